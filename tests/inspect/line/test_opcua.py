"""The server of OPC 40100-1 against its NodeSet and asyncua's client: states, arguments, results, refusals, faults.

The states in docs/interfaces.md are what `test_every_transition_under_every_fault` (soak) finds, and writes with
ANISOSCOPE_WRITE_DOCS=1.
"""

import asyncio
import importlib.util
import itertools
import json
import os
import re
import socket
import threading
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import tomli_w
from asyncua import ua
from asyncua.ua.uaerrors import UaError

from anisoscope.base.errors import CameraError, RigError, UsageError
from anisoscope.history.store import open_history
from anisoscope.inspection.work import WorkerHere
from anisoscope.line import opcua, opcua_types
from anisoscope.line.jobs import Jobs
from anisoscope.line.opcua import METHODS, STATES, STEPS, VisionServer
from anisoscope.sim.bench.camera import SimulatedCamera, SimulatedLight

SPEC = importlib.util.spec_from_file_location("controller", Path(__file__).with_name("controller.py"))
CONTROLLER = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(CONTROLLER)
Controller, Loop, content = (
    CONTROLLER.Controller,
    CONTROLLER.Loop,
    CONTROLLER.content,
)
RESULT_READY, READY, JOB_STARTED, STATE_CHANGED = 1024, 1023, 1013, 1018
ERROR_EVENT, RECIPE_PREPARED, INFORMATION = 1019, 1022, 1038
PAGE = Path(__file__).parents[3] / "docs" / "interfaces.md"
UA = {"ua": "http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"}
OUTER = dict.fromkeys(opcua.OPERATIONAL, "Operational")
NOTHING = ua.Variant(0, ua.VariantType.Int32)
CAUSE = (NOTHING, ua.Variant("", ua.VariantType.String))


@pytest.fixture(scope="module")
def loop():
    made = Loop()
    yield made
    made.close()


class Gate:
    """What the camera does at a job's third frame: nothing, wait, or fail."""

    def __init__(self):
        self.reached, self.go, self.fault = threading.Event(), threading.Event(), None
        self.at_work, self.count = False, 0

    def hold(self):
        self.at_work, self.count, self.fault = True, 0, None
        self.reached.clear()
        self.go.clear()

    def let_go(self):
        self.at_work = False
        self.go.set()

    @property
    def grabbing(self):
        """What takes the place of the camera's method."""
        return lambda camera: self.grab(camera)  # noqa: PLW0108 - a function becomes a method

    def grab(self, camera):
        self.count += 1
        if self.at_work and self.count == 3:
            self.reached.set()
            self.go.wait(600)
        if self.fault is not None:
            raise self.fault
        return _GRAB(camera)


_GRAB = SimulatedCamera.grab


@pytest.fixture(scope="module")
def gate():
    found = Gate()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedCamera, "grab", found.grabbing)
        yield found


@pytest.fixture(scope="module")
def stopping():
    """What the axes say when they are stopped, by table."""
    return {}


@pytest.fixture(scope="module")
def place(place_of):
    return place_of("opcua")


@pytest.fixture(scope="module")
def server(place, loop, gate, stopping):
    journal = place[0].out / "line" / "jobs.jsonl"
    journal.parent.mkdir(parents=True)
    order = {"job": "K-1", "recipe": "plate", "serial": "K"}
    line = {"line": "accepted", "at": "2026-01-01T00:00:00+00:00", "job": "K-1", "order": order}
    journal.write_text(json.dumps(line) + "\n")  # of a server that was killed
    jobs = Jobs(*place, WorkerHere(place[0]), lambda: dict(stopping), "S1")
    made = VisionServer(jobs, place[1], port=CONTROLLER.free_port())
    gate.hold()
    loop(made.__aenter__())
    assert gate.reached.wait(600)
    made.at_first = made.state
    gate.let_go()
    yield made
    gate.let_go()
    loop(made.__aexit__())


@pytest.fixture(scope="module")
def controller(server, loop):
    made = Controller(server.address)
    loop(made.__aenter__())
    yield made
    loop(made.__aexit__())


