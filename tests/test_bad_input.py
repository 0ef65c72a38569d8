"""Bad recordings and bad places, as a user meets them: one clear line or a counted mask, nothing lost."""

import contextlib
import ctypes
import dataclasses
import json
import os
import resource
import subprocess
import sys

import numpy as np
import pytest

from made_recordings import pose
from outrider import cli, io, simulate
from outrider.io.run import finish, open_run
from outrider.records import LaserScan, Pose

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def messages():
    """Four seconds of the demo: a moving rider, poses, cars, walls."""
    until = simulate.EPOCH_NS + 4 * SECOND
    return [m for m in simulate.record(simulate.load("demo")) if m.received_ns <= until]


@pytest.fixture
def track(capsys, tmp_path):
    """`outrider track` on messages or a path: exit code, the one line on stderr, the run folder's summary."""

    def call(source, *options, suffix="parquet"):
        if not isinstance(source, str | os.PathLike):
            io.write_recording(tmp_path / f"rec.{suffix}", source, force=True)
            source = tmp_path / f"rec.{suffix}"
        capsys.readouterr()
        run = tmp_path / "run"
        code = cli.run(["track", str(source), "-o", str(run), "--no-pictures", *options])
        out, err = capsys.readouterr()
        if code:
            assert out == ""
            assert err.startswith("outrider: ")
            assert len(err.splitlines()) == 1
        else:
            assert err == ""
        summary = open_run(run).summary if (run / "settings.toml").exists() else None
        return code, err, summary

    return call


def scans_changed(messages, change):
    """The messages with scan number k replaced by `change(scan, k)`; None leaves it out."""
    k = 0
    for message in messages:
        if isinstance(message, LaserScan):
            changed = change(message, k)
            k += 1
            if changed is not None:
                yield changed
        else:
            yield message


def count(messages):
    return sum(isinstance(m, LaserScan) for m in messages)


# ------------------------------------------------------------------ recordings that cannot be used


def test_an_empty_file(track, tmp_path):
    for name in ("a.bag", "a.mcap", "a.parquet", "a.csv", "a.db3"):
        (tmp_path / name).touch()
        code, err, run = track(tmp_path / name)
        assert (code, run) == (2, None)
        assert "empty file" in err


def test_a_folder_that_is_no_bag(track, tmp_path):
    (tmp_path / "folder").mkdir()
    code, err, run = track(tmp_path / "folder")
    assert (code, run) == (2, None)
    assert str(tmp_path / "folder") in err


def test_a_file_that_is_not_there_or_something_else(track, tmp_path):
    (tmp_path / "notes.txt").write_text("no scans here")
    (tmp_path / "notes.bag").write_text("no scans here")
    for name in ("absent.bag", "notes.txt", "notes.bag"):
        code, err, run = track(tmp_path / name)
        assert (code, run) == (2, None)
        assert name in err


def test_a_wrong_topic(track, messages):
    code, err, run = track(messages, "--scan-topic", "/scam")
    assert (code, run) == (2, None)
    assert "did you mean /scan" in err


def test_a_recording_without_scans(track):
    code, err, run = track([pose(i) for i in range(20)])
    assert (code, run) == (2, None)
    assert "no laser scan" in err
    assert "/ego_pose" in err


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("suffix", ["bag", "mcap", "parquet", "csv"])
def test_a_truncated_recording(track, messages, tmp_path, suffix, share):
    """What is left is tracked, or one line says why it cannot be read; a folder that was begun is whole."""
    io.write_recording(tmp_path / f"whole.{suffix}", messages)
    content = (tmp_path / f"whole.{suffix}").read_bytes()
    (tmp_path / f"cut.{suffix}").write_bytes(content[: int(share * len(content))])
    code, _, run = track(tmp_path / f"cut.{suffix}")
    assert code in (0, 2)
    if code == 0:
        assert 0 <= run["scans"] <= count(messages)
    if run is not None:
        assert run["finished"]
        assert run["interrupted"] == (code == 2)
    if suffix == "mcap" and share > 0.5:
        assert code == 0
        assert run["truncated"]
        assert run["scans"] > 0


# ------------------------------------------------------------------ scans that are bad


