"""The one door to Numba: loops over tracks, what kernels need in them, a compile cache that cannot go stale.

Numba judges cached code by the time stamp of the function's own file; a function of another file that
was inlined into it may change unnoticed. So the cache folder is named after the contents of the package.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.extending import overload, register_jitable, type_callable
from numba.np.arrayobj import make_array, populate_array

from outrider.kernel import MARKED, axpy, from_row, matrix, to_row

F = TypeVar("F", bound=Callable[..., Any])

INNER = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "forceinline": True,
}  # no way in from Python, and no calls: sizes of matrices become constants
KEEP_S = 30 * 86400.0  # an older version's cache not used for this long is removed [s]


def compiled(function: F, of: Any = None) -> F:
    """A loop over arrays, compiled at its first call, kept on disk; divides as NumPy does, no GIL.

    No fast-math: NaN and infinity keep their meaning. `function.py_func` is the original. Where one loop is
    compiled for several observers, `of` is the class of this one's state: each is kept in a file of its own,
    so that none needs the others to be read.
    """
    while MARKED:
        register_jitable(**INNER)(MARKED.pop())
    if of is not None:
        function.__qualname__ += f".{of.__module__}"
    return cast(F, numba.njit(cache=True, error_model="numpy", nogil=True)(function))


def fingerprint(package: Path) -> str:
    """First 16 hex digits of the SHA-256 over names and contents of all Python files under `package`."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def cache_folder(base: Path, name: str) -> Path:
    """Folder `name` under `base`, made and marked as used; a temporary one where that cannot be.

    Siblings of other versions (same name up to the dash) that were not used for `KEEP_S` are removed.
    """
    folder = base / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    for other in base.glob(name.split("-")[0] + "-*"):
        if other != folder and other.is_dir() and not other.is_symlink() and _age(other) > KEEP_S:
            shutil.rmtree(other, ignore_errors=True)
    return folder


