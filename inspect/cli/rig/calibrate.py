"""``anisoscope calibrate``: calibrations of the rig."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Flag, Json, Overwrite, check_new, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.rig.options import (
    OF_TAKING,
    SCANNED,
    DryRun,
    RigPath,
    Scanned,
    Yes,
    ask_to_turn,
    asked_to_seat_fixture,
)
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.taking import Entry, MaterialEntry, MaterialScan, Taking
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from collections.abc import Callable

    from anisoscope.calibration.record import CalibrationRecord
    from anisoscope.inspection.material_calibration import ScanPlan
    from anisoscope.recipe.material_file import MaterialFile

app = App(
    name="calibrate", help="Calibrate the rig: white tile, dark frames, linearity, rotation centre, material."
)

_Out = Annotated[Path, Parameter(help="File to write; picture (.tif) and record (.json) share its name.")]
FIXTURE_FRAMES = 4


def _of(frames: int, exposure: str = "", count: str = "") -> Options:
    """Options of a command that averages so many frames; with texts of its own for exposure and count."""
    texts = {"exposure_s": exposure, "frames": count}
    own = {name: text for name, text in texts.items() if text}
    return replace(OF_TAKING, default={"frames": frames}, help=own)


@app.command
@with_options(taking=_of(16))
def flat(
    *,
    rig: RigPath,
    out: Path,
    taking: Given[Taking],
    reflectance: Annotated[float, Parameter(help="Reflectance of the white tile, 0 to 1.")] = 0.99,
    write: Flag = False,
    json_: Json = False,
) -> int:
    """Photograph a white tile: shading of the picture and scale of the radiances.

    Place the tile on the stage so that it fills the picture. The file is named in the rig file under [calibration]
    flat. The tile hides the markers of the fixture, which are taught after it.

    Args:
        out: File to write, such as flat.tif; its record is written next to it.
        write: Write it into the rig file; then the terminal asks for the fixture, whose markers are taught.

    Examples:
        anisoscope calibrate flat --rig rig.toml --exposure 0.006 --reflectance 0.99 --out flat.tif --write
    """
    from anisoscope.calibration.pictures import calibrate_flat
    from anisoscope.commissioning.commissioning import name_in_rig

    settings = taking.made()
    with progress("flat", quiet=json_) as advance:
        meta, record = calibrate_flat(rig, out, settings, reflectance=reflectance, on_progress=advance)
    if write:
        name_in_rig(rig, "flat", out, settings.light_channel)
    if json_:
        return print_json({"file": str(out), **meta, "record": record})
    print_lines(
        f"{out}: {meta['frames']} frames, median {meta['level']:.0%} of full scale, "
        f"radiance of the tile {meta['radiance']:.4f} 1/sr"
    )
    code = _show(record, out, json_=False)
    return max(code, _fixture_after_tile(rig, settings, write=write))


def _fixture_after_tile(rig: Path, taking: "Taking", *, write: bool) -> int:
    """Ask for the fixture and teach its markers, which the tile hid; without an answer print the command."""
    from anisoscope.commissioning.commissioning import teach_fixture
    from anisoscope.rig.rigfile import read_rig

    if read_rig(rig, channel=taking.light_channel).fixture is None:
        return 0
    if not (write and asked_to_seat_fixture()):
        channel = "" if taking.light_channel is None else f" --channel {taking.light_channel}"
        print_lines(
            "the tile hid the markers, by which inspections watch the rig: seat the fixture, then `anisoscope "
            f"calibrate fixture --rig {rig} --exposure {taking.exposure_s:g}{channel} --out fixture.json --write`"
        )
        return 0
    with progress("fixture") as advance:
        taught = teach_fixture(rig, replace(taking, frames=FIXTURE_FRAMES), on_progress=advance)
    return _show(taught.record, taught.path, json_=False)


@app.command
@with_options(taking=_of(32))
def dark(
    *,
    rig: RigPath,
    out: _Out,
    taking: Given[Taking],
    json_: Json = False,
) -> int:
    """Photograph with the light off: dark level, noise and hot pixels at an exposure and gain.

    Take it with the exposure and gain of the inspections. Exit code 0: fit; 3: light reaches the camera, or too many
    pixels are hot.

    Examples:
        anisoscope calibrate dark --rig rig.toml --exposure 0.004 --out dark.json
    """  # fmt: skip
    from anisoscope.calibration.pictures import calibrate_dark

    return _taken("dark", calibrate_dark, rig, out, taking, json_=json_)


@app.command
@with_options(taking=_of(32))
def stray(
    *,
    rig: RigPath,
    out: _Out,
    taking: Given[Taking],
    target_reflectance: Annotated[
        float, Parameter(help="Largest diffuse reflectance that the black target may have.")
    ] = 1e-4,
    json_: Json = False,
) -> int:
    """Photograph black glass or a light trap under the lit lamp: stray light, which inspections then subtract.

    Needs the flat of the rig. A long exposure makes it exact.

    Examples:
        anisoscope calibrate stray --rig rig.toml --exposure 0.05 --out stray.json
    """
    from anisoscope.calibration.pictures import calibrate_stray

    return _taken(
        "stray light",
        calibrate_stray,
        rig,
        out,
        taking,
        json_=json_,
        target_reflectance=target_reflectance,
    )


@app.command
@with_options(
    taking=_of(
        16,
        "Exposure in seconds at which the tile is neither dark nor clipped.",
        "Frames of the stacks for the fixed pattern.",
    )
)
def linearity(
    *,
    rig: RigPath,
    out: _Out,
    taking: Given[Taking],
    steps: Annotated[int, Parameter(help="Number of exposures of the series.")] = 24,
    json_: Json = False,
) -> int:
    """Photograph a white tile with many exposures: gain, read noise, linearity and saturation after EMVA 1288.

    The exposures run from 2 % of full scale to clipping. Exit code 0: fit; 3: too non-linear to be corrected.

    Examples:
        anisoscope calibrate linearity --rig rig.toml --exposure 0.002 --out linearity.json
    """
    from anisoscope.calibration.linearity import calibrate_linearity

    return _taken(
        "linearity",
        calibrate_linearity,
        rig,
        out,
        taking,
        json_=json_,
        steps=steps,
    )


@app.command
@with_options(
    taking=replace(
        _of(
            4,
            "Longest exposure in seconds: the brightest places just clip at it.",
            "Frames to average, at every exposure.",
        ),
        without=dict.fromkeys(
            ("valid_days", "operator", "temperature_c", "light_channel"), "a curve has no record"
        ),
    )
)
def response(
    *,
    rig: RigPath,
    out: Annotated[Path, Parameter(help="File of the curve, such as response.json.")],
    taking: Given[Taking],
    white_level: Annotated[
        int | None, Parameter(help="Counts at which the camera clips, such as 235; else full scale.")
    ] = None,
    json_: Json = False,
) -> int:
    """Photograph a still scene with many exposures: how the counts of a camera that is not linear grow with light.

    The scene needs dark and bright places, as a part in its fixture has. The exposures go down to a sixteenth. Name the
    file in the rig file under [camera.options] response, then take a new flat: both make the camera a linear one.

    Examples:
        anisoscope calibrate response --rig rig.toml --exposure 0.02 --out response.json
    """
    from anisoscope.calibration.linearity import calibrate_response

    with progress("response", quiet=json_) as advance:
        curve = calibrate_response(rig, out, taking.made(), white_level=white_level, on_progress=advance)
    if json_:
        return print_json({"file": str(out), **curve.model_dump(by_alias=True)})
    text = (
        f"{out}: fitted from {len(curve.exposures_s)} exposures, which agree within {curve.residual:.2%}; name it in "
        "the rig file under [camera.options] response, then take a new flat"
    )
    print_lines(text)
    return 0


@app.command
@with_options(taking=_of(4, count="Frames in every pose."))
def fixture(
    *,
    rig: RigPath,
    out: _Out,
    taking: Given[Taking],
    angles: Annotated[int, Parameter(name="--steps", help="Number of stage angles over one turn.")] = 8,
    tilts: Annotated[str, Parameter(help="Tilts of the arm of your recipes, in degrees; usually 0.")] = "",
    write: Annotated[bool, Parameter(negative="", help="Write it into the rig file.")] = False,
    json_: Json = False,
) -> int:
    """Photograph the markers of the fixture all round: the grey card by which inspections watch the rig.

    Inspections then measure lamp level, exposure, stray light and linearity in every picture, and correct for them.
    Take it after the flat, when lamp, room and camera are as they should be; a part may lie in the fixture. --write
    names the file in the rig file under [calibration] fixture. The axes home and move: keep their paths free. Exit
    code 0: fit; 3: out of limits.

    Examples:
        anisoscope calibrate fixture --rig rig.toml --exposure 0.006 --out fixture.json --write
    """
    from anisoscope.calibration.fixture import calibrate_fixture
    from anisoscope.commissioning.commissioning import name_in_rig

    code = _taken(
        "fixture",
        calibrate_fixture,
        rig,
        out,
        taking,
        json_=json_,
        angles=angles,
        tilts=parse_numbers(tilts, "--tilts") if tilts else (),
    )
    if write and code == 0:
        name_in_rig(rig, "fixture", out, taking.made().light_channel)
    return code


@app.command
@with_options(taking=_of(2, count="Frames at every angle."))
def rotation(
    *,
    rig: RigPath,
    out: _Out,
    taking: Given[Taking],
    angles: Annotated[int, Parameter(name="--steps", help="Number of stage angles over one turn.")] = 12,
    at: tuple[float, float] = (0.0, 0.0),
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Turn the fixture by a full turn: rotation centre in the picture, size of a pixel, runout, tilt of the axis.

    With axes x and y also their readings with the rotation centre in the middle of the picture, and their directions.
    The axes home and move: keep their paths free. Exit code 0: fit; 3: out of limits.

    Args:
        at: Place of the fixture on the plate, which x and y follow: mm right and up of the axis.

    Examples:
        anisoscope calibrate rotation --rig rig.toml --exposure 0.004 --out rotation.json
    """
    from anisoscope.calibration.rotation import calibrate_rotation

    ask_to_turn(rig, yes=yes)
    return _taken(
        "rotation",
        calibrate_rotation,
        rig,
        out,
        taking,
        json_=json_,
        angles=angles,
        at_mm=at,
    )


