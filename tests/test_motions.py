"""Motions that make a pose seen: what each is for, that all keep off the wall; and simulated logs."""

import numpy as np
import pytest

from outrider import relocalise
from outrider.errors import InputError
from outrider.geometry import wrap
from outrider.relocalise import motions, mount, observability, simulate
from outrider.relocalise import room as rooms
from outrider.relocalise.motions import Limits
from outrider.relocalise.simulate import Faults

ELLIPSE = rooms.load("ellipse")
MOUNTED = ELLIPSE._replace(mount=np.array([0.12, -0.05]))
LIMITS = Limits(v=0.6, w=0.8, margin=0.25)


# ------------------------------------------------------------------ the unicycle and its sensors


def test_the_arc_is_exact():
    """A thousand small Euler steps end where the closed form does."""
    pose, v, w = np.array([[0.3, -0.2, 0.7], [0.0, 0.0, -2.0]]), np.array([0.4, -0.3]), np.array([0.9, 0.0])
    end = mount.advanced(pose, v, w, 1.5)
    small = pose.copy()
    for _ in range(1000):
        small = mount.advanced(small, v, 0.0, 0.00075) + np.column_stack([0 * v, 0 * v, 0.0015 * w])
        small = mount.advanced(small, v, 0.0, 0.00075)
    np.testing.assert_allclose(end, small, atol=1e-6)


def test_the_mount_is_applied_both_ways():
    rng = np.random.default_rng(0)
    robot, at = rng.uniform(-3.0, 3.0, (50, 3)), np.array([0.2, -0.1])
    sensors = mount.sensors(robot, at)
    np.testing.assert_allclose(mount.robot(sensors, at), robot, atol=1e-12)
    c, s = np.cos(robot[:, 2]), np.sin(robot[:, 2])
    np.testing.assert_allclose(sensors[:, 0], robot[:, 0] + 0.2 * c + 0.1 * s)
    np.testing.assert_allclose(sensors[:, 1], robot[:, 1] + 0.2 * s - 0.1 * c)


def test_the_twist_of_the_sensors_is_their_velocity():
    robot, at, v, w, h = np.array([0.4, 0.1, 0.9]), np.array([0.2, -0.1]), np.array(0.5), np.array(0.7), 1e-6
    ends = [mount.sensors(mount.advanced(robot, v, w, dt), at) for dt in (-h, h)]
    vx, vy, turn = mount.twist(v, w, at)
    c, s = np.cos(robot[2]), np.sin(robot[2])
    moved = (ends[1] - ends[0]) / (2.0 * h)
    np.testing.assert_allclose(moved, [c * vx - s * vy, s * vx + c * vy, turn], atol=1e-8)


# ------------------------------------------------------------------ each motion


def anywhere(n=200, seed=1, room=ELLIPSE):
    return simulate.anywhere(room, n, np.random.default_rng(seed), LIMITS.margin)


@pytest.mark.parametrize("name", [*motions.MOTIONS, *motions.ALIASES])
def test_every_command_is_within_the_limits(name):
    pose, motion = anywhere(), motions.get(name)
    for t in (0.0, 1.7, 33.3):
        made = motions.command(motion, t, pose, ELLIPSE, LIMITS)
        assert made.shape == (200, 2)
        assert (np.abs(made) <= [LIMITS.v + 1e-12, LIMITS.w + 1e-12]).all()
        one = motions.command(motion, t, pose[7], ELLIPSE, LIMITS)
        if name != "random":  # n robots draw n commands
            np.testing.assert_allclose(one, made[7])


@pytest.mark.parametrize("name", motions.MOTIONS)
@pytest.mark.parametrize("wall", ["ellipse", "rectangle"])
def test_every_motion_keeps_off_the_wall(name, wall):
    room = rooms.load(wall)
    made = simulate.drives(room, motions.get(name), 8, 20.0, seed=4, limits=LIMITS)
    assert room.wall.inside(made.truth[..., :2], 0.9 * LIMITS.margin).all()
    turned = np.abs(np.diff(made.truth[..., 2], axis=0)).sum(axis=0)
    assert (turned > 1.0).all()  # none is stuck before a wall


