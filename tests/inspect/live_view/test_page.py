"""The live page as an HTTP client meets it."""

import http.client
import json
import math
import re
import socket
import threading
import time

import pytest

from anisoscope.base.errors import RigError
from anisoscope.live_view.page import LivePage
from anisoscope.rig.jogging import Step

JPEG = b"\xff\xd8" + b"x" * 500 + b"\xff\xd9"


@pytest.fixture
def page():
    with LivePage(title="rig <2>") as found:
        yield found


def get(page, path, method="GET", **headers):
    line = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60)
    try:
        line.request(method, path, headers=headers)
        answer = line.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        line.close()


def connect(page, name="stream.mjpg", receive_bytes=None):
    """A client that has asked for a stream and reads nothing yet."""
    client = socket.socket()
    if receive_bytes is not None:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    client.settimeout(60)
    client.connect(("127.0.0.1", page.port))
    client.sendall(f"GET /{page.token}/{name} HTTP/1.0\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
    return client


def receive_until(client, wanted):
    found = b""
    while wanted not in found:
        chunk = client.recv(65536)
        assert chunk, found
        found += chunk
    return found


def test_address_is_of_this_machine_and_cannot_be_guessed(page):
    assert re.fullmatch(rf"http://127\.0\.0\.1:{page.port}/[\w-]{{32}}/", page.address)
    with LivePage() as other:
        assert other.token != page.token
    listening = page._server.socket.getsockname()[0]
    assert listening == "127.0.0.1"


def test_page_asks_for_nothing_from_elsewhere(page):
    status, headers, body = get(page, f"/{page.token}/")
    text = body.decode()
    assert status == 200
    assert "rig &lt;2&gt;" in text
    assert "http" not in text.replace("http-equiv", "")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")
    nonce = re.search(r"script-src 'nonce-([^']+)'", headers["Content-Security-Policy"])[1]
    assert re.findall(r"<(?:script|style) nonce=\"([^\"]+)\"", text) == [nonce, nonce]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/{token}",
        "/{token}x/",
        "/{short}/",
        "/{token}/../",
        "/{token}/other",
        "/numbers.json",
        "/%C3%A9/",
    ],
)
def test_everything_else_is_not_found(page, path):
    path = path.format(token=page.token, short=page.token[:-1])
    assert get(page, path)[0] == 404


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "[::1]:{port}"]
)
def test_other_host_names_are_refused(page, host):
    status, _, body = get(page, f"/{page.token}/", Host=host.format(port=page.port))
    assert (status, body) == (421, b"")
    assert get(page, f"/{page.token}/", Host=f"localhost:{page.port}")[0] == 200


def test_nothing_can_be_sent_to_the_page(page):
    assert get(page, f"/{page.token}/", "POST")[0] == 404


def test_numbers_are_those_that_were_published(page):
    assert json.loads(get(page, f"/{page.token}/numbers.json")[2]) == {}
    page.publish(JPEG, {"focus": math.nan, "mean": 0.25, "histogram": [0.5, 0.5]})
    status, headers, body = get(page, f"/{page.token}/numbers.json")
    assert (status, headers["Content-Type"]) == (200, "application/json")
    assert json.loads(body) == {"focus": None, "mean": 0.25, "histogram": [0.5, 0.5]}


def test_every_picture_is_followed_by_its_end(page):
    """Browsers show a part when they see the boundary after it."""
    page.publish(JPEG, {})
    with connect(page) as client:
        first = receive_until(client, b"\xff\xd9\r\n--frame\r\n")
        assert b"Content-Type: multipart/x-mixed-replace; boundary=frame\r\n" in first
        assert b"\r\n\r\n--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 504\r\n\r\n\xff\xd8" in first
        page.publish(b"next", {})
        second = receive_until(client, b"next\r\n--frame\r\n")
        assert second == b"Content-Type: image/jpeg\r\nContent-Length: 4\r\n\r\nnext\r\n--frame\r\n"


