"""Pictures of a robot that is looked for: walls with poses and rays, errors over time, where it can be seen.

Figures are made without pyplot, as in `plots`. The first are of the kind of Cedervall and Hu's Fig. 2 to 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from outrider.geometry import wrap
from outrider.plots import DPI, HALO, LINES, TEXT, write
from outrider.relocalise import Array, mount, observability
from outrider.relocalise.follow import AMBIGUOUS, LOST, SEARCHING, STATES, TRACKING
from outrider.relocalise.room import Room
from outrider.relocalise.run import Run
from outrider.relocalise.wall import Wall

BANDS = {SEARCHING: "0.90", AMBIGUOUS: "#FBE6B8", TRACKING: "#FFFFFF", LOST: "#F6CDBB"}
INK = {SEARCHING: "0.6", AMBIGUOUS: "#E69F00", TRACKING: LINES[0], LOST: LINES[1]}
TRUE: dict[str, Any] = {"color": "0.1", "lw": 3.0}
LEAST = 1e-12  # a logarithm needs more than nothing
JUMP = 0.05  # a step longer than this share of the room is not driven
OUTCOMES = {
    0: ("lost", LINES[1], "x"),
    1: ("found", LINES[0], "o"),
    2: ("the twin pose found", LINES[4], "^"),
}


def save(run: Run, folder: Path | str) -> list[Path]:
    """Writes room.png and errors.png of a run into the folder; OutputError where it cannot."""
    made = {"room.png": scene(run), "errors.png": over_time(run)}
    for name, figure in made.items():
        write(figure, Path(folder) / name)
    return [Path(folder) / name for name in made]


# ------------------------------------------------------------------ in the room


@rc_context(TEXT)
def scene(run: Run) -> Figure:
    """Wall, true and estimated way and both poses with their rays: at the first estimate, and at the end."""
    figure, axes = _rooms(run.room, 2, 16.0)
    shown, t = np.flatnonzero(np.isfinite(run.way.pose[:, 0])), run.log.t - run.log.t[0]
    if len(shown):
        _moment(axes[0], run, int(shown[0]))
        axes[0].set_title(f"t = {t[shown[0]]:.1f} s: the first estimate")
        _way(axes[1], run)
        _moment(axes[1], run, int(shown[-1]))
        axes[1].set_title(f"the way, and the last estimate, t = {t[shown[-1]]:.1f} s")
    marks: list[Any] = []
    if run.log.truth is not None:
        marks.append(Line2D([], [], **TRUE, marker="o", label="true"))
    for state in np.unique(run.way.state[shown]):
        marks.append(Line2D([], [], color=INK[int(state)], marker="o", lw=2, label=STATES[state]))
    marks.append(Line2D([], [], color="0.6", marker=">", lw=0, label="other poses that fit"))
    figure.legend(handles=marks, loc="outside lower center", ncols=6, frameon=False, fontsize="small")
    return figure


def draw_wall(ax: Axes, wall: Wall) -> None:
    """The wall, dotted where only the curve is closed there, with an equal scale."""
    s = np.linspace(0.0, 2.0 * np.pi, 721)
    r, known = wall.at(np.mod(s, 2.0 * np.pi)).r, wall.known(np.mod(s, 2.0 * np.pi))
    ax.plot(*np.where(known[:, None], r, np.nan).T, color="0.25", lw=3.0, zorder=3)
    ax.plot(*np.where(known[:, None], np.nan, r).T, color="0.5", lw=1.5, ls=":", zorder=3)
    ax.set_aspect("equal")


def draw_robot(
    ax: Axes, room: Room, robot: Array, ranges: Array, angles: Array, look: dict[str, Any]
) -> None:
    """A robot at pose (3,) as an arrow, and what its sensors say, ranges (2,) [m], as rays with a dot."""
    size = 0.07 * room.wall.diameter
    tip = robot[:2] + size * np.array([np.cos(robot[2]), np.sin(robot[2])])
    wide = 1.2 * look["lw"]
    arrow = {"arrowstyle": "-|>", "lw": wide, "color": look["color"], "mutation_scale": 12 + 3 * wide}
    ends: dict[str, Any] = {"xy": tuple(tip), "xytext": tuple(robot[:2]), "zorder": look["zorder"]}
    ax.annotate("", **ends, arrowprops=arrow | {"shrinkA": 0, "shrinkB": 0})
    ax.plot(*robot[:2], marker="o", **look)
    at = mount.sensors(robot, room.mount)
    for range_, angle in zip(ranges, angles, strict=True):
        end = at[:2] + range_ * np.array([np.cos(at[2] + angle), np.sin(at[2] + angle)])
        ax.plot(*np.stack([at[:2], end]).T, marker="o", markevery=[1], **look)


def outline(wall: Wall) -> Array:
    """(n, 2) points of the wall [m]."""
    return np.asarray(wall.at(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)).r)


def _moment(ax: Axes, run: Run, k: int) -> None:
    """True and estimated pose at row k, both with the measured ranges, and the other poses that fit."""
    x, y, theta, _ = run.others[k][1:].T
    arrows: dict[str, Any] = {"width": 0.003, "scale": 28.0, "color": "0.65", "zorder": 4}
    ax.quiver(x, y, np.cos(theta), np.sin(theta), **arrows)
    angles = run.log.angles[k] if run.log.angles is not None else run.room.angles
    if run.log.truth is not None and np.isfinite(run.log.truth[k]).all():
        look = {"color": "0.1", "zorder": 6, "lw": 3.5, "ms": 10}
        draw_robot(ax, run.room, run.log.truth[k], run.log.ranges[k], angles, look)
    look = {"color": INK[int(run.way.state[k])], "zorder": 7, "lw": 1.6, "ms": 5}
    draw_robot(ax, run.room, run.way.pose[k], run.log.ranges[k], angles, look)


def _way(ax: Axes, run: Run) -> None:
    """The true way, broken where the robot was carried, and what was said of it."""
    if run.log.truth is not None:
        x = run.log.truth[:, :2]
        far = np.hypot(*np.diff(x, axis=0).T) > JUMP * run.room.wall.diameter
        ax.plot(*np.insert(x, np.flatnonzero(far) + 1, np.nan, axis=0).T, **TRUE, zorder=3)
    for state, ink in INK.items():
        there = run.way.state == state
        ax.plot(*run.way.pose[there, :2].T, ".", color=ink, ms=4, zorder=5)


# ------------------------------------------------------------------ over time


@rc_context(TEXT)
def over_time(run: Run) -> Figure:
    """Errors of position and heading with their expected size, hypotheses, observability; bands by state."""
    figure = _figure(14.0, 11.0)
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 1.6, 2.2))
    t, error = run.log.t - run.log.t[0], run.errors()
    sigma = np.hypot(run.way.sigma[:, 0], run.way.sigma[:, 1])
    _against(axes[0], t, error[:, 0], sigma, "position [m]", 1e-3)
    _against(axes[1], t, np.rad2deg(error[:, 1]), np.rad2deg(run.way.sigma[:, 2]), "heading [deg]", 1e-2)
    axes[2].set(yscale="log", ylim=(0.7, 1.5 * max(10, run.way.hypotheses.max())), ylabel="hypotheses")
    axes[2].plot(t, np.maximum(run.way.hypotheses, 0.1), color=LINES[3], drawstyle="steps-post")
    axes[3].set(yscale="log", ylim=(1e-4, 2.0))
    axes[3].plot(t, np.maximum(run.way.observability, LEAST), color=LINES[0], lw=1.3)
    axes[3].axhline(observability.WEAK, color="0.4", lw=1.0, ls=":")
    where: dict[str, Any] = {
        "xytext": (4, -4),
        "textcoords": "offset points",
        "va": "top",
        "fontsize": "small",
    }
    axes[3].annotate("weak below", (float(t[0]), observability.WEAK), **where)
    axes[3].set_ylabel("observability\n(least singular value)")
    _bands(axes, t, run.way.state)
    axes[-1].set_xlabel("t [s]")
    axes[-1].set_xlim(float(t[0]), float(t[-1]))
    marks = axes[0].get_legend_handles_labels()[0]
    marks += [Patch(fc=BANDS[s], ec="0.7", label=STATES[s]) for s in np.unique(run.way.state)]
    figure.legend(handles=marks, loc="outside upper center", ncols=6, frameon=False, fontsize="small")
    return figure


def _against(ax: Axes, t: Array, error: Array, sigma: Array, what: str, least: float) -> None:
    """An error over time, where the truth is known, and its expected size, on a logarithm's scale."""
    most = float(np.nanmax(np.concatenate([error, sigma]), initial=10.0 * least))
    ax.set(yscale="log", ylim=(least, 2.0 * most), ylabel=what)
    if np.isfinite(error).any():
        ax.plot(t, np.maximum(error, LEAST), color=LINES[0], lw=1.5, label="error")
    ax.plot(t, np.maximum(sigma, LEAST), color=LINES[2], lw=1.4, ls="--", label="expected (1 sigma)")
    ax.grid(axis="y", alpha=0.4)


