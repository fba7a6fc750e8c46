"""Cycles of a machine by OPC 40077, from the simulated press with the OPC Foundation's NodeSets, into the history."""

import asyncio
import importlib.util
import struct
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from asyncua import Server, ua
from asyncua.common.events import Event

from anisoscope.base.errors import UsageError
from anisoscope.history.problems import HistoryError
from anisoscope.history.store import open_history
from anisoscope.line.opcua_security import make_identity, read_security
from anisoscope.line.press import PressReader, cycle_of
from anisoscope.sim.press_server import FIELDS, PressServer

SPEC = importlib.util.spec_from_file_location("controller", Path(__file__).with_name("controller.py"))
CONTROLLER = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(CONTROLLER)
SETTINGS = {
    "melt temperature": 230.5,
    "mould temperature": 60.25,
    "packing pressure": 501.0,
    "cycle time": 30.5,
}
BEGIN = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def loop():
    made = CONTROLLER.Loop()
    yield made
    made(cancel_others())  # sessions of the server that were cut
    made.close()


async def cancel_others():
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        task.cancel()


@pytest.fixture(scope="module")
def press(loop):
    made = PressServer(CONTROLLER.free_port())
    loop(made.__aenter__())
    yield made
    loop(made.__aexit__())


async def cut(press):
    """End all connections, without a word to the clients."""
    for one in list(press._server.bserver.clients):
        one.transport.abort()


class Reading:
    """A reader at work, with what it said and what it took."""

    def __init__(self, address, loop, most=None, fields=(), failures=0, security=None):
        self.loop, self.lines, self.taken, self.failures = loop, asyncio.Queue(), [], failures
        self.reader = PressReader(address, self.take, self.say, fields, again_s=(0.01,), security=security)
        self.task = asyncio.run_coroutine_threadsafe(self.reader.run(most), loop.loop)

    def take(self, news):
        if self.failures:
            self.failures -= 1
            raise HistoryError("the history is locked")
        self.taken += news
        return f"{len(news)} taken"

    def say(self, text):
        self.loop.loop.call_soon_threadsafe(self.lines.put_nowait, text)

    def said(self, words):
        """Wait until it has said this."""

        async def wait():
            async with asyncio.timeout(600):
                while words not in (text := await self.lines.get()):
                    pass
                return text

        return self.loop(wait())

    def done(self):
        return self.task.result(600)


@pytest.fixture
def reading(press, loop):
    """``reading(**more)``: a reader that is connected; it is cancelled at the end."""
    made = []

    def read(**more):
        made.append(Reading(press.address, loop, **more))
        made[-1].said("connected to")
        return made[-1]

    yield read
    for one in made:
        one.task.cancel()
        with suppress(BaseException):
            one.task.result(600)


def test_a_cycle_is_read_by_the_browse_names_of_the_nodesets(press, loop, reading):
    one = reading(most=2)
    loop(press.cycle(SETTINGS, "P-1", BEGIN))
    loop(press.cycle(SETTINGS | {"mould temperature": float("nan")}, "", BEGIN + timedelta(seconds=30)))
    one.done()
    first, second = one.taken
    assert (first.at, first.serial, second.serial) == (BEGIN, "P-1", None)
    assert first.source == press.address.split("/")[2]
    expected = {field: scale * SETTINGS[label] for label, (field, scale) in FIELDS.items()}
    assert {name: first.numbers[name] for name in expected} == expected
    assert expected["CycleTime"] == 30_500.0
    assert first.numbers.keys() == {*expected, "AverageCycleTime"}
    assert second.numbers.keys() == first.numbers.keys() - {FIELDS["mould temperature"][0]}


def test_fields_are_chosen_and_what_is_no_number_is_said_once(press, loop, reading):
    one = reading(most=2, fields=("CycleTime", "PartId", "JobCycleCounter"))
    for number in range(2):
        loop(press.cycle(SETTINGS, f"P-{number}", BEGIN))
    one.done()
    assert [cycle.numbers.keys() for cycle in one.taken] == [{"CycleTime", "JobCycleCounter"}] * 2
    one.said("PartId holds no number; cycles are taken without it")
    left = []
    while sum(left) < 2:
        left.append(int(one.said(" taken").split()[0]))
    assert one.lines.empty()


def test_after_a_cut_cycles_are_read_again_and_missing_ones_counted(press, loop, reading):
    one = reading(most=2)
    loop(press.cycle(SETTINGS, "C-1", BEGIN))
    while not one.taken:
        assert not one.task.done()
    loop(cut(press))
    loop(press.cycle(SETTINGS, "C-2", BEGIN))
    assert press.address in one.said("; trying again")
    one.said("connected to")
    loop(press.cycle(SETTINGS, "C-3", BEGIN))
    one.said("1 cycles before MachineCycleCounter")
    one.done()
    assert [cycle.serial for cycle in one.taken] == ["C-1", "C-3"]


def test_a_machine_that_is_not_there_is_tried_again_and_said_once(loop):
    one = Reading(f"opc.tcp://127.0.0.1:{CONTROLLER.free_port()}", loop)
    assert "trying again" in one.said("127.0.0.1")
    one.task.cancel()


