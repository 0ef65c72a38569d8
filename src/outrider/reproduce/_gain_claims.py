"""What the papers claim about their gains, computed anew."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from outrider import inequalities
from outrider.certificate import peak, relative
from outrider.inequalities import SLIP, chain
from outrider.observers import multi_stage
from outrider.reproduce import proofs
from outrider.reproduce.gains import L_S, L_W, high_gain_proof, orientation_slack, speed_bound
from outrider.reproduce.published import HALF_WAY, HighGain, HighGainGains, Seen, high_gain
from outrider.reproduce.section import Claim, verdict

Array = npt.NDArray[np.float64]

K_PRINTED = np.array([11.73, 20.25, -7.3])  # [HG 87]
L_PRINTED = np.array([67.20, 823.1, 2818.5])  # [HG 92]
THETA, LAMBDA_MAX, LAMBDA, K_F = 6.7205, 26.5, 10.0, 1.25  # [HG III.B]
DIGITS = 0.005  # relative error that the printed digits explain [-]


def claims() -> Iterator[Claim]:
    """All of them, in the order of the papers."""
    yield from _speed_claims()
    yield from _orientation_claims()
    yield from _slip_claims()
    yield from _high_gain_claims()
    yield from _theta_claims()
    yield from _lipschitz_claims()


def _speed_claims() -> Iterator[Claim]:
    bound = speed_bound()
    slack = bound.margin("continuous")
    yield Claim(
        "[MS] IV.A, Theorem 1",
        "The printed speed gain satisfies the matrix inequality (29).",
        verdict(slack > 0.0),
        f"with mu_s = {bound.gain**2:.2f}: slack {slack:.1e}",
    )
    L, one = np.array(L_S)[:, None], np.eye(4)
    A = chain(4) - L @ one[:1]
    V, a = (peak(A, -L, one[[k]], "continuous") for k in (1, 2))
    yield Claim(
        "[MS 24-26]",
        "The inequality bounds speed and acceleration errors at each instant by the path's error then.",
        verdict(max(V, a) <= bound.gain),
        f"largest speed error {V:.2f} 1/s and acceleration error {a:.2f} 1/s2 times the largest path error "
        f"(impulse response); sqrt(mu_s) = {bound.gain:.2f} is a ratio of energies",
    )
    w = position_slack(1.0025)
    yield Claim(
        "[MS] IV.C, Theorem 3",
        "The printed position gain of 20 1/s satisfies (70), and the error stays within that of its inputs.",
        verdict(w > -1e-12),
        f"mu_w = 1 + 1/20^2 = 1.0025 with P = I/20: slack {max(w, 0.0):.1g}, the closed form's limit; "
        "at each instant |w| <= |d_w| + |g| / 20",
    )


def position_slack(mu: float) -> float:
    """Slack of [MS 70] for L_w = 20 I with P = I / 20: 0 at the smallest mu."""
    P = np.eye(2) / L_W
    return relative(inequalities.position(P, L_W * P, mu), 1.0)


def _orientation_claims() -> Iterator[Claim]:
    slack = [orientation_slack(i) for i in range(len(multi_stage.NOMINAL))]
    good = sum(s > 0.0 for s in slack)
    yield Claim(
        "[MS] IV.B, Theorem 2, Table I",
        "Each printed orientation gain satisfies (58) at both ends of its span of speeds.",
        verdict(good == len(slack), good > 0),
        f"{good} of {len(slack)} entries, with the first block's sign and l_r put right; smallest slack "
        f"{min(slack):.1e}, mu_z from {proofs.TABLE_I[-1].mu:g} to {proofs.TABLE_I[0].mu:g}",
    )
    antisymmetric = as_printed(0)
    yield Claim(
        "[MS 58]",
        "The inequality (58) as printed.",
        verdict(antisymmetric < 0.0),
        f"its first block minus its transpose has no definite part: the yaw's own term is {antisymmetric:g}, "
        "and must be below a negative number",
    )
    proof = multi_stage.certificate()
    yield Claim(
        "[MS] IV.B",
        "The table can be used without interpolation, its entry chosen by the estimated speed.",
        verdict(proof.proven()),
        f"one P for all {len(multi_stage.NOMINAL)} entries, true speed up to 10 % outside the entry's span: "
        f"{proof.rate:g} 1/s, margin {proof.margin():.1e}; the paper has no proof of the switching",
    )
    used = int(np.searchsorted(HALF_WAY, 6.7))
    psi, beta = multi_stage.L_PSI[used], multi_stage.L_BETA[used]
    yield Claim(
        "[MS] IV.B",
        "At 6.7 m/s the gain [8.05, 0.99] is the one to use.",
        verdict(psi == 8.05 and beta == 0.99),
        f"nearest nominal speed: [{psi:g}, {beta:g}]",
    )


def as_printed(i: int) -> float:
    """The yaw's own entry of the first block of [MS 63] as printed, P L H - H'L'P, for entry i."""
    p = proofs.TABLE_I[i]
    P, L = np.array([[p.p, p.q], [p.q, p.r]]), np.array([[multi_stage.L_PSI[i]], [multi_stage.L_BETA[i]]])
    block = P @ L @ np.ones((1, 2))
    return float((block - block.T)[0, 0])


