"""A tiny world for the tests: straight walls seen by a sensor that moves, each beam at its own time."""

import numpy as np

from outrider.records import LaserScan, Pose

T0 = 1_700_000_000.0
PERIOD = 0.1


def ns(t):
    return round(t * 1e9)


def raw_scan(ranges, t=T0, **fields):
    """A clean 0.1 s scan over the full circle, 0.1 to 40 m; any field may be replaced."""
    ranges = np.asarray(ranges, np.float32)
    n = max(1, len(ranges))
    values = {
        "topic": "scan",
        "frame": "laser",
        "stamp_ns": ns(t),
        "received_ns": ns(t + PERIOD),
        "angle_min": -np.pi,
        "angle_increment": 2.0 * np.pi / n,
        "time_increment": PERIOD / n,
        "scan_time": PERIOD,
        "range_min": 0.1,
        "range_max": 40.0,
        "ranges": ranges,
        "intensities": np.empty(0, np.float32),
    }
    return LaserScan(**(values | fields))


def pose(t, x, y, yaw, **fields):
    """Pose of the body `ego` at time t."""
    values = {
        "topic": "ego",
        "frame": "map",
        "body": "",
        "stamp_ns": ns(t),
        "received_ns": ns(t),
        "position": np.array([x, y, 0.0]),
        "quaternion": np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]),
        "extent": np.empty(0),
    }
    return Pose(**(values | fields))


def look(W_sensor, angle, walls):
    """Ranges (n,) to the nearest wall, a line given by angle of its normal and distance; inf: none."""
    bearing = W_sensor[:, 2] + angle
    best = np.full(len(angle), np.inf)
    for normal, distance in walls:
        towards = np.cos(bearing - normal)
        gap = distance - W_sensor[:, 0] * np.cos(normal) - W_sensor[:, 1] * np.sin(normal)
        hit = np.divide(gap, towards, out=np.full(len(angle), np.inf), where=towards > 1e-3)
        best = np.minimum(best, np.where(hit > 0.0, hit, np.inf))
    return best


ROOM = [(0.0, 5.0), (0.5 * np.pi, 4.0), (np.pi, 6.0), (-0.5 * np.pi, 3.0)]


def path(t, wobble=True):
    """Pose (n, 3) of a body that goes in a circle of 2 m at 1.6 m/s, or turns to and fro on it."""
    s = np.asarray(t) - T0
    phase = 0.8 * s + (0.4 * np.sin(2.0 * s) if wobble else 0.0)
    return np.stack([2.0 * np.sin(phase), -2.0 * np.cos(phase) + 0.5, phase], axis=-1)


def mounted(body, mount):
    """Pose (n, 3) of a sensor mounted at `mount` (x, y, yaw) on the body."""
    x, y, yaw = mount
    c, s = np.cos(body[:, 2]), np.sin(body[:, 2])
    return np.column_stack([body[:, 0] + c * x - s * y, body[:, 1] + s * x + c * y, body[:, 2] + yaw])


def drive(
    scans=40, n=360, mount=(0.0, 0.0, 0.0), backward=False, offset=0.0, shrink=1.0, walls=ROOM, **header
):
    """Messages of a drive in receive order; lengths are divided by `shrink` as in a scale model."""
    step = (-1.0 if backward else 1.0) * PERIOD / n
    header = {"time_increment": step} | header
    messages = []
    for k in range(scans):
        stamp = T0 + 0.5 + k * PERIOD
        angle = -np.pi + 2.0 * np.pi / n * np.arange(n)
        sensor = mounted(path(stamp + offset + step * np.arange(n)), mount)
        messages.append(raw_scan(look(sensor, angle, walls) / shrink, stamp, **header))
    for t in np.arange(T0, T0 + 1.0 + scans * PERIOD, 0.01):
        x, y, yaw = path(t)
        messages.append(pose(t, x / shrink, y / shrink, yaw))
    return sorted(messages, key=lambda m: m.received_ns)


def off_the_walls(W_p, walls=ROOM):
    """Distance (n,) of points to the nearest wall's line."""
    lines = [np.abs(W_p[:, 0] * np.cos(a) + W_p[:, 1] * np.sin(a) - d) for a, d in walls]
    return np.min(lines, axis=0)
