"""Named public recordings: where they come from, under which licence, how they are cited, had and checked.

A file is looked for below the folder that the environment variable OUTRIDER_DATA names, then in the cache of
pooch, then fetched from its origin. Whatever is found must have the SHA-256 that is written here.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from outrider.errors import InputError
from outrider.io import Recording, open_recording
from outrider.io._kitti import open_kitti

PREFIX = "dataset:"
DATA_VARIABLE = "OUTRIDER_DATA"

_DATMO_COMMIT = "https://raw.githubusercontent.com/kostaskonkk/datmo/25aaf8a3a376f6fd886715178a93e8d2df8b2214"
_TYSIK_COMMIT = (
    "https://raw.githubusercontent.com/tysik/obstacle_detector/bd59d405b2284f05c46f7b99cb9cb4247934e2ff"
)


@dataclass(frozen=True, slots=True)
class File:
    """One file below OUTRIDER_DATA, and where the same content can be fetched."""

    local: str
    sha256: str  # of the local file
    url: str = ""  # "": cannot be fetched
    url_sha256: str = ""  # of what the URL gives


@dataclass(frozen=True, slots=True)
class Entry:
    """A recording with a name. All lengths are those of the recording, before `recording.scale`."""

    name: str
    about: str
    origin: str
    licence: str
    citation: str  # BibTeX
    files: tuple[File, ...]
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # sections of settings.Settings
    # By truth topic: centre of the body's rectangle in the frame of the truth pose; its length and width.
    truth_offset_m: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    truth_extent_m: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    valid_until_s: float | None = None  # header stamp after the first scan's from which ego or truth is wrong
    defects: str = ""


_DATMO_CITATION = """@misc{konstantinidis_datmo,
  title = {Development of a Detection and Tracking of Moving Vehicles system for 2D LIDAR sensors},
  author = {Konstantinidis, K. and Alirezaei, M. and Grammatico, S.},
  note = {paper.pdf of the repository},
  url = {https://github.com/kostaskonkk/datmo}
}"""
_KITTI_CITATION = """@article{geiger2013kitti,
  title = {Vision meets Robotics: The KITTI Dataset},
  author = {Geiger, Andreas and Lenz, Philip and Stiller, Christoph and Urtasun, Raquel},
  journal = {International Journal of Robotics Research},
  volume = {32}, number = {11}, pages = {1231--1237}, year = {2013}
}"""
_TYSIK_CITATION = """@inproceedings{przybyla2017obstacles,
  title = {Detection and tracking of 2D geometric obstacles from LRF data},
  author = {Przyby{\\l}a, Mateusz},
  booktitle = {11th International Workshop on Robot Motion and Control (RoMoCo)},
  year = {2017}
}"""

_DATMO_PERIOD_S = 0.0775
_DATMO_SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "recording": {
        "scan_topic": "/scan",
        "ego_topic": "/ego_pose",
        "truth_topics": ("/red_pose",),
        "scale": 10.0,
    },
    # Fitted to the room's walls: the driver writes 1/1000 of the true times, and beams run against time.
    "timing": {
        "scan_time_s": _DATMO_PERIOD_S,
        "time_increment_s": -0.977 * _DATMO_PERIOD_S / 360,
        "stamp_offset_s": 0.0591,
    },
    "mount": {"x_m": -0.1686, "y_m": 0.0220, "yaw_rad": 0.0020},
    "rider": {"length_m": 4.2, "width_m": 2.0},
    # Ten times the noise of the lidar, and model cars that are ten times as agile as street cars.
    "detect": {
        "range_noise_m": 0.1,
        "shape_noise_m": 0.1,
        "max_gap_beams": 6,
        "body_length_m": 4.2,
        "body_width_m": 2.0,
    },
    "track": {
        "acceleration_noise": 15.0,
        "yaw_acceleration_noise": 6.0,
        "moving_speed_mps": 1.0,
        "drift_per_range": 0.05,  # the walls wander by 0.2 m at 5 m
    },
    # Tuned on overtakes alone, each observer with the same budget: docs/comparison.md.
    "observer": {
        "gains": {
            "constant_velocity": {
                "L_x": 5.03,
                "L_y": 35.7,
                "L_psi": 19.0,
                "L_beta": 19.4,
                "speed": 10.4,
                "speed_chain": 0.115,
                "noise": 0.667,
                "l_r": 1.4,
                "heading": 16.6,
                "heading_noise": 0.177,
                "huber": 0.85,
            },
            "ekf": {
                "noise": 0.106,
                "jerk": 34.7,
                "slip": 1.01,
                "yaw": 0.107,
                "l_r": 1.46,
                "coast": 20.0,
                "heading_noise": 0.00475,
                "huber": 2.52,
            },
            "high_gain": {
                "L1": 57.6,
                "L2": 409.0,
                "L3": 2250.0,
                "c_max": 1.78,
                "noise": 0.0555,
                "l_r": 1.28,
                "heading": 14.3,
                "heading_noise": 0.161,
                "turn": 20.0,
                "huber": 1.22,
            },
            "imm": {
                "noise": 0.137,
                "straight": 20.0,
                "turning": 12.1,
                "turn_rate": 3.47,
                "turn": 1.1,
                "begin": 0.128,
                "end": 0.841,
                "l_r": 1.82,
                "heading_noise": 0.0054,
                "huber": 1.77,
            },
            "invariant": {
                "tau": 0.0789,
                "arc": 0.279,
                "relax": 4.62,
                "noise": 0.226,
                "turn": 1.49,
                "yaw": 0.125,
                "cross": 1.05,
                "heading_noise": 0.00351,
            },
            "multi_stage": {
                "speed": 4.92,
                "orientation": 3.93,
                "L_w": 8.71,
                "gate": 0.484,
                "l_r": 1.2,
                "heading": 100.0,
            },
            "ukf": {
                "noise": 0.0882,
                "jerk": 30.7,
                "slip": 1.0,
                "yaw": 0.0419,
                "l_r": 1.46,
                "coast": 1.07,
                "heading_noise": 0.0138,
                "huber": 3.15,
            },
        }
    },
}


def _datmo(run: str, sha256: str, url_sha256: str, about: str, **rest: Any) -> Entry:
    file = File(f"datmo_2dlidar/bags/{run}.bag.xz", sha256, f"{_DATMO_COMMIT}/examples/{run}.bag", url_sha256)
    return Entry(
        name=f"datmo/{run}",
        about=about,
        origin="https://github.com/kostaskonkk/datmo, commit 25aaf8a, examples/",
        licence="BSD 2-Clause, (c) 2019 Kostas Flou",
        citation=_DATMO_CITATION,
        files=(file,),
        settings=_DATMO_SETTINGS,
        truth_offset_m={"/red_pose": (0.046, 0.026)},
        truth_extent_m={"/red_pose": (0.42, 0.20)},
        **rest,
    )


_KITTI = "kitti0000_lidar_slice"
_ENTRIES = (
    _datmo(
        "overtakes",
        "a3037b8cc5eef4487ade206bdd7b3c2fc06309f0465fe04d195b0be73a520b2b",
        "fbd89a42e1902786acd9e90b9168855cf04216e654ab690140d657ac1efbe235",
        "1/10-scale cars overtake each other; rotating 360-beam lidar, motion-capture truth, 26 s",
        defects="Receive times equal header stamps: the bag was re-timed.",
    ),
    _datmo(
        "parallel",
        "488c6311e83a7dd517cd9d6dfc1086c56096368c665fe96e63fee162f689e2b5",
        "281c0205c9d14e0f5ed7561e445674baf53371571c69732576e2533d98df6600",
        "1/10-scale cars side by side; rotating 360-beam lidar, motion-capture truth, 17 s",
        defects="Header stamps are 0.08 s older than receive times.",
    ),
    _datmo(
        "overtake_ego",
        "0d9884274aa12161359d38becc2f191e688ef5e318dada54058f38b200edb50d",
        "678c6c2e4dfdce9739c3ab0be05b67cc5e006287084a9adb059f4ca75f4fb535",
        "the 1/10-scale lidar car overtakes another; rotating 360-beam lidar, motion-capture truth, 10 s",
        valid_until_s=8.0,
        defects="The ego pose stands still from scan 104 of 135 on, while the wheels go on turning.",
    ),
    Entry(
        name="kitti0000",
        about="street with a turning van, a cyclist and parked cars: slices of a 64-beam lidar, boxes, 10 s",
        origin="KITTI raw 2011_09_26_drive_0005 (tracking sequence 0000); slices 0.70-1.00 m above the road",
        licence="CC BY-NC-SA 3.0",
        citation=_KITTI_CITATION,
        files=(
            File(
                f"{_KITTI}/slices.parquet", "e6ce4a229a4515258c5fc42936e2e48077b29cadf11c604af953c6a2e2a3fecf"
            ),
            File(f"{_KITTI}/ego.parquet", "aa8f974db0ba4e9ad3ec57436ae459980cd823c3aad4df6ffa2635ee7bd6aa6b"),
            File(
                f"{_KITTI}/truth_boxes.parquet",
                "d1fd3c1571eecfa469399a6ec1f7f03472fc4e08bb2e5ae524fff31531d6fbbd",
            ),
        ),
        settings={
            "recording": {"scan_topic": "/scan", "ego_topic": "/ego_pose"},
            "timing": {"scan_time_s": 0.1036, "time_increment_s": 0.0, "stamp_offset_s": 0.0},
            "rider": {"length_m": 4.8, "width_m": 1.8},
        },
        defects="Every beam is the nearest of a 0.3 m thick slice, the turn of 0.1 s is not compensated, "
        "and only what the camera sees ahead is labelled.",
    ),
    Entry(
        name="tysik",
        about="indoors, two 726-beam scanners, ahead and back, something moves; no poses, no truth, 33 s",
        origin="https://github.com/tysik/obstacle_detector, commit bd59d40, resources/scans_demo.bag",
        licence="BSD (as package.xml says; the repository holds no licence file)",
        citation=_TYSIK_CITATION,
        files=(
            File(
                "tysik_two_hokuyo/scans_demo.bag.xz",
                "cfffe356d9ae1be89e40de034831580762a66ab024825c4777aff1a96f06f9ca",
                f"{_TYSIK_COMMIT}/resources/scans_demo.bag",
                "7cda65e31651605e7b3aa094b19d617a4c6b5fd5391f46601b3b0a09d97f6d30",
            ),
        ),
        settings={"recording": {"scan_topic": "/front_scan", "ego_topic": "none"}},
        defects="Some returns are nearer than range_min.",
    ),
)


def names() -> tuple[str, ...]:
    """Names of all recordings."""
    return tuple(entry.name for entry in _ENTRIES)


def entry(name: str) -> Entry:
    """What is known about a recording, its name with or without `dataset:`; raises InputError if unknown."""
    name = name.removeprefix(PREFIX)
    for candidate in _ENTRIES:
        if candidate.name == name:
            return candidate
    raise InputError(f"no data set {name!r}; want {', '.join(names())}")


def path(name: str) -> Path:
    """Local path of a recording's first file, its hash checked; fetched where it is not at hand."""
    return fetch(entry(name).files[0])


def load(name: str) -> Recording:
    """The recording, as `outrider.io.open_recording` gives it."""
    found = entry(name)
    paths = [fetch(file) for file in found.files]
    return open_kitti(*paths) if found.name == "kitti0000" else open_recording(paths[0])


def open_any(source: Path | str) -> tuple[Recording, Entry | None]:
    """The recording at a path, or the data set of a name that starts with `dataset:`, with its entry."""
    if isinstance(source, str) and source.startswith(PREFIX):
        return load(source), entry(source)
    return open_recording(source), None


def fetch(file: File) -> Path:
    """Local path of a file, found or fetched; raises InputError if it cannot be had or is not what it was."""
    import pooch

    folder = os.environ.get(DATA_VARIABLE)
    local = Path(folder) / file.local if folder else None
    if local and local.is_file():
        _check(local, file.sha256)
        return local
    hint = f"set {DATA_VARIABLE} to the folder that holds {file.local}"
    if not file.url:
        raise InputError(f"{file.local}: is not at hand and cannot be fetched; {hint}")
    try:
        cached = pooch.retrieve(
            file.url,
            known_hash=f"sha256:{file.url_sha256}",
            fname=file.local.removesuffix(".xz"),
            path=pooch.os_cache("outrider"),
        )
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"{file.url}: cannot be fetched ({reason}); {hint}") from error
    return Path(cached)


def _check(local: Path, sha256: str) -> None:
    import pooch

    try:
        found = pooch.file_hash(str(local), alg="sha256")
    except OSError as error:
        raise InputError(f"{local}: cannot be opened ({error.strerror})") from error
    if found != sha256:
        raise InputError(f"{local}: SHA-256 is {found[:12]}..., want {sha256[:12]}...; get the file again")