@pytest.fixture
def at(server, controller, loop, gate, stopping):
    """``at(state)``: brings the machine into a state by the calls of the specification."""

    def bring(state):
        gate.fault = None
        stopping.clear()
        gate.let_go()
        assert server._jobs.wait(600)
        loop(server._heard.join())
        if server.state != "Preoperational":
            loop(controller.call("Reset", *CAUSE))
        if state == "Preoperational":
            return
        if state == "Halted":
            loop(controller.call("Halt", *CAUSE))
            return
        loop(controller.call("SelectModeAutomatic"))
        if state in {"Ready", "SingleExecution", "Error"}:
            loop(controller.prepare("plate"))
        if state == "SingleExecution":
            gate.hold()
            loop(controller.start("X-1"))
            assert gate.reached.wait(600)
        if state == "Error":
            gate.fault = CameraError("the cable came off")
            loop(controller.start("X-1"))
            assert server._jobs.wait(600)
            loop(server._heard.join())
            gate.fault = None
        assert server.state == state
        while not controller.heard.empty():
            controller.heard.get_nowait()

    return bring


def nodes_of_nodeset():
    return {
        node.get("NodeId"): node
        for node in ET.parse(opcua_types.NODESET).getroot()
        if node.get("NodeId") is not None
    }


def test_every_step_is_a_way_of_transitions_of_the_nodeset():
    nodes = nodes_of_nodeset()
    named = {}
    for node in nodes.values():
        if node.get("ParentNodeId") in {"ns=1;i=1017", "ns=1;i=1021"}:
            found = {}
            for reference in node.find("ua:References", UA):
                if reference.get("IsForward") != "false":
                    target = nodes.get(reference.text)
                    name = reference.text if target is None else target.get("BrowseName").split(":")[-1]
                    found.setdefault(reference.get("ReferenceType"), []).append(name)
            named[node.get("BrowseName").split(":")[-1]] = found
    for (state, on), step in STEPS.items():
        if not step.transitions:
            assert (state, on, step.to) == ("Ready", "PrepareRecipe", "Ready")
            continue
        ways = [named[transition] for transition in step.transitions]
        assert ways[0]["FromState"][0] in {state, OUTER.get(state)}
        assert ways[-1]["ToState"][0] in {step.to, OUTER.get(step.to)}
        for one, following in itertools.pairwise(ways):
            assert one["ToState"] == following["FromState"]
        causes = [cause for way in ways for cause in way.get("HasCause", [])]
        assert causes == ([] if on in {"done", "failed", "resumed"} else causes)
        if on in METHODS:
            assert causes == [on]


def test_a_job_by_the_specification(place, server, controller, loop, at):
    at("Initialized")
    assert loop(controller.states()) == ("Operational", "Initialized")
    internal, complete, error = loop(controller.prepare("plate"))
    assert (internal.Id, complete, error) == ("plate", True, 0)
    assert loop(controller.next(RECIPE_PREPARED)).ExternalId.Id == "plate"
    job, error = loop(controller.start("B-1", "M-1", parameters=["lot=L7", "cavity=2"]))
    assert (job.Id, error) == ("M-1", 0)
    assert loop(controller.next(JOB_STARTED)).JobId.Id == "M-1"
    event = loop(controller.next(RESULT_READY))
    assert loop(controller.next(READY)).JobId.Id == "M-1"
    assert loop(controller.states()) == ("Operational", "Ready")
    verdict, code, all_of_it = content(event.ResultContent)
    record = server._jobs.record("M-1")
    assert (verdict, code, event.ResultState) == (record.verdict, 0, 1) == ("PASS", 0, 1)
    assert (event.PartId.Id, event.JobId.Id, event.ExternalRecipeId.Id) == ("B-1", "M-1", "plate")
    with open_history(place[0].history, create=False) as history:
        (row,) = [row for row in history.rows() if row.serial == "B-1"]
    assert all_of_it["numbers"] == pytest.approx(row.numbers, rel=1e-6)  # the history keeps seven digits
    assert (row.lot, row.cavity, row.station) == ("L7", "2", "S1")
    assert Path(all_of_it["links"]["report"].removeprefix("file://")).name == "report.html"
    assert loop(controller.result("M-1")) == (verdict, code, all_of_it)
    complete, count, _, (listed,), error = loop(controller.results("M-1"))
    assert (complete, count, listed.ResultId.Id, listed.ResultState, error) == (True, 1, "M-1", 1, 0)
    again, error = loop(controller.start("B-1", "M-1", parameters=["lot=L7", "cavity=2"]))
    assert (again.Id, error) == ("M-1", 0)  # the answer was lost: no second job
    assert server.state == "Ready"
    _, error = loop(controller.start("B-2", "M-1"))
    assert error == -3
    assert len(list(place[0].out.glob("B-*"))) == 1


