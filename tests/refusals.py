"""What a command line says when it refuses."""


def refused(result, *words):
    """One line on stderr with these words, nothing on stdout, exit code 2."""
    code, out, err = result
    assert (code, out) == (2, "")
    assert err.startswith("outrider: ")
    for word in words:
        assert word in err
    return True
