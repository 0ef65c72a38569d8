"""The page in a real browser, and who may look at it; what needs a browser is skipped where there is none."""

import http.client
import itertools
import json
import os
import pickle
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from made_frames import make_frames
from outrider import pipeline, simulate
from outrider.errors import InputError
from outrider.io._run_points import RunPoints
from outrider.io.run import RunWriter, open_run
from outrider.live import Health, Shot
from outrider.live.page import message
from outrider.live.page.guard import Guard
from outrider.live.page.replay import RunShow
from outrider.live.page.server import PAGES, PageSink, Server, address
from outrider.records import Level, TrackState
from outrider.scan import ScanStream
from outrider.settings import Settings, override

pytestmark = pytest.mark.once

FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--no-first-run", "--mute-audio"),
)
FINE = Health((), {"turns": 7})
TOKEN = "a-word-for-the-test"

# what is asked of the page, in its own language
COLOUR = "name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim()"
COUNT = """wanted => {
  const c = page.scene.canvas, d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  let n = 0;
  for (let i = 0; i < d.length; i += 4) n += wanted.every((value, k) => Math.abs(d[i + k] - value) < 5);
  return n;
}"""
PAINTED = """() => {
  const c = document.getElementById("marks");
  return c.getContext("2d").getImageData(0, 0, c.width, c.height).data.some((value) => value);
}"""
NAMELESS = """[...document.querySelectorAll("button, input, select, canvas[role], dialog, section")]
  .filter((e) => !(e.getAttribute("aria-label") || e.textContent.trim() || e.labels?.length))
  .map((e) => e.outerHTML)"""
RING = """async () => {
  const { Ring } = await import("./times.js"), ring = new Ring(), lengths = [];
  for (let i = 0; i < 6000; i++) {
    ring.push({ at: i / 20, level: 0, id: [] }, i > 2000);
    lengths.push(ring.length);
  }
  return lengths;
}"""
WARNED = """() => {
  const track = page.shown.rows.find((t) => t.id === page.shown.track);
  return page.scene.at(track.x, track.y);
}"""
BOXES = """() => [
  Object.fromEntries(["banner", "level", "ttc", "about", "scene", "pause"].map((id) => {
    const box = document.getElementById(id).getBoundingClientRect();
    return [id, [box.left, box.top, box.right, box.bottom]];
  })),
  parseFloat(getComputedStyle(document.getElementById("seconds")).fontSize),
]"""
HEIGHTS = """[...document.querySelectorAll("button, select")]
  .filter((e) => e.checkVisibility()).map((e) => e.getBoundingClientRect().height)"""
STATIC = Path(message.__file__).parent / "static"


# ------------------------------------------------------------------ what is shown


@pytest.fixture(scope="module")
def settings():
    return override(Settings(), ["envelope.position_m=0.2"])


@pytest.fixture(scope="module")
def frames(settings):
    """Six seconds of the street of `outrider demo`: a car from the right, as far as danger."""
    made, engine, memory = [], pipeline.engine(settings), pipeline.start(settings)
    with np.errstate(all="raise", under="ignore"):
        for scan in ScanStream(simulate.record(simulate.load("demo")), "/scan", "/ego_pose", settings):
            memory, frame = pipeline.step(memory, scan, settings, engine)
            made.append(frame)
            if len(made) == 58:
                break
    assert {f.alert.level for f in made} == set(Level)
    return made


@pytest.fixture(scope="module")
def folder(frames, settings, tmp_path_factory):
    """A finished run of these frames."""
    where = tmp_path_factory.mktemp("page") / "run"
    with RunWriter(where, settings, about={"recording": "/somewhere/street.mcap"}) as writer:
        for frame in frames:
            writer.write(frame)
    return where


PATIENT = ["envelope.position_m=0.2", "alert.stale_after_s=30"]  # a slow machine tests something else


@pytest.fixture
def sink():
    made = PageSink(override(Settings(), PATIENT), port=0, about={"sensor": "made up"})
    yield made
    made.close()


@pytest.fixture(scope="module")
def silent():
    """A page that is asked, and never shown anything."""
    made = PageSink(Settings(), port=0)
    yield made
    made.close()


def shot(frame, health=FINE):
    now = time.time()
    return Shot(frame, None, health, now - 0.01, now)


