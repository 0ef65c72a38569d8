"""Gains of an observer and the numbers that prove what is claimed of them, as one file of JSON.

The file holds no error matrices: they are made anew from the gains and the region, so a proof cannot be read
without the gain it is for. Its digest tells an edited file; the proof is checked whatever the digest says.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider.certificate import Certificate
from outrider.claim import Proof
from outrider.errors import InputError, NotCertified, OutputError

Array = npt.NDArray[np.float64]

FORMAT, VERSION, UNITS = "outrider gains", 1, "SI, rad"
SHIPPED = Path(__file__).parent / "observers" / "shipped"
KEYS = {"format", "version", "units", "observer", "form", "gains", "asked", "rate", "P", "proofs", "made"}


@dataclass(frozen=True, slots=True)
class ProofFile:
    """What the file holds; nothing of it is believed before `certificate_of` has checked it."""

    observer: str  # name in observers/
    form: str  # of the claim: continuous or sampled
    gains: Mapping[str, float]  # of the observer, by name, all of them
    asked: Mapping[str, Any]  # region and what else the claim depends on, by argument of the observer's claim
    rate: float  # continuous: [1/s]; sampled: factor of a step [-]
    P: Array  # (n, n)
    proofs: tuple[Proof, ...] = ()  # of bounds
    made: Mapping[str, Any] = field(
        default_factory=dict
    )  # by which version and solver, how long, what margin


def write(file: ProofFile, path: str | Path) -> None:
    """Write as JSON, numbers to the last bit; OutputError where that cannot be."""
    content = _plain(file)
    content["digest"] = _digest(content)
    lines = (f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in content.items())
    try:
        Path(path).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); choose another place") from error


def read(path: str | Path) -> ProofFile:
    """What a file of `write` holds.

    InputError for a file that is missing, truncated, of another version or unit, or holds something else;
    NotCertified for one that was edited since it was made.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); want a file of outrider design"
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: no JSON ({error}); the file is damaged, make it anew") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: no gains with a proof; want a file that outrider design wrote")
    for key, want in (("version", VERSION), ("units", UNITS)):
        if content.get(key) != want:
            raise InputError(
                f"{path}: {key} {content.get(key)!r}; want {want!r}; make it anew with this outrider"
            )
    digest = content.pop("digest", None)
    if content.keys() != KEYS:
        odd = ", ".join(sorted(content.keys() ^ KEYS))
        raise InputError(f"{path}: not whole, or not only what belongs there ({odd}); make it anew")
    if digest != _digest(content):
        raise NotCertified(f"{path}: edited since it was made: its digest is {digest}; make it anew")
    try:
        return _parsed(content)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not gains with a proof ({error}); make it anew") from error


def described(file: ProofFile, certificate: Certificate) -> dict[str, Any]:
    """Gains, region, bounds and margin in plain numbers and words, for scripts."""
    bounds = [
        {"of": b.of, "by": b.by, "kind": b.kind, "gain": b.gain, "exact": b.exact} for b in certificate.bounds
    ]
    return {
        "observer": file.observer,
        "form": file.form,
        "gains": dict(file.gains),
        "proven": certificate.proven(),
        "margin": certificate.margin(),
        "rounding": certificate.tolerance(),
        "rate": file.rate,
        "region": dict(certificate.region),
        "bounds": bounds,
        "assumptions": list(certificate.assumptions),
        "made": dict(file.made),
    }


def shipped(name: str) -> ProofFile:
    """The proof that comes with the package: OBSERVER of its default gains, OBSERVER.GAINS of others."""
    return read(SHIPPED / f"{name}.json")


def shipped_names(observer: str) -> list[str]:
    """Names of an observer's proofs that come with the package."""
    return sorted(p.stem for p in SHIPPED.glob("*.json") if p.stem.partition(".")[0] == observer)


def _parsed(content: Mapping[str, Any]) -> ProofFile:
    numbers = [content["rate"], *content["gains"].values(), *np.ravel(content["P"])]
    proofs = tuple(
        Proof(
            str(p["of"]),
            str(p["by"]),
            str(p["kind"]),
            float(p["gain"]),
            np.array(p["P"], float),
            float(p["a"]),
        )
        for p in content["proofs"]
    )
    if not all(isinstance(v, int | float) and isfinite(v) for v in numbers):
        raise ValueError("a number is not finite")
    return ProofFile(
        str(content["observer"]),
        str(content["form"]),
        {str(name): float(value) for name, value in content["gains"].items()},
        {str(k): tuple(v) if isinstance(v, list) else v for k, v in content["asked"].items()},
        float(content["rate"]),
        np.array(content["P"], float),
        proofs,
        dict(content["made"]),
    )


def _plain(file: ProofFile) -> dict[str, Any]:
    proofs = [{**p._asdict(), "P": p.P.tolist()} for p in file.proofs]
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": UNITS,
        "observer": file.observer,
        "form": file.form,
        "gains": dict(file.gains),
        "asked": {k: list(v) if isinstance(v, tuple) else v for k, v in file.asked.items()},
        "rate": file.rate,
        "P": file.P.tolist(),
        "proofs": proofs,
        "made": dict(file.made),
    }


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
