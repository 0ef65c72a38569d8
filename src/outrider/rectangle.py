"""Rectangles fitted to the returns of one object: of unknown size, and of known size.

Closeness: Zhang, Xu, Dong and Dolan, Efficient L-shape fitting for vehicle detection using laser scanners,
IV 2017. The fit of the known size is ours: robust least squares of the distance to the sides the sensor can
see, of the way a beam that went past cuts into the body, and of a weak prior.
"""

from __future__ import annotations

import numpy as np

from outrider.kernel import kernel
from outrider.records import Array

ANGLES = 30  # headings tried over a quarter turn before the best is refined
MOST_HITS = 48  # returns of one object used in a fit; evenly thinned beyond


@kernel
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


@kernel
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
    lo1 = lo2 = 1e300
    hi1 = hi2 = -1e300
    for i in range(p.shape[0]):
        u, v = c * p[i, 0] + s * p[i, 1], c * p[i, 1] - s * p[i, 0]
        lo1, hi1, lo2, hi2 = min(lo1, u), max(hi1, u), min(lo2, v), max(hi2, v)
    mu, mv, length, width = 0.5 * (hi1 + lo1), 0.5 * (hi2 + lo2), hi1 - lo1, hi2 - lo2
    if width > length:
        a, length, width = a + 0.5 * np.pi, width, length
    return c * mu - s * mv, s * mu + c * mv, a, length, width


@kernel
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


@kernel
def _add(N: Array, j0: float, j1: float, j2: float, r: float, w: float) -> None:
    """Add one weighted residual r with the row (j0, j1, j2) of the Jacobian to the normal equations."""
    for k, jk in enumerate((j0, j1, j2)):
        N[k, 0] += w * jk * j0
        N[k, 1] += w * jk * j1
        N[k, 2] += w * jk * j2
        N[k, 3] += w * jk * r


