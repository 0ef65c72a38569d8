"""Rectangles fitted to the returns of one object: of unknown size (closeness), and of known size (visible sides).

Closeness: Zhang, Xu, Dong and Dolan, Efficient L-shape fitting for vehicle detection using laser scanners, IV 2017.
The fit of the known size is ours: robust least squares of the distance to the sides the sensor can see, of the
way a beam that went past cuts into the body, and of a weak prior.
"""

from __future__ import annotations

import numpy as np

from outrider.kernel import compiled
from outrider.records import Array

ANGLES = 45  # headings tried over a quarter turn before the best is refined
MOST_HITS = 48  # returns of one object used in a fit; evenly thinned beyond


@compiled
def _closeness(p: Array, c: float, s: float, floor: float) -> float:
    """Sum over the returns of 1 / distance to the nearer of the two nearest sides, for the axis (c, s)."""
    n = p.shape[0]
    lo1 = lo2 = 1e300
    hi1 = hi2 = -1e300
    for i in range(n):
        u, v = c * p[i, 0] + s * p[i, 1], c * p[i, 1] - s * p[i, 0]
        lo1, hi1, lo2, hi2 = min(lo1, u), max(hi1, u), min(lo2, v), max(hi2, v)
    near1 = near2 = 0.0
    for i in range(n):
        u, v = c * p[i, 0] + s * p[i, 1], c * p[i, 1] - s * p[i, 0]
        near1 += (hi1 - u) - (u - lo1)
        near2 += (hi2 - v) - (v - lo2)
    score = 0.0
    for i in range(n):
        u, v = c * p[i, 0] + s * p[i, 1], c * p[i, 1] - s * p[i, 0]
        d1 = hi1 - u if near1 < 0.0 else u - lo1
        d2 = hi2 - v if near2 < 0.0 else v - lo2
        score += 1.0 / max(min(d1, d2), floor)
    return score


@compiled
def fit_closeness(p: Array, floor: float) -> tuple[float, float, float, float, float]:
    """x, y, heading, length, width of the rectangle around returns p (n, 2); length is the longer side.

    heading [rad] of the longer side, modulo pi. `floor` [m]: distances below it count as on the side.
    """
    best, best_k = -1.0, 0
    step = 0.5 * np.pi / ANGLES
    for k in range(ANGLES):
        score = _closeness(p, np.cos(k * step), np.sin(k * step), floor)
        if score > best:
            best, best_k = score, k
    a = best_k * step
    for half in range(1, 4):
        for side in (-1.0, 1.0):
            trial = a + side * step / 2.0**half
            score = _closeness(p, np.cos(trial), np.sin(trial), floor)
            if score > best:
                best, a = score, trial
    c, s = np.cos(a), np.sin(a)
    u, v = c * p[:, 0] + s * p[:, 1], c * p[:, 1] - s * p[:, 0]
    mu, mv = 0.5 * (u.max() + u.min()), 0.5 * (v.max() + v.min())
    length, width = u.max() - u.min(), v.max() - v.min()
    if width > length:
        a, length, width = a + 0.5 * np.pi, width, length
    return c * mu - s * mv, s * mu + c * mv, a, length, width


@compiled
def _outline(u: float, v: float, su: float, sv: float, a: float, b: float) -> tuple[float, float, int]:
    """Nearest point (u, v) of the sides seen from (su, sv), body frame, half sizes a, b; and which side."""
    best, qu, qv, which = 1e300, u, v, 0
    if abs(su) > a:
        cu, cv = np.copysign(a, su), min(max(v, -b), b)
        d = (u - cu) ** 2 + (v - cv) ** 2
        if d < best:
            best, qu, qv, which = d, cu, cv, 1
    if abs(sv) > b:
        cu, cv = min(max(u, -a), a), np.copysign(b, sv)
        d = (u - cu) ** 2 + (v - cv) ** 2
        if d < best:
            best, qu, qv, which = d, cu, cv, 2
    return qu, qv, which


