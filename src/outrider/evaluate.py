"""A run folder against the truth: figures for each body whose motion is known, and for the scene.

The definitions are in docs/results.md. Lengths are those of the recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outrider.datasets import Entry, open_any
from outrider.errors import InputError
from outrider.io import choose_topics
from outrider.io.run import Run, open_run
from outrider.metrics import Estimates, Score, Truth, gospa, lead_time, overlap, score, truth_from_poses
from outrider.records import Array, Pose, TrackState

GATE_M = 3.5  # full-size world: nearest track that may be the body's
MOVING_MPS = 2.0  # full-size world: slower bodies have no course to be judged
COUNTED = ("caution", "danger")  # alerts that warn


@dataclass(frozen=True, slots=True)
class Body:
    """One body whose true poses a recording holds."""

    name: str
    truth: Truth  # at the times of the poses
    extent: Array | None  # (2,) length, width [m]; None: the recording does not say


@dataclass(frozen=True, slots=True)
class Target:
    """One body whose truth is known."""

    name: str
    truth: Truth  # at the times of the scans
    extent: Array  # (2,) length, width [m]; NaN where unknown
    score: Score
    contact_t: float | None  # first touch of the rider's footprint [s], the recording's clock
    lead_s: float | None  # warning before it; None: no contact, or no warning


@dataclass(frozen=True, slots=True)
class Scene:
    """All bodies and all moving tracks together, over the scans in which some truth is known."""

    scans: int
    gospa_m: float  # mean of the distance, cut off at the gate
    localisation_m2: float  # mean parts of its square
    missed_m2: float
    false_m2: float
    false_tracks: float  # moving tracks a scan with no body inside the gate


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What `evaluate` found."""

    targets: tuple[Target, ...]
    scene: Scene
    alerts: dict[str, int]  # how often each level was reached

    @property
    def truth(self) -> dict[str, Truth]:
        """True motion by name of the body, as the pictures want it."""
        return {target.name: target.truth for target in self.targets}

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, None where there was nothing to measure."""
        bodies = {
            t.name: {**t.score.to_dict(), "contact_t": t.contact_t, "warning_lead_s": t.lead_s}
            for t in self.targets
        }
        found = {k: getattr(self.scene, k) for k in Scene.__slots__}
        scene = {k: v if np.isfinite(v) else None for k, v in found.items()}
        return {"targets": bodies, "scene": scene, "alerts": self.alerts}

    def table(self) -> str:
        """The same as text: a block for each body, then the scene."""
        lines: list[str] = []
        for target in self.targets:
            lines += _block(target)
        s = self.scene
        located, missed, false = _shown(s.localisation_m2), _shown(s.missed_m2), _shown(s.false_m2)
        lines += [
            f"scene: {s.scans} scans with a moving body, false tracks {_shown(s.false_tracks)} a scan",
            f"  GOSPA {_shown(s.gospa_m)} m",
            f"  parts of GOSPA ** 2: located {located}, missed {missed}, false {false} m2",
            "alerts: " + ", ".join(f"{name} {n}" for name, n in self.alerts.items()),
        ]
        return "\n".join(lines)


def evaluate(
    run_folder: Path | str | Run,
    truth: Iterable[Pose] | Path | str | None = None,
    offset: Sequence[float] | None = None,
    gate: float | None = None,
    skip: float = 1.0,
    until: float | None = None,
    lagged: bool = False,
) -> Evaluation:
    """Scores a run against the true poses of one or more bodies.

    truth: poses; or the recording that holds them, by path or `dataset:` name; None: the recording that the
    run was made from. offset: the body centre in the frame whose pose was measured [m]; None: as the data set
    says, else (0, 0). gate: how near a track must be [m]; None: 3.5 m in the full-size world. Scans from
    `skip` to `until` seconds after the first one count; until None: as long as the data set is sound. lagged:
    score what the observer knew by looking back (docs/observers.md).

    Raises InputError where there is no truth, no scan to compare it with, or no run.
    """
    run = run_folder if isinstance(run_folder, Run) else open_run(run_folder)
    poses, known = _poses(run, truth)
    if until is None:
        until = known.valid_until_s if known and known.valid_until_s is not None else np.inf
    gate = GATE_M / run.settings.recording.scale if gate is None else gate
    t, rider = _rider(run, skip, until)
    estimates = _estimates(run, lagged)
    targets: list[Target] = []
    for body in bodies(poses, known, offset):
        extent = _extent(run, body.extent)
        targets.append(_target(body.name, run, body.truth.at(t), extent, gate, rider, estimates))
    if not targets:
        raise InputError(f"{run.folder}: no true pose to compare with; name a recording that holds some")
    return Evaluation(tuple(targets), _scene(run, targets, estimates, gate), _alerts(run))


def _poses(run: Run, source: Iterable[Pose] | Path | str | None) -> tuple[Iterable[Pose], Entry | None]:
    """The true poses, and what is known about the data set they come from."""
    if source is not None and not isinstance(source, str | Path):
        return source, None
    source = source or run.summary.get("recording")
    if not source:
        raise InputError(f"{run.folder}: does not say what it was made from; name the recording of the truth")
    recording, known = open_any(source)
    topics = choose_topics(recording, run.settings.recording).truth
    found = recording.messages(topics) if topics else iter(())
    return (message for message in found if isinstance(message, Pose)), known


def bodies(
    poses: Iterable[Pose],
    known: Entry | None = None,
    offset: Sequence[float] | None = None,
    scale: float = 1.0,
) -> list[Body]:
    """The bodies whose true poses these are, at the times of the poses; all lengths times `scale`.

    offset: the body centre in the frame whose pose was measured, in the recording's lengths [m]; None: as the
    data set says, else (0, 0).
    """
    groups: dict[tuple[str, str], list[Pose]] = {}
    for pose in poses:
        groups.setdefault((pose.topic, pose.body), []).append(pose)
    found = []
    for (topic, body), group in groups.items():
        x, y = offset or (known.truth_offset_m.get(topic) if known else None) or (0.0, 0.0)
        stamps = np.array([pose.stamp_ns for pose in group]) * 1e-9
        rows = np.array([pose.xyyaw for pose in group]) * [scale, scale, 1.0]
        told = group[0].extent if len(group[0].extent) == 2 else None
        size = known.truth_extent_m.get(topic) if known and told is None else told
        extent = None if size is None else scale * np.asarray(size, float)
        name = topic if body in topic else f"{topic} {body}"
        found.append(Body(name, truth_from_poses(stamps, rows, (scale * x, scale * y)), extent))
    return found


def _extent(run: Run, told: Array | None) -> Array:
    """Length and width of a body [m]: as told, else as the settings say, else NaN."""
    if told is not None:
        return told
    detect = run.settings.detect
    known = np.array([detect.body_length_m or np.nan, detect.body_width_m or np.nan])
    return known / run.settings.recording.scale


def _estimates(run: Run, lagged: bool) -> Estimates:
    if lagged and run.lagged is None:
        raise InputError(
            f"{run.folder}: no lagged tracks; want a run with --observer NAME+lagN, such as ekf+lag2"
        )
    table = run.lagged if lagged else run.tracks
    c = {name: table[name].to_numpy() for name in table.column_names}
    reverse = np.where(c["speed"] < 0.0, np.pi, 0.0)
    state = np.array([TrackState[name.upper()] for name in c["state"]], np.uint8)
    xy, v = np.column_stack([c["x"], c["y"]]), np.column_stack([c["vx"], c["vy"]])
    every = Estimates(c["t"], c["track_id"], xy, v, c["yaw"], c["course"] + reverse, state)
    return every.rows(np.argsort(every.t, kind="stable"))


def _rider(run: Run, skip: float, until: float) -> tuple[Array, Array]:
    """Times (m,) of the scans that count, in order, and the rider's poses (m, 3) then."""
    names = ("t", "ego_x", "ego_y", "ego_yaw")
    table = np.column_stack([run.scans[name].to_numpy() for name in names])
    since = table[:, 0] - table[:1, 0]
    table = table[(since >= skip) & (since <= until)]
    if not len(table):
        raise InputError(
            f"{run.folder}: no scan between {skip} s and {until} s; want a longer run or other limits"
        )
    table = table[np.unique(table[:, 0], return_index=True)[1]]
    return table[:, 0], table[:, 1:]


