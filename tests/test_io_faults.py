"""Files that are damaged, wrong or not allowed: one clear line, and nothing lost that was written."""

import os
import resource
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_recordings import TARGETS, check_equal, drive, pose, scan
from outrider import io
from outrider.errors import InputError, OutputError
from outrider.settings import Recording as Named

SUFFIXES = [".bag", ".bag.xz", ".db3", ".mcap", ".parquet", ".csv"]
FILES = [name for name in TARGETS if name not in ("ros2-mcap", "ros2-sqlite3")]


def write(folder, target, messages):
    name, format = TARGETS[target]
    io.write_recording(folder / name, messages, format=format)
    return folder / name


def noise(n=40, beams=720):
    """Scans that no packing makes small."""
    rng = np.random.default_rng(5)
    return [scan(i, rng.uniform(0.1, 30, beams)) for i in range(n)]


def read_all(path):
    """All messages, or those before the damage; and its one line, or ""."""
    got, problem = [], ""
    try:
        for message in io.open_recording(path).messages():
            got.append(message)
    except InputError as error:
        problem = str(error)
    assert "\n" not in problem
    assert not problem or str(path) in problem
    return got, problem


@contextmanager
def nobody():
    """Root may read and write everything, so tests of permissions run as someone else."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(before)


# ------------------------------------------------------------------ what is no recording


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_empty_file(tmp_path, suffix):
    (tmp_path / f"a{suffix}").touch()
    with pytest.raises(InputError, match="empty file"):
        io.open_recording(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=30)
@given(st.binary(min_size=1, max_size=400))
def test_random_bytes(tmp_path_factory, suffix, content):
    path = tmp_path_factory.mktemp("random") / f"a{suffix}"
    path.write_bytes(content)
    assert read_all(path)[0] == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_long_random_bytes_are_refused(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(np.random.default_rng(1).bytes(200_000))
    with pytest.raises(InputError, match=str(path)):
        io.open_recording(path)


def test_absent_file(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        io.open_recording(tmp_path / "none.bag")


def test_file_without_read_permission(tmp_path):
    path = write(tmp_path, "mcap", drive(1))
    path.chmod(0)
    with nobody(), pytest.raises(InputError, match="Permission denied"):
        io.open_recording(path)


@pytest.mark.parametrize("name", ["notes.txt", "noname", "a.bag.gz"])
def test_unknown_suffix_names_the_known(tmp_path, name):
    (tmp_path / name).write_text("hello")
    with pytest.raises(InputError, match=r"want .*\.bag, \.bag\.xz, \.csv, \.db3, \.mcap, \.parquet"):
        io.open_recording(tmp_path / name)


def test_a_wrong_suffix_is_told(tmp_path):
    path = write(tmp_path, "parquet", drive(1))
    for suffix in SUFFIXES:
        if suffix != ".parquet":
            wrong = tmp_path / f"wrong{suffix}"
            wrong.write_bytes(path.read_bytes())
            with pytest.raises(InputError, match=str(wrong)):
                io.open_recording(wrong)


def test_a_folder_that_is_no_bag(tmp_path):
    with pytest.raises(InputError, match=r"without metadata\.yaml"):
        io.open_recording(tmp_path)
    write(tmp_path, "mcap", drive(1))
    with pytest.raises(InputError, match=r"e\.mcap in it may open"):
        io.open_recording(tmp_path)


@pytest.mark.parametrize("text", ["", "hello", "rosbag2_bagfile_information: 3", "a: [", "\x00"])
def test_a_folder_with_bad_metadata(tmp_path, text):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=str(tmp_path)):
        io.open_recording(tmp_path)


# ------------------------------------------------------------------ cut off or damaged


@pytest.mark.parametrize("target", FILES)
def test_cut_anywhere_gives_the_first_messages_or_one_line(tmp_path, target):
    whole, messages = write(tmp_path, target, drive(40)), drive(40)
    content = whole.read_bytes()
    cut = tmp_path / f"cut{whole.suffix}"
    for size in np.linspace(1, len(content) - 1, 60).astype(int):
        cut.write_bytes(content[:size])
        got, _ = read_all(cut)
        if target == "csv":  # the last line may be half a line
            got = got[:-1]
        check_equal(got, messages[: len(got)])


@pytest.mark.parametrize("target", FILES)
def test_changed_bytes_never_end_in_a_traceback(tmp_path, target):
    content = write(tmp_path, target, drive(4)).read_bytes()
    rng = np.random.default_rng(7)
    path = tmp_path / f"changed{TARGETS[target][0][1:]}"
    for _ in range(60):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 8):
            changed[place] = rng.integers(256)
        path.write_bytes(changed)
        read_all(path)


def test_an_mcap_cut_off_gives_every_finished_chunk(tmp_path):
    messages = noise(600)  # several chunks
    path = write(tmp_path, "mcap", messages)
    content = path.read_bytes()
    whole, counts = io.open_recording(path), []
    assert not whole.truncated
    for part in (0.99, 0.8, 0.5, 0.3):
        path.write_bytes(content[: int(part * len(content))])
        recording = io.open_recording(path)
        got = list(recording.messages())
        check_equal(got, messages[: len(got)])
        assert recording.truncated
        assert recording.topics[0].count == len(got)
        assert len(got) >= part * len(messages) - 200  # less than two chunks are lost
        assert io.describe(path).truncated
        counts.append(len(got))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]


def test_an_mcap_that_ends_in_zeros_is_read_up_to_them(tmp_path):
    path = write(tmp_path, "mcap", noise(300))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] + bytes(len(content) // 2))
    got, problem = read_all(path)
    assert problem == ""
    check_equal(got, noise(300)[: len(got)])
    assert len(got) > 0
    assert io.open_recording(path).truncated


def test_an_mcap_without_chunks_is_read_up_to_the_cut(tmp_path):
    from mcap.writer import Writer

    from outrider.io import _ros_messages

    ros, path = _ros_messages.codec(2), tmp_path / "bare.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", b"")
        channel = writer.register_channel("/scan", "cdr", schema)
        for i in range(10):
            writer.add_message(channel, i, ros.encode(scan(i), {})[1], i)
    path.write_bytes(path.read_bytes()[:-20])
    recording = io.open_recording(path)
    assert recording.truncated
    assert [m.received_ns for m in recording.messages()] == list(range(9))


def test_damage_inside_a_whole_mcap_is_told_after_what_came_before(tmp_path):
    path = write(tmp_path, "mcap", noise(600))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    got, problem = read_all(path)
    assert 0 < len(got) < 600
    assert f"damaged after {len(got)} messages" in problem
    check_equal(got, noise(600)[: len(got)])
    info = io.describe(path)
    assert "damaged" in info.problem
    assert info.topics[0].count == len(got)


def test_a_ros1_bag_that_was_not_closed_says_what_to_do(tmp_path):
    from rosbags.rosbag1 import Writer

    from outrider.io import _ros_messages

    ros, bag = _ros_messages.codec(1), Writer(tmp_path / "killed.bag")
    bag.open()
    connection = bag.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=ros.store)
    bag.write(connection, 5, ros.encode(scan(), {})[1])
    bag.abort()
    with pytest.raises(InputError, match="rosbag reindex"):
        io.open_recording(tmp_path / "killed.bag")
    content = write(tmp_path, "ros1", noise(40)).read_bytes()
    (tmp_path / "cut.bag").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match="rosbag reindex"):
        io.open_recording(tmp_path / "cut.bag")


def test_a_packed_bag_that_is_cut_off(tmp_path):
    import lzma

    packed = lzma.compress(write(tmp_path, "ros1", noise(4)).read_bytes())
    (tmp_path / "whole.bag.xz").write_bytes(packed)
    check_equal(io.open_recording(tmp_path / "whole.bag.xz").messages(), noise(4))
    (tmp_path / "cut.bag.xz").write_bytes(packed[:-1000])
    with pytest.raises(InputError, match="cut off"):
        io.open_recording(tmp_path / "cut.bag.xz")


def test_the_unpacked_bag_lives_as_long_as_it_is_needed(tmp_path, monkeypatch):
    import gc
    import lzma
    import tempfile

    (tmp_path / "a.bag.xz").write_bytes(lzma.compress(write(tmp_path, "ros1", drive(2)).read_bytes()))
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(room))
    messages = io.open_recording(tmp_path / "a.bag.xz").messages()
    gc.collect()
    assert len(list(room.iterdir())) == 1
    check_equal(messages, drive(2))
    del messages
    gc.collect()
    assert list(room.iterdir()) == []


def test_a_ros2_folder_whose_storage_is_missing(tmp_path):
    path = write(tmp_path, "ros2-mcap", drive(1))
    (path / "b.mcap").unlink()
    with pytest.raises(InputError, match="missing"):
        io.open_recording(path)


# ------------------------------------------------------------------ topics


def test_a_recording_without_scans(tmp_path):
    path = write(tmp_path, "mcap", [pose(0), pose(1)])
    with pytest.raises(
        InputError, match=r"no laser scan; topics: /ego_pose \(geometry_msgs/msg/PoseStamped, 2\)"
    ):
        io.choose_topics(io.open_recording(path))
    info = io.describe(path)
    assert info.chosen is None
    assert "no laser scan" in info.problem
    assert [(t.name, t.role, t.count) for t in info.topics] == [("/ego_pose", "not used", 2)]


def test_a_named_topic_that_is_missing_offers_the_nearest(tmp_path):
    recording = io.open_recording(write(tmp_path, "csv", drive(2)))
    for named in (Named(scan_topic="/scam"), Named(ego_topic="/scna"), Named(truth_topics=("/scann",))):
        with pytest.raises(InputError, match="did you mean /scan"):
            io.choose_topics(recording, named)
    with pytest.raises(InputError, match=r"want one of .*/ego_pose, /scan, /truth/car_1"):
        io.choose_topics(recording, Named(scan_topic="qqqqqqq"))


def test_a_named_topic_of_another_type_lists_what_fits(tmp_path):
    recording = io.open_recording(write(tmp_path, "ros1", drive(2)))
    with pytest.raises(InputError, match="want a LaserScan: /scan"):
        io.choose_topics(recording, Named(scan_topic="/ego_pose"))
    with pytest.raises(InputError, match=r"want a pose or odometry: /drive, /ego_pose, /truth/car_1"):
        io.choose_topics(recording, Named(ego_topic="/scan"))


# ------------------------------------------------------------------ tables


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,angle_min\n1,2\n", "column missing: ranges, angle_increment"),
        ("a,b\n1,2\n", r"column missing: t \(or stamp_ns\), ranges, angle_min, angle_increment"),
        ("t,x,y\n1,2,3\n", r"column missing: yaw \(or qx, qy, qz, qw\)"),
        ("t,ranges,angle_min,angle_increment\n1,1 two 3,0,0.1\n", "column ranges.*two"),
        ("t,ranges,angle_min,angle_increment\n1,1 2,left,0.1\n", "column angle_min.*left"),
        ("t,ranges,angle_min,angle_increment\n1,1 2,,0.1\n", "angle_min is empty in 1 rows"),
        ("t,ranges,angle_min,angle_increment\nnoon,1 2,0,0.1\n", "column t.*noon"),
        ("t,ranges,angle_min,angle_increment\n,1 2,0,0.1\n", "column t is empty"),
        ("t,ranges,angle_min,angle_increment\ninf,1 2,0,0.1\n", "no time"),
        ("t,ranges,angle_min,angle_increment\n1,1 2,0\n", "as many fields"),
        ("t,ranges,angle_min,angle_increment,x,y,yaw\n1,1 2,0,0.1,0,0,0\n", "column kind missing"),
        ("kind,t,ranges,angle_min,angle_increment\npicture,1,1 2,0,0.1\n", "kind 'picture'; want scan, pose"),
        ("t,t,ranges,angle_min,angle_increment\n1,1,1 2,0,0.1\n", "t is there twice"),
        ("stamp_ns,ranges,angle_min,angle_increment\n1.5,1 2,0,0.1\n", "column stamp_ns.*1.5"),
        ("kind,t,ranges,angle_min,angle_increment,x,y,yaw\npose,1,,,,,2,0\n", "column x is empty in 1 rows"),
    ],
)
def test_csv_that_cannot_be_understood(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        list(io.open_recording(tmp_path / "a.csv").messages())
    assert "\n" not in str(caught.value)


def test_a_header_without_rows_is_an_empty_recording(tmp_path):
    (tmp_path / "a.csv").write_text("t,ranges,angle_min,angle_increment")
    assert list(io.open_recording(tmp_path / "a.csv").messages()) == []


def test_csv_that_is_not_text(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00t\x00,")
    with pytest.raises(InputError, match="not text"):
        io.open_recording(tmp_path / "a.csv")


def test_parquet_with_text_for_numbers(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {"t": [0.0], "ranges": [[1.0]], "angle_min": ["left"], "angle_increment": [0.1]}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"column angle_min.*left"):
        list(io.open_recording(tmp_path / "a.parquet").messages())


# ------------------------------------------------------------------ writing


@contextmanager
def full_disk(size=65536):
    """Files cannot grow beyond this; the system answers as a full disk does, with an error on write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("target", TARGETS)
