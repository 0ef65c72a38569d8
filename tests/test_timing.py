"""Time of each beam: headers are repaired by a stated rule, and ego motion tells the order of beams."""

import lzma
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from made_scans import PERIOD, T0, drive, raw_scan
from outrider.records import LaserScan, Pose
from outrider.scan import ScanStream
from outrider.settings import Mount, Recording, Settings, Timing
from outrider.timing import detect, measure_period, resolve, survey

NOBODY = Timing()
CAR = Settings(mount=Mount(x_m=-0.1686, y_m=0.0220, yaw_rad=0.0020), recording=Recording(scale=10.0))


# ------------------------------------------------------------------ the rule


def test_a_right_header_is_kept():
    timing = resolve(raw_scan(np.ones(360)), 0.1003, NOBODY)
    assert timing.time_increment == PERIOD / 360
    assert timing.stamp_offset == 0.0
    assert timing.repairs == ()
    assert not timing.repaired


@pytest.mark.parametrize("wrong", [0.0, np.nan, np.inf, 7.8e-5, 0.079, 0.121])
def test_scan_time_more_than_a_fifth_off_is_repaired(wrong):
    timing = resolve(raw_scan(np.ones(360), scan_time=wrong), PERIOD, NOBODY)
    assert timing.period == PERIOD
    assert [r.split(":")[0] for r in timing.repairs] == ["scan_time repaired"]


@pytest.mark.parametrize("right", [0.081, 0.119])
def test_scan_time_less_than_a_fifth_off_is_not(right):
    assert resolve(raw_scan(np.ones(360), scan_time=right), PERIOD, NOBODY).repairs == ()


@given(some.floats(-3.0, 3.0), some.sampled_from([1.0, -1.0]))
def test_beams_must_take_half_to_all_of_a_turn(share, sign):
    header = share * PERIOD / 360
    timing = resolve(raw_scan(np.ones(360), time_increment=header), PERIOD, NOBODY)
    if 0.5001 < abs(share) < 1.0499:
        assert timing.time_increment == header
    elif not 0.4999 < abs(share) < 1.0501:
        assert timing.time_increment == pytest.approx(np.copysign(PERIOD / 360, share))
        assert timing.repaired


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
def test_an_increment_that_is_no_number_becomes_the_nominal_one(bad):
    timing = resolve(raw_scan(np.ones(360), time_increment=bad), PERIOD, NOBODY)
    assert timing.time_increment == pytest.approx(PERIOD / 360)


def test_a_sensor_that_does_not_see_all_around_takes_its_share_of_the_turn():
    raw = raw_scan(np.ones(270), angle_increment=np.deg2rad(1.0), time_increment=0.0)
    assert resolve(raw, PERIOD, NOBODY).time_increment == pytest.approx(PERIOD / 360)


def test_the_user_is_right():
    user = Timing(scan_time_s=0.2, time_increment_s=-1e-4, stamp_offset_s=0.03)
    timing = resolve(raw_scan(np.ones(360), scan_time=np.nan), PERIOD, user)
    assert (timing.period, timing.time_increment, timing.stamp_offset) == (0.2, -1e-4, 0.03)
    assert timing.repairs == ()


def test_one_scan_alone_has_the_period_of_its_header_or_the_default():
    assert resolve(raw_scan(np.ones(360), scan_time=0.05), np.nan, NOBODY).period == 0.05
    timing = resolve(raw_scan(np.ones(360), scan_time=0.0), np.nan, NOBODY)
    assert timing.period == 0.1
    assert timing.repairs[0].startswith("scan_time repaired")


def test_the_scan_ends_with_its_last_beam_in_time():
    for step in (1e-4, -1e-4, 0.0):
        timing = resolve(raw_scan(np.ones(360)), PERIOD, Timing(time_increment_s=step, stamp_offset_s=0.02))
        assert timing.end(T0, 360) == pytest.approx(timing.beam_t(T0, 360).max(), abs=1e-6)


