"""A lidar on a serial port, through all that a bumpy ride does to it; the emulator is in its own process.

Each story of a fault takes some seconds of true time, so all are lived through at once, and each test looks
at what came of one.
"""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from made_lidars import Lidar, Log, from_edge, staircase
from outrider.errors import InputError
from outrider.records import Raw, Trouble, Turn
from outrider.rplidar import ports
from outrider.rplidar.decoder import BEHIND, Decoder
from outrider.rplidar.device import Device
from outrider.rplidar.line import STORED, Line
from outrider.rplidar.models import MODELS, Mode
from outrider.rplidar.ports import Listed, Setback
from outrider.rplidar.protocol import SHORT_REPLY_MAX

pytestmark = pytest.mark.once

BACK_S = 2.0  # good turns are back so soon after good data
CP210X = (0x10C4, 0xEA60)


@dataclass
class Clock:
    """Of the host, and it can be made to jump."""

    ahead: float = 0.0

    def __call__(self):
        return time.monotonic() + self.ahead


@dataclass
class Ride:
    """A lidar, whoever reads it, and what came of that."""

    lidar: Lidar
    device: Device
    clock: Clock
    log: Log = field(default_factory=Log)
    back_s: float = float("nan")  # from good data to a good turn

    def good(self, since=0.0, limit=10.0):
        """When the first turn came, after `since`, in which nothing is missing."""
        return self.log.wait(lambda e: isinstance(e, Turn) and not e.faults, since, limit)

    def trouble(self, word, since=0.0, limit=10.0):
        """When trouble came, after `since`, that speaks of this."""
        return self.log.wait(lambda e: isinstance(e, Trouble) and word in e.words, since, limit)[0]

    def recovered(self, since):
        """Good turns are there; how long that took from when data were good again."""
        self.back_s = self.good(since)[0] - since

    def words(self):
        return [event.words for event in self.log.of(Trouble)]


# ------------------------------------------------------------------ stories


def unplugged(ride):
    ride.good()
    at = time.monotonic()
    ride.lidar.order("unplug 1")
    ride.trouble("the lidar is gone", at)
    ride.trouble("no such port", at)
    ride.recovered(at + 1.0)


def stalled(ride):
    ride.good()
    at = time.monotonic()
    ride.lidar.order("stall 1")
    ride.trouble("stopped to protect itself (code 0x8001)", at)
    ride.recovered(at + 1.0)


def other_baud(ride):
    ride.good()
    ride.lidar.order("baud 256000")
    ride.recovered(ride.trouble("made no turn"))


def garbage(ride):
    ride.good()
    for _ in range(5):
        at = time.monotonic()
        ride.lidar.order("garbage 3000")
        time.sleep(0.15)
    ride.recovered(at)


def half_a_descriptor(ride):
    ride.recovered(ride.trouble("no whole answer to EXPRESS_SCAN"))


def bytes_lost(ride):
    ride.good()
    at = time.monotonic()
    ride.lidar.order("loss 0.3")
    ride.trouble("made no turn", at)
    time.sleep(2.0)
    assert not [e for t, e in ride.log.events if isinstance(e, Turn) and t > at + 0.3]
    at = time.monotonic()
    ride.lidar.order("loss 0")
    ride.recovered(at)


def slowed_down(ride):
    ride.good()
    ride.lidar.order("slow 2")
    at = time.monotonic()
    twice = ride.log.wait(lambda e: isinstance(e, Turn) and np.ptp(e.beam_t) > 0.19, at)[0]
    ride.recovered(twice)
    time.sleep(1.0)
    ride.lidar.order("slow 1")
    ride.log.wait(lambda e: isinstance(e, Turn) and np.ptp(e.beam_t) < 0.11, time.monotonic())


def suspended(ride):
    ride.good()
    at = time.monotonic()
    ride.lidar.asleep(5.0)
    ride.trouble("not one byte came", at)
    ride.trouble("nothing answers", at)
    ride.recovered(at + 5.0)


def clock_jumps(ride):
    for jump in (5.0, -12.0):
        time.sleep(0.3)
        ride.good()
        at = time.monotonic()
        ride.clock.ahead += jump
        ride.recovered(ride.trouble(f"{jump:.1f} s were lost", at))


def short_pause(ride):
    ride.good()
    at = time.monotonic()
    ride.lidar.order("pause 0.7")
    ride.log.wait(lambda e: isinstance(e, Turn) and any("silence" in f for f in e.faults), at)
    ride.recovered(at + 0.7)


