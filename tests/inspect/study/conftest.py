"""A Dask cluster as a user starts it: a scheduler and two workers, each a process."""

import json
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import pytest

# A killed run ends no fixture: the kernel ends what was started here (by util-linux; other systems have no such thing).
ENDS_WITH_US = ["setpriv", "--pdeathsig", "KILL"] if shutil.which("setpriv") else []


@dataclass
class Cluster:
    """A running cluster: its address, how to add a worker, and the processes of its workers."""

    address: str
    add_worker: object
    workers: list

    def wait_for_workers(self, count):
        wait_for_workers(self.address, count)


@contextmanager
def process(*arguments):
    command = [*ENDS_WITH_US, sys.executable, "-Im", "dask", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as started:
        try:
            yield started
        finally:
            started.send_signal(signal.SIGKILL)


def scheduler_address(file):
    deadline = time.monotonic() + 120
    while True:
        try:
            return json.loads(file.read_text())["address"]
        except (OSError, ValueError):
            assert time.monotonic() < deadline, "the Dask scheduler did not start"
            time.sleep(0.05)


def wait_for_workers(address, count):
    """On a busy machine one may have done all the work before the other is there."""
    from distributed import Client

    with Client(address, timeout=60) as client:
        client.wait_for_workers(count, timeout=120)


@pytest.fixture(scope="session")
def scheduler(tmp_path_factory):
    """A scheduler without workers; yields its address."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("scheduler")
    file = folder / "scheduler.json"
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
    with process("scheduler", *options):
        yield scheduler_address(file)


@pytest.fixture(scope="session")
def cluster(tmp_path_factory):
    """A scheduler with two workers; a worker more can be added."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    with ExitStack() as stack:
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
        stack.enter_context(process("scheduler", *options))
        address, workers = scheduler_address(file), []

        def add_worker():
            options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", folder]
            workers.append(stack.enter_context(process("worker", address, *options)))

        add_worker()
        add_worker()
        wait_for_workers(address, 2)
        yield Cluster(address, add_worker, workers)
