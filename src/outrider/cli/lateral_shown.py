"""What `outrider lateral` prints: estimates, tuned gains and cars in a few lines."""

from math import isfinite
from typing import TYPE_CHECKING

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.cars import Car
    from outrider.lateral.identify import Identified
    from outrider.lateral.run import Run
    from outrider.lateral.tune import Tuned


def identified(made: "Identified", begun: "Car") -> None:
    """Each number of the car: as found, how well, and what the search began from."""
    from outrider import cars

    rows = []
    for name, value in made.car._asdict().items():
        was = getattr(begun, name)
        known = f"{made.spread[name]:.2g}" if name in made.spread else "kept" if value == was else None
        rows.append((cars.FIELDS[name], f"{value:.5g}", known, f"{was:.5g}"))
    show.table(rows, ("", "found", "+-", "from"))
    print(
        f"\n{made.seconds:.0f} s of driving, misfit {made.misfit:.3f} m/s2, |ay| up to {made.most:.1f} m/s2"
    )


def tuned(made: "Tuned") -> None:
    """The bins with what was chosen in each, and the error of every method."""
    unit = "m/s2" if made.over == "ay" else "m/s"
    none = [f"{e:.3f}" if e is not None else None for e in made.rmse_mps[0]]
    truth = [f"{e:.3f}" if e is not None else None for e in made.rms_vy_mps]
    chosen = [f"{value:.4g}" for value in made.values[made.method]]
    rows = zip((f"{edge:g}" for edge in made.edges), made.rows, truth, none, chosen, strict=True)
    what = "k" if made.estimator == "ultra_local" else "alpha"
    show.table([*rows], (f"{made.over} from [{unit}]", "rows", "rms vy", "rmse without", what))
    print()
    errors = [(n, f"{e:.4f}", "chosen" if n == made.method else "") for n, e in made.rmse_of.items()]
    show.table(errors, ("method", "rmse [m/s]", ""))


def estimated(made: "Run") -> list[tuple[str, str]]:
    """What an estimate says of itself, in a few lines."""
    s = made.summary()
    rate = f", {s['rate_hz']:.0f} Hz" if s["rate_hz"] else ""
    rows = [
        ("log", f"{s['rows']} rows, {s['duration_s']:.1f} s{rate}"),
        ("estimator", made.estimator),
        ("held", f"{s['held_rows']} of the rows, {s['held_s']:.1f} s" if s["held_rows"] else "never"),
    ]
    if s["vy"]:
        rows.append(("vy", "rms {rms:.3f}, from {least:.3f} to {most:.3f} m/s".format(**s["vy"])))
    if s["bias_radps"] and isfinite(s["bias_radps"]):
        rows.append(("yaw-rate sensor", f"reads {s['bias_radps']:+.4f} rad/s too much, as known at the end"))
    if s["error"]:
        e = s["error"]
        told = f"rmse {e['rmse_mps']:.3f} m/s, largest {e['largest_mps']:.3f}, mean {e['mean_mps']:+.3f}"
        rows.append(("against the log's vy", f"{told}; vy itself has rms {e['rms_vy_mps']:.3f}"))
    rows += [("fault", text) for text in s["faults"]]
    rows += [("doubt", text) for text in s["doubts"]]
    each = 1e9 * s["seconds"] / s["rows"]
    return [*rows, ("speed", f"{each:.0f} ns a row")]
