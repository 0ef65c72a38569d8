"""A car's log: any format and unit gives the same numbers; what is wrong is named, masked and counted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_logs import save
from outrider import cars
from outrider.errors import InputError, OutputError
from outrider.lateral import log as logs
from outrider.lateral.log import Log

CAR = cars.load("b_class")
DEG = np.pi / 180.0


def weaving(n=2000, dt=0.01):
    """A car that weaves gently at 15 m/s: columns in SI units that belong together."""
    t = dt * np.arange(n)
    yaw_rate = 0.2 * np.sin(0.8 * t)
    vx = 15.0 + 3.0 * np.sin(0.3 * t)
    wheelbase = CAR.front + CAR.rear
    return {
        "t": t,
        "vx": vx,
        "yaw_rate": yaw_rate,
        "ay": vx * yaw_rate,
        "steering": wheelbase * yaw_rate / vx,
        "vy": -0.3 * np.sin(0.8 * t),
    }


def same(a, b):
    for name in logs.COLUMNS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-13, atol=0.0)


# ------------------------------------------------------------------ in and out


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_what_is_written_is_read_again(tmp_path, suffix):
    made = logs.checked(weaving())
    logs.write(made, tmp_path / f"log{suffix}")
    again = logs.read(tmp_path / f"log{suffix}")
    same(made, again)
    assert made.fingerprint() == again.fingerprint()
    assert made.faults == again.faults == ()
    assert [p.name for p in tmp_path.iterdir()] == [f"log{suffix}"]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_units_are_part_of_names(tmp_path, suffix):
    c = weaving()
    named = {
        "Time [ms]": 1e3 * c["t"],
        "speed_kmh": 3.6 * c["vx"],
        "yaw_rate (°/s)": c["yaw_rate"] / DEG,
        "ay [g]": c["ay"] / logs.G,
        "delta_deg": c["steering"] / DEG,
        "vy_mps": c["vy"],
        "note": c["t"],
    }
    same(logs.read(save(tmp_path / f"log{suffix}", named)), logs.checked(c))


def test_columns_by_any_name(tmp_path):
    c = weaving(100)
    named = {**c, "hand wheel [deg]": 16.0 * c["steering"] / DEG, "steering": c["t"]}
    path = save(tmp_path / "log.csv", named)
    read = logs.read(path, {"steering": "hand wheel [deg]"})
    np.testing.assert_allclose(read.steering, 16.0 * c["steering"], rtol=1e-13)
    with pytest.raises(InputError, match="none of a log"):
        logs.read(path, {"stering": "hand wheel [deg]"})
    with pytest.raises(InputError, match=r"column .wheel. missing"):
        logs.read(path, {"steering": "wheel"})


def test_decimal_commas_and_empty_columns_are_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t;vx [km/h];yaw_rate [deg/s];delta;ay\r\n0,5;36;5,73;0,1;\r\n0,75;36;n/a;0,1;\r\n")
    log = logs.read(path)
    assert log.t.tolist() == [0.5, 0.75]
    assert log.vx == pytest.approx([10.0, 10.0])
    assert log.yaw_rate == pytest.approx([0.1, np.nan], abs=1e-4, nan_ok=True)
    assert log.steering.tolist() == [0.1, 0.1]
    assert np.isnan(log.ay).all()


def test_integers_semicolons_and_dates_are_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("﻿t;vx;yaw_rate;steering\n2026-03-01T12:00:00.00;10;0;0\n2026-03-01T12:00:00.25;10;0;1\n")
    log = logs.read(path)
    assert np.diff(log.t) == pytest.approx([0.25], abs=1e-6)
    assert log.vx.tolist() == [10.0, 10.0]


# ------------------------------------------------------------------ what an estimator gets


def test_samples_have_the_cars_steering_and_are_free_of_roll():
    car = CAR._replace(steering_gain=1 / 16, steering_offset=0.01, roll_gain=0.016)
    made = logs.checked(weaving(50))
    samples = made.samples(car)
    assert samples.shape == (50, 5)
    np.testing.assert_allclose(samples[:, 0], np.append(0.0, np.diff(made.t)))
    np.testing.assert_allclose(samples[:, 4], made.steering / 16 + 0.01)
    np.testing.assert_allclose(samples[:, 3] * (1 + 9.81 * 0.016), made.ay)
    np.testing.assert_array_equal(samples[:, 1:3], np.column_stack([made.vx, made.yaw_rate]))


def test_halves_share_the_rows():
    whole = logs.checked(weaving(501))
    first, second = whole.halves()
    np.testing.assert_array_equal(np.concatenate([first.vx, second.vx]), whole.vx)
    assert first.t[-1] < 2.5 <= second.t[0]
    with pytest.raises(InputError, match="want at least 2"):
        whole.part(100.0, 200.0)


@given(st.sampled_from(["t", "vx", "yaw_rate", "ay", "steering", "vy"]), st.integers(0, 99))
def test_the_fingerprint_sees_every_number(name, row):
    columns = weaving(100)
    before = logs.checked(columns).fingerprint()
    assert logs.checked(columns).fingerprint() == before
    columns[name][row] += 1e-6
    assert logs.checked(columns).fingerprint() != before


def test_the_fingerprint_knows_an_absent_column():
    columns = weaving(100)
    del columns["vy"]
    assert logs.checked(columns).fingerprint() != logs.checked(weaving(100)).fingerprint()


# ------------------------------------------------------------------ what is masked and counted


def test_missing_stretches_are_counted(tmp_path):
    c = weaving(1000)
    c["ay"][100:150] = np.nan
    c["yaw_rate"][[5, 7]] = np.inf
    c["steering"][600] = 3.4e38
    c["vx"][990:] = np.nan
    log = logs.read(save(tmp_path / "log.parquet", c))
    assert np.isnan(log.ay).sum() == 50
    assert np.isnan(log.steering[600])
    told = " | ".join(log.faults)
    assert "ay missing in 50 rows, at most 0.50 s on end" in told
    assert "yaw_rate missing in 2 rows, at most 0.01 s on end" in told
    assert "steering impossibly large in 1 row: taken as missing" in told
    assert "vx missing in 10 rows, at most 0.09 s on end" in told


def test_rows_without_a_time_are_left_out_and_doubled_ones_told():
    c = weaving(100)
    c["t"][20] = np.nan
    c["t"][51] = c["t"][50]
    log = logs.checked(c)
    assert len(log.t) == 99
    assert log.faults == (
        "1 row without a time: left out",
        "1 row at the time of the row before: not used",
    )


def test_a_log_without_ay_is_told():
    c = weaving(100)
    del c["ay"], c["vy"]
    log = logs.checked(c)
    assert np.isnan(log.ay).all()
    assert log.vy is None
    assert log.faults == ("no ay: estimated without it",)


# ------------------------------------------------------------------ units and signs that are hardly right


@pytest.mark.parametrize(
    ("column", "factor", "word"),
    [
        ("yaw_rate", 1 / DEG, "yaw_rate in deg/s"),
        ("ay", 1 / 9.81, "ay in g"),
        ("vx", 3.6, "vx in km/h"),
        ("ay", 9.81, "another unit"),
        ("yaw_rate", -1.0, "opposite signs"),
        ("t", 1000.0, "t in ms"),
    ],
)
def test_wrong_units_are_suspected(column, factor, word):
    c = weaving()
    c[column] = c[column] * factor
    (said,) = logs.checked(c).faults
    assert word in said


def test_degrees_are_suspected_without_ay():
    c = weaving()
    del c["ay"]
    c["yaw_rate"] = c["yaw_rate"] / DEG
    assert any("yaw_rate in deg/s" in text for text in logs.checked(c).faults)


@pytest.mark.parametrize(
    ("factor", "word"),
    [
        (1 / DEG, "deg instead of rad"),
        (16.0, "steering_gain"),
        (0.05, "another unit"),
        (-1.0, "opposite signs"),
    ],
)
def test_wrong_steering_is_suspected(factor, word):
    c = weaving()
    c["steering"] = factor * c["steering"]
    (said,) = logs.doubts(logs.checked(c), CAR)
    assert word in said


def test_the_cars_gain_settles_the_doubt():
    c = weaving()
    c["steering"] = -16.0 * c["steering"] + 0.3
    log = logs.checked(c)
    assert logs.doubts(log, CAR)
    assert logs.doubts(log, CAR._replace(steering_gain=-1 / 16, steering_offset=0.3 / 16)) == ()


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_bias_raise_no_doubt(seed):
    """Straight on, what the sensors say is noise; that is no reason to suspect a unit."""
    rng = np.random.default_rng(seed)
    c = weaving()
    c["yaw_rate"] = 0.02 * c["yaw_rate"] + 0.1 * rng.standard_normal(2000)
    c["ay"] = 0.02 * c["ay"] + 0.3 + 0.2 * rng.standard_normal(2000)
    assert logs.doubts(logs.checked(c), CAR) == ()


# ------------------------------------------------------------------ what is refused


def without(name):
    return {key: values for key, values in weaving(10).items() if key != name}


@pytest.mark.parametrize(
    ("name", "unit"), [("t", "s"), ("vx", "m/s"), ("yaw_rate", "rad/s"), ("steering", "rad")]
)
def test_a_missing_column_is_named_with_its_unit(tmp_path, name, unit):
    with pytest.raises(InputError) as said:
        logs.read(save(tmp_path / "log.csv", without(name)))
    assert f"column {name} [{unit}] missing" in str(said.value)
    assert "has " in str(said.value)


def test_time_may_not_go_back():
    c = weaving(100)
    c["t"][3] = np.nan  # left out, but counted as a row
    c["t"][60:] -= 0.5
    with pytest.raises(InputError, match=r"time goes back from 0\.59 to 0\.1 s at row 61"):
        logs.checked(c)


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("log.txt", "t,vx\n", "suffix '.txt'"),
        ("log.csv", "", "missing"),
        ("log.csv", "t,vx,yaw_rate,steering\n", "0 rows"),
        ("log.csv", "t,vx,yaw_rate,steering\n0,1,0,0\n", "1 rows"),
        ("log.csv", "t,vx,yaw_rate,steering\n0,1,0,0\n0,1,0,0\n", "at different times"),
        ("log.csv", "t,vx,yaw_rate,steering\n0,1,0,0\n1,fast,0,0\n", "'vx' has 'fast' in row 2"),
        ("log.csv", "t,vx,yaw_rate,steering\n0,1,0,0\n1,1,0\n", "cannot be read"),
        ("log.csv", "t,vx,vx,yaw_rate,steering\n0,1,1,0,0\n1,1,1,0,0\n", "more than one column for vx"),
        (
            "log.csv",
            "t,vx,yaw_rate,delta,steering_deg\n0,1,0,0,0\n1,1,0,0,0\n",
            "more than one column for steering",
        ),
        ("log.parquet", "no parquet", "cannot be read"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, name, text, word):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as said:
        logs.read(tmp_path / name)
    assert word in str(said.value)


def test_an_absent_file_is_refused(tmp_path):
    for name in ("absent.csv", "absent.parquet"):
        with pytest.raises(InputError, match="absent"):
            logs.read(tmp_path / name)


def test_what_cannot_be_written(tmp_path):
    made = logs.checked(weaving(10))
    with pytest.raises(InputError, match="suffix"):
        logs.write(made, tmp_path / "log.xlsx")
    with pytest.raises(OutputError):
        logs.write(made, tmp_path / "absent" / "log.csv")


def test_columns_that_do_not_belong_together():
    with pytest.raises(InputError, match="different length"):
        logs.checked({**weaving(10), "vx": np.zeros(9)})
    with pytest.raises(InputError, match="steering"):
        logs.checked(without("steering"))


def test_a_log_is_frozen():
    made = logs.checked(weaving(10))
    assert isinstance(made, Log)
    with pytest.raises(AttributeError):
        made.vx = made.ay


# ------------------------------------------------------------------ real


def test_a_real_log_is_read_as_it_is(data):
    log = logs.read(data / "revs_250lm" / "20140222_01_01_03_250lm_dev.parquet")
    assert len(log.t) == 36501
    assert log.faults == ()
    assert np.sqrt(np.mean(log.vy**2)) == pytest.approx(0.65, abs=0.02)
    assert logs.doubts(log, CAR) == ()
