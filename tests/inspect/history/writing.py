"""Run as a program by the tests: writers that add inspections, and some that are killed while they do.

`writing.py add PLACE WORKERS COUNT` adds COUNT inspections from each of WORKERS processes at once.
`writing.py kill PLACE TIMES SEED` lets a process add inspections TIMES times, and kills it at a random moment; it
prints what the processes had been told was saved, as a JSON list of seals.
"""

import json
import multiprocessing
import os
import random
import signal
import sys
import time
from datetime import UTC, datetime, timedelta
from hashlib import sha256

from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history

START = datetime(2026, 11, 1, tzinfo=UTC)


def row(worker, number):
    return NewRow(
        created_at=START + timedelta(seconds=number),
        serial=f"W{worker}-{number}",
        product="ridged plate",
        recipe="ridged plate 0123456789ab",
        station=f"station {worker}",
        verdict="PASS",
        reasons=("all is well",),
        folder=f"/inspections/W{worker}-{number}",
        seal=sha256(f"{worker} {number}".encode()).hexdigest(),
        software="anisoscope 0.1.0",
        numbers={f"ln 0-{worker}": float(number), "d2": 1.0},
    )


def write(place, worker, count, tell=None, together=None):
    with open_history(place) as history:
        for number in range(count):
            if together is not None:
                together.wait()  # or one of them may have written all before the next one is given the processor
            seal = history.append(row(worker, number)).seal
            if tell is not None:
                os.write(tell, bytes.fromhex(seal))


def add(place, workers, count):
    children, together = [], multiprocessing.get_context("fork").Barrier(workers, timeout=300.0)
    for worker in range(workers):
        child = os.fork()
        if child == 0:
            write(place, worker, count, together=together)
            os._exit(0)
        children.append(child)
    codes = [os.waitpid(child, 0)[1] for child in children]
    sys.exit(max(codes) != 0)


def kill(place, times, seed):
    chance = random.Random(seed)
    saved = []
    for worker in range(times):
        read_end, write_end = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read_end)
            write(place, worker, 1_000_000, tell=write_end)
        os.close(write_end)
        with os.fdopen(read_end, "rb") as told:
            # from before the database is open until well into the writing
            data = told.read(32 * chance.randrange(12))
            time.sleep(chance.uniform(0.0, 0.01))
            os.kill(child, signal.SIGKILL)
            assert os.waitpid(child, 0)[1] == signal.SIGKILL
            data += told.read()
        saved += [data[at : at + 32].hex() for at in range(0, len(data), 32)]
    json.dump(saved, sys.stdout)


if __name__ == "__main__":
    job, place, first, second = sys.argv[1:]
    {"add": add, "kill": kill}[job](place, int(first), int(second))
