"""What happens to a computer during an inspection: nothing that was photographed is lost, and it can be taken up."""

import contextlib
import datetime as dt
import errno
import os
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import NotConnected, RecordError
from anisoscope.record.schema import sha256_of
from anisoscope.rig.acquisition import runner, writer
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.opening import Rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import run_plan
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.lights.always_on import AlwaysOn
from anisoscope.rig.rigfile import CameraPart, RigFile, StagePart
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.elliptec import ElliptecFirmware
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.serialports import protocol_sim
from anisoscope.sim.bench.serve import PtyServer

PLAN = Plan(tuple(Pose(angle, 0.0) for angle in (0.0, 40.0, 80.0)), exposure_s=0.01, dark_frames=2)
STAGE = StagePart(driver="elliptec", zero_deg=10.0)
FILE = RigFile(
    schema=1, name="disturbed", stage=STAGE, camera=CameraPart(driver="eye", pixel_um=1.0), light={}
)


class Eye:
    """A camera of a few pixels that does something at one of its frames."""

    info = CameraInfo("eye", "1", 4, 4, 12, 64.0)

    def __init__(self, at=0, action=lambda: None):
        self._at, self._action, self.frames = at, action, 0

    def configure(self, exposure_s, gain):
        return CameraSettings(exposure_s, gain)

    def grab(self):
        self.frames += 1
        if self.frames == self._at:
            self._action()
        return np.full((4, 4), 100 + self.frames, np.uint16)

    def close(self):
        """Nothing is held."""


def photograph(port, folder, eye):
    """Carry the plan out on a stage at a port, as far as it is not done in the folder."""
    with open_stage("elliptec", port=port, move_gap_s=0.0, timeout_s=5.0) as stage:
        return run_plan(PLAN, Rig(stage, eye, AlwaysOn(lambda _: None), FILE), folder)


def check_frames(folder, steps):
    """So many steps of the plan have their frame, and every frame of the journal is on disk as it was taken."""
    lines = read_journal(folder).frames
    assert len({line.step for line in lines if line.step is not None}) == steps
    assert all(sha256_of(folder / line.name) == line.sha256 for line in lines)
    assert {line.name for line in lines} <= {f"frames/{path.name}" for path in folder.glob("frames/*.tif")}


@pytest.fixture
def port():
    with PtyServer(ElliptecFirmware(RotaryAxis(time_scale=0.0))) as server:
        yield server.port


def test_a_disk_that_fills_during_an_inspection_loses_nothing_and_can_be_emptied(port, tmp_path, monkeypatch):
    write, written = writer.write_frame, []

    def fill(frame, path, packing):
        written.append(path)
        if len(written) > 3:
            path.write_bytes(b"half a frame")
            raise RecordError(f"cannot write {path}: {os.strerror(errno.ENOSPC)}")
        write(frame, path, packing)

    with monkeypatch.context() as patch:
        patch.setattr(writer, "write_frame", fill)
        with pytest.raises(RecordError, match="No space left"):
            photograph(port, tmp_path, Eye())
    check_frames(tmp_path, 3)
    photograph(port, tmp_path, Eye())
    check_frames(tmp_path, PLAN.frame_count)


class SetBack(dt.datetime):
    """The wall clock, which is set back by an hour while the plan is carried out."""

    back = dt.timedelta()

    @classmethod
    def now(cls, tz=None):
        return dt.datetime.now(tz) - cls.back


def test_a_clock_set_back_by_an_hour_disturbs_nothing(port, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "datetime", SetBack)
    monkeypatch.setattr(SetBack, "back", dt.timedelta())

    def set_back():
        SetBack.back = dt.timedelta(hours=1)

    photograph(port, tmp_path, Eye(3, set_back))
    check_frames(tmp_path, PLAN.frame_count)
    times = [line.captured_at for line in read_journal(tmp_path).frames]
    assert times != sorted(times), "it was set back"
    photograph(port, tmp_path, eye := Eye())
    assert eye.frames == 0, "all was done, in the order of the steps"


@pytest.mark.parametrize("name", ["link", "usb"])
def test_a_device_that_comes_back_under_another_name_is_found_again(tmp_path, monkeypatch, name):
    """As a USB adapter does: /dev/ttyUSB1 instead of 0; the link of /dev/serial/by-id follows, or its serial number."""
    firmware = ElliptecFirmware(RotaryAxis(time_scale=0.0))
    folder, link = tmp_path / "inspection", tmp_path / "by-id"
    port = str(link) if name == "link" else "usb:DK0A1B2C"
    with PtyServer(firmware) as server:
        first = server.port

        def appear():
            link.unlink(missing_ok=True)
            link.symlink_to(server.port)
            found = SimpleNamespace(
                device=server.port, vid=0x0403, pid=0x6015, serial_number="DK0A1B2C", location=None
            )
            monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [found])

        def unplug():
            firmware.faults[FaultKind.HANGUP] = 0.0

        appear()
        with pytest.raises(NotConnected, match=r"check the cable and the power"):
            photograph(port, folder, Eye(4, unplug))
        check_frames(folder, 4)
        while server.port == first:
            pass
        appear()
        photograph(port, folder, Eye())
    check_frames(folder, PLAN.frame_count)


@pytest.mark.parametrize("protocol", ["apt", "elliptec", "grbl", "smc100", "zaber"])
def test_a_computer_that_sleeps_during_a_motion_finds_it_done(protocol, monkeypatch):
    """The device goes on meanwhile, and the time limit of the motion is long over."""
    clock = VirtualClock()
    firmware = build(protocol, [Mount(RotaryAxis(clock=clock))])
    monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
    with open_stage(protocol, port="sim://device") as stage:
        stage.home()
        busy, slept = stage._is_busy, []

        def sleep_once(wait_s):
            going = busy(wait_s)
            if going and not slept:
                slept.append(clock.sleep(3600.0))
            return going

        monkeypatch.setattr(stage, "_is_busy", sleep_once)
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.rules.tolerance_deg)
        assert slept
        with contextlib.suppress(NotConnected):
            assert stage.position_deg() == pytest.approx(90.0, abs=stage.rules.tolerance_deg)
