"""Recordings as logs of a robot with two range sensors; every rule here works without the truth.

Car: github.com/kostaskonkk/datmo, examples, 2019 (K. Konstantinidis, M. Alirezaei, S. Grammatico). A lidar
with 24 bearings a turn, of which two are the sensors; wheel speed, gyroscope, motion capture.
Robot: UTIAS MRCLAM data set 7, robot 1 (K. Leung et al., IJRR 30(8), 2011). Odometry, Vicon.

What was set on the recording `overtakes` alone: the four numbers of the car below, the rule for the pair.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq

from outrider.geometry import wrap
from outrider.relocalise import Array, mount
from outrider.relocalise import room as rooms
from outrider.relocalise.log import Log, checked
from outrider.relocalise.room import Room

ROOM = Path(__file__).parent / "room_2019.toml"
CAR_RUNS = ("overtakes", "parallel", "overtake_ego")  # the first is the one things were set on
FROZEN = {"overtake_ego": 104}  # scans after which motion capture stood still
WHEEL = 0.931  # true speed / wheel speed as given [-]
GYRO = 0.0102  # bias [rad/s]
CRAB = 0.0243  # the car moves this far to the left of where the lidar looks [rad]
BEARINGS = np.deg2rad(np.arange(-180, 180, 15))
STRAIGHT = 0.05  # a return this near to the line through its two neighbours may be of a wall [m]
SPREAD = np.deg2rad(60.0)  # least angle between the two beams
MOVED = 0.02  # ranges are read again only after this way [m]
ROBOT_STEP = 0.2  # of the robot's log [s]


class Turns(NamedTuple):
    """A car's recording, scan by scan, beam by beam, in the order of `BEARINGS`."""

    t: Array  # (n, 24) [s]
    ranges: Array  # (n, 24) [m]
    v: Array  # (n, 24) [m/s]
    w: Array  # (n, 24) [rad/s]
    lidar: Array  # (n, 24, 3) true x, y [m], yaw [rad] of the lidar


def room() -> Room:
    """The car's room."""
    return rooms.load(ROOM)


def turns(data: Path, run: str) -> Turns:
    """One of `CAR_RUNS` from the folder of all recordings."""
    table = pq.read_table(data / "datmo_2dlidar" / run / "wall_ranges.parquet")

    def column(name: str) -> Array:
        return table[name].to_numpy().reshape(-1, len(BEARINGS))[: FROZEN.get(run)]

    lidar = np.stack([column(name) for name in ("lidar_x", "lidar_y", "lidar_yaw")], axis=-1)
    return Turns(column("t"), column("range"), WHEEL * column("v_wheel"), column("wz_gyro") - GYRO, lidar)


def pair(ranges: Array) -> tuple[int, int] | None:
    """Which two of the 24 returns of a scan are read.

    Those that lie on a line with both neighbours, as on a wall; of them the longest, as what stands in the
    way is nearer, and the longest of those 60 deg or more away from it. None: there are no two.
    """
    point = ranges[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])
    before, after = np.roll(point, 1, axis=0), np.roll(point, -1, axis=0)
    along, across = after - before, point - before
    off = np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]) / np.hypot(along[:, 0], along[:, 1])
    length = np.where(np.nan_to_num(off, nan=np.inf) < STRAIGHT, ranges, 0.0)
    first = int(np.argmax(length))
    length = np.where(np.abs(wrap(BEARINGS - BEARINGS[first])) >= SPREAD - 1e-9, length, 0.0)
    second = int(np.argmax(length))
    return (first, second) if length[second] > 0.0 else None


def fixed(*degrees: int) -> tuple[int, int]:
    """Two bearings [deg] as indices."""
    first, second = ((angle + 180) // 15 for angle in degrees)
    return first, second


def car(turned: Turns, beams: tuple[int, int] | None = None) -> Log:
    """The log of a car with two beams, those of `pair` or always the same; one row a scan.

    Time is half-way between both beams. No ranges while the car stands: they would be the same again.
    """
    own = room()
    order = np.argsort(turned.t.ravel())
    t, v, w = (values.ravel()[order] for values in (turned.t, turned.v, turned.w))
    way, turn = (_integral(values, t) for values in (v, w))
    lidar = turned.lidar.reshape(-1, 3)[order]
    lidar[:, 2] = np.unwrap(lidar[:, 2])
    n = len(turned.t)
    at, ranges, angles = np.empty(n), np.full((n, 2), np.nan), np.tile(own.angles, (n, 1))
    for k in range(n):
        chosen = list(beams or pair(turned.ranges[k]) or ())
        at[k] = turned.t[k, chosen or slice(None)].mean()
        if chosen:
            ranges[k], angles[k] = turned.ranges[k, chosen], BEARINGS[chosen] - CRAB
    ranges[_standing(np.interp(at, t, way))] = np.nan
    seen = np.stack([np.interp(at, t, part) for part in lidar.T], axis=-1)
    truth = mount.robot(seen + np.array([0.0, 0.0, CRAB]), own.mount)
    return _log(at, np.interp(at, t, way), np.interp(at, t, turn), ranges, angles, truth)


def robot(data: Path) -> Log:
    """The log of the robot: odometry and truth at 5 Hz, no ranges."""
    folder = data / "mrclam_unicycle"
    odometry, truth = (
        {name: table[name].to_numpy() for name in table.column_names}
        for table in (
            pq.read_table(folder / f"ds7_robot1_{kind}.parquet") for kind in ("odometry", "groundtruth")
        )
    )
    t, held = odometry["t"], np.diff(odometry["t"])
    way, turn = (np.concatenate([[0.0], np.cumsum(odometry[name][:-1] * held)]) for name in ("v", "w"))
    at = np.arange(t[0], min(t[-1], truth["t"][-1]), ROBOT_STEP)
    pose = np.stack(
        [np.interp(at, truth["t"], part) for part in (truth["x"], truth["y"], np.unwrap(truth["theta"]))],
        axis=-1,
    )
    none = np.full((len(at), 2), np.nan)
    return _log(at, np.interp(at, t, way), np.interp(at, t, turn), none, np.zeros((len(at), 2)), pose)


def _standing(way: Array) -> npt.NDArray[np.bool_]:
    """Rows at which the car has not moved since ranges were last read."""
    out, last = np.ones(len(way), np.bool_), way[0]
    for k, here in enumerate(way):
        if abs(here - last) >= MOVED:
            out[k], last = False, here
    return out


def _integral(values: Array, t: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])


def _log(t: Array, way: Array, turn: Array, ranges: Array, angles: Array, truth: Array) -> Log:
    """A log whose speeds are the way and the turn of each interval over its length."""
    step = np.diff(t)
    rows = {"v": np.append(0.0, np.diff(way) / step), "w": np.append(0.0, np.diff(turn) / step)}
    rows |= {"t": t - t[0], "range_1": ranges[:, 0], "range_2": ranges[:, 1]}
    rows |= {"angle_1": angles[:, 0], "angle_2": angles[:, 1]}
    return checked(rows | {"x": truth[:, 0], "y": truth[:, 1], "theta": wrap(truth[:, 2])})
