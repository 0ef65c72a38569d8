"""Observers side by side: the figures are those defined, and every observer gets the same measurements."""

import csv
import dataclasses
import json
import math

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.testing import assert_allclose, assert_array_equal, assert_equal

from outrider import cli, compare, comparison, io, measured, observers, plots_compare, simulate
from outrider.certificate import Bound, Certificate
from outrider.compare import Estimate, Series, judge
from outrider.errors import InputError, OutputError
from outrider.geometry import wrap
from outrider.io._folder import prepare
from outrider.metrics import Truth
from outrider.records import Pose
from outrider.settings import Settings, override

pytestmark = pytest.mark.once

MULTI = observers.get("multi_stage")
DT = 0.1


def straight(n=60, speed=8.0, yaw=0.3):
    """A series that is seen exactly: a body on a straight line, a row every DT."""
    t = 100.0 + DT * np.arange(n)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    p, v = np.outer(speed * (t - t[0]), ahead), np.tile(speed * ahead, (n, 1))
    y = np.zeros((n, 9))
    y[:, :2], y[:, 5] = p, yaw
    y[:, [2, 4]], y[:, 6], y[:, 7:] = 1e-4, 1e-3, (4.5, 1.8)
    return Series("straight", t, y, Truth(t, p, v, np.full(n, yaw)))


def exact(s, spread=None):
    """The truth as an estimate."""
    speed = np.hypot(*s.truth.W_v.T)
    course = np.arctan2(s.truth.W_v[:, 1], s.truth.W_v[:, 0])
    nothing = np.zeros(len(s.t))
    motion = np.column_stack([s.truth.W_p, speed, nothing, course, s.truth.yaw, nothing, nothing])
    return Estimate(motion, np.full((len(s.t), 10), np.nan) if spread is None else spread)


def changed(e, **columns):
    motion = e.motion.copy()
    for name, change in columns.items():
        motion[:, observers.Motion._fields.index(name)] += change
    return dataclasses.replace(e, motion=motion)


# ------------------------------------------------------------------ figures


def test_the_truth_itself_has_no_error():
    s = straight()
    f = judge([exact(s)], [s])
    assert f.samples == 50  # the first second does not count
    assert_allclose(
        [f.position_m, f.speed_mps, f.velocity_mps, f.course_rad, f.yaw_rad, f.J], 0.0, atol=1e-12
    )
    assert (f.divergences, f.heading_flips) == (0, 0)
    assert all(math.isnan(v) for v in (f.nees, f.outside, f.beyond))


def test_each_error_is_what_it_is_defined_to_be():
    s = straight(speed=8.0)
    f = judge([changed(exact(s), x=0.3, y=-0.4, speed=1.0, yaw=-0.2)], [s])
    assert_allclose([f.position_m, f.speed_mps, f.velocity_mps, f.course_rad, f.yaw_rad], [0.5, 1, 1, 0, 0.2])
    assert_allclose(f.J, 1.0 + 5.0 * 0.2)
    f = judge([changed(exact(s), course=0.1)], [s])
    assert_allclose([f.speed_mps, f.velocity_mps, f.course_rad], [0.0, 16.0 * np.sin(0.05), 0.1], atol=1e-12)


def test_reversing_and_driving_forward_are_told_apart_by_speed_and_course():
    """A body that reverses: course axis forward, speed negative, is the same motion as the truth says."""
    s = straight()
    backwards = dataclasses.replace(s, truth=dataclasses.replace(s.truth, yaw=wrap(s.truth.yaw + np.pi)))
    f = judge([changed(exact(backwards), speed=-16.0, course=np.pi)], [backwards])
    assert_allclose([f.speed_mps, f.velocity_mps, f.course_rad, f.yaw_rad], 0.0, atol=1e-12)


def test_course_and_yaw_count_only_where_the_body_moves():
    s = straight(speed=1.0)
    f = judge([changed(exact(s), yaw=2.0, course=2.0)], [s])
    assert math.isnan(f.yaw_rad)
    assert f.heading_flips == 0
    f = judge([changed(exact(s), yaw=2.0)], [s], moving_mps=0.5)
    assert_allclose(f.yaw_rad, 2.0)
    assert f.heading_flips == 50


