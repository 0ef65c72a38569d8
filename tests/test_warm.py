"""The second process of a first run compiles just what the first one will ask for."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.once

SCRIPT = """
import sys
from numba.core import event

class Listener(event.Listener):
    names = []
    def on_start(self, e):
        self.names.append(e.data["dispatcher"].py_func.__name__)
    def on_end(self, e):
        pass

event.register("numba:compile", Listener())
if sys.argv[1] == "warm":
    from outrider.warm import compile_later_steps
    compile_later_steps()
else:
    import outrider
    from outrider import simulate
    for frame in outrider.track(simulate.record(simulate.load("crossing"))):
        pass
print(*Listener.names)
"""
LATER = {"widen", "measure", "ask", "_assess", "start_all", "step_all", "predict_all", "each_one"}


def compiled(what, cache):
    env = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, what], env=env, capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_what_the_second_process_compiled_is_not_compiled_again(tmp_path):
    assert compiled("warm", tmp_path) >= LATER
    again = compiled("track", tmp_path)
    assert "fit_pairs" in again
    assert not again & LATER