def test_a_full_disk_leaves_what_was_there(tmp_path, target):
    path = write(tmp_path, target, drive(2))
    with full_disk(), pytest.raises(OutputError, match="cannot be written") as caught:
        io.write_recording(path, noise(400), force=True, format=TARGETS[target][1])
    assert "\n" not in str(caught.value)
    check_equal(io.open_recording(path).messages(), drive(2))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("target", TARGETS)
def test_a_source_that_fails_leaves_what_was_there(tmp_path, target):
    def broken():
        yield from drive(2)
        raise RuntimeError("the source broke")

    path = write(tmp_path, target, drive(2))
    with pytest.raises(RuntimeError, match="the source broke"):
        io.write_recording(path, broken(), force=True, format=TARGETS[target][1])
    check_equal(io.open_recording(path).messages(), drive(2))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_no_folder_to_write_to(tmp_path):
    with pytest.raises(OutputError, match="no folder"):
        io.write_recording(tmp_path / "none" / "a.bag", drive(1))
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="no folder"):
        io.write_recording(tmp_path / "file" / "a.bag", drive(1))


@pytest.mark.parametrize("mode", [0o500, 0o100, 0])
def test_no_permission_to_write(tmp_path, mode):
    write(tmp_path, "ros1", drive(1))
    closed = tmp_path / "closed"
    closed.mkdir(mode)
    with nobody(), pytest.raises(OutputError, match="Permission denied"):
        io.write_recording(closed / "a.bag", drive(1))


@pytest.mark.parametrize("target", ["ros1", "ros2-mcap", "ros2-sqlite3", "mcap"])
@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_times_that_ros_cannot_hold(tmp_path, target, stamp):
    with pytest.raises(InputError, match=r"use \.parquet or \.csv"):
        write(tmp_path, target, [scan(stamp_ns=stamp)])


def test_unknown_formats_to_write(tmp_path):
    with pytest.raises(
        InputError, match=r"want no suffix \(ROS 2 bag\), \.bag, \.csv, \.db3, \.mcap, \.parquet"
    ):
        io.write_recording(tmp_path / "a.txt", drive(1))
    with pytest.raises(InputError, match="want csv, mcap, parquet, ros1, ros2-mcap, ros2-sqlite3"):
        io.write_recording(tmp_path / "a.bag", drive(1), format="ros3")
    with pytest.raises(InputError, match="not a name"):
        io.write_recording("..", drive(1))
    with pytest.raises(InputError, match="can be read, not written"):
        io.write_recording(tmp_path / "a.bag.xz", drive(1), format="ros1-xz")
