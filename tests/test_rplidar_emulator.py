"""The emulated lidar: what it sees and when, what it answers, and the command that runs it."""

import os

import numpy as np
import pytest

from made_lidars import scans
from outrider.cli.emulate import _simulated
from outrider.errors import InputError, OutputError
from outrider.records import LaserScan
from outrider.rplidar.decoder import Decoder
from outrider.rplidar.emulator import FAULTS, Emulator
from outrider.rplidar.models import MODELS
from outrider.rplidar.protocol import (
    Answer,
    Command,
    Conf,
    Health,
    Request,
    conf_request,
    express_request,
    motor_request,
    take_reply,
)
from outrider.rplidar.scene import Scene
from outrider.rplidar.sensor import BOOT_S, Sensor
from outrider.simulate import load


def sensor(model="S2", see=scans, mode=None):
    return Sensor(MODELS[model], Scene(see), mode)


def said(lidar, request, t=0.0):
    """The replies to one request."""
    buffer, replies = bytearray(lidar.hear(request.pack(), t)), []
    while (got := take_reply(buffer)) is not None:
        replies.append(got)
    return replies


def numbered(count, first=0):
    """Scans of which the k-th sees k + 1 metres all around, ten a second."""
    for k in range(first, first + count):
        ranges = np.full(8, k + 1.0, np.float32)
        timing = (0.0125, 0.1, 0.05, 1000.0)
        stamp = 1_000_000_000 + k * 100_000_000
        none = np.zeros(0, np.float32)
        yield LaserScan("/scan", "lidar", stamp, stamp, 0.0, -np.pi / 4, *timing, ranges, none)


# ------------------------------------------------------------------ what is seen


def test_a_simulated_world_is_sent_with_the_true_time_of_each_beam():
    world, model = load("crossing"), MODELS["C1"]
    mode = model.modes[1]
    messages = _simulated(world, model, mode)[:12]
    lidar = sensor("C1", lambda: messages)
    lidar.hear(express_request(1).pack(), 0.0)
    decoder, turns = Decoder(mode, model.baud, model.range_min), []
    for t in np.arange(0.0, 1.2, 0.005):
        turns += decoder.feed(lidar.due(t), 100.0 + t)
    t = np.concatenate([turn.beam_t for turn in turns]) - 100.0
    angle = np.unwrap(np.concatenate([turn.angle for turn in turns]))
    ranges = np.concatenate([turn.range for turn in turns])

    n = len(messages[0].ranges)
    true_angle = messages[0].angle_min + messages[0].angle_increment * np.arange(n * len(messages))
    true_t = np.arange(n * len(messages)) * 0.1 / n
    true = np.concatenate([np.where(np.isfinite(m.ranges), m.ranges, 0.0) for m in messages])
    assert len(t) > 9 * n
    first = np.argmin(
        np.abs(true_angle - (angle[0] + np.round((true_angle[0] - angle[0]) / 2 / np.pi) * 2 * np.pi))
    )
    seen = np.round((angle - angle[0]) / messages[0].angle_increment).astype(int) + first
    np.testing.assert_allclose(true_angle[seen] - angle, true_angle[first] - angle[0], atol=5e-4)
    heard = (true[seen] > 0.0) & (true[seen] < mode.range_max) & (true[seen] >= model.range_min)
    np.testing.assert_allclose(ranges[heard], true[seen][heard], atol=6e-4)
    assert np.all(ranges[~heard] == 0.0)
    late = t - true_t[seen]
    assert np.ptp(late[n:]) < 0.002
    assert abs(np.median(late)) < 0.01


def test_a_scene_follows_the_stamps_and_begins_anew():
    scene = Scene(lambda: numbered(3))
    there = [float(scene.turn(k, 0.1 * k, 16).range[0]) for k in range(7)]
    assert there == [1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0]
    assert [float(scene.turn(0, t, 16).range[0]) for t in (0.81, 0.84, 0.86, 0.9)] == [3.0, 3.0, 1.0, 1.0]


def test_where_stamps_jump_the_next_scan_follows_as_the_one_before_did():
    scene = Scene(lambda: [*numbered(2), *numbered(2, first=900)])
    assert [float(scene.turn(k, 0.1 * k, 8).range[0]) for k in range(5)] == [1.0, 2.0, 901.0, 902.0, 1.0]


def test_no_scan_is_nothing_to_emulate():
    with pytest.raises(InputError, match="no laser scan"):
        Scene(list)


