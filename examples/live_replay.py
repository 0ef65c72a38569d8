"""Play a recording as if a lidar were there, with a sink of one's own.

python examples/live_replay.py rec.mcap 4
"""

import sys

from outrider.live import Health, Shot, Silent
from outrider.live.engine import Live
from outrider.live.replay import open_replay


class Printer(Silent):
    """One line for each change of the level, and for what is not to be trusted."""

    level = None

    def shot(self, shot: Shot) -> None:
        """Called after every scan; whatever takes long belongs into a thread of its own."""
        alert = shot.frame.alert
        if alert.level != self.level:
            late = 1e3 * (shot.decided - shot.last_beam)
            print(f"{alert.level.name.lower():<8} {late:6.1f} ms after its last beam")
            self.level = alert.level

    def health(self, health: Health) -> None:
        """Called between scans, where none comes."""
        print("not to be trusted:", "; ".join(health.degraded) or "all is well again")


def main(recording: str, speed: str = "1.0") -> None:
    """Frames come at the recording's own pace times `speed`."""
    source, settings = open_replay(recording, None, [], float(speed))
    live = Live(source, [Printer()], settings, source.pace)
    live.warm()
    figures = live.run()
    print(f"{figures['counts']['scans']} scans, {figures['alerts']['danger']} dangers")


if __name__ == "__main__":
    main(*sys.argv[1:])