def unpacked(data):
    """Head and columns of a message."""
    (size,) = struct.unpack("<I", data[:4])
    head, at = json.loads(data[4 : 4 + size]), 4 + size
    for name, *shape in head.pop("arrays"):
        n = int(np.prod(shape))
        head[name] = np.frombuffer(data, "<f4", n, at).reshape(shape).astype(float)
        at += 4 * n
    assert at == len(data)
    return head


# ------------------------------------------------------------------ messages


def test_a_message_holds_what_the_frame_holds(frames):
    frame = frames[-1]
    got, tracks = unpacked(message.pack(message.picture(frame), number=3)), frame.tracks
    origin = np.array(got["ego"][:2])
    np.testing.assert_allclose(got["points"] + origin, frame.scan.W_p[frame.scan.valid], rtol=1e-6, atol=1e-5)
    rows = dict(zip(message.COLUMNS, got["tracks"].T, strict=True))
    np.testing.assert_allclose(
        np.column_stack([rows["x"], rows["y"]]) + origin, tracks.W_p, rtol=1e-6, atol=1e-5
    )
    for name, told in [
        ("speed", tracks.speed), ("yaw", tracks.yaw), ("ttc", frame.threats.ttc),
        ("earliest", frame.threats.ttc_earliest), ("latest", frame.threats.ttc_latest),
        ("bound_position", tracks.bound[:, 0]), ("width", tracks.extent[:, 1]),
    ]:  # fmt: skip
        np.testing.assert_allclose(rows[name], told, rtol=1e-6, err_msg=name)
    assert np.isinf(rows["ttc"]).any()
    assert np.isfinite(rows["ttc"]).any()
    assert (got["id"], got["state"]) == (tracks.id.tolist(), tracks.state.tolist())
    assert (got["level"], got["track"], got["number"]) == (Level.DANGER, frame.alert.track, 3)
    assert got["ttc"] == frame.alert.ttc


def test_paths_begin_at_the_body_and_bounds_grow_along_them(frames):
    frame = frames[-1]
    got, tracks = unpacked(message.pack(message.picture(frame))), frame.tracks
    np.testing.assert_allclose(got["arcs"][:, 0, :2], got["tracks"][:, :2], atol=1e-5)
    off = got["arcs"][..., 3]
    bounded = np.isfinite(tracks.bound).all(axis=1) & (tracks.state != TrackState.STATIC)
    assert bounded.any()
    assert np.isinf(off[~bounded]).all()
    np.testing.assert_allclose(off[bounded, 0], tracks.bound[bounded, 0], rtol=1e-6)
    step = np.diff(off[bounded], axis=1) / message.STEP_S
    assert (step >= tracks.bound[bounded, 1:] - 1e-3).all()


def test_what_is_not_finite_can_be_sent(frames):
    frame = frames[-1]
    lost = replace(frame.scan.ego, W_pose=np.array([np.nan, 0.0, 0.0]))
    tracks = replace(frame.tracks, W_p=np.full_like(frame.tracks.W_p, np.inf))
    shown = message.picture(replace(frame, scan=replace(frame.scan, ego=lost), tracks=tracks))
    got = unpacked(message.pack(shown))
    assert got["ego"][:2] == [0.0, 0.0]
    assert np.isnan(got["arcs"][..., :2]).all()


# ------------------------------------------------------------------ a run folder


def same_pictures(show, frames):
    for k, frame in enumerate(frames):
        live, kept = (unpacked(message.pack(p)) for p in (message.picture(frame), show.picture(k)))
        for name in ("points", "tracks", "arcs"):
            broken = message.COLUMNS.index("broken")  # a folder does not keep it
            one, other = (
                np.delete(a[name], broken, -1) if name == "tracks" else a[name] for a in (live, kept)
            )
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4, err_msg=f"{name} of {k}")
        for name in ("t", "id", "state", "level", "track", "degraded", "known"):
            assert live[name] == kept[name], (name, k)


