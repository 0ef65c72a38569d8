"""`outrider demo`: a scooter at a crossing, from the simulated scanner to the warnings."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from outrider.cli import show

if TYPE_CHECKING:
    from outrider.io.run import Run
    from outrider.records import Frame
    from outrider.scenario import Scenario

SIDES = (
    *("ahead", "ahead on the left", "on the left", "behind on the left"),
    *("behind", "behind on the right", "on the right", "ahead on the right"),
)
WARNING = ("caution", "danger")
NEAR_M = 4.0  # a warning farther from every body is about none of them


def demo(
    *,
    output: Annotated[Path, Parameter(["--output", "-o"])] = Path("demo"),
    pictures: bool = True,
    force: show.Force = False,
    json: show.Json = False,
) -> None:
    """Simulate a scooter at a crossing, track what it sees, and tell the warnings.

    Parameters
    ----------
    output
        Folder for the recording and the results.
    pictures
        Draw scene.png and tracks.png.
    """
    from outrider import io, offline, simulate
    from outrider.cli.warm import compiling_beside
    from outrider.errors import OutputError
    from outrider.records import Pose
    from outrider.settings import Observer

    world = simulate.load("demo")
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{output}: cannot be made ({error.strerror}); name another folder with -o"
        ) from error
    recording = output / "recording.mcap"
    with compiling_beside(Observer().name):
        messages = list(simulate.record(world))
        io.write_recording(recording, messages, force)
        teller = None if json else Teller(world.title, simulate.EPOCH_NS * 1e-9)
        run = offline.run(recording, output / "run", force=force, pictures=False, watch=teller)
    if pictures:
        offline.draw(run, [m for m in messages if isinstance(m, Pose) and m.topic.startswith("/truth/")])
    courses, harmless = warned(run, world)
    if json:
        show.json({**run.summary, "collision_courses": courses, "harmless_dangers": harmless})
        return
    _sum_up(run, courses, harmless)
    _next_steps(recording, run, pictures)


class Teller:
    """Prints a line for each change of the alert."""

    def __init__(self, title: str, start: float) -> None:
        self._start, self._before = start, (0, -1)
        print(f"{title}.\nThe first run compiles the inner loops, which takes some seconds.\n", flush=True)

    def __call__(self, frame: "Frame") -> None:
        """Tell what has changed with this frame."""
        alert = frame.alert
        now = (int(alert.level), alert.track)
        if now != self._before:
            print(
                f"{frame.t - self._start:6.1f} s  {alert.level.name.lower():<8} {about(frame)}".rstrip(),
                flush=True,
            )
        self._before = now


def about(frame: "Frame") -> str:
    """Which track an alert is about, where it is as the rider sees it, and how long until contact."""
    import numpy as np

    i = np.flatnonzero(frame.tracks.id == frame.alert.track)
    if not len(i):
        return ""
    ego, tracks = frame.scan.ego.W_pose, frame.tracks
    dx, dy = tracks.W_p[i[0]] - ego[:2]
    side = SIDES[round((np.arctan2(dy, dx) - ego[2]) / (np.pi / 4)) % 8]
    contact = f"contact in {frame.alert.ttc:.1f} s" if np.isfinite(frame.alert.ttc) else "path clear"
    speed = abs(tracks.speed[i[0]])
    return f"track {frame.alert.track}, {np.hypot(dx, dy):.0f} m {side}, {speed:.1f} m/s: {contact}"


# ------------------------------------------------------------------ against the truth


@dataclass(frozen=True, slots=True)
class Course:
    """A body that is, or was until it braked, bound to hit the rider."""

    body: str
    contact_s: float  # from the beginning: of the contact, or of the one it braked before
    real: bool  # whether they touched
    lead_s: float | None  # from the first caution or danger about it to that contact


def warned(run: "Run", world: "Scenario") -> tuple[list[Course], list[str]]:
    """Every collision course of a scenario with its warning, and the bodies a danger alert was wrong about.

    A danger about a track that is near no body is told as "nothing".
    """
    from outrider import simulate

    epoch = simulate.EPOCH_NS * 1e-9
    first: dict[str, float] = {}
    dangers = set()
    for alert in run.alerts:
        if alert["level"] in WARNING:
            body = _body(run, world, alert, epoch)
            first.setdefault(body, alert["t"] - epoch)
            if alert["level"] == "danger":
                dangers.add(body)
    courses = []
    for name, (contact, real) in collision_courses(world).items():
        lead = contact - first[name] if name in first else None
        courses.append(Course(name, contact, real, lead))
    bound = {course.body for course in courses}
    return sorted(courses, key=lambda c: c.contact_s), sorted(dangers - bound)


def collision_courses(world: "Scenario") -> dict[str, tuple[float, bool]]:
    """Time of contact [s] by body, and whether it happens; else the earliest ever due at held speed."""
    import numpy as np

    from outrider import simulate

    found = {name: (t, True) for name, t in simulate.contact_times(world).items() if t is not None}
    bound = [v.name for v in world.vehicles if v.collision_course and v.name not in found]
    due = dict.fromkeys(bound, np.inf)
    for t in np.arange(0.0, world.duration_s, 0.5) if bound else ():
        left = simulate.time_to_contact(world, float(t))
        due = {name: min(at, float(t) + left[name]) for name, at in due.items()}
    return found | {name: (at, False) for name, at in due.items() if np.isfinite(at)}


def _body(run: "Run", world: "Scenario", alert: dict[str, Any], epoch: float) -> str:
    """Name of the body nearest to an alert's track, "nothing" where none is near."""
    import numpy as np

    from outrider import simulate

    c = {name: run.tracks[name].to_numpy() for name in ("t", "track_id", "x", "y")}
    row = np.flatnonzero((c["track_id"] == alert["track_id"]) & (np.abs(c["t"] - alert["t"]) < 1e-6))[0]
    truth = simulate.truth_at(world, alert["t"] - epoch)
    far = {n: float(np.hypot(b.x[0] - c["x"][row], b.y[0] - c["y"][row])) for n, b in truth.items()}
    nearest = min(far, key=lambda name: far[name])
    return nearest if far[nearest] < NEAR_M else "nothing"


def _sum_up(run: "Run", courses: list[Course], harmless: list[str]) -> None:
    s = run.summary
    print()
    rows = [
        (
            c.body,
            f"{c.contact_s:.2f} s" if c.real else f"{c.contact_s:.2f} s, had it not braked",
            "no warning" if c.lead_s is None else f"{c.lead_s:.2f} s before",
        )
        for c in courses
    ]
    show.table(rows, ("on collision course", "true contact", "warned"))
    print(f"danger told of anyone else: {', '.join(harmless) or 'none'}")
    speed = f"{s['speed']['median_ms']:.1f} ms from scan to alert"
    print(f"{s['scans']} scans, {s['tracks']} tracks, {s['moving_tracks']} of them moved; {speed}")


def _next_steps(recording: Path, run: "Run", pictures: bool) -> None:
    folder = run.folder
    steps = [
        (f"{folder}/scene.png", "the scene from above")
        if pictures
        else (f"{folder}/tracks.parquet", "the tracks"),
        (f"outrider view {folder}", "the run in the browser, with a time slider"),
        (f"{folder}/run.mcap", "opens in Foxglove"),
        (f"outrider evaluate {folder}", "how far off the tracks are"),
        (f"outrider info {recording}", "what is in the recording"),
        ("outrider track YOUR.bag -o run", "your own recording"),
    ]
    print("\nnext:")
    show.table([("", *step) for step in steps])
