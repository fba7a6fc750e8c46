"""``anisoscope rig status``: devices of the rig and their state; nothing moves, nothing is switched."""

from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import RigError
from anisoscope.base.language import decimal, message, translated
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import NOTHING_NAMED, Which

if TYPE_CHECKING:
    from anisoscope.rig.stage import Unit


def status(*, which: Annotated[Which, Parameter(name="*")] = NOTHING_NAMED, json_: Json = False) -> int:
    """Query identity and state of every device of the rig. Nothing moves.

    A device that does not answer does not hide the others; the exit code is then that of a hardware error.

    Examples:
        anisoscope rig status --rig rig.toml
        anisoscope rig status --driver elliptec --port /dev/ttyUSB0
    """
    from anisoscope.operations.rigging import rig_status

    found = rig_status(which.read())
    if json_:
        print_json(found)
    else:
        _print(found)
    failed = any(isinstance(device, dict) and "error" in device for device in found.values())
    return RigError.exit_code if failed else 0


def _print(found: dict[str, Any]) -> None:
    from anisoscope.rig.rigfile import AXES

    if found["rig"] is not None:
        print(f"{message('rig'):<9} {found['rig']}")  # noqa: T201
    for table in (*AXES, "camera", "light"):
        if table in found:
            print(f"{translated(table):<9} {_line(table, found[table])}")  # noqa: T201


def _name(device: str) -> str:
    return message("set by hand") if device == "set by hand" else device


def _axis_words(device: dict[str, Any], unit: "Unit", whose: str, place: float | None) -> list[str]:
    from anisoscope.rig.stage import SYMBOLS

    sign, (low, high), at = SYMBOLS[unit], device[f"limits_{unit}"], device[f"position_{unit}"]
    words = []
    if at is not None:
        known = "" if place is None else f" ({whose} {decimal(format(place, '.3f'))}{sign})"
        words.append(message("at {place}", place=f"{at:.3f}{sign}") + known)
    if device["moving"]:
        speed = device[f"speed_{unit}_s"]
        words.append(
            message("moving")
            if speed is None
            else message("moving at {speed}", speed=f"{decimal(format(speed, '+.3g'))}{sign}/s")
        )
    return [
        *words,
        message("homed") if device["homed"] else message("not homed since it was connected"),
        message("reaches {low}…{high}", low=f"{low:g}{sign}", high=f"{high:g}{sign}"),
        message("steps of {step}", step=f"{device[f'resolution_{unit}']:.2g}{sign}"),
    ]


EIGHT_BITS = 8


def _line(table: str, device: dict[str, Any]) -> str:
    if "error" in device:
        return f"{device['driver']}: {device['error']}"
    words = [_name(device["device"])]
    if "position_deg" in device:
        whose = message("part") if table == "stage" else message("arm")
        words += _axis_words(device, "deg", whose, device.get("angle_deg"))
    elif "position_mm" in device:
        words += _axis_words(device, "mm", table, device.get("place_mm"))
    elif table == "camera":
        words += [
            message(
                "{rows} × {cols} pixels of {size} µm on the sample",
                rows=device["rows"],
                cols=device["cols"],
                size=format(device["pixel_um"], "g"),
            ),
            message(
                "{depth} bits, black at {black}",
                depth=device["bit_depth"],
                black=format(device["black_level"], "g"),
            ),
            *(
                [
                    message(
                        "8 bits: set its pixel format to 10 or 12 where it has them, else average more frames"
                    )
                ]
                if device["bit_depth"] == EIGHT_BITS
                else []
            ),
            *(
                []
                if device["filters"] == "mono"
                else [message("colour filters {name}", name=device["filters"])]
            ),
            message("linear") if device["linear"] else message("not linear"),
            *(
                [message("UNCALIBRATED: no response curve (anisoscope calibrate response)")]
                if device["uncalibrated"]
                else []
            ),
        ]
    elif table == "light":
        words.append(message("{angle}° from the camera", angle=format(device["angle_deg"], "g")))
        if device["channels"]:
            words.append(message("channels {names}", names=", ".join(device["channels"])))
    return ", ".join(words)
