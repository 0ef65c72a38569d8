"""Gains from inequalities: the papers' figures put right, refusals that say why, and designs that hold."""

import re
import sys
from math import radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import certificates

from outrider import design, family, inequalities, proof_file
from outrider.certificate import Certificate, peak
from outrider.claim import Claim, Sought
from outrider.errors import InputError, NotCertified
from outrider.observers import multi_stage
from outrider.observers.multi_stage import L_BETA, L_PSI, NOMINAL

pytestmark = pytest.mark.once

PUBLISHED_SPEED = [4.61, 12.24, 9.83, 4.16]
PUBLISHED_HIGH_GAIN = [67.20, 823.1, 2818.5]


def entry(V: float) -> np.ndarray:
    """Column (2, 1) of Table I."""
    i = NOMINAL.index(V)
    return np.array([[L_PSI[i]], [L_BETA[i]]])


# ---------------------------------------------------------------- coefficients from values


def test_a_problem_reads_its_coefficients_off_the_function() -> None:
    """Least t with P <= t I, P >= A for a given A: its largest eigenvalue."""
    A = np.array([[2.0, 1.0, 0.0], [1.0, -1.0, 0.5], [0.0, 0.5, 0.3]])
    problem = design.Problem()
    P, t = problem.symmetric(3), problem.number()
    problem.below(lambda P: A - P, P)
    problem.below(lambda t, P: P - t * np.eye(3), t, P)
    solved = problem.minimise(t)
    assert solved.optimal
    assert problem.found(t, solved, "") == pytest.approx(np.linalg.eigvalsh(A)[-1], abs=1e-6)
    found = problem.found(P, solved, "")
    np.testing.assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found - A)[0] > -1e-6


def test_what_has_no_solution_is_refused() -> None:
    problem = design.Problem()
    t = problem.number()
    problem.below(lambda t: t + 1.0, t)
    problem.below(lambda t: 1.0 - t, t)
    solved = problem.minimise(t)
    assert not solved.optimal
    with pytest.raises(NotCertified, match="found nothing: relax it"):
        problem.found(t, solved, "relax it")


def test_the_printed_orientation_inequality_is_the_one_in_the_paper() -> None:
    """[MS 58] block by block, corrected, with M2, M3, M4 as they are written there."""
    P, Y, V, l = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[0.7], [0.2]]), 5.0, 2.0
    G, H, e1, e2, mu = np.array([[1.0], [0.0]]), np.array([[1.0, 1.0]]), 4.0, 0.5, 1.1
    zero = np.zeros((1, 1))
    left = np.block(
        [
            [-(Y @ H + H.T @ Y.T), P @ G * V / l, P @ G, -Y],
            [(P @ G).T * V / l, zero, zero, zero],
            [(P @ G).T, zero, zero, zero],
            [-Y.T, zero, zero, zero],
        ]
    )
    b = np.array([[0.0], [1.0]])

    def sector(square: float, cross: float) -> np.ndarray:
        M = np.zeros((5, 5))
        M[:3, :3] = np.block([[square * b @ b.T, -cross * b], [-cross * b.T, np.ones((1, 1))]])
        return M

    right = e1 * sector(0.88, 1.0) - e2 * sector(1.0, 0.94) + np.diag([-1.0, -1.0, 0.0, 36 * mu, mu])
    made = inequalities.orientation(P, Y, np.array([e1, e2]), mu, V, l, tight=False)
    np.testing.assert_allclose(made, left - right, atol=1e-12)


# ---------------------------------------------------------------- the papers' figures


def test_the_printed_unstable_gain_is_refused() -> None:
    """E1: with its powers of theta, wherever it is asked for."""
    for region in ((5.0, 0.0, 0.0), (2.0, 1.0, 1.9)):
        with pytest.raises(NotCertified, match=r"no proof can exist: .* eigenvalue \+[2-9]\."):
            design.high_gain(*region, rate=0.0, gain=[78.83, 914.6, -2215.8])


