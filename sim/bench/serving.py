"""Virtual rig served to other programs, and the rig file that names its devices."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import tomli_w

from anisoscope.base.atomic_write import write_text
from anisoscope.sim.bench.bench import Bench
from anisoscope.sim.bench.benchfile import BenchFile
from anisoscope.sim.bench.camera import SimulatedCamera
from anisoscope.sim.bench.camera_server import CameraServer
from anisoscope.sim.bench.firmware.device import Firmware
from anisoscope.sim.bench.serve import PtyServer, TcpServer

MOST = 6
OTHERS = 3  # ports of stage, light and camera


def serve_bench(
    virtual_rig: Bench, base: int, stack: ExitStack, *, pty: bool
) -> tuple[dict[str, str], dict[str, str]]:
    """Serve all devices of a virtual rig.

    Args:
        virtual_rig: the rig.
        base: TCP port of the stage; light and camera have the next ones. 0: any free ones.
        stack: ends the servers.
        pty: stage and light on pseudo terminals.

    Returns:
        Ports by device, and their addresses for a rig file.

    Raises:
        RigError: a port is taken.
    """

    def line(firmware: Firmware, number: int) -> PtyServer | TcpServer:
        return PtyServer(firmware) if pty else TcpServer(firmware, base and base + number)

    own = virtual_rig.file.stage.protocol
    others: list[str] = [name for name in virtual_rig.lines if name != own]
    lines: dict[str, PtyServer | TcpServer] = {
        "stage": line(virtual_rig.device(own), 0),
        "light": line(virtual_rig.light_firmware, 1),
    }
    camera = CameraServer(lambda: SimulatedCamera(virtual_rig), base and base + 2)
    for number, name in enumerate(others, start=OTHERS):
        lines[name] = line(virtual_rig.device(name), number)
    if virtual_rig.file.filters:
        others.append("wheel")
        lines["wheel"] = line(virtual_rig.wheel, OTHERS + len(others) - 1)
    for server in (*lines.values(), camera):
        stack.enter_context(server)
    places = {"stage": lines["stage"].port, "light": lines["light"].port, "camera": camera.port}
    places.update((name, lines[name].port) for name in others)
    urls: dict[str, str] = {name: one.url for name, one in lines.items()}
    return places, urls | {"camera": camera.port}


def write_rig_file(virtual_rig: Bench, urls: dict[str, str], path: Path) -> None:
    """Write a rig file that states the truth about the bench: zeros, senses, pixel size, fixture."""
    file = virtual_rig.file
    stage: dict[str, Any] = {
        "driver": file.stage.protocol,
        "port": urls["stage"],
        "zero_deg": file.stage.zero_deg,
        "turns": file.stage.turns,
    }
    if file.stage.address:
        stage["options"] = {_AXIS_OPTION.get(file.stage.protocol, "address"): file.stage.address}
    table: dict[str, Any] = {"schema": 1, "name": "virtual rig in another process", "stage": stage}
    if file.tilt is not None:
        protocol = file.stage.protocol
        table["tilt"] = {
            "driver": protocol,
            "port": urls["stage"],
            "zero_deg": file.tilt.zero_deg,
            "sign": file.tilt.sign,
            "options": {
                _AXIS_OPTION.get(protocol, "address"): file.tilt.address or _SECOND.get(protocol, "2")
            },
        }
    else:
        table["geometry"] = {"tilt_deg": file.geometry.tilt_deg}
    for name, part in file.linear.items():
        table[name] = {
            "driver": part.protocol,
            "port": urls["stage" if part.protocol == file.stage.protocol else part.protocol],
            "zero_mm": part.zero_mm,
            "sign": part.sign,
            "options": _linear_options(virtual_rig, name),
        }
    table["camera"] = {
        "driver": "simulated",
        "pixel_um": file.optics.pixel_um,
        "options": {"port": urls["camera"]},
    }
    if file.sensor.filters != "mono" or file.sample.kind == "print":
        table["camera"]["sensitivities"] = file.sensor.sensitivities
    table["light"] = {
        "driver": "coolled" if file.lamps else "serial",
        "port": urls["light"],
        "angle_deg": file.geometry.light_angle_deg,
        "spectrum": file.optics.spectrum,
        **_channels(file, urls.get("wheel")),
    }
    if file.fixture is not None:
        table["fixture"] = file.fixture.model_dump(mode="json")
    write_text(path, tomli_w.dumps(table))


def _channels(file: BenchFile, wheel: str | None) -> dict[str, Any]:
    """Light channels: each lamp, behind each filter."""
    found: dict[str, dict[str, Any]] = {}
    for letter in (*file.lamps, *([] if file.lamps else [""])):
        lamp = next((one for name, one in file.lamps.items() if name == letter), None)
        shared: dict[str, Any] = (
            {} if lamp is None else {"lamps": [letter], "angle_deg": lamp.light_angle_deg}
        )
        for place, passed in enumerate(file.filters or (None,), 1):
            own = shared if passed is None else shared | {"filter": place}
            nm = (None if passed is None else passed.wavelength_nm) or (
                None if lamp is None else lamp.wavelength_nm
            )
            if own:
                name = "-".join([letter] * bool(letter) + [str(place)] * (passed is not None))
                found[name] = own if nm is None else own | {"wavelength_nm": nm}
    named = {"channels": found, "channel": next(iter(found))} if found else {}
    return named if wheel is None else {"wheel": {"driver": "fw102c", "port": wheel}, **named}


def _linear_options(virtual_rig: Bench, name: str) -> dict[str, str | int | float]:
    """Options of a driver for a linear axis: its address on its line, and the scale if the device does not say it."""
    file = virtual_rig.file
    part = file.linear[name]
    turning = 0 if part.protocol != file.stage.protocol else 1 if file.tilt is None else 2
    before = [one for one, other in file.linear.items() if other.protocol == part.protocol].index(name)
    place = turning + before
    match part.protocol:
        case "grbl":
            return {"axis": "Z"}
        case "apt":
            return {} if part.model == "LTS150" else {"actuator": part.model or "MTS25-Z8"}
        case "elliptec":
            return {"address": part.address or f"{place:X}"}
        case "zaber":
            return {"address": part.address or str(place + 1), "counts_per_mm": 1000.0 / 0.047625}
        case _:
            return {"address": part.address or str(place + 1)}


# How a driver is told which axis of the line it drives, and what the second of a bench is called.
_AXIS_OPTION = {"grbl": "axis"}
_SECOND = {"elliptec": "1", "zaber": "2", "grbl": "Y", "smc100": "2"}
