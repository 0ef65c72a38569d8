"""From scans to tracks: one identity a vehicle, never turned round, near the truth; what stands stands."""

import dataclasses

import numpy as np
import pytest

from made_worlds import BACKDROP, driven, follow, prepared, returns_on, since_start, world
from outrider import detect, moving, scenario, simulate, tracker
from outrider.book import empty
from outrider.geometry import rotate, wrap
from outrider.records import LaserScan, Pose, TrackState
from outrider.settings import Recording, Settings

MOVING = (TrackState.CONFIRMED, TrackState.COASTING)


def lives(steps, what, near=2.0):
    """For each body of a scenario: its truth, and per step the row of its track or -1, and hits.

    A track follows the body whose centre is nearest to its own, within `near` [m].
    """
    truth = simulate.truth_at(what, since_start(steps))
    found = {}
    for name, motion in truth.items():
        rows, hits = [], []
        for k, step in enumerate(steps):
            off = np.hypot(*(step.tracks.W_p - [motion.x[k], motion.y[k]]).T)
            rows.append(int(off.argmin()) if len(off) and off.min() < near else -1)
            hits.append(int(returns_on(step.scan, motion, k).sum()))
        found[name] = (motion, np.array(rows), np.array(hits))
    return found


def column(steps, rows, name):
    """Column of the tracks along the rows of one life; NaN where there is no track."""
    values = [getattr(s.tracks, name)[i] if i >= 0 else np.nan for s, i in zip(steps, rows, strict=True)]
    return np.array(values, float)


def moving_ids(steps, rows):
    state = column(steps, rows, "state")
    return set(column(steps, rows, "id")[np.isin(state, MOVING)])


def check_vehicle(steps, motion, rows, hits, rms=0.15):
    """The promises kept for a vehicle that is seen."""
    state, yaw = column(steps, rows, "state"), column(steps, rows, "yaw")
    seen = np.flatnonzero(hits >= 5)
    drives = seen[np.abs(motion.speed[seen]) > 1.0]
    assert len(moving_ids(steps, rows)) == 1
    confirmed = drives[state[drives] == TrackState.CONFIRMED]
    late = drives[drives > drives[0] + 10]  # a second after it was first seen, or first drove
    assert np.mean(state[late] == TrackState.CONFIRMED) > 0.97
    assert np.abs(wrap(yaw[confirmed] - motion.yaw[confirmed])).max() < 0.5 * np.pi
    assert np.sqrt(np.mean(wrap(yaw[confirmed] - motion.yaw[confirmed]) ** 2)) < np.deg2rad(5.0)
    W_p = np.array([s.tracks.W_p[i] for s, i in zip(steps, rows, strict=True) if i >= 0])
    off = np.full(len(steps), np.nan)
    off[rows >= 0] = np.hypot(*(W_p - np.column_stack([motion.x, motion.y])[rows >= 0]).T)
    assert np.sqrt(np.mean(off[confirmed] ** 2)) < rms


# ------------------------------------------------------------------ the shipped scenarios


@pytest.mark.parametrize("seed", [None, 11])
@pytest.mark.parametrize("name", [n for n in scenario.names() if n != "demo"])
def test_a_vehicle_has_one_identity_one_front_and_is_where_it_is(name, seed):
    what, steps = simulate.load(name), driven(name, seed)
    for motion, rows, hits in lives(steps, what).values():
        check_vehicle(steps, motion, rows, hits)


def test_a_street_full_of_traffic():
    what, steps = simulate.load("demo"), driven("demo")
    found = lives(steps, what)
    for vehicle in what.vehicles:
        check_vehicle(steps, *found[vehicle.name])
    all_ids = [moving_ids(steps, found[v.name][1]) for v in what.vehicles]
    assert len(set().union(*all_ids)) == len(what.vehicles)
    for parked in what.parked:
        state = column(steps, found[parked.name][1], "state")
        assert not (state == TrackState.CONFIRMED).any()


@pytest.mark.parametrize("name", ["constant", "oncoming", "overtaking", "turning"])
def test_the_first_speed_that_is_told_is_right(name):
    """The observer starts with what the predictor has learnt by then, however open a direction still is."""
    what, steps = simulate.load(name), driven(name)
    ((motion, rows, _),) = lives(steps, what, near=3.0).values()
    first = int(np.flatnonzero(column(steps, rows, "state") == TrackState.CONFIRMED)[0])
    speed = column(steps, rows, "speed")[first : first + 5]
    assert speed == pytest.approx(motion.speed[first : first + 5], abs=0.8)


