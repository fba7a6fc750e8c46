"""``anisoscope rig focus``: bring the part into focus with the axis z, and say how repeatable that is."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.language import decimal, message, translated
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import Channel, Exposure, Gain, LightState, RigPath, Yes, asking
from anisoscope.cli.tables import answer

if TYPE_CHECKING:
    from anisoscope.live_view.autofocus import Sweep
    from anisoscope.operations.rigging import Focused


@everyday("rig", "exposure", "low", "high", "gain", "repeat", "light", "map_", "out", "yes", "json_")
def focus(
    *,
    rig: RigPath,
    exposure: Exposure,
    low: Annotated[float, Parameter(name="--from", help="Reading of z in mm at which the search begins.")],
    high: Annotated[float, Parameter(name="--to", help="Reading of z in mm at which it ends.")],
    gain: Gain = 1.0,
    steps: Annotated[int, Parameter(help="Number of readings in a sweep.")] = 15,
    repeat: Annotated[int, Parameter(help="Fine sweeps; two or more tell the repeatability.")] = 3,
    average: Annotated[int, Parameter(help="Frames averaged at each reading.")] = 1,
    measure: Annotated[Literal["tenengrad", "laplacian"], Parameter(help="Focus measure.")] = "tenengrad",
    light: LightState = "on",
    channel: Channel = None,
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
    from anisoscope.live_view.autofocus import Sweep
    from anisoscope.operations.rigging import focus as focused

    if not (low < high and steps >= 1 and repeat >= 1 and average >= 1):
        raise UsageError("--from must be below --to, and --steps, --repeat and --average 1 or more")
    sweep = Sweep(low, high, steps, repeat, measure, average)
    if map_ is not None:
        return _map(rig, map_, out, (exposure, gain), sweep, channel, yes=yes, json_=json_)
    done = focused(rig, exposure, sweep, gain, light=light, channel=channel, confirm=asking(rig, yes=yes))
    answer(done, [_line(done)], json_=json_)
    return 0


def _map(
    rig: Path,
    tray: Path,
    out: Path,
    exposed: tuple[float, float],
    sweep: "Sweep",
    channel: str | None,
    *,
    yes: bool,
    json_: bool,
) -> int:
    from anisoscope.cli.progress import progress
    from anisoscope.inspection.batch.tray import read_tray
    from anisoscope.live_view.autofocus import LEAST_SEATS, map_focus
    from anisoscope.parameters.taking import Taking

    seats = [slot.place_mm for slot in read_tray(tray).slots if slot.place_mm is not None]
    asking(rig, yes=yes)(
        message("the axes search their references and go to {count} seats", count=len(seats))
    )
    with progress("focus map", quiet=json_) as advance:
        record = map_focus(rig, seats, out, Taking(*exposed, light_channel=channel), sweep, advance)
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
