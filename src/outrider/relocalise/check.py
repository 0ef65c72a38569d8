"""Whether a robot can be found in a room at all: told before any estimate is trusted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from outrider.geometry import wrap
from outrider.relocalise import Array, motions, mount, observability, simulate
from outrider.relocalise.observability import Summary
from outrider.relocalise.room import Room

POSES = 4000  # anywhere in the room, looked at
NARROW = 119.9  # sensors that look less apart see less [deg]
OFTEN = 20.0  # a larger share of weak poses is told in the verdict [%]
OTHERS = {
    "turning on the spot": (0.0, 0.5),
    "on a circle": (0.5, 0.5),
    "straight on": (0.5, 0.0),
    "standing still": (0.0, 0.0),
}  # motions to compare with: v [m/s], w [rad/s]


class Check(NamedTuple):
    """What can be known in a room with one motion."""

    seen: Summary  # of the observability over poses anywhere
    low: float  # sigma that 5 % of the poses are below [-]
    reached: float  # share of the poses from which both ranges are within the sensors' reach [-]
    unknown: float  # share of the poses from which a ray ends where the wall is not known [-]
    motions: dict[str, tuple[float, float, float]]  # median, 5 % and weak share for other motions
    words: tuple[str, ...]  # the verdict, then reasons and advice, a sentence each


def check(room: Room, v: float, w: float) -> Check:
    """Verdict for a robot that drives at v [m/s] and turns at w [rad/s], over `POSES` poses in the room."""
    robots = simulate.anywhere(room, POSES, np.random.default_rng(0), margin=0.0)
    pose = mount.sensors(robots, room.mount)
    found = observability.assess(room, pose, _twist(room, v, w))
    seen = observability.summary(room, found)
    ranges = motions.seen(robots, room)
    reached = float(((ranges > room.range_min) & (ranges <= room.range_max)).all(axis=1).mean())
    unknown = float(
        (found.reason == observability.REASONS.index("a ray ends where the wall is not known")).mean()
    )
    others = {"asked for": (v, w), **OTHERS}
    compared = {}
    for name, (forward, turn) in others.items():
        sigma = observability.sigma_min(room, pose, _twist(room, forward, turn))
        weak = float((sigma < observability.WEAK).mean())
        compared[name] = (float(np.median(sigma)), float(np.quantile(sigma, 0.05)), weak)
    made = Check(seen, compared["asked for"][1], reached, unknown, compared, ())
    return made._replace(words=tuple(_words(room, made)))


def _twist(room: Room, v: float, w: float) -> tuple[Array, Array, Array]:
    return mount.twist(np.array(v), np.array(w), room.mount)


def _words(room: Room, made: Check) -> list[str]:
    seen, weak = made.seen, 100.0 * made.seen.weak
    apart = np.rad2deg(abs(wrap(room.angles[0] - room.angles[1])))
    often = seen.word == "good" and weak > OFTEN
    verdicts = {
        "good": "The pose can be found: two ranges and their change fix it nearly everywhere.",
        "weak": "The pose is only weakly seen: expect slow and uncertain estimates.",
        "unobservable": "The pose cannot be found: whatever the ranges are, many poses explain them.",
    }
    if often:
        verdicts["good"] = (
            "The pose can be found, but not at every moment: keep moving until the weak poses have gone by."
        )
    why = f": {seen.reason}" if seen.reason else ""
    n, chance = seen.poses, seen.word != "unobservable"
    said = (
        (True, verdicts[seen.word]),
        (seen.word != "good" and why, f"Why{why}."),
        (seen.word == "good" and weak > 0.0, f"Weak at {weak:.1f} % of all poses, mostly{why}."),
        (
            n > 1,
            f"The wall looks the same from {n} poses: {n} remain that nothing but a start can tell apart.",
        ),
        (
            chance and seen.width <= seen.chord,
            f"H1 can fail: the wall is {seen.width:.2f} m wide at its narrowest, with both sides in reach.",
        ),
        (
            made.reached < 1.0,
            f"Out of the sensors' reach from {100 * (1 - made.reached):.1f} % of all poses.",
        ),
        (made.unknown > 0.0, f"A ray ends on unknown wall from {100 * made.unknown:.1f} % of all poses."),
        (chance and apart < NARROW, f"The sensors look {apart:.0f} deg apart; 120 deg and more see better."),
    )
    return [text for holds, text in said if holds]
