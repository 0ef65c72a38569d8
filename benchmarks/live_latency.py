"""From a lidar's last beam to the alert and to the horn, the lidar emulated in a process of its own.

python benchmarks/live_latency.py [--seconds 60] [--write] [A1 S2 ...]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

RESULT = Path(__file__).parent / "results" / "live_latency.json"
# Car after car, straight at the rider: three levels each.
WORLD = """
title = "A car comes straight at a standing rider"
duration_s = 4.0
vehicles = [{ name = "car", x_m = 40.0, y_m = 0.0, yaw_deg = 180.0, speed_mps = 8.0 }]
walls = [{ points_m = [[-20.0, 6.0], [60.0, 6.0]] }]
"""


def outrider(*tokens):
    return [sys.executable, "-m", "outrider", *map(str, tokens)]


def measure(model, seconds, folder):
    """The figures of one live run; `model` may name a mode too, as A1:Standard."""
    model, _, mode = model.partition(":")
    (folder / "world.toml").write_text(WORLD)
    lidar, chosen = folder / "lidar", ["--mode", mode] if mode else []
    emulate = outrider("emulate", folder / "world.toml", "--model", model, "--link", lidar)
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as emulator:
        emulator.stdout.readline()
        live = outrider("live", "--port", lidar, *chosen, "--seconds", seconds, "--json")
        horn = ["--horn", f"wav:{folder / 'horn.wav'}"]
        done = subprocess.run([*live, *horn], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
        emulator.terminate()
    told = json.loads(done.stdout)
    return {
        "mode": told["source"]["mode"],
        "scans": told["counts"]["scans"],
        "dropped": told["counts"]["dropped turns"],
        "to_the_host": told["of_it_on_the_way"],
        "computing": told["of_it_computing"],
        "to_the_alert": told["last_beam_to_alert"],
        "to_the_horn": told["sinks"]["horn"]["last_beam_to_sound"],
    }


def main():
    """One line a model; with --write the figures are kept."""
    options = argparse.ArgumentParser()
    options.add_argument("models", nargs="*", default=["A1", "A1:Standard", "C1", "S2"])
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--write", action="store_true")
    asked = options.parse_args()
    found = {"load": os.getloadavg()[0], "seconds": asked.seconds}
    for model in asked.models:
        with tempfile.TemporaryDirectory() as folder:
            found[model] = one = measure(model, asked.seconds, Path(folder))
        parts = ", ".join(f"{k} {one[k]['p50_ms']}/{one[k]['p99_ms']} ms" for k in one if k.startswith("to_"))
        print(f"{model}: {one['mode']}, {one['scans']} scans, {parts}", flush=True)
    if asked.write:
        RESULT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
