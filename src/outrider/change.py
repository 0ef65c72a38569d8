"""Has a body moved? Ask an earlier scan about where it is now, and this scan about where it was.

A wall seen through gaps looks like a body that slides along it as the rider passes. It betrays itself: where
the body is said to have arrived, the earlier scan already saw a surface; where it is said to have left,
there still is one. Only returns outside the other rectangle are asked, so a body's overlap with itself says
nothing. Ours.
"""

from __future__ import annotations

import numpy as np

from outrider.compiler import compiled
from outrider.kernel import kernel
from outrider.records import Array, Bools, Scan

SAME, FARTHER, NEARER, NOTHING = 0, 1, 2, 3


@kernel
def _look(
    px: float, py: float, r: Array, valid: Bools, W_o: Array, angle0: float, step: float, margin: Array
) -> int:
    """What a scan says of the point (px, py): a surface there, one farther on, one nearer, or no return."""
    n = r.shape[0]
    turn = int(np.round(2.0 * np.pi / abs(step)))
    k = n // 2
    for _ in range(2):  # the sensor's pose is that of the beam that looks there
        az = np.arctan2(py - W_o[k, 1], px - W_o[k, 0]) - W_o[k, 2]
        k = int(np.round((az - angle0) / step)) % turn
        if k >= n:
            return NOTHING
    d = np.hypot(px - W_o[k, 0], py - W_o[k, 1])
    lo, hi = 1e300, -1e300
    for m in range(k - 1, k + 2):
        j = m % turn
        if j < n and valid[j]:
            lo, hi = min(lo, r[j]), max(hi, r[j])
    if hi < 0.0:
        answered = valid[(k - 2) % turn % n] or valid[(k + 2) % turn % n]
        return NEARER if answered else NOTHING  # one that answers close by makes the silence mean little
    least = margin[0] + margin[1] * d
    if d < lo - least:
        return FARTHER
    return SAME if d <= hi + least else NEARER


@kernel
def _outside(px: float, py: float, box: Array, margin: float) -> bool:
    c, s = np.cos(box[2]), np.sin(box[2])
    u, v = c * (px - box[0]) + s * (py - box[1]), c * (py - box[1]) - s * (px - box[0])
    return bool(abs(u) > 0.5 * box[3] + margin or abs(v) > 0.5 * box[4] + margin)


@compiled
def ask(
    p: Array,
    r: Array,
    valid: Bools,
    W_o: Array,
    angle0: float,
    step: float,
    box: Array,
    other: Array,
    margin: Array,
    votes: Array,
) -> None:
    """Returns p (n, 2) inside `box` and outside `other`: what the scan (r, valid, W_o) says of them."""
    for i in range(p.shape[0]):
        if (
            np.isnan(p[i, 0])
            or _outside(p[i, 0], p[i, 1], box, margin[0])
            or not _outside(p[i, 0], p[i, 1], other, margin[0])
        ):
            continue
        votes[_look(p[i, 0], p[i, 1], r, valid, W_o, angle0, step, margin)] += 1.0


def votes(scan: Scan, box: Array, earlier: Scan, earlier_box: Array, margin: Array) -> Array:
    """(4,) how many returns say: same, gone or new, hidden, unknown.

    box, earlier_box (5,): x, y, heading, length, width of the body now and at the earlier scan, fixed frame
    W; margin (2,) [m, m/m]: distance below which two surfaces are the same, and what each metre of range
    adds to it.
    """
    out = np.zeros(4)
    for here, there, mine, other in ((scan, earlier, box, earlier_box), (earlier, scan, earlier_box, box)):
        n = len(there.angle)
        if n < 2:
            continue
        step = float(there.angle[-1] - there.angle[0]) / max(n - 1, 1)
        if step != 0.0:
            ask(
                here.W_p,
                there.range,
                there.valid,
                there.W_sensor,
                float(there.angle[0]),
                step,
                mine,
                other,
                margin,
                out,
            )
    return out
