"""A proof of stability as data, re-checked from its definition with NumPy alone.

A certificate says: for every matrix A of a family, the error dynamics e' = A e (continuous form) or
e+ = A e (sampled form) shrinks V(e) = e' P e at least at the given rate. The family is what an observer's
gains give over a region of speed, time step and so on; its corners or grid points are the `matrices`.
What the numbers say and do not say is in docs/proofs.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.errors import InputError, OutputError
from outrider.inequalities import Form

Array = npt.NDArray[np.float64]

FORMAT, VERSION = "outrider certificate", 1
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, slots=True)
class Bound:
    """|error of `of`| <= gain * max |disturbance `by`| once the start is forgotten; with its own proof.

    The error is C x of x' = A x + B d (continuous) or x+ = A x + B d (sampled). kind "peak": as above, by an
    ellipsoid x'Px <= 1 with multiplier `a`, or, where exact, by the impulse response. kind "energy": the same
    of root sums of squares over all time (L2 gain), by P.
    """

    of: str  # what is estimated, such as "speed"
    by: str  # the disturbance, such as "position"
    gain: float  # unit of `of` per unit of `by`
    exact: bool  # reached by some disturbance (impulse response), or an upper bound only
    kind: Literal["peak", "energy"] = "peak"
    A: Array | None = None  # (m, n, n); exact: (1, n, n)
    B: Array | None = None  # (m, n, k)
    C: Array | None = None  # (p, n)
    P: Array | None = None  # (n, n); None where exact
    a: float = 0.0  # multiplier of the ellipsoid [1/s], sampled [-]

    def __post_init__(self) -> None:
        """Arrays made float and read-only; InputError for shapes that do not fit or a number not finite."""
        _arrays(self, "A", "B", "C", "P")
        _finite(f"bound on {self.of}", self.gain, self.a)
        if self.A is None or self.B is None or self.C is None:
            return
        m, _, n = (*self.A.shape, 0, 0, 0)[:3]
        k, p = (*self.B.shape, 0, 0, 0)[2], (*self.C.shape, 0)[0]
        want = {"A": (m, n, n), "B": (m, n, k), "C": (p, n), "P": (n, n)}
        _shapes(self, f"bound on {self.of}", want)

    def margin(self, form: Form) -> float:
        """Smallest slack of its inequalities, relative; inf: exact and holds; -inf: nothing is proven."""
        if self.A is None or self.B is None or self.C is None or not self.gain >= 0.0:
            return -np.inf
        if self.exact:
            if self.kind != "peak" or len(self.A) != 1:
                return -np.inf
            reached = peak(self.A[0], self.B[0], self.C, form)
            return np.inf if self.gain >= reached * (1.0 - 1e-6) else self.gain / reached - 1.0
        if self.P is None or not self.gain > 0.0:
            return -np.inf
        P, g2 = self.P, self.gain**2
        slack = [relative(-P, _size(P))]
        if self.kind == "peak":
            slack.append(relative(inequalities.inside(self.C / self.gain, P, 1.0), max(_size(P), 1.0)))
        if self.kind == "peak":
            M = inequalities.ellipsoid(self.A, self.B, P, self.a, form)
        else:
            M = inequalities.energy(self.A, self.B, self.C, P, g2, form)
        return min(*slack, relative(M, _size(self.A.mT @ P) + _size(P @ self.B) + _size(P)))


@dataclass(frozen=True, slots=True)
class Certificate:
    """P and a rate for a family of error matrices, the region and the assumptions under which it is one."""

    observer: str  # name in observers/
    form: Form  # which difference or differential equation runs
    matrices: Array  # (m, n, n) error matrices, scaled to states of like size
    P: Array  # (n, n)
    rate: float  # continuous: e decays as exp(-rate t) [1/s]; sampled: each step by at least this factor [-]
    region: Mapping[str, tuple[float, float]]  # quantity with unit -> from, to
    assumptions: tuple[str, ...]  # what must hold besides, one sentence each
    bounds: tuple[Bound, ...] = field(default=())
    corners: tuple[str, ...] = field(default=())  # (m,) what each matrix is, for messages; () unknown

    def __post_init__(self) -> None:
        """Arrays made float and read-only; InputError for shapes that do not fit or a number not finite."""
        _arrays(self, "matrices", "P")
        m, _, n = (*self.matrices.shape, 0, 0, 0)[:3]
        _shapes(self, f"certificate of {self.observer}", {"matrices": (m, n, n), "P": (n, n)})
        if not m or self.form not in ("continuous", "sampled"):
            raise InputError(
                f"certificate of {self.observer}: {m} matrices, form {self.form!r}; want one or more, and "
                "continuous or sampled"
            )
        _finite(f"certificate of {self.observer}", self.rate, *np.ravel(list(self.region.values())))

    def margin(self) -> float:
        """Smallest slack of all inequalities, relative to the size of their matrices; positive: proven.

        Continuous: -(A'P + P A + 2 rate P); sampled: rate^2 P - A'P A; and P itself; each divided by its
        largest term's spectral norm. The bounds' own slacks count too. A continuous rate below 0, or a
        sampled one above 1, is no decay: -inf.
        """
        if not (self.rate >= 0.0 if self.form == "continuous" else 0.0 < self.rate <= 1.0):
            return -np.inf
        P = 0.5 * (self.P + self.P.T)
        slack = [relative(-P, _size(P)), *(bound.margin(self.form) for bound in self.bounds)]
        if self.form == "continuous":
            size = _size(self.matrices.mT @ P) + self.rate * _size(P)
        else:
            size = _size(self.matrices.mT @ P @ self.matrices) + self.rate**2 * _size(P)
        return min(*slack, relative(inequalities.decay(self.matrices, P, self.rate, self.form), size))

    def tolerance(self) -> float:
        """What rounding alone can make of a margin: 100 n machine epsilons."""
        return 100.0 * len(self.P) * EPS

    def proven(self) -> bool:
        """Whether the margin is beyond rounding."""
        return self.margin() > self.tolerance()

    def failing(self) -> str:
        """Why nothing is proven, in words: the matrix and its eigenvalue where one alone is too slow."""
        found = unstable(self.matrices, self.corners, self.rate, self.form)
        return found or f"margin {self.margin():.1e}, want more than {self.tolerance():.0e}: P proves nothing"

    def __str__(self) -> str:
        """A report to read: region, rate, bounds, margin, assumptions."""
        margin, least = self.margin(), self.tolerance()
        verdict = "proven" if margin > least else "NOT PROVEN"
        decay = f"exp(-{self.rate:.4g} t), t in s" if self.form == "continuous" else f"{self.rate:.4g} a step"
        lines = [
            f"{self.observer}: {verdict}, margin {margin:.2e} (rounding {least:.0e})",
            f"  form      {self.form}, {len(self.matrices)} matrices, {len(self.P)} states",
            f"  decay     {decay}",
            *(f"  region    {name}: {low:.4g} to {high:.4g}" for name, (low, high) in self.region.items()),
        ]
        for b in self.bounds:
            how = "exact" if b.exact else "at most"
            what = "max" if b.kind == "peak" else "root of the energy of"
            lines.append(f"  bound     {what} |{b.of}| <= {b.gain:.4g} {what} |{b.by}|, {how}")
        return "\n".join(lines + [f"  assumes   {text}" for text in self.assumptions])

    def save(self, path: str | Path) -> None:
        """Write as JSON, numbers to the last bit; OutputError where that cannot be."""
        content = {"format": FORMAT, "version": VERSION, **_plain(self)}
        try:
            Path(path).write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise OutputError(
                f"{path}: cannot be written ({error.strerror}); choose another place"
            ) from error


def load(path: str | Path) -> Certificate:
    """Certificate from a file of `save`; it is not proven until `proven()` says so.

    InputError for a file that is missing, truncated, of another version, or holds what is no certificate.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); want a certificate") from error
    except ValueError as error:
        raise InputError(f"{path}: no JSON ({error}); the file is damaged, make it anew") from error
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise InputError(f"{path}: not a certificate; want a file that `Certificate.save` wrote")
    version = content.pop("version", None)
    if version != VERSION:
        raise InputError(f"{path}: version {version!r}; want {VERSION}; make it anew with this outrider")
    try:
        content["bounds"] = tuple(Bound(**bound) for bound in content["bounds"])
        content["region"] = {str(name): (float(a), float(b)) for name, (a, b) in content["region"].items()}
        content["assumptions"] = tuple(map(str, content["assumptions"]))
        content["corners"] = tuple(map(str, content.get("corners", ())))
        return Certificate(**content)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not a whole certificate ({error}); make it anew") from error


