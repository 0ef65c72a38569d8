"""One robot over time: looked for, followed, lost and found again; what is said of it is true."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import parquet as pq

from outrider import plots_relocalise, relocalise
from outrider.errors import InputError, OutputError
from outrider.geometry import wrap
from outrider.relocalise import follow, motions, mount, run, simulate
from outrider.relocalise import room as rooms
from outrider.relocalise.follow import AMBIGUOUS, LOST, SEARCHING, STATES, TRACKING
from outrider.relocalise.simulate import Faults

ELLIPSE, EGG = rooms.load("ellipse"), rooms.load("asymmetric")
START = np.array([0.6, -0.4, 1.0])


def drive(room=EGG, motion="spin", seconds=12.0, seed=1, **asked):
    return simulate.simulate(room, motions.get(motion), seconds, seed=seed, **asked)


def when(made, word):
    """Times of the events that say so [s]."""
    return [t for t, what in made.events if word in what]


# ------------------------------------------------------------------ found


@pytest.mark.parametrize("motion", ["spin", "constant"])
def test_it_is_found_from_anywhere(motion):
    made = run.run(drive(motion=motion), EGG)
    state = made.way.state
    assert set(state[:5]) == {SEARCHING}
    first = int(np.flatnonzero(state == TRACKING)[0])
    assert made.log.t[first] < 5.0
    assert (state[first:] == TRACKING).all()
    assert (made.errors()[first + 20 :, 0] < 0.06).all()
    assert made.way.hypotheses[0] > 20
    assert made.way.hypotheses[-1] == 1


def test_what_is_expected_of_the_error_is_about_right():
    """Errors over their standard deviations, over runs: neither boast nor alarm."""
    ratio = []
    for seed in range(3):
        made = run.run(drive(ELLIPSE, "constant", seed=seed, start=START), ELLIPSE, START)
        off = made.way.pose - made.log.truth
        ratio.append((off[60:, :2] / made.way.sigma[60:, :2]).ravel())
    size = np.sqrt(np.mean(np.concatenate(ratio) ** 2))
    assert 0.3 < size < 2.0


def test_in_an_ellipse_both_poses_are_told_for_ever():
    made = run.run(drive(ELLIPSE), ELLIPSE)
    assert made.way.state[-1] == AMBIGUOUS
    assert TRACKING not in made.way.state
    assert len(made.others[-1]) == 2
    one, other = made.others[-1][:, :3]
    np.testing.assert_allclose(other[:2], -one[:2], atol=1e-9)
    assert abs(wrap(other[2] - one[2] - np.pi)) < 1e-9
    assert made.errors()[-1, 0] < 0.03
    assert any("the same from 2 poses" in text for text in made.doubts)


def test_a_start_settles_which():
    log = drive(ELLIPSE, start=START)
    made = run.run(log, ELLIPSE, START + np.array([0.2, -0.2, 0.1]))
    assert (made.way.state == TRACKING).all()
    assert (made.way.hypotheses == 1).all()
    assert made.errors()[-1, 0] < 0.03
    assert made.doubts == made.events == ()


def test_a_start_that_is_all_wrong_is_found_out():
    log = drive(EGG, start=START)
    made = run.run(log, EGG, np.array([-1.5, 1.2, -2.0]))
    assert made.way.state[0] == TRACKING
    assert len(when(made, "lost")) == 1
    assert made.errors()[-1, 0] < 0.03


def test_a_robot_that_stands_still_is_not_found():
    """Two ranges leave a curve of poses, and say so."""
    log = drive(EGG, seconds=5.0)
    still = replace(log, w=0.0 * log.w, ranges=np.tile(log.ranges[0], (len(log.t), 1)))
    made = run.run(still, EGG)
    assert (made.way.state == SEARCHING).all()
    assert made.way.hypotheses[-1] > 5
    assert made.way.sigma[-1, 0] > 0.3
    assert made.seen.word == "unobservable"
    assert "stands still" in made.seen.reason


# ------------------------------------------------------------------ lost, and found again


@pytest.mark.parametrize("observer", ["pose_ekf", "wall_range"])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_kidnapped_robot_is_missed_and_found_again(observer, seed):
    log = drive(seconds=14.0, seed=seed, faults=Faults(kidnapped=(6.0,)))
    made = run.run(log, EGG, log.truth[0], observer)
    (missed,) = when(made, "lost")
    assert 6.0 < missed < 7.5
    (found,) = when(made, "found")
    assert missed < found < missed + 5.0
    between = made.way.state[(log.t >= missed) & (log.t < found)]
    assert (between == LOST).all()
    assert made.way.state[-1] == TRACKING
    assert made.errors()[-1, 0] < (0.03 if observer == "pose_ekf" else 0.4)


@pytest.mark.parametrize("seed", [1, 2])
def test_what_stands_in_the_way_now_and_then_is_no_kidnapping(seed):
    log = drive(seconds=15.0, seed=seed, start=START, faults=Faults(lost=0.1, short=0.12))
    sure = {"start_position": 0.05, "start_heading": 0.05, "start_doubt": 0.0}  # unlike a guess
    made = run.run(log, EGG, START, gains=sure)
    assert made.events == ()
    assert (made.way.state == TRACKING).all()
    assert (made.errors()[50:, 0] < 0.1).all()


def test_it_is_found_though_something_is_in_the_way_now_and_then():
    for seed in range(2):
        log = drive(seconds=12.0, seed=seed, faults=Faults(lost=0.1, short=0.1))
        made = run.run(log, EGG._replace(strays=0.1))
        assert made.way.state[-1] == TRACKING
        assert made.errors()[-1, 0] < 0.05


def test_something_before_one_sensor_is_no_kidnapping():
    """For six seconds, one sensor sees only what stands before it; the other still says the truth."""
    log = drive(seconds=15.0, start=START)
    ranges = log.ranges.copy()
    ranges[40:100, 0] = 0.4
    made = run.run(replace(log, ranges=ranges), EGG, START)
    assert made.events == ()
    assert made.errors()[-1, 0] < 0.03


def test_a_robot_without_ranges_goes_on_by_odometry():
    log = drive(motion="constant", seconds=12.0, start=START)
    ranges = log.ranges.copy()
    ranges[50:100] = np.nan
    made = run.run(replace(log, ranges=ranges), EGG, START)
    assert (made.way.state == TRACKING).all()
    sigma = made.way.sigma[:, 0]
    assert sigma[99] > 2.0 * sigma[49]
    assert np.isnan(made.way.distance[50:100]).all()
    assert made.errors()[-1, 0] < 0.05


@pytest.mark.parametrize("what", ["rows", "odometry"])
def test_after_a_long_gap_it_is_looked_for_anew(what):
    log = drive(seconds=18.0, start=START)
    gap = (log.t > 6.0) & (log.t < 9.5)
    if what == "rows":
        kept = {name: values[~gap] for name, values in log.columns().items()}
        log = run_log(kept)
    else:
        log = replace(log, v=np.where(gap, np.nan, log.v))
    made = run.run(log, EGG, START)
    assert len(when(made, f"without {'a row' if what == 'rows' else 'odometry'}")) == 1
    assert LOST in made.way.state
    assert made.way.state[-1] == TRACKING
    assert made.errors()[-1, 0] < 0.03


def run_log(columns):
    from outrider.relocalise import log as logs

    return logs.checked(columns)


def test_a_short_gap_in_odometry_is_bridged():
    log = drive(seconds=10.0, start=START)
    w = log.w.copy()
    w[50:58] = np.nan
    made = run.run(replace(log, w=w), EGG, START)
    assert made.events == ()
    assert made.errors()[-1, 0] < 0.03


# ------------------------------------------------------------------ sensors


def test_sensors_off_the_axle():
    """Truth, start and estimate are of the robot's own point; the sensors are 20 cm from it."""
    room = EGG._replace(mount=np.array([0.2, 0.1]))
    log = drive(room, "constant", seconds=8.0, start=START)
    for start in (None, START):
        made = run.run(log, room, start)
        assert made.errors()[-1, 0] < 0.04
    wrong = run.run(log, EGG, START)
    assert np.nanmax(wrong.errors()[30:, 0]) > 2.0 * np.nanmax(made.errors()[30:, 0])


