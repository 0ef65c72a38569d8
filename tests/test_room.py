"""Rooms as files: what is shipped, what is written comes back, and what is refused in one line."""

import numpy as np
import pytest

from outrider.errors import InputError, OutputError
from outrider.relocalise import room
from outrider.relocalise.wall import polygon

WALL = '[wall]\nshape = "ellipse"\nhalf_axes_m = [4.0, 2.5]\n'


def test_the_shipped_rooms_are_what_they_say():
    symmetry = {name: room.load(name).wall.symmetry for name in room.names()}
    assert symmetry == {"asymmetric": 1, "circle": 0, "ellipse": 2, "rectangle": 2}


@pytest.mark.parametrize("name", room.names())
def test_a_room_that_is_written_comes_back(name, tmp_path):
    before = room.load(name)._replace(mount=np.array([0.1, -0.02]), range_min=0.15, range_max=8.0, strays=0.3)
    room.save(before, tmp_path / "room.toml")
    after = room.load(tmp_path / "room.toml")
    assert after.wall == before.wall
    assert np.allclose(after.angles, before.angles, atol=1e-14)
    assert np.array_equal(after.mount, before.mount)
    assert after[3:] == before[3:]
    assert room.as_dict(after)["sensors"]["range_m"] == [0.15, 8.0]


def test_every_shape_can_be_written():
    shape = polygon(((0, 0), (4, 0), (3, 2.5)), radius=0.1, unknown_sides=(1,))
    before = room.load("ellipse")._replace(wall=shape)
    assert room.parse(room.dump(before)).wall == shape
    content = '[wall]\nshape = "points"\npoints_m = [[0, 0], [2, -1], [3, 1], [1, 2]]\n'
    assert room.parse(room.dump(room.parse(content))).wall == room.parse(content).wall
    content = '[wall]\nshape = "superellipse"\nhalf_axes_m = [4, 2]\npower = 4\nturn_deg = 30\n'
    assert room.parse(room.dump(room.parse(content))).wall == room.parse(content).wall


def test_sensors_have_defaults():
    made = room.parse(WALL)
    assert np.rad2deg(made.angles) == pytest.approx([60, -60])
    assert made.mount.tolist() == [0, 0]
    assert made[3:] == (0.0, 100.0, 0.01, 0.0)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("x", "not TOML"),
        (b"\xff", "not TOML"),
        ("[sensors]\n", "missing required field `wall`; keys are wall, sensors"),
        ("[wal]\nx = 2\n", "unknown field `wal`; did you mean wall"),
        ('[wall]\nshape = "elipse"\n', "'elipse' .*; want shape one of circle, ellipse"),
        ("[wall]\nhalf_axes_m = [4, 2]\n", "want shape one of"),
        ('[wall]\nshape = "ellipse"\n', "missing required field `half_axes_m` .*; keys are half_axes_m"),
        ('[wall]\nshape = "ellipse"\nhalf_axis_m = [4, 2]\n', "did you mean half_axes_m"),
        ('[wall]\nshape = "ellipse"\nhalf_axes_m = "4"\n', "Expected `array`"),
        ('[wall]\nshape = "ellipse"\nhalf_axes_m = [4, -2]\n', "half_axes_m has -2; want"),
        (
            '[wall]\nshape = "ellipse"\nhalf_axes_m = [4, 2]\ncentre_m = [nan, 0]\n',
            "centre_m or turn_deg is no finite",
        ),
        ('[wall]\nshape = "polygon"\ncorners_m = [[0, 0], [1, 1], [1, 0], [0, 1]]\n', "crosses itself"),
        (WALL + "[sensors]\nsigma = 3\n", "unknown field `sigma` .*; did you mean sigma_m"),
        (WALL + "[sensors]\nsigma_m = -0.01\n", "sigma_m = -0.01; want"),
        (WALL + "[sensors]\nsigma_m = nan\n", "no finite number"),
        (WALL + "[sensors]\nangles_deg = [30, 390]\n", "both sensors look the same way; want two different"),
        (WALL + "[sensors]\nangles_deg = [30, 60, 90]\n", "Expected `array` of length 2"),
        (WALL + "[sensors]\nrange_m = [-1, 8]\n", r"range_m = \[-1, 8\]; want"),
        (WALL + "[sensors]\nstray_share = 1.0\n", "stray_share = 1; want 0 to less than 1"),
        (WALL + "[sensors]\nrange_m = [8, 1]\n", r"range_m = \[8, 1\]; want"),
    ],
)
def test_a_wrong_room_is_refused_in_one_line(content, said):
    with pytest.raises(InputError, match=said) as refused:
        room.parse(content, "mine.toml")
    assert str(refused.value).startswith("mine.toml: ")
    assert "\n" not in str(refused.value)


def test_a_room_is_found_by_name_or_path(tmp_path):
    with pytest.raises(InputError, match="no such name; want ellipse"):
        room.load("elipse")
    with pytest.raises(InputError, match="cannot read room"):
        room.load(tmp_path / "none.toml")
    with pytest.raises(OutputError, match="cannot write the room"):
        room.save(room.load("ellipse"), tmp_path / "none" / "room.toml")
