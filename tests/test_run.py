"""The run folder: what is in it, and what is left of it when writing ends badly."""

import json
import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Footer, Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from numpy.testing import assert_allclose, assert_array_equal

from made_frames import DT, STREET, make_frames
from outrider import __version__
from outrider.errors import InputError, OutputError
from outrider.io._run_background import Background
from outrider.io.run import RunWriter, finish, open_run
from outrider.records import Alert, Level, TrackState
from outrider.settings import Settings

COLUMNS = [
    *("t", "track_id", "x", "y", "vx", "vy", "speed", "acceleration", "course", "yaw", "slip", "yaw_rate"),
    *("length", "width", "state", "hits", "ttc", "bound_position", "bound_speed", "bound_course"),
    *("ttc_earliest", "ttc_latest"),
]
FRAMES = list(make_frames(40))


def write(folder, frames=FRAMES, **options):
    with RunWriter(folder, Settings(), **options) as run:
        write_all(run, frames)
    return open_run(folder)


def write_all(run, frames):
    for frame in frames:
        run.write(frame)


def test_every_track_of_every_scan_is_a_row():
    run = write("run")
    table = run.to_pandas()
    assert list(table.columns) == COLUMNS
    assert len(table) == sum(len(f.tracks.id) for f in FRAMES)
    for frame in FRAMES:
        rows = table[table.t == frame.t]
        assert_array_equal(rows.track_id, frame.tracks.id)
        assert_array_equal(rows[["x", "y"]], frame.tracks.W_p)
        assert_array_equal(rows[["vx", "vy"]], frame.tracks.W_v)
        assert_array_equal(rows[["length", "width"]], frame.tracks.extent)
        for name in ("speed", "acceleration", "course", "yaw", "slip", "yaw_rate", "hits"):
            assert_array_equal(rows[name], getattr(frame.tracks, name))
        assert_array_equal(rows[["bound_position", "bound_speed"]], frame.tracks.bound)
        assert_array_equal(rows.bound_course, frame.tracks.course_bound)
        for name in ("ttc", "ttc_earliest", "ttc_latest"):
            assert_array_equal(rows[name], getattr(frame.threats, name))
        assert list(rows.state) == [TrackState(s).name.lower() for s in frame.tracks.state]


def test_every_scan_is_a_row_even_when_there_is_no_track():
    run = write("run", list(make_frames(20, cars=())))
    assert run.tracks.num_rows == 0
    assert run.tracks.column_names == COLUMNS
    assert run.scans.num_rows == 20
    assert_allclose(run.scans["ego_x"].to_numpy(), 3.0 * DT * np.arange(20))
    assert set(run.scans["valid"].to_pylist()) == {int(f.scan.valid.sum()) for f in make_frames(20, cars=())}


def test_lengths_are_those_of_the_recording():
    full, small = write("full").to_pandas(), write("small", scale=10.0).to_pandas()
    lengths = ["x", "y", "vx", "vy", "speed", "acceleration", "length", "width"]
    lengths += ["bound_position", "bound_speed"]
    assert_allclose(small[lengths], full[lengths] / 10.0, atol=1e-12)
    rest = [c for c in COLUMNS if c not in lengths]
    assert small[rest].equals(full[rest])
    assert open_run("small").settings.recording.scale == 10.0
    ego = [open_run(f).scans["ego_x"].to_numpy() for f in ("full", "small")]
    assert_allclose(ego[1], ego[0] / 10.0)
    assert_allclose(
        np.ptp(open_run("small").background[:, 1]), np.ptp(open_run("full").background[:, 1]) / 10, rtol=0.05
    )


def test_the_folder_says_what_made_it():
    settings = Settings()
    with RunWriter("run", settings, about={"recording": "street.bag"}) as run:
        started = json.loads(Path("run/summary.json").read_text())
        write_all(run, FRAMES)
        run.close({"seconds": 1.5})
    assert started == {
        "version": __version__,
        "finished": False,
        "interrupted": False,
        "recording": "street.bag",
    }
    run = open_run("run")
    assert run.settings == settings
    said = {
        k: run.summary[k] for k in ("version", "finished", "interrupted", "recording", "seconds", "scans")
    }
    assert said == {**started, "finished": True, "seconds": 1.5, "scans": 40}
    assert (run.summary["t_first"], run.summary["t_last"]) == (FRAMES[0].t, FRAMES[-1].t)
    assert run.summary["masked_beams"] == {"no return": sum(int((~f.scan.valid).sum()) for f in FRAMES)}
    names = {"alerts.jsonl", "background.npz", "run.mcap", "scans.parquet", "settings.toml", "summary.json"}
    assert {p.name for p in Path("run").iterdir()} == {*names, "tracks.parquet"}


