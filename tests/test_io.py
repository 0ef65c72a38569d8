"""Recordings come back as they were written, in every format, and topics are chosen by the stated rule."""

import dataclasses
import itertools
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_recordings import DRIVE_TYPES, TARGETS, check_equal, drive, pose, scan, single
from outrider import io
from outrider.errors import InputError
from outrider.settings import Recording as Named


def write(folder, target, messages, **options):
    name, format = TARGETS[target]
    io.write_recording(folder / name, messages, format=format, **options)
    return folder / name


# ------------------------------------------------------------------ round trips


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("originals")
    return {target: write(folder, target, drive(), types=DRIVE_TYPES) for target in TARGETS}


@pytest.mark.parametrize(("source", "target"), list(itertools.product(TARGETS, TARGETS)))
def test_converting_loses_nothing(originals, tmp_path, source, target):
    name, format = TARGETS[target]
    first = io.open_recording(originals[source])
    assert io.convert(first, tmp_path / name, format=format) == len(drive())
    second = io.open_recording(tmp_path / name)
    check_equal(second.messages(), drive())
    assert [(t.name, t.kind, t.count) for t in second.topics] == [
        (t.name, t.kind, t.count) for t in first.topics
    ]
    assert io.choose_topics(second) == io.choose_topics(first)
    assert second.format == ("ros2-sqlite3" if target == "db3" else target)
    assert not second.truncated


words = st.text(st.characters(exclude_categories=("C", "Z")) | st.just(" "), max_size=8)
singles = st.floats(width=32)
arrays = st.lists(singles, max_size=20).map(lambda values: np.array(values, np.float32))
doubles = st.floats()
finite = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)


def doubles_array(n, numbers=doubles):
    return st.lists(numbers, min_size=n, max_size=n).map(np.array)


scans = st.builds(
    dataclasses.replace,
    st.just(scan()),
    topic=st.sampled_from(["/scan", "/left/scan"]),
    frame=words,
    stamp_ns=stamps,
    received_ns=stamps,
    **dict.fromkeys(
        ["angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"],
        st.floats(width=32, allow_nan=False, allow_infinity=False, min_value=-(2.0**60), max_value=2.0**60),
    ),
    ranges=arrays,
    intensities=arrays,
)
poses = st.builds(
    dataclasses.replace,
    st.just(pose()),
    topic=st.sampled_from(["/ego_pose", "/truth/a"]),
    frame=words,
    body=words,
    stamp_ns=stamps,
    received_ns=stamps,
    position=doubles_array(3),
    quaternion=doubles_array(4),
    extent=st.just(np.zeros(0)) | doubles_array(2, finite),
)


@pytest.mark.parametrize("target", TARGETS)
@settings(max_examples=25)
@given(messages=st.lists(scans | poses, max_size=12, unique_by=lambda m: m.received_ns))
def test_any_message_comes_back(tmp_path_factory, target, messages):
    path = write(tmp_path_factory.mktemp("any"), target, messages)
    check_equal(io.open_recording(path).messages(), sorted(messages, key=lambda m: m.received_ns))


@pytest.mark.parametrize("target", ["parquet", "csv"])
def test_tables_keep_what_ros_cannot(tmp_path, target):
    messages = [scan(at_ns=-5, angle_min=1 / 3, range_max=np.inf), scan(at_ns=2**62 + 1, scan_time=np.nan)]
    path = write(tmp_path, target, messages)
    first, second = io.open_recording(path).messages()
    assert (first.received_ns, second.received_ns) == (-5, 2**62 + 1)
    assert first.angle_min == 1 / 3
    assert first.range_max == np.inf
    assert np.isnan(second.scan_time)


@pytest.mark.parametrize("target", TARGETS)
def test_messages_are_sorted_by_receive_time_and_ties_keep_their_order(tmp_path, target):
    late, early = scan(2, [2.0]), scan(1, [1.0])
    twins = [scan(3, [3.0]), scan(3, [4.0])]
    path = write(tmp_path, target, [late, early, *twins])
    check_equal(io.open_recording(path).messages(), [early, late, *twins])


