"""The simulated injection moulding machine as a server of OPC 40077 (EUROMAP 77), with the OPC Foundation's NodeSets.

It has an interface object of the specification, and after every cycle fires an event of a type of its own, as the
specification asks of machines: below CycleParametersEventType, with an injection unit and two temperature zones.
"""

import copy
import logging
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from asyncua import Server, ua
from asyncua.common.events import get_event_obj_from_type_node
from asyncua.common.instantiate_util import instantiate

from anisoscope.sim.press import SETTINGS

DATA = Path(__file__).parent / "data"
NODESETS = ("Di", "PlasticsRubber.GeneralTypes", "PlasticsRubber.IMM2MES")
GENERAL_TYPES = "http://opcfoundation.org/UA/PlasticsRubber/GeneralTypes/"
IMM2MES = "http://opcfoundation.org/UA/PlasticsRubber/IMM2MES/"
DEVICES = "http://opcfoundation.org/UA/DI/"
UNIT = "InjectionUnitCycleParameters_1"
FIELDS = {
    "melt temperature": ("InjectionUnitTemperatureZone_1/ActualTemperature", 1.0),
    "mould temperature": ("MouldTemperatureZone_1/ActualTemperature", 1.0),
    "packing pressure": (f"{UNIT}/HoldSpecificPressureAverage", 1.0),
    "cycle time": ("CycleTime", 1000.0),
}
"""Field of the event by setting, and its unit over the setting's: the specification has cycle times in ms."""


class PressServer:
    """A machine in a server; use it as an asynchronous context.

    Args:
        port: TCP port at 127.0.0.1.
        server: not yet initialised, with its security; None: one without encryption.
    """

    def __init__(self, port: int, server: Server | None = None) -> None:
        self.address = f"opc.tcp://127.0.0.1:{port}/press"
        self._server, self._cycles, self._seconds = server or Server(), 0, 0.0
        if server is None:
            self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])

    async def __aenter__(self) -> Self:
        for name in ("asyncua", "opcua"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        server = self._server
        await server.init()
        server.set_endpoint(self.address)
        for name in NODESETS:  # that of the general types names a child twice: the second one is left out
            await server.import_xml(DATA / f"Opc.Ua.{name}.NodeSet2.xml", strict_mode=False)
        general, imm, di = [
            await server.get_namespace_index(one) for one in (GENERAL_TYPES, IMM2MES, DEVICES)
        ]
        own = await server.register_namespace("urn:anisoscope:press")
        devices = await server.nodes.objects.get_child(ua.QualifiedName("DeviceSet", di))
        await instantiate(
            devices,
            server.get_node(ua.NodeId(1007, imm)),
            bname=ua.QualifiedName("IMM_anisoscope_1", own),
            idx=own,
            instantiate_optional=False,
        )
        kind = await server.create_custom_event_type(own, "PressCycleEventType", ua.NodeId(1038, general))
        for label, (field, scale) in FIELDS.items():
            part, _, name = field.rpartition("/")
            if part:
                component = await kind.add_object(own, part)
                space = imm if part == UNIT else general
                await component.add_variable(
                    ua.NodeId(0, own),
                    ua.QualifiedName(name, space),
                    scale * SETTINGS[label][0],
                    ua.VariantType.Double,
                )
        await kind.add_property(ua.NodeId(0, own), ua.QualifiedName("PartId", general), "")
        await kind.add_property(
            ua.NodeId(0, own), ua.QualifiedName("MachineCycleCounter", general), 0, ua.VariantType.UInt64
        )
        self._event = await get_event_obj_from_type_node(kind)
        await server.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._server.stop()

    async def cycle(self, settings: Mapping[str, float], part: str, at: datetime | None = None) -> None:
        """Fire the event of a cycle.

        Args:
            settings: by the names of `FIELDS`, in the units of `anisoscope.sim.press.SETTINGS`.
            part: id of the part.
            at: end of the cycle; None: now.
        """
        self._cycles += 1
        event = copy.copy(self._event)
        event.data_types = dict(event.data_types)
        event.EventId, event.Severity = uuid.uuid4().bytes, 100
        event.Time = event.ReceiveTime = at or datetime.now(UTC)
        event.Message = ua.LocalizedText("cycle")
        event.SourceNode, event.SourceName = self._server.nodes.server.nodeid, "press"
        event.emitting_node = self._server.nodes.server.nodeid
        self._seconds += settings["cycle time"]
        for name, value, number in (
            ("PartId", part, ua.VariantType.String),
            ("AverageCycleTime", 1000.0 * self._seconds / self._cycles, ua.VariantType.Double),
            ("MachineCycleCounter", self._cycles, ua.VariantType.UInt64),
            ("JobCycleCounter", self._cycles, ua.VariantType.UInt64),
            *(
                (field, scale * settings[label], ua.VariantType.Double)
                for label, (field, scale) in FIELDS.items()
            ),
        ):
            event.add_property(name, value, number)
        await self._server.iserver.isession.subscription_service.trigger_event(event)
