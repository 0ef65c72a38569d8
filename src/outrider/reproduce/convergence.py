"""The extended Kalman filter beside the high-gain observer from starts far off, [HG] IV.B and Fig. 4.

The paper does not print the filter's covariances. Three are shown: two that believe the wrong start, one of
them with little trust in the sensor too, and one that knows how far it may be off.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.models import bicycle
from outrider.reproduce import plant, published
from outrider.reproduce.plant import Drive, Truth
from outrider.reproduce.published import HIGH_GAIN, L_R, MULTI_STAGE, Estimate, Seen
from outrider.reproduce.section import Claim, Picture, Section, Table, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

STEP, DURATION, DRAWN = 4e-3, 6.0, 3.0  # of the runs, of which are drawn [s]
DRIVES = {  # the caption of [HG] Fig. 4, and the acceleration of the tables (E13)
    "A = 10 m/s2": Drive(10.0, 10.0, steering=10.0),
    "A = -1 m/s2": Drive(10.0, -1.0, steering=10.0),
}
HEADINGS = tuple(range(-165, 181, 15))  # errors of the yaw at the beginning [deg]
SPEEDS = (2.0, 5.0, 15.0, 20.0)  # guessed, truth 10 [m/s]
SHOWN = (120, 2.0)  # the start of the picture
NEAR = 1.0  # a velocity within this of the truth has arrived [m/s]
MUCH = 2.0  # so many times as fast is significantly better [-]
PROCESS = (
    0.0,
    0.0,
    0.0,
    3.0,
    0.0,
    0.2,
)  # noise on X Y V A psi beta: jerk, slip rate [unit of the rate / sqrt(Hz)]


class Belief(NamedTuple):
    """Standard deviations of X Y V A psi beta at the beginning [m, m, m/s, m/s2, rad, rad]."""

    name: str
    start: tuple[float, ...]
    sensor: float  # of a measured coordinate [m]


SURE = (0.1, 0.1, 0.5, 0.5, 0.1, 0.05)
SLUGGISH = Belief("EKF, sure of its start, sensor 1 m", SURE, 1.0)
CONFIDENT = Belief("EKF, sure of its start, sensor 2 cm", SURE, 0.02)  # [HG] Table II
HONEST = Belief("EKF, unsure of its start, sensor 2 cm", (0.1, 0.1, 10.0, 10.0, 2.0, 0.2), 0.02)


def ekf(belief: Belief, x0: Array, y0: Array, V: Array, psi: Array, seen: Seen, dt: float) -> Estimate:
    """Extended Kalman filter of [HG 29] over positions (T, N), dt [s] apart, N runs at once."""
    o = np.zeros_like(V)
    s = bicycle.State(x0, y0, V, o, psi, o)
    P = np.tile(np.diag(np.square(belief.start)), (len(V), 1, 1))
    Q, R, H = np.diag(np.square(PROCESS)) * dt, belief.sensor**2 * np.eye(2), np.eye(2, 6)
    history = [s]
    for x, y in zip(seen.x[1:], seen.y[1:], strict=True):
        F = transition(s, dt)
        s = bicycle.arc(s, dt)
        P = F @ P @ np.swapaxes(F, 1, 2) + Q
        K = np.swapaxes(np.linalg.solve(P[:, :2, :2] + R, P[:, :2, :]), 1, 2)
        P = P - K @ H @ P
        P = 0.5 * (P + np.swapaxes(P, 1, 2))
        move = (K @ np.stack([x - s.X, y - s.Y], axis=-1)[..., None])[..., 0]
        s = bicycle.State(*(v + move[:, i] for i, v in enumerate(s)))
        history.append(s)
    S = bicycle.State(*np.moveaxis(np.array(history), 0, 1))
    chi = S.psi + S.beta
    return Estimate(S.X, S.Y, S.V * np.cos(chi), S.V * np.sin(chi), S.psi, np.zeros(len(V), bool))


def transition(s: bicycle.State, dt: float) -> Array:
    """Jacobian (N, 6, 6) of the motion over dt, to first order."""
    F = np.tile(np.eye(6), (len(s.V), 1, 1))
    c, d = np.cos(s.psi + s.beta), np.sin(s.psi + s.beta)
    for k in (4, 5):
        F[:, 0, k], F[:, 1, k] = -dt * s.V * d, dt * s.V * c
    F[:, 0, 2], F[:, 1, 2], F[:, 2, 3] = dt * c, dt * d, dt
    F[:, 4, 2], F[:, 4, 5] = dt * np.sin(s.beta) / L_R, dt * s.V * np.cos(s.beta) / L_R
    return F


# ------------------------------------------------------------------ the runs


class Runs(NamedTuple):
    """Every way to estimate, by name, over all starts of one drive."""

    truth: Truth
    estimates: dict[str, Estimate]

    def errors(self, name: str) -> Array:
        """Error (T, N) of the velocity [m/s]; inf from where a run is lost."""
        chi, e = self.truth.psi + self.truth.beta, self.estimates[name]
        V = self.truth.V
        error = np.hypot(e.V_x - V * np.cos(chi), e.V_y - V * np.sin(chi))
        return np.where(e.lost, np.inf, error)

    def arrivals(self, name: str) -> Array:
        """Time (N,) from which on the velocity is within NEAR of the truth [s]; inf: never."""
        outside = self.errors(name) >= NEAR
        last = len(outside) - 1 - np.argmax(outside[::-1], axis=0)
        t = np.append(self.truth.t, np.inf)[np.where(outside.any(axis=0), last + 1, 0)]
        return np.where(t > self.truth.t[-1], np.inf, t)


@cache
def run(drive: str, starts: Sequence[tuple[float, float]]) -> Runs:
    """From starts (error of the yaw [deg], guessed speed [m/s]), positions right."""
    truth = plant.drive(Drive(*(np.repeat(v, len(starts)) for v in DRIVES[drive])), DURATION, STEP)
    seen = plant.measured(truth.x, truth.y)
    psi, V = np.radians([s[0] for s in starts]), np.array([s[1] for s in starts])
    o = np.zeros(len(starts))
    made = {}
    for p in (HIGH_GAIN, MULTI_STAGE):
        made[p.name] = published.simulate(p, p.start(o, o, V, psi), seen, STEP)
    for belief in (SLUGGISH, CONFIDENT, HONEST):
        made[belief.name] = ekf(belief, o, o, V, psi, seen, STEP)
    return Runs(truth, made)


# ------------------------------------------------------------------ the section


def section(headings: Sequence[int] = HEADINGS) -> Section:
    """How many far starts each one recovers from, and how fast."""
    starts = tuple(product(headings, SPEEDS))
    runs = {drive: run(drive, starts) for drive in DRIVES}
    text = f"""
