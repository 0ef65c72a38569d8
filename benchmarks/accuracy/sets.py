"""The series every observer is judged on: real streets, real scans, and simulation; full-size lengths.

A series is what one vehicle looked like, sample by sample, and how it really moved. Seeds are fixed. The real
recordings are looked for below the folder that the environment variable OUTRIDER_DATA names.

    kitti/train|test            labelled centres of tracked vehicles with the labels' own scatter
    argoverse/train|test        labelled centres with noise of 8 cm and 0.02 rad
    argoverse-hops/train|test   the same, and the seen point hops about the body
    simulated[-hops|-outliers]  a bicycle; noise of 2 cm and 0.02 rad; /train the first half, /test the rest
    datmo/RUN                   rectangles fitted to the scans of a real lidar, truth by motion capture
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from benchmarks.accuracy import driving, recorded

from outrider.compare import Series
from outrider.errors import InputError
from outrider.geometry import rotate, wrap
from outrider.metrics import Truth
from outrider.records import Array

SEQUENCES = {"train": (4, 8, 18), "test": (6, 11, 20)}
LOGS = {"train": "adcf7d18", "test": "3b3570b4"}
RUNS = ("overtakes", "parallel", "overtake_ego")
NOT_DRIVEN = ("Pedestrian", "Cyclist", "EGO_VEHICLE", "BICYCLE")
KITTI_SCATTER = (0.03, 0.02)  # of the labels about their own smooth course [m, rad]
MAX_GAP = 5  # a track is split where it was not labelled in more frames than this
MOVED_M = 5.0  # a track that ends nearer to its beginning was parked
HOPS = 0.08  # share of scans in which the seen point jumps to another place of the body
SIMULATED = ("simulated", "simulated-hops", "simulated-outliers")
NAMES = (
    *(f"{name}/{part}" for name in ("kitti", "argoverse", "argoverse-hops") for part in SEQUENCES),
    *(name + part for name in SIMULATED for part in ("", "/train", "/test")),
    *(f"datmo/{run}" for run in RUNS),
)


@cache
def load(name: str) -> list[Series]:
    """The series of a set; InputError for an unknown name, or where the recordings are not there."""
    family, _, part = name.partition("/")
    if name not in NAMES:
        raise InputError(f"set {name!r} is not known; want one of {', '.join(NAMES)}")
    if family in SIMULATED and part:
        whole = load(family)
        half = len(whole) // 2
        return whole[:half] if part == "train" else whole[half:]
    if family == "kitti":
        return list(_kitti(part))
    if family == "argoverse":
        return list(_argoverse(part))
    if family == "argoverse-hops":
        rng = np.random.default_rng(20)
        return [_hopping(s, (0.8, 0.3), rng) for s in load(f"argoverse/{part}")]
    if family == "simulated-hops":
        rng = np.random.default_rng(21)
        return [_hopping(s, (0.4, 0.2), rng) for s in load("simulated")]
    if family == "simulated-outliers":
        rng = np.random.default_rng(22)
        return [_outlying(s, rng) for s in load("simulated")]
    if family == "simulated":
        rng = np.random.default_rng(23)
        return [_seen(name, truth, 0.02, 0.02, rng) for name, truth in driving.all_of_them()]
    return recorded.load(part)


def data() -> Path:
    """Folder of the real recordings; InputError where there is none."""
    folder = os.environ.get("OUTRIDER_DATA", "")
    if not (folder and Path(folder).is_dir()):
        raise InputError(f"OUTRIDER_DATA={folder!r}; want the folder that holds the real recordings")
    return Path(folder)


# ------------------------------------------------------------------ labelled streets


def _kitti(part: str) -> Iterator[Series]:
    table = _columns(data() / "kitti_tracking" / "tracks_world.parquet")
    for sequence in SEQUENCES[part]:
        for track in np.unique(table["track_id"][table["seq"] == sequence]):
            rows = {k: v[(table["seq"] == sequence) & (table["track_id"] == track)] for k, v in table.items()}
            if rows["type"][0] not in NOT_DRIVEN:
                poses = np.column_stack([rows[k] for k in ("x_w", "y_w", "yaw_w")]).astype(float)
                for t, pose in _pieces(rows["frame"], rows["t_nominal"], poses, least=30):
                    yield _labelled(f"kitti {sequence} {track}", t, pose, KITTI_SCATTER)


def _argoverse(part: str) -> Iterator[Series]:
    rng = np.random.default_rng(24 if part == "train" else 25)
    table = _columns(data() / "argoverse2_logs" / LOGS[part] / "vehicle_tracks_city.parquet")
    for track in np.unique(table["track_id"]):
        rows = {k: v[table["track_id"] == track] for k, v in table.items()}
        if rows["category"][0] not in NOT_DRIVEN:
            poses = np.column_stack([rows[k] for k in ("x_c", "y_c", "yaw_c")]).astype(float)
            for t, pose in _pieces(rows["frame"], rows["t"], poses, least=15):
                truth = smoothed(t, pose)
                yield _seen(f"argoverse {track}", truth, 0.08, 0.02, rng, at=pose)


def _columns(path: Path) -> dict[str, Array]:
    import pyarrow.parquet as pq

    if not path.is_file():
        raise InputError(f"{path}: not there; want the real recordings below OUTRIDER_DATA")
    table = pq.read_table(path)
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def _pieces(frame: Array, t: Array, poses: Array, least: int) -> Iterator[tuple[Array, Array]]:
    """Times and poses (n, 3) of the stretches of one track that move and are long enough."""
    order = np.argsort(frame, kind="stable")
    cuts = np.flatnonzero(np.diff(frame[order]) > MAX_GAP) + 1
    for rows in np.split(order, cuts):
        if len(rows) >= least and np.hypot(*(poses[rows[-1], :2] - poses[rows[0], :2])) > MOVED_M:
            yield t[rows].astype(float), poses[rows]


def smoothed(t: Array, poses: Array, window: int = 9) -> Truth:
    """Two-sided estimate from labelled poses (n, 3): a quadratic over `window` samples around each one.

    Savitzky and Golay 1964, for samples that need not be even; at the ends the window is one-sided.
    """
    x = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    fitted = np.empty((len(t), 2, 3))
    for i in range(len(t)):
        first = min(max(i - window // 2, 0), len(t) - window)
        near = slice(first, first + window)
        powers = np.vander(t[near] - t[i], 3, increasing=True)
        fitted[i] = np.linalg.lstsq(powers, x[near], rcond=None)[0][:2]
    return Truth(t, fitted[:, 0, :2], fitted[:, 1, :2], wrap(fitted[:, 0, 2]))


def _labelled(name: str, t: Array, poses: Array, scatter: tuple[float, float]) -> Series:
    """The labels as they are."""
    return Series(name, t, measurements(poses, *scatter), smoothed(t, poses))


# ------------------------------------------------------------------ what the sensor makes of it


def measurements(poses: Array, noise: float, heading_noise: float) -> Array:
    """Rows (n, 9) of observers.Measurement at poses (n, 3), with the deviations [m], [rad] they claim."""
    y = np.zeros((len(poses), 9))
    y[:, :2], y[:, 5] = poses[:, :2], wrap(poses[:, 2])
    y[:, [2, 4]], y[:, 6] = noise**2, heading_noise**2
    y[:, 7:] = 4.5, 1.8
    return y


def _seen(
    name: str,
    truth: Truth,
    noise: float,
    heading_noise: float,
    rng: np.random.Generator,
    at: Array | None = None,
) -> Series:
    """The truth, or the poses `at` (n, 3), with Gaussian noise [m], [rad]."""
    poses = np.column_stack([truth.W_p, truth.yaw]) if at is None else at
    noisy = poses + rng.normal(0.0, [noise, noise, heading_noise], poses.shape)
    return Series(name, truth.t, measurements(noisy, noise, heading_noise), truth)


def _hopping(s: Series, reach: tuple[float, float], rng: np.random.Generator) -> Series:
    """The seen point moves to another place of the body, uniform within +-reach [m], and stays there."""
    n = len(s.t)
    places = rng.uniform(-1.0, 1.0, (n, 2)) * reach
    hop = rng.random(n) < HOPS
    hop[0] = True
    latest = np.maximum.accumulate(np.where(hop, np.arange(n), 0))
    y = s.y.copy()
    y[:, :2] += rotate(places[latest], s.truth.yaw)
    return Series(s.name, s.t, y, s.truth)


def _outlying(s: Series, rng: np.random.Generator) -> Series:
    """One sample in a hundred lies 5 to 20 m off, in any direction."""
    n = len(s.t)
    off = np.where(rng.random(n) < 0.01, rng.uniform(5.0, 20.0, n), 0.0)
    way = rng.uniform(-np.pi, np.pi, n)
    off[:2] = 0.0
    y = s.y.copy()
    y[:, :2] += off[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    return Series(s.name, s.t, y, s.truth)
