"""What the benchmarks share: a table of ratios after the run, and no name of the machine in the kept JSON."""

from typing import Any

import numpy as np
import pytest

MEDIANS: dict[tuple[str, str], float] = {}
GOALS_MS = {"480 beams": 2.0, "3200 beams": 6.0}
NOTES: list[str] = []

SPEED: dict[tuple[str, Any], float] = {}  # us, and times C; filled by test_observer_speed.py
PEERS = {
    "filterpy": ("FilterPy", 300.0),
    "stonesoup": ("Stone Soup", 2000.0),
}  # at least as many times faster
TIMES_C, TIMES_C_EKF = 1.1, 1.4  # at most
SCAN_US, SCAN_US_EKF = 150.0, 300.0  # at most, with 200 tracks


def pytest_benchmark_update_machine_info(config, machine_info):
    machine_info.pop("node", None)


def pytest_benchmark_update_commit_info(config, commit_info):
    for key in ("author_time", "project", "branch"):
        commit_info.pop(key, None)


@pytest.fixture
def timed(benchmark):
    """Call `work` once a round after warm-up; its median goes into the table under (case, who)."""

    def run(case, who, work, rounds=300, warmup=100):
        benchmark.extra_info.update(case=case, who=who)
        benchmark.pedantic(work, rounds=rounds, iterations=1, warmup_rounds=warmup)
        if benchmark.stats is not None:
            MEDIANS[case, who] = 1e3 * float(np.median(benchmark.stats.stats.data))

    return run


def pytest_terminal_summary(terminalreporter):
    write = terminalreporter.write_line
    if MEDIANS:
        terminalreporter.section("scan to alert, median of one scan")
        write(f"{'case':<14}{'who':<14}{'ms':>9}{'x outrider':>12}   what it does")
    for (case, who), ms in MEDIANS.items():
        ours = MEDIANS.get((case, "outrider"))
        ratio = f"{ms / ours:12.2f}" if ours else f"{'-':>12}"
        does = "the whole chain" if who == "outrider" else "association and filter on outrider's detections"
        goal = GOALS_MS.get(case) if who == "outrider" else None
        told = f"; goal {goal} ms {'met' if ms <= goal else 'MISSED'}" if goal else ""
        write(f"{case:<14}{who:<14}{ms:9.3f}{ratio}   {does}{told}")
    for note in NOTES:
        write(note)
    names = [name for name, what in SPEED if what == "step"]
    if names:
        terminalreporter.section("observers: a batch of 100000 tracks, a stream of one call a scan")
        for name in names:
            for line in observer_lines(name):
                write(line)


def observer_lines(name):
    """What was measured of one observer, and whether that is what is wanted."""
    step, ekf = SPEED[name, "step"], name == "ekf"
    yield f"{name:<20}{step:9.3f} us a step"
    if (name, "C") in SPEED:
        yield told("x scalar C", SPEED[name, "C"], TIMES_C_EKF if ekf else TIMES_C)
    else:
        yield f"{'':<20}{'-':>9} x scalar C: not written in C, or no compiler here"
    for library, (title, goal) in PEERS.items():
        kind = name if (library, name) in SPEED else "kalman"
        if (library, kind) in SPEED:
            yield told(f"x faster than {title}, {kind}", SPEED[library, kind] / step, goal, least=True)
    for tracks in (1, 10, 50):
        if (name, tracks) in SPEED:
            yield f"{'':<20}{SPEED[name, tracks]:9.1f} us a scan of {tracks} tracks"
    if (name, 200) in SPEED:
        yield told("us a scan of 200 tracks", SPEED[name, 200], SCAN_US_EKF if ekf else SCAN_US)


def told(what, value, goal, least=False):
    """A line with the value, the goal, and whether it is met."""
    met = value >= goal if least else value <= goal
    limit = f"goal {'at least' if least else 'at most'} {goal:g}: {'met' if met else 'MISSED'}"
    return f"{'':<20}{value:9.{0 if least else 2}f} {what:<40}{limit}"
