"""``anisoscope rig sim``: simulated devices, and a whole virtual rig, for other programs."""

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.bench.bench import Bench
    from anisoscope.sim.bench.benchfile import BenchFile
    from anisoscope.sim.bench.firmware.device import Firmware
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

app = App(name="sim", help="Serve a simulated device, byte by byte, to any program.")
MOST = 6
OTHERS = 3  # ports of stage, light and camera


@app.default
def device(
    name: Annotated[str, Parameter(help="Protocol: elliptec, zaber, grbl, apt or smc100; or light.")],
    /,
    *,
    pty: Annotated[bool, Parameter(negative="", help="Pseudo terminals: serve on a new one.")] = False,
    tcp: Annotated[
        int | None, Parameter(help="Serve on this TCP port of 127.0.0.1; 0 takes any free one.")
    ] = None,
    device_type: Annotated[
        str, Parameter(help="Device of the protocol, such as KDC101; the usual one if not given.")
    ] = "",
    address: Annotated[str, Parameter(help="Bus address; the protocol's first if not given.")] = "",
    time_scale: Annotated[
        float, Parameter(help="Stretch of time; 1 is real time, 0 ends every move at once.")
    ] = 1.0,
    fault: Annotated[
        tuple[str, ...],
        Parameter(negative="", help="Fault of the device, as NAME or NAME:NUMBER; may be repeated."),
    ] = (),
) -> int:
    """Serve a simulated stage or light until Ctrl-C; the first line gives its port.

    Examples:
        anisoscope rig sim elliptec --tcp 4001
        anisoscope rig sim zaber --pty --fault stall:47.5
    """
    from anisoscope.sim.bench.firmware.catalogue import build, lone_mount
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

    if pty == (tcp is not None):
        raise UsageError(f"rig sim {name}: give exactly one of --pty and --tcp PORT")
    if not 0.0 <= time_scale < float("inf"):
        raise UsageError(f"rig sim {name}: --time-scale must be a number, 0 or more")
    mount = lone_mount(name, device_type, address, time_scale)
    firmware = build(name, [mount], model=device_type, faults=fault)
    return _serve(name, PtyServer(firmware) if tcp is None else TcpServer(firmware, tcp))


def _serve(name: str, server: "PtyServer | TcpServer") -> int:
    """Serve until Ctrl-C or SIGTERM (which the command line turns into the same); that is a normal end."""
    print(f"serving {name} on {server.port}", flush=True)  # noqa: T201
    try:
        server.run()
    except KeyboardInterrupt:
        return 0
    finally:
        server.close()
    return 0


@app.command
def press(
    *,
    out: Annotated[Path, Parameter(help="Folder for parts.csv and cycles.csv.")],
    parts: Annotated[int, Parameter(help="Parts that are inspected, one shot in 20.")] = 300,
    setting: Annotated[
        str | None, Parameter(help="Setting that changes, such as 'mould temperature'.")
    ] = None,
    change: Annotated[float, Parameter(help="By how much, in °C, bar, s or shots.")] = 0.0,
    onset: Annotated[int, Parameter(help="First part with the change, counted from 1.")] = 200,
    ramp: Annotated[int, Parameter(help="Parts over which it grows; 0 for a step.")] = 0,
    seed: Annotated[int, Parameter(help="Seed of the noise.")] = 1,
    opcua_port: Annotated[
        int | None,
        Parameter(
            help="TCP port of 127.0.0.1: serve the cycles by OPC 40077 (EUROMAP 77) too, until Ctrl-C."
        ),
    ] = None,
    every_s: Annotated[float, Parameter(help="With --opcua-port: seconds from cycle to cycle.")] = 30.0,
) -> int:
    """Simulate an injection moulding machine: its cycle data, and what was measured on the parts.

    `spc --csv parts.csv` reads the one, `history covariates cycles.csv` the other, or its cycles with `--opcua`.

    Examples:
        anisoscope rig sim press --out press --setting "mould temperature" --change -2
    """
    from datetime import UTC, datetime, timedelta

    import numpy as np

    from anisoscope.base.atomic_write import write_text
    from anisoscope.base.csv_style import csv_text, number_text
    from anisoscope.sim.press import Change, mould

    if opcua_port is not None and not 0 < opcua_port < 65536:
        raise UsageError(f"rig sim press: --opcua-port is a TCP port from 1 to 65535, not {opcua_port}")
    if not 0.0 < every_s < math.inf:
        raise UsageError(f"rig sim press: --every-s is above 0, not {every_s:g}")
    if min(parts, onset) < 1 or ramp < 0 or not math.isfinite(change):
        raise UsageError(
            "rig sim press: --parts and --onset are at least 1, --ramp at least 0, --change is finite"
        )
    if (setting is None) != (change == 0.0):
        raise UsageError("rig sim press: --setting and --change go together")
    taken = next((out / one for one in ("parts.csv", "cycles.csv") if (out / one).exists()), None)
    if taken is not None:
        raise UsageError(f"rig sim press: {taken} exists: give another --out")
    changes = () if setting is None else (Change(setting, change, onset - 1, ramp),)
    made = mould(parts, changes, np.random.default_rng(seed))
    start = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)
    times = [(start + timedelta(seconds=one)).isoformat(timespec="seconds") for one in made.seconds.tolist()]
    serials = [f"P-{number:04d}" for number in range(1, parts + 1)]
    out.mkdir(parents=True, exist_ok=True)
    for name, columns in (("parts.csv", made.measured | made.cycles), ("cycles.csv", made.cycles)):
        rows = [
            [time, serial, *(number_text(f"{column[k]:.7g}") for column in columns.values())]
            for k, (time, serial) in enumerate(zip(times, serials, strict=True))
        ]
        write_text(out / name, csv_text([["time", "serial", *columns], *rows]))
    print(f"{out / 'parts.csv'} and {out / 'cycles.csv'}: {parts} parts", flush=True)  # noqa: T201
    if opcua_port is not None:
        cycles = [{name: float(column[k]) for name, column in made.cycles.items()} for k in range(parts)]
        _serve_press(opcua_port, dict(zip(serials, cycles, strict=True)), every_s)
    return 0


