"""The four experiments of the papers, rebuilt as simulated scans and run from the scan to the track.

[MS] V.B, Figs. 8-11; [HG] IV.C, Figs. 7-10. What was recorded there is not public.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from outrider.records import Array
from outrider.reproduce import experiment_runs as ex
from outrider.reproduce.experiment_claims import HIGH, HIGH_GAIN, LOW, MULTI, OURS, READ, Scores, claims
from outrider.reproduce.experiment_runs import INPUTS, LABELS, NOISES, NUMBERS, THETAS, Input, Run, Score
from outrider.reproduce.section import Picture, Section, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN: tuple[tuple[str, int, Input, tuple[str, str], str], ...] = (  # ..., the figure of the papers
    ("experiment-1", 1, "corner", (HIGH_GAIN, MULTI), "after [MS] Fig. 8, [HG] Fig. 7"),
    ("experiment-2", 2, "corner", (HIGH_GAIN, MULTI), "after [MS] Fig. 9, [HG] Fig. 8"),
    ("experiment-3-low", 3, "corner", (HIGH_GAIN, LOW), "after [MS] Fig. 10"),
    ("experiment-3-high", 3, "corner", (HIGH, MULTI), "after [MS] Fig. 11"),
    ("experiment-3-theta", 3, "corner", (THETAS[1], THETAS[0]), "after [HG] Fig. 10"),
    ("experiment-4-theta", 4, "corner", (THETAS[2], THETAS[0]), "after [HG] Fig. 9"),
    ("experiment-3-ours", 3, "rectangle", (MULTI, OURS), "no figure of theirs"),
)
CUTOFFS = (0.5, 1.0, 2.0)  # of the reference [Hz]
HEAD = (
    "observer",
    "velocity [m/s], truth / reference",
    "yaw [deg], truth / reference",
    "roughness of V [m/s]",
    "of yaw [deg]",
    "delay [s]",
)


def section() -> Section:
    """Errors, smoothness and delay of the observers in the four experiments, pictures, claims."""
    found = {number: ex.runs(number) for number in NUMBERS}
    every = scores(found)
    corner = [run for run in found[3] if run.input == "corner"]
    near = ex.apart(corner, LOW, HIGH_GAIN), ex.apart(corner, LOW, MULTI)
    return Section(
        name="experiments",
        title="The four experiments",
        text=_text(found),
        tables=(*_tables(every), _references(found)),
        pictures=tuple(
            Picture(name, f"{ex.world(n).title}; in: {kind}; {source}.", partial(_draw, n, kind, labels))
            for name, n, kind, labels, source in SHOWN
        ),
        claims=tuple(claims(every, near)),
    )


def scores(found: Mapping[int, Sequence[Run]]) -> Scores:
    """Median scores over the seeds, by experiment, input and label."""
    out: dict[tuple[int, Input, str], Score] = {}
    for number, runs in found.items():
        for kind in INPUTS:
            some = [run for run in runs if run.input == kind]
            out |= {(number, kind, label): ex.typical(some, label) for label in some[0].scores}
    return out


def _text(found: Mapping[int, Sequence[Run]]) -> str:
    hops = np.array([run.hops for runs in found.values() for run in runs if run.input == "corner"])
    far = np.array([run.hops for runs in found.values() for run in runs if run.input == "nearest"])
    return f"""
The recordings of the papers are not public. Each experiment is rebuilt as a scenario, `experiment_1.toml`
to `experiment_4.toml`, in the papers' frame: x to the right, y ahead of the standing scooter. Distances and
speeds are ours; the turns are those the papers read off, and what is judged is whether an observer finds
them. The sensor is their RPLIDAR Mapper: 0.1 to 40 m, 0.75 deg, 10 Hz, 2 cm, taken as a standard deviation.
Every figure is the median of {ex.SEEDS} seeds. The same scans give three inputs:

- **corner**: the return next to a front corner of the car, the one in sight; the source chose a corner too.
  It hops by more than {ex.HOP_M:g} m in {_range(100 * hops[:, 0])} % of the scans,
  by at most {hops[:, 1].max():.1f} m.
- **rectangle**: what the tracker hands to its observer, after segments, rectangles and association. Where
  the first rectangles of a distant car are wrong (experiment 4), who looks only at positions starts wrong.
- **nearest**: the return nearest to the sensor. It wanders over the whole body, by hops of up to
  {far[:, 1].max():.1f} m.

The observers are those of this package with the papers' gains, over the true times of the samples;
multi-stage without the heading of the rectangle. `ekf` is our default. The papers' two EKFs are our reading:
2 cm and 0.5 m.

**Truth** is the motion of the car's centre. **Reference** is what the source has in its place: the measured
positions through `filtfilt`, here a Butterworth low-pass of order {ex.ORDER} at {ex.CUTOFF_HZ:g} Hz (neither
is printed), their derivative, and its direction for the yaw. That is the course, and differs from the yaw by
the slip. A corner swings round the centre in a bend, which no observer fed with a corner can know: its error
against the truth has that in it.

