"""The kept rows as Markdown tables, put between the markers of docs/comparison.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from benchmarks.accuracy import methods, table
from benchmarks.accuracy.methods import Method
from benchmarks.accuracy.table import Row
from benchmarks.markdown import grid

SHORT = {
    "datmo/overtakes": "overtakes *",
    "datmo/parallel": "parallel",
    "datmo/overtake_ego": "overtake ego",
    "kitti/test": "KITTI",
    "argoverse/test": "Argoverse",
    "argoverse-hops/test": "Argoverse, hops",
    "simulated/test": "simulated",
    "simulated-hops/test": "simulated, hops",
    "simulated-outliers/test": "simulated, outliers",
}
# Velocity RMSE [m/s], yaw RMSE [rad] that were set as goals before any of this was written.
GOALS = {
    "datmo/overtakes": (0.95, 0.041),
    "datmo/parallel": (0.99, 0.025),
    "datmo/overtake_ego": (0.75, 0.031),
    "argoverse/test": (0.36, 0.026),
    "argoverse-hops/test": (0.53, 0.027),
}
COLUMNS: Sequence[tuple[str, str, str]] = (
    ("position [m]", "position_m", ".2f"),
    ("speed [m/s]", "speed_mps", ".2f"),
    ("velocity [m/s]", "velocity_mps", ".2f"),
    ("course [rad]", "course_rad", ".3f"),
    ("yaw [rad]", "yaw_rad", ".3f"),
    ("J", "J", ".2f"),
    ("lost", "divergences", ".0f"),
    ("flips", "heading_flips", ".0f"),
    ("NEES", "nees", ".1f"),
    ("outside", "outside", ".0%"),
    ("beyond", "beyond", ".0%"),
)


def label(row: Row) -> str:
    """The method and its variant."""
    return Method(row["method"], row["variant"], row["lag"], row["kind"]).label


def tuned(rows: Iterable[Row], streets: bool = False) -> list[Row]:
    """The rows whose gains were searched, on each set's own training part or on all streets together."""
    return [r for r in rows if r["kind"] == "tuned" and (r["tuned_on"] == "streets") == streets]


