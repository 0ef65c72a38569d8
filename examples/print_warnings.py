"""Track a recording and print each change of the warning level.

python examples/print_warnings.py rec.mcap
"""

import sys

import outrider


def main(recording: str) -> None:
    """One line for each change, with the time to collision and the track it is about."""
    before, start = None, None
    for frame in outrider.track(recording):
        start = frame.t if start is None else start
        alert = frame.alert
        if alert.level != before:
            about = f", track {alert.track} in {alert.ttc:.1f} s" if alert.track >= 0 else ""
            print(f"{frame.t - start:6.1f} s  {alert.level.name.lower()}{about}")
            before = alert.level
        for reason in alert.degraded:
            print(f"{frame.t - start:6.1f} s  not to be trusted: {reason}")


if __name__ == "__main__":
    main(*sys.argv[1:])