async def said(controller, words):
    """Wait until it is said in an event; fails with what was said instead."""
    heard = []
    try:
        async with asyncio.timeout(60):
            while not heard or re.search(words, heard[-1]) is None:
                heard.append((await controller.next(INFORMATION)).Message.Text)
    except TimeoutError:
        pytest.fail(f"{words!r} was not said, but {heard}")
    return True


def variant(value, kind, **more):
    return ua.Variant(value, ua.VariantType[kind], **more)


WRONG = {
    "strings for ids": ("PrepareRecipe", lambda: [variant(["plate"], "String")] * 2),
    "a string for an id": ("PrepareRecipe", lambda: [variant("plate", "String")] * 2),
    "the internal id for the external one": (
        "PrepareRecipe",
        lambda: [ua.RecipeIdInternalDataType(Id="plate"), ua.RecipeIdInternalDataType()],
    ),
    "one of two": ("PrepareRecipe", lambda: [ua.RecipeIdExternalDataType(Id="plate")]),
    "one too many": ("SelectModeAutomatic", lambda: [variant(1, "Int32")]),
    "a cause of another size": ("Halt", lambda: [variant(1, "Int64"), variant("", "String")]),
    "a list of causes": ("Halt", lambda: [variant([1], "Int32"), variant("", "String")]),
    "no array": (
        "StartSingleJob",
        lambda: [
            ua.MeasIdDataType(),
            ua.PartIdDataType(Id="A"),
            ua.RecipeIdExternalDataType(),
            ua.ProductIdDataType(),
            variant("lot=1", "String"),
        ],
    ),
    "a part for a measurement": ("GetResultById", lambda: [ua.PartIdDataType(Id="A"), NOTHING]),
}


@pytest.mark.parametrize("case", WRONG)
def test_arguments_of_other_types_are_refused_and_change_nothing(case, server, controller, loop, at):
    at("Initialized")
    name, arguments = WRONG[case]
    with pytest.raises(UaError, match=r"BadInvalidArgument|BadArgumentsMissing|BadTooManyArguments"):
        loop(controller.call(name, *arguments()))
    assert server.state == "Initialized"


@pytest.mark.parametrize(
    ("asked", "code", "words"),
    [
        ({"recipe": "other"}, -1, "StartSingleJob: recipe 'other' is not prepared; plate is"),
        ({"serial": "=1+1"}, -2, "serial number '=1\\+1' cannot be used"),
        ({"serial": ""}, -2, "cannot be used"),
        ({"product": "spoon"}, -5, "product 'spoon'"),
        ({"parameters": ["colour=red"]}, -5, "parameter 'colour=red'"),
        ({"parameters": [7]}, -5, "parameter '7'"),
        ({"meas": "a\nb"}, -5, r"job: 'a\\nb' holds a sign that cannot be seen"),
    ],
)
def test_orders_that_do_not_fit_are_refused_in_words(asked, code, words, place, server, controller, loop, at):
    at("Ready")
    before = len(server._jobs.all())
    _, error = loop(controller.start(**({"serial": "A"} | asked)))
    assert error == code
    assert loop(said(controller, words))
    assert (server.state, len(server._jobs.all())) == ("Ready", before)
    assert opcua.SAYS[code]


