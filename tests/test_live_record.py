"""What a live run records: readable by others, bit by bit by us, and whatever ends the power or the disk."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove import messages as fg
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader

from made_frames import make_frames
from outrider import io
from outrider.errors import InputError
from outrider.io import _live_mcap, _ros_scene
from outrider.live import Health, Shot, record
from outrider.live.record import Recorder
from outrider.records import LaserScan, Raw
from outrider.settings import Settings

ABOUT = {"model": "A1", "mode": "standard", "answer": 0x81}
FRAMES = list(make_frames(30))


def shots(n, t=1_700_000_000.0, step=0.1):
    """Frames, their times made new."""
    for k in range(n):
        frame = FRAMES[k % len(FRAMES)]
        now = t + k * step
        scan = replace(frame.scan, t=now, beam_t=frame.scan.beam_t - frame.scan.t + now)
        alert = replace(frame.alert, t=now)
        yield Shot(replace(frame, t=now, scan=scan, alert=alert), None, Health((), {}), now, now)


def raws(n, t=1_700_000_000.0, seed=1):
    rng = np.random.default_rng(seed)
    for k in range(n):
        yield Raw(t + 0.01 * k + 1e-3 * rng.random(), rng.bytes(int(rng.integers(1, 300))))


def recorded(path, *items, **options):
    recorder = Recorder(path, Settings(), lambda: ABOUT, floor_mb=0.0, **options)
    for item in items:
        recorder.shot(item) if isinstance(item, Shot) else recorder.raw(item)
    recorder.close()
    recorder.close()
    return recorder


def test_bytes_come_back_as_they_were_given(tmp_path):
    given = list(raws(300))
    recorded(tmp_path / "ride.mcap", *given, *shots(20))
    assert list(_live_mcap.raws(tmp_path / "ride.mcap")) == given
    assert _live_mcap.about(tmp_path / "ride.mcap") == ABOUT


def test_a_recording_without_bytes_says_so(tmp_path):
    recorded(tmp_path / "ride.mcap", *shots(5))
    assert _live_mcap.about(tmp_path / "ride.mcap") is None
    (tmp_path / "other.mcap").write_bytes(b"no MCAP at all")
    assert _live_mcap.about(tmp_path / "other.mcap") is None


def test_all_that_a_ros_player_asks_for_is_there(tmp_path):
    """Profile ros2, one encoding, definitions with every channel, rising times within a topic."""
    recorded(tmp_path / "ride.mcap", *raws(50), *shots(20))
    with (tmp_path / "ride.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        topics = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert topics == {"/scan": "sensor_msgs/msg/LaserScan", **_ros_scene.TYPES}


def test_others_read_every_message(tmp_path):
    """rosbags decodes each message by the definition that is in the file, not by one of ours."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    path = tmp_path / "ride.mcap"
    recorded(path, *raws(30), *shots(20))
    counts = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            if connection.topic == "/scene" and counts["/scene"] == 20:
                scene = message
    assert counts["/scan"] == counts["/tf"] == counts["/scene"] == counts["/alert"] == counts["/tracks"] == 20
    assert counts["/lidar/bytes"] == 30
    frame = list(shots(20))[-1].frame
    assert [entity.id for entity in scene.entities][1:] == [f"track {i}" for i in frame.tracks.id]
    box = scene.entities[1].cubes[0]
    assert [box.pose.position.x, box.pose.position.y] == pytest.approx(frame.tracks.W_p[0])
    assert [box.size.x, box.size.y] == pytest.approx(frame.tracks.extent[0])


def test_the_scene_is_as_foxglove_defines_it():
    """The fields of each ROS type, in their order, are those of the Protobuf schema that Foxglove ships."""
    files = descriptor_pb2.FileDescriptorSet()
    files.ParseFromString(fg.SceneUpdate.get_schema().data)
    theirs = {m.name: [f.name for f in m.field] for file in files.file for m in file.message_type}
    for name, text in _ros_scene.PRIMITIVES.items():
        ours = [line.split()[1] for line in text.splitlines() if "=" not in line]
        assert ours == theirs[name], name


def test_scans_come_back(tmp_path):
    """The scan that any tool reads has each return at its angle and time, as far as an even grid can."""
    given = list(shots(10))
    recorded(tmp_path / "ride.mcap", *given)
    messages = list(io.open_recording(tmp_path / "ride.mcap").messages())
    assert len(messages) == 10
    for message, shot in zip(messages, given, strict=True):
        assert isinstance(message, LaserScan)
        scan = shot.frame.scan
        angle = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
        beam_t = message.stamp_ns * 1e-9 + message.time_increment * np.arange(len(message.ranges))
        assert message.angle_increment > 0.0
        order = np.argsort(scan.angle)
        np.testing.assert_allclose(angle, scan.angle[order], atol=1e-5)
        np.testing.assert_allclose(beam_t, scan.beam_t[order], atol=1e-5)
        np.testing.assert_array_equal(np.isfinite(message.ranges), scan.valid[order])
        seen = scan.valid[order]
        np.testing.assert_allclose(message.ranges[seen], scan.range[order][seen], rtol=1e-6)


def test_a_sensor_that_turns_clockwise_is_told_by_negative_time(tmp_path):
    shot = next(shots(1))
    scan = shot.frame.scan
    turned = replace(scan, angle=-scan.angle)
    recorded(tmp_path / "ride.mcap", replace(shot, frame=replace(shot.frame, scan=turned)))
    (message,) = io.open_recording(tmp_path / "ride.mcap").messages()
    assert message.angle_increment > 0.0 > message.time_increment
    assert message.stamp_ns * 1e-9 == pytest.approx(float(scan.beam_t.max()), abs=1e-6)


