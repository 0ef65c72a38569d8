"""All rows of the comparison: each method tuned on some sets and judged on others, kept as JSON."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from benchmarks.accuracy import methods, sets, tune
from benchmarks.accuracy.methods import Method

from outrider.compare import Series, judge

Row = dict[str, Any]
BUDGET, PEER_BUDGET = 300, 60
DATMO = tuple(f"datmo/{run}" for run in sets.RUNS)


class Task(NamedTuple):
    """Sets that gains are tuned on, and sets that they are judged on."""

    training: tuple[str, ...]
    judged: tuple[str, ...]


FAMILIES = ("kitti", "argoverse", "argoverse-hops", *sets.SIMULATED)
TASKS: Mapping[str, Task] = {
    "datmo": Task(DATMO[:1], DATMO),
    **{name: Task((f"{name}/train",), (f"{name}/test",)) for name in FAMILIES},
    "streets": Task(
        tuple(f"{name}/train" for name in ("kitti", "argoverse", "argoverse-hops", "simulated-outliers")),
        tuple(f"{name}/test" for name in FAMILIES),
    ),
}
JUDGED = tuple(dict.fromkeys(name for task in TASKS.values() for name in task.judged))
Loader = Callable[[str], Sequence[Series]]


def budget(method: Method, task: str, whole: int = BUDGET, peer: int = PEER_BUDGET) -> int:
    """Evaluations a method is given: all the same on datmo, fewer for the slow peers elsewhere."""
    return peer if method.peer and task != "datmo" else whole


def tuned_rows(
    name: str,
    task: str,
    load: Loader = sets.load,
    whole: int = BUDGET,
    peer: int = PEER_BUDGET,
    seed: int = tune.SEED,
) -> Iterator[Row]:
    """Every variant of an observer or peer, tuned for a task and judged."""
    training = [load(s) for s in TASKS[task].training]
    for method in methods.searched(name):
        found = tune.search(method, training, budget(method, task, whole, peer), seed)
        gains = method.gains(found.values)
        for shown in (method, *methods.followers(method)):
            yield {
                **_said(shown, task, found.values),
                "evaluations": found.evaluations,
                "J_training": found.score,
                "sets": {s: _judged(shown, gains, load(s)) for s in TASKS[task].judged},
            }


def fixed_rows(name: str, load: Loader = sets.load, judged: Sequence[str] = JUDGED) -> Iterator[Row]:
    """Gains that an observer comes with, untuned, on all sets."""
    for method in methods.fixed(name):
        gains = method.gains()
        yield {
            **_said(method, "", {}),
            "evaluations": 0,
            "sets": {s: _judged(method, gains, load(s)) for s in judged},
        }


def timed_rows(rows: Sequence[Row], load: Loader = sets.load, on: str = DATMO[0]) -> None:
    """Adds `step_us` to rows: one row of each method and variant is timed, the others like it."""
    known: dict[str, float] = {}
    for row in rows:
        method = Method(row["method"], row["variant"], row["lag"], row["kind"])
        if method.label not in known:
            known[method.label] = _short(method.step_us(method.gains(row["gains"] or None), load(on)))
        row["step_us"] = known[method.label]


def _said(method: Method, task: str, gains: Mapping[str, float]) -> Row:
    return {
        "method": method.name,
        "variant": method.variant,
        "lag": method.lag,
        "kind": method.kind,
        "tuned_on": task,
        "gains": dict(gains),
    }


def _judged(method: Method, gains: Any, series: Sequence[Series]) -> dict[str, Any]:
    with np.errstate(all="ignore"):
        f = judge(method.estimates(gains, series), series)
    return {k: _short(v) for k, v in {**asdict(f), "J": f.J}.items()}


def _short(value: float) -> Any:
    """Four digits; None where it is not a number."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


# ------------------------------------------------------------------ many


def key(row: Row) -> tuple[Any, ...]:
    """What makes a row another one."""
    return row["method"], row["variant"], row["lag"], row["kind"], row["tuned_on"]


def _work(name: str, task: str, whole: int, peer: int, seed: int) -> list[Row]:
    if task == "fixed":
        return list(fixed_rows(name))
    return list(tuned_rows(name, task, whole=whole, peer=peer, seed=seed))


def run(
    names: Sequence[str],
    tasks: Sequence[str],
    file: Path,
    workers: int,
    whole: int = BUDGET,
    seed: int = tune.SEED,
) -> list[Row]:
    """Rows of all names and tasks, put into `file` beside those that it already holds."""
    rows = {key(r): r for r in read(file)}
    jobs = [
        (name, task) for task in tasks for name in names if not (task == "streets" and name in methods.PEERS)
    ]
    peer = min(PEER_BUDGET, whole)
    for s in DATMO:
        sets.load(s)  # before the workers would each track it
    begin, failed = time.monotonic(), []
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        pending = {pool.submit(_work, *job, whole, peer, seed): job for job in jobs}
        for done, future in enumerate(as_completed(pending), 1):
            what, error = " ".join(pending[future]), future.exception()
            if error:
                failed.append(f"{what}: {error!r}")
            else:
                fresh = future.result()
                stale = {(r["method"], r["tuned_on"]) for r in fresh}
                rows = {k: r for k, r in rows.items() if (r["method"], r["tuned_on"]) not in stale}
                rows |= {key(r): r for r in fresh}
                _write(file, list(rows.values()))
            print(f"{done}/{len(jobs)} {what}: {time.monotonic() - begin:.0f} s", flush=True)
    if failed:
        raise RuntimeError("; ".join(failed))
    timed_rows([r for r in rows.values() if r["method"] in names])
    _write(file, list(rows.values()))
    return list(rows.values())


def read(file: Path) -> list[Row]:
    rows: list[Row] = json.loads(file.read_text())["rows"] if file.is_file() else []
    return rows


def _write(file: Path, rows: Sequence[Row]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    ordered = sorted(rows, key=lambda r: [str(part) for part in key(r)])
    lines = ",\n".join(json.dumps(row) for row in ordered)
    about = json.dumps({"seed": tune.SEED, "evaluations": BUDGET, "peer_evaluations": PEER_BUDGET})
    file.write_text(f'{{"about": {about},\n"rows": [\n{lines}\n]}}\n')
