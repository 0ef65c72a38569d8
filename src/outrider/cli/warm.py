"""The first run compiles for seconds: two processes share it where there are two cores."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

COMMAND = "import sys; from outrider.warm import compile_later_steps; compile_later_steps(sys.argv[1])"


@contextmanager
def compiling_beside(observer: str) -> Iterator[None]:
    """While the body runs, and where nothing is compiled yet, compile the later loops in a second process.

    What that process leaves in the cache is found by this one; if it fails, this one compiles as usual.
    """
    from outrider import compiler

    if not compiler.cold():
        yield
        return
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        [sys.executable, "-c", COMMAND, observer], stdin=quiet, stdout=quiet, stderr=quiet
    ) as child:
        try:
            yield
        finally:
            child.terminate()  # done long ago, or no longer of use
