"""Which topics of a recording are the scanner, the rider and the truth: by name, or by a stated rule."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from outrider.errors import InputError
from outrider.extension import nearest
from outrider.io._recording import ODOMETRY_TYPE, Recording, Topic
from outrider.settings import Recording as Named

EGO_WORDS = ("ego", "odom", "base", "self")  # in the last part of a topic's name
NOT_TRUTH = ("goal", "initialpose", "clicked", "waypoint", "setpoint", "command")
TRUTH_FOLDER = "/truth/"
NONE = "none"


@dataclass(frozen=True, slots=True)
class Chosen:
    """Names of the topics that are used."""

    scan: str
    ego: str | None  # None: the sensor is taken as standing
    truth: tuple[str, ...]


def choose_topics(recording: Recording, named: Named | None = None) -> Chosen:
    """The topics named in the settings, the rest by rule; raises InputError for a name that does not fit.

    Scan: of the LaserScan topics the one with most messages, ties by name.
    Ego: an odometry topic, else a pose topic whose last name part holds ego, odom, base or self; nothing
    below `/truth/`; of several the one with most messages, ties by name.
    Truth: every other pose topic that is not odometry and not a goal, waypoint or the like.
    """
    named = named or Named()
    scan = named.scan_topic
    if scan:
        _check(recording, scan, "scan")
    else:
        scan = _most(recording, lambda topic: topic.kind == "scan") or ""
    if not scan:
        raise InputError(f"{recording.path}: holds no laser scan; {_listing(recording)}")
    ego = _ego(recording, named.ego_topic)
    return Chosen(scan, ego, _truth(recording, named.truth_topics, ego))


def _ego(recording: Recording, name: str) -> str | None:
    if name:
        return None if name == NONE else _check(recording, name, "pose")
    poses = {t.name for t in recording.topics if t.kind == "pose" and not t.name.startswith(TRUTH_FOLDER)}
    odometry = _most(recording, lambda topic: topic.name in poses and topic.type == ODOMETRY_TYPE)
    return odometry or _most(recording, lambda topic: topic.name in poses and _sounds_like_ego(topic.name))


def _truth(recording: Recording, names: tuple[str, ...], ego: str | None) -> tuple[str, ...]:
    if names:
        return () if names == (NONE,) else tuple(_check(recording, name, "pose") for name in names)
    return tuple(t.name for t in recording.topics if t.kind == "pose" and t.name != ego and _may_be_truth(t))


def _may_be_truth(topic: Topic) -> bool:
    if topic.name.startswith(TRUTH_FOLDER):
        return True
    return topic.type != ODOMETRY_TYPE and not any(word in topic.name.lower() for word in NOT_TRUTH)


def _sounds_like_ego(name: str) -> bool:
    return any(word in name.rstrip("/").rpartition("/")[2].lower() for word in EGO_WORDS)


def _most(recording: Recording, fits: Callable[[Topic], bool]) -> str | None:
    found = [topic for topic in recording.topics if topic.count and fits(topic)]
    return min(found, key=lambda topic: (-topic.count, topic.name)).name if found else None


def _check(recording: Recording, name: str, kind: str) -> str:
    every = {topic.name: topic for topic in recording.topics + recording.others}
    topic = every.get(name)
    want = {"scan": "a LaserScan", "pose": "a pose or odometry"}[kind]
    if topic is None:
        raise InputError(f"{recording.path}: no topic {name!r}{nearest(name, sorted(every))}")
    if topic.kind != kind:
        fitting = ", ".join(t.name for t in recording.topics if t.kind == kind) or "none here"
        raise InputError(f"{recording.path}: topic {name!r} is {topic.type}; want {want}: {fitting}")
    if not topic.count:
        raise InputError(f"{recording.path}: topic {name!r} holds no message")
    return name


def _listing(recording: Recording) -> str:
    every = recording.topics + recording.others
    return (
        "topics: " + ", ".join(f"{t.name} ({t.type}, {t.count})" for t in every)
        if every
        else "no topics at all"
    )
