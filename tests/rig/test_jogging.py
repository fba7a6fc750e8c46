"""Jogging: keys of a terminal, steps of axes, and events of a game pad."""

import os
import threading

import pytest

from anisoscope.base.errors import LimitExceeded, NotConnected, RigError, UsageError
from anisoscope.rig import jogging
from anisoscope.rig.jogging import Gamepad, Jogger, Step, commands_of

PATIENCE_S = 60.0


class Axis:
    """An axis whose motions end when the test says so."""

    name, resolution_deg, is_homed = "axis", 0.001, True

    def __init__(self, at=0.0, limits=(0.0, 360.0), unit="deg", *, waits=False):
        self.at, self.limits_deg, self.unit = at, limits, unit
        self.targets, self.stops = [], 0
        self.began, self.may_end = threading.Semaphore(0), threading.Semaphore(0)
        self._waits = waits

    def position_deg(self):
        return self.at

    def move_to(self, target):
        self.targets.append(target)
        self.began.release()
        if self._waits:
            assert self.may_end.acquire(timeout=PATIENCE_S)
            if self.stops:
                raise RigError("the motion was stopped")
        self.at = target
        return target

    def stop(self):
        self.stops += 1
        self.may_end.release()


def wait_for(axis, motions=1):
    for _ in range(motions):
        assert axis.began.acquire(timeout=PATIENCE_S)


def test_keys_are_those_of_terminals():
    data = b"\x1b[C\x1bOA\x1b[5~xd+ \x1b[1;5Cq"
    assert list(commands_of(data)) == [
        Step("stage", 1),
        Step("tilt", 1),
        Step("z", 1),
        Step("x", 1),
        "coarser",
        "stop",
    ]


def test_steps_move_axes_round_and_along():
    stage, z = Axis(at=359.5), Axis(at=5.0, limits=(0.0, 10.0), unit="mm")
    with Jogger({"stage": stage, "z": z}) as jogger:
        jogger.do(Step("stage", 1))  # goes on at 0
        wait_for(stage)
        jogger.do("coarser")
        jogger.do(Step("z", -1))
        wait_for(z)
    assert (stage.targets, z.targets) == ([pytest.approx(0.5)], [4.0])
    assert jogger.state() == "stage 0.5°, z 4 mm; ± 5° 1 mm"


def test_of_what_waits_the_newest_alone_is_done():
    stage = Axis(at=100.0, waits=True)
    with Jogger({"stage": stage}) as jogger:
        jogger.do(Step("stage", 1))
        wait_for(stage)
        for sign in (1, 1, -1):
            jogger.do(Step("stage", sign))
        stage.may_end.release()
        wait_for(stage)
        assert stage.targets == [101.0, 100.0]


def test_stop_reaches_a_motion_and_forgets_what_waits():
    stage = Axis(at=100.0, waits=True)
    with Jogger({"stage": stage}) as jogger:
        jogger.do(Step("stage", 1))
        wait_for(stage)
        jogger.do(Step("stage", 1))
        jogger.do("stop")
        assert stage.stops == 1
    assert stage.targets == [101.0]
    assert stage.at == 100.0
    assert "the motion was stopped" in jogger.state()


def test_limits_and_missing_axes_are_said():
    tilt = Axis(at=9.5, limits=(0.0, 10.0))
    with Jogger({"tilt": tilt}) as jogger:
        jogger.do(Step("z", 1))
        assert "the rig has no axis z" in jogger.state()
        jogger.do("finer")
        for _ in range(9):
            jogger.do("coarser")  # to the largest
        assert jogger.step_of("tilt") == 15.0
        with pytest.raises(LimitExceeded, match="nothing was moved"):
            jogger._move(Step("tilt", 1))
    assert tilt.targets == []


# Events in the layout of the kernel's struct input_event on 64-bit machines, written by hand: no pad was recorded.
# Stick right, back to the middle; hat up, back; shoulder right; button A.
EVENTS = bytes.fromhex(
    "a1f05065000000001027000000000000" "03000000ff7f0000"
    "a1f05065000000001027000000000000" "0000000000000000"
    "a1f0506500000000204e000000000000" "0300000000010000"
    "a1f05065000000003075000000000000" "03001100ffffffff"
    "a1f0506500000000409c000000000000" "0300110000000000"
    "a1f050650000000050c3000000000000" "0100370101000000"
    "a1f050650000000060ea000000000000" "0100370100000000"
    "a1f0506500000000701101000000000" + "0" "0100300101000000"
)  # fmt: skip


@pytest.fixture
def piped():
    """A pipe in place of a device: write what comes, and read as a game pad."""
    theirs, ours = os.pipe()
    pad = Gamepad(f"/dev/fd/{theirs}")
    yield pad, ours
    pad.close()
    os.close(theirs)


def test_recorded_events_of_a_pad_become_steps(piped):
    pad, ours = piped
    os.write(ours, EVENTS)
    os.close(ours)
    assert jogging.EVENT.size == 24
    found = list(pad.commands(threading.Event()))
    assert found == [
        "stop",
        "stop",
        "coarser",
        "stop",
        "stop",
    ]  # both are back in the middle; the end of the file


def test_a_stick_that_is_held_steps_until_it_is_back(piped):
    pad, ours = piped
    os.write(ours, EVENTS[:24])
    commands, ended = pad.commands(threading.Event()), []
    assert [next(commands) for _ in range(3)] == [Step("stage", 1)] * 3
    os.write(ours, EVENTS[48:72])
    while next(commands) != "stop":
        ended.append(1)
    os.write(ours, EVENTS[72:90])  # an event in two parts
    os.write(ours, EVENTS[90:96])
    assert next(commands) == Step("tilt", 1)
    os.close(ours)


def test_a_pad_that_is_not_there(tmp_path, monkeypatch):
    with pytest.raises(NotConnected, match=r"game pad .*no-pad: No such file or directory; on Linux join"):
        Gamepad(tmp_path / "no-pad")
    monkeypatch.setattr(jogging, "INPUTS", tmp_path)
    with pytest.raises(UsageError, match=r"one game pad is needed, .* shows none"):
        Gamepad.find()
    for name in ("usb-a-event-joystick", "usb-b-event-joystick"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(UsageError, match=r"there are .*usb-a-event-joystick, "):
        Gamepad.find()
    (tmp_path / "usb-b-event-joystick").unlink()
    found = Gamepad.find()
    assert list(found.commands(threading.Event())) == ["stop"]
    found.close()
    found.close()
