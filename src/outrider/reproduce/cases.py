"""The three simulations of the papers: RMSE beside the printed ones, and the states over time.

Neither paper prints an initial error, a duration or a step. Two sets are shown: a plain one, and the one of a
small search whose errors are nearest to the printed ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.reproduce import plant, published
from outrider.reproduce.plant import Drive, Truth
from outrider.reproduce.published import HIGH_GAIN, MULTI_STAGE, NONLINEAR, OBSERVERS, Estimate
from outrider.reproduce.section import Claim, Picture, Section, Table, verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

STEP = 1e-3  # of the simulation and the sensor [s]
SEARCH_STEP = 4e-3  # while searching [s]
HEADINGS = tuple(round(0.2 + 0.02 * i, 2) for i in range(16))  # initial errors of the yaw tried [rad]
DURATIONS = (2.5, 3.0, 4.0, 5.0, 6.0, 8.0)  # tried [s]
SHOWN = 4.0  # in the pictures [s]
GIVEN = 10.0  # speed that the nonlinear observer is given, [MS V.A] [m/s]

NAMES = (
    "1: A = 0, steering rate 0",
    "2: A = 0, steering rate 10 deg/s",
    "3: A = -1 m/s2, steering rate -5 deg/s",
)
READINGS = {  # what is ambiguous in print: the tables' steering rates, the captions' steering angles
    "tables": (Drive(10.0), Drive(10.0, steering_rate=10.0), Drive(15.0, -1.0, steering_rate=-5.0)),
    "captions": (Drive(10.0), Drive(10.0, steering=10.0), Drive(15.0, -1.0, steering=10.0)),
}
# [MS] Table II, [HG] Table I: case, observer as in OBSERVERS, column as in plant.COLUMNS.
PRINTED = np.array(
    [
        [[0.01, 0.07, 0.38, 0.04], [0.00, 0.05, 0.29, 0.04], [0.01, 0.07, 0.38, 0.04]],
        [[0.01, 0.07, 0.40, 0.10], [0.00, 0.06, 0.30, 0.05], [0.01, 0.40, 0.60, 0.07]],
        [[0.27, 4.09, 0.68, 0.25], [0.00, 0.48, 0.55, 0.04], [0.04, 1.64, 0.74, 0.06]],
    ]
)
HALF_DIGIT = 0.005  # of a printed number
GOOD_W, GOOD_PSI = 0.05, 0.08  # what counts as good in the simplest case [m, rad]
NEAR, NEAR_ABS = 1.5, 0.02  # to a printed number: by a factor, or by a difference in its unit


class Start(NamedTuple):
    """What is wrong at the beginning, and for how long errors are counted; positions begin right."""

    heading: float  # error of the yaw [rad]
    given: bool  # speed guessed as GIVEN, or else right
    duration: float  # [s]

    def __str__(self) -> str:
        """In words."""
        speed = f"guessed as {GIVEN:g} m/s" if self.given else "right"
        return f"yaw {self.heading:.2f} rad off, speed {speed}, {self.duration:g} s"


PLAIN = Start(0.36, False, 5.0)


class Runs(NamedTuple):
    """All observers on all columns (start, reading, case); estimates in the order of OBSERVERS."""

    columns: tuple[tuple[Start, str, int], ...]
    truth: Truth
    estimates: tuple[Estimate, ...]  # (T, columns) each
    until: tuple[Array, ...]  # RMSE (T, columns, 4) of each

    def errors(self, start: Start, reading: str = "tables") -> Array:
        """RMSE (case, observer, column of the papers' tables) over the duration of a start."""
        at = round(start.duration / STEP)
        columns = [self.columns.index((start, reading, case)) for case in range(3)]
        return np.moveaxis(np.array([u[at, columns] for u in self.until]), 0, 1)


@cache
def run(*starts: Start) -> Runs:
    """The three cases under both readings, from each start."""
    columns = tuple(product(starts, READINGS, range(3)))
    drives = [READINGS[reading][case] for _, reading, case in columns]
    guess = [GIVEN if s.given else d.V for (s, *_), d in zip(columns, drives, strict=True)]
    headings = [s.heading for s, *_ in columns]
    truth, made = _simulate(drives, guess, headings, max(s.duration for s in starts), STEP, OBSERVERS)
    return Runs(columns, truth, tuple(made), tuple(plant.rmse(truth, e) for e in made))


def _simulate(
    drives: Sequence[Drive],
    speeds: Sequence[float],
    headings: Sequence[float],
    duration: float,
    step: float,
    observers: Sequence[published.Published],
) -> tuple[Truth, list[Estimate]]:
    truth = plant.drive(Drive(*np.array(drives, float).T), duration, step)
    seen, o = plant.measured(truth.x, truth.y), np.zeros(len(drives))
    V, psi = np.array(speeds, float), np.array(headings, float)
    return truth, [published.simulate(p, p.start(o, o, V, psi), seen, step) for p in observers]


@cache
def search(
    headings: Sequence[float] = HEADINGS, durations: Sequence[float] = DURATIONS
) -> tuple[Start, float]:
    """The start whose errors are nearest to the printed ones, and how near: mean |log ratio|.

    Of high-gain and multi-stage observer alone, whose gains are printed; half a digit is added to each.
    """
    drives = READINGS["tables"]
    tried = list(product((False, True), headings, range(3)))
    truth, estimates = _simulate(
        [drives[case] for *_, case in tried],
        [GIVEN if given else drives[case].V for given, _, case in tried],
        [heading for _, heading, _ in tried],
        max(durations),
        SEARCH_STEP,
        OBSERVERS[1:],
    )
    every = np.array([plant.rmse(truth, e) for e in estimates])  # observer, time, run, column
    found: list[tuple[float, Start]] = []
    for duration in durations:
        at = every[:, round(duration / SEARCH_STEP)].reshape(2, 2, len(headings), 3, 4)
        off = np.log((at + HALF_DIGIT) / (np.swapaxes(PRINTED[:, 1:], 0, 1)[:, None, None] + HALF_DIGIT))
        score = np.abs(off).mean(axis=(0, 3, 4))
        for (i, given), (j, heading) in product(enumerate((False, True)), enumerate(headings)):
            found.append((float(score[i, j]), Start(heading, given, duration)))
    score_of, start = min(found)
    return start, score_of


# ------------------------------------------------------------------ the section


def section(matched: Start | None = None) -> Section:
    """Tables II of [MS] and I of [HG], Figs. 4-6 of [MS]; `matched`: instead of a search."""
    start, score = (matched, float("nan")) if matched else search()
    runs = run(PLAIN, start)
    near, captions = runs.errors(start), runs.errors(start, "captions")
    return Section(
        "cases",
        "The three simulations",
        _text(start, score),
        (_against_print(runs.errors(PLAIN), near), _readings(near, captions)),
        tuple(_pictures(start)),
        tuple(_claims(near, captions)),
    )


def _text(start: Start, score: float) -> str:
    near = f" Mean |log| of ours over the printed number: {score:.2f}, a factor of {np.exp(score):.2f}."
    return f"""
No noise; the observers exactly as printed, in continuous time, {1 / STEP:g} measurements a second with
straight lines between them, classical Runge-Kutta. Steering stops at {plant.STEERING_MAX:g} deg, the papers'
own range. RMSE from the first instant on; w is the distance between estimated and true position. The
nonlinear observer's gain is printed nowhere: it runs with ours, from one LMI for {GIVEN:g} m/s, with the slip
in its course, and is given {GIVEN:g} m/s in every case.

The papers print no initial error, duration or step. **Plain**: {PLAIN}. **Matched**: {start}; the best of
{len(HEADINGS)} yaw errors from {HEADINGS[0]:g} to {HEADINGS[-1]:g} rad, {len(DURATIONS)} durations from
{DURATIONS[0]:g} to {DURATIONS[-1]:g} s, and both guesses of the speed, one start for all cases, judged by the
two observers with printed gains.{near * bool(score == score)}

The tables speak of steering *rates* of 10 and -5 deg/s, the text and captions of [HG] of a *constant*
steering angle of 10 deg. Both readings are run; the second table has them side by side.
"""


def _against_print(plain: Array, near: Array) -> Table:
    rows = [
        (
            NAMES[i],
            o.name,
            *(" / ".join(f"{of[i, j, k]:.2f}" for of in (PRINTED, plain, near)) for k in range(4)),
        )
        for i, (j, o) in product(range(3), enumerate(OBSERVERS))
    ]
    return Table("RMSE: paper / plain / matched", ("simulation", "observer", *plant.COLUMNS), tuple(rows))


def _readings(rates: Array, angles: Array) -> Table:
    rows = [
        (NAMES[i][0], o.name, *(f"{rates[i, j, k]:.2f} / {angles[i, j, k]:.2f}" for k in range(4)))
        for i, (j, o) in product((1, 2), enumerate(OBSERVERS))
    ]
    title = "RMSE, matched start: steering rate as in the tables / steering 10 deg as in the captions"
    return Table(title, ("simulation", "observer", *plant.COLUMNS), tuple(rows))


def _pictures(start: Start) -> Iterator[Picture]:
    for i, name in enumerate(NAMES):
        yield Picture(
            f"case-{i + 1}",
            f"Simulation {name}; {start}, of which {SHOWN:g} are shown. [MS] Fig. {i + 4}.",
            partial(_draw, start, i),
        )


def _draw(start: Start, case: int) -> Figure:
    from outrider.reproduce import draw

    runs = run(PLAIN, start)
    figure, axes = draw.panels(2, 2)
    n = int((runs.truth.t <= SHOWN).sum())
    of = runs.columns.index((start, "tables", case))
    x, y, V, psi, beta = (v[:n, of] for v in runs.truth[1:6])
    names = [o.name for o in OBSERVERS]
    every = [e.at((slice(n), of)) for e in runs.estimates]
    for name, e in zip(names, every, strict=True):
        axes[0].plot(e.x, e.y, color=draw.COLOURS[name], lw=1.4)
    axes[0].plot(x, y, zorder=5, **draw.TRUTH)
    axes[0].set(xlabel="x [m]", ylabel="y [m]")
    axes[0].set_aspect("equal", adjustable="datalim")
    panels = (
        ("$V_x$ [m/s]", V * np.cos(psi + beta), [e.V_x for e in every]),
        ("$V_y$ [m/s]", V * np.sin(psi + beta), [e.V_y for e in every]),
        ("yaw [deg]", np.degrees(psi), [np.degrees(_near(e.psi, psi)) for e in every]),
    )
    for ax, (label, truth, values) in zip(axes[1:], panels, strict=True):
        draw.against_time(ax, runs.truth.t[:n], truth, list(zip(names, values, strict=True)), label)
    draw.legend(figure, axes[1])
    return figure


def _near(angle: Array, to: Array) -> Array:
    """The angle's turn that is nearest to another, for a line without jumps."""
    near: Array = to + published.wrap(angle - to)
    return near


# ------------------------------------------------------------------ claims


def _claims(e: Array, captions: Array) -> Iterator[Claim]:
    n, h, m = (OBSERVERS.index(o) for o in (NONLINEAR, HIGH_GAIN, MULTI_STAGE))
    yield _printed_numbers(e)
    w, psi = e[0, :, 0].max(), e[0, :, 3].max()
    yield Claim(
        "[MS] V.A, Fig. 4",
        "With speed and orientation constant all three observers do well.",
        verdict(w <= GOOD_W and psi <= GOOD_PSI),
        f"worst of the three in simulation 1: {w:.2f} m, {psi:.2f} rad (limits {GOOD_W:g}, {GOOD_PSI:g})",
    )
    best = int((e[:, h] <= e.min(axis=1) + HALF_DIGIT).sum())
    yield Claim(
        "[MS] V.A, [HG] IV.A",
        "Without noise the high-gain observer has the smallest errors.",
        verdict(best == 12, best > 6),
        f"best, or within half a digit of it, in {best} of 12 (simulation, quantity)",
    )
    yield Claim(
        "[MS] V.A, Fig. 5",
        "While steering at constant speed, the multi-stage observer's orientation beats the nonlinear one's.",
        verdict(e[1, m, 3] < e[1, n, 3] - HALF_DIGIT, captions[1, m, 3] < captions[1, n, 3]),
        f"simulation 2, yaw RMSE: {e[1, m, 3]:.3f} against {e[1, n, 3]:.3f} rad; with the captions' constant "
        f"steering {captions[1, m, 3]:.3f} against {captions[1, n, 3]:.3f}",
    )
    ratios = e[2, n] / e[2, [h, m]].max(axis=0)
    yield Claim(
        "[MS] V.A, Fig. 6; VI; [HG] IV.A",
        "When the speed varies, the constant-velocity observer is poor and the two others are much better.",
        verdict(bool((ratios > NEAR).all()), bool((ratios > NEAR).any())),
        f"simulation 3, nonlinear over the worse of the two others (limit {NEAR:g}): "
        + ", ".join(f"{c.split()[0]} {r:.1f}" for c, r in zip(plant.COLUMNS, ratios, strict=True)),
    )


def _printed_numbers(e: Array) -> Claim:
    ratio = np.maximum(e, 1e-9) / np.maximum(PRINTED, 1e-9)
    near = ((ratio < NEAR) & (ratio > 1.0 / NEAR)) | (np.abs(e - PRINTED) <= NEAR_ABS + 1e-12)
    counts = [int(near[:, j].sum()) for j in range(3)]
    shown = ", ".join(f"{o.name} {c} of 12" for o, c in zip(OBSERVERS, counts, strict=True))
    return Claim(
        "[MS] Table II, [HG] Table I",
        "The printed errors of the three simulations.",
        verdict(sum(counts) >= 32, sum(counts[1:]) >= 12),
        f"within a factor {NEAR:g} or {NEAR_ABS:g} of print with the matched start: {shown}",
    )