@pytest.mark.parametrize("rows", [slice(30, 31), slice(30, None), slice(None)])
def test_an_estimate_that_is_lost_is_infinitely_wrong_and_counted(rows):
    s = straight()
    e = exact(s)
    e.motion[rows] = np.nan
    f = judge([e, exact(s)], [s, s])
    assert f.divergences == 1
    assert math.inf == f.J
    assert f.samples == 100


def test_an_estimate_too_far_off_has_diverged():
    s, jump = straight(), np.zeros(60)
    jump[40] = 1.01 * compare.LOST_M
    assert judge([changed(exact(s), x=jump)], [s]).divergences == 1
    assert judge([changed(exact(s), x=0.9 * jump)], [s]).divergences == 0
    assert judge([changed(exact(s), x=np.roll(jump, -35))], [s]).divergences == 0  # within the first second


def test_what_only_a_lag_leaves_open_does_not_count():
    s = straight()
    e = exact(s)
    e.motion[-2:] = np.nan
    assert judge([e], [s]).divergences == 1
    f = judge([dataclasses.replace(e, lag=2)], [s])
    assert (f.divergences, f.samples) == (0, 48)


def test_pooled_figures_are_those_of_all_samples():
    a, b = straight(40), straight(90, speed=5.0)
    ea, eb = changed(exact(a), x=1.0), changed(exact(b), x=2.0)
    f = judge([ea, eb], [a, b])
    assert_allclose(f.position_m**2, (30 * 1.0 + 80 * 4.0) / 110)
    assert judge([], []).samples == 0


def half(P):
    """The ten numbers of observers.Spread of a covariance (4, 4)."""
    rows = {"x": 0, "y": 1, "u": 2, "v": 3}
    return np.array([P[rows[a], rows[b]] for a, b in observers.Spread._fields])


def test_a_consistent_covariance_has_a_nees_of_four():
    rng = np.random.default_rng(5)
    s = straight(20_010)
    root = np.array([[0.2, 0, 0, 0], [0.05, 0.1, 0, 0], [0.3, 0.0, 0.5, 0], [0.0, -0.2, 0.1, 0.4]])
    e = rng.normal(size=(len(s.t), 4)) @ root.T
    spread = np.tile(half(root @ root.T), (len(s.t), 1))
    made = exact(s, spread)
    v = s.truth.W_v + e[:, 2:]
    motion = made.motion.copy()
    motion[:, :2] += e[:, :2]
    motion[:, 2], motion[:, 4] = np.hypot(*v.T), np.arctan2(v[:, 1], v[:, 0])
    f = judge([dataclasses.replace(made, motion=motion)], [s])
    assert_allclose([f.nees, f.outside], [4.0, 0.05], rtol=0.03)
    sure = dataclasses.replace(made, motion=motion, spread=spread / 4.0)
    assert_allclose(judge([sure], [s]).nees, 16.0, rtol=0.03)


def test_a_velocity_without_spread_across_the_course_is_no_fault():
    s = straight(yaw=0.0)
    f = judge([exact(s, np.tile(half(np.diag([0.1, 0.1, 0.1, 0.0])), (60, 1)))], [s])
    assert_allclose([f.nees, f.outside], 0.0, atol=1e-9)


def promised(of, by, gain, speeds=(0.0, np.inf)):
    return compare.Promise((Bound(of, by, gain, False),), speeds)


def test_beyond_a_bound_is_counted_against_the_largest_measurement_error():
    s = straight()
    s.y[20, :2] += [0.3, 0.4]  # half a metre off: the largest
    off = np.zeros(60)
    off[30:40] = 1.1
    e = changed(exact(s), speed=off)

    def beyond(*promise):
        return judge([dataclasses.replace(e, promise=promised(*promise))], [s]).beyond

    assert_allclose(beyond("speed", "position", 2.0), 10 / 50)
    assert beyond("speed", "position", 2.3) == 0.0
    assert_allclose(beyond("speed", "position", 2.0, (5.0, 10.0)), 10 / 50)
    assert math.isnan(beyond("speed", "position", 2.0, (10.0, 20.0)))  # the body drives at 8 m/s
    assert math.isnan(judge([e], [s]).beyond)


