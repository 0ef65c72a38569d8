"""Where the rider's body was at any instant, from the poses of a recording or a live source."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from outrider.geometry import Array, wrap
from outrider.records import Ego, Pose

REACH_S = 0.1  # a pose is carried on with constant velocity this far, then held; older than this is stale
VELOCITY_S = 0.15  # length of the least-squares line behind velocity and yaw rate
FROZEN_S = 0.3  # exactly repeated for longer ...
FROZEN_SPEED = 0.1  # ... after moving faster than this [m/s] ...
FROZEN_BRAKING = 20.0  # ... and stopping harder than tyres can [m/s2]: the source has stopped, not the body


def pose_stamp_s(message: Pose) -> float:
    """Time of a pose since the epoch [s]: the header stamp, or the receive time where the stamp is 0."""
    return (message.stamp_ns or message.received_ns) * 1e-9


def xyyaw(pose: Pose) -> tuple[float, float, float]:
    """x [m], y [m], yaw [rad] of a pose; NaN where it is not finite or its quaternion has no length."""
    x, y, z, w = pose.quaternion.tolist()
    px, py, pz = pose.position.tolist()
    square = x * x + y * y + z * z + w * w
    if not (square > 1e-12 and math.isfinite(square + px + py + pz)):
        return math.nan, math.nan, math.nan
    return px, py, math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def columns(poses: Sequence[Pose]) -> tuple[Array, Array]:
    """Times (m,) [s], increasing, and poses (m, 3) in the recording's metres; unusable ones are left out."""
    t = np.array([pose_stamp_s(p) for p in poses], float)
    rows = np.array([xyyaw(p) for p in poses], float).reshape(-1, 3)
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], t]))[:-1]
    keep = (t > latest) & np.isfinite(rows[:, 0])
    return t[keep], rows[keep]


