"""A certificate is checked from its definition: closed forms, tampering, files, bounds that are reached."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_lyapunov

from outrider import observers
from outrider.certificate import Bound, Certificate, load, peak
from outrider.errors import InputError, OutputError
from outrider.observers import multi_stage

STABLE = np.array([[0.0, 1.0], [-4.0, -2.0]])  # poles -1 +- 1.73i


def certified(
    A: Any = STABLE, P: Any = None, rate: float = 0.5, form: Any = "continuous", **more: Any
) -> Any:
    """Certificate of one matrix; P from its Lyapunov equation with the rate taken off."""
    n = len(A)
    if P is None and form == "continuous":
        P = solve_continuous_lyapunov((A + rate * np.eye(n)).T, -np.eye(n))
    elif P is None:
        P = solve_discrete_lyapunov((A / rate).T, np.eye(n))
    return Certificate(
        "made", form, np.asarray(A)[None], P, rate, {"speed [m/s]": (1.0, 2.0)}, ("None.",), **more
    )


def test_a_decay_that_is_there_is_proven_and_a_faster_one_is_not() -> None:
    proof = certified(rate=0.5)
    assert proof.proven()
    assert dataclasses.replace(proof, rate=0.99).proven() is False  # this P is for 0.5
    assert certified(rate=0.99).proven()
    assert not certified(P=np.eye(2), rate=0.99).proven()
    assert not dataclasses.replace(proof, rate=1.01).proven()


def test_the_margin_of_a_diagonal_matrix_is_known() -> None:
    """A = -a I, P = I: the slack is 2 a - 2 rate, the largest term a + rate (norms of A'P and rate P)."""
    proof = certified(A=-3.0 * np.eye(2), P=np.eye(2), rate=1.0)
    assert proof.margin() == pytest.approx(min(1.0, (2 * 3.0 - 2 * 1.0) / (3.0 + 1.0)))
    sampled = certified(A=0.5 * np.eye(2), P=np.eye(2), rate=0.8, form="sampled")
    assert sampled.margin() == pytest.approx((0.64 - 0.25) / (0.64 + 0.25))


@given(st.floats(1e-6, 1e6), st.floats(-3.0, 3.0))
def test_the_scale_of_p_and_the_frame_change_nothing(size: float, angle: float) -> None:
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    proof = certified()
    turned = certified(A=R @ STABLE @ R.T, P=size * (R @ proof.P @ R.T))
    assert turned.margin() == pytest.approx(proof.margin(), rel=1e-6)


def test_the_error_decays_at_least_as_fast_as_certified() -> None:
    proof = certified(rate=0.9)
    V = [e @ proof.P @ e for e in (expm(STABLE * t) @ [1.0, -2.0] for t in np.linspace(0.0, 5.0, 51))]
    assert (np.diff(np.log(V)) <= -2.0 * 0.9 * 0.1 + 1e-9).all()


@pytest.mark.parametrize(
    "change",
    [
        {"matrices": -STABLE[None]},
        {"P": -np.eye(2)},
        {"P": np.zeros((2, 2))},
        {"P": np.diag([1.0, 1e-20])},
        {"rate": -1.0},
        {"form": "sampled"},
    ],
)
def test_what_was_tampered_with_is_not_proven(change: dict[str, Any]) -> None:
    assert certified().proven()
    assert not dataclasses.replace(certified(), **change).proven()


def test_a_sampled_rate_above_one_is_no_decay() -> None:
    growing = certified(A=1.05 * np.eye(2), P=np.eye(2), rate=1.1, form="sampled")
    assert growing.margin() == -np.inf


# ---------------------------------------------------------------- bounds


def test_the_peak_of_a_first_order_lag_is_its_gain_at_rest() -> None:
    A, B, C = np.array([[-2.0]]), np.array([[3.0]]), np.array([[1.0]])
    assert peak(A, B, C, "continuous") == pytest.approx(1.5, rel=1e-9)
    assert peak(np.array([[0.5]]), B, C, "sampled") == pytest.approx(6.0, rel=1e-9)


def test_the_peak_of_an_oscillator_is_the_sum_of_its_half_waves() -> None:
    """Impulse response exp(-a t) sin(w t): each half wave is exp(-a pi / w) of the one before."""
    a, w = 0.3, 2.0
    A, B, C = np.array([[-a, w], [-w, -a]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    r = np.exp(-a * np.pi / w)
    assert peak(A, B, C, "continuous") == pytest.approx(w / (a**2 + w**2) * (1 + r) / (1 - r), rel=1e-9)


def test_the_worst_disturbance_reaches_the_peak() -> None:
    """Sampled: the sign of the impulse response, backwards in time, gives the bound itself."""
    A, B, C = np.array([[0.9, 0.3], [-0.3, 0.8]]), np.array([[1.0], [0.5]]), np.array([[1.0, 0.0]])
    h = [float((C @ np.linalg.matrix_power(A, k) @ B)[0, 0]) for k in range(400)]
    x = np.zeros((2, 1))
    for k in reversed(range(400)):
        x = A @ x + B * np.sign(h[k])
    assert float((C @ x)[0, 0]) == pytest.approx(peak(A, B, C, "sampled"), rel=1e-9)


def test_an_unstable_error_has_no_peak() -> None:
    assert peak(-STABLE, np.ones((2, 1)), np.ones((1, 2)), "continuous") == np.inf
    with pytest.raises(InputError, match="one disturbance and one output"):
        peak(STABLE, np.ones((2, 2)), np.ones((1, 2)), "continuous")


def exact(gain: float) -> Bound:
    B, C = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    return Bound("speed", "path", gain, True, "peak", STABLE[None], B[None], C)


def test_a_bound_counts_in_the_margin() -> None:
    true = peak(STABLE, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), "continuous")
    assert certified(bounds=(exact(true),)).margin() == certified().margin()
    assert certified(bounds=(exact(0.99 * true),)).margin() == pytest.approx(-0.01, rel=1e-3)
    assert certified(bounds=(Bound("speed", "path", 1.0, False),)).margin() == -np.inf


def test_an_ellipsoid_and_an_energy_are_checked_from_their_definition() -> None:
    """x' = -x + d: with P = 1 and a = 1 the ellipsoid is |x| <= 1; the L2 gain is 1: both just reached."""
    one = np.ones((1, 1, 1))
    for kind in ("peak", "energy"):
        bound = Bound("x", "d", 1.02, False, kind, -one, one, one[0], one[0], 1.0)
        assert bound.margin("continuous") == pytest.approx(0.0, abs=0.05)
        low = dataclasses.replace(bound, gain=0.98)
        assert low.margin("continuous") < -1e-3
    energy = Bound("x", "d", 1.02, False, "energy", -one, one, one[0], 1.01 * one[0])
    assert energy.margin("continuous") > 1e-3


# ---------------------------------------------------------------- files


def test_a_file_gives_back_every_bit(tmp_path: Any) -> None:
    proof = multi_stage.certificate()
    proof.save(tmp_path / "proof.json")
    again = load(tmp_path / "proof.json")
    np.testing.assert_array_equal(again.matrices, proof.matrices)
    np.testing.assert_array_equal(again.P, proof.P)
    assert (again.rate, again.region, again.assumptions) == (proof.rate, proof.region, proof.assumptions)
    assert [b.gain for b in again.bounds] == [b.gain for b in proof.bounds]
    assert again.margin() == proof.margin()
    assert str(again) == str(proof)


def written(path: Any, change: Any) -> Any:
    """A saved certificate with its JSON changed."""
    certified(bounds=(exact(5.0),)).save(path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return path


def test_an_edited_number_is_found_out(tmp_path: Any) -> None:
    def faster(content: Any) -> None:
        content["rate"] = 5.0

    assert not load(written(tmp_path / "p.json", faster)).proven()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(version=2), "version 2; want 1"),
        (lambda c: c.update(format="else"), "not a certificate"),
        (lambda c: c.pop("P"), "not a whole certificate"),
        (lambda c: c.update(P=[[1.0]]), r"P has shape \(1, 1\); want \(2, 2\)"),
        (lambda c: c.update(P=[["a", 1.0], [1.0, 1.0]]), "no array of numbers"),
        (lambda c: c.update(form="other"), "form 'other'"),
        (lambda c: c.update(region={"speed": 3.0}), "not a whole certificate"),
        (lambda c: c["bounds"][0].update(B=[[[1.0]]]), r"B has shape \(1, 1, 1\); want \(1, 2, 1\)"),
        (lambda c: c.update(rate=float("nan")), "not finite"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Any, change: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load(written(tmp_path / "p.json", change))


def test_a_truncated_or_missing_file_is_refused(tmp_path: Any) -> None:
    path = tmp_path / "p.json"
    certified().save(path)
    path.write_text(path.read_text()[:100])
    with pytest.raises(InputError, match="damaged"):
        load(path)
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path / "none.json")
    with pytest.raises(OutputError, match="cannot be written"):
        certified().save(tmp_path / "no" / "p.json")


def test_what_is_no_certificate_is_refused_when_it_is_made() -> None:
    with pytest.raises(InputError, match="not finite"):
        certified(P=np.array([[np.nan, 0.0], [0.0, 1.0]]))
    with pytest.raises(InputError, match=r"matrices has shape \(1, 2, 3\)"):
        certified(A=np.ones((2, 3)), P=np.eye(3))


# ---------------------------------------------------------------- what is shipped


def test_the_report_says_what_is_proven() -> None:
    text = str(multi_stage.certificate())
    assert text.startswith("multi_stage: proven, margin 1.58e-04")
    for part in ("speed [m/s]: 1 to 20", "exp(-0.05 t)", "max |speed| <= 4.691 max |path|, exact", "assumes"):
        assert part in text
    assert "NOT PROVEN" in str(dataclasses.replace(multi_stage.certificate(), rate=1.0))


def test_the_whole_cascade_is_proven_with_the_table_switched_at_will() -> None:
    """E11: both tables, all 21 entries by one P, with 10 % between true and estimated speed."""
    for gains in (multi_stage.Gains(), multi_stage.DESIGNED):
        proof = multi_stage.certificate(gains)
        assert proof.margin() > 1e-4
        assert proof.matrices.shape[1:] == (8, 8)
        assert len(proof.matrices) == len(proof.corners) == (32 if gains.psi_V else 336)
    wrong = multi_stage.Gains(orientation=-1.0)
    assert not multi_stage.certificate(wrong).proven()


@pytest.mark.parametrize("name", observers.names())
def test_a_shipped_certificate_is_one_of_its_observer(name: str) -> None:
    proof = observers.get(name).certificate()
    if proof is None:
        pytest.skip("this observer has none")
    assert proof.observer == name
    assert proof.proven()
    assert proof.region
