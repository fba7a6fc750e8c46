"""Inspect one part over OPC UA: python controller.py opc.tcp://127.0.0.1:4840/anisoscope RECIPE SERIAL."""

import asyncio
import json
import sys
import uuid

from asyncua import Client, ua

RESULT_READY = 1024  # ResultReadyEventType of the NodeSet


class Results:
    """Receives the events of a subscription."""

    def __init__(self):
        self.came = asyncio.Queue()

    def event_notification(self, event):
        self.came.put_nowait(event)


async def inspect(address, recipe, serial):
    async with Client(address) as client:
        await client.load_data_type_definitions()
        vision = await client.get_namespace_index("http://opcfoundation.org/UA/MachineVision")
        own = await client.get_namespace_index("urn:anisoscope:line")
        system = client.get_node(f"ns={own};s=VisionSystem")
        results = Results()
        subscription = await client.create_subscription(20, results)
        await subscription.subscribe_events(ua.ObjectIds.Server, ua.NodeId(RESULT_READY, vision))

        async def call(path, *arguments):
            *folder, method = (f"{vision}:{name}" for name in path.split("/"))
            return await (await system.get_child(folder)).call_method(method, *arguments)

        machine = await system.get_child(f"{vision}:VisionStateMachine")
        state = await (await machine.get_child("0:CurrentState")).read_value()
        if state.Text == "Preoperational":
            await call("VisionStateMachine/SelectModeAutomatic")
        named = ua.RecipeIdExternalDataType(Id=recipe)
        _, _, error = await call("RecipeManagement/PrepareRecipe", named, ua.RecipeIdInternalDataType())
        if error:
            raise SystemExit(f"recipe {recipe} cannot be prepared: error {error}")
        run = str(uuid.uuid4())  # the same one again, after a cut, orders no second job
        job, error = await call(
            "VisionStateMachine/AutomaticModeStateMachine/StartSingleJob",
            ua.MeasIdDataType(Id=run),
            ua.PartIdDataType(Id=serial),
            named,
            ua.ProductIdDataType(),
            ua.Variant([ua.Variant("lot=L42")], ua.VariantType.Variant, is_array=True),
        )
        if error:
            raise SystemExit(f"the job is refused: error {error}")
        while (event := await results.came.get()).JobId.Id != job.Id:
            pass
        verdict, _, text = (one.Value for one in event.ResultContent)
        print(f"{serial}: {verdict}")
        result = json.loads(text)
        print(result["problem"] or result["finding"])


if __name__ == "__main__":
    asyncio.run(inspect(*sys.argv[1:4]))