@app.command
@with_options(entry=Options(Entry, whole=True))
def check(
    *,
    rig: RigPath,
    recipe: Annotated[Path, Parameter(name=["--recipe", "-r"], help="Recipe of the check standard.")],
    out: Annotated[Path, Parameter(help="Record of the check standard, such as check.json.")],
    teach: Flag = False,
    serial: Annotated[str | None, Parameter(name=["--serial", "-s"])] = None,
    max_deviation: Annotated[float, Parameter(help="Largest deviation of an ln ratio.")] = 0.02,
    entry: Given[Entry],
    json_: Json = False,
) -> int:
    """Measure a check standard, and compare it with its first measurement.

    Exit code 0: within limits; 3: out of limits; inspections are then INVALID until the rig is repaired.

    Args:
        teach: Store the measured contrasts as its reference.
        serial: Serial number of the check standard, with --teach.

    Examples:
        anisoscope calibrate check --rig rig.toml --recipe standard.toml --out check.json --teach --serial CHECK-1
        anisoscope calibrate check --rig rig.toml --recipe standard.toml --out check.json
    """
    from anisoscope.inspection.check_standard import SERIAL, run_check, teach_check

    if serial is not None and not teach:
        raise UsageError("--serial goes with --teach: afterwards the record knows which part it is")
    noted = entry.made()
    with progress("check standard", quiet=json_) as advance:
        if teach:
            record = teach_check(
                rig,
                recipe,
                out,
                serial=serial or SERIAL,
                **vars(noted),
                on_progress=advance,
            )
        else:
            record = run_check(
                rig,
                recipe,
                out,
                limit=max_deviation,
                **vars(noted),
                on_progress=advance,
            )
    return _show(record, out, json_=json_)


