"""``anisoscope serve``: the console in the browser, at the station and over all stations."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.inspect.history_entry import HistoryOption, history_place, remember
from anisoscope.cli.inspect.inspection import explained
from anisoscope.cli.inspect.lot_mates import lot_mates
from anisoscope.cli.rig.options import RigPath, write_line

if TYPE_CHECKING:
    from anisoscope.console.station import Eyes

PORT = 8040


def serve(
    *,
    rig: RigPath,
    recipes: Annotated[Path, Parameter(help="Folder of the recipes that may be inspected here.")],
    out: Annotated[Path, Parameter(help="Folder that receives the inspection folders.")] = Path(
        "inspections"
    ),
    history: HistoryOption = None,
    users: Annotated[
        Path | None, Parameter(help="File of users; without it one user, at this computer only.")
    ] = None,
    host: Annotated[str, Parameter(help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, Parameter(help="TCP port; 0 takes any free one.")] = PORT,
    station: Annotated[str | None, Parameter(help="Station where the rig stands.")] = None,
    name: Annotated[
        tuple[str, ...],
        Parameter(
            name="--name", negative="", help="Name by which other computers call this one; may be repeated."
        ),
    ] = (),
    certificate: Annotated[Path | None, Parameter(help="TLS certificate (PEM).")] = None,
    key: Annotated[Path | None, Parameter(help="Its key (PEM).")] = None,
) -> int:
    """Serve the console: a page at the station and a page over all stations, until Ctrl-C.

    Examples:
        anisoscope serve --rig rig.toml --recipes recipes
    """
    try:
        from anisoscope.console.application import (
            Page,
            check_exposure,
            create_app,
            hosts_of,
            listen,
            server_of,
        )
    except ImportError as problem:
        raise UsageError(
            f"the console needs more packages ({problem.name}): pip install 'anisoscope[console]'"
        ) from problem
    from anisoscope.console.access import Access, Accounts, Trail, trail_of
    from anisoscope.console.fleet import fleet_router
    from anisoscope.console.station import Station, station_router
    from anisoscope.console.work import WorkerProcess, Workplace

    if (certificate is None) != (key is None):
        raise UsageError("--certificate and --key go together")
    tls = None if certificate is None or key is None else (certificate, key)
    check_exposure(host, users=users is not None, tls=tls is not None)
    if not recipes.is_dir():
        raise UsageError(f"--recipes {recipes}: there is no such folder")
    accounts = None if users is None else Accounts(users)
    if accounts is not None and not accounts.read():
        raise UsageError(f"--users {users}: has no accounts; `anisoscope user add` makes the first")
    place = history_place(history, out)
    rig, out = rig.resolve(), out.resolve()
    trail = Trail(out / "console.audit.jsonl") if users is None else trail_of(users.resolve())
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(listen(host, port))
        here = int(listener.getsockname()[1])
        own = stack.enter_context(_opened(rig))
        work = Workplace(rig, out, place, remember, lot_mates, explained)
        worker = WorkerProcess(work)
        stack.callback(worker.close)
        at = Station(work, recipes.resolve(), worker, own.stop, own.eyes, trail, station)
        app = create_app(
            Access(accounts, trail, secure=tls is not None),
            [station_router(at), fleet_router(place)],
            hosts_of(host, here, name),
            pages=[Page("/station", "Station"), Page("/fleet", "Fleet")],
            closing=at.end,
        )
        server = server_of(app, tls)
        address = f"http{'s' * (tls is not None)}://{host}:{here}/"
        print(message("console at {path}", path=address), flush=True)  # noqa: T201
        write_line(message("Ctrl-C ends it"))
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])
    return 0


@dataclass(frozen=True)
class _Open:
    """Camera and light of the rig for the live picture, and what stops its axes."""

    eyes: "Eyes | None"
    stop: Callable[[], dict[str, str]]


@contextlib.contextmanager
def _opened(rig: Path) -> Iterator[_Open]:
    """The rig, held by this process, or by another one that holds it already (`anisoscope rig hold`).

    Raises:
        UsageError: a device asks the operator in a terminal, which a page has not.
    """
    from anisoscope.console.station import Eyes
    from anisoscope.rig.acquisition.opening import hold_devices, open_devices
    from anisoscope.rig.hold import ASKING, SharedCamera, is_held
    from anisoscope.rig.holdline import stop_held
    from anisoscope.rig.rigfile import read_rig

    file = read_rig(rig)
    asking = [table for table, part in file.axes.items() if part.driver in ASKING]
    asking += ["light"] * (file.light.driver in ASKING)
    if asking:
        raise UsageError(
            f"{rig}: {' and '.join(asking)} of this rig are set by hand, which asks in a terminal: use "
            "`anisoscope inspect` there"
        )
    if any(map(is_held, file.axes.values())):
        with open_devices({}, file.camera, file.light) as devices:
            assert devices.camera is not None

            def stop() -> dict[str, str]:
                return {table: why for found in stop_held(rig).values() for table, why in found.items()}

            yield _Open(Eyes(SharedCamera(devices.camera), devices.light), stop)
        return
    with hold_devices(file.axes, file, str(rig)) as held:
        camera = held.owner.camera
        eyes = None if camera is None else Eyes(camera, held.devices.light)
        yield _Open(eyes, held.owner.stop_all)
