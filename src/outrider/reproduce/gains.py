"""The printed gains beside ours, each with its proof checked anew: [MS] Table I, eq. 77, [HG] eq. 87-92."""

from __future__ import annotations

from itertools import pairwise, product
from math import cos

import numpy as np
import numpy.typing as npt

from outrider import family, inequalities
from outrider.certificate import Bound, Certificate, relative
from outrider.inequalities import SLIP, chain
from outrider.observers import constant_velocity, high_gain, multi_stage
from outrider.observers.multi_stage import NOMINAL
from outrider.reproduce import proofs
from outrider.reproduce.published import HALF_WAY
from outrider.reproduce.section import Section, Table

Array = npt.NDArray[np.float64]

SPANS = tuple(pairwise((NOMINAL[0], *HALF_WAY, NOMINAL[-1])))  # speeds of each entry of Table I [m/s]
L_S, L_W = (4.61, 12.24, 9.83, 4.16), 20.0  # [MS] after eq. 36, eq. 77


def section() -> Section:
    """Gains, their slowest poles, and how fast and by what margin each is proven."""
    from outrider.reproduce import _gain_claims

    return Section(
        "gains",
        "The gains",
        TEXT,
        (_table_one(), _others()),
        claims=tuple(_gain_claims.claims()),
    )


TEXT = """
Every proof is checked on this run with NumPy alone; no solver is asked. A margin is the smallest slack of all
inequalities of a proof, relative to their size: positive is proven.

*Slowest pole*: of the orientation error, frozen, the worst over the entry's span of speeds and slips up to
20 deg. *Rate*: decay under the one P of the certificate of the whole observer, the true speed up to 10 %
outside the span; as all entries share that P, switching is included. *mu*: bound on the energy of yaw and
slip errors over that of course and speed errors, by [MS 58] with its signs and l_r put right and the sector
of the sine; *slack* is that proof's margin. *Ours*: `multi_stage.DESIGNED` at that speed.
"""


# ------------------------------------------------------------------ Table I


def _table_one() -> Table:
    P, own_P = (multi_stage.certificate(g).P[4:6, 4:6] for g in (multi_stage.Gains(), multi_stage.DESIGNED))
    rows = []
    for i, (V, span) in enumerate(zip(multi_stage.NOMINAL, SPANS, strict=True)):
        printed, own = (multi_stage.L_PSI[i], multi_stage.L_BETA[i]), ours(V)
        rows.append(
            (
                f"{V:g}",
                f"{printed[0]:.2f}, {printed[1]:.2f}",
                f"{slowest(*printed, span):.2f}",
                f"{rate_under(P, *printed, span):.2f}",
                f"{proofs.TABLE_I[i].mu:g}",
                f"{orientation_slack(i):.1e}",
                f"{own[0]:.2f}, {own[1]:.2f}",
                f"{slowest(*own, (V, V)):.2f}",
                f"{rate_under(own_P, *own, (V, V)):.2f}",
            )
        )
    head = (
        "V [m/s]", "[MS] Table I [1/s]", "slowest pole [1/s]", "rate [1/s]", "mu", "slack",
        "ours [1/s]", "slowest pole [1/s]", "rate [1/s]",
    )  # fmt: skip
    return Table("Orientation gains L_z(1), L_z(2) by speed", head, tuple(rows))


def ours(V: float) -> tuple[float, float]:
    """Orientation gains of DESIGNED at a speed [m/s]."""
    g = multi_stage.DESIGNED
    return g.psi_0 + g.psi_V * V, g.beta_0 + g.beta_V * V


def errors(psi: float, beta: float, span: tuple[float, float]) -> list[Array]:
    """Error matrices (2, 2) of yaw and slip at both ends of a span of speeds and of the sine's slope."""
    slopes = product(span, (cos(SLIP), 1.0))
    return [np.array([[-psi, V * k / multi_stage.Gains().l_r - psi], [-beta, -beta]]) for V, k in slopes]


def slowest(psi: float, beta: float, span: tuple[float, float]) -> float:
    """Slowest decay [1/s] of yaw and slip error over a span of speeds [m/s], frozen."""
    return -max(float(np.linalg.eigvals(A).real.max()) for A in errors(psi, beta, span))