@app.command
@with_options(
    source=Options(
        MaterialScan,
        names={"step_deg": "--step"},
        groups={"frames": MORE, "reflectance": MORE},
        whole=True,
    ),
    entry=Options(MaterialEntry, groups=dict.fromkeys(("lobe", "name", "valid_days"), MORE), whole=True),
)
def material(
    *,
    rig: RigPath,
    out: Annotated[Path | None, Parameter(help="Material file to write, such as abs.toml.")] = None,
    scanned: Scanned = SCANNED,
    source: Given[MaterialScan],
    entry: Given[MaterialEntry],
    dry_run: DryRun = False,
    json_: Json = False,
) -> int:
    """Scan a coupon or a part over stage and tilt: lobe and albedo of the plastic, with their covariance.

    Prints duration and expected uncertainty, then scans. The stage homes and turns: keep its path
    free. Exit code 0: the lobe fits; 3: it does not, or the specimen cannot be used.

    Examples:
        anisoscope calibrate material --coupon --rig rig.toml --recipe recipe.toml --out abs.toml
        anisoscope calibrate material --coupon --rig rig.toml --readings readings.csv --out abs.toml
    """
    from anisoscope.fit.lobe import Scan
    from anisoscope.inspection.material_calibration import (
        calibrate_material,
        frame_poses,
        plan_scan,
        scan_of_frames,
        scan_setup,
        scan_specimen,
    )
    from anisoscope.inspection.reflectance_scan import read_scan

    noted, specimen = entry.made(), scanned.specimen()
    asked, recipe = source.made(), scanned.recipe
    readings, frames = asked.readings, asked.frames
    if out is None and not dry_run:
        raise UsageError("--out FILE.toml says where the material goes; --dry-run prints the plan only")
    if readings is None and recipe is None:
        raise UsageError(
            "--recipe FILE says how the specimen is photographed; --readings FILE.csv needs none"
        )
    if readings is not None and frames is not None:
        raise UsageError("--readings and --frames exclude each other: both stand in place of a scan")
    read = None if readings is None else read_scan(readings)
    poses = None if frames is None else frame_poses(frames)
    setup = scan_setup(
        rig,
        recipe,
        specimen,
        tilt_deg=asked.max_tilt_deg,
        step_deg=asked.step_deg,
        poses=poses if read is None else read[0],
    )
    if dry_run or not json_:
        plan = plan_scan(setup)
        if json_:
            print_json(plan)
        else:
            _show_plan(plan)
    if dry_run:
        return 0
    assert out is not None
    with progress("material", quiet=json_) as advance:
        camera = ""
        if read is not None:
            scan = Scan(setup.poses, setup.convention, read[1], read[2])
        else:
            assert recipe is not None
            scan, camera = (
                scan_specimen(setup, rig, recipe, advance)
                if frames is None
                else scan_of_frames(setup, frames, rig, recipe, asked.reflectance)
            )
        file, found = calibrate_material(setup, scan, out, entry=noted, camera=camera, on_progress=advance)
    if json_:
        print_json({"file": str(out), **file.model_dump(mode="json", by_alias=True)})
    else:
        _show_material(file, out)
    return 0 if found.fits else 3