def test_identities_are_born_in_order_and_never_again():
    seen = []
    for step in driven("demo"):
        ids = step.tracks.id.tolist()
        assert ids == sorted(set(ids))
        seen.append(set(ids))
    for i in set().union(*seen):
        alive = [i in ids for ids in seen]
        first, last = alive.index(True), len(alive) - alive[::-1].index(True)
        assert all(alive[first:last])


# ------------------------------------------------------------------ what stands, and what begins to move


def test_parked_cars_are_never_called_moving():
    """A rider passes cars along the kerb, one across, one facing it, with a fence and a post between."""
    street = world(
        """
        [rider]
        speed_mps = 6.0
        """
        + "".join(
            f"""
            [[parked]]
            name = "p{k}"
            x_m = {x}
            y_m = {y}
            yaw_deg = {yaw}
            """
            for k, (x, y, yaw) in enumerate(
                [(10, -3, 0), (16, -3.1, 3), (22, -3, 0), (34, 3.5, 180), (40, 6.5, 90), (47, -3, -2)]
            )
        )
        + "[[walls]]\npoints_m = [[-20.0, -6.0], [100.0, -6.0]]\n"
        + "[[walls]]\npoints_m = [[-20.0, 10.0], [28.0, 10.0], [28.0, 40.0]]\n"
        + "[[poles]]\nx_m = 13.0\ny_m = -1.5\n",
        12.0,
    )
    for seed in (0, 1):
        steps = driven(street, seed)
        called = {}
        for step in steps:
            for i in step.tracks.id[step.tracks.state == TrackState.CONFIRMED]:
                called[i] = called.get(i, 0) + 1
        assert max(called.values(), default=0) <= 5


def sideways(speed, size=(1.8, 0.65)):
    """A track at (20, 3) that moves towards the sensor, its length across the way, after one look."""
    book = dataclasses.replace(empty(1, 0), size=np.array([[*size, 0.1, 0.15]]))
    book.x[:] = [20.0, 3.0, -speed, 0.0, 0.5 * np.pi, 0.0]
    book.P[:] = 0.01 * np.eye(6)
    book.state[:] = TrackState.CONFIRMED
    (scan,) = prepared(simulate.record(world(BACKDROP, 0.1)))
    moving.straighten(book, np.array([0]), scan, Settings())
    return book


def test_what_drives_across_its_length_shows_its_front():
    """A car straight ahead, taken for a two-wheeler from the side: the face that is seen stays."""
    book = sideways(6.0)
    assert book.size[0, :2].tolist() == [4.3, 1.8]
    assert abs(wrap(book.x[0, 4] - np.pi)) < 1e-12
    assert book.x[0, 0] - 0.5 * 4.3 == pytest.approx(20.0 - 0.5 * 0.65)
    assert book.x[0, 1] == pytest.approx(3.0)


@pytest.mark.parametrize(("speed", "size"), [(1.4, (1.8, 0.65)), (6.0, (4.3, 1.8))])
def test_people_side_by_side_and_a_car_of_known_length_are_left_alone(speed, size):
    """Walkers abreast do move across their common length; and no front is as wide as a car is long."""
    book = sideways(speed, size)
    assert book.size[0, :2].tolist() == list(size)
    assert book.x[0, 4] == 0.5 * np.pi


WAITS = """
    [[vehicles]]
    name = "car"
    x_m = -6.0
    y_m = 5.0
    manoeuvres = [{ duration_s = 4.0 }, { duration_s = 3.0, acceleration_mps2 = 2.0 }, { duration_s = 3.0 }]
    """
STOPS_AND_GOES = """
    [[vehicles]]
    name = "car"
    x_m = -14.0
    y_m = 5.0
    speed_mps = 5.0
    manoeuvres = [
      { duration_s = 1.5 },
      { duration_s = 1.25, acceleration_mps2 = -4.0 },
      { duration_s = 4.0 },
      { duration_s = 2.0, acceleration_mps2 = 2.0 },
      { duration_s = 1.0 },
      { duration_s = 2.0, acceleration_mps2 = -2.0 },
      { duration_s = 1.0 },
      { duration_s = 2.0, acceleration_mps2 = 2.0 },
    ]
    """


@pytest.mark.parametrize("seed", [0, 1])
def test_a_car_that_waits_is_static_and_keeps_its_identity_when_it_drives(seed):
    what = world(WAITS + BACKDROP, 10.0)
    steps = driven(what, seed)
    t = since_start(steps)
    ((_, rows, _),) = lives(steps, what).values()
    state, ids = column(steps, rows, "state"), column(steps, rows, "id")
    assert (state[(t > 1.0) & (t < 4.0)] == TrackState.STATIC).all()
    assert (state[t > 5.5] == TrackState.CONFIRMED).all()  # drives for 1.5 s, 2.2 m
    assert len(set(ids[t > 1.0])) == 1


