"""A ride on which everything goes wrong in turn: no crash, memory stays, soon all is well again."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.soak.__main__ import DAY, failures, soak  # noqa: E402
from benchmarks.soak.ride import FAULTS, Ride  # noqa: E402
from benchmarks.soak.watch import Memory, Recoveries  # noqa: E402

from outrider.rplidar.models import DECODED  # noqa: E402

pytestmark = pytest.mark.once


def test_two_minutes_of_scans_with_all_faults():
    *_, figures = soak(1200, look=200)
    assert failures(figures) == []
    assert set(figures["recovery"]["after"]) == {
        *(fault.__name__.replace("_", " ") for fault in FAULTS),
        "another lidar",
    }
    assert figures["recovery"]["after"]["another lidar"]["times"] == len(DECODED) - 1
    assert figures["scans"] >= 1200
    assert figures["memory"]["looks"] >= 6
    assert figures["decoded"]["turns"] == figures["scans"]
    assert figures["decoded"]["bytes_dropped"] > 10_000
    assert figures["decoded"]["silences"] >= 3
    assert figures["watched"]["alerts raised"] > 0
    assert figures["watched"]["most tracks"] >= 3
    json.dumps(figures)


@pytest.mark.slow
def test_two_minutes_on_the_wall():
    *_, figures = soak(DAY, wall_s=120.0, look=600)
    assert failures(figures) == []
    assert figures["scans"] > 6000


def test_every_answer_is_ridden_with():
    assert {lidar.mode.answer for lidar in Ride().lidars} == set(DECODED)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_fault_is_felt(fault):
    ride = Ride()
    for _ in range(200):
        ride.step()
    before = ride.decoder.counts
    for _ in fault(ride):
        pass
    turns = [turn for _ in range(80) for turn in ride.step()]
    after = ride.decoder.counts
    felt = ("bytes_dropped", "turns_dropped", "beams_lost", "silences", "starts")
    slow = fault is Ride.slow
    back = fault is Ride.clock_back
    assert slow or back or any(after[name] > before[name] for name in felt)
    assert len(turns) >= 15
    assert not turns[-1].faults


def test_what_must_not_be_is_said():
    memory, recoveries = Memory(10), Recoveries()
    recoveries.add("noise", 0.2)
    recoveries.add("noise", 2.5)
    recoveries.add("stall", None)
    memory.mb = [100.0, 103.0, 94.0]
    figures = {
        "memory": memory.as_dict(),
        "recovery": recoveries.as_dict(),
        "watched": {"backward": 2},
    }
    assert failures(figures) == [
        "not well within 2 s after: noise, 1 times",
        "not well within 2 s after: stall, 1 times",
        "memory has changed by -6.0 %",
        "2 scans were not later than the one before",
    ]
    assert figures["recovery"]["after"]["noise"] == {"times": 2, "mean_s": 1.35, "worst_s": 2.5}
