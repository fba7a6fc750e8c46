"""The tables of devices in docs/faults.md are what the conformance tests expect, fault by fault.

ANISOSCOPE_WRITE_DOCS=1 with -m soak writes them.

Its times are those of the simulated device's clock, with the driver's usual options and the device's usual speed.
"""

import ast
import itertools
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.clock import VirtualClock
from anisoscope.base.errors import RigError
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.opening import Rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import run_plan
from anisoscope.rig.camera import CameraInfo, CameraSettings
from anisoscope.rig.drivers import open_stage
from anisoscope.rig.lights.always_on import AlwaysOn
from anisoscope.rig.rigfile import CameraPart, RigFile, StagePart
from anisoscope.sim.bench.firmware import faults as faults_module
from anisoscope.sim.bench.firmware.faults import FaultKind
from anisoscope.sim.bench.serialports import protocol_sim

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
ACTIONS = ("home", "move", "inspect")
LIMIT_S = 8.0
RIG_ERRORS = (RigError, *RigError.__subclasses__())
# A Grbl board that searches its switches answers nothing: only the time that the search may take at its speed ends it.
# A stepper without an encoder counts the steps that it loses: only a whole turn without a switch shows that it is held.
BEYOND = {("grbl", "slow:100000", "home"), ("apt", "stall", "home")}
# Until the stage stops moving nothing is wrong.
AT_REST = {"stall", "overshoot", "lost-homing", "lost-reply"}
ACTION = re.compile(r"; (calibrate|check|correct|find|home|let|look|lower|remove|send|unpark|wait)\b")
MARK = "<!-- devices: written by tests/rig/stages -->\n"
HEAD = """## What a driver does when its stage fails

This table is written by the tests that check it (`tests/rig/stages`), on every kind of line: in process, pseudo
terminal, TCP. Where a class of error stands, the driver raises it, tells the stage to stop, and closes the port; no
thread is left, and once the fault is gone the next connection works. "goes on": the driver copes, and the angle is
right. A number after the colon is the fault's parameter, as in `anisoscope rig sim zaber --fault stall:47.5`.

`rig home` finds the fault from the beginning, over a way of 200°; `rig move` to 90° and an inspection find it after the
stage was homed, the inspection after its first frame. Class, exit code, and seconds from the command to the error, with
the usual options and speeds; in brackets, seconds since the stage stopped, where nothing was wrong before. Undisturbed
they take {durations}. The error comes at most {limit:.0f} s after the fault, but for two that cannot be seen earlier: a
Grbl board answers nothing while it searches, and may search over 1.5 travels of Z and of the slower of X and Y; a
stepper without an encoder (K10CR1) counts on while something holds it, until it has counted more than a turn. Every
message ends with what to do, and every frame taken before is on disk.

The table has {devices} faults of devices, {lines} of [lines](#the-line) and {cameras} of [cameras](#the-camera).
"""
WIRE = """### The line

What lines do rather than devices, each with a fake in `tests/rig/stages/test_wire.py`, `tests/rig/test_stage.py`.
A device that says nothing is waited for twice as long again, once, to tell a slow one from a silent one. A motion that
takes more than 8 s says every 8 s what is waited for, and how long it may take.

| fault | stages | what the driver does |
|---|---|---|
| two devices with one address | elliptec, smc100, zaber | ProtocolError 69, "answers one question twice" |
| slow answers | all | NotConnected 69, "is slow: it begins to answer after … s", and names `timeout_s` |
| lines that end with a line feed only, small hex digits (clones) | all | goes on |
| echo of the adapter before every answer | all | goes on |
| echo and no answer, or joined lines | all | NotConnected 69, "an echo of the adapter, or its two lines touch" |
| feed override at the board | grbl | goes on, and says so; Grbl 1.1 spares jogs, some descendants do not |
| readings a turn off: 359.997° at zero, 0 for 360 | all that turn | goes on |
"""
CAMERA = """
### The camera

What cameras and their lines do, each with a fake in the test that the last column names (`tests/rig`).

| fault | drivers | what the driver does | test |
|---|---|---|---|
| packets are lost, a frame is late, or of another size or exposure | aravis | takes it again, \
`retries` times; then CameraError 69 | `test_a_frame_that_is_not_right_is_taken_again` |
| no packet of the stream arrives | aravis | CameraError 69, "no packet at all", names firewall, \
reverse-path filter, packet size | `test_a_stream_of_which_nothing_comes_names_what_holds_it_back` |
| the camera goes away and comes back | aravis | within `reconnect_s` goes on with its settings; \
else NotConnected 69 | `test_a_camera_that_went_away_and_came_back_has_its_settings_again` |
| another camera comes in its place | aravis | NotConnected 69 | \
`test_another_camera_in_its_place_is_not_taken` |
| high byte first | aravis, gentl | goes on; of 16 bits CameraError 69, names `big_endian` | \
`test_counts_with_their_high_byte_first` |
| counts above full scale | all | CameraError 69, "left-justified" | \
`test_counts_above_full_scale_are_refused_live` |
| automatic exposure goes on | all | `rig check`, `rig commission`: exit code 3 | \
`test_cameras_that_adjust_themselves` |
"""


