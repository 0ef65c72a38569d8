"""A run folder, finished or killed, for the page: any picture by its number, and series of one track.

The folder has lengths of the recording; the page is given those of the full-size world, as in a live run.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from outrider.errors import InputError
from outrider.io._run_points import RunPoints
from outrider.io.run import Run
from outrider.live.page.message import Picture, hello, pack
from outrider.records import Alert, Array, Bools, Ego, Ints, Level, Tracks, TrackState

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

LEVELS = {level.name.lower(): level for level in Level}
STATES = {state.name.lower(): state for state in TrackState}
SILENT = Alert(np.nan, Level.NONE, -1, np.inf, ())
Columns = dict[str, Any]  # of a table of the run folder, (n,) each


class RunShow:
    """Pictures of a run; InputError for one without a scan."""

    def __init__(self, run: Run) -> None:
        self._run, self._scale = run, run.settings.recording.scale
        self._scans = _columns(run.scans)
        self._tracks = _columns(run.tracks)
        self._t = self._scans["t"]
        if not len(self._t):
            raise InputError(f"{run.folder}: a run without a scan; nothing to show")
        self._rows = _rows_of_scans(self._t, self._tracks["t"])
        self._alerts = _alerts(self._t, run.alerts)
        self._points = RunPoints(run.folder / "run.mcap")

    def __len__(self) -> int:
        return len(self._t)

    def picture(self, k: int) -> Picture:
        """Picture k, from 0 on."""
        s, c = self._scale, {name: column[k] for name, column in self._scans.items()}
        pose = np.array([s * c["ego_x"], s * c["ego_y"], c["ego_yaw"]])
        v = s * np.array([c["ego_vx"], c["ego_vy"]])
        ego = Ego(float(c["t"]), pose, v, float(c["ego_yaw_rate"]), bool(c["ego_known"]))
        rows = slice(*self._rows[k : k + 2])
        mine = {name: column[rows] for name, column in self._tracks.items()}
        tracks, times = _tracks(ego.t, mine, s), _times(mine)
        return Picture(ego, s * self._points.at(k), tracks, times, self._alert(k, tracks, times))

    def _alert(self, k: int, tracks: Tracks, times: Array) -> Alert:
        """The alert after scan k: what was told last, with the time to collision of now."""
        told = self._alerts[k]
        row = np.flatnonzero(tracks.id == told.track)
        which = 1 if self._run.settings.alert.act_on == "earliest" else 0
        return Alert(
            float(self._t[k]),
            LEVELS[self._scans["level"][k]],
            told.track,
            float(times[row[0], which]) if len(row) else np.inf,
            told.degraded,
        )

    # ------------------------------------------------------------------ what the page asks for

    async def serve(self, socket: WebSocket) -> None:
        """Answer each number of a picture with that picture."""
        await socket.send_text(self._hello().decode())
        loop = asyncio.get_running_loop()
        while True:
            text = await socket.receive_text()
            if text.isascii() and text.isdigit():
                k = min(int(text), len(self) - 1)
                await socket.send_bytes(await loop.run_in_executor(None, self._packed, k))

    def _packed(self, k: int) -> bytes:
        return pack(self.picture(k), number=k)

    def _hello(self) -> bytes:
        said, origin = self._run.summary, [self._scans["ego_x"][0], self._scans["ego_y"][0]]
        about: dict[str, Any] = {"recording": Path(said.get("recording", "")).name}
        about |= {name: said[name] for name in ("observer", "version") if name in said}
        ending = said.get("error") or ("" if said.get("finished") else "it was cut off")
        run = {
            "t": self._t.tolist(),
            "levels": [int(LEVELS[name]) for name in self._scans["level"]],
            "origin": [self._scale * float(x) for x in origin],
        }
        about |= {"ending": ending} if ending else {}
        return hello(self._run.settings, about, mode="run", run=run)

    def data(self, name: str, query: Mapping[str, str]) -> bytes | None:
        """`background`: (n, 2) float32 from the rider's first place; `series?track=ID`: columns as JSON."""
        if name == "background":
            first = np.array([self._scans["ego_x"][0], self._scans["ego_y"][0]])
            points: Array = self._scale * (self._run.background - first)
            return points.astype("<f4").tobytes()
        track = query.get("track", "")
        if name == "series" and track.isascii() and track.isdigit() and len(track) < 19:
            return self._series(int(track))
        return None

    def _series(self, track: int) -> bytes:
        """Columns of one track at every scan, seconds from the first; null where it was not there."""
        mine = self._tracks["track_id"] == track
        scan = np.repeat(np.arange(len(self)), np.diff(self._rows))[mine]
        found = {name: column[mine] for name, column in self._tracks.items()}
        earliest_latest = _times(found)[:, 1:].T
        wanted = {
            "speed": self._scale * found["speed"],
            "off": self._scale * _bound(found)[:, 1],
            "ttc": found["ttc"],
            **dict(zip(("earliest", "latest"), earliest_latest, strict=True)),
        }
        out: dict[str, Any] = {"t": (self._t - self._t[0]).tolist()}
        for name, values in wanted.items():
            column = np.full(len(self), np.nan)
            column[scan] = values
            out[name] = column.tolist()
        return msgspec.json.encode(out)