def unstable(matrices: Array, corners: Sequence[str], rate: float, form: Form) -> str:
    """Which of the matrices (m, n, n) alone does not decay at `rate`, worst first; "" where all do."""
    poles = np.linalg.eigvals(matrices)
    pace = poles.real if form == "continuous" else np.abs(poles)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(pace)), pace.shape))
    limit = 0.0 - rate if form == "continuous" else rate
    if pace[i, j] < limit:
        return ""
    pole = complex(poles[i, j])
    where = corners[i] if len(corners) == len(matrices) else f"matrix {i} of {len(matrices)}"
    imaginary = f"{pole.imag:+.4g}i" if pole.imag else ""
    part = "its real part" if form == "continuous" else "its magnitude"
    return (
        f"at {where} the frozen error dynamics has the eigenvalue {pole.real:+.4g}{imaginary}, want {part} "
        f"below {limit:g}"
    )


def peak(A: Array, B: Array, C: Array, form: Form) -> float:
    """Largest |y| that some |d| <= 1 reaches: x' = A x + B d or x+ = A x + B d, y = C x; A must be stable.

    The integral (or sum) of the impulse response's magnitude, one disturbance and one output: B (n, 1), C
    (1, n). Continuous: total variation of the step response, its turns found by halving where the impulse
    response changes sign. InputError for other shapes, inf where A is not stable.
    """
    if B.shape[1] != 1 or C.shape[0] != 1:
        raise InputError(f"peak of B {B.shape} and C {C.shape}; want one disturbance and one output")
    poles = np.linalg.eigvals(A)
    slow = float(np.abs(poles).max() if form == "sampled" else np.exp(poles.real.max()))
    if not slow < 1.0 - 1e-9:
        return np.inf
    length = 40.0 / -np.log(max(slow, 1e-12))  # until exp(-40) is left [s, steps]
    if form == "sampled":
        return float(np.abs(C[0] @ _powers(A, B[:, 0], int(length) + len(A) + 1)).sum())
    return _variation(A, B[:, 0], C[0], length, 1.0 / max(float(np.abs(poles).max()), 1e-12))


