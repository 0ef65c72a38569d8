"""The live loop: what comes in, in which order it goes out, what is dropped, what is not to be trusted."""

import dataclasses
import itertools
import json
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_live import HEAD_ON, Fed, Kept, head_on, turn_of
from outrider import alert, cli, io, offline, pipeline, simulate
from outrider.errors import InputError
from outrider.geometry import TAU, wrap
from outrider.live import Raw, Trouble
from outrider.live.clock import Pace, now
from outrider.live.engine import Live
from outrider.live.inbox import MOST_BYTES, MOST_TURNS, Inbox
from outrider.live.latency import Latency
from outrider.live.replay import Replay, scans, turns
from outrider.live.scans import TurnsToScans, even
from outrider.records import Level, Turn
from outrider.repair import FORGOTTEN, LOST
from outrider.rplidar.decoder import BEHIND, Decoder
from outrider.rplidar.encode import Encoder
from outrider.rplidar.models import Mode
from outrider.rplidar.protocol import Answer
from outrider.rplidar.scene import Scene
from outrider.settings import Settings

PLAIN = Settings()


# ------------------------------------------------------------------ clock


def test_the_clock_is_the_time_of_day_and_never_goes_back():
    readings = [now() for _ in range(1000)]
    assert all(b >= a for a, b in itertools.pairwise(readings))
    assert abs(now() - time.time()) < 5.0


@given(st.floats(0.1, 20.0), st.floats(0.0, 1e9), st.floats(-1e3, 1e3))
def test_a_pace_and_its_inverse(speed, begin, later):
    pace = Pace(speed)
    pace.begin(begin)
    assert pace.to_beams(pace.to_host(begin + later)) == pytest.approx(begin + later, abs=1e-4)
    assert pace.to_host(begin + speed) - pace.to_host(begin) == pytest.approx(1.0, abs=1e-4)
    assert Pace().to_host(begin) == begin


# ------------------------------------------------------------------ inbox, latency


def test_when_the_engine_is_behind_the_newest_turns_are_kept():
    inbox, made = Inbox(), [turn_of(scan) for scan in head_on()[:9]]
    inbox.put(Trouble(0.0, "unplugged"))
    for turn in made:
        inbox.put(Raw(0.0, b"bytes"))
        inbox.put(turn)
    got = iter(lambda: inbox.get(0.0), None)
    kept = list(got)
    assert [e for e in kept if isinstance(e, Turn)] == made[-MOST_TURNS:]
    assert inbox.dropped_turns == 9 - MOST_TURNS
    assert isinstance(kept[0], Trouble)
    assert sum(isinstance(e, Raw) for e in kept) == 9
    assert kept[-1] is made[-1]


