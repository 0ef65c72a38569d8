"""The validation of lateral velocity: the cars of others are theirs, and the page says what was kept."""

import sys
from pathlib import Path

import numpy as np
import pytest

from outrider import cars
from outrider.lateral import course, plant

pytest.importorskip("vehiclemodels", reason="the cars of others: uv pip install 'outrider[bench]'")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import markdown  # noqa: E402
from benchmarks.lateral import cases, commonroad, report, table  # noqa: E402

pytestmark = pytest.mark.once

B = cars.load("b_class")
LONG = {"multibody": pytest.mark.slow}  # to compile
KINDS = [pytest.param(kind, marks=LONG.get(kind, ())) for kind in commonroad.KINDS]


@pytest.fixture(scope="module")
def kept():
    return table.read(ROOT / "benchmarks" / "results" / "lateral.json")


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_they_are_what_the_package_says(kind):
    p = commonroad.parameters(B, 0.8)
    module = commonroad.vehicle_dynamics_mb if kind == "multibody" else commonroad.vehicle_dynamics_std
    plain = getattr(module, module.__name__.rpartition(".")[2])
    made = commonroad._compiled()[commonroad.KINDS.index(kind)]
    core = [0.0, 0.0, 0.03, 12.0, 0.2, 0.25, -0.02]
    start = commonroad.init_mb(core, p) if kind == "multibody" else commonroad.init_std(core, p)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x = np.array(start) * (1.0 + 0.01 * rng.standard_normal(len(start)))
        u = np.array([0.1, -2.0])
        assert made(x.copy(), u, commonroad.frozen(p)) == pytest.approx(plain(list(x), list(u), p), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_in_a_gentle_bend_they_drive_as_the_linear_model_says(kind):
    """The stiffness they were given is the one of the tables; a roll of 16 % is read as ay."""
    bend = course.Course(1.0, np.full(150, 1.0 / 150.0), np.zeros(150), np.zeros(150))
    speed = np.full(150, 12.0)
    theirs, ours = commonroad.drive(kind, bend, B, speed=speed), plant.drive(bend, B, speed=speed)
    assert theirs.whole
    for name, within in (("vx", 0.01), ("yaw_rate", 0.01), ("steering", 0.03), ("vy", 0.15)):
        assert getattr(theirs, name)[-1] == pytest.approx(getattr(ours, name)[-1], rel=within)
    over = 1.0 + course.G * cases.ROLL if kind == "multibody" else 1.0
    assert theirs.ay[-1] == pytest.approx(over * theirs.vx[-1] * theirs.yaw_rate[-1], rel=0.01)


def test_the_page_says_what_was_kept(kept):
    page = (ROOT / "docs" / "lateral-validation.md").read_text()
    assert markdown.filled(page, kept, report.BLOCKS) == page
    assert markdown.names(page) == set(report.BLOCKS)


def test_what_was_kept_is_whole(kept):
    drives = {(r["truth"], r["name"], r["noise"]) for r in kept["rows"]}
    assert len(drives) == len(cases.TRUTHS) * len(cases.DRIVES) * len(plant.NOISES)
    for row in kept["rows"]:
        assert set(row["rmse"]) == {m.label for m in cases.methods()}


def test_a_row_is_what_is_kept(kept):
    """One drive judged anew, on this machine."""
    ride = next(r for r in cases.DRIVES if r.name == "winding, dry")
    (row,) = report.rows(kept, truth="own", name=ride.name, noise="mems")
    method = next(m for m in cases.METHODS if m.label == "`scheduled`")
    vy = table.estimate(method, "own", ride, "mems")
    assert table.rmse(vy, cases.driven("own", ride).vy) == pytest.approx(row["rmse"][method.label], abs=2e-4)


def test_the_order_that_the_page_tells_of(kept):
    """Without noise the combined method beats the fixed one; with the source's, scheduling beats both."""
    for row in report.rows(kept, name="dry"):
        labels = (report.FIXED, report.COMBINED, report.SCHEDULED)
        fixed, combined, scheduled = (row["rmse"][x] for x in labels)
        assert scheduled < fixed
        if row["noise"] == "none":
            assert combined < 0.35 * fixed
        if row["noise"] == "paper":
            assert scheduled < combined
