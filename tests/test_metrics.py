"""Truth against estimates: closed cases, symmetry, and the figures another program would print."""

import datetime
import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from made_frames import DT, SIZE, STREET, Car, make_frames
from outrider.errors import InputError
from outrider.evaluate import evaluate
from outrider.geometry import rotate, transform, wrap
from outrider.io import write_recording
from outrider.io.run import RunWriter
from outrider.metrics import Estimates, Truth, gospa, lead_time, overlap, score, spread, truth_from_poses
from outrider.records import LaserScan, Pose, TrackState
from outrider.settings import Settings

points = st.integers(0, 6).flatmap(lambda n: arrays(float, (n, 2), elements=st.floats(-20, 20, width=32)))


def driven(t, speed=8.0, turn=0.5):
    """Poses (n, 3), velocities (n, 2) of a body on a circle."""
    yaw = turn * t
    p = speed / turn * np.stack([np.sin(yaw), 1.0 - np.cos(yaw)], -1)
    return np.column_stack([p, wrap(yaw)]), speed * np.stack([np.cos(yaw), np.sin(yaw)], -1)


def tracked(t, poses, velocity, ids=1, state=TrackState.CONFIRMED):
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    n = len(t)
    return Estimates(
        t,
        np.broadcast_to(np.asarray(ids, np.int64), n).copy(),
        poses[:, :2],
        velocity,
        poses[:, 2],
        course,
        np.full(n, state, np.uint8),
    )


T = np.arange(0.0, 8.0, 0.1)
POSES, VELOCITY = driven(T)
TRUTH = Truth(T, POSES[:, :2], VELOCITY, POSES[:, 2])


# ------------------------------------------------------------------ truth


def test_velocity_of_the_centre_of_a_turning_body():
    fine = np.arange(0.0, 8.0, 1 / 120)
    poses, _ = driven(fine)
    offset = np.array([0.4, -0.2])
    truth = truth_from_poses(fine, poses, offset).at(T[5:-5])
    centre = transform(POSES, offset)[5:-5]
    arm = rotate(np.broadcast_to(offset, (len(T), 2)), POSES[:, 2])
    velocity = VELOCITY + 0.5 * np.stack([-arm[:, 1], arm[:, 0]], -1)
    assert_allclose(truth.W_p, centre, atol=1e-3)
    assert_allclose(truth.W_v, velocity[5:-5], atol=0.01)
    assert_allclose(wrap(truth.yaw - POSES[5:-5, 2]), 0.0, atol=1e-9)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-5, 5))
def test_the_derivative_of_a_parabola_is_exact(a, b, v):
    t = np.arange(0.0, 3.0, 0.01)
    poses = np.column_stack([a * t**2 + v * t, b * t**2, np.zeros(len(t))])
    found = truth_from_poses(t, poses)
    assert_allclose(found.W_v, np.column_stack([2 * a * t + v, 2 * b * t]), atol=1e-6)


def test_noise_is_smoothed():
    rng = np.random.default_rng(3)
    fine = np.arange(0.0, 8.0, 1 / 120)
    poses, velocity = driven(fine, speed=1.0)
    noisy = poses + rng.normal(0.0, 1e-3, poses.shape) * [1.0, 1.0, 0.0]
    error = truth_from_poses(fine, noisy).W_v - velocity
    window = 31
    theory = 1e-3 * 120 * np.sqrt(12 / (window * (window**2 - 1)))  # of a slope fitted to 31 samples
    assert 0.8 * theory < error[20:-20].std() < 1.2 * theory


def test_nothing_is_known_in_a_gap_and_outside():
    fine = np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(3.0, 5.0, 0.01)])
    truth = truth_from_poses(fine, driven(fine)[0]).at(np.array([-0.1, 1.0, 2.5, 4.0, 5.1]))
    assert np.isnan(truth.W_p[:, 0]).tolist() == [True, False, True, False, True]
    assert_allclose(np.hypot(*truth.W_v[[1, 3]].T), 8.0, rtol=1e-3)


def test_too_few_poses_have_a_place_but_no_velocity():
    truth = truth_from_poses(T[:4], POSES[:4])
    assert np.isfinite(truth.W_p).all()
    assert np.isnan(truth.W_v).all()


# ------------------------------------------------------------------ score