def test_a_run_gives_the_pictures_that_were_live(folder, frames):
    show = RunShow(open_run(folder))
    assert len(show) == len(frames)
    same_pictures(show, frames)
    background = np.frombuffer(show.data("background", {}), "<f4").reshape(-1, 2)
    assert len(background) > 100
    track = frames[-1].alert.track
    series = json.loads(show.data("series", {"track": str(track)}))
    assert series["ttc"][-1] == frames[-1].alert.ttc
    assert series["speed"][0] is None
    assert show.data("series", {"track": "-1"}) is show.data("nothing", {}) is None


def test_a_killed_run_gives_what_was_finished(frames, settings, tmp_path):
    script = (
        "import os, pickle, sys\n"
        "from outrider.io.run import RunWriter\n"
        "frames, settings = pickle.load(open(sys.argv[1], 'rb'))\n"
        "writer = RunWriter(sys.argv[2], settings)\n"
        "for frame in frames: writer.write(frame)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    (tmp_path / "frames").write_bytes(pickle.dumps((frames, settings)))
    subprocess.run([sys.executable, "-c", script, "frames", "run"], check=False, cwd=tmp_path)
    show = RunShow(open_run(tmp_path / "run"))
    assert len(frames) - 16 <= len(show) < len(frames)
    kept = len(RunPoints(tmp_path / "run" / "run.mcap"))
    assert 0 < kept < len(frames)
    same_pictures(show, frames[: min(kept, len(show))])
    assert show.picture(len(show) - 1).points.shape[1] == 2


def test_scale_models_are_shown_full_size(frames, settings, tmp_path):
    with RunWriter(tmp_path / "run", settings, scale=10.0) as writer:
        for frame in frames[:20]:
            writer.write(frame)
    same_pictures(RunShow(open_run(tmp_path / "run")), frames[:20])


def test_a_run_without_points_is_shown_without(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "run")
    (copy / "run.mcap").write_bytes(b"not what it should be, at any length that would do for a head")
    shown = RunShow(open_run(copy)).picture(30)
    assert shown.points.shape == (0, 2)
    assert len(shown.tracks.id)


def test_a_run_without_scans_is_refused(settings, tmp_path):
    RunWriter(tmp_path / "run", settings).close()
    with pytest.raises(InputError, match="without a scan"):
        RunShow(open_run(tmp_path / "run"))


# ------------------------------------------------------------------ who may look


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("", ("127.0.0.1", 8642)),
        ("9000", ("127.0.0.1", 9000)),
        (":9000", ("127.0.0.1", 9000)),
        ("0.0.0.0", ("0.0.0.0", 8642)),
        ("bike.local:80", ("bike.local", 80)),
        ("[::1]:80", ("::1", 80)),
        ("[::1]", ("::1", 8642)),
    ],
)
def test_addresses(text, want):
    assert address(text) == want


@pytest.mark.parametrize("text", ["host:port", "host:99999", "http://host:80", "host:-1", "a@b:80", "1 2:80"])
def test_a_wrong_address_is_refused(text):
    with pytest.raises(InputError, match="want HOST:PORT"):
        address(text)


def test_an_address_that_cannot_be_had_is_one_line(silent):
    with pytest.raises(InputError, match="in use; name another") as told:
        PageSink(Settings(), port=port(silent))
    assert "\n" not in str(told.value)
    with pytest.raises(InputError, match="no such address"):
        PageSink(Settings(), host="no.such.host.invalid", port=0)
    with pytest.raises(InputError, match="12 or more"):
        PageSink(Settings(), port=0, token="short")


def port(page):
    return int(page.url.split("/")[2].rpartition(":")[2])


def ask(page, path="/", method="GET", body=None, **headers):
    """One request; headers by name with _ for -; the answer with its body."""
    connection = http.client.HTTPConnection("127.0.0.1", port(page), timeout=5.0)
    connection.request(method, path, body, {k.replace("_", "-"): v for k, v in headers.items()})
    answer = connection.getresponse()
    answer.body = answer.read()
    connection.close()
    return answer


def look(page, origin="", **more):
    where = f"127.0.0.1:{port(page)}"
    return connect(f"ws://{where}/pictures", origin=origin or f"http://{where}", compression=None, **more)


def refused(page, **more):
    with pytest.raises(InvalidStatus) as told, look(page, **more):
        pass
    return told.value.response.status_code


