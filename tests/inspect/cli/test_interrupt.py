"""Ctrl-C and SIGTERM to the real process, with the stage in a process of its own."""

import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest


@pytest.fixture
def slow_stage():
    """A simulated stage that needs a hundred times as long as a real one; yields its TCP port."""
    command = [
        sys.executable,
        "-Im",
        "anisoscope",
        "rig",
        "sim",
        "elliptec",
        "--tcp",
        "0",
        "--time-scale",
        "100",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        assert line.startswith("serving elliptec on 127.0.0.1:"), line
        yield int(line.rsplit(":", 1)[1])
        process.send_signal(signal.SIGINT)
        process.wait(10)


def ask(port, command):
    with socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        line.sendall(command)
        answer = b""
        while not answer.endswith(b"\r\n"):
            answer += line.recv(64)
    return answer


@pytest.mark.parametrize("interruption", [signal.SIGINT, signal.SIGTERM])
def test_stage_stands_still_and_no_record_is_written(demo_folder, tmp_path, slow_stage, interruption):
    shutil.copytree(demo_folder / "bench", tmp_path / "bench")
    shutil.copy(demo_folder / "flat.tif", tmp_path)
    rig = tmp_path / "bench" / "good" / "rig.toml"
    text = rig.read_text().replace(
        "sim://elliptec?bench=${here}/bench.toml", f"socket://127.0.0.1:{slow_stage}"
    )
    rig.write_text(text)
    out = tmp_path / "out"
    command = [sys.executable, "-Im", "anisoscope", "inspect", "--recipe", demo_folder / "recipe.toml"]
    command += ["--rig", rig, "--serial", "A1", "--out", out]
    with subprocess.Popen([str(part) for part in command], stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 30
        while not out.exists():  # made when the rig is about to be opened
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(1.0)
        process.send_signal(interruption)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "interrupted" in err.splitlines()[-1]
    assert list(out.rglob("record.json")) == []
    first, second = ask(slow_stage, b"0gp"), ask(slow_stage, b"0gp")
    assert first.startswith(b"0PO"), "the stage still moves, or stands in an error"
    assert first == second
