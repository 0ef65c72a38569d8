"""A robot's log: any format and unit gives the same numbers; what is wrong is named, masked and counted."""

import numpy as np
import pytest

from made_logs import save
from outrider.errors import InputError, OutputError
from outrider.relocalise import log as logs
from outrider.relocalise import room as rooms

DEG = np.pi / 180.0


def turning(n=200, dt=0.1):
    """A robot that turns on the spot in a round room: columns in SI units."""
    t = dt * np.arange(n)
    return {
        "t": t,
        "v": 0.2 + 0.1 * np.sin(t),
        "w": np.full(n, 0.5),
        "range_1": 2.0 + 0.3 * np.sin(0.7 * t),
        "range_2": 3.0 + 0.2 * np.cos(0.9 * t),
        "angle_1": np.full(n, 1.0),
        "angle_2": -1.0 + 0.1 * np.sin(t),
        "x": np.cos(t),
        "y": np.sin(t),
        "theta": np.mod(0.5 * t, 1.0),
    }


def without(*names):
    return {key: values for key, values in turning(10).items() if key not in names}


# ------------------------------------------------------------------ in and out


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("left_out", [(), ("angle_1", "angle_2"), ("x", "y", "theta")])
def test_what_is_written_is_read_again(tmp_path, suffix, left_out):
    made = logs.checked(without(*left_out))
    logs.write(made, tmp_path / f"log{suffix}")
    again = logs.read(tmp_path / f"log{suffix}")
    assert made.columns().keys() == again.columns().keys() == without(*left_out).keys()
    for name, values in made.columns().items():
        np.testing.assert_array_equal(values, again.columns()[name])
    assert made.fingerprint() == again.fingerprint()
    assert made.faults == again.faults == ()


def test_units_in_names_and_other_names(tmp_path):
    c = turning()
    other = {
        "time [ms]": c["t"] * 1e3,
        "speed_kmh": c["v"] * 3.6,
        "yaw_rate [deg/s]": c["w"] / DEG,
        "range1_mm": c["range_1"] * 1e3,
        "front right": c["range_2"] * 100.0,
        "angle_1_deg": c["angle_1"] / DEG,
        "angle_2": c["angle_2"],
        "x_cm": c["x"] * 100.0,
        "y": c["y"],
        "heading (deg)": c["theta"] / DEG,
    }
    path = save(tmp_path / "log.csv", other)
    with pytest.raises(InputError, match=r"column range_2 \[m\] missing"):
        logs.read(path)
    renamed = save(
        tmp_path / "b.csv", {"front right [cm]" if k == "front right" else k: v for k, v in other.items()}
    )
    log = logs.read(renamed, {"range_2": "front right [cm]"})
    for name, values in logs.checked(c).columns().items():
        np.testing.assert_allclose(log.columns()[name], values, rtol=1e-13, atol=1e-15)


def test_a_part_of_a_log():
    log = logs.checked(turning())
    part = log.part(5.0, 7.0)
    assert (part.t[0], len(part.t)) == (5.0, 20)
    np.testing.assert_array_equal(part.angles, log.angles[50:70])
    np.testing.assert_array_equal(part.truth, log.truth[50:70])
    with pytest.raises(InputError, match="want at least 2"):
        log.part(100.0, 200.0)


# ------------------------------------------------------------------ masked and counted


def test_what_is_no_range_is_masked_and_counted():
    c = turning()
    c["range_1"][3:6] = [-1.0, 0.0, -0.001]
    c["range_2"][10] = np.inf
    c["range_2"][20:30] = np.nan
    c["w"][7] = 2e5
    log = logs.checked(c)
    assert np.isnan(log.ranges[3:6, 0]).all()
    assert np.isnan(log.ranges[[10, *range(20, 30)], 1]).all()
    assert np.isfinite(log.ranges).sum() == 2 * 200 - 14
    told = " | ".join(log.faults)
    assert "range_1 not positive in 3 rows: taken as no return" in told
    assert "range_2 missing in 11 rows, at most 1.00 s on end" in told
    assert "w impossibly large in 1 row: taken as missing" in told


def test_a_log_is_left_as_it_was():
    c = turning()
    c["range_1"][3] = -1.0
    logs.checked(c)
    assert c["range_1"][3] == -1.0


@pytest.mark.parametrize(
    ("column", "factor", "word"),
    [("w", 100.0 / DEG, "deg/s instead of rad/s"), ("t", 1000.0, "t in ms")],
)
def test_wrong_units_are_suspected(column, factor, word):
    c = turning()
    c[column] = c[column] * factor
    (said,) = logs.checked(c).faults
    assert word in said


def test_ranges_are_compared_with_the_room():
    room = rooms.load("ellipse")
    assert logs.doubts(logs.checked(turning()), room) == ()
    c = turning()
    c["range_1"], c["range_2"] = c["range_1"] * 1e3, c["range_2"] * 1e-3
    first, second = logs.doubts(logs.checked(c), room)
    assert "range_1 is mostly over twice the room's 8 m" in first
    assert "range_2 is never over 0.0032 m" in second


# ------------------------------------------------------------------ refused


@pytest.mark.parametrize("name", ["t", "v", "w", "range_1", "range_2"])
def test_a_missing_column_is_named(tmp_path, name):
    with pytest.raises(InputError, match=rf"column {name} \[.+\] missing; want t \[s\], v \[m/s\]"):
        logs.read(save(tmp_path / "log.csv", without(name)))
    with pytest.raises(InputError, match=f"column {name} missing"):
        logs.checked(without(name))


@pytest.mark.parametrize("name", ["angle_2", "x", "theta"])
def test_half_of_what_belongs_together_is_refused(name):
    with pytest.raises(InputError, match=r"without the rest of"):
        logs.checked(without(name))


def test_time_may_not_go_back():
    c = turning()
    c["t"][60:] -= 0.5
    with pytest.raises(InputError, match=r"time goes back from 5\.9 to 5\.5 s at row 61"):
        logs.checked(c)


def test_what_cannot_be_written(tmp_path):
    made = logs.checked(turning(10))
    with pytest.raises(InputError, match="suffix"):
        logs.write(made, tmp_path / "log.xlsx")
    with pytest.raises(OutputError):
        logs.write(made, tmp_path / "absent" / "log.csv")