def rows_below(text):
    return len(re.findall(r"^\| (?!fault |---)", text, re.MULTILINE))


@dataclass(frozen=True)
class Outcome:
    """What an action ended with: a class of error (the whole message if it advises nothing) or ""; its times."""

    error: str
    exit_code: int
    seconds: float
    text: str = ""
    since_rest_s: float | None = None

    @property
    def late_s(self):
        return self.seconds if self.since_rest_s is None else self.since_rest_s

    def __str__(self):
        rest = "" if self.since_rest_s is None else f" ({self.since_rest_s:.1f} s)"
        return f"{self.error} {self.exit_code}, {self.seconds:.1f} s{rest}" if self.error else "goes on"


class Watch(VirtualClock):
    """A virtual clock that looks, whenever somebody waits, whether an axis still moves."""

    axis, at_deg, moved_s = None, None, -1.0

    def sleep(self, seconds, /):
        super().sleep(seconds)
        if self.axis is not None and (at_deg := self.axis.position(self._now_s)) != self.at_deg:
            self.at_deg, self.moved_s = at_deg, self._now_s


class Eye:
    """A camera of a few pixels; at its second frame the fault sets in."""

    info = CameraInfo("eye", "1", 4, 4, 12, 64.0)

    def __init__(self, begin):
        self._begin, self._frames = begin, 0

    def configure(self, exposure_s, gain):
        return CameraSettings(exposure_s, gain)

    def grab(self):
        self._frames += 1
        if self._frames == 1:
            self._begin()
        return np.full((4, 4), 100, np.uint16)

    def close(self):
        """Nothing is held."""


def held_back(firmware):
    """Take the faults out of a device; gives a function that puts them back."""
    planner = getattr(firmware, "_planner", None)
    places = [(firmware.axis, "stall_at_deg", None), (firmware, "_busy_answers", 0)]
    places += [(planner, "overshoot", 0.0), (planner, "slowness", 1.0)]
    places = [place for place in places if hasattr(place[0], place[1])]
    faults, values = dict(firmware.faults), [getattr(owner, name) for owner, name, _ in places]
    firmware.faults.clear()
    for owner, name, sound in places:
        setattr(owner, name, sound)

    def put_back():
        firmware.faults.update(faults)
        for (owner, name, _), value in zip(places, values, strict=True):
            setattr(owner, name, value)

    return put_back


def outcome_of(case, fault, action, monkeypatch):
    """Outcome of an action on a device with a fault ("" has none), by the clock of the device."""
    clock = Watch()
    firmware = case.firmware(*filter(None, [fault]), time_scale=1.0, clock=clock, start_deg=200.0)
    clock.axis = firmware.axis
    monkeypatch.setattr(protocol_sim, "device_of_url", lambda _: firmware)
    begun = clock()

    def begin(put_back):
        nonlocal begun
        put_back()
        begun = clock()

    try:
        put_back = (lambda: None) if action == "home" else held_back(firmware)
        with open_stage(case.protocol, port="sim://device") as stage:
            begun = clock() if action == "home" else begun
            stage.home()
            if action == "move":
                begin(put_back)
                stage.move_to(90.0)
                stage.position_deg()
            elif action == "inspect":
                inspect(stage, lambda: begin(put_back))
    except RigError as error:
        advised, now = ACTION.search(str(error)) is not None, clock()
        at_rest = fault.partition(":")[0] in AT_REST
        return Outcome(
            type(error).__name__ if advised else str(error),
            error.exit_code,
            now - begun,
            str(error),
            now - max(begun, clock.moved_s) if at_rest else None,
        )
    return Outcome("", 0, clock() - begun)


def inspect(stage, begin):
    """Photograph two poses; an error leaves the frames of before."""
    file = RigFile(
        schema=1,
        name="table",
        stage=StagePart(driver="elliptec", zero_deg=10.0),
        camera=CameraPart(driver="eye", pixel_um=1.0),
        light={"driver": "none"},
    )
    plan = Plan(
        (Pose(0.0, 0.0), Pose(80.0, 0.0)),
        exposure_s=0.01,
        gain=1.0,
        frames_per_pose=1,
        dark_frames=0,
        settle_s=0.0,
    )
    with tempfile.TemporaryDirectory() as folder:
        try:
            run_plan(plan, Rig(stage, Eye(begin), AlwaysOn(lambda _: None), file), Path(folder))
        except RigError:
            kept = {f"frames/{path.name}" for path in Path(folder).glob("frames/*.tif")}
            assert {line.name for line in read_journal(Path(folder)).frames} == kept != set()
            raise