def test_every_answer_has_a_strict_policy(silent):
    for path in ("/", "/main.js", "/session", "/nothing", "/data/nothing"):
        answer = ask(silent, path)
        policy = dict(part.split(" ", 1) for part in answer.getheader("Content-Security-Policy").split("; "))
        assert policy["default-src"] == policy["base-uri"] == policy["frame-ancestors"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == "'self'"
        assert policy["connect-src"].split()[0] == "'self'"
        assert "unsafe" not in str(policy)
        assert answer.getheader("X-Content-Type-Options") == "nosniff"
        assert answer.getheader("Access-Control-Allow-Origin") is None


def test_nothing_is_written_inline_or_had_from_elsewhere():
    page = (STATIC / "index.html").read_text()
    assert not re.search(r"<style|\sstyle=|\son\w+=|javascript:|<script(?![^>]*\bsrc=)", page)
    ours = [p for p in STATIC.iterdir() if p.suffix in (".js", ".css", ".html")]
    assert len(ours) > 8
    for path in ours:
        assert not re.search(
            r"(https?:)?//[a-z]", re.sub(r"^\s*//.*|\s//\s.*", "", path.read_text(), flags=re.M)
        )
    assert "1.6.32" in (STATIC / "vendor" / "uPlot.esm.js").read_text()[:400]
    assert "MIT" in (STATIC / "vendor" / "uPlot.LICENSE.txt").read_text()


def test_files_outside_are_not_served(silent):
    for path in ("/../server.py", "/%2e%2e/server.py", "/vendor/..%2f..%2fserver.py", "//etc/passwd"):
        assert ask(silent, path).status == 404


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "10.0.0.9", "", "localhost;x", "[::1"]
)
def test_another_name_for_this_machine_is_refused(silent, host):
    assert ask(silent, Host=host).status == 421
    assert ask(silent, Host=f"localhost:{port(silent)}").status == 200


def test_a_site_that_takes_over_a_name_gets_no_pictures(silent):
    name = f"evil.example:{port(silent)}"  # now leads here, and its own page asks
    reached = socket.create_connection(("127.0.0.1", port(silent)), 5.0)
    with (
        pytest.raises(InvalidStatus) as told,
        connect(f"ws://{name}/pictures", sock=reached, origin=f"http://{name}"),
    ):
        pass
    assert told.value.response.status_code == 421


def test_names_of_this_machine():
    near, far = Guard("127.0.0.1", 80, ""), Guard("0.0.0.0", 80, "x" * 12)
    assert not near.knows_host({"host": "192.168.1.5:80"})
    assert far.knows_host({"host": "192.168.1.5:80"})
    assert far.knows_host({"host": "[fe80::1]:80"})
    assert not far.knows_host({"host": "evil.example:80"})
    assert not far.knows_host({})


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_pages_of_others_get_no_pictures(silent, origin):
    assert refused(silent, origin=origin) == 403
    with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{port(silent)}/pictures"):
        pass  # none at all


def test_without_the_token_nothing_is_shown(frames, settings):
    page = PageSink(settings, host="0.0.0.0", port=0, token=TOKEN)
    try:
        page.shot(shot(frames[0]))
        here = f"http://127.0.0.1:{port(page)}"
        assert page.url.endswith(f"#{TOKEN}")
        assert TOKEN not in str(page.report)
        assert refused(page) == 401
        assert ask(page, "/data/background").status == 401
        assert json.loads(ask(page, "/session").body) == {"admitted": False}
        begin = time.monotonic()
        assert ask(page, "/enter", "POST", "a wrong word", Origin=here).status == 403
        assert time.monotonic() - begin > 0.4
        assert ask(page, "/enter", "POST", TOKEN, Origin="http://evil.example").status == 403
        assert ask(page, "/enter", "POST", TOKEN).status == 403
        assert ask(page, "/enter", "POST", "x" * 1000, Origin=here).status == 413
        assert refused(page, additional_headers={"Cookie": f"outrider-{port(page)}=guess"}) == 401
        cookie = ask(page, "/enter", "POST", TOKEN, Origin=here).getheader("Set-Cookie")
        assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
        with look(page, additional_headers={"Cookie": cookie.split(";")[0]}) as seen:
            assert json.loads(seen.recv(5.0))["mode"] == "live"
    finally:
        page.close()


