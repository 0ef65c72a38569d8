"""`outrider view`: a finished run in the browser, with a time slider."""

import os
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def view(
    run: Path,
    /,
    *,
    page: str = "",
    page_token: str = "",
    open_: Annotated[bool, Parameter("--open", negative="--no-open")] = True,
) -> None:
    """Show a run folder in the browser until Ctrl-C: the scene from above, alerts, a time slider.

    Parameters
    ----------
    run
        Folder that `outrider track -o` wrote, also one whose run was killed.
    page
        HOST:PORT to serve it on; this machine alone can reach it by default.
    page_token
        Word that the page asks for; without it, one is made up where others can reach HOST.
    open_
        Open the browser of this machine.
    """
    from outrider.io.run import open_run
    from outrider.live.page.replay import RunShow
    from outrider.live.page.server import Server, address

    host, port = address(page)
    server = Server(RunShow(open_run(run)), host, port, page_token)
    try:
        print(f"{run}: {server.url}\nCtrl-C ends it", file=sys.stderr, flush=True)
        if open_ and _has_screen():
            webbrowser.open(server.url)
        with suppress(KeyboardInterrupt):
            server.wait()
    finally:
        server.close()


def _has_screen() -> bool:
    """Whether a browser would open a window, not take over the terminal."""
    return sys.platform != "linux" or bool(os.environ.keys() & {"DISPLAY", "WAYLAND_DISPLAY"})