def alerted(levels, degraded=()):
    """Frames with the given levels about track 3; `degraded`: indices of those not to be trusted."""
    for i, (frame, level) in enumerate(zip(make_frames(len(levels)), levels, strict=True)):
        reasons = ("stale",) if i in degraded else ()
        yield replace(
            frame, alert=Alert(frame.t, level, 3 if level else -1, 2.5 if level else np.inf, reasons)
        )


def test_an_alert_is_a_line_only_when_it_changes():
    none, notice, danger = Level.NONE, Level.NOTICE, Level.DANGER
    run = write("run", list(alerted([none, none, notice, notice, danger, danger, none, none], degraded=[7])))
    assert run.alerts == [
        {"t": pytest.approx(1000.2), "level": "notice", "track_id": 3, "ttc": 2.5, "degraded": []},
        {"t": pytest.approx(1000.4), "level": "danger", "track_id": 3, "ttc": 2.5, "degraded": []},
        {"t": pytest.approx(1000.6), "level": "none", "track_id": None, "ttc": None, "degraded": []},
        {"t": pytest.approx(1000.7), "level": "none", "track_id": None, "ttc": None, "degraded": ["stale"]},
    ]
    assert run.summary["alerts"] == {"notice": 1, "caution": 0, "danger": 1}
    assert run.summary["degraded_scans"] == 1


def test_a_folder_with_something_in_it_is_refused_unless_forced():
    Path("run").mkdir()
    Path("run/notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"not empty.*--force"):
        RunWriter("run", Settings())
    Path("run/scene.png").write_text("of an earlier run")
    run = write("run", force=True)
    assert Path("run/notes.txt").read_text() == "mine"
    assert not Path("run/scene.png").exists()
    assert run.scans.num_rows == 40


def test_a_file_is_no_folder():
    Path("run").write_text("")
    with pytest.raises(InputError, match="is a file"):
        RunWriter("run", Settings(), force=True)
    with pytest.raises(InputError, match=r"no settings\.toml"):
        open_run("elsewhere")


# ------------------------------------------------------------------ run.mcap


def messages(path):
    with Path(path).open("rb") as file:
        return [
            (schema.name, channel.topic, message.log_time, decoded)
            for schema, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory(), Plain()]
            ).iter_decoded_messages()
        ]


class Plain:
    """JSON for the reader."""

    def decoder_for(self, encoding, schema):
        return json.loads if encoding == "json" else None


def test_foxglove_finds_schemas_frames_and_times():
    write("run")
    found = messages("run/run.mcap")
    names = {(topic, schema) for schema, topic, _, _ in found}
    assert names == {
        ("/points", "foxglove.PointCloud"),
        ("/scene", "foxglove.SceneUpdate"),
        ("/tf", "foxglove.FrameTransforms"),
        ("/alerts", "foxglove.Log"),
        ("/alert", "outrider.Alert"),
        ("/tracks", "outrider.Tracks"),
    }
    for topic in ("/points", "/scene", "/tf", "/alert", "/tracks"):
        times = [t for _, name, t, _ in found if name == topic]
        assert times == [round(f.t * 1e9) for f in FRAMES]
    links = {
        (t.parent_frame_id, t.child_frame_id) for _, n, _, m in found if n == "/tf" for t in m.transforms
    }
    assert links == {("map", "base_link"), ("base_link", "laser")}
    used = {m.frame_id for _, n, _, m in found if n == "/points"}
    used |= {e.frame_id for _, n, _, m in found if n == "/scene" for e in m.entities}
    assert used == {"map", "base_link"}


