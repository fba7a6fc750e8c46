"""The driver against the firmware: in this process, on a pseudo terminal, on TCP."""

import time

import pytest

from anisoscope.base.errors import (
    LimitExceeded,
    ProtocolError,
    RigError,
)
from anisoscope.rig.stages.elliptec import (
    Answer,
    DeviceInfo,
    Elliptec,
    counts_from_hex,
    counts_to_hex,
    error_of_status,
)
from anisoscope.rig.transport import Transport
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.device import Bus
from anisoscope.sim.bench.firmware.elliptec import ELL8, ElliptecFirmware, ElliptecModel

HURRY = {"timeout_s": 0.15, "move_gap_s": 0.0, "margin_s": 0.15, "velocity_deg_s": 4000.0}
COUNT_DEG = 360 / 143360


def firmware_with(*faults, time_scale=0.0, **options):
    return ElliptecFirmware(RotaryAxis(time_scale=time_scale), faults=faults, **options)


def test_the_scale_comes_from_the_device(in_process):
    firmware = firmware_with(model=ELL8)
    with Elliptec.open(in_process(firmware), **HURRY) as stage:
        stage.home()
        stage.move_to(90.0)
        assert firmware.counts == 65536
        assert stage.resolution_deg == 360 / 262144


def test_settings(in_process):
    with Elliptec.open(in_process(firmware_with()), **HURRY) as stage:
        assert stage.velocity_percent() == 100
        assert stage.status() == 0


def test_the_pause_between_moves_is_kept(in_process):
    with Elliptec.open(in_process(firmware_with()), **(HURRY | {"move_gap_s": 0.1})) as stage:
        stage.home()
        start = time.monotonic()
        stage.move_to(10.0)
        assert time.monotonic() - start >= 0.09


def test_two_stages_share_a_line(in_process):
    first, second = firmware_with(address="0"), firmware_with(address="B")
    with Transport(in_process(Bus(first, second))) as line:
        stages = [Elliptec(line, address=address, **HURRY) for address in "0B"]
        for stage, angle in zip(stages, (10.0, 20.0), strict=True):
            stage.home()
            stage.move_to(angle)
        stages[0].close()
        assert stages[1].position_deg() == pytest.approx(20.0, abs=COUNT_DEG)


def test_what_is_no_rotation_stage(in_process):
    with pytest.raises(ProtocolError, match="ELL20 is a linear stage; name the port of a rotation"):
        Elliptec.open(in_process(firmware_with(model=ElliptecModel(number=20))), **HURRY)
    with pytest.raises(ProtocolError, match="0 counts"):
        Elliptec.open(in_process(firmware_with(model=ElliptecModel(pulses=0, number=14))), **HURRY)
    with pytest.raises(RigError, match="not an Elliptec address"):
        Elliptec.open(in_process(firmware_with()), address="Z")


def test_real_information():
    info = DeviceInfo.parse(Answer.parse(b"2IN0E1140051720231701016800023000\r\n").data)
    assert (info.model, info.serial, info.year, info.travel_deg) == (14, "11400517", "2023", 360)
    assert info.pulses == 143360


@pytest.mark.parametrize("line", [b"\r\n", b"0PO123\r\n", b"PO00000000\r\n", b"0XX00\r\n", b"\xff\xfe\r\n"])
def test_damaged_lines_are_no_answers(line):
    assert Answer.parse(line) is None


@pytest.mark.parametrize("counts", [0, -1, 143360, -(1 << 31), (1 << 31) - 1])
def test_positions_are_signed(counts):
    assert counts_from_hex(counts_to_hex(counts)) == counts


def test_positions_beyond_32_bits_are_refused():
    with pytest.raises(LimitExceeded):
        counts_to_hex(1 << 31)


def test_every_status_is_an_error_of_one_line():
    for status in range(1, 256):
        error = error_of_status("stage", status, "moving")
        assert isinstance(error, RigError)
        assert "\n" not in str(error)
