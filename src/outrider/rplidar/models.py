"""Lidars and their ways of scanning: what is known of a model without asking it, and which mode to take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from outrider.errors import InputError
from outrider.rplidar.protocol import Answer, Info, SampleRate

DECODED = (Answer.STANDARD, Answer.EXPRESS, Answer.DENSE, Answer.ULTRA_DENSE)


class Mode(NamedTuple):
    """One way of scanning."""

    id: int
    name: str
    answer: int  # Answer
    sample_us: float  # between two samples
    range_max: float  # [m]


def choose(modes: Sequence[Mode], wanted: str | None = None) -> Mode:
    """The mode by name in any case, or the one with most samples a second that is decoded.

    InputError for a name that is not there, or for answer 84, which is patented and not decoded.
    """
    can = [mode for mode in modes if mode.answer in DECODED]
    if wanted is None and can:
        return min(can, key=lambda mode: mode.sample_us)
    names = " or ".join(f"'{mode.name}'" for mode in can) or "another lidar"
    found = next((mode for mode in modes if mode.name.lower() == (wanted or "").lower()), None)
    if found is None:
        raise InputError(f"no mode {wanted!r} here: want {names}")
    if found not in can:
        refuse(found, names)
    return found


def refuse(mode: Mode, instead: str) -> None:
    """InputError for a mode whose answer is not decoded, naming what to choose instead."""
    why = "is under a patent (CN 108306649 A)" if mode.answer == Answer.ULTRA else "is not known"
    raise InputError(
        f"mode {mode.name!r} answers {mode.answer:02X}, which {why} and not decoded: choose {instead}"
    )


class Model(NamedTuple):
    """What is known of a lidar without asking it; an emulator answers so, a real one is asked."""

    name: str
    model: int  # Info.model
    firmware: tuple[int, int]  # major, minor
    baud: int
    range_min: float  # [m]
    modes: tuple[Mode, ...]  # modes of S and C are the maker's as far as they are known


def _modes(range_max: float, *rows: tuple[str, Answer, float]) -> tuple[Mode, ...]:
    return tuple(Mode(i, name, answer, us, range_max) for i, (name, answer, us) in enumerate(rows))


_A1 = (
    ("Standard", Answer.STANDARD, 508.0),
    ("Express", Answer.EXPRESS, 254.0),
    ("Boost", Answer.ULTRA, 127.0),
)
_A3 = (
    ("Standard", Answer.STANDARD, 252.0),
    ("Express", Answer.EXPRESS, 126.0),
    ("Boost", Answer.ULTRA, 63.0),
    ("Sensitivity", Answer.ULTRA, 63.0),
    ("Stability", Answer.ULTRA, 100.0),
)
_C1 = (("Standard", Answer.STANDARD, 200.0), ("DenseBoost", Answer.DENSE, 200.0))
_S2 = (("Standard", Answer.STANDARD, 100.0), ("DenseBoost", Answer.DENSE, 31.25))
_S3 = (("Standard", Answer.STANDARD, 100.0), ("DenseBoost", Answer.ULTRA_DENSE, 31.25))
MODELS = {
    "A1": Model("A1", 0x18, (1, 29), 115_200, 0.15, _modes(12.0, *_A1)),
    "A3": Model("A3", 0x31, (1, 29), 256_000, 0.15, _modes(25.0, *_A3)),
    "C1": Model("C1", 0x41, (1, 2), 460_800, 0.05, _modes(12.0, *_C1)),
    "S2": Model("S2", 0x71, (1, 2), 1_000_000, 0.05, _modes(30.0, *_S2)),
    "S3": Model("S3", 0x81, (1, 2), 1_000_000, 0.05, _modes(40.0, *_S3)),
}
BAUDS = (115_200, 256_000, 460_800, 1_000_000)  # the likeliest first


def old_modes(rate: SampleRate, range_max: float = 12.0) -> tuple[Mode, ...]:
    """The modes of a lidar too old to tell them: by GET_SAMPLERATE."""
    rows = (
        ("Standard", Answer.STANDARD, float(rate.standard_us)),
        ("Express", Answer.EXPRESS, float(rate.express_us)),
    )
    return _modes(range_max, *rows)


def nearest_model(info: Info) -> Model:
    """The model of MODELS of the same series, for what GET_CONF does not tell."""
    return min(MODELS.values(), key=lambda model: abs(model.model - info.model))
