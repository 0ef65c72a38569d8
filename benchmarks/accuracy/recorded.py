"""What the front end makes of real scans of a vehicle, with its truth; kept between runs of the same code."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

import numpy as np

import outrider
from outrider import datasets, measured, offline
from outrider.compare import Series
from outrider.metrics import Truth

# What does not touch the measurements: other observers, and what is downstream of them.
APART = (
    "compare.py",
    "comparison.py",
    "certificate.py",
    "inequalities.py",
    "family.py",
    "lag.py",
    "plots.py",
)


def load(run: str) -> list[Series]:
    """The series of a datmo run: a row a scan, as the tracker hands it to its observer."""
    name = f"datmo/{run}"
    file = Path(tempfile.gettempdir()) / f"outrider-series-{run}-{_fingerprint(name)}.npz"
    if not file.is_file():
        rows = {
            f"{i}": np.column_stack([s.t, s.y, s.truth.W_p, s.truth.W_v, s.truth.yaw])
            for i, s in enumerate(measured.measure(f"dataset:{name}").series)
        }
        part = file.with_name(f"{file.stem}-{np.random.default_rng().integers(1 << 62)}.npz")
        np.savez(part, **rows)
        part.replace(file)
    with np.load(file) as kept:
        return [_series(name, kept[i]) for i in sorted(kept)]


def _series(name: str, rows: np.ndarray) -> Series:
    t, y, p, v, yaw = np.split(rows, [1, 10, 12, 14], axis=1)
    return Series(name, t[:, 0], np.ascontiguousarray(y), Truth(t[:, 0], p, v, yaw[:, 0]))


def _fingerprint(name: str) -> str:
    """Of the code and settings that the measurements come from."""
    package = Path(outrider.__file__).parent
    settled = offline.settle(datasets.entry(name).settings, None)
    used = {f"{n}.py" for n in ("__init__", "_measured", settled.observer.name)}
    digest = hashlib.sha256(repr(settled).encode())
    for path in sorted(package.rglob("*.py")):
        folder = path.parent.name
        other = folder == "observers" and path.name not in used
        if folder not in ("cli", "design") and path.name not in APART and not other:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