class EgoBuffer:
    """Recent poses of the body in the fixed frame W, in stamp order.

    Lengths are multiplied by `scale` on the way in. Memory stays flat when `forget` is called now and then.
    """

    def __init__(self, scale: float = 1.0) -> None:
        self.scale = scale
        self.clear()

    def clear(self) -> None:
        """Forget every pose (the clock jumped)."""
        self._t: Array = np.empty(256)
        self._pose: Array = np.empty((256, 3))  # yaw runs on past pi, so that it can be interpolated
        self._begin = self._end = 0
        self._raw: tuple[float, ...] = ()  # of the newest pose, as it came
        self._speeds = (0.0, 0.0)  # of the last two steps between poses that differ, unscaled [m/s]
        self._same_since = math.nan
        self._stopped_dead = False

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def oldest(self) -> float:
        """Time of the oldest pose kept [s]; inf when there is none."""
        return float(self._t[self._begin]) if len(self) else math.inf

    @property
    def newest(self) -> float:
        """Time of the newest pose [s]; -inf when there is none."""
        return float(self._t[self._end - 1]) if len(self) else -math.inf

    @property
    def frozen_since(self) -> float:
        """Since when the poses repeat exactly although the body cannot have stopped so hard [s]; NaN if not.

        A body that brakes to a stand, and then gives one constant pose, is not frozen.
        """
        frozen = self._stopped_dead and self.newest - self._same_since > FROZEN_S
        return self._same_since if frozen else math.nan

    def add(self, pose: Pose) -> bool:
        """Take a pose; False if it was left out: not finite, no quaternion, or not later than the newest."""
        t, (x, y, yaw) = pose_stamp_s(pose), xyyaw(pose)
        if not (t > self.newest and math.isfinite(x)):
            return False
        self._watch(t, (*pose.position.tolist(), *pose.quaternion.tolist()))
        if len(self):
            before = float(self._pose[self._end - 1, 2])
            yaw = before + float(wrap(yaw - before))
        if self._end == len(self._t):
            self._make_room()
        self._t[self._end], self._pose[self._end] = t, (self.scale * x, self.scale * y, yaw)
        self._end += 1
        return True

    def _watch(self, t: float, raw: tuple[float, ...]) -> None:
        """Follow runs of exactly equal poses and how abruptly they began; call before the pose is kept."""
        if raw == self._raw:
            if math.isnan(self._same_since):
                self._same_since = self.newest
                speed = max(0.5 * self._speeds[0], self._speeds[1])  # the last step may have been cut short
                self._stopped_dead = speed > FROZEN_SPEED and speed > FROZEN_BRAKING * (t - self.newest)
            return
        if len(self):
            since = self.newest if math.isnan(self._same_since) else self._same_since
            self._speeds = self._speeds[1], math.dist(raw[:2], self._raw[:2]) / (t - since)
        self._raw, self._same_since, self._stopped_dead = raw, math.nan, False

    def _make_room(self) -> None:
        """Move what is kept to the front of arrays at most half full."""
        n = len(self)
        size = max(256, 2 * n)
        t, pose = np.empty(size), np.empty((size, 3))
        t[:n], pose[:n] = self._t[self._begin : self._end], self._pose[self._begin : self._end]
        self._t, self._pose, self._begin, self._end = t, pose, 0, n

    def forget(self, before: float) -> None:
        """Drop poses no longer needed for times after `before` [s]; the newest stretch is always kept."""
        before = min(before, self.newest - 2.0 * VELOCITY_S)
        kept = self._t[self._begin : self._end]
        self._begin += max(0, int(np.searchsorted(kept, before, side="right")) - 1)

    def _between(self, first: float, last: float) -> tuple[Array, Array]:
        """Poses from the last one at or before `first` to the first one at or after `last`."""
        t = self._t[self._begin : self._end]
        i = max(0, int(np.searchsorted(t, first, side="right")) - 1)
        j = int(np.searchsorted(t, last, side="left")) + 1
        return t[i:j], self._pose[self._begin : self._end][i:j]

    def velocity(self, t: float) -> Array:
        """(3,) vx, vy [m/s], yaw rate [rad/s] in W: least-squares line over the VELOCITY_S before t.

        At the beginning, where nothing lies before t, over the first poses. Zero with fewer than two poses.
        """
        kept = self._t[self._begin : self._end]
        if len(kept) < 2:
            return np.zeros(3)
        j = max(2, int(np.searchsorted(kept, t, side="right")))
        i = min(j - 2, int(np.searchsorted(kept, kept[j - 1] - VELOCITY_S, side="left")))
        rows = self._pose[self._begin : self._end][i:j]
        tau = kept[i:j] - kept[i:j].sum() / (j - i)
        return np.asarray(tau @ rows / (tau @ tau))

    def at(self, t: Array) -> Array:
        """Poses (m, 3) in W [m, m, rad] at times t (m,) [s], m >= 1, with at least one pose in the buffer.

        Between poses: straight line. Beyond them: constant velocity for REACH_S, then held.
        """
        first, last = float(t.min()), float(t.max())
        known_t, known = self._between(first, last)
        if last > self.newest:
            known_t, known = _carry(known_t, known, self.velocity(self.newest), -1, REACH_S)
        if first < self.oldest:
            known_t, known = _carry(known_t, known, self.velocity(self.oldest), 0, -REACH_S)
        out = np.empty((len(t), 3))
        for k in range(3):
            out[:, k] = np.interp(t, known_t, known[:, k])
        out[:, 2] = wrap(out[:, 2])
        return out

    def ego(self, t: float, W_pose: Array) -> Ego:
        """State of the body at t, where its pose is W_pose (3,); velocity 0 where the pose is only held."""
        held = not self.oldest - REACH_S <= t <= self.newest + REACH_S
        rate = np.zeros(3) if held else self.velocity(t)
        return Ego(t, W_pose, rate[:2], float(rate[2]), True)

    def staleness(self, first: float, last: float) -> float:
        """Longest time [s] from either end of [first, last] to the nearest pose; inf without poses."""
        if not len(self):
            return math.inf
        return max(float(np.abs(self._between(t, t)[0] - t).min()) for t in (first, last))


def _carry(t: Array, poses: Array, rate: Array, end: int, reach: float) -> tuple[Array, Array]:
    """Times and poses with one more row, `reach` [s] beyond row `end` (0 or -1) at constant velocity."""
    more = poses[end] + reach * rate
    if end == 0:
        return np.concatenate([[t[0] + reach], t]), np.vstack([more, poses])
    return np.concatenate([t, [t[-1] + reach]]), np.vstack([poses, more])


def standing(t: float) -> Ego:
    """The body where no pose is known: at the origin of W, not moving."""
    return Ego(t, np.zeros(3), np.zeros(2), 0.0, False)