def test_recipes_and_configurations_are_named(place, server, controller, loop, at):
    at("Initialized")
    mapped = place[1] / "mapped.toml"
    table = tomllib.loads((place[1] / "plate.toml").read_text())
    table["surface"] = {"pitch_um": 100.0, "height_map": "gone.x3p"}
    mapped.write_text(tomli_w.dumps(table))
    for call, code, words in (
        (lambda: controller.prepare("no such"), -1, "there is no recipe 'no such'"),
        (lambda: controller.prepare("mapped"), -1, "gone.x3p: there is no such file"),
        (
            lambda: controller.call("ActivateConfiguration", ua.ConfigurationIdDataType(Id="x")),
            -8,
            "configuration",
        ),
        (lambda: controller.call("GetResultById", ua.ResultIdDataType(Id="x"), NOTHING), -8, "result 'x'"),
        (
            lambda: controller.call(
                "PrepareRecipe",
                ua.RecipeIdExternalDataType(Id="plate", Hash=b"1"),
                ua.RecipeIdInternalDataType(),
            ),
            -1,
            "another hash",
        ),
    ):
        assert loop(call())[-1] == code
        assert loop(said(controller, words))
    mapped.unlink()
    numbers = variant(0, "UInt32"), variant(0, "UInt32"), NOTHING
    filters = ua.RecipeIdExternalDataType(), ua.ProductIdDataType(), variant(2, "Int32")
    complete, count, _, ids, error = loop(controller.call("GetRecipeListFiltered", *filters, *numbers))
    assert (complete, count, [one.Id for one in ids], error) == (True, 1, ["plate"], 0)
    _, _, _, (one,), _ = loop(controller.call("GetConfigurationList", *numbers))
    assert one.InternalId.Id == "rig.toml"
    assert loop(controller.call("ActivateConfiguration", one.InternalId)) == [0]
    loop(controller.prepare("plate"))
    recipe = place[1] / "plate.toml"
    text = recipe.read_text()
    recipe.write_text(text + "\n# changed\n")
    try:
        assert loop(controller.start("A"))[-1] == -1
        assert loop(said(controller, "changed since"))
    finally:
        recipe.write_text(text)
    assert loop(controller.call("StartContinuous", *_start_arguments()))[-1] == -7


def _start_arguments(serial="A-7"):
    array = ua.Variant([], ua.VariantType.Variant, is_array=True)
    return (
        ua.MeasIdDataType(),
        ua.PartIdDataType(Id=serial),
        ua.RecipeIdExternalDataType(),
        ua.ProductIdDataType(),
        array,
    )


def test_a_second_client_is_refused_while_a_job_runs(server, controller, loop, at, gate):
    at("SingleExecution")

    async def order():
        async with Controller(server.address) as other:
            with pytest.raises(UaError, match="BadInvalidState"):
                await other.start("Y-1")
            with pytest.raises(UaError, match="BadInvalidState"):
                await other.prepare("plate")

    loop(order())
    gate.let_go()
    assert loop(controller.next(RESULT_READY)).PartId.Id == "X-1"
    loop(controller.next(READY))


def test_a_job_that_a_killed_server_left_is_at_work_again(place, server, at):
    at("Initialized")
    assert server.at_first == "SingleExecution"
    assert server._jobs.job("K-1").verdict == "PASS"
    assert len(list(place[0].out.glob("K-*/record.json"))) == 1


def test_other_nodesets_are_refused(place, loop, tmp_path):
    text = opcua_types.NODESET.read_text()
    files = {
        "other.xml": (
            text.replace(opcua_types.NAMESPACE, "http://opcfoundation.org/UA/DI/"),
            "not the NodeSet of",
        ),
        "torn.xml": (text[:20000], "damaged"),
        "missing.xml": (None, "cannot be read"),
    }
    for name, (content_, words) in files.items():
        if content_ is not None:
            (tmp_path / name).write_text(content_)

        async def enter(name=name):
            await VisionServer(None, place[1], nodeset=tmp_path / name).__aenter__()

        with pytest.raises(UsageError, match=words) as refused:
            loop(enter())
        assert "\n" not in str(refused.value)


def test_the_licence_of_the_nodeset_goes_with_it():
    head = opcua_types.NODESET.read_text()[:2000]
    assert "OPC Foundation MIT License 1.00" in head
    assert "The above copyright notice and this permission notice shall be" in head


# Every transition under every fault.

