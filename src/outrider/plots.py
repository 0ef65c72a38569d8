"""Pictures of a run: the scene from above, and the tracks against time.

Figures are made without pyplot: no window opens, nothing is kept between calls. Colours are Okabe and Ito's
palette and viridis, which colour-blind readers can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from outrider import plots_bounds
from outrider.errors import OutputError
from outrider.geometry import corners
from outrider.metrics import Truth
from outrider.records import Array, Bools
from outrider.settings import Settings

SIZE_INCH, DPI = (16.0, 12.0), 100
MOVING_S = 0.5  # a track confirmed as moving for less is drawn faintly
FRAME = (0.065, 0.06, 0.83, 0.895)  # of the scene in its figure: left, bottom, width, height
SHAPE = 16.0 * FRAME[2] / (12.0 * FRAME[3])  # width / height
GAP_S = 0.3  # a line is broken over a longer gap
MOST = 12  # tracks in a diagram against time
LEVELS = {"notice": "#F0E442", "caution": "#E69F00", "danger": "#D55E00"}
LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255")
STYLES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (1, 1)))
TRUTH: dict[str, Any] = {"color": "k", "lw": 1.2, "ls": (0, (3, 3))}
TEXT: dict[str, Any] = {"font.size": 13.0}
HALO = [patheffects.withStroke(linewidth=3.0, foreground="white")]


class _Run(Protocol):
    """What is drawn: a run folder that was read."""

    @property
    def settings(self) -> Settings: ...
    @property
    def tracks(self) -> Any: ...
    @property
    def scans(self) -> Any: ...
    @property
    def alerts(self) -> list[dict[str, Any]]: ...
    @property
    def background(self) -> Array: ...


class _Way(NamedTuple):
    """One track over its life, in order of time."""

    id: int
    c: dict[str, Any]  # the columns of tracks.parquet, (n,) each
    moving: Bools  # (n,) confirmed or coasting
    confirmed_s: float  # how long it was confirmed as moving

    @property
    def p(self) -> Array:
        return np.column_stack([self.c["x"], self.c["y"]])

    @property
    def boxes(self) -> Array:
        pose = np.column_stack([self.c["x"], self.c["y"], self.c["yaw"]])
        return corners(pose, np.column_stack([self.c["length"], self.c["width"]]))


def save(run: _Run, folder: Path | str, truth: Mapping[str, Truth] | None = None) -> tuple[Path, Path]:
    """Writes scene.png and tracks.png, 1600 x 1200 points each; OutputError where it cannot."""
    pictures = (
        (Path(folder) / "scene.png", scene(run, truth)),
        (Path(folder) / "tracks.png", tracks(run, truth)[0]),
    )
    for path, ax in pictures:
        write(_root(ax), path)
    return pictures[0][0], pictures[1][0]


def write(figure: Any, path: Path) -> None:
    """Writes a figure as a picture; OutputError where it cannot."""
    try:
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise OutputError(f"{path}: cannot write ({error.strerror or error}); free some space") from error


# ------------------------------------------------------------------ from above


@rc_context(TEXT)
def scene(run: _Run, truth: Mapping[str, Truth] | None = None, ax: Axes | None = None) -> Axes:
    """The run from above, in the fixed frame [m]; drawn into `ax`, or into a figure of its own.

    Ways are coloured by time, with a box and an arrow (the way of half a second) now and then; alerts stand
    where their track was. truth: bodies whose true way is drawn too, by name.
    """
    ax = _figure(None).add_axes(FRAME) if ax is None else ax
    ways = _ways(run)
    strong = [w for w in ways if w.confirmed_s > MOVING_S]
    ego = np.column_stack([run.scans["ego_x"].to_numpy(), run.scans["ego_y"].to_numpy()])
    t = run.scans["t"].to_numpy()
    start, end = (float(t.min()), float(t.max())) if len(t) else (0.0, 0.0)
    color = ScalarMappable(Normalize(0.0, max(end - start, 1e-3)), "viridis")
    _limits(ax, [ego, *(w.p[w.moving] for w in strong)], run)
    ax.plot(*run.background.T, ".", ms=2.8, mfc="0.62", mec="none", zorder=1)
    _at_rest(ax, ways)
    for way in ways:
        if way.moving.any() and way.confirmed_s <= MOVING_S:
            ax.plot(*way.p[way.moving].T, color="0.6", lw=0.8, zorder=2)
    for body in (truth or {}).values():
        ax.plot(*body.W_p.T, **TRUTH, zorder=6)
    for way in strong:
        _draw_way(ax, way, start, color)
    _draw_rider(ax, run, ego)
    told = _draw_alerts(ax, run, ways)
    _label(ax, strong, ego)
    ax.set(xlabel="x [m]", ylabel="y [m]", title=_title(run, strong, end - start))
    handles = _scene_legend(told, bool(truth)) + plots_bounds.legend(run.tracks)
    ax.legend(handles=handles, loc="upper right", framealpha=0.95).set_zorder(20)
    bar = ax.inset_axes((1.015, 0.0, 0.02, 1.0))
    _root(ax).colorbar(color, cax=bar, label="time from the start [s]")
    return ax


def _figure(layout: Literal["constrained"] | None) -> Figure:
    figure = Figure(figsize=SIZE_INCH, dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def _root(ax: Axes) -> Any:
    """The figure that holds the axes."""
    return ax.get_figure(root=True)


def _outlines(boxes: Any, **look: Any) -> PolyCollection:
    """Rectangles, boxes (n, 4, 2)."""
    return PolyCollection(boxes, **look)


def _ways(run: _Run) -> list[_Way]:
    columns = {name: run.tracks[name].to_numpy() for name in run.tracks.column_names}
    order = np.lexsort([columns["t"], columns["track_id"]])
    columns = {name: values[order] for name, values in columns.items()}
    ids, starts = np.unique(columns["track_id"], return_index=True)
    ways: list[_Way] = []
    for i, first, last in zip(ids, starts, [*starts[1:], len(order)], strict=False):
        c = {name: values[first:last] for name, values in columns.items()}
        confirmed = c["state"] == "confirmed"
        steps = np.minimum(np.diff(c["t"], prepend=c["t"][0]), GAP_S)
        moving = confirmed | (c["state"] == "coasting")
        ways.append(_Way(int(i), c, moving, float(steps[confirmed].sum())))
    return ways


def _limits(ax: Axes, places: Sequence[Array], run: _Run) -> None:
    """Room for all places, and for what stands around them, on equal axes."""
    p = np.vstack(places)
    p = p[np.isfinite(p).all(axis=1)]
    if not len(p):
        p = np.zeros((1, 2))
    room = 8.0 / run.settings.recording.scale
    low, high = p.min(axis=0) - room, p.max(axis=0) + room
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    half = np.maximum(half, half[::-1] * [SHAPE, 1.0 / SHAPE])
    ax.set_xlim(centre[0] - half[0], centre[0] + half[0])
    ax.set_ylim(centre[1] - half[1], centre[1] + half[1])
    ax.set_aspect("equal", adjustable="box")
    ax.grid(color="0.93", lw=0.6)
    ax.set_axisbelow(True)


def _at_rest(ax: Axes, ways: Iterable[_Way]) -> None:
    """The last box of every track that stood for longer than it moved."""
    boxes = [w.boxes[w.c["state"] == "static"][-1:] for w in ways if w.confirmed_s <= MOVING_S]
    ax.add_collection(
        _outlines(np.vstack([np.zeros((0, 4, 2)), *boxes]), facecolors="none", edgecolors="0.5", zorder=2)
    )


def _draw_way(ax: Axes, way: _Way, start: float, color: ScalarMappable) -> None:
    t, p = way.c["t"] - start, way.p
    whole = way.moving[1:] & way.moving[:-1] & (np.diff(t) < GAP_S)
    lines = LineCollection(np.stack([p[:-1], p[1:]], 1)[whole], lw=2.2, zorder=5)
    lines.set_color(color.to_rgba(t[1:][whole]))
    ax.add_collection(lines)
    rows = np.flatnonzero(way.moving)
    some = rows[:: max(len(rows) // 7, 1)]
    shade = color.to_rgba(t[some])
    ax.add_collection(_outlines(way.boxes[some], facecolors="none", edgecolors=shade, lw=1.2, zorder=4))
    plots_bounds.around(ax, way.c, some, shade)
    ax.quiver(
        *p[some].T,
        0.5 * way.c["vx"][some],
        0.5 * way.c["vy"][some],
        color=shade,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.0022,
        zorder=6,
    )
    ends = p[rows[[0, -1]]]
    for place, marker, when in zip(ends, "os", rows[[0, -1]], strict=True):
        ax.plot(*place, marker, ms=7, mfc=color.to_rgba(t[when]), mec="white", mew=1.0, zorder=7)


def _draw_rider(ax: Axes, run: _Run, ego: Array) -> None:
    """The rider's way, and the footprint at its end."""
    if not len(ego):
        return
    ax.plot(*ego.T, color="k", lw=1.5, zorder=3)
    ax.plot(*ego[0], "o", ms=7, mfc="k", mec="white", zorder=7)
    rider, scale = run.settings.rider, run.settings.recording.scale
    yaw = run.scans["ego_yaw"].to_numpy()[-1]
    centre = ego[-1] + rider.centre_x_m / scale * np.array([np.cos(yaw), np.sin(yaw)])
    size = np.array([rider.length_m, rider.width_m]) / scale
    box = corners(np.array([*centre, yaw]), size)
    ax.add_collection(_outlines(box[None], facecolors="k", edgecolors="white", zorder=7))


