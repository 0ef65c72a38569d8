"""Proofs of the published gains as data; `gains` checks each anew, so nothing here is believed.

Found with `outrider.design` and rounded to four digits.
"""

from __future__ import annotations

from typing import NamedTuple


class Orientation(NamedTuple):
    """Of one entry of Table I in [MS 58] put right: P = [[p, q], [q, r]], multiplier of the slip's sector."""

    p: float
    q: float
    r: float
    sector: float
    mu: float  # energy of yaw and slip errors over that of course and speed errors [-]


class Region(NamedTuple):
    """Of one gain (3,) per axis of the high-gain observer: P = I2 (x) P3 over a region of states."""

    gain: tuple[float, float, float]  # [1/s, 1/s2, 1/s3]
    speed: float  # at least [m/s]
    acceleration: float  # along the course, at most [m/s2]
    course_rate: float  # at most [rad/s]
    rate: float  # of decay [1/s]
    half: tuple[float, ...]  # lower half of P3 by rows, states scaled as in `family.high_gain`


TABLE_I = (  # in the order of the table
    Orientation(2.062, -2.809, 14.25, 319.0, 1.144),
    Orientation(1.627, -1.944, 10.54, 405.8, 1.09),
    Orientation(1.076, -1.484, 10.07, 454.4, 1.051),
    Orientation(0.7356, -0.8955, 8.067, 424.8, 1.036),
    Orientation(0.5358, -0.936, 9.144, 717.7, 1.018),
    Orientation(0.424, -1.1, 10.07, 1234.0, 1.011),
    Orientation(0.3517, -1.312, 11.67, 2012.0, 1.008),
    Orientation(0.3004, -1.428, 12.62, 2916.0, 1.006),
    Orientation(0.2618, -1.313, 11.74, 3365.0, 1.005),
    Orientation(0.2313, -0.4418, 5.29, 1206.0, 1.006),
    Orientation(0.2079, -0.3896, 4.995, 1289.0, 1.005),
    Orientation(0.1888, -0.3495, 4.708, 1250.0, 1.005),
    Orientation(0.173, -0.3214, 4.512, 1230.0, 1.005),
    Orientation(0.1596, -0.3016, 4.384, 1210.0, 1.005),
    Orientation(0.1481, -0.287, 4.321, 1423.0, 1.004),
    Orientation(0.1382, -0.2728, 4.216, 1425.0, 1.004),
    Orientation(0.1295, -0.2617, 4.133, 1424.0, 1.004),
    Orientation(0.1218, -0.2502, 4.036, 1412.0, 1.004),
    Orientation(0.1151, -0.2367, 3.982, 1378.0, 1.004),
    Orientation(0.109, -0.2202, 3.836, 1316.0, 1.004),
    Orientation(0.1047, -0.2168, 3.822, 1891.0, 1.003),
)

SPEED_MU = 4.387**2  # energy of speed and acceleration errors over that of the path's error, [MS 29]
SPEED_P = (  # lower half, states scaled by powers of 4.16^(1/4)
    *(8.0915, -3.472, 6.2085, -2.8516, -3.4182, 8.7673),
    *(4.3982, -6.6461, -3.0145, 33.107),
)

_PUBLISHED = (67.20, 823.1, 2818.5)  # [HG 92]
REGIONS = (
    Region(_PUBLISHED, 5.0, 3.0, 0.3, 1.0, (0.0453, -0.0431, 0.1172, -0.0136, -0.2385, 1.0)),
    Region(_PUBLISHED, 2.0, 1.0, 0.3, 1.0, (0.0538, -0.0461, 0.1183, -0.0316, -0.22, 1.0)),
    Region(_PUBLISHED, 5.0, 3.0, 2.1, 0.0, (0.0756, -0.0851, 0.18, -0.0038, -0.2595, 1.0)),
    Region(_PUBLISHED, 2.0, 1.0, 2.3, 0.0, (0.0757, -0.0822, 0.1763, -0.0164, -0.2471, 1.0)),
    Region(_PUBLISHED, 1.0, 1.0, 1.3, 0.0, (0.079, -0.1064, 0.2099, 0.0716, -0.3342, 1.0)),
)
