"""Observers of one target vehicle: the contract, and the drivers that run any of them over many tracks.

One file is one observer, named in the settings as the file is. To add one: docs/observers.md.
Fixed frame W, lengths of the full-size world, angles counter-clockwise.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from outrider import extension
from outrider.certificate import Certificate
from outrider.errors import InputError
from outrider.extension import nearest
from outrider.proof_file import ProofFile

Array = npt.NDArray[np.float64]


class Measurement(NamedTuple):
    """One vehicle in one scan; x or y not finite: not seen. Columns of a measurement array, in this order."""

    x: float  # body centre in W [m]
    y: float  # [m]
    xx: float = 0.0  # covariance of the centre [m2]
    xy: float = 0.0  # [m2]
    yy: float = 0.0  # [m2]
    heading: float = 0.0  # the way the body points [rad]
    heading_variance: float = float("inf")  # [rad2]; inf: heading not known
    length: float = 0.0  # of the body [m]
    width: float = 0.0  # [m]


class Motion(NamedTuple):
    """What every observer estimates, whatever its state. Columns of a motion array, in this order."""

    x: float  # body centre in W [m]
    y: float  # [m]
    speed: float  # along the course, negative when reversing [m/s]
    acceleration: float  # along the course [m/s2]
    course: float  # the way the centre moves when going forward, in [-pi, pi) [rad]
    yaw: float  # the way the body points, in [-pi, pi) [rad]
    slip: float  # course - yaw [rad]
    yaw_rate: float  # [rad/s]


class Innovation(NamedTuple):
    """How far a measured position is from the predicted one, and how far it may be by chance."""

    x: float  # measured minus predicted, in W [m]
    y: float  # [m]
    xx: float  # covariance of this difference, as the observer sees it [m2]
    xy: float  # [m2]
    yy: float  # [m2]


class Spread(NamedTuple):
    """Covariance of the estimated position (x, y) and velocity (u, v) in W; the ten entries of one half."""

    xx: float  # [m2]
    xy: float  # [m2]
    yy: float  # [m2]
    xu: float  # [m2/s]
    yu: float  # [m2/s]
    uu: float  # [m2/s2]
    xv: float  # [m2/s]
    yv: float  # [m2/s]
    uv: float  # [m2/s2]
    vv: float  # [m2/s2]


class Observer(Protocol):
    """The contract of a file in this folder: names at module level, functions pure and marked `@kernel`."""

    reference: str  # where the equations are published
    State: Any  # NamedTuple of floats, covariance and mode probabilities included where there are any
    Gains: Any  # NamedTuple of floats (arrays are allowed, but not set by name), published values as defaults

    def start(self, y0: Measurement, y1: Measurement, dt: float, gains: Any) -> Any:
        """State at the time of y1 from two measurements dt [s] apart, finite if one of them is."""

    def step(self, state: Any, previous: Measurement, measurement: Measurement, dt: float, gains: Any) -> Any:
        """State at the time of `measurement`, dt [s] after `state`; dt not in (0, inf): unchanged.

        `previous` was measured at the time of `state`. Where `measurement` is not finite the state is
        predicted; where `previous` is not finite the state speaks for it.
        """

    def predict(self, state: Any, dt: float, gains: Any) -> Any:
        """State after dt [s] without a measurement; dt not in (0, inf): unchanged."""

    def motion(self, state: Any, gains: Any) -> Motion:
        """The state in common terms."""

    def innovation(self, state: Any, measurement: Measurement, gains: Any) -> Innovation:
        """Measured minus predicted position, with covariance; `state` is at the measurement's time."""

    def certificate(self) -> Any:
        """Proof of stability of the default gains, or None."""

    # Only some observers have these; ask with hasattr.
    #   DESIGNED: Gains                                     gains from our own matrix inequalities
    #   spread(state, gains) -> Spread                      covariance, where there is one
    #   smooth(state, later, dt, gains) -> State            state with what `later`, dt [s] after it, knows
    #   claim(gains, form, **region) -> claim.Claim         what is to be proven, for any gains and region


def names() -> list[str]:
    """Names of all observers: the files of this folder."""
    return extension.files(*__path__)


def get(name: str) -> Observer:
    """Observer by name; InputError, with the nearest names, for an unknown one."""
    found: Observer = extension.load(__name__, name, names(), "observer")
    return found


def gains_from(observer: Observer, values: Mapping[str, float]) -> Any:
    """The observer's Gains with some numbers replaced; InputError for an unknown name or no finite number."""
    named: Any = observer
    where = f"observer.gains.{named.__name__.rpartition('.')[2]}: "
    return extension.replaced(observer.Gains(), values, where)


def certificate_of(file: ProofFile, gains: Any = None) -> Certificate:
    """The certificate that a file of gains claims, its error matrices made anew; not checked.

    gains: other ones than the file's. InputError for an observer, gain, form or region that this version does
    not know; NotCertified where P is not of the shape that the claim's argument needs.
    """
    observer: Any = get(file.observer)
    if not hasattr(observer, "claim"):
        raise InputError(f"observer {file.observer!r} claims nothing; want one with a proof")
    if gains is None:
        missing = observer.Gains._fields - file.gains.keys()
        if missing:
            raise InputError(f"{file.observer}: {len(missing)} gains are missing; make it anew")
        gains = gains_from(observer, file.gains)
    try:
        claim = observer.claim(gains, file.form, **file.asked)
    except TypeError as error:
        raise InputError(f"{file.observer}: no such region ({error}); make it anew") from error
    made: Certificate = claim.certificate(file.P, file.rate, file.proofs)
    return made


class Variant(NamedTuple):
    """An observer with the gains and the lag that were asked for by name."""

    label: str  # as asked for
    observer: Any
    gains: Any
    lag: int  # [scans]