def test_a_perfect_track_has_no_error():
    found = score(TRUTH, tracked(T, POSES, VELOCITY), gate=1.0, moving_mps=0.2)
    assert (found.present, found.identities, found.switches, found.breaks) == (1.0, 1, 0, 0)
    assert found.heading_flips == 0
    for name in ("position_m", "velocity_mps", "speed_mps", "course_deg", "yaw_deg"):
        assert_allclose(getattr(found, name), 0.0, atol=1e-9)


def test_known_errors_are_found():
    shifted = POSES + np.column_stack([np.full(len(T), 0.3), np.full(len(T), -0.4), np.full(len(T), 0.1)])
    found = score(TRUTH, tracked(T, shifted, 1.25 * VELOCITY), gate=1.0, moving_mps=0.2)
    assert_allclose(found.position_m, 0.5)
    assert_allclose(found.velocity_mps, 2.0)
    assert_allclose(found.speed_mps, 2.0)
    assert_allclose(found.course_deg, 0.0, atol=1e-9)
    assert_allclose(found.yaw_deg, np.degrees(0.1))


def test_root_mean_square_median_and_95_percent():
    assert_allclose(spread(np.array([3.0, -4.0, np.nan])), [np.sqrt(12.5), 3.5, 3.95])
    assert np.isnan(spread(np.array([]))).all()


def test_a_turned_heading_is_a_flip_only_while_the_body_moves():
    poses = POSES + [0.0, 0.0, 3.0] * (np.arange(len(T)) < 7)[:, None]
    rows = tracked(T, poses, VELOCITY)
    assert score(TRUTH, rows, 1.0, moving_mps=0.2).heading_flips == 7
    assert score(TRUTH, rows, 1.0, moving_mps=9.0).heading_flips == 0


def test_breaks_and_switches_are_counted():
    keep = (
        (np.arange(len(T)) < 20)
        | (np.arange(len(T)) >= 30) & (np.arange(len(T)) < 50)
        | (np.arange(len(T)) >= 60)
    )
    ids = np.repeat([4, 4, 4, 9, 9, 9, 9, 9], 10)
    rows = tracked(T, POSES, VELOCITY, ids).rows(keep)
    found = score(TRUTH, rows, gate=1.0, moving_mps=0.2)
    assert (found.scans, found.present) == (80, 60 / 80)
    assert (found.identities, found.switches, found.breaks, found.ids) == (2, 1, 2, (4, 9))


def test_the_nearest_track_counts_and_only_inside_the_gate():
    aside = np.array([0.1, 0.0, 0.0])
    near, far = tracked(T, POSES + aside, VELOCITY, 1), tracked(T, POSES + 2 * aside, VELOCITY, 2)
    both = Estimates(
        *(np.concatenate(pair) for pair in zip(far_columns(near), far_columns(far), strict=True))
    )
    found = score(TRUTH, both.rows(np.argsort(both.t, kind="stable")), gate=0.15, moving_mps=0.2)
    assert found.ids == (1,)
    assert_allclose(found.position_m.rms, 0.1)
    assert score(TRUTH, far, gate=0.15, moving_mps=0.2).present == 0.0


def far_columns(e):
    return e.t, e.id, e.W_p, e.W_v, e.yaw, e.course, e.state


def test_tracks_are_interpolated_to_the_truth():
    late = tracked(T + 0.05, *driven(T + 0.05))
    found = score(TRUTH, late, gate=1.0, moving_mps=0.2)
    assert found.present == (len(T) - 1) / len(T)
    assert found.position_m.rms < 0.006


@given(st.floats(-np.pi, np.pi), st.floats(-50, 50), st.floats(-50, 50))
def test_turning_and_moving_the_world_changes_nothing(angle, dx, dy):
    rng = np.random.default_rng(0)
    rows = tracked(T, POSES + rng.normal(0, 0.1, POSES.shape), VELOCITY + rng.normal(0, 0.3, VELOCITY.shape))

    def moved(p):
        return rotate(p, angle) + np.array([dx, dy])

    truth = Truth(T, moved(TRUTH.W_p), rotate(TRUTH.W_v, angle), wrap(TRUTH.yaw + angle))
    turned = Estimates(
        T,
        rows.id,
        moved(rows.W_p),
        rotate(rows.W_v, angle),
        wrap(rows.yaw + angle),
        wrap(rows.course + angle),
        rows.state,
    )
    a, b = score(TRUTH, rows, 1.0, 0.2).to_dict(), score(truth, turned, 1.0, 0.2).to_dict()
    assert a.pop("ids") == b.pop("ids")
    assert_allclose(list(a.values()), list(b.values()), atol=1e-8)


