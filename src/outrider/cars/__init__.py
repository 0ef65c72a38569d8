"""Cars by name or file: what the lateral estimators know of a vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from outrider.errors import InputError, OutputError

FOLDER = Path(__file__).parent


class Car(NamedTuple):
    """A car as a single track; stiffness is that of both wheels of an axle together."""

    mass: float  # [kg]
    inertia: float  # about the vertical axis [kg m2]
    front: float  # centre of gravity to front axle, l_f [m]
    rear: float  # centre of gravity to rear axle, l_r [m]
    front_stiffness: float  # cornering stiffness of the front axle, C_f [N/rad]
    rear_stiffness: float  # of the rear axle, C_r [N/rad]
    steering_gain: float = 1.0  # angle of the front wheels over what the log has as steering [-]
    steering_offset: float = 0.0  # angle of the front wheels where the log has none [rad]
    roll_gain: float = 0.0  # roll angle over ay: the sensor reads ay (1 + g roll_gain) [rad s2/m]
    front_grip: float = 1.0  # most lateral force of the axle over its load at rest, at friction 1 [-]
    rear_grip: float = 1.0  # the same of the rear axle [-]


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A car as it is written: one unit in each name."""

    name: str = ""
    mass_kg: float
    inertia_kgm2: float
    front_m: float
    rear_m: float
    front_stiffness_n_per_rad: float
    rear_stiffness_n_per_rad: float
    steering_gain: float = 1.0
    steering_offset_rad: float = 0.0
    roll_gain_rad_s2_per_m: float = 0.0
    front_grip: float = 1.0
    rear_grip: float = 1.0


FIELDS = dict(zip(Car._fields, _File.__struct_fields__[1:], strict=True))  # of Car -> of the file
POSITIVE = (*Car._fields[:6], "steering_gain", "front_grip", "rear_grip")


def names() -> list[str]:
    """Names of the cars that come with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load(name: str | Path) -> Car:
    """A car by name (see `names`) or from a TOML file; InputError for what is unknown or no number."""
    path = FOLDER / f"{name}.toml" if str(name) in names() else Path(name)
    if path.suffix != ".toml":
        raise InputError(f"car {str(name)!r} is not known; want one of {', '.join(names())}, or a TOML file")
    try:
        made = msgspec.toml.decode(path.read_bytes(), type=_File)
    except OSError as error:
        raise InputError(f"{path}: cannot read car ({error.strerror}); want a TOML file") from error
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: no car ({error}); want {', '.join(FIELDS.values())}") from error
    return checked(Car(*(float(getattr(made, field)) for field in FIELDS.values())), str(path))


def checked(car: Car, where: str) -> Car:
    """The car itself; InputError where a number cannot be."""
    for field, value in car._asdict().items():
        if not abs(value) < float("inf") or (field in POSITIVE and not value > 0.0):
            want = "a positive number" if field in POSITIVE else "a finite number"
            raise InputError(f"{where}: {FIELDS[field]} = {value:g}; want {want}")
    return car


def save(car: Car, path: str | Path, name: str = "") -> None:
    """Write as TOML; OutputError where that cannot be."""
    content: dict[str, Any] = {"name": name} if name else {}
    content |= {FIELDS[field]: value for field, value in car._asdict().items()}
    lines = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in content.items()]
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write ({error.strerror}); choose another place") from error