STORIES: dict[Callable[[Ride], None], tuple[str, ...]] = {
    unplugged: ("S2", ""),
    stalled: ("A3", ""),
    other_baud: ("A1", ""),
    garbage: ("S2", "Dense"),
    half_a_descriptor: ("A1", "Express", "half"),
    bytes_lost: ("A1", "Express"),
    slowed_down: ("A1", "Standard"),
    suspended: ("S3", ""),
    clock_jumps: ("C1", ""),
    short_pause: ("S2", "UltraDense"),
}


def lived(story, folder):
    """A story from beginning to end; the sensor is at rest then, and what it gave is in order."""
    model, mode, *before = STORIES[story]
    clock = Clock()
    with Lidar(model, mode, folder / story.__name__, before) as lidar:
        ride = Ride(lidar, Device(lidar.port, mode or None, clock=clock), clock)
        ride.device.start(ride.log.put)
        try:
            story(ride)
            time.sleep(0.4)
            assert not ride.device.finished
        finally:
            ride.device.stop()
        end = time.monotonic() + 2.0
        while "mode none" not in (state := lidar.order("state")) and time.monotonic() < end:
            time.sleep(0.02)
        assert "mode none" in state
        assert "rpm 0" in state or model in ("A1", "C1")  # no DTR here, on which their motor hangs
    return ride


@pytest.fixture(scope="module")
def rides(tmp_path_factory):
    """By story, all at the same time; to be asked for the result."""
    folder = tmp_path_factory.mktemp("lidars")
    with ThreadPoolExecutor(len(STORIES)) as pool:
        yield {story: pool.submit(lived, story, folder) for story in STORIES}


@pytest.mark.parametrize("story", STORIES, ids=lambda story: story.__name__)
def test_good_turns_are_back_soon_after_good_data(rides, story):
    ride = rides[story].result()
    assert ride.back_s < BACK_S
    assert ride.device.finished
    counts = ride.device.about["counts"]
    assert counts["turns"] == len(ride.log.of(Turn))
    assert counts["bytes"] == sum(len(raw.data) for raw in ride.log.of(Raw))


@pytest.mark.parametrize("story", STORIES, ids=lambda story: story.__name__)
def test_turns_are_true_and_in_order_whatever_happens(rides, story):
    turns = rides[story].result().log.of(Turn)
    assert len(turns) > 3
    for turn in turns:
        inside = from_edge(turn.angle) > np.deg2rad(1.5)
        there = staircase(turn.angle[inside])
        off = np.abs(turn.range[inside] - there) > 0.01
        assert np.mean(off) < (0.05 if turn.faults else 1e-9), (turn.faults, np.flatnonzero(off))
        assert np.all(np.diff(turn.beam_t) > 0.0)
        assert turn.beam_t[-1] <= turn.received
    if story is not clock_jumps:
        ends = [t.beam_t[-1] for t in turns]
        assert all(later.beam_t[0] > end for end, later in zip(ends, turns[1:], strict=False))


def test_trouble_is_told_once_and_says_why(rides):
    for story in STORIES:
        words = rides[story].result().words()
        assert all(later != before for before, later in pairwise(words)), words
        assert all("\n" not in text and 10 < len(text) < 250 for text in words)
    for harmless in (garbage, slowed_down):
        words = rides[harmless].result().words()
        assert [text for text in words if "held up" not in text] == []  # a busy computer may hold us up


def test_a_slower_mirror_is_not_lost_and_not_hidden(rides):
    turns = rides[slowed_down].result().log.of(Turn)
    spans = np.array([np.ptp(turn.beam_t) for turn in turns if not turn.faults])
    slow = np.abs(spans - 0.2) < 0.02
    assert slow.sum() >= 3
    assert np.mean(slow | (np.abs(spans - 0.1) < 0.01)) > 0.6


def test_another_speed_is_found_by_itself(rides):
    about = rides[other_baud].result().device.about
    assert (about["baud"], about["sensor"], about["mode"]) == (256000, "RPLIDAR A1M8", "Express")


def test_garbage_and_lost_bytes_are_counted(rides):
    ride = rides[garbage].result()
    assert 10_000 < ride.device.about["counts"]["bytes_dropped"] < 40_000
    assert any("bytes were no samples" in fault for turn in ride.log.of(Turn) for fault in turn.faults)


def test_bytes_come_before_the_turn_they_end_and_decode_to_it_again(rides):
    ride = rides[half_a_descriptor].result()
    about = ride.device.about
    mode = Mode(0, about["mode"], about["answer"], about["sample_us"], about["range_max"])
    again = Decoder(mode, about["baud"], about["range_min"], BEHIND)
    decoded = []
    for _, event in ride.log.events:
        if isinstance(event, Raw):
            decoded += again.feed(event.data, event.received)
        elif isinstance(event, Turn):
            same = decoded.pop(0)
            np.testing.assert_array_equal(event.range, same.range)
            np.testing.assert_array_equal(event.beam_t, same.beam_t)
    assert decoded == []


