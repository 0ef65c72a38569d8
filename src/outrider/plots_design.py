"""Pictures of proofs: over which speeds, accelerations and yaw rates a gain is proven.

Figures are made without pyplot, as in `plots`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from outrider.design.region import QUOTED, Edge, Map
from outrider.plots import DPI, HALO, LINES, TEXT, write

GRIP = 8.0  # what tyres give sideways on a dry road [m/s2]
LEVEL = 0.5  # between the rays of equal yaw rate [rad/s]
COLORS = (LINES[0], *LINES[2:])  # of gains; the other one is for what cannot be proven
DARK = [patheffects.withStroke(linewidth=2.5, foreground="0.15")]
DOT: dict[str, Any] = {"marker": "o", "ms": 9, "color": "k", "mec": "w"}
CROSS: dict[str, Any] = {"marker": "X", "ms": 12, "color": LINES[1], "mec": "w"}
HATCH: dict[str, Any] = {"fc": "w", "ec": "0.65", "hatch": "//", "lw": 0.0}
LIMIT: dict[str, Any] = {"color": LINES[1], "lw": 2.5, "zorder": 4}
TYRES: dict[str, Any] = {"ls": (0, (6, 3)), "lw": 2.0}
Marks = Sequence[tuple[float, float]]


def save(map: Map, path: Path | str, marks: Marks = QUOTED) -> Path:
    """Writes the region map as a picture; OutputError where it cannot."""
    write(region_map(map, marks), Path(path))
    return Path(path)


@rc_context(TEXT)
def region_map(map: Map, marks: Marks = QUOTED) -> Figure:
    """Largest proven yaw rate over speed and acceleration, a panel for each gain; below, over their ratio.

    A point stands for every state faster than its speed with less acceleration, along the course, either way.
    The figures beside the dots are those of `marks`, (speed [m/s], acceleration [m/s2]) each.
    """
    n = len(map.edges)
    figure = Figure(figsize=(1.6 + 6.2 * n, 10.6), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, n, height_ratios=(5, 4))
    most = max(float(np.nanmax(edge.yaw_rate, initial=1e-3)) for edge in map.edges.values())
    color = ScalarMappable(Normalize(0.0, most), "viridis")
    panels: list[Axes] = []
    for i, name in enumerate(map.edges):
        panels.append(figure.add_subplot(grid[0, i], sharey=panels[0] if panels else None))
        _panel(panels[-1], map, name, color)
        _marks(panels[-1], map.edges[name], marks)
    panels[0].set_ylabel("|acceleration| up to [m/s²]")
    decay = f", decay {map.rate:g} 1/s" if map.rate else ""
    figure.colorbar(color, ax=panels, label=f"proven up to this yaw rate [rad/s]{decay}", pad=0.01)
    _profile(figure.add_subplot(grid[1, :]), map, marks)
    figure.legend(
        handles=_legend(map.rate), loc="outside upper center", ncols=2 if n < 2 else 4, frameon=False
    )
    return figure


def _panel(ax: Axes, map: Map, name: str, color: ScalarMappable) -> None:
    """Colours of one gain, rays of equal yaw rate, where no proof can exist, where the tyres end."""
    edge, right, top = map.edges[name], float(map.speeds[-1]), float(map.accelerations[-1])
    low, high = color.get_clim()
    values = map.yaw_rates[name]
    ax.pcolormesh(map.speeds, map.accelerations, values, vmin=low, vmax=high, shading="nearest")
    levels = np.arange(LEVEL, np.nanmax(edge.yaw_rate, initial=0.0), LEVEL)
    for i, level in enumerate(levels):
        _ray(
            ax,
            float(edge.ratio[edge.yaw_rate >= level].max()),
            f"{level:g}",
            (right, top),
            0.94 - 0.07 * (i % 2),
        )
    if np.isfinite(edge.limit):
        x = np.array([0.0, right])
        ax.fill_between(x, edge.limit * x, max(top, edge.limit * right), **HATCH)
        ax.plot(x, edge.limit * x, **LIMIT)
        text = (
            f"no proof can exist:\n|A| / V from {edge.limit:.2f} 1/s" if edge.limit else "no proof can exist"
        )
        ax.annotate(
            text, (0.02, 0.97), xycoords="axes fraction", va="top", size=12, path_effects=HALO, zorder=6
        )
    some = np.flatnonzero(edge.yaw_rate > 0.0)[::4]
    V = GRIP / edge.yaw_rate[some]
    ax.plot(V, edge.ratio[some] * V, **TYRES, color="w", path_effects=DARK, zorder=4)
    ax.set_title(f"{name}: L = {', '.join(f'{g:g}' for g in edge.gain)}", loc="left")
    ax.set(xlim=(0.0, right), ylim=(0.0, top), xlabel="speed from [m/s]")


def _ray(ax: Axes, ratio: float, label: str, corner: tuple[float, float], place: float) -> None:
    """Line of one acceleration / speed, with its yaw rate at a share of its length."""
    x = min(corner[0], corner[1] / max(ratio, 1e-9))
    ax.plot([0.0, x], [0.0, ratio * x], color="w", lw=0.8, alpha=0.7, zorder=3)
    look: dict[str, Any] = {"color": "w", "ha": "center", "va": "center", "size": 11, "path_effects": DARK}
    ax.annotate(label, (place * x, place * ratio * x), zorder=5, **look)


def _marks(ax: Axes, edge: Edge, marks: Marks) -> None:
    """The points that are spoken of, with their yaw rates below, or a cross where nothing is proven."""
    for v, a in marks:
        k = float(edge.at(v, a))
        proven = not np.isnan(k)
        ax.plot(v, a, **(DOT if proven else CROSS), zorder=7)
        ax.annotate(
            f"{k:.2f}" if proven else "none",
            (v, a),
            (0, -8 if proven else 8),
            textcoords="offset points",
            ha="center",
            va="top" if proven else "bottom",
            weight="bold",
            path_effects=HALO,
            zorder=8,
        )


def _profile(ax: Axes, map: Map, marks: Marks) -> None:
    """Largest proven yaw rate over acceleration / speed, and where a state alone is unstable."""
    stable = {name: edge for name, edge in map.edges.items() if edge.limit > 0.0}
    for color, (name, edge) in zip(cycle(COLORS), stable.items(), strict=False):
        _curves(ax, edge, name, color)
    right = 1.08 * max((float(edge.ratio[-1]) for edge in stable.values()), default=1.0)
    ax.set(xlim=(0.0, right), ylim=(0.0, 1.1 * ax.get_ylim()[1]))
    look: dict[str, Any] = {"rotation": 90, "size": 11, "path_effects": HALO}
    for v, a in marks:
        if a < right * v:
            ax.axvline(a / v, color="0.4", lw=0.9, zorder=1.5)
            said = f"V ≥ {v:g} m/s, |A| ≤ {a:g} m/s²"
            ax.annotate(said, (a / v, 0.0), (3, 6), textcoords="offset points", **look)
    ax.set(xlabel="|acceleration| / speed [1/s]", ylabel="yaw rate [rad/s]")
    ax.grid(color="0.93", lw=0.6)
    ax.set_axisbelow(True)
    if stable:
        ax.legend(loc="upper right", framealpha=0.95, ncols=len(stable), fontsize="small")


def _curves(ax: Axes, edge: Edge, name: str, color: str) -> None:
    """Of one gain; both fall to 0 at its limit, if it has one."""
    end = [edge.limit] if np.isfinite(edge.limit) else []
    r, zero = np.append(edge.ratio, end), np.zeros(len(end))
    proven, frozen = np.append(edge.yaw_rate, zero), np.append(edge.frozen, zero)
    ax.plot(r, proven, color=color, lw=2.4, label=f"{name}: proven up to")
    ax.fill_between(r, 0.0, proven, color=color, alpha=0.12, lw=0.0)
    known = np.isfinite(frozen)
    ax.plot(r[known], frozen[known], color=color, ls=(0, (4, 3)), label=f"{name}: no proof can exist from")


def _legend(rate: float) -> list[Any]:
    what = f"slower than {rate:g} 1/s" if rate else "unstable"
    return [
        Line2D([], [], ls="none", label="proven up to [rad/s]", **DOT),
        Line2D([], [], ls="none", label="refused", **CROSS),
        Patch(label=f"frozen matrix {what}", **HATCH),
        Line2D([], [], color="0.3", label=f"right of it, every turn up to {GRIP:g} m/s² sideways", **TYRES),
    ]