def _show_plan(plan: "ScanPlan") -> None:
    """Print what a scan takes and what it would say."""
    from anisoscope.fit.lobe import POSE_NOISE

    poses, u = plan.setup.poses, plan.u_log_ratios
    stage, tilts = {pose.stage_deg for pose in poses}, {pose.tilt_deg for pose in poses}
    minutes = "" if plan.seconds is None else f", about {plan.seconds / 60.0:.1f} min"
    extent = (
        f"{len(poses)} poses: {len(stage)} stage angles, {len(tilts)} tilts from {min(tilts):g}° to {max(tilts):g}°"
        f"{minutes}"
    )
    ratios = (
        f"with {100.0 * POSE_NOISE:g} % a pose, u of ln ratios of {plan.ridge_angle_deg:g}° ridges from the material: "
        f"0/90 {100.0 * u[0, 1]:.2f} %, 0/180 {100.0 * u[0, 2]:.2f} %, 90/180 {100.0 * u[1, 2]:.2f} %, over tilts of "
        f"±10° at most {100.0 * u.max():.2f} %"
    )
    lines = [extent, ratios, *plan.information.not_identified()]
    print_lines(*lines)


def _show_material(file: "MaterialFile", out: Path) -> None:
    """Print a calibrated material."""
    one, u, test = file.material, file.covariance.u(), file.test
    rows = [
        ["roughness along", f"{one.alpha_along:.5f}", f"{one.alpha_along * u['ln_alpha_along']:.2g}"],
        ["roughness across", f"{one.alpha_across:.5f}", f"{one.alpha_across * u['ln_alpha_across']:.2g}"],
        ["albedo", f"{one.albedo:.4f}", f"{one.albedo * u['ln_albedo']:.2g}"],
    ]
    if "tail" in u:
        rows.insert(2, ["tail", f"{one.tail:.3f}", f"{u['tail']:.2g}"])
    if one.second_lobe is not None:
        weight, width = one.second_lobe
        rows.insert(
            2, ["weight of the second lobe", f"{weight:.3f}", f"{weight * u['ln_second_weight']:.2g}"]
        )
        rows.insert(3, ["width of the second lobe", f"{width:.3f}", f"{width * u['ln_second_width']:.2g}"])
    print_table(f"{file.id}: {file.name} (index {one.index:g}, stated)", ["what [1]", "value", "u"], rows)
    lines = list(file.remarks)
    if test is not None:
        lines.append(
            f"residuals of {100.0 * test.rms_share:.2f} %, {test.residual_over_noise:.2f} times their noise, "
            f"{test.degrees_of_freedom} degrees of freedom"
        )
    low, high = file.validity.half_angle_deg
    until = "" if file.validity.until is None else f", until {file.validity.until:%Y-%m-%d}"
    lines.append(f"{out}: holds for half angles of {low:.1f}° to {high:.1f}°{until}")
    print_lines(*lines)