@pytest.mark.parametrize(("speed", "acceleration"), [(2.0, 3.0), (0.5, 1.0)])
def test_beyond_the_frozen_limit_the_refusal_names_the_eigenvalue(speed: float, acceleration: float) -> None:
    """E3: beyond 1.27 1/s of acceleration over speed a frozen error matrix is unstable."""
    with pytest.raises(
        NotCertified, match=r"no proof can exist: at course rate .* eigenvalue \+[0-9.]+, want"
    ):
        design.high_gain(speed, acceleration, 0.5, rate=0.0, gain=PUBLISHED_HIGH_GAIN)
    L1, L2, L3 = PUBLISHED_HIGH_GAIN

    def pace(r: float) -> float:
        return float(
            np.linalg.eigvals(family.frozen_high_gain([L1, L2, L3], 1.0, r, 0.0).matrices).real.max()
        )

    limit = (3.0 * L2 - sqrt(9.0 * L2**2 - 12.0 * L1 * L3)) / (6.0 * L1)
    assert limit == pytest.approx(1.27, abs=5e-3)
    assert pace(0.99 * limit) < 0.0 < pace(1.01 * limit)


def test_the_companion_form_lies_between_its_corners() -> None:
    """Bernstein: every state's Jacobian is a convex combination of the 16 control points."""
    from scipy.optimize import linprog

    F, corners = family.companion(2.0, 3.0, 1.2)
    assert len(corners) == 16
    rng = np.random.default_rng(0)
    for k, r in [(1.2, 1.5), (-1.2, 0.75), (0.0, 0.0), *rng.uniform(-1, 1, (40, 2)) * [1.2, 1.5]]:
        target = family._companion(k, r, k * k, k * r, r * r)
        rows = np.vstack([F.reshape(16, -1).T, np.ones(16)])
        found = linprog(np.zeros(16), A_eq=rows, b_eq=np.r_[target.ravel(), 1.0])
        assert found.status == 0, (k, r)


def test_the_companion_form_is_the_jacobian_of_the_model() -> None:
    """[HG 56-58] differentiated numerically, in the frame of the velocity."""

    def f(z: np.ndarray) -> np.ndarray:
        c = (z[5] * z[1] - z[2] * z[4]) / (z[1] ** 2 + z[4] ** 2)
        return np.array([-3 * z[5] * c + 2 * z[1] * c**2, 3 * z[2] * c + 2 * z[4] * c**2])

    V, a, k = 4.0, 2.0, 0.6
    z = np.array([0.0, V, a, 0.0, 0.0, V * k])
    J = np.column_stack([(f(z + h) - f(z - h)) / 2e-6 for h in 1e-6 * np.eye(6)])
    made = family._companion(k, a / V, k**2, k * a / V, (a / V) ** 2)
    np.testing.assert_allclose(made[[2, 5]], J, atol=1e-6)


def test_the_sector_condition_is_tighter() -> None:
    """E6: at l = 4 m and 1 m/s from 2.69 to 1.71; and the sector's corners say the same."""
    found = {}
    for tight in (False, True):
        problem = design.Problem()
        P, Y, m, mu = problem.symmetric(2), problem.matrix(2, 1), problem.matrix(2, 1), problem.number()
        problem.below(lambda P: -P, P)
        problem.below(lambda m: -np.diag(m[:, 0]), m)

        def condition(P: Any, Y: Any, m: Any, mu: Any, tight: bool = tight) -> Any:
            return inequalities.orientation(P, Y, m[:, 0], mu, 1.0, 4.0, tight)

        problem.below(condition, P, Y, m, mu)
        found[tight] = problem.found(mu, problem.minimise(mu), "")
    assert found == pytest.approx({False: 2.69, True: 1.71}, abs=6e-3)
    problem = design.Problem()
    P, Y, mu = problem.symmetric(2), problem.matrix(2, 1), problem.number()
    problem.below(lambda P: -P, P)
    G, H, C = np.eye(2, 1), np.ones((1, 2)), np.eye(2)

    def corner(P: Any, Y: Any, mu: Any, A: Any) -> Any:
        return inequalities.estimate(A, H, G, C, P, Y, mu, weight=36.0)

    for A in family.orientation(1.0, 1.0, l_r=4.0):
        problem.below(corner, P, Y, mu, A=A)
    assert problem.found(mu, problem.minimise(mu), "") == pytest.approx(found[True], rel=1e-3)


