"""From scans to alerts: who is warned of and when, what a step tolerates, and what a run says of itself."""

import dataclasses
import itertools
import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import outrider
from made_scans import raw_scan
from outrider import datasets, io, offline, pipeline, simulate
from outrider.cli.demo import collision_courses, warned
from outrider.errors import InputError
from outrider.io.run import open_run
from outrider.records import LaserScan, Level, Pose
from outrider.scan import ScanStream
from outrider.settings import Settings, dump, fingerprint
from outrider.settings import Timing as TimingSettings

SETTINGS = Settings()
ENGINE = pipeline.engine(SETTINGS)
WORLD = simulate.load("demo")


@pytest.fixture(scope="module")
def messages():
    return list(simulate.record(WORLD))


@pytest.fixture(scope="module")
def run(messages, tmp_path_factory):
    """The run folder of the demo scenario, without pictures."""
    folder = tmp_path_factory.mktemp("demo")
    io.write_recording(folder / "demo.mcap", messages)
    return offline.run(folder / "demo.mcap", folder / "run", pictures=False)


def steps(scans, memory=None):
    """The frames of some scans, one after the other."""
    memory = memory or pipeline.start(SETTINGS)
    for scan in scans:
        memory, frame = pipeline.step(memory, scan, SETTINGS, ENGINE)
        yield frame


def prepared(raws, ego=None):
    return list(ScanStream(raws, raws[0].topic, ego, SETTINGS))


# ------------------------------------------------------------------ the demo scenario


def test_every_collision_course_of_the_demo_is_warned_two_seconds_before(run):
    courses, _ = warned(run, WORLD)
    assert {c.body for c in courses} == {v.name for v in WORLD.vehicles if v.collision_course}
    leads = {c.body: c.lead_s for c in courses}
    assert all(lead is not None and lead >= 2.0 for lead in leads.values()), leads


def test_no_danger_is_told_of_parked_or_parallel_traffic(run):
    assert warned(run, WORLD)[1] == []


def test_the_courses_of_the_demo_are_those_of_closed_form():
    """A car at 6 m/s that starts y away meets the rider's near side after (|y| - halves) / 6 s."""
    due = collision_courses(WORLD)
    by_name = {v.name: v for v in WORLD.vehicles}
    half = 0.5 * WORLD.rider.width_m
    for name, (t, real) in due.items():
        v = by_name[name]
        assert t == pytest.approx((abs(v.y_m) - 0.5 * v.length_m - half) / v.speed_mps, abs=0.02)
        assert real == (name == "runs_light")


@pytest.mark.parametrize("seed", [1, 2])
def test_the_warnings_do_not_hang_on_the_noise(seed, tmp_path):
    recording = tmp_path / "demo.mcap"
    io.write_recording(recording, simulate.record(WORLD, seed))
    courses, harmless = warned(offline.run(recording, tmp_path / "run", pictures=False), WORLD)
    assert min(c.lead_s or 0.0 for c in courses) >= 2.0
    assert harmless == []


# ------------------------------------------------------------------ one step


def test_a_step_is_pure(messages):
    scans = prepared([m for m in messages if isinstance(m, LaserScan)][:40])
    memory = pipeline.start(SETTINGS)
    for scan in scans[:-1]:
        memory, _ = pipeline.step(memory, scan, SETTINGS, ENGINE)
    one, two = (pipeline.step(memory, scans[-1], SETTINGS, ENGINE)[1] for _ in range(2))
    for name in ("W_p", "speed", "course", "extent", "cov"):
        assert np.array_equal(getattr(one.tracks, name), getattr(two.tracks, name))
    assert one.alert == two.alert


def test_a_scan_without_beams_is_taken():
    scans = prepared([raw_scan([], 1_700_000_000.0 + 0.1 * k) for k in range(5)])
    frames = list(steps(scans))
    assert len(frames) == 5
    assert all(len(f.detections.hits) == len(f.tracks.id) == 0 for f in frames)
    assert all(f.alert.degraded and f.alert.level == Level.NONE for f in frames)


def test_scans_without_beams_among_others_are_taken(messages):
    """Tracks are there before and after; sizes are learnt, so every step of the tracker has work to do."""
    raws = [m for m in messages if isinstance(m, LaserScan)][:60]
    none = np.zeros(0, np.float32)
    raws = [dataclasses.replace(m, ranges=none) if i % 7 == 6 else m for i, m in enumerate(raws)]
    frames = list(steps(prepared(raws)))
    assert len(frames) == 60
    assert max(len(f.tracks.id) for f in frames) > 5