@pytest.mark.parametrize("target", TARGETS)
def test_only_named_topics_are_read(tmp_path, target):
    path = write(tmp_path, target, drive())
    recording = io.open_recording(path)
    check_equal(recording.messages(["/scan"]), [m for m in drive() if m.topic == "/scan"])
    assert list(recording.messages([])) == []
    with pytest.raises(InputError, match="did you mean /scan"):
        recording.messages(["/scam"])


@pytest.mark.parametrize("target", TARGETS)
def test_a_recording_without_messages_can_be_written_and_read(tmp_path, target):
    recording = io.open_recording(write(tmp_path, target, []))
    assert list(recording.messages()) == []
    assert recording.topics == ()


@pytest.mark.parametrize("target", TARGETS)
def test_one_topic_may_mix_poses_with_and_without_extent(tmp_path, target):
    messages = [pose(0, "/truth/a", "a", (4.0, 2.0)), pose(1, "/truth/a", "a"), pose(2, "/truth/a", "")]
    recording = io.open_recording(write(tmp_path, target, messages))
    check_equal(recording.messages(), messages)
    assert [(t.name, t.count) for t in recording.topics] == [("/truth/a", 3)]


@pytest.mark.parametrize("target", TARGETS)
def test_hundred_thousand_beams(tmp_path, target):
    wide = [scan(i, np.linspace(0.1, 30, 100_000), np.ones(100_000)) for i in range(3)]
    check_equal(io.open_recording(write(tmp_path, target, wide)).messages(), wide)


# ------------------------------------------------------------------ what others write


