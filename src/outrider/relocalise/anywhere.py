"""Where the robot is without a guess: one filter for each pose that the first ranges allow, until few remain.

The seeds are the whole statically unobservable curve of the first two ranges (`seeds`). Each runs the filter
of `observers/pose_ekf`; its score is the sum of the log likelihoods of what it then sees, slowly forgotten.
Far less likely ones are dropped, those that have met are merged. In a wall that looks the same when turned,
as an ellipse does, the twins remain for ever, and are told.
"""

from __future__ import annotations

from math import ceil, log
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from outrider.errors import InputError
from outrider.geometry import wrap
from outrider.relocalise import Array, Bools, Sample, lost
from outrider.relocalise.lost import Lost
from outrider.relocalise.observers import pose_ekf
from outrider.relocalise.seeds import matches, seeds

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

__all__ = ["Found", "Gains", "Search", "matches", "seeds"]


DOUBT = lost.Gains(window=0.5, least=6.0, share=0.6)  # when seeds are sown again: early, as it costs nothing


class Gains(NamedTuple):
    """How hypotheses are made, judged and dropped."""

    headings: float = 64.0  # of the seeds, at least
    spread_position: float = 0.15  # standard deviation of a seed, along x and y [m]
    spread_heading: float = 0.1  # [rad]
    memory: float = 20.0  # time constant with which likelihoods are forgotten [s]
    every: float = 0.5  # hypotheses are dropped and merged so often [s]
    drop: float = 40.0  # this much less likely than the best: dropped [nats]
    alike: float = 0.2  # closer than this, in metres plus radians: merged
    late: float = 25.0  # seeds that are sown again start as much less likely than the best [nats]
    doubt: float = 10.0  # a second one that is less unlikely than this: ambiguous [nats]


class Found(NamedTuple):
    """What is known after a sample; the most likely hypothesis first, none before two ranges were seen."""

    pose: Array  # (m, 3) of the sensors' point, x, y [m], theta [rad] in [-pi, pi)
    covariance: Array  # (m, 3, 3)
    log_weight: Array  # (m,) log likelihood compared with the best [nats], 0 first
    twin: Bools  # (m,) no range will ever tell it from the best: the wall looks the same when turned
    ambiguous: bool  # a second hypothesis may be the true one too
    moved: bool  # what is likeliest has just become one of those begun when nothing fitted: carried


class Search:
    """One robot's hypotheses, sample by sample."""

    def __init__(self, room: Room, gains: Gains | None = None, ekf: pose_ekf.Gains | None = None) -> None:
        """Nothing known. InputError for a circle, in which no pose can be found."""
        if room.wall.symmetry == 0:
            raise InputError(
                "the wall is a circle: every bearing of the robot fits any ranges; want another wall"
            )
        self.room, self.gains = room, gains or Gains()
        self.ekf = (ekf or pose_ekf.Gains())._replace(
            start_position=self.gains.spread_position,
            start_heading=self.gains.spread_heading,
            start_doubt=0.0,
        )
        self._state = pose_ekf.start(np.empty((0, 3)), room.angles, room, self.ekf)
        self._score, self._round = np.empty(0), np.empty(0, np.int64)  # (m,) of each hypothesis
        self._best_round, self._since, self._doubt = 0, 0.0, Lost(lost.among(DOUBT, room.strays))
        self._sown = 0  # samples whose seeds were sown

    def step(self, sample: Sample) -> Found:
        """Take in a sample with a scalar twist and ranges (2,); seeds wait until both ranges are there."""
        if len(self._score):
            self._follow(sample)
        early = self._sown < sowings(self.room.strays)
        if early or not len(self._score) or self._unfit(sample):
            self._begin(sample, early)
        return self._found(sample)

    def _begin(self, sample: Sample, early: bool) -> None:
        """A hypothesis for each seed of this sample beside those there are, less likely than the best."""
        if not (np.isfinite(sample.ranges) & (np.nan_to_num(sample.ranges) > 0.0)).all():
            return
        pose = seeds(self.room, sample.ranges, sample.angles, int(self.gains.headings))
        if not len(pose):
            return
        new = pose_ekf.start(pose, sample.angles, self.room, self.ekf)
        self._state = pose_ekf.State(*(np.concatenate(pair) for pair in zip(self._state, new, strict=True)))
        number = 0 if early else int(self._round.max(initial=-1)) + 1
        self._sown += 1
        score = float(self._score.max()) - self.gains.late if len(self._score) else 0.0
        self._score = np.append(self._score, np.full(len(pose), score))
        self._round = np.append(self._round, np.full(len(pose), number))
        self._since = 0.0
        self._doubt.reset()

    def _follow(self, sample: Sample) -> None:
        """All filters one sample on, and now and then fewer of them."""
        self._state = pose_ekf.step(self._state, sample, self.room, self.ekf)
        dt = sample.dt if np.isfinite(sample.dt) else 0.0
        self._score = self._score * np.exp(-dt / self.gains.memory) + self._state.fit
        self._since += dt
        if self._since >= self.gains.every and len(self._score) > 1:
            self._since = 0.0
            keep = remaining(self._state.pose, self._score, self.gains)
            self._state = pose_ekf.State(*(part[keep] for part in self._state))
            self._score, self._round = self._score[keep], self._round[keep]

    def _unfit(self, sample: Sample) -> bool:
        """Whether what is most likely does not fit for too long."""
        best = int(np.argmax(self._score))
        return self._doubt.step(sample.dt, float(self._state.distance[best]), int(self._state.rays[best]))

    def _found(self, sample: Sample) -> Found:
        order = np.argsort(-self._score, kind="stable")
        pose = pose_ekf.pose(self._state, sample, self.room)[order]
        weight = self._score[order] - self._score.max(initial=-np.inf)
        ambiguous = not len(pose) or bool((weight[1:] > -self.gains.doubt).any())
        best = int(self._round[order[0]]) if len(pose) else 0
        moved, self._best_round = best > self._best_round, max(best, self._best_round)
        return Found(pose, self._state.P[order], weight, self._twins(pose), ambiguous, moved)

    def _twins(self, pose: Array) -> Bools:
        """(m,) which poses are the first one, turned with the wall."""
        twin = np.zeros(len(pose), np.bool_)
        for k in range(1, self.room.wall.symmetry if len(pose) else 0):
            twin |= apart(pose, self.room.wall.turned(pose[0], k)) < self.gains.alike
        return twin


def sowings(strays: float) -> int:
    """From how many samples seeds are sown at first: in 99 of 100 both ranges of one are of the wall."""
    both = (1.0 - strays) ** 2
    return 1 if both >= 0.99 else ceil(log(0.01) / log(1.0 - both))


def remaining(pose: Array, score: Array, gains: Gains) -> npt.NDArray[np.int64]:
    """Which of the hypotheses (n, 3) stay, likeliest first: not far less likely, and no near one likelier."""
    order = np.argsort(-score, kind="stable")
    order = order[score[order] > score[order[0]] - gains.drop]
    near = apart(pose[order, None], pose[order]) < gains.alike
    alive = np.ones(len(order), np.bool_)
    for k in range(len(order)):
        if alive[k]:
            alive[k + 1 :] &= ~near[k, k + 1 :]
    return np.asarray(order[alive])


def apart(a: Array, b: Array) -> Array:
    """How far poses (..., 3) are apart: metres plus radians."""
    away = a - b
    return np.asarray(np.hypot(away[..., 0], away[..., 1]) + np.abs(wrap(away[..., 2])))
