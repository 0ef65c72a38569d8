"""The horn: what it sounds like, that it is on time, and that nobody waits for whatever makes the noise."""

import stat
import sys
import time
import types
import wave

import numpy as np
import pytest

from made_live import head_on, turn_of
from outrider import pipeline
from outrider.errors import InputError, OutputError
from outrider.live import Health, Shot
from outrider.live.clock import now
from outrider.live.horn import HIGH_HZ, LOW_HZ, PATTERNS, RATE, SILENT_AFTER_S, Horn, pattern
from outrider.live.scans import TurnsToScans
from outrider.live.sounders import HANGS_S, Command, Device, Loop, Wav, sounder
from outrider.records import Level
from outrider.settings import Settings

LOUD = [Level.NOTICE, Level.CAUTION, Level.DANGER]
GOOD = Health((), {})


@pytest.fixture(scope="module")
def frame():
    """Any frame; its alert is replaced as wanted."""
    settings = Settings()
    scan = TurnsToScans(settings).scan(turn_of(head_on()[0]))
    return pipeline.step(pipeline.start(settings), scan, settings, pipeline.engine(settings))[1]


def at(frame, level, last_beam=None):
    import dataclasses

    alert = dataclasses.replace(frame.alert, level=level)
    t = now() if last_beam is None else last_beam
    return Shot(dataclasses.replace(frame, alert=alert), None, GOOD, t, t)


def wait_for(what, seconds=10.0):
    until = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.005)


# ------------------------------------------------------------------ the sound


@pytest.mark.parametrize("level", LOUD)
def test_a_sound_is_of_the_two_tones_and_louder_the_worse_it_is(level):
    sound = pattern(level).astype(float)
    assert len(sound) == PATTERNS[level][1] * RATE
    strength = np.abs(np.fft.rfft(sound))
    hertz = np.fft.rfftfreq(len(sound), 1.0 / RATE)
    strongest = hertz[strength > 0.7 * strength.max()]
    assert {round(f) for f in strongest} <= {LOW_HZ + k for k in range(-9, 10)} | {
        HIGH_HZ + k for k in range(-9, 10)
    }
    assert np.abs(sound).max() <= 32767
    if level < Level.DANGER:
        assert np.abs(sound).max() < np.abs(pattern(Level(level + 1)).astype(float)).max()


def test_a_repeated_pattern_has_no_seam():
    sound = pattern(Level.DANGER).astype(float)
    steps = np.abs(np.diff(np.concatenate([sound, sound])))
    assert steps[len(sound) - 1] <= steps[: len(sound) - 1].max()


def test_a_blast_begins_within_some_milliseconds_and_without_a_click():
    for level in LOUD:
        sound = np.abs(pattern(level).astype(float))
        assert sound[: round(0.01 * RATE)].max() > 0.3 * sound.max()
        assert sound[0] < 0.01 * 32767


def test_silence_is_silent():
    assert not pattern(Level.NONE).any()


def test_a_loop_goes_on_where_it_was_and_a_new_level_begins_at_its_beginning():
    loop = Loop()
    loop.begin(Level.CAUTION)
    whole = pattern(Level.CAUTION)
    taken = np.concatenate([loop.take(n) for n in (1000, 1, 60000, 40000)])
    assert np.array_equal(taken, np.resize(whole, len(taken)))
    loop.begin(Level.DANGER)
    assert np.array_equal(loop.take(500), pattern(Level.DANGER)[:500])


# ------------------------------------------------------------------ wav


def test_the_file_holds_what_was_heard_when_it_was_heard(frame, tmp_path):
    horn = Horn(Wav(tmp_path / "horn.wav"))
    begun = now()
    time.sleep(0.2)
    horn.shot(at(frame, Level.DANGER))
    time.sleep(0.3)
    horn.shot(at(frame, Level.NONE))
    time.sleep(0.2)
    horn.close()
    seconds = now() - begun
    with wave.open(str(tmp_path / "horn.wav")) as file:
        assert (file.getframerate(), file.getnchannels(), file.getsampwidth()) == (RATE, 1, 2)
        sound = np.frombuffer(file.readframes(file.getnframes()), "<i2")
    loud = np.flatnonzero(sound)
    assert len(sound) / RATE == pytest.approx(seconds, abs=0.1)
    assert loud[0] / RATE >= 0.2
    assert (loud[-1] - loud[0]) / RATE == pytest.approx(0.3, abs=0.1)
    told = horn.report
    assert told["blasts"] == told["last_beam_to_sound"]["n"] == 1
    assert 0.0 < told["last_beam_to_sound"]["max_ms"] < 200.0
    horn.close()


def test_what_was_heard_is_kept_while_it_goes_on(frame, tmp_path):
    horn = Horn(Wav(tmp_path / "horn.wav"))
    horn.shot(at(frame, Level.DANGER))

    def kept():
        with wave.open(str(tmp_path / "horn.wav")) as file:
            return file.getnframes() > 0.4 * RATE

    wait_for(lambda: (tmp_path / "horn.wav").stat().st_size > RATE)
    wait_for(kept)
    horn.close()


def test_a_sensor_that_falls_silent_does_not_leave_the_horn_on(frame, tmp_path, monkeypatch):
    from outrider.live import horn as module

    monkeypatch.setattr(module, "SILENT_AFTER_S", 0.1)
    assert SILENT_AFTER_S > 1.0
    horn = Horn(Wav(tmp_path / "horn.wav"))
    horn.shot(at(frame, Level.DANGER))
    horn.health(GOOD)
    wait_for(lambda: horn._playing == Level.DANGER)
    time.sleep(0.15)
    horn.health(Health(("scans late",), {}))
    wait_for(lambda: horn._playing == Level.NONE)
    horn.close()


