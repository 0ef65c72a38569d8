"""Robots that drive circles between known walls, exact and noisy, and what an observer makes of them."""

from typing import Any, NamedTuple

import numpy as np

from outrider.geometry import wrap
from outrider.relocalise import Sample, wall
from outrider.relocalise import equations as eq
from outrider.relocalise.room import Room

V = W = 0.5  # [m/s], [rad/s]: circles of 1 m radius
ANGLES = np.radians([60.0, -60.0])
ELLIPSE = Room(wall.ellipse(4.0, 2.5), ANGLES)
START = np.array([1.6, -0.8, 0.3])
OFF = np.array([0.3, -0.25, 0.3])


class Drive(NamedTuple):
    """n robots over m instants."""

    t: Any  # (m,)
    truth: Any  # (m, n, 3)
    s: Any  # (m, n, 2) where the rays end
    ranges: Any  # (m, n, 2) measured
    rates: Any  # (m, n, 2) true
    v: Any  # (n,) as odometry says
    w: Any  # (n,)


def twist(v=V, w=W):
    return eq.Twist(v, 0.0, w)


def circle(start, t, v=V, w=W):
    """Exact poses (..., 3) at times t after start (..., 3)."""
    theta = start[..., 2] + w * t
    x = start[..., 0] + v / w * (np.sin(theta) - np.sin(start[..., 2]))
    y = start[..., 1] - v / w * (np.cos(theta) - np.cos(start[..., 2]))
    return np.stack([x, y, theta], axis=-1)


def drive(n=1, seconds=10.0, rate=50.0, noise=0.0, odometry=0.0, seed=0, start=START, room=ELLIPSE):
    """Ranges with noise [m], odometry with one scale error a robot; start (3,) or (n, 3)."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate) + 1) / rate
    truth = circle(np.broadcast_to(start, (1, n, 3)), t[:, None])
    hit = room.wall.ray(truth[..., None, :2], truth[..., 2:] + room.angles)
    p = np.concatenate([hit.s, truth[..., 2:]], axis=-1)
    rates = eq.rates(eq.scene(room.wall, p, room.angles, hit.range, twist()))
    ranges = hit.range + noise * rng.standard_normal(hit.range.shape)
    scale = 1.0 + odometry * rng.standard_normal((2, n))
    return Drive(t, truth, hit.s, ranges, rates, V * scale[0], W * scale[1])


def sample(made, k, rates=None, room=ELLIPSE):
    """What is known at instant k; rates (m, n, 2): None for the true ones."""
    rates = made.rates if rates is None else rates
    dt = made.t[k] - made.t[k - 1]
    return Sample(dt, made.v, 0.0 * made.v, made.w, made.ranges[k], made.ranges[k - 1], rates[k], room.angles)


def follow(observer, gains, made, rates=None, guess=OFF, room=ELLIPSE, state=None):
    """Poses (m - 1, n, 3) from instant 1 on, and the last state; guess: added to the true start."""
    state = observer.start(made.truth[0] + guess, room.angles, room, gains) if state is None else state
    out = np.empty((len(made.t) - 1, *np.broadcast_shapes(made.truth[0].shape, np.shape(guess))))
    for k in range(1, len(made.t)):
        now = sample(made, k, rates, room)
        state = observer.step(state, now, room, gains)
        out[k - 1] = observer.pose(state, now, room)
    return out, state


def errors(poses, truth):
    """Distances (...) [m] and headings' (...) [rad] from truth, both (..., 3)."""
    off = poses - truth
    return np.hypot(off[..., 0], off[..., 1]), np.abs(wrap(off[..., 2]))


def rms(values, axis=None):
    return np.sqrt(np.mean(np.square(values), axis=axis))
