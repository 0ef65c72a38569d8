"""Frozen settings with defaults that work; read from TOML, written beside every result.

Lengths are those of the full-size world. Where a recording is a scale model, `recording.scale` multiplies
every length of the recording on the way in and divides every length on the way out; only `mount` is in the
recording's own metres. Sources of the numbers are in docs/settings.md.
"""

from __future__ import annotations

import difflib
import hashlib
from pathlib import Path
from typing import Any, Literal

import msgspec

from outrider.errors import InputError


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections: frozen, and an unknown key is an error."""


class Recording(Section, frozen=True):
    """Which parts of a recording to use; empty means: find by type."""

    scan_topic: str = ""  # topic of the laser scans
    ego_topic: str = ""  # "none": ignore what is there, the sensor is taken as standing
    truth_topics: tuple[str, ...] = ()  # ("none",): ignore
    scale: float = 1.0  # full-size length / length in the recording


class Timing(Section, frozen=True):
    """When each beam was measured; None: from the recording, repaired where it is wrong (docs/scans.md)."""

    scan_time_s: float | None = None  # duration of one turn
    time_increment_s: float | None = None  # negative: beams are stored against time
    stamp_offset_s: float | None = None  # time of beam 0 minus the header stamp


class Mount(Section, frozen=True):
    """Pose of the sensor on the rider's body, in the recording's own metres."""

    x_m: float = 0.0  # ahead of the body's origin
    y_m: float = 0.0  # left of it
    yaw_rad: float = 0.0  # counter-clockwise from straight ahead


class Rider(Section, frozen=True):
    """Footprint of the rider's own vehicle, a rectangle in the frame of the body."""

    length_m: float = 1.2  # of the footprint
    width_m: float = 0.6  # of the footprint
    centre_x_m: float = 0.0  # of the rectangle, ahead of the body's origin
    margin_m: float = 0.3  # added on every side


class Detect(Section, frozen=True):
    """Segmentation of a scan and the fit of rectangles."""

    range_noise_m: float = 0.02  # standard deviation of one range
    shape_noise_m: float = 0.06  # how far a body's outline is from its rectangle
    max_range_m: float = 60.0  # returns further away are not looked at
    breakpoint_angle_rad: float = 0.175  # lambda of the adaptive breakpoint detector
    max_gap_beams: int = 3  # a longer run of beams without return splits a segment
    max_break_m: float = 1.2  # two neighbours further apart than this never belong together
    min_hits: int = 3  # fewer returns: SMALL
    min_length_m: float = 0.3  # both sides shorter: SMALL
    max_length_m: float = 7.5  # longer: LARGE
    max_width_m: float = 3.2  # wider: LARGE
    body_length_m: float | None = None  # of every vehicle where known; None: learnt over each track's life
    body_width_m: float | None = None  # the same for the width


class Track(Section, frozen=True):
    """Life of a track and the prediction that association uses."""

    gate_sigma: float = 4.0  # Mahalanobis distance within which a detection may belong to a track
    confirm_hits: int = 3  # scans with a hit before a tentative track is confirmed
    confirm_window: int = 5  # scans in which those hits must fall
    coast_s: float = 1.0  # a moving track not seen for longer is deleted
    forget_static_s: float = 20.0  # a static track not seen for longer is forgotten
    acceleration_noise: float = 6.0  # white acceleration of the gate's predictor [m/s2]
    yaw_acceleration_noise: float = 4.0  # its white yaw acceleration [rad/s2]
    moving_speed_mps: float = 0.7  # slower is not called moving
    moving_distance_m: float = 0.6  # net way before a track is called moving
    drift_per_range: float = 0.02  # how far a standing body seems to wander, per metre of range


class Observer(Section, frozen=True):
    """Which observer, by name of its file in observers/, and gains that differ from its defaults."""

    name: str = "ekf"  # file in observers/; NAME:GAINS for gains it names; +lagN: also N scans late
    gains: dict[str, dict[str, float]] = {}  # by observer: gain by name, where it differs from the default


class Envelope(Section, frozen=True):
    """Guaranteed bounds: what is assumed of the sensor and of every road user (docs/bounds.md)."""

    position_m: float = 0.0  # a measured centre is off by at most this; 0: nothing is assumed, no bounds
    acceleration_mps2: float = 8.0  # no road user's centre accelerates more, in any direction [m/s2]
    speed_mps: float = 30.0  # none is faster