def _slip_claims() -> Iterator[Claim]:
    steering = float(np.degrees(np.arctan(2.0 * np.tan(SLIP))))
    yield Claim(
        "[MS 8-9]",
        "Slip within 20 deg means steering within 36 deg where l_r / l = 0.5.",
        verdict(abs(steering - 36.0) < 0.5),
        f"{steering:.2f} deg",
    )
    share = float(np.sin(SLIP) ** 2 / 4.0)
    yield Claim(
        "[MS 54-55]",
        "(sin(slip) / l_r)^2 is at most 1/36, so mu_V = 36 mu_d is enough.",
        verdict(share <= 1.0 / 36.0, np.sin(0.97 * SLIP) ** 2 / 4.0 <= 1.0 / 36.0),
        f"at 20 deg it is 1/{1.0 / share:.1f}; 1/36 holds up to {np.degrees(np.arcsin(1.0 / 3.0)):.2f} deg",
    )
    b, f = np.meshgrid(np.linspace(-1.0, 1.0, 41), np.linspace(-1.0, 1.0, 41))
    first, second = (f * f + 0.88 * b * b - 2.0 * f * b <= 0.0), (f * f + b * b - 2.0 * 0.94 * f * b >= 0.0)
    yield Claim(
        "[MS] Lemma 1",
        "Two quadratic conditions enclose the error of the slip's sine.",
        verdict(not (first.all() or second.all()), not first.all()),
        f"of a grid of pairs (slip error, sine error) the first excludes {100 * (1 - first.mean()):.0f} %, "
        f"the second {100 * (1 - second.mean()):.0f} %: it says nothing",
    )


def _high_gain_claims() -> Iterator[Claim]:
    H = np.eye(1, 3)
    slow = [float(np.linalg.eigvals(chain(3) - k[:, None] @ H).real.max()) for k in (K_PRINTED, scaled())]
    yield Claim(
        "[HG 87]",
        "The printed K makes F - K H stable.",
        verdict(slow[0] < 0.0),
        f"eigenvalue at {slow[0]:+.3f}; the K of the printed L, {_row(scaled())}, has its slowest "
        f"at {slow[1]:+.3f}",
    )
    L = K_PRINTED * THETA ** np.arange(1, 4)
    yield Claim(
        "[HG 66, 92]",
        f"The printed L is the printed K scaled with theta = {THETA:g}.",
        verdict(bool((np.abs(L / L_PRINTED - 1.0) < DIGITS).all())),
        f"scaled K: {_row(L)}; printed L: {_row(L_PRINTED)}",
    )


