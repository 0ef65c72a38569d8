"""Every command as it is typed: what it prints, what it writes, how it ends."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from outrider import cli, datasets, io, observers, simulate
from outrider.io.run import open_run
from refusals import refused

COMMANDS = (
    *("demo", "track", "info", "convert", "simulate", "evaluate", "compare"),
    *("design", "certify", "reproduce", "lateral", "relocalise", "ls", "cite"),
    *("live", "emulate", "view"),
)
HEAD_ON = """
title = "A car comes straight at a standing rider"
duration_s = 4.0
vehicles = [{ name = "car", x_m = 40.0, y_m = 0.0, yaw_deg = 180.0, speed_mps = 8.0 }]
walls = [{ points_m = [[-20.0, 6.0], [60.0, 6.0]] }]
"""
PROGRAM = [sys.executable, "-m", "outrider"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with a recording of a car that comes straight at a standing rider, and its run folder `run`."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "head_on.toml").write_text(HEAD_ON)
    assert cli.run(["simulate", str(folder / "head_on.toml"), "-o", str(folder / "rec.mcap")]) == 0
    assert cli.run(["track", str(folder / "rec.mcap"), "-o", str(folder / "run")]) == 0
    return folder


# ------------------------------------------------------------------ help


def test_help_names_every_command():
    done = subprocess.run([*PROGRAM, "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert all(re.search(rf"^\W*{name}\b", done.stdout, flags=re.M) for name in COMMANDS)


def test_help_loads_nothing_heavy():
    """What makes `outrider --help` quick: a slow library is loaded by the command that needs it."""
    script = "import sys; from outrider.cli import run; run(['--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert "cyclopts" in loaded
    assert not loaded & {
        "numpy",
        "numba",
        "scipy",
        "matplotlib",
        "pyarrow",
        "rosbags",
        "mcap",
        "foxglove",
        "pooch",
    }


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(outrider, command):
    code, out, _ = outrider(command, "--help")
    assert code == 0
    assert f"Usage: outrider {command}" in out


def test_version(outrider):
    from outrider import __version__

    assert outrider("--version")[1].strip() == __version__


def test_completion_can_be_installed(outrider):
    assert "--shell" in outrider("--install-completion", "--help")[1]


@pytest.mark.parametrize(
    ("tokens", "word"),
    [
        (["track", "rec.mcap", "-o", "run", "--sclae", "2"], "--sclae"),
        (["track", "rec.mcap"], "--output"),
        (["track", "-o", "run"], "RECORDING"),
        (["trck"], "trck"),
        (["track", "rec.mcap", "-o", "run", "--scale", "big"], "big"),
        (["ls", "people"], "people"),
    ],
)
def test_wrong_words_end_in_one_line(outrider, tokens, word):
    assert refused(outrider(*tokens), word)


# ------------------------------------------------------------------ track


def test_track_leaves_a_run_folder_with_pictures(made):
    files = {p.name for p in (made / "run").iterdir()}
    assert files == {
        *("settings.toml", "summary.json", "alerts.jsonl", "run.mcap", "background.npz", "scene.png"),
        *("tracks.png", "tracks.parquet", "scans.parquet"),
    }


def test_track_says_what_came_out(outrider, made, tmp_path):
    code, out, _ = outrider("track", made / "rec.mcap", "-o", tmp_path / "run", "--no-pictures")
    assert code == 0
    assert not (tmp_path / "run" / "scene.png").exists()
    s = open_run(tmp_path / "run").summary
    assert s["least_ttc"]["ttc_s"] < 1.0
    assert re.search(r"^alerts +1 notice, 1 caution, 1 danger$", out, flags=re.M)
    assert f"{s['scans']} scans" in out
    assert f"{s['tracks']}, of which {s['moving_tracks']} moved" in out
    assert f"{s['least_ttc']['ttc_s']:.2f} s to contact" in out
    assert f"{tmp_path / 'run'}/" in out


def test_track_in_json(outrider, made, tmp_path):
    _, out, _ = outrider("track", made / "rec.mcap", "-o", tmp_path / "run", "--no-pictures", "--json")
    told = json.loads(out)
    assert told.pop("folder") == str(tmp_path / "run")
    assert told == open_run(tmp_path / "run").summary


def test_track_does_not_overwrite(outrider, made, tmp_path):
    before = (made / "run" / "summary.json").read_bytes()
    assert refused(outrider("track", made / "rec.mcap", "-o", made / "run"), "--force")
    assert (made / "run" / "summary.json").read_bytes() == before
    target = tmp_path / "run"
    for tokens in ([], ["--force"]):
        assert outrider("track", made / "rec.mcap", "-o", target, "--no-pictures", *tokens)[0] == 0


def test_options_become_settings(outrider, made, tmp_path):
    (tmp_path / "mine.toml").write_text("[detect]\nmin_hits = 4\nmax_range_m = 50.0\n")
    options = [
        "--settings",
        tmp_path / "mine.toml",
        "--set",
        "detect.min_hits=5",
        "--set",
        "alert.notice_s=4.5",
    ]
    options += ["--scale", "2", "--observer", observers.names()[0], "--scan-topic", "/scan"]
    options += ["--ego-topic", "none", "--truth-topic", "/truth/target", "--no-pictures"]
    truth = next(t.name for t in io.open_recording(made / "rec.mcap").topics if t.name.startswith("/truth/"))
    options = [truth if o == "/truth/target" else o for o in options]
    assert outrider("track", made / "rec.mcap", "-o", tmp_path / "run", *options)[0] == 0
    used = open_run(tmp_path / "run").settings
    assert (used.detect.min_hits, used.detect.max_range_m, used.alert.notice_s) == (5, 50.0, 4.5)
    assert (used.recording.scale, used.recording.ego_topic) == (2.0, "none")
    assert used.recording.truth_topics == (truth,)


@pytest.mark.parametrize(
    ("option", "value", "word"),
    [
        ("--set", "detect.min_hist=5", "min_hits"),
        ("--set", "detect", "section.key=value"),
        ("--settings", "absent.toml", "absent.toml"),
        ("--observer", "multistage", "multi_stage"),
        ("--scan-topic", "/scam", "/scan"),
        ("--ego-topic", "/scan", "want a pose"),
    ],
)
def test_wrong_settings_end_in_one_line_and_leave_nothing(outrider, made, tmp_path, option, value, word):
    assert refused(outrider("track", made / "rec.mcap", "-o", tmp_path / "run", option, value), word)
    assert not (tmp_path / "run").exists()


def test_a_data_set_brings_its_settings(outrider, data, tmp_path):
    code, out, _ = outrider(
        "track", "dataset:datmo/parallel", "-o", tmp_path / "run", "--set", "rider.width_m=1.9"
    )
    assert code == 0
    used = open_run(tmp_path / "run").settings
    known = datasets.entry("datmo/parallel").settings
    assert used.recording.scale == known["recording"]["scale"]
    assert used.rider.length_m == known["rider"]["length_m"]
    assert used.rider.width_m == 1.9
    code, out, _ = outrider("evaluate", tmp_path / "run")
    assert code == 0
    assert "/red_pose" in out


# ------------------------------------------------------------------ the other commands


def test_info(outrider, made):
    out = outrider("info", made / "rec.mcap")[1]
    assert re.search(r"^/scan +scan +\d+ +10\.00 Hz", out, flags=re.M)
    assert re.search(r"^/ego_pose +ego ", out, flags=re.M)
    assert re.search(r"^beams +480$", out, flags=re.M)
    told = json.loads(outrider("info", made / "rec.mcap", "--json")[1])
    assert told["chosen"]["scan"] == "/scan"
    assert told["repairs"] == []


def test_info_tells_what_would_be_repaired(outrider, tmp_path):
    messages = simulate.record(simulate.load("constant"), faults={"time_scale": 1e-3})
    io.write_recording(tmp_path / "wrong.mcap", messages)
    out = outrider("info", tmp_path / "wrong.mcap")[1]
    assert "would be repaired: time_increment repaired: header 2.08e-07 s" in out


def test_convert_there_and_back(outrider, made, tmp_path):
    count = json.loads(outrider("convert", made / "rec.mcap", tmp_path / "a.parquet", "--json")[1])[
        "messages"
    ]
    assert outrider("convert", tmp_path / "a.parquet", tmp_path / "b", "--format", "ros2-sqlite3")[0] == 0
    assert f"{count} messages" in outrider("convert", tmp_path / "b", tmp_path / "c.mcap")[1]
    assert refused(outrider("convert", made / "rec.mcap", tmp_path / "a.parquet"), "--force")
    assert outrider("convert", made / "rec.mcap", tmp_path / "a.parquet", "--force")[0] == 0
    assert refused(outrider("convert", made / "rec.mcap", tmp_path / "a.xyz"), ".xyz")


def test_simulate_with_the_same_seed_gives_the_same_bytes(outrider, tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        assert outrider("simulate", "oncoming", "-o", tmp_path / f"{name}.csv", "--seed", seed)[0] == 0
    a, b, c = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert a == b != c
    assert refused(outrider("simulate", "oncoming", "-o", tmp_path / "a.csv"), "--force")
    assert refused(outrider("simulate", "oncomming", "-o", tmp_path / "d.csv"), "oncoming")


def test_evaluate(outrider, made):
    out = outrider("evaluate", made / "run")[1]
    assert re.search(r"position \[m\]", out)
    told = json.loads(outrider("evaluate", made / "run", "--json", "--skip", "2")[1])
    assert all(0.0 <= body["present"] <= 1.0 for body in told["targets"].values())
    moved = json.loads(outrider("evaluate", made / "run", "--json", "--skip", "2", "--offset", "0.5,0")[1])
    assert moved["targets"] != told["targets"]


@pytest.mark.parametrize(
    ("options", "word"),
    [(["--offset", "0.5"], "x,y"), (["--skip", "900"], "no scan"), (["--truth", "absent.bag"], "absent.bag")],
)
def test_evaluate_refuses(outrider, made, options, word):
    assert refused(outrider("evaluate", made / "run", *options), word)


def test_evaluate_wants_a_run_folder(outrider, tmp_path):
    assert refused(outrider("evaluate", tmp_path), "settings.toml")


@pytest.mark.parametrize(
    "what",
    ["scenarios", "observers", "estimators", "relocalisers", "rooms", "cars", "datasets", "formats"],
)
def test_ls(outrider, what):
    told = json.loads(outrider("ls", what, "--json")[1])
    assert list(told) == [what]
    out = outrider("ls")[1]
    assert all(entry["name"] in out for entry in told[what])


def test_cite(outrider):
    every = outrider("cite", *datasets.names())[1]
    entries = re.findall(r"^@(\w+)\{(\w+),$", every, flags=re.M)
    assert len(entries) == len({key for _, key in entries}) == 10
    assert every.count("{") == every.count("}")
    assert len(outrider("cite")[1]) < len(every)
    assert refused(outrider("cite", "kiti"), "kitti0000")


def test_demo(outrider, tmp_path):
    code, out, _ = outrider("demo", "-o", tmp_path / "demo")
    assert code == 0
    assert re.search(r"^ +\d+\.\d s  danger +track \d+, \d+ m ahead", out, flags=re.M)
    assert re.search(r"^brakes_late +6\.40 s, had it not braked +[23]\.\d\d s before", out, flags=re.M)
    assert re.search(r"^runs_light +13\.96 s +[23]\.\d\d s before", out, flags=re.M)
    assert "danger told of anyone else: none" in out
    for name in re.findall(r"^ +(\S+\.(?:png|mcap))", out, flags=re.M):
        assert Path(name).is_file()
    assert refused(outrider("demo", "-o", tmp_path / "demo"), "--force")
    told = json.loads(outrider("demo", "-o", tmp_path / "demo", "--force", "--no-pictures", "--json")[1])
    assert [course["body"] for course in told["collision_courses"]] == ["brakes_late", "runs_light"]


# ------------------------------------------------------------------ how it ends


def test_ctrl_c_leaves_a_valid_run_folder(tmp_path):
    """A long recording, stopped while it runs; exit code 130 and one line."""
    path = tmp_path / "long.parquet"
    io.write_recording(path, long_drive())
    run = tmp_path / "run"
    process = subprocess.Popen(
        [*PROGRAM, "track", str(path), "-o", str(run)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    for _ in range(1200):
        time.sleep(0.1)
        if process.poll() is not None or ((run / "tracks.arrows").exists() and rows(run) > 20):
            break
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err == "outrider: stopped\n"
    left = open_run(run)
    assert left.summary["finished"]
    assert left.summary["interrupted"]
    assert left.summary["scans"] == left.scans.num_rows > 20
    assert (run / "tracks.parquet").exists()
    from outrider import read

    assert read(run / "run.mcap") is not None


def rows(folder):
    try:
        return open_run(folder).scans.num_rows
    except Exception:  # written to at this moment
        return 0


def long_drive():
    """The scans of a scenario, over and over again for ten minutes."""
    import dataclasses

    world = simulate.load("constant")
    messages = list(simulate.record(world))
    turn = messages[-1].received_ns - messages[0].received_ns + 20_000_000
    for k in range(int(600 / world.duration_s)):
        for m in messages:
            shift = k * turn
            yield dataclasses.replace(m, stamp_ns=m.stamp_ns + shift, received_ns=m.received_ns + shift)


def test_a_reader_that_goes_away_is_no_error():
    process = subprocess.Popen([*PROGRAM, "cite"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 141
    assert err == b""


def test_no_progress_where_there_is_no_terminal(made, tmp_path):
    tokens = ["track", str(made / "rec.mcap"), "-o", str(tmp_path / "run"), "--no-pictures"]
    done = subprocess.run([*PROGRAM, *tokens], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_progress_on_a_terminal(made, tmp_path):
    """Count, rate and remaining time on stderr; nothing of it on stdout."""
    import pty

    main, terminal = pty.openpty()
    tokens = ["track", str(made / "rec.mcap"), "-o", str(tmp_path / "run"), "--no-pictures"]
    env = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    process = subprocess.Popen([*PROGRAM, *tokens], stdout=subprocess.PIPE, stderr=terminal, env=env)
    os.close(terminal)
    shown = b""
    while True:
        try:
            shown += os.read(main, 4096)
        except OSError:  # closed at the other end
            break
    os.close(main)
    out = process.stdout.read()
    process.stdout.close()
    assert process.wait(timeout=60) == 0
    total = open_run(tmp_path / "run").summary["scans"]
    assert f"{total}/{total}".encode() in shown
    assert b"scans/s" in shown
    assert b"\x1b" not in out
