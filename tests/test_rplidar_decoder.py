"""Bytes of a lidar to turns: exact, in any pieces, after any damage, each beam at its own time."""

import time
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from outrider.errors import InputError
from outrider.rplidar.capsules import BEGIN_MM, LAYOUTS, STEP_MM, unpack
from outrider.rplidar.decoder import Decoder
from outrider.rplidar.encode import Encoder, Sweep, descriptor
from outrider.rplidar.models import MODELS, Mode
from outrider.rplidar.protocol import Answer

LIDARS = {
    Answer.STANDARD: (MODELS["A1"], MODELS["A1"].modes[0]),
    Answer.EXPRESS: (MODELS["A1"], MODELS["A1"].modes[1]),
    Answer.DENSE: (MODELS["S2"], MODELS["S2"].modes[1]),
    Answer.ULTRA_DENSE: (MODELS["S3"], MODELS["S3"].modes[1]),
}
answers = pytest.mark.parametrize("answer", LIDARS, ids=lambda answer: f"{answer:02X}")
HALF_Q6 = 0.5 / 64.0 + 1e-9  # half a step of the angle [deg]


class Made:
    """A stream of turns, and the truth of each sample in it."""

    def __init__(self, answer, turns, seed=0, samples=None, first=0):
        self.model, self.mode = LIDARS[answer]
        self.n = samples or round(1e5 / self.mode.sample_us)
        self.mode = self.mode._replace(sample_us=1e5 / self.n)  # turns at 10 Hz
        self.period = self.mode.sample_us * 1e-6
        rng = np.random.default_rng(seed)
        count = turns * self.n
        ranges = np.where(rng.random(count) < 0.1, 0.0, rng.uniform(0.2, self.mode.range_max, count))
        angle = (np.arange(count) + first) * 360.0 / self.n
        self.truth = Sweep(angle, ranges, rng.integers(0, 64, count).astype(float))
        self.rows = Encoder(answer).feed(self.truth)
        self.size, self.packet = LAYOUTS[answer][:2]
        self.data = self.rows.tobytes()
        self.packet_s = self.packet * self.period

    def decoder(self):
        return Decoder(self.mode, self.model.baud)

    def whole_at(self, i):
        """When packet i is whole, after the last sample in it and the line."""
        return 100.0 + ((i + 1) * self.packet + 0.5) * self.period + 10.0 * self.size / self.model.baud

    def feed(self, decoder, keep=None):
        """Packet by packet, each when it is whole."""
        turns = []
        for i, row in enumerate(self.rows):
            if keep is None or keep(i):
                turns += decoder.feed(row.tobytes(), self.whole_at(i))
        return turns

    def sample_of(self, turn):
        """Which sample of the truth each beam of a turn is, by the time it was taken; and how far off [s]."""
        exact = (turn.beam_t - 100.0) / self.period
        return np.rint(exact).astype(int), np.abs(exact - np.rint(exact)).max() * self.period


def one(turns):
    """All beams one after the other."""
    return [np.concatenate([getattr(t, name) for t in turns]) for name in ("angle", "range", "quality")]


def same(a, b):
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        assert np.abs(x.angle - y.angle).max() < 1e-6
        assert np.array_equal(x.range, y.range)
        assert np.array_equal(x.quality, y.quality)


# ------------------------------------------------------------------ exact


RANGE_STEP = {Answer.STANDARD: 0.25e-3, Answer.EXPRESS: 1e-3, Answer.DENSE: 1e-3, Answer.ULTRA_DENSE: 5e-3}


