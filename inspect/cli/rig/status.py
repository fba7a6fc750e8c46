"""``anisoscope rig status``: devices of the rig and their state; nothing moves, nothing is switched."""

import contextlib
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import AnisoscopeError, RigError
from anisoscope.base.language import decimal, message, translated
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import NOTHING_NAMED, Which

if TYPE_CHECKING:
    from collections.abc import Callable

    from anisoscope.rig.rigfile import CameraPart, LightPart, MotorPart, RigAxes
    from anisoscope.rig.stage import Unit


def status(*, which: Annotated[Which, Parameter(name="*")] = NOTHING_NAMED, json_: Json = False) -> int:
    """Query identity and state of every device of the rig. Nothing moves.

    A device that does not answer does not hide the others; the exit code is then that of a hardware error.

    Examples:
        anisoscope rig status --rig rig.toml
        anisoscope rig status --driver elliptec --port /dev/ttyUSB0
    """
    from anisoscope.rig.transport import shared_ports

    file, axes = which.read()
    found: dict[str, Any] = {"rig": None if file is None else file.name}
    with contextlib.ExitStack() as stack, shared_ports():
        for table, part in axes.items():
            found[table] = _of(_axis, part, table, stack)
            if file is None:  # nobody said where the sample stands at 0°
                found[table].pop("angle_deg", None)
                found[table].pop("place_mm", None)
        if file is not None and file.camera is not None:
            found["camera"] = _of(_camera, file.camera, file, stack)
        if file is not None and file.light is not None:
            found["light"] = _of(_light, file.light, stack)
    if json_:
        print_json(found)
    else:
        _print(found)
    failed = any(isinstance(device, dict) and "error" in device for device in found.values())
    return RigError.exit_code if failed else 0


def _of(query: "Callable[..., dict[str, Any]]", part: Any, *rest: Any) -> dict[str, Any]:  # noqa: ANN401
    try:
        return {"driver": part.driver, **query(part, *rest)}
    except AnisoscopeError as problem:
        return {"driver": part.driver, "error": " ".join(str(problem).split())}


def _axis(part: "MotorPart", table: str, stack: contextlib.ExitStack) -> dict[str, Any]:
    from anisoscope.rig.acquisition.opening import open_axis
    from anisoscope.rig.rigfile import BY_HAND
    from anisoscope.rig.stage import motion_state

    if part.driver == BY_HAND:
        return {"device": "set by hand"}
    axis = open_axis(part, table)
    stack.callback(axis.close)
    state = motion_state(axis)
    reading = state.position_deg
    unit = part.unit
    return {
        "port": part.port,
        "device": axis.name,
        f"position_{unit}": reading,
        "angle_deg" if unit == "deg" else "place_mm": None if reading is None else part.place(reading),
        "moving": state.moving,
        f"speed_{unit}_s": state.speed_deg_s,
        "homed": axis.is_homed,
        f"limits_{unit}": list(axis.limits_deg),
        f"resolution_{unit}": axis.resolution_deg,
    }


def _camera(part: "CameraPart", file: "RigAxes", stack: contextlib.ExitStack) -> dict[str, Any]:
    from anisoscope.rig.acquisition.opening import open_eye

    camera = open_eye(part)
    stack.callback(camera.close)
    info = camera.info
    return {
        "device": f"{info.model} {info.serial}".strip(),
        "rows": info.rows,
        "cols": info.cols,
        "bit_depth": info.bit_depth,
        "black_level": info.black_level,
        "filters": info.filters,
        "linear": info.linear,
        "uncalibrated": file.uncalibrated(info),
        "pixel_um": part.pixel_um,
    }


def _light(part: "LightPart", stack: contextlib.ExitStack) -> dict[str, Any]:
    from anisoscope.rig.acquisition.opening import open_lamp

    light = open_lamp(part)
    stack.callback(light.close)
    return {
        "port": part.port,
        "device": str(getattr(light, "name", part.driver)),
        "angle_deg": part.angle_deg,
        "channels": list(part.channels),
    }


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
