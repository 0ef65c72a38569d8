"""How all pictures of the reproduction look: size, colours, legend above, a light grid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from outrider.plots import LINES, TRUTH

__all__ = ["COLOURS", "LINES", "TRUTH", "against_time", "legend", "panels"]

TEXT: dict[str, Any] = {"font.size": 10.0}
EVERY = 5  # of the samples of a series are drawn
COLOURS = {"nonlinear": LINES[4], "high-gain": LINES[1], "multi-stage": LINES[0], "EKF": LINES[2]}


@rc_context(TEXT)
def panels(rows: int, columns: int, width: float = 9.0, height: float = 6.0) -> tuple[Figure, list[Axes]]:
    """An empty figure [inch] and its axes, by rows."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.ravel(figure.subplots(rows, columns)))
    for ax in axes:
        ax.grid(color="0.9", lw=0.6)
        ax.set_axisbelow(True)
    return figure, axes


@rc_context(TEXT)
def legend(figure: Figure, ax: Axes, columns: int = 5) -> None:
    """One legend above all panels, from the lines of one of them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)


def against_time(
    ax: Axes, t: Any, truth: Any, series: Sequence[tuple[str, Any]], ylabel: str, every: int = EVERY
) -> None:
    """Truth dashed and on top, each (label, values (T,)) as a line of its observer's colour."""
    for i, (label, values) in enumerate(series):
        colour = COLOURS.get(label, LINES[(i + 3) % len(LINES)])
        ax.plot(t[::every], values[::every], lw=1.4, color=colour, label=label, zorder=2 + 0.1 * i)
    ax.plot(t[::every], truth[::every], zorder=5, label="truth", **TRUTH)
    ax.set(ylabel=ylabel, xlabel="time [s]", xlim=(t[0], t[-1]))
