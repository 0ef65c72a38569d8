"""The ladder, its debounce and hysteresis, and every reason not to trust it."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from outrider import alert as warn
from outrider import repair, settings
from outrider.errors import InputError
from outrider.records import Ego, Level, Scan, Threats, Tracks, TrackState
from outrider.threat import assess

LIMITS = settings.Alert()  # 4, 3, 1.7 s; 2 scans; 0.5 s
NONE, NOTICE, CAUTION, DANGER = Level
DT = 0.1


def threats(t, ttc, ids=(1,), closing=5.0, inside=True, earliest=None):
    ttc, n = np.atleast_1d(np.asarray(ttc, float)), len(ids)
    distance = np.where(np.isfinite(ttc), 0.0, 2.0)
    return Threats(
        t, np.array(ids), np.resize(ttc, n), np.resize(distance, n), np.zeros(n), np.zeros(n),
        np.full(n, inside), np.full(n, float(closing)), np.resize(ttc if earliest is None else earliest, n),
        np.full(n, np.inf),
    )  # fmt: skip


def tracks(t, ids=(1,), state=TrackState.CONFIRMED, x=-20.0, y=0.0, speed=10.0, broken=False):
    n = len(ids)
    zero = np.zeros(n)
    return Tracks(
        t, np.array(ids), np.full(n, state, np.uint8), np.tile([x, y], (n, 1)), zero + speed, zero, zero,
        zero, zero, zero, np.tile([4.0, 2.0], (n, 1)), np.zeros((n, 2, 2)), np.full(n, 9), zero + 1.0,
        np.tile([0.2, 1.0], (n, 1)), np.full(n, broken),
    )  # fmt: skip


def play(ttcs, limits=LIMITS, state=TrackState.CONFIRMED, start=0.0, memory=None, **more):
    """Levels of the alerts for a row of times to collision, one a scan at 10 Hz."""
    memory, levels = memory or warn.start(), []
    for k, ttc in enumerate(ttcs):
        t = start + k * DT
        memory, out = warn.alert(memory, threats(t, ttc, **more), tracks(t, state=state), (), limits)
        levels.append(out.level)
    return levels


@pytest.mark.parametrize(
    ("ttc", "level"),
    [
        (np.inf, NONE),
        (4.01, NONE),
        (4.0, NOTICE),
        (3.01, NOTICE),
        (3.0, CAUTION),
        (1.7, DANGER),
        (0.0, DANGER),
    ],
)
def test_the_ladder(ttc, level):
    assert play([ttc] * 3)[-1] == level


@pytest.mark.parametrize("scans", [1, 2, 3, 5])
def test_a_level_goes_up_after_so_many_scans_in_a_row(scans):
    levels = play([1.0] * 6, settings.Alert(debounce_scans=scans))
    assert levels == [NONE] * (scans - 1) + [DANGER] * (7 - scans)


def test_flicker_raises_nothing():
    assert set(play([1.0, np.inf] * 10)) == {NONE}
    assert set(play([1.0, 1.0, np.inf] * 10, settings.Alert(debounce_scans=3))) == {NONE}


def test_escalation_is_debounced_level_by_level():
    ttcs = [3.9, 3.5, 2.9, 2.8, 1.6, 1.5]
    assert play(ttcs) == [NONE, NOTICE, NOTICE, CAUTION, CAUTION, DANGER]


def test_a_jump_to_danger_needs_no_steps_between():
    assert play([np.inf, 1.5, 1.4]) == [NONE, NONE, DANGER]


def test_a_scan_of_danger_counts_for_the_levels_below():
    """Alternating caution and danger is caution without a break, and danger never twice in a row."""
    assert play([2.0, 1.0, 2.0, 1.0]) == [NONE, CAUTION, CAUTION, CAUTION]


def test_a_level_is_kept_until_not_asked_for_so_long():
    levels = play([1.0] * 2 + [np.inf] * 9, settings.Alert(release_s=0.55))
    assert levels == [NONE, DANGER] + [DANGER] * 5 + [NONE] * 4  # last asked at 0.1 s, kept to 0.65 s


def test_release_steps_down_to_the_level_still_asked_for():
    levels = play([1.0] * 2 + [2.5] * 9, settings.Alert(release_s=0.35))
    assert levels == [NONE, DANGER, DANGER, DANGER, DANGER] + [CAUTION] * 6


def test_a_held_level_is_renewed_by_a_single_scan():
    """Once up, one scan in five is enough to keep it: no debounce on the way."""
    assert set(play([1.0, 1.0] + [np.inf, np.inf, np.inf, 1.0] * 8)[1:]) == {DANGER}


def test_debounce_is_for_the_same_track():
    memory = warn.start()
    for k in range(8):
        i = 1 + k % 2
        memory, out = warn.alert(memory, threats(k * DT, 1.0, [i]), tracks(k * DT, [i]), (), LIMITS)
        assert out.level == NONE


def test_the_alert_is_about_the_worst_track():
    memory = warn.start()
    for k in range(2):
        now = threats(k * DT, [3.5, 1.6, 1.2, np.inf], [2, 5, 9, 11])
        memory, out = warn.alert(memory, now, tracks(k * DT, [2, 5, 9, 11]), (), LIMITS)
    assert (out.level, out.track, out.ttc) == (DANGER, 9, 1.2)


def test_a_track_that_is_gone_is_held_without_a_time():
    memory = warn.start()
    for k in range(2):
        memory, _ = warn.alert(memory, threats(k * DT, 1.0), tracks(k * DT), (), LIMITS)
    memory, out = warn.alert(memory, threats(0.2, [], []), tracks(0.2, []), (), LIMITS)
    assert (out.level, out.track, out.ttc) == (DANGER, 1, np.inf)
    memory, out = warn.alert(memory, threats(0.8, [], []), tracks(0.8, []), (), LIMITS)
    assert (out.level, out.track, out.ttc) == (NONE, -1, np.inf)
    assert memory.runs == {}


@pytest.mark.parametrize("state", [TrackState.TENTATIVE, TrackState.STATIC])
def test_tentative_and_static_tracks_raise_nothing(state):
    assert set(play([0.5] * 10, state=state)) == {NONE}


def test_a_coasting_track_still_alerts():
    assert play([1.0] * 3, state=TrackState.COASTING)[-1] == DANGER


def test_creeping_and_what_stays_outside_the_corridor_raise_nothing():
    assert set(play([1.0] * 5, closing=0.4)) == {NONE}
    assert set(play([1.0] * 5, inside=False)) == {NONE}


def test_a_rider_passing_parked_cars_is_not_alerted_and_an_overtaking_car_on_course_is():
    """Through `assess`: a parked car in the way, one beside the way, a lane beside, a car from behind."""
    levels = {}
    for name, state, x, y, speed in [
        ("parked ahead", TrackState.STATIC, 9.0, 0.0, 0.0),
        ("parked beside", TrackState.STATIC, 9.0, 2.2, 0.0),
        ("next lane", TrackState.CONFIRMED, -12.0, 3.0, 14.0),
        ("from behind", TrackState.CONFIRMED, -14.0, 0.3, 14.0),
    ]:
        memory = warn.start()
        for k in range(3):
            t = k * DT
            now = tracks(t, state=state, x=x + (speed - 5.0) * t, y=y, speed=speed)
            ego = Ego(t, np.zeros(3), np.array([5.0, 0.0]), 0.0, True)
            seen = assess(now, ego, settings.Rider(), settings.Threat())
            memory, out = warn.alert(memory, seen, now, (), LIMITS)
        levels[name] = out.level
    assert levels == {"parked ahead": NONE, "parked beside": NONE, "next lane": NONE, "from behind": DANGER}


@given(st.lists(st.sampled_from([0.5, 1.7, 2.0, 3.5, 9.0, np.inf]), max_size=40), st.integers(1, 4))
def test_no_level_without_its_reason(ttcs, scans):
    """A level up means: some window of so many scans in a row asked for it, and it was asked for lately."""
    limits = settings.Alert(debounce_scans=scans)
    asks = [sum(ttc <= s for s in (4.0, 3.0, 1.7)) for ttc in ttcs]
    for k, level in enumerate(play(ttcs, limits)):
        if level:
            windows = [min(asks[j - scans + 1 : j + 1]) for j in range(scans - 1, k + 1)]
            assert max(windows) >= level
            assert max(asks[max(0, k - 5) : k + 1]) >= level
        if k >= scans - 1:
            assert level >= min(asks[k - scans + 1 : k + 1])


# ------------------------------------------------------------------ trust


def scan(t=1.0, valid=480, beams=480, faults=(), W_v=(0.0, 0.0)):
    n = beams
    mask = np.arange(n) < valid
    return Scan(
        t=t, beam_t=np.full(n, t), angle=np.linspace(-3, 3, n), range=np.where(mask, 5.0, np.nan), valid=mask,
        intensity=np.zeros(0, np.float32), range_max=40.0, W_sensor=np.zeros((n, 3)), W_p=np.zeros((n, 2)),
        ego=Ego(t, np.zeros(3), np.array(W_v), 0.0, True), masked={}, faults=faults,
    )  # fmt: skip


def test_a_good_scan_has_no_reason():
    assert warn.health(scan(1.0), 0.9, LIMITS) == ()
    assert warn.health(scan(1.0), None, LIMITS) == ()


@pytest.mark.parametrize(
    ("seen", "previous", "words"),
    [
        (scan(5.0), 0.0, "scans late: 5.00 s since the last one, limit 0.50 s"),
        (scan(1.0), 3.5, "clock jumped back 2.50 s"),
        (scan(1.0), 1.0, "clock stood still"),
        (scan(valid=3), 0.9, "mostly invalid: 0.6 % of 480 beams have a return, want 2.0 %"),
        (scan(valid=0), 0.9, "mostly invalid: 0.0 % of 480 beams have a return, want 2.0 %"),
        (scan(beams=0), 0.9, "mostly invalid: 0.0 % of 0 beams have a return, want 2.0 %"),
        (scan(W_v=(np.nan, 0.0)), 0.9, "ego pose not finite"),
        (scan(faults=(f"{repair.POSE_STALE} by 3.10 s",)), 0.9, f"{repair.POSE_STALE} by 3.10 s"),
        (scan(faults=(f"{repair.POSE_FROZEN} for 2 s",)), 0.9, f"{repair.POSE_FROZEN} for 2 s"),
        (scan(faults=(repair.POSE_MISSING,)), 0.9, repair.POSE_MISSING),
    ],
)
def test_each_reason_in_words(seen, previous, words):
    assert warn.health(seen, previous, LIMITS) == (words,)


def test_repaired_faults_do_not_degrade():
    assert warn.health(scan(faults=(f"{repair.SCAN_TIME}: 0.1 s taken",)), 0.9, LIMITS) == ()


def test_several_reasons_are_all_told():
    assert len(warn.health(scan(9.0, valid=0, W_v=(np.inf, 0.0)), 1.0, LIMITS)) == 3


def test_degraded_marks_the_alert_and_leaves_its_level():
    memory = warn.start()
    for k in range(2):
        memory, out = warn.alert(memory, threats(k * DT, 1.0), tracks(k * DT), ("scans late",), LIMITS)
    assert out.level == DANGER
    assert out.degraded == ("scans late",)


def test_tracks_that_could_not_be_assessed_are_told():
    now = dataclasses.replace(threats(0.0, [np.inf, 2.0], [1, 2]), closest_distance=np.array([np.inf, 0.0]))
    _, out = warn.alert(warn.start(), now, tracks(0.0, [1, 2]), (), LIMITS)
    assert out.degraded == ("1 of 2 tracks could not be assessed",)


def test_a_slow_scanner_still_alerts():
    """One scan in 2 s is always late, and marked so; the second in a row still raises the level."""
    memory = warn.start()
    for k in range(2):
        memory, out = warn.alert(memory, threats(2.0 * k, 1.0), tracks(2.0 * k), ("late",), LIMITS)
    assert out.level == DANGER


def test_a_clock_that_jumps_back_does_not_hold_an_alert_for_ever():
    memory = warn.start()
    for k in range(2):
        memory, out = warn.alert(memory, threats(100.0 + k * DT, 1.0), tracks(0.0), (), LIMITS)
    assert out.level == DANGER
    levels = play([np.inf] * 8, start=3.0, memory=memory)
    assert levels[0] == DANGER
    assert levels[-1] == NONE


def test_overdue_is_told_while_no_scan_comes():
    assert warn.overdue(warn.start(), 0.0, LIMITS) == ("no scan yet",)
    memory, _ = warn.alert(warn.start(), threats(1.0, 9.0), tracks(1.0), (), LIMITS)
    assert warn.overdue(memory, 1.4, LIMITS) == ()
    assert warn.overdue(memory, 3.0, LIMITS) == ("scans late: 2.00 s since the last one, limit 0.50 s",)


def test_a_ladder_out_of_order_is_refused():
    with pytest.raises(InputError, match="want notice_s >= caution_s >= danger_s"):
        warn.alert(warn.start(), threats(0.0, 1.0), tracks(0.0), (), settings.Alert(danger_s=3.5))


def test_nothing_handed_in_is_changed():
    memory = warn.start()
    memory, _ = warn.alert(memory, threats(0.0, 1.0), tracks(0.0), (), LIMITS)
    before = dict(memory.runs)
    warn.alert(memory, threats(0.1, 1.0), tracks(0.1), (), LIMITS)
    assert memory.runs == before
