"""The tables of docs/relocalise-real.md, made from what was kept."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

METHODS = {  # as kept -> as written
    "odometry alone": "odometry alone",
    "pair": "`pose_ekf`, two chosen beams",
    "fixed 0, -90": "`pose_ekf`, fixed: ahead, right",
    "fixed 60, -60": "`pose_ekf`, fixed: ±60 deg",
    "fixed 90, -90": "`pose_ekf`, fixed: ±90 deg",
    "pair, strays removed": "`pose_ekf`, strays taken out by the truth",
    "particles, pair": "1000 particles, two chosen beams",
    "published, pair": "published observer, two chosen beams",
    "published, fixed 0, -90": "published observer, fixed: ahead, right",
    "published, strays removed": "published observer, strays taken out by the truth",
    "fed forward, strays removed": "`wall_range`, fed forward, strays taken out by the truth",
}
BEAMS = {"pair": "two chosen", "0, -90": "ahead, right", "60, -60": "±60 deg"}


def write(kept: dict[str, Any], path: Path) -> None:
    """Every block `<!-- table NAME -->` ... `<!-- end -->` of the page, made anew."""

    def made(match: re.Match[str]) -> str:
        return f"<!-- table {match[1]} -->\n\n{BLOCKS[match[1]](kept)}\n\n<!-- end -->"

    path.write_text(re.sub(r"<!-- table (\S+) -->.*?<!-- end -->", made, path.read_text(), flags=re.DOTALL))


def _grid(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    every = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in every)


def _cm(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}" if value < 0.1 else f"{100 * value:.0f}"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def ranges(kept: dict[str, Any]) -> str:
    """What the beams end on."""
    lines = []
    for run, of in kept["cars"].items():
        for beams, r in of["ranges"].items():
            shares = (r[key] for key in ("read", "of_the_wall", "too_short", "too_long", "unknown_side"))
            lines.append([run, BEAMS[beams], *(f"{100 * share:.0f} %" for share in shares)])
            lines[-1].append(f"{100 * r['both_of_the_wall']:.0f} %")
    head = ("run", "beams", "read", "known wall", "too short", "too long", "unknown side", "scans with both")
    return _grid(head, lines)


def tracking(kept: dict[str, Any]) -> str:
    """Errors by method and run."""
    lines = []
    for name, label in METHODS.items():
        cells = []
        for of in kept["cars"].values():
            e = of["tracking"][name]
            cells.append(f"{_cm(e['rms_m'])} / {_cm(e['largest_m'])}, {e['heading_median_deg']:.1f} deg")
        lines.append([label, *cells])
    return _grid(("cm rms / largest, median heading", *kept["cars"]), lines)


def anywhere(kept: dict[str, Any]) -> str:
    """Searches by beams and run."""
    lines = []
    for run, of in kept["cars"].items():
        for beams, r in of["anywhere"].items():
            counts = [str(r[key]) for key in ("searches", "found_right", "found_wrong", "nothing_found")]
            after = f"{_seconds(r['median_s'])} ({_seconds(r['longest_s'])})"
            end = f"{r['right_at_the_end']} / {r['wrong_at_the_end']}"
            lines.append([run, BEAMS[beams], *counts, after, _cm(r["median_m"]), end])
        r = of["particles"]
        end = f"{r['right_at_the_end']} / {r['wrong_at_the_end']}"
        lines.append([run, "two chosen, 5000 particles", str(r["searches"]), *["-"] * 5, end])
    head = (
        "run",
        "beams",
        "searches",
        "right",
        "wrong",
        "none",
        "after s (longest)",
        "error cm",
        "end: right / wrong",
    )
    return _grid(head, lines)


def odometry(kept: dict[str, Any]) -> str:
    """Odometry over windows."""
    lines = []
    every = {
        **{run: of["odometry"] for run, of in kept["cars"].items()},
        **{f"robot, {name}": windows for name, windows in kept["robot"].items()},
    }
    for name, windows in every.items():
        for seconds, r in windows.items():
            share = r["median_m"] / r["way_m"]
            cells = (r["windows"], f"{r['way_m']:.2f}", _cm(r["median_m"]), f"{100 * share:.1f} %")
            turn = f"{r['heading_median_deg']:.1f} deg"
            lines.append([name, f"{seconds} s", *map(str, cells), _cm(r["largest_m"]), turn])
            lines[-1].append(f"{r['normalised']:.1f}")
    head = (
        "recording",
        "window",
        "windows",
        "way m",
        "median cm",
        "of the way",
        "largest cm",
        "heading",
        "normalised",
    )
    return _grid(head, lines)


BLOCKS: dict[str, Callable[[dict[str, Any]], str]] = {
    "ranges": ranges,
    "tracking": tracking,
    "anywhere": anywhere,
    "odometry": odometry,
}