def _columns(table: Any) -> Columns:
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def _rows_of_scans(t: Array, rows_t: Array) -> Ints:
    """(n + 1,) where the rows of each scan begin: they lie in its order, and some scans have none."""
    ends = np.append(np.flatnonzero(np.diff(rows_t)) + 1, len(rows_t)).tolist()
    begins, at, group = np.zeros(len(t) + 1, np.int64), 0, 0
    for k, now in enumerate(t.tolist()):
        if at < len(rows_t) and rows_t[at] == now:
            at, group = ends[group], group + 1
        begins[k + 1] = at
    return begins


def _alerts(t: Array, lines: list[dict[str, Any]]) -> list[Alert]:
    """What had been told last after each scan; lines are written at the time of their scan, in order."""
    told, now, after = deque(lines), SILENT, []
    for when in t.tolist():
        if told and told[0]["t"] == when:
            line = told.popleft()
            track = -1 if line["track_id"] is None else line["track_id"]
            now = Alert(when, LEVELS[line["level"]], track, np.inf, tuple(line["degraded"]))
        after.append(now)
    return after


def _tracks(t: float, c: Columns, scale: float) -> Tracks:
    """The rows of one scan as tracks of the full-size world; what the folder does not keep is zero."""
    n = len(c["track_id"])
    state = np.array([STATES[name] for name in c["state"]], np.uint8)
    broken: Bools = np.zeros(n, np.bool_)
    return Tracks(
        t=t,
        id=c["track_id"],
        state=state,
        hits=c["hits"],
        broken=broken,
        **{name: c[name] for name in ("course", "yaw", "slip", "yaw_rate")},
        W_p=scale * np.column_stack([c["x"], c["y"]]),
        speed=scale * c["speed"],
        acceleration=scale * c["acceleration"],
        extent=scale * np.column_stack([c["length"], c["width"]]),
        cov=np.zeros((n, 2, 2)),
        age=np.zeros(n),
        bound=scale * _bound(c),
    )


def _bound(c: Columns) -> Array:
    """(n, 2) the bounds; infinite in a run that was written before there were any."""
    with suppress(KeyError):
        return np.column_stack([c["bound_position"], c["bound_speed"]])
    return np.full((len(c["track_id"]), 2), np.inf)


def _times(c: Columns) -> Array:
    """(n, 3) expected, earliest and latest time to collision [s]."""
    n = len(c["track_id"])
    return np.column_stack([
        c["ttc"], c.get("ttc_earliest", np.zeros(n)), c.get("ttc_latest", np.full(n, np.inf))
    ])  # fmt: skip
