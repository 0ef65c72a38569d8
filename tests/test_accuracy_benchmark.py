"""The scripts of the comparison at a size of seconds: sets, search, rows, tables and picture."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import markdown  # noqa: E402
from benchmarks.accuracy import driving, methods, peers, pictures, report, sets, table, tune  # noqa: E402

from outrider.compare import estimate, judge  # noqa: E402
from outrider.errors import InputError  # noqa: E402
from outrider.geometry import wrap  # noqa: E402
from outrider.observers import ekf  # noqa: E402

pytestmark = pytest.mark.once


def short(series, n=40):
    """The first n samples."""
    truth = type(series.truth)(*(getattr(series.truth, k)[:n] for k in ("t", "W_p", "W_v", "yaw")))
    return type(series)(series.name, series.t[:n], series.y[:n], truth)


def little(_name):
    """Two drives, whatever is asked for."""
    return [short(s) for s in sets.load("simulated/train")[:2]]


# ------------------------------------------------------------------ sets


@pytest.mark.parametrize("name", list(driving.MANOEUVRES))
def test_a_drive_has_the_velocity_of_its_path(name):
    speed, slip = driving.MANOEUVRES[name]
    truth = driving.drive(speed, slip, 1.0, 1.0, 1.4, 0.3)
    middle = (truth.W_p[2:] - truth.W_p[:-2]) / (2.0 * driving.PERIOD_S)
    assert np.abs(middle - truth.W_v[1:-1]).max() < 0.1  # second order in the period
    slip = np.deg2rad(25.0)
    forward = (truth.W_v * np.column_stack([np.cos(truth.yaw), np.sin(truth.yaw)])).sum(axis=1)
    assert (np.abs(forward) >= np.cos(slip) * np.hypot(*truth.W_v.T) - 1e-9).all()


def test_simulated_drives_stop_and_reverse():
    s = {x.name: x for x in sets.load("simulated")}
    assert len(s) == 2 * len(driving.MANOEUVRES)
    stopped = np.hypot(*s["braking to a stop x1.0"].truth.W_v.T)
    assert stopped.min() < 1e-9
    truth = s["backing out x1.0"].truth
    forward = (truth.W_v * np.column_stack([np.cos(truth.yaw), np.sin(truth.yaw)])).sum(axis=1)
    assert forward.min() < -2.0
    assert forward.max() > 7.0


def test_hops_stay_within_reach_and_outliers_are_rare():
    plain, hops, far = (sets.load(n) for n in ("simulated", "simulated-hops", "simulated-outliers"))
    moved = np.concatenate([h.y[:, :2] - p.y[:, :2] for h, p in zip(hops, plain, strict=True)])
    assert 0.4 < np.hypot(*moved.T).max() <= np.hypot(0.4, 0.2)
    changed = np.concatenate(
        [np.hypot(*(f.y[:, :2] - p.y[:, :2]).T) for f, p in zip(far, plain, strict=True)]
    )
    assert 0.003 < (changed > 0.0).mean() < 0.02
    assert changed.max() <= 20.0
    assert changed[changed > 0.0].min() >= 5.0


def test_smoothing_keeps_a_parabola():
    t = np.sort(np.random.default_rng(1).uniform(0.0, 5.0, 40))
    poses = np.column_stack([3.0 * t + t**2, 1.0 - 2.0 * t, 0.2 * t + 3.0])
    truth = sets.smoothed(t, np.column_stack([poses[:, :2], wrap(poses[:, 2])]))
    np.testing.assert_allclose(truth.W_p, poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(truth.W_v, np.column_stack([3.0 + 2.0 * t, np.full(40, -2.0)]), atol=1e-8)
    np.testing.assert_allclose(wrap(truth.yaw - poses[:, 2]), 0.0, atol=1e-9)


def test_an_unknown_set_and_missing_data_say_so(monkeypatch):
    with pytest.raises(InputError, match="want one of kitti/train"):
        sets.load("kitti/other")
    monkeypatch.setenv("OUTRIDER_DATA", "nowhere")
    with pytest.raises(InputError, match="OUTRIDER_DATA='nowhere'"):
        sets.data()


@pytest.mark.usefixtures("data")
@pytest.mark.parametrize(
    ("name", "tracks", "scatter"),
    [("kitti/train", 14, 0.06), ("argoverse/train", 15, 0.12), ("argoverse-hops/train", 15, 0.7)],
)
def test_labelled_tracks(name, tracks, scatter):
    series = sets.load(name)
    assert len(series) >= tracks
    for s in series:
        assert (np.diff(s.t) > 0.05).all()
        assert np.sqrt(np.mean((s.y[:, :2] - s.truth.W_p) ** 2)) < scatter
        along = (s.truth.W_v * np.column_stack([np.cos(s.truth.yaw), np.sin(s.truth.yaw)])).sum(axis=1)
        assert along.min() > -1.0  # labels point the way they drive


# ------------------------------------------------------------------ search and rows


def test_the_quick_score_is_that_of_compare():
    series = little("")
    gains = ekf.Gains()
    estimates = [estimate(ekf, gains, s) for s in series]
    J, lost = tune.Judge(series)(estimates)
    whole = judge(estimates, series)
    np.testing.assert_allclose(J, whole.J, rtol=1e-12)
    assert lost == whole.divergences


def test_a_search_is_repeatable_within_its_ranges_and_no_worse_than_the_default():
    method, training = methods.Method("ekf", "heading"), [little("")]
    found = tune.search(method, training, 12)
    assert found == tune.search(method, training, 12)
    judged = {tune.Judge(s): s for s in training}
    default = {k: v for k, v in method.gains()._asdict().items() if k in method.ranges()}
    assert found.score <= tune.score(method, default, judged)
    for name, (low, high) in method.ranges().items():
        assert 0.999 * low <= found.values[name] <= 1.001 * high


@pytest.mark.parametrize("name", list(methods.TUNED))
def test_every_gain_that_is_tuned_exists(name):
    pytest.importorskip("stonesoup")
    fields = methods.Method(name, "position").gains()._fields
    assert set(methods.TUNED[name]) | set(methods.HEADING_GAIN.get(name, {})) <= set(fields)


@pytest.mark.parametrize("name", ["ekf", "constant_velocity", *peers.NAMES])
def test_rows_tables_and_picture(name, tmp_path):
    pytest.importorskip("stonesoup")  # one table names them all
    rows = [*table.tuned_rows(name, "simulated", little, whole=2, peer=2)]
    rows += table.fixed_rows(name, little, ["simulated/test"])
    table.timed_rows(rows[:1], little, "simulated/test")
    for row in rows:
        figures = row["sets"]["simulated/test"]
        assert figures["samples"] == 60 - 2 * row["lag"]
        assert figures["velocity_mps"] is not None
    page = tmp_path / "page.md"
    page.write_text("".join(f"<!-- table {block} -->\n<!-- end -->\n" for block in report.BLOCKS))
    markdown.write(page, rows, report.BLOCKS)
    text = page.read_text()
    markdown.write(page, rows, report.BLOCKS)
    assert page.read_text() == text
    for row in rows:
        assert report.label(row).split(",")[0] in text
    pictures.save(rows, tmp_path)
    assert (tmp_path / "comparison.png").stat().st_size > 10_000