def _bands(axes: Sequence[Axes], t: Array, state: Any) -> None:
    edges = np.flatnonzero(np.diff(state)) + 1
    for begin, end in zip([0, *edges], [*edges, len(t) - 1], strict=True):
        for ax in axes:
            ax.axvspan(t[begin], t[end], color=BANDS[int(state[begin])], lw=0, zorder=0)


# ------------------------------------------------------------------ over the room


def save_map(room: Room, v: float, w: float, path: Path | str) -> Path:
    """Writes the map for a robot that drives at v [m/s], w [rad/s]; OutputError where it cannot."""
    twist = mount.twist(np.array(v), np.array(w), room.mount)
    made = observability.over(room, twist, spacing=room.wall.diameter / 70.0, headings=48)
    first, second = np.rad2deg(room.angles)
    about = f"sensors at {first:+.0f} and {second:+.0f} deg, v = {v:g} m/s, w = {w:g} rad/s"
    write(map_of(room, made, about), Path(path))
    return Path(path)


@rc_context(TEXT)
def map_of(room: Room, made: observability.Map, title: str = "") -> Figure:
    """What `observability.over` has: the least and the median of all headings, and the share that is weak."""
    figure, axes = _rooms(room, 3, 19.0)
    fine = LogNorm(1e-3, 1.0)
    parts = (
        (axes[0], made.least, "least of all headings", {"norm": fine, "cmap": "viridis"}),
        (axes[1], made.median, "median of all headings", {"norm": fine, "cmap": "viridis"}),
        (axes[2], made.weak, "share of headings that are weak", {"vmin": 0, "vmax": 1, "cmap": "magma_r"}),
    )
    for ax, values, what, look in parts:
        shown = np.ma.masked_invalid(np.maximum(values, LEAST))
        drawn = ax.pcolormesh(made.x, made.y, shown, shading="nearest", **look)
        drawn.set_clip_path(Polygon(outline(room.wall), transform=ax.transData))
        ax.set_title(what)
        if ax is axes[1]:
            label = "least singular value; weak below 0.01"
            figure.colorbar(drawn, ax=axes[:2], label=label, extend="min", shrink=0.8)
    figure.colorbar(drawn, ax=axes[2], shrink=0.8)
    if title:
        figure.suptitle(title, fontsize="medium")
    return figure