def _draw_alerts(ax: Axes, run: _Run, ways: Iterable[_Way]) -> list[str]:
    """A mark where the track of an alert was when its level was reached; returns the levels that were."""
    known = {way.id: way for way in ways}
    before, told = (None, "none"), set()
    for alert in run.alerts:
        level, way = alert["level"], known.get(alert["track_id"])
        if level in LEVELS and way and (alert["track_id"], level) != before:
            place = way.p[np.abs(way.c["t"] - alert["t"]).argmin()]
            ax.plot(*place, "^", ms=13, mfc=LEVELS[level], mec="k", mew=1.0, zorder=9)
            told.add(level)
        before = (alert["track_id"], level)
    return [level for level in LEVELS if level in told]


def _label(ax: Axes, ways: Sequence[_Way], ego: Array) -> None:
    """Names at the ends of the ways, moved aside until none covers another."""
    renderer = RendererAgg(*_root(ax).bbox.size, _root(ax).dpi)
    ends = [(f"track {w.id}", w.p[w.moving][-1]) for w in ways]
    if len(ego):
        ends.append(("rider", ego[-1]))
    if not ends:
        return
    _root(ax).draw_without_rendering()
    busy = np.vstack([*(w.p[w.moving][:: max(len(w.p) // 40, 1)] for w in ways), *(p[None] for _, p in ends)])
    leader = {"arrowstyle": "-", "color": "0.3", "lw": 0.8, "shrinkA": 0.0, "shrinkB": 4.0}
    taken = [Bbox.from_bounds(x - 7, y - 7, 14, 14) for x, y in ax.transData.transform(busy)]
    for name, place in ends:
        if not ax.viewLim.contains(*place):
            continue
        text = ax.annotate(
            name,
            place,
            (0, 0),
            textcoords="offset points",
            arrowprops=leader,
            weight="bold",
            path_effects=HALO,
            zorder=12,
        )
        for far, (dx, dy) in product((12, 26, 42, 60), ((1, 1), (1, -1), (-1, 1), (-1, -1))):
            text.set_position((dx * far, dy * far))
            text.set(ha="left" if dx > 0 else "right", va="center")
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer).padded(2.0)  # without its line
            if (
                ax.bbox.fully_containsx(box.x0)
                and ax.bbox.fully_containsx(box.x1)
                and not box.count_overlaps(taken)
            ):
                break
        taken.append(box)


def _title(run: _Run, strong: Sequence[_Way], duration: float) -> str:
    counts = {level: sum(a["level"] == level for a in run.alerts) for level in LEVELS}
    said = ", ".join(f"{n} {level}" for level, n in counts.items() if n) or "no alert"
    return f"{duration:.1f} s, {len(strong)} moving track{'s' * (len(strong) != 1)}; {said}"


def _scene_legend(told: Sequence[str], truth: bool) -> list[Any]:
    plain: dict[str, Any] = {"color": "none", "mec": "0.3", "mfc": "0.3", "ms": 7}
    handles: list[Any] = [
        Line2D([], [], color="k", lw=1.5, label="rider"),
        Line2D([], [], marker="o", label="start", **plain),
        Line2D([], [], marker="s", label="end of a track", **plain),
        Patch(fc="none", ec="0.5", label="stands"),
        Line2D([], [], color="none", marker=".", mfc="0.62", mec="none", ms=8, label="background"),
    ]
    if truth:
        handles.append(Line2D([], [], label="truth", **TRUTH))
    for level in told:
        handles.append(
            Line2D([], [], color="none", marker="^", mfc=LEVELS[level], mec="k", ms=12, label=level)
        )
    return handles


# ------------------------------------------------------------------ against time


@rc_context(TEXT)
def tracks(
    run: _Run, truth: Mapping[str, Truth] | None = None, figure: Figure | None = None
) -> tuple[Axes, Axes, Axes]:
    """Speed, course and time to collision of every track that moved, against time; truth is dashed, in black.

    Bands say which alert was given. Of many tracks, the ones that moved longest are drawn.
    """
    figure = _figure("constrained") if figure is None else figure
    speed, course, ttc = axes = figure.subplots(3, 1, sharex=True)
    t = run.scans["t"].to_numpy()
    start, end = (float(t.min()), float(t.max())) if len(t) else (0.0, 0.0)
    moved = sorted((w for w in _ways(run) if w.confirmed_s > MOVING_S), key=lambda w: -w.confirmed_s)
    for i, way in enumerate(sorted(moved[:MOST], key=lambda w: w.id)):
        look = {"color": LINES[i % len(LINES)], "ls": STYLES[i // len(LINES) % len(STYLES)], "lw": 1.8}
        shown = np.where(way.moving, 1.0, np.nan)
        when, c = way.c["t"] - start, way.c
        speed.plot(*_broken(when, shown * c["speed"]), label=f"track {way.id}", **look)
        course.plot(*_broken(when, shown * np.degrees(c["course"]), 180.0), **look)
        ttc.plot(
            *_broken(when, shown * np.where(np.isfinite(c["ttc"]), c["ttc"], np.nan)),
            marker=".",
            ms=3,
            **look,
        )
    for body in (truth or {}).values():
        v = np.hypot(*body.W_v.T)
        slow = v < 0.05 * np.nanmax(v, initial=0.0)
        speed.plot(body.t - start, v, **TRUTH, zorder=5)
        direction = np.where(slow, np.nan, np.degrees(np.arctan2(body.W_v[:, 1], body.W_v[:, 0])))
        course.plot(*_broken(body.t - start, direction, 180.0), **TRUTH, zorder=5)
    _bands(axes, run, start, end)
    _dress(run, speed, course, ttc, len(moved), bool(truth))
    for i, way in enumerate(sorted(moved[:MOST], key=lambda w: w.id)):
        plots_bounds.beside(axes, way.c["t"] - start, way.c, way.moving, LINES[i % len(LINES)])
    speed.set_xlim(0.0, max(end - start, 1e-3))
    return speed, course, ttc


def _broken(t: Array, y: Array, jump: float = np.inf) -> tuple[Array, Array]:
    """The line with a hole wherever time jumps by more than GAP_S, or the value by more than `jump`."""
    with np.errstate(invalid="ignore"):
        cut = np.flatnonzero((np.diff(t) > GAP_S) | (np.abs(np.diff(y)) > jump)) + 1
    return np.insert(t, cut, np.nan), np.insert(y, cut, np.nan)


def _bands(axes: Sequence[Axes], run: _Run, start: float, end: float) -> None:
    times = [a["t"] for a in run.alerts] + [end]
    for alert, until in zip(run.alerts, times[1:], strict=True):
        if alert["level"] in LEVELS:
            for ax in axes:
                ax.axvspan(
                    alert["t"] - start, until - start, color=LEVELS[alert["level"]], alpha=0.3, lw=0, zorder=0
                )


def _dress(run: _Run, speed: Axes, course: Axes, ttc: Axes, moved: int, truth: bool) -> None:
    ladder, horizon = run.settings.alert, run.settings.threat.horizon_s
    for level in LEVELS:
        ttc.axhline(getattr(ladder, f"{level}_s"), color="0.4", lw=0.8, ls=":")
        ttc.annotate(
            level, (1.0, getattr(ladder, f"{level}_s")), (4, 0), xycoords=("axes fraction", "data"),
            textcoords="offset points", va="center", color="0.3",
        )  # fmt: skip
    low, high = speed.get_ylim()
    speed.set(ylabel="speed [m/s]", ylim=(min(low, 0.0), high))
    course.set(ylabel="course [deg]", ylim=(-185.0, 185.0), yticks=range(-180, 181, 90))
    ttc.set(ylabel="time to collision [s]", xlabel="time from the start [s]", ylim=(0.0, horizon))
    for ax in (speed, course, ttc):
        ax.grid(color="0.9", lw=0.6)
        ax.set_axisbelow(True)
    handles = speed.get_legend_handles_labels()[0]
    if truth:
        handles.append(Line2D([], [], label="truth", **TRUTH))
    told = {a["level"] for a in run.alerts}
    handles += [Patch(color=c, alpha=0.3, lw=0, label=level) for level, c in LEVELS.items() if level in told]
    handles += plots_bounds.legend(run.tracks)
    if handles:
        speed.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.01), ncols=8, frameon=False)
    if moved > MOST:
        speed.annotate(
            f"{MOST} of {moved} tracks", (0.99, 0.97), xycoords="axes fraction", ha="right", va="top"
        )