def test_the_exciting_motion_is_spin():
    assert motions.get("exciting") is motions.get(motions.DEFAULT) is motions.spin
    np.testing.assert_array_equal(motions.spin(3.0, anywhere(), ELLIPSE, LIMITS), [0.0, LIMITS.w])


def test_the_periodic_pose_comes_back_and_is_never_at_rest():
    room = ELLIPSE._replace(wall=type(ELLIPSE.wall)(half_axes_m=(50.0, 50.0)))
    steps, period = 1000, 2.0 * np.pi / LIMITS.w
    pose = begun = np.array([0.4, -0.3, 0.8])
    speeds = []
    for k in range(steps):
        v, w = motions.command(motions.periodic, (k + 0.5) * period / steps, pose, room, LIMITS)
        speeds.append(np.hypot(v / LIMITS.v, w / LIMITS.w))
        pose = mount.advanced(pose, v, w, period / steps)
    np.testing.assert_allclose(pose, begun, atol=1e-5)
    assert min(speeds) > 0.5


def test_the_criterion_is_the_largest_of_all_commands():
    """No command within the limits has a larger norm of (v sin phi - w rho), where all are safe."""
    room = rooms.load("ellipse")
    pose = anywhere(50, room=room) * [0.2, 0.2, 1.0]  # near the middle
    best = motions.criterion(0.0, pose, room, LIMITS)
    ranges = motions.seen(pose, room)

    def norm(v, w):
        return np.linalg.norm(v * np.sin(room.angles) - w * ranges, axis=-1)

    found = norm(best[:, :1], best[:, 1:])
    for v in np.linspace(-LIMITS.v, LIMITS.v, 9):
        for w in np.linspace(-LIMITS.w, LIMITS.w, 9):
            assert (norm(v, w) <= found + 1e-9).all()


def test_sigma_is_the_best_seen_of_its_choices():
    pose = anywhere(30) * [0.2, 0.2, 1.0]
    best = motions.sigma(0.0, pose, ELLIPSE, LIMITS)

    def seen(v, w):
        return observability.sigma_min(ELLIPSE, pose, (v, 0.0 * v, w))

    found = seen(*best.T)
    for v, w in motions.CHOICES * (LIMITS.v, LIMITS.w):
        assert (seen(np.full(30, v), np.full(30, w)) <= found + 1e-12).all()


def test_straight_and_turn_turns_only_before_a_wall():
    middle = np.array([0.0, 0.0, 0.0])
    before = np.array([3.6, 0.0, 0.0])
    assert motions.command(motions.straight_and_turn, 0.0, middle, ELLIPSE, LIMITS).tolist() == [0.6, 0.0]
    assert motions.command(motions.straight_and_turn, 0.0, before, ELLIPSE, LIMITS).tolist() == [0.0, 0.8]


def test_a_random_motion_is_kept_and_repeats():
    draw = motions.get("random", 5)
    pose = anywhere(3)
    np.testing.assert_array_equal(
        draw(2.0, pose, ELLIPSE, LIMITS), motions.get("random", 5)(2.9, pose, ELLIPSE, LIMITS)
    )
    assert (draw(2.0, pose, ELLIPSE, LIMITS) != draw(3.0, pose, ELLIPSE, LIMITS)).all()
    assert (draw(2.0, pose, ELLIPSE, LIMITS) != motions.get("random", 6)(2.0, pose, ELLIPSE, LIMITS)).all()


def test_an_unknown_motion_is_told_the_nearest():
    with pytest.raises(InputError, match="did you mean spin"):
        motions.get("spinn")
    with pytest.raises(InputError, match="straight_and_turn"):
        motions.get("straight")


# ------------------------------------------------------------------ the log of a simulated robot


