"""``anisoscope rig sim``: simulated devices, and a whole virtual rig, for other programs."""

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from cyclopts import App, Parameter

from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.cli.options import Flag
from anisoscope.cli.rig.options import write_line
from anisoscope.parameters.moulding import MouldingRun
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.sim.bench.bench import Bench
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

app = App(name="sim", help="Serve a simulated device, byte by byte, to any program.")


@app.default
def device(
    name: Annotated[str, Parameter(help="Protocol: elliptec, zaber, grbl, apt or smc100; or light.")],
    /,
    *,
    pty: Annotated[bool, Parameter(negative="", help="Pseudo terminals: serve on a new one.")] = False,
    tcp: int | None = None,
    device_type: str = "",
    address: Annotated[str, Parameter(help="Bus address; the protocol's first if not given.")] = "",
    time_scale: float = 1.0,
    fault: Annotated[tuple[str, ...], Parameter(negative="")] = (),
) -> int:
    """Serve a simulated stage or light until Ctrl-C; the first line gives its port.

    Args:
        tcp: Serve on this TCP port of 127.0.0.1; 0 takes any free one.
        device_type: Device of the protocol, such as KDC101; the usual one if not given.
        time_scale: Stretch of time; 1 is real time, 0 ends every move at once.
        fault: Fault of the device, as NAME or NAME:NUMBER; may be repeated.

    Examples:
        anisoscope rig sim elliptec --tcp 4001
        anisoscope rig sim zaber --pty --fault stall:47.5
    """
    from anisoscope.sim.bench.firmware.catalogue import build, lone_mount, simulated
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

    simulated(name)
    if pty == (tcp is not None):
        raise UsageError(f"give one of --pty and --tcp; write: anisoscope rig sim {name} --tcp 4001")
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
@with_options(run=Options(MouldingRun, whole=True))
def press(
    *,
    out: Annotated[Path, Parameter(help="Folder for parts.csv and cycles.csv.")],
    run: Given[MouldingRun],
    opcua_port: int | None = None,
    every_s: Annotated[float, Parameter(help="With --opcua-port: seconds from cycle to cycle.")] = 30.0,
) -> int:
    """Simulate an injection moulding machine: its cycle data, and what was measured on the parts.

    `spc --csv parts.csv` reads the one, `history covariates cycles.csv` the other, or its cycles with `--opcua`.

    Args:
        opcua_port: TCP port of 127.0.0.1: serve the cycles by OPC 40077 (EUROMAP 77) too, until Ctrl-C.

    Examples:
        anisoscope rig sim press --out press --setting "mould temperature" --change -2
    """
    from anisoscope.sim.press import check_free, moulded, write_moulded

    asked = run.made()
    if opcua_port is not None and not 0 < opcua_port < 65536:
        raise UsageError(f"rig sim press: --opcua-port is a TCP port from 1 to 65535, not {opcua_port}")
    if not 0.0 < every_s < math.inf:
        raise UsageError(f"rig sim press: --every-s is above 0, not {every_s:g}")
    check_free(out)
    cycles = write_moulded(moulded(asked), out)
    print(f"{out / 'parts.csv'} and {out / 'cycles.csv'}: {asked.parts} parts", flush=True)  # noqa: T201
    if opcua_port is not None:
        _serve_press(opcua_port, cycles, every_s)
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
    tcp_base: int | None = None,
    pty: Flag = False,
    write_rig: Annotated[Path | None, Parameter(help="Write a rig file that uses them.")] = None,
) -> int:
    """Serve a whole virtual rig until Ctrl-C: its camera shows every motion of its stage to all clients.

    The first line says where: serving bench on stage 127.0.0.1:4001, light 127.0.0.1:4002, camera 127.0.0.1:4003.
    A tilt axis is on the line of the stage, as linear axes of its protocol are; lines of other protocols follow. Only
    programs of this machine can connect. Save the bench file with another table [sample] to lay that on the stage.

    Args:
        tcp_base: TCP port of the stage; the light has the next, the camera the one after; 0: any free ones.
        pty: Stage and light on pseudo terminals; the camera stays on TCP.

    Examples:
        anisoscope rig sim bench bench.toml --tcp-base 4001 --write-rig rig.toml
    """
    from anisoscope.sim.bench.bench import Bench
    from anisoscope.sim.bench.benchfile import read_bench
    from anisoscope.sim.bench.serving import MOST, serve_bench, write_rig_file

    if pty and tcp_base is not None:
        raise UsageError("rig sim bench: give one of --pty and --tcp-base PORT")
    base = tcp_base or 0
    if not 0 <= base < 65536 - MOST:
        raise UsageError(f"--tcp-base must lie between 0 and {65535 - MOST}, not {base}")
    virtual_rig = Bench(read_bench(file))
    with ExitStack() as stack:
        try:
            places, urls = serve_bench(virtual_rig, base, stack, pty=pty)
            if write_rig is not None:
                write_rig_file(virtual_rig, urls, write_rig)
            listing = ", ".join(f"{name} {place}" for name, place in places.items())
            print(f"serving bench on {listing}", flush=True)  # noqa: T201
            _lay_as_written(virtual_rig, file)
        except KeyboardInterrupt:
            return 0


LOOK_S = 0.5


def _lay_as_written(virtual_rig: "Bench", file: Path) -> NoReturn:
    """Lay on the stage what the bench file says, whenever it is saved."""
    import time

    from anisoscope.sim.bench.benchfile import read_bench

    seen = file.stat().st_mtime_ns
    while True:
        time.sleep(LOOK_S)
        try:
            now = file.stat().st_mtime_ns
            if now == seen:
                continue
            seen, sample = now, read_bench(file).sample
        except (OSError, RigFileError) as problem:
            write_line(f"the sample stays as it is: {problem}")
            continue
        if sample != virtual_rig.file.sample:
            virtual_rig.lay(sample)
            print(f"on the stage: {sample.kind}", flush=True)  # noqa: T201