def _serve_press(port: int, cycles: dict[str, dict[str, float]], every_s: float) -> None:
    """Serve the cycles one after the other, by part, until Ctrl-C.

    Raises:
        UsageError: asyncua is not installed, or the port is taken.
    """
    import asyncio
    import contextlib

    try:
        from anisoscope.sim.press_server import PressServer
    except ImportError as problem:
        raise UsageError(
            f"OPC UA needs more packages ({problem.name}): pip install 'anisoscope[line]'"
        ) from problem

    async def serve() -> None:
        async with PressServer(port) as server:
            print(f"press at {server.address}", flush=True)  # noqa: T201
            for part, settings in cycles.items():
                await asyncio.sleep(every_s)
                await server.cycle(settings, part)
            await asyncio.Event().wait()

    try:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(serve())
    except OSError as problem:
        raise UsageError(
            f"cannot serve at port {port}: {problem.strerror}; choose another --opcua-port"
        ) from None


@app.command
def bench(
    file: Annotated[Path, Parameter(help="Bench file (TOML).")],
    /,
    *,
    tcp_base: Annotated[
        int | None,
        Parameter(
            help="TCP port of the stage; the light has the next, the camera the one after; 0: any free ones."
        ),
    ] = None,
    pty: Annotated[
        bool, Parameter(negative="", help="Stage and light on pseudo terminals; the camera stays on TCP.")
    ] = False,
    write_rig: Annotated[Path | None, Parameter(help="Write a rig file that uses them.")] = None,
) -> int:
    """Serve a whole virtual rig until Ctrl-C: its camera shows every motion of its stage to all clients.

    The first line says where: serving bench on stage 127.0.0.1:4001, light 127.0.0.1:4002, camera 127.0.0.1:4003.
    A tilt axis is on the line of the stage, as linear axes of its protocol are; lines of other protocols follow. Only
    programs of this machine can connect.

    Examples:
        anisoscope rig sim bench bench.toml --tcp-base 4001 --write-rig rig.toml
    """
    import threading

    from anisoscope.sim.bench.bench import Bench
    from anisoscope.sim.bench.benchfile import read_bench

    if pty and tcp_base is not None:
        raise UsageError("rig sim bench: give one of --pty and --tcp-base PORT")
    base = tcp_base or 0
    if not 0 <= base < 65536 - MOST:
        raise UsageError(f"--tcp-base must lie between 0 and {65535 - MOST}, not {base}")
    virtual_rig = Bench(read_bench(file))
    with ExitStack() as stack:
        try:
            places, urls = _serve_bench(virtual_rig, base, stack, pty=pty)
            if write_rig is not None:
                _write_rig(virtual_rig, urls, write_rig)
            listing = ", ".join(f"{name} {place}" for name, place in places.items())
            print(f"serving bench on {listing}", flush=True)  # noqa: T201
            threading.Event().wait()
        except KeyboardInterrupt:
            return 0
    return 0


def _serve_bench(
    virtual_rig: "Bench", base: int, stack: ExitStack, *, pty: bool
) -> tuple[dict[str, str], dict[str, str]]:
    """Serve all devices; print their ports, and the entries for a rig file."""
    from anisoscope.sim.bench.camera import SimulatedCamera
    from anisoscope.sim.bench.camera_server import CameraServer
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

    def line(firmware: "Firmware", number: int) -> "PtyServer | TcpServer":
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


def _write_rig(virtual_rig: "Bench", urls: dict[str, str], path: Path) -> None:
    """A rig file that knows the truth about the bench: zeros, senses, pixel size, fixture."""
    import tomli_w

    from anisoscope.base.atomic_write import write_text

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


def _channels(file: "BenchFile", wheel: str | None) -> dict[str, Any]:
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


def _linear_options(virtual_rig: "Bench", name: str) -> dict[str, str | int | float]:
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
