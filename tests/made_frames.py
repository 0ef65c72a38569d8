"""Frames made by hand: a rider in a street, with vehicles whose motion is known exactly."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from outrider.geometry import corners, transform, wrap
from outrider.records import Alert, Detections, Ego, Frame, Level, Scan, Threats, Tracks, TrackState

SIZE = (4.5, 1.8)
DT = 0.1


@dataclass(frozen=True)
class Car:
    """A vehicle on a circle, or a straight line, at constant speed; times in s from the start."""

    id: int
    start: tuple[float, float, float]  # x, y, yaw at time 0
    speed: float
    yaw_rate: float = 0.0
    born: float = 0.0
    gone: float = np.inf

    def pose(self, t: float) -> np.ndarray:
        x, y, yaw = self.start
        turn = self.yaw_rate * t
        way = self.speed * t * np.sinc(turn / (2 * np.pi))
        return np.array(
            [
                x + way * np.cos(yaw + turn / 2),
                y + way * np.sin(yaw + turn / 2),
                wrap(yaw + turn),
            ]
        )

    def state(self, t: float) -> TrackState:
        if self.speed == 0.0:
            return TrackState.STATIC
        return TrackState.TENTATIVE if t - self.born < 0.3 else TrackState.CONFIRMED


STREET = (
    Car(1, (14.0, 4.6, 0.0), 0.0),
    Car(2, (22.0, 4.6, 0.0), 0.0),
    Car(3, (-25.0, 2.4, 0.0), 8.0),
    Car(4, (38.0, -30.0, 1.9), 6.0, yaw_rate=0.06, born=2.0),
    Car(5, (75.0, 1.0, np.pi), 7.0, born=1.0, gone=7.0),
)
WALLS = np.array(
    [
        [[-30.0, 8.0], [30.0, 8.0]],
        [[46.0, 8.0], [90.0, 8.0]],
        [[-30.0, -8.0], [28.0, -8.0]],
        [[44.0, -8.0], [90.0, -8.0]],
    ]
)


def cast(origin: np.ndarray, angles: np.ndarray, lines: np.ndarray, reach: float = 40.0) -> np.ndarray:
    """Ranges (n,) to the first of the segments lines (k, 2, 2); inf beyond reach."""
    d = np.stack([np.cos(angles), np.sin(angles)], -1)[:, None]
    a, e = lines[:, 0] - origin, lines[:, 1] - lines[:, 0]
    det = d[..., 0] * e[:, 1] - d[..., 1] * e[:, 0]
    det = np.where(np.abs(det) < 1e-12, 1e-12, det)
    r = (a[:, 0] * e[:, 1] - a[:, 1] * e[:, 0]) / det
    u = (a[:, 0] * d[..., 1] - a[:, 1] * d[..., 0]) / det
    best = np.where((r > 0.05) & (u >= 0.0) & (u <= 1.0), r, np.inf).min(1)
    return np.where(best < reach, best, np.inf)


def make_frames(
    n: int = 100,
    cars: tuple[Car, ...] = STREET,
    beams: int = 480,
    t0: float = 1000.0,
    ego_speed: float = 3.0,
    seed: int = 1,
) -> Iterator[Frame]:
    """n frames, 0.1 s apart from t0 [s]; the rider goes along x from the origin."""
    rng = np.random.default_rng(seed)
    ladder = ((1.7, Level.DANGER), (3.0, Level.CAUTION), (4.0, Level.NOTICE))
    for k in range(n):
        t = k * DT
        ego = Ego(t0 + t, np.array([ego_speed * t, 0.0, 0.0]), np.array([ego_speed, 0.0]), 0.0, True)
        there = [c for c in cars if c.born <= t < c.gone]
        poses = np.array([c.pose(t) for c in there]).reshape(-1, 3)
        boxes = corners(poses, np.array([SIZE] * len(there)).reshape(-1, 2))
        sides = np.stack([boxes, np.roll(boxes, -1, 1)], 2).reshape(-1, 2, 2)
        angle = np.linspace(-np.pi, np.pi, beams, endpoint=False)
        ranges = cast(ego.W_pose[:2], angle, np.vstack([WALLS, sides])) + rng.normal(0.0, 0.02, beams)
        valid = np.isfinite(ranges)
        ranges = np.where(valid, ranges, np.nan)
        local = ranges[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        scan = Scan(
            t=ego.t,
            beam_t=ego.t + DT * (np.arange(beams) / beams - 1.0),
            angle=angle,
            range=ranges,
            valid=valid,
            intensity=np.zeros(0, np.float32),
            range_max=40.0,
            W_sensor=np.tile(ego.W_pose, (beams, 1)),
            W_p=transform(ego.W_pose, local),
            ego=ego,
            masked={"no return": int((~valid).sum())},
            faults=(),
        )
        tracks = _tracks(t0 + t, t, there, poses)
        ttc = _ttc(tracks, ego)
        threats = Threats(
            tracks.t,
            tracks.id,
            ttc,
            *(np.zeros(len(ttc)) for _ in range(3)),
            np.isfinite(ttc),
            np.zeros(len(ttc)),
            np.maximum(ttc - 0.5, 0.0),
            ttc + 0.5,
        )
        i = int(np.argmin(ttc)) if len(ttc) else -1
        level = next((lv for s, lv in ladder if i >= 0 and ttc[i] < s), Level.NONE)
        about = (int(tracks.id[i]), float(ttc[i])) if level else (-1, np.inf)
        yield Frame(ego.t, scan, _detections(tracks), tracks, threats, Alert(ego.t, level, *about, ()))


def _tracks(now: float, t: float, there: list[Car], poses: np.ndarray) -> Tracks:
    n = len(there)
    return Tracks(
        t=now,
        id=np.array([c.id for c in there], np.int64),
        state=np.array([c.state(t) for c in there], np.uint8),
        W_p=poses[:, :2].copy(),
        speed=np.array([c.speed for c in there]),
        acceleration=np.zeros(n),
        course=poses[:, 2].copy(),
        yaw=poses[:, 2].copy(),
        slip=np.zeros(n),
        yaw_rate=np.array([c.yaw_rate for c in there]),
        extent=np.array([SIZE] * n).reshape(-1, 2),
        cov=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        hits=np.full(n, 12, np.int64),
        age=np.array([t - c.born for c in there]),
        bound=np.tile([0.3, 1.0], (n, 1)),
        broken=np.zeros(n, np.bool_),
    )


def _detections(tracks: Tracks) -> Detections:
    n = len(tracks.id)
    zeros = np.zeros(n, np.int64)
    return Detections(
        tracks.t, np.full(n, tracks.t), tracks.W_p, tracks.yaw, tracks.extent, np.tile(np.eye(3), (n, 1, 1)),
        tracks.hits, zeros + 2, zeros.astype(np.uint8), tracks.id, zeros, zeros + 11,
    )  # fmt: skip


def _ttc(tracks: Tracks, ego: Ego) -> np.ndarray:
    """Time for the centres to come within 2 m, straight ahead [s]."""
    p, v = tracks.W_p - ego.W_pose[:2], tracks.W_v - ego.W_v
    a, b, c = (v**2).sum(-1), (p * v).sum(-1), (p**2).sum(-1) - 4.0
    root = b**2 - a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        ttc = (-b - np.sqrt(root)) / a
    moving = tracks.state != TrackState.STATIC
    return np.where((root > 0.0) & (ttc > 0.0) & (ttc < 6.0) & moving, ttc, np.inf)