def meanings():
    """The sentence that stands below every member of `FaultKind` in its source."""
    tree = ast.parse(Path(faults_module.__file__).read_text(encoding="utf-8"))
    body = next(
        node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "FaultKind"
    ).body
    found = {}
    for name, text in itertools.pairwise(body):
        if isinstance(name, ast.Assign) and isinstance(text, ast.Expr):
            found[FaultKind(name.value.value)] = text.value.value
    return found


STANDS_STILL = "does not get on"


def cell(case, fault, outcomes):
    expected = case.error_of(fault)
    if expected is None:
        return "–"
    texts = [outcomes[case.protocol, fault, action].text for action in ACTIONS]
    found = [part for part in (expected[1], STANDS_STILL) if any(re.search(part, text) for text in texts)]
    return found[0].replace("|", "\\|")


def row(case, fault, outcomes):
    found = " | ".join(str(outcomes[case.protocol, fault, action]) for action in ACTIONS)
    return f"| {case.protocol} | `{fault}` | {cell(case, fault, outcomes)} | {found} |"


def table_of(cases, outcomes, undisturbed):
    sentences = meanings()
    durations = "; ".join(
        f"{name} {', '.join(f'{found[action].seconds:.1f} s' for action in ACTIONS)}"
        for name, found in undisturbed.items()
    )
    count = sum(len(case.faults) for case in cases.values())
    own = {"devices": count, "lines": rows_below(WIRE), "cameras": rows_below(CAMERA)}
    lines = [HEAD.format(durations=durations, limit=LIMIT_S, **own)]
    head = ["| stage | fault | message has | home | move | inspect |", "|---|---|---|---|---|---|"]
    for kind in FaultKind:
        lines += [f"### {kind}", "", sentences[kind], "", *head]
        for case in cases.values():
            rows = [fault for fault in case.faults if fault.partition(":")[0] == str(kind)]
            lines += [row(case, fault, outcomes) for fault in rows]
            if not rows:
                lines.append(f"| {case.protocol} | – | a device of this protocol cannot have it | | | |")
        lines.append("")
    lines.append(WIRE + CAMERA)
    return "\n".join(lines)


def disturbed(cases, monkeypatch):
    """Outcomes of all actions by protocol and fault, for pairs of a case and its fault; none comes too late."""
    outcomes = {
        (case.protocol, fault, action): outcome_of(case, fault, action, monkeypatch)
        for case, fault in cases
        for action in ACTIONS
    }
    late = {key for key, found in outcomes.items() if found.error and found.late_s > LIMIT_S}
    assert late == BEYOND & outcomes.keys()
    assert {found.error for found in outcomes.values()} <= {"", *(kind.__name__ for kind in RIG_ERRORS)}
    return outcomes


def test_a_third_of_the_page_of_faults_is_true_and_errors_come_in_time(all_cases, monkeypatch):
    some = [(case, fault) for case in all_cases.values() for fault in case.faults][::3]
    outcomes = disturbed(some, monkeypatch)
    rows = PAGE.read_text(encoding="utf-8").splitlines()
    missing = [row(case, fault, outcomes) for case, fault in some if row(case, fault, outcomes) not in rows]
    assert missing == [], (
        f"{PAGE.name} is out of date: run the next test with ANISOSCOPE_WRITE_DOCS=1 and -m soak"
    )


def test_the_page_counts_its_faults_and_names_a_test_of_each(all_cases):
    text = PAGE.read_text(encoding="utf-8")
    assert text.endswith(WIRE + CAMERA)
    devices, line, camera = (
        int(one) for one in re.search(r"(\d+) faults of devices, (\d+) of .*? and (\d+) of", text).groups()
    )
    kinds = {fault for case in all_cases.values() for fault in case.faults}
    assert (
        devices
        == len(re.findall(r"^\| \w+ \| `", text, re.MULTILINE))
        == sum(len(case.faults) for case in all_cases.values())
    )
    assert len(kinds) >= 48
    assert (line, camera) == (7, 7) == (rows_below(WIRE), rows_below(CAMERA))
    tests = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parents[1].rglob("test_*.py"))
    for name in re.findall(r"`(test_\w+)` \|", CAMERA):
        assert f"def {name}(" in tests, name


@pytest.mark.soak
def test_the_page_of_faults_is_true_and_errors_come_in_time(all_cases, monkeypatch):
    undisturbed = {
        name: {action: outcome_of(case, "", action, monkeypatch) for action in ACTIONS}
        for name, case in all_cases.items()
    }
    outcomes = disturbed([(case, fault) for case in all_cases.values() for fault in case.faults], monkeypatch)
    text = table_of(all_cases, outcomes, undisturbed)
    before, _, found = PAGE.read_text(encoding="utf-8").partition(MARK)
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        PAGE.write_text(before + MARK + text, encoding="utf-8")
    elif found != text:
        pytest.fail(f"{PAGE.name} is out of date: run this test with -m soak and ANISOSCOPE_WRITE_DOCS=1")