def test_bytes_that_wait_are_bounded():
    inbox, piece = Inbox(), bytes(MOST_BYTES // 4)
    for k in range(9):
        inbox.put(Raw(float(k), piece))
    assert [inbox.get(0.0).received for _ in range(4)] == [5.0, 6.0, 7.0, 8.0]
    assert inbox.get(0.0) is None
    assert inbox.dropped_bytes == 5 * len(piece)


def test_an_event_wakes_whoever_waits():
    inbox = Inbox()
    threading.Timer(0.05, inbox.put, [Raw(0.0, b"x")]).start()
    begun = time.monotonic()
    assert inbox.get(10.0) is not None
    assert time.monotonic() - begun < 5.0


@given(st.lists(st.floats(1e-5, 100.0), min_size=1, max_size=200), st.floats(0.01, 1.0))
def test_quantiles_are_right_within_two_per_cent(values, share):
    latency = Latency()
    for value in values:
        latency.add(value)
    exact = sorted(values)[int(np.ceil(share * len(values))) - 1]
    assert exact * 0.999 <= latency.quantile(share) <= exact * 1.021
    assert latency.quantile(1.0) == max(values)


def test_nothing_measured_is_no_time():
    assert Latency().as_dict() == {"n": 0, "p50_ms": None, "p99_ms": None, "max_ms": None}


# ------------------------------------------------------------------ turns -> scans


def spin(n=360, start=0.3, missing=(), turned=TAU, clockwise=True):
    """A turn with beam k at range 1 + k/100, some of them missing."""
    k = np.setdiff1d(np.arange(n), missing)
    angle = wrap((-1.0 if clockwise else 1.0) * (start + turned * k / n))
    quality = np.ones(len(k), np.float32)
    return Turn(
        100.0 + 0.1 * k / n, angle, (1.0 + k / 100.0).astype(np.float32), quality, 0.1, 40.0, 100.11, ()
    )


@pytest.mark.parametrize("clockwise", [True, False])
def test_a_whole_turn_keeps_every_beam(clockwise):
    turn = spin(clockwise=clockwise)
    beams = even(turn, 100.1)
    assert np.array_equal(beams.ranges, turn.range)
    assert np.array_equal(beams.beam_t, turn.beam_t)
    assert np.allclose(wrap(beams.angle - turn.angle), 0.0, atol=1e-9)
    assert np.allclose(np.diff(beams.angle), (-1 if clockwise else 1) * TAU / 360)


def test_missing_beams_leave_beams_without_return_in_their_places():
    missing = [*range(40, 80), 200, 300, 301]
    beams, whole = even(spin(missing=missing), 100.1), even(spin(), 100.1)
    assert np.flatnonzero(beams.ranges == 0.0).tolist() == missing
    assert np.allclose(beams.angle, whole.angle)
    assert np.allclose(beams.beam_t, whole.beam_t)


def test_two_turns_in_one_are_cut_to_the_last():
    beams = even(spin(n=720, turned=2 * TAU), 100.1)
    assert len(beams.ranges) == 360
    assert beams.ranges[-1] == spin(n=720).range[-1]


def test_angles_that_are_not_exact_lose_next_to_nothing():
    turn = spin(n=1440)
    shaken = dataclasses.replace(turn, angle=turn.angle + np.random.default_rng(1).normal(0.0, 0.0008, 1440))
    beams = even(shaken, 100.1)
    kept = beams.ranges > 0.0
    assert kept.sum() > 0.98 * 1440
    assert abs(len(beams.ranges) - 1440) <= 2
    assert np.all(np.isin(beams.ranges[kept], turn.range))


@given(
    st.lists(st.tuples(st.floats(-10.0, 10.0), st.floats(0.0, 50.0, width=32)), max_size=40),
    st.floats(1e3, 2e9),
)
def test_any_turn_becomes_a_scan_that_the_pipeline_takes(rows, t):
    n = len(rows)
    angle, ranges = (np.array([row[i] for row in rows]) for i in (0, 1))
    turn = Turn(
        t + 1e-3 * np.arange(n), angle, ranges.astype(np.float32), np.zeros(n, np.float32), 0.1, 40.0, t, ()
    )
    scan = TurnsToScans(PLAIN).scan(turn)
    assert len(scan.range) == len(scan.beam_t) == len(scan.angle) <= 20000
    assert np.array_equal(np.isfinite(scan.range), scan.valid)
    pipeline.step(pipeline.start(PLAIN), scan, PLAIN, pipeline.engine(PLAIN))


def test_what_was_lost_is_told_and_degrades_the_alert():
    ready = TurnsToScans(PLAIN)
    first, second = head_on()[:2]
    assert ready.scan(turn_of(first)).faults == ()
    scan = ready.scan(turn_of(second, faults=("84 bytes lost",)))
    assert scan.faults == (f"{LOST}: 84 bytes lost",)
    assert alert.health(scan, scan.t - 0.1, PLAIN.alert) == scan.faults


def test_turns_out_of_order_are_left_out_and_a_long_gap_forgets_all_before():
    ready = TurnsToScans(PLAIN)
    first, second, third = head_on()[:3]
    ready.scan(turn_of(second))
    assert ready.scan(turn_of(first)) is None
    assert "out of order" in ready.scan(turn_of(third)).faults[0]
    assert ready.scan(turn_of(third, offset=5.0)).faults == (f"{FORGOTTEN}: gap of 5.0 s",)


def test_scans_of_turns_are_those_of_the_recording():
    """The same beams by both ways: masks, points and times."""
    messages = head_on()
    recorded = list(offline.open_source(messages).stream)
    ready = TurnsToScans(PLAIN)
    for raw, other in zip(messages, recorded, strict=True):
        scan = ready.scan(turn_of(raw))
        assert scan.t == pytest.approx(other.t, abs=1e-6)
        assert np.array_equal(scan.valid, other.valid)
        assert np.allclose(scan.W_p, other.W_p, atol=1e-6, equal_nan=True)


# ------------------------------------------------------------------ the loop


def live_run(events, settings=PLAIN, **options):
    source = Fed(events)
    sink = Kept(source)
    return Live(source, [sink], settings, **options).run(), sink, source


def test_a_recording_gives_the_frames_that_offline_gives():
    messages = list(simulate.record(simulate.load("crossing")))[:400]
    opened = offline.open_source(messages)
    _, sink, _ = live_run(list(opened.stream))
    frames = list(offline.track(messages))
    assert len(frames) == len(sink.shots) > 20
    for frame, shot in zip(frames, sink.shots, strict=True):
        assert frame.alert == shot.frame.alert
        for name in ("id", "state", "W_p", "speed", "course", "cov"):
            assert np.array_equal(getattr(frame.tracks, name), getattr(shot.frame.tracks, name))


def test_turns_raise_the_alert_and_the_figures_tell():
    offset = now() - head_on()[-1].stamp_ns * 1e-9
    figures, sink, source = live_run([turn_of(scan, offset) for scan in head_on()])
    levels = [shot.frame.alert.level for shot in sink.shots]
    assert levels[0] == Level.NONE
    assert levels[-1] == Level.DANGER
    assert figures["alerts"] == {"notice": 1, "caution": 1, "danger": 1}
    assert figures["counts"]["scans"] == len(levels) == figures["counts"]["fed"]
    assert figures["last_beam_to_alert"]["n"] == len(levels)
    assert all(shot.last_beam == shot.turn.beam_t[-1] <= shot.decided for shot in sink.shots)
    assert (sink.closed, source.stopped) == (1, 1)


def test_what_is_ahead_of_a_turning_lidar_is_in_one_piece():
    """A lidar's own turns begin ahead, where a car that comes straight on would be cut in two."""
    dense = Mode(0, "dense", Answer.DENSE, 125.0, 30.0)
    scene, encoder = Scene(head_on), Encoder(dense.answer)
    decoder, given = Decoder(dense, 1_000_000, seam=BEHIND), []
    for k in range(4):
        for i, packet in enumerate(encoder.feed(scene.turn(k, 0.1 * k, 800))):
            given += decoder.feed(packet.tobytes(), 100.0 + 0.1 * k + 0.005 * (i + 1))
    assert len(given) >= 2
    for turn in given[1:]:
        assert len(turn.angle) == 800
        assert turn.angle[0] == pytest.approx(np.pi, abs=0.02)
        assert turn.angle[-1] == pytest.approx(-np.pi, abs=0.02)
        left, right = np.flatnonzero(np.abs(turn.angle) < TAU / 800)[[0, -1]]
        assert 0.0 < turn.beam_t[right] - turn.beam_t[left] < 0.001
        scan = TurnsToScans(PLAIN).scan(turn)
        assert np.allclose(np.diff(scan.angle), -TAU / 800, atol=1e-3)


def test_bytes_go_before_the_turn_they_end_in():
    scan = head_on()[0]
    _, sink, _ = live_run([Raw(1.0, b"a"), Raw(2.0, b"b"), turn_of(scan), Raw(3.0, b"c")])
    assert [kind for kind in sink.order if kind != "health"] == ["raw", "raw", "shot", "raw"]
    assert b"".join(raw.data for raw in sink.raws) == b"abc"


def test_silence_and_trouble_are_told_and_a_turn_ends_them():
    first, second = head_on()[:2]
    offset = now() - first.stamp_ns * 1e-9 - 0.1
    trouble = Trouble(0.0, "unplugged; plug it in")
    source = Fed([turn_of(first, offset), trouble, lambda: time.sleep(0.8), lambda: source.again()])
    sink = Kept(source)
    source.again = lambda: source._events.append(turn_of(second, now() - second.stamp_ns * 1e-9))
    figures = Live(source, [sink], PLAIN).run()
    told = [health.degraded for _, health in sink.healths]
    assert ("unplugged; plug it in",) in told
    assert any(len(reasons) == 2 and reasons[1].startswith("scans late") for reasons in told)
    assert figures["trouble"] == ()
    assert sink.shots[0].health.degraded == ()
    assert sink.shots[1].health.degraded[0].startswith("scans late")
    assert figures["counts"]["troubles"] == 1


def test_before_the_first_scan_nothing_is_to_be_trusted():
    _, sink, _ = live_run([lambda: time.sleep(0.3)])
    assert sink.healths[0][1].degraded == ("no scan yet",)


def test_no_track_outlives_a_sleep_of_the_host():
    made = head_on()
    before = [turn_of(scan) for scan in made[:30]]
    after = [turn_of(scan, offset=5.0) for scan in made[30:]]
    _, sink, _ = live_run(before + after)
    known = set(sink.shots[29].frame.tracks.id.tolist())
    assert known
    assert "gap of 5.1 s" in sink.shots[30].frame.scan.faults[0]
    assert sink.shots[30].health.degraded[0].startswith("scans late: 5.")
    assert all(not known & set(shot.frame.tracks.id.tolist()) for shot in sink.shots[30:])
    assert sink.shots[31].health.degraded == ()


def test_a_source_that_cannot_start_leaves_every_sink_closed():
    class Absent(Fed):
        def start(self, put):
            self._thread = threading.Thread()
            raise InputError("no such port")

        def stop(self):
            self.stopped += 1

    source, sink = Absent([]), Kept()
    with pytest.raises(InputError, match="no such port"):
        Live(source, [sink], PLAIN).run()
    assert sink.closed == 1


# ------------------------------------------------------------------ replay


def test_a_replay_keeps_the_time_of_the_recording():
    opened = offline.open_source(head_on())
    source, sink = Replay(scans(opened.stream), {}, speed=8.0), Kept()
    figures = Live(source, [sink], PLAIN, source.pace).run()
    assert figures["seconds"] == pytest.approx(4.0 / 8.0, abs=0.3)
    taken = figures["counts"]["scans"] + figures["counts"]["dropped turns"]
    assert taken == len(head_on())
    assert sink.shots[-1].frame.alert.level == Level.DANGER
    assert all(shot.last_beam <= shot.decided for shot in sink.shots)


def test_a_recording_whose_clock_is_set_back_is_played_on():
    raws = [Raw(100.0, b"1"), Raw(100.1, b"2"), Raw(50.0, b"3"), Raw(50.1, b"4")]
    source, sink = Replay(turns(raws, lambda data, received: ()), {}, speed=2.0), Kept()
    assert Live(source, [sink], PLAIN, source.pace).run()["seconds"] < 2.0
    assert [raw.data for raw in sink.raws] == [b"1", b"2", b"3", b"4"]


def test_bytes_are_decoded_again():
    made = [turn_of(scan) for scan in head_on()[:3]]
    by_time = {turn.received: turn for turn in made}
    raws = [Raw(turn.received, b"x") for turn in made]
    events = list(turns(raws, lambda data, received: [by_time[received]]))
    assert [event for _, event in events] == [e for pair in zip(raws, made, strict=True) for e in pair]


@pytest.mark.parametrize("speed", [0.0, -1.0, float("inf"), float("nan")])
def test_a_replay_wants_a_speed(speed):
    with pytest.raises(InputError, match="--speed"):
        Replay((), {}, speed)


# ------------------------------------------------------------------ the command


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "head_on.mcap"
    io.write_recording(path, head_on())
    return path


def test_live_tells_what_happens_and_sums_up(recording, capsys, tmp_path):
    code = cli.run(
        ["live", "--replay", str(recording), "--speed", "4", "--horn", f"wav:{tmp_path / 'horn.wav'}"]
    )
    out, err = capsys.readouterr()
    assert code == 0
    assert re.search(r"^ +\d+\.\d s  danger +track \d+, \d+ m ahead", err, flags=re.M)
    assert re.search(r"^alerts +1 notice, 1 caution, 1 danger$", out, flags=re.M)
    assert re.search(r"^last beam to alert +[\d.]+ ms \(median\)", out, flags=re.M)
    assert re.search(r"^horn +blasts 3; ", out, flags=re.M)
    assert (tmp_path / "horn.wav").stat().st_size > 44100


@pytest.mark.parametrize(
    ("tokens", "word"),
    [
        (["--speed", "2"], "--replay"),
        (["--replay", "absent.mcap"], "absent.mcap"),
        (["--replay", "absent.mcap", "--port", "/dev/ttyUSB0"], "leave one out"),
        (["--port", "/dev/absent"], "/dev/absent"),
        (["--horn", "trumpet", "--port", "/dev/absent"], "wav:FILE"),
        (["--lines", "udp://x", "--port", "/dev/absent"], "tcp://HOST:PORT"),
        (["--set", "alert.danger=3"], "danger_s"),
    ],
)
def test_live_refuses_in_one_line(capsys, tokens, word):
    assert cli.run(["live", *tokens]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("outrider:")]
    assert len(told) == 1
    assert word in told[0]


def program(*tokens):
    command = [sys.executable, "-m", "outrider", *map(str, tokens)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_line(process, words):
    for line in process.stderr:
        if words in line:
            return
    pytest.fail(f"it ended without: {words}")


def test_signals_end_a_lidar_and_a_replay_cleanly(recording, tmp_path):
    """An emulated lidar in a process of its own, read by another one, and a replay: both asked to stop."""
    (tmp_path / "head_on.toml").write_text(HEAD_ON)
    with (
        program("emulate", tmp_path / "head_on.toml", "--link", tmp_path / "lidar") as lidar,
        program("live", "--replay", recording, "--speed", "0.2", "--json") as replay,
    ):
        assert lidar.stdout.readline().strip() == str(tmp_path / "lidar")
        with program("live", "--port", tmp_path / "lidar", "--record", "ride.mcap", "--json") as live:
            wait_for_line(live, "sensor RPLIDAR A1")
            wait_for_line(replay, "head_on.mcap")
            replay.send_signal(signal.SIGTERM)
            live.send_signal(signal.SIGINT)
            ends = [process.communicate(timeout=60) for process in (replay, live)]
        lidar.terminate()
        lidar.communicate(timeout=60)
    assert (replay.returncode, live.returncode) == (0, 0), ends
    figures = [json.loads(out) for out, _ in ends]
    assert all(told["counts"]["scans"] > 0 for told in figures)
    assert figures[1]["of_it_on_the_way"]["n"] == figures[1]["counts"]["scans"]
    assert figures[1]["source"]["mode"] == "Express"
    assert figures[1]["sinks"]["recorder"]["files"] == ["ride.mcap"]
