"""Folders of which every file is one thing to choose by name: its files are the names, no list is kept."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numpy as np

from outrider.errors import InputError


def files(*folders: Path | str) -> list[str]:
    """Names of the Python files in some folders, sorted; one that begins with an underscore is none."""
    return sorted(m.name for m in iter_modules(list(map(str, folders))) if not m.name.startswith("_"))


def load(package: str, name: str, known: Collection[str], what: str) -> Any:
    """The module of `package` called `name`; InputError, with the nearest names, where it is not known."""
    if name not in known:
        raise InputError(f"{what} {name!r} is not known{nearest(name, known)}")
    return import_module(f"{package}.{name}")


def replaced(gains: Any, values: Mapping[str, float], where: str = "gain ") -> Any:
    """A NamedTuple with some of its numbers replaced; InputError for an unknown name or no finite number.

    where: what stands before a name in the message.
    """
    known = [name for name, value in gains._asdict().items() if isinstance(value, float)]
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{where}{name!r} is not known{nearest(name, known)}")
        if not np.isfinite(value):
            raise InputError(f"{where}{name} = {value}; want a finite number")
    return gains._replace(**{name: float(value) for name, value in values.items()})


def nearest(name: str, known: Collection[str]) -> str:
    """Tail of an error message: the names nearest to a wrong one, or all there are."""
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    if close:
        return f"; did you mean {', '.join(close)}?"
    return f"; want one of {', '.join(known)}" if known else "; there is none"