def test_the_period_survives_gaps_duplicates_and_stamps_that_alternate():
    steps = np.where(np.arange(20) % 4 == 0, 0.0717, 0.0798)
    stamps = T0 + np.concatenate([[0.0], np.cumsum(steps)])
    assert measure_period(stamps) == pytest.approx(steps.mean(), abs=1e-6)
    stamps[11:] += 5.0
    assert measure_period(np.repeat(stamps, 2)) == pytest.approx(steps.mean(), abs=5e-4)
    assert np.isnan(measure_period([T0, T0]))
    assert np.isnan(measure_period([]))


# ------------------------------------------------------------------ the order of the beams


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("offset", [0.0, 0.055, -0.04])
def test_a_drive_through_a_room_shows_order_and_offset(backward, offset):
    mount = Mount(x_m=0.3, y_m=-0.1, yaw_rad=0.7)
    messages = drive(60, 180, (0.3, -0.1, 0.7), backward, offset, time_increment=1e-7)
    found = survey(messages, "scan", "ego", Settings(mount=mount))
    assert found.confident
    assert found.time_increment == pytest.approx((-1 if backward else 1) * PERIOD / 180, rel=0.01)
    assert found.stamp_offset == pytest.approx(offset, abs=0.006)
    assert (found.backward < found.forward) == backward


def split(messages):
    scans = [m for m in messages if isinstance(m, LaserScan)]
    return scans, [m for m in messages if isinstance(m, Pose)]


def test_a_body_that_stands_shows_nothing():
    scans, poses = split(drive(60, 180))
    still = [poses[0].__class__(**(fields(p) | {"position": np.zeros(3)})) for p in poses]
    still = [p.__class__(**(fields(p) | {"quaternion": np.array([0.0, 0.0, 0.0, 1.0])})) for p in still]
    found = detect(scans, still, Settings())
    assert not found.confident
    assert found.scans == 0
    assert "sign of the header kept" in found.words


def fields(record):
    return {name: getattr(record, name) for name in record.__slots__}


def test_poses_of_another_drive_show_nothing():
    scans, poses = split(drive(60, 180, time_increment=1e-7))
    rng = np.random.default_rng(4)
    yaw = np.cumsum(rng.normal(0.0, 0.05, len(poses)))
    other = [
        p.__class__(**(fields(p) | {"quaternion": np.array([0.0, 0.0, np.sin(a / 2), np.cos(a / 2)])}))
        for p, a in zip(poses, yaw, strict=True)
    ]
    assert not detect(scans, other, Settings()).confident


def test_no_survey_where_nothing_is_in_doubt():
    messages = drive(30, 90)
    wrong = drive(30, 90, time_increment=0.0)
    assert survey(messages, "scan", "ego", Settings()) is None
    assert survey(wrong, "scan", None, Settings()) is None
    assert survey(wrong, "scan", "ego", Settings(timing=Timing(time_increment_s=1e-3))) is None
    assert survey([], "scan", "ego", Settings()) is None


def test_a_survey_reads_no_more_than_it_needs():
    messages = iter(drive(200, 90))
    assert survey(messages, "scan", "ego", Settings()) is None
    assert sum(isinstance(m, LaserScan) for m in messages) == 200 - 21


def test_a_doubtful_estimate_changes_nothing():
    messages = drive(30, 90, time_increment=0.0)
    scans, poses = split(messages)
    doubt = detect(scans[:10], poses, Settings())
    assert not doubt.confident
    stream = ScanStream(messages, "scan", "ego", Settings(), doubt)
    first = next(iter(stream))
    assert stream.report.time_increment_s == pytest.approx(PERIOD / 90)
    assert stream.report.stamp_offset_s == 0.0
    assert any("sign of the header kept" in fault for fault in first.faults)


# ------------------------------------------------------------------ real recordings


