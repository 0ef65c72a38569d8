"""Picture of a tuning: alpha over speed or lateral acceleration, and the errors that it was chosen by.

Figures are made without pyplot, as in `plots`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from outrider.lateral._search import KINDS, LEAST_ROWS, METHODS
from outrider.lateral.tune import Tuned
from outrider.plots import DPI, LINES, TEXT, write

MOST = 1000.0  # a larger alpha is drawn as none of it [m/s2 per rad]
NAMES = {"speed": "speed [km/h]", "ay": "|ay|, low-passed [m/s²]"}
SCALES = {"speed": 3.6, "ay": 1.0}
MARKS: dict[str, dict[str, Any]] = {
    "grid": {"marker": "o", "ms": 9, "color": LINES[0], "label": "best of the grid"},
    "greedy": {"marker": "x", "ms": 9, "mew": 2.0, "color": LINES[1], "label": "published loop"},
    "joint": {
        "marker": "s",
        "ms": 13,
        "color": LINES[2],
        "mfc": "none",
        "mew": 1.6,
        "label": "all bins together",
    },
}


def save(tuned: Tuned, path: Path | str) -> Path:
    """Writes the picture; OutputError where it cannot."""
    write(figure(tuned), Path(path))
    return Path(path)


@rc_context(TEXT)
def figure(tuned: Tuned) -> Figure:
    """Alpha in each bin with its fitted curve, as Fenyes et al. 2023, fig. 2; beside, errors of all tries.

    Where alpha is large, the ultra-local model adds nothing: such points stand at the upper edge.
    """
    made = Figure(figsize=(15.0, 6.8), dpi=DPI, layout="constrained")
    FigureCanvasAgg(made)
    left, right = made.subplots(1, 2)
    _alpha(left, tuned)
    _errors(right, tuned, made)
    none, chosen = tuned.rmse_of["none"], tuned.rmse_of[tuned.method]
    made.suptitle(
        f"{tuned.estimator}, tuned over {tuned.over} on {sum(tuned.rows)} rows: rmse of vy {none:.3f} m/s "
        f"without, {chosen:.3f} m/s with it ({tuned.method})"
    )
    return made


def _alpha(ax: Axes, tuned: Tuned) -> None:
    kind, scale = KINDS[tuned.estimator], SCALES[tuned.over]
    at, seen = tuned.middles, np.array(tuned.rows) >= LEAST_ROWS
    x, strength = tuned.curve
    curve = tuned.alpha(strength, x)
    curve[curve > MOST] = np.nan
    ax.plot(scale * x, curve, color="0.4", lw=2.0, label="curve fitted to the grid's", zorder=1)
    for method in METHODS:
        if method in MARKS:
            alpha = np.minimum(tuned.alpha(kind.strength(tuned.values[method]), at), MOST)
            mark = {"ls": "none", "clip_on": False, "zorder": 3, **MARKS[method]}
            ax.plot(scale * at[seen], alpha[seen], **mark)
    for edge in tuned.edges:
        ax.axvline(scale * edge, color="0.9", lw=1.0, zorder=0)
    ax.set(xlabel=NAMES[tuned.over], ylabel="alpha [m/s² per rad]", yscale="log", ylim=(70.0, MOST))
    ticks = (80.0, 100.0, 150.0, 200.0, 300.0, 500.0, MOST)
    ax.set_yticks(ticks, [*(f"{v:g}" for v in ticks[:-1]), "none"])
    ax.set_yticks([], minor=True)
    ax.legend(loc="best", framealpha=0.8)


def _errors(ax: Axes, tuned: Tuned, made: Figure) -> None:
    """Of each bin its error over what was tried, relative to none of it; the choice is marked."""
    errors = np.array([[np.nan if e is None else e for e in row] for row in tuned.rmse_mps])
    rows, scale = np.array(tuned.rows), SCALES[tuned.over]
    color = ScalarMappable(Normalize(scale * tuned.edges[0], scale * tuned.middles[-1]), "viridis")
    index = np.arange(len(tuned.grid))
    for i in np.flatnonzero(rows >= LEAST_ROWS):
        line = errors[:, i] / errors[0, i]
        own = color.to_rgba(np.array(scale * tuned.middles[i]))
        ax.plot(index, line, color=own, lw=2.0)
        for method in ("grid", "greedy"):
            chosen = tuned.grid.index(tuned.values[method][i])
            ax.plot(chosen, line[chosen], ls="none", **{**MARKS[method], "label": None, "color": own})
    ax.axhline(1.0, color="0.7", lw=1.0, zorder=0)
    most = KINDS[tuned.estimator].gain == "k"
    ax.set_xticks(index, ["none" if i == 0 else f"{v:g}" for i, v in enumerate(tuned.grid)], rotation=60)
    ax.set(
        xlabel="k, the same in all bins [-]" if most else "alpha, the same in all bins [m/s² per rad]",
        ylabel="rmse of vy in the bin over that without [-]",
        yscale="log",
    )
    low, high = np.nanmin(errors / errors[0]), np.nanmax(errors / errors[0])
    ax.set_ylim(max(0.8 * low, 0.02), min(1.2 * high, 10.0))
    ticks = [
        v
        for v in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
        if ax.get_ylim()[0] <= v <= ax.get_ylim()[1]
    ]
    ax.set_yticks(ticks, [f"{v:g}" for v in ticks])
    ax.set_yticks([], minor=True)
    made.colorbar(color, ax=ax, label=NAMES[tuned.over])
