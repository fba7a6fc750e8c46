"""The commands of docs/line.md, run as they stand there, with the demo that the tests make once."""

import contextlib
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "line.md"


def commands():
    """Lines of the page's shell blocks."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


@contextlib.contextmanager
def serving(command, cwd):
    """The address that a server says while it runs; it ends by SIGTERM, with 0."""
    arguments = [sys.executable, "-Im", *shlex.split(command)]
    with subprocess.Popen(arguments, cwd=cwd, stdout=subprocess.PIPE, text=True) as server:
        try:
            yield server.stdout.readline().split()[-1]
        finally:
            server.send_signal(signal.SIGTERM)
            assert server.wait(600) == 0


@pytest.fixture
def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def test_the_commands_of_the_page(demo_folder, free_port, tmp_path, anisoscope):
    install, demo, folder, copy, serve, control, history = commands()
    assert install == "pip install 'anisoscope[line]'"
    assert demo == "anisoscope demo --out demo"
    shutil.copytree(demo_folder, tmp_path / "demo")
    for line in (folder, copy):
        subprocess.run(shlex.split(line), cwd=tmp_path, check=True)
    with serving(serve.replace("4840", str(free_port)), tmp_path) as address:
        order = control.replace("opc.tcp://127.0.0.1:4840/anisoscope", address).replace(
            "docs/", f"{ROOT}/docs/"
        )
        done = subprocess.run(
            [sys.executable, "-I", *shlex.split(order)[1:]],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=900,
            env=os.environ,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[0] == "A-0001: PASS"
    listed = anisoscope(*shlex.split(history)[1:], cwd=tmp_path)
    assert listed.out.count("A-0001") == 1