@answers
def test_what_was_encoded_is_decoded_but_for_rounding(answer):
    made = Made(answer, 6)
    decoder = made.decoder()
    turns = made.feed(decoder)
    assert len(turns) == 6 - (6 * made.n % made.packet > 0 or made.packet == 1)
    assert not any(turn.faults for turn in turns)
    angle, ranges, quality = one(turns)
    truth = Sweep(*(column[: len(angle)] for column in made.truth))
    off = np.rad2deg(-angle) - truth.angle
    most = HALF_Q6 if answer == Answer.STANDARD else 3.0 * HALF_Q6  # where a turn ends: by the step before
    assert np.abs(off - 360.0 * np.rint(off / 360.0)).max() <= most
    assert np.mean(np.abs(off - 360.0 * np.rint(off / 360.0)) <= HALF_Q6) > 0.95
    assert np.array_equal(ranges == 0.0, truth.range == 0.0)
    assert np.abs(ranges - truth.range).max() <= 0.5 * RANGE_STEP[answer] + 1e-6
    kept = {Answer.STANDARD: truth.quality, Answer.ULTRA_DENSE: truth.quality * (truth.range > 0.0)}
    wrong = np.abs(quality - kept.get(answer, 0.0 * truth.quality))
    assert wrong.max() <= (7.0 if answer == Answer.ULTRA_DENSE else 0.0)
    counts = decoder.counts
    assert counts["bytes"] == len(made.data)
    assert counts["bytes_dropped"] == counts["beams_lost"] == counts["turns_dropped"] == 0
    assert counts["packets"] == len(made.rows)
    assert counts["beams"] == len(angle)


@answers
def test_what_was_decoded_is_not_rounded_again(answer):
    said = unpack(answer, Made(answer, 3).rows)
    if answer == Answer.STANDARD:
        again = Sweep(
            np.unwrap(said.start_q6 / 64.0, period=360.0), said.range_mm[:, 0] / 1000.0, said.quality[:, 0]
        )
    else:
        start = np.unwrap(said.start_q6 / 64.0, period=360.0)
        angle = start[:, None] + np.arange(said.range_mm.shape[1]) * 1e-3
        again = Sweep(angle.ravel(), said.range_mm.ravel() / 1000.0, said.quality.ravel())
    for column, same in zip(said, unpack(answer, Encoder(answer).feed(again)), strict=True):
        assert np.array_equal(column, same)


