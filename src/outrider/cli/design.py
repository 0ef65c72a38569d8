"""`outrider design`: gains of an observer from matrix inequalities, with their proof, as a file."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from outrider.cli import quantities, show
from outrider.errors import InputError

Text = str | None
Read = Callable[[str, str], Any]


def _low(text: str, what: str) -> float:
    return quantities.span(text, what)[0]


def _sector(text: str, what: str) -> bool:
    if text not in ("tight", "printed"):
        raise InputError(f"{what} {text!r}; want tight or printed")
    return text == "tight"


N, SPAN, PAIR = quantities.number, quantities.span, quantities.pair
LIMITS: dict[str, tuple[str, Read]] = {
    "rate": ("rate", N),
    "fastest": ("fastest", N),
    "gain_bound": ("gain_bound", N),
}
BODY: dict[str, tuple[str, Read]] = {
    "rear_axle": ("l_r", N),
    "slip": ("slip", N),
    "mismatch": ("mismatch", N),
}
# By observer, or stage of multi_stage: its options, the argument each becomes, and how it is read.
OPTIONS: dict[str, dict[str, tuple[str, Read]]] = {
    "multi_stage": {
        **BODY,
        **LIMITS,
        "speed": ("speed", SPAN),
        "rear_axle": ("rear_axle", N),
        "turn_rate": ("turn_rate", PAIR),
        "turn_fastest": ("turn_fastest", PAIR),
        "position_rate": ("position_rate", N),
        "position_fastest": ("position_fastest", N),
    },
    "high_gain": {
        **LIMITS,
        "speed": ("speed", _low),
        "accel": ("acceleration", N),
        "yaw_rate": ("yaw_rate", N),
        "lipschitz": ("lipschitz", N),
        "theta": ("theta", N),
    },
    "constant_velocity": {
        **LIMITS,
        "speed": ("speeds", SPAN),
        "window": ("window", N),
        "yaw_rate": ("yaw_rate", N),
        "rear_axle": ("rear_axle", N),
        "slip": ("slip", N),
    },
    "speed": LIMITS,
    "table": {
        **BODY,
        "speed": ("speeds", SPAN),
        "turn_rate": ("rate", PAIR),
        "turn_fastest": ("fastest", PAIR),
    },
    "orientation": {
        "speed": ("speed", _low),
        "rear_axle": ("l_r", N),
        "sector": ("tight", _sector),
        "rate": ("rate", N),
        "fastest": ("fastest", N),
    },
    "position": LIMITS,
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
    lipschitz: Text = None,
    theta: Text = None,
    sector: Text = None,
    output: Annotated[Path | None, Parameter(["--output", "-o"])] = None,
    json: show.Json = False,
) -> None:
    """Design an observer's gains with a proof; exit code 3 where there is none.

    Parameters
    ----------
    observer
        multi_stage, high_gain or constant_velocity; or one stage of multi_stage alone, to look at: speed,
        table (a gain for each of 21 speeds), orientation (at one speed, as the paper does it), position.
        Needs pip install 'outrider[design]'.
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
    lipschitz
        high_gain: by theta, for this Lipschitz constant k_f of the model (eq. 76-78 of the paper).
    theta
        high_gain: theta itself; else 1.01 times the least one that k_f allows.
    sector
        orientation: tight, or printed for both conditions of the paper.
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
    made = _made(observer, arguments)
    from outrider import proof_file

    if output:
        if made.file is None:
            raise InputError(f"{observer} is one stage of multi_stage, no observer; -o wants a whole one")
        proof_file.write(made.file, output)
    if json:
        show.json(_described(made))
        return
    _print(made)
    if output:
        print(f"written to {output}")


def _made(observer: str, arguments: dict[str, Any]) -> Any:
    from outrider import design
    from outrider.observers import multi_stage

    if observer == "constant_velocity":
        arguments.setdefault("speeds", (10.0, 10.0))
    if observer == "table":
        low, high = arguments.pop("speeds", (1.0, 20.0))
        arguments["speeds"] = [v for v in multi_stage.NOMINAL if low <= v <= high]
    if observer == "high_gain" and ("lipschitz" in arguments or "theta" in arguments):
        by = {n: arguments.pop(n) for n in ("lipschitz", "theta", "gain_bound") if n in arguments}
        found = design.by_theta(**by)
        print(
            f"K = {found.K}, theta = {found.theta:.5g}, at least {found.least:.5g} by eq. 77", file=sys.stderr
        )
        arguments = {"rate": 0.0, **arguments, "gain": found.gain}
    return getattr(design, observer)(**arguments)


def _described(made: Any) -> dict[str, Any]:
    from outrider import proof_file

    if made.file is not None:
        return proof_file.described(made.file, made.certificate)
    proof = made.certificate
    return {"gain": made.gain, "proven": proof.proven(), "margin": proof.margin(), "rate": proof.rate}


def _print(made: Any) -> None:
    """Gains that are not the observer's defaults, what the solver said, and the report."""
    from outrider import observers

    if made.file is None:
        print(f"gain {made.gain}")
    else:
        defaults = observers.get(made.file.observer).Gains()._asdict()
        for name, value in made.file.gains.items():
            if value != defaults[name]:
                print(f"{name:>8} = {value:.6g}")
    said = made.solved
    print(
        f"{said.solver} said {said.status} in {said.seconds:.2f} s; checked with NumPy:\n{made.certificate}"
    )
