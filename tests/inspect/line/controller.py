"""A controller of a line by asyncua's client, with the calls of the specification in order."""

import asyncio
import json
import socket
import threading

from asyncua import Client, ua
from asyncua.common.events import get_filter_from_event_type

NAMESPACE = "http://opcfoundation.org/UA/MachineVision"
FOLDERS = {
    "RecipeManagement": ("GetRecipeListFiltered", "PrepareRecipe", "UnprepareRecipe"),
    "ConfigurationManagement": ("ActivateConfiguration", "GetConfigurationById", "GetConfigurationList"),
    "ResultManagement": ("GetResultById", "GetResultComponentsById", "GetResultListFiltered"),
    "VisionStateMachine": ("SelectModeAutomatic", "Halt", "Reset"),
    "VisionStateMachine/AutomaticModeStateMachine": ("StartSingleJob", "StartContinuous", "Stop", "Abort"),
}


def free_port():
    """A port of this computer that is free at the moment."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Loop:
    """An event loop in a thread."""

    def __init__(self):
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever)
        self._thread.start()

    def __call__(self, coroutine, timeout=600):
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(timeout)

    def close(self):
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()


class Controller:
    """A client with its session; `heard` are the events, as they come.

    The structures of the NodeSet stay known for a process; ``known``, of an earlier session in it, is the filter of its
    events, so that neither is read again.
    """

    def __init__(self, address, timeout=30, *, known=None):
        self.known = known
        self.client = Client(address, timeout=timeout)
        self.client.session_timeout = 30_000  # ms; what a cut leaves publishes on in the server until then
        self.heard = asyncio.Queue()

    async def __aenter__(self):
        await self.client.connect()
        try:
            if self.known is None:
                await self.client.load_data_type_definitions()
            self.ns = await self.client.get_namespace_index(NAMESPACE)
            own = await self.client.get_namespace_index("urn:anisoscope:line")
            self.system = self.client.get_node(ua.NodeId("VisionSystem", own))
            self.methods = {}
            subscription = await self.client.create_subscription(20, self)
            if self.known is None:
                types = (1013, 1018, 1019, 1022, 1023, 1024, 1038)
                nodes = [self.client.get_node(ua.NodeId(one, self.ns)) for one in types]
                self.known = await get_filter_from_event_type(nodes)
            await subscription.subscribe_events(ua.ObjectIds.Server, evfilter=self.known)
        except BaseException:
            await self.client.disconnect()
            raise
        return self

    async def __aexit__(self, *_):
        await self.client.disconnect()

    def event_notification(self, event):
        self.heard.put_nowait(event)

    def status_change_notification(self, status):
        """The subscription has ended with the connection."""

    async def at(self, path):
        return await self.system.get_child([f"{self.ns}:{name}" for name in path.split("/")])

    async def call(self, name, *arguments):
        """Output arguments of a method; a single one is a list too."""
        if name not in self.methods:
            folder = next(folder for folder, names in FOLDERS.items() if name in names)
            self.methods[name] = await self.at(folder), await self.at(f"{folder}/{name}")
        parent, method = self.methods[name]
        found = await parent.call_method(method, *arguments)
        return found if isinstance(found, list | tuple) else [found]

    async def states(self):
        """The state of the machine, and that of automatic mode or None."""
        found = []
        for path in ("VisionStateMachine", "VisionStateMachine/AutomaticModeStateMachine"):
            current = await (await self.at(path)).get_child("0:CurrentState")
            value = await current.read_data_value(raise_on_bad_status=False)
            found.append(value.Value.Value.Text if value.StatusCode.is_good() else None)
        return tuple(found)

    async def prepare(self, recipe):
        external = ua.RecipeIdExternalDataType(Id=recipe)
        return await self.call("PrepareRecipe", external, ua.RecipeIdInternalDataType())

    async def start(self, serial, meas="", recipe="", product="", parameters=()):
        array = ua.Variant([ua.Variant(one) for one in parameters], ua.VariantType.Variant, is_array=True)
        return await self.call(
            "StartSingleJob",
            ua.MeasIdDataType(Id=meas),
            ua.PartIdDataType(Id=serial),
            ua.RecipeIdExternalDataType(Id=recipe),
            ua.ProductIdDataType(Id=product),
            array,
        )

    async def next(self, kind):
        """The next event of a type; the others are passed over."""
        async with asyncio.timeout(600):
            while True:
                event = await self.heard.get()
                if event.EventType.Identifier == kind and event.EventType.NamespaceIndex == self.ns:
                    return event

    async def results(self, job="", state=0):
        empty = [ua.MeasIdDataType(), ua.PartIdDataType(), ua.RecipeIdExternalDataType()]
        empty += [ua.RecipeIdInternalDataType(), ua.ConfigurationIdDataType(), ua.ConfigurationIdDataType()]
        empty += [ua.ProductIdDataType(), ua.JobIdDataType(Id=job)]
        numbers = [ua.Variant(0, ua.VariantType.UInt32)] * 2 + [ua.Variant(0, ua.VariantType.Int32)]
        return await self.call(
            "GetResultListFiltered", ua.Variant(state, ua.VariantType.Int32), *empty, *numbers
        )

    async def result(self, job):
        """Verdict, exit code and the rest of a result."""
        asked = ua.ResultIdDataType(Id=job), ua.Variant(0, ua.VariantType.Int32)
        _, found, error = await self.call("GetResultById", *asked)
        assert error == 0
        return content(found.ResultContent)


def content(found):
    verdict, code, text = (one.Value if isinstance(one, ua.Variant) else one for one in found)
    return verdict, code, json.loads(text)