def test_bounds_along_and_across_the_course_take_those_parts_of_the_errors():
    s = straight(yaw=0.0)
    s.y[20, :2] += [0.5, 0.1]
    e = changed(exact(s), x=0.6, y=0.3)

    def beyond(of, by, gain):
        return judge([dataclasses.replace(e, promise=promised(of, by, gain))], [s]).beyond

    assert (
        beyond("position along", "position along", 1.1),
        beyond("position along", "position along", 1.3),
    ) == (1, 0)
    assert (
        beyond("position across", "position across", 2.9),
        beyond("position across", "position across", 3.1),
    ) == (1, 0)


class Certified:
    """An observer whose certificate holds for its default gains, P = 1, A = 0."""

    Gains = MULTI.Gains
    sound = True

    def certificate(self):
        bounds = tuple(
            Bound(of, by, 1.0, True, "peak", np.zeros((1, 1, 1)), np.ones((1, 1, 1)), np.ones((1, 1)))
            for of, by in (("position", "position"), ("speed", "jerk"), ("smell", "position"))
        )
        rate = 0.5 if self.sound else 2.0
        return Certificate(
            "made", "sampled", np.zeros((1, 1, 1)), np.eye(1), rate, {"speed [m/s]": (1.0, 20.0)}, (), bounds
        )


def test_a_bound_holds_for_what_is_proven_only():
    one, default = Certified(), MULTI.Gains()
    known = compare.promise(one, default)
    assert [(b.of, b.by) for b in known.bounds] == [("position", "position")]
    assert known.speeds == (1.0, 20.0)
    assert compare.promise(one, default._replace(speed=2.0)) is None
    assert compare.promise(one, default, lag=1) is None
    one.sound = False
    assert compare.promise(one, default) is None


@pytest.mark.parametrize("name", observers.names())
def test_every_observer_follows_a_straight_line(name):
    s = straight(150)
    observer = observers.get(name)
    f = judge([compare.estimate(observer, observer.Gains(), s)], [s], skip_s=5.0)
    assert f.samples == 100
    assert f.velocity_mps < 0.3
    assert f.yaw_rad < 0.05
    assert f.divergences == 0


def test_a_step_takes_time_and_a_lag_more():
    s = straight()
    assert 0.0 < compare.step_time(MULTI, MULTI.Gains(), [s, straight(3)], steps=2000) < 1000.0
    with pytest.raises(InputError, match="no series"):
        compare.step_time(MULTI, MULTI.Gains(), [])


# ------------------------------------------------------------------ which observers


def test_a_variant_is_named_by_observer_gains_and_lag():
    v = observers.variant("multi_stage")
    assert (v.label, v.observer, v.gains, v.lag) == ("multi_stage", MULTI, MULTI.Gains(), 0)
    changes = {"multi_stage": {"speed": 3.0}}
    assert observers.variant(" Multi_Stage ", changes).gains.speed == 3.0
    assert observers.variant("multi_stage:DEFAULT", changes).gains == MULTI.Gains()


@pytest.mark.parametrize("name", observers.names())
def test_every_named_gain_set_and_every_lag_can_be_asked_for(name):
    observer = observers.get(name)
    for chosen, gains in observers.gain_sets(observer).items():
        assert observers.variant(f"{name}:{chosen}").gains == gains
    if hasattr(observer, "smooth"):
        assert observers.variant(f"{name}+lag3").lag == 3
    else:
        with pytest.raises(InputError, match="look back"):
            observers.variant(f"{name}+lag3")
    labels = [v.label for v in observers.variants("all")]
    assert name in labels
    assert (f"{name}+lag2" in labels) == hasattr(observer, "smooth")
    assert len(set(labels)) == len(labels)


