"""The command line: parses, calls, prints; one file a group of commands, libraries imported inside them."""

import os
import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError

from outrider import __version__
from outrider.cli.certify import certify
from outrider.cli.compare import compare
from outrider.cli.demo import demo
from outrider.cli.design import design
from outrider.cli.emulate import emulate
from outrider.cli.evaluate import evaluate
from outrider.cli.lateral import lateral
from outrider.cli.live import live
from outrider.cli.names import cite, ls
from outrider.cli.recordings import convert, info, simulate
from outrider.cli.relocalise import relocalise
from outrider.cli.reproduce import reproduce
from outrider.cli.track import track
from outrider.cli.view import view
from outrider.errors import OutriderError

STOPPED, CLOSED = 130, 141  # exit codes after Ctrl-C, and where the reader of a pipe went away

app = App(
    name="outrider",
    help="Raw 2D lidar scans in; tracked vehicles, times to collision and warnings out. "
    "And a car's lateral velocity, and where a robot is between walls, from their own sensors.",
    version=__version__,
    suppress_keyboard_interrupt=False,
)
for _command in (
    demo,
    track,
    info,
    convert,
    simulate,
    evaluate,
    compare,
    design,
    certify,
    reproduce,
    lateral,
    relocalise,
    live,
    emulate,
    view,
    ls,
    cite,
):
    app.command(_command)
app.register_install_completion_command()


def run(tokens: Sequence[str] | None = None) -> int:
    """One command; its exit code. What goes wrong is one line on stderr."""
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return _told(f"{error}; see outrider --help", 2)
    except OutriderError as error:
        return _told(error, error.exit_code)
    except KeyboardInterrupt as error:
        return _told(str(error) or "stopped", STOPPED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing is left to flush at exit
        return CLOSED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _told(f"{place}{error.strerror or error}", 2)
    return 0


def _told(message: object, code: int) -> int:
    print("outrider:", " ".join(str(message).split()), file=sys.stderr)
    return code


def main() -> None:
    """The command `outrider`."""
    sys.exit(run())