def test_foxglove_sees_what_the_frame_holds():
    write("run", FRAMES[-1:])
    content = {topic: message for _, topic, _, message in messages("run/run.mcap")}
    frame, tracks = FRAMES[-1], FRAMES[-1].tracks
    cloud = content["/points"]
    xy = np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4)[:, :2]
    origin = [cloud.pose.position.x, cloud.pose.position.y]
    assert_allclose(xy + origin, frame.scan.W_p[frame.scan.valid], atol=1e-5)
    stamp = cloud.timestamp
    assert stamp.seconds + 1e-9 * stamp.nanos == pytest.approx(frame.t, abs=1e-6)
    boxes = {e.id: e for e in content["/scene"].entities}
    assert set(boxes) == {"rider", *(f"track {i}" for i in tracks.id)}
    for row, i in enumerate(tracks.id):
        box = boxes[f"track {i}"].cubes[0]
        assert_allclose([box.pose.position.x, box.pose.position.y], tracks.W_p[row])
        assert_allclose([box.size.x, box.size.y], tracks.extent[row])
        q = box.pose.orientation
        assert_allclose(np.cos(2 * np.arctan2(q.z, q.w) - tracks.yaw[row]), 1.0)
        stands = tracks.state[row] == TrackState.STATIC
        assert len(boxes[f"track {i}"].arrows) == len(boxes[f"track {i}"].texts) == (not stands)
    body = content["/tf"].transforms[0]
    assert_allclose([body.translation.x, body.translation.y], frame.scan.ego.W_pose[:2])
    assert [row["track_id"] for row in content["/tracks"]["tracks"]] == tracks.id.tolist()
    assert [row["x"] for row in content["/tracks"]["tracks"]] == tracks.W_p[:, 0].tolist()
    assert content["/alert"]["level"] == frame.alert.level.name.lower()


def test_foxglove_shows_lengths_of_the_recording():
    write("run", FRAMES[:1], scale=10.0)
    scene = next(message for _, topic, _, message in messages("run/run.mcap") if topic == "/scene")
    outline = next(e for e in scene.entities if e.id == "rider").lines[0].points
    assert_allclose(max(p.x for p in outline) - min(p.x for p in outline), Settings().rider.length_m / 10.0)
    car = next(e for e in scene.entities if e.id == "track 3").cubes[0]
    assert_allclose([car.size.x, car.size.y], [0.45, 0.18])


# ------------------------------------------------------------------ bad endings

WRITES_AND_DIES = """
import itertools, os, signal, sys
sys.path.insert(0, sys.argv[1])
from made_frames import make_frames
from outrider.io.run import RunWriter
from outrider.settings import Settings
with RunWriter("run", Settings(), about={"recording": "street.bag"}) as run:
    for n, frame in enumerate(make_frames(1000), 1):
        run.write(frame)
        if n == 75:
            os.kill(os.getpid(), signal.SIGKILL)
"""


def kept_messages(path):
    """Messages of a cut file, up to the cut."""
    count = 0
    with Path(path).open("rb") as file, suppress(EndOfFile):
        for record in StreamReader(file).records:
            assert not isinstance(record, Footer)
            count += isinstance(record, Message)
    return count


def test_a_killed_process_leaves_every_finished_chunk():
    here = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", WRITES_AND_DIES, here], check=False)
    assert done.returncode == -signal.SIGKILL
    assert kept_messages("run/run.mcap") > 5 * 45
    assert not Path("run/tracks.parquet").exists()
    killed = open_run("run")
    assert not killed.summary["finished"]
    n = killed.scans.num_rows
    assert 60 <= n <= 75
    whole = write("whole", list(make_frames(n)))
    assert killed.tracks.equals(whole.tracks)
    assert killed.scans.equals(whole.scans)
    assert killed.alerts[: len(whole.alerts)] == whole.alerts

    ended = finish("run")
    assert ended.tracks.equals(whole.tracks)
    assert (ended.summary["finished"], ended.summary["interrupted"], ended.summary["scans"]) == (
        True,
        True,
        n,
    )
    assert ended.summary["recording"] == "street.bag"
    assert Path("run/tracks.parquet").exists()
    assert not Path("run/tracks.arrows").exists()
    assert {topic for _, topic, _, _ in messages("run/run.mcap")} >= {"/points", "/scene", "/tf", "/tracks"}
    assert finish("run").summary == ended.summary


def test_a_table_cut_anywhere_gives_its_finished_chunks():
    path, chunks = Path("run/tracks.arrows"), []
    with RunWriter("run", Settings()) as run:
        for frame in FRAMES:
            run.write(frame)
            chunks.append((path.stat().st_size, open_run("run").tracks.num_rows))
        whole, scans = path.read_bytes(), Path("run/scans.arrows").read_bytes()
    everything = open_run("run").tracks
    assert len(set(chunks)) > 3
    Path("cut").mkdir()
    Path("cut/settings.toml").write_text("")
    Path("cut/scans.arrows").write_bytes(scans)
    for length in {*np.linspace(0, len(whole), 60).astype(int), *(size for size, _ in chunks)}:
        Path("cut/tracks.arrows").write_bytes(whole[:length])
        kept = open_run("cut").tracks
        assert kept.num_rows == max([rows for size, rows in chunks if size <= length], default=0)
        assert kept.equals(everything.slice(0, kept.num_rows))