def test_the_published_speed_gain_bounds_energies_and_instants() -> None:
    """E8: mu_s, H-infinity norm, peak-to-peak exact and by ellipsoid."""
    L = np.array(PUBLISHED_SPEED)[:, None]
    mu = design.smallest(lambda P, m, mu: inequalities.speed(P, P @ L, mu), 4)
    assert mu == pytest.approx(18.86, abs=5e-3)
    made = design.certify_speed(PUBLISHED_SPEED, 0.3)
    assert made.certificate.proven()
    speed, acceleration, energy = made.certificate.bounds
    assert (speed.gain, acceleration.gain) == pytest.approx((4.69, 4.22), abs=5e-3)
    assert energy.gain == pytest.approx(4.343, rel=0.012)  # stated 1 % above, for the margin
    A, C = family.chain(4) - L @ np.eye(1, 4), np.eye(4)
    w = np.geomspace(0.05, 20.0, 4000)
    response = [np.linalg.norm(C[1:3] @ np.linalg.solve(1j * x * C - A, -L)) for x in w]
    assert max(response) == pytest.approx(4.343, abs=1e-3)
    assert sqrt(mu) == pytest.approx(max(response), abs=1e-3)
    for row, gain in ((1, 5.71), (2, 4.99)):
        found = design.bound(Sought("x", "path", np.array([A, A]), np.array([-L, -L]), C[row : row + 1]))
        assert found.gain == pytest.approx(gain, rel=0.015)


@pytest.mark.parametrize("V", [2.0, 10.0, 20.0])
def test_one_window_of_150_degrees_has_a_gain(V: float) -> None:
    """Theory of the constant-velocity observer: window 75 deg at 0.5 1/s; and with the frame turning too."""
    for turning in (0.0, 0.5):
        made = design.constant_velocity([V], radians(75.0), turning, rate=0.5, fastest=60.0)
        assert made.certificate.proven()
        assert np.abs(made.gain[:4]).max() < 500.0


def test_the_table_may_be_switched_at_will() -> None:
    """E11: one P for all entries of Table I, in the paper's own model of the orientation."""
    proof = design.certify_schedule(family.Table(NOMINAL, L_PSI, L_BETA).points(0.1), 0.05)
    assert proof.margin() > 1e-2


# ---------------------------------------------------------------- designs


def test_no_pole_leaves_the_region_it_was_given() -> None:
    made = design.speed(0.8, 6.0)
    poles = np.roots([1.0, *made.gain])
    assert poles.real.max() < -0.8
    assert np.abs(poles).max() < 6.0
    assert made.certificate.proven()
    assert made.solved.solver == "Clarabel"
    assert "gain [" in str(made)


def test_the_bound_on_the_gain_is_one() -> None:
    """L'PL <= bound2 with P >= I: the spectral norm of L stays below."""
    problem, H = design.Problem(), np.eye(1, 4)
    P, Y, most = problem.symmetric(4), problem.matrix(4, 1), problem.number()
    problem.below(lambda P, Y: inequalities.unknown_gain(family.chain(4), H, P, Y, 0.2), P, Y)
    problem.below(lambda P, Y: inequalities.gain_within(P, Y, 400.0), P, Y)
    problem.below(lambda P: np.eye(4) - P, P)
    problem.below(lambda P, most: P - most * np.eye(4), P, most)
    solved = problem.minimise(most)
    L = np.linalg.solve(*(problem.found(u, solved, "") for u in (P, Y)))
    assert np.linalg.norm(L) <= 20.0 + 1e-6
    assert np.linalg.eigvals(family.chain(4) - L @ H).real.max() <= -0.2 + 1e-6


