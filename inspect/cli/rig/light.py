"""``anisoscope rig light``: light a channel of the rig, or list what it has."""

import contextlib
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import RigPath, write_line
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.rig.rigfile import LightPart


def light(
    state: Annotated[
        str | None, Parameter(help="Channel to light, on (the default channel, or the only lamp), or off.")
    ] = None,
    /,
    *,
    rig: RigPath,
    json_: Json = False,
) -> int:
    """List the light channels of a rig, or light one: its lamps shine, its filter stands in the beam, others are dark.

    Under rig hold the light stays as it was switched; otherwise it shines until Enter or Ctrl-C.

    Examples:
        anisoscope rig light --rig rig.toml
        anisoscope rig light blue --rig rig.toml
        anisoscope rig light off --rig rig.toml
    """
    from anisoscope.rig.acquisition.opening import open_lamp
    from anisoscope.rig.hold import is_held
    from anisoscope.rig.rigfile import read_rig

    file = read_rig(rig)
    if state is None:
        return _show(
            {one: read_rig(rig, channel=one).light for one in file.light.channels}, file.light, json_=json_
        )
    if state not in {"on", "off"}:
        try:
            file = read_rig(rig, channel=state)
        except RigFileError as problem:
            raise UsageError(str(problem)) from None
    with contextlib.closing(open_lamp(file.light)) as lamp:
        lamp.off() if state == "off" else lamp.on()
        if json_:
            print_json({"light": state, "channel": file.light.channel})
        else:
            print(message("light: {state}", state=state), flush=True)  # noqa: T201
        if state != "off" and not is_held(file.light):
            write_line(message("it shines until Enter or Ctrl-C"))
            with contextlib.suppress(KeyboardInterrupt, EOFError):
                input()
            lamp.off()
    return 0


def _show(lit: "dict[str, LightPart]", part: "LightPart", *, json_: bool) -> int:
    if json_:
        return print_json({"channel": part.channel, "channels": part.model_dump(mode="json")["channels"]})
    if not part.channels:
        print(message("this light has one lamp and no channels"))  # noqa: T201
        return 0
    rows = []
    for name, one in lit.items():
        own = part.channels[name]
        rows.append(
            [
                f"{name} *" if name == part.channel else name,
                ", ".join(own.lamps) or "–",
                f"{own.level_percent} %",
                "–" if own.filter is None else str(own.filter),
                "–" if one.wavelength_nm is None else f"{one.wavelength_nm:g} nm",
                decimal(f"{one.angle_deg:g}°"),
            ]
        )
    head = [
        message("channel"),
        message("lamps"),
        message("level"),
        message("filter"),
        message("wavelength"),
        message("angle"),
    ]
    print_table(message("Light channels"), head, rows)
    return 0
