"""`outrider lateral`: a car's lateral velocity from its own log, and what an estimate needs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from outrider.cli import lateral_shown, quantities, show
from outrider.errors import InputError

if TYPE_CHECKING:
    from outrider.lateral.log import Log

lateral = App(
    name="lateral", help="Estimate a car's lateral velocity from its own speed, yaw rate, steering and ay."
)

Logs = Annotated[list[Path], Parameter(negative=())]
Output = Annotated[Path, Parameter(["--output", "-o"])]
Sets = Annotated[list[str] | None, Parameter("--set", negative=())]
Columns = Annotated[list[str] | None, Parameter("--column", negative=())]


@lateral.default
def estimate(
    log: Path,
    /,
    *,
    output: Output,
    car: str = "b_class",
    observer: str | None = None,
    gains: Path | None = None,
    set_: Sets = None,
    column: Columns = None,
    span: str | None = None,
    pictures: bool = True,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Estimate lateral velocity over a log: estimate.parquet, a summary and a picture.

    Parameters
    ----------
    log
        CSV or Parquet file with t, vx, yaw_rate, steering and, where known, ay and vy; a unit may be part of
        a column's name, such as vx_kmh or steering [deg]; else SI.
    output
        Folder for the results; must be new or empty, or use --force.
    car
        Name (see `outrider ls cars`), or a TOML file with units.
    observer
        Name of the estimator (see `outrider ls estimators`); kalman where nothing else says.
    gains
        File of `outrider lateral tune`, or settings.toml of an earlier run: its estimator with its gains.
    set_
        One gain as name=value, over the file; may be repeated.
    column
        Which column of the file is which, such as "steering=wheel [deg]"; may be repeated.
    span
        Part to use, by the log's own clock, BEGIN:END [s].
    pictures
        Draw vy.png.
    """
    from outrider.lateral import run

    name, values = _gains(gains, observer)
    given = {**values, **quantities.values(set_, "--set")}
    made = run.run(_read(log, column, span), _car(car), name or run.DEFAULT, given)
    run.save(made, output, force, {"log": log.name, "car_was": car})
    if pictures:
        from outrider import plots_lateral

        plots_lateral.save(made, output)
    if json:
        show.json({**made.summary(), "folder": output})
    else:
        show.table([*lateral_shown.estimated(made), ("written to", f"{output}/")])