def test_an_open_address_makes_a_token_up(settings):
    pages = [PageSink(settings, host="0.0.0.0", port=0) for _ in range(2)]
    tokens = {page.url.partition("#")[2] for page in pages}
    for page in pages:
        page.close()
    assert len(tokens) == 2
    assert min(map(len, tokens)) >= 16


def test_only_so_many_pages(sink):
    with ExitStack() as opened:
        for _ in range(PAGES):
            opened.enter_context(look(sink)).recv(5.0)
        with look(sink) as one_more, pytest.raises(ConnectionClosed) as told:
            one_more.recv(5.0)
        assert (told.value.rcvd.code, sink.report["pages"]) == (1013, PAGES)


def test_a_message_that_is_too_large_ends_the_page(silent):
    with look(silent) as page:
        page.send("x" * 10_000)
        with pytest.raises(ConnectionClosed) as told:
            list(received(page))
    assert told.value.rcvd.code == 1009


# ------------------------------------------------------------------ newest wins


def pictures(page, until):
    """Numbers of the pictures that come until one is at least `until`, each told to be taken."""
    found = []
    while not found or found[-1] < until:
        data = page.recv(5.0)
        if isinstance(data, bytes):
            found.append(unpacked(data)["number"])
            page.send("taken")
    return found


def test_a_slow_page_holds_up_nobody(sink, frames):
    with look(sink) as slow, look(sink) as quick:
        assert json.loads(slow.recv(5.0))["mode"] == json.loads(quick.recv(5.0))["mode"] == "live"
        costs, got = [], []
        for number, frame in enumerate(frames, 1):
            begin = time.perf_counter()
            sink.shot(shot(frame))
            costs.append(time.perf_counter() - begin)
            got += pictures(quick, number)
        late = [unpacked(d)["number"] for d in drained(slow) if isinstance(d, bytes)]
        assert len(late) == 2  # takes none: no more are on their way
        slow.send("taken")
        assert pictures(slow, len(frames)) == [len(frames)]  # the newest, at once
    assert got == list(range(1, len(frames) + 1))
    assert np.median(costs) < 0.002
    assert sink.report["dropped"] > len(frames) // 2


def drained(page):
    """What has come and comes within a moment."""
    while True:
        try:
            yield page.recv(0.2)
        except TimeoutError:
            return
        except ConnectionClosed:
            return


def test_a_word_comes_while_no_picture_does(sink, frames):
    sink.shot(shot(frames[0]))
    with look(sink) as page:
        page.recv(5.0)
        sink.health(Health(("sensor unplugged",), {"turns": 9}))
        words = [json.loads(m) for m in itertools.islice(filter(is_text, received(page)), 3)]
    assert words[-1]["degraded"] == ["sensor unplugged"]
    assert words[-1]["counts"] == {"turns": 9}
    assert words[-1]["age"] > 0.4


def is_text(data):
    return isinstance(data, str)


def received(page):
    while True:
        yield page.recv(5.0)


# ------------------------------------------------------------------ in a browser


@pytest.fixture(scope="module")
def browser():
    """One Chromium for all; OUTRIDER_CHROMIUM or the one on the path."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="the page in a browser: needs playwright")
    program = os.environ.get("OUTRIDER_CHROMIUM") or shutil.which("chromium")
    if not program:
        pytest.skip("the page in a browser: install Debian's chromium, or name one in OUTRIDER_CHROMIUM")
    with sync_api.sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield made
        made.close()


@pytest.fixture
def tab(browser):
    """Opens pages; in the end none has complained, and none has asked another host for anything."""
    opened, wrong, asked = [], [], set()

    def open_(url, width=1280, height=800, scheme="light"):
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
        page = context.new_page()
        page.on("console", lambda said: said.type == "error" and wrong.append(said.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: asked.add(request.url.split("/")[2]))
        page.set_default_timeout(5000)
        page.goto(url)
        opened.append((context, url.split("/")[2]))
        return page

    open_.wrong = wrong
    yield open_
    for context, _ in opened:
        context.close()
    assert wrong == []
    assert asked <= {host for _, host in opened}


def until(page, expression):
    """Wait for something to become true; the page's policy lets nobody compile it there."""
    end = time.monotonic() + 5.0
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"still not so: {expression}"
        page.wait_for_timeout(5)


