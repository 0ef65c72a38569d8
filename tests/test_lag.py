"""Tracks of some scans ago, smoothed: what they promise, and that they are better than those of then."""

import dataclasses

import numpy as np
import pytest

import outrider
from made_worlds import prepared
from outrider import offline, pipeline, simulate
from outrider.errors import InputError
from outrider.evaluate import evaluate
from outrider.io import write_recording
from outrider.records import TrackState
from outrider.settings import Observer, Settings

LAG = 2
SETTINGS = Settings(observer=Observer(name=f"ekf+lag{LAG}"))
WORLD = simulate.load("oncoming_left_turn")


@pytest.fixture(scope="module")
def frames():
    engine, memory, frames = pipeline.engine(SETTINGS), pipeline.start(SETTINGS), []
    for scan in prepared(simulate.record(WORLD)):
        memory, frame = pipeline.step(memory, scan, SETTINGS, engine)
        frames.append(frame)
    return frames


def columns(tracks):
    return {f.name: getattr(tracks, f.name) for f in dataclasses.fields(tracks)}


def test_each_frame_tells_the_scan_two_scans_ago_once_more(frames):
    assert all(frame.lagged is None for frame in frames[:LAG])
    for then, now in zip(frames[:-LAG], frames[LAG:], strict=True):
        assert now.lagged.t == then.t
        for name in ("id", "extent", "hits", "age"):
            np.testing.assert_array_equal(getattr(now.lagged, name), getattr(then.tracks, name))
        moves = np.isin(then.tracks.id, now.tracks.id[now.tracks.state == TrackState.CONFIRMED])
        np.testing.assert_array_equal(now.lagged.state[~moves], then.tracks.state[~moves])
        still = now.lagged.state == TrackState.STATIC
        np.testing.assert_array_equal(now.lagged.W_p[still], then.tracks.W_p[still])


def test_what_moves_now_moved_before_it_was_told(frames):
    """A body that drove into view is known as moving LAG scans sooner, at a speed near the truth."""
    told = {i for f in frames for i in f.tracks.id[f.tracks.state == TrackState.CONFIRMED].tolist()}
    assert told
    for track in told:
        first = next(
            k for k, f in enumerate(frames) if track in f.tracks.id[f.tracks.state == TrackState.CONFIRMED]
        )
        lagged = frames[first].lagged
        i = np.flatnonzero(lagged.id == track)
        if len(i):
            assert lagged.state[i] == TrackState.CONFIRMED
            assert lagged.speed[i] > 0.5 * frames[first].tracks.speed[frames[first].tracks.id == track]


def test_looking_back_is_nearer_to_the_truth(frames):
    """Velocity errors of all moving tracks near a body, pooled; the present against the same scan later."""
    t = np.array([f.t for f in frames]) - simulate.EPOCH_NS * 1e-9
    truth = simulate.truth_at(WORLD, t)
    errors = {"now": [], "later": []}
    for k, (then, now) in enumerate(zip(frames[:-LAG], frames[LAG:], strict=True)):
        for motion in truth.values():
            off = np.hypot(*(then.tracks.W_p - [motion.x[k], motion.y[k]]).T)
            i = int(off.argmin()) if len(off) else -1
            if i < 0 or off[i] > 2.0 or then.tracks.state[i] != TrackState.CONFIRMED:
                continue
            chi = motion.yaw[k] + motion.slip[k]
            v = motion.speed[k] * np.array([np.cos(chi), np.sin(chi)])
            errors["now"].append(then.tracks.W_v[i] - v)
            errors["later"].append(now.lagged.W_v[i] - v)
    rms = {name: np.sqrt(np.mean(np.square(e))) for name, e in errors.items()}
    assert len(errors["now"]) > 30
    assert rms["later"] < 0.85 * rms["now"], rms


def test_looking_back_leaves_the_present_as_it_is(frames):
    plain = Settings(observer=Observer(name="ekf"))
    engine, memory = pipeline.engine(plain), pipeline.start(plain)
    for scan, frame in zip(prepared(simulate.record(WORLD)), frames, strict=True):
        memory, same = pipeline.step(memory, scan, plain, engine)
        assert same.lagged is None
        for name, column in columns(same.tracks).items():
            np.testing.assert_array_equal(column, getattr(frame.tracks, name), err_msg=name)


def test_angles_stay_in_their_range_and_nothing_is_unmarked(frames):
    for frame in frames[LAG:]:
        for name, column in columns(frame.lagged).items():
            assert np.isfinite(column).all() or name == "bound"  # nothing is assumed
        assert (np.abs([frame.lagged.course, frame.lagged.yaw]) <= np.pi).all()


def test_a_run_keeps_both_and_both_can_be_scored(tmp_path):
    write_recording(tmp_path / "world.mcap", simulate.record(WORLD))
    run = offline.run(tmp_path / "world.mcap", tmp_path / "run", SETTINGS, pictures=False)
    assert run.lagged.column_names == [n for n in run.tracks.column_names if not n.startswith("ttc")]
    assert run.lagged.num_rows > 0
    now = evaluate(run).targets[0].score
    later = evaluate(run, lagged=True).targets[0].score
    assert later.velocity_mps.rms < now.velocity_mps.rms
    plain = offline.run(tmp_path / "world.mcap", tmp_path / "plain", pictures=False)
    assert plain.lagged is None
    with pytest.raises(InputError, match=r"no lagged tracks; want a run with --observer NAME\+lagN"):
        evaluate(plain, lagged=True)


def test_an_observer_that_cannot_look_back_is_refused_with_those_that_can():
    with pytest.raises(InputError, match=r"lag = 2 scans: this observer cannot look back; want one of .*ekf"):
        list(outrider.track(simulate.record(WORLD), changes=["observer.name=multi_stage+lag2"]))