def test_the_figures_are_those_of_a_plain_recount():
    """Many noisy tracks, gaps and clutter, against the definitions written out with one loop an instant."""
    rng = np.random.default_rng(7)
    t = T + 0.03
    pieces = []
    for i, (first, last, noise) in enumerate(
        [(0, 30, 0.1), (25, 60, 0.2), (58, 80, 0.1), (0, 80, 3.0), (40, 41, 0)]
    ):
        poses, velocity = driven(t[first:last])
        poses = poses + rng.normal(0.0, noise, poses.shape)
        pieces.append((t[first:last], poses, velocity + rng.normal(0.0, 1.0, velocity.shape), i))
    drop = rng.random(80) < 0.06
    pieces[1] = tuple(c[~drop[25:60]] if np.ndim(c) else c for c in pieces[1])
    rows = [tracked(*piece) for piece in pieces]
    e = Estimates(*(np.concatenate(c) for c in zip(*map(far_columns, rows), strict=True)))
    found = score(TRUTH, e.rows(np.argsort(e.t, kind="stable")), gate=0.5, moving_mps=0.2).to_dict()

    errors, used, flips = [], [], 0
    for k, now in enumerate(T):
        best = None
        for when, poses, velocity, i in pieces:
            j = int(np.searchsorted(when, now))
            if len(when) < 2 or j == 0 or j == len(when) or when[j] - when[j - 1] > 0.3:
                continue
            w = (now - when[j - 1]) / (when[j] - when[j - 1])
            p = (1 - w) * poses[j - 1, :2] + w * poses[j, :2]
            v = (1 - w) * velocity[j - 1] + w * velocity[j]
            yaw = poses[j - 1, 2] + w * wrap(poses[j, 2] - poses[j - 1, 2])
            d = np.hypot(*(p - POSES[k, :2]))
            if best is None or d < best[0]:
                best = (d, np.hypot(*(v - VELOCITY[k])), np.hypot(*v) - 8.0, wrap(yaw - POSES[k, 2]), i)
        if best and best[0] < 0.5:
            errors.append(best[:4])
            used.append(best[4])
            flips += abs(best[3]) > np.pi / 2
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert found["present"] == len(used) / len(T)
    assert found["identities"] == len(set(used))
    assert found["switches"] == sum(a != b for a, b in pairwise(used))
    assert found["heading_flips"] == flips
    names = ("position_rms_m", "velocity_rms_mps", "speed_rms_mps")
    assert_allclose([found[n] for n in names], rms[:3], rtol=1e-9)
    assert_allclose(found["yaw_rms_deg"], np.degrees(rms[3]), rtol=1e-9)
    assert 0.5 < found["present"] < 1.0
    assert found["switches"] > 2


# ------------------------------------------------------------------ GOSPA


def test_gospa_of_closed_cases():
    one, two = np.array([[0.0, 0.0]]), np.array([[0.0, 0.0], [10.0, 0.0]])
    none = np.zeros((0, 2))
    assert gospa(none, none, 2.0) == (0.0, 0.0, 0.0, 0.0)
    assert_allclose(gospa(one, one + np.array([0.6, 0.8]), 2.0), (1.0, 1.0, 0.0, 0.0))
    assert_allclose(gospa(one, none, 2.0), (np.sqrt(2.0), 0.0, 2.0, 0.0))
    assert_allclose(gospa(none, two, 2.0), (2.0, 0.0, 0.0, 4.0))
    assert_allclose(gospa(one, one + 5.0, 2.0), (2.0, 0.0, 2.0, 2.0))
    assert_allclose(gospa(two, two[::-1] + np.array([1.0, 0.0]), 2.0), (np.sqrt(2.0), 2.0, 0.0, 0.0))


@given(points, points, points)
def test_gospa_is_a_metric(a, b, c):
    assert gospa(a, b, 3.0).distance == pytest.approx(gospa(b, a, 3.0).distance, abs=1e-9)
    assert gospa(a, a, 3.0).distance == 0.0
    assert gospa(a, c, 3.0).distance <= gospa(a, b, 3.0).distance + gospa(b, c, 3.0).distance + 1e-9
    parts = gospa(a, b, 3.0)
    assert sum(parts[1:]) == pytest.approx(parts.distance**2)
    assert (parts.missed - parts.false) / 4.5 == pytest.approx(len(a) - len(b))