def _target(
    name: str, run: Run, truth: Truth, extent: Array, gate: float, rider: Array, estimates: Estimates
) -> Target:
    settings, scale = run.settings, run.settings.recording.scale
    truth = truth.where(np.hypot(*(truth.W_p - rider[:, :2]).T) < settings.detect.max_range_m / scale)
    result = score(truth, estimates, gate, MOVING_MPS / scale)
    contact = _contact(run, truth, extent, rider)
    alerts = [(a["t"], a["track_id"]) for a in run.alerts if a["level"] in COUNTED]
    lead = None if contact is None else lead_time(contact, alerts, result.ids, settings.threat.horizon_s)
    return Target(name, truth, extent, result, contact, lead)


def _contact(run: Run, truth: Truth, extent: Array, rider: Array) -> float | None:
    """When the body first touches the rider's footprint [s], margin not included."""
    if not np.isfinite(extent).all():
        return None
    scale, own = run.settings.recording.scale, run.settings.rider
    size = np.array([own.length_m, own.width_m]) / scale
    ahead = own.centre_x_m / scale
    x, y, yaw = rider.T
    centre = np.column_stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw])
    seen = np.flatnonzero(np.isfinite(truth.yaw))
    body = np.column_stack([truth.W_p, truth.yaw])[seen]
    touch = overlap(body, np.tile(extent, (len(seen), 1)), centre[seen], np.tile(size, (len(seen), 1)))
    return float(truth.t[seen[touch][0]]) if touch.any() else None