# ------------------------------------------------------------------ command


def script(path, body):
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_a_program_is_told_each_level(frame, tmp_path):
    horn = Horn(Command(script(tmp_path / "beep", f'echo "$1 $2" >> {tmp_path / "said"}') + " pin7"))
    said = tmp_path / "said"
    for count, level in enumerate([Level.NOTICE, Level.DANGER, Level.NONE], start=1):
        horn.shot(at(frame, level))
        wait_for(lambda count=count: said.exists() and len(said.read_text().splitlines()) == count)
    horn.close()
    assert said.read_text().splitlines()[:3] == ["pin7 notice", "pin7 danger", "pin7 none"]
    assert horn.report["failed"] == 0
    assert "trouble" not in horn.report


def test_a_program_that_hangs_is_told_and_killed_and_nobody_waits(frame, tmp_path, monkeypatch):
    from outrider.live import sounders as module

    monkeypatch.setattr(module, "HANGS_S", 0.2)
    assert HANGS_S > 1.0
    horn = Horn(Command(script(tmp_path / "hang", "sleep 60")))
    begun = time.monotonic()
    for level in (Level.NOTICE, Level.DANGER):
        horn.shot(at(frame, level))
    assert time.monotonic() - begun < 0.1
    wait_for(lambda: "trouble" in horn.report)
    assert "has run for" in horn.report["trouble"]
    horn.shot(at(frame, Level.CAUTION))
    wait_for(lambda: horn.report["killed"] == 1)
    horn.close()
    assert horn.report["killed"] >= 2
    assert time.monotonic() - begun < 10.0


def test_a_program_that_fails_is_told(frame, tmp_path):
    horn = Horn(Command(script(tmp_path / "fails", "exit 3")))
    horn.shot(at(frame, Level.DANGER))
    wait_for(lambda: horn.report["failed"] == 1)
    assert "failed 1 times" in horn.report["trouble"]
    horn.close()


def test_only_the_newest_level_waits_for_a_busy_program(frame, tmp_path):
    said = tmp_path / "said"
    horn = Horn(Command(script(tmp_path / "slow", f'echo "$1" >> {said}; sleep 0.3')))
    horn.shot(at(frame, Level.NOTICE))
    wait_for(said.exists)
    for level in (Level.CAUTION, Level.NONE, Level.DANGER):
        horn.shot(at(frame, level))
    wait_for(lambda: len(said.read_text().splitlines()) == 2)
    assert said.read_text().splitlines() == ["notice", "danger"]
    assert horn.report["overtaken"] == 2
    horn.close()


# ------------------------------------------------------------------ sound card


class Card:
    """Stands in for the sound card's library, which no test machine has: takes blocks when asked to."""

    class PortAudioError(Exception):
        pass

    def __init__(self):
        self.opened, self.fails = [], False
        self.OutputStream = self._open

    def _open(self, **options):
        if self.fails:
            raise Card.PortAudioError("no such card")
        stream = types.SimpleNamespace(active=True, start=lambda: None, close=lambda: None, **options)
        self.opened.append(stream)
        return stream


def block(stream, n=512):
    out = np.zeros((n, 1), np.int16)
    stream.callback(out, n, None, None)
    return out[:, 0]


@pytest.fixture
def card(monkeypatch):
    made = Card()
    monkeypatch.setitem(sys.modules, "sounddevice", made)
    return made


def test_the_sound_card_is_given_the_pattern(card, frame):
    horn = Horn(Device("USB"))
    assert (card.opened[0].samplerate, card.opened[0].device) == (RATE, "USB")
    assert not block(card.opened[0]).any()
    horn.shot(at(frame, Level.DANGER))
    wait_for(lambda: horn._playing == Level.DANGER)
    heard = np.concatenate([block(card.opened[0]) for _ in range(4)])
    assert np.array_equal(heard, pattern(Level.DANGER)[:2048])
    horn.close()


def test_a_sound_card_that_goes_away_is_opened_again(card, frame, monkeypatch):
    from outrider.live import sounders as module

    monkeypatch.setattr(module, "OPEN_AGAIN_S", 0.05)
    horn = Horn(Device())
    horn.shot(at(frame, Level.DANGER))
    card.fails, card.opened[0].active = True, False
    wait_for(lambda: "trouble" in horn.report)
    card.fails = False
    wait_for(lambda: horn.report["opened_again"] == 1)
    wait_for(lambda: "trouble" not in horn.report)
    assert block(card.opened[1]).any()
    horn.close()


def test_no_sound_card_is_one_line(card, monkeypatch):
    card.fails = True
    with pytest.raises(InputError, match=r"no such card.*sounddevice"):
        sounder("device:nothing")
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(InputError, match=r"outrider\[audio\]"):
        sounder("device")


# ------------------------------------------------------------------ choice, failure


@pytest.mark.parametrize("words", ["trumpet", "wav", "wav:", "command:", "command:/absent/program", ""])
def test_a_horn_that_cannot_be_is_refused(words):
    with pytest.raises(InputError):
        sounder(words)


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(OutputError, match="absent"):
        sounder(f"wav:{tmp_path / 'absent' / 'horn.wav'}")
    assert sounder("none") is None


def test_a_sounder_that_fails_is_told_and_the_run_goes_on(frame, tmp_path):
    class Broken(Wav):
        def play(self, level):
            raise OSError("the disk is gone")

    horn = Horn(Broken(tmp_path / "horn.wav"))
    horn.shot(at(frame, Level.DANGER))
    wait_for(lambda: "trouble" in horn.report)
    assert horn.report["trouble"] == "horn failed: the disk is gone"
    horn.shot(at(frame, Level.NONE))
    horn.close()
