"""Pictures of lateral velocity: every line is there, in the right place, and none is flattened by another."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from outrider import cars, plots_lateral
from outrider.errors import OutputError
from outrider.lateral import course, plant, run

pytestmark = pytest.mark.once

B = cars.load("b_class")


@pytest.fixture(scope="module")
def log():
    return plant.simulate(course.winding(2, 600.0), B, 1.0, "mems", 1)


def test_the_lines_are_the_truth_the_estimates_and_their_errors(log):
    figure = plots_lateral.over_time(log, {"zero": np.zeros(len(log.t)), "same": log.vy}, title="made")
    middle, below = figure.axes[1], figure.axes[2]
    lines = {line.get_label().split(",")[0]: line.get_ydata() for line in middle.lines}
    assert np.array_equal(lines["truth"], log.vy)
    assert np.array_equal(lines["same"], log.vy)
    assert not lines["zero"].any()
    assert np.array_equal(below.lines[0].get_ydata(), -log.vy)
    said = {line.get_label().split(",")[0]: line.get_label() for line in middle.lines}
    assert said["same"].endswith("RMSE 0.000 m/s")
    assert said["zero"].endswith(f"RMSE {np.sqrt(np.mean(log.vy**2)):.3f} m/s")


def test_an_estimate_that_drifts_does_not_flatten_the_others(log):
    figure = plots_lateral.over_time(log, {"drift": np.linspace(0.0, 50.0, len(log.t))})
    most = np.abs(log.vy).max()
    for ax in figure.axes[1:3]:
        assert max(np.abs(ax.get_ylim())) < 2.0 * most


def test_a_log_without_truth_has_no_error_panel(log):
    bare = type(log)(log.t, log.vx, log.yaw_rate, log.ay, log.steering)
    figure = plots_lateral.over_time(bare, {"kalman": log.vy})
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert "lateral velocity [m/s]" in labels
    assert "error [m/s]" not in labels


def test_what_was_held_is_shaded_and_a_gap_is_a_gap(log):
    held = (log.t > 5.0) & (log.t < 8.0)
    vy = np.where(held, np.nan, log.vy)
    figure = plots_lateral.over_time(log, {"kalman": vy}, held=held)
    shades = [p for p in figure.axes[1].patches if p.get_facecolor() == to_rgba("0.85")]
    assert len(shades) == 1
    assert shades[0].get_x() == pytest.approx(5.0, abs=0.03)
    assert shades[0].get_x() + shades[0].get_width() == pytest.approx(8.0, abs=0.03)


def test_a_span_is_all_that_is_drawn(log):
    figure = plots_lateral.over_time(log, {"same": log.vy}, span=(3.0, 6.0))
    t = figure.axes[1].lines[0].get_xdata()
    assert (t.min(), t.max()) == (pytest.approx(3.0, abs=0.011), pytest.approx(6.0, abs=0.011))


def test_errors_over_ranges_are_those_of_the_rows_in_them(log):
    figure = plots_lateral.over_ranges(log, {"off": log.vy + 0.25, "zero": np.zeros(len(log.t))})
    top = figure.axes[0]
    truth, off, zero = (line.get_ydata() for line in top.lines)
    assert off[np.isfinite(off)] == pytest.approx(0.25)
    assert np.array_equal(truth, zero, equal_nan=True)
    seconds = sum(bar.get_height() for bar in figure.axes[2].patches)
    assert seconds == pytest.approx(log.t[-1] - log.t[0], abs=0.02)


def test_a_run_is_saved(log, tmp_path):
    path = plots_lateral.save(run.run(log, B, "scheduled"), tmp_path)
    assert path.name == "vy.png"
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(OutputError):
        plots_lateral.save(run.run(log, B, "scheduled"), tmp_path / "none")
