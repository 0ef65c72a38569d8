"""A place for results: new, or to be replaced; what the file system refuses is one line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from outrider.errors import InputError, OutputError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """OutputError, in one line, where the file system says no."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(
            f"{path}: cannot write ({reason}); what was written before stays readable; "
            "free some space or name another folder with -o"
        ) from error


def may_write(path: Path, force: bool) -> None:
    """InputError where something is there already, unless `force`."""
    if path.exists() and not force:
        raise InputError(f"{path}: exists; choose another name, or --force to replace it")


def prepare(folder: Path, force: bool = False) -> None:
    """Make a folder for results; InputError where it is a file or not empty, unless `force`; OutputError."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; want a folder for the results")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()) and not force:
            raise InputError(
                f"{folder}: not empty; name another folder or use --force to replace its results"
            )


def describe(
    folder: Path, summary: Mapping[str, Any], settings: Mapping[str, Any], gains: Mapping[str, float]
) -> None:
    """Write summary.json, and settings.toml with the gains below the rest; OutputError where it cannot be."""
    lines = [f"{key} = {msgspec.json.encode(value).decode()}" for key, value in settings.items()]
    lines += ["", "[gains]", *(f"{key} = {float(value)!r}" for key, value in gains.items())]
    with writing(folder):
        (folder / "summary.json").write_bytes(msgspec.json.format(msgspec.json.encode(summary)) + b"\n")
        (folder / "settings.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