@pytest.mark.parametrize("seed", [0, 1])
def test_a_car_that_stops_and_goes_is_one_car(seed):
    what = world(STOPS_AND_GOES + BACKDROP, 14.0)
    steps = driven(what, seed)
    t = since_start(steps)
    ((motion, rows, _),) = lives(steps, what).values()
    state, ids, yaw = (column(steps, rows, name) for name in ("state", "id", "yaw"))
    assert len(set(ids[t > 0.5])) == 1
    assert TrackState.STATIC in state[(t > 5.0) & (t < 6.7)]  # it has stood for more than two seconds
    assert (state[(t > 8.5) & (t < 9.5)] == TrackState.CONFIRMED).all()
    assert np.abs(wrap(yaw[t > 1.0] - motion.yaw[t > 1.0])).max() < 0.2  # standing or not


def test_a_car_that_backs_out_keeps_its_front():
    """First forward, then in reverse: the yaw stays, the speed changes its sign."""
    what = world(
        """
        [[vehicles]]
        name = "car"
        x_m = -6.0
        y_m = 6.0
        speed_mps = 4.0
        manoeuvres = [{ duration_s = 1.5 }, { duration_s = 1.0, acceleration_mps2 = -4.0 },
                      { duration_s = 1.0, acceleration_mps2 = -3.0 }, { duration_s = 3.0 }]
        """
        + BACKDROP,
        6.0,
    )
    steps = driven(what)
    t = since_start(steps)
    ((motion, rows, _),) = lives(steps, what).values()
    late = t > 1.0
    assert np.abs(wrap(column(steps, rows, "yaw") - motion.yaw)[late]).max() < 0.3
    assert (column(steps, rows, "speed")[t > 5.0] < -2.0).all()
    assert len(set(column(steps, rows, "id")[late])) == 1


# ------------------------------------------------------------------ out of sight


HIDDEN = """
    [[vehicles]]
    name = "car"
    x_m = -22.0
    y_m = 10.0
    speed_mps = 8.0
    [[walls]]
    points_m = [[-2.6, 3.0], [-0.1, 3.0]]
    """


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_car_behind_a_screen_coasts_and_comes_back_as_itself(seed):
    what = world(HIDDEN + BACKDROP.replace("14.0", "20.0"), 6.0)
    steps = driven(what, seed)
    ((motion, rows, hits),) = lives(steps, what).values()
    hidden = np.flatnonzero(hits == 0)
    state = column(steps, rows, "state")
    assert len(hidden) >= 3
    assert (state[hidden] == TrackState.COASTING).all()
    check_vehicle(steps, motion, rows, hits)


def test_what_is_not_seen_any_more_is_forgotten_in_time():
    """Moving tracks after `coast_s`, standing ones not yet; nothing becomes infinite on the way."""
    scans = prepared(simulate.record(simulate.load("crossing")))
    blind = [
        dataclasses.replace(
            scans[40],
            t=scans[40].t + 0.1 * k,
            beam_t=scans[40].beam_t + 0.1 * k,
            valid=np.zeros_like(scans[40].valid),
            range=np.full_like(scans[40].range, np.nan),
            W_p=np.full_like(scans[40].W_p, np.nan),
            ego=dataclasses.replace(scans[40].ego, t=scans[40].t + 0.1 * k),
        )
        for k in range(1, 21)
    ]
    steps = follow([*scans[:41], *blind])
    assert (steps[40].tracks.state == TrackState.CONFIRMED).sum() == 1
    for k, step in enumerate(steps[41:], 1):
        tracks = step.tracks
        assert not (tracks.state == TrackState.CONFIRMED).any()
        coasting = (tracks.state == TrackState.COASTING).sum()
        assert coasting == 1 or 0.1 * k > 0.9
        assert coasting == 0 or 0.1 * k < 1.1
        for name in ("W_p", "speed", "acceleration", "course", "yaw", "slip", "yaw_rate", "extent", "cov"):
            assert np.isfinite(getattr(tracks, name)).all()
    still = steps[40].tracks.id[steps[40].tracks.age > 2.0]
    standing = steps[40].tracks.state == TrackState.STATIC
    assert set(steps[40].tracks.id[standing]) & set(still) <= set(steps[-1].tracks.id)


