"""Jobs over MQTT while connections are cut and server and broker are killed: none is lost, none done twice.

ANISOSCOPE_LINE_JOBS is the number of jobs, 1000 by default; of 10,000, some 80 meet a kill of server or broker and some
300 a cut between the two. After ANISOSCOPE_LINE_MINUTES the jobs done so far are checked. A line a minute says how far
it is.
"""

import contextlib
import importlib.util
import json
import os
import queue
import random
import shutil
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from anisoscope.history.store import open_history
from anisoscope.record.schema import read_record

COUNT = int(os.environ.get("ANISOSCOPE_LINE_JOBS", "1000"))
MINUTES = float(os.environ.get("ANISOSCOPE_LINE_MINUTES", "inf"))
KILLS, CUTS = 0.001, 0.004  # of the messages, of which a job has about eight
NODE = ("--group", "hall 1", "--node", "rig 1", "--device", "plates")


def beside():
    """The broker and the client of the other tests."""
    spec = importlib.util.spec_from_file_location("mqtt_tests", Path(__file__).with_name("test_mqtt.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Wire(socketserver.ThreadingTCPServer):
    """What lies between the server and the broker; it can be cut, and carries the next connection."""

    daemon_threads = True

    def __init__(self, broker):
        super().__init__(("127.0.0.1", 0), socketserver.BaseRequestHandler)
        self.broker, self.ends = broker, set()
        self.thread = threading.Thread(target=self.serve_forever)
        self.thread.start()

    def finish_request(self, near, _):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.broker.port)) as far:
            self.ends = {near, far}
            back = threading.Thread(target=self.carry, args=(far, near))
            back.start()
            self.carry(near, far)
            back.join()

    def carry(self, here, there):
        with contextlib.suppress(OSError):
            while some := here.recv(65536):
                there.sendall(some)
        self.cut({here, there})

    def cut(self, ends=None):
        for end in ends or self.ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self):
        self.shutdown()
        self.thread.join()
        self.server_close()


def server(wire, place, recipes):
    command = [sys.executable, "-Im", "anisoscope", "line", "mqtt", *NODE]
    command += ["--broker", f"mqtt://127.0.0.1:{wire.server_address[1]}"]
    command += ["--reports", "not-pass"]
    paths = ["--rig", place.rig, "--recipes", recipes, "--out", place.out, "--history", place.history]
    return subprocess.Popen([*command, *paths], stdout=subprocess.DEVNULL)


class Shop:
    """A controller that orders jobs one after the other; now and then there is a cut or a kill."""

    def __init__(self, tests, place, recipes, folder):
        self.tests, self.place, self.recipes, self.chance = tests, place, recipes, random.Random(5)
        self.broker = tests.Broker(folder)
        self.wire, self.host = Wire(self.broker), tests.Host(self.broker)
        self.server = server(self.wire, place, recipes)
        self.seen, self.kills, self.cuts, self.done = set(), 0, 0, 0

    @property
    def order(self):
        return {"job": f"J{self.done}", "recipe": "plate", "serial": f"S-{self.done}"}

    def say(self):
        self.host.publish(self.tests.NAMES.plain("order"), json.dumps(self.order).encode())

    def hear(self, message):
        """What a message says; a birth means that orders may have been lost, so that the same is ordered again."""
        if "/NBIRTH/" in message.topic:
            self.say()
        elif message.topic.endswith("/result"):
            self.seen.add(json.loads(message.payload)["serial"])
        elif message.topic.endswith("/answer"):
            answer = json.loads(message.payload)
            if answer.get("job") == self.order["job"] and answer["state"] == "done":
                self.drop_frames()
                self.done += 1
                self.say()

    def drop_frames(self):
        """Of a job that is done only the record is needed: 10,000 have 10 GB of frames."""
        (record,) = self.place.out.glob(f"S-{self.done}-*/record.json")
        for name in ("frames", "inputs"):
            shutil.rmtree(record.parent / name)

    def disturb(self):
        kind = self.chance.random()
        if kind < KILLS:
            self.kill()
        elif kind < KILLS + CUTS:
            self.cuts += 1
            self.wire.cut()

    def kill(self):
        self.kills += 1
        if self.chance.random() < 0.5:
            self.server.kill()
            self.server.wait()
            self.server = server(self.wire, self.place, self.recipes)
            return
        self.broker.kill()
        self.host.close()
        heard = self.host.heard
        self.broker.start()
        self.host = self.tests.Host(self.broker)
        while not heard.empty():  # what had arrived before
            self.host.heard.put(heard.get())
        self.host.publish(*self.tests.command("NCMD", ("Node Control/Rebirth", True)))

    def close(self):
        self.server.send_signal(signal.SIGTERM)
        self.server.wait()
        with contextlib.suppress(queue.Empty):
            while True:
                self.hear(self.host.heard.get(timeout=5))
        self.host.close()
        self.wire.close()
        self.broker.kill()


@pytest.mark.soak
def test_jobs_over_mqtt_are_done_once_whatever_is_killed(place_of, coarse, tmp_path):
    place, recipes = place_of("mqtt soak", **coarse)
    shop, began, said = Shop(beside(), place, recipes, tmp_path), time.monotonic(), 0
    try:
        while shop.done < COUNT and said < MINUTES:
            if (minute := int((time.monotonic() - began) / 60)) > said:
                said = minute
                print(f"{minute} min: {shop.done} jobs, {shop.kills} kills, {shop.cuts} cuts", flush=True)  # noqa: T201
            shop.hear(shop.host.heard.get(timeout=300))
            shop.disturb()
    finally:
        per_s = shop.done / (time.monotonic() - began)
        shop.close()
    with open_history(place.history, create=False) as history:
        serials = [row.serial for row in history.rows()]
        assert history.verify_chain() == []
    ordered = {f"S-{number}" for number in range(shop.done)}
    records = [read_record(path.parent).serial for path in place.out.glob("*/record.json")]
    for found in (serials, records):
        assert len(found) == len(set(found))
        assert ordered <= set(found)
    assert ordered <= shop.seen  # at least once over MQTT
    assert (shop.kills > 0 and shop.cuts > 0) or COUNT < 100
    print(f"{shop.done} jobs, {shop.kills} kills, {shop.cuts} cuts, {per_s:.2f} jobs/s")  # noqa: T201
