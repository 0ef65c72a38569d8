"""`outrider design`: gains of an observer from matrix inequalities, with their proof, as a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from outrider.cli import quantities, show
from outrider.errors import InputError

Text = str | None
# By observer: the options it has, the argument each becomes, and how it is read.
OPTIONS: dict[str, dict[str, tuple[str, Callable[[str, str], Any]]]] = {
    "multi_stage": {
        "speed": ("speed", quantities.span),
        "rear_axle": ("rear_axle", quantities.number),
        "slip": ("slip", quantities.number),
        "mismatch": ("mismatch", quantities.number),
        "rate": ("rate", quantities.number),
        "fastest": ("fastest", quantities.number),
        "turn_rate": ("turn_rate", quantities.pair),
        "turn_fastest": ("turn_fastest", quantities.pair),
        "position_rate": ("position_rate", quantities.number),
        "position_fastest": ("position_fastest", quantities.number),
        "gain_bound": ("gain_bound", quantities.number),
    },
    "high_gain": {
        "speed": ("speed", lambda text, what: quantities.span(text, what)[0]),
        "accel": ("acceleration", quantities.number),
        "yaw_rate": ("yaw_rate", quantities.number),
        "rate": ("rate", quantities.number),
        "fastest": ("fastest", quantities.number),
        "gain_bound": ("gain_bound", quantities.number),
    },
    "constant_velocity": {
        "speed": ("speeds", quantities.span),
        "window": ("window", quantities.number),
        "yaw_rate": ("yaw_rate", quantities.number),
        "rear_axle": ("rear_axle", quantities.number),
        "slip": ("slip", quantities.number),
        "rate": ("rate", quantities.number),
        "fastest": ("fastest", quantities.number),
        "gain_bound": ("gain_bound", quantities.number),
    },
}


def design(
    observer: str,
    /,
    *,
    speed: Text = None,
    accel: Text = None,
    yaw_rate: Text = None,
    window: Text = None,
    slip: Text = None,
    rear_axle: Text = None,
    mismatch: Text = None,
    rate: Text = None,
    fastest: Text = None,
    turn_rate: Text = None,
    turn_fastest: Text = None,
    position_rate: Text = None,
    position_fastest: Text = None,
    gain_bound: Text = None,
    output: Annotated[Path | None, Parameter(["--output", "-o"])] = None,
    json: show.Json = False,
) -> None:
    """Design an observer's gains with a proof; exit code 3 where there is none.

    Parameters
    ----------
    observer
        multi_stage, high_gain or constant_velocity. Needs pip install 'outrider[design]'.
    speed
        True speeds as LOW:HIGH [m/s]; for high_gain the lower one counts.
    accel
        high_gain: largest acceleration along the course [m/s2].
    yaw_rate
        Largest course rate (high_gain), or rate at which the frame turns (constant_velocity) [rad/s].
    window
        constant_velocity: the course is within this of the frame, such as 75deg.
    slip
        Largest slip, such as 20deg.
    rear_axle
        From the body's centre to the rear axle [m].
    mismatch
        multi_stage: share by which the estimated speed may be wrong [-].
    rate
        Decay of the errors, at least [1/s]; for multi_stage of the speed stage.
    fastest
        No pole is further from 0 [1/s]; for multi_stage of the speed stage.
    turn_rate
        multi_stage: A,B for a decay rate A + B V of the orientation at speed V.
    turn_fastest
        multi_stage: the same for its poles.
    position_rate
        multi_stage: decay of the position stage [1/s].
    position_fastest
        multi_stage: its poles [1/s].
    gain_bound
        No gain has a larger norm, in SI units, stage by stage.
    output
        File for the gains and their proof, for `outrider certify` and `outrider track --gains`.
    """
    given = {name: value for name, value in locals().items() if isinstance(value, str) and name != "observer"}
    if observer not in OPTIONS:
        raise InputError(f"no design for observer {observer!r}; want one of {', '.join(OPTIONS)}")
    arguments = {}
    for name, text in given.items():
        option = f"--{name.replace('_', '-')}"
        if name not in OPTIONS[observer]:
            known = ", ".join(f"--{n.replace('_', '-')}" for n in OPTIONS[observer])
            raise InputError(f"{option} says nothing to {observer}; it has {known}")
        argument, read = OPTIONS[observer][name]
        arguments[argument] = read(text, option)
    if observer == "constant_velocity":
        arguments.setdefault("speeds", (10.0, 10.0))
    from outrider import design, observers, proof_file

    made = getattr(design, observer)(**arguments)
    if output:
        proof_file.write(made.file, output)
    if json:
        show.json(proof_file.described(made.file, made.certificate))
        return
    defaults = observers.get(observer).Gains()._asdict()
    for name, value in made.file.gains.items():
        if value != defaults[name]:
            print(f"{name:>8} = {value:.6g}")
    said = made.solved
    print(
        f"{said.solver} said {said.status} in {said.seconds:.2f} s; checked with NumPy:\n{made.certificate}"
    )
    if output:
        print(f"written to {output}")