def rate_under(P: Array, psi: float, beta: float, span: tuple[float, float]) -> float:
    """Decay [1/s] of e'Pe, P of states scaled as the certificate's, with the span 10 % wider."""
    T, root = family.scale_multi_stage()[4:6], np.linalg.inv(np.linalg.cholesky(P))
    wider = (0.9 * span[0], 1.1 * span[1])
    scaled = [A / T[:, None] * T for A in errors(psi, beta, wider)]
    return min(-0.5 * float(np.linalg.eigvalsh(root @ (A.T @ P + P @ A) @ root.T)[-1]) for A in scaled)


def orientation_slack(i: int, proof: proofs.Orientation | None = None) -> float:
    """Smallest slack of [MS 58] put right for entry i of Table I, at both ends of its span, by its proof."""
    p = proof or proofs.TABLE_I[i]
    P, L = np.array([[p.p, p.q], [p.q, p.r]]), np.array([[multi_stage.L_PSI[i]], [multi_stage.L_BETA[i]]])
    slack = [relative(-P, float(np.linalg.norm(P, 2)))]
    for V in SPANS[i]:
        M = inequalities.orientation(P, P @ L, np.array([p.sector]), p.mu, V)
        size = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(M)), 1e-12))  # signals of like size
        slack.append(relative(size[:, None] * M * size, 1.0))
    return min(slack)


# ------------------------------------------------------------------ the others


def _others() -> Table:
    rows = [_proven("multi-stage, whole cascade, printed gains", multi_stage.certificate())]
    rows.append(
        _proven("multi-stage, whole cascade, ours (DESIGNED)", multi_stage.certificate(multi_stage.DESIGNED))
    )
    rows += [_proven("high-gain, printed gain [HG 92]", high_gain_proof(r)) for r in proofs.REGIONS]
    rows.append(_proven("high-gain, ours for streets, sampled", high_gain.certificate()))
    rows.append(_proven("constant velocity, ours, sampled (none printed)", constant_velocity.certificate()))
    return Table("Proofs of whole observers", ("observer and gain", "region", "decay", "margin"), tuple(rows))


def _proven(name: str, c: Certificate) -> tuple[str, str, str, str]:
    region = "; ".join(f"{q} {low:.3g} to {high:.3g}" for q, (low, high) in c.region.items())
    decay = f"{c.rate:g} 1/s" if c.form == "continuous" else f"factor {c.rate:g} a step"
    return name, region, decay, f"{c.margin():.1e}" + (" (not proven)" if not c.proven() else "")


def high_gain_proof(r: proofs.Region) -> Certificate:
    """Certificate of a gain of the high-gain observer over a region, in continuous time."""
    P3 = _symmetric(r.half, 3)
    return Certificate(
        "high_gain",
        "continuous",
        family.high_gain(r.gain, r.speed, r.acceleration, r.course_rate).matrices,
        inequalities.alike(P3),
        r.rate,
        {
            "speed [m/s]": (r.speed, 70.0),
            "acceleration [m/s2]": (-r.acceleration, r.acceleration),
            "course rate [rad/s]": (-r.course_rate, r.course_rate),
        },
        (),
    )


def _symmetric(half: tuple[float, ...], n: int) -> Array:
    P, (i, j) = np.zeros((n, n)), np.tril_indices(n)
    P[i, j] = P[j, i] = half
    return P


def speed_bound() -> Bound:
    """Energy of speed and acceleration errors against that of the path's error, under the printed gain."""
    L = np.array(L_S)[:, None]
    T = L_S[3] ** (np.arange(4) / 4.0)
    A = (chain(4) - L @ np.eye(1, 4)) / T[:, None] * T
    P = _symmetric(proofs.SPEED_P, 4)
    return Bound(
        "(speed, acceleration)", "path", proofs.SPEED_MU**0.5, False, "energy",
        A[None], (-L / T[:, None])[None], np.diag(T)[1:3], P,
    )  # fmt: skip