def by_label(rows: Iterable[Row]) -> dict[str, dict[str, dict[str, Any]]]:
    """Figures by label and set."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(label(row), {}).update(row["sets"])
    return found


def chosen(rows: Iterable[Row], name: str) -> dict[str, dict[int, float]]:
    """J on a set by method and kind: 0 position only, 1 with the heading, 2 with the heading and a lag.

    Of the variants of a kind it is the one that was best in training that counts, not the best on this set.
    """
    best: dict[tuple[str, int], tuple[float, float]] = {}
    for row in tuned(rows):
        if name not in row["sets"] or row["J_training"] is None:
            continue
        kind = 2 if row["lag"] else int(row["variant"].startswith("heading"))
        J = row["sets"][name]["J"]
        found = (row["J_training"], float("inf") if J is None else J)
        best[row["method"], kind] = min(best.get((row["method"], kind), found), found)
    out: dict[str, dict[int, float]] = {}
    for (method, kind), (_, J) in best.items():
        out.setdefault(method, {})[kind] = J
    return out


def shown(value: Any, form: str) -> str:
    """A number; a dash for none, or one that is beyond all use."""
    return "-" if value is None or abs(value) > 999.0 else format(value, form)


# ------------------------------------------------------------------ blocks


def _scores(cells: dict[str, dict[str, dict[str, Any]]]) -> str:
    """J by label and set; the best without a lag in bold."""
    names = [s for s in SHORT if any(s in of for of in cells.values())]
    J = {who: {s: of.get(s, {}).get("J") for s in names} for who, of in cells.items()}
    causal = {who: of for who, of in J.items() if "lag" not in who}
    least = {s: min((of[s] for of in causal.values() if of[s] is not None), default=None) for s in names}
    return grid(
        ["", *(SHORT[s] for s in names)],
        [[who, *(_bold(of[s], least[s] if who in causal else None) for s in names)] for who, of in J.items()],
    )


def _bold(value: Any, best: Any) -> str:
    text = shown(value, ".2f")
    return f"**{text}**" if value is not None and value == best else text


def _chosen(kind: int) -> Callable[[Sequence[Row]], str]:
    """J by method and set, of the variant that was best in training."""

    def block(rows: Sequence[Row]) -> str:
        cells: dict[str, dict[str, dict[str, Any]]] = {}
        for s in SHORT:
            for who, of in chosen(rows, s).items():
                if kind in of:
                    cells.setdefault(who, {})[s] = {"J": of[kind]}
        if kind == 1:
            cells["goal"] = {s: {"J": v + 5.0 * yaw} for s, (v, yaw) in GOALS.items()}
        return _scores(cells)

    return block


def _own(rows: Sequence[Row]) -> str:
    return folded("All variants: J", _scores(by_label(tuned(rows))))


def _streets(rows: Sequence[Row]) -> str:
    return _scores(by_label(r for r in tuned(rows, streets=True) if r["variant"].startswith("heading")))


def _fixed(rows: Sequence[Row]) -> str:
    """Gains that observers come with; with the heading where these gains use it."""
    cells: dict[str, dict[str, dict[str, Any]]] = {}
    for r in sorted(rows, key=lambda r: (str(r["method"]), str(r["kind"]), str(r["variant"]))):
        if r["kind"] != "tuned":
            cells.setdefault(f"{r['method']}, {r['kind']} gains", r["sets"])  # heading comes before position
    return _scores(cells)


def _details(rows: Sequence[Row]) -> str:
    """Every figure of every tuned row, one folded table a set, the best J first."""
    cells, out = by_label(tuned(rows)), []
    for name, short in SHORT.items():
        lines = [
            [who, *(shown(cells[who][name][field], form) for _, field, form in COLUMNS)]
            for who in sorted(cells, key=lambda who: _order(cells[who].get(name)))
            if name in cells[who]
        ]
        head = ["", *(title for title, _, _ in COLUMNS)]
        samples = next((of[name]["samples"] for of in cells.values() if name in of), 0)
        title = f"{short.rstrip(' *')}: {samples:.0f} samples"
        out.append(folded(title, grid(head, lines)))
    return "\n\n".join(out)


def _order(figures: dict[str, Any] | None) -> float:
    return figures["J"] if figures and figures["J"] is not None else float("inf")


def _ranges(rows: Sequence[Row]) -> str:
    """What may be tuned, how many gains that is, and what a step costs."""
    lines, times = [], {label(r): r.get("step_us") for r in rows}
    for name in methods.names():
        every = list(methods.searched(name))
        for method in every:
            first = every[0].ranges() if method is not every[0] else {}
            more = {k: v for k, v in method.ranges().items() if k not in first}
            less = "".join(f" without `{k}`" for k in first if k not in method.ranges())
            of = ", ".join(f"`{k}` {low:g} to {high:g}" for k, (low, high) in more.items())
            told = ("as position, and " if first and of else "as position" if first else "") + of + less
            cells = [method.label, str(len(method.ranges())), shown(times.get(method.label), ".3g"), told]
            lines.append(cells)
    head = ["", "gains tuned", "us a step", "from .. to"]
    return folded("What is tuned, in which range, and what a step costs", grid(head, lines))


def folded(title: str, text: str) -> str:
    """A block that opens on a click."""
    return f'<details markdown="1"><summary>{title}</summary>\n\n{text}\n\n</details>'


def _gains(task: str) -> Callable[[Sequence[Row]], str]:
    def block(rows: Sequence[Row]) -> str:
        lines = [
            [
                label(r),
                shown(r["J_training"], ".3f"),
                ", ".join(f"`{k}` {v:.3g}" for k, v in r["gains"].items()),
            ]
            for r in rows
            if r["tuned_on"] == task and not r["lag"]
        ]
        return folded(f"Gains tuned on {task}", grid(["", "J in training", "gains"], lines))

    return block


BLOCKS: dict[str, Callable[[Sequence[Row]], str]] = {
    "position": _chosen(0),
    "heading": _chosen(1),
    "lag": _chosen(2),
    "own": _own,
    "streets": _streets,
    "fixed": _fixed,
    "details": _details,
    "ranges": _ranges,
    **{f"gains-{task}": _gains(task) for task in table.TASKS},
}