@rc_context(TEXT)
def basin(room: Room, truth: Array, guesses: Array, outcome: Any, title: str = "") -> Figure:
    """From which guesses a pose is found: three panels by error of heading, a mark where each guess began.

    truth (3,) or (n, 3), guesses (n, 3): poses; outcome (n,): 0 lost, 1 found, 2 a twin of it found. Where
    truths differ, guesses are drawn as far from the first truth as they were from their own.
    """
    truth = np.broadcast_to(truth, guesses.shape)
    turn, outcome = np.abs(wrap(guesses[:, 2] - truth[:, 2])), np.asarray(outcome, int)
    figure, axes = _rooms(room, 3, 17.0)
    place = guesses[:, :2] - truth[:, :2] + truth[0, :2]
    for ax, low, high in zip(axes, (0, 60, 120), (60, 120, 181), strict=True):
        within = (turn >= np.deg2rad(low)) & (turn < np.deg2rad(high))
        for kind, (_, ink, mark) in OUTCOMES.items():
            ax.plot(*place[within & (outcome == kind)].T, mark, color=ink, ms=5, alpha=0.75, zorder=4)
        share = float(np.mean(outcome[within] > 0)) if within.any() else float("nan")
        ax.set_title(f"heading wrong by {low} to {min(high, 180)} deg: {100 * share:.0f} %")
        ax.plot(*truth[0, :2], "*", ms=16, color="k", zorder=6, path_effects=HALO)
    marks = [
        Line2D([], [], lw=0, color=c, marker=m, label=w) for k, (w, c, m) in OUTCOMES.items() if k in outcome
    ]
    marks.append(Line2D([], [], lw=0, color="k", marker="*", ms=12, label="truth"))
    figure.legend(handles=marks, loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    if title:
        figure.suptitle(title, fontsize="medium")
    return figure


def _rooms(room: Room, columns: int, width: float) -> tuple[Figure, Any]:
    """A figure with the wall in each of its columns, side by side."""
    wide, tall = np.ptp(outline(room.wall), axis=0)
    figure = _figure(width, float(np.clip(0.95 * width / columns * tall / wide, 3.5, 9.0)) + 1.6)
    axes = figure.subplots(1, columns, sharex=True, sharey=True)
    for ax in axes:
        draw_wall(ax, room.wall)
        ax.set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    return figure, axes


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