Errors are RMS from {ex.SKIP_S:g} s after the first scan on. Roughness: RMS of the second difference from scan
to scan. Delay: the shift in time that brings the reference's velocity nearest to the observer's.
"""


def _range(values: Array) -> str:
    return f"{values.min():.0f} to {values.max():.0f}"


# ------------------------------------------------------------------ tables


def _tables(every: Scores) -> Iterator[Table]:
    for kind in INPUTS[:2]:
        for number in NUMBERS:
            rows = [_row(every[number, kind, label], label) for label in ("reference", *LABELS)]
            yield Table(f"Experiment {number}, {kind}", HEAD, tuple(rows))
    rows = [
        (label, *(_short(every[number, "nearest", label]) for number in NUMBERS))
        for label in ("reference", *LABELS)
    ]
    yield Table(
        "Nearest return: error against the truth, velocity [m/s], yaw [deg]",
        ("observer", *(f"experiment {number}" for number in NUMBERS)),
        tuple(rows),
    )
    rows = [_row(every[3, "corner", label], label) for label in (MULTI, *NOISES)]
    yield Table("Experiment 3, corner: what the EKF is told of the noise", HEAD, tuple(rows))
    rows = [_row(every[n, "corner", label], f"{n}: {label}") for n in (3, 4) for label in THETAS]
    yield Table("Experiments 3 and 4, corner: theta", HEAD, tuple(rows))


def _references(found: Mapping[int, Sequence[Run]]) -> Table:
    """How far the reference is from the truth, and how much of that is the choice of the filter."""
    rows = []
    for kind in INPUTS[:2]:
        for hz in CUTOFFS:
            cells = []
            for number in NUMBERS:
                some = [r for r in found[number] if r.input == kind]
                tried = [(ex.reference(r.series, hz), r.series) for r in some]
                s = [ex.score(track, track, series) for track, series in tried]
                v, yaw = np.median([(x.velocity, np.degrees(x.yaw)) for x in s], axis=0)
                cells.append(f"{v:.2f}, {yaw:.1f}")
            rows.append((f"{kind}, {hz:g} Hz", *cells))
    head = ("input, cut-off", *(f"experiment {number}" for number in NUMBERS))
    return Table("Reference: error against the truth, velocity [m/s], yaw [deg]", head, tuple(rows))


def _row(s: Score, label: str) -> tuple[str, ...]:
    reference = label == "reference"
    return (
        label,
        f"{s.velocity:.2f} / {'-' if reference else f'{s.velocity_ref:.2f}'}",
        f"{np.degrees(s.yaw):.1f} / {'-' if reference else f'{np.degrees(s.yaw_ref):.1f}'}",
        f"{s.rough_speed:.3f}",
        f"{np.degrees(s.rough_yaw):.2f}",
        "-" if reference else f"{s.delay:.2f}",
    )


def _short(s: Score) -> str:
    return f"{s.velocity:.2f}, {np.degrees(s.yaw):.1f}"


# ------------------------------------------------------------------ pictures


def _draw(number: int, kind: Input, labels: tuple[str, str]) -> Figure:
    """Path, velocities and yaw of two observers with reference and truth; the scenario's own seed."""
    from outrider.plots import LINES, TRUTH
    from outrider.reproduce import draw

    run = next(r for r in ex.runs(number) if r.input == kind)
    true, t = run.tracks["truth"], run.series.t
    turn = 360.0 * round((READ[number][0] - np.degrees(true.yaw[0])) / 360.0)  # as the papers count it
    figure, axes = draw.panels(2, 2, 10.0, 7.0)
    path = axes[0]
    path.plot(*run.series.y[:, :2].T, ".", ms=4, color="0.6", label="measured")
    path.plot(0.0, 0.0, "k^", ms=8)
    looks = [
        (labels[0], {"color": LINES[1], "lw": 1.2}),
        (labels[1], {"color": LINES[0], "lw": 1.6}),
        ("reference", {"color": "0.45", "lw": 1.2}),
        ("truth", TRUTH),
    ]
    for label, look in looks:
        track = run.tracks[label]
        path.plot(*track.p.T, label=label, **look)
        for ax, values in zip(axes[1:], (*track.v.T, np.degrees(track.yaw) + turn), strict=True):
            ax.plot(t, values, **look)
    names = ("$V_x$ [m/s]", "$V_y$ [m/s]", "yaw [deg]")
    for ax, name, values, margin in zip(
        axes[1:], names, (*true.v.T, np.degrees(true.yaw) + turn), (4.0, 4.0, 30.0), strict=True
    ):
        ax.set(xlabel="time [s]", ylabel=name, ylim=(values.min() - margin, values.max() + margin))
    path.set(xlabel="x [m]", ylabel="y [m]")
    path.set_aspect("equal", adjustable="datalim")
    draw.legend(figure, path)
    return figure
