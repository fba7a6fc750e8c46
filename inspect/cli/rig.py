"""``anisoscope rig``: the ports of this machine, and simulated devices for other programs."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

app = App(name="rig", help="Look after the rig: list ports, serve simulated devices.")
sim = App(name="sim", help="Serve a simulated device, byte by byte, to any program.")
app.command(sim)


@app.command
def ports(*, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """List the serial ports of this machine, without opening any.

    Args:
        json: print a JSON list instead of lines.
    """
    from json import dumps

    from serial.tools import list_ports

    found = [
        {"port": port.device, "description": port.description or "", "serial": port.serial_number or ""}
        for port in sorted(list_ports.comports())
    ]
    if json:
        print(dumps(found, ensure_ascii=False))  # noqa: T201
        return
    for port in found:
        print("  ".join(text for text in port.values() if text))  # noqa: T201
    if not found:
        print("no serial ports")  # noqa: T201


@sim.default
def device(
    name: Annotated[str, Parameter(help="Protocol: elliptec, zaber, grbl, apt or smc100.")],
    /,
    *,
    pty: Annotated[bool, Parameter(negative="")] = False,
    tcp: int | None = None,
    model: str = "",
    address: str = "",
    time_scale: float = 1.0,
    fault: Annotated[tuple[str, ...], Parameter(negative="")] = (),
) -> int:
    """Serve a simulated stage until Ctrl-C; the first line says where.

    Args:
        pty: serve on a new pseudo terminal.
        tcp: serve on this TCP port of 127.0.0.1; 0 takes any free one.
        model: which device of the protocol; the usual one if not given.
        address: bus address; the protocol's first if not given.
        time_scale: stretch of time; 1 is real time, 0 ends every move at once.
        fault: what is wrong with the device, as NAME or NAME:NUMBER; may be repeated.
    """
    from anisoscope.sim.bench.firmware.axis import RotaryAxis
    from anisoscope.sim.bench.firmware.catalogue import Mount, build
    from anisoscope.sim.bench.serve import PtyServer, TcpServer

    if pty == (tcp is not None):
        raise UsageError(f"rig sim {name}: give exactly one of --pty and --tcp PORT")
    if not 0.0 <= time_scale < float("inf"):
        raise UsageError(f"rig sim {name}: --time-scale must be a number, 0 or more")
    firmware = build(name, [Mount(RotaryAxis(time_scale=time_scale), address)], model=model, faults=fault)
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
