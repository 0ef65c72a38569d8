"""Named recordings: found, checked by hash, fetched from a server, refused with one clear line."""

import hashlib
import http.server
import threading

import msgspec
import numpy as np
import pytest

from made_recordings import check_equal, drive
from outrider import datasets, io
from outrider.errors import InputError
from outrider.settings import Settings


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache and no folder of recordings."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(datasets.DATA_VARIABLE, raising=False)
    return tmp_path / "cache"


@pytest.fixture
def server(tmp_path):
    """Address of a folder on this machine, and the folder."""
    folder = tmp_path / "served"
    folder.mkdir()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(folder))

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{serving.server_address[1]}", folder
        serving.shutdown()
        thread.join()


@pytest.mark.parametrize("name", datasets.names())
def test_every_entry_is_complete(name):
    entry = datasets.entry(name)
    assert entry is datasets.entry(datasets.PREFIX + name)
    assert entry.about
    assert entry.origin
    assert entry.licence
    assert entry.citation.startswith("@")
    assert entry.citation.count("{") == entry.citation.count("}")
    assert isinstance(msgspec.convert(entry.settings, Settings), Settings)
    for file in entry.files:
        hashes = [file.sha256] + ([file.url_sha256] if file.url else [])
        assert all(len(h) == 64 and set(h) <= set("0123456789abcdef") for h in hashes)


def test_the_three_runs_of_one_car_share_their_settings():
    runs = [datasets.entry(name) for name in datasets.names() if name.startswith("datmo/")]
    assert len(runs) == 3
    assert all(run.settings == runs[0].settings for run in runs)
    timing = msgspec.convert(runs[0].settings, Settings).timing
    assert timing.time_increment_s == pytest.approx(-0.977 * 0.0775 / 360)


def test_an_unknown_name_lists_the_known():
    with pytest.raises(
        InputError, match="datmo/overtakes, datmo/parallel, datmo/overtake_ego, kitti0000, tysik"
    ):
        datasets.entry("nuscenes")


def test_what_cannot_be_fetched_says_so(cache):
    with pytest.raises(InputError, match="cannot be fetched; set OUTRIDER_DATA to the folder"):
        datasets.load("kitti0000")


def test_a_file_is_fetched_once_and_checked(cache, server):
    address, folder = server
    io.write_recording(folder / "a.bag", drive(2))
    digest = hashlib.sha256((folder / "a.bag").read_bytes()).hexdigest()
    file = datasets.File("set/a.bag.xz", "0" * 64, f"{address}/a.bag", digest)
    got = datasets.fetch(file)
    assert cache in got.parents
    check_equal(io.open_recording(got).messages(), drive(2))
    (folder / "a.bag").unlink()
    assert datasets.fetch(file) == got


def test_a_file_that_is_not_what_it_was_is_refused(cache, server):
    address, folder = server
    (folder / "a.bag").write_text("something else")
    file = datasets.File("set/a.bag.xz", "0" * 64, f"{address}/a.bag", "0" * 64)
    with pytest.raises(InputError, match="cannot be fetched") as caught:
        datasets.fetch(file)
    assert "\n" not in str(caught.value)


def test_a_server_that_does_not_answer_is_one_line(cache):
    file = datasets.File("set/a.bag.xz", "0" * 64, "http://127.0.0.1:9/a.bag", "0" * 64)
    with pytest.raises(InputError, match=r"cannot be fetched .*set OUTRIDER_DATA") as caught:
        datasets.fetch(file)
    assert "\n" not in str(caught.value)


def test_a_local_file_goes_first_and_is_checked(tmp_path, monkeypatch):
    monkeypatch.setenv(datasets.DATA_VARIABLE, str(tmp_path))
    (tmp_path / "a").write_text("right")
    file = datasets.File("a", hashlib.sha256(b"right").hexdigest())
    assert datasets.fetch(file) == tmp_path / "a"
    (tmp_path / "a").write_text("wrong")
    with pytest.raises(InputError, match="SHA-256"):
        datasets.fetch(file)