@compiled
def _normal_equations(
    pose: Array,
    p: Array,
    o: Array,
    far: Array,
    far_o: Array,
    weight: Array,
    prior: Array,
    size: Array,
    scale: Array,
    A: Array,
    g: Array,
) -> tuple[float, int]:
    """Cost at `pose`; fills A (3, 3) and g (3,) of the reweighted least squares; bit mask of the sides hit."""
    x, y, h = pose
    c, s = np.cos(h), np.sin(h)
    a, b = 0.5 * size[0], 0.5 * size[1]
    sigma, cauchy = scale
    A[:] = 0.0
    g[:] = 0.0
    cost, hit1, hit2 = 0.0, 0, 0
    J = np.empty(3)
    for i in range(p.shape[0]):
        dx, dy = p[i, 0] - x, p[i, 1] - y
        u, v = c * dx + s * dy, c * dy - s * dx
        ex, ey = o[i, 0] - x, o[i, 1] - y
        qu, qv, which = _outline(u, v, c * ex + s * ey, c * ey - s * ex, a, b)
        if which == 1:
            hit1 += 1
        elif which == 2:
            hit2 += 1
        ru, rv = (u - qu) / sigma, (v - qv) / sigma
        r2 = ru * ru + rv * rv
        w = 1.0 / (1.0 + r2 / cauchy**2)
        cost += cauchy**2 * np.log1p(r2 / cauchy**2)
        if abs(u - qu) > 0.0:
            J[0], J[1], J[2] = -c / sigma, -s / sigma, v / sigma
            for k in range(3):
                g[k] += w * J[k] * ru
                for m in range(3):
                    A[k, m] += w * J[k] * J[m]
        if abs(v - qv) > 0.0:
            J[0], J[1], J[2] = s / sigma, -c / sigma, -u / sigma
            for k in range(3):
                g[k] += w * J[k] * rv
                for m in range(3):
                    A[k, m] += w * J[k] * J[m]
    for i in range(far.shape[0]):
        dx, dy = far[i, 0] - far_o[i, 0], far[i, 1] - far_o[i, 1]
        reach = np.hypot(dx, dy)
        nx, ny = -dy / reach, dx / reach
        along = (dx * (x - far_o[i, 0]) + dy * (y - far_o[i, 1])) / reach
        if along <= 0.0 or along > reach:  # the body is behind the sensor, or the return lies in front of it
            continue
        m0 = nx * (x - far_o[i, 0]) + ny * (y - far_o[i, 1])
        nu, nv = c * nx + s * ny, c * ny - s * nx
        half = a * abs(nu) + b * abs(nv)
        depth = half - abs(m0)  # how far the beam cuts into the silhouette
        if depth <= 0.0:
            continue
        side = 1.0 if m0 >= 0.0 else -1.0
        r = depth / sigma
        w = weight[i] / (1.0 + (r / cauchy) ** 2)
        cost += weight[i] * cauchy**2 * np.log1p((r / cauchy) ** 2)
        # the corner that sticks out furthest towards the beam moves with the heading
        ku, kv = -side * np.copysign(a, nu), -side * np.copysign(b, nv)
        dcx, dcy = -s * ku - c * kv, c * ku - s * kv
        J[0], J[1], J[2] = -side * nx / sigma, -side * ny / sigma, -side * (nx * dcx + ny * dcy) / sigma
        if weight[i] < 1.0:  # silence may move a body, not turn it
            J[2] = 0.0
        for k in range(3):
            g[k] += w * J[k] * r
            for m in range(3):
                A[k, m] += w * J[k] * J[m]
    turn = (h - prior[2] + np.pi) % (2.0 * np.pi) - np.pi
    e0, e1, e2 = (x - prior[0]) / prior[3], (y - prior[1]) / prior[3], turn / prior[4]
    cost += e0 * e0 + e1 * e1 + e2 * e2
    g[0] += e0 / prior[3]
    g[1] += e1 / prior[3]
    g[2] += e2 / prior[4]
    A[0, 0] += prior[3] ** -2
    A[1, 1] += prior[3] ** -2
    A[2, 2] += prior[4] ** -2
    few = max(2, p.shape[0] // 10)
    return cost, (1 if hit1 >= few else 0) + (2 if hit2 >= few else 0)


@compiled
def solve3(A: Array, g: Array) -> tuple[float, float, float]:
    """Solution of the symmetric positive definite 3 x 3 system A z = g by Cholesky."""
    l00 = np.sqrt(A[0, 0])
    l10, l20 = A[1, 0] / l00, A[2, 0] / l00
    l11 = np.sqrt(max(A[1, 1] - l10 * l10, 1e-12))
    l21 = (A[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(max(A[2, 2] - l20 * l20 - l21 * l21, 1e-12))
    y0 = g[0] / l00
    y1 = (g[1] - l10 * y0) / l11
    y2 = (g[2] - l20 * y0 - l21 * y1) / l22
    z2 = y2 / l22
    z1 = (y1 - l21 * z2) / l11
    return (y0 - l10 * z1 - l20 * z2) / l00, z1, z2


@compiled
def fit_sized(
    start: Array,
    p: Array,
    o: Array,
    far: Array,
    far_o: Array,
    weight: Array,
    prior: Array,
    size: Array,
    scale: Array,
    pose: Array,
    A: Array,
) -> tuple[float, int]:
    """Gauss-Newton from `start` (3,); leaves the best pose in `pose` (3,) and the information in A (3, 3).

    p, o: (n, 2) returns of the object and where the sensor was; far, far_o: (m, 2) returns beside or behind it,
    weight (m,) how much each counts if it passed through the body.
    prior: x, y, heading, position sigma, heading sigma. size: length, width. scale: sigma [m], Cauchy width in
    sigmas. Returns the cost and the bit mask of the sides seen
    (1: a short side, 2: a long side).
    """
    g = np.empty(3)
    trial = start.copy()
    pose[:] = start
    best, sides = _normal_equations(pose, p, o, far, far_o, weight, prior, size, scale, A, g)
    damping = 1e-3
    B = np.empty((3, 3))
    gb = np.empty(3)
    for _ in range(12):
        M = A.copy()
        for k in range(3):
            M[k, k] *= 1.0 + damping
        d0, d1, d2 = solve3(M, g)
        d2 = min(max(d2, -0.3), 0.3)
        trial[0], trial[1], trial[2] = pose[0] - d0, pose[1] - d1, pose[2] - d2
        cost, seen = _normal_equations(trial, p, o, far, far_o, weight, prior, size, scale, B, gb)
        if cost < best:
            gain = best - cost
            best, sides = cost, seen
            pose[:] = trial
            A[:] = B
            g[:] = gb
            damping = max(damping * 0.3, 1e-4)
            if gain < 1e-3:
                break
        else:
            damping *= 8.0
            if damping > 1e3:
                break
    return best, sides