@kernel
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
    N: Array,
) -> tuple[float, int]:
    """Cost at `pose`, mask of the sides hit; fills N (3, 4): information and gradient, reweighted."""
    x, y, h = pose[0], pose[1], pose[2]
    c, s = np.cos(h), np.sin(h)
    a, b = 0.5 * size[0], 0.5 * size[1]
    sigma, cauchy = scale[0], scale[1]
    for k in range(3):
        for m in range(4):
            N[k, m] = 0.0
    cost, hit1, hit2 = 0.0, 0, 0
    for i in range(p.shape[0]):
        dx, dy = p[i, 0] - x, p[i, 1] - y
        u, v = c * dx + s * dy, c * dy - s * dx
        ex, ey = o[i, 0] - x, o[i, 1] - y
        qu, qv, which = _outline(u, v, c * ex + s * ey, c * ey - s * ex, a, b)
        hit1 += which == 1
        hit2 += which == 2
        ru, rv = (u - qu) / sigma, (v - qv) / sigma
        r2 = (ru * ru + rv * rv) / cauchy**2
        w = 1.0 / (1.0 + r2)
        cost += cauchy**2 * np.log1p(r2)
        if ru != 0.0:
            _add(N, -c / sigma, -s / sigma, v / sigma, ru, w)
        if rv != 0.0:
            _add(N, s / sigma, -c / sigma, -u / sigma, rv, w)
    for i in range(far.shape[0]):
        dx, dy = far[i, 0] - far_o[i, 0], far[i, 1] - far_o[i, 1]
        reach = np.hypot(dx, dy)
        nx, ny = -dy / reach, dx / reach
        along = (dx * (x - far_o[i, 0]) + dy * (y - far_o[i, 1])) / reach
        m0 = nx * (x - far_o[i, 0]) + ny * (y - far_o[i, 1])
        nu, nv = c * nx + s * ny, c * ny - s * nx
        depth = a * abs(nu) + b * abs(nv) - abs(m0)  # how far the beam cuts into the silhouette
        if (
            depth <= 0.0 or along <= 0.0 or along > reach
        ):  # the last two: it ends before the body, or points away
            continue
        side = 1.0 if m0 >= 0.0 else -1.0
        r = depth / sigma
        cost += weight[i] * cauchy**2 * np.log1p((r / cauchy) ** 2)
        # the corner that sticks out furthest towards the beam moves with the heading
        ku, kv = -side * np.copysign(a, nu), -side * np.copysign(b, nv)
        lever = nx * (-s * ku - c * kv) + ny * (c * ku - s * kv)
        if weight[i] < 1.0:  # silence may move a body, not turn it
            lever = 0.0
        w = weight[i] / (1.0 + (r / cauchy) ** 2)
        _add(N, -side * nx / sigma, -side * ny / sigma, -side * lever / sigma, r, w)
    turn = (h - prior[2] + np.pi) % (2.0 * np.pi) - np.pi
    e0, e1, e2 = (x - prior[0]) / prior[3], (y - prior[1]) / prior[3], turn / prior[4]
    cost += e0 * e0 + e1 * e1 + e2 * e2
    _add(N, 1.0 / prior[3], 0.0, 0.0, e0, 1.0)
    _add(N, 0.0, 1.0 / prior[3], 0.0, e1, 1.0)
    _add(N, 0.0, 0.0, 1.0 / prior[4], e2, 1.0)
    few = max(2, p.shape[0] // 10)
    return cost, (1 if hit1 >= few else 0) + (2 if hit2 >= few else 0)


@kernel
def solve3(N: Array, damping: float) -> tuple[float, float, float]:
    """Solution z of A z = g by Cholesky; N (3, 4) holds the symmetric positive definite A, then g.

    damping: share by which the diagonal of A is raised (Levenberg and Marquardt).
    """
    more = 1.0 + damping
    l00 = np.sqrt(N[0, 0] * more)
    l10, l20 = N[1, 0] / l00, N[2, 0] / l00
    l11 = np.sqrt(max(N[1, 1] * more - l10 * l10, 1e-12))
    l21 = (N[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(max(N[2, 2] * more - l20 * l20 - l21 * l21, 1e-12))
    y0 = N[0, 3] / l00
    y1 = (N[1, 3] - l10 * y0) / l11
    y2 = (N[2, 3] - l20 * y0 - l21 * y1) / l22
    z2 = y2 / l22
    z1 = (y1 - l21 * z2) / l11
    return (y0 - l10 * z1 - l20 * z2) / l00, z1, z2


@kernel
def copy(source: Array, target: Array) -> None:
    """Fill one array with the first elements of another (quicker to compile than a slice)."""
    a, b = source.ravel(), target.ravel()  # views: both lie in one piece
    for i in range(b.shape[0]):
        b[i] = a[i]


@kernel
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
    N: Array,
) -> tuple[float, int]:
    """Gauss-Newton from `start` (3,); leaves the best pose in `pose` (3,) and in N (3, 4) the information.

    p, o: (n, 2) returns of the object and where the sensor was; far, far_o: (m, 2) returns beside or behind
    it, weight (m,) how much each counts if it passed through the body. prior: x, y, heading, position sigma,
    heading sigma. size: length, width. scale: sigma [m], Cauchy width in sigmas. Returns the cost and the
    bit mask of the sides seen (1: a short side, 2: a long side).
    """
    trial, M = np.empty(3), np.empty((3, 4))
    copy(start, pose)
    best, sides = _normal_equations(pose, p, o, far, far_o, weight, prior, size, scale, N)
    damping = 1e-3
    for _ in range(12):
        d0, d1, d2 = solve3(N, damping)
        trial[0], trial[1], trial[2] = pose[0] - d0, pose[1] - d1, pose[2] - min(max(d2, -0.3), 0.3)
        cost, seen = _normal_equations(trial, p, o, far, far_o, weight, prior, size, scale, M)
        if cost < best:
            gain = best - cost
            best, sides = cost, seen
            copy(trial, pose)
            copy(M, N)
            damping = max(damping * 0.3, 1e-4)
            if gain < 1e-3:
                break
        else:
            damping *= 8.0
            if damping > 1e3:
                break
    return best, sides
