"""How sure can one be? Bounds that hold whatever the noise does, against the true errors of a simulation.

python examples/guaranteed_bounds.py left_turn_in_front 0.2
"""

import sys

import numpy as np

import outrider
from outrider import simulate
from outrider.records import TrackState


def main(scenario: str, position_m: str) -> None:
    """Error and bound of the track nearest to the first body, once a second, and how often it was outside."""
    world = simulate.load(scenario)
    changes = [f"envelope.position_m={position_m}", "detect.body_length_m=4.5", "detect.body_width_m=1.8"]
    outside = scans = 0
    print("     t   error <= bound [m]   error <= bound [m/s]   time to collision")
    for frame in outrider.track(simulate.record(world), changes=changes):
        t, tracks, threats = frame.t - simulate.EPOCH_NS * 1e-9, frame.tracks, frame.threats
        body = next(iter(simulate.truth_at(world, t).values()))
        away = np.hypot(tracks.W_p[:, 0] - body.x[0], tracks.W_p[:, 1] - body.y[0])
        away[tracks.state != TrackState.CONFIRMED] = np.inf
        if not len(away) or away.min() > 2.0:
            continue
        i, course = int(away.argmin()), body.yaw[0] + body.slip[0]
        v = tracks.W_v[i] - body.speed[0] * np.array([np.cos(course), np.sin(course)])
        errors, (far, fast) = (away[i], np.hypot(*v)), tracks.bound[i]
        outside += errors[0] > far or errors[1] > fast
        scans += 1
        if scans % 10 == 1:
            place, speed = f"{errors[0]:5.2f} <= {far:5.2f}", f"{errors[1]:5.2f} <= {fast:5.2f}"
            between = f"{threats.ttc_earliest[i]:.1f} to {threats.ttc_latest[i]:.1f} s"
            print(f"{t:6.1f}   {place}       {speed}         {between}")
    print(f"outside its bound in {outside} of {scans} scans")


if __name__ == "__main__":
    main(*sys.argv[1:])
