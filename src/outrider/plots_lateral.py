"""Pictures of a car's lateral velocity: estimates against time, and how wrong they are over speed and ay.

Figures are made without pyplot, as in `plots`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from outrider.lateral import Array, Bools
from outrider.lateral.log import Log
from outrider.lateral.run import Run
from outrider.plots import DPI, LINES, TEXT, write

GAP_S = 0.5  # a line is broken over a longer gap
MOST = 40_000  # points of a line that are drawn
BINS = 10  # of speed, and of lateral acceleration
FEWEST = 50  # rows that a bin needs to be shown
TRUTH: dict[str, Any] = {"color": "k", "lw": 1.6, "zorder": 5}


def save(run: Run, folder: Path | str) -> Path:
    """Writes vy.png, a run against time, into the folder; OutputError where it cannot."""
    path = Path(folder) / "vy.png"
    vy = np.where(run.track.held, np.nan, run.track.estimate[:, 0])
    write(over_time(run.log, {run.estimator: vy}, held=run.track.held), path)
    return path


@rc_context(TEXT)
def over_time(
    log: Log,
    estimates: Mapping[str, Array],
    *,
    held: Bools | None = None,
    span: tuple[float, float] | None = None,
    title: str = "",
) -> Figure:
    """Speed and lateral acceleration, then lateral velocity, then its error where the log has vy.

    estimates: vy (n,) by name [m/s], NaN where there is none. held (n,): shaded. span: only from, to [s].
    """
    known = log.vy is not None and bool(np.isfinite(log.vy).any())
    figure = Figure(figsize=(14.0, 10.5 if known else 8.0), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3 if known else 2, 1, sharex=True, height_ratios=(2, 3, 2) if known else (2, 3))
    rows = _rows(log.t, span)
    t = log.t[rows]
    _drive(axes[0], t, log.vx[rows], log.ay[rows])
    if known:
        axes[1].plot(*_line(t, _truth(log)[rows]), label=f"truth, RMS {_rms(_truth(log)):.3f} m/s", **TRUTH)
    for i, (name, vy) in enumerate(estimates.items()):
        look: dict[str, Any] = {"color": LINES[i % len(LINES)], "lw": 1.3}
        said = name
        if known:
            error = vy - _truth(log)
            said = f"{name}, RMSE {_rms(error):.3f} m/s"
            axes[2].plot(*_line(t, error[rows]), **look)
        axes[1].plot(*_line(t, vy[rows]), label=said, **look)
    axes[1].set_ylabel("lateral velocity [m/s]")
    axes[1].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False, fontsize="small")
    if known:
        axes[2].set_ylabel("error [m/s]")
        axes[2].axhline(0.0, color="k", lw=0.8)
        _within(axes[1], _truth(log)[rows], 1.8)
        _within(axes[2], _truth(log)[rows], 1.0)
    _shade(axes, log.t, held, rows)
    axes[-1].set_xlabel("t [s]")
    axes[-1].set_xlim(float(t[0]), float(t[-1]))
    if title:
        figure.suptitle(title, fontsize="medium")
    return figure


@rc_context(TEXT)
def over_ranges(log: Log, estimates: Mapping[str, Array], *, title: str = "") -> Figure:
    """RMSE of vy in bins of speed and of |ay|, beside the RMS of vy itself; below, how long each lasted.

    estimates: vy (n,) by name [m/s]. The log needs vy; rows without an estimate are not counted.
    """
    figure = Figure(figsize=(14.0, 7.5), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, sharex="col", sharey="row", height_ratios=(4, 1))
    truth, dt = _truth(log), np.diff(log.t, append=log.t[-1:])
    side = np.abs(log.vx * log.yaw_rate)  # smoother than the sensor's ay
    for column, (x, label) in enumerate(((log.vx, "speed [m/s]"), (side, "|vx yaw rate| [m/s2]"))):
        good = np.isfinite(x) & np.isfinite(truth)
        edges = np.linspace(float(x[good].min()), float(np.quantile(x[good], 0.9995)), BINS + 1)
        place = np.where(good, np.clip(np.digitize(x, edges) - 1, 0, BINS - 1), -1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        top, bottom = axes[0, column], axes[1, column]
        top.plot(middle, _binned(truth, place), label="RMS of vy: the error of always 0", ls="--", **TRUTH)
        for i, (name, vy) in enumerate(estimates.items()):
            look: dict[str, Any] = {"color": LINES[i % len(LINES)], "lw": 1.8, "marker": "o", "ms": 5}
            top.plot(middle, _binned(vy - truth, place), label=name, **look)
        seconds = [float(dt[place == b].sum()) for b in range(BINS)]
        bottom.bar(middle, seconds, width=0.9 * np.diff(edges), color="0.6")
        bottom.set_xlabel(label)
    axes[0, 0].set_ylabel("RMSE of lateral velocity [m/s]")
    worth = max(float(np.nanmax(line.get_ydata()[:], initial=0.0)) for ax in axes[0] for line in ax.lines[:1])
    axes[0, 0].set_ylim(0.0, min(axes[0, 0].get_ylim()[1], 2.5 * max(worth, 0.02)))
    axes[1, 0].set_ylabel("time [s]")
    axes[0, 0].legend(loc="upper left", fontsize="small", framealpha=0.8)
    if title:
        figure.suptitle(title, fontsize="medium")
    return figure


def _drive(ax: Axes, t: Array, vx: Array, ay: Array) -> None:
    ax.plot(*_line(t, vx), color="0.25", lw=1.5)
    ax.set_ylabel("speed [m/s]")
    ax.set_ylim(bottom=min(0.0, float(np.nanmin(vx, initial=0.0))))
    other = ax.twinx()
    other.plot(*_line(t, ay), color=LINES[5], lw=0.8)
    other.set_ylabel("ay, measured [m/s2]", color=LINES[0])
    other.set_zorder(ax.get_zorder() - 1)
    ax.patch.set_visible(False)


def _within(ax: Axes, truth: Array, times: float) -> None:
    """Cut what runs far off: an estimate that drifts must not flatten the others."""
    most = times * float(np.nanmax(np.abs(truth), initial=0.05))
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, -most), min(high, most))


def _shade(axes: Sequence[Axes], t: Array, held: Bools | None, rows: slice) -> None:
    if held is None or not held[rows].any():
        return
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held[rows], [False]]).astype(int)))
    times = np.append(t[rows], t[rows][-1])
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        for ax in axes:
            ax.axvspan(times[begin], times[end], color="0.85", lw=0, zorder=0)


def _rows(t: Array, span: tuple[float, float] | None) -> slice:
    first, last = (0, len(t)) if span is None else (int(i) for i in np.searchsorted(t, span))
    return slice(first, max(last, first + 2), max((last - first) // MOST, 1))


def _line(t: Array, y: Array) -> tuple[Array, Array]:
    cut = np.flatnonzero(np.diff(t) > GAP_S) + 1
    return np.insert(t, cut, np.nan), np.insert(y, cut, np.nan)


def _truth(log: Log) -> Array:
    return np.full(len(log.t), np.nan) if log.vy is None else log.vy


def _binned(values: Array, place: Any) -> Array:
    good = np.isfinite(values)
    return np.array(
        [_rms(v) if len(v := values[good & (place == b)]) >= FEWEST else np.nan for b in range(BINS)]
    )


def _rms(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good * good))) if len(good) else float("nan")
