"""What real lines do: two devices with one address, slow answers, line ends of clones, echoes, a feed override."""

import logging
import re
from pathlib import Path

import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import NotConnected, ProtocolError
from anisoscope.rig.drivers import open_stage

ADDRESSED = ("elliptec", "zaber", "smc100")
PAGE = Path(__file__).parents[3] / "docs" / "faults.md"


class Line:
    """A line to a simulated device; what it does to the bytes is added by a subclass."""

    def __init__(self, *devices):
        self.devices = devices

    def __getattr__(self, name):
        return getattr(self.devices[0], name)

    def connect(self):
        for one in self.devices:
            one.connect()

    def write(self, data):
        for one in self.devices:
            one.write(data)

    def read(self):
        return b"".join(one.read() for one in self.devices)


class Echo(Line):
    """Sends back what comes, before the device answers."""

    back = b""

    def write(self, data):
        self.back += data
        super().write(data)

    def read(self):
        back, self.back = self.back, b""
        return back + super().read()


class Loop(Echo):
    """Sends back what comes; no device is there."""

    def read(self):
        back, self.back = self.back, b""
        return back


class Clone(Line):
    """Ends its lines with a line feed only, and writes hex digits of data small."""

    def read(self):
        data = super().read().replace(b"\r\n", b"\n")
        return re.sub(
            rb"(?<=[A-Z]{2})[0-9A-F]{2,}(?=\n)|(?<=:)[0-9A-F]{2}(?=\n)", lambda found: found[0].lower(), data
        )


class Slow(Line):
    """Answers only after a while."""

    def __init__(self, device, delay_s):
        super().__init__(device)
        self.delay_s, self.queue = delay_s, []

    def read(self):
        if answer := super().read():
            self.queue.append((self.clock() + self.delay_s, answer))
        ready = [answer for due, answer in self.queue if due <= self.clock()]
        self.queue = self.queue[len(ready) :]
        return b"".join(ready)


def device(case, **axis):
    return case.firmware(clock=VirtualClock(), **{"time_scale": 0.0, **axis})


@pytest.mark.parametrize("protocol", ADDRESSED)
def test_two_devices_with_one_address_are_noticed(all_cases, in_process, protocol):
    case, clock = all_cases[protocol], VirtualClock()
    pair = [case.firmware(clock=clock) for _ in range(2)]
    with pytest.raises(ProtocolError, match="two devices have this address"):
        case.open(in_process(Line(*pair)))


def test_a_slow_device_is_called_slow(case, in_process):
    line = Slow(device(case), 1.5 * case.driver.get("timeout_s", 0.5))
    with pytest.raises(NotConnected, match=r"is slow: it begins to answer after .* set timeout_s"):
        case.open(in_process(line), **({"reset_s": 0.1} if case.protocol == "grbl" else {}))


def test_lines_of_clones_are_read(case, in_process):
    with case.open(in_process(Clone(device(case)))) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.rules.tolerance_deg)


def test_an_echo_does_not_disturb(case, in_process):
    with case.open(in_process(Echo(device(case)))) as stage:
        stage.home()
        assert stage.move_to(90.0) == pytest.approx(90.0, abs=stage.rules.tolerance_deg)


def test_a_line_that_only_echoes_is_named(case, in_process):
    with pytest.raises(NotConnected, match="comes back: an echo of the adapter, or its two lines touch"):
        case.open(in_process(Loop(device(case))))


class Overridden(Line):
    """A board at which somebody has turned the feed down: its axis is slower, and its reports say so."""

    def read(self):
        return super().read().replace(b"|FS:", b"|Ov:10,100,100|FS:")


def test_a_feed_override_is_no_time_out(all_cases, in_process, caplog):
    case, clock = all_cases["grbl"], VirtualClock()
    board = case.firmware(clock=clock, time_scale=1.0)
    with case.open(in_process(Overridden(board))) as stage:
        stage.home()
        board._planner.slowness = 10.0
        with caplog.at_level(logging.WARNING):
            assert stage.move_to(300.0 if stage.limits_deg[1] > 0 else -300.0)
    assert "the feed override of the board stands at 10 %" in caplog.text


def test_a_long_motion_says_every_eight_seconds_what_is_waited_for(all_cases, in_process, caplog):
    case = all_cases["apt"]
    line = in_process(device(case, start_deg=200.0, time_scale=1.0))
    with open_stage("apt", port=line) as stage, caplog.at_level(logging.WARNING):
        stage.home()
    said = [record.message for record in caplog.records if "has moved for" in record.message]
    assert [re.search(r"for (\d+) s", line)[1] for line in said] == ["8", "16"], said


def test_the_page_of_faults_names_the_line():
    text = PAGE.read_text(encoding="utf-8")
    for word in ("one address", "slow answers", "line feed", "echo", "feed override", "a turn off"):
        assert re.search(rf"^\| .*{word}", text, re.MULTILINE), word