def _theta_claims() -> Iterator[Claim]:
    theta = 2.0 * K_F * LAMBDA_MAX / LAMBDA
    yield Claim(
        "[HG 77, 88]",
        f"theta = {THETA:g} is the threshold that (77) gives.",
        verdict(abs(theta - THETA) < 1e-3, theta < THETA),
        f"2 x {K_F:g} x {LAMBDA_MAX:g} / {LAMBDA:g} = {theta:g}; {THETA:g} is above it and needs "
        f"lambda_max = {THETA * LAMBDA / (2.0 * K_F):.2f}",
    )
    c = K_F / (3.0 * np.sqrt(2.0))
    yield Claim(
        "[HG] III.B",
        f"k_f = {K_F:g} allows a yaw rate of 0.3 rad/s.",
        verdict(abs(c - 0.3) < 0.01),
        f"{c:.3f} rad/s",
    )
    found = [high_gain_proof(r) for r in proofs.REGIONS]
    good, r = sum(p.proven() for p in found), proofs.REGIONS
    yield Claim(
        "[HG] III.B",
        "With the printed L the error decays for yaw rates up to 0.3 rad/s.",
        verdict(found[0].proven() and found[1].proven(), good > 0),
        f"proven at {r[0].rate:g} 1/s, from {r[1].speed:g} m/s on; and stable up to "
        f"{r[3].course_rate:g} rad/s; {good} of {len(found)} proofs hold, each for a bounded acceleration",
    )


def scaled() -> Array:
    """K (3,) that belongs to the printed L and theta."""
    K: Array = L_PRINTED / THETA ** np.arange(1, 4)
    return K


def _lipschitz_claims() -> Iterator[Claim]:
    k = 0.295
    norms = [_slope(k, r) for r in (0.0, 0.2, 0.6)]
    bound = 3.0 * np.sqrt(2.0) * k
    yield Claim(
        "[HG 89-91]",
        "On yaw rates up to 0.3 rad/s the nonlinear functions are Lipschitz with 3 c each.",
        verdict(norms[-1] <= bound, norms[0] <= bound),
        f"their joint constant would be {bound:.2f}; the Jacobian's norm is {norms[0]:.2f} without "
        f"acceleration, {norms[1]:.2f} and {norms[2]:.2f} at acceleration / speed = 0.2 and 0.6 1/s",
    )
    speeds = (4.0, 2.0, 1.0, 0.5)
    worst = [_frozen(V) for V in speeds]
    stable = sum(w < 0.0 for w in worst)
    yield Claim(
        "[HG] I.B, VI",
        "The high-gain design always has a solution, stable over all motion.",
        verdict(stable == len(speeds), stable > 0),
        "slowest eigenvalue of the error at 2 m/s2 and "
        + ", ".join(f"{V:g} m/s: {w:+.2f}" for V, w in zip(speeds, worst, strict=True))
        + "; the functions grow without bound towards standstill",
    )


def jacobian(V: float, A: float, k: float) -> Array:
    """Of z' = F z + G f(z) at speed V [m/s], acceleration A [m/s2], course rate k [rad/s], (6, 6)."""
    z, o = np.array([0.0, V, A, 0.0, 0.0, k * V]), 0.0
    columns = np.column_stack([z + h * e for e in np.eye(6) for h in (1e-4, -1e-4)])
    free = HighGainGains(L=(0.0, 0.0, 0.0))
    moved = np.array(high_gain(HighGain(*columns), Seen(o, o, o, o), free))
    slopes: Array = (moved[:, ::2] - moved[:, 1::2]) / 2e-4
    return slopes


def _slope(k: float, r: float) -> float:
    """Largest growth of f at course rate k [rad/s] and acceleration / speed r [1/s], [HG 61]."""
    return float(np.linalg.norm(jacobian(10.0, 10.0 * r, k)[[2, 5]], 2))


def _frozen(V: float) -> float:
    """Slowest eigenvalue [1/s] of the error at speed V, 2 m/s2 and up to 0.3 rad/s, under the printed L."""
    LH = np.kron(np.eye(2), L_PRINTED[:, None] @ np.eye(1, 3))
    return max(float(np.linalg.eigvals(jacobian(V, 2.0, k) - LH).real.max()) for k in (0.0, 0.15, 0.3))


def _row(values: Array) -> str:
    return "[" + ", ".join(f"{v:.4g}" for v in values) + "]"
