"""Jobs ordered over OPC UA while connections are cut and the server is killed: each is done once.

ANISOSCOPE_LINE_JOBS is the number of jobs, 1000 by default; of 10,000, some 75 meet a kill and some 600 a cut. After
ANISOSCOPE_LINE_MINUTES no further job is ordered, and those that were are checked. A line a minute says how far it is.
"""

import asyncio
import contextlib
import importlib.util
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from asyncua.ua.uaerrors import UaError

from anisoscope.history.store import open_history

SPEC = importlib.util.spec_from_file_location("controller", Path(__file__).with_name("controller.py"))
CONTROLLER = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(CONTROLLER)
RESULT_READY = 1024
KILLS, CUTS = 0.0075, 0.06  # of the jobs
MINUTES = float(os.environ.get("ANISOSCOPE_LINE_MINUTES", "inf"))


class Server:
    """The command in a process of its own, with its inspecting process, started again whenever it is killed."""

    def __init__(self, folder):
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self.port = found.getsockname()[1]
        self.folder, self.process, self.kills = folder, None, 0

    def start(self):
        command = ["line", "opcua", "--rig", "rig.toml", "--recipes", "recipes", "--port", str(self.port)]
        command += ["--reports", "not-pass"]
        self.process = subprocess.Popen(
            [sys.executable, "-Im", "anisoscope", *command],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.address = self.process.stdout.readline().split()[-1]

    def kill(self, *, alone):
        """Kill the server as by kill -9; not alone, its inspecting process with it."""
        self.kills += 1
        with contextlib.suppress(ProcessLookupError):
            (os.kill if alone else os.killpg)(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(60) == 0
        self.process.stdout.close()


async def disturb(server, controller, rng, counts):
    """At a moment of a job, or just after it, a cut or a kill; or nothing."""
    kind = rng.random()
    if kind >= KILLS + CUTS:
        return
    await asyncio.sleep(rng.uniform(0.0, 1.2) * counts["job s"])
    if kind < KILLS:
        await asyncio.to_thread(server.kill, alone=rng.random() < 0.5)
    else:
        transport = controller.client.uaclient.protocol.transport
        if transport is not None:
            counts["cuts"] += 1
            transport.abort()


async def do(controller, number, *, again):
    """Order a job and wait for its result; ``again``: it may have been ordered, and its result sent, before.

    Returns:
        The result.
    """
    meas = f"M-{number}"
    if again:
        state = (await controller.states())[1]
        if state is None:
            await controller.call("SelectModeAutomatic")
        if state in {None, "Initialized"}:
            await controller.prepare("plate")
    job, error = await controller.start(f"S-{number}", meas)
    assert (job.Id, error) == (meas, 0)
    while True:
        if again:
            *_, (result,), error = await controller.results(meas)
            assert error == 0
            if result.ResultState != 2:
                return (await controller.result(meas))[2]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                while True:
                    event = await controller.heard.get()
                    if event.EventType.Identifier == RESULT_READY and event.MeasId.Id == meas:
                        return CONTROLLER.content(event.ResultContent)[2]
        again = True


def drop_frames(result):
    """Of a job that is done only the record is needed: 10,000 have 10 GB of frames."""
    folder = Path(result["links"]["folder"].removeprefix("file://"))
    for name in ("frames", "inputs"):
        shutil.rmtree(folder / name)


async def order_all(server, jobs, rng, counts):
    """Order jobs until all are done or the time is over.

    Returns:
        How many were ordered.
    """
    number, known, said = 0, None, 0
    began = time.monotonic()
    while number < jobs:
        if server.process.poll() is not None:
            starting = time.monotonic()
            await asyncio.to_thread(server.start)
            counts["starting s"] += time.monotonic() - starting
        try:
            made, again = CONTROLLER.Controller(server.address, 10, known=known), True
            async with asyncio.timeout(240), made as controller:
                known = controller.known
                while number < jobs:
                    at = time.monotonic()
                    if at - began > 60 * MINUTES and not again:  # no job was ordered before a break
                        return number
                    disturbing = asyncio.create_task(disturb(server, controller, rng, counts))
                    try:
                        result = await do(controller, number, again=again)
                    finally:
                        await disturbing
                    assert (result["job"], result["state"]) == (f"M-{number}", "done")
                    drop_frames(result)
                    number, again = number + 1, False
                    counts["job s"] += 0.1 * (min(time.monotonic() - at, 3.0) - counts["job s"])
                    if (minute := int((time.monotonic() - began) / 60)) > said:
                        said = minute
                        print(f"{minute} min: {number} jobs, {server.kills} kills, {counts}", flush=True)  # noqa: T201
        except (OSError, UaError, TimeoutError, asyncio.CancelledError) as problem:
            counts["problems"] += 1
            counts[type(problem).__name__] = counts.get(type(problem).__name__, 0) + 1
            assert counts["problems"] < 20 * jobs
    return number


@pytest.mark.soak
def test_no_job_is_lost_or_doubled_by_kills_and_cuts(virtual_rig, coarse):
    jobs = int(os.environ.get("ANISOSCOPE_LINE_JOBS", "1000"))
    rig = virtual_rig("soak", **coarse)
    folder = rig.rig.parent
    (folder / "recipes").mkdir()
    shutil.copy(rig.recipe, folder / "recipes" / "plate.toml")
    server, counts = Server(folder), {"cuts": 0, "problems": 0, "job s": 1.0, "starting s": 0.0}
    server.start()
    began = time.monotonic()
    jobs = asyncio.run(order_all(server, jobs, random.Random(7), counts))
    per_s = jobs / (time.monotonic() - began)
    server.end()
    names = [f"M-{number}" for number in range(jobs)]
    found = sorted((folder / "inspections").glob("*/record.json"))
    records = [json.loads(path.read_text()) for path in found]
    assert sorted(one["particulars"]["job"] for one in records) == sorted(names)
    with open_history(folder / "inspections" / "history.sqlite", create=False) as history:
        rows = history.rows()
        assert history.verify_chain() == []
    assert sorted(row.folder for row in rows) == [str(path.parent) for path in found]
    verdicts = sorted({row.verdict for row in rows})
    print(f"{jobs} jobs, {server.kills} kills, {counts}, verdicts {verdicts}, {per_s:.2f} jobs/s")  # noqa: T201
