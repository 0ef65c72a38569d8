"""Observers in plain scalar C: the time that compiled code may take, and a second writing to check ours."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

HERE = Path(__file__).parent
FLAGS = (
    *("-std=c11", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC"),
    "-finline-limit=10000",  # inlined like our kernels: up to a quarter faster
    *("-fno-tree-vectorize", "-fno-tree-slp-vectorize", "-ffp-contract=off"),  # scalar; no fused operations
)
Array = npt.NDArray[np.float64]


def names() -> list[str]:
    """Observers that are written in C here; what they share is in common.h."""
    return sorted(path.stem for path in HERE.glob("*.c"))


def compiler() -> str | None:
    """The system's C compiler, if there is one."""
    return shutil.which("cc")


@cache
def build(name: str) -> Any:
    """run(y (N, T, 9), dt (N, T), gains, out (N, T, n_states)) of NAME.c, compiled once a process.

    All arrays C-contiguous float64; `gains` is the observer's Gains. CalledProcessError, with the compiler's
    own words on stderr, where it does not compile.
    """
    cc = compiler()
    if cc is None:
        raise FileNotFoundError("no C compiler `cc` on the path")
    with tempfile.TemporaryDirectory(prefix="outrider-") as folder:
        library = Path(folder) / f"{name}.so"
        subprocess.run([cc, *FLAGS, str(HERE / f"{name}.c"), "-o", str(library), "-lm"], check=True)
        function = ctypes.CDLL(str(library)).run  # stays loaded when the file is gone
    function.argtypes = [ctypes.c_void_p] * 4 + [ctypes.c_long] * 2
    function.restype = None

    def run(y: Array, dt: Array, gains: Any, out: Array) -> None:
        arrays = (y, dt, np.hstack([np.ravel(np.asarray(value, float)) for value in gains]), out)
        if not all(a.dtype == np.float64 and a.flags.c_contiguous for a in arrays):
            raise TypeError("arrays in C order of float64 wanted")
        function(*(a.ctypes.data for a in arrays), *dt.shape)

    return run