class Threat(Section, frozen=True):
    """Prediction of contact."""

    horizon_s: float = 6.0  # how far ahead paths are predicted
    step_s: float = 0.1  # between the predicted poses that are compared
    corridor_width_m: float = 3.0  # lateral corridor ahead of and behind the rider


class Alert(Section, frozen=True):
    """Warning ladder, debounce, hysteresis and the limits of trust."""

    act_on: Literal["expected", "earliest"] = "expected"  # which time to collision; earliest: by the bounds
    notice_s: float = 4.0  # time to collision below which NOTICE is asked for
    caution_s: float = 3.0  # CAUTION
    danger_s: float = 1.7  # DANGER
    debounce_scans: int = 2  # a level must be asked for this many scans in a row
    release_s: float = 0.5  # a level is kept until it has not been asked for this long
    stale_after_s: float = 0.5  # no scan for longer: degraded
    min_valid: float = 0.02  # smaller share of valid beams: degraded
    min_speed_mps: float = 0.5  # closing speed below which nothing is alerted


class Settings(Section, frozen=True):
    """Everything that shapes a run."""

    recording: Recording = Recording()
    timing: Timing = Timing()
    mount: Mount = Mount()
    rider: Rider = Rider()
    detect: Detect = Detect()
    track: Track = Track()
    observer: Observer = Observer()
    envelope: Envelope = Envelope()
    threat: Threat = Threat()
    alert: Alert = Alert()


def _explain(error: msgspec.ValidationError, where: str) -> InputError:
    text = str(error)
    known = sorted(f"{s}.{f}" for s in Settings.__struct_fields__ for f in _fields(s))
    unknown = text.split("unknown field `")[1].split("`")[0] if "unknown field `" in text else ""
    section = text.split("`$.")[1].split("`")[0] + "." if "`$." in text else ""
    close = difflib.get_close_matches(section + unknown, known, n=3, cutoff=0.4) if unknown else []
    hint = f"; did you mean {', '.join(close)}?" if close else "; see docs/settings.md"
    return InputError(f"{where}: {text}{hint}")


def _fields(section: str) -> tuple[str, ...]:
    value: Section = getattr(Settings(), section)
    return value.__struct_fields__


def load(path: Path | str) -> Settings:
    """Settings from a TOML file; raises InputError for an unknown key, a wrong type or an unreadable file."""
    path = Path(path)
    try:
        return msgspec.toml.decode(path.read_bytes(), type=Settings)
    except OSError as error:
        raise InputError(f"{path}: cannot read settings ({error.strerror}); want a TOML file") from error
    except msgspec.ValidationError as error:
        raise _explain(error, str(path)) from error
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: not TOML ({error}); want lines like [detect] and min_hits = 3") from error


def override(settings: Settings, assignments: list[str]) -> Settings:
    """Settings with `section.key=value` replaced, value as in TOML (a bare word is taken as a string)."""
    tree = msgspec.to_builtins(settings)
    for text in assignments:
        name, sep, value = text.partition("=")
        parts = name.strip().split(".")
        if not sep or len(parts) < 2:
            raise InputError(f"--set {text!r}: want section.key=value, such as detect.min_hits=5")
        node: Any = tree
        for part in parts[:-1]:
            node = node.setdefault(part, {}) if isinstance(node, dict) else None
        if not isinstance(node, dict):
            raise InputError(
                f"--set {text!r}: {'.'.join(parts[:-1])} is a value, not a section; want section.key=value"
            )
        node[parts[-1]] = _value(value.strip(), isinstance(node.get(parts[-1]), str))
    try:
        return msgspec.convert(tree, type=Settings)
    except msgspec.ValidationError as error:
        raise _explain(error, "--set") from error


def _value(text: str, text_wanted: bool) -> Any:
    try:
        return msgspec.toml.decode(f"v = {text}".encode())["v"]
    except msgspec.DecodeError:
        return None if text == "none" and not text_wanted else text


def dump(settings: Settings) -> str:
    """The settings as TOML, one `section.key` a line; a key whose value is None is left out (its default)."""
    lines: list[str] = []
    for section, values in msgspec.to_builtins(settings).items():
        lines.append(f"[{section}]")
        lines += [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
        lines.append("")
    return "\n".join(lines)


def fingerprint(settings: Settings) -> str:
    """First 16 hex digits of the SHA-256 of the settings as `dump` writes them."""
    return hashlib.sha256(dump(settings).encode()).hexdigest()[:16]


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, float):
        return repr(value)  # inf and nan are TOML, but not JSON
    return msgspec.json.encode(value).decode().replace("\x7f", "\\u007f")