@given(
    st.lists(
        hnp.arrays(
            np.float32,
            st.integers(0, 60),
            elements=st.one_of(
                st.floats(-1.0, 50.0, width=32), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 3e38])
            ),
        ),
        min_size=1,
        max_size=8,
    ),
    st.sampled_from([0.1, 0.0, -0.1, 2.0]),
)
@settings(max_examples=60)
def test_no_ranges_stop_the_pipeline(rows, step):
    raws = [raw_scan(row, 1_700_000_000.0 + step * k) for k, row in enumerate(rows)]
    for frame in steps(prepared(raws)):
        assert len(frame.tracks.id) == len(frame.threats.id)
        assert np.isfinite(frame.tracks.W_p).all()


def test_the_number_of_beams_may_change_from_scan_to_scan(messages):
    raws = [m for m in messages if isinstance(m, LaserScan)][:30]
    raws = [
        dataclasses.replace(m, ranges=m.ranges[::2], angle_increment=2 * m.angle_increment) if i % 2 else m
        for i, m in enumerate(raws)
    ]
    assert len(list(steps(prepared(raws)))) == 30


def test_a_clock_that_jumps_back_starts_anew_and_uses_no_identity_twice(messages):
    raws = [m for m in messages if isinstance(m, LaserScan)][:30]
    hour = 3_600_000_000_000
    again = [dataclasses.replace(m, stamp_ns=m.stamp_ns - hour) for m in raws]
    frames = list(steps(prepared(raws + again)))
    before, after = frames[29], frames[30]
    assert after.t < before.t
    assert any("clock jumped back" in reason for reason in after.alert.degraded)
    assert not set(before.tracks.id) & set(after.tracks.id)
    assert min(i for f in frames[30:] for i in f.tracks.id) > max(i for f in frames[:30] for i in f.tracks.id)


# ------------------------------------------------------------------ from a source to frames


def test_a_file_a_recording_and_messages_give_the_same(messages, tmp_path):
    io.write_recording(tmp_path / "a.mcap", messages)
    sources = (tmp_path / "a.mcap", outrider.read(tmp_path / "a.mcap"), messages, iter(messages))
    last = [next(itertools.islice(offline.track(source), 50, None)) for source in sources]
    for frame in last[1:]:
        assert np.array_equal(frame.tracks.id, last[0].tracks.id)
        assert np.array_equal(frame.tracks.W_p, last[0].tracks.W_p)


def test_frames_are_full_size_and_the_folder_is_not(messages, tmp_path):
    """A recording ten times smaller, tracked at scale 10, is the full-size one; its folder is small again."""
    n = 25

    def small(m):
        if isinstance(m, Pose):
            return dataclasses.replace(m, position=m.position / 10.0, extent=m.extent / 10.0)
        limits = {"range_min": m.range_min / 10.0, "range_max": m.range_max / 10.0}
        return dataclasses.replace(m, ranges=(m.ranges / 10.0).astype(np.float32), **limits)

    shrunk = [small(m) for m in messages]
    want = next(itertools.islice(offline.track(messages), n, None))
    got = next(itertools.islice(offline.track(shrunk, changes=["recording.scale=10"]), n, None))
    assert len(got.tracks.id) == len(want.tracks.id)
    assert np.allclose(got.tracks.W_p, want.tracks.W_p, atol=0.05)
    until = [m for m in shrunk if m.received_ns <= simulate.EPOCH_NS + (n + 1) * 100_000_000]
    folder = offline.run(until, tmp_path / "run", changes=["recording.scale=10"], pictures=False)
    length = folder.tracks["length"].to_numpy()
    assert 0.3 < np.median(length) < 0.6


def test_the_order_of_the_beams_is_found_before_tracking():
    """Header times a thousandth of the true ones and beams stored against time, as some real drivers do."""
    world = simulate.load("turning")
    wrong = {"time_scale": 1e-3, "reverse": True}
    opened = offline.open_source(simulate.record(world, faults=wrong))
    if opened.estimate is None or not opened.estimate.confident:
        assert opened.estimate is None or "not found" in opened.estimate.words
    else:
        assert opened.estimate.time_increment < 0.0
    assert len(list(itertools.islice(opened.frames(), 5))) == 5
    assert opened.stream.report.repairs


def test_what_the_survey_has_read_is_tracked_too():
    """A one-shot source whose head is surveyed loses no scan."""
    world = simulate.load("constant")
    messages = list(simulate.record(world, faults={"time_scale": 1e-3}))
    scans = sum(isinstance(m, LaserScan) for m in messages)
    assert len(list(offline.track(iter(messages)))) == scans


# ------------------------------------------------------------------ settings


