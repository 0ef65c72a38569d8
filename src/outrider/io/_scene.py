"""A frame as things to draw: boxes, arrows, lines and words, in whatever format they are then written.

Frames of reference: `map` (fixed), `base_link` (the rider's body), `laser` (the sensor on it).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from outrider.geometry import corners
from outrider.records import Alert, Array, Frame, Level, Tracks, TrackState
from outrider.settings import Settings
from outrider.threat import predict_arc

MAP, BODY, LASER = "map", "base_link", "laser"
ARC_HORIZON_S, ARC_STEP_S = 3.0, 0.25

Rgba = tuple[float, float, float, float]

# red, green, blue, opacity; Okabe and Ito's palette, which colour-blind readers can tell apart
STATE_COLOR: dict[TrackState, Rgba] = {
    TrackState.TENTATIVE: (0.34, 0.71, 0.91, 0.35),
    TrackState.CONFIRMED: (0.0, 0.45, 0.70, 0.7),
    TrackState.COASTING: (0.80, 0.47, 0.65, 0.6),
    TrackState.STATIC: (0.6, 0.6, 0.6, 0.3),
}
LEVEL_COLOR: dict[Level, Rgba] = {
    Level.NONE: (0.0, 0.62, 0.45, 0.8),
    Level.NOTICE: (0.94, 0.89, 0.26, 0.8),
    Level.CAUTION: (0.90, 0.62, 0.0, 0.9),
    Level.DANGER: (0.84, 0.37, 0.0, 1.0),
}


class Place(NamedTuple):
    """Where something is, and which way it points."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m]
    yaw: float  # [rad]


class Box(NamedTuple):
    """A vehicle's body."""

    place: Place
    size: tuple[float, float, float]  # length, width, height [m]
    color: Rgba


class Arrow(NamedTuple):
    """A velocity: one metre of shaft is one metre a second."""

    place: Place
    shaft: tuple[float, float]  # length, diameter [m]
    head: tuple[float, float]  # length, diameter [m]
    color: Rgba


class Line(NamedTuple):
    """A line on the ground."""

    xy: Array  # (n, 2) [m]
    pixels: float  # how thick
    closed: bool
    color: Rgba


class Text(NamedTuple):
    """Words that face whoever looks."""

    place: Place
    pixels: float  # how high
    color: Rgba
    words: str


class Entity(NamedTuple):
    """What is drawn of one track, or of the rider."""

    name: str
    frame: str
    boxes: tuple[Box, ...] = ()
    arrows: tuple[Arrow, ...] = ()
    lines: tuple[Line, ...] = ()
    texts: tuple[Text, ...] = ()


def nanoseconds(t: float) -> int:
    """Time t [s] as ROS and MCAP count it [ns], exact; before zero, which MCAP cannot hold, it is zero."""
    sec = math.floor(t)
    return max(sec * 1_000_000_000 + round((t - sec) * 1e9), 0)


def links(W_body: Array, mount: Array) -> tuple[tuple[str, str, Place], ...]:
    """Parent, child and place: the body in `map`, the sensor on the body; both (3,) x, y [m], yaw [rad]."""
    (x, y, yaw), (mx, my, turn) = W_body.tolist(), mount.tolist()
    return (MAP, BODY, Place(x, y, 0.0, yaw)), (BODY, LASER, Place(mx, my, 0.0, turn))


def entities(frame: Frame, settings: Settings, scale: float) -> list[Entity]:
    """The rider's footprint and every track.

    frame: lengths of the recording; settings: lengths of the full-size world; scale: their ratio.
    """
    tracks, rider = frame.tracks, settings.rider
    size = np.array([rider.length_m, rider.width_m]) / scale
    outline = corners(np.array([rider.centre_x_m / scale, 0.0, 0.0]), size)
    footprint = Line(outline, 4.0, True, LEVEL_COLOR[frame.alert.level])
    arcs = predict_arc(tracks, ARC_HORIZON_S, ARC_STEP_S)
    ttc = frame.threats.ttc.tolist()
    return [
        Entity("rider", BODY, lines=(footprint,)),
        *(_track(i, tracks, arcs[i], ttc[i], scale) for i in range(len(ttc))),
    ]


def _track(i: int, tracks: Tracks, arc: Array, ttc: float, scale: float) -> Entity:
    """Box, arrow, predicted path and label of track i; all but the box only where it may move."""
    x, y = tracks.W_p[i].tolist()
    length, width = tracks.extent[i].tolist()
    state, speed = TrackState(int(tracks.state[i])), float(tracks.speed[i])
    color, height, name = STATE_COLOR[state], 1.5 / scale, f"track {int(tracks.id[i])}"
    box = Box(Place(x, y, 0.5 * height, float(tracks.yaw[i])), (length, width, height), color)
    if state is TrackState.STATIC:
        return Entity(name, MAP, boxes=(box,))
    way = float(tracks.course[i]) + (math.pi if speed < 0.0 else 0.0)
    arrow = Arrow(Place(x, y, height, way), (abs(speed), 0.15 / scale), (0.5 / scale, 0.4 / scale), color)
    label = f"{int(tracks.id[i])}  {abs(speed):.1f} m/s" + (f"  {ttc:.1f} s" if math.isfinite(ttc) else "")
    text = Text(Place(x, y, 1.4 * height, 0.0), 14.0, (*color[:3], 1.0), label)
    return Entity(name, MAP, (box,), (arrow,), (Line(arc[:, :2], 2.0, False, color),), (text,))


def say(alert: Alert) -> str:
    """The alert in words, one line."""
    text = alert.level.name.lower()
    if alert.track >= 0:
        text += f": track {alert.track}" + (f" in {alert.ttc:.1f} s" if np.isfinite(alert.ttc) else "")
    return text + (f" (degraded: {', '.join(alert.degraded)})" if alert.degraded else "")