def test_with_a_certificate_no_machine_is_followed_without_encryption_and_no_password_is_shown(
    press, loop, tmp_path
):
    security = read_security(*make_identity(tmp_path / "own", "urn:rig", ["rig"]), tmp_path, list)
    one = Reading(press.address.replace("//", "//setter:geheim@"), loop, security=security)
    line = one.said("neither Basic256Sha256 nor Aes256Sha256RsaPss with encryption")
    assert line.startswith(f"{press.address}: ")
    one.task.cancel()


BAD = ua.StatusCodes.BadSecurityChecksFailed


def refusal_as_error(_):
    return b"ERRF" + struct.pack("<III", 16, BAD, 0xFFFFFFFF)


def refusal_as_fault(asked):
    """A fault in place of the answer, with the header of the question (OPC 10000-6, 6.7.2)."""
    length = (
        4 + 4 + struct.unpack_from("<i", asked, 4)[0] + 8 + 8
    )  # channel, policy, no certificates, numbers
    fault = b"\x01\x00" + struct.pack("<HqIIBi", 397, 0, 1, BAD, 0, -1) + b"\x00\x00\x00"
    return b"OPNF" + struct.pack("<I", 8 + length + len(fault)) + asked[:length] + fault


@pytest.mark.parametrize(
    ("refusal", "words"),
    [
        (refusal_as_error, "An error occurred verifying security"),
        (refusal_as_fault, "it refused the connection"),
    ],
)
def test_a_server_that_refuses_the_channel_is_tried_again(loop, refusal, words):
    async def answer(reader, writer):
        while head := await reader.read(8):
            asked = await reader.readexactly(struct.unpack("<I", head[4:])[0] - 8)
            if head[:3] == b"HEL":
                writer.write(b"ACKF" + struct.pack("<6I", 28, 0, 65536, 65536, 0, 0))
            else:
                writer.write(refusal(asked))
                break
        writer.close()

    server = loop(asyncio.start_server(answer, "127.0.0.1", 0))
    try:
        one = Reading("opc.tcp://127.0.0.1:{1}".format(*server.sockets[0].getsockname()), loop)
        assert words in one.said("trying again")
        one.task.cancel()
    finally:
        loop(ended(server))


async def ended(server):
    server.close()
    await server.wait_closed()


def test_cycles_that_cannot_be_written_are_given_again(press, loop, reading):
    one = reading(most=1, failures=2)
    loop(press.cycle(SETTINGS, "W-1", BEGIN))
    one.done()
    assert [cycle.serial for cycle in one.taken] == ["W-1"]
    one.said("the history is locked")
    one.said("1 taken")
    assert one.lines.empty()


def test_other_servers_and_unknown_fields_are_refused(press, loop):
    with pytest.raises(UsageError, match=r"'Nope'; they have .*CycleTime"):
        Reading(press.address, loop, fields=("Nope",)).done()

    async def other():
        server = Server()
        await server.init()
        server.set_endpoint(f"opc.tcp://127.0.0.1:{CONTROLLER.free_port()}")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        async with server:
            await PressReader(server.endpoint.geturl(), list, str).run()

    with pytest.raises(UsageError, match="no server of OPC 40077"):
        loop(other())


@pytest.mark.parametrize("address", ["press:4840", "http://press", "opc.tcp://", "opc.tcp://press:none"])
def test_addresses_of_other_protocols_are_refused(address):
    with pytest.raises(UsageError, match=r"opc\.tcp://press:4840"):
        PressReader(address, list, str)


def test_truth_values_and_texts_are_no_numbers():
    event = Event()
    event.add_property("Open", True, ua.VariantType.Boolean)
    event.add_property("Heat", "hot", ua.VariantType.Double)
    cycle, lacking = cycle_of(event, ("Open", "Heat"), "press")
    assert (dict(cycle.numbers), lacking, cycle.at.tzinfo) == ({}, ["Open", "Heat"], UTC)


def test_the_command_adds_each_cycle_once(press, loop, anisoscope, tmp_path):
    place = tmp_path / "history.sqlite"
    moments = (BEGIN + timedelta(seconds=30 * number) for number in range(10_000))

    async def mould():
        while True:
            at = next(moments)
            await press.cycle(SETTINGS, "", at)
            await asyncio.sleep(0.05)

    moulding = asyncio.run_coroutine_threadsafe(mould(), loop.loop)
    try:
        command = ("history", "covariates", "--opcua", press.address, "--machine", "press 3")
        done = anisoscope(*command, "--cycles", "3", "--history", place)
    finally:
        moulding.cancel()
    assert done.code == 0, done.err
    with open_history(place, create=False) as history:
        found = history.covariates()
        assert history.verify_chain() == []
    times = found.times.tolist()
    assert len(times) == len(set(times)) >= 3
    assert set(found.numbers["press 3 CycleTime"].tolist()) == {30_500.0}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cycles.csv", "--opcua", "opc.tcp://a"), "give files or --opcua"),
        (("--cycles", "3"), "--field, --cycles, --certificate, --key and --peers belong to --opcua"),
        (("--opcua", "opc.tcp://a", "--cycles", "0"), "--cycles is at least 1"),
        (("--opcua", "http://a"), "opc.tcp://press:4840"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_a_line(arguments, words, anisoscope, tmp_path):
    done = anisoscope("history", "covariates", *arguments, "--history", tmp_path / "h.sqlite")
    assert done.code != 0
    assert words in done.err
    assert not (tmp_path / "h.sqlite").exists()