FAULTS = {
    "stage: silent": "stage",
    "stage: stall": "stage",
    "camera: no frame": "camera",
    "light: fails": "light",
}
CALLS = {
    "SelectModeAutomatic": tuple,
    "PrepareRecipe": lambda: (ua.RecipeIdExternalDataType(Id="plate"), ua.RecipeIdInternalDataType()),
    "UnprepareRecipe": lambda: (ua.RecipeIdExternalDataType(Id="plate"), ua.RecipeIdInternalDataType()),
    "StartSingleJob": _start_arguments,
    "StartContinuous": _start_arguments,
    "Stop": lambda: CAUSE,
    "Abort": lambda: CAUSE,
    "Halt": lambda: CAUSE,
    "Reset": lambda: CAUSE,
}


class Faults:
    """Breaks the virtual rig; the stage by what is written in its bench file, which is read when it is opened."""

    def __init__(self, place, gate, stopping, patch):
        self.rig, self.gate, self.stopping, self.patch = place[0].rig, gate, stopping, patch
        self.text = self.rig.read_text()

    def set(self, fault):
        device, _, what = fault.partition(": ")
        if device == "stage":
            bench = self.rig.with_name("bench.toml").read_text()
            fault_line = f'faults = ["{what}"]\n'
            broken = self.rig.with_name(f"bench-{what}.toml")
            broken.write_text(bench.replace("[stage]\n", f"[stage]\n{fault_line}"))
            assert fault_line in broken.read_text()
            stage, rest = self.text.split("[camera]", 1)
            self.rig.write_text(stage.replace("bench.toml", broken.name) + "[camera]" + rest)
            self.stopping["stage"] = f"the stage does not answer ({what})"
        elif device == "camera":
            self.gate.fault = CameraError("the cable came off")
        else:

            def fail(_):
                raise RigError("the light does not answer")

            self.patch.setattr(SimulatedLight, "on", fail)
            self.patch.setattr(SimulatedLight, "off", fail)

    def clear(self):
        self.rig.write_text(self.text)
        self.gate.fault = None
        self.stopping.clear()
        self.patch.undo()


def outcome(method, server, controller, loop, gate):
    """The state after a call, and what was answered."""
    try:
        error = loop(controller.call(method, *CALLS[method]()))[-1]
    except UaError as refused:
        return f"{server.state}; {type(refused).__name__}"
    gate.let_go()
    assert server._jobs.wait(120)
    loop(server._heard.join())
    return f"{server.state}{'' if error == 0 else f'; error {error}'}"


@pytest.fixture
def tried(place, server, controller, loop, at, gate, stopping):
    """``tried(state, method, faults)``: state and answer after a method under each fault."""

    def try_all(state, method, faults):
        cells = []
        for fault in faults:
            at(state)
            with pytest.MonkeyPatch.context() as patch:
                broken = Faults(place, gate, stopping, patch)
                before = sorted(place[0].out.iterdir())
                if fault:
                    broken.set(fault)
                cells.append(outcome(method, server, controller, loop, gate))
                broken.clear()
            if (state, method) != ("Ready", "StartSingleJob"):
                assert sorted(place[0].out.iterdir()) == before  # nothing moved
        return cells

    yield try_all
    at("Preoperational")


LEGAL = [
    (state, method)
    for state in STATES
    for method in METHODS
    if (state, method) in STEPS or (state, method) == ("Ready", "StartContinuous")
]


def rows_of_page():
    """Cells by state and method; an empty cell of the page is that of no fault."""
    lines = [line.strip("|").split("|") for line in PAGE.read_text().splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in cells] for cells in lines]
    return {(state, method): [cell or cells[0] for cell in cells] for state, method, *cells in rows}


def changed(cells):
    """Cells of a row, of those with a fault only what differs from no fault."""
    return [cells[0], *("" if cell == cells[0] else cell for cell in cells[1:])]


def test_states_and_methods_are_those_of_the_page(tried, server, controller, loop, at, gate):
    page_rows = rows_of_page()
    for state in STATES:
        at(state)
        for method in METHODS:
            if (state, method) not in LEGAL:
                assert outcome(method, server, controller, loop, gate) == f"{state}; BadInvalidState"
                assert (state, method) not in page_rows
        for method in METHODS:
            if (state, method) in LEGAL:
                assert tried(state, method, [""]) == page_rows[state, method][:1], (state, method)
    assert page_rows["Ready", "StartSingleJob"] == tried("Ready", "StartSingleJob", ["", *FAULTS])


