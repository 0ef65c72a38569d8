"""The comparison of observers, search and particle filters: what was kept, the page, and a tiny run of it."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import markdown  # noqa: E402
from benchmarks.relocalise import cases, follow, report, table, tune  # noqa: E402

from outrider.relocalise import motions  # noqa: E402

pytestmark = pytest.mark.once

SMALL = {"ks": np.array([1.0, 10.0]), "ka": np.array([0.01, 0.1])}


@pytest.fixture(scope="module")
def kept():
    return table.read(ROOT / "benchmarks" / "results" / "relocalise.json")


def one(kept, part, **what):
    """The row with these fields."""
    (row,) = (r for r in kept[part] if all(r[key] == value for key, value in what.items()))
    return row


def test_the_page_says_what_was_kept(kept):
    page = (ROOT / "docs" / "relocalise-comparison.md").read_text()
    assert markdown.filled(page, kept, report.BLOCKS) == page
    assert markdown.names(page) == set(report.BLOCKS)


def test_what_was_kept_is_whole(kept):
    assert len(kept["noise"]) == len(cases.NOISE) * (len(cases.METHODS) + len(cases.CLOUDS) + 1)
    assert len(kept["basin"]) == 4 * len(cases.BASIN)
    assert {r["motion"] for r in kept["motions"]} == set(motions.MOTIONS)
    searched = [r for r in kept["anywhere"] if r["method"] == "search"]
    assert [(r["wall"], r["cell"]) for r in searched] == [(c.wall, c.label) for c in cases.ANYWHERE]


@pytest.mark.parametrize("cell", cases.NOISE[:2])
def test_a_row_is_what_is_kept(kept, cell):
    """The filter, judged anew on this machine."""
    method = next(m for m in cases.METHODS if m.label == "`pose_ekf`")
    (row,) = table.noise((cell,), (method,), clouds=())
    assert row["rms"] == pytest.approx(
        one(kept, "noise", cell=cell.label, method=method.label)["rms"], rel=0.02
    )


def test_the_order_that_the_page_tells_of(kept):
    for cell in cases.NOISE:
        rms = {r["method"]: r["rms"] for r in kept["noise"] if r["cell"] == cell.label}
        parabola, line = (rms[f"published, rates by a {x}"] for x in ("parabola", "line"))
        fed = rms["fed forward, rates by a parabola"]
        assert line < parabola
        assert fed < 0.5 * line
        assert rms["`pose_ekf`"] < 0.5 * fed
        assert rms["`pose_ekf`"] < 0.6 * rms["fed forward, true rates (no robot has them)"]
    motion = {r["motion"]: r["rms"] for r in kept["motions"]}
    assert min(motion, key=motion.__getitem__) == motions.DEFAULT


def test_the_search_finds_all_and_says_what_is_ambiguous(kept):
    for row in (r for r in kept["anywhere"] if r["method"] == "search"):
        assert row["good"] >= row["runs"] - (row["runs"] == 16)
        assert row["ambiguous"] == (0 if row["wall"] == "asymmetric" else row["runs"])


def test_the_basin_is_whole_in_the_ellipse_and_half_without_symmetry(kept):
    fed = {"method": "fed forward 5, 1", "sigma": 0.0}
    assert one(kept, "basin", wall="ellipse", **fed)["good"] >= 0.98
    assert 0.3 < one(kept, "basin", wall="asymmetric", **fed)["good"] < 0.7


def test_a_tiny_run():
    """Tuning, observers, a particle filter, the search, the basin and a motion, as small as they come."""
    cell = cases.Cell("ellipse", 10.0, 0.01, 2)
    method = cases.Method("fed forward", "wall_range", "parabola", {}, SMALL)
    (row,) = table.noise((cell,), (method,), clouds=(), runs=3)
    assert row["rms"] < 0.15
    assert set(row["gains"]) == {"ks", "ka"}
    (found,) = table.anywhere((cell,), clouds=(), seconds=4.0)
    assert (found["good"], found["ambiguous"], found["left"]) == (2, 2, 2.0)
    rows = table.basin(20, ("ellipse",), (cases.BASIN[2],), seconds=6.0)
    assert rows[0]["good"] == 1.0
    (spin,) = table.driving(("spin",), repeats=1)
    assert spin["rms"] < spin["worst"] < 0.03


def test_a_tuned_cloud_follows():
    cell = cases.Cell("ellipse", 10.0, 0.01)
    drives = tune.driven(cell, 1, 2, 6.0)
    guess = tune.guesses(drives, 1)
    gains = cases.AMCL._replace(particles=300.0, width=0.05)
    poses = np.stack([follow.cloud(drives, cell.room, gains, i, guess[i]) for i in range(2)], axis=1)
    assert follow.rms(follow.errors(cell.room, poses, drives.truth), drives.t, 4.0).max() < 0.1


def test_errors_know_symmetry():
    where = cases.ANYWHERE[0].room
    truth = np.array([[[1.0, 0.5, 0.3]]])
    off = follow.errors(where, np.array([[[-1.0, -0.4, 0.3 + np.pi]]]), truth)
    assert off.position == pytest.approx(0.1)
    assert off.heading == pytest.approx(0.0, abs=1e-12)


def test_success_is_what_lasts():
    t = np.arange(0.0, 5.0, 0.5)
    position = np.where(t < 2.0, 1.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    position[-1, 2] = 1.0
    good, since = follow.success(follow.Errors(position, 0.0 * position), t)
    assert good.tolist() == [True, True, False]
    assert since[:2].tolist() == [2.0, 0.0]
