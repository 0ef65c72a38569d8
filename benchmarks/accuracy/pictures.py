"""The picture of docs/comparison.md: how the methods rank on each set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.accuracy.methods import PEERS
from benchmarks.accuracy.report import GOALS, SHORT, chosen
from benchmarks.accuracy.table import Row
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, RED, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
KINDS = (
    ("position only", BLUE, "o"),
    ("with the rectangle's heading", RED, "s"),
    ("with the heading, two samples later", GREEN, "^"),
)
WIDEST = 2.6  # the axis ends at this many times the best without a lag


def save(rows: Sequence[Row], folder: Path) -> None:
    """comparison.png: for each set a panel, for each method a line, a dot for each kind of variant."""
    figure = Figure(figsize=(12.0, 11.0))
    FigureCanvasAgg(figure)
    figure.subplots_adjust(0.13, 0.05, 0.98, 0.93, wspace=0.58, hspace=0.28)
    axes = figure.subplots(3, 3)
    for name, ax in zip(SHORT, axes.flat, strict=True):
        _panel(ax, chosen(rows, name), name)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), frameon=False)
    figure.savefig(folder / "comparison.png", dpi=110, metadata={"Software": ""})


def _panel(ax: Axes, scores: Mapping[str, Mapping[int, float]], name: str) -> None:
    """scores: J by method and kind; what lies beyond the axis is drawn at its end."""
    ax.set_title(SHORT[name].rstrip(" *"), fontsize=10)
    causal = {who: min(v for k, v in of.items() if k < 2) for who, of in scores.items()}
    order = sorted(causal, key=lambda who: -causal[who])
    if not order:
        return
    end = WIDEST * causal[order[-1]]
    for i, who in enumerate(order):
        shown = [min(v, end) for v in scores[who].values()]
        ax.plot([min(shown), max(shown)], [i, i], color=GREY, lw=0.8, zorder=0)
    for kind, (text, colour, mark) in enumerate(KINDS):
        at = [(scores[who][kind], i) for i, who in enumerate(order) if kind in scores[who]]
        near = [(J, i) for J, i in at if not end < J]
        ax.plot([J for J, _ in near], [i for _, i in near], mark, color=colour, ms=6, label=text)
        far = [i for J, i in at if end < J]
        ax.plot([end] * len(far), far, ">", color=colour, ms=6, mfc="none", clip_on=False)
    if name in GOALS:
        ax.axvline(
            sum(f * v for f, v in zip((1.0, 5.0), GOALS[name], strict=True)), color=GREY, ls="--", lw=1.0
        )
    ax.set_xlim(0.0, end)
    ax.set_yticks(range(len(order)), [who.replace("_", " ") for who in order], fontsize=8)
    for tick, who in zip(ax.get_yticklabels(), order, strict=True):
        tick.set_color(GREY if who in PEERS else "black")
    ax.set_xlabel("J = velocity [m/s] + 5 yaw [rad]", fontsize=8)
    ax.tick_params(axis="x", labelsize=7)
    ax.grid(axis="x", color="#dddddd", lw=0.5)
