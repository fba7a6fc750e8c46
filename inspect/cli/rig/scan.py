"""``anisoscope rig scan``: the rig as a goniometer."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.rig.options import Yes, ask_to_turn
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.inspection.reflectance_scan import ScanResult, ScanSettings

_MOVE_S = 2.0


@everyday("rig", "recipe", "out", "coupon", "part", "continue_", "max_tilt", "dry_run", "json_")
def scan(
    *,
    rig: Annotated[
        tuple[Path, ...],
        Parameter(
            name=["--rig", "-g"],
            negative="",
            consume_multiple=False,
            help="Rig file (TOML); given several times, a lamp each, one scan with all of them.",
        ),
    ] = (),
    recipe: Annotated[Path | None, Parameter(name=["--recipe", "-r"])] = None,
    out: Annotated[Path | None, Parameter(help="New folder for frames, table and budget.")] = None,
    coupon: Annotated[bool, Parameter(negative="", help="Scan a flat piece of the plastic.")] = False,
    part: Annotated[bool, Parameter(negative="", help="Scan the ridged part of the recipe.")] = False,
    continue_: Annotated[Path | None, Parameter(name="--continue")] = None,
    max_tilt: Annotated[float, Parameter(help="Largest tilt of the scan in degrees.")] = 20.0,
    stages: Annotated[int, Parameter(help="Number of stage angles.")] = 24,
    tilts: Annotated[int, Parameter(help="Number of tilts.")] = 13,
    exposure: float | None = None,
    channel: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False)] = (),
    dry_run: Annotated[bool, Parameter(negative="", help="Only print the plan; nothing moves.")] = False,
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Measure the BRDF of a coupon or a part over stage and tilt, with the uncertainty of every value.

    Poses are dense where facets mirror the light. The seating of a coupon is found from the scan; one that is not flat
    is refused. Writes brdf.csv for fit brdf, readings.csv for calibrate material --readings, budget.json, and with a
    lamp of known wavelength goniometer.csv for ink fit. The stage homes and turns: keep its path free.
    With several rig files or channels each lamp has a folder, and the tables of all lamps lie above them.

    Args:
        recipe: Recipe with region, exposure and surface.
        continue_: Continue the interrupted scan of this folder.
        exposure: Shortest exposure in seconds; that of the recipe by default.
        channel: Light channel of the rig file; given several times, one scan with all of them.

    Examples:
        anisoscope rig scan --coupon --rig rig.toml --recipe recipe.toml --out scan
        anisoscope rig scan --coupon -g rig.toml --channel red --channel blue -r ink.toml --out scan
        anisoscope rig scan --continue scan
    """
    from anisoscope.inspection.reflectance_scan import (
        LAMPS,
        begin_lamps,
        begin_scan,
        planned_lamps,
        planned_scan,
        resume_lamps,
        resume_scan,
    )

    if continue_ is not None:
        if rig or recipe or out or coupon or part or channel:
            raise UsageError("--continue goes on with what the folder says: leave the other options out")
        with progress("scan", quiet=json_) as advance:
            if (continue_ / LAMPS).exists():
                return _show_lamps(resume_lamps(continue_, advance), continue_, as_json=json_)
            return _show(resume_scan(continue_, advance), continue_, as_json=json_)
    if coupon == part:
        raise UsageError("say what is scanned: --coupon, a flat piece of the plastic, or --part")
    if not rig or recipe is None or (len(rig) > 1 and channel):
        raise UsageError("a scan needs --rig FILE (one, where --channel is given) and --recipe FILE")
    specimen: Literal["coupon", "part"] = "coupon" if coupon else "part"
    if exposure is not None and not 0.0 < exposure < float("inf"):
        raise UsageError(f"--exposure takes a positive number of seconds, not {exposure:g}")
    only, lights = next(iter(channel), None), max(len(rig), len(channel))
    if dry_run:
        job, settings = planned_scan(
            rig[0], recipe, specimen,
            tilt_deg=max_tilt, stages=stages, tilts=tilts, exposure_s=exposure, channel=only,
        )  # fmt: skip
        return _show_plan(settings, job.recipe.acquisition.frames_per_pose, lights, as_json=json_)
    if out is None:
        raise UsageError("--out FOLDER says where the scan goes; --dry-run prints the plan only")
    ask_to_turn(*rig, yes=yes)
    if lights > 1:
        lamps = planned_lamps(
            rig, recipe, specimen,
            tilt_deg=max_tilt, stages=stages, tilts=tilts, exposure_s=exposure, channels=channel,
        )  # fmt: skip
        with progress("scan", quiet=json_) as advance:
            return _show_lamps(begin_lamps(lamps, out, advance), out, as_json=json_)
    with progress("scan", quiet=json_) as advance:
        found = begin_scan(
            rig[0], recipe, specimen, out,
            tilt_deg=max_tilt, stages=stages, tilts=tilts, exposure_s=exposure, channel=only, on_progress=advance,
        )  # fmt: skip
    return _show(found, out, as_json=json_)