def test_a_line_of_alerts_that_was_cut_is_left_out():
    write("run", list(alerted([Level.NOTICE, Level.DANGER])))
    path = Path("run/alerts.jsonl")
    path.write_bytes(path.read_bytes()[:-9])
    assert [a["level"] for a in open_run("run").alerts] == ["notice"]


def interrupted(frames):
    yield from frames
    raise KeyboardInterrupt


def test_ctrl_c_leaves_a_valid_folder():
    with pytest.raises(KeyboardInterrupt):
        write("run", interrupted(FRAMES[:23]))
    run = open_run("run")
    assert run.scans.num_rows == run.summary["scans"] == 23
    assert run.summary["finished"]
    assert run.summary["interrupted"]
    assert len(messages("run/run.mcap")) >= 5 * 23


@pytest.mark.parametrize("limit", [0, 4_000, 30_000, 150_000])
def test_a_full_disk_is_one_line_and_loses_nothing_written(limit):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        with pytest.raises(OutputError) as caught:
            write("run", make_frames(400))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)
    assert "\n" not in str(caught.value)
    assert "cannot write" in str(caught.value)
    if limit >= 4_000:
        run = open_run("run")
        n = run.scans.num_rows
        whole = write("whole", list(make_frames(n)))
        assert run.tracks.equals(whole.tracks)
        assert n > limit / 10_000
        assert finish("run").scans.num_rows == n


def test_a_full_disk_at_the_end_keeps_the_stream():
    run = RunWriter("run", Settings())
    for frame in FRAMES:
        run.write(frame)
    Path("run/tracks.part").mkdir()  # where the Parquet file is prepared
    with pytest.raises(OutputError, match="cannot write"):
        run.close()
    Path("run/tracks.part").rmdir()
    assert open_run("run").scans.num_rows == 40
    assert finish("run").tracks.num_rows == sum(len(f.tracks.id) for f in FRAMES)


def test_no_permission_is_one_line():
    Path("locked").mkdir()
    Path("locked").chmod(0o555)
    code = "from outrider.io.run import RunWriter; from outrider.settings import Settings; "
    code += "from outrider.errors import OutputError\n"
    code += "try:\n RunWriter('locked/run', Settings())\nexcept OutputError as e:\n print(e)"
    Path().chmod(0o755)
    as_root = os.geteuid() == 0
    drop = "import os; os.setgid(65534); os.setuid(65534)\n" if as_root else ""
    warm = "import outrider.io._run_mcap, outrider.io._run_tables, outrider.io.run\n"
    done = subprocess.run(
        [sys.executable, "-c", warm + drop + code], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert "locked/run: cannot write (Permission denied)" in done.stdout
    assert done.stdout.count("\n") == 1


# ------------------------------------------------------------------ cost


def later(frames, start):
    """The same frames, from time `start` on."""
    for i, f in enumerate(frames):
        t = start + i * DT
        yield replace(
            f,
            t=t,
            scan=replace(f.scan, t=t, ego=replace(f.scan.ego, t=t)),
            tracks=replace(f.tracks, t=t),
            alert=replace(f.alert, t=t),
        )


def test_memory_does_not_grow_with_the_length_of_a_run():
    held = []
    with RunWriter("run", Settings()) as run:
        tracemalloc.start()
        for turn in range(12):
            for frame in later(FRAMES, 1000.0 + 40 * DT * turn):
                run.write(frame)
            held.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert held[-1] - held[3] < 150_000


def test_the_background_holds_what_stands_and_no_more_than_its_limit():
    free, tight = Background(0.1), Background(0.1, limit=200)
    for frame in make_frames(100):
        free.add(frame)
        tight.add(frame)
    assert len(tight.points) <= 200
    assert tight.cell > 0.1
    often = free.points[free.seen >= 2]
    on_wall = np.abs(np.abs(often[:, 1]) - 8.0) < 0.1
    parked = [c.pose(0.0)[:2] for c in STREET if c.speed == 0.0]
    near_parked = np.min([np.abs(often - p).max(axis=1) for p in parked], axis=0) < 2.6
    assert (on_wall | near_parked).all()
    assert on_wall.sum() > 100
