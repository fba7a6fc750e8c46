"""``anisoscope calibrate``: calibrations of the rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.calibration.record import CalibrationRecord

app = App(name="calibrate", help="Calibrate the rig.")

_Rig = Annotated[Path, Parameter(name=["--rig", "-g"], help="Rig file (TOML).")]
_Out = Annotated[Path, Parameter(help="File to write; picture (.tif) and record (.json) share its name.")]
_Exposure = Annotated[float, Parameter(help="Exposure in seconds.")]
_Gain = Annotated[float, Parameter(help="Gain of the camera, as a factor.")]
_Frames = Annotated[int, Parameter(help="Frames to average.")]
_Days = Annotated[float | None, Parameter(help="Days for which it holds; else what is usual for its kind.")]
_Operator = Annotated[str | None, Parameter(help="Who takes it; goes into the record.")]
_Temperature = Annotated[float | None, Parameter(help="Temperature of the day in °C; goes into the record.")]


@app.command
def flat(
    *,
    rig: _Rig,
    out: Annotated[Path, Parameter(help="File to write, such as flat.tif; its record goes beside it.")],
    exposure: _Exposure,
    gain: _Gain = 1.0,
    reflectance: Annotated[float, Parameter(help="Reflectance of the white tile, 0 to 1.")] = 0.99,
    frames: _Frames = 16,
    valid_days: _Days = None,
    operator: _Operator = None,
    temperature: _Temperature = None,
    json_: Json = False,
) -> int:
    """Photograph a white tile: the picture's shading and the scale of radiance.

    Lay the tile on the stage so that it fills the picture, then run this; name the file in the rig file under
    [calibration] flat.
    """
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.pictures import calibrate_flat

    taking = Taking(exposure, gain, frames, valid_days, operator, temperature)
    with progress("flat", quiet=json_) as advance:
        meta, record = calibrate_flat(rig, out, taking, reflectance=reflectance, on_progress=advance)
    if json_:
        print_json({"file": str(out), **meta, "record": _as_json(record)})
        return 0
    text = (
        f"{out}: {meta['frames']} frames, median {meta['level']:.0%} of full scale, "
        f"radiance of the tile {meta['radiance']:.4f} 1/sr"
    )
    console().print(text, markup=False, highlight=False)
    return _show(record, out, json_=False)


@app.command
def dark(
    *,
    rig: _Rig,
    out: _Out,
    exposure: _Exposure,
    gain: _Gain = 1.0,
    frames: _Frames = 32,
    valid_days: _Days = None,
    operator: _Operator = None,
    temperature: _Temperature = None,
    json_: Json = False,
) -> int:
    """Photograph with the light off: dark level, noise and hot pixels at an exposure and gain.

    Take it with the exposure and gain of the inspections. Exit code 0: fit; 3: light reaches the camera, or too many
    pixels are hot.
    """  # fmt: skip
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.pictures import calibrate_dark

    taking = Taking(exposure, gain, frames, valid_days, operator, temperature)
    with progress("dark", quiet=json_) as advance:
        record = calibrate_dark(rig, out, taking, on_progress=advance)
    return _show(record, out, json_=json_)


@app.command
def stray(
    *,
    rig: _Rig,
    out: _Out,
    exposure: _Exposure,
    gain: _Gain = 1.0,
    frames: _Frames = 32,
    target_reflectance: Annotated[
        float, Parameter(help="Largest diffuse reflectance that the black target may have.")
    ] = 1e-4,
    valid_days: _Days = None,
    operator: _Operator = None,
    temperature: _Temperature = None,
    json_: Json = False,
) -> int:
    """Photograph black glass or a light trap under the lit lamp: stray light, which inspections then subtract.

    Needs the flat of the rig. A long exposure makes it exact.
    """
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.pictures import calibrate_stray

    taking = Taking(exposure, gain, frames, valid_days, operator, temperature)
    with progress("stray light", quiet=json_) as advance:
        record = calibrate_stray(rig, out, taking, target_reflectance=target_reflectance, on_progress=advance)
    return _show(record, out, json_=json_)


@app.command
def linearity(
    *,
    rig: _Rig,
    out: _Out,
    exposure: Annotated[
        float, Parameter(help="Exposure in seconds at which the tile is neither dark nor clipped.")
    ],
    gain: _Gain = 1.0,
    steps: Annotated[int, Parameter(help="Exposures of the series.")] = 24,
    frames: Annotated[int, Parameter(help="Frames of the stacks for the fixed pattern.")] = 16,
    valid_days: _Days = None,
    operator: _Operator = None,
    temperature: _Temperature = None,
    json_: Json = False,
) -> int:
    """Photograph a white tile with many exposures: gain, read noise, linearity and saturation after EMVA 1288.

    The exposures run from 2 % of full scale to clipping. Exit code 0: fit; 3: too bent to be corrected.
    """
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.linearity import calibrate_linearity

    taking = Taking(exposure, gain, frames, valid_days, operator, temperature)
    with progress("linearity", quiet=json_) as advance:
        record = calibrate_linearity(rig, out, taking, steps=steps, on_progress=advance)
    return _show(record, out, json_=json_)


@app.command
def response(
    *,
    rig: _Rig,
    out: Annotated[Path, Parameter(help="File of the curve, such as response.json.")],
    exposure: Annotated[
        float, Parameter(help="Longest exposure in seconds: the brightest places just clip at it.")
    ],
    gain: _Gain = 1.0,
    frames: Annotated[int, Parameter(help="Frames to average, at every exposure.")] = 4,
    white_level: Annotated[
        int | None, Parameter(help="Counts at which the camera clips, such as 235; else full scale.")
    ] = None,
    json_: Json = False,
) -> int:
    """Photograph a still scene with many exposures: how the counts of a camera that is not linear grow with light.

    The scene needs dark and bright places, as a part in its fixture has. The exposures go down to a sixteenth. Name the
    file in the rig file under [camera.options] response, then take a new flat: both make the camera a linear one.
    """
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.linearity import calibrate_response

    with progress("response", quiet=json_) as advance:
        curve = calibrate_response(
            rig, out, Taking(exposure, gain, frames), white_level=white_level, on_progress=advance
        )
    if json_:
        print_json({"file": str(out), **curve.model_dump(by_alias=True)})
        return 0
    text = (
        f"{out}: fitted from {len(curve.exposures_s)} exposures, which agree within {curve.residual:.2%}; name it in "
        "the rig file under [camera.options] response, then take a new flat"
    )
    console().print(text, markup=False, highlight=False, soft_wrap=True)
    return 0


@app.command
def rotation(
    *,
    rig: _Rig,
    out: _Out,
    exposure: _Exposure,
    gain: _Gain = 1.0,
    angles: Annotated[int, Parameter(help="Stage angles over one turn.")] = 12,
    frames: Annotated[int, Parameter(help="Frames at every angle.")] = 2,
    valid_days: _Days = None,
    operator: _Operator = None,
    temperature: _Temperature = None,
    json_: Json = False,
) -> int:
    """Turn the fixture all round: rotation centre in the picture, size of a pixel, runout, tilt of the axis.

    The stage homes and turns: nothing may stand in its way. Exit code 0: fit; 3: out of limits.
    """
    from anisoscope.calibration.frames import Taking
    from anisoscope.calibration.rotation import calibrate_rotation

    taking = Taking(exposure, gain, frames, valid_days, operator, temperature)
    with progress("rotation", quiet=json_) as advance:
        record = calibrate_rotation(rig, out, taking, angles=angles, on_progress=advance)
    return _show(record, out, json_=json_)


@app.command
def check(
    *,
    rig: _Rig,
    recipe: Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe of the check standard.")],
    out: Annotated[Path, Parameter(help="Record of the check standard, such as check.json.")],
    teach: Annotated[
        bool, Parameter(negative="", help="Keep the contrasts of now as those it must have.")
    ] = False,
    serial: Annotated[
        str | None, Parameter(name=["--serial", "-s"], help="With --teach: which part it is.")
    ] = None,
    limit: Annotated[float, Parameter(help="Largest deviation of an ln ratio.")] = 0.02,
    valid_days: _Days = None,
    operator: _Operator = None,
    json_: Json = False,
) -> int:
    """Photograph a part that is kept for this, and compare it with what it showed when it was taught.

    Exit code 0: in limits; 3: out of limits, so that inspections are INVALID until the rig is put right.
    """
    from anisoscope.inspection.check_standard import SERIAL, run_check, teach_check

    if serial is not None and not teach:
        raise UsageError("--serial goes with --teach: afterwards the record knows which part it is")
    with progress("check standard", quiet=json_) as advance:
        if teach:
            record = teach_check(
                rig,
                recipe,
                out,
                serial=serial or SERIAL,
                valid_days=valid_days,
                operator=operator,
                on_progress=advance,
            )
        else:
            record = run_check(
                rig, recipe, out, limit=limit, valid_days=valid_days, operator=operator, on_progress=advance
            )
    return _show(record, out, json_=json_)


@app.command(name="list")
def list_(*, rig: _Rig, json_: Json = False) -> int:
    """List the calibrations of a rig: what there is, until when it holds, and what is missing.

    Exit code 0: inspections can use them; 3: one that the rig file names does not hold, or the flat is missing.
    """
    from anisoscope.calibration.corrections import list_calibrations

    found = list_calibrations(rig)
    if json_:
        print_json([one.to_json() for one in found])
    else:
        rows = [[one.kind, one.state, one.id or "", one.valid_until or "", one.file or ""] for one in found]
        print_table(f"Calibrations of {rig}", ["kind", "state", "id", "valid until", "file"], rows)
        for one in found:
            if one.advice:
                console().print(f"{one.kind}: {one.advice}", markup=False, highlight=False, soft_wrap=True)
    usable = {"valid", "no record"}
    invalid = [one for one in found if one.state not in usable and (one.needed or one.file is not None)]
    return 3 if invalid else 0


def _as_json(record: "CalibrationRecord") -> dict[str, object]:
    return record.model_dump(mode="json", by_alias=True)


def _show(record: "CalibrationRecord", out: Path, *, json_: bool) -> int:
    """Print a record; return 0 if it is in limits, else 3."""
    from anisoscope.calibration.record import record_path

    target = record_path(out)
    if json_:
        print_json({"file": str(target), **_as_json(record)})
    else:
        rows = [
            [name.replace("_", " "), f"{one.value:.6g}", "" if one.u is None else f"{one.u:.2g}", one.unit]
            for name, one in record.values.items()
        ]
        print_table(f"{record.id} ({record.camera.model})", ["what", "value", "u", "unit"], rows)
        for remark in record.remarks:
            console().print(remark, markup=False, highlight=False, soft_wrap=True)
        console().print(
            f"{target}: valid until {record.valid_until:%Y-%m-%d %H:%M} UTC; name it in the rig file under "
            f"[calibration] {record.kind}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    return 0 if record.in_limits else 3
