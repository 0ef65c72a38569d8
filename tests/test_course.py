"""Courses: closed forms of a circle, plans that keep what they promise, lines that are refused."""

import numpy as np
import pytest

from outrider.errors import InputError
from outrider.lateral import course


def circle(radius, n=200, sign=1.0):
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    return radius * np.column_stack([np.cos(angle), sign * np.sin(angle)])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_circle_has_the_curvature_of_one(sign):
    made = course.along(circle(60.0, sign=sign))
    smoothed = 60.0 * np.exp(-0.5 * (course.SMOOTH / 60.0) ** 2)  # a Gaussian draws a circle inwards
    assert made.curvature == pytest.approx(sign / smoothed, rel=1e-4)
    assert made.length == pytest.approx(2.0 * np.pi * smoothed, rel=1e-3)
    assert np.hypot(made.x, made.y) == pytest.approx(smoothed, rel=1e-4)


def test_it_does_not_matter_where_a_line_begins_or_whether_its_start_is_repeated():
    line = circle(60.0) * [1.0, 0.5]
    turned = course.along(np.roll(line, 70, axis=0))
    repeated = course.along(np.vstack([line, line[:1]]))
    made = course.along(line)
    assert repeated.curvature == pytest.approx(made.curvature, abs=1e-12)
    assert turned.length == pytest.approx(made.length, rel=1e-6)
    assert turned.curvature.max() == pytest.approx(made.curvature.max(), rel=2e-3)
    assert turned.curvature.min() == pytest.approx(made.curvature.min(), rel=2e-3)


def test_a_closed_course_turns_round_once():
    wavy = (
        circle(1.0)
        * (80.0 + 12.0 * np.sin(3.0 * np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)))[:, None]
    )
    made = course.along(wavy)
    assert made.step * made.curvature.sum() == pytest.approx(2.0 * np.pi, rel=1e-3)


@pytest.mark.parametrize("friction", [1.0, 0.5])
def test_a_plan_keeps_its_limits_round_the_seam_too(friction):
    made = course.winding(3, 2000.0)
    speed = course.plan(made, friction)
    assert speed.max() <= 20.0
    assert (speed**2 * np.abs(made.curvature)).max() <= course.SHARE * friction * course.G * (1.0 + 1e-12)
    change = np.diff(np.append(speed, speed[0]) ** 2) / (2.0 * made.step)
    assert np.abs(change).max() <= course.ALONG * friction * (1.0 + 1e-9)


def test_a_plan_swings_over_all_speeds():
    flat = course.Course(1.0, np.zeros(4000), np.arange(4000.0), np.zeros(4000))
    speed = course.plan(flat)
    assert (speed.min(), speed.max()) == (pytest.approx(6.0), pytest.approx(20.0, abs=1e-3))


def test_a_made_course_is_its_seed():
    a, b, other = course.winding(4), course.winding(4), course.winding(5)
    assert np.array_equal(a.curvature, b.curvature)
    assert not np.array_equal(a.curvature, other.curvature)
    assert np.abs(a.curvature).max() < course.SHARPEST


def test_a_file_is_read_with_its_remarks(tmp_path):
    path = tmp_path / "oval.csv"
    np.savetxt(
        path, np.column_stack([circle(50.0), np.ones((200, 2))]), delimiter=",", header="x_m,y_m,right,left"
    )
    assert course.read(path).curvature == pytest.approx(1.0 / 49.64, rel=1e-3)


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (circle(60.0)[:5], "5 points"),
        (np.where(np.arange(200)[:, None] == 7, np.nan, circle(60.0)), "finite"),
        (circle(60.0)[:150], "from its start"),
        (circle(7.0), "turns on"),
    ],
)
def test_what_is_no_course_is_refused(points, says):
    with pytest.raises(InputError, match=says):
        course.along(points, "line.csv")


def test_a_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        course.read(tmp_path / "none.csv")
    (tmp_path / "words.csv").write_text("x,y\n1,2\n")
    with pytest.raises(InputError, match=r"words\.csv"):
        course.read(tmp_path / "words.csv")


@pytest.mark.parametrize(
    "bad", [{"friction": 0.0}, {"share": 2.0}, {"least": 0.0}, {"least": 9.0, "most": 8.0}]
)
def test_a_plan_that_cannot_be_is_refused(bad):
    with pytest.raises(InputError):
        course.plan(course.winding(0, 500.0), **bad)


def test_the_hungaroring(data):
    made = course.read(data / "racetrack_database" / "tracks" / "Budapest.csv")
    assert made.length == pytest.approx(4377.0, rel=5e-3)
    assert made.step * made.curvature.sum() == pytest.approx(-2.0 * np.pi, rel=1e-3)  # driven clockwise
    speed = course.plan(made)
    assert np.abs(speed**2 * made.curvature).max() == pytest.approx(8.0, abs=0.05)
    assert 330.0 < (made.step / speed).sum() < 400.0  # the paper's drive took 400 s