def test_gospa_is_that_of_stonesoup():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        metrics = pytest.importorskip("stonesoup.metricgenerator.ospametric")
        state = pytest.importorskip("stonesoup.types.state")
    rng = np.random.default_rng(5)
    now = datetime.datetime(2020, 1, 1)
    peer = metrics.GOSPAMetric(c=3.0, p=2.0)
    for _ in range(40):
        sets = [rng.uniform(-4, 4, (rng.integers(0, 6), 2)) for _ in range(2)]
        if not all(map(len, sets)):
            continue
        states = [[state.State(p, timestamp=now) for p in s] for s in sets]
        theirs = peer.compute_gospa_metric(states[1], states[0])
        value = theirs[0].value if isinstance(theirs, tuple) else theirs.value
        ours = gospa(*sets, 3.0)
        assert_allclose(ours.distance, value["distance"])
        assert_allclose(ours.localisation, value["localisation"])


# ------------------------------------------------------------------ contact and warning


def test_rectangles_overlap_by_closed_cases():
    square, unit = np.zeros((4, 3)), np.ones((4, 2))
    other = np.array([[0.99, 0, 0], [1.01, 0, 0], [1.2, 0, np.pi / 4], [1.21, 0, np.pi / 4]])
    assert overlap(square, unit, other, unit).tolist() == [True, False, True, False]


@given(
    arrays(float, (2, 3), elements=st.floats(-3, 3, width=32)),
    arrays(float, (2, 2), elements=st.floats(0.125, 4, width=32)),
)
def test_rectangles_overlap_as_polygons_do(poses, sizes):
    shapely = pytest.importorskip("shapely")
    from outrider.geometry import corners

    a, b = (shapely.Polygon(c) for c in corners(poses, sizes))
    ours = bool(overlap(poses[0], sizes[0], poses[1], sizes[1]))
    if not 0.0 < a.distance(b) < 1e-9 and not 0.0 < a.intersection(b).area < 1e-9:
        assert ours == a.intersects(b)


def test_the_warning_is_counted_from_the_first_alert_about_the_body():
    alerts = [(1.0, 3), (6.0, 8), (7.5, 3), (9.0, 3)]
    assert lead_time(10.0, alerts, [3, 5], horizon_s=6.0) == 2.5
    assert lead_time(10.0, alerts, [3, 5], horizon_s=9.0) == 9.0
    assert lead_time(7.0, alerts, [3], horizon_s=5.0) is None


# ------------------------------------------------------------------ a whole run


def run_of(cars, n=100, scale=1.0):
    with RunWriter("run", Settings(), scale=scale) as run:
        for frame in make_frames(n, cars):
            run.write(frame)
    return "run"


def poses_of(car, scale=1.0, n=1000, name="/truth/car", extent=SIZE):
    for k in range(n):
        t = 0.01 * k
        x, y, yaw = car.pose(t) / [scale, scale, 1.0]
        stamp = round((1000.0 + t) * 1e9)
        turn = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
        yield Pose(name, "map", "", stamp, stamp, np.array([x, y, 0.0]), turn, np.asarray(extent) / scale)


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_a_run_made_of_the_truth_scores_without_error(scale):
    found = evaluate(run_of(STREET, scale=scale), poses_of(STREET[2], scale), until=9.0)
    (car,) = found.targets
    assert car.name == "/truth/car"
    assert (car.score.scans, car.score.present, car.score.ids) == (81, 1.0, (3,))
    assert car.score.position_m.rms < 1e-6
    assert car.score.velocity_mps.rms < 1e-6
    assert car.score.yaw_deg.rms < 1e-6
    assert car.contact_t is None
    assert found.alerts == {"notice": 1, "caution": 1, "danger": 1}
    assert found.scene.scans == 81
    assert found.scene.missed_m2 == 0.0
    others = [
        np.hypot(*(c.pose(t) - STREET[2].pose(t))[:2]) >= 3.5
        for t in DT * np.arange(10, 91)
        for c in STREET[3:]
        if c.born <= t < c.gone and c.state(t) == TrackState.CONFIRMED
    ]
    assert found.scene.false_tracks == pytest.approx(sum(others) / 81)
    assert sum(others) > 100