Steering 10 deg, {DURATION:g} s, no noise, {1 / STEP:g} positions a second. The yaw is off by {headings[0]} to
{headings[-1]} deg in steps of {headings[1] - headings[0]}, the speed is guessed as
{", ".join(f"{v:g}" for v in SPEEDS)} m/s while it is 10: {len(starts)} starts. *Arrived*: the velocity is and
stays within {NEAR:g} m/s of the truth.

The filter's model is [HG 29] with white noise of {PROCESS[3]:g} m/s3 on the jerk and {PROCESS[5]:g} rad/s
on the slip rate. Deviations at its start (position, speed, acceleration, yaw, slip): {_listed(CONFIDENT)}
where it is sure, {_listed(HONEST)} where it is not. The paper prints none of these.
"""
    picture = Picture(
        "far-start",
        f"From a yaw {SHOWN[0]} deg off and a speed guessed as {SHOWN[1]:g} m/s, true 10: [HG] Fig. 4.",
        partial(_draw, starts),
    )
    claims = tuple(_claims(runs))
    return Section("convergence", "Far starts: EKF and observers", text, (_table(runs),), (picture,), claims)


def _listed(belief: Belief) -> str:
    return ", ".join(f"{v:g}" for v in belief.start[1:])


def _table(runs: dict[str, Runs]) -> Table:
    names = list(next(iter(runs.values())).estimates)
    head = ("estimator", *(f"{drive}: arrived [%], median time [s]" for drive in runs))
    cells = ((name, *(_cell(r.arrivals(name)) for r in runs.values())) for name in names)
    return Table("Starts recovered from", head, tuple(cells))


def _cell(times: Array) -> str:
    middle = float(np.median(times))
    return f"{100 * np.isfinite(times).mean():.0f}, " + (f"{middle:.2f}" if np.isfinite(middle) else "-")


def _claims(runs: dict[str, Runs]) -> Iterator[Claim]:
    share, time = partial(_share, runs), partial(_time, runs)
    plain, multi = HIGH_GAIN.name, MULTI_STAGE.name
    filters = [belief.name for belief in (SLUGGISH, CONFIDENT, HONEST)]
    better = [time(e) > MUCH * time(plain) and share(e) <= share(plain) for e in filters]
    told = ", ".join(
        f"{name}: {100 * share(name):.0f} % in {_seconds(time(name))}" for name in (plain, *filters)
    )
    yield Claim(
        "[HG] IV.B, Fig. 4",
        "From a wrong start the high-gain observer converges significantly better than the EKF.",
        verdict(all(better), any(better)),
        f"arrived, and median time: {told}",
    )
    lost = [int(r.estimates[plain].lost.sum()) for r in runs.values()]
    n = sum(len(r.estimates[plain].lost) for r in runs.values())
    yield Claim(
        "[HG] I.A, I.B",
        "The high-gain observer converges from any start.",
        verdict(share(plain) == 1.0, share(plain) > 0.5),
        f"{n - sum(lost)} of {n} far starts stay finite as printed, {100 * share(plain):.0f} % arrive",
    )
    yield Claim(
        "[MS] V.B",
        "The multi-stage estimates always come near the true state when the model holds.",
        verdict(share(multi) == 1.0, share(multi) > 0.5),
        f"{100 * share(multi):.0f} % of the far starts arrive within {DURATION:g} s",
    )
    shares = [share(name) for name in filters]
    yield Claim(
        "[MS] V.B, [HG] I.A",
        "The EKF need not come near the truth, even with well chosen covariances.",
        verdict(max(shares) < 1.0, min(shares) < 1.0),
        f"far starts that arrive within {DURATION:g} s, in the order above: "
        + ", ".join(f"{100 * s:.0f} %" for s in shares),
    )


def _share(runs: dict[str, Runs], name: str) -> float:
    """Of the starts, over all drives, from which it arrives."""
    return float(np.mean([np.isfinite(r.arrivals(name)).mean() for r in runs.values()]))


def _time(runs: dict[str, Runs], name: str) -> float:
    """Median time until it arrives [s]."""
    return float(np.median(np.concatenate([r.arrivals(name) for r in runs.values()])))


def _seconds(t: float) -> str:
    return f"{t:.2f} s" if np.isfinite(t) else "no time"


def _draw(starts: Sequence[tuple[float, float]]) -> Figure:
    from outrider.reproduce import draw

    figure, axes = draw.panels(2, 2, height=5.6)
    for row, drive in zip((axes[:2], axes[2:]), DRIVES, strict=True):
        runs, at = run(drive, starts), starts.index(SHOWN)
        t, chi = runs.truth.t, (runs.truth.psi + runs.truth.beta)[:, at]
        V, until = runs.truth.V[:, at], runs.truth.t <= DRAWN
        for i, (name, e) in enumerate(runs.estimates.items()):
            look: dict[str, Any] = {"color": draw.LINES[(1, 0, 5, 3, 2)[i]], "lw": 1.4, "label": name}
            for ax, v in zip(row, (e.V_x, e.V_y), strict=True):
                ax.plot(t, v[:, at], **look)
        for ax, v, label in zip(row, (V * np.cos(chi), V * np.sin(chi)), ("x", "y"), strict=True):
            ax.plot(t, v, label="truth", zorder=5, **draw.TRUTH)
            room = 0.5 * float(np.ptp(v[until])) + 2.0
            ax.set(xlabel="time [s]", ylabel=f"{drive}: $V_{label}$ [m/s]", xlim=(0.0, DRAWN))
            ax.set_ylim(float(v[until].min()) - room, float(v[until].max()) + room)
    draw.legend(figure, axes[0], 3)
    return figure
