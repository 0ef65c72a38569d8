"""`outrider relocalise`: where a robot is inside a known wall, from its odometry and two ranges."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from outrider.cli import quantities, relocalise_shown, show
from outrider.errors import InputError

if TYPE_CHECKING:
    from outrider.relocalise.room import Room

relocalise = App(
    name="relocalise", help="Find where a robot is inside a known wall, from its odometry and two ranges."
)

Output = Annotated[Path, Parameter(["--output", "-o"])]
Sets = Annotated[list[str] | None, Parameter("--set", negative=())]
Columns = Annotated[list[str] | None, Parameter("--column", negative=())]
Numbers = Annotated[str | None, Parameter(allow_leading_hyphen=True)]
Flag = Annotated[bool, Parameter(negative=())]


@relocalise.default
def estimate(
    log: Path,
    /,
    *,
    wall: str,
    output: Output,
    start: Numbers = None,
    anywhere: Flag = False,
    observer: str | None = None,
    sensors: Numbers = None,
    set_: Sets = None,
    column: Columns = None,
    span: str | None = None,
    pictures: bool = True,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Estimate the pose over a log: estimate.parquet, the hypotheses, a summary and pictures.

    Parameters
    ----------
    log
        CSV or Parquet file with t, v, w, range_1, range_2 and, where known, angle_1, angle_2, x, y, theta; a
        unit may be part of a column's name, such as range_1_mm or w [deg/s]; else SI.
    wall
        Name of a room (see `outrider ls rooms`), or a TOML file.
    output
        Folder for the results; must be new or empty, or use --force.
    start
        The robot's pose at the first row, X,Y,THETA [m, m, rad or such as 90deg]; else it may be anywhere.
    anywhere
        Search everywhere, as without --start.
    observer
        What follows the pose once it is found (see `outrider ls relocalisers`); pose_ekf where none is named.
    sensors
        Angles of both sensors from straight ahead, A,B, instead of those of the room.
    set_
        One gain of the observer as name=value; may be repeated.
    column
        Which column of the file is which, such as "range_1=left [mm]"; may be repeated.
    span
        Part to use, by the log's own clock, BEGIN:END [s].
    pictures
        Draw room.png and errors.png.
    """
    from outrider.relocalise import log as logs
    from outrider.relocalise import run

    if start is not None and anywhere:
        raise InputError("--start and --anywhere: want one of them")
    found = logs.read(log, quantities.pairs(column, "--column"))
    found = found.part(*quantities.span(span, "--span")) if span else found
    begun, name = _pose(start), observer or run.DEFAULT
    made = run.run(found, _room(wall, sensors), begun, name, quantities.values(set_, "--set"))
    run.save(made, output, force, {"log": log.name, "wall_was": wall})
    if pictures:
        from outrider import plots_relocalise

        plots_relocalise.save(made, output)
    if json:
        show.json({**made.summary(), "folder": output})
    else:
        show.table([*relocalise_shown.estimated(made), ("written to", f"{output}/")])


@relocalise.command
def simulate(
    *,
    output: Output,
    wall: str = "ellipse",
    motion: str = "exciting",
    seconds: float = 30.0,
    rate: float = 10.0,
    noise: float | None = None,
    odometry: float | None = None,
    start: Numbers = None,
    limits: str = "0.5,0.5",
    sensors: Numbers = None,
    kidnap: str | None = None,
    lost: float = 0.0,
    short: float = 0.0,
    seed: int = 0,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Drive a simulated robot in a room; a log with its true pose.

    Parameters
    ----------
    output
        Log to write, CSV or Parquet.
    wall
        Name of a room (see `outrider ls rooms`), or a TOML file.
    motion
        How it drives: exciting (that is spin), constant, periodic, criterion, sigma, straight_and_turn,
        random.
    seconds
        Length of the log [s].
    rate
        Rows per second [Hz].
    noise
        Standard deviation of the ranges [m]; the room's where none is said.
    odometry
        Standard deviation of the constant scale errors of v and of w; 0.02 where none is said.
    start
        The robot's first pose, X,Y,THETA [m, m, rad or such as 90deg]; any, where none is said.
    limits
        Fastest speed and turn, V,W [m/s, rad/s].
    sensors
        Angles of both sensors from straight ahead, A,B, instead of those of the room.
    kidnap
        Times at which the robot is put anywhere else, such as 10,20 [s].
    lost
        Share of the ranges without a return.
    short
        Share of the ranges that end before the wall.
    seed
        Of noise and start; the same seed gives the same log.
    """
    from outrider.io._folder import may_write
    from outrider.relocalise import log as logs
    from outrider.relocalise import motions
    from outrider.relocalise import simulate as simulation

    room, drive = _room(wall, sensors), motions.get(motion, seed)
    when = tuple(quantities.listed(kidnap, "--kidnap")) if kidnap else ()
    most = motions.Limits(*quantities.pair(limits, "--limits"))
    scale = simulation.ODOMETRY if odometry is None else odometry
    may_write(output, force)
    faults = simulation.Faults(when, lost, short)
    made = simulation.simulate(room, drive, seconds, rate, noise, scale, seed, _pose(start), most, faults)
    logs.write(made, output)
    if json:
        show.json(
            {"path": output, "rows": len(made.t), "duration_s": float(made.t[-1]), "faults": made.faults}
        )
        return
    print(f"{output}: {len(made.t)} rows, {made.t[-1]:.1f} s in {wall}")


@relocalise.command
def check(
    *,
    wall: str,
    sensors: Numbers = None,
    motion: Annotated[str, Parameter(allow_leading_hyphen=True)] = "0,0.5",
    output: Annotated[Path | None, Parameter(["--output", "-o"])] = None,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Say whether a robot can be found in a room at all, before anything is trusted; draw where.

    Parameters
    ----------
    wall
        Name of a room (see `outrider ls rooms`), or a TOML file.
    sensors
        Angles of both sensors from straight ahead, A,B, such as 30deg,-30deg; the room's where none are said.
    motion
        Speed and yaw rate, V,W [m/s, rad/s]; turning on the spot where none is said.
    output
        Picture to draw, a map over the room.
    """
    from outrider.io._folder import may_write

    if output is not None:
        may_write(output, force)
    room, moved = _room(wall, sensors), quantities.pair(motion, "--motion")
    relocalise_shown.checked(room, *moved, output, json)


# ------------------------------------------------------------------ what is given


def _room(wall: str, sensors: str | None) -> "Room":
    """The room, its sensors at other angles where some are given."""
    import numpy as np

    from outrider.relocalise import room as rooms

    room = rooms.load(wall)
    if sensors is None:
        return room
    angles = np.array(quantities.pair(sensors, "--sensors"))
    return rooms.parse(rooms.dump(room._replace(angles=angles)), f"--sensors {sensors}")


def _pose(text: str | None) -> Any:
    if text is None:
        return None
    parts = quantities.listed(text, "--start")
    if len(parts) != 3:
        raise InputError(f"--start {text!r}; want X,Y,THETA, such as 1.5,0,90deg")
    return parts