@app.command
def ink(
    *inspections: Path,
    out: Annotated[Path, Parameter(help="Ink file *.toml to write.")],
    name: Annotated[str | None, Parameter(help="Name of the ink; else that of the file.")] = None,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Make the ink file of good prints from their inspections: no goniometer is needed.

    Inspect the prints with any ink of the package in the recipe, at 21 poses or more; then name the new file there.

    Args:
        inspections: Folders of finished inspections of good prints.

    Examples:
        anisoscope calibrate ink inspections/P-1-20260101T080000Z --out mine.toml
    """
    from anisoscope.operations.inks import calibrate_ink
    from anisoscope.sim.materials.inks import write_ink

    check_suffix(out, "--out", ".toml")
    check_new((out,), overwrite=overwrite)
    found = calibrate_ink(inspections, name or out.stem)
    write_ink(found.ink, out)
    if json_:
        print_json({"file": str(out)} | fields_of(found))
    else:
        print_lines(*found.lines(), f"{out}: written")
    return 0


@app.command(name="list")
def list_(*, rig: RigPath, json_: Json = False) -> int:
    """List the calibrations of a rig: which exist, until when they are valid, and which are missing.

    Exit code 0: inspections can use them; 3: one of the rig file is invalid or expired, or the flat is missing.

    Examples:
        anisoscope calibrate list --rig rig.toml
    """
    from anisoscope.calibration.corrections import list_calibrations

    found = list_calibrations(rig)
    if json_:
        print_json(found)
    else:
        rows = [[one.kind, one.state, one.id or "", one.valid_until or "", one.file or ""] for one in found]
        print_table(f"Calibrations of {rig}", ["kind", "state", "id", "valid until", "file"], rows)
        for one in found:
            if one.advice:
                print_lines(f"{one.kind}: {one.advice}")
    usable = {"valid", "no record"}
    invalid = [one for one in found if one.state not in usable and (one.needed or one.file is not None)]
    return 3 if invalid else 0


def _taken(
    label: str,
    calibrate: "Callable[..., CalibrationRecord]",
    rig: Path,
    out: Path,
    taking: Given[Taking],
    *,
    json_: bool,
    **settings: object,
) -> int:
    with progress(label, quiet=json_) as advance:
        record = calibrate(rig, out, taking.made(), on_progress=advance, **settings)
    return _show(record, out, json_=json_)


def _show(record: "CalibrationRecord", out: Path, *, json_: bool) -> int:
    """Print a record; return 0 if it is in limits, else 3."""
    from anisoscope.calibration.record import record_path

    target = record_path(out)
    if json_:
        print_json({"file": target} | record.model_dump(by_alias=True))
    else:
        rows = [
            [name.replace("_", " "), f"{one.value:.6g}", "" if one.u is None else f"{one.u:.2g}", one.unit]
            for name, one in record.values.items()
        ]
        print_table(f"{record.id} ({record.camera.model})", ["what", "value", "u", "unit"], rows)
        print_lines(*record.remarks)
        print_lines(
            f"{target}: valid until {record.valid_until:%Y-%m-%d %H:%M} UTC; name it in the rig file under "
            f"[calibration] {record.kind}"
        )
    return 0 if record.in_limits else 3
