"""Lines of JSON for other programs: who reads gets them, who does not is not waited for."""

import json
import socket
import time

import pytest

from made_live import head_on, turn_of
from outrider import pipeline
from outrider.errors import InputError
from outrider.live import Health, Shot
from outrider.live.lines import MOST_CLIENTS, MOST_LINES, Lines
from outrider.live.scans import TurnsToScans
from outrider.settings import Settings


@pytest.fixture(scope="module")
def shots():
    """A car that comes nearer, frame by frame."""
    settings, made = Settings(), []
    engine, memory, ready = pipeline.engine(settings), pipeline.start(settings), TurnsToScans(settings)
    for scan in head_on():
        memory, frame = pipeline.step(memory, ready.scan(turn_of(scan)), settings, engine)
        made.append(Shot(frame, None, Health(frame.alert.degraded, {}), frame.t, frame.t + 0.005))
    return made


@pytest.fixture
def lines():
    made = Lines("tcp://127.0.0.1:0")
    yield made
    made.close()


def connect(lines, buffer=None):
    host, port = lines.address.removeprefix("tcp://").split(":")
    before = lines.report["clients"] + lines.report["refused"]
    made = socket.socket()
    made.settimeout(10.0)
    if buffer:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
    made.connect((host, int(port)))
    while lines.report["clients"] + lines.report["refused"] == before:
        time.sleep(0.002)
    return made


def read(connection, n):
    with connection.makefile("rb") as file:
        return [json.loads(file.readline()) for _ in range(n)]


def test_each_frame_is_a_line(lines, shots):
    with connect(lines) as one, connect(lines) as other:
        for shot in shots[-3:]:
            lines.shot(shot)
        for got in (read(one, 3), read(other, 3)):
            for line, shot in zip(got, shots[-3:], strict=True):
                frame = shot.frame
                assert (line["schema"], line["kind"], line["t"]) == (1, "frame", frame.t)
                assert line["level"] == frame.alert.level.name.lower()
                assert line["track"] == frame.alert.track
                assert [t["id"] for t in line["tracks"]] == frame.tracks.id.tolist()
                assert line["tracks"][0]["x_m"] == pytest.approx(frame.tracks.W_p[0, 0], abs=1e-3)
                assert line["tracks"][0]["position_bound_m"] is None
            assert got[-1]["level"] == "danger"


def test_what_is_wrong_is_a_line(lines):
    with connect(lines) as one:
        lines.health(Health(("no scan yet",), {}))
        assert read(one, 1) == [{"schema": 1, "kind": "health", "degraded": ["no scan yet"]}]


def test_who_does_not_read_misses_lines_and_holds_up_nobody(lines, shots):
    with connect(lines, buffer=4096) as deaf, connect(lines) as quick, quick.makefile("rb") as heard:
        told = 0
        while lines.report["dropped"] < 10 * MOST_LINES:
            lines.shot(shots[-1])
            assert json.loads(heard.readline())["kind"] == "frame"
            told += 1
            assert told < 3000, "all were kept for one who does not read"
        lines.health(Health(("this is the newest",), {}))
        with deaf.makefile("rb") as late:
            kinds = [json.loads(late.readline())["kind"]]
            while kinds[-1] == "frame":
                kinds.append(json.loads(late.readline())["kind"])
        assert len(kinds) == told - lines.report["dropped"] + 1


def test_a_client_that_hangs_up_is_forgotten(lines, shots):
    connect(lines).close()
    with connect(lines) as other:
        for _ in range(5):
            lines.shot(shots[0])
            time.sleep(0.01)
        assert len(read(other, 5)) == 5
    assert len(lines._clients) <= 1


def test_one_client_too_many_is_hung_up_on(lines):
    held = [connect(lines) for _ in range(MOST_CLIENTS)]
    with connect(lines) as late:
        assert late.recv(1) == b""
    assert lines.report["refused"] == 1
    for one in held:
        one.close()


def test_while_nobody_listens_nothing_is_made(lines, shots):
    lines.shot(shots[0])
    assert lines.report["lines"] == 0


def test_a_unix_socket_is_made_and_taken_away(tmp_path, shots):
    path = tmp_path / "outrider.sock"
    lines = Lines(f"unix://{path}")
    with socket.socket(socket.AF_UNIX) as one:
        one.settimeout(10.0)
        one.connect(str(path))
        while not lines.report["clients"]:
            time.sleep(0.002)
        lines.shot(shots[0])
        assert read(one, 1)[0]["t"] == shots[0].frame.t
        with pytest.raises(InputError, match="another program listens"):
            Lines(f"unix://{path}")
        lines.close()
        assert one.recv(1) == b""
    assert not path.exists()
    lines.close()


def test_a_socket_left_by_a_killed_program_is_replaced(tmp_path):
    path = tmp_path / "left.sock"
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(path))
    left.close()
    Lines(f"unix://{path}").close()


def test_a_file_in_the_way_stays(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(InputError, match="cannot listen"):
        Lines(f"unix://{path}")
    assert path.read_text() == "mine"


@pytest.mark.parametrize("address", ["udp://x:1", "tcp://127.0.0.1", "tcp://:5", "tcp://h:99999", "5000"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(InputError, match="want tcp://HOST:PORT"):
        Lines(address)


def test_an_address_in_use_is_refused(lines):
    with pytest.raises(InputError, match="cannot listen"):
        Lines(lines.address)