def _powers(A: Array, b: Array, count: int) -> Array:
    """b, A b, A^2 b ... (n, at least count), by doubling."""
    columns = b[:, None]
    while columns.shape[1] < count:
        columns, A = np.hstack([columns, A @ columns]), A @ A
    return columns


def _variation(A: Array, b: Array, c: Array, length: float, fast: float) -> float:
    """Integral of |c exp(A t) b| over [0, length]: sum of the step response's ups and downs."""
    h = 0.05 * fast
    x = _powers(_exponential(A * h), b, min(int(length / h) + 2, 1 << 20))
    to_step = np.linalg.solve(A.T, c)  # step response: to_step (exp(A t) b - b)
    impulse = c @ x
    turning = np.flatnonzero(impulse[:-1] * impulse[1:] < 0.0)
    y, until = x[:, turning], impulse[turning + 1]  # where it turns, by halving
    for i in range(1, 40):
        middle = _exponential(A * h * 0.5**i) @ y
        y = np.where((c @ middle) * until > 0.0, y, middle)
    turns = np.r_[to_step @ b, to_step @ y, to_step @ x[:, -1]]
    return float(np.abs(np.diff(turns)).sum())


def _exponential(M: Array) -> Array:
    """exp(M) of a matrix of norm below about 1: Taylor's series, squared thrice."""
    N, term, total = M / 8.0, np.eye(len(M)), np.eye(len(M))
    for i in range(1, 20):
        term = term @ N / i
        total = total + term
    for _ in range(3):
        total = total @ total
    return total


def relative(M: Array, size: Any) -> float:
    """Slack of M < 0, of all in a stack: minus the largest eigenvalue over `size`; -inf where not finite."""
    if not np.isfinite(M).all():
        return -np.inf
    return float((-np.linalg.eigvalsh(0.5 * (M + M.mT))[..., -1] / size).min())


def _size(M: Array) -> Any:
    """Spectral norm of each matrix."""
    return np.maximum(np.linalg.norm(M, 2, axis=(-2, -1)), np.finfo(float).tiny)


def _arrays(record: Any, *names: str) -> None:
    for name in names:
        value = getattr(record, name)
        if value is not None:
            try:
                array = np.array(value, float)
            except (TypeError, ValueError) as error:
                raise InputError(f"{name} is no array of numbers ({error}); want numbers") from error
            array.flags.writeable = False
            object.__setattr__(record, name, array)


def _shapes(record: Any, what: str, want: Mapping[str, tuple[int, ...]]) -> None:
    for name, shape in want.items():
        array = getattr(record, name)
        if array is not None and array.shape != shape:
            raise InputError(f"{what}: {name} has shape {array.shape}; want {shape}")
        if array is not None:
            _finite(f"{what}: {name}", *array.ravel())


def _finite(what: str, *values: Any) -> None:
    if not all(isinstance(v, float | int) and np.isfinite(v) for v in values):
        raise InputError(f"{what}: a number is not finite; want finite numbers")


def _plain(value: Any) -> Any:
    """Dataclasses, arrays, mappings and tuples as what JSON knows."""
    if isinstance(value, Bound | Certificate):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, tuple | list) else value