def gain_sets(observer: Any) -> dict[str, Any]:
    """Gains that an observer's file names besides its defaults, by name in lower case, such as `designed`."""
    found = {name.lower(): value for name, value in vars(observer).items() if name.isupper()}
    return {name: value for name, value in found.items() if isinstance(value, observer.Gains)}


def variant(text: str, changes: Mapping[str, Mapping[str, float]] | None = None) -> Variant:
    """The observer that `NAME`, `NAME:SET`, `NAME+lagN` or `NAME:SET+lagN` asks for.

    SET: one of `gain_sets`, or `default`. Without it, the defaults with what `changes` states of NAME.
    InputError for what is not known, with the nearest names.
    """
    parts = re.fullmatch(r"([^:+]*)(?::([^:+]*))?(?:\+lag(\d{1,4}))?", text.strip().lower())
    if parts is None:
        raise InputError(f"observer {text!r}: want NAME, NAME:GAINS, NAME+lagN or NAME:GAINS+lagN")
    name, chosen, lag = parts[1], parts[2], int(parts[3] or 0)
    observer: Any = get(name)
    sets = {"default": observer.Gains(), **gain_sets(observer)}
    if chosen is None:
        gains = gains_from(observer, (changes or {}).get(name, {}))
    elif chosen in sets:
        gains = sets[chosen]
    else:
        raise InputError(f"observer {name}: no gains {chosen!r}{nearest(chosen, list(sets))}")
    check_lag(observer, lag)
    return Variant(text.strip().lower(), observer, gains, lag)


def variants(text: str, changes: Mapping[str, Mapping[str, float]] | None = None) -> list[Variant]:
    """The variants of a list with commas, each once; `all`: every observer with all its gains.

    `all` also looks two scans back with those that can. InputError as of `variant`.
    """
    labels: list[str] = []
    for part in text.split(","):
        labels += list(_every(changes or {})) if part.strip().lower() == "all" else [part.strip().lower()]
    return [variant(label, changes) for label in dict.fromkeys(labels)]


def _every(changes: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    for name in names():
        observer: Any = get(name)
        yield name
        used = [gains_from(observer, changes.get(name, {}))]
        for chosen, gains in {"default": observer.Gains(), **gain_sets(observer)}.items():
            if gains not in used:
                used.append(gains)
                yield f"{name}:{chosen}"
        if hasattr(observer, "smooth"):
            yield f"{name}+lag2"


def stream(observer: Observer) -> Any:
    """Compiled start_all, step_all, predict_all, motion_all over arrays of tracks (`compiler.Stream`)."""
    from outrider import compiler

    o = observer
    return compiler.stream(o.start, o.step, o.predict, o.motion, o.State, Measurement)


def batch(observer: Observer, measurements: Array, dt: Array, gains: Any) -> Array:
    """States (N, T, n_states) of N tracks from measurements (N, T, 9), dt (N, T) since the last sample [s].

    Bit for bit what `stream` gives. NaN before a track's first two neighbouring finite samples.
    InputError where the shapes do not fit.
    """
    from outrider import compiler

    y, dt = np.ascontiguousarray(measurements, float), np.ascontiguousarray(dt, float)
    if y.ndim != 3 or y.shape[2] != len(Measurement._fields) or dt.shape != y.shape[:2]:
        raise InputError(
            f"measurements {y.shape} and dt {dt.shape}; want (N, T, {len(Measurement._fields)}) and (N, T)"
        )
    out = np.empty((*dt.shape, len(observer.State._fields)))
    run = compiler.batch(observer.start, observer.step, observer.State, Measurement)
    run(y, dt, gains, out)
    return out


def check_lag(observer: Any, lag: int) -> None:
    """InputError for a lag [scans] that is negative, or of an observer that cannot smooth."""
    if lag < 0:
        raise InputError(f"lag = {lag} scans; want 0 or more")
    if lag and not hasattr(observer, "smooth"):
        able = [name for name in names() if hasattr(get(name), "smooth")]
        raise InputError(f"lag = {lag} scans: this observer cannot look back; want one of {', '.join(able)}")


def lagged(observer: Any, states: Array, dt: Array, lag: int, gains: Any) -> Array:
    """States (N, T, n_states) at each sample as known `lag` samples later, from what `batch` gave.

    Fixed-lag smoothing: row k looks back from the filtered state of sample k + lag; the last `lag` rows are
    NaN. InputError for a negative lag, or an observer that cannot smooth.
    """
    from outrider import compiler

    check_lag(observer, lag)
    out = np.empty_like(states)
    run = compiler.lagged(observer.smooth, observer.State)
    run(np.ascontiguousarray(states), np.ascontiguousarray(dt, float), lag, gains, out)
    return out


def described(observer: Observer, states: Array, gains: Any) -> Array:
    """Motions (n, 8) of states (n, n_states); NaN where a state is."""
    out = np.full((len(states), len(Motion._fields)), np.nan)
    known = np.flatnonzero(np.isfinite(states).all(axis=1))
    stream(observer).motion_all(np.ascontiguousarray(states), gains, known, out)
    return out


def spreads(observer: Any, states: Array, gains: Any, rows: npt.NDArray[np.int64] | None = None) -> Array:
    """Covariances (n, 10) of states (n, n_states) as `Spread`; NaN where a state is, or there is none.

    rows: only these; None: all.
    """
    from outrider import compiler

    out = np.full((len(states), len(Spread._fields)), np.nan)
    if hasattr(observer, "spread"):
        known = np.flatnonzero(np.isfinite(states).all(axis=1)) if rows is None else rows
        compiler.each(observer.spread, observer.State)(np.ascontiguousarray(states), gains, known, out)
    return out
