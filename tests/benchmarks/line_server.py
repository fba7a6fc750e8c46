"""The server of OPC UA as the command starts it, and the same inspections by the same process without it.

``python line_server.py RIG RECIPES OUT PORT STAMPS`` says its address. Each line of its input is a serial number, which
is inspected without a job; each begin and end of an inspection, its row in the history included, is a line of STAMPS by
the monotonic clock, written by the process that inspects.
"""

import asyncio
import contextlib
import os
import sys
import threading
import time
from functools import partial
from pathlib import Path

from anisoscope.inspection.work import Task, WorkerProcess, Workplace, held_rig, perform
from anisoscope.line.jobs import Jobs
from anisoscope.line.opcua import VisionServer, long_lived
from anisoscope.operations.findings import explained
from anisoscope.operations.remembering import lot_mates, remember

STAMPS = "ANISOSCOPE_STAMPS"


def stamp(what):
    with Path(os.environ[STAMPS]).open("a") as file:
        file.write(f"{what} {time.monotonic()!r}\n")


def mates_stamped(history, lot):
    stamp("begin")
    return lot_mates(history, lot)


def remember_stamped(inspected, history):
    remember(inspected, history)
    stamp("end")


def inspect_here(recipe, serial, place, _advance):
    """Inspect in the process that does the jobs, with nobody listening."""
    perform(Task("inspect", recipe, serial), place, lambda *_: None, threading.Event())


async def serve(jobs, worker, recipes, port):
    async with contextlib.AsyncExitStack() as stack:
        with long_lived():
            server = await stack.enter_async_context(VisionServer(jobs, recipes, port=port))
        print(server.address, flush=True)
        while serial := (await asyncio.to_thread(sys.stdin.readline)).strip():
            await asyncio.to_thread(jobs.wait)
            task = Task("step", do=partial(inspect_here, recipes / "recipe.toml", serial))
            await asyncio.to_thread(worker.run, task, lambda *_: None, threading.Event())
            print("done", flush=True)


def main(rig, recipes, out, port, stamps):
    os.environ[STAMPS] = stamps
    with held_rig(Path(rig)) as held:
        history = Path(out) / "history.sqlite"
        place = Workplace(Path(rig), Path(out), history, remember_stamped, mates_stamped, explained)
        worker = WorkerProcess(place)
        jobs = Jobs(place, Path(recipes), worker, held.stop)
        asyncio.run(serve(jobs, worker, Path(recipes), int(port)))
        worker.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
