"""Guaranteed bounds in the pictures of a run: shaded, and nothing where there are none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Circle, Patch

from outrider.records import Array, Bools, Ints

SHADE = 0.18  # opacity [-]
Columns = Mapping[str, Any]  # of tracks.parquet, (n,) each, of one track


def bounded(c: Columns) -> Any:
    """(n,) which rows have a bound; also of a run folder that was written before there were any."""
    return np.isfinite(c["bound_position"]) if "bound_position" in c else np.zeros(len(c["t"]), np.bool_)


def legend(table: Any) -> list[Any]:
    """What to say of the shade, if any row of the table of tracks is bounded."""
    name = "bound_position"
    found = name in table.column_names and np.isfinite(table[name].to_numpy()).any()
    return [Patch(fc="0.3", alpha=SHADE, lw=0, label="guaranteed to be within")] if found else []


def around(ax: Axes, c: Columns, rows: Ints, shade: Array) -> None:
    """A disc about the place of some rows of a track, as wide as its bound; shade (len(rows), 4): colours."""
    told = bounded(c)[rows]
    places = zip(c["x"][rows], c["y"][rows], c["bound_position"][rows], strict=True) if told.any() else ()
    discs = [Circle((x, y), r) for x, y, r in places if np.isfinite(r)]
    ax.add_collection(PatchCollection(discs, facecolors=shade[told], alpha=SHADE, lw=0, zorder=3))
    ax.add_collection(PatchCollection(discs, facecolors="none", edgecolors=shade[told], lw=0.6, zorder=3))


def beside(axes: Sequence[Axes], when: Array, c: Columns, shown: Bools, color: str) -> None:
    """Bands on speed, course and time to collision of a track against time [s], where it is `shown` (n,)."""
    told = shown & bounded(c)
    if not told.any():
        return
    look: dict[str, Any] = {"color": color, "alpha": SHADE, "lw": 0, "zorder": 1}
    v, off = c["speed"], c["bound_speed"]
    axes[0].fill_between(when, v - off, v + off, where=told, **look)
    turn, wide = np.degrees(np.unwrap(np.nan_to_num(c["course"]))), np.degrees(c["bound_course"])
    for k in range(int(turn.min() // 360.0) - 1, int(turn.max() // 360.0) + 2):  # seen anew past the seam
        low, high = turn - wide - 360.0 * k, turn + wide - 360.0 * k
        axes[1].fill_between(when, low, high, where=told & (wide < 180.0), **look)
    low, high = axes[0].get_ylim()
    axes[0].set_ylim(low, max(high, float(np.quantile((v + off)[told], 0.9))))
    ttc, top = axes[2], axes[2].get_ylim()[1]
    first, last = (np.minimum(c[f"ttc_{name}"], top) for name in ("earliest", "latest"))
    ttc.fill_between(when, first, last, where=told & (first < top), **look)