@pytest.mark.parametrize("model", MODELS)
def test_samples_come_at_the_pace_of_the_model(model):
    lidar = sensor(model)
    mode = lidar.typical
    if lidar.motor != "dtr":
        lidar.hear(motor_request(lidar.motor, 600 if lidar.motor == "rpm" else 660).pack(), 0.0)
    request = express_request(mode.id) if mode.answer != Answer.STANDARD else Request(Command.SCAN)
    lidar.hear(request.pack(), 0.0)
    decoder, turns = Decoder(mode, MODELS[model].baud), []
    for t in np.arange(0.0, 2.0, 0.01):
        turns += decoder.feed(lidar.due(t), float(t))
    assert 18 <= len(turns) <= 20
    assert all(np.ptp(turn.beam_t) == pytest.approx(0.1, rel=0.03) for turn in turns[1:])
    assert all(len(turn.range) == pytest.approx(1e5 / mode.sample_us, abs=2) for turn in turns[1:])


def test_time_that_was_lost_is_not_made_up_for():
    lidar = sensor("A1")
    lidar.hear(express_request(1).pack(), 0.0)
    for t in np.arange(0.0, 0.5, 0.01):
        before = len(lidar.due(t))
    assert 0 < before < 300
    assert lidar.due(5.5) == b""
    assert len(lidar.due(5.51)) < 300


# ------------------------------------------------------------------ what is answered


@pytest.mark.parametrize("model", MODELS)
def test_it_tells_what_it_is_and_can(model):
    lidar = sensor(model)
    known = MODELS[model]
    (info,) = said(lidar, Request(Command.GET_INFO))
    assert info.payload[0] == known.model
    (health,) = said(lidar, Request(Command.GET_HEALTH))
    assert Health.parse(health.payload) == Health(0, 0)
    (typical,) = said(lidar, conf_request(Conf.TYPICAL_MODE))
    assert typical.payload[4] == lidar.typical.id
    assert len(said(lidar, Request(Command.GET_BOARD, bytes(4)))) == (lidar.motor == "pwm")
    assert said(lidar, Request(Command.STOP)) == []


def test_what_it_cannot_do_it_does_not_answer():
    lidar = sensor("A1")
    assert said(lidar, express_request(2)) == []  # Boost: 84
    assert said(lidar, express_request(9)) == []
    assert said(lidar, conf_request(Conf.MODE_NAME, 9)) == []
    assert said(lidar, conf_request(0x7777, 0)) == []
    with pytest.raises(InputError, match="84"):
        sensor("A1", mode="Boost")


def test_a_blocked_motor_stops_it_until_reset_and_reset_makes_it_deaf_for_a_while():
    lidar = sensor("A1")
    lidar.hear(express_request(1).pack(), 0.0)
    lidar.blocked = True
    assert lidar.due(0.1) == b""
    assert lidar.health.status == 2
    assert said(lidar, express_request(1), 0.2) == []
    lidar.blocked = False
    assert said(lidar, Request(Command.RESET), 0.3) == []
    assert said(lidar, Request(Command.GET_INFO), 0.3 + 0.9 * BOOT_S) == []
    assert len(said(lidar, Request(Command.GET_HEALTH), 0.3 + 1.1 * BOOT_S)) == 1
    assert lidar.health.status == 0


# ------------------------------------------------------------------ at a port


def test_orders_are_those_that_are_listed_and_others_are_told_so():
    emulator = Emulator(sensor())
    try:
        assert set(emulator._orders) == set(FAULTS)
        for wrong in ("", "explode", "loss much", "unplug nan", "garbage inf"):
            told = emulator.order(wrong)
            assert all(name in told for name in FAULTS)
        assert emulator.order("loss 7") == "loss: mode none, rpm 0, status 0"
        assert emulator.faults.loss == 1.0
    finally:
        emulator.close()


def test_the_link_leads_to_the_port_and_goes_with_it(tmp_path):
    link = tmp_path / "lidar"
    emulator = Emulator(sensor(), link)
    assert emulator.port == str(link)
    assert os.readlink(link).startswith("/dev/")
    emulator.close()
    emulator.close()
    assert not link.is_symlink()
    link.write_text("mine")
    with pytest.raises(OutputError, match="no link can be made"):
        Emulator(sensor(), link)
    assert link.read_text() == "mine"


def test_the_command_prints_the_port_and_ends(outrider, tmp_path):
    link = tmp_path / "lidar"
    code, out, _ = outrider("emulate", "constant", "--link", link, "--seconds", 0.05)
    assert (code, out) == (0, f"{link}\n")
    assert outrider("simulate", "constant", "-o", "recording.csv")[0] == 0
    code, out, _ = outrider("emulate", "recording.csv", "--model", "S3", "--seconds", 0.05)
    assert code == 0
    assert out.startswith("/dev/")


def test_the_command_refuses_in_one_line(outrider):
    for tokens, words in (
        (("constant", "--model", "Z9"), "want A1, A3, C1, S2, S3"),
        (("constant", "--mode", "Boost"), "patent"),
        (("constant", "--speed", "0"), "above 0"),
        (("nowhere.bag",), "nowhere.bag"),
    ):
        code, _, err = outrider("emulate", *tokens)
        assert code == 2
        assert words in err