def test_sensors_that_turn():
    log = drive(EGG, start=START, noise=0.0)
    angles = EGG.angles + 0.4 * np.sin(log.t)[:, None] * [1.0, -0.7]
    at = mount.sensors(log.truth, EGG.mount)
    ranges = EGG.wall.ray(at[:, None, :2], at[:, 2:] + angles).range
    made = run.run(replace(log, ranges=ranges, angles=angles), EGG)
    assert made.way.state[-1] == TRACKING
    assert made.errors()[-1, 0] < 0.02


def test_ranges_out_of_reach_are_not_used_and_counted():
    room = EGG._replace(range_min=0.5, range_max=3.5)
    log = drive(room, "constant", start=START)
    bad = log.ranges.copy()
    bad[20:30, 0], bad[50:55, 1] = 9.0, 0.2
    blind = np.where((bad > 3.5) | (bad <= 0.5), np.nan, bad)
    a, b = run.run(replace(log, ranges=bad), room, START), run.run(replace(log, ranges=blind), room, START)
    np.testing.assert_array_equal(a.way.pose, b.way.pose)
    assert a.summary()["out_of_reach"] == [10, 5]
    assert b.summary()["out_of_reach"] == [0, 0]


def test_a_row_that_is_not_later_changes_nothing():
    log = drive(seconds=6.0, start=START)
    twice = {name: np.repeat(values, 2, axis=0) for name, values in log.columns().items()}
    a, b = run.run(log, EGG, START), run.run(run_log(twice), EGG, START)
    assert np.abs(a.way.pose - b.way.pose[1::2]).max() < 0.05
    assert b.errors()[-1, 0] < 0.03


