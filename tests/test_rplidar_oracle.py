"""The maker's own software reads the emulator, which runs in a process of its own; so does ours, exactly."""

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from made_lidars import FOUR, Lidar, Log, from_edge, staircase, with_all_answers
from outrider.records import Trouble, Turn
from outrider.rplidar.capsules import BEGIN_MM, STEP_MM
from outrider.rplidar.device import Device
from outrider.rplidar.models import MODELS
from outrider.rplidar.protocol import Answer

pytestmark = pytest.mark.once

MODES = ("Standard", "Express", "Dense", "UltraDense")
CASES = [(model, mode) for model in ("A1", "S2") for mode in MODES]
TURNS = 3
EDGE = np.deg2rad(1.0)  # nearer to an edge of the staircase than this, either side may be seen
READER = """
import json, sys
import pyrplidarsdk
driver = pyrplidarsdk.RplidarDriver(port=sys.argv[1], baudrate=int(sys.argv[2]))
assert driver.connect()
info, turns = driver.get_device_info(), []
assert driver.start_scan()
while len(turns) < int(sys.argv[3]):
    turn = driver.get_scan_data()
    if turn:
        turns.append([list(map(float, column)) for column in turn])
driver.stop_scan()
driver.disconnect()
print(json.dumps({"model": info.model, "serial": info.serial_number, "turns": turns}))
"""


def seen_by_the_makers(lidar, baud):
    done = subprocess.run(
        [sys.executable, "-c", READER, lidar.port, str(baud), str(TURNS)],
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def seen_by_us(lidar, mode):
    device, log = Device(lidar.port, mode, clock=time.time), Log()
    device.start(log.put)
    try:
        log.wait(lambda e: len([t for t in log.of(Turn) if not t.faults]) >= TURNS)
    finally:
        device.stop()
    return [turn for turn in log.of(Turn) if not turn.faults], log.of(Trouble)


def both(case):
    """What the maker's reader and ours make of one emulator, one after the other."""
    model, mode = case
    with Lidar(model, mode) as lidar:
        theirs = seen_by_the_makers(lidar, MODELS[model].baud)
        between = lidar.order("state")
        return theirs, between, *seen_by_us(lidar, mode)


@pytest.fixture(scope="module")
def seen():
    """By case, some at the same time."""
    pytest.importorskip("pyrplidarsdk", reason="the maker's SDK has no wheel for this Python")
    with ThreadPoolExecutor(3) as pool:
        return dict(zip(CASES, pool.map(both, CASES), strict=True))


def sendable(answer, metres):
    """The range [m] that an answer can carry and that lies nearest."""
    if answer == Answer.STANDARD:
        return np.round(metres * 4000.0) / 4000.0
    if answer != Answer.ULTRA_DENSE:
        return np.round(metres * 1000.0) / 1000.0
    ends = [*BEGIN_MM[1:], 65000]
    every = np.concatenate([np.arange(b, e, s) for b, e, s in zip(BEGIN_MM, ends, STEP_MM, strict=True)])
    return every[nearest(every, metres * 1000.0)] / 1000.0


def nearest(rising, to):
    """Index of the value nearest to each of `to`."""
    above = np.clip(np.searchsorted(rising, to), 1, len(rising) - 1)
    return above - (to - rising[above - 1] < rising[above] - to)


@pytest.mark.parametrize(("model", "mode"), CASES)
def test_the_makers_reader_sees_what_there_is(seen, model, mode):
    theirs, state, _, _ = seen[model, mode]
    assert theirs["model"] == MODELS[model].model
    sample_us = with_all_answers(MODELS[model]).modes[MODES.index(mode)].sample_us
    errors = []
    beams = max(len(angle) for angle, _, _ in theirs["turns"])  # their reader drops some where it is held up
    assert beams == pytest.approx(1e5 / sample_us, rel=0.02)
    for angle, ranges, quality in theirs["turns"]:
        clockwise, ranges = np.array(angle), np.array(ranges)
        assert np.count_nonzero(ranges) > 0.98 * len(ranges)
        assert np.all(np.array(quality)[ranges > 0.0] > 0.0)
        errors.append(np.abs(ranges - staircase(-clockwise))[ranges > 0.0])
    errors = np.concatenate(errors)
    assert np.median(errors) < 0.002
    assert np.mean(errors < 0.006) > 0.9  # all but those near an edge
    assert state.startswith("state: mode none")


@pytest.mark.parametrize(("model", "mode"), CASES)
def test_our_reader_sees_exactly_what_was_sent(seen, model, mode):
    _, _, turns, troubles = seen[model, mode]
    assert troubles == []
    for turn in turns:
        inside = from_edge(turn.angle) > EDGE
        assert np.mean(inside) > 0.6
        there = staircase(turn.angle[inside]).astype(np.float32).astype(float)
        want = sendable(FOUR[MODES.index(mode)], there)
        np.testing.assert_array_equal(turn.range[inside], want.astype(np.float32))
        assert np.all(np.diff(turn.beam_t) > 0.0)
        assert turn.beam_t[-1] - turn.beam_t[0] == pytest.approx(
            0.1, rel=0.1
        )  # squeezed while its offset is learnt
        assert 0.0 < turn.received - turn.beam_t[-1] < 0.5
    assert max(np.ptp(turn.beam_t) for turn in turns) == pytest.approx(0.1, rel=0.05)


def test_both_readers_see_the_same_beams(seen):
    for case, (theirs, _, ours, _) in seen.items():
        fullest = max(theirs["turns"], key=lambda turn: len(turn[0]))
        clockwise, ranges, _ = (np.array(column) for column in fullest)
        angle = np.mod(-clockwise, 2.0 * np.pi)
        order = np.argsort(np.mod(ours[-1].angle, 2.0 * np.pi))
        mine, metres = np.mod(ours[-1].angle, 2.0 * np.pi)[order], ours[-1].range[order]
        same = nearest(mine, angle)
        inside = (from_edge(angle) > EDGE) & (from_edge(mine[same]) > EDGE) & (ranges > 0.0)
        assert np.mean(inside) > 0.6, case
        assert np.abs(mine[same] - angle)[inside].max() < EDGE, case
        np.testing.assert_allclose(metres[same][inside], ranges[inside], atol=1e-5)
