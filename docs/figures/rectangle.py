"""Draws rectangle.png: returns of a car, its rectangle fitted to them, and a beam that corrects it."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from outrider import lidar_model
from outrider.geometry import TAU, corners
from outrider.rectangle import fit_closeness, fit_sized

SIZE = np.array([4.5, 1.8])
BLUE, RED, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
SIGMA = np.array([0.063, 2.0])  # noise of range and shape together [m], Cauchy width in sigmas


def look(pose, eye, rng, beams=300):
    """Noisy returns (n, 2) of the car at pose seen from eye, and headings (m,) of the beams past it."""
    heading = np.arange(beams) * TAU / beams
    shapes = lidar_model.Shapes(
        np.tile(pose, (beams, 1, 1)), SIZE[None], np.zeros((beams, 0, 2)), np.zeros(0), np.zeros((0, 2, 2))
    )
    echo = lidar_model.cast(np.tile(eye, (beams, 1)), heading, shapes)
    hit = np.isfinite(echo.range)
    r = echo.range[hit] + rng.normal(0.0, 0.02, hit.sum())
    return eye + r[:, None] * np.column_stack([np.cos(heading[hit]), np.sin(heading[hit])]), heading[~hit]


def fit(p, eye, prior, far):
    pose, N = np.empty(3), np.empty((3, 4))
    o, far_o = np.tile(eye, (len(p), 1)), np.tile(eye, (len(far), 1))
    prior = np.array([*prior, 1.0, 0.3])
    fit_sized(prior[:3].copy(), p, o, far, far_o, np.ones(len(far)), prior, SIZE, SIGMA, pose, N)
    return pose


def box(axes, pose, size, **style):
    axes.add_patch(Polygon(corners(pose, size), fill=False, **style))


def beam(axes, eye, to, **style):
    axes.plot([eye[0], to[0]], [eye[1], to[1]], **style)


def known(axes, rng):
    """A tracked car: prediction, fit, and the beams beside it."""
    eye, true = np.array([0.0, 0.0]), np.array([6.0, 4.6, 0.35])
    p, past = look(true, eye, rng)
    turn = (past - np.arctan2(true[1], true[0]) + np.pi) % TAU - np.pi
    beside = past[np.argsort(np.abs(turn))[:8]]
    far = eye + 12.0 * np.column_stack([np.cos(beside), np.sin(beside)])
    predicted = true + np.array([0.75, -0.45, -0.17])
    fitted = fit(p, eye, predicted, far)
    for to in p:
        beam(axes, eye, to, color=GREY, lw=0.5, alpha=0.5)
    cut = far[np.argsort(np.arctan2(far[:, 1], far[:, 0]))][3]
    for to in far:
        beam(axes, eye, to, color=GREY, lw=0.5, alpha=0.5)
    beam(axes, eye, cut, color=RED, lw=1.8)
    box(axes, predicted, SIZE, ec=GREY, ls=(0, (4, 3)), lw=1.6)
    box(axes, fitted, SIZE, ec=BLUE, lw=2.4)
    axes.plot(*p.T, ".", color="k", ms=6)
    axes.annotate(
        "predicted", corners(predicted, SIZE)[2], (5.6, 0.9), color=GREY, arrowprops={"arrowstyle": "-"}
    )
    axes.annotate("fitted", corners(fitted, SIZE)[1], (2.5, 6.0), color=BLUE, arrowprops={"arrowstyle": "-"})
    axes.annotate("went past: the\nbody is not there", cut, (11.3, 4.0), color=RED, va="center")
    axes.set_title("A known body: its rectangle on the returns", loc="left")
    axes.set(xlim=(-1.0, 14.2), ylim=(-0.9, 7.4))


def new(axes, rng):
    """Only the rear is seen: the rectangle around the returns lies across, the sized one behind its rear."""
    eye, true = np.array([0.0, 3.2]), np.array([8.0, 3.2, 0.05])
    p, _ = look(true, eye, rng)
    x, y, heading, length, width = fit_closeness(np.ascontiguousarray(p), 0.063)
    for to in p:
        beam(axes, eye, to, color=GREY, lw=0.5, alpha=0.5)
    box(axes, np.array([x, y, heading]), np.array([length, max(width, 0.12)]), ec=GREEN, lw=2.0)
    box(axes, fit(p, eye, true + np.array([0.2, 0.1, 0.05]), np.zeros((0, 2))), SIZE, ec=BLUE, lw=2.4)
    axes.plot(*p.T, ".", color="k", ms=6)
    axes.annotate(
        "around the returns:\nits long side is the car's width", (0.0, 0.0), (3.4, 0.9), color=GREEN
    )
    axes.annotate("of known size", (9.0, 4.3), color=BLUE, ha="center")
    axes.set_title("Only the rear is seen", loc="left")
    axes.set(xlim=(-1.0, 12.2), ylim=(-0.6, 6.6))


def main():
    figure = Figure(figsize=(12.0, 3.7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    rng = np.random.default_rng(3)
    for axes, draw, eye in zip(figure.subplots(1, 2), (known, new), ((0.0, 0.0), (0.0, 3.2)), strict=True):
        draw(axes, rng)
        axes.plot(*eye, marker="o", ms=9, color="k")
        axes.annotate("sensor", eye, (eye[0], eye[1] - 0.35), ha="center", va="top")
        axes.set(aspect="equal", xticks=[], yticks=[])
        for spine in axes.spines.values():
            spine.set_visible(False)
    figure.savefig(Path(__file__).with_suffix(".png"), metadata={"Software": None})


if __name__ == "__main__":
    main()