def test_settings_lie_in_layers(tmp_path):
    recommended = {"recording": {"scale": 10.0}, "rider": {"length_m": 4.2}, "detect": {"min_hits": 4}}
    file = tmp_path / "mine.toml"
    file.write_text("[recording]\nscale = 1.0\n[detect]\nmax_range_m = 30.0\n")
    settled = offline.settle(recommended, file, ["detect.max_range_m=25.0"])
    assert settled.recording.scale == 1.0  # stated, though it is the default
    assert settled.rider.length_m == 4.2
    assert settled.detect.min_hits == 4
    assert settled.detect.max_range_m == 25.0


def test_settings_that_differ_from_the_defaults_win_over_the_recommended():
    own = Settings(timing=TimingSettings(scan_time_s=0.2))
    settled = offline.settle({"timing": {"scan_time_s": 0.1, "time_increment_s": 1e-4}}, own)
    assert settled.timing == TimingSettings(scan_time_s=0.2, time_increment_s=1e-4)


@pytest.mark.parametrize("name", datasets.names())
def test_what_is_recommended_for_a_data_set_is_valid(name):
    recommended = datasets.entry(name).settings
    settled = offline.settle(recommended, None)
    for section, values in recommended.items():
        for key, value in values.items():
            assert getattr(getattr(settled, section), key) == value


def test_a_wrong_setting_is_told_before_anything_is_written(messages, tmp_path):
    with pytest.raises(InputError, match="observer 'nobody'"):
        offline.run(messages, tmp_path / "run", changes=["observer.name=nobody"])
    assert not (tmp_path / "run").exists()


# ------------------------------------------------------------------ the run


def test_the_summary_accounts_for_everything(run, messages):
    s = run.summary
    scans = [m for m in messages if isinstance(m, LaserScan)]
    assert s["finished"]
    assert not s["interrupted"]
    assert s["scans"] == s["repairs"]["scans_out"] == len(scans)
    assert s["repairs"]["beams"] == sum(len(m.ranges) for m in scans)
    assert sum(s["repairs"]["masked"].values()) + s["repairs"]["valid"] == s["repairs"]["beams"]
    assert s["topics"]["scan"] == "/scan"
    assert s["topics"]["ego"] == "/ego_pose"
    assert len(s["topics"]["truth"]) == 13
    assert s["settings_sha256"] == fingerprint(run.settings)
    assert s["duration_s"] == pytest.approx(s["t_last"] - s["t_first"])
    assert sum(s["seconds_at_level"].values()) == pytest.approx(s["duration_s"])
    assert s["alerts"]["danger"] == sum(a["level"] == "danger" for a in run.alerts)
    assert 0.0 < s["speed"]["median_ms"] <= s["speed"]["p95_ms"]


def test_the_fingerprint_of_settings_tells_them_apart():
    other = offline.settle({}, None, ["detect.min_hits=4"])
    assert fingerprint(other) != fingerprint(SETTINGS)
    assert fingerprint(SETTINGS) == fingerprint(offline.settle({}, SETTINGS))
    assert dump(SETTINGS) == dump(offline.settle({}, None))


def test_an_interrupted_run_is_a_valid_one(messages, tmp_path):
    seen = []

    def stop(frame):
        seen.append(frame.t)
        if len(seen) == 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        offline.run(messages, tmp_path / "run", watch=stop)
    run = open_run(tmp_path / "run")
    assert run.summary["interrupted"]
    assert run.summary["scans"] == 30
    assert run.summary["repairs"]["scans_out"] >= 30
    assert set(run.scans["t"].to_pylist()) == set(seen)


def test_a_recording_damaged_on_the_way_leaves_what_came_before(messages, tmp_path):
    def broken():
        for i, message in enumerate(messages):
            if i == 4000:
                raise InputError("rec.bag: damaged after 4000 messages")
            yield message

    with pytest.raises(InputError, match="damaged"):
        offline.run(broken(), tmp_path / "run")
    run = open_run(tmp_path / "run")
    assert run.summary["interrupted"]
    assert "damaged" in run.summary["error"]
    assert run.summary["scans"] > 10


def test_the_public_names_work_alone_and_the_package_imports_no_library_before():
    """Each name as a stranger would use it, in an interpreter of its own."""
    code = (
        "import sys, json, outrider; heavy = {'numpy', 'numba', 'scipy', 'pyarrow', 'matplotlib', 'rosbags'};"
        "early = sorted(heavy & set(sys.modules));"
        "kinds = {n: callable(getattr(outrider, n)) for n in outrider.__all__ if n[0] != '_'};"
        "print(json.dumps([early, kinds]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    early, kinds = json.loads(done.stdout)
    assert early == []
    assert all(kinds.values()), kinds