def test_open_any_takes_paths_and_names(tmp_path, cache):
    io.write_recording(tmp_path / "a.csv", drive(1))
    recording, entry = datasets.open_any(tmp_path / "a.csv")
    assert (recording.format, entry) == ("csv", None)
    with pytest.raises(InputError, match="no data set 'nope'"):
        datasets.open_any("dataset:nope")


# ------------------------------------------------------------------ the real ones


def test_every_real_recording_opens(data):
    counts = {
        "datmo/overtakes": (339, 3161, 3161),
        "datmo/parallel": (219, 2034, 2034),
        "datmo/overtake_ego": (135, 1248, 1248),
        "kitti0000": (100, 100, 301),
        "tysik": (331, 0, 0),
    }
    assert set(counts) == set(datasets.names())
    for name in datasets.names():
        recording, entry = datasets.open_any(f"dataset:{name}")
        chosen = io.choose_topics(recording, msgspec.convert(entry.settings, Settings).recording)
        found = {topic.name: topic.count for topic in recording.topics}
        truth = sum(found[topic] for topic in chosen.truth)
        assert (found[chosen.scan], found.get(chosen.ego, 0), truth) == counts[name]
        assert sum(1 for _ in recording.messages()) == sum(found.values())


def test_real_bags_convert_without_loss(data, tmp_path):
    recording = datasets.load("datmo/overtake_ego")
    io.convert(recording, tmp_path / "a.mcap")
    check_equal(io.open_recording(tmp_path / "a.mcap").messages(), recording.messages())


def test_unknown_types_of_a_real_bag_are_listed(data):
    others = {topic.name: topic.type for topic in datasets.load("datmo/parallel").others}
    assert others["/wheel_speeds"] == "barc/msg/Encoder"
    assert others["/imu/data"] == "sensor_msgs/msg/Imu"


def test_the_frozen_ego_pose_is_marked(data):
    entry = datasets.entry("datmo/overtake_ego")
    messages = list(datasets.load("datmo/overtake_ego").messages(["/ego_pose", "/scan"]))
    scans = [m.stamp_ns for m in messages if m.topic == "/scan"]
    valid = [s for s in scans if (s - scans[0]) * 1e-9 <= entry.valid_until_s]
    assert len(valid) == 104
    end = [m.position for m in messages if m.topic == "/ego_pose" and m.stamp_ns > scans[0] + 8.2e9]
    assert len(end) > 100
    assert np.ptp(np.array(end), axis=0).max() == 0


def test_parked_cars_of_the_street_stand_on_their_returns(data):
    """Scan, ego and truth are in frames that agree: returns fall on the edge of the parked van."""
    from outrider.geometry import invert, transform

    by_time = {}
    for message in datasets.load("kitti0000").messages(["/scan", "/ego_pose", "/truth/Van_3"]):
        by_time.setdefault(message.stamp_ns, {})[message.topic] = message
    inside = outside = 0
    for frame in by_time.values():
        if len(frame) < 3:
            continue
        laser, van = frame["/scan"], frame["/truth/Van_3"]
        angle = laser.angle_min + laser.angle_increment * np.arange(len(laser.ranges))
        hit = np.isfinite(laser.ranges)
        p = laser.ranges[hit, None].astype(float) * np.column_stack([np.cos(angle[hit]), np.sin(angle[hit])])
        local = transform(invert(van.xyyaw), transform(frame["/ego_pose"].xyyaw, p))
        within = np.all(np.abs(local) < 0.5 * van.extent + 0.15, axis=1)
        deep = np.all(np.abs(local) < 0.5 * van.extent - 0.4, axis=1)
        inside, outside = inside + int(within.sum()), outside + int(deep.sum())
    assert inside > 500
    assert outside < 0.1 * inside


def test_the_street_converts_without_loss(data, tmp_path):
    recording = datasets.load("kitti0000")
    io.convert(recording, tmp_path / "a.bag")
    io.convert(tmp_path / "a.bag", tmp_path / "b.parquet")
    check_equal(
        sorted(io.open_recording(tmp_path / "b.parquet").messages(), key=lambda m: (m.received_ns, m.topic)),
        sorted(recording.messages(), key=lambda m: (m.received_ns, m.topic)),
    )
