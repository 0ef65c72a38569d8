"""Pictures of a comparison: the errors of each observer, and the longest series with what they made of it.

Figures are made without pyplot, as in `plots`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from outrider.compare import Estimate, Series
from outrider.comparison import Comparison, Row, name_of
from outrider.geometry import wrap
from outrider.observers import Motion
from outrider.plots import DPI, LINES, TEXT, TRUTH, write
from outrider.records import Array, Bools

MARKERS = "osD^vP"  # a recording each, then from the front again
MOST = 5  # observers in the picture against time
WIDE = 20.0  # a wider range of errors is drawn on a logarithmic scale
SLOW_MPS = 0.5  # slower, a course says nothing
OFF = 45.0  # range of the error of the course that is drawn [deg]


def save(comparison: Comparison, folder: Path | str) -> tuple[Path, Path]:
    """Writes errors.png and series.png; OutputError where it cannot."""
    pictures = (
        (Path(folder) / "errors.png", errors(comparison)),
        (Path(folder) / "series.png", series(comparison)),
    )
    for path, figure in pictures:
        write(figure, path)
    return pictures[0][0], pictures[1][0]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


# ------------------------------------------------------------------ errors


@rc_context(TEXT)
def errors(comparison: Comparison) -> Figure:
    """RMS errors of velocity and yaw: an observer a line, a recording a mark; best J of all on top."""
    ranked = sorted(comparison.pooled, key=lambda row: row.figures.J)
    labels = [row.label for row in ranked]
    figure = _figure(14.0, 2.2 + 0.36 * len(labels))
    left, right = figure.subplots(1, 2, sharey=True)
    columns = (
        (left, "velocity_mps", 1.0, "velocity, RMS error [m/s]"),
        (right, "yaw_rad", 180.0 / np.pi, "yaw, RMS error [deg]"),
    )
    for ax, key, factor, title in columns:
        points = [
            _points(rows, labels, key, factor, name, i) for i, (name, rows) in enumerate(comparison.tables())
        ]
        _dots(ax, points, len(labels))
        ax.set_xlabel(title)
    left.set_yticks(range(len(labels)), labels)
    left.set_ylim(len(labels) - 0.5, -0.5)
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _points(
    rows: Sequence[Row], labels: Sequence[str], key: str, factor: float, name: str, i: int
) -> tuple[str, Array, Array, dict[str, Any]]:
    """Name, values and places on the axis of one recording's marks, and how they look."""
    values = np.array([factor * row.values()[key] for row in rows], float)
    places = np.array([labels.index(row.label) for row in rows], float)
    if name == "all recordings":
        return name, values, places, {"marker": "|", "ms": 16, "mew": 2.5, "color": "k", "zorder": 2}
    color = LINES[i % len(LINES)]
    return name, values, places, {"marker": MARKERS[i % len(MARKERS)], "ms": 8, "color": color, "zorder": 3}


def _dots(ax: Axes, points: Sequence[tuple[str, Array, Array, dict[str, Any]]], n: int) -> None:
    """All marks of one panel; what is not finite stands at the right edge, as a word."""
    finite = np.concatenate([values[np.isfinite(values)] for _, values, _, _ in points])
    positive = finite[finite > 0.0]
    if len(positive) and positive.max() > WIDE * positive.min():
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(ScalarFormatter())
        ax.xaxis.set_minor_formatter(NullFormatter())
    for name, values, places, look in points:
        ax.plot(values, places, ls="none", label=name, mec=look["color"], **look)
        for place in places[np.isposinf(values)]:
            ax.annotate(
                "lost",
                (0.99, place),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                color="0.3",
            )
    if ax.get_xscale() == "linear":
        ax.set_xlim(left=0.0)
    for place in range(n):
        ax.axhline(place, color="0.9", lw=0.8, zorder=0)
    ax.grid(axis="x", color="0.9", lw=0.6)
    ax.set_axisbelow(True)


# ------------------------------------------------------------------ against time


@rc_context(TEXT)
def series(comparison: Comparison) -> Figure:
    """The longest series against time: speed, course and its error, of the truth and the best observers by J.

    Course is drawn where the body truly moves. Observers with a lag are left out.
    """
    found, of, j = max(
        ((c, s, j) for c in comparison.recordings for j, s in enumerate(c.measured.series)),
        key=lambda item: len(item[1].t),
    )
    causal = [i for i, row in enumerate(found.rows) if not row.lag] or list(range(len(found.rows)))
    ranked = sorted(causal, key=lambda i: found.rows[i].figures.J)
    figure = _figure(16.0, 12.0)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    for k, i in enumerate(ranked[:MOST]):
        look = {"color": LINES[k % len(LINES)], "lw": 1.4, "zorder": 4 - 0.1 * k}
        _draw(axes, of, found.estimates[i][j], found.rows[i].label, look)
    _truth(axes, of)
    count = f": {MOST} best of {len(ranked)} by J" if len(ranked) > MOST else ""
    axes[0].set_title(f"{name_of(found.measured)}, {of.name}{count}", loc="left")
    axes[0].set(ylabel="speed [m/s]", xlim=(0.0, of.t[-1] - of.t[0]))
    axes[1].set_ylabel("course [deg]")
    axes[2].set(
        ylabel="error of course [deg]", xlabel="time from the first measurement [s]", ylim=(-OFF, OFF)
    )
    for ax in axes:
        ax.grid(color="0.9", lw=0.6)
        ax.set_axisbelow(True)
    handles = [*axes[0].get_legend_handles_labels()[0], Line2D([], [], label="truth", **TRUTH)]
    figure.legend(handles=handles, loc="outside upper center", ncols=MOST + 2, frameon=False)
    return figure


def _draw(axes: Sequence[Axes], of: Series, e: Estimate, label: str, look: dict[str, Any]) -> None:
    m = dict(zip(Motion._fields, e.motion.T, strict=True))
    t, true = of.t - of.t[0], _course(of)
    way = m["course"] + np.where(m["speed"] < 0.0, np.pi, 0.0)
    error = wrap(np.where(_moves(of), way - true, np.nan))
    axes[0].plot(t, np.abs(m["speed"]), label=label, **look)
    axes[1].plot(t, np.degrees(true + error), **look)
    axes[2].plot(t, np.degrees(error), **look)


def _truth(axes: Sequence[Axes], of: Series) -> None:
    t = of.t - of.t[0]
    course = np.where(_moves(of), _course(of), np.nan)
    for ax, values in zip(axes, (np.hypot(*of.truth.W_v.T), np.degrees(course), 0.0 * course), strict=True):
        ax.plot(t, values, **TRUTH, zorder=5)
    unseen = t[~np.isfinite(of.y[:, 0])]
    if len(unseen):
        axes[0].plot(unseen, np.zeros(len(unseen)), "|", color="0.4", ms=12, label="not seen")


def _moves(of: Series) -> Bools:
    return np.asarray(np.nan_to_num(np.hypot(*of.truth.W_v.T)) > SLOW_MPS)


def _course(of: Series) -> Array:
    """True direction of motion (n,), without jumps [rad]; held where the body stands or nothing is known."""
    where = np.flatnonzero(_moves(of))
    if not len(where):
        return np.zeros(len(of.t))
    u, v = of.truth.W_v[where].T
    held: Array = np.interp(np.arange(len(of.t)), where, np.unwrap(np.arctan2(v, u)))
    return held
