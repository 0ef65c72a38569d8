"""The currencies of the project: frozen columns, with shape, unit and frame on the line.

Frames: S sensor, B the rider's body (x forward, y left, origin where the ego pose is measured), W fixed.
The letter before an underscore names the frame a quantity is expressed in.

Two groups: what a sensor or a recording gives (`LaserScan`, `Pose`, `Turn`, `Raw`, `Trouble`), not repaired;
and what the pipeline makes of it (`Scan`, `Detections`, `Tracks`, `Threats`, `Alerts`, `Frame`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Float32s = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]

# ------------------------------------------------------------------ what a recording holds


@dataclass(frozen=True, slots=True)
class LaserScan:
    """One message of a scanner as it was recorded (field for field a ROS LaserScan); nothing repaired."""

    topic: str
    frame: str  # name of the sensor's frame
    stamp_ns: int  # header stamp, time of the first beam if the driver is right [ns]
    received_ns: int  # when the recorder got it [ns]
    angle_min: float  # angle of beam 0 in S [rad]
    angle_increment: float  # [rad]
    time_increment: float  # between beams, negative where beams are stored against time [s]
    scan_time: float  # of one turn [s]
    range_min: float  # [m]
    range_max: float  # [m]
    ranges: Float32s  # (n,) [m], with whatever the driver writes for "no return"
    intensities: Float32s  # (n,) or (0,) when the sensor has none


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a body was: of the rider (ego) or of a target whose truth is known."""

    topic: str
    frame: str  # name of the fixed frame
    body: str  # name of the body, "" where the recording does not say
    stamp_ns: int  # [ns]
    received_ns: int  # [ns]
    position: Array  # (3,) [m]
    quaternion: Array  # (4,) x, y, z, w
    extent: Array  # (2,) length, width of the body's rectangle centred here [m]; (0,) where unknown

    @property
    def xyyaw(self) -> Array:
        """(3,) x [m], y [m], yaw [rad] of the body in the fixed frame."""
        x, y, z, w = self.quaternion
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.array([self.position[0], self.position[1], yaw])


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of a live scanner, beam by beam in the order of time; nothing but lost beams is left out."""

    beam_t: Array  # (n,) time of each beam, clock of the host [s]
    angle: Array  # (n,) in S, counter-clockwise [rad]
    range: Float32s  # (n,) [m]; 0: no return
    quality: Float32s  # (n,) strength of the return, in the sensor's own unit
    range_min: float  # [m]
    range_max: float  # [m]
    received: float  # when its last byte came, clock of the host [s]
    faults: tuple[str, ...]  # what was lost or mended on the way, in words


@dataclass(frozen=True, slots=True)
class Raw:
    """Bytes as they came from a live sensor; for those who record."""

    received: float  # clock of the host [s]
    data: bytes


@dataclass(frozen=True, slots=True)
class Trouble:
    """What keeps a live sensor from giving turns, from now on."""

    t: float  # clock of the host [s]
    words: str  # one line: what is wrong, and what to do where somebody can do something


# ------------------------------------------------------------------ what the pipeline makes of it


@dataclass(frozen=True, slots=True)
class Ego:
    """The rider at one instant, fixed frame W."""

    t: float  # [s]
    W_pose: Array  # (3,) x, y, yaw [m, m, rad]
    W_v: Array  # (2,) velocity [m/s]
    yaw_rate: float  # [rad/s]
    known: bool  # False where there is no ego pose and the sensor is taken as standing


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn of the lidar, repaired; row i is beam i."""

    t: float  # time of the last beam in time [s], the recording's own clock
    beam_t: Array  # (n,) time of each beam [s]
    angle: Array  # (n,) in S [rad]
    range: Array  # (n,) [m]; NaN exactly where `valid` is False
    valid: Bools  # (n,)
    intensity: Float32s  # (n,) or (0,)
    range_max: float  # [m]
    W_sensor: Array  # (n, 3) pose of the sensor at the time of each beam
    W_p: Array  # (n, 2) returns [m]; NaN exactly where `valid` is False
    ego: Ego  # at t
    masked: dict[str, int]  # how many beams were masked, by reason
    faults: tuple[str, ...]  # what was wrong with this scan and how it was repaired, in words


class Kind(IntEnum):
    """What a detection looks like before it is tracked."""

    VEHICLE = 0  # size of something that may be a road user
    SMALL = 1  # too few returns or too small
    LARGE = 2  # wall, building: larger than any road user
    STATIC = 3  # lies where the world has been occupied for long


