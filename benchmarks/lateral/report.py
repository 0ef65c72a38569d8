"""The kept rows as Markdown tables, put between the markers of docs/lateral-validation.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.lateral import cases
from benchmarks.lateral.table import Row
from benchmarks.markdown import grid

SHOWN = {"own": "own", "drift": "drift", "multibody": "multi-body"}
MAIN = ("dry", "friction 0.5", "D class")
FIXED, COMBINED, SCHEDULED = (cases.METHODS[i].label for i in (0, 2, 4))
PAIRS = (  # labels: the first is expected to be better
    (COMBINED, FIXED),
    (SCHEDULED, FIXED),
    (SCHEDULED, COMBINED),
    ("`scheduled`", "`scheduled`, L1 used"),
    ("`ultra_local`", "`scheduled`"),
    ("`kalman`", "`scheduled`"),
    ("`tyre`, friction 1", "`scheduled`"),
    ("`friction_bank`", "`kalman`"),
)


def rows(kept: dict[str, Any], **what: Any) -> list[Row]:
    """The rows of which all these fields are so; with the roll told where nothing else is asked."""
    wanted = {"roll": True, **what}
    return [r for r in kept["rows"] if all(r[key] == value for key, value in wanted.items())]


def shown(value: float) -> str:
    """A number with three digits, a dash for what is of no use."""
    return f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


def errors(of: Sequence[Row], heads: Sequence[str]) -> str:
    """RMSE of each method (lines) on some rows (columns), RMS of vy first; the least of a column in bold."""
    best = [min(r["rmse"].values()) for r in of]
    lines = [["always 0: RMS of vy", *(shown(r["rms_vy"]) for r in of)]]
    for label in of[0]["rmse"]:
        values = [r["rmse"][label] for r in of]
        lines.append(
            [label, *(f"**{shown(v)}**" if v == b else shown(v) for v, b in zip(values, best, strict=True))]
        )
    return grid(["[m/s]", *heads], lines)


def _main(noise: str) -> Callable[[dict[str, Any]], str]:
    def block(kept: dict[str, Any]) -> str:
        of = [r for t in cases.TRUTHS for n in MAIN for r in rows(kept, truth=t, name=n, noise=noise)]
        return errors(of, [f"{SHOWN[r['truth']]}: {r['name']}" for r in of])

    return block


def _all(kept: dict[str, Any]) -> str:
    out = []
    for noise in ("none", "mems", "paper"):
        for truth in cases.TRUTHS:
            of = rows(kept, truth=truth, noise=noise)
            heads = [r["name"] + ("" if r["whole"] else f" (slid off, {r['seconds']:.0f} s)") for r in of]
            title = f"Noise: {noise}; truth: {SHOWN[truth]}"
            out.append(
                f'<details markdown="1"><summary>{title}</summary>\n\n{errors(of, heads)}\n\n</details>'
            )
    return "\n\n".join(out)


CLAIMS = (  # what the source says of its CarSim runs, the drive, and the half (None: whole) it speaks of
    ("fast-changing speed: both good", "dry", 0),
    ("above 10 m/s for long: fixed LQ bad, combined good", "dry", 1),
    ("friction 0.5: fixed LQ cannot cope, combined matches", "friction 0.5", None),
    ("the same, sliding", "0.5, sliding", None),
    ("D class: fixed LQ bad, combined good but for 5 s", "D class", None),
)


def _claims(kept: dict[str, Any]) -> str:
    lines = []
    for text, name, half in CLAIMS:
        for noise in ("none", "paper"):
            cells = []
            for truth in cases.TRUTHS:
                (r,) = rows(kept, truth=truth, name=name, noise=noise)
                a, b = (
                    r["rmse"][x] if half is None else r["halves"][x][min(half, len(r["halves"][x]) - 1)]
                    for x in (FIXED, COMBINED)
                )
                cells.append(f"{shown(a)} → {shown(b)} ({b / a - 1.0:+.0%})")
            lines.append([text if noise == "none" else "", noise, *cells])
    return grid(["the source says", "noise", *(SHOWN[t] for t in cases.TRUTHS)], lines)


def _orders(kept: dict[str, Any]) -> str:
    """How often the first of a pair is better, by noise."""
    lines = []
    for better, other in PAIRS:
        if better not in kept["rows"][0]["rmse"] or other not in kept["rows"][0]["rmse"]:
            continue
        line = [f"{better} better than {other}"]
        for noise in ("none", "mems", "paper"):
            of = rows(kept, noise=noise)
            known = [r for r in of if r["car"] == "b_class"]
            line.append(" and ".join(_won(part, better, other) for part in (known, _rest(of, known))))
        lines.append(line)
    return grid(["", "no noise", "mems", "paper"], lines)


def _rest(of: Sequence[Row], known: Sequence[Row]) -> list[Row]:
    return [r for r in of if r not in known]


def _won(of: Sequence[Row], better: str, other: str) -> str:
    return f"{sum(r['rmse'][better] < r['rmse'][other] for r in of)} of {len(of)}"


def _winners(kept: dict[str, Any]) -> str:
    """Which method has the least error in how many drives, by noise."""
    counts = {
        noise: Counter(min(r["rmse"], key=r["rmse"].__getitem__) for r in rows(kept, noise=noise))
        for noise in ("none", "mems", "paper")
    }
    worst = {
        label: max(r["rmse"][label] / r["rms_vy"] for r in rows(kept, noise="mems"))
        for label in kept["rows"][0]["rmse"]
    }
    lines = [
        [label, *(str(of[label] or "") for of in counts.values()), f"{worst[label]:.2f}"] for label in worst
    ]
    return grid(["best in", "no noise", "mems", "paper", "worst RMSE / RMS(vy), mems"], lines)


def _roll(kept: dict[str, Any]) -> str:
    of = [
        r
        for name in MAIN
        for known in (True, False)
        for r in rows(kept, truth="multibody", noise="mems", name=name, roll=known)
    ]
    return errors(of, [f"{r['name']}, roll {'told' if r['roll'] else 'not told'}" for r in of])


def _gains(kept: dict[str, Any]) -> str:
    lines = [
        [label, noise, *(f"{v:g}" for k, v in gains.items() if k[-1].isdigit())]
        for label, of in kept["tuned"].items()
        for noise, gains in of.items()
    ]
    return grid(["", "noise", *(f"bin {i + 1}" for i in range(7))], lines)


BLOCKS: dict[str, Callable[[dict[str, Any]], str]] = {
    "paper": _main("paper"),
    "mems": _main("mems"),
    "none": _main("none"),
    "claims": _claims,
    "orders": _orders,
    "winners": _winners,
    "roll": _roll,
    "gains": _gains,
    "all": _all,
}
