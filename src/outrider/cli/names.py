"""`outrider ls` and `cite`: what there is by name, and how it is cited."""

from typing import Any, Literal

from outrider.cli import show

What = Literal["scenarios", "observers", "estimators", "relocalisers", "rooms", "cars", "datasets", "formats"]

SOFTWARE = """@software{{outrider,
  title = {{outrider: from raw 2D lidar scans to tracked vehicles and warnings}},
  author = {{{{The outrider authors}}}},
  version = {{{version}}}
}}"""
METHODS = (
    """@article{cedervall2007nonlinear,
  title = {Nonlinear Observers for Unicycle Robots with Range Sensors},
  author = {Cedervall, Simon and Hu, Xiaoming},
  journal = {IEEE Transactions on Automatic Control},
  year = {2007}
}""",
    """@inproceedings{fenyes2023observer,
  title = {An Observer Design Method Using Ultra-Local Model for Autonomous Vehicles},
  author = {F{\\'e}nyes, D{\\'a}niel and Heged{\\H{u}}s, Tam{\\'a}s and Van Tan, Vu and
    G{\\'a}sp{\\'a}r, P{\\'e}ter},
  booktitle = {International Conference on Informatics in Control, Automation and Robotics (ICINCO)},
  year = {2023}
}""",
    """@article{alai2023multistage,
  title = {Multi-Stage Estimation Algorithm for Target Vehicle Trajectory Tracking with Applications to
    E-Scooter Protection},
  author = {Alai, Hamidreza and Rajamani, Rajesh},
  journal = {IEEE Transactions on Intelligent Vehicles},
  year = {2023}
}""",
    """@article{borges2004line,
  title = {Line Extraction in {2D} Range Images for Mobile Robotics},
  author = {Borges, Geovany Araujo and Aldon, Marie-Jos{\\'e}},
  journal = {Journal of Intelligent and Robotic Systems},
  volume = {40}, number = {3}, pages = {267--297}, year = {2004}
}""",
    """@inproceedings{zhang2017lshape,
  title = {Efficient {L}-Shape Fitting for Vehicle Detection Using Laser Scanners},
  author = {Zhang, Xiao and Xu, Wenda and Dong, Chiyu and Dolan, John M.},
  booktitle = {IEEE Intelligent Vehicles Symposium (IV)},
  year = {2017}
}""",
    """@inproceedings{rahmathullah2017gospa,
  title = {Generalized Optimal Sub-Pattern Assignment Metric},
  author = {Rahmathullah, Abu Sajana and Garc{\\'i}a-Fern{\\'a}ndez, {\\'A}ngel F. and Svensson, Lennart},
  booktitle = {20th International Conference on Information Fusion},
  year = {2017}
}""",
)


def ls(what: What | None = None, /, *, json: show.Json = False) -> None:
    """List scenarios, observers, what estimates lateral velocity or a pose, rooms, cars, data sets, formats.

    Parameters
    ----------
    what
        One of them; all where none is named.
    """
    every = {
        "scenarios": _scenarios,
        "observers": _observers,
        "estimators": _estimators,
        "relocalisers": _relocalisers,
        "rooms": _rooms,
        "cars": _cars,
        "datasets": _datasets,
        "formats": _formats,
    }
    found = {name: rows() for name, rows in every.items() if what in (None, name)}
    if json:
        show.json(found)
        return
    for i, (name, entries) in enumerate(found.items()):
        if i:
            print()
        show.table([list(entry.values()) for entry in entries], title=name)


def _scenarios() -> list[dict[str, Any]]:
    from outrider import scenario

    return [{"name": name, "about": scenario.load(name).title} for name in scenario.names()]


def _observers() -> list[dict[str, Any]]:
    from outrider import observers

    return [{"name": name, "reference": observers.get(name).reference} for name in observers.names()]


def _estimators() -> list[dict[str, Any]]:
    from outrider import lateral

    return [{"name": name, "reference": lateral.get(name).reference} for name in lateral.names()]


def _relocalisers() -> list[dict[str, Any]]:
    from outrider import relocalise

    return [{"name": name, "reference": relocalise.get(name).reference} for name in relocalise.names()]


def _rooms() -> list[dict[str, Any]]:
    from outrider.relocalise import room as rooms

    walls = [(name, rooms.load(name).wall) for name in rooms.names()]
    alike = {0: "the same from everywhere round its centre", 1: "not symmetric"}
    return [
        {
            "name": name,
            "about": f"{wall.perimeter:.1f} m around, {wall.diameter:.1f} m across, "
            + alike.get(wall.symmetry, f"the same from {wall.symmetry} poses"),
        }
        for name, wall in walls
    ]


def _cars() -> list[dict[str, Any]]:
    from outrider import cars

    known = [(name, cars.load(name)) for name in cars.names()]
    return [
        {"name": name, "about": f"{car.mass:.0f} kg, wheelbase {car.front + car.rear:.2f} m"}
        for name, car in known
    ]


def _datasets() -> list[dict[str, Any]]:
    from outrider import datasets

    entries = [datasets.entry(name) for name in datasets.names()]
    return [
        {"name": f"{datasets.PREFIX}{e.name}", "about": e.about, "licence": e.licence, "origin": e.origin}
        for e in entries
    ]


def _formats() -> list[dict[str, Any]]:
    from outrider import io

    return [
        {"name": f.name, "about": f.about, "reads": " ".join(f.reads), "writes": " ".join(f.writes) or None}
        for f in io.formats()
    ]


def cite(*datasets: str) -> None:
    """Print BibTeX for outrider, the methods it runs, and the data sets that are named.

    Parameters
    ----------
    datasets
        Names of data sets (see `outrider ls datasets`).
    """
    from outrider import __version__
    from outrider import datasets as known

    named = [known.entry(name).citation for name in datasets]
    print("\n\n".join([SOFTWARE.format(version=__version__), *METHODS, *dict.fromkeys(named)]))