def test_a_contact_and_the_warning_before_it():
    """Head on at 10 m/s: the centres meet at 7.0 s, the rectangles touch when 2.85 m are left."""
    car = Car(7, (70.0, 0.0, np.pi), 7.0)
    found = evaluate(run_of((car,)), poses_of(car), until=9.0)
    (target,) = found.targets
    assert target.contact_t == pytest.approx(1000.0 + 7.0 - 0.5 * (4.5 + 1.2) / 10.0, abs=DT)
    caution = target.contact_t - target.lead_s
    assert caution == pytest.approx(
        1003.85, abs=0.06
    )  # made frames count to a gap of 2 m between the centres
    assert f"warned {target.lead_s:.2f} s before" in found.table()


def test_a_missing_track_is_missed_and_the_table_says_so():
    car = Car(7, (20.0, 5.0, 0.0), 7.0)
    found = evaluate(run_of(()), poses_of(car), until=5.0)
    assert found.targets[0].score.present == 0.0
    assert found.scene.missed_m2 == pytest.approx(0.5 * 3.5**2)
    assert "present 0.0 %" in found.table()
    out = found.to_dict()
    assert out["targets"]["/truth/car"]["position_rms_m"] is None
    assert out["scene"]["gospa_m"] == pytest.approx(3.5 / np.sqrt(2.0))


def test_the_truth_comes_from_the_recording_that_the_run_names():
    nothing = np.full(4, np.inf, np.float32)
    scan = LaserScan("/scan", "laser", 0, 0, 0.0, 0.1, 0.0, 0.1, 0.1, 40.0, nothing, nothing[:0])
    poses = [*poses_of(STREET[2]), *poses_of(STREET[3], name="/truth/other")]
    ego = poses_of(Car(0, (0.0, 0.0, 0.0), 3.0), name="/ego_pose")
    write_recording("street.mcap", sorted([scan, *ego, *poses], key=lambda m: m.received_ns))
    with RunWriter("run", Settings(), about={"recording": "street.mcap"}) as run:
        for frame in make_frames(80):
            run.write(frame)
    found = evaluate("run", until=7.0)
    assert {t.name: t.score.ids for t in found.targets} == {"/truth/car": (3,), "/truth/other": (4,)}
    assert found.to_dict() == evaluate("run", poses, until=7.0).to_dict()
    assert set(found.truth) == {"/truth/car", "/truth/other"}


def test_bodies_out_of_reach_are_not_asked_for():
    far = Car(7, (90.0, 0.0, 0.0), 7.0)
    assert evaluate(run_of(()), poses_of(far), until=5.0).targets[0].score.scans == 0


def test_the_offset_moves_the_truth_to_the_centre():
    car = STREET[3]
    run = run_of(STREET)
    shift = np.array([0.5, -0.25])
    there = Car(car.id, car.start, car.speed, car.yaw_rate)
    moved = []
    for pose in poses_of(there):
        p = transform(pose.xyyaw, -shift)
        moved.append(Pose(*(getattr(pose, n) for n in ("topic", "frame", "body", "stamp_ns", "received_ns")),
                          np.array([*p, 0.0]), pose.quaternion, pose.extent))  # fmt: skip
    assert evaluate(run, moved, offset=shift.tolist(), until=9.0).targets[0].score.position_m.rms < 1e-3
    assert evaluate(run, moved, until=9.0).targets[0].score.position_m.rms == pytest.approx(
        np.hypot(*shift), rel=0.01
    )


def test_no_truth_or_no_scans_is_one_clear_line():
    run = run_of(STREET, n=20)
    with pytest.raises(InputError, match="no true pose"):
        evaluate(run, [])
    with pytest.raises(InputError, match="does not say what it was made from"):
        evaluate(run)
    with pytest.raises(InputError, match="no scan between 5"):
        evaluate(run, poses_of(STREET[2]), skip=5.0)


def test_velocity_of_recorded_motion_is_that_of_its_published_derivative(data):
    import pyarrow.parquet as pq

    folder = data / "datmo_2dlidar" / "parallel"
    pose = pq.read_table(folder / "mocap_red_pose.parquet", columns=["t", "x", "y", "yaw"])
    t, x, y, yaw = (pose[c].to_numpy() for c in ("t", "x", "y", "yaw"))
    known = pq.read_table(folder / "truth_at_scan.parquet")
    truth = truth_from_poses(t, np.column_stack([x, y, yaw])).at(known["t_mid"].to_numpy())
    theirs = np.column_stack([known["tgt1_vx"].to_numpy(), known["tgt1_vy"].to_numpy()])
    assert np.nanmax(np.abs(truth.W_v - theirs)) < 1e-3
