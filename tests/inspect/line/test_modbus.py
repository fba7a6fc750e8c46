"""The handshake over Modbus/TCP, against pymodbus's own server."""

import asyncio
import threading

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from anisoscope.line.modbus import Addresses, Handshake, Lines, ModbusIo

READY, BUSY = Lines(ready=True), Lines(busy=True)


class Plc:
    """A controller: pymodbus's server, and what its program reads and sets."""

    def __init__(self):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()
        self.number = None
        self.port = 0
        self.start()

    def do(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(60)

    def start(self):
        async def begin():
            bits, words = (
                SimData(0, count=16, values=False, datatype=DataType.BITS),
                SimData(0, count=16, values=0, datatype=DataType.REGISTERS),
            )
            device = SimDevice(1, simdata=([bits], [bits], [words], [words]))
            self.server = ModbusTcpServer(device, address=("127.0.0.1", self.port))
            await self.server.listen()
            return self.server.transport.sockets[0].getsockname()[1]

        self.port = self.do(begin())

    def stop(self):
        self.do(self.server.shutdown())

    def trigger(self, number):
        self.number = number
        if number is not None:
            self.do(self.server.async_setValues(1, 3, 0, [number >> 16, number & 0xFFFF]))
        self.do(self.server.async_setValues(1, 2, 0, [number is not None]))

    def outputs(self):
        return Lines(*map(bool, self.do(self.server.async_getValues(1, 1, 0, 5))[:5]))

    def close(self):
        self.stop()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


@pytest.fixture
def plc():
    found = Plc()
    yield found
    found.close()


@pytest.fixture
def io(plc):
    found = ModbusIo("127.0.0.1", plc.port, Addresses())
    yield found
    found.close()


@pytest.fixture
def handshake(io, place_of, jobs_at):
    def make(name, recipe="plate", prefix="A-"):
        jobs, _ = jobs_at(*place_of(name))
        said = []
        return Handshake(io, jobs, recipe, prefix, said.append), jobs, said

    return make


def test_a_part_from_trigger_to_result(plc, handshake):
    shake, jobs, said = handshake("modbus")
    assert shake.step() == READY == plc.outputs()
    plc.trigger(70_001)
    assert shake.step() == BUSY == plc.outputs()
    assert jobs.wait(600)
    assert shake.step() == Lines(passed=True) == plc.outputs()
    plc.stop()  # a cut while the result stands: the next one that comes sees the same
    assert shake.step() is None
    assert "does not answer" in said[-1] or "no controller answers" in said[-1]
    plc.start()
    plc.trigger(70_001)
    assert shake.step() == Lines(passed=True)
    plc.trigger(None)
    assert shake.step() == READY == plc.outputs()
    assert [(job.id, job.order.serial) for job in jobs.all()] == [("modbus-A-70001", "A-70001")]


def test_a_job_that_cannot_be_done_sets_invalid_and_is_told_once(plc, handshake):
    shake, jobs, said = handshake("modbus refused", recipe="other")
    plc.trigger(1)
    assert shake.step() == Lines(invalid=True) == shake.step()
    assert len(said) == 1
    assert "there is no recipe 'other'" in said[0]
    plc.trigger(None)
    assert shake.step() == READY
    assert jobs.all() == []


def test_another_address_is_named(plc, place_of, jobs_at):
    io = ModbusIo("127.0.0.1", plc.port, Addresses(trigger=99))
    jobs, _ = jobs_at(*place_of("modbus address"))
    said = []
    assert Handshake(io, jobs, "plate", "", said.append).step() is None
    assert "check --trigger" in said[0]
    io.close()


def test_the_lines_are_coils_that_any_client_reads(plc, io):
    io.write(Lines(busy=True, invalid=True))
    client = ModbusTcpClient("127.0.0.1", port=plc.port)
    assert client.connect()
    assert client.read_coils(0, count=5).bits[:5] == [False, True, False, False, True]
    client.close()
