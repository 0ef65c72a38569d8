"""Recordings made by hand for the tests of formats: awkward on purpose, every value known."""

import dataclasses

import numpy as np

from outrider.records import LaserScan, Pose

START_NS = 1_575_810_072_093_116_401
AWKWARD = [np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-45, 3.4028235e38, 0.1, 1 / 3]

# One path and --format for each way of writing; "" lets the suffix pick.
TARGETS = {
    "ros1": ("a.bag", ""),
    "ros2-mcap": ("b", ""),
    "ros2-sqlite3": ("c", "ros2-sqlite3"),
    "db3": ("d.db3", ""),
    "mcap": ("e.mcap", ""),
    "parquet": ("f.parquet", ""),
    "csv": ("g.csv", ""),
}


def single(value):
    """The nearest number that a ROS header can hold."""
    return float(np.float32(value))


def scan(i=0, ranges=(1.0, 2.0), intensities=(), topic="/scan", at_ns=None, **changes):
    at_ns = START_NS + i * 77_500_000 if at_ns is None else at_ns
    made = LaserScan(
        topic=topic,
        frame="laser",
        stamp_ns=at_ns - 3_000_001,
        received_ns=at_ns,
        angle_min=single(-3.1),
        angle_increment=single(0.0175),
        time_increment=single(-2e-4),
        scan_time=single(0.0775),
        range_min=single(0.15),
        range_max=8.0,
        ranges=np.array(ranges, np.float32),
        intensities=np.array(intensities, np.float32),
    )
    return dataclasses.replace(made, **changes)


def pose(i=0, topic="/ego_pose", body="", extent=(), at_ns=None, **changes):
    at_ns = START_NS + i * 77_500_000 + 10 if at_ns is None else at_ns
    made = Pose(
        topic=topic,
        frame="map",
        body=body,
        stamp_ns=at_ns - 7,
        received_ns=at_ns,
        position=np.array([0.1 * i, -1 / 3, 0.05]),
        quaternion=np.array([0.0, 0.1, np.sin(0.05 * i), np.cos(0.05 * i)]),
        extent=np.array(extent, float),
    )
    return dataclasses.replace(made, **changes)


def drive(n=12, seed=3):
    """Messages in time order: scans, the rider, a body of known size, one without, odometry."""
    rng = np.random.default_rng(seed)
    messages = []
    for i in range(n):
        beams = int(rng.integers(0, 40)) if i else 0  # the first scan is empty
        ranges = rng.choice(np.array(AWKWARD, np.float32), beams)
        strength = rng.uniform(0, 255, beams) if i % 3 else ()
        messages += [
            scan(i, ranges, strength),
            pose(i, "/ego_pose", ""),
            pose(i, "/truth/car_1", "car_1", (4.2, 1.8), at_ns=START_NS + i * 77_500_000 + 20),
            pose(i, "/truth/walker", "walker", at_ns=START_NS + i * 77_500_000 + 30),
            pose(i, "/drive", "base_link", at_ns=START_NS + i * 77_500_000 + 40),
        ]
    return messages


DRIVE_TYPES = {"/drive": "nav_msgs/msg/Odometry"}


def difference(a, b):
    """Name of the first field in which two messages differ, None if they are equal; NaN equals NaN."""
    if type(a) is not type(b):
        return "type"
    for field in dataclasses.fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            if x.dtype != y.dtype or not np.array_equal(x, y, equal_nan=True):
                return field.name
        elif type(x) is not type(y) or x != y:
            return field.name
    return None


def check_equal(got, want):
    got, want = list(got), list(want)
    assert len(got) == len(want)
    for i, (a, b) in enumerate(zip(got, want, strict=True)):
        assert difference(a, b) is None, (i, difference(a, b), a, b)