def feed(sink, page, frames, health=FINE):
    """Show frames one by one, each once the one before has been drawn."""
    until(page, "page.link.state === 'open'")
    for frame in frames:
        before = page.evaluate("page.newest?.number ?? 0")
        sink.shot(shot(frame, health))
        until(page, f"document.getElementById('scene').dataset.number > {before}")


def banner(page):
    return page.locator("#banner").get_attribute("data-level")


def test_the_alert_appears_with_its_frame(sink, frames, tab):
    page = tab(sink.url)
    until(page, "document.getElementById('level').textContent === 'waiting'")
    told = []
    for frame in frames[28:]:
        feed(sink, page, [frame])
        seconds = page.locator("#seconds").inner_text() if frame.alert.level else ""
        told.append((banner(page), seconds))
    want = [(f.alert.level.name.lower(), f"{f.alert.ttc:.1f}" if f.alert.level else "") for f in frames[28:]]
    assert told == want
    assert page.locator("#where").inner_text() == "ahead right"
    assert re.fullmatch(
        rf"danger: ahead right, track {frames[-1].alert.track}, contact in \d\.\d seconds",
        page.locator("#spoken").text_content(),
    )
    assert page.locator("#spoken").get_attribute("aria-live") == "assertive"
    assert page.locator("#status").inner_text().endswith("0 dropped")
    until(page, "document.getElementById('subject').textContent.endsWith('warned of')")
    assert page.locator("#speeds canvas").count() == page.locator("#times canvas").count() == 1


def test_points_boxes_and_bounds_are_drawn(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[-2:])
    white = page.evaluate(COUNT, [255, 255, 255])
    assert page.evaluate(COUNT, [38, 41, 46]) > 500  # returns
    assert page.evaluate(COUNT, [0, 114, 178]) > 200  # moving road users
    assert page.evaluate(COUNT, [213, 94, 0]) > 200  # the one that is warned of
    assert white > 100_000
    page.keyboard.press("t")  # auto, light
    page.keyboard.press("t")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    assert page.evaluate(COUNT, [255, 255, 255]) < 0.05 * white


def test_pause_step_and_back_while_the_frame_stays_now(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[30:50])
    page.get_by_role("button", name="Pause").click()
    for _ in range(3):
        page.keyboard.press("ArrowLeft")
    until(page, "document.getElementById('scene').dataset.number === '17'")
    assert page.locator("#past").inner_text().startswith("PAST")
    assert page.locator("#clock").inner_text().startswith("-")
    page.get_by_role("button", name="One picture on").click()
    until(page, "document.getElementById('scene').dataset.number === '18'")
    for frame in frames[50:]:
        sink.shot(shot(frame))
        time.sleep(0.01)
    until(page, "document.getElementById('banner').dataset.level === 'danger'")
    assert page.locator("#scene").get_attribute("data-number") == "18"
    page.locator("#slider").fill("0")
    until(page, "document.getElementById('scene').dataset.number === '1'")
    page.keyboard.press("End")
    until(page, f"document.getElementById('scene').dataset.number === '{len(frames) - 30}'")
    assert page.locator("#past").is_hidden()


def test_the_last_minute_is_kept_and_no_more(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[:1])
    lengths = page.evaluate(RING)
    assert lengths[1000] == 1001
    assert lengths[2000] == 1201
    assert max(lengths) == 3601


def test_follow_a_track_by_tap_list_and_key(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[-3:])
    track = frames[-1].alert.track
    x, y = page.evaluate(WARNED)
    page.locator("#scene").click(position={"x": x, "y": y})
    assert page.locator("#follow").input_value() == str(track)
    until(page, "document.getElementById('subject').textContent.endsWith('followed')")
    page.keyboard.press("Escape")
    assert page.locator("#follow").input_value() == ""
    page.keyboard.press("f")
    first = page.locator("#follow").input_value()
    assert first
    page.locator("#follow").select_option(str(track))
    assert page.evaluate("page.followed") == track


