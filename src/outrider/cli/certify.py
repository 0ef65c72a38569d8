"""`outrider certify`: check what a file or an observer claims, or search a proof for what is asked."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from outrider.cli import quantities, show
from outrider.errors import InputError, NotCertified

Text = str | None
LEAST = {"high_gain": 3, "multi_stage": 4, "constant_velocity": 4}  # gains that belong together


def certify(
    what: str,
    /,
    *,
    gain: Text = None,
    speed: Text = None,
    accel: Text = None,
    yaw_rate: Text = None,
    window: Text = None,
    slip: Text = None,
    mismatch: Text = None,
    rate: Text = None,
    position: Text = None,
    form: Literal["continuous", "sampled"] | None = None,
    map_: Annotated[bool, Parameter("--map", negative=())] = False,
    output: Annotated[Path | None, Parameter(["--output", "-o"])] = None,
    json: show.Json = False,
) -> None:
    """Prove again, with NumPy alone, what is claimed; exit code 0 proven, 3 not proven.

    Parameters
    ----------
    what
        A file of `outrider design`, or the name of an observer, or of an estimator of lateral velocity
        (scheduled): then the proofs that come with the package. For an observer with any option below: a
        search for a proof (needs pip install 'outrider[design]'). envelope: the
        bounds at run time, for --position and --accel.
    gain
        The observer's first gains, with commas, such as 67.20,823.1,2818.5; else its default ones.
    speed
        True speeds as LOW:HIGH [m/s]; for high_gain the lower one counts.
    accel
        high_gain: largest acceleration along the course; envelope: in any direction [m/s2].
    yaw_rate
        Largest course rate (high_gain), or rate at which the frame turns (constant_velocity) [rad/s].
    window
        constant_velocity: the course is within this of the frame, such as 36deg.
    slip
        Largest slip, such as 20deg.
    mismatch
        multi_stage: share by which the estimated speed may be wrong [-].
    rate
        Decay to prove [1/s]; sampled form: factor of a step.
    position
        envelope: largest error of a measured position [m].
    form
        Of the observer: continuous or sampled; each has those that it has a claim for.
    map_
        high_gain: draw how far the published gain, ours and a given one are proven; needs outrider[design].
    output
        File for the gains and the proof that was found, or for the map.
    """
    asked = {
        "speed": speed and quantities.span(speed, "--speed"),
        "acceleration": accel and quantities.number(accel, "--accel"),
        "yaw_rate": yaw_rate and quantities.number(yaw_rate, "--yaw-rate"),
        "window": window and quantities.number(window, "--window"),
        "slip": slip and quantities.number(slip, "--slip"),
        "mismatch": mismatch and quantities.number(mismatch, "--mismatch"),
    }
    region = {name: value for name, value in asked.items() if value is not None}
    gains = quantities.listed(gain, "--gain") if gain else []
    decay = quantities.number(rate, "--rate") if rate else None
    if what == "envelope":
        _envelope(position or "0.1", accel or "8", json)
    elif map_:
        _draw(what, gains, decay or 0.0, output or Path("region-map.png"))
    elif gains or region or decay is not None or form:
        _show([_search(what, gains, form, decay, region, output)], json)
    elif output:
        raise InputError("-o without a search or --map; want --gain or a region, such as --speed 5:20")
    else:
        _show(_kept(what), json)


def _kept(what: str) -> list[tuple[str, Any, Any]]:
    """Label, file and certificate of a file, or of all that come with the package for an observer."""
    from outrider import lateral, observers, proof_file
    from outrider.observers import certificate_of

    if what.endswith(".json") or Path(what).exists():
        files = {what: proof_file.read(what)}
    elif what in lateral.names() and what not in observers.names():
        return _of_estimator(what)
    else:
        observers.get(what)  # its message for an unknown name
        files = {name: proof_file.shipped(name) for name in proof_file.shipped_names(what)}
        if not files:
            able = ", ".join(n for n in observers.names() if proof_file.shipped_names(n))
            raise NotCertified(f"{what}: no constant gain, so nothing is claimed; want one of {able}")
    return [(label, file, certificate_of(file)) for label, file in files.items()]


def _of_estimator(name: str) -> list[tuple[str, Any, Any]]:
    """The same for an estimator of lateral velocity: a proof for each car that it comes with."""
    from outrider import lateral, proof_file

    estimator: Any = lateral.get(name)
    paths = sorted((Path(lateral.__file__).parent / "shipped").glob(f"{name}.*.json"))
    if not paths:
        raise NotCertified(f"{name}: nothing is claimed; of the estimators want scheduled")
    return [(p.stem, proof_file.read(p), estimator.certificate(p.stem.partition(".")[2])) for p in paths]


def _search(
    what: str,
    gain: list[float],
    form: str | None,
    rate: float | None,
    region: dict[str, Any],
    output: Path | None,
) -> tuple[str, Any, Any]:
    """Label, file and certificate of a proof searched anew."""
    from outrider import design, observers, proof_file

    observer: Any = observers.get(what)
    form = form or ("sampled" if what == "invariant" else "continuous")
    if what == "high_gain" and "speed" in region:
        region["speed"] = region["speed"][0]
    gains = observer.Gains()
    least = LEAST.get(what, 1) if gain else 0
    if not least <= len(gain) <= len(gains):
        names = ", ".join(gains._fields)
        raise InputError(f"--gain has {len(gain)} numbers; want {least} to {len(gains)}, for {names}")
    gains = gains._replace(**dict(zip(gains._fields, gain, strict=False)))
    if rate is None:
        rate = 0.0 if form == "continuous" else 1.0
    made = design.certify(what, gains, form, rate, region)
    if output and made.file:
        proof_file.write(made.file, output)
    return f"{what}, proof searched", made.file, made.certificate


def _envelope(position: str, accel: str, json: bool) -> None:
    """Report of the bounds at run time."""
    from outrider import envelope

    made = quantities.number(position, "--position"), quantities.number(accel, "--accel")
    proof = envelope.certificate(*made)
    if json:
        show.json(
            {"proven": proof.proven(), "margin": proof.margin(), "bounds": [b.gain for b in proof.bounds]}
        )
    else:
        print(proof)


def _show(found: list[tuple[str, Any, Any]], json: bool) -> None:
    """Reports; NotCertified, after them, where one does not hold."""
    from outrider import proof_file

    if json:
        show.json([{"name": label, **proof_file.described(file, proof)} for label, file, proof in found])
    failing = []
    for label, _, proof in found:
        report = str(proof)
        if not json:
            print(f"{label}\n{report}\n")
        if "NOT PROVEN" in report:
            failing.append(f"{label}: {proof.failing()}")
    if failing:
        raise NotCertified("; ".join(failing))


def _draw(what: str, gain: list[float], rate: float, path: Path) -> None:
    """The map of the proven region, as a picture."""
    if what != "high_gain":
        raise InputError(f"--map draws high_gain; got {what}")
    import numpy as np

    from outrider import plots_design
    from outrider.design import region

    gains = region.shipped()
    if gain:
        gains["given"] = gain
    made = region.map(gains, np.linspace(0.0, 10.0, 251), np.linspace(0.0, 6.0, 151), rate)
    plots_design.save(made, path)
    print(f"written to {path}")