def _show_lamps(found: "tuple[ScanResult, ...]", folder: Path, *, as_json: bool) -> int:
    import numpy as np

    if as_json:
        lamps = [_values(one, folder / f"{one.wavelength_nm:g}nm") for one in found]
        return print_json({"folder": str(folder), "lamps": lamps})
    rows = [
        [f"{one.wavelength_nm:g}", f"{one.brdf.min():.3g}", f"{one.brdf.max():.3g}",
         f"{100.0 * np.median(one.u):.2f}", f"{100.0 * one.u.max():.2f}"]
        for one in found
    ]  # fmt: skip
    head = ["lamp [nm]", "lowest [1/sr]", "highest [1/sr]", "median u [%]", "largest u [%]"]
    print_table("Scans", head, rows)
    print_lines(
        f"{folder / 'brdf.csv'}, goniometer.csv: {sum(len(one.poses) for one in found)} rows of {len(found)} lamps"
    )
    return 0


def _show_plan(settings: "ScanSettings", frames: int, lamps: int, *, as_json: bool) -> int:
    poses = lamps * len(settings.angles_deg) * len(settings.tilts_deg)
    seconds = poses * (_MOVE_S + frames * settings.exposure_s * (1.0 + sum(settings.brackets)))
    if as_json:
        return print_json(
            settings.model_dump(mode="json", by_alias=True) | {"poses": poses, "seconds": seconds}
        )
    for name, angles in (("stage", settings.angles_deg), ("tilt", settings.tilts_deg)):
        print_lines(f"{len(angles)} {name} angles: " + ", ".join(f"{angle:g}" for angle in angles))
    exposures = ", ".join(f"{settings.exposure_s * one:g}" for one in (1.0, *settings.brackets))
    print_lines(f"{poses} poses, exposures {exposures} s, about {seconds / 60.0:.0f} min")
    return 0


def _values(found: "ScanResult", folder: Path) -> dict[str, Any]:
    import numpy as np

    seat = found.coupon
    rms = {name: float(np.sqrt(np.mean(part**2))) for name, part in found.budget.items()}
    return {"folder": str(folder), "poses": len(found.poses), "u_rms": rms,
            "wavelength_nm": found.wavelength_nm,
            "u_median": float(np.median(found.u)), "u_largest": float(found.u.max()),
            "seating_deg": seat and [seat.about_x_deg, seat.about_y_deg],
            "u_seating_deg": seat and list(seat.u_deg),
            "light_angle_deg": seat and seat.light_angle_deg,
            "u_light_angle_deg": seat and seat.u_light_angle_deg,
            "flatness_deg": seat and seat.flatness_deg, "u_flatness_deg": seat and seat.u_flatness_deg,
            "brdf": [float(found.brdf.min()), float(found.brdf.max())]}  # fmt: skip


def _show(found: "ScanResult", folder: Path, *, as_json: bool) -> int:
    import numpy as np

    seat, values = found.coupon, _values(found, folder)
    if as_json:
        return print_json(values)
    rows = [
        [name, f"{100.0 * value:.2f}", f"{100.0 * found.budget[name].max():.2f}"]
        for name, value in values["u_rms"].items()
    ]
    rows.append(["combined", f"{100.0 * np.sqrt(np.mean(found.u**2)):.2f}", f"{100.0 * found.u.max():.2f}"])
    print_table("Uncertainty (k = 1)", ["source", "rms [%]", "largest [%]"], rows)
    if seat is not None:
        print_lines(
            f"seated {seat.about_x_deg:+.3f}° about x and {seat.about_y_deg:+.3f}° about y (u {seat.u_deg[0]:.3f}°, "
            f"{seat.u_deg[1]:.3f}°), flat within {seat.flatness_deg:.2f}° (u {seat.u_flatness_deg:.2f}°), light angle "
            f"{seat.light_angle_deg:.3f}° (u {seat.u_light_angle_deg:.3f}°)"
        )
    print_lines(
        f"{folder / 'brdf.csv'}: {len(found.poses)} rows, {found.brdf.min():.3g} to {found.brdf.max():.3g} 1/sr; "
        f"median u {np.median(found.u):.2%}"
    )
    return 0
