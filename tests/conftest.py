"""What every test has: strict NumPy, no display, repeatable Hypothesis, real recordings if there are any."""

import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

mpl.use("Agg")

settings.register_profile(
    "repeatable",
    deadline=None,  # the first call may compile
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("repeatable")


def pytest_collection_modifyitems(items):
    """What takes minutes runs where it is asked for."""
    if not os.environ.get("OUTRIDER_SLOW"):
        for item in items:
            if item.get_closest_marker("slow"):
                item.add_marker(pytest.mark.skip(reason="takes long: set OUTRIDER_SLOW"))


@pytest.fixture(autouse=True)
def numpy_errors_are_raised():
    """Division by zero, overflow and invalid values end a test; underflow to zero is harmless."""
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    """Each test runs in an empty folder of its own: a stray file cannot land in the tree."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the real recordings, named by OUTRIDER_DATA."""
    folder = os.environ.get("OUTRIDER_DATA", "")
    if not folder:
        pytest.skip("real recordings: set OUTRIDER_DATA to the folder that holds them")
    if not Path(folder).is_dir():
        pytest.skip(f"real recordings: OUTRIDER_DATA={folder} is not a folder")
    return Path(folder)


@pytest.fixture
def outrider(capsys):
    """Call the command line in this process: exit code, stdout, stderr; one line on stderr where refused."""
    from outrider import cli

    def call(*tokens):
        capsys.readouterr()
        code = cli.run([str(token) for token in tokens])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        assert len(err.splitlines()) == (code != 0), err
        return code, out, err

    return call