def test_rows_by_hand_need_four_columns(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(
        "t, ranges, angle_min, angle_increment, note\n0.5,1 2.5 inf,-0.1,0.1,hello\n0.6,,-0.1,0.1,\n"
    )
    first, second = io.open_recording(path).messages()
    assert (first.topic, first.stamp_ns, first.received_ns) == ("/scan", 500_000_000, 500_000_000)
    assert (first.time_increment, first.scan_time, first.range_min, first.range_max) == (0, 0, 0, np.inf)
    np.testing.assert_array_equal(first.ranges, np.array([1, 2.5, np.inf], np.float32))
    assert len(second.ranges) == 0


def test_scans_and_poses_by_hand_in_one_file(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(
        "kind,body,t,ranges,angle_min,angle_increment,x,y,yaw,length,width\n"
        'scan,,0.2,"[1.0, nan, 3.0]",0,0.1,,,,,\n'
        "pose,ego,0.1,,,,1,2,1.5707963267948966,,\n"
        "pose,van,0.2,,,,5,6,0,5.2,2.0\n"
    )
    recording = io.open_recording(path)
    assert io.choose_topics(recording) == io.Chosen("/scan", "/ego_pose", ("/truth/van",))
    ego, laser, van = recording.messages()
    np.testing.assert_allclose(ego.xyyaw, [1, 2, np.pi / 2])
    np.testing.assert_array_equal(laser.ranges, np.array([1, np.nan, 3], np.float32))
    np.testing.assert_array_equal(van.extent, [5.2, 2.0])
    assert van.body == "van"


def test_poses_alone_by_hand(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("t,x,y,yaw\n1,2,3,0\n")
    (only,) = io.open_recording(path).messages()
    np.testing.assert_array_equal(only.position, [2, 3, 0])


def test_the_files_in_the_docs_are_read(tmp_path):
    text = (Path(__file__).parents[1] / "docs" / "formats.md").read_text("utf8")
    blocks = re.findall(r"```csv\n(.*?)```", text, re.DOTALL)
    kinds = []
    for i, block in enumerate(blocks):
        (tmp_path / f"{i}.csv").write_text(block)
        kinds.append([type(m).__name__ for m in io.open_recording(tmp_path / f"{i}.csv").messages()])
    assert kinds == [["LaserScan", "LaserScan"], ["Pose", "Pose", "LaserScan"]]


def test_the_docs_name_every_format_and_column():
    from outrider.io import _columns

    text = (Path(__file__).parents[1] / "docs" / "formats.md").read_text("utf8")
    for name in (*_columns.KNOWN, *(f.name for f in io.formats())):
        assert f"`{name}`" in text


def test_parquet_by_others_may_have_other_number_types(tmp_path):
    table = pa.table(
        {
            "t": pa.array([0, 1], pa.int32()),
            "ranges": pa.array([[1.0, None], None], pa.large_list(pa.float64())),
            "angle_min": pa.array([0, 0], pa.int8()),
            "angle_increment": pa.array([0.5, 0.5], pa.float32()),
            "picture": pa.array([b"", b""]),
        }
    )
    pq.write_table(table, tmp_path / "other.parquet")
    first, second = io.open_recording(tmp_path / "other.parquet").messages()
    np.testing.assert_array_equal(first.ranges, np.array([1, np.nan], np.float32))
    assert (second.stamp_ns, len(second.ranges)) == (10**9, 0)


def ros_scan(store, generation, stamp_ns, ranges, intensities=()):
    types = store.types
    sequence = {"seq": 0} if generation == 1 else {}
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="laser", **sequence)
    return types["sensor_msgs/msg/LaserScan"](
        header,
        0.0,
        1.0,
        0.5,
        0.0,
        0.1,
        0.1,
        9.0,
        np.array(ranges, np.float32),
        np.array(intensities, np.float32),
    )


def test_a_bag_with_types_that_nobody_knows(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "odd.bag") as bag:
        odd = bag.add_connection("/wheels", "barc/msg/Encoder", msgdef="not, a definition!", md5sum="0" * 32)
        laser = bag.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        bag.write(odd, 1, b"\x01\x02")
        message = ros_scan(store, 1, 2, [1.0, 2.0, 3.0])
        bag.write(laser, 2, store.serialize_ros1(message, "sensor_msgs/msg/LaserScan"))
    recording = io.open_recording(tmp_path / "odd.bag")
    assert [(t.name, t.type) for t in recording.others] == [("/wheels", "barc/msg/Encoder")]
    assert [m.topic for m in recording.messages()] == ["/scan"]


def test_the_first_echo_of_a_multi_echo_scanner(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types, name = store.types, "sensor_msgs/msg/MultiEchoLaserScan"
    plain = ros_scan(store, 1, 5, [])
    echoes = [types["sensor_msgs/msg/LaserEcho"](np.array(e, np.float32)) for e in ([1.5, 4.0], [])]
    message = types[name](plain.header, 0.0, 1.0, 0.5, 0.0, 0.1, 0.1, 9.0, echoes, [])
    with Writer(tmp_path / "echo.bag") as bag:
        connection = bag.add_connection("/echoes", name, typestore=store)
        bag.write(connection, 5, store.serialize_ros1(message, name))
    (only,) = io.open_recording(tmp_path / "echo.bag").messages()
    np.testing.assert_array_equal(only.ranges, np.array([1.5, np.inf], np.float32))


def test_markers_drawn_for_other_reasons_are_no_poses(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from outrider.io import _ros_messages

    ours = _ros_messages.codec(2)
    store, name = get_typestore(Stores.ROS2_HUMBLE), "visualization_msgs/msg/Marker"
    marker = ours.load(ours.encode(pose(0, "/drawn", "arrow", (1.0, 1.0)), {})[1], name)
    marker.text = "hello"
    with Writer(tmp_path / "drawn", version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/drawn", name, typestore=store)
        bag.write(connection, 5, store.serialize_cdr(marker, name))
    (inner,) = (tmp_path / "drawn").glob("*.mcap")
    for path in (tmp_path / "drawn", inner):
        recording = io.open_recording(path)
        assert recording.topics == ()
        assert [t.name for t in recording.others] == ["/drawn"]


@pytest.mark.parametrize(
    "options", [{}, {"use_chunking": False}, {"index_types": None, "use_statistics": False}]
)
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_mcap_by_others(tmp_path, options, encoding):
    from mcap.writer import IndexType, Writer
    from rosbags.typesys import Stores, get_typestore

    generation = 2 if encoding == "cdr" else 1
    store = get_typestore(Stores.ROS2_FOXY if generation == 2 else Stores.ROS1_NOETIC)
    pack = store.serialize_cdr if generation == 2 else store.serialize_ros1
    if "index_types" in options:
        options = options | {"index_types": IndexType.NONE}
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=400, **options)
        writer.start()
        text = writer.register_channel("/log", "json", writer.register_schema("Log", "jsonschema", b"{}"))
        name = "sensor_msgs/msg/LaserScan" if generation == 2 else "sensor_msgs/LaserScan"
        laser = writer.register_channel(
            "/scan", encoding, writer.register_schema(name, f"ros{generation}msg", b"")
        )
        for i in (3, 1, 2):
            data = bytes(pack(ros_scan(store, generation, i, [i] * 50), "sensor_msgs/msg/LaserScan"))
            writer.add_message(laser, i, data, i)
            writer.add_message(text, i, b"{}", i)
        writer.finish()
    recording = io.open_recording(path)
    assert not recording.truncated
    assert [(t.name, t.count) for t in recording.topics + recording.others] == [("/scan", 3), ("/log", 3)]
    assert [m.ranges[0] for m in recording.messages()] == [1, 2, 3]


def test_our_mcap_is_a_ros2_bag_to_others(tmp_path):
    from rosbags.highlevel import AnyReader

    path = write(tmp_path, "mcap", drive(), types=DRIVE_TYPES)
    with AnyReader([path]) as bag:
        types = {c.topic: c.msgtype for c in bag.connections}
        assert types == {
            "/scan": "sensor_msgs/msg/LaserScan",
            "/ego_pose": "geometry_msgs/msg/PoseStamped",
            "/truth/car_1": "visualization_msgs/msg/Marker",
            "/truth/walker": "geometry_msgs/msg/TransformStamped",
            "/drive": "nav_msgs/msg/Odometry",
        }
        boxes = [c for c in bag.connections if c.topic == "/truth/car_1"]
        marker = bag.deserialize(next(bag.messages(boxes))[2], boxes[0].msgtype)
        assert (marker.ns, marker.scale.x, marker.scale.y) == ("car_1", 4.2, 1.8)


# ------------------------------------------------------------------ which topics


def recording_of(tmp_path, messages, types=None):
    return io.open_recording(write(tmp_path, "mcap", messages, types=types))


def test_the_scanner_with_most_messages_is_taken(tmp_path):
    messages = [scan(0, topic="/b"), scan(1, topic="/a"), scan(2, topic="/c"), scan(3, topic="/c")]
    recording = recording_of(tmp_path, messages)
    assert io.choose_topics(recording).scan == "/c"
    assert io.choose_topics(recording, Named(scan_topic="/a")).scan == "/a"
    (tmp_path / "less").mkdir()
    assert io.choose_topics(recording_of(tmp_path / "less", messages[:3])).scan == "/a"


def test_odometry_goes_before_names_and_is_never_truth(tmp_path):
    types = {"/wheels": "nav_msgs/msg/Odometry", "/filtered": "nav_msgs/msg/Odometry"}
    messages = [scan(), pose(1, "/base_pose"), pose(2, "/wheels"), pose(3, "/wheels"), pose(4, "/filtered")]
    chosen = io.choose_topics(recording_of(tmp_path, messages, types))
    assert chosen == io.Chosen("/scan", "/wheels", ("/base_pose",))


def test_truth_is_every_other_pose_but_goals(tmp_path):
    names = ["/move_base/goal", "/initialpose", "/red_pose", "/truth/ego_twin", "/my/self_pose"]
    chosen = io.choose_topics(recording_of(tmp_path, [scan(), *(pose(i, n) for i, n in enumerate(names))]))
    assert chosen == io.Chosen("/scan", "/my/self_pose", ("/red_pose", "/truth/ego_twin"))


def test_ego_and_truth_can_be_named_or_switched_off(tmp_path):
    recording = recording_of(tmp_path, drive())
    named = Named(ego_topic="/truth/walker", truth_topics=("/ego_pose",))
    assert io.choose_topics(recording, named) == io.Chosen("/scan", "/truth/walker", ("/ego_pose",))
    off = Named(ego_topic="none", truth_topics=("none",))
    assert io.choose_topics(recording, off) == io.Chosen("/scan", None, ())


def test_without_a_pose_the_sensor_stands(tmp_path):
    assert io.choose_topics(recording_of(tmp_path, [scan()])) == io.Chosen("/scan", None, ())


# ------------------------------------------------------------------ what is inside


def test_describe_counts_and_measures(tmp_path):
    ranges = [np.nan, np.inf, 0.0, 0.01, 9.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    messages = [scan(i, ranges, scan_time=single(7.8e-5)) for i in range(5)] + [pose(0, at_ns=10**9)]
    info = io.describe(write(tmp_path, "mcap", messages))
    ego, laser = info.topics
    assert (ego.role, laser.role, info.chosen.scan, info.problem) == ("ego", "scan", "/scan", "")
    assert laser.rate_hz == pytest.approx(1 / 0.0775)
    assert laser.delay_s == pytest.approx(0.003000001)
    assert laser.scan.invalid == pytest.approx(
        {"nan": 0.1, "inf": 0.1, "zero": 0.1, "below": 0.1, "above": 0.1}
    )
    assert laser.scan.period_s == pytest.approx(0.0775)
    assert laser.scan.header_scan_time_s == (single(7.8e-5),) * 2
    assert laser.scan.beams == (10, 10)
    assert laser.scan.angle_max_rad[0] == pytest.approx(-3.1 + 9 * 0.0175)
    assert laser.scan.backward_stamps == 0


def test_describe_sees_stamps_that_go_back(tmp_path):
    messages = [scan(0), scan(1), scan(2, stamp_ns=scan(0).stamp_ns), scan(80)]
    laser = io.describe(write(tmp_path, "csv", messages)).topics[0].scan
    assert laser.backward_stamps == 1
    assert laser.longest_gap_s == pytest.approx(80 * 0.0775)


# ------------------------------------------------------------------ writing


@pytest.mark.parametrize("target", TARGETS)
def test_nothing_is_overwritten_without_force(tmp_path, target):
    name, format = TARGETS[target]
    write(tmp_path, target, drive(3))
    with pytest.raises(InputError, match="exists"):
        io.write_recording(tmp_path / name, drive(1), format=format)
    check_equal(io.open_recording(tmp_path / name).messages(), drive(3))
    assert io.write_recording(tmp_path / name, drive(1), force=True, format=format) == len(drive(1))
    check_equal(io.open_recording(tmp_path / name).messages(), drive(1))
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("target", TARGETS)
def test_a_recording_can_be_converted_onto_itself(tmp_path, target):
    path = write(tmp_path, target, drive(3))
    io.convert(path, path, force=True, format=TARGETS[target][1])
    check_equal(io.open_recording(path).messages(), drive(3))


def test_force_never_removes_a_folder_that_is_no_bag(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "one.jpg").touch()
    with pytest.raises(InputError, match="no ROS 2 bag"):
        io.write_recording(tmp_path / "photos", drive(1), force=True)
    assert (tmp_path / "photos" / "one.jpg").exists()


def test_force_replaces_a_file_by_a_folder_and_back(tmp_path):
    (tmp_path / "run").write_text("old")
    io.write_recording(tmp_path / "run", drive(1), force=True)
    check_equal(io.open_recording(tmp_path / "run").messages(), drive(1))
    io.write_recording(tmp_path / "run", drive(2), force=True, format="ros2-sqlite3")
    check_equal(io.open_recording(tmp_path / "run").messages(), drive(2))


def test_a_new_format_is_one_file():
    named = {f.name for f in io.formats()}
    assert named == {"csv", "mcap", "parquet", "ros1", "ros1-xz", "ros2-mcap", "ros2-sqlite3"}
    assert len(named) == len(io.formats())


# ------------------------------------------------------------------ memory


@pytest.mark.parametrize("target", TARGETS)
def test_memory_does_not_grow_with_the_recording(tmp_path, target):
    """Twice the messages need at most a quarter more than an index entry each."""

    def peak(n):
        messages = (scan(i, np.full(720, 1.0 + i)) for i in range(n))
        path = tmp_path / str(n)
        path.mkdir()
        path = write(path, target, messages)
        return min(once(path) for _ in range(3))  # how far ahead a reading thread is, is chance

    def once(path):
        before = pa.total_allocated_bytes()
        tracemalloc.start()
        most = 0
        for _ in io.open_recording(path).messages():
            most = max(most, pa.total_allocated_bytes() - before)
        python = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return python + most

    small, large = peak(1500), peak(3000)
    assert large < small + 1500 * 300 + 0.25 * small