@pytest.fixture
def patient(monkeypatch):
    """A page that waits ten minutes for slow clients: whoever waits for them hangs, and the test sees it."""
    monkeypatch.setattr("anisoscope.live_view.page._Handler.timeout", 600.0)


def ends(work):
    """Whether some work comes to its end."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(60)
    return not thread.is_alive()


def test_a_slow_client_blocks_neither_the_camera_nor_the_others(patient, page):
    big = JPEG * 4000  # 2 MB: no buffer of the line takes many of them
    with connect(page, receive_bytes=4096) as slow, connect(page) as quick:
        seen = threading.Event()

        def read():
            while b"last" not in quick.recv(1 << 20):
                pass
            seen.set()

        def publish():
            for _ in range(50):
                page.publish(big, {})
            page.publish(b"last" * 10, {})

        reader = threading.Thread(target=read)
        reader.start()
        assert ends(publish)
        reader.join(60)
        assert seen.is_set()
        assert slow.recv(12) == b"HTTP/1.0 200"


def test_too_many_viewers_are_turned_away(page, monkeypatch):
    monkeypatch.setattr("anisoscope.live_view.page.MAX_VIEWERS", 2)
    page.publish(JPEG, {})
    with connect(page) as one, connect(page) as two:
        receive_until(one, b"\xff\xd9")
        receive_until(two, b"\xff\xd9")
        assert get(page, f"/{page.token}/")[0] == 503
    deadline = time.monotonic() + 60
    while get(page, f"/{page.token}/")[0] != 200:  # noticed when the next picture is sent
        page.publish(JPEG, {})
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_closing_ends_streams_idle_lines_and_threads_and_frees_the_port(patient):
    before = set(threading.enumerate())
    with LivePage() as page, socket.create_connection(("127.0.0.1", page.port)) as idle:
        page.publish(JPEG * 4000, {})
        with connect(page) as reading, connect(page, receive_bytes=4096) as stuck:
            receive_until(reading, b"\xff\xd9")
            receive_until(stuck, b"200")
            assert ends(page.close)
            assert set(threading.enumerate()) <= before
            while reading.recv(1 << 20):
                pass
        assert idle.recv(10) == b""
        again = LivePage(page.port)
        again.close()


def test_a_port_that_is_taken_or_none(page):
    with pytest.raises(RigError, match=f"cannot serve on TCP port {page.port}: .*choose another"):
        LivePage(page.port)
    with pytest.raises(RigError, match="choose 1…65535"):
        LivePage(70000)


class Keys:
    """What takes the commands of a page."""

    def __init__(self):
        self.taken = []

    def do(self, command):
        self.taken.append(command)

    def state(self):
        return "stage 12°; ± 1°"


def post(page, path, body, **headers):
    line = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60)
    try:
        line.request("POST", path, body=body, headers=headers)
        return line.getresponse().status
    finally:
        line.close()


def test_keys_of_the_page_move_axes_and_their_place_is_shown():
    keys = Keys()
    with LivePage(jogger=keys) as page:
        assert post(page, f"/{page.token}/key", b"\x1b[C") == 204
        assert post(page, f"/{page.token}/key", b" ") == 204
        assert post(page, f"/{page.token}/key", b"?") == 204  # means nothing
        assert keys.taken == [Step("stage", 1), "stop"]
        assert post(page, "/wrong/key", b"\x1b[C") == 404
        assert post(page, f"/{page.token}/numbers.json", b"\x1b[C") == 404
        assert post(page, f"/{page.token}/key", b" " * 17) == 413
        assert post(page, f"/{page.token}/key", b" ", Host="evil.example") == 421
        assert len(keys.taken) == 2
        page.publish(JPEG, {"frame": 1})
        assert json.loads(get(page, f"/{page.token}/numbers.json")[2])["axes"] == "stage 12°; ± 1°"
        assert b"ArrowRight" in get(page, f"/{page.token}/")[2]


def test_a_page_without_axes_takes_no_keys(page):
    assert post(page, f"/{page.token}/key", b"\x1b[C") == 404
    assert b"ArrowRight" not in get(page, f"/{page.token}/")[2]
