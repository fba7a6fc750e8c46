"""Server of OPC UA for Machine Vision (OPC 40100-1): the state machine of the companion specification over the jobs.

The address space is that of the OPC Foundation's NodeSet, which lies in ``data/``. Of what the specification leaves
open there are: configuration management (one configuration, the rig file), recipe management (the folder of recipes),
result management, and automatic mode with single jobs. asyncua checks no arguments; every call is checked here against
the signature in the NodeSet before anything else (`anisoscope.line.opcua_types`).
"""

import asyncio
import contextlib
import copy
import gc
import hashlib
import json
import logging
import re
import socket
import uuid
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from asyncua import Node, Server, ua
from asyncua.common.events import Event, get_event_obj_from_type_node
from asyncua.common.instantiate_util import instantiate

from anisoscope.base.crash import crash_line
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.line.jobs import Job, Jobs, Kind, Refused, order_of, result_of
from anisoscope.line.opcua_security import Security
from anisoscope.line.opcua_types import (
    NODESET,
    WRONG,
    BadCall,
    check_nodeset,
    define_ids,
    empty_value,
    import_nodeset,
    input_value,
    named_children,
    output_variant,
    paired,
    signature_of,
    subtypes,
)
from anisoscope.record.schema import Record
from anisoscope.record.verdict import Verdict

NAME = "VisionSystem"
PATH = "/anisoscope"
MOST_RESULTS = 1000
"""Results or recipes in one answer; a client asks for more with StartIndex."""
PARTS = {
    "ConfigurationManagement": 1006,
    "RecipeManagement": 1004,
    "ResultManagement": 1007,
    "VisionStateMachine/AutomaticModeStateMachine": 1021,
}
"""Optional parts of the specification that this server has, by the numbers of their types, with what they must have."""
PARAMETERS = ("lot", "cavity", "operator")
"""What StartSingleJob takes as parameters, each a String ``name=value``."""

_log = logging.getLogger("anisoscope.line")

# The state machine. Leaf states: those of VisionStateMachine, and of AutomaticModeStateMachine below Operational.

PREOPERATIONAL, HALTED, ERROR = "Preoperational", "Halted", "Error"
INITIALIZED, READY, SINGLE = "Initialized", "Ready", "SingleExecution"
OPERATIONAL = (INITIALIZED, READY, SINGLE)
STATES = (PREOPERATIONAL, HALTED, ERROR, *OPERATIONAL)


@dataclass(frozen=True)
class Step:
    """A way of the state machine: where it leads, and the transitions of the NodeSet on it, the outer one first."""

    to: str
    transitions: tuple[str, ...]


def _steps() -> dict[tuple[str, str], Step]:
    """Transitions of each state by each method of the specification, and by events of the rig."""
    found = {
        (PREOPERATIONAL, "SelectModeAutomatic"): Step(INITIALIZED, ("PreoperationalToInitialized",)),
        (PREOPERATIONAL, "Halt"): Step(HALTED, ("PreoperationalToHalted",)),
        (HALTED, "Reset"): Step(PREOPERATIONAL, ("HaltedToPreoperational",)),
        (ERROR, "Reset"): Step(PREOPERATIONAL, ("ErrorToPreoperational",)),
        (ERROR, "Halt"): Step(HALTED, ("ErrorToHalted",)),
        (INITIALIZED, "PrepareRecipe"): Step(READY, ("InitializedToReadyRecipe",)),
        (READY, "PrepareRecipe"): Step(READY, ()),
        (READY, "UnprepareRecipe"): Step(INITIALIZED, ("ReadyToInitializedRecipe",)),
        (READY, "StartSingleJob"): Step(SINGLE, ("ReadyToSingleExecution",)),
        (SINGLE, "Abort"): Step(READY, ("SingleExecutionToReadyAbort",)),
        (SINGLE, "Stop"): Step(READY, ("SingleExecutionToReadyStop",)),
        (SINGLE, "done"): Step(READY, ("SingleExecutionToReadyAuto",)),
        (SINGLE, "failed"): Step(ERROR, ("OperationalToErrorAuto",)),
        (SINGLE, "stopped"): Step(READY, ("SingleExecutionToReadyAbort",)),
        (PREOPERATIONAL, "resumed"): Step(
            SINGLE,
            ("PreoperationalToInitializedAuto", "InitializedToReadyAuto", "ReadyToSingleExecutionAuto"),
        ),
    }
    for state in OPERATIONAL:
        found[state, "Halt"] = Step(HALTED, ("OperationalToHalted",))
        found[state, "Reset"] = Step(PREOPERATIONAL, ("OperationalToPreoperational",))
    return found


