"""How long it takes to design and prove a gain table, and to check a shipped proof.

The peer is the interpreter that only loads NumPy: what a check costs above it is ours.
"""

import subprocess
import sys

import pytest

from outrider import design, proof_file
from outrider.observers import certificate_of
from outrider.observers.multi_stage import NOMINAL

SHIPPED = str(proof_file.SHIPPED / "multi_stage.json")
COMMANDS = {
    "numpy alone": [sys.executable, "-c", "import numpy"],
    "outrider certify": [sys.executable, "-m", "outrider", "certify", SHIPPED],
}


@pytest.mark.benchmark(group="design")
def test_table_of_21_speeds(benchmark):
    """Designed and proven, by one P."""
    made = benchmark(lambda: design.table(NOMINAL, (0.05, 0.03), (1.0, 0.25)))
    assert made.certificate.proven()


@pytest.mark.benchmark(group="design")
def test_whole_multi_stage_observer(benchmark):
    """All three stages and the proof of the cascade with its bounds."""
    assert benchmark(design.multi_stage).certificate.proven()


@pytest.mark.benchmark(group="check")
@pytest.mark.parametrize("name", ["multi_stage", "high_gain", "constant_velocity", "invariant"])
def test_check_in_python(benchmark, name):
    """File to verdict, everything loaded."""
    assert benchmark(lambda: certificate_of(proof_file.shipped(name)).proven())


@pytest.mark.benchmark(group="command")
@pytest.mark.parametrize("what", COMMANDS)
def test_check_as_a_command(benchmark, what):
    """A new process, from start to end."""
    benchmark(lambda: subprocess.run(COMMANDS[what], check=True, capture_output=True))