@lateral.command
def tune(
    logs: Logs,
    /,
    *,
    output: Output,
    car: str = "b_class",
    observer: Literal["ultra_local", "ultra_local_published"] = "ultra_local",
    over: Literal["ay", "speed"] | None = None,
    method: Literal["grid", "greedy", "curve", "joint"] = "grid",
    set_: Sets = None,
    column: Columns = None,
    span: str | None = None,
    pictures: bool = True,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Tune the ultra-local part on logs with measured vy: how far it trusts the accelerometer.

    Parameters
    ----------
    logs
        Logs as for `outrider lateral`, with vy.
    output
        JSON file for the gains, with the fingerprint of the logs, for --gains.
    car
        Name (see `outrider ls cars`), or a TOML file with units.
    observer
        The form that is tuned.
    over
        Quantity in whose bins the gain is chosen: lateral acceleration, or speed as published.
    method
        greedy: the published loop, until the error stops falling; grid: the best of all values, bin by bin;
        curve: a parabola through those; joint: bin after bin while the error of all rows falls.
    set_
        One other gain as name=value; may be repeated.
    column
        Which column of the files is which, such as "steering=wheel [deg]"; may be repeated.
    span
        Part to use, by the log's own clock, BEGIN:END [s].
    pictures
        Draw alpha over the bins, beside the output with suffix .png.
    """
    from outrider.io._folder import may_write
    from outrider.lateral import tune as tuning

    picture = output.with_suffix(".png")
    for path in (output, picture) if pictures else (output,):
        may_write(path, force)
    found = [_read(path, column, span) for path in logs]
    made = tuning.tune(found, _car(car), observer, over or "", method, quantities.values(set_, "--set"))
    tuning.save(made, output)
    if pictures:
        from outrider import plots_tune

        plots_tune.save(made, picture)
    if json:
        show.json(made)
    else:
        lateral_shown.tuned(made)
        print(f"written to {output}")


@lateral.command
def identify(
    logs: Logs,
    /,
    *,
    output: Output,
    car: str = "b_class",
    vy: bool = True,
    roll: Annotated[bool, Parameter(negative=())] = False,
    column: Columns = None,
    span: str | None = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Identify a car from logs: steering gain and offset, tyre stiffness, roll.

    Parameters
    ----------
    logs
        Logs as for `outrider lateral`; vy is used where it is there.
    output
        TOML file for the car, for --car.
    car
        The car to begin from: its mass and lengths are kept; name or TOML file.
    vy
        Use measured vy; --no-vy: yaw rate and lateral acceleration alone.
    roll
        Find the roll gain as well, by which the accelerometer reads too much.
    column
        Which column of the files is which, such as "steering=wheel [deg]"; may be repeated.
    span
        Part to use, by the log's own clock, BEGIN:END [s].
    """
    from outrider import cars
    from outrider.io._folder import may_write
    from outrider.lateral import identify as identifying

    may_write(output, force)
    begun = _car(car)
    made = identifying.identify([_read(path, column, span) for path in logs], begun, use_vy=vy, roll=roll)
    cars.save(made.car, output)
    if json:
        show.json({**made._asdict(), "car": made.car._asdict(), "path": output})
        return
    lateral_shown.identified(made, begun)
    print(f"written to {output}")


@lateral.command
def simulate(
    course: str,
    /,
    *,
    output: Output,
    car: str = "b_class",
    friction: float = 1.0,
    noise: str = "mems",
    speed: str = "6:20",
    seed: int = 0,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Drive a simulated car with saturating tyres once round a course; a log with the true vy.

    Parameters
    ----------
    course
        CSV file whose first two columns are x and y of a closed centre line [m]; or winding:SEED, a made one.
    output
        Log to write, CSV or Parquet.
    car
        Name (see `outrider ls cars`), or a TOML file with units.
    friction
        Of tyres on the road [-].
    noise
        Of the sensors: none, mems (with bias), or paper.
    speed
        Slowest and fastest the driver wishes to go, LOW:HIGH [m/s].
    seed
        Of the noise; the same seed gives the same log.
    """
    from outrider.io._folder import may_write
    from outrider.lateral import course as courses
    from outrider.lateral import log, plant

    kind, _, number = course.partition(":")
    way = courses.winding(_seed(number)) if kind == "winding" else courses.read(course)
    least, most = quantities.span(speed, "--speed")
    may_write(output, force)
    wished = courses.plan(way, friction, least=least, most=most)
    made = plant.simulate(way, _car(car), friction, noise, seed, wished)
    log.write(made, output)
    seconds = float(made.t[-1] - made.t[0])
    if json:
        show.json({"path": output, "rows": len(made.t), "duration_s": seconds, "faults": made.faults})
        return
    print(f"{output}: {len(made.t)} rows, {seconds:.1f} s on {way.length:.0f} m")
    for text in made.faults:
        print(text)


# ------------------------------------------------------------------ what is given


def _gains(path: Path | None, observer: str | None) -> tuple[str | None, dict[str, float]]:
    """Estimator and gains of a file of `tune`, or of settings.toml of a run; else what is asked for."""
    if path is None:
        return observer, {}
    from outrider.lateral import run, tune

    if path.suffix == ".toml":
        name, values = run.chosen(path)
    else:
        tuned = tune.load(path)
        name, values = tuned.estimator, tuned.gains
    if observer not in (None, name):
        raise InputError(f"{path} holds gains of {name}; got --observer {observer}; leave one out")
    return name, values


def _read(path: Path, column: list[str] | None, span: str | None) -> "Log":
    from outrider.lateral import log

    found = log.read(path, quantities.pairs(column, "--column"))
    return found.part(*quantities.span(span, "--span")) if span else found


def _car(name: str) -> Any:
    """A car by name or file; B and D are short for the cars of that class."""
    from outrider import cars

    short = f"{name.lower()}_class"
    return cars.load(short if short in cars.names() else name)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise InputError(f"course winding:{text}; want a number, such as winding:5")
    return int(text)
