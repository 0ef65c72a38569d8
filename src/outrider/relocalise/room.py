"""A room: its wall and the two range sensors of the robot in it, as a TOML file.

Its keys are in docs/relocalise.md.
"""

from __future__ import annotations

import difflib
import re
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from outrider.errors import InputError, OutputError
from outrider.relocalise.curve import Array, Point, Wall
from outrider.relocalise.outline import Polygon, Spline
from outrider.relocalise.wall import Circle, Ellipse, Superellipse, Support

Shape = Circle | Ellipse | Superellipse | Support | Polygon | Spline
SHAPES = {str(kind.__struct_config__.tag): kind for kind in Shape.__args__}


class Room(NamedTuple):
    """A known wall and two range sensors that sit on one point of the robot."""

    wall: Wall
    angles: Array  # (2,) of the sensors, counter-clockwise from straight ahead [rad]
    mount: Array = np.zeros(2)  # (2,) where both sit on the robot: ahead of its axle's middle, left of it [m]
    range_min: float = 0.0  # shorter readings are none [m]
    range_max: float = 100.0  # longer readings are none [m]
    sigma: float = 0.01  # standard deviation of one range [m]
    strays: float = 0.0  # share of ranges that end on something else than the wall [-]


class Sensors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of [sensors]; the defaults are what theory and tests use."""

    angles_deg: tuple[float, float] = (60.0, -60.0)
    mount_m: Point = (0.0, 0.0)
    range_m: tuple[float, float] = (0.0, 100.0)
    sigma_m: float = 0.01
    stray_share: float = 0.0

    def __post_init__(self) -> None:
        angles, low, high = self.angles_deg, *self.range_m
        numbers = (*angles, *self.mount_m, low, high, self.sigma_m, self.stray_share)
        if not np.isfinite(numbers).all():
            raise InputError("sensors: has a value that is no finite number")
        if abs(np.sin(np.deg2rad(angles[0] - angles[1]) / 2)) < 1e-3:
            raise InputError("sensors: both sensors look the same way; want two different angles_deg")
        if self.sigma_m <= 0.0:
            raise InputError(
                f"sensors: sigma_m = {self.sigma_m:g}; want the standard deviation of a range, above 0"
            )
        if not 0.0 <= self.stray_share < 1.0:
            raise InputError(f"sensors: stray_share = {self.stray_share:g}; want 0 to less than 1")
        if not 0.0 <= low < high:
            raise InputError(
                f"sensors: range_m = [{low:g}, {high:g}]; want the shortest, then the longest range"
            )


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    wall: Shape
    sensors: Sensors = Sensors()


def names() -> list[str]:
    """Names of the rooms that come with the package, sorted."""
    files = (resources.files("outrider") / "relocalise" / "rooms").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


def load(name_or_path: Path | str) -> Room:
    """The shipped room of that name, or one read from a TOML file.

    Raises InputError for an unknown name or key, a wall that is no convex curve, sensors that cannot be, or a
    file that cannot be read.
    """
    text = str(name_or_path)
    if text in names():
        return parse(
            (resources.files("outrider") / "relocalise" / "rooms" / f"{text}.toml").read_bytes(), text
        )
    path = Path(text)
    if path.suffix != ".toml":
        close = difflib.get_close_matches(text, names(), n=3) or names()
        raise InputError(f"room {text!r}: no such name; want {', '.join(close)}, or a path ending in .toml")
    try:
        return parse(path.read_bytes(), text)
    except OSError as error:
        raise InputError(f"{path}: cannot read room ({error.strerror}); want a TOML file") from error


def parse(content: bytes | str, where: str = "room") -> Room:
    """A room from the text of a TOML file; raises InputError as `load` does, naming `where`."""
    try:
        read = msgspec.toml.decode(content, type=_File)
    except msgspec.ValidationError as error:
        raise InputError(f"{where}: {error}; {_hint(str(error), content)}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f'{where}: not TOML ({error}); want [wall] and shape = "ellipse"') from error
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    sensors = read.sensors
    return Room(
        read.wall,
        np.deg2rad(sensors.angles_deg),
        np.array(sensors.mount_m, dtype=float),
        sensors.range_m[0],
        sensors.range_m[1],
        sensors.sigma_m,
        sensors.stray_share,
    )


def _hint(message: str, content: bytes | str) -> str:
    """What to do about a message of msgspec, such as: unknown field `sigma` - at `$.sensors`."""
    unknown = re.search(r"unknown field `(.*?)`|Invalid value '(.*?)'", message)
    fields: tuple[str, ...]
    if "$.sensors" in message:
        fields = Sensors.__struct_fields__
    elif "$.wall.shape" in message or "field `shape`" in message:
        return f"want shape one of {', '.join(SHAPES)}"
    elif "$.wall" in message:
        shape = msgspec.toml.decode(content)["wall"].get("shape")
        fields = SHAPES[shape].__struct_fields__ if shape in SHAPES else ("shape",)
    else:
        fields = _File.__struct_fields__
    close = difflib.get_close_matches((unknown[1] or "") if unknown else "", fields, cutoff=0.4)
    return f"did you mean {', '.join(close)}?" if unknown and close else f"keys are {', '.join(fields)}"


def dump(room: Room) -> str:
    """The room as TOML, such that `parse` gives the same room back."""
    sensors = Sensors(
        angles_deg=tuple(np.round(np.rad2deg(room.angles), 12).tolist()),
        mount_m=tuple(np.asarray(room.mount, dtype=float).tolist()),
        range_m=(room.range_min, room.range_max),
        sigma_m=room.sigma,
        stray_share=room.strays,
    )
    tables = {"wall": msgspec.to_builtins(room.wall), "sensors": msgspec.to_builtins(sensors)}
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {msgspec.json.encode(v).decode()}\n" for key, v in values.items())
        for name, values in tables.items()
    )


def save(room: Room, path: Path | str) -> None:
    """Write the room as TOML; raises OutputError where that fails."""
    try:
        Path(path).write_text(dump(room))
    except OSError as error:
        raise OutputError(
            f"{path}: cannot write the room ({error.strerror}); want a folder that exists"
        ) from error


def as_dict(room: Room) -> dict[str, Any]:
    """What `dump` writes, as plain values for a summary."""
    return dict(msgspec.toml.decode(dump(room)))