@pytest.mark.soak
def test_every_transition_under_every_fault(tried):
    rows = [(state, method, tried(state, method, ["", *FAULTS])) for state, method in LEGAL]
    for state, method, cells in rows:
        if method not in {"StartSingleJob", "Abort", "Stop", "StartContinuous"}:
            assert {cell.split(";")[0] for cell in cells} == {STEPS[state, method].to}
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    text = before + MARKS[0] + table(rows) + MARKS[1] + rest.partition(MARKS[1])[2]
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        PAGE.write_text(text, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == text


MARKS = "<!-- states: written by tests/inspect/line/test_opcua.py -->\n", "<!-- end of states -->"


def table(rows):
    lines = [
        "| state | method | no fault | " + " | ".join(FAULTS) + " |",
        "|---|---|---|" + "---|" * len(FAULTS),
        *(f"| {state} | {method} | {' | '.join(changed(cells))} |" for state, method, cells in rows),
        "",
        "A job whose rig fails ends with a ResultReady event of ResultState 4 (failed) and an ErrorEvent that names",
        "the device; *Reset* leads to Preoperational, from where the next job shows whether the fault is gone.",
        "",
        "| Error | meaning |",
        "|---|---|",
        *(f"| {code} | {words} |" for code, words in opcua.SAYS.items()),
        "",
    ]
    return "\n".join(lines)


def test_state_changes_are_told_with_their_states(server, controller, loop, at):
    at("Preoperational")
    loop(controller.call("SelectModeAutomatic"))
    event = loop(controller.next(STATE_CHANGED))
    while event.Message.Text != "PreoperationalToInitialized":  # earlier ones may still arrive
        event = loop(controller.next(STATE_CHANGED))
    assert (event.FromState.Text, event.ToState.Text) == ("Preoperational", "Initialized")


def test_a_job_whose_rig_fails_ends_with_a_result_and_an_error_event(server, controller, loop, at, gate):
    at("Ready")
    gate.fault = CameraError("the cable came off")
    job, _ = loop(controller.start("F-1"))
    event = loop(controller.next(RESULT_READY))
    while event.JobId.Id != job.Id:
        event = loop(controller.next(RESULT_READY))
    assert (event.ResultState, content(event.ResultContent)[:2]) == (4, ("", -1))
    assert "the cable came off" in loop(controller.next(ERROR_EVENT)).Message.Text
    assert loop(controller.states()) == ("Error", None)


def test_a_job_whose_record_is_damaged_ends_all_the_same(server, controller, loop, at, monkeypatch):
    at("Ready")

    worker, out = server._jobs._worker, server._jobs.place.out

    class Damaging:
        def run(self, task, emit, cancel):
            def damaged(kind, content):
                if kind == "verdict":
                    (out / content["folder"] / "record.json").write_text("{")
                emit(kind, content)

            worker.run(task, damaged, cancel)

    monkeypatch.setattr(server._jobs, "_worker", Damaging())
    assert loop(controller.start("D-1", "M-damaged"))[1] == 0
    assert loop(said(controller, "M-damaged: .*record.json"))
    event = loop(controller.next(RESULT_READY))
    verdict, code, all_of_it = content(event.ResultContent)
    assert (verdict, code, all_of_it["job"], "numbers" in all_of_it) == ("PASS", 0, "M-damaged", False)
    assert loop(controller.next(READY)).JobId.Id == "M-damaged"


def test_the_server_calls_itself_by_its_computer(controller, loop):
    (found,) = {one.Server.ApplicationUri for one in loop(controller.client.get_endpoints())}
    assert found == f"urn:{socket.gethostname()}:anisoscope"


def test_a_port_that_is_taken_is_named(place_of, server, loop):
    place, recipes = place_of("taken")
    port = int(server.address.rpartition(":")[2].partition("/")[0])

    async def enter():
        await VisionServer(Jobs(place, recipes, WorkerHere(place), dict), recipes, port=port).__aenter__()

    with pytest.raises(UsageError, match="choose another --port"):
        loop(enter())