def test_all_holds_the_defaults_beside_what_the_settings_state():
    labels = [v.label for v in observers.variants("all", {"multi_stage": {"speed": 3.0}})]
    assert "multi_stage:default" in labels
    assert "multi_stage:default" not in [v.label for v in observers.variants("all")]
    twice = observers.variants("multi_stage, multi_stage:default,multi_stage")
    assert [v.label for v in twice] == ["multi_stage", "multi_stage:default"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("multi_sage", "did you mean multi_stage"),
        ("", "not known"),
        ("multi_stage,", "not known"),
        ("multi_stage:defalt", "did you mean default"),
        ("multi_stage+lag", "want NAME"),
        ("multi_stage+lag-1", "want NAME"),
        ("multi_stage:default:default", "want NAME"),
    ],
)
def test_an_unknown_variant_is_refused(text, said):
    with pytest.raises(InputError, match=said):
        observers.variants(text)


# ------------------------------------------------------------------ measurements


HIDDEN = """
title = "A car comes past; another one drives behind a wall, a third one far away"
duration_s = 6.0
vehicles = [
  { name = "car", x_m = 25.0, y_m = 4.0, yaw_deg = 180.0, speed_mps = 8.0 },
  { name = "hidden", x_m = 25.0, y_m = 20.0, yaw_deg = 180.0, speed_mps = 8.0 },
]
walls = [{ points_m = [[-90.0, 9.0], [90.0, 9.0]] }]
"""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Folder with the recording of a car that passes, and one that is never seen."""
    folder = tmp_path_factory.mktemp("compare")
    (folder / "hidden.toml").write_text(HIDDEN)
    io.write_recording(folder / "rec.mcap", simulate.record(simulate.load(str(folder / "hidden.toml"))))
    return folder


@pytest.fixture(scope="module")
def seen(world):
    return measured.measure(world / "rec.mcap")


def test_the_body_that_is_seen_is_measured_and_the_other_left_out(seen):
    (s,) = seen.series
    assert s.name == "/truth/car"
    assert seen.left_out == ("/truth/hidden",)
    assert (np.diff(s.t) > 0.0).all()
    assert np.isfinite(s.y[[0, -1], 0]).all()
    known = np.isfinite(s.y[:, 0])
    assert known.mean() > 0.8
    assert (np.isfinite(s.y).all(axis=1) | (s.y[:, 6] == np.inf))[known].all()
    assert np.isnan(s.y[~known]).all()
    off = np.hypot(*(s.y[known, :2] - s.truth.W_p[known]).T)
    assert np.median(off) < 0.3


def test_no_heading_that_points_backwards_is_believed(seen):
    """The rider looks along x, so the oncoming car is first taken to point the same way."""
    (s,) = seen.series
    back = np.abs(wrap(s.y[:, 5] - s.truth.yaw)) > 0.5 * np.pi
    assert back.any()
    assert (s.y[back, 6] == np.inf).all()
    assert np.isfinite(s.y[~back, 6]).sum() > 20


def test_measurements_do_not_depend_on_the_observer(world, seen):
    (other,) = [name for name in observers.names() if name != "multi_stage"][:1]
    again = measured.measure(world / "rec.mcap", changes=[f"observer.name={other}"]).series
    assert_array_equal(again[0].y, seen.series[0].y)
    assert_array_equal(again[0].t, seen.series[0].t)


def test_a_scale_model_is_measured_in_full_size_lengths(world, seen):
    """The same world ten times smaller, with recording.scale = 10, gives the same series."""
    small = []
    for m in simulate.record(simulate.load(str(world / "hidden.toml"))):
        if isinstance(m, Pose):
            small.append(dataclasses.replace(m, position=m.position / 10, extent=m.extent / 10))
        else:
            changes = {k: getattr(m, k) / 10 for k in ("ranges", "range_min", "range_max")}
            small.append(dataclasses.replace(m, **changes))
    truth = [m for m in small if isinstance(m, Pose) and m.topic == "/truth/car"]
    (s,) = measured.measure(small, override(Settings(), ["recording.scale=10"]), truth=truth).series
    (full,) = seen.series
    assert_allclose(s.t, full.t, atol=1e-6)
    assert_allclose(s.y, full.y, rtol=1e-3, atol=1e-3)
    assert_allclose(s.truth.W_v, full.truth.W_v, atol=1e-6)


def test_a_body_out_of_sight_for_long_begins_another_series(world, seen):
    messages = list(simulate.record(simulate.load(str(world / "hidden.toml"))))
    scans = [m.stamp_ns for m in messages if not isinstance(m, Pose)]
    middle = scans[len(scans) // 3]
    truth = [m for m in messages if isinstance(m, Pose) and m.topic == "/truth/car"]
    gone = [m for m in messages if isinstance(m, Pose) or not 0 <= m.stamp_ns - middle < 1.5e9]
    first, second = measured.measure(gone, truth=truth).series
    assert (first.name, second.name) == ("/truth/car", "/truth/car (2)")
    assert second.t[0] - first.t[-1] > 1.0


def test_without_truth_there_is_nothing_to_compare(world):
    with pytest.raises(InputError, match="no true pose"):
        measured.measure(world / "rec.mcap", changes=['recording.truth_topics=["none"]'])


def test_where_no_body_was_seen_there_is_nothing_to_compare(world):
    hidden = measured.measure(world / "rec.mcap", changes=['recording.truth_topics=["/truth/hidden"]'])
    assert (hidden.series, hidden.left_out) == ((), ("/truth/hidden",))
    with pytest.raises(InputError, match="none of 1 bodies"):
        comparison.compare([hidden], "multi_stage")


# ------------------------------------------------------------------ tables


@pytest.fixture(scope="module")
def result(seen):
    return comparison.compare([seen, seen], "multi_stage,multi_stage:default")


def test_every_observer_gets_the_same_measurements_and_pooling_changes_nothing(seen, result):
    first, second = result.pooled
    assert_equal(
        dataclasses.astuple(first.figures), dataclasses.astuple(second.figures)
    )  # no gains are stated
    (s,) = seen.series
    alone = judge([compare.estimate(MULTI, MULTI.Gains(), s)], [s])
    for (name, rows), times in zip(result.tables(), (1, 1, 2), strict=True):
        assert name in {"rec.mcap", "all recordings"}
        assert rows[0].figures.samples == times * alone.samples
        assert_allclose(rows[0].figures.J, alone.J)


def test_the_best_of_each_column_is_marked():
    f = judge([exact(straight())], [straight()])
    rows = [
        comparison.Row("a", 0, dataclasses.replace(f, position_m=1.0, nees=3.0, outside=0.2), 2.0),
        comparison.Row("b", 0, dataclasses.replace(f, position_m=2.0, nees=9.0, outside=0.06), 1.0),
        comparison.Row("c", 0, dataclasses.replace(f, position_m=math.inf), 3.0),
        comparison.Row("b+lag2", 2, dataclasses.replace(f, position_m=0.5), 4.0),
    ]
    table = {r[0]: dict(zip(comparison.head(), r, strict=True)) for r in comparison.cells(rows)}
    marked = {name: {k for k, v in row.items() if v.endswith("*")} for name, row in table.items()}
    assert marked["a"] == {"position [m]", "NEES"}
    assert marked["b"] == {"outside [%]", "us a step"}
    assert marked["c"] == marked["b+lag2"] == set()
    assert table["c"]["position [m]"] == "inf"
    assert table["c"]["NEES"] == "-"


def test_files_hold_the_same_figures(result, tmp_path):
    prepare(tmp_path / "out")
    comparison.save(result, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "compare.json").read_text())
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").read_text().splitlines()))
    assert len(rows) == 3 * 2
    for row, said in zip(rows[-2:], told["pooled"], strict=True):
        assert row["observer"] == said["observer"]
        assert float(row["velocity_mps"]) == said["velocity_mps"] == result.pooled[0].figures.velocity_mps
    assert told["recordings"][0]["observers"][0]["gains"]["L_S"] == MULTI.Gains().L_S
    assert told["recordings"][0]["left_out"] == ["/truth/hidden"]
    assert said["nees"] is None
    assert (tmp_path / "out" / "table.md").read_text() == comparison.markdown(result)


def test_a_folder_that_holds_something_is_not_written_into(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="not empty"):
        prepare(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        prepare(tmp_path / "file")
    prepare(tmp_path, force=True)
    assert (tmp_path / "file").read_text() == "x"


# ------------------------------------------------------------------ pictures


def test_pictures_show_the_figures_and_the_truth(result, seen, tmp_path):
    for path in plots_compare.save(result, tmp_path):
        shown = (imread(path)[..., :3].min(axis=-1) < 0.9).mean()
        assert 0.005 < shown < 0.5
    velocity, yaw = plots_compare.errors(result).axes
    assert [tick.get_text() for tick in velocity.get_yticklabels()] == ["multi_stage", "multi_stage:default"]
    assert_allclose(velocity.lines[0].get_xdata(), result.pooled[0].figures.velocity_mps)
    assert_allclose(yaw.lines[0].get_xdata(), np.degrees(result.pooled[0].figures.yaw_rad))
    speed, _, error = plots_compare.series(result).axes
    (s,) = seen.series
    assert_allclose(speed.lines[2].get_ydata(), np.hypot(*s.truth.W_v.T))
    assert np.nanmax(np.abs(error.lines[2].get_ydata())) == 0.0


def test_what_is_lost_is_named_in_the_picture(result):
    lost = dataclasses.replace(result.pooled[0].figures, velocity_mps=math.inf)
    row = dataclasses.replace(result.pooled[0], figures=lost)
    recordings = tuple(dataclasses.replace(c, rows=(row, c.rows[1])) for c in result.recordings)
    changed_result = dataclasses.replace(result, recordings=recordings, pooled=(row, result.pooled[1]))
    velocity, _ = plots_compare.errors(changed_result).axes
    assert "lost" in [text.get_text() for text in velocity.texts]
    assert [t.get_text() for t in velocity.get_yticklabels()] == ["multi_stage:default", "multi_stage"]


def test_pictures_that_cannot_be_written_are_one_line(result):
    with pytest.raises(OutputError, match=r"nowhere/errors\.png: cannot write"):
        plots_compare.save(result, "nowhere")


# ------------------------------------------------------------------ command


def call(capsys, *tokens):
    capsys.readouterr()
    code = cli.run(["compare", *map(str, tokens)])
    return code, *capsys.readouterr()


def test_the_command_prints_writes_and_tells_what_was_left_out(world, tmp_path, capsys):
    code, out, err = call(capsys, world / "rec.mcap", "--observers", "multi_stage", "-o", tmp_path / "out")
    assert (code, err) == (0, "")
    assert "multi_stage" in out
    assert "left out of rec.mcap" in out
    assert "/truth/hidden" in out
    kept = {path.name for path in (tmp_path / "out").iterdir()}
    assert kept == {"compare.json", "table.csv", "table.md", "errors.png", "series.png"}
    code, out, err = call(capsys, world / "rec.mcap", "--observers", "multi_stage", "-o", tmp_path / "out")
    assert code == 2
    assert "--force" in err


def test_the_command_prints_json(world, capsys):
    code, out, _ = call(
        capsys,
        world / "rec.mcap",
        "--observers",
        "multi_stage",
        "--json",
        "--set",
        "observer.gains.multi_stage.noise=0.05",
    )
    told = json.loads(out)
    assert code == 0
    assert told["recordings"][0]["observers"][0]["gains"]["noise"] == 0.05
    assert told["pooled"][0]["samples"] > 20


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--observers", "multi_sage"], "did you mean multi_stage"),
        (["--set", 'recording.truth_topics=["none"]'], "no true pose"),
        (["--set", 'recording.truth_topics=["/truth/hidden"]'], "none of 1 bodies"),
        (["--skip", "-1"], "skip"),
    ],
)
def test_what_cannot_be_compared_is_one_line(world, options, said, capsys):
    code, out, err = call(capsys, world / "rec.mcap", *options)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert said in err


def test_a_recording_of_model_cars(data):
    """The measurements reach the published accuracy of the front end, the observer that of the tracker."""
    seen = measured.measure("dataset:datmo/parallel")
    (s,) = seen.series
    assert_allclose(np.sqrt(np.nanmean((s.y[:, :2] - s.truth.W_p) ** 2 * 2)), 0.13, atol=0.03)
    result = comparison.compare([seen], "multi_stage")
    assert result.pooled[0].figures.velocity_mps < 1.6
    until = measured.measure("dataset:datmo/overtake_ego").series[0]
    assert until.t[-1] - until.t[0] < 8.1  # what the data set says is sound
