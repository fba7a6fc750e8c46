"""``anisoscope rig focus``: bring the part into focus with the axis z, and say how repeatable that is."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import CalibrationError
from anisoscope.base.language import decimal, message, translated
from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import OF_SHOT, RigPath, Yes, asking
from anisoscope.cli.tables import answer
from anisoscope.parameters.taking import Shot, Sweep, Taking
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.operations.rigging import Focused


@with_options(
    shot=replace(OF_SHOT, groups={"channel": MORE}),
    sweep=Options(
        Sweep,
        names={"low": "--from", "high": "--to", "repeats": "--repeat"},
        groups=dict.fromkeys(("steps", "measure", "average"), MORE),
        whole=True,
    ),
)
@everyday("rig", "map_", "out", "yes", "json_")
def focus(
    *,
    rig: RigPath,
    sweep: Given[Sweep],
    shot: Given[Shot],
    map_: Annotated[Path | None, Parameter(name="--map")] = None,
    out: Annotated[Path, Parameter(help="With --map: record to write.")] = Path("focus.json"),
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Bring the part into focus: sweep z, fit a curve to the sharpness, and go to its peak.

    Nothing is moved beyond the search (and z.approach_mm below it). An axis that was not homed is homed first: confirm,
    or give --yes. With --map x and y bring every seat below the camera, and a surface through its focus is fitted:
    name the record in the rig file under [calibration] focus, and inspections go to it.

    Args:
        map_: Focus map: z at the seats of this tray list (x_mm, y_mm), as a calibration.

    Examples:
        anisoscope rig focus --rig rig.toml --exposure 0.005 --from 9.5 --to 10.5
        anisoscope rig focus --rig rig.toml --exposure 0.005 --from 8 --to 12 --map tray.csv --yes
    """
    from anisoscope.operations.rigging import focus as focused

    search, seen = sweep.made(), shot.made()
    if map_ is not None:
        return _map(rig, map_, out, seen, search, yes=yes, json_=json_)
    done = focused(rig, search, shot=seen, confirm=asking(rig, yes=yes))
    answer(done, [_line(done)], json_=json_)
    return 0


def _map(
    rig: Path,
    tray: Path,
    out: Path,
    shot: Shot,
    sweep: Sweep,
    *,
    yes: bool,
    json_: bool,
) -> int:
    from anisoscope.cli.progress import progress
    from anisoscope.inspection.batch.tray import read_tray
    from anisoscope.live_view.autofocus import LEAST_SEATS, map_focus

    seats = [slot.place_mm for slot in read_tray(tray).slots if slot.place_mm is not None]
    asking(rig, yes=yes)(
        message("the axes search their references and go to {count} seats", count=len(seats))
    )
    with progress("focus map", quiet=json_) as advance:
        record = map_focus(
            rig, seats, out, Taking(shot.exposure_s, shot.gain, light_channel=shot.channel), sweep, advance
        )
    if json_:
        print_json({"file": str(out), **record.model_dump(mode="json")})
    else:
        slope = 1000.0 * math.hypot(record.number("slope_x"), record.number("slope_y"))
        print(  # noqa: T201
            message(
                "{path}: {count} seats, z {place} at the axis, the plate tilted by {slope} µm per mm; off the surface "
                "{rest} (rms), repeatable within {size}",
                path=out,
                count=len(seats),
                place=decimal(f"{record.number('z'):.4f} mm"),
                slope=decimal(f"{slope:.3g}"),
                rest="–"
                if len(seats) == LEAST_SEATS
                else decimal(f"{1000.0 * record.number('residual'):.2g} µm"),
                size=decimal(f"{1000.0 * record.number('repeatability'):.2g} µm"),
            )
        )
        for remark in record.remarks:
            print(translated(remark))  # noqa: T201
    return 0 if record.in_limits else CalibrationError.exit_code


def _line(done: "Focused") -> str:
    found, depth = done.found, done.depth_of_field_mm
    words = [message("z in focus at {place}", place=decimal(f"{found.reached:.4f} mm"))]
    if not math.isnan(found.repeatability):
        words.append(
            message(
                "repeatable within {size} (standard deviation of {count} sweeps)",
                size=decimal(f"{1000.0 * found.repeatability:.2g} µm"),
                count=len(found.places),
            )
        )
    words.append(message("half as sharp {size} away", size=decimal(f"{1000.0 * found.half_width:.3g} µm")))
    if depth is not None:
        words.append(message("depth of field ±{size}", size=decimal(f"{500.0 * depth:.3g} µm")))
    return ", ".join(words)
