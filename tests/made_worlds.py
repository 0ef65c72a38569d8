"""Scenarios driven through scan preparation and tracker: what the tests of the front end look at."""

import dataclasses
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from made_scans import raw_scan
from outrider import detect, lidar_model, scenario, simulate, tracker
from outrider import scan as scans
from outrider.geometry import TAU
from outrider.records import Detections, Scan, Tracks
from outrider.settings import Settings

DEFAULT = Settings()
BACKDROP = "[[walls]]\npoints_m = [[-60.0, 14.0], [60.0, 14.0]]\n"


class Step(NamedTuple):
    """All that the tracker made of one scan."""

    scan: Scan
    detections: Detections
    tracks: Tracks
    memory: tracker.TrackMemory


def world(text, seconds=8.0):
    """A scenario from its tables; without a [rider] the sensor stands at the origin, facing along x."""
    return scenario.parse(f'title = "test"\nduration_s = {seconds}\n{text}')


def prepared(messages, settings=DEFAULT, ego="/ego_pose", topic="/scan"):
    return list(scans.prepare(messages, topic, ego, settings))


def single(ranges, sequential=True, **fields):
    """One scan over the full circle from given ranges (n,); all beams at one time where not sequential."""
    (made,) = prepared([raw_scan(ranges, **fields)], ego=None, topic="scan")
    return made if sequential else dataclasses.replace(made, beam_t=np.full(len(made.angle), made.t))


def follow(scan_list, settings=DEFAULT):
    """The tracker's steps over some scans."""
    engine, memory, steps = tracker.engine(settings), tracker.start(settings), []
    for scan in scan_list:
        segments, found = detect.detect(scan, settings.detect)
        memory, found, tracks = tracker.update(memory, scan, segments, found, settings, engine)
        steps.append(Step(scan, found, tracks, memory))
    return steps


@lru_cache
def driven(what, seed=None):
    """Steps over a scenario, by name or as one, with the default settings."""
    what = simulate.load(what) if isinstance(what, str) else what
    return follow(prepared(simulate.record(what, seed)))


def since_start(steps):
    """Times (n,) of the steps in the scenario's own seconds."""
    return np.array([step.tracks.t for step in steps]) - simulate.EPOCH_NS * 1e-9


def returns_on(scan, truth, k, margin=0.15):
    """(n,) which beams came back from the body whose motion is `truth` (k: its row at the scan's time)."""
    c, s = np.cos(truth.yaw[k]), np.sin(truth.yaw[k])
    ahead = np.array([np.cos(truth.yaw[k] + truth.slip[k]), np.sin(truth.yaw[k] + truth.slip[k])])
    q = scan.W_p - [truth.x[k], truth.y[k]] - truth.speed[k] * ahead * (scan.beam_t - scan.t)[:, None]
    u, v = np.abs(c * q[:, 0] + s * q[:, 1]), np.abs(c * q[:, 1] - s * q[:, 0])
    inside = (u < 0.5 * truth.extent[0] + margin) & (v < 0.5 * truth.extent[1] + margin)
    return scan.valid & inside


def look(pose, size, eye, beams=480, reach=30.0):
    """Exact returns p (n, 2) of one rectangle seen from eye (2,), and the ends (m, 2) of beams past it."""
    heading = np.arange(beams) * (TAU / beams)
    origin = np.tile(np.asarray(eye, float), (beams, 1))
    shapes = lidar_model.Shapes(
        np.tile(np.asarray(pose, float), (beams, 1, 1)),
        np.asarray(size, float)[None],
        np.zeros((beams, 0, 2)),
        np.zeros(0),
        np.zeros((0, 2, 2)),
    )
    echo = lidar_model.cast(origin, heading, shapes)
    ray = np.column_stack([np.cos(heading), np.sin(heading)])
    hit = np.isfinite(echo.range)
    return origin[hit] + echo.range[hit, None] * ray[hit], origin[~hit] + reach * ray[~hit]
