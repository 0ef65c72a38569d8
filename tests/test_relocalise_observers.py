"""The contract of relocalise/observers/, for every file in it."""

import inspect
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_circling import ANGLES, ELLIPSE, OFF, START, drive, errors, follow, rms, sample
from outrider import relocalise
from outrider.geometry import rotate, wrap
from outrider.relocalise import wall
from outrider.relocalise.room import Room

NAN = float("nan")
NAMES = relocalise.names()
every_observer = pytest.mark.parametrize("name", NAMES)


def moved(poses, angle, by):
    """Poses (..., 3) of a world turned by angle [rad], then shifted by `by` [m]."""
    return np.concatenate([rotate(poses[..., :2], angle) + by, wrap(poses[..., 2:] + angle)], axis=-1)


@every_observer
def test_contract(name):
    observer = relocalise.get(name)
    assert observer.reference
    fields = inspect.getsource(observer.Gains).split("\n")
    assert observer.Gains() == observer.Gains(*(float(value) for value in observer.Gains()))
    for field in observer.Gains._fields:
        assert re.search(rf"^    {field}: float = \S+  # .*\[.+\]$", "\n".join(fields), re.MULTILINE), field
    state = observer.start(np.tile(START, (4, 1)), ANGLES, ELLIPSE, observer.Gains())
    assert all(len(part) == 4 for part in state)


@every_observer
def test_finds_the_pose_from_a_guess_off_by_40_cm(name):
    observer = relocalise.get(name)
    made = drive(8, 15.0, 10.0, noise=0.01, odometry=0.02)
    poses, state = follow(observer, observer.Gains(), made)
    far, turned = errors(poses[-50:], made.truth[-50:])
    assert rms(far) < 0.05
    assert rms(turned) < 0.03
    if hasattr(observer, "covariance"):
        sigma = np.sqrt(np.trace(observer.covariance(state)[:, :2, :2], axis1=1, axis2=2))
        assert (far[-1] < 5.0 * sigma).all()


@every_observer
def test_n_at_once_is_each_alone(name):
    observer = relocalise.get(name)
    made = drive(1, 1.0)
    guess = OFF * np.array([[1.0], [-1.0], [0.2]])
    together, _ = follow(observer, observer.Gains(), made, guess=guess)
    for k in range(3):
        alone, _ = follow(observer, observer.Gains(), made, guess=guess[k : k + 1])
        np.testing.assert_allclose(together[:, k], alone[:, 0], atol=1e-12)


@every_observer
@given(angle=st.floats(-3.0, 3.0), x=st.floats(-5.0, 5.0))
def test_turning_the_world_changes_nothing(name, angle, x):
    observer, by = relocalise.get(name), np.array([x, 1.0])
    made = drive(2, 0.5, 10.0, noise=0.01, odometry=0.02)
    room = Room(wall.ellipse(4.0, 2.5, (x, 1.0), angle), ANGLES)
    other = made._replace(truth=moved(made.truth, angle, by))
    first, _ = follow(observer, observer.Gains(), made, guess=0.0)
    second, _ = follow(observer, observer.Gains(), other, guess=0.0, room=room)
    off = second - moved(first, angle, by)
    off[..., 2] = wrap(off[..., 2])
    np.testing.assert_allclose(off, 0.0, atol=1e-8)


@every_observer
def test_a_mirrored_world_changes_nothing(name):
    """Left for right: y, theta, w and both sensors change sign."""
    observer, flip = relocalise.get(name), np.array([1.0, -1.0, -1.0])
    made = drive(2, 2.0, 10.0, noise=0.01, odometry=0.02)
    mirrored = made._replace(truth=made.truth * flip, w=-made.w)
    first, _ = follow(observer, observer.Gains(), made)
    second, _ = follow(
        observer, observer.Gains(), mirrored, guess=OFF * flip, room=ELLIPSE._replace(angles=-ANGLES)
    )
    np.testing.assert_allclose(second, first * flip, atol=1e-9)


@every_observer
@pytest.mark.parametrize(
    "broken",
    [
        {"ranges": [NAN, NAN]},
        {"ranges": [NAN, 1.0]},
        {"rates": [NAN, NAN]},
        {"ranges": [NAN, NAN], "before": [NAN, NAN], "rates": [NAN, NAN]},
        {"ranges": [-1.0, 0.0]},
        {"ranges": [1e4, 1e4]},
        {"rates": [1e4, -1e4]},
        {"vx": NAN},
        {"w": NAN, "vx": NAN, "vy": NAN},
        {"dt": 0.0},
        {"dt": -0.1},
        {"dt": NAN},
        {"dt": 10.0},
    ],
)
def test_whatever_is_missing_it_stays_finite(name, broken):
    observer = relocalise.get(name)
    made = drive(3, 1.0, 10.0)
    state = observer.start(made.truth[0] + OFF, ANGLES, ELLIPSE, observer.Gains())
    for k in range(1, len(made.t)):
        now = sample(made, k)
        if k % 2:
            now = now._replace(**{key: np.asarray(value) for key, value in broken.items()})
        state = observer.step(state, now, ELLIPSE, observer.Gains())
        pose = observer.pose(state, now, ELLIPSE)
        assert all(np.isfinite(part).all() for part in state)
        assert np.isfinite(pose).all()
        assert (np.abs(pose[:, 2]) <= np.pi).all()


@every_observer
@pytest.mark.parametrize("where", [[9.0, 0.0, 0.0], [0.0, -2.6, 1.0], [4.0, 2.5, 5.0], [-4.0, 0.0, 0.0]])
def test_a_guess_outside_starts_inside(name, where):
    observer = relocalise.get(name)
    state = observer.start(np.array([where]), ANGLES, ELLIPSE, observer.Gains())
    found = observer.pose(state, sample(drive(1, 0.1), 1), ELLIPSE)[0]
    assert ELLIPSE.wall.inside(found[:2])
    assert ELLIPSE.wall.distance(found[:2]) < 0.05
    assert wrap(found[2] - where[2]) == pytest.approx(0.0, abs=1e-12)


@every_observer
def test_an_unknown_part_of_the_wall_says_nothing(name):
    """The side the second sensor looks at is missing: its ranges, whatever they are, change nothing."""
    observer = relocalise.get(name)
    corners = np.array([[-4.0, -2.5], [4.0, -2.5], [4.0, 2.5], [-4.0, 2.5]])
    shut, opened = (
        Room(wall.polygon(corners, 0.3, sides), np.radians([90.0, -90.0])) for sides in ((), (0,))
    )
    made = drive(1, 1.0, start=np.array([0.0, 0.5, 0.0]), room=shut)
    made.ranges[:, :, 1] += np.linspace(0.0, 1.0, len(made.t))[:, None]
    after, _ = follow(observer, observer.Gains(), made, guess=0.0, room=opened)
    assert errors(after, made.truth[1:])[0].max() < 1e-3
    fooled, _ = follow(observer, observer.Gains(), made, guess=0.0, room=shut)
    assert errors(fooled, made.truth[1:])[0].max() > 0.02


def test_names_are_the_files():
    assert {"pose_ekf", "wall_range"} <= set(NAMES)
