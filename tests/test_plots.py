"""The pictures: that what is drawn is what the run holds, and that it can be read."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Annotation, Text
from numpy.testing import assert_allclose

from made_frames import STREET, Car, make_frames
from outrider import plots, plots_bounds
from outrider.errors import OutputError
from outrider.io.run import RunWriter, open_run
from outrider.metrics import Truth
from outrider.settings import Settings


def run_of(cars=STREET, n=80, scale=1.0):
    with RunWriter("run", Settings(), scale=scale, force=True) as run:
        for frame in make_frames(n, cars):
            run.write(frame)
    return open_run("run")


def crowd(n=24):
    rng = np.random.default_rng(0)
    for i in range(1, n + 1):
        start = (rng.uniform(-20, 40), rng.uniform(-15, 15), rng.uniform(-3, 3))
        yield Car(i, start, rng.choice([0.0, 4.0, 7.0]), rng.uniform(-0.4, 0.4), born=rng.uniform(0, 4))


def truth_of(car, n=80):
    t = 0.1 * np.arange(n)
    poses = np.array([car.pose(s) for s in t])
    yaw = poses[:, 2]
    return Truth(t + 1000.0, poses[:, :2], car.speed * np.column_stack([np.cos(yaw), np.sin(yaw)]), yaw)


def labels(ax):
    return {t.get_text(): t for t in ax.texts if isinstance(t, Annotation)}


def test_both_pictures_have_their_size_and_are_not_empty():
    run = run_of()
    paths = plots.save(run, "run", {"car": truth_of(STREET[2])})
    assert [p.name for p in paths] == ["scene.png", "tracks.png"]
    for path in paths:
        picture = imread(path)
        assert picture.shape[:2] == (1200, 1600)
        assert 0.01 < (picture[..., :3].min(axis=-1) < 0.9).mean() < 0.5


def test_a_way_is_where_the_track_was():
    ax = plots.scene(run_of((STREET[3],)))
    (way,) = [c for c in ax.collections if isinstance(c, LineCollection) and len(c.get_segments()) > 5]
    points = np.vstack([s[0] for s in way.get_segments()])
    distance = np.abs(np.hypot(*(points - circle_centre(STREET[3])).T) - 6.0 / 0.06)
    assert distance.max() < 1e-6
    assert ax.get_aspect() == 1.0


def circle_centre(car):
    x, y, yaw = car.start
    return np.array([x, y]) + car.speed / car.yaw_rate * np.array([-np.sin(yaw), np.cos(yaw)])


def test_a_bound_is_a_disc_as_wide_as_it_is():
    run = run_of((STREET[3],))
    ax = plots.scene(run)
    (discs,) = [
        c for c in ax.collections if isinstance(c, PatchCollection) and c.get_alpha() == plots_bounds.SHADE
    ]
    sizes = np.array([np.ptp(path.vertices, axis=0) for path in discs.get_paths()])
    assert len(sizes) >= 7
    assert_allclose(sizes, 0.6, atol=1e-6)
    assert "guaranteed to be within" in [text.get_text() for text in ax.get_legend().get_texts()]


def test_what_is_not_bounded_has_no_shade():
    run = run_of((STREET[3],))
    names = [n for n in run.tracks.column_names if not n.startswith("bound")]
    for table in (run.tracks.select(names), no_bounds(run.tracks)):  # of an older version; switched off
        there = replace(run, tracks=table)
        for ax in (plots.scene(there), plots.tracks(there)[0]):
            said = [text.get_text() for text in ax.get_legend().get_texts()]
            assert "guaranteed to be within" not in said


def no_bounds(table):
    names = ("bound_position", "bound_speed")
    columns = {n: np.full(len(table), np.inf) if n in names else table[n] for n in table.column_names}
    return type(table).from_pydict(columns)


def test_only_what_moved_long_enough_is_named():
    brief = Car(9, (10.0, -5.0, 0.0), 3.0, born=7.6)
    ax = plots.scene(run_of((*STREET, brief)))
    assert set(labels(ax)) == {"track 3", "track 4", "track 5", "rider"}
    grey = [c for c in ax.collections if isinstance(c, PolyCollection) and len(c.get_edgecolor())]
    grey = [c for c in grey if np.allclose(c.get_edgecolor()[0, :3], 0.5, atol=0.01)]
    assert [len(c.get_paths()) for c in grey] == [2]


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_no_name_covers_another_or_leaves_the_picture(scale):
    ax = plots.scene(run_of(tuple(crowd()), scale=scale))
    renderer = ax.figure.canvas.get_renderer()
    ax.figure.draw_without_rendering()
    boxes = [Text.get_window_extent(t, renderer) for t in labels(ax).values()]
    assert len(boxes) > 10
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(ax.bbox.x0 <= b.x0 and b.x1 <= ax.bbox.x1 for b in boxes)


def test_an_alert_stands_where_its_track_was():
    run = run_of()
    ax = plots.scene(run)
    marks = [line for line in ax.lines if line.get_marker() == "^"]
    assert [m.get_markerfacecolor() for m in marks] == [
        plots.LEVELS[n] for n in ("notice", "caution", "danger")
    ]
    raised = [a for a in run.alerts if a["level"] != "none"]
    for mark, alert in zip(marks, raised, strict=True):
        assert_allclose(mark.get_xydata()[0], STREET[4].pose(alert["t"] - 1000.0)[:2], atol=1e-9)


def test_lines_against_time_are_the_columns():
    run = run_of()
    speed, course, ttc = plots.tracks(run, {"car": truth_of(STREET[2])})
    shown = {line.get_label(): line for line in speed.lines}
    assert {"track 3", "track 4", "track 5"} <= set(shown)
    table = run.to_pandas()
    rows = table[(table.track_id == 5) & (table.state == "confirmed")]
    seen = shown["track 5"].get_xydata()
    seen = seen[np.isfinite(seen).all(axis=1)]
    assert_allclose(seen, np.column_stack([rows.t - 1000.0, rows.speed]), atol=1e-9)
    times = [line.get_xydata() for line in ttc.lines if line.get_marker() == "."]
    drawn = np.vstack([xy[np.isfinite(xy).all(axis=1)] for xy in times])
    finite = table[np.isfinite(table.ttc) & (table.state == "confirmed")]
    assert_allclose(np.sort(drawn[:, 1]), np.sort(finite.ttc))
    black = [line for line in course.lines if line.get_color() == "k"]
    assert_allclose(black[0].get_ydata(), 0.0)
    assert speed.get_ylim()[0] <= 0.0


def test_a_course_that_passes_the_seam_is_not_drawn_across():
    ax = plots.tracks(run_of((Car(1, (0.0, 0.0, 2.5), 6.0, yaw_rate=0.3),)))[1]
    for line in ax.lines:
        steps = np.abs(np.diff(line.get_ydata()))
        assert np.nanmax(steps, initial=0.0) < 10.0


def test_bands_are_where_the_alerts_were():
    run = run_of()
    ax = plots.tracks(run)[2]
    bands = sorted((p.get_x(), p.get_x() + p.get_width()) for p in ax.patches)
    times = [a["t"] - 1000.0 for a in run.alerts]
    assert_allclose(bands, list(pairwise(times)), atol=1e-9)


def test_a_run_in_which_nothing_happened_is_drawn():
    for cars, n in (((), 0), ((), 3), (STREET[:2], 3)):
        assert [p.stat().st_size > 5_000 for p in plots.save(run_of(cars, n), "run")] == [True, True]


def test_pictures_can_go_into_a_figure_of_ones_own():
    run, figure = run_of(n=20), Figure()
    ax = figure.add_subplot()
    assert plots.scene(run, ax=ax) is ax
    assert plots.tracks(run, figure=Figure())[0].figure is not figure


def test_a_picture_that_cannot_be_written_is_one_line():
    with pytest.raises(OutputError, match=r"nowhere/scene\.png: cannot write"):
        plots.save(run_of(n=3), "nowhere")