def _age(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except OSError:  # removed by another process meanwhile
        return 0.0


def _user_cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(base) / "outrider" if base else Path(os.path.expanduser("~")) / ".cache" / "outrider"


if not os.environ.get("NUMBA_CACHE_DIR"):  # before anything is compiled
    numba.config.CACHE_DIR = str(
        cache_folder(_user_cache(), f"outrider-{fingerprint(Path(__file__).parent)}")
    )


def _compiled_axpy(a, b, h):  # type: ignore[no-untyped-def]
    terms = ", ".join(f"a[{i}] + h * b[{i}]" for i in range(len(a)))
    return eval(f"lambda a, b, h: cls({terms})", {"cls": a.instance_class})


overload(axpy, jit_options=INNER)(_compiled_axpy)


# ------------------------------------------------------------------ rows of arrays

# Plain loads and stores: indexing by a variable would pass the whole tuple through memory, once a number.


@type_callable(from_row)
def _type_of_from_row(context):  # type: ignore[no-untyped-def]
    def typer(cls, row):  # type: ignore[no-untyped-def]
        made = cls.instance_class
        return numba.types.NamedUniTuple(row.dtype, len(made._fields), made)

    return typer


@type_callable(to_row)
def _type_of_to_row(context):  # type: ignore[no-untyped-def]
    return lambda values, row: numba.types.none


def _places(context: Any, builder: Any, kind: Any, row: Any, n: int) -> Iterator[Any]:
    """Pointers to the first n numbers of a one-dimensional array."""
    array = make_array(kind)(context, builder, row)
    stride = cgutils.unpack_tuple(builder, array.strides, 1)[0]
    for i in range(n):
        at = context.get_constant(numba.types.intp, i)
        if kind.layout == "C":
            yield builder.gep(array.data, [at])
        else:
            yield cgutils.pointer_add(builder, array.data, builder.mul(stride, at))


@lower_builtin(from_row, numba.types.NamedTupleClass, numba.types.Array)
def _make_from_row(context, builder, signature, args):  # type: ignore[no-untyped-def]
    made, kind = signature.return_type, signature.args[1]
    values = [builder.load(place) for place in _places(context, builder, kind, args[1], made.count)]
    return context.make_tuple(builder, made, values)


@lower_builtin(to_row, numba.types.BaseTuple, numba.types.Array)
def _make_to_row(context, builder, signature, args):  # type: ignore[no-untyped-def]
    kinds, kind = signature.args
    values = cgutils.unpack_tuple(builder, args[0], len(kinds))
    places = _places(context, builder, kind, args[1], len(kinds))
    for value, of, place in zip(values, kinds, places, strict=True):
        builder.store(context.cast(builder, value, of, kind.dtype), place)
    return context.get_dummy_value()


# ------------------------------------------------------------------ small matrices


@type_callable(matrix)
def _type_of_matrix(context):  # type: ignore[no-untyped-def]
    def typer(rows, columns):  # type: ignore[no-untyped-def]
        literal = numba.types.IntegerLiteral
        known = isinstance(rows, literal) and isinstance(columns, literal)
        return numba.types.Array(numba.float64, 2, "C") if known else None

    return typer


@lower_builtin(matrix, numba.types.IntegerLiteral, numba.types.IntegerLiteral)
def _make_matrix(context, builder, signature, args):  # type: ignore[no-untyped-def]
    rows, columns = (arg.literal_value for arg in signature.args)
    kind, size = signature.return_type, 8 * rows * columns
    place = cgutils.alloca_once(builder, cgutils.ir.ArrayType(cgutils.ir.DoubleType(), rows * columns))
    cgutils.memset(builder, place, context.get_constant(numba.types.intp, size), 0)
    array = make_array(kind)(context, builder)

    def constants(*values: int) -> Any:
        return cgutils.pack_array(builder, [context.get_constant(numba.types.intp, v) for v in values])

    populate_array(
        array,
        data=builder.bitcast(place, array.data.type),
        shape=constants(rows, columns),
        strides=constants(8 * columns, 8),
        itemsize=context.get_constant(numba.types.intp, 8),
        meminfo=None,
    )
    return array._getvalue()


# ------------------------------------------------------------------ drivers


class Stream(NamedTuple):
    """Compiled loops over tracks; track i is row i of every array; `index` (k,) int64 says which are touched.

    `out` may be the array of states itself. dt (N,) [s]; measurements (N, n_measurements). All C-contiguous
    float64: other layouts work, but each is compiled anew.
    """

    start_all: Any  # (first, second, dt, gains, index, out (N, n_states))
    step_all: Any  # (states (N, n_states), previous, measurement, dt, gains, index, out (N, n_states))
    predict_all: Any  # (states, dt, gains, index, out (N, n_states))
    motion_all: Any  # (states, gains, index, out (N, n_motion))


@lru_cache
def each(of: Any, State: Any) -> Any:
    """Compiled each_one(states (N, n_states), gains, index, out (N, m)): what `of(state, gains)` says."""

    @partial(compiled, of=State)
    def each_one(states, gains, index, out):  # type: ignore[no-untyped-def]
        for i in index:
            to_row(of(from_row(State, states[i]), gains), out[i])

    return each_one


@lru_cache
def stream(start: Any, step: Any, predict: Any, motion: Any, State: Any, Measurement: Any) -> Stream:
    """Compiled loops over the rows of arrays, one call a scan, from four functions of one track."""

    @partial(compiled, of=State)
    def start_all(first, second, dt, gains, index, out):  # type: ignore[no-untyped-def]
        for i in index:
            y0, y1 = from_row(Measurement, first[i]), from_row(Measurement, second[i])
            to_row(start(y0, y1, dt[i], gains), out[i])

    @partial(compiled, of=State)
    def step_all(states, previous, measurement, dt, gains, index, out):  # type: ignore[no-untyped-def]
        for i in index:
            s = from_row(State, states[i])
            y0, y1 = from_row(Measurement, previous[i]), from_row(Measurement, measurement[i])
            to_row(step(s, y0, y1, dt[i], gains), out[i])

    @partial(compiled, of=State)
    def predict_all(states, dt, gains, index, out):  # type: ignore[no-untyped-def]
        for i in index:
            to_row(predict(from_row(State, states[i]), dt[i], gains), out[i])

    return Stream(start_all, step_all, predict_all, each(motion, State))


@lru_cache
def batch(start: Any, step: Any, State: Any, Measurement: Any) -> Any:
    """Compiled loop over recordings: run(measurements (N, T, m), dt (N, T), gains, out (N, T, n_states)).

    dt[i, k] is the time from sample k - 1 to k of track i [s]. A track starts at its first two neighbouring
    samples without NaN in the first two columns; rows of `out` before are NaN.
    """

    @partial(compiled, of=State)
    def run(measurements, dt, gains, out):  # type: ignore[no-untyped-def]
        for i in range(measurements.shape[0]):
            started = False
            out[i] = float("nan")
            for k in range(1, measurements.shape[1]):
                y0 = from_row(Measurement, measurements[i, k - 1])
                y1 = from_row(Measurement, measurements[i, k])
                if started:
                    to_row(step(from_row(State, out[i, k - 1]), y0, y1, dt[i, k], gains), out[i, k])
                elif y0[0] + y0[1] + y1[0] + y1[1] == y0[0] + y0[1] + y1[0] + y1[1]:
                    to_row(start(y0, y1, dt[i, k], gains), out[i, k])
                    started = True

    return run


@lru_cache
def lagged(smooth: Any, State: Any) -> Any:
    """Compiled loop over recordings: run(states (N, T, n), dt (N, T), lag, gains, out (N, T, n)).

    out[i, k] is the state at sample k, smoothed back from the filtered one at sample k + lag; NaN rows where
    either is not known.
    """

    @partial(compiled, of=State)
    def run(states, dt, lag, gains, out):  # type: ignore[no-untyped-def]
        out[:] = float("nan")
        for i in range(states.shape[0]):
            for k in range(states.shape[1] - lag):
                if states[i, k, 0] != states[i, k, 0]:
                    continue
                s = from_row(State, states[i, k + lag])
                for j in range(lag):
                    m = k + lag - j
                    s = smooth(from_row(State, states[i, m - 1]), s, dt[i, m], gains)
                to_row(s, out[i, k])

    return run


@lru_cache
def log(start: Any, step: Any, output: Any, State: Any, Sample: Any, still: Any = None) -> Any:
    """Compiled loop over a car's log: run(samples (n, k), car, design, least speed, longest gap, out, held).

    A row is used where dt, vx, yaw rate and steering, columns 0, 1, 2 and 4, are finite, dt > 0 (but not in
    the first row) and |vx| is at least the least speed [m/s]. Else the last estimate is held; what was held
    for longer than the gap [s] starts anew. out (n, m): the output, NaN before the first row used; held (n,).
    With `still`, which is as `step`, a row that is slower than that, but else as good, goes to the state.
    """
    width, learns = len(State._fields), still is not None
    rest = still if learns else step

    @partial(compiled, of=State)
    def run(samples, car, design, least, gap, out, held):  # type: ignore[no-untyped-def]
        started, since = False, 0.0
        row, now = np.zeros(width), np.zeros(samples.shape[1])
        for k in range(len(samples)):
            dt = samples[k, 0]
            whole = np.isfinite(samples[k, 1]) and np.isfinite(samples[k, 2]) and np.isfinite(samples[k, 4])
            timed = np.isfinite(dt) and dt > 0.0
            since = since + dt if timed else since
            good = whole and (timed or not started)
            used = good and abs(samples[k, 1]) >= least
            held[k] = not used
            if good and (used or learns):
                now[:] = samples[k]
                now[0] = since
                y = from_row(Sample, now)
                if not started or (used and since > gap):
                    to_row(start(y, car, design), row)
                elif used:
                    to_row(step(from_row(State, row), y, car, design), row)
                else:
                    to_row(rest(from_row(State, row), y, car, design), row)
                started, since = True, 0.0
            if used:
                to_row(output(from_row(State, row), y, car, design), out[k])
            elif k > 0:
                out[k] = out[k - 1]

    return run


def cold() -> bool:
    """Whether nothing has been compiled yet for this version of the package on this machine."""
    return next(Path(numba.config.CACHE_DIR).rglob("*.nbi"), None) is None