@pytest.mark.parametrize("room", [ELLIPSE, MOUNTED])
def test_without_noise_a_log_is_the_truth(room):
    """Odometry leads from row to row, and the ranges are those of the sensors' point."""
    log = simulate.simulate(room, motions.constant, 8.0, 20.0, noise=0.0, odometry=0.0, seed=2)
    assert (len(log.t), log.v[0], log.w[0]) == (161, 0.0, 0.0)
    for k in range(1, len(log.t)):
        moved = mount.advanced(log.truth[k - 1], log.v[k], log.w[k], 0.05)
        np.testing.assert_allclose(wrap(moved - log.truth[k]), 0.0, atol=1e-12)
    at = mount.sensors(log.truth, room.mount)
    hit = room.wall.ray(at[:, None, :2], at[:, 2:] + room.angles)
    np.testing.assert_allclose(log.ranges, hit.range, atol=1e-12)


def test_noise_is_as_asked():
    made = simulate.drives(ELLIPSE, motions.spin, 200, 5.0, 10.0, noise=0.03, odometry=0.05, seed=3)
    true = motions.seen(made.truth, ELLIPSE)
    assert np.std(made.ranges - true) == pytest.approx(0.03, rel=0.03)
    scale = made.odometry[1, :, 1] / 0.5
    assert np.std(scale) == pytest.approx(0.05, rel=0.15)
    np.testing.assert_array_equal(made.odometry[1:], np.broadcast_to(made.odometry[1], (50, 200, 2)))


def test_the_same_seed_makes_the_same_log():
    a, b, c = (simulate.simulate(ELLIPSE, seconds=3.0, seed=seed).fingerprint() for seed in (1, 1, 2))
    assert a == b != c


def test_faults_are_as_asked():
    faults = Faults(kidnapped=(2.0,), lost=0.1, short=0.2)
    made = simulate.drives(ELLIPSE, motions.spin, 100, 4.0, 10.0, noise=0.0, seed=5, faults=faults)
    assert np.mean(np.isnan(made.ranges)) == pytest.approx(0.1, abs=0.01)
    off = made.ranges - motions.seen(made.truth, ELLIPSE)
    assert np.mean(off[np.isfinite(off)] < -1e-9) == pytest.approx(0.2, abs=0.015)
    assert not (off > 1e-9).any()
    jump = np.hypot(*np.moveaxis(np.diff(made.truth[..., :2], axis=0), -1, 0))
    assert (jump[19] > 0.01).all()  # from t = 1.9 to 2.0 s
    assert not np.delete(jump, 19, axis=0).any()


def test_a_range_out_of_reach_is_none():
    room = ELLIPSE._replace(range_min=1.0, range_max=3.0)
    made = simulate.drives(room, motions.spin, 50, 6.0, noise=0.0, seed=6)
    true = motions.seen(made.truth, ELLIPSE)
    reached = (true >= 1.0) & (true <= 3.0)
    np.testing.assert_array_equal(np.isfinite(made.ranges), reached)
    assert 0.1 < reached.mean() < 0.9


@pytest.mark.parametrize(
    ("asked", "word"),
    [
        ({"seconds": 0.0}, "seconds"),
        ({"rate": -1.0}, "rate"),
        ({"noise": -0.1}, "noise"),
        ({"odometry": np.inf}, "odometry"),
        ({"start": [4.2, 0.0, 0.0]}, "outside the wall"),
        ({"start": [np.nan, 0.0, 0.0]}, "outside the wall"),
        ({"faults": Faults(lost=1.5)}, "lost"),
        ({"limits": Limits(v=-1.0)}, "v ="),
        ({"limits": Limits(margin=9.0)}, "no place 9 m from the wall"),
    ],
)
def test_what_cannot_be_simulated(asked, word):
    with pytest.raises(InputError, match=word):
        simulate.simulate(ELLIPSE, **asked)


def test_a_log_of_any_motion_is_followed():
    """From a known start, the default observer ends within 3 cm whatever the motion."""
    from outrider.relocalise import run

    for name in motions.MOTIONS:
        log = simulate.simulate(ELLIPSE, motions.get(name), 12.0, seed=7, start=np.array([0.5, 0.3, 1.0]))
        made = run.run(log, ELLIPSE, log.truth[0])
        assert made.errors()[-1, 0] < 0.03, name
    assert "pose_ekf" in relocalise.names()
