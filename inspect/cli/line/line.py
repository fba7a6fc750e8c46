"""``anisoscope line``: serve a rig to the controller of a line."""

import asyncio
import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from anisoscope.base.address import is_loopback
from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.help_page import MORE
from anisoscope.cli.options import Into, Trusted, extra_packages
from anisoscope.cli.rig.options import RigPath, write_line
from anisoscope.parameters.serving import Addresses
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.line.jobs import Jobs
    from anisoscope.line.mqtt import Broker

app = App(name="line", help="Serve a rig to the controller of a line: jobs by OPC UA, MQTT or Modbus/TCP.")
Recipes = Annotated[Path, Parameter(help="Folder of the recipes that may be inspected here.")]
Wanted = Literal["all", "not-pass", "none"]


@Parameter(name="*")
@dataclass(frozen=True)
class Kept(Into):
    """Folder, history and reports of ordered inspections."""

    station: Annotated[
        str | None, Parameter(help="Station where the rig stands; the fleet page shows what it does.")
    ] = None
    reports: Annotated[
        Wanted,
        Parameter(
            group=MORE,
            help="Parts whose report.html is written: all, those that are not PASS, or none. `anisoscope report "
            "FOLDER` writes any other one later.",
        ),
    ] = "all"

    def jobs(self, rig: Path, recipes: Path) -> "AbstractContextManager[Jobs]":
        """The jobs of a rig; errors as for `jobs_at`."""
        from anisoscope.line.jobs import jobs_at

        return jobs_at(rig, recipes, self.out, self.history, self.station, self.reports)


@Parameter(name="*")
@dataclass(frozen=True)
class Secured(Trusted):
    """Encryption and log in of a server.

    Attributes:
        open_: Let every computer that reaches the address order jobs: there is no encryption and no password.
        users: With --certificate: file of users, who log in by name and password.
    """

    open_: Annotated[bool, Parameter(name="--open", negative="")] = False
    users: Path | None = None


KEPT, PLAIN = Kept(), Secured()