def _scene(run: Run, targets: Sequence[Target], estimates: Estimates, gate: float) -> Scene:
    """Bodies that ever move against moving tracks; a track at rest may find a body, but is never false."""
    slow, t = MOVING_MPS / run.settings.recording.scale, targets[0].truth.t
    truths = [g.truth for g in targets if (np.nan_to_num(np.hypot(*g.truth.W_v.T)) > slow).any()]
    places = np.array([truth.W_p for truth in truths]).reshape(-1, len(t), 2)
    known = np.isfinite(places[:, :, 0])
    shown = estimates.rows(estimates.state != TrackState.TENTATIVE)
    starts, ends = np.searchsorted(shown.t, [t - 1e-6, t + 1e-6])
    found, false = [], 0
    for i in np.flatnonzero(known.any(axis=0)):
        there = places[known[:, i], i]
        tracks = shown.rows(slice(starts[i], ends[i]))
        near = (np.linalg.norm(tracks.W_p[:, None] - there, axis=-1) < gate).any(axis=1)
        moving = tracks.state != TrackState.STATIC
        false += int((moving & ~near).sum())
        found.append(gospa(there, tracks.W_p[moving | near], gate))
    distance, near, missed, extra = np.mean(found, axis=0).tolist() if found else 4 * [np.nan]
    return Scene(len(found), distance, near, missed, extra, false / max(len(found), 1))


def _alerts(run: Run) -> dict[str, int]:
    """How often each level was reached from another."""
    counts, before = dict.fromkeys(("notice", *COUNTED), 0), "none"
    for alert in run.alerts:
        level = alert["level"]
        if level != before and level in counts:
            counts[level] += 1
        before = level
    return counts


def _shown(value: float) -> str:
    """A number, or a dash where there was nothing to measure."""
    return f"{value:.3g}" if np.isfinite(value) else "-"


def _block(target: Target) -> list[str]:
    s = target.score
    counts = f"identities {s.identities}, switches {s.switches}, breaks {s.breaks}"
    lines = [
        f"{target.name}: {s.scans} scans, present {100.0 * s.present:.1f} %",
        f"  {counts}, heading flips {s.heading_flips}",
        f"  {'error':<18}{'RMS':>9}{'median':>9}{'95 %':>9}",
    ]
    names = {
        "position_m": "m",
        "speed_mps": "m/s",
        "velocity_mps": "m/s",
        "course_deg": "deg",
        "yaw_deg": "deg",
    }
    for name, unit in names.items():
        label = f"{name.split('_')[0]} [{unit}]"
        lines.append(f"  {label:<18}" + "".join(f"{_shown(value):>9}" for value in getattr(s, name)))
    if target.contact_t is not None:
        lead = "no warning" if target.lead_s is None else f"warned {target.lead_s:.2f} s before"
        lines.append(f"  contact at {target.contact_t:.2f} s: {lead}")
    return lines
