"""The kept rows as Markdown tables, put between the markers of docs/relocalise-comparison.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.markdown import grid
from benchmarks.relocalise import cases

Rows = list[dict[str, Any]]
CELLS = [cell.label for cell in cases.NOISE]
FIRST = {  # median position rmse of the first study [cm], by cell
    "published, true rates (no robot has them)": (2.84, 6.39, 2.82, 5.97),
    "published, rates by a line": (11.4, 26.5, 10.5, 19.6),
    "published, rates by a parabola": (16.0, 56.4, 11.2, 33.2),
    "published, rates by difference": (14.8, 46.4, 29.5, 144.0),
    "fed forward, rates by a parabola": (2.50, 8.10, 2.07, 6.81),
    "fed forward and normalised": (1.86, 5.23, 1.68, 4.74),
    "fed forward, no rates (ka = 0)": (4.75, 6.17, 6.77, 8.01),
    "`pose_ekf`": (0.82, 1.71, 0.67, 1.27),
    "particle filter, 300": (1.35, 1.95, 2.35, 1.30),
    "particle filter, 1000": (1.14, 1.83, 1.57, 1.39),
}
FIRST_BASIN = {  # share that was found without noise in the first study: ellipse, egg
    "published 20, 20": (1.0, 0.0),
    "fed forward 20, 20": (1.0, 0.48),
    "fed forward 5, 1": (1.0, 0.49),
    "fed forward 1, 0.1": (1.0, 0.42),
    "normalised, 5/s": (1.0, 0.49),
    "fed forward 1, 0 (no rates)": (0.66, 0.22),
    "fed forward 5, 0 (no rates)": (0.35, 0.07),
    "`pose_ekf`, told 5 cm, no gate": (0.93, 0.78),
    "`pose_ekf`, told 30 cm, no gate": (0.64, 0.48),
}
FIRST_MOTIONS = {  # median and worst rmse, after 3 s [cm], to 5 cm [s]
    "constant": "3.2 (12.3), 3.9 cm, 0.55 s",
    "criterion": "1.1 (1.6), 1.8 cm, 0.82 s",
    "sigma": "1.35 (3.5), 3.5 cm, 0.43 s",
    "straight_and_turn": "1.3 (2.3), 12.5 cm, 3.35 s",
    "random": "1.1 (2.0), 4.7 cm, 1.05 s",
    "spin": "0.6 (1.3), 2.3 cm, 0.50 s",
}
FIRST_ANYWHERE = {
    ("ellipse", "10 Hz, 1 cm", "search"): "16 of 16",
    ("ellipse", "10 Hz, 5 cm", "search"): "16 of 16",
    ("ellipse", "50 Hz, 2 cm", "search"): "16 of 16",
    ("asymmetric", "10 Hz, 1 cm", "search"): "12 of 12",
    ("ellipse", "10 Hz, 1 cm", "particle filter, 5000"): "12 of 12",
    ("ellipse", "10 Hz, 5 cm", "particle filter, 5000"): "12 of 12",
    ("asymmetric", "10 Hz, 1 cm", "particle filter, 5000"): "11 of 12",
}


def cm(value: float | None) -> str:
    """Metres as centimetres; `lost` beyond a metre or without a figure."""
    if value is None or value > 1.0:
        return "lost"
    return f"{100.0 * value:.2f}" if value < 0.0995 else f"{100.0 * value:.1f}"


def seconds(value: float | None) -> str:
    """A time with two digits, a dash for never."""
    return "-" if value is None else f"{value:.2g}" if value < 10.0 else f"{value:.0f}"


def _rows(kept: dict[str, Any], part: str, **what: Any) -> Rows:
    return [r for r in kept[part] if all(r[key] == value for key, value in what.items())]


def _labels(rows: Rows) -> list[str]:
    return list(dict.fromkeys(r["method"] for r in rows))


def _noise(kept: dict[str, Any]) -> str:
    """Ours, and in brackets that of the first study."""
    lines = []
    for label in _labels(kept["noise"]):
        of = {r["cell"]: r for r in _rows(kept, "noise", method=label)}
        first = FIRST.get(label)
        cells = [
            cm(of[c]["rms"]) + (f" ({first[k]:g})" if first else "") if c in of else ""
            for k, c in enumerate(CELLS)
        ]
        us = [
            min(r[name] for r in of.values())
            for name in ("us", "us_of_many")
            if name in next(iter(of.values()))
        ]
        lines.append([label, *cells, ", ".join(f"{u:.0f}" for u in us)])
    return grid(["median rmse [cm] (first study)", *CELLS, "us a step: alone, of 24"], lines)


def _tails(kept: dict[str, Any]) -> str:
    lines = []
    for label in _labels(kept["noise"]):
        of = {r["cell"]: r for r in _rows(kept, "noise", method=label)}
        cells = [f"{cm(of[c]['p90'])}, {seconds(of[c]['time'])} s" if c in of else "" for c in CELLS]
        lines.append([label, *cells])
    return grid(["nine in ten below [cm], time to 15 cm", *CELLS], lines)


def _gains(kept: dict[str, Any]) -> str:
    lines = []
    for label in _labels(kept["noise"]):
        of = {r["cell"]: r["gains"] for r in _rows(kept, "noise", method=label)}
        text = [
            ", ".join(f"{name} {value:.2g}" for name, value in of[c].items() if _told(name, value))
            for c in CELLS
            if c in of
        ]
        if any(text):
            lines.append([label, *text])
    return grid(["", *CELLS], lines)


def _told(name: str, value: float) -> bool:
    return not (name in ("kappa", "feedforward") and value == 0.0)


def _basin(kept: dict[str, Any]) -> str:
    cells = [(wall, sigma) for wall in ("ellipse", "asymmetric") for sigma in (0.0, 0.01)]
    lines = []
    for label in _labels(kept["basin"]):
        line = [label]
        for k, (wall, sigma) in enumerate(cells):
            (r,) = _rows(kept, "basin", method=label, wall=wall, sigma=sigma)
            first = FIRST_BASIN.get(label) if sigma == 0.0 else None
            line.append(f"{r['good']:.0%}" + (f" ({first[k // 2]:.0%})" if first else ""))
        (r,) = _rows(kept, "basin", method=label, wall="ellipse", sigma=0.0)
        lines.append([*line, seconds(r["time"])])
    heads = [f"{wall}, {'no noise' if sigma == 0.0 else '1 cm'}" for wall, sigma in cells]
    return grid(["found (first study)", *heads, "time, ellipse [s]"], lines)


def _anywhere(kept: dict[str, Any]) -> str:
    lines = []
    for r in kept["anywhere"]:
        searched = r["method"] == "search"
        first = FIRST_ANYWHERE.get((r["wall"], r["cell"], r["method"]), "")
        lines.append(
            [
                f"{r['wall']}, {r['cell']}" if searched else "",
                f"**{r['method']}**" if searched else r["method"],
                f"{r['good']} of {r['runs']}" + (f" ({first})" if first else ""),
                f"{r['ambiguous']} of {r['runs']}" if searched else "",
                f"{seconds(r['time'])}, {seconds(r['slowest'])}",
                f"{r['us'] / 1000.0:.2f}" + (f", {r['worst']:.0f}" if searched else ""),
                f"{r['seeds']:.0f}, {r['left']:.1f}" if searched else "",
            ]
        )
    head = ["", "", "found (first study)", "said to be ambiguous", "time: median, slowest [s]"]
    return grid([*head, "ms a step: mean, worst", "hypotheses: first, last"], lines)


def _motions(kept: dict[str, Any]) -> str:
    lines = [
        [
            f"`{r['motion']}`",
            f"{cm(r['rms'])} ({cm(r['worst'])})",
            cm(r["after_3_s"]),
            seconds(r["time"]),
            f"{r['sigma_min']:.2f}",
            FIRST_MOTIONS.get(r["motion"], ""),
        ]
        for r in kept["motions"]
    ]
    head = ["motion", "rmse, median (worst start) [cm]", "after 3 s [cm]", "without noise to 5 cm [s]"]
    return grid([*head, "median sigma_min", "first study"], lines)


BLOCKS: dict[str, Callable[[dict[str, Any]], str]] = {
    "noise": _noise,
    "tails": _tails,
    "gains": _gains,
    "basin": _basin,
    "anywhere": _anywhere,
    "motions": _motions,
}
