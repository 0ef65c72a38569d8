"""What `outrider relocalise` prints: where a robot was found, and whether it can be found at all."""

from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.relocalise.room import Room
    from outrider.relocalise.run import Run

EVENTS = 6  # printed at most


def estimated(made: "Run") -> list[tuple[str, str]]:
    """What a run says of itself, in a few lines."""
    s = made.summary()
    rate = f", {s['rate_hz']:.0f} Hz" if s["rate_hz"] else ""
    rows = [("log", f"{s['rows']} rows, {s['duration_s']:.1f} s{rate}"), ("observer", made.observer)]
    rows.append(("rows", show.listed(s["states"])))
    first = s["first_known_s"]
    rows.append(("first known", "never" if first is None else f"after {first:.1f} s"))
    rows += [(f"at {e['t_s']:.1f} s", e["what"]) for e in s["events"][:EVENTS]]
    if len(s["events"]) > EVENTS:
        rows.append(("and", f"{len(s['events']) - EVENTS} more, see summary.json"))
    end = s["at_the_end"]
    for i, pose in enumerate(end["poses"][: made.room.wall.symmetry or 1]):
        told = "x {x_m:.3f} m, y {y_m:.3f} m, theta ".format(**pose) + f"{degrees(pose['theta_rad']):.1f} deg"
        rows.append((f"at the end, {end['state']}" if i == 0 else "or", told))
    if s["observability"]:
        seen = s["observability"]
        told = f"{seen['word']}: median {seen['median']:.3f}, weak in {100 * seen['weak']:.1f} % of the rows"
        rows.append(("observability", told))
    if s["error"]:
        e = s["error"]
        told = f"rmse {e['rmse_m']:.4f} m, median {e['median_m']:.4f} m, largest {e['largest_m']:.3f} m"
        rows.append(("against the log's pose", f"{told}; heading rmse {degrees(e['rmse_rad']):.2f} deg"))
    if any(s["out_of_reach"]):
        rows.append(
            ("out of reach", "range_1 in {} rows, range_2 in {}: not used".format(*s["out_of_reach"]))
        )
    rows += [("note", text) for text in (*s["faults"], *s["doubts"])]
    return [*rows, ("speed", f"{1e3 * s['seconds'] / s['rows']:.2f} ms a row")]


def checked(room: "Room", v: float, w: float, output: Path | None, json: bool) -> None:
    """The verdict for a room and a motion, as words and a table; the map where a picture is asked for."""
    from outrider.relocalise import check

    made = check.check(room, v, w)
    if output is not None:
        from outrider import plots_relocalise

        plots_relocalise.save_map(room, v, w, output)
    if json:
        show.json({**made._asdict(), "seen": made.seen._asdict(), "path": output})
        return
    print(*made.words, sep="\n")
    print()
    rows = [
        (name, f"{median:.3f}", f"{low:.4f}", f"{100 * weak:.1f} %")
        for name, (median, low, weak) in made.motions.items()
    ]
    show.table(rows, ("motion", "observability, median", "5 % are below", "weak"))
    if output is not None:
        print(f"\nmap drawn to {output}")
