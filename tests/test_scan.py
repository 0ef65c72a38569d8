"""Raw messages become repaired scans: masked, timed, de-skewed; and bad input never stops the stream."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra.numpy import arrays

from made_scans import PERIOD, T0, drive, look, mounted, ns, off_the_walls, path, pose, raw_scan
from outrider import repair as rp
from outrider.ego import EgoBuffer
from outrider.geometry import wrap
from outrider.scan import ScanStream, prepare
from outrider.settings import Detect, Mount, Recording, Settings, Timing
from outrider.timing import resolve

PLAIN = Settings()
WALL = np.full(360, 5.0)


def one(raw, settings=PLAIN, ego=None):
    return rp.repair(raw, resolve(raw, PERIOD, settings.timing), ego, settings)


def several(n=5, **fields):
    return [raw_scan(WALL, T0 + k * PERIOD, **fields) for k in range(n)]


def run(messages, ego=None, settings=PLAIN):
    stream = ScanStream(messages, "scan", ego, settings)
    return list(stream), stream.report


# ------------------------------------------------------------------ masks


@given(
    arrays(np.float32, some.integers(0, 60), elements=some.floats(width=32)),
    some.floats(0.0, 10.0),
    some.floats(10.0, 1e300),
)
def test_each_beam_is_valid_or_masked_for_one_reason(ranges, low, high):
    valid, masked = rp.mask(ranges, low, high)
    assert int(valid.sum()) + sum(masked.values()) == len(ranges)
    assert all(count > 0 for count in masked.values())
    assert np.isfinite(ranges[valid]).all()
    assert (ranges[valid] > 0.0).all()


def test_beams_are_masked_by_reason():
    ranges = [np.nan, np.nan, np.inf, -np.inf, 0.0, -1.0, 0.05, 40.0, 41.0, 5.0, 0.1]
    scan = one(raw_scan(ranges))
    assert scan.masked == {"nan": 2, "infinite": 2, "not_positive": 2, "below_min": 1, "above_max": 2}
    assert scan.valid.tolist() == [False] * 9 + [True, True]


def test_masked_beams_are_nan_and_only_they():
    ranges = np.where(np.arange(360) % 10 == 0, np.nan, 5.0)
    scan = one(raw_scan(ranges))
    assert scan.masked == {"nan": 36}
    assert np.array_equal(np.isnan(scan.range), ~scan.valid)
    assert np.array_equal(np.isnan(scan.W_p).any(axis=1), ~scan.valid)
    assert np.isfinite(scan.W_sensor).all()


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf, -1.0])
def test_unusable_range_max_is_replaced_by_the_setting(bad):
    settings = Settings(detect=Detect(max_range_m=30.0), recording=Recording(scale=10.0))
    scan = one(raw_scan([2.9, 3.1], range_max=bad), settings)
    assert scan.range_max == pytest.approx(30.0)
    assert scan.valid.tolist() == [True, False]
    assert any(f.startswith(rp.LIMITS) and "3 m taken" in f for f in scan.faults)


@pytest.mark.parametrize("bad", [np.nan, -0.5])
def test_unusable_range_min_is_taken_as_zero(bad):
    scan = one(raw_scan([0.01, 5.0], range_min=bad))
    assert scan.valid.all()
    assert [rp.kind(f) for f in scan.faults] == [rp.LIMITS]


# ------------------------------------------------------------------ de-skew


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.1, 0.7)])
@pytest.mark.parametrize("shrink", [1.0, 10.0])
def test_walls_seen_while_driving_and_turning_are_straight(backward, mount, shrink):
    offset = 0.06 if backward else 0.0
    x, y, yaw = mount
    settings = Settings(
        timing=Timing(stamp_offset_s=offset),
        mount=Mount(x_m=x / shrink, y_m=y / shrink, yaw_rad=yaw),
        recording=Recording(scale=shrink),
    )
    messages = drive(mount=mount, backward=backward, offset=offset, shrink=shrink)
    scans, report = run(messages, "ego", settings)
    assert len(scans) == 40
    assert report.faults == {}
    for scan in scans:
        assert off_the_walls(scan.W_p[scan.valid]).max() < 1e-3
        error = scan.W_sensor - mounted(path(scan.beam_t), mount)
        assert np.abs(np.column_stack([error[:, :2], wrap(error[:, 2])])).max() < 1e-3
        assert scan.t == scan.beam_t.max()
        assert scan.range_max == pytest.approx(40.0 * shrink)


def test_without_de_skew_the_same_walls_are_crooked():
    backward, _ = run(drive(backward=True), "ego", Settings(timing=Timing(time_increment_s=PERIOD / 360)))
    frozen, _ = run(drive(), "ego", Settings(timing=Timing(time_increment_s=0.0)))
    for scans in (backward, frozen):
        assert max(np.percentile(off_the_walls(s.W_p[s.valid]), 95) for s in scans) > 0.03


def test_a_standing_sensor_sees_what_it_measures():
    angle = -np.pi + 2 * np.pi / 360 * np.arange(360)
    ranges = look(np.zeros((360, 3)), angle, [(0.0, 5.0), (np.pi, 3.0)])
    scan = one(raw_scan(ranges))
    flat = scan.range[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    assert scan.W_p == pytest.approx(flat, nan_ok=True)
    assert not scan.ego.known
    assert scan.ego.W_pose.tolist() == [0.0, 0.0, 0.0]
    assert scan.W_sensor.tolist() == np.zeros((360, 3)).tolist()


def test_the_mount_of_a_standing_sensor_moves_its_points():
    scan = one(raw_scan(WALL), Settings(mount=Mount(x_m=1.0, y_m=2.0, yaw_rad=np.pi / 2)))
    assert np.hypot(*(scan.W_p - [1.0, 2.0]).T) == pytest.approx(5.0)
    assert scan.W_p[180] == pytest.approx([1.0, 7.0])


@given(some.floats(0.01, 100.0))
def test_scale_multiplies_every_length(scale):
    buffers = [EgoBuffer(1.0), EgoBuffer(scale)]
    for buffer in buffers:
        for t in np.arange(T0, T0 + 0.3, 0.01):
            buffer.add(pose(t, *path(t)))
    mount = Mount(x_m=0.2, y_m=0.1, yaw_rad=0.3)
    raw = raw_scan(WALL, T0 + 0.1)
    plain = one(raw, Settings(mount=mount), buffers[0])
    scaled = one(raw, Settings(mount=mount, recording=Recording(scale=scale)), buffers[1])
    assert scaled.W_p == pytest.approx(scale * plain.W_p)
    assert scaled.range == pytest.approx(scale * plain.range)
    assert scaled.W_sensor[:, 2] == pytest.approx(plain.W_sensor[:, 2])
    assert scaled.ego.W_v == pytest.approx(scale * plain.ego.W_v)
    assert scaled.ego.yaw_rate == pytest.approx(plain.ego.yaw_rate)


# ------------------------------------------------------------------ the ego pose


def buffer_of(t, at=path):
    buffer = EgoBuffer()
    for time in t:
        assert buffer.add(pose(time, *at(time)))
    return buffer


def straight(t):
    s = t - T0
    return np.array([2.0 * s, -1.0 * s, 3.0 * s])


def test_velocity_of_a_straight_drive_across_the_end_of_the_circle():
    buffer = buffer_of(T0 + np.arange(0.0, 3.0, 0.01), straight)
    scan = one(raw_scan(WALL, T0 + 2.5), ego=buffer)
    assert scan.ego.known
    assert scan.ego.W_v == pytest.approx([2.0, -1.0], abs=1e-4)
    assert scan.ego.yaw_rate == pytest.approx(3.0, abs=1e-4)
    assert (np.abs(scan.W_sensor[:, 2]) <= np.pi).all()


def test_a_pose_is_carried_on_a_little_and_then_held():
    buffer = buffer_of(T0 + np.arange(0.0, 0.5, 0.01), straight)
    newest = buffer.newest
    at = buffer.at(newest + np.array([0.05, 0.1, 0.5]))
    assert at[0] == pytest.approx([*straight(newest + 0.05)], abs=1e-4)
    assert at[2] == pytest.approx(at[1])
    late = one(raw_scan(WALL, newest + 0.4), ego=buffer)
    assert late.ego.W_v.tolist() == [0.0, 0.0]
    assert late.faults == ("ego pose stale by 0.50 s",)


def test_poses_that_are_no_use_are_left_out_and_counted():
    good = [pose(T0 + 0.01 * k, 0.01 * k, 0.0, 0.0) for k in range(100)]
    bad = [
        pose(T0 + 0.5, np.nan, 0.0, 0.0),
        pose(T0 + 0.5, 0.0, 0.0, 0.0, quaternion=np.zeros(4)),
        pose(T0 + 0.5, 0.0, 0.0, 0.0, quaternion=np.full(4, np.nan)),
        pose(T0 + 0.2, 9.0, 9.0, 0.0),
        good[-1],
    ]
    scans, report = run([*good[:50], *bad[:4], *good[50:], bad[4], *several()], "ego")
    assert report.poses_in == 105
    assert report.poses_left_out == 5
    assert np.abs(scans[0].W_sensor[:, 1]).max() == 0.0


def test_a_long_quaternion_gives_the_same_yaw():
    buffer = EgoBuffer()
    buffer.add(pose(T0, 1.0, 2.0, 0.8, quaternion=3.0 * np.array([0, 0, np.sin(0.4), np.cos(0.4)])))
    assert buffer.at(np.array([T0]))[0] == pytest.approx([1.0, 2.0, 0.8])


def test_scans_wait_for_the_pose_after_their_last_beam():
    stream = ScanStream((), "scan", "ego", PLAIN, head=1)
    for t in np.arange(T0, T0 + 0.1, 0.01):
        assert stream.feed(pose(t, *path(t))) == []
    assert stream.feed(raw_scan(WALL, T0, received_ns=ns(T0 + 0.09))) == []
    (scan,) = stream.feed(pose(T0 + 0.1, *path(T0 + 0.1)))
    assert scan.faults == ()


def test_scans_do_not_wait_for_ever_for_poses():
    stream = ScanStream((), "scan", "ego", PLAIN, head=1)
    given = [(k, stream.feed(raw)) for k, raw in enumerate(several(8))]
    late = [k for k, scans in given if scans]
    assert late[0] == 4  # 0.2 s and one period after its receive time
    assert rp.POSE_MISSING in given[4][1][0].faults
    assert len(stream.finish()) + sum(len(scans) for _, scans in given) == 8


def test_when_the_pose_begins_late_the_memory_must_restart():
    poses = [pose(t, 9.0, 9.0, 0.0) for t in np.arange(T0 + 3.0, T0 + 6.0, 0.01)]
    messages = sorted([*several(50), *poses], key=lambda m: m.received_ns)
    scans, report = run(messages, "ego")
    begins = [s for s in scans if rp.restarts(s)]
    assert len(begins) == 1
    assert rp.POSE_BEGINS in begins[0].faults
    assert report.faults[rp.POSE_MISSING] == scans.index(begins[0])
    assert {s.ego.known for s in scans[: scans.index(begins[0])]} == {False}


def test_a_pose_that_freezes_in_full_drive_is_told():
    stop = T0 + 2.0
    poses = [pose(t, *straight(min(t, stop))) for t in np.arange(T0, T0 + 4.0, 0.01)]
    scans, report = run(sorted([*several(38), *poses], key=lambda m: m.received_ns), "ego")
    told = [s for s in scans if any(f.startswith(rp.POSE_FROZEN) for f in s.faults)]
    assert stop + 0.3 < told[0].t < stop + 0.5
    assert [rp.kind(f) for f in told[0].faults] == [rp.POSE_FROZEN]
    assert float(told[0].faults[0].split()[4]) == pytest.approx(stop, abs=0.0101)
    assert report.faults == {rp.POSE_FROZEN: len(told)}
    assert told[-1] is scans[-1]


def test_a_body_that_brakes_and_then_stands_is_not_frozen():
    def brake(t):
        s = min(t - T0, 1.0)
        return np.array([2.0 * s - 1.0 * s * s, 0.0, 0.0])  # from 2 m/s to 0 within a second

    buffer = buffer_of(T0 + np.arange(0.0, 3.0, 0.01), brake)
    assert np.isnan(buffer.frozen_since)


def test_a_pose_repeated_between_updates_is_not_frozen():
    def slow_source(t):
        return straight(T0 + np.floor((t - T0) * 20.0 + 1e-6) / 20.0)

    buffer = EgoBuffer()
    for t in T0 + np.arange(0.0, 3.0, 0.01):
        buffer.add(pose(t, *slow_source(t)))
        assert np.isnan(buffer.frozen_since)


def test_the_pose_buffer_stays_small():
    buffer = EgoBuffer()
    for k in range(20_000):
        buffer.add(pose(T0 + 0.01 * k, 0.0, 0.0, 0.0))
        buffer.forget(T0 + 0.01 * k - 1.0)
    assert len(buffer) < 110
    assert len(buffer._t) < 1000


# ------------------------------------------------------------------ bad input


def test_clean_scans_have_no_fault():
    scans, report = run(several(30))
    assert [s.t for s in scans] == sorted(s.t for s in scans)
    assert report.faults == report.skipped == report.masked == {}
    assert (report.scans_in, report.scans_out, report.beams, report.valid) == (30, 30, 10800, 10800)
    assert report.period_s == pytest.approx(PERIOD)


def replaced(k, **fields):
    scans = several()
    scans[k] = dataclasses.replace(scans[k], **fields)
    return run(scans)


def test_a_scan_without_beams_passes_empty():
    scans, report = replaced(2, ranges=np.empty(0, np.float32))
    assert len(scans) == 5
    assert scans[2].W_p.shape == (0, 2)
    assert scans[2].W_sensor.shape == (0, 3)
    assert scans[2].faults == (rp.NO_BEAMS,)
    assert scans[1].t < scans[2].t < scans[3].t
    assert report.faults == {rp.NO_BEAMS: 1}


def test_a_scan_without_beams_has_the_ego_state():
    buffer = buffer_of(T0 + np.arange(0.0, 1.0, 0.01), straight)
    scan = one(raw_scan([], T0 + 0.5), ego=buffer)
    assert scan.ego.W_pose == pytest.approx(straight(T0 + 0.6), abs=1e-4)


@pytest.mark.parametrize(
    "fields",
    [
        {"angle_increment": 0.0},
        {"angle_increment": np.nan},
        {"angle_increment": np.inf},
        {"angle_min": np.nan},
    ],
)
def test_a_scan_without_usable_angles_is_masked_whole(fields):
    scans, report = replaced(2, **fields)
    assert scans[2].masked == {"no_angle": 360}
    assert not scans[2].valid.any()
    assert report.masked == {"no_angle": 360}
    assert report.faults[rp.BAD_ANGLES] == 1
    assert scans[3].valid.all()


def test_a_scan_of_infinite_ranges_is_masked_whole():
    scans, report = replaced(2, ranges=np.full(360, np.inf, np.float32))
    assert scans[2].faults == (rp.NO_RETURN,)
    assert report.masked == {"infinite": 360}


def test_a_hundred_thousand_beams():
    scans, report = run([raw_scan(np.full(100_000, 5.0), T0 + k * PERIOD) for k in range(3)])
    assert report.valid == 300_000
    assert np.hypot(*scans[0].W_p.T) == pytest.approx(5.0)


def test_intensities_of_another_length_are_dropped():
    scans, report = replaced(2, intensities=np.ones(10, np.float32))
    assert scans[2].intensity.shape == (0,)
    assert scans[2].faults == ("intensities dropped: 10 for 360 beams",)
    assert report.faults == {rp.INTENSITIES: 1}
    scans, report = replaced(2, intensities=np.ones(360, np.float32))
    assert scans[2].intensity.shape == (360,)
    assert report.faults == {}


def test_the_second_of_two_equal_stamps_is_dropped():
    scans, report = replaced(2, stamp_ns=ns(T0 + PERIOD))
    assert len(scans) == 4
    assert report.skipped == {"duplicated stamp": 1}
    assert scans[2].faults == ("scan skipped: duplicated stamp, 1 of them",)


def test_a_late_scan_is_dropped():
    messages = several()
    messages[2], messages[3] = messages[3], messages[2]
    scans, report = run(messages)
    assert [s.t for s in scans] == sorted(s.t for s in scans)
    assert report.skipped == {"out of order": 1}
    assert scans[3].faults == ("scan skipped: out of order, 1 of them",)


def test_a_scan_that_ends_before_the_last_one_is_dropped():
    scans, report = replaced(2, stamp_ns=ns(T0 + 0.101), time_increment=-PERIOD / 360)
    assert report.skipped == {"ends before the last one": 1}
    assert len(scans) == 4


def test_a_gap_is_told():
    scans, report = run([*several(), *[raw_scan(WALL, T0 + 5.4 + k * PERIOD) for k in range(5)]])
    assert [s.faults for s in scans] == [()] * 5 + [("gap of 5.0 s",)] + [()] * 4
    assert report.faults == {rp.GAP: 1}


def test_a_clock_that_jumps_back_restarts_the_stream():
    scans, report = run([*several(30), *several(30)])
    told = [k for k, s in enumerate(scans) if s.faults]
    assert told == [30]
    assert scans[30].faults == ("clock jumped back by 2.9 s",)
    assert rp.restarts(scans[30])
    assert scans[30].t == scans[0].t
    assert report.scans_out == 60


def test_when_scans_and_poses_jump_back_the_poses_are_those_of_their_time():
    first = drive(scans=30)
    shift = T0 - 100.0 - first[-1].received_ns * 1e-9 - 0.1

    def moved(message):
        return dataclasses.replace(message, stamp_ns=message.stamp_ns + ns(shift))

    scans, report = run([*first, *map(moved, first)], "ego")
    assert len(scans) == 60
    assert [k for k, s in enumerate(scans) if rp.restarts(s)] == [30]
    assert max(off_the_walls(s.W_p[s.valid]).max() for s in scans) < 1e-3
    assert report.poses_left_out == 0


def test_scans_without_stamp_take_the_receive_time():
    scans, report = run(several(5, stamp_ns=0))
    assert [s.beam_t[0] for s in scans] == pytest.approx([T0 + PERIOD * (k + 1) for k in range(5)])
    assert [bool(s.faults) for s in scans] == [True, False, False, False, False]
    assert report.faults == {rp.NO_STAMP: 5}


def test_other_topics_are_not_touched():
    scans, report = run([*several(3, topic="rear"), *several(3), pose(T0, 0, 0, 0)])
    assert (len(scans), report.scans_in, report.poses_in) == (3, 3, 0)


def test_no_messages_no_scans():
    assert run([])[0] == []


@given(some.data())
def test_nothing_a_header_says_stops_the_stream(data):
    number = some.floats(width=32) | some.sampled_from([0.0, np.nan, np.inf, 0.1, 40.0])
    names = ["angle_min", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"]
    ranges = some.lists(number, max_size=8).map(lambda v: np.array(v, np.float32))
    raws = [
        raw_scan(
            data.draw(ranges),
            T0 + data.draw(some.floats(-20.0, 20.0)),
            **{name: data.draw(number) for name in names},
        )
        for _ in range(4)
    ]
    scans, report = run([pose(T0, 1.0, 2.0, 0.5), *raws], "ego")
    assert report.scans_in == 4 == report.scans_out + sum(report.skipped.values())
    assert report.beams == report.valid + sum(report.masked.values())
    for scan in scans:
        assert np.isfinite(scan.t)
        assert np.isfinite(scan.W_p[scan.valid]).all()
        assert all(rp.kind(f) in rp.KINDS for f in scan.faults)


# ------------------------------------------------------------------ the report


def test_the_report_is_plain_enough_for_json():
    stream = ScanStream(drive(scans=5), "scan", "ego", PLAIN)
    assert json.loads(json.dumps(stream.report.as_dict()))["period_s"] is None
    list(stream)
    values = json.loads(json.dumps(stream.report.as_dict(), allow_nan=False))
    assert values["scans_out"] == 5
    assert values["period_s"] == pytest.approx(PERIOD)


def test_stream_feed_and_prepare_give_the_same():
    messages = drive(scans=30)
    live = ScanStream((), "scan", "ego", PLAIN)
    fed = [scan for message in messages for scan in live.feed(message)] + live.finish()
    for other in (list(prepare(messages, "scan", "ego", PLAIN)), run(messages, "ego")[0]):
        assert [s.t for s in other] == [s.t for s in fed]
        assert all(np.array_equal(a.W_p, b.W_p, equal_nan=True) for a, b in zip(other, fed, strict=True))


def test_every_kind_of_fault_is_explained(request):
    page = (request.config.rootpath / "docs" / "scans.md").read_text()
    assert [k for k in rp.KINDS if f"`{k}" not in page] == []
