"""``anisoscope rig``: look after the rig: its ports, its motion, its picture; and simulated devices."""

import ast
from dataclasses import asdict
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, cast

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, Json

if TYPE_CHECKING:
    from anisoscope.rig.discovery import Answer, FoundPort

app = App(
    name="rig",
    help="Operate and check the rig: ports, motion, live picture, commissioning; simulated devices.",
)
_look = Group.create_ordered("Look")
_move = Group.create_ordered("Move")
_set_up = Group.create_ordered("Set up and check")
_simulate = Group.create_ordered("Simulate")


def _register(path: str, group: Group) -> None:
    """Register a command by its import path; its summary is read from the source, so that help imports none of them."""
    module, _, name = path.partition(":")
    spec = find_spec(module)
    source = (
        None
        if spec is None or spec.loader is None
        else cast("SourceFileLoader", spec.loader).get_source(module)
    )
    assert source is not None
    function = next(
        node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef) and node.name == name
    )
    app.command(path, group=group, help=(ast.get_docstring(function) or "").partition("\n\nArgs:")[0])


_register("anisoscope.cli.rig.status:status", _look)
_register("anisoscope.cli.rig.snap:snap", _look)
_register("anisoscope.cli.rig.live:live", _look)
_register("anisoscope.cli.rig.light:light", _look)
for _motion in ("home", "move", "jog", "stop"):
    _register(f"anisoscope.cli.rig.motion:{_motion}", _move)
_register("anisoscope.cli.rig.focus:focus", _move)
_register("anisoscope.cli.rig.hold:hold", _move)
_register("anisoscope.cli.rig.markers:markers", _set_up)
_register("anisoscope.cli.rig.scan:scan", _set_up)
_register("anisoscope.cli.rig.export:export", _look)
for _check in ("commission", "check"):
    _register(f"anisoscope.cli.rig.commission:{_check}", _set_up)
app.command(
    "anisoscope.cli.rig.sim:app",
    name="sim",
    group=_simulate,
    help="Serve a simulated device, byte by byte, to any program.",
)


@app.command(group=_look)
def ports(
    *,
    probe: Flag = False,
    port: Annotated[tuple[str, ...], Parameter(help="Only this port, listed or not; may be repeated.")] = (),
    json: Json = False,
) -> None:
    """List the serial ports of this machine and the devices that may be connected, without opening any.

    Args:
        probe: Open each port and identify the device; opening resets some boards (Arduino).

    Examples:
        anisoscope rig ports
        anisoscope rig ports --json
    """
    from anisoscope.rig.discovery import FoundPort, find_ports
    from anisoscope.rig.discovery import probe as ask

    found = list(find_ports())
    if port:
        listed = {one.port: one for one in found}
        if not probe and (strange := [name for name in port if name not in listed]):
            raise UsageError(
                f"--port {strange[0]}: not a port of this machine; --probe asks on it all the same"
            )
        found = [listed.get(name) or FoundPort(name, "", "", "", "", "", ()) for name in port]
    answers = [ask(one.port, one.may_be) if probe else None for one in found]
    if json:
        print_json(
            [
                asdict(one) | ({} if answer is None else {"probe": asdict(answer)})
                for one, answer in zip(found, answers, strict=True)
            ]
        )
        return
    for one, answer in zip(found, answers, strict=True):
        print(_line(one, answer))  # noqa: T201
    if not found:
        print(message("no serial ports"))  # noqa: T201


def _line(found: "FoundPort", answer: "Answer | None") -> str:
    words = [found.port, found.usb, found.maker, found.product or found.description]
    if found.serial:
        words.append(message("serial {serial}", serial=found.serial))
    if answer is not None:
        words.append(
            message("{name}: {text} answered", name=answer.driver, text=answer.device)
            if answer.driver
            else answer.problem
        )
    elif found.may_be:
        words.append(message("may be {name}", name=message(" or ").join(found.may_be)))
    return "  ".join(word for word in words if word)
