"""What is driven, by which truth, and which estimators look at it with which gains."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.lateral import commonroad

from outrider import cars, lateral
from outrider.lateral import course, plant, tune
from outrider.lateral.course import SHARE, Course
from outrider.lateral.log import Log
from outrider.lateral.plant import NOISES, Drive

TRUTHS = ("own", *commonroad.KINDS)
TOLD = cars.load("b_class")  # what the estimators are told of the car, whichever it is
ROLL = 0.016  # roll over ay of the multi-body car: its sensor reads 16 % too much [rad s2/m]
TRAINING = (1, 2, 3)  # seeds of made courses, and of noise, that is tuned on; our own car, a dry road
SEED = 21  # of the noise that is judged


class Ride(NamedTuple):
    """One drive to judge on."""

    name: str  # heading in the tables
    course: str
    car: str
    friction: float
    share: float = SHARE  # of what friction allows that the driver uses in turns


DRIVES = (
    Ride("dry", "Hungaroring", "b_class", 1.0),
    Ride("friction 0.5", "Hungaroring", "b_class", 0.5),
    Ride("0.5, sliding", "Hungaroring", "b_class", 0.5, 0.95),
    Ride("D class", "Hungaroring", "d_class", 1.0),
    Ride("winding, dry", "winding:5", "b_class", 1.0, 0.75),
    Ride("winding, 0.7", "winding:5", "b_class", 0.7),
    Ride("winding, D class", "winding:13", "d_class", 1.0),
)


class Method(NamedTuple):
    """An estimator with gains; the tuned ones are tuned for each noise."""

    label: str
    estimator: str
    gains: dict[str, float] = {}  # noqa: RUF012
    tuned: str = ""  # "" or the way `tune` searches
    over: str = ""  # what the bins are of

    def values(self, noise: str) -> dict[str, float]:
        """The gains that differ from the estimator's own."""
        if self.tuned:
            return tuned(self, noise).gains
        known = lateral.get(self.estimator).Gains._fields
        told = max(NOISES[noise].yaw_rate, 0.01)
        return {k: told if v < 0.0 else v for k, v in self.gains.items() if k in known}


KNOWN = {"noise_yaw": -1.0}  # negative: as large as the noise really is
METHODS = (
    Method("`lq`: fixed at 10 m/s", "lq"),
    Method("`ultra_local_published`, reading 1, greedy", "ultra_local_published", {"reading": 1.0}, "greedy"),
    Method("`ultra_local` on `lq`, k(vx)", "ultra_local", {"base": 0.0}, "joint", "speed"),
    Method("`scheduled`, L1 used", "scheduled", {"share": 1.0}),
    Method("`scheduled`", "scheduled"),
    Method("`ultra_local`, k(ay) tuned", "ultra_local", {}, "joint", "ay"),
    Method("`ultra_local`", "ultra_local"),
    Method("`kalman`", "kalman"),
    Method("`kalman`, told the noise", "kalman", KNOWN),
    Method("`tyre`, friction 1", "tyre"),
    Method("`tyre`, friction 1, told the noise", "tyre", KNOWN),
    Method("`friction_bank`", "friction_bank"),
    Method("`friction_bank`, told the noise", "friction_bank", KNOWN),
    Method("`integration`", "integration"),
    Method("`integration`, leak 0.3/s", "integration", {"leak": 0.3}),
)


def methods() -> list[Method]:
    """All of them that there are, and any estimator that is in none with its own gains."""
    there = lateral.names()
    listed = {m.estimator for m in METHODS}
    return [m for m in METHODS if m.estimator in there] + [
        Method(f"`{n}`", n) for n in there if n not in listed
    ]


@lru_cache
def way(name: str) -> Course:
    """A course by name: winding:SEED, or the Hungaroring of the recordings' folder, OUTRIDER_DATA."""
    kind, _, number = name.partition(":")
    if kind == "winding":
        return course.winding(int(number))
    return course.read(Path(os.environ["OUTRIDER_DATA"]) / "racetrack_database" / "tracks" / "Budapest.csv")


@lru_cache
def driven(truth: str, what: Ride) -> Drive:
    """The drive as it was."""
    road = way(what.course)
    speed = course.plan(road, what.friction, share=what.share)
    car = cars.load(what.car)
    if truth == "own":
        return plant.drive(road, car, what.friction, speed=speed)
    return commonroad.drive(truth, road, car, what.friction, speed)


def log_of(truth: str, what: Ride, noise: str) -> Log:
    """The drive as the sensors have it."""
    return plant.sensed(driven(truth, what), TOLD, NOISES[noise], SEED)


def told(truth: str, roll: bool = True) -> cars.Car:
    """The car that estimators are given: always the B class, and how much the multi-body one rolls."""
    return TOLD._replace(roll_gain=ROLL) if truth == "multibody" and roll else TOLD


_TUNED: dict[tuple[str, str], Any] = {}


def tuned(method: Method, noise: str) -> tune.Tuned:
    """The tuning of a method on the training course, once for each noise."""
    key = (method.label, noise)
    if key not in _TUNED:
        logs = [plant.simulate(course.winding(seed), TOLD, 1.0, noise, seed) for seed in TRAINING]
        _TUNED[key] = tune.tune(
            logs, TOLD, method.estimator, over=method.over, method=method.tuned, gains=method.gains
        )
    return _TUNED[key]  # type: ignore[no-any-return]
