"""`anisoscope serve` in a process of its own, with TLS and accounts: killed in an inspection, and resumed."""

import json
import os
import re
import shutil
import signal
import ssl
import subprocess
import sys
import tomllib
from contextlib import contextmanager

import httpx
import pytest
import tomli_w

from anisoscope.console.accounts import Accounts
from anisoscope.history.signs import read_signs
from anisoscope.history.store import open_history
from anisoscope.record.schema import read_record
from anisoscope.rig.acquisition.journal import read_journal

PASSWORD = "correct horse battery"
PLUGIN = '''
"""A simulated camera that waits at its fifth frame until somebody writes into a pipe, if the pipe is there."""

from pathlib import Path

from anisoscope.sim.bench.camera import open_camera


def open_waiting(pipe, **options):
    camera, count = open_camera(**options), iter(range(1, 1000))
    grab = camera.grab

    def wait_and_grab():
        if next(count) == 5 and Path(pipe).exists():
            Path(pipe).read_text()
        return grab()

    camera.grab = wait_and_grab
    return camera
'''


@pytest.fixture
def rig(virtual_rig, tmp_path):
    """A rig whose camera waits, its folder of recipes, and accounts."""
    found = virtual_rig()
    info = tmp_path / "waiting-1.0.dist-info"
    info.mkdir()
    (tmp_path / "waiting.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: waiting\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[anisoscope.cameras]\nwaiting = waiting:open_waiting\n")
    file = tomllib.loads(found.rig.read_text())
    file["camera"]["driver"] = "waiting"
    file["camera"]["options"]["pipe"] = str(tmp_path / "pipe")
    found.rig.write_text(tomli_w.dumps(file))
    (tmp_path / "recipes").mkdir()
    shutil.copy(found.recipe, tmp_path / "recipes" / "plate.toml")
    Accounts(tmp_path / "users.json").put("anna", "operator", PASSWORD)
    return found.rig


@contextmanager
def serving(folder, rig, tls, *, killed=False):
    """The command, and a client that has logged in."""
    command = [sys.executable, "-m", "anisoscope", "serve", "--port", "0", "--rig", str(rig)]
    for name, path in (("recipes", "recipes"), ("out", "out"), ("users", "users.json")):
        command += [f"--{name}", str(folder / path)]
    command += ["--station", "S1", "--certificate", str(tls[0]), "--key", str(tls[1])]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=folder) as process:
        try:
            address = process.stdout.readline().split()[-1].rstrip("/")
            with httpx.Client(
                base_url=address, verify=ssl.create_default_context(cafile=tls[0]), timeout=120
            ) as client:
                yield client
        finally:
            process.send_signal(signal.SIGKILL if killed else signal.SIGTERM)
    assert process.returncode == (-signal.SIGKILL if killed else 0)


def log_in(client):
    token = re.search('name="token" content="([^"]+)', client.get("/login").text)[1]
    answer = client.post(
        "/login", json={"name": "anna", "password": PASSWORD}, headers={"X-CSRF-Token": token}
    )
    client.headers["X-CSRF-Token"] = answer.json()["token"]
    return answer


def state_with(client, wanted):
    """The first state or progress that is wanted, from the events."""
    with client.stream("GET", "/api/v1/events") as answer:
        for line in answer.iter_lines():
            if line.startswith("data: ") and wanted(content := json.loads(line.removeprefix("data: "))):
                return content
    raise AssertionError("the events ended")


def station_in(client, state):
    """The station, once the history knows that it is in a state."""
    while True:
        for one in client.get("/api/v1/stations").json():
            if one["state"] == state:
                return one


def test_with_tls_it_is_killed_in_an_inspection_and_offers_to_resume(rig, tls, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with serving(tmp_path, rig, tls, killed=True) as client:
        assert client.base_url.scheme == "https"
        with pytest.raises(httpx.ConnectError, match="certificate"):
            httpx.get(client.base_url, verify=True)
        with pytest.raises(httpx.RemoteProtocolError):
            httpx.get(f"http://{client.base_url.host}:{client.base_url.port}/login")
        answer = log_in(client)
        assert "; Secure" in answer.headers["set-cookie"]
        assert answer.headers["strict-transport-security"] == "max-age=31536000"
        assert client.post("/api/v1/start", json={"recipe": "plate", "serial": "K-1"}).status_code == 200
        state_with(
            client, lambda content: content.get("frames") == 1
        )  # and two dark ones; another is being taken
        folder = client.get("/api/v1/status").json()["folder"]
        assert station_in(client, "running")["words"] == "K-1"
    (tmp_path / "pipe").unlink()
    taken = read_journal(tmp_path / "out" / folder).frames
    assert len(taken) >= 3
    assert not (tmp_path / "out" / folder / "record.json").exists()
    with serving(tmp_path, rig, tls) as client:
        log_in(client)
        assert station_in(client, "idle")["station"] == "S1"
        assert client.get("/api/v1/resumable").json() == [folder]
        assert f'data-resume="{folder}"' in client.get("/station").text
        assert client.post("/api/v1/resume", json={"name": folder}).status_code == 200
        state = state_with(client, lambda content: content.get("state") in {"done", "failed"})
        assert (state["verdict"] or state["failure"])["verdict"] == "PASS"
    with open_history(tmp_path / "out" / "history.sqlite") as history:
        assert [(one.station, one.doing) for one in read_signs(history)] == [("S1", "off")]
    record = read_record(tmp_path / "out" / folder)
    assert record.serial == "K-1"
    assert [frame.name for frame in read_journal(tmp_path / "out" / folder).frames][: len(taken)] == [
        one.name for one in taken
    ]
