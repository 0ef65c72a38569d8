"""Real scans in, figures against truth out; the same settings for the three datmo runs."""

from functools import cache

import numpy as np
import pytest

import outrider
from outrider import datasets
from outrider.geometry import compose, interpolate_poses, wrap
from outrider.io import choose_topics
from outrider.records import Pose, TrackState

SCALE = 10.0
SKIP_S = 1.0  # a track has its first second to begin
RUNS = ("overtakes", "parallel", "overtake_ego")
MOVING = (TrackState.CONFIRMED, TrackState.COASTING)
LEARN = ("detect.body_length_m=none", "detect.body_width_m=none")

pytestmark = pytest.mark.usefixtures("data")


@cache
def truth(run):
    """Times and poses of the target's body centre, in the recording's metres."""
    entry = datasets.entry(f"datmo/{run}")
    poses = [
        m for m in datasets.load(entry.name).messages() if isinstance(m, Pose) and m.topic == "/red_pose"
    ]
    offset = np.append(entry.truth_offset_m["/red_pose"], 0.0)
    t = np.array([p.stamp_ns * 1e-9 for p in poses])
    t, first = np.unique(t, return_index=True)
    return t, compose(np.array([p.xyyaw for p in poses])[first], offset[None])


@cache
def frames(run, changes=()):
    """Frames of a run, without its first second and without what its truth does not cover."""
    entry = datasets.entry(f"datmo/{run}")
    out = list(outrider.track(f"dataset:datmo/{run}", changes=changes))
    first = out[0].t
    until = entry.valid_until_s or np.inf
    return [f for f in out if first + SKIP_S <= f.t <= first + until]


def at(run, t):
    return interpolate_poses(*truth(run), np.atleast_1d(t))


def front_end(run, changes=()):
    """Error of centre [m] and heading [rad] of the rectangle fitted to the target in each scan."""
    centre, heading = [], []
    for frame in frames(run, changes):
        d = frame.detections
        true = at(run, d.hit_t)
        apart = np.hypot(*(d.W_p / SCALE - true[:, :2]).T)
        mine = np.flatnonzero((d.track >= 0) & (apart < 0.35))
        if len(mine):
            i = mine[d.hits[mine].argmax()]
            centre.append(apart[i])
            heading.append(wrap(d.heading[i] - true[i, 2]))
    return np.array(centre), np.array(heading)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize(
    ("run", "centre_cm", "heading_deg"),
    [("overtakes", 2.5, 5.5), ("parallel", 1.6, 1.5), ("overtake_ego", 2.1, 4.0)],
)
def test_rectangle_of_known_size(run, centre_cm, heading_deg):
    centre, heading = front_end(run)
    assert len(centre) >= 0.97 * len(frames(run))
    assert 100.0 * rms(centre) <= centre_cm
    assert np.rad2deg(rms(heading)) <= heading_deg
    assert np.rad2deg(np.abs(heading).max()) < 45.0


@pytest.mark.parametrize("run", RUNS)
def test_rectangle_of_learnt_size(run):
    centre, heading = front_end(run, LEARN)
    assert len(centre) >= 0.97 * len(frames(run, LEARN))
    assert 100.0 * rms(centre) <= 4.0
    assert np.rad2deg(np.abs(heading).max()) < 45.0


def nearest(run, frame):
    """Row of the track that is the target, -1 for none."""
    tracks = frame.tracks
    apart = np.hypot(*(tracks.W_p / SCALE - at(run, frame.t)[0, :2]).T)
    apart[tracks.state == TrackState.TENTATIVE] = np.inf
    return int(apart.argmin()) if len(apart) and apart.min() < 0.35 else -1


@pytest.mark.parametrize("changes", [(), LEARN], ids=["known size", "learnt size"])
@pytest.mark.parametrize("run", RUNS)
def test_one_identity_from_the_first_second_to_the_end(run, changes):
    rows = [(frame, nearest(run, frame)) for frame in frames(run, changes)]
    identities = [int(frame.tracks.id[i]) for frame, i in rows if i >= 0]
    assert len(identities) >= 0.97 * len(rows)
    assert len(set(identities)) == 1
    turned = [
        abs(wrap(frame.tracks.yaw[i] - at(run, frame.t)[0, 2]))
        for frame, i in rows
        if i >= 0 and abs(frame.tracks.speed[i]) > 0.2 * SCALE
    ]
    assert max(turned) < 0.5 * np.pi


