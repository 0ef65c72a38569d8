"""The picture of docs/relocalise-real.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.relocalise_real import recordings, study
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from outrider.plots import LINES, TEXT, write
from outrider.plots_relocalise import draw_wall
from outrider.relocalise import Array, mount
from outrider.relocalise.follow import TRACKING
from outrider.relocalise.log import Log
from outrider.relocalise.room import Room
from outrider.relocalise.run import run


@rc_context(TEXT)
def save(data: Path, path: Path, name: str = "parallel") -> None:
    """One run of the car: the room with what the two beams hit, and the errors over time."""
    room = recordings.room()
    log = recordings.car(recordings.turns(data, name))
    known = study.KNOWN | {"gate": study.GATE}
    ways = {
        "odometry alone": (study.followed(study.blind(log), room, "pose_ekf", known)[0], LINES[1]),
        "ranges too, start given": (study.followed(log, room, "pose_ekf", known)[0], LINES[0]),
    }
    made = run(log, room, None, gains={"gate": study.GATE})
    sure = np.where((made.way.state == TRACKING)[:, None], made.way.pose, np.nan)
    ways["ranges too, no start"] = (sure, LINES[2])
    figure = Figure(figsize=(15.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    above, over = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    _room(above, log, room, ways)
    over.set(xlabel="t [s]", ylabel="position error [m]", ylim=(0.0, 0.4), xlim=(0.0, float(log.t[-1])))
    for pose, ink in ways.values():
        over.plot(log.t, np.hypot(*(pose - log.truth)[:, :2].T), color=ink, lw=1.8)
    over.grid(alpha=0.4)
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    write(figure, path)


def _room(ax: Axes, log: Log, room: Room, ways: dict[str, tuple[Array, Any]]) -> None:
    """The wall, the ways and the ends of the beams as seen from the true pose."""
    draw_wall(ax, room.wall)
    at = mount.sensors(log.truth, room.mount)
    bearing = at[:, 2:] + log.angles
    ends = at[:, None, :2] + log.ranges[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    of_wall = np.isfinite(study.cleaned(log, room).ranges)
    ax.plot(*ends[of_wall].T, "o", color="0.45", ms=3.5, label="range of the wall")
    ax.plot(*ends[~of_wall].T, "x", color=LINES[4], ms=5.0, label="stray, or of an unknown side")
    ax.plot(*log.truth[:, :2].T, color="0.1", lw=4.0, label="true")
    for label, (pose, ink) in ways.items():
        ax.plot(*pose[:, :2].T, color=ink, lw=1.8, label=label)
    ax.set(xlabel="x [m]", ylabel="y [m]", xlim=(-5.6, 5.4), ylim=(-4.6, 3.0))