def bag(data, folder, name):
    """Scans and poses of a packed ROS 1 bag, in receive order."""
    from rosbags.highlevel import AnyReader

    path = folder / f"{name.split('/')[-1]}.bag"
    path.write_bytes(lzma.decompress((data / f"{name}.bag.xz").read_bytes()))
    messages = []
    with AnyReader([path]) as reader:
        for c, received, raw in reader.messages():
            if c.msgtype == "sensor_msgs/msg/LaserScan":
                m = reader.deserialize(raw, c.msgtype)
                numbers = (m.angle_min, m.angle_increment, m.time_increment, m.scan_time, m.range_min)
                where = (c.topic, m.header.frame_id, stamp(m), received)
                messages.append(LaserScan(*where, *numbers, m.range_max, m.ranges, m.intensities))
            elif c.msgtype == "geometry_msgs/msg/PoseStamped":
                m = reader.deserialize(raw, c.msgtype)
                p, q = m.pose.position, m.pose.orientation
                place = (np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w]), np.empty(0))
                messages.append(Pose(c.topic, m.header.frame_id, "", stamp(m), received, *place))
    return messages


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.mark.parametrize("name", ["overtakes", "parallel", "overtake_ego"])
def test_the_clockwise_lidar_of_the_model_car_is_found_out(name, data, tmp_path):
    messages = bag(data, tmp_path, f"datmo_2dlidar/bags/{name}")
    found = survey(iter(messages), "/scan", "/ego_pose", CAR)
    assert found.confident
    assert found.time_increment == pytest.approx(-0.977 * 0.0775 / 360, rel=0.04)
    assert found.stamp_offset == pytest.approx(0.0591, abs=0.008)
    stream = ScanStream(messages, "/scan", "/ego_pose", CAR, found)
    scans = list(stream)
    report = stream.report
    assert report.period_s == pytest.approx(0.0775, rel=0.01)
    assert report.scans_out == report.scans_in == len(scans)
    assert [r.split(":")[0] for r in report.repairs[:2]] == ["scan_time repaired", "time_increment repaired"]
    assert "against time" in report.repairs[2]
    assert set(report.masked) == {"infinite", "above_max"}
    assert all(a.t < b.t for a, b in pairwise(scans))
    frozen = [k for k, s in enumerate(scans) if any(f.startswith("ego pose frozen") for f in s.faults)]
    assert frozen == (list(range(110, 135)) if name == "overtake_ego" else [])


def test_the_real_walls_become_sharper_with_the_right_order(data, tmp_path):
    messages = bag(data, tmp_path, "datmo_2dlidar/bags/parallel")
    right = Settings(mount=CAR.mount, timing=Timing(time_increment_s=-2.15e-4, stamp_offset_s=0.0591))
    wrong = Settings(mount=CAR.mount, timing=Timing(time_increment_s=2.15e-4))
    spread = []
    for settings in (right, wrong):
        p = np.concatenate([s.W_p[s.valid] for s in ScanStream(messages, "/scan", "/ego_pose", settings)])
        off = p[:, 0] - (4.80 - 0.015 * p[:, 1])  # the east wall of the room
        near = np.abs(off[(p[:, 1] > -2.4) & (p[:, 1] < 1.1)])
        spread.append(np.median(near[near < 0.3]))
    assert spread[0] < 0.85 * spread[1]


@pytest.mark.parametrize("topic", ["/front_scan", "/rear_scan"])
def test_the_right_header_of_a_hokuyo_is_kept(topic, data, tmp_path):
    messages = bag(data, tmp_path, "tysik_two_hokuyo/scans_demo")
    stream = ScanStream(messages, topic, None, Settings())
    scans = list(stream)
    assert stream.report.repairs == []
    assert stream.report.skipped == {}
    assert stream.report.masked["below_min"] > 0
    assert stream.report.period_s == pytest.approx(0.1, rel=0.02)
    assert scans[0].beam_t[-1] - scans[0].beam_t[0] == pytest.approx(725 * 9.765627e-05)