def test_a_sampled_gain_can_be_had_the_same_way() -> None:
    """Position and speed at 10 Hz: errors shrink by 0.7 a scan."""
    F, H, problem = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(1, 2), design.Problem()
    P, Y, most = problem.symmetric(2), problem.matrix(2, 1), problem.number()

    def condition(P: Any, Y: Any) -> Any:
        return inequalities.unknown_sampled_gain(F, H, P, Y, 0.7) + 1e-3 * np.eye(4)

    problem.below(condition, P, Y)
    problem.below(lambda P: np.eye(2) - P, P)
    problem.below(lambda P, most: P - most * np.eye(2), P, most)
    solved = problem.minimise(most)
    A = F - np.linalg.solve(*(problem.found(u, solved, "") for u in (P, Y))) @ H @ F
    assert np.abs(np.linalg.eigvals(A)).max() < 0.7
    B, exact = np.eye(2, 1)[None], Sought("position", "position", A[None], np.eye(2, 1)[None], H)
    wide = [exact, Sought("both", "position", A[None], B, np.eye(2)), exact_energy(A, B, H)]
    made = claim_of(A, "sampled", wide)
    proof, proofs, _ = design.prove(made, 0.75)
    assert proof.proven()
    assert [p.of for p in proofs] == ["both", "energy"]
    assert proof.bounds[0].exact
    assert proof.bounds[0].gain == pytest.approx(peak(A, B[0], H, "sampled"))
    assert proof.bounds[1].gain > proof.bounds[0].gain > 0.0


