"""A scenario: what stands and moves in a small world, as a TOML file (keys in docs/scenarios.md).

Fixed frame W: x forward, y left, yaw counter-clockwise from x. Angles are in degrees, as their keys say.
"""

from __future__ import annotations

import difflib
import re
from importlib import resources
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from outrider.errors import InputError

Finite = Annotated[float, Meta(ge=-1e5, le=1e5)]
Positive = Annotated[float, Meta(gt=0.0, le=1e5)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e5)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Steering = Annotated[float, Meta(ge=-60.0, le=60.0)]
Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]*\Z")]
Point = tuple[Finite, Finite]


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all parts: frozen, and an unknown key is an error."""


class Faults(Part, frozen=True):
    """What the driver writes wrong in the header; the beams themselves are right."""

    time_scale: Positive = (
        1.0  # time_increment and scan_time are multiplied by it: 1e-3 as some real drivers do
    )
    reverse: bool = False  # beams are stored against time, the header says along time


class Sensor(Part, frozen=True):
    """A spinning lidar; the defaults are those of an RPLIDAR Mapper."""

    rate_hz: Annotated[float, Meta(ge=0.1, le=1000.0)] = 10.0
    step_deg: Annotated[float, Meta(ge=0.01, le=90.0)] = 0.75
    range_min_m: Positive = 0.1
    range_max_m: Positive = 40.0
    sigma_m: NotNegative = 0.02  # standard deviation of one range
    lost: Share = 0.005  # share of beams lost for no reason
    echoes: Positive = 3.0  # mean number of echoes from a surface met squarely at range_max
    clockwise: bool = False  # the way it turns; beams are stored in the order of time
    x_m: Finite = 0.0  # mounting pose on the rider's body
    y_m: Finite = 0.0
    yaw_deg: Finite = 0.0
    faults: Faults = Faults()


class Manoeuvre(Part, frozen=True):
    """What a driver does for a while; speed never changes sign within one: braking ends at a standstill."""

    duration_s: Annotated[float, Meta(gt=0.0, le=3600.0)]
    acceleration_mps2: Finite = 0.0
    steering_deg: Steering | None = None  # front wheel at the beginning; not given: as it was
    steering_rate_degps: Finite = 0.0  # and how it turns


class Vehicle(Part, frozen=True):
    """A rectangle whose centre moves as a bicycle; after the last manoeuvre speed and steering are held."""

    name: Name
    x_m: Finite
    y_m: Finite
    yaw_deg: Finite = 0.0
    speed_mps: Finite = 0.0
    length_m: Positive = 4.5
    width_m: Positive = 1.8
    rear_axle_m: Positive = 2.0  # body centre to rear axle
    wheelbase_m: Positive = 4.0
    manoeuvres: tuple[Manoeuvre, ...] = ()
    collision_course: bool = (
        False  # is at some time bound to hit the rider: told to the reader, checked by a test
    )


class Rider(Part, frozen=True):
    """The rider's own vehicle: carries the sensor; the ego pose is its body's origin."""

    x_m: Finite = 0.0
    y_m: Finite = 0.0
    yaw_deg: Finite = 0.0
    speed_mps: Finite = 0.0
    length_m: Positive = 1.2  # of the footprint
    width_m: Positive = 0.6
    centre_x_m: Finite = 0.0  # of the footprint, ahead of the body's origin
    rear_axle_m: Positive = 0.45
    wheelbase_m: Positive = 0.9
    manoeuvres: tuple[Manoeuvre, ...] = ()


class Parked(Part, frozen=True):
    """A rectangle that stands."""

    name: Name
    x_m: Finite
    y_m: Finite
    yaw_deg: Finite = 0.0
    length_m: Positive = 4.5
    width_m: Positive = 1.8


class Pedestrian(Part, frozen=True):
    """A circle that walks straight on."""

    name: Name
    x_m: Finite
    y_m: Finite
    yaw_deg: Finite = 0.0
    speed_mps: Finite = 1.4
    radius_m: Positive = 0.25


class Wall(Part, frozen=True):
    """A polyline without thickness."""

    points_m: Annotated[tuple[Point, ...], Meta(min_length=2)]


class Pole(Part, frozen=True):
    """A circle that stands."""

    x_m: Finite
    y_m: Finite
    radius_m: Positive = 0.1


class Scenario(Part, frozen=True):
    """A world and how long to look at it."""

    title: str
    duration_s: Annotated[float, Meta(gt=0.0, le=3600.0)]
    seed: Annotated[int, Meta(ge=0)] = 0
    sensor: Sensor = Sensor()
    rider: Rider = Rider()
    vehicles: tuple[Vehicle, ...] = ()
    parked: tuple[Parked, ...] = ()
    pedestrians: tuple[Pedestrian, ...] = ()
    walls: tuple[Wall, ...] = ()
    poles: tuple[Pole, ...] = ()

    def __post_init__(self) -> None:
        bodies: tuple[Vehicle | Parked | Pedestrian, ...] = (*self.vehicles, *self.parked, *self.pedestrians)
        names = [body.name for body in bodies]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"name {twice[0]!r} is given twice")
        if self.sensor.range_max_m <= self.sensor.range_min_m:
            raise ValueError("sensor.range_max_m must be above sensor.range_min_m")


PARTS: dict[str, type[Part]] = {  # by the key they stand under
    "": Scenario,
    "sensor": Sensor,
    "faults": Faults,
    "rider": Rider,
    "vehicles": Vehicle,
    "manoeuvres": Manoeuvre,
    "parked": Parked,
    "pedestrians": Pedestrian,
    "walls": Wall,
    "poles": Pole,
}


def names() -> list[str]:
    """Names of the scenarios that come with the package, sorted."""
    files = (resources.files("outrider") / "scenarios").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


def load(name_or_path: Path | str) -> Scenario:
    """The shipped scenario of that name, or one read from a TOML file.

    Raises InputError for an unknown name or key, a wrong type or value, or a file that cannot be read.
    """
    text = str(name_or_path)
    if text in names():
        return parse((resources.files("outrider") / "scenarios" / f"{text}.toml").read_bytes(), text)
    path = Path(text)
    if path.suffix != ".toml":
        close = difflib.get_close_matches(text, names(), n=3) or names()
        raise InputError(
            f"scenario {text!r}: no such name; want {', '.join(close)}, or a path ending in .toml"
        )
    try:
        return parse(path.read_bytes(), text)
    except OSError as error:
        raise InputError(f"{path}: cannot read scenario ({error.strerror}); want a TOML file") from error


def parse(content: bytes | str, where: str = "scenario") -> Scenario:
    """A scenario from the text of a TOML file; raises InputError as `load` does, naming `where`."""
    try:
        return msgspec.toml.decode(content, type=Scenario)
    except msgspec.ValidationError as error:
        raise InputError(f"{where}: {error}; {_hint(str(error))}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: not TOML ({error}); want lines such as duration_s = 10") from error


def _hint(message: str) -> str:
    """What to do about a message of msgspec, such as: unknown field `speed` - at `$.vehicles[0]`."""
    unknown = re.search(r"unknown field `(.*?)`", message)
    place = re.search(r"at `\$(?:.*\.)?(\w*)(?:\[\d+\])?`", message)
    part = PARTS.get(place[1] if place else "", Scenario)
    close = difflib.get_close_matches(unknown[1], part.__struct_fields__, cutoff=0.4) if unknown else []
    return f"did you mean {', '.join(close)}?" if close else "see docs/scenarios.md"