STEPS = _steps()
METHODS = (
    "SelectModeAutomatic",
    "PrepareRecipe",
    "UnprepareRecipe",
    "StartSingleJob",
    "StartContinuous",
    "Stop",
    "Abort",
    "Halt",
    "Reset",
)
CODES = {"recipe": -1, "serial": -2, "changed": -3, "busy": -4, "order": -5, "closed": -6}
"""Values of the output argument Error by the reason of `Refused`; others below."""
UNSUPPORTED, UNKNOWN, BROKEN, FAULT = -7, -8, -9, -10
SAYS = {
    0: "done",
    -1: "no recipe of this id, one that cannot be used, or one that was changed since it was prepared",
    -2: "PartId is no serial number that can be used",
    -3: "MeasId is that of another job, for another part or recipe",
    -4: "another job is at work",
    -5: "a parameter, an id or the product does not fit",
    -6: "the server is ending",
    -7: "not supported: continuous execution",
    -8: "no such result or configuration",
    -9: "the journal or a record cannot be written or read",
    -10: "an axis was not stopped: the message says which; the state is entered all the same",
}
"""What the values of Error mean."""


class _No(Exception):
    """Refusal of a call: its error code, and an event with the reason in words."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


Structure = Any
"""A structure of the specification, which asyncua makes from the NodeSet when the server starts."""
Call = Callable[..., Awaitable[tuple[Any, ...]]]


@dataclass(frozen=True)
class _Prepared:
    """A recipe that was prepared: its name and the hash of its file."""

    name: str
    sha256: bytes
    product: str


class VisionServer:
    """An OPC UA server over the jobs of a rig; use it as an asynchronous context.

    Args:
        jobs: the jobs, not yet entered.
        recipes: folder of the recipes.
        host: address to listen at.
        port: TCP port.
        name: of the vision system in the address space.
        nodeset: file of the NodeSet; another one than that of the specification is refused.
        security: its certificate, and the clients that are trusted; None: everybody, without encryption.

    Raises:
        UsageError: on entering: the port is taken, or the NodeSet is not that of OPC 40100-1.
    """

    def __init__(
        self,
        jobs: Jobs,
        recipes: Path,
        host: str = "127.0.0.1",
        port: int = 4840,
        name: str = NAME,
        nodeset: Path = NODESET,
        security: Security | None = None,
    ) -> None:
        self._jobs, self._recipes, self._name, self._nodeset = jobs, recipes, name, nodeset
        self._host, self._port = host, port
        self.address = f"opc.tcp://{host}:{port}{PATH}"
        self.state = PREOPERATIONAL
        self._security = security
        self._server = Server() if security is None else security.server()
        self._prepared: _Prepared | None = None
        self._lock = asyncio.Lock()
        self._heard: asyncio.Queue[tuple[Kind, Job, Record | None]] = asyncio.Queue()
        self._events: dict[str, Event] = {}
        self._ends: dict[str, dict[str, ua.LocalizedText]] = {}
        self._shown: list[tuple[ua.NodeId, ua.NodeId]] = []
        self._handle = 0
        self._stop_asked = False
        self._outputs: dict[str, list[ua.Argument]] = {}

    # Setting up.

    async def __aenter__(self) -> Self:
        _check_port(self._host, self._port)
        check_nodeset(self._nodeset)
        await self._lay_out()
        loop = asyncio.get_running_loop()

        def hear(kind: Kind, job: Job, content: dict[str, Any]) -> None:
            if kind in {"done", "failed", "stopped"}:
                loop.call_soon_threadsafe(self._heard.put_nowait, (kind, job, content.get("record")))

        self._jobs.listen(hear)
        await asyncio.to_thread(self._jobs.__enter__)
        async with contextlib.AsyncExitStack() as stack:
            stack.push_async_callback(asyncio.to_thread, self._jobs.__exit__, None, None, None)
            running = self._jobs.running
            if running is not None:
                self._prepared = self._find(running.order.recipe)
                await self._go("resumed", running)
            await self._server.start()
            stack.push_async_callback(self._server.stop)
            following = asyncio.create_task(self._follow())
            stack.callback(following.cancel)
            self._cleanup = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._cleanup.aclose()

    async def _lay_out(self) -> None:
        server = self._server
        for name in ("asyncua", "opcua"):
            logging.getLogger(name).setLevel(logging.ERROR if self._security is None else logging.CRITICAL)
        await server.init()
        server.set_endpoint(self.address)
        server.set_server_name("anisoscope")
        if self._security is None:
            await server.set_application_uri(f"urn:{socket.gethostname()}:anisoscope")
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
            server.set_identity_tokens([ua.AnonymousIdentityToken])  # a password would not be looked at
        await server.set_build_info(
            "anisoscope", "anisoscope", "anisoscope", version("anisoscope"), "", datetime.now(UTC)
        )
        self._ns = await import_nodeset(server, self._nodeset)
        await define_ids(server, self._ns)
        await server.load_data_type_definitions()
        self._types = {
            (await node.read_browse_name()).Name: node
            for node in await subtypes(server.nodes.base_event_type)
        }
        system_type = server.get_node(ua.NodeId(1003, self._ns))
        own = await server.register_namespace("urn:anisoscope:line")
        name = ua.QualifiedName(self._name, own)
        (self._system, *_) = await instantiate(
            server.nodes.objects,
            system_type,
            ua.NodeId(self._name, own),
            name,
            idx=own,
            instantiate_optional=False,
        )
        for path, number in PARTS.items():
            parent, _, part = path.rpartition("/")
            await instantiate(
                await self._at(parent) if parent else self._system,
                server.get_node(ua.NodeId(number, self._ns)),
                bname=ua.QualifiedName(part, self._ns),
                idx=own,
                instantiate_optional=False,
            )
        self._machine = await self._at("VisionStateMachine")
        self._automatic = await self._at("VisionStateMachine/AutomaticModeStateMachine")
        error = ua.Argument(Name="Error", DataType=ua.NodeId(ua.ObjectIds.Int32), ValueRank=-1)
        select = ua.QualifiedName("SelectModeAutomatic", self._ns)
        await self._machine.add_method(ua.NodeId(0, own), select, _no_call, [], [error])
        self._objects = {
            **await named_children(server.get_node(ua.NodeId(1017, self._ns))),
            **await named_children(server.get_node(ua.NodeId(1021, self._ns))),
        }
        for name in {name for step in STEPS.values() for name in step.transitions}:
            self._ends[name] = await _ends_of(self._objects[name])
        for machine in (self._machine, self._automatic):
            current = await machine.get_child(ua.QualifiedName("CurrentState"))
            identity = await current.get_child(ua.QualifiedName("Id"))
            self._shown.append((current.nodeid, identity.nodeid))
        for node in (server.nodes.server, self._system, self._machine, self._automatic):
            await node.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        await self._link()
        await self._show_state()
        active = await self._at("ConfigurationManagement/ActiveConfiguration")
        await server.write_attribute_value(active.nodeid, ua.DataValue(ua.Variant(self._configuration())))

    async def _at(self, path: str) -> Node:
        return await self._system.get_child([ua.QualifiedName(one, self._ns) for one in path.split("/")])

    async def _link(self) -> None:
        management = {
            "ConfigurationManagement": (
                "ActivateConfiguration",
                "GetConfigurationById",
                "GetConfigurationList",
            ),
            "RecipeManagement": ("GetRecipeListFiltered", "PrepareRecipe", "UnprepareRecipe"),
            "ResultManagement": ("GetResultById", "GetResultComponentsById", "GetResultListFiltered"),
            "VisionStateMachine": ("SelectModeAutomatic", "Halt", "Reset"),
            "VisionStateMachine/AutomaticModeStateMachine": (
                "StartSingleJob",
                "StartContinuous",
                "Stop",
                "Abort",
            ),
        }
        for folder, names in management.items():
            for name in names:
                method = await self._at(f"{folder}/{name}")
                inputs, self._outputs[name] = await signature_of(method)
                call = getattr(self, re.sub("(?=[A-Z])", "_", name).lower())
                self._server.link_method(method, self._checked(name, inputs, call))

    def _checked(self, name: str, inputs: list[ua.Argument], call: Call) -> Callable[..., Awaitable[Any]]:
        async def answer(_parent: ua.NodeId, *given: ua.Variant) -> ua.CallMethodResult:
            result = ua.CallMethodResult()
            try:
                values = [input_value(one, wanted, self._ns) for one, wanted in paired(given, inputs)]
                wrong = [number for number, value in enumerate(values) if value is WRONG]
                if wrong:
                    raise BadCall(ua.StatusCodes.BadInvalidArgument, wrong)
                async with self._lock:
                    found = (*await call(*values), 0)
            except BadCall as refused:
                result.StatusCode = ua.StatusCode(refused.status)
                result.InputArgumentResults = [
                    ua.StatusCode(ua.StatusCodes.BadTypeMismatch if one in refused.arguments else 0)
                    for one in range(len(given))
                ]
                return result
            except _No as refused:
                await self._say(f"{name}: {refused}")
                found = (*map(empty_value, self._outputs[name][:-1]), refused.code)
            except Exception as error:  # noqa: BLE001 - the server goes on
                await self._say(crash_line(error, f"line opcua: {name}"))
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInternalError)
                return result
            result.OutputArguments = [
                output_variant(value, wanted)
                for value, wanted in zip(found, self._outputs[name], strict=True)
            ]
            return result

        return answer

    # States.

    async def _go(self, on: str, job: Job | None = None) -> None:
        """Change the state; the caller has looked whether that is possible."""
        step, before = STEPS[self.state, on], self.state
        self.state = step.to
        await self._show_state()
        if self.state in {PREOPERATIONAL, HALTED, ERROR, INITIALIZED}:
            self._prepared = None
        for name in step.transitions:
            await self._fire(
                "StateChangedEventType", name, Transition=ua.LocalizedText(name), **self._ends[name]
            )
        if before != READY and self.state == READY:
            await self._fire("ReadyEventType", f"{before}: ready", JobId=_id("JobIdDataType", job))
        if self.state == SINGLE:
            await self._fire("JobStartedEventType", "job started", JobId=_id("JobIdDataType", job))

    async def _show_state(self) -> None:
        outer = "Operational" if self.state in OPERATIONAL else self.state
        inner = self.state if self.state in OPERATIONAL else None
        for (current, identity), name in zip(self._shown, (outer, inner), strict=True):
            if name is None:
                text = of = ua.DataValue(
                    ua.Variant(None), StatusCode=ua.StatusCode(ua.StatusCodes.BadStateNotActive)
                )
            else:
                text = ua.DataValue(ua.Variant(ua.LocalizedText(name), ua.VariantType.LocalizedText))
                of = ua.DataValue(ua.Variant(self._objects[name].nodeid, ua.VariantType.NodeId))
            await self._server.write_attribute_value(current, text)
            await self._server.write_attribute_value(identity, of)

    def _may(self, method: str) -> None:
        if (self.state, method) not in STEPS:
            raise BadCall(ua.StatusCodes.BadInvalidState)

    # Events.

    async def _fire(self, kind: str, text: str, severity: int = 100, **fields: Any) -> None:  # noqa: ANN401
        """Send an event from the server and from the vision system; both have the same id."""
        if kind not in self._events:
            self._events[kind] = await get_event_obj_from_type_node(self._types[kind])
        event = copy.copy(self._events[kind])
        event.data_types = dict(event.data_types)
        now = datetime.now(UTC)
        event.EventId = uuid.uuid4().bytes
        event.Time = event.ReceiveTime = now
        event.Message, event.Severity = ua.LocalizedText(text), severity
        event.SourceNode, event.SourceName = self._system.nodeid, self._name
        for name, value in fields.items():
            variant = value if isinstance(value, ua.Variant) else ua.Variant(value)
            event.add_property(name, variant.Value, variant.VariantType)
        for node in (self._server.nodes.server, self._system):
            event.emitting_node = node.nodeid
            await self._server.iserver.isession.subscription_service.trigger_event(copy.copy(event))

    async def _say(self, text: str) -> None:
        """A message in words, for the operator of the client."""
        _log.warning("%s", text)
        await self._fire("VisionInformationEventType", text, 400, CausePath="anisoscope")

    async def _follow(self) -> None:
        """Events of the jobs, in order."""
        while True:
            kind, job, record = await self._heard.get()
            try:
                async with self._lock:
                    await self._ended(kind, job, record)
            except Exception:  # noqa: BLE001 - the next job is followed all the same
                _log.exception("job %s: %s", job.id, kind)
            finally:
                self._heard.task_done()

    async def _ended(self, kind: Kind, job: Job, record: Record | None) -> None:
        try:
            fields = await self._result_fields(job, record)
        except _No as problem:  # the record is gone or damaged: the job has ended all the same
            await self._say(f"job {job.id}: {problem}")
            fields = await self._result_fields(job, content=False)
            fields["ResultContent"] = _content(job, json.dumps(result_of(job, None)))
        await self._fire("ResultReadyEventType", f"job {job.id}: {job.verdict or job.state}", **fields)
        if self.state != SINGLE:  # halted or reset meanwhile
            return
        if kind == "failed":
            await self._go("failed", job)
            await self._fire("ErrorEventType", f"job {job.id}: {job.problem}", 800)
        else:
            await self._go("Stop" if self._stop_asked and kind == "done" else kind, job)
        self._stop_asked = False

    # Methods of the state machine. Each returns its output arguments but the last, Error, which is 0.

    async def _select_mode_automatic(self) -> tuple[Any, ...]:
        self._may("SelectModeAutomatic")
        await self._go("SelectModeAutomatic")
        return ()

    async def _halt(self, _cause: int, description: str) -> tuple[Any, ...]:
        return await self._leave("Halt", description)

    async def _reset(self, _cause: int, description: str) -> tuple[Any, ...]:
        return await self._leave("Reset", description)

    async def _leave(self, method: str, description: str) -> tuple[Any, ...]:
        self._may(method)
        problems = await self._stop_rig()
        await self._go(method)
        if description:
            _log.info("%s: %s", method, description)
        return self._none(problems)

    async def _abort(self, _cause: int, _description: str) -> tuple[Any, ...]:
        self._may("Abort")
        return self._none(await self._stop_rig())  # the state follows when the job has ended

    async def _stop(self, _cause: int, _description: str) -> tuple[Any, ...]:
        self._may("Stop")
        self._stop_asked = True  # the job is finished
        return ()

    async def _stop_rig(self) -> dict[str, str]:
        return await asyncio.to_thread(self._jobs.stop)

    @staticmethod
    def _none(problems: dict[str, str]) -> tuple[Any, ...]:
        if problems:
            said = "; ".join(f"{table}: {' '.join(why.split())}" for table, why in problems.items())
            raise _No(FAULT, f"not stopped: {said}")
        return ()

    async def _start_single_job(
        self,
        meas: Structure,
        part: Structure,
        recipe: Structure,
        product: Structure,
        parameters: list[Any],
    ) -> tuple[Any, ...]:
        known = None if not meas.Id else self._jobs.job(meas.Id)
        if known is None:
            self._may("StartSingleJob")
        name = recipe.Id or (known.order.recipe if known else self._prepared.name if self._prepared else "")
        if known is None:
            self._check_prepared(name, product)
        more = _parameters(parameters)
        content = {"job": meas.Id or str(uuid.uuid4()), "recipe": name, "serial": part.Id or ""} | more
        with _refusals():
            job = await asyncio.to_thread(self._jobs.submit, order_of(content))
        if known is None:
            self._stop_asked = False
            await self._go("StartSingleJob", job)
        return (_id("JobIdDataType", job),)

    def _check_prepared(self, name: str, product: Structure) -> None:
        prepared = self._prepared
        assert prepared is not None
        if name != prepared.name:
            raise _No(CODES["recipe"], f"recipe {name[:80]!r} is not prepared; {prepared.name} is")
        if _digest(self._recipes, name) != prepared.sha256:
            self._find(name)  # says what is wrong with one that cannot be used any more
            raise _No(CODES["recipe"], f"recipe {name} was changed since it was prepared: prepare it again")
        if product.Id and product.Id != prepared.product:
            raise _No(CODES["order"], f"product {product.Id[:80]!r}: recipe {name} is for {prepared.product}")

    async def _start_continuous(self, *_: object) -> tuple[Any, ...]:
        if self.state != READY:
            raise BadCall(ua.StatusCodes.BadInvalidState)
        raise _No(UNSUPPORTED, "continuous execution is not supported: a part is put in for every job")

    # Recipes.

    def _find(self, name: str) -> _Prepared:
        with _refusals():
            entry = self._jobs.recipe(name)
        return _Prepared(name, _digest(self._recipes, name), entry.product)

    def _asked_recipe(self, external: Structure, internal: Structure) -> _Prepared:
        names = {one.Id for one in (external, internal) if one.Id}
        if len(names) != 1:
            raise _No(CODES["recipe"], "give ExternalId or InternalId of one recipe")
        found = self._find(names.pop())
        for one in (external, internal):
            if one.Hash and one.Hash != found.sha256:
                raise _No(
                    CODES["recipe"], f"recipe {found.name} has another hash than the one that was asked for"
                )
        return found

    async def _prepare_recipe(self, external: Structure, internal: Structure) -> tuple[Any, ...]:
        self._may("PrepareRecipe")
        found = await asyncio.to_thread(self._asked_recipe, external, internal)
        with _refusals():
            await asyncio.to_thread(self._jobs.check, found.name)
        self._prepared = found
        await self._fire(
            "RecipePreparedEventType",
            f"recipe {found.name} is prepared",
            ExternalId=_recipe_id("RecipeIdExternalDataType", found),
            InternalId=_recipe_id("RecipeIdInternalDataType", found),
            ProductId=ua.ProductIdDataType(Id=found.product),
        )
        await self._go("PrepareRecipe")
        return _recipe_id("RecipeIdInternalDataType", found), True

    async def _unprepare_recipe(self, external: Structure, internal: Structure) -> tuple[Any, ...]:
        self._may("UnprepareRecipe")
        found = await asyncio.to_thread(self._asked_recipe, external, internal)
        if self._prepared is None or found.name != self._prepared.name:
            raise _No(CODES["recipe"], f"recipe {found.name} is not prepared")
        await self._go("UnprepareRecipe")
        return (_recipe_id("RecipeIdInternalDataType", found),)

    async def _get_recipe_list_filtered(
        self,
        external: Structure,
        product: Structure,
        prepared: int,
        most: int,
        start: int,
        _timeout: int,
    ) -> tuple[Any, ...]:
        now = None if self._prepared is None else self._prepared.name
        entries = [
            entry
            for entry in await asyncio.to_thread(self._jobs.recipes)
            if entry.problem is None
            and external.Id in {None, "", entry.name}
            and product.Id in {None, "", entry.product}
            and int(prepared) in {int(entry.name == now), 2}
        ]
        page, complete = _page(entries, most, start)
        ids = [_recipe_id("RecipeIdInternalDataType", self._find(entry.name)) for entry in page]
        return complete, len(ids), self._next_handle(), ids

    # Configurations: one, the rig file.

    def _configuration_id(self) -> Structure:
        path = self._jobs.place.rig
        digest = hashlib.sha256(bounded_bytes(path)).digest()
        return ua.ConfigurationIdDataType(Id=path.name, Hash=digest, HashAlgorithm="SHA-256")

    def _configuration(self) -> Structure:
        changed = datetime.fromtimestamp(self._jobs.place.rig.stat().st_mtime, UTC)
        return ua.ConfigurationDataType(
            HasTransferableDataOnFile=False,
            ExternalId=self._configuration_id(),
            InternalId=self._configuration_id(),
            LastModified=changed,
        )

    def _check_configuration(self, asked: Structure) -> None:
        name = self._jobs.place.rig.name
        if asked.Id != name:
            raise _No(
                UNKNOWN, f"there is no configuration {str(asked.Id)[:80]!r}; {name} is the one of this rig"
            )

    async def _activate_configuration(self, asked: Structure) -> tuple[Any, ...]:
        self._check_configuration(asked)
        return ()

    async def _get_configuration_by_id(self, asked: Structure, _timeout: int) -> tuple[Any, ...]:
        self._check_configuration(asked)
        return self._next_handle(), self._configuration()

    async def _get_configuration_list(self, most: int, start: int, _timeout: int) -> tuple[Any, ...]:
        page, complete = _page([self._configuration()], most, start)
        return complete, len(page), self._next_handle(), list(page)

    # Results: one a job, with its id.

    async def _result_fields(
        self, job: Job, record: Record | None = None, *, content: bool = True
    ) -> dict[str, Any]:
        """Fields of a result, by the names of ResultDataType that the event has too."""
        if content and record is None:
            try:
                record = await asyncio.to_thread(self._jobs.record, job.id)
            except AnisoscopeError as problem:
                raise _No(BROKEN, str(problem)) from None
        recipe = ua.RecipeIdInternalDataType(Id=job.order.recipe)
        ended = job.ended_at or job.accepted_at
        fields: dict[str, Any] = {
            "ResultId": ua.ResultIdDataType(Id=job.id),
            "IsPartial": False,
            "IsSimulated": False,
            "ResultState": ua.Variant(_RESULT_STATES[job.state], ua.VariantType.Int32),
            "MeasId": ua.MeasIdDataType(Id=job.id),
            "PartId": ua.PartIdDataType(Id=job.order.serial),
            "ExternalRecipeId": ua.RecipeIdExternalDataType(Id=job.order.recipe),
            "InternalRecipeId": recipe,
            "ProductId": ua.ProductIdDataType(Id="" if record is None else record.product),
            "ExternalConfigurationId": self._configuration_id(),
            "InternalConfigurationId": self._configuration_id(),
            "JobId": _id("JobIdDataType", job),
            "CreationTime": ua.Variant(datetime.fromisoformat(ended), ua.VariantType.DateTime),
            "ProcessingTimes": ua.ProcessingTimesDataType(
                StartTime=datetime.fromisoformat(job.accepted_at), EndTime=datetime.fromisoformat(ended)
            ),
        }
        if content:
            fields["ResultContent"] = _content(
                job, json.dumps(result_of(job, record, self._jobs.place.reports))
            )
        return fields

    async def _result(self, job: Job, *, content: bool = True) -> Any:  # noqa: ANN401
        fields = await self._result_fields(job, content=content)
        plain = {name: one.Value if isinstance(one, ua.Variant) else one for name, one in fields.items()}
        return ua.ResultDataType(HasTransferableDataOnFile=False, **plain)

    def _job_of(self, asked: Structure) -> Job:
        found = self._jobs.job(asked.Id or "")
        if found is None:
            raise _No(UNKNOWN, f"there is no result {str(asked.Id)[:80]!r}")
        return found

    async def _get_result_by_id(self, asked: Structure, _timeout: int) -> tuple[Any, ...]:
        return self._next_handle(), await self._result(self._job_of(asked))

    async def _get_result_components_by_id(self, asked: Structure, _timeout: int) -> tuple[Any, ...]:
        fields = await self._result_fields(self._job_of(asked))
        names = [argument.Name for argument in self._outputs["GetResultComponentsById"]][2:-1]
        return False, self._next_handle(), *(fields[name] for name in names)

    async def _get_result_list_filtered(self, state: int, *asked: Structure) -> tuple[Any, ...]:
        *ids, most, start, _timeout = asked
        meas, part, external, internal, outer, inner, product, job_id = (one.Id or "" for one in ids)
        rig = self._jobs.place.rig.name
        one = self._jobs.job(meas or job_id)
        found = [
            job
            for job in (self._jobs.all() if not meas + job_id else [one] if one else [])
            if state in {0, _RESULT_STATES[job.state]}
            and {meas, job_id} <= {"", job.id}
            and part in {"", job.order.serial}
            and {external, internal} <= {"", job.order.recipe}
            and {outer, inner} <= {"", rig}
            and not product  # products are known of the records alone
        ]
        page, complete = _page(found, most, start)
        results = [await self._result(job, content=False) for job in page]
        return complete, len(results), self._next_handle(), results

    def _next_handle(self) -> int:
        self._handle = self._handle % 0xFFFFFFFF + 1
        return self._handle


async def _ends_of(transition: Node) -> dict[str, ua.LocalizedText]:
    """FromState and ToState of a transition of the NodeSet, as its event gives them."""
    wanted = (ua.ObjectIds.FromState, ua.ObjectIds.ToState)
    return {
        ua.ObjectIdNames[found.ReferenceTypeId.Identifier]: ua.LocalizedText(found.BrowseName.Name)
        for found in await transition.get_references(direction=ua.BrowseDirection.Forward)
        if found.ReferenceTypeId.Identifier in wanted
    }


_RESULT_STATES = {"done": 1, "running": 2, "stopped": 3, "failed": 4}


def _digest(recipes: Path, name: str) -> bytes:
    """SHA-256 of the file of a recipe; empty where it cannot be read."""
    with contextlib.suppress(OSError):
        return hashlib.sha256(bounded_bytes(recipes / f"{name}.toml")).digest()
    return b""


def _page(found: Sequence[Any], most: int, start: int) -> tuple[Sequence[Any], bool]:
    """A portion of a list, and whether nothing follows it."""
    most = min(most or MOST_RESULTS, MOST_RESULTS)
    return found[start : start + most], start + most >= len(found)


def _id(kind: str, job: Job | None) -> Any:  # noqa: ANN401
    return getattr(ua, kind)(Id="" if job is None else job.id)


def _recipe_id(kind: str, found: _Prepared) -> Any:  # noqa: ANN401
    return getattr(ua, kind)(Id=found.name, Hash=found.sha256, HashAlgorithm="SHA-256")


def _content(job: Job, text: str) -> ua.Variant:
    """Verdict as String (empty without one), as Int32 (exit code of the commands; -1 without one), and all as JSON."""
    code = -1 if job.verdict is None else Verdict(job.verdict).exit_code
    one = [
        ua.Variant(job.verdict or "", ua.VariantType.String),
        ua.Variant(code, ua.VariantType.Int32),
        ua.Variant(text, ua.VariantType.String),
    ]
    return ua.Variant(one, ua.VariantType.Variant, is_array=True)


def _parameters(given: list[Any]) -> dict[str, str]:
    found: dict[str, str] = {}
    for one in given:
        name, sign, text = one.partition("=") if isinstance(one, str) else ("", "", "")
        if not sign or name not in PARAMETERS or name in found:
            raise _No(
                CODES["order"],
                f"parameter {str(one)[:80]!r}: give each of {', '.join(PARAMETERS)} once as name=value",
            )
        found[name] = text
    return found


@contextlib.contextmanager
def _refusals() -> Any:  # noqa: ANN401
    """Refusals of the jobs as errors of the call."""
    try:
        yield
    except Refused as refused:
        raise _No(CODES[refused.why], str(refused)) from None
    except (AnisoscopeError, OSError) as problem:
        raise _No(BROKEN, " ".join(str(problem).split())) from None


@contextlib.contextmanager
def long_lived() -> Iterator[None]:
    """Keep objects made meanwhile out of garbage collection: they last as long as the process."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _check_port(host: str, port: int) -> None:
    """Refuse an address that cannot be listened at, before the address space is made.

    Raises:
        UsageError: the port is taken, or there is no such address here.
    """
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((host, port))
    except (OSError, OverflowError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise UsageError(f"cannot serve at {host}:{port}: {reason}; choose another --port") from None


async def _no_call(*_: object) -> ua.StatusCode:
    """Stands for a method until it is linked."""
    return ua.StatusCode(ua.StatusCodes.BadNotImplemented)
