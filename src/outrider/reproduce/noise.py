"""What noise and hops of the reflecting point do to the published observers, for each printed theta.

[HG] III.B and Figs. 9, 10 say that the smallest theta is the smoothest; [MS] V.B that the multi-stage
observer is smoother still. Simulated sensor, known truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.reproduce import plant, published
from outrider.reproduce.behaviour import between
from outrider.reproduce.plant import Drive, Truth
from outrider.reproduce.published import HIGH_GAIN, LIMITED, MULTI_STAGE, Estimate, Published, Seen
from outrider.reproduce.section import Claim, Picture, Section, Table, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

K = (67.20 / 6.7205, 823.1 / 6.7205**2, 2818.5 / 6.7205**3)  # of the printed L, [HG 92, 66]
THETAS = (6.72, 8.6, 8.7)  # [HG] III.B
SCAN, FINE = 0.1, 25  # time between two samples [s], integration steps in it
SIGMA = 0.02  # of a measured coordinate, [HG] Table II [m]
HOP, HOPPED = (
    0.4,
    0.08,
)  # largest offset of the reflecting point along the body [m], chance of a new one a scan
SKIPPED = 1.0  # at the beginning [s]
DURATION = 6.0  # [s]
SEEDS = 20
DRIVES = {
    "straight": Drive(10.0, 0.5),
    "left turn": Drive(6.0, 0.0, steering_rate=4.0),
}
KINDS = tuple(product(DRIVES, (False, True)))  # with hops or without
COARSE = (0.02, 0.05, 0.10)  # noise with which a slow car is seen [m]
SLOW = (0.5, 1.0, 2.0)  # its speed [m/s]
EACH = 10  # runs of each
LITTLE = 0.05  # speed that counts as none [m/s]


class Way(NamedTuple):
    """One observer, and how the samples are joined in between."""

    name: str
    observer: Published
    held: bool  # the last sample holds, or else a line from sample to sample


def _theta(value: float) -> Published:
    L = tuple(k * value**power for power, k in enumerate(K, 1))
    return HIGH_GAIN._replace(gains=LIMITED._replace(L=L))


WAYS = (
    *(Way(f"high-gain, theta = {value:g}", _theta(value), False) for value in THETAS),
    Way("multi-stage", MULTI_STAGE, False),
    Way(f"high-gain, theta = {THETAS[0]:g}, samples held", _theta(THETAS[0]), True),
)


class Figures(NamedTuple):
    """Median over the seeds, each axis [m/s]."""

    rmse: float  # of the velocity
    step: float  # RMS of its error's change from one sample to the next


Every = dict[str, dict[tuple[str, bool], Figures]]  # by observer, drive and hops


class Run(NamedTuple):
    """All drives, without and with hops, all seeds: truth and estimates at the samples, (T, N)."""

    truth: Truth
    estimate: Estimate

    def figures(self) -> dict[tuple[str, bool], Figures]:
        """By drive and hops, after SKIPPED; inf where most seeds are lost."""
        chi, first = self.truth.psi + self.truth.beta, round(SKIPPED / SCAN)
        V, e = self.truth.V, self.estimate
        error = np.array([e.V_x - V * np.cos(chi), e.V_y - V * np.sin(chi)])[:, first:]
        rmse = np.sqrt((error**2).mean(axis=(0, 1)))
        step = np.sqrt((np.diff(error, axis=1) ** 2).mean(axis=(0, 1)))
        medians = [
            np.median(np.where(e.lost, np.inf, v).reshape(len(KINDS), -1), axis=1) for v in (rmse, step)
        ]
        return {kind: Figures(float(r), float(s)) for kind, r, s in zip(KINDS, *medians, strict=True)}


@cache
def run(way: Way, seeds: int = SEEDS) -> Run:
    """One observer, started at the truth; the seed of the noise is the number of the run."""
    drives = [DRIVES[drive] for drive, _ in KINDS for _ in range(seeds)]
    truth = plant.drive(Drive(*np.array(drives, float).T), DURATION, SCAN / FINE)
    at = Truth(*(v[::FINE] for v in truth))
    noise = np.stack([_noise(seed, len(at.t), hops) for _, hops in KINDS for seed in range(seeds)], axis=-1)
    x = at.x + noise[0] + noise[2] * np.cos(at.psi)
    y = at.y + noise[1] + noise[2] * np.sin(at.psi)
    start = way.observer.start(at.x[0], at.y[0], at.V[0], at.psi[0] + at.beta[0])
    e = published.simulate(way.observer, start, _joined(x, y, way.held), SCAN / FINE)
    return Run(at, e.at(slice(None, None, FINE)))


def _joined(x: Array, y: Array, held: bool) -> Seen:
    seen = plant.measured(x, y)
    if held:
        return Seen(*(np.repeat(v, FINE, axis=0)[: 1 - FINE] for v in seen))
    return between(seen, FINE)


def _noise(seed: int, n: int, hops: bool) -> Array:
    """Errors (3, n) of a sample: x, y, and along the body [m]."""
    draw = np.random.default_rng(seed)
    white = SIGMA * draw.standard_normal((2, n))
    new, where = draw.random(n) < HOPPED, draw.uniform(-HOP, HOP, n)
    held = np.maximum.accumulate(np.where(new, np.arange(n), -1))
    offset = np.where(held >= 0, where[np.maximum(held, 0)], 0.0)
    return np.concatenate([white, [offset if hops else 0.0 * offset]])


def parked() -> Array:
    """Speed [m/s] that the multi-stage observer gives a standing car, for each noise of COARSE."""
    e = _slow(MULTI_STAGE, (0.0,))
    speed: Array = np.hypot(e.V_x, e.V_y)[50 * FINE :].mean(axis=0).reshape(len(COARSE), -1).mean(axis=1)
    return speed


def lost() -> npt.NDArray[np.int64]:
    """Runs, of EACH, that the high-gain observer as printed does not survive; (SLOW, COARSE)."""
    e = _slow(HIGH_GAIN, SLOW)
    gone: npt.NDArray[np.int64] = e.lost.reshape(len(SLOW), len(COARSE), EACH).sum(axis=-1)
    return gone


def _slow(observer: Published, speeds: Sequence[float]) -> Estimate:
    """100 samples of slow straight motion, all noises of COARSE, EACH times each."""
    sigma = np.tile(np.repeat(COARSE, EACH), len(speeds))
    V, o = np.repeat(speeds, len(COARSE) * EACH), np.zeros(len(sigma))
    x, y = sigma * np.random.default_rng(0).standard_normal((2, 101, len(sigma)))
    x = x + V * SCAN * np.arange(101)[:, None]
    start = observer.start(o, o, V, o)
    return published.simulate(observer, start, between(plant.measured(x, y), FINE), SCAN / FINE)


# ------------------------------------------------------------------ the section


def section(seeds: int = SEEDS) -> Section:
    """Velocity errors and smoothness of each observer under noise, with hops and without."""
    every = {w.name: run(w, seeds).figures() for w in WAYS}
    text = f"""
{1 / SCAN:g} samples a second, {SIGMA * 100:g} cm of noise on each coordinate; with hops the reflecting point
sits up to {HOP:g} m along the body and jumps with {100 * HOPPED:g} % a scan. Seeds 0 to {seeds - 1}, medians,
per axis, the first {SKIPPED:g} s not counted. Straight: 10 m/s, 0.5 m/s2. Left turn: 6 m/s, steering 4 deg/s.
K for each theta is that of the printed L. The continuous equations run along straight lines between the last
two samples, except in the last row; the high-gain observer's course rate is limited to
{LIMITED.c_max:g} rad/s and the speed in its divisor to at least {LIMITED.floor:g} m/s.