def test_a_picture_that_is_old_never_looks_live(settings, frames, tab):
    sink = PageSink(settings, port=0)
    page = tab(sink.url)
    feed(sink, page, frames[40:44])
    assert page.locator("#deadman").evaluate("e => getComputedStyle(e).opacity") == "0"
    sink.health(Health(("sensor unplugged: plug it in again",), {}))
    until(page, "document.getElementById('trust').textContent.includes('unplugged')")
    until(page, "document.getElementById('banner').dataset.level === 'dead'")
    assert page.locator("#level").inner_text().lower() == "no scans"
    assert page.locator("#deadman").evaluate("e => getComputedStyle(e).opacity") == "1"
    assert page.locator("#clock").inner_text() == "old"
    feed(sink, page, frames[44:46])
    until(page, "document.getElementById('banner').dataset.level !== 'dead'")
    assert page.locator("#trust").is_hidden()
    assert page.locator("#deadman").evaluate("e => getComputedStyle(e).opacity") == "0"
    sink.close()
    tab.wrong.clear()  # it tries to come back, in vain


def test_a_page_whose_script_stops_covers_its_banner(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[-1:])
    cover = "getComputedStyle(document.getElementById('hung')).opacity"
    assert page.evaluate(cover) == "0"
    page.evaluate("page.watch = () => {}")  # as if it did not run any more
    until(page, f"{cover} === '1'")
    assert page.locator("#hung").inner_text() == "PAGE HAS STOPPED"


def test_the_end_of_the_run_and_a_lost_connection_are_told(settings, frames, tab):
    sink = PageSink(settings, port=0)
    page = tab(sink.url, 360, 740)
    feed(sink, page, frames[-2:])
    sink.close()
    until(page, "document.getElementById('level').textContent === 'ended'")
    assert page.locator("#deadman").evaluate("e => getComputedStyle(e).opacity") == "1"
    page.evaluate("page.link.state = 'lost'; page.watch()")
    assert page.locator("#level").inner_text().lower() == "no connection"
    level, frame_ = page.locator("#level"), page.locator("#banner").bounding_box()
    assert level.evaluate("e => e.scrollWidth <= e.clientWidth")
    assert page.locator("#about").bounding_box()["y"] < frame_["y"] + frame_["height"] - 20
    assert "There are no warnings" in page.locator("#spoken").text_content()
    page.close()
    tab.wrong[:] = [text for text in tab.wrong if "ERR_CONNECTION_REFUSED" not in text]


def test_dropped_pictures_are_counted_on_the_page(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[:1])
    for frame in frames[1:41]:
        sink.shot(shot(frame))  # faster than any page
    until(page, "page.newest.number === 41")
    dropped = page.evaluate("page.dropped")
    assert 20 < dropped < 40
    until(page, f"document.getElementById('status').textContent.endsWith('{dropped} dropped')")


def test_the_horn_waits_for_a_tap(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[-4:-2])
    assert page.evaluate("page.horn.played") == 0
    page.get_by_role("button", name="Horn: tap to start").click()
    feed(sink, page, frames[-2:])
    until(page, "page.horn.played > 1")
    assert page.locator("#horn").get_attribute("aria-pressed") == "true"


@pytest.mark.parametrize(
    ("width", "height", "scheme"), [(360, 740, "light"), (360, 640, "dark"), (740, 360, "light")]
)
def test_a_phone_has_room_for_all(sink, frames, tab, width, height, scheme):
    page = tab(sink.url, width, height, scheme)
    feed(sink, page, frames[-2:], Health(("scans late: 0.62 s since the last one, limit 0.50 s",), {}))
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    boxes, size = page.evaluate(BOXES)
    for name in ("banner", "level", "ttc", "scene", "pause"):
        left, top, right, bottom = boxes[name]
        assert (left >= 0, right <= width) == (True, True), name
        assert top < bottom <= height or name == "scene", name
    for name in ("level", "ttc", "about"):
        assert boxes["banner"][1] <= boxes[name][1] < boxes[name][3] <= boxes["banner"][3], name
    assert boxes["level"][3] <= boxes["ttc"][1] + 2
    assert size > 48
    assert min(page.evaluate(HEIGHTS)) >= 44


