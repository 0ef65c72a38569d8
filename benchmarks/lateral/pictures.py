"""The pictures of docs/lateral-validation.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from benchmarks.lateral import cases, table
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from outrider import plots_lateral
from outrider.lateral import Array, course

DPI = 80
CHOSEN = (0, 2, 4, 7)  # of `cases.METHODS`: fixed, combined, scheduled, Kalman
PICTURES = {  # file -> truth, drive, noise, from, to [s]
    "lateral-dry": ("multibody", "dry", "paper", (0.0, 360.0)),
    "lateral-friction": ("drift", "0.5, sliding", "paper", (225.0, 385.0)),
    "lateral-d-class": ("multibody", "D class", "paper", (200.0, 360.0)),
}


def save(folder: Path) -> None:
    """The course; the estimates against time on three drives; the errors over speed and ay."""
    _save(_course(), folder / "lateral-course.png")
    for name, (truth, ride, noise, span) in PICTURES.items():
        log, estimates = _judged(truth, ride, noise)
        title = f"{ride}, truth: {truth}, noise: {noise}"
        _save(plots_lateral.over_time(log, estimates, span=span, title=title), folder / f"{name}.png")
    log, estimates = _judged("multibody", "dry", "mems")
    figure = plots_lateral.over_ranges(log, estimates, title="dry, truth: multibody, noise: mems")
    _save(figure, folder / "lateral-ranges.png")


def _judged(truth: str, name: str, noise: str) -> tuple[object, dict[str, Array]]:
    ride = next(r for r in cases.DRIVES if r.name == name)
    chosen = [m for i in CHOSEN if (m := cases.METHODS[i]) in cases.methods()]
    estimates = {m.label.replace("`", ""): table.estimate(m, truth, ride, noise) for m in chosen}
    return cases.log_of(truth, ride, noise), estimates


def _course() -> Figure:
    """The line, coloured by the planned speed, and the plan along the way."""
    road = cases.way("Hungaroring")
    speed = course.plan(road)
    figure = Figure(figsize=(14.0, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    above, along = figure.subplots(1, 2, width_ratios=(1, 1.4))
    line = np.column_stack([road.x, road.y])
    parts = LineCollection(np.stack([line[:-1], line[1:]], 1), array=speed[:-1], cmap="viridis", lw=3)
    above.add_collection(parts)
    above.autoscale()
    above.set_aspect("equal")
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    figure.colorbar(parts, ax=above, label="planned speed [m/s]", shrink=0.8)
    s = road.step * np.arange(len(speed))
    along.plot(s, speed, color="0.25", lw=1.5)
    along.set_xlabel("way [m]")
    along.set_ylabel("planned speed [m/s]")
    other = along.twinx()
    other.plot(s, speed**2 * road.curvature, color="#0072B2", lw=1.0)
    other.set_ylabel("speed² curvature [m/s2]", color="#0072B2")
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=DPI, metadata={"Software": ""})