*RMSE*: of the velocity. *Step*: RMS of the change of its error from one sample to the next, which is what a
reader calls rough.
"""
    picture = Picture(
        "theta",
        "Velocity along x for two values of theta (8.6 lies under 8.7) and the multi-stage observer, seed 0, "
        "with hops. [HG] Figs. 9 and 10.",
        lambda: _draw(seeds),
    )
    claims = (*_claims(every), *_bounded())
    return Section("noise", "Noise, hops and theta", text, (_table(every),), (picture,), claims)


def _table(every: Every) -> Table:
    head = ("observer", *(f"{d}, {'hops' if h else 'no hops'}" for d, h in KINDS))
    cells = ((w.name, *(_cell(every[w.name][d, h]) for d, h in KINDS)) for w in WAYS)
    return Table("Velocity RMSE / step [m/s]", head, tuple(cells))


def _cell(f: Figures) -> str:
    return f"{f.rmse:.2f} / {f.step:.2f}" if np.isfinite(f.rmse) else "lost"


def _claims(every: Every) -> Iterator[Claim]:
    low, middle, high, multi = (w.name for w in WAYS[:4])
    ordered = [every[low][k].step <= every[middle][k].step <= every[high][k].step for k in KINDS]
    steps = [f"{every[low][k].step:.2f} to {every[high][k].step:.2f}" for k in KINDS]
    yield Claim(
        "[HG] III.B, IV.C, Figs. 9, 10",
        "The smallest theta gives the smoothest estimates, a larger one much more noise.",
        verdict(all(ordered), any(ordered)),
        f"step from theta {THETAS[0]:g} to {THETAS[-1]:g}: " + ", ".join(steps) + " m/s",
    )
    for hops, source in ((True, "[MS] V.B"), (False, "[MS] V.A, VI")):
        of = [(every[multi][d, hops], every[low][d, hops]) for d in DRIVES]
        smoother, nearer = [m.step < h.step for m, h in of], [m.rmse < h.rmse for m, h in of]
        what = "With hops of the reflecting point" if hops else "With plain sensor noise"
        yield Claim(
            source,
            f"{what}, the multi-stage observer is smoother and more reliable than the high-gain observer.",
            verdict(all(smoother) and all(nearer), any(smoother) or any(nearer)),
            ", ".join(
                f"{d}: step {m.step:.2f} against {h.step:.2f}, RMSE {m.rmse:.2f} against {h.rmse:.2f} m/s"
                for d, (m, h) in zip(DRIVES, of, strict=True)
            ),
        )


def _bounded() -> Iterator[Claim]:
    speeds = parked().tolist()
    seen = ", ".join(f"{100 * s:g}" for s in COARSE) + " cm of noise"
    yield Claim(
        "[MS 11, 24]",
        "The error of the measured way is bounded, so the speed's is too.",
        verdict(max(speeds) < LITTLE, min(speeds) < LITTLE),
        f"a standing car drives at {', '.join(f'{v:.2f}' for v in speeds)} m/s when seen with {seen}: the "
        "lengths of steps add up and never cancel",
    )
    gone = lost()
    yield Claim(
        "[HG] I.A, II.C",
        "The high-gain observer is stable wherever the vehicle moves; only what stands must be left out.",
        verdict(not gone.any(), bool((gone < EACH).any())),
        f"as printed, of {EACH} runs with {seen} leave all bounds: "
        + "; ".join(
            f"{', '.join(map(str, row))} at {V:g} m/s" for V, row in zip(SLOW, gone.tolist(), strict=True)
        ),
    )


def _draw(seeds: int) -> Figure:
    from outrider.reproduce import draw

    figure, axes = draw.panels(2, 1, height=6.5)
    for ax, name in zip(axes, DRIVES, strict=True):
        at = KINDS.index((name, True)) * seeds
        for i, way in enumerate((WAYS[2], WAYS[0], WAYS[3])):
            truth, e = run(way, seeds)
            ax.plot(truth.t, e.V_x[:, at], color=draw.LINES[(3, 1, 0)[i]], lw=1.4, label=way.name)
        V_x = truth.V[:, at] * np.cos((truth.psi + truth.beta)[:, at])
        ax.plot(truth.t, V_x, label="truth", zorder=5, **draw.TRUTH)
        ax.set(xlabel="time [s]", ylabel=f"{name}: $V_x$ [m/s]", xlim=(0.0, DURATION))
    draw.legend(figure, axes[0])
    return figure
