"""What the benchmarks share: a table of ratios after the run, and no name of the machine in the kept JSON."""

import numpy as np
import pytest

MEDIANS: dict[tuple[str, str], float] = {}
GOALS_MS = {"480 beams": 2.0, "3200 beams": 6.0}
NOTES: list[str] = []


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