def exact_energy(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> Sought:
    return Sought("energy", "position", A[None], B, C, "energy")


def claim_of(A: np.ndarray, form: Any = "continuous", sought: Any = (), blocks: Any = None) -> Claim:
    """Claim about one matrix."""
    made = family.Family(A[None], ("the matrix",))
    return Claim("made", form, made, {}, ("None.",), {}, blocks, tuple(sought))


def test_blocks_of_p_are_alike_and_checked() -> None:
    """An error in a frame that turns needs the same P on both axes: found so, and refused otherwise."""
    A = np.kron(np.eye(2), np.array([[0.0, 1.0], [-2.0, -3.0]]))
    made = claim_of(A, blocks=[[range(2), range(2, 4)]])
    proof, _, _ = design.prove(made, 0.5)
    np.testing.assert_array_equal(proof.P[:2, :2], proof.P[2:, 2:])
    assert not proof.P[:2, 2:].any()
    other = proof.P.copy()
    other[0, 0] *= 1.001
    assert Certificate("made", "continuous", A[None], other, 0.5, {}, ()).proven()  # as a matrix it would do
    with pytest.raises(NotCertified, match="blocks"):
        made.certificate(other, 0.5)


def test_a_line_of_gains_is_proven_between_its_ends() -> None:
    """At speeds in between, true and estimated 10 % apart, with the P of the ends."""
    made = design.line(1.0, 20.0)
    (p, q), (r, s) = made.gain
    P, rate, rng = made.certificate.P, made.certificate.rate, np.random.default_rng(1)
    for _ in range(200):
        V = rng.uniform(1.0, 20.0)
        point = family.Point("", V * rng.uniform(0.9, 1.1), p + q * V, r + s * V)
        for A in family.orientation_errors([point]).matrices:
            assert np.linalg.eigvalsh(A.T @ P + P @ A + 2.0 * rate * P)[-1] < 0.0


def test_a_bound_on_the_gain_is_kept() -> None:
    free, bounded = design.speed(1.0, 8.0), design.speed(0.4, 8.0, gain_bound=20.0)
    assert np.linalg.norm(free.gain) > 20.0
    assert np.linalg.norm(bounded.gain) < 20.0 + 1e-3
    assert bounded.certificate.proven()
    with pytest.raises(NotCertified, match="bound on the gain"):
        design.speed(3.0, 8.0, gain_bound=1.0)
    with pytest.raises(InputError, match="positive"):
        design.speed(0.4, 8.0, gain_bound=-1.0)


def test_a_bound_holds_a_whole_gain_not_a_scaled_one() -> None:
    made = design.high_gain(5.0, 3.0, 0.2, rate=0.2, fastest=20.0, gain_bound=200.0)
    assert np.linalg.norm(made.gain[:3]) < 200.0


QUICK = [s for s in certificates.ALL if s.name not in ("high_gain", "constant_velocity")]


@pytest.mark.parametrize("shipped", QUICK, ids=lambda s: s.name)
def test_shipped_gains_and_bounds_come_out_again(shipped: certificates.Shipped) -> None:
    assert shipped.off() < certificates.TOLERANCE
    assert shipped.bounds_off() < certificates.BOUNDS


def test_what_is_shipped_is_what_the_script_makes() -> None:
    files = {p.stem for p in proof_file.SHIPPED.glob("*.json")}
    assert files == {s.name for s in certificates.ALL}
    for s in certificates.ALL:
        file = proof_file.shipped(s.name)
        assert dict(file.gains) == s.gains._asdict()
        assert (file.form, file.rate) == (s.form, s.rate)
        assert file.asked.items() >= s.asked.items()


def test_the_page_on_proofs_runs() -> None:
    """All its Python, from top to bottom, and the report it shows."""
    page = (Path(__file__).parents[1] / "docs" / "proofs.md").read_text()
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.S):
        exec(block, names)
    assert names["made"].gain == pytest.approx([10.55, 38.64, 58.24, 31.34], rel=0.01)
    shown = re.search(r"^    multi_stage: proven.*?^    +\.\.\.", page, flags=re.S | re.M)
    assert shown
    lines = [line.strip() for line in shown[0].splitlines()[:-1]]
    report = [line.strip() for line in str(multi_stage.certificate()).splitlines()]
    assert lines == report[: len(lines)]


# ---------------------------------------------------------------- refusals


def test_what_cannot_be_proven_is_refused_with_what_to_relax() -> None:
    with pytest.raises(NotCertified, match="lower the rate, raise `fastest` or the bound on") as caught:
        design.high_gain(2.0, 3.0, 1.0)
    assert caught.value.exit_code == 3
    with pytest.raises(NotCertified, match=r"checked margin .*narrow the region or lower the rate"):
        design.high_gain(5.0, 3.0, 3.0, rate=0.0, gain=PUBLISHED_HIGH_GAIN)
    with pytest.raises(InputError, match="want 0 <= rate < fastest"):
        design.speed(5.0, 4.0)
    with pytest.raises(NotCertified, match=r"at the matrix the .* eigenvalue \+1, .*real part below 0"):
        design.prove(claim_of(np.eye(1)), 0.0)
    with pytest.raises(NotCertified, match="no bound exists"):
        design.bound(Sought("x", "d", np.eye(2)[None], np.eye(2, 1)[None], np.eye(2)))


def test_without_the_solver_the_refusal_says_how_to_have_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(InputError, match=r"outrider\[design\]"):
        design.speed()
    assert multi_stage.certificate().proven()


@pytest.mark.parametrize("arguments", [(0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (float("nan"), 1.0, 1.0)])
def test_a_region_through_standstill_is_refused(arguments: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="want a speed above 0"):
        design.high_gain(*arguments)
    with pytest.raises(InputError, match="finite"):
        design.high_gain(5.0, 1.0, 1.0, gain=[1.0, float("inf"), 1.0])