def test_everything_has_a_name_and_enough_contrast(sink, frames, tab):
    page = tab(sink.url)
    feed(sink, page, frames[-2:])
    nameless = page.evaluate(NAMELESS)
    assert nameless == []
    ids = page.evaluate("[...document.querySelectorAll('[id]')].map((e) => e.id)")
    assert len(ids) == len(set(ids))
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.locator("h1").count() == 1
    for name in ("notice", "caution", "danger"):
        assert contrast("#000000", page.evaluate(COLOUR, name)) > 4.5
    assert contrast(page.evaluate(COLOUR, "page"), page.evaluate(COLOUR, "soft")) > 4.5
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") == "BUTTON"


def contrast(one, other):
    """Ratio of relative luminances, as the Web Content Accessibility Guidelines define it."""

    def luminance(text):
        c = np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_a_token_comes_with_the_address_or_by_hand(settings, frames, tab):
    sink = PageSink(settings, host="0.0.0.0", port=0, token=TOKEN)
    here = f"http://127.0.0.1:{port(sink)}/"
    try:
        page = tab(f"{here}#{TOKEN}")
        feed(sink, page, frames[-1:])
        assert banner(page) == "danger"
        assert TOKEN not in page.url
        page = tab(here)
        page.locator("#token").fill("something else")
        page.get_by_role("button", name="Show me").click()
        until(page, "document.getElementById('refusal').textContent !== ''")
        page.locator("#token").fill(TOKEN)
        page.get_by_role("button", name="Show me").click()
        until(page, "page.link.state === 'open'")
        feed(sink, page, frames[-1:])
        assert banner(page) == "danger"
        tab.wrong[:] = [text for text in tab.wrong if "403" not in text]
    finally:
        sink.close()


def test_as_much_as_a_fast_sensor_gives(sink, tab):
    cars = make_crowd(20)
    crowd = list(make_frames(12, cars, beams=1440))
    assert len(crowd[0].tracks.id) == 20
    page = tab(sink.url)
    feed(sink, page, crowd)
    assert page.evaluate("page.shown.points.length") > 1500
    costs = page.evaluate("page.scene.costs")
    assert np.median(costs) < 25.0  # of 50 ms between two pictures at 20 Hz


def make_crowd(n):
    from made_frames import Car

    return tuple(
        Car(i + 1, (4.0 * (i % 10) - 18.0, 4.0 + 3.0 * (i // 10), 0.0), 5.0 + 0.1 * i) for i in range(n)
    )


def test_a_run_is_shown_with_a_slider(folder, frames, tab):
    server = Server(RunShow(open_run(folder)), port=0)
    try:
        page = tab(server.url)
        until(page, "document.getElementById('scene').dataset.number === '0'")
        assert page.locator("#slider").get_attribute("max") == str(len(frames) - 1)
        assert page.evaluate("page.scene.background.points.length") > 200
        assert page.locator("#status").inner_text() == "street.mcap"
        first = next(k for k, f in enumerate(frames) if f.alert.level is Level.DANGER)
        for k, want in [(first - 1, "caution"), (first, "danger")]:
            page.locator("#slider").fill(str(k))
            until(page, f"document.getElementById('scene').dataset.number === '{k}'")
            assert banner(page) == want
        page.keyboard.press("Home")
        until(page, "document.getElementById('scene').dataset.number === '0'")
        page.locator("#speed").select_option("10")
        page.get_by_role("button", name="Play").click()
        until(page, f"document.getElementById('scene').dataset.number === '{len(frames) - 1}'")
        page.get_by_role("button", name="Play").wait_for()
        assert page.evaluate(PAINTED)
        assert page.evaluate("page.charts.data.ttc.filter(Number.isFinite).length") > 10
    finally:
        server.close()


def test_view_refuses_what_is_no_run(outrider, tmp_path):
    code, _, err = outrider("view", tmp_path, "--no-open")
    assert code == 2
    assert "not a run folder" in err


def test_view_serves_until_it_is_stopped(folder):
    command = [sys.executable, "-m", "outrider", "view", str(folder), "--page", ":0", "--no-open"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        where = running.stderr.readline().split()[-1]
        connection = http.client.HTTPConnection(where.split("/")[2], timeout=5.0)
        connection.request("GET", "/data/background")
        assert connection.getresponse().status == 200
        connection.close()
        running.send_signal(signal.SIGINT)
        assert running.wait(10.0) == 0
        assert running.stderr.read() == "Ctrl-C ends it\n"