@pytest.mark.parametrize(
    ("run", "velocity_mps", "yaw_deg"),
    [("overtakes", 0.14, 4.0), ("parallel", 0.16, 3.0), ("overtake_ego", 0.135, 3.0)],
)
def test_motion_of_the_target(run, velocity_mps, yaw_deg):
    """The default observer behind the real front end, in the recording's metres."""
    e_v, e_yaw = [], []
    for frame in frames(run):
        i = nearest(run, frame)
        before, after = at(run, [frame.t - 0.125, frame.t + 0.125])
        v = (after[:2] - before[:2]) / 0.25
        e_v.append(np.hypot(*(frame.tracks.W_v[i] / SCALE - v)))
        if np.hypot(*v) > 0.2:
            e_yaw.append(wrap(frame.tracks.yaw[i] - at(run, frame.t)[0, 2]))
    assert rms(e_v) <= velocity_mps
    assert np.rad2deg(rms(e_yaw)) <= yaw_deg


# ------------------------------------------------------------------ a street


@cache
def street():
    """Frames, and the labelled boxes of each by the time of the scan."""
    recording = datasets.load("kitti0000")
    chosen = choose_topics(recording, None)
    boxes = {}
    for m in recording.messages(chosen.truth):
        boxes.setdefault(m.stamp_ns, []).append(m)
    return list(outrider.track("dataset:kitti0000")), boxes


def followed(kind):
    """Frames in which a labelled body has four returns or more; identity and state of its track."""
    seen, held = 0, []
    for frame in street()[0]:
        for box in street()[1].get(round(frame.t * 1e9), ()):
            if not box.topic.startswith(f"/truth/{kind}"):
                continue
            x, y, yaw = box.xyyaw
            d = frame.scan.W_p[frame.scan.valid] - [x, y]
            c, s = np.cos(yaw), np.sin(yaw)
            u, v = np.abs(c * d[:, 0] + s * d[:, 1]), np.abs(c * d[:, 1] - s * d[:, 0])
            if np.sum((u < 0.5 * box.extent[0] + 0.15) & (v < 0.5 * box.extent[1] + 0.15)) < 4:
                continue
            seen += 1
            apart = np.hypot(*(frame.tracks.W_p - [x, y]).T)
            apart[frame.tracks.state == TrackState.TENTATIVE] = np.inf
            if len(apart) and apart.min() < max(1.5, 0.5 * box.extent[0]):
                held.append((int(frame.tracks.id[apart.argmin()]), int(frame.tracks.state[apart.argmin()])))
    return seen, held


@pytest.mark.parametrize("kind", ["Van_0", "Cyclist_1"])
def test_a_turning_van_and_a_cyclist_each_under_one_track(kind):
    seen, held = followed(kind)
    assert seen >= 80
    _, counts = np.unique([identity for identity, _ in held], return_counts=True)
    assert counts.max() >= 0.8 * seen


def test_no_parked_car_is_called_moving_for_half_a_second():
    recording = datasets.load("kitti0000")
    names = {t.name for t in recording.topics if t.name.startswith("/truth/")}
    parked = [n.removeprefix("/truth/") for n in names if not n.endswith(("Van_0", "Cyclist_1"))]
    assert parked
    for name in parked:
        _, held = followed(name)
        assert sum(state in MOVING for _, state in held) <= 5, name


def test_a_second_sensor_layout_without_poses_runs_through():
    """A room where nearly all stands: 726 beams over 255 deg, some returns below the least range."""
    out = list(outrider.track("dataset:tysik"))
    assert len(out) == 331
    assert all(np.isfinite(f.tracks.W_p).all() and np.isfinite(f.tracks.speed).all() for f in out)
    assert sum(f.scan.masked.get("below_min", 0) for f in out) > 0
    assert not any((f.tracks.state == TrackState.CONFIRMED).sum() > 1 for f in out)