def test_the_scales_of_the_ultra_dense_answer_meet():
    assert BEGIN_MM.tolist() == [0, 2046, 8187, 24567]
    assert STEP_MM.tolist() == [2, 3, 4, 5]
    mm = np.arange(0, 65_536, dtype=float)[: 65_536 // 64 * 64]
    rows = Encoder(Answer.ULTRA_DENSE).feed(Sweep(mm * 0.01, mm / 1000.0, np.zeros(len(mm))))
    got = unpack(Answer.ULTRA_DENSE, rows).range_mm.ravel()
    fits = (mm >= 1.1) & (mm <= 65_522.0)
    step = np.select([mm <= 2046, mm <= 8187, mm <= 24_567], [2, 3, 4], 5)
    assert np.all(np.abs(got - mm)[fits] <= 0.5 * step[fits])


def test_the_express_answer_shifts_single_angles_back():
    made = Made(Answer.EXPRESS, 1)
    row = made.rows[:1].copy()
    row[0, 4] |= 2  # two high bits of the first sample's angle: 32 of 63 eighths
    row[0, 8] = 0x50 | 3  # four low bits of both
    said = unpack(Answer.EXPRESS, row)
    assert said.offset_deg[0, :3].tolist() == [(32 + 3) / 8.0, 5 / 8.0, 0.0]
    assert np.array_equal(said.range_mm, unpack(Answer.EXPRESS, made.rows[:1]).range_mm)


@answers
def test_angles_fall_from_ahead_over_the_right_hand_side(answer):
    made = Made(answer, 3)
    for turn in made.feed(made.decoder()):
        assert -2.0 * np.pi - HALF_Q6 < turn.angle[-1] < turn.angle[0] <= np.deg2rad(HALF_Q6)
        assert np.all(np.diff(turn.angle) < 0.0)
        assert turn.range_max == made.mode.range_max


# ------------------------------------------------------------------ as they come


@pytest.fixture(scope="module")
def streams():
    """Turns of each answer, and what the whole stream at once gives."""
    made = {answer: Made(answer, 4, samples=150, first=20) for answer in LIDARS}
    return {answer: (one, one.decoder().feed(one.data, 100.0)) for answer, one in made.items()}


@answers
@settings(max_examples=25)
@given(cuts=st.lists(st.integers(0, 40_000), max_size=40))
@example(cuts=list(range(4000)))
def test_the_pieces_in_which_bytes_come_change_nothing(answer, cuts, streams):
    made, want = streams[answer]
    assert want
    decoder, turns = made.decoder(), []
    edges = [0, *sorted(min(cut, len(made.data)) for cut in cuts), len(made.data)]
    for begin, end in pairwise(edges):
        turns += decoder.feed(made.data[begin:end], 100.0)
    same(turns, want)


@answers
def test_a_turn_is_given_with_the_packet_it_ends_in(answer):
    made = Made(answer, 4)
    decoder, given_at = made.decoder(), []
    for i, row in enumerate(made.rows):
        given_at += [i] * len(decoder.feed(row.tobytes(), made.whole_at(i)))
    last = made.n * np.arange(1, 5) - 1
    if answer == Answer.STANDARD:  # where the next sample proves it, and begins beyond it
        assert given_at == (last + 1)[:3].tolist()
    else:
        ends = last // made.packet
        assert given_at == ends[ends < len(made.rows)].tolist()


@answers
def test_a_mirror_that_changes_its_speed_is_followed(answer):
    made = Made(answer, 10)
    t = np.arange(10 * made.n) / made.n / 10.0
    wave = made.truth._replace(angle=3600.0 * (t + 0.02 * np.sin(7.0 * t) / 7.0))  # 2 % faster and slower
    decoder, turns = made.decoder(), []
    for i, row in enumerate(Encoder(answer).feed(wave)):
        turns += decoder.feed(row.tobytes(), made.whole_at(i))
    angle, ranges, _ = one(turns)
    off = np.rad2deg(-angle) - wave.angle[: len(angle)]
    assert np.abs(off - 360.0 * np.rint(off / 360.0)).max() < 0.05
    assert np.abs(ranges - wave.range[: len(angle)]).max() < 3e-3
    assert not any(turn.faults for turn in turns)


@answers
def test_a_descriptor_may_come_in_pieces_and_begins_the_stream_anew(answer):
    made = Made(answer, 3)
    head = descriptor(answer).pack()
    decoder = made.decoder()
    turns = []
    for byte in head:
        turns += decoder.feed(bytes([byte]), 100.0)
    turns += decoder.feed(made.data, 100.3)
    same(turns, made.decoder().feed(made.data, 100.3))
    assert decoder.counts["starts"] == 1
    assert decoder.counts["bytes_dropped"] == 0
    before = decoder.counts["turns"]
    decoder.feed(head[:4], 100.4)  # half of one, then the stream begins anew
    assert len(decoder.feed(head + made.data, 100.7)) >= before - 1
    assert decoder.counts["starts"] == 2
    assert decoder.counts["bytes_dropped"] <= made.size + 4


# ------------------------------------------------------------------ damaged


def wrong(made, turns):
    """How many beams given are none of the truth: their range belongs to no sample of that angle."""
    truth = made.truth.range.reshape(-1, made.n)
    begin = made.truth.angle[0] / 360.0 * made.n
    count = 0
    for turn in turns:
        sample = np.rint(np.rad2deg(-turn.angle) / 360.0 * made.n - begin).astype(int) % made.n
        near = [np.abs(truth[:, (sample + k) % made.n] - turn.range).min(axis=0) < 3e-3 for k in (-1, 0, 1)]
        count += int(np.sum(~np.any(near, axis=0)))
    return count


def damaged(rng, kind, row):
    """One packet with something done to it."""
    at, length = rng.integers(0, len(row)), rng.integers(1, 12)
    if kind == "cut":
        return np.delete(row, slice(at, at + length))
    if kind == "insert":
        return np.insert(row, at, rng.integers(0, 256, length).astype(np.uint8))
    if kind == "flip":
        return np.where(np.arange(len(row)) == at, row ^ np.uint8(1 << rng.integers(0, 8)), row)
    if kind == "noise":
        return rng.integers(0, 256, len(row)).astype(np.uint8)
    if kind == "gone":
        return row[:0]
    return row[rng.random(len(row)) > 0.3]


@answers
@settings(max_examples=20)
@given(
    seed=st.integers(0, 10**6),
    kinds=st.lists(
        st.sampled_from(["cut", "insert", "flip", "noise", "gone", "third lost"]), min_size=1, max_size=6
    ),
    share=st.sampled_from([0.02, 0.3, 1.0]),
)
@example(seed=1, kinds=["third lost"], share=1.0)
def test_after_any_damage_the_next_whole_turn_is_exact(answer, seed, kinds, share):
    bad, good = 5, 5
    made = Made(answer, bad + good, samples=100 if answer == Answer.STANDARD else 400)
    rng, decoder, turns = np.random.default_rng(seed), made.decoder(), []
    edge = next(i for i in range(len(made.rows)) if i * made.packet >= bad * made.n)
    for i, row in enumerate(made.rows[:edge]):
        hurt = rng.random() < share
        data = damaged(rng, kinds[rng.integers(len(kinds))], row) if hurt else row
        turns += decoder.feed(data.tobytes(), made.whole_at(i))
    before, soiled = decoder.counts, len(turns)
    for i, row in enumerate(made.rows[edge:], edge):
        turns += decoder.feed(row.tobytes(), made.whole_at(i))
    counts = decoder.counts
    assert counts["packets"] - before["packets"] >= len(made.rows) - edge - (
        9 if answer == Answer.STANDARD else 2
    )
    clean = turns[soiled + 2 :]  # what was under way, and the turn that begins in a damaged packet
    assert len(clean) >= good - 3
    assert not any(turn.faults for turn in clean)
    assert wrong(made, clean) == 0
    assert all(abs(len(turn.angle) - made.n) <= 1 for turn in clean)
    assert counts["bytes"] == before["bytes"] + made.size * (len(made.rows) - edge)
    assert before["bytes_dropped"] > 0 or share < 1.0 or set(kinds) <= {"gone", "flip"}
    if answer != Answer.STANDARD:  # which has no checksum: a damaged sample may look like a good one
        assert wrong(made, turns) == 0


@answers
def test_of_thirty_percent_of_bytes_lost_no_beam_is_made_up(answer):
    made = Made(answer, 12, samples=800)
    rng, decoder, turns = np.random.default_rng(3), made.decoder(), []
    for i, row in enumerate(made.rows):
        turns += decoder.feed(damaged(rng, "third lost", row).tobytes(), made.whole_at(i))
    assert turns == []
    counts = decoder.counts
    assert counts["bytes"] - counts["bytes_dropped"] < 500
    assert counts["packets"] < 100


@answers
@pytest.mark.parametrize("turns_lost", [0.3, 1.0, 2.4, 4.0])
def test_packets_lost_without_a_trace_are_counted_and_the_time_goes_on(answer, turns_lost):
    made = Made(answer, 16)
    first, gone = len(made.rows) // 3, round(turns_lost * made.n / made.packet)
    decoder = made.decoder()
    turns = made.feed(decoder, lambda i: not first <= i < first + gone)
    assert wrong(made, turns) == 0
    lost = decoder.counts["beams_lost"]
    assert gone * made.packet <= lost <= gone * made.packet + (answer == Answer.STANDARD)
    for turn in turns:
        sample, off = made.sample_of(turn)
        assert off < 1e-6
        assert np.array_equal(sample, np.arange(sample[0], sample[0] + len(sample))) or turn.faults
        assert np.abs(made.truth.range[sample] - turn.range).max() < 3e-3
    faults = [turn.faults for turn in turns if turn.faults]
    assert all(fault[0].startswith("about ") and fault[0].endswith(" beams lost") for fault in faults)
    assert len(faults) + decoder.counts["turns_dropped"] in (1, 2)


@answers
def test_a_turn_of_which_little_is_left_is_dropped_and_counted(answer):
    made = Made(answer, 6)
    per_turn = made.n / made.packet
    decoder = made.decoder()
    turns = made.feed(decoder, lambda i: not 2.1 * per_turn <= i < 2.9 * per_turn)
    assert len(turns) == len(made.feed(made.decoder())) - 1
    assert not any(turn.faults for turn in turns)
    assert decoder.counts["turns_dropped"] == 1


@answers
def test_memory_does_not_grow_whatever_comes(answer):
    made = Made(answer, 3, samples=400)
    rng, decoder = np.random.default_rng(5), made.decoder()
    still = Encoder(answer).feed(made.truth._replace(angle=0.0 * made.truth.angle)).tobytes()
    soup = [
        made.data,
        rng.integers(0, 256, 20_000).astype(np.uint8).tobytes(),
        made.data[::2],
        b"\xa5" * 9_000,
        still,
    ]

    def round_of_all(begin):
        for k, part in enumerate(soup * 2):
            for i in range(0, len(part), 700):
                decoder.feed(part[i : i + 700], begin + 0.3 * k + i * 1e-5)

    tracemalloc.start()
    try:
        round_of_all(100.0)
        before = tracemalloc.get_traced_memory()[0]
        for k in range(1, 6):
            round_of_all(100.0 + 5.0 * k)
        assert tracemalloc.get_traced_memory()[0] < before + 50_000
    finally:
        tracemalloc.stop()


@answers
def test_a_mirror_that_stands_gives_no_turn_and_goes_on_afterwards(answer):
    made = Made(answer, 8)
    decoder = made.decoder()
    assert len(made.feed(decoder)) >= 6
    encoder, packets = Encoder(answer), round(5.0 / made.packet_s)
    still = Sweep(
        np.full(packets * made.packet, 77.0), np.ones(packets * made.packet), np.ones(packets * made.packet)
    )
    turns = [
        turn
        for i, row in enumerate(encoder.feed(still), len(made.rows))
        for turn in decoder.feed(row.tobytes(), made.whole_at(i))
    ]
    assert len(turns) <= 1  # the one under way
    after = Made(answer, 8, seed=9)
    begin = len(made.rows) + packets
    turns = [
        t for i, row in enumerate(after.rows, begin) for t in decoder.feed(row.tobytes(), made.whole_at(i))
    ]
    assert len(turns) >= 6
    assert wrong(after, turns[1:]) == 0
    assert not any(turn.faults for turn in turns[1:])


@answers
def test_a_period_that_doubles_is_followed(answer):
    fast, slow = (
        Made(answer, 6),
        Made(answer, 6, seed=2, samples=2 * round(0.1 / (LIDARS[answer][1].sample_us * 1e-6))),
    )
    angle = np.concatenate([fast.truth.angle, fast.truth.angle[-1] + 360.0 / fast.n + slow.truth.angle])
    both = Sweep(angle, *(np.concatenate(pair) for pair in zip(fast.truth[1:], slow.truth[1:], strict=True)))
    decoder, turns = fast.decoder(), []
    for i, row in enumerate(Encoder(answer).feed(both)):
        turns += decoder.feed(row.tobytes(), fast.whole_at(i))
    assert len(turns) >= 10
    assert not any(turn.faults for turn in turns)
    assert decoder.counts["beams_lost"] == 0
    assert wrong(fast, turns[:5]) == wrong(slow, turns[7:]) == 0
    assert np.all(np.diff(np.concatenate([turn.beam_t for turn in turns])) > 0.0)


# ------------------------------------------------------------------ time


@answers
@pytest.mark.parametrize("lump_s", [0.001, 0.016])
def test_late_bytes_do_not_move_the_time_of_beams(answer, lump_s):
    made = Made(answer, 30)
    rng, decoder, turns = np.random.default_rng(4), made.decoder(), []
    whole_at = made.whole_at(np.arange(len(made.rows)))
    received, sent = 100.0, 0
    while received < whole_at[-1] - 0.2:
        received += lump_s + (rng.exponential(0.02) if rng.random() < 0.3 else 0.0)
        ready = int(np.searchsorted(whole_at, received))
        turns += decoder.feed(made.rows[sent:ready].tobytes(), received)
        sent = ready
    t = np.concatenate([turn.beam_t for turn in turns])
    assert np.all(np.diff(t) > 0.0)
    late = t - (100.0 + np.arange(len(t)) * made.period)
    settled = t > 101.0
    assert np.abs(late[settled]).max() < min(lump_s, 0.004)
    assert late.min() > -1e-6
    assert all(turn.received >= turn.beam_t[-1] for turn in turns)


@answers
def test_a_crystal_that_is_off_is_followed(answer):
    made = Made(answer, 60, samples=100 if answer == Answer.STANDARD else 300)
    decoder = made.decoder()
    slow = 1.001
    turns = [
        t
        for i, row in enumerate(made.rows)
        for t in decoder.feed(row.tobytes(), 100.0 + (made.whole_at(i) - 100.0) * slow)
    ]
    t = np.concatenate([turn.beam_t for turn in turns])
    late = t - (100.0 + np.arange(len(t)) * made.period * slow)
    assert np.abs(late).max() < 0.0015


@answers
def test_a_silence_ends_the_turn_under_way_and_is_told(answer):
    made = Made(answer, 8)
    half = int(3.5 * made.n / made.packet)
    decoder, turns = made.decoder(), []
    for i, row in enumerate(made.rows):
        turns += decoder.feed(row.tobytes(), made.whole_at(i) + 5.0 * (i >= half))
    before, after = [t for t in turns if t.received < 105.0], [t for t in turns if t.received > 105.0]
    assert len(before) >= 2
    assert len(after) >= 2
    assert after[0].faults[0] == "silence of 5.0 s"
    assert not any(turn.faults for turn in after[1:])
    assert after[0].beam_t[0] > 105.0
    assert decoder.counts["silences"] == decoder.counts["turns_dropped"] == 1
    for turn in after:
        sample = np.rint((turn.beam_t - 105.0) / made.period).astype(int)
        assert np.abs(made.truth.range[sample] - turn.range).max() < 3e-3


def test_a_clock_that_goes_back_is_told():
    made = Made(Answer.DENSE, 3)
    decoder = made.decoder()
    made.feed(decoder)
    turns = [
        t for i, row in enumerate(made.rows) for t in decoder.feed(row.tobytes(), made.whole_at(i) - 60.0)
    ]
    assert turns[0].faults[0].startswith("clock back by 60.")
    assert turns[0].beam_t[0] < 50.0


# ------------------------------------------------------------------ the rest


def test_the_patented_answer_is_refused_with_what_to_choose():
    boost = MODELS["A1"].modes[2]
    with pytest.raises(
        InputError, match=r"mode 'Boost' answers 84, .*patent.*choose a mode that answers 81, 82, 85 or 86$"
    ):
        Decoder(boost)
    with pytest.raises(InputError, match=r"'HQ' answers 83"):
        Decoder(Mode(2, "HQ", 0x83, 100.0, 12.0))


@answers
def test_a_core_decodes_many_times_what_the_line_can_bring(answer):
    made = Made(answer, 40)
    lump = max(round(0.016 * len(made.data) / 4.0), 1)  # 40 turns take 4 s
    decoder, begin = made.decoder(), time.process_time()
    for i in range(0, len(made.data), lump):
        decoder.feed(made.data[i : i + lump], 100.0 + i / len(made.data) * 4.0)
    assert decoder.counts["turns"] >= 38
    assert time.process_time() - begin < 4.0 / 10.0