@app.command
def opcua(
    *,
    rig: RigPath,
    recipes: Recipes,
    kept: Kept = KEPT,
    host: Annotated[str, Parameter(help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, Parameter(help="TCP port.")] = 4840,
    secured: Secured = PLAIN,
) -> int:
    """Serve the rig by OPC UA for Machine Vision (OPC 40100-1), until Ctrl-C.

    Examples:
        anisoscope line opcua --rig rig.toml --recipes recipes
        anisoscope line opcua --rig rig.toml --recipes recipes --certificate c.der --key key.pem --peers peers
    """
    with extra_packages("OPC UA", "line"):
        from anisoscope.line.opcua import VisionServer, long_lived
        from anisoscope.line.opcua_security import read_security

    users, open_ = secured.users, secured.open_
    security = read_security(secured.certificate, secured.key, secured.peers, write_line)
    if users is not None:
        if security is None:
            raise UsageError("--users goes with --certificate: a password is never sent without encryption")
        with extra_packages("--users", "console"):
            from anisoscope.console.access import log_in_of
        security = replace(security, log_in=log_in_of(users))
    if security is not None and open_:
        raise UsageError("--open is for a server without --certificate: with it, only --peers may order jobs")
    check_open(host, open_=open_ or security is not None)
    with kept.jobs(rig, recipes) as jobs:

        async def serve() -> None:
            async with contextlib.AsyncExitStack() as stack:
                with long_lived():
                    server = VisionServer(jobs, recipes.resolve(), host, port, security=security)
                    await stack.enter_async_context(server)
                _say_address(server.address)
                await _until_signalled()

        asyncio.run(serve())
    return 0


@Parameter(name="*")
@dataclass(frozen=True)
class Topics:
    """Names in the topics of a broker.

    Attributes:
        node: Sparkplug edge node; another one for every rig at the broker.
    """

    group: Annotated[str, Parameter(help="Sparkplug group.")] = "anisoscope"
    node: str = "rig"
    device: Annotated[str, Parameter(help="Sparkplug device.")] = "inspection"


TOPICS = Topics()


@app.command
def mqtt(
    *,
    broker: Annotated[str, Parameter(help="Address: mqtt://[user:password@]host[:1883] or mqtts://…")],
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    recipes: Annotated[Path | None, Parameter(help="Folder of the recipes that may be ordered.")] = None,
    kept: Kept = KEPT,
    topics: Topics = TOPICS,
    open_: Annotated[bool, Parameter(name="--open", negative="")] = False,
) -> int:
    """Publish results by MQTT as Sparkplug B and JSON, until Ctrl-C; with --rig and --recipes take orders of jobs.

    Args:
        rig: Rig file; without it only results are published.
        open_: With --rig: take orders over a broker elsewhere without encryption.

    Examples:
        anisoscope line mqtt --broker mqtt://127.0.0.1 --rig rig.toml --recipes recipes
        anisoscope line mqtt --broker mqtts://broker.example --history inspections/history.sqlite
    """
    from anisoscope.operations.remembering import history_place

    with extra_packages("MQTT", "line"):
        from anisoscope.line.mqtt import EdgeNode, broker_of
        from anisoscope.line.sparkplug import Names

    if (rig is None) != (recipes is None):
        raise UsageError("--rig and --recipes go together: the rig that inspects, and what may be ordered")
    if rig is None and kept.reports != "all":
        raise UsageError("--reports is for parts that are inspected here: add --rig and --recipes")
    where, names = broker_of(broker), Names(topics.group, topics.node, topics.device)
    place = history_place(kept.history, kept.out)
    if place is None:
        raise UsageError("MQTT publishes what the history gains: name one with --history")
    with contextlib.ExitStack() as stack:
        jobs: Jobs | None = None
        if rig is not None and recipes is not None:
            _check_reach(where, open_=open_)
            jobs = stack.enter_context(kept.jobs(rig, recipes))
        served = EdgeNode(where, names, place, kept.out / "line" / "mqtt.json", write_line, jobs)
        if jobs is not None:
            stack.enter_context(jobs)  # a job that a killed process left goes on, and is heard of
        stack.enter_context(_at_signals(served.end))
        write_line(message("Ctrl-C ends it"))
        served.run()
    return 0


def _check_reach(broker: "Broker", *, open_: bool) -> None:
    """Refuse to take orders unencrypted from elsewhere without a word that everybody there may order jobs.

    Raises:
        UsageError: it was not said.
    """
    if not (is_loopback(broker.host) or broker.tls or open_):
        raise UsageError(
            f"orders over {broker} are not encrypted, and each client there may move the rig: mqtts://, or --open"
        )


@app.command
@with_options(addresses=Options(Addresses, names={"device": "--unit"}, whole=True))
def modbus(
    plc: Annotated[str, Parameter(help="Address of the controller or coupler, HOST or HOST:PORT.")],
    /,
    *,
    rig: RigPath,
    recipes: Recipes,
    recipe: Annotated[
        str, Parameter(name=["--recipe", "-r"], help="Name of the recipe: its file without .toml.")
    ],
    kept: Kept = KEPT,
    addresses: Given[Addresses],
    prefix: Annotated[str, Parameter(help="Begins the serial number; the number of the job follows.")] = "",
) -> int:
    """Inspect a part at every trigger of a controller and set its result lines, by Modbus/TCP, until Ctrl-C.

    Examples:
        anisoscope line modbus 192.168.1.10 --rig rig.toml --recipes recipes --recipe plate
    """
    with extra_packages("Modbus/TCP", "line"):
        from anisoscope.line.modbus import POLL_S, Handshake, Lines, ModbusIo
    from anisoscope.base.crash import Steady
    from anisoscope.base.errors import NotConnected

    host, _, port = plc.partition(":")
    if not host or not (port or "502").isdigit():
        raise UsageError(f"{plc}: give the controller as HOST or HOST:PORT")
    io = ModbusIo(host, int(port or 502), addresses.made())
    stop = threading.Event()
    with _at_signals(stop.set), contextlib.closing(io), kept.jobs(rig, recipes) as jobs, jobs:
        jobs.check(recipe)
        handshake = Handshake(io, jobs, recipe, prefix, write_line)
        steady = Steady("line modbus", write_line)
        _say_address(f"modbus://{plc}")
        while not stop.wait(POLL_S):
            steady(handshake.step, None)
        with contextlib.suppress(NotConnected):
            io.write(Lines())
    return 0


@app.command
def certificate(
    *,
    out: Annotated[Path, Parameter(help="Folder that receives certificate.der and key.pem.")],
    name: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    uri: str | None = None,
    days: Annotated[int, Parameter(help="Days for which it is valid.")] = 3 * 365,
) -> int:
    """Make a self-signed certificate and its key, by which other programs of OPC UA know this one.

    Args:
        name: Name or address by which others call this computer; may be repeated.
        uri: URI of the application; by default urn:COMPUTER:anisoscope.

    Examples:
        anisoscope line certificate --out own --name rig-1.example --name 192.168.1.20
    """
    with extra_packages("OPC UA", "line"):
        from anisoscope.line.opcua_security import make_identity

    here = socket.gethostname()
    made, secret = make_identity(out, uri or f"urn:{here}:anisoscope", name or (here,), days)
    print(f"{made} for others to trust, {secret} for this computer alone", flush=True)  # noqa: T201
    return 0


def check_open(host: str, *, open_: bool) -> None:
    """Refuse to listen beyond this computer without a word that everybody there may order jobs.

    Raises:
        UsageError: it was not said.
    """
    if not (is_loopback(host) or open_):
        raise UsageError(
            f"--host {host} can be reached from other computers, each of which may then move the rig: trust some with "
            "--certificate, --key and --peers, or put it into a network of its own and add --open"
        )


def _say_address(address: str) -> None:
    print(message("line at {path}", path=address), flush=True)  # noqa: T201
    write_line(message("Ctrl-C ends it"))


@contextlib.contextmanager
def _at_signals(do: Callable[[], object]) -> Iterator[None]:
    """What Ctrl-C and SIGTERM do meanwhile."""
    before = {one: signal.signal(one, lambda *_: do()) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


async def _until_signalled() -> None:
    """Wait for the first Ctrl-C or SIGTERM."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    with _at_signals(lambda: loop.call_soon_threadsafe(stop.set)):
        await stop.wait()