def test_a_tenth_of_the_ranges_is_not_a_number(track, messages):
    rng = np.random.default_rng(1)
    put = []

    def spoil(scan, k):
        bad = rng.random(len(scan.ranges)) < 0.1
        put.append(bad.sum())
        return dataclasses.replace(scan, ranges=np.where(bad, np.float32(np.nan), scan.ranges))

    code, _, run = track(scans_changed(messages, spoil))
    assert code == 0
    assert run["repairs"]["masked"]["nan"] == sum(put) > 1000
    assert run["scans"] == count(messages)
    assert run["moving_tracks"] > 0


def test_all_ranges_infinite(track, messages):
    nothing = np.full(480, np.inf, np.float32)
    code, _, run = track(scans_changed(messages, lambda scan, k: dataclasses.replace(scan, ranges=nothing)))
    assert code == 0
    assert run["repairs"]["masked"] == {"infinite": 480 * count(messages)}
    assert run["tracks"] == 0
    assert run["degraded_scans"] == run["scans"] == count(messages)


@pytest.mark.parametrize("every", [1, 5])
def test_scans_of_length_zero(track, messages, every):
    none = np.zeros(0, np.float32)

    def empty(scan, k):
        return dataclasses.replace(scan, ranges=none) if k % every == 0 else scan

    code, _, run = track(scans_changed(messages, empty))
    assert code == 0
    assert run["repairs"]["faults"]["no beams"] == -(-count(messages) // every)
    assert run["scans"] == count(messages)


def test_scans_out_of_order(track, messages):
    """The header stamp of every fourth scan is that of the scan before the last one: it comes too late."""
    late = 250_000_000

    def swap(scan, k):
        return dataclasses.replace(scan, stamp_ns=scan.stamp_ns - late) if k % 4 == 3 else scan

    code, _, run = track(scans_changed(messages, swap))
    assert code == 0
    assert run["repairs"]["skipped"]["out of order"] == count(messages) // 4
    assert run["scans"] == count(messages) - count(messages) // 4


def test_duplicated_stamps(track, messages):
    def twice():
        for message in messages:
            yield message
            if isinstance(message, LaserScan):
                yield message

    code, _, run = track(twice())
    assert code == 0
    assert run["repairs"]["skipped"] == {"duplicated stamp": count(messages)}
    assert run["scans"] == count(messages)


def test_a_gap_of_five_seconds(track, messages):
    def later(message):
        if message.received_ns < simulate.EPOCH_NS + 2 * SECOND:
            return message
        shift = 5 * SECOND
        return dataclasses.replace(
            message, stamp_ns=message.stamp_ns + shift, received_ns=message.received_ns + shift
        )

    code, _, run = track([later(m) for m in messages])
    assert code == 0
    assert run["repairs"]["faults"]["gap"] == 1
    assert run["degraded_scans"] >= 1
    assert run["duration_s"] == pytest.approx(0.1 * (count(messages) - 1) + 5.0, abs=0.2)


@pytest.mark.parametrize("ego", [True, False])
def test_a_clock_that_jumps_back(track, messages, ego):
    """A quarter of an hour, in the middle; receive times go on."""
    jump = 900 * SECOND

    def back(message):
        late = message.received_ns > simulate.EPOCH_NS + 2 * SECOND
        return dataclasses.replace(message, stamp_ns=message.stamp_ns - jump) if late else message

    kept = [back(m) for m in messages if ego or not isinstance(m, Pose)]
    code, _, run = track(kept)
    assert code == 0
    assert run["repairs"]["faults"]["clock jumped back"] == 1
    assert run["scans"] >= count(messages) - 2
    assert run["t_last"] < run["t_first"]


def test_an_angle_increment_of_zero(track, messages):
    code, _, run = track(scans_changed(messages, lambda s, k: dataclasses.replace(s, angle_increment=0.0)))
    assert code == 0
    assert run["repairs"]["masked"] == {"no_angle": 480 * count(messages)}
    assert run["repairs"]["faults"]["angles unusable"] == count(messages)
    assert run["tracks"] == 0


def test_a_hundred_thousand_beams(track, messages):
    n = 100_000

    def finer(scan, k):
        index = np.arange(n) * len(scan.ranges) // n
        step = 2.0 * np.pi / n
        more = {"angle_increment": step, "time_increment": 0.1 / n, "ranges": scan.ranges[index]}
        return dataclasses.replace(scan, **more) if k < 5 else None

    code, _, run = track(scans_changed(messages, finer))
    assert code == 0
    assert run["repairs"]["beams"] == 5 * n
    assert run["scans"] == 5


def test_poses_that_are_not_finite(track, messages):
    nowhere = np.full(3, np.nan)
    spoilt = [
        dataclasses.replace(m, position=nowhere) if isinstance(m, Pose) and i % 3 == 0 else m
        for i, m in enumerate(messages)
    ]
    code, _, run = track(spoilt)
    assert code == 0
    assert run["repairs"]["poses_left_out"] > 0
    assert run["scans"] == count(messages)


def test_headers_full_of_nonsense(track, messages):
    wrong = {"time_increment": np.nan, "scan_time": -1.0, "range_max": -5.0}
    code, _, run = track(scans_changed(messages, lambda s, k: dataclasses.replace(s, **wrong)))
    assert code == 0
    assert run["scans"] == count(messages)
    assert run["repairs"]["faults"]["range limits repaired"] == count(messages)
    assert any("time_increment repaired" in text for text in run["repairs"]["repairs"])


# ------------------------------------------------------------------ places that cannot be written


def test_no_permission_to_write(messages, tmp_path):
    """A folder without the right to write; a root gives up its right to pass over that."""
    io.write_recording(tmp_path / "rec.parquet", messages)
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    done = outrider("track", tmp_path / "rec.parquet", "-o", locked / "run", before=bound_by_permissions)
    refused(done, "Permission denied")
    done = outrider("simulate", "oncoming", "-o", locked / "rec.mcap", before=bound_by_permissions)
    refused(done, "Permission denied")
    assert list(locked.iterdir()) == []


def outrider(*tokens, before):
    """The program in a process of its own, where `before` is called first."""
    tokens = [sys.executable, "-m", "outrider", *map(str, tokens)]
    return subprocess.run(tokens, capture_output=True, text=True, preexec_fn=before, timeout=120)


def bound_by_permissions():
    """What is executed from here on has no CAP_DAC_OVERRIDE (1); without effect where it is not root."""
    ctypes.CDLL(None).prctl(24, 1, 0, 0, 0)  # PR_CAPBSET_DROP


def refused(done, word):
    assert done.returncode == 2, done
    assert done.stdout == ""
    assert done.stderr.startswith("outrider: ")
    assert len(done.stderr.splitlines()) == 1
    assert word in done.stderr


@contextlib.contextmanager
def no_file_beyond(size):
    """As on a disk that is nearly full: no file grows beyond `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_where_the_folder_should_be(track, messages, tmp_path):
    (tmp_path / "run").write_text("mine")
    code, err, _ = track(messages)
    assert code == 2
    assert "is a file" in err
    assert (tmp_path / "run").read_text() == "mine"


@pytest.mark.parametrize("size", [20_000, 100_000, 150_000])
def test_a_full_disk_keeps_what_was_written(track, messages, tmp_path, size):
    assert track(messages)[0] == 0  # and compiles, whose files are larger
    run = tmp_path / "run"
    with no_file_beyond(size):
        code, err, _ = track(tmp_path / "rec.parquet", "--force")
    assert code == 2
    assert "File too large" in err
    left = open_run(run)
    assert not left.summary["finished"]
    if size > 20_000:
        assert left.scans.num_rows > 5
        assert left.tracks.num_rows > 5
    whole = finish(run)
    assert whole.summary["interrupted"]
    assert whole.scans.num_rows == left.scans.num_rows
    assert json.loads((run / "summary.json").read_text())["finished"]


def test_a_full_disk_for_a_recording_changes_nothing(tmp_path):
    """simulate and convert write beside the target: what was there stays."""
    target = tmp_path / "rec.mcap"
    target.write_bytes(b"before")
    limit = (100_000, 100_000)
    done = outrider(
        *("simulate", "demo", "-o", target, "--force"),
        before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )
    refused(done, "File too large")
    assert target.read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == ["rec.mcap"]
