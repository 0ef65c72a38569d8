"""Raw scan to alert, with twenty vehicles in view, beside two peers on the very same detections.

The peers get the centres that outrider's own detector found and do association and filtering only. Times are
medians over scans after warm-up.
"""

import datetime
from functools import cache
from itertools import count

import numpy as np
import pytest

from conftest import NOTES
from outrider import pipeline
from outrider.lidar_model import Shapes, beam_angles, beam_count, cast, measure
from outrider.records import LaserScan, TrackState
from outrider.scan import prepare
from outrider.scenario import Sensor
from outrider.settings import Settings

VEHICLES = 20
LAP = 180  # scans until the scene repeats
PERIOD_NS = 100_000_000
EXTENT = np.array([4.2, 1.8])
SETTINGS = Settings()
EPOCH = datetime.datetime(2026, 1, 1)


def places(t):
    """Poses (n, 20, 3) at times t (n,) [s]: on two rings about the sensor, 5 to 10 m/s, none hidden."""
    rate = 2.0 * np.pi / (LAP * PERIOD_NS * 1e-9)
    slot = 2.0 * np.pi * np.arange(VEHICLES) / VEHICLES
    radius = np.where(np.arange(VEHICLES) % 2, 28.0, 16.0)
    angle = slot + rate * t[:, None]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2], axis=-1)


@cache
def lap(beams):
    """Ranges (180, beams) [m] of one lap, and the sensor."""
    sensor = Sensor(step_deg=360.0 / beams, lost=0.0, echoes=30.0)
    rng = np.random.default_rng(20)
    n = beam_count(sensor)
    rows = []
    for k in range(LAP):
        t = (k + np.arange(n) / n) * PERIOD_NS * 1e-9
        shapes = Shapes(
            pose=places(t),
            extent=np.tile(EXTENT, (VEHICLES, 1)),
            centre=np.empty((n, 0, 2)),
            radius=np.empty(0),
            walls=np.empty((0, 2, 2)),
        )
        rows.append(measure(cast(np.zeros((n, 2)), beam_angles(sensor), shapes), sensor, rng))
    return np.stack(rows), sensor


def messages(beams):
    """Raw scans for ever, the lap again and again."""
    rows, sensor = lap(beams)
    n, first = rows.shape[1], float(beam_angles(sensor)[0])
    for k in count():
        stamp = 1_000_000_000_000 + k * PERIOD_NS
        yield LaserScan(
            topic="/scan",
            frame="laser",
            stamp_ns=stamp,
            received_ns=stamp + PERIOD_NS,
            angle_min=first,
            angle_increment=2.0 * np.pi / n,
            time_increment=PERIOD_NS * 1e-9 / n,
            scan_time=PERIOD_NS * 1e-9,
            range_min=sensor.range_min_m,
            range_max=sensor.range_max_m,
            ranges=rows[k % LAP],
            intensities=np.empty(0, np.float32),
        )


class Ours:
    """outrider's chain; each call takes the next raw scan."""

    def __init__(self, beams):
        self.scans = iter(prepare(messages(beams), "/scan", None, SETTINGS))
        self.engine = pipeline.engine(SETTINGS)
        self.memory = pipeline.start(SETTINGS)
        self.frame = None

    def __call__(self):
        self.memory, self.frame = pipeline.step(self.memory, next(self.scans), SETTINGS, self.engine)
        return self.frame

    def confirmed(self):
        return int((self.frame.tracks.state == TrackState.CONFIRMED).sum())


@cache
def detections(beams):
    """Times [s], centres (n, 2) and sizes (n, 2) [m] of what outrider detects, over two laps."""
    ours = Ours(beams)
    found = []
    for _ in range(2 * LAP):
        d = ours().detections
        vehicle = np.isin(d.kind, [0]) | (d.track >= 0)
        found.append((d.t - 1000.0, d.W_p[vehicle], d.extent[vehicle]))
    return found


def endless(beams):
    """The detections for ever, with time running on."""
    found = detections(beams)
    for k in count():
        t, centres, sizes = found[k % len(found)]
        yield t + (k // len(found)) * len(found) * PERIOD_NS * 1e-9, centres, sizes


@pytest.mark.parametrize("beams", [480, 3200])
def test_outrider(timed, beams):
    ours = Ours(beams)
    timed(f"{beams} beams", "outrider", ours, warmup=150)
    assert ours.confirmed() >= VEHICLES - 1


def test_stone_soup(timed):
    """Global nearest neighbour, constant velocity, Kalman filter."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.tracker.simple import MultiTargetTracker
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    model = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=np.diag([0.1**2, 0.1**2]))
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(6.0)] * 2))
    updater = KalmanUpdater(model)
    associator = GNNWith2DAssignment(
        DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4.0)
    )
    deleter = UpdateTimeStepsDeleter(10)

    def stream():
        for t, centres, _ in endless(480):
            at = EPOCH + datetime.timedelta(seconds=t)
            yield at, {Detection(p[:, None], timestamp=at, measurement_model=model) for p in centres}

    tracker = MultiTargetTracker(
        initiator=MultiMeasurementInitiator(
            prior_state=GaussianState(np.zeros((4, 1)), np.diag([0.0, 15.0, 0.0, 15.0]) ** 2),
            deleter=deleter,
            data_associator=associator,
            updater=updater,
            measurement_model=model,
            min_points=3,
        ),
        deleter=deleter,
        detector=stream(),
        data_associator=associator,
        updater=updater,
    )
    steps = iter(tracker)
    last = []

    def work():
        last[:] = [next(steps)]

    timed("480 beams", "Stone Soup", work, rounds=60, warmup=15)
    assert len(last[0][1]) >= VEHICLES - 1


def test_motpy(timed):
    """Boxes without heading, matched by overlap, constant velocity, Kalman filter."""
    from motpy import Detection, ModelPreset, MultiObjectTracker

    tracker = MultiObjectTracker(
        dt=PERIOD_NS * 1e-9,
        model_spec=ModelPreset.constant_velocity_and_static_box_size_2d.value,
        matching_fn_kwargs={"min_iou": 0.01},
    )
    stream = endless(480)

    def work():
        _, centres, sizes = next(stream)
        half = 0.5 * np.maximum(sizes, 1.8)
        tracker.step([Detection(box=[*(c - h), *(c + h)]) for c, h in zip(centres, half, strict=True)])

    timed("480 beams", "motpy", work)
    assert len(tracker.active_tracks()) >= VEHICLES - 1


def test_memory_stays_flat_over_an_hour(benchmark):
    """An hour of replay at 10 Hz holds no more memory at its end than after its first six minutes."""
    ours = Ours(480)
    held = []

    def hour():
        for k in range(36_000):
            ours()
            if k % 3600 == 3599:
                held.append(resident_mib())

    benchmark.pedantic(hour, rounds=1, iterations=1)
    NOTES.append(
        f"memory over an hour's replay, MiB, every six minutes: {' '.join(f'{m:.1f}' for m in held)}"
    )
    assert max(held[1:]) - held[0] < 5.0


def resident_mib():
    """Resident memory of this process [MiB]; the peak where the system does not tell the present."""
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
