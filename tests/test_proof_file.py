"""Files of gains with their proof: nothing is believed, and what is wrong is told."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outrider import observers, proof_file
from outrider.errors import InputError, NotCertified, OutputError
from outrider.observers import certificate_of, constant_velocity, high_gain, multi_stage

NAMES = sorted(p.stem for p in proof_file.SHIPPED.glob("*.json"))
SHIPPED = proof_file.shipped("high_gain.designed")


def rewritten(path: Path, change: Any, digest: bool = True) -> Path:
    """The shipped file with its content changed, and a digest that fits where `digest`."""
    content = json.loads((proof_file.SHIPPED / "high_gain.designed.json").read_text())
    kept = content.pop("digest")
    change(content)
    content["digest"] = proof_file._digest(content) if digest else kept
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("name", NAMES)
def test_what_is_shipped_is_proven_by_numpy_alone(name: str) -> None:
    file = proof_file.shipped(name)
    proof = certificate_of(file)
    assert proof.proven()
    assert proof.observer == name.partition(".")[0]
    assert len(proof.corners) == len(proof.matrices)
    assert proof.margin() == pytest.approx(file.made["margin"], rel=0.05)
    assert {p.of for p in file.proofs} <= {b.of for b in proof.bounds}


def test_a_file_gives_back_every_bit(tmp_path: Path) -> None:
    proof_file.write(SHIPPED, tmp_path / "gains.json")
    again = proof_file.read(tmp_path / "gains.json")
    np.testing.assert_array_equal(again.P, SHIPPED.P)
    assert dict(again.gains) == dict(SHIPPED.gains)
    assert dict(again.asked) == dict(SHIPPED.asked)
    assert certificate_of(again).margin() == certificate_of(SHIPPED).margin()


def test_every_observer_with_a_claim_ships_a_proof_of_its_defaults() -> None:
    for name in observers.names():
        observer: Any = observers.get(name)
        assert hasattr(observer, "claim") == (name in proof_file.shipped_names(name))
        assert (observer.certificate() is None) != hasattr(observer, "claim")


def test_named_gains_are_those_of_their_files() -> None:
    sets = {
        "high_gain.designed": high_gain.DESIGNED,
        "high_gain.published": high_gain.PUBLISHED,
        "multi_stage.designed": multi_stage.DESIGNED,
        "constant_velocity.designed": constant_velocity.DESIGNED,
    }
    for name, gains in sets.items():
        assert dict(proof_file.shipped(name).gains) == gains._asdict()


# ---------------------------------------------------------------- tampering


def test_an_edited_digit_is_found_by_the_digest(tmp_path: Path) -> None:
    def change(content: Any) -> None:
        content["gains"]["L1"] += 1e-9

    with pytest.raises(NotCertified, match="edited since it was made") as caught:
        proof_file.read(rewritten(tmp_path / "g.json", change, digest=False))
    assert caught.value.exit_code == 3


def test_an_unstable_gain_with_a_good_digest_is_refused_by_its_eigenvalue(tmp_path: Path) -> None:
    """K = [11.73 20.25 -7.3] with the powers of theta, in a file whose digest fits."""

    def change(content: Any) -> None:
        content["gains"] |= {"L1": 78.83, "L2": 914.6, "L3": -2215.8}

    proof = certificate_of(proof_file.read(rewritten(tmp_path / "g.json", change)))
    assert not proof.proven()
    assert "eigenvalue +3.429" in proof.failing()


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.update(rate=2.0),
        lambda c: c["asked"].update(yaw_rate=3.0),
        lambda c: c["gains"].update(L3=400.0),
        lambda c: c["proofs"][1].update(gain=0.5 * c["proofs"][1]["gain"]),
        lambda c: c.update(P=np.eye(6).tolist()),
    ],
    ids=["rate", "region", "gain", "bound", "P"],
)
def test_a_claim_that_was_made_larger_is_not_proven(tmp_path: Path, change: Any) -> None:
    assert not certificate_of(proof_file.read(rewritten(tmp_path / "g.json", change))).proven()


def test_a_p_that_treats_the_axes_differently_is_refused(tmp_path: Path) -> None:
    """It would pass as a matrix, but the frame of the velocity may turn only where both axes are alike."""

    def change(content: Any) -> None:
        content["P"][0][0] *= 1.0001

    with pytest.raises(NotCertified, match="blocks"):
        certificate_of(proof_file.read(rewritten(tmp_path / "g.json", change)))


# ---------------------------------------------------------------- bad files


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(version=2), "version 2; want 1"),
        (lambda c: c.update(units="imperial"), "units 'imperial'; want 'SI, rad'"),
        (lambda c: c.update(format="other"), "no gains with a proof"),
        (lambda c: c.pop("P"), "not whole"),
        (lambda c: c.update(more=1), "not whole"),
        (lambda c: c["gains"].update(L1=float("nan")), "not finite"),
        (lambda c: c.update(rate=None), "not finite"),
        (lambda c: c["proofs"][0].pop("a"), "not gains with a proof"),
    ],
)
def test_a_file_that_is_not_right_is_refused(tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        proof_file.read(rewritten(tmp_path / "g.json", change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(observer="ekf"), "claims nothing"),
        (lambda c: c.update(observer="nobody"), "not known"),
        (lambda c: c.update(form="discrete"), "want continuous or sampled"),
        (lambda c: c["asked"].update(roll=1.0), "no such region"),
        (lambda c: c["asked"].update(speed=0.0), "above 0"),
        (lambda c: c["gains"].pop("L2"), "missing"),
        (lambda c: c["gains"].update(L4=1.0), "not known"),
        (lambda c: c["proofs"][0].update(of="mass"), "no bound is sought on mass"),
        (lambda c: c.update(P=[[1.0]]), "want"),
    ],
)
def test_a_claim_nobody_makes_is_refused(tmp_path: Path, change: Any, message: str) -> None:
    file = proof_file.read(rewritten(tmp_path / "g.json", change))
    with pytest.raises(InputError, match=message):
        certificate_of(file)


def test_a_truncated_missing_or_foreign_file_is_refused(tmp_path: Path) -> None:
    text = (proof_file.SHIPPED / "multi_stage.json").read_text()
    for name, content in (("cut", text[: len(text) // 2]), ("list", "[]"), ("text", "gains")):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError):
            proof_file.read(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        proof_file.read(tmp_path / "none.json")
    with pytest.raises(OutputError, match="cannot be written"):
        proof_file.write(SHIPPED, tmp_path / "no" / "folder.json")


def test_a_claim_over_another_region_is_another_claim() -> None:
    narrow = dataclasses.replace(SHIPPED, asked={**SHIPPED.asked, "yaw_rate": 0.1})
    assert certificate_of(narrow).proven()  # inside what was proven
    assert certificate_of(narrow).region["course rate [rad/s]"] == (-0.1, 0.1)
