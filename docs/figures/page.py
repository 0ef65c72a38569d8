"""Takes page-*.png: the page in a browser, on a desk and on a phone, live and of a finished run.

python docs/figures/page.py [FOLDER]: into this folder unless one is named. Needs playwright and a Chromium
(OUTRIDER_CHROMIUM, or the one on the path).
"""

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from outrider import pipeline, simulate
from outrider.io.run import RunWriter, open_run
from outrider.live import Health, Shot
from outrider.live.page.replay import RunShow
from outrider.live.page.server import PageSink, Server
from outrider.scan import ScanStream
from outrider.settings import Settings, override

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
FLAGS += ["--disable-sync", "--no-first-run", "--mute-audio"]
INTO = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
DESK, PHONE = {"width": 1280, "height": 760}, {"width": 360, "height": 740}
FINE, LATE = Health((), {}), Health(("scans late: 0.62 s since the last one, limit 0.50 s",), {})
CLEAR, CAUTION, DANGER = 30, 43, 54  # scans of the demo so far


def frames(settings):
    """The street of `outrider demo`, with bounds."""
    engine, memory = pipeline.engine(settings), pipeline.start(settings)
    for scan in ScanStream(simulate.record(simulate.load("demo")), "/scan", "/ego_pose", settings):
        memory, frame = pipeline.step(memory, scan, settings, engine)
        yield frame


def feed(sink, page, shown, health=FINE, gap=0.1):
    for frame in shown:
        now = time.time()
        sink.shot(Shot(frame, None, health, now - 0.012, now))
        page.wait_for_timeout(1000 * gap)


def take(page, name):
    """A picture of the page while its sign does not blink."""
    page.evaluate("document.getAnimations().filter((a) => a.animationName).forEach((a) => a.cancel())")
    page.screenshot(path=INTO / f"page-{name}.png", full_page=False)


def live(browser, settings, street):
    """Danger on a desk and on a phone; then paused, untrusted, and without scans."""
    for name, size, scheme in (("desk", DESK, "light"), ("dark", DESK, "dark"), ("phone", PHONE, "light")):
        sink = PageSink(settings, port=0, about={"sensor": "simulated"})
        page = opened(browser, sink.url, size, scheme)
        page.wait_for_timeout(500)
        last = CAUTION if name == "dark" else DANGER
        feed(sink, page, street[:CLEAR], gap=0.03)
        feed(sink, page, street[CLEAR:last])
        feed(sink, page, street[last : last + 4])
        take(page, name)
        if name == "phone":
            feed(sink, page, street[CLEAR - 3 : CLEAR], LATE)
            take(page, "unsure")
            page.wait_for_timeout(1500)
            take(page, "old")
        elif name == "desk":
            page.get_by_role("button", name="Pause").click()
            for _ in range(10):
                page.keyboard.press("ArrowLeft")
            feed(sink, page, street[DANGER + 4 : DANGER + 8])
            take(page, "past")
        page.context.close()
        sink.close()


def run(browser, settings, street, folder):
    """A finished run, with its slider."""
    with RunWriter(folder, settings, about={"recording": "demo/recording.mcap"}) as writer:
        for frame in street:
            writer.write(frame)
    server = Server(RunShow(open_run(folder)), port=0)
    page = opened(browser, server.url, DESK, "light")
    page.wait_for_timeout(500)
    page.locator("#slider").fill("118")
    page.wait_for_timeout(1000)
    page.locator("#slider").blur()
    take(page, "view")
    page.context.close()
    server.close()


def opened(browser, url, size, scheme):
    context = browser.new_context(
        viewport=size, color_scheme=scheme, device_scale_factor=2 if size is PHONE else 1
    )
    page = context.new_page()
    page.goto(url)
    return page


def main():
    program = os.environ.get("OUTRIDER_CHROMIUM") or shutil.which("chromium")
    if not program:
        sys.exit("no Chromium: install one, or name it in OUTRIDER_CHROMIUM")
    settings = override(Settings(), ["envelope.position_m=0.2"])
    street = list(frames(settings))
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        live(browser, settings, street)
        run(browser, settings, street, Path(folder) / "run")
        browser.close()


if __name__ == "__main__":
    main()
