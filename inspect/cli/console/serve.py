"""``anisoscope serve``: the console in the browser, at the station and over all stations."""

import contextlib
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.help_page import MORE
from anisoscope.cli.log import chosen_language
from anisoscope.cli.options import INTO, Into, extra_packages
from anisoscope.cli.rig.options import RigPath, write_line
from anisoscope.parameters.serving import ConsoleSettings
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.console.openid import OpenId
    from anisoscope.live_view.lamps import RigLamps


@with_options(settings=Options(ConsoleSettings, repeated=("name",), groups={"idle": MORE}, whole=True))
def serve(
    *,
    rig: RigPath,
    recipes: Annotated[Path, Parameter(help="Folder of the recipes that may be inspected here.")],
    into: Into = INTO,
    settings: Given[ConsoleSettings],
) -> int:
    """Serve the console: a page at the station and a page over all stations, until Ctrl-C.

    Examples:
        anisoscope serve --rig rig.toml --recipes recipes
    """
    from anisoscope.operations.findings import explained
    from anisoscope.operations.remembering import (
        history_place,
        judge_lot,
        lot_mates,
        remember,
        unsigned,
        used_before,
    )

    with extra_packages("the console", "console"):
        from anisoscope.console.application import (
            Page,
            check_exposure,
            create_app,
            hosts_of,
            listen,
            run_server,
            server_of,
        )
    from anisoscope.console.access import Access, accounts_in
    from anisoscope.console.fleet import fleet_router
    from anisoscope.console.live import Eyes
    from anisoscope.console.routes import station_router
    from anisoscope.console.station import Station
    from anisoscope.console.trail import Trail, trail_of
    from anisoscope.history.signs import Beacon
    from anisoscope.inspection.work import WorkerProcess, Workplace, held_rig

    @functools.cache
    def lamps() -> "RigLamps":  # loads much that the first page does not need
        from anisoscope.live_view.lamps import RigLamps

        return RigLamps(rig)

    asked = settings.made()
    users, tls, out = asked.users, asked.tls, into.out
    check_exposure(asked.host, users=users is not None, tls=tls is not None)
    if not recipes.is_dir():
        raise UsageError(f"--recipes {recipes}: there is no such folder")
    accounts = None if users is None else accounts_in(users)
    provider = _provider(asked.openid)
    place = history_place(into.history, out)
    rig, out = rig.resolve(), out.resolve()
    trail = Trail(out / "console.audit.jsonl") if users is None else trail_of(users.resolve())
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(listen(asked.host, asked.port))
        here = int(listener.getsockname()[1])
        own = stack.enter_context(held_rig(rig))
        eyes = None if own.camera is None else Eyes(own.camera, own.light, own.channel, lamps)
        work = Workplace(
            rig, out, place, remember, lot_mates, explained, used_before=used_before, judge_lot=judge_lot
        )
        worker = WorkerProcess(work)
        stack.callback(worker.close)
        beacon = stack.enter_context(Beacon(place, asked.station, unsigned))
        at = Station(work, recipes.resolve(), worker, own.stop, eyes, trail, asked.station, beacon.show)
        app = create_app(
            Access(accounts, trail, secure=tls is not None, openid=provider, idle_s=60.0 * asked.idle),
            [station_router(at), fleet_router(place)],
            hosts_of(asked.host, here, asked.name),
            pages=[Page("/station", "Station"), Page("/fleet", "Fleet")],
            lang=chosen_language(),
            closing=at.end,
        )
        address = f"http{'s' * (tls is not None)}://{asked.host}:{here}/"
        print(message("console at {path}", path=address), flush=True)  # noqa: T201
        write_line(message("Ctrl-C ends it"))
        run_server(server_of(app, tls, at.log.close), listener)
    return 0


def _provider(file: Path | None) -> "OpenId | None":
    if file is None:
        return None
    from anisoscope.console.openid import OpenId, read_provider

    with extra_packages("--openid", "openid"):
        return OpenId(read_provider(file))
