"""Proofs that come with the package, put together with the gains they are for."""

from __future__ import annotations

from typing import Any

from outrider import observers, proof_file
from outrider.certificate import Certificate
from outrider.errors import InputError
from outrider.proof_file import ProofFile


def certificate(name: str, gains: Any) -> Certificate:
    """What the shipped proof `name` says of these gains; made for its own, it may fail for others."""
    return certificate_of(proof_file.shipped(name), gains)


def certificate_of(file: ProofFile, gains: Any = None) -> Certificate:
    """The certificate that a file claims, its error matrices made anew; `gains`: other ones than the file's.

    InputError for an observer, gain, form or region that this version does not know.
    """
    observer: Any = observers.get(file.observer)
    if not hasattr(observer, "claim"):
        raise InputError(f"observer {file.observer!r} claims nothing; want one with a proof")
    if gains is None:
        missing = observer.Gains._fields - file.gains.keys()
        if missing:
            raise InputError(f"{file.observer}: {len(missing)} gains are missing; make it anew")
        gains = observers.gains_from(observer, file.gains)
    try:
        claim = observer.claim(gains, file.form, **file.asked)
    except TypeError as error:
        raise InputError(f"{file.observer}: no such region ({error}); make it anew") from error
    made: Certificate = claim.certificate(file.P, file.rate, file.proofs)
    return made
