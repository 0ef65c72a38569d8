"""What host and lidar say to each other: built and read again, in any pieces, with any noise around it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider.errors import InputError
from outrider.rplidar import models, protocol
from outrider.rplidar.models import MODELS, Mode, choose
from outrider.rplidar.protocol import Answer, Command, Conf, Descriptor, Health, Info, Request, SampleRate

INFO = Info(0x18, (1, 29), 7, "00112233445566778899AABBCCDDEEFF")
noise = st.binary(max_size=30).filter(lambda b: 0xA5 not in b)


def test_bytes_on_the_line_are_those_of_the_manual():
    assert Request(Command.SCAN).pack() == bytes.fromhex("A520")
    assert protocol.express_request(0).pack() == bytes.fromhex("A58205000000000022")
    assert protocol.motor_request("pwm", 660).pack() == bytes.fromhex("A5F002940 2C1".replace(" ", ""))
    assert Descriptor(5, True, Answer.STANDARD).pack() == bytes.fromhex("A55A0500004081")
    assert protocol.reply(Answer.HEALTH, Health(0, 0).pack()) == bytes.fromhex("A55A0300000006000000")


requests = st.one_of(
    st.sampled_from([c for c in Command if c < 0x80]).map(Request),
    st.builds(Request, st.sampled_from([c for c in Command if c >= 0x80]), st.binary(max_size=40)),
)


@given(st.lists(requests, max_size=5), noise, st.integers(1, 9))
def test_requests_are_read_in_any_pieces_after_noise(said, before, cut):
    stream = before + b"".join(request.pack() for request in said)
    buffer, heard = bytearray(), []
    for i in range(0, len(stream), cut):
        buffer += stream[i : i + cut]
        while (request := protocol.take_request(buffer)) is not None:
            heard.append(request)
    assert heard == said
    assert not buffer


@given(
    st.lists(st.sampled_from([INFO, Health(2, 0x8001), SampleRate(508, 254)]), max_size=4),
    noise,
    st.integers(1, 9),
)
def test_replies_are_read_in_any_pieces_after_noise(told, before, cut):
    kinds = {Info: Answer.INFO, Health: Answer.HEALTH, SampleRate: Answer.SAMPLERATE}
    stream = before + b"".join(protocol.reply(kinds[type(reply)], reply.pack()) for reply in told)
    buffer, heard = bytearray(), []
    for i in range(0, len(stream), cut):
        buffer += stream[i : i + cut]
        while (reply := protocol.take_reply(buffer)) is not None:
            heard.append(reply)
    answers = {answer: kind for kind, answer in kinds.items()}
    assert [answers[reply.descriptor.answer].parse(reply.payload) for reply in heard] == told
    assert not buffer


def test_packets_of_a_stream_stay_in_the_buffer():
    buffer = bytearray(Descriptor(84, True, Answer.EXPRESS).pack() + b"\xa0\x50more")
    reply = protocol.take_reply(buffer)
    assert reply == (Descriptor(84, True, Answer.EXPRESS), b"")
    assert buffer == b"\xa0\x50more"


@given(st.binary(max_size=4000))
def test_noise_is_no_reply_and_is_not_kept(data):
    buffer = bytearray(data)
    while protocol.take_reply(buffer) is not None:
        pass
    assert len(buffer) < protocol.SHORT_REPLY_MAX + 7


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (Conf.MODE_COUNT, 5),
        (Conf.SAMPLE_US, 31.25),
        (Conf.RANGE_MAX, 12.0),
        (Conf.ANSWER, 0x86),
        (Conf.TYPICAL_MODE, 2),
        (Conf.MODE_NAME, "DenseBoost"),
        (Conf.DESIRED_SPEED, 600 | 660 << 16),
    ],
)
def test_what_a_lidar_tells_of_itself_is_read_as_it_was_told(key, value):
    assert protocol.parse_conf(protocol.pack_conf(key, value)) == (key, value)


@pytest.mark.parametrize("kind", [Info, Health, SampleRate])
def test_a_reply_of_the_wrong_length_is_refused_in_one_line(kind):
    with pytest.raises(InputError, match=r"^reply to GET_\w+ has 2 bytes: want \d+; ask again$"):
        kind.parse(b"ab")
    with pytest.raises(InputError, match=r"want 5 or more"):
        protocol.parse_conf(b"abcd")


@pytest.mark.parametrize(
    ("model", "name", "pwm", "motor", "tells"),
    [
        (0x18, "A1M8", False, "dtr", True),
        (0x18, "A1M8", True, "dtr", True),
        (0x28, "A2M8", True, "pwm", True),
        (0x31, "A3M1", False, "dtr", True),
        (0x41, "C1M1", True, "pwm", True),
        (0x71, "S2M1", False, "rpm", True),
        (0x92, "T1M2", False, "rpm", True),
    ],
)
def test_one_byte_tells_the_model_and_its_motor(model, name, pwm, motor, tells):
    info = INFO._replace(model=model)
    assert (info.name, info.motor(pwm), info.tells_modes) == (name, motor, tells)


def test_an_old_lidar_does_not_tell_its_modes_but_has_two():
    assert not INFO._replace(firmware=(1, 20)).tells_modes
    modes = models.old_modes(SampleRate(508, 254))
    assert [(mode.id, mode.answer, mode.sample_us) for mode in modes] == [(0, 0x81, 508.0), (1, 0x82, 254.0)]


def test_the_best_mode_is_the_fastest_that_is_decoded():
    assert {name: choose(model.modes).name for name, model in MODELS.items()} == {
        "A1": "Express",
        "A3": "Express",
        "C1": "Standard",
        "S2": "DenseBoost",
        "S3": "DenseBoost",
    }
    assert choose(MODELS["A1"].modes, "standard").answer == Answer.STANDARD


def test_the_patented_answer_is_refused_with_what_to_choose():
    with pytest.raises(InputError, match=r"'Boost' answers 84, .*patent.*: choose 'Standard' or 'Express'$"):
        choose(MODELS["A1"].modes, "Boost")
    with pytest.raises(InputError, match=r"answers 83, which is not known"):
        choose((Mode(0, "HQ", 0x83, 100.0, 12.0),), "HQ")
    with pytest.raises(InputError, match=r"^no mode 'Fast' here: want 'Standard' or 'Express'$"):
        choose(MODELS["A1"].modes, "Fast")


def test_every_line_is_fast_enough_for_its_modes():
    from outrider.rplidar.capsules import LAYOUTS

    for model in MODELS.values():
        for mode in model.modes:
            if mode.answer in models.DECODED:
                size, samples = LAYOUTS[mode.answer][:2]
                assert 10.0 * size / (samples * mode.sample_us * 1e-6) < model.baud, (model.name, mode.name)