# ------------------------------------------------------------------ the observers


@pytest.mark.parametrize("observer", ["pose_ekf", "wall_range"])
def test_every_observer_follows(observer):
    log = drive(ELLIPSE, "constant", start=START)
    made = run.run(log, ELLIPSE, START + np.array([0.1, 0.1, 0.1]), observer)
    assert np.isfinite(made.way.pose).all()
    assert made.errors()[-40:, 0].max() < 0.15
    has = hasattr(relocalise.get(observer), "covariance")
    assert np.isfinite(made.way.sigma).all() == has


def test_gains_are_taken_over():
    log = drive(ELLIPSE, seconds=4.0, start=START)
    wall_range = relocalise.get("wall_range")
    v, w = (np.sqrt(np.mean(u**2)) for u in (log.v, log.w))
    for given in ({}, {"ks": 2.7}, {"kappa": 2.0}):
        made = run.run(log, ELLIPSE, START, "wall_range", given)
        by_rule = wall_range.rule(ELLIPSE, 0.1, v, w, normalised="kappa" in given)
        np.testing.assert_allclose(made.gains, by_rule._replace(**given))
    assert run.run(log, ELLIPSE, START, "pose_ekf", {"gate": 4.0}).gains.gate == 4.0


# ------------------------------------------------------------------ refused


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"start": [9.0, 0.0, 0.0]}, "not inside the wall"),
        ({"start": [0.0, 0.0, np.nan]}, "not inside the wall"),
        ({"start": [0.0, 0.0]}, "three numbers"),
        ({"observer": "pose_efk"}, "did you mean pose_ekf"),
        ({"gains": {"gait": 3.0}}, "gate"),
        ({"gains": {"gate": np.nan}}, "finite"),
        ({"room": rooms.load("circle")}, "circle"),
    ],
)
def test_what_is_refused(asked, words):
    log = drive(ELLIPSE, seconds=2.0)
    room = asked.pop("room", ELLIPSE)
    with pytest.raises(InputError, match=words):
        run.run(log, room, **asked)


def test_in_a_circle_a_start_is_followed_and_the_limit_told():
    circle = rooms.load("circle")
    log = drive(circle, "constant", start=START)
    kept = (log.t < 5.0) | (log.t > 7.5)  # a gap: there is nothing to look for
    log = run_log({name: values[kept] for name, values in log.columns().items()})
    made = run.run(log, circle, START)
    assert any("circle" in text for text in made.doubts)
    assert (made.way.state == TRACKING).all()
    assert made.seen.word == "unobservable"
    assert made.errors()[-1, 0] < 0.3  # odometry alone tells where round the centre


# ------------------------------------------------------------------ kept


@pytest.fixture(scope="module")
def kidnapped():
    return run.run(drive(ELLIPSE, seconds=10.0, seed=5, faults=Faults(kidnapped=(6.0,))), ELLIPSE)