# ------------------------------------------------------------------ ports


@pytest.fixture
def terminal():
    """A pseudo-terminal: our end, and the path of the other."""
    ours, theirs = os.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def refused(port):
    with pytest.raises(InputError) as caught:
        Device(port, clock=time.time).start(lambda event: None)
    return str(caught.value)


def test_a_port_that_cannot_be_used_is_one_line_that_says_what_to_do(terminal, tmp_path):
    assert refused("/dev/nowhere") == "/dev/nowhere: no such port; plug the lidar in or name another port"
    plain = tmp_path / "file"
    plain.write_text("")
    for wrong in (plain, tmp_path, "/dev/null"):
        assert refused(str(wrong)) == f"{wrong}: not a serial port; name the one the lidar is on"
    taken = ports.opened(terminal[1], 115_200)
    assert "in use by another program" in refused(terminal[1])
    taken.close()


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions of POSIX")
def test_a_port_without_permission_names_the_group_to_join(terminal):
    os.chmod(terminal[1], 0)
    nobody = os.geteuid() == 0
    if nobody:
        os.seteuid(65534)
    try:
        said = refused(terminal[1])
    finally:
        if nobody:
            os.seteuid(0)
    assert said.startswith(
        f"{terminal[1]}: permission denied; join its group (sudo usermod -aG dialout $USER)"
    )


def test_auto_asks_usb_bridges_only_and_takes_the_one_that_answers(terminal):
    with Lidar("A1") as lidar:
        listing = [
            Listed("/dev/ttyACM0", (0x2341, 0x0043), "Uno"),
            Listed(terminal[1], CP210X, "CP2102 USB to UART Bridge Controller"),
            Listed(lidar.port, CP210X, "CP2102 USB to UART Bridge Controller"),
        ]
        assert ports.candidates(lambda: listing) == sorted([terminal[1], lidar.port])
        log, device = Log(), Device(clock=time.time, listing=lambda: listing)
        assert device.about["port"] == "auto"
        device.start(log.put)
        log.wait(lambda e: isinstance(e, Turn))
        device.stop()
        device.stop()
    assert device.about["port"] == lidar.port
    assert log.of(Trouble) == []


def test_where_no_port_may_be_a_lidar_it_is_told_what_was_looked_at_and_waited():
    log, device = Log(), Device(clock=time.time, listing=lambda: [Listed("/dev/ttyS0", None, "")])
    device.start(log.put)
    _, trouble = log.wait(lambda e: isinstance(e, Trouble))
    device.stop()
    assert "CP210x" in trouble.words
    assert "saw only /dev/ttyS0 (not on USB)" in trouble.words
    with pytest.raises(Setback, match="no serial port at all"):
        ports.candidates(list)


def test_a_mode_that_is_not_there_or_not_decoded_is_told(tmp_path):
    with Lidar("A1") as lidar:
        for mode, words in (("Fast", "no mode 'Fast'"), ("boost", "84, which is under a patent")):
            log, device = Log(), Device(lidar.port, mode, clock=time.time)
            device.start(log.put)
            _, trouble = log.wait(lambda e: isinstance(e, Trouble))
            device.stop()
            assert words in trouble.words
            assert "'Standard' or 'Express'" in trouble.words


def test_noise_without_end_is_neither_kept_nor_an_answer(terminal):
    ours, path = terminal
    os.set_blocking(ours, False)
    line = Line(path, 115_200)
    noise = np.random.default_rng(0).bytes(3000) + b"\xa5\x5a\xff\x01\x00\x00\x04"

    def talk(seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                os.write(ours, noise)
            except BlockingIOError:
                time.sleep(0.001)

    with ThreadPoolExecutor(1) as pool:
        talking = pool.submit(talk, 1.0)
        for _ in range(3):
            with pytest.raises((Setback, InputError), match="GET_INFO"):
                line.info()
            assert len(line._buffer) < STORED + SHORT_REPLY_MAX + 7
        assert line.heard > 10_000
        assert 0 < len(line.read()) <= STORED
        talking.result()
    line.close()


def test_at_the_wrong_speed_nothing_is_understood():
    with Lidar("S2") as lidar:
        wrong = Line(lidar.port, 115_200)
        with pytest.raises(Setback):
            wrong.info()
        wrong.close()
        right = Line(lidar.port, MODELS["S2"].baud)
        assert right.info().model == MODELS["S2"].model
        right.close()