@dataclass(frozen=True, slots=True)
class Detections:
    """Objects seen in one scan; row i is object i; fixed frame W."""

    t: float  # time of the scan [s]
    hit_t: Array  # (n,) mean time of the object's returns [s]
    W_p: Array  # (n, 2) centre of the rectangle [m]
    heading: Array  # (n,) of the rectangle's length axis [rad]; directed only where `track` >= 0
    extent: Array  # (n, 2) length, width [m]: as far as seen; the known size where fitted to a track
    cov: Array  # (n, 3, 3) of x, y, heading
    hits: Ints  # (n,) number of returns
    sides: Ints  # (n,) number of sides of the rectangle that were seen (1 or 2)
    kind: Bytes  # (n,) Kind
    track: Ints  # (n,) id of the track whose rectangle was fitted, -1 for none
    first: Ints  # (n,) index of the first beam
    last: Ints  # (n,) index of the last beam


class TrackState(IntEnum):
    """Life of a track."""

    TENTATIVE = 0
    CONFIRMED = 1  # seen in this scan, and moving
    COASTING = 2  # moving, not seen in this scan, predicted
    STATIC = 3  # known not to move; remembered, not observed


@dataclass(frozen=True, slots=True)
class Tracks:
    """Road users at time t; row i is track i; fixed frame W; same order as `id`, which increases."""

    t: float  # [s]
    id: Ints  # (n,)
    state: Bytes  # (n,) TrackState
    W_p: Array  # (n, 2) body centre [m]
    speed: Array  # (n,) signed along the course axis: negative when reversing [m/s]
    acceleration: Array  # (n,) along the course [m/s2]
    course: Array  # (n,) direction the body would move in going forward [rad]
    yaw: Array  # (n,) direction the body points in [rad]
    slip: Array  # (n,) course - yaw [rad]
    yaw_rate: Array  # (n,) [rad/s]
    extent: Array  # (n, 2) length, width [m]
    cov: Array  # (n, 2, 2) of the body centre [m2]
    hits: Ints  # (n,) returns in this scan, 0 while coasting
    age: Array  # (n,) since birth [s]
    bound: Array  # (n, 2) error of W_p and of W_v at most, if what is assumed holds [m, m/s]; inf: any
    broken: Bools  # (n,) what was assumed for the bound did not hold, as this scan shows

    @property
    def W_v(self) -> Array:
        """(n, 2) velocity of the body centre [m/s]."""
        v: Array = self.speed[:, None] * np.column_stack([np.cos(self.course), np.sin(self.course)])
        return v

    @property
    def course_bound(self) -> Array:
        """(n,) angle between W_v and the true velocity, at most [rad]; pi where it may be any."""
        v, off = np.abs(self.speed), self.bound[:, 1]
        known = off < v
        return np.where(known, np.arcsin(np.divide(off, v, out=np.zeros(len(v)), where=known)), np.pi)


@dataclass(frozen=True, slots=True)
class Threats:
    """How near each track comes; row i is row i of the Tracks they were made from."""

    t: float  # [s]
    id: Ints  # (n,)
    ttc: Array  # (n,) time to first overlap with the rider's footprint [s]; inf where none within the horizon
    closest_distance: Array  # (n,) least gap between the two rectangles within the horizon [m]; 0 at overlap
    closest_time: Array  # (n,) when that is, from t [s]
    required_deceleration: Array  # (n,) constant braking of the track that just avoids contact [m/s2]
    in_corridor: Bools  # (n,) comes into the rider's lateral corridor within the horizon
    closing_speed: Array  # (n,) mean rate at which the gap shrinks until contact or closest approach [m/s]
    ttc_earliest: Array  # (n,) time to first overlap, at least, for all that the track's bound allows [s]
    ttc_latest: Array  # (n,) the same, at most; inf where it may not touch within the horizon [s]


class Level(IntEnum):
    """The ladder of warnings."""

    NONE = 0
    NOTICE = 1
    CAUTION = 2
    DANGER = 3


@dataclass(frozen=True, slots=True)
class Alert:
    """What the rider and the others are told after one scan."""

    t: float  # [s]
    level: Level
    track: int  # id of the track it is about, -1 for none
    ttc: float  # of that track, as acted on: expected or earliest [s], inf for none
    degraded: tuple[str, ...]  # why the warning cannot be trusted now; empty when it can


@dataclass(frozen=True, slots=True)
class Frame:
    """All that one scan gave."""

    t: float  # [s]
    scan: Scan
    detections: Detections
    tracks: Tracks
    threats: Threats
    alert: Alert
    lagged: Tracks | None = None  # some scans ago, as known now; None where that was not asked for