def test_a_run_is_kept_whole(kidnapped, tmp_path):
    folder = tmp_path / "run"
    run.save(kidnapped, folder, about={"log": "drive.csv"})
    table = pq.read_table(folder / "estimate.parquet").to_pydict()
    assert list(table) == [
        *("t", "x", "y", "theta", "sigma_x", "sigma_y", "sigma_theta"),
        *("state", "hypotheses", "innovation", "observability"),
    ]
    np.testing.assert_array_equal(table["x"], kidnapped.way.pose[:, 0])
    assert table["state"] == [STATES[i] for i in kidnapped.way.state]
    rows = pq.read_table(folder / "hypotheses.parquet").to_pydict()
    first = np.array(rows["t"]) == table["t"][0]
    assert first.sum() == table["hypotheses"][0]
    np.testing.assert_array_equal(np.array(rows["theta"])[first], kidnapped.others[0][:, 2])
    again = rooms.load(folder / "room.toml")
    assert again.wall == ELLIPSE.wall
    kept = tomllib.loads((folder / "settings.toml").read_text())
    assert (kept["observer"], kept["anywhere"], kept["log"]) == ("pose_ekf", True, "drive.csv")
    assert kept["gains"]["gate"] == kidnapped.gains.gate
    told = json.loads((folder / "summary.json").read_text())
    assert sum(told["states"].values()) == told["rows"] == 101
    assert told["symmetry"] == 2
    assert told["log_sha256"] == kidnapped.log.fingerprint()
    assert [e["what"] for e in told["events"]] == [what for _, what in kidnapped.events]
    known = np.isin(kidnapped.way.state, [TRACKING, AMBIGUOUS])
    error = kidnapped.errors()[known, 0]
    assert told["error"]["rmse_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    with pytest.raises(InputError, match="--force"):
        run.save(kidnapped, folder)


def test_a_start_is_kept(tmp_path):
    log = drive(seconds=2.0, start=START)
    run.save(run.run(log, EGG, START), tmp_path / "run")
    assert tomllib.loads((tmp_path / "run" / "settings.toml").read_text())["start"] == START.tolist()


def test_a_log_without_truth_has_no_error():
    made = run.run(replace(drive(seconds=4.0), truth=None), EGG)
    assert made.summary()["error"] is None
    assert np.isnan(made.errors()).all()


# ------------------------------------------------------------------ pictures


def test_the_pictures_show_what_there_is(kidnapped, tmp_path):
    paths = plots_relocalise.save(kidnapped, tmp_path)
    assert [path.name for path in paths] == ["room.png", "errors.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    figure = plots_relocalise.over_time(kidnapped)
    top = figure.axes[0]
    lines = {line.get_label(): line.get_ydata() for line in top.lines}
    np.testing.assert_array_equal(lines["error"], np.maximum(kidnapped.errors()[:, 0], 1e-12))
    bands = len([p for p in top.patches if p.get_zorder() == 0])
    assert bands == 1 + np.count_nonzero(np.diff(kidnapped.way.state))
    scene = plots_relocalise.scene(kidnapped)
    ends = [np.array(line.get_xydata())[-1] for line in scene.axes[0].lines if line.get_markevery() == [1]]
    assert len(ends) == 4  # two rays of the truth, two of the estimate
    true = ends[:2]
    for end in true:  # the noise of a range is 1 cm
        assert abs(np.hypot(end[0] / 4.0, end[1] / 2.5) - 1.0) < 0.02


def test_pictures_of_a_log_without_truth_or_estimate(tmp_path):
    log = replace(drive(seconds=3.0), truth=None)
    blind = replace(log, ranges=np.full_like(log.ranges, np.nan))
    assert len(plots_relocalise.over_time(run.run(log, EGG)).axes[0].lines) == 1
    made = run.run(blind, EGG)
    assert np.isnan(made.way.pose).all()
    assert plots_relocalise.save(made, tmp_path)
    with pytest.raises(OutputError):
        plots_relocalise.save(made, tmp_path / "absent")


def test_a_basin_counts_what_it_draws():
    rng = np.random.default_rng(0)
    guesses = START + rng.uniform(-1.0, 1.0, (90, 3)) * [0.5, 0.5, 3.1]
    outcome = rng.integers(0, 3, 90)
    figure = plots_relocalise.basin(EGG, START, guesses, outcome, "made")
    turn = np.abs(wrap(guesses[:, 2] - START[2]))
    shares = [ax.get_title().split(": ")[1] for ax in figure.axes]
    for share, low, high in zip(shares, (0, 60, 120), (60, 120, 181), strict=True):
        within = (turn >= np.deg2rad(low)) & (turn < np.deg2rad(high))
        assert share == f"{100 * np.mean(outcome[within] > 0):.0f} %"


def test_the_follower_is_the_run_row_by_row():
    log = drive(seconds=5.0)
    observer = relocalise.get("pose_ekf")
    follower = follow.Follower(EGG, observer, observer.Gains())
    made = run.run(log, EGG)
    for k, reading in enumerate(run.readings(log, EGG)):
        np.testing.assert_array_equal(follower.step(reading).pose, made.way.pose[k])
