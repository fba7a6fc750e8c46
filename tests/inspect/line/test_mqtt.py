"""An edge node at a real broker: what it publishes by the rules of Sparkplug, cuts, and commands that are refused."""

import contextlib
import json
import os
import queue
import shutil
import socket
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.history.problems import HistoryError
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history
from anisoscope.inspection.work import WorkerHere
from anisoscope.line.jobs import Job, Jobs, Order, Refused
from anisoscope.line.mqtt import EdgeNode, broker_of
from anisoscope.line.sparkplug import MalformedError, Names, decoded

ROOT = Path(__file__).resolve().parents[3]
NAMES = Names("hall 1", "rig 1", "plates")
LONG_S = 60.0
PROGRAM = Path(
    shutil.which("mosquitto") or "/usr/sbin/mosquitto"
)  # Debian's place is not in the path of all users


def varint(data, at):
    value = shift = 0
    while True:
        byte = data[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at


def fields(data):
    """Numbers and contents of the fields of a protobuf message, read by hand: by the encoding's own description."""
    found, at = [], 0
    while at < len(data):
        key, at = varint(data, at)
        kind = key & 7
        if kind == 0:
            value, at = varint(data, at)
        else:
            size, at = (8, at) if kind == 1 else (4, at) if kind == 5 else varint(data, at)
            value, at = data[at : at + size], at + size
        found.append((key >> 3, value))
    return found


def read(data):
    """A payload: timestamp, seq, and metrics by name with datatype and value."""
    whole = fields(data)
    payload = {"timestamp": None, "seq": None, "metrics": {}, "order": []}
    for number, value in whole:
        if number == 2:
            metric = dict(fields(value))
            name = metric[1].decode()
            payload["metrics"][name] = metric
            payload["order"].append(metric.get(3, 0))
        else:
            payload[{1: "timestamp", 3: "seq"}[number]] = value
    return payload


def text(payload, name):
    return payload["metrics"][name][15].decode()


class Broker:
    """Mosquitto at a free port of this computer."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.file = folder / "mosquitto.conf"
        self.file.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        self.start()

    def start(self):
        self.process = subprocess.Popen([PROGRAM, "-c", self.file], stderr=subprocess.PIPE, text=True)
        for line in self.process.stderr:
            if "running" in line:
                break
        else:
            raise AssertionError("mosquitto does not start")
        self.reader = threading.Thread(target=self.process.stderr.read)
        self.reader.start()

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.reader.join()
        self.process.stderr.close()

    @property
    def address(self):
        return f"mqtt://127.0.0.1:{self.port}"


class Host:
    """A client of its own that hears everything and may command."""

    def __init__(self, broker):
        self.heard = queue.Queue()
        self.kept = []
        self.ready = threading.Event()
        self.client = paho.Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = lambda _c, _u, message: self.heard.put(message)
        self.client.on_subscribe = lambda *_: self.ready.set()
        self.client.connect("127.0.0.1", broker.port)
        self.client.subscribe("#", qos=1)
        self.client.loop_start()
        assert self.ready.wait(LONG_S)

    def next(self, ending, accept=lambda _: True):
        """The next message of a topic that has a part, and is accepted; all that were heard are kept."""
        while True:
            message = self.heard.get(timeout=LONG_S)
            self.kept.append(message)
            if ending in message.topic and accept(message):
                return message

    def publish(self, topic, payload, *, retain=False):
        self.client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(LONG_S)

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


class Line:
    """Jobs as the engine has them: remembers ids, one at a time; what was ordered is kept."""

    def __init__(self):
        self.running, self.done, self.stops, self.listener = None, {}, 0, None

    def listen(self, listener):
        self.listener = listener

    def submit(self, order):
        if order.job in self.done:
            return self.done[order.job]
        if self.running is not None:
            raise Refused("busy", f"job {self.running.id} is at work: one job at a time")
        if order.recipe != "plate":
            raise Refused("recipe", f"there is no recipe {order.recipe!r}")
        job = Job(Order(**order.model_dump()), "running", "2026-11-01T06:00:00+00:00")
        self.running = self.done[order.job] = job
        self.listener("accepted", job, {})
        return job

    def stop(self):
        self.stops += 1
        return {}


def row(number, **changes):
    values = {
        "created_at": datetime(2026, 11, 1, 6, 0, tzinfo=UTC) + timedelta(minutes=number),
        "serial": f"A{number}", "product": "plate", "recipe": "plate 0123456789ab", "lot": "L7", "cavity": "2",
        "verdict": "PASS", "reasons": (), "folder": f"/parts/A{number}",
        "seal": sha256(str(number).encode()).hexdigest(), "software": "anisoscope 0",
        "numbers": {"ln 0-90": 1.0 + 0.5 * number},
    }  # fmt: skip
    return NewRow(**(values | changes))


@pytest.fixture
def broker(tmp_path):
    if not PROGRAM.exists():
        pytest.skip("mosquitto is not installed: apt-get install mosquitto")
    made = Broker(tmp_path)
    yield made
    made.kill()


@pytest.fixture
def place(tmp_path):
    path = tmp_path / "history.sqlite"
    with open_history(path) as history:
        history.append_all([row(1), row(2, verdict="FAIL", numbers={"ln 0-90": 2.0, "cause worn tool": 0.8})])
    return path


@pytest.fixture
def host(broker):
    made = Host(broker)
    yield made
    made.close()


@contextlib.contextmanager
def serving(broker, place, said, jobs=None):
    node = EdgeNode(broker_of(broker.address), NAMES, place, place.parent / "mqtt.json", said.append, jobs)
    thread = threading.Thread(target=node.run)
    thread.start()
    try:
        yield node
    finally:
        node.end()
        thread.join(LONG_S)
        assert not thread.is_alive()


def command(topic_name, *metrics):
    """A command as a host writes it, by hand."""

    def size(data):
        return bytes([len(data) & 127 | 128, len(data) >> 7]) if len(data) > 127 else bytes([len(data)])

    body = b"\x08\x01"
    for name, value in metrics:
        metric = b"\x0a" + size(name.encode()) + name.encode()
        if isinstance(value, bool):
            metric += b"\x20\x0b\x70" + bytes([value])
        else:
            metric += b"\x20\x0c\x7a" + size(value.encode()) + value.encode()
        body += b"\x12" + size(metric) + metric
    return NAMES.topic(topic_name), body


@pytest.fixture
def session(broker, place, host):
    """Everything that a host hears: birth, a result, orders, rebirth, a killed broker, and the end."""
    said, jobs = [], Line()
    with serving(broker, place, said, jobs):
        host.next("DBIRTH")
        with open_history(place) as history:
            history.append(row(3, numbers={"ln 0-90": 2.5, "new": 7.0}))
        host.next("result")
        host.publish(*command("NCMD", ("Node Control/Rebirth", True)))
        host.next("DBIRTH", lambda m: b"Numbers/new" in m.payload and read(m.payload)["seq"] == 1)
        host.publish(
            *command("DCMD", ("Command/Order", json.dumps({"job": "J1", "recipe": "plate", "serial": "A4"})))
        )
        host.next("answer")
        host.next("state")
    host.next("NDEATH")
    return host.kept, said


def kinds(messages):
    return [(m.topic.split("/")[2], m, read(m.payload)) for m in messages if m.topic.startswith("spB")]


# One entry for each assertion of Sparkplug 3.0 that can be seen from outside: what has to hold of the messages heard.
def every(kind, holds):
    def check(messages):
        found = [(m, p) for name, m, p in kinds(messages) if name == kind]
        return bool(found) and all(holds(m, p) for m, p in found)

    return check


def now_ms():
    return datetime.now(UTC).timestamp() * 1000


def recent(m, p):
    return p["timestamp"] is not None and abs(now_ms() - p["timestamp"]) < 600_000


def plain(m, p):
    return (m.qos, m.retain) == (0, False)


def data_order(messages):
    expected = None
    for name, _, payload in kinds(messages):
        if name in ("NDEATH", "NCMD", "DCMD"):
            continue
        if name == "NBIRTH":
            expected = 0
        if payload["seq"] != expected:
            return False
        expected = (expected + 1) % 256
    return True


def born_before(messages):
    """Every name of data is in the last birth of its device."""
    known = set()
    for name, _, payload in kinds(messages):
        if name == "DBIRTH":
            known = set(payload["metrics"])
        elif name == "DDATA" and not set(payload["metrics"]) <= known:
            return False
    return bool(known)


def rebirth_is_whole(messages):
    names = [name for name, _, _ in kinds(messages)]
    after = names[names.index("NCMD") :]
    return [one for one in after if one in ("NBIRTH", "DBIRTH")][:2] == ["NBIRTH", "DBIRTH"]


def same_session(messages):
    numbers = {p["metrics"]["bdSeq"][11] for name, _, p in kinds(messages) if name in ("NBIRTH", "NDEATH")}
    return numbers == {0}


def of(messages, *names):
    return [(m, p) for name, m, p in kinds(messages) if name in names]


def metrics_are_whole(*names):
    def holds(messages):
        found = [one for _, p in of(messages, *names) for one in p["metrics"].values()]
        return bool(found) and all({1, 4} <= set(one) and set(one) & set(range(7, 16)) for one in found)

    return holds


def rebirth_metric(m, p):
    one = p["metrics"]["Node Control/Rebirth"]
    return (one[4], one[14]) == (11, 0)


def bd_seq_metric(m, p):
    one = p["metrics"]["bdSeq"]
    return one[4] == 4 and 0 <= one[11] < 256


def at(topic):
    return lambda m, p: m.topic == f"spBv1.0/hall 1/{topic}"


def in_order(m, p):
    return p["order"] == sorted(p["order"])


def node_topics(messages):
    return all(m.topic.count("/") == 3 for m, _ in of(messages, "NBIRTH", "NDEATH", "NCMD"))


def device_topics(messages):
    return all(
        m.topic.endswith("/rig 1/plates") for m, _ in of(messages, "DBIRTH", "DDATA", "DDEATH", "DCMD")
    )


def all_have_seq(messages):
    return all(p["seq"] is not None for _, p in of(messages, "NBIRTH", "DBIRTH", "DDATA", "DDEATH"))


def no_seq(m, p):
    return p["seq"] is None


DBIRTH_TOPIC = every("DBIRTH", at("DBIRTH/rig 1/plates"))
REBIRTH = every("NBIRTH", rebirth_metric)
SEEN = {
    "tck-id-topic-structure-namespace-a": lambda ms: all(m.topic[:8] == "spBv1.0/" for _, m, _ in kinds(ms)),
    "tck-id-topic-structure-namespace-device-id-associated-message-types": device_topics,
    "tck-id-topic-structure-namespace-device-id-non-associated-message-types": node_topics,
    "tck-id-topics-nbirth-topic": every("NBIRTH", at("NBIRTH/rig 1")),
    "tck-id-topics-nbirth-mqtt": every("NBIRTH", plain),
    "tck-id-topics-nbirth-seq-num": every("NBIRTH", lambda m, p: p["seq"] == 0),
    "tck-id-topics-nbirth-timestamp": every("NBIRTH", recent),
    "tck-id-topics-nbirth-metric-reqs": metrics_are_whole("NBIRTH"),
    "tck-id-topics-nbirth-bdseq-included": every("NBIRTH", bd_seq_metric),
    "tck-id-topics-nbirth-bdseq-matching": same_session,
    "tck-id-topics-nbirth-rebirth-metric": REBIRTH,
    "tck-id-topics-ndeath-topic": every("NDEATH", at("NDEATH/rig 1")),
    "tck-id-topics-ndeath-payload": every("NDEATH", lambda m, p: set(p["metrics"]) == {"bdSeq"}),
    "tck-id-topics-ndeath-seq": every("NDEATH", no_seq),
    "tck-id-topics-dbirth-topic": DBIRTH_TOPIC,
    "tck-id-topics-dbirth-mqtt": every("DBIRTH", plain),
    "tck-id-topics-dbirth-seq": data_order,
    "tck-id-topics-dbirth-timestamp": every("DBIRTH", recent),
    "tck-id-topics-dbirth-metric-reqs": metrics_are_whole("DBIRTH"),
    "tck-id-topics-dbirth-metrics": born_before,
    "tck-id-topics-ddata-topic": every("DDATA", at("DDATA/rig 1/plates")),
    "tck-id-topics-ddata-mqtt": every("DDATA", plain),
    "tck-id-topics-ddata-seq-num": data_order,
    "tck-id-topics-ddata-timestamp": every("DDATA", recent),
    "tck-id-topics-ddata-payload": every("DDATA", lambda m, p: bool(p["metrics"])),
    "tck-id-topics-ddeath-topic": every("DDEATH", at("DDEATH/rig 1/plates")),
    "tck-id-topics-ddeath-mqtt": every("DDEATH", plain),
    "tck-id-topics-ddeath-seq-num": data_order,
    "tck-id-message-flow-edge-node-birth-publish-nbirth-payload-bdSeq": same_session,
    "tck-id-message-flow-edge-node-birth-publish-nbirth-qos": every("NBIRTH", plain),
    "tck-id-message-flow-device-birth-publish-nbirth-wait": lambda ms: kinds(ms)[0][0] == "NBIRTH",
    "tck-id-message-flow-device-birth-publish-dbirth-match-edge-node-topic": DBIRTH_TOPIC,
    "tck-id-operational-behavior-edge-node-intentional-disconnect-ndeath": lambda ms: (
        kinds(ms)[-1][0] == "NDEATH"
    ),
    "tck-id-operational-behavior-data-publish-nbirth-order": every("NBIRTH", in_order),
    "tck-id-operational-behavior-data-publish-dbirth-order": every("DDATA", in_order),
    "tck-id-operational-behavior-data-commands-rebirth-name": REBIRTH,
    "tck-id-operational-behavior-data-commands-rebirth-datatype": REBIRTH,
    "tck-id-operational-behavior-data-commands-rebirth-value": REBIRTH,
    "tck-id-operational-behavior-data-commands-rebirth-action-2": rebirth_is_whole,
    "tck-id-operational-behavior-data-commands-rebirth-action-3": same_session,
    "tck-id-payloads-sequence-num-always-included": all_have_seq,
    "tck-id-payloads-sequence-num-incrementing": data_order,
    "tck-id-payloads-ndeath-seq": every("NDEATH", no_seq),
    "tck-id-payloads-ddeath-timestamp": every("DDEATH", recent),
    "tck-id-payloads-ddeath-seq-inc": data_order,
}
"""Assertions of Eclipse Sparkplug 3.0 for edge nodes."""


def test_the_assertions_of_sparkplug_that_can_be_seen_hold_one_by_one(session):
    messages, said = session
    assert {name: check(messages) for name, check in SEEN.items()} == dict.fromkeys(SEEN, True)
    assert said == [f"connected to {said[0].split()[-1]}"]
    lines = "\n".join(f"| `{name}` | holds |" for name in sorted(SEEN))
    page = ROOT / "docs" / "evidence" / "line.md"
    head = "<!-- assertions: written by the tests -->\n| assertion | |\n|---|---|\n"
    table = f"{head}{lines}\n<!-- end of assertions -->"
    written = page.read_text(encoding="utf-8")
    before, _, rest = written.partition("<!-- assertions")
    whole = before + table + rest.partition("<!-- end of assertions -->")[2]
    if os.environ.get("ANISOSCOPE_WRITE_DOCS"):
        page.write_text(whole, encoding="utf-8")
    assert page.read_text(encoding="utf-8") == whole, "ANISOSCOPE_WRITE_DOCS=1 writes the page anew"


def test_results_orders_and_yield_are_in_the_metrics_and_in_json(session):
    messages, _ = session
    births = [p for name, _, p in kinds(messages) if name == "DBIRTH"]
    assert text(births[0], "Result/Verdict") == "FAIL"
    assert text(births[0], "Result/Cause") == "worn tool"
    data = [p for name, _, p in kinds(messages) if name == "DDATA"]
    assert (text(data[0], "Result/Serial"), text(data[0], "Result/Verdict")) == ("A3", "PASS")
    plain_topics = {
        m.topic.rpartition("/")[2]: json.loads(m.payload) for m in messages if m.topic.startswith("aniso")
    }
    result = plain_topics["result"]
    assert (result["id"], result["numbers"], result["yield"]) == (
        3,
        {"ln 0-90": 2.5, "new": 7.0},
        pytest.approx(2 / 3),
    )
    assert plain_topics["answer"] == {"job": "J1", "state": "running", "verdict": None, "problem": None}
    assert plain_topics["state"] == {"state": "running", "job": "J1"}


def test_a_killed_broker_gets_the_next_session_and_what_it_missed_once(broker, place, host):
    said = []
    with serving(broker, place, said):
        host.next("DBIRTH")
        broker.kill()
        host.close()
        with open_history(place) as history:
            history.append_all([row(3), row(4)])
        broker.start()
        again = Host(broker)
        results = [json.loads(again.next("result").payload)["id"] for _ in range(2)]
        again.close()
    assert results == [3, 4]
    assert json.loads((place.parent / "mqtt.json").read_text())["published"] == 4
    assert "trying again" in said[1]


def test_a_killed_node_is_declared_dead_by_its_will(broker, place, host):
    code = """
import pathlib, sys
from anisoscope.line.mqtt import EdgeNode, broker_of
from anisoscope.line.sparkplug import Names
place = pathlib.Path(sys.argv[2])
names = Names('hall 1', 'rig 1', 'plates')
EdgeNode(broker_of(sys.argv[1]), names, place, place.parent / 'm.json', print).run()
"""
    for number in (0, 1):
        node = subprocess.Popen([sys.executable, "-c", code, broker.address, str(place)])
        birth = read(host.next("NBIRTH").payload)
        host.next("DBIRTH")
        node.kill()
        node.wait()
        death = host.next("NDEATH")
        assert (death.qos, death.retain) == (1, False)
        assert read(death.payload)["metrics"]["bdSeq"][11] == birth["metrics"]["bdSeq"][11] == number


REFUSED = [
    ("NCMD", b"\xff\xff\xff", "it is no Sparkplug B payload"),
    ("NCMD", b"", "it has no metrics"),
    ("NCMD", command("NCMD", ("Node Control/Reboot", True))[1], "there is no command 'Node Control/Reboot'"),
    ("NCMD", command("NCMD", ("Node Control/Rebirth", "yes"))[1], "takes a truth value"),
    ("DCMD", command("DCMD", ("Command/Order", "{}"))[1], "job: missing; expected a text"),
    ("DCMD", command("DCMD", ("Command/Order", "[" * 100))[1], "an order is a JSON object"),
    ("DCMD", b"\x12\x04\x0a\x01x\x20", "it is no Sparkplug B payload"),
    ("DCMD", b"\x12\x05\x0a\x01x\x20\x10", "the data type 16"),
    ("order", b"\xfe", "can't decode"),
    ("order", b'{"job": "J", "recipe": "other", "serial": "A"}', "there is no recipe 'other'"),
    ("order", b"x" * 70_000, "70000 bytes"),
]


def test_what_is_no_command_is_refused_in_one_line_and_nothing_moves(broker, place, host):
    said, jobs = [], Line()
    with serving(broker, place, said, jobs):
        host.next("DBIRTH")
        for topic, payload, words in REFUSED:
            where = NAMES.topic(topic) if topic.isupper() else NAMES.plain(topic)
            host.publish(where, payload)
            answer = json.loads(host.next("answer").payload)
            assert words in answer["text"], (topic, payload, answer)
            assert "\n" not in answer["text"]
        assert len(said) == 1 + len(REFUSED)
        assert (jobs.done, jobs.stops) == ({}, 0)


def test_retained_commands_are_not_carried_out(broker, place, host):
    host.publish(NAMES.plain("order"), b'{"job": "J", "recipe": "plate", "serial": "A"}', retain=True)
    host.publish(*command("NCMD", ("Node Control/Rebirth", True)), retain=True)
    said, jobs = [], Line()
    with serving(broker, place, said, jobs):
        answers = [json.loads(host.next("answer").payload) for _ in range(2)]
        assert all("retained by the broker" in one["text"] for one in answers)
        assert jobs.done == {}
        order = b'{"job": "J", "recipe": "plate", "serial": "A"}'
        host.publish(NAMES.plain("order"), order)
        assert json.loads(host.next("answer").payload)["state"] == "running"
        host.publish(NAMES.plain("order"), order)  # delivered twice: the same job
        assert json.loads(host.next("answer").payload)["job"] == "J"
        host.publish(NAMES.plain("order"), order.replace(b'"J"', b'"K"'))
        assert json.loads(host.next("answer").payload)["refused"] == "busy"
        host.publish(NAMES.plain("stop"), b"")
        assert json.loads(host.next("answer").payload) == {"stopped": True}
        assert (list(jobs.done), jobs.stops) == (["J"], 1)


@pytest.mark.parametrize(
    "address", ["broker", "http://broker", "mqtt://", "mqtt://broker:x", "mqtt://broker/topic"]
)
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(UsageError, match="a broker has an address"):
        broker_of(address)


def test_no_history_is_made_where_nothing_can_be_ordered(tmp_path):
    node = EdgeNode(
        broker_of("mqtt://127.0.0.1"), NAMES, tmp_path / "none.sqlite", tmp_path / "a" / "mqtt.json", print
    )
    with pytest.raises(HistoryError, match="there is no history"):
        node.run()
    assert list(tmp_path.iterdir()) == []


def test_names_memory_and_passwords(tmp_path, place):
    found = broker_of("mqtts://me:s%40me@[::1]")
    assert (found.port, found.password, found.tls) == (8883, "s@me", True)
    assert "me" not in str(found)
    assert "s@me" not in repr(found)
    with pytest.raises(UsageError, match="--node 'a/b' cannot be part of a topic"):
        Names("g", "a/b", "d")
    (tmp_path / "mqtt.json").write_text("{")
    with pytest.raises(RecordError, match=r"mqtt\.json cannot be used"):
        EdgeNode(found, NAMES, place, tmp_path / "mqtt.json", print)
    with pytest.raises(MalformedError, match="a metric has no name"):
        decoded(b"\x12\x02\x20\x0b")


def test_a_job_that_is_ordered_over_mqtt_is_done_once(place_of, broker, host):
    place, recipes = place_of("mqtt")
    said, order = [], {"job": "J1", "recipe": "plate", "serial": "A-1", "lot": "L7"}
    jobs = Jobs(place, recipes, WorkerHere(place), dict, "S1")
    with serving(broker, place.history, said, jobs), jobs:
        host.next("DBIRTH")
        for _ in range(2):  # the answer was lost: ordered again
            host.publish(NAMES.plain("order"), json.dumps(order).encode())
        answers = [json.loads(host.next("answer").payload) for _ in range(3)]
        assert [one["state"] for one in answers] == ["running", "running", "done"]
        assert answers[-1]["verdict"] == "PASS"
        host.publish(NAMES.plain("order"), json.dumps(order).encode())
        assert json.loads(host.next("answer").payload) == answers[-1]
        results = [json.loads(m.payload) for m in host.kept if m.topic.endswith("/result")]
        assert [(one["id"], one["serial"], one["lot"], one["verdict"]) for one in results] == [
            (1, "A-1", "L7", "PASS")
        ]
    with open_history(place.history, create=False) as history:
        assert [row.serial for row in history.rows()] == ["A-1"]


PEER = Path(
    os.environ.get("ANISOSCOPE_TEST_PYSPARKPLUG", ROOT / ".venv" / "peers" / "pysparkplug" / "bin" / "python")
)
HOW = (
    "pysparkplug (it needs paho-mqtt 1) has an environment of its own: python3 -m venv .venv/peers/pysparkplug && "
    ".venv/peers/pysparkplug/bin/pip install pysparkplug==0.3.2"
)


@pytest.mark.skipif(not PEER.exists(), reason=HOW)
def test_somebody_elses_reader_reads_the_same(broker, place, host):
    script = ROOT / "tools" / "peers" / "pysparkplug_reader.py"
    with subprocess.Popen([PEER, script, str(broker.port)], stdout=subprocess.PIPE, text=True) as peer:
        assert peer.stdout.readline() == "listening\n"
        with serving(broker, place, []):
            host.next("DBIRTH")
            with open_history(place) as history:
                history.append(row(3, numbers={"ln 0-90": 2.5, "new": 7.0}))
            host.next("result")
        found = [json.loads(line) for line in peer.stdout]
    host.next("NDEATH")
    ours = kinds(host.kept)
    assert [one["kind"] for one in found] == [name for name, _, _ in ours]
    for theirs, (name, _, payload) in zip(found, ours, strict=True):
        assert theirs["seq"] == payload["seq"]
        if name not in ("NDEATH", "DDEATH"):
            assert set(theirs["metrics"]) - {"bdSeq"} == set(payload["metrics"]) - {"bdSeq"}
    data = next(one["metrics"] for one in found if one["kind"] == "DDATA")
    assert (data["Result/Verdict"], data["Numbers/ln 0-90"], data["Numbers/new"]) == ("PASS", "2.5", "7.0")
