"""How far a gain of the high-gain observer is proven: the largest yaw rate over speed and acceleration.

In the frame of the velocity its error dynamics depends on the course rate k and on r = acceleration / speed
only (`family.companion`). So the largest proven |k| is a function of r, and a map over speeds V and
accelerations A is a lookup at r = |A| / V. The hull of the corners of a box |k| <= K, |r| <= R holds that of
every smaller box: the largest K never grows with R, and a certificate serves all smaller boxes. Every value
is a multiple of a step, has its certificate, checked without the solver, and is less than a step too low.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider import family
from outrider.certificate import Certificate
from outrider.claim import Claim
from outrider.design.prove import accept, prove
from outrider.errors import InputError, NotCertified
from outrider.family import Family
from outrider.observers import high_gain

Array = npt.NDArray[np.float64]
Gain = Sequence[float]  # (3,) of each axis [1/s, 1/s2, 1/s3]
Hull = Literal["tight", "box"]

STEP = 0.02  # between yaw rates that are tried [rad/s]
COUNT = 48  # ratios in a table, besides those of the points asked for
QUOTED = ((2.0, 1.0), (5.0, 3.0), (1.0, 1.0), (2.0, 3.0))  # speeds [m/s], accelerations [m/s2] spoken of
MOST = 64.0  # yaw rate beyond which nothing is tried [rad/s]
WIDEST = 100.0  # ratio beyond which nothing is tried [1/s]
UNLIMITED = "The observer's limits on course rate, speed and acceleration are not reached."


class Reach(NamedTuple):
    """What is proven at one ratio: a yaw rate with its certificate, or nothing and why."""

    yaw_rate: float  # [rad/s]; 0: straight motion only; NaN: nothing
    certificate: Certificate | None  # None where nothing is proven
    refusal: str  # why the next yaw rate is not proven; names the eigenvalue where no proof can exist


@dataclass(frozen=True, slots=True)
class Edge:
    """How far one gain is proven, over the ratio r = |acceleration| / speed."""

    gain: Array  # (3,) [1/s, 1/s2, 1/s3]
    rate: float  # decay that is proven [1/s]
    limit: float  # ratio from which no proof can exist, for straight motion is unstable [1/s]; inf: none
    ratio: Array  # (n,) ascending from 0 [1/s]
    yaw_rate: Array  # (n,) largest proven, falling [rad/s]; NaN: nothing is proven
    frozen: Array  # (n,) from which no proof can exist, for a state is unstable [rad/s]; inf: none found
    certificates: tuple[Certificate | None, ...] = field(repr=False)  # (n,)

    def at(self, speed: Any, acceleration: Any) -> Array:
        """Largest proven yaw rate [rad/s] faster than `speed` [m/s] within |acceleration| [m/s2]; NaN: none.

        That of the next ratio in the table, so never more than what a certificate says. Arrays broadcast.
        """
        return np.append(self.yaw_rate, np.nan)[self._row(speed, acceleration)]

    def certificate(self, speed: float, acceleration: float) -> Certificate:
        """The certificate behind `at`; NotCertified, with the reason, where nothing is proven.

        The reason is an eigenvalue wherever no proof can exist. InputError for standstill.
        """
        row, r = int(self._row(speed, acceleration)), float(_ratio(speed, acceleration))
        found = self.certificates[row] if row < len(self.ratio) else None
        if found is not None:
            return found
        if not np.isfinite(r):
            raise InputError(f"speed from {speed:g} m/s; want more than 0: no proof reaches standstill")
        why = _Search(self.gain.tolist(), self.rate, STEP).refusal(r, 0) or "too close to this table's limit"
        raise NotCertified(f"{why}; asked: speed from {speed:g} m/s, acceleration to {acceleration:g} m/s2")

    def _row(self, speed: Any, acceleration: Any) -> npt.NDArray[np.intp]:
        return np.asarray(np.searchsorted(self.ratio, _ratio(speed, acceleration) * (1.0 - 1e-12)))


@dataclass(frozen=True, slots=True)
class Map:
    """Largest proven yaw rates over speed and acceleration, of some gains."""

    rate: float  # decay that is proven [1/s]
    speeds: Array  # (n,) slowest of the region [m/s]
    accelerations: Array  # (m,) largest of the region, along the course, both signs [m/s2]
    edges: Mapping[str, Edge]  # by the gain's name
    yaw_rates: Mapping[str, Array]  # (m, n) each [rad/s]; NaN: nothing is proven


def shipped() -> dict[str, Gain]:
    """The paper's gain, eq. 92, and the one that was designed here.

    As gains: what an observer does with them beyond its limit `c_max` on the course rate is not proven.
    """
    return {
        name: (c.L1, c.L2, c.L3)
        for name, c in (("published", high_gain.PUBLISHED), ("ours", high_gain.DESIGNED))
    }


def map(
    gains: Mapping[str, Gain],
    speeds: Sequence[float] | Array,
    accelerations: Sequence[float] | Array,
    rate: float = 0.0,
    step: float = STEP,
    count: int = COUNT,
    points: Sequence[tuple[float, float]] = QUOTED,
) -> Map:
    """Where each gain is proven at a decay `rate` [1/s]; speeds (n,) [m/s], accelerations (m,) [m/s2].

    InputError for speeds or accelerations that do not rise from 0 or more, no gain, or one that is not three
    finite numbers. A gain for which nothing is proven has NaN everywhere; its edge's `certificate` says why.
    points: pairs (speed, acceleration) whose own ratio is in the table: their figure is exact to `step`.
    """
    v, a = (np.asarray(x, float) for x in (speeds, accelerations))
    for name, axis in (("speeds", v), ("accelerations", a)):
        if not (axis.ndim == 1 and len(axis) > 1 and np.isfinite(axis).all()):
            raise InputError(f"{name} of the map are {axis}; want two or more finite ones")
        if not (axis[0] >= 0.0 and (np.diff(axis) > 0.0).all()):
            raise InputError(f"{name} of the map from {axis[0]:g}; want 0 or more, each above the one before")
    if not gains:
        raise InputError("a map of no gain; want one or more")
    also = [abs(a) / v for v, a in points if v > 0.0]
    edges = {name: trace(gain, rate, step, count, also) for name, gain in gains.items()}
    return Map(rate, v, a, edges, {name: edge.at(v, a[:, None]) for name, edge in edges.items()})


def trace(
    gain: Gain, rate: float = 0.0, step: float = STEP, count: int = COUNT, also: Sequence[float] = ()
) -> Edge:
    """Largest proven yaw rate at `count` ratios, closer together near the limit, and at those of `also`."""
    search, limit = _Search(gain, rate, step), frozen_limit(gain, rate)
    ratio = np.zeros(1)
    if limit > 0.0:
        ratio = min(limit, WIDEST) * (1.0 - (1.0 - np.arange(count) / count) ** 2)
        ratio = np.union1d(ratio, [r for r in also if 0.0 <= r < ratio[-1]])
    frozen = [search.unstable(r) for r in ratio]
    found = search.everywhere(ratio, frozen[0])
    return Edge(
        np.array(search.gain),
        rate,
        limit,
        ratio,
        np.array([search.yaw_rate(row.steps) for row in found]),
        np.array([step * steps if step * steps <= MOST else np.inf for steps in frozen]),
        tuple(row.certificate for row in found),
    )


def reach(gain: Gain, ratio: float, rate: float = 0.0, step: float = STEP, hull: Hull = "tight") -> Reach:
    """What is proven within |acceleration| <= `ratio` [1/s] times speed, at a decay `rate` [1/s].

    hull: the 16 corners of `family.companion`, or the 32 of `family.high_gain_box`, which prove less.
    InputError for a ratio, rate or step that is none, or a gain that is not three finite numbers.
    """
    search = _Search(gain, rate, step, hull)
    if not 0.0 <= ratio < np.inf:
        raise InputError(f"acceleration / speed {ratio:g} 1/s; want 0 or more: no proof reaches standstill")
    found = search.highest(ratio, NOTHING, search.unstable(ratio))
    return Reach(search.yaw_rate(found.steps), found.certificate, search.refusal(ratio, found.steps + 1))


def largest_yaw_rate(
    gain: Gain, ratio: float, rate: float = 0.0, step: float = STEP, hull: Hull = "tight"
) -> float:
    """Yaw rate of `reach` [rad/s], a multiple of `step`; 0: straight motion only; NaN: nothing is proven."""
    return reach(gain, ratio, rate, step, hull).yaw_rate


def frozen_limit(gain: Gain, rate: float = 0.0) -> float:
    """Acceleration / speed [1/s] from which straight motion decays slower than `rate` [1/s]: no proof exists.

    0 where it does so at constant speed, inf where it does not up to 100 1/s. At rate 0 it is the least
    positive root of L3 - 3 L2 r + 3 L1 r^2, if the gain is stable and the other conditions of Routh hold.
    """

    def decays(ratio: float) -> bool:
        return _growth(gain, ratio, 0.0) < -rate

    low = 0.0
    for high in np.geomspace(0.01, WIDEST, 80):
        if not decays(high):
            break
        low = float(high)
    else:
        return np.inf
    if not decays(0.0):
        return 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if decays(middle) else (low, middle)
    return float(high)


def _ratio(speed: Any, acceleration: Any) -> Array:
    """|acceleration| / speed [1/s]; inf at standstill, where the model is singular."""
    v, a = np.broadcast_arrays(np.asarray(speed, float), np.abs(np.asarray(acceleration, float)))
    ratio: Array = np.divide(a, v, out=np.full(v.shape, np.inf), where=v > 0.0)
    return ratio


def _growth(gain: Gain, ratio: float, yaw_rate: float) -> float:
    """Largest real part of an eigenvalue at states of the box itself [1/s]."""
    frozen = family.frozen_high_gain(gain, 1.0, ratio, yaw_rate)
    return float(np.linalg.eigvals(frozen.matrices).real.max())


class _Found(NamedTuple):
    """Yaw rate in steps, and its proof; -1 steps: nothing."""

    steps: int
    certificate: Certificate | None


NOTHING = _Found(-1, None)


class _Search:
    """Proofs for one gain at one decay rate; yaw rates are counted in steps."""

    def __init__(self, gain: Gain, rate: float, step: float, hull: Hull = "tight") -> None:
        if not (rate >= 0.0 and np.isfinite(rate) and 0.0 < step < np.inf):
            raise InputError(f"rate {rate:g}, step {step:g}; want a rate of 0 or more and a step above 0")
        self.gain, self.rate, self.step, self.hull = [float(g) for g in gain], rate, step, hull
        family.high_gain(self.gain, 1.0, 0.0, 0.0)  # its message for a gain that is none
        self.gains = high_gain.Gains(*self.gain)

    def claim(self, ratio: float, steps: int) -> Claim:
        """What would have to be proven."""
        K = self.step * steps
        made: Claim = high_gain.claim(self.gains, "continuous", speed=1.0, acceleration=ratio, yaw_rate=K)
        return replace(
            made,
            family=made.family if self.hull == "tight" else family.high_gain_box(self.gain, 1.0, ratio, K),
            region={"acceleration / speed [1/s]": (-ratio, ratio), "course rate [rad/s]": (-K, K)},
            assumptions=(*made.assumptions, UNLIMITED),
            sought=(),
        )

    def proof(self, ratio: float, steps: int) -> Certificate:
        """Certificate, or NotCertified; mirrored, corners turn left instead of right: half is searched."""
        whole = self.claim(ratio, steps)
        matrices, corners = whole.family
        half = len(corners) // 2
        left = Family(matrices[:half], corners[:half])
        found, _, solved = prove(replace(whole, family=left), self.rate)
        return accept(whole.certificate(found.P, self.rate), solved)

    def highest(self, ratio: float, low: _Found, high: int) -> _Found:
        """The last proof between what is proven and what is not, by halving."""
        while high - low.steps > 1:
            middle = (low.steps + high) // 2
            try:
                low = _Found(middle, self.proof(ratio, middle))
            except NotCertified:
                high = middle
        return low

    def everywhere(self, ratio: Array, high: int) -> list[_Found]:
        """`highest` at rising ratios (n,), `high` being too much; between two it lies between theirs."""
        last = len(ratio) - 1
        found = {0: self.highest(ratio[0], NOTHING, high)}
        found[last] = found[0] if last == 0 else self.highest(ratio[last], NOTHING, found[0].steps + 1)
        spans = [(0, last)]
        while spans:
            i, j = spans.pop()
            if j - i > 1:
                m = (i + j) // 2
                found[m] = self.highest(ratio[m], found[j], found[i].steps + 1)
                spans += [(i, m), (m, j)]
        return [found[i] for i in range(len(ratio))]

    def unstable(self, ratio: float) -> int:
        """Steps at which a state alone decays too slowly, so no proof exists; beyond MOST: none found."""
        low, high = -1, int(MOST / self.step) + 1
        while high - low > 1:
            middle = (low + high) // 2
            decays = _growth(self.gain, ratio, self.step * middle) < -self.rate
            low, high = (middle, high) if decays else (low, middle)
        return high

    def refusal(self, ratio: float, steps: int) -> str:
        """Why a yaw rate is not proven; the eigenvalue where a state alone is unstable."""
        try:
            self.proof(ratio, steps)
        except NotCertified as refused:
            return str(refused)
        return ""

    def yaw_rate(self, steps: int) -> float:
        """[rad/s]; NaN for none."""
        return round(self.step * steps, 9) if steps >= 0 else np.nan
