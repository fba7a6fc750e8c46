"""``anisoscope rig focus``: bring the part into focus with the axis z, and say how repeatable that is."""

import math
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import Exposure, Gain, LightState, RigPath, Yes, home_axis

if TYPE_CHECKING:
    from anisoscope.live_view.autofocus import Focus
    from anisoscope.rig.rigfile import RigFile


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
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Bring the part into focus: sweep z, fit a curve to the sharpness, and go to its peak.

    Nothing is moved beyond the search (and z.approach_mm below it). An axis that was not homed is homed first: confirm,
    or give --yes.

    Examples:
        anisoscope rig focus --rig rig.toml --exposure 0.005 --from 9.5 --to 10.5
        anisoscope rig focus --rig rig.toml --exposure 0.005 --from 8 --to 12 --repeat 5
    """
    from anisoscope.live_view.autofocus import Autofocus
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.rigfile import read_rig

    if not (low < high and steps >= 1 and repeat >= 1 and average >= 1):
        raise UsageError("--from must be below --to, and --steps, --repeat and --average 1 or more")
    file = read_rig(rig)
    if file.z is None:
        raise UsageError("nothing moves the focus there: the rig file has no table [z]")
    lamp = None if light == "as-is" else file.light
    with open_devices({"z": file.z}, file.camera, lamp) as devices:
        axis, camera = devices.axes["z"], devices.camera
        assert camera is not None
        if not axis.is_homed:
            home_axis(axis, file.z, yes=yes)
        camera.configure(exposure, gain)
        if devices.light is not None:
            (devices.light.on if light == "on" else devices.light.off)()
        found = Autofocus(axis, camera, file.z.approach_mm, measure, average).search(
            low, high, steps=steps, repeats=repeat
        )
    _show(found, file, json_=json_)
    return 0


def depth_of_field_mm(file: "RigFile") -> float | None:
    """Depth of field λ/NA² in mm by the wavelength and the aperture in a rig file; None where it has not both."""
    if file.light.wavelength_nm is None or not file.camera.half_angle_deg:
        return None
    return 1e-6 * file.light.wavelength_nm / math.sin(math.radians(file.camera.half_angle_deg)) ** 2


def _show(found: "Focus", file: "RigFile", *, json_: bool) -> None:
    assert file.z is not None
    depth = depth_of_field_mm(file)
    if json_:
        print_json(
            {
                "best_mm": found.best,
                "place_mm": file.z.place(found.best),
                "reached_mm": found.reached,
                "repeatability_mm": None if math.isnan(found.repeatability) else found.repeatability,
                "places_mm": found.places,
                "half_width_mm": found.half_width,
                "depth_of_field_mm": depth,
                "kept_share": found.kept,
                "readings_mm": found.readings,
                "sharpness": found.sharpness,
            }
        )
        return
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
    print(", ".join(words))  # noqa: T201