def test_scans_without_beams_or_returns_give_no_tracks():
    scans = prepared(simulate.record(simulate.load("constant")))[:4]
    empty = [
        dataclasses.replace(
            s,
            **{f: getattr(s, f)[:0] for f in ("beam_t", "angle", "range", "valid", "W_sensor", "W_p")},
        )
        for s in scans
    ]
    for step in follow(empty):
        assert len(step.tracks.id) == len(step.detections.hits) == 0


# ------------------------------------------------------------------ symmetry


def same_tracks(one, other, turn=0.0):
    """Moving tracks agree; a newborn of two returns is left out, whose open directions are anyone's guess."""
    for a, b in zip((s.tracks for s in one), (s.tracks for s in other), strict=True):
        i, j = (np.flatnonzero(t.state == TrackState.CONFIRMED) for t in (a, b))
        assert np.array_equal(a.id[i], b.id[j])
        assert np.allclose(rotate(a.W_p[i], turn), b.W_p[j], atol=0.01)
        assert np.allclose(wrap(a.yaw[i] + turn - b.yaw[j]), 0.0, atol=0.01)
        assert np.allclose(a.speed[i], b.speed[j], atol=0.02)
        assert np.allclose(a.extent[i], b.extent[j], atol=0.01)


@pytest.mark.parametrize("turn", [0.5, 2.0, -2.6])
def test_turning_the_world_turns_the_tracks(turn):
    """Rider, poses and returns are turned together: the tracks are those of before, turned."""
    scans = prepared(simulate.record(simulate.load("oncoming_left_turn")))

    def turned(scan):
        sensor = np.column_stack([rotate(scan.W_sensor[:, :2], turn), wrap(scan.W_sensor[:, 2] + turn)])
        ego = scan.ego
        W_pose = np.append(rotate(ego.W_pose[:2], turn), wrap(ego.W_pose[2] + turn))
        ego = dataclasses.replace(ego, W_pose=W_pose, W_v=rotate(ego.W_v, turn))
        return dataclasses.replace(scan, W_sensor=sensor, W_p=rotate(scan.W_p, turn), ego=ego)

    same_tracks(follow(scans), follow([turned(s) for s in scans]), turn)


def test_a_scale_model_gives_the_same_tracks():
    """A tenth-scale recording with `recording.scale` 10, up to the rounding of its ranges."""

    def small(m):
        if isinstance(m, Pose):
            return dataclasses.replace(m, position=m.position / 10.0, extent=m.extent / 10.0)
        assert isinstance(m, LaserScan)
        ranges = (m.ranges.astype(float) / 10.0).astype(np.float32)
        return dataclasses.replace(
            m, ranges=ranges, range_min=m.range_min / 10.0, range_max=m.range_max / 10.0
        )

    messages = list(simulate.record(simulate.load("turning")))
    settings = Settings(recording=Recording(scale=10.0))
    want = follow(prepared(messages))
    got = follow(prepared([small(m) for m in messages], settings), settings)
    same_tracks(want, got)


def test_the_memory_that_was_handed_in_is_left_as_it_was():
    """A step is pure: every column of the book is the same after the next scan."""
    steps = driven("crossing")
    book = steps[20].memory.book
    columns = {f.name: getattr(book, f.name).copy() for f in dataclasses.fields(book)}
    engine = tracker.engine(Settings())
    segments, found = detect.detect(steps[21].scan, Settings().detect)
    tracker.update(steps[20].memory, steps[21].scan, segments, found, Settings(), engine)
    for name, before in columns.items():
        assert np.array_equal(getattr(book, name), before, equal_nan=before.dtype.kind == "f"), name


def test_the_covariance_of_every_track_is_one():
    for step in driven("demo"):
        cov = step.tracks.cov
        assert np.allclose(cov, cov.transpose(0, 2, 1))
        assert (np.linalg.eigvalsh(cov) > 0.0).all()
        P = step.memory.book.P
        assert (np.linalg.eigvalsh(P)[:, 0] > -1e-9).all()


def test_what_stands_is_remembered_where_it_was_seen():
    """Ten seconds out of sight: a parked car neither drifts with its noise nor claims the street."""
    engine = tracker.engine(Settings())
    book = dataclasses.replace(
        empty(2, engine.n_states), state=np.array([TrackState.STATIC, TrackState.COASTING])
    )
    book.x[:, 2], book.P[:] = 0.2, 0.01 * np.eye(6)
    tracks = tracker.estimate(book, 10.0, Settings(), engine)
    assert np.sqrt(tracks.cov[0].diagonal()).max() < 0.2
    assert np.sqrt(tracks.cov[1].diagonal()).min() > 10.0
    assert book.ahead(10.0).tolist() == [pytest.approx(0.3), 10.0]