@pytest.mark.parametrize(("limit", "files"), [({"size_mb": 0.01}, 3), ({"minutes": 0.5 / 60}, 2)])
def test_a_file_ends_by_size_or_time_and_each_stands_alone(tmp_path, monkeypatch, limit, files):
    monkeypatch.setattr(record, "SYNC_S", 0.05)
    recorder = Recorder(tmp_path / "ride.mcap", Settings(), lambda: ABOUT, floor_mb=0.0, **limit)
    given = [*raws(120)]
    for k, raw in enumerate(given):
        recorder.raw(raw)
        if k % 10 == 0:
            recorder.shot(list(shots(k + 1))[-1])
            time.sleep(0.06)
    recorder.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) >= files
    assert names[:2] == ["ride-0002.mcap", "ride.mcap"] or names[0] == "ride-0002.mcap"
    paths = [Path(name) for name in recorder.report["files"]]
    assert all(_live_mcap.about(path) == ABOUT for path in paths)
    assert [raw for path in paths for raw in _live_mcap.raws(path)] == given
    assert not any(io.open_recording(path).truncated for path in paths)


def test_a_disk_that_is_nearly_full_is_left_alone_and_recording_goes_on_later(tmp_path, monkeypatch):
    room = [600e6]
    usage = type("Usage", (), {"free": property(lambda self: room[0])})
    monkeypatch.setattr(record.shutil, "disk_usage", lambda path: usage())
    monkeypatch.setattr(record, "SYNC_S", 0.02)
    monkeypatch.setattr(record, "LOOK_S", 0.05)
    recorder = Recorder(tmp_path / "ride.mcap", Settings(), lambda: ABOUT, floor_mb=500.0)

    def give(seconds=0.2):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            recorder.raw(Raw(time.time(), b"abc"))
            time.sleep(0.005)

    give()
    assert recorder.report["trouble"] == ""
    room[0] = 400e6
    give()
    assert "less than 500 MB left on the disk; recording has stopped" in recorder.report["trouble"]
    stopped = recorder.report["written"]
    room[0] = 600e6  # not enough again: it would begin and stop for ever
    give()
    assert recorder.report["written"] == stopped
    assert recorder.report["dropped"] > 0
    room[0] = 800e6
    give()
    assert recorder.report["trouble"] == ""
    assert recorder.report["written"] > stopped
    recorder.close()
    assert [Path(name).name for name in recorder.report["files"]] == ["ride.mcap", "ride-0002.mcap"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full here")
def test_a_disk_that_refuses_stops_no_warning(tmp_path):
    (tmp_path / "ride.mcap").symlink_to("/dev/full")
    recorder = Recorder(tmp_path / "ride.mcap", Settings(), lambda: ABOUT, floor_mb=0.0, force=True)
    for raw in raws(2000):
        recorder.raw(raw)
    recorder.close()
    assert recorder.report["failures"] >= 1
    assert "No space left" in recorder.report["trouble"]


def test_what_may_not_be_written_is_said_at_once(tmp_path):
    (tmp_path / "ride.mcap").write_bytes(b"kept")
    with pytest.raises(InputError, match=r"ride\.mcap: exists; choose another name"):
        Recorder(tmp_path / "ride.mcap", Settings())
    with pytest.raises(InputError, match=r"want a name that ends in \.mcap"):
        Recorder(tmp_path / "ride.bag", Settings())
    with pytest.raises(InputError, match="record minutes = 0; want more than 0"):
        Recorder(tmp_path / "new.mcap", Settings(), minutes=0.0)
    with pytest.raises(InputError, match="record floor_mb = -1; want 0 or more"):
        Recorder(tmp_path / "new.mcap", Settings(), floor_mb=-1.0)
    with pytest.raises(InputError, match="there is no folder"):
        Recorder(tmp_path / "no" / "ride.mcap", Settings())
    assert (tmp_path / "ride.mcap").read_bytes() == b"kept"


RIDE = """
import sys, time
sys.path.insert(0, {tests!r})
from test_live_record import Recorder, Settings, ABOUT, Raw, shots
recorder = Recorder({path!r}, Settings(), lambda: ABOUT, floor_mb=0.0)
k = 0
while True:
    t = time.time()
    recorder.raw(Raw(t, b"x" * 400))
    if k % 10 == 0:
        recorder.shot(next(shots(1, t)))
    print(repr(t), flush=True)
    k += 1
    time.sleep(0.01)
"""


def test_a_killed_process_loses_less_than_a_second(tmp_path):
    """SIGKILL at random times, several rides at once: all but the last second is there, and readable."""
    rng, rides = np.random.default_rng(7), []
    for k in range(3):
        path = tmp_path / f"ride{k}.mcap"
        code = RIDE.format(tests=str(Path(__file__).parent), path=str(path))
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        rides.append((path, process))
    for _, process in rides:
        process.stdout.readline()  # it runs
        time.sleep(float(rng.uniform(0.3, 1.2)))
    for path, process in rides:
        os.kill(process.pid, signal.SIGKILL)
        told = [float(line) for line in process.stdout.read().split("\n") if line.strip()]
        process.wait()
        process.stdout.close()
        kept = [raw.received for raw in _live_mcap.raws(path)]
        assert io.open_recording(path).truncated
        assert kept == sorted(kept)
        assert told[-1] - kept[-1] < 1.0
        assert set(told) >= set(kept[1:-1])
        assert _live_mcap.about(path) == ABOUT
