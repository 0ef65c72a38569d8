"""The pictures of docs/relocalise-comparison.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.relocalise import cases, follow, table, tune
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from outrider.relocalise.anywhere import Search

DPI = 80
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "0.3")
SHOWN = (0, 2, 4, 5, 7, 9)  # of `cases.BASIN`
AT = (0.0, 0.3, 1.0, 4.0)  # when the hypotheses are drawn [s]


def save(kept: dict[str, Any], folder: Path) -> None:
    """Error over cost; basins of attraction; the search in two rooms."""
    for name, figure in (("comparison", cost(kept)), ("basin", basin(kept)), ("anywhere", anywhere())):
        figure.savefig(folder / f"relocalise-{name}.png", dpi=DPI, metadata={"Software": ""})


def _figure(width: float, height: float, rows: int, columns: int, **how: Any) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **how)


def cost(kept: dict[str, Any]) -> Figure:
    """Error of each method against what a step of it takes, a panel for each cell."""
    figure, axes = _figure(14.0, 8.0, 2, 2, sharex=True, sharey=True)
    for ax, cell in zip(axes.ravel(), cases.NOISE, strict=True):
        rows = [r for r in kept["noise"] if r["cell"] == cell.label]
        for k, r in enumerate(rows):
            mark = "s" if "particle" in r["method"] else "*" if "ekf" in r["method"] else "o"
            error = 100.0 * min(r["rms"] if r["rms"] is not None else 1.0, 1.0)
            label = r["method"].replace("`", "")
            ax.loglog(r["us"], error, mark, color=f"C{k % 10}", ms=13 if mark == "*" else 8, label=label)
        ax.set_title(cell.label)
        ax.grid(True, which="both", alpha=0.25)
    for ax in axes[:, 0]:
        ax.set_ylabel("median rmse of the position [cm]")
    for ax in axes[1]:
        ax.set_xlabel("one step of one robot [us]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return figure


def basin(kept: dict[str, Any]) -> Figure:
    """Share of guesses that find the pose, over how far off their heading is and their place."""
    figure, axes = _figure(14.0, 8.0, 2, 2, sharey=True)
    degrees = np.rad2deg(0.5 * (table.HEADINGS[1:] + table.HEADINGS[:-1]))
    metres = cases.FAR * (np.arange(5) + 0.5) / 5.0
    for row, wall in zip(axes, ("ellipse", "asymmetric"), strict=True):
        for k, i in enumerate(SHOWN):
            label = cases.BASIN[i][0]
            of = next(r for r in kept["basin"] if (r["method"], r["wall"], r["sigma"]) == (label, wall, 0.0))
            for ax, x, name in ((row[0], degrees, "by_heading"), (row[1], metres, "by_distance")):
                shares = [np.nan if share is None else 100.0 * share for share in of[name]]
                ax.plot(x, shares, "o-", color=COLOURS[k], label=label.replace("`", ""))
        row[0].set_ylabel(f"{wall}: found [%]")
        for ax in row:
            ax.grid(True, alpha=0.25)
    axes[1, 0].set_xlabel("heading off [deg]")
    axes[1, 1].set_xlabel("position off [m]")
    axes[0, 1].legend(fontsize=8)
    return figure


def anywhere() -> Figure:
    """All poses that are left of a search, at four instants, in two rooms."""
    figure, axes = _figure(15.0, 6.5, 2, len(AT))
    for row, cell in zip(axes, (cases.ANYWHERE[0], cases.ANYWHERE[3]), strict=True):
        drives, search = tune.driven(cell, cases.JUDGED + 1, 2, 5.0), Search(cell.room)
        none = np.full_like(drives.ranges, np.nan)
        panels = iter(zip(row, AT, strict=True))
        ax, when = next(panels)
        for k, t in enumerate(drives.t):
            found = search.step(follow.sample(drives, cell.room, k, none, 1))
            if t >= when - 1e-9:
                _hypotheses(ax, cell, found.pose, drives.truth[k, 1])
                ax.set_title(f"{t:.1f} s: {len(found.pose)} left")
                ax, when = next(panels, (ax, np.inf))
    return figure


def _hypotheses(ax: Axes, cell: cases.Cell, pose: Any, truth: Any) -> None:
    outline = cell.room.wall.at(np.linspace(0.0, 2.0 * np.pi, 400)).r
    ax.plot(*outline.T, color="0.2", lw=2)
    ends = cell.room.wall.ray(truth[:2], truth[2] + cell.room.angles).range[:, None]
    bearing = truth[2] + cell.room.angles
    for end in truth[:2] + ends * np.column_stack([np.cos(bearing), np.sin(bearing)]):
        ax.plot(*np.array([truth[:2], end]).T, color=COLOURS[2], lw=1)
    arrows = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ax.quiver(*pose[:, :2].T, *arrows, color=COLOURS[0], scale=18, width=0.006)
    ax.quiver(*truth[:2], np.cos(truth[2]), np.sin(truth[2]), color=COLOURS[1], scale=12, width=0.012)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
