"""``anisoscope rig scan``: the rig as a goniometer."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.rig.options import SCANNED, DryRun, Scanned, Yes, ask_to_turn
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.taking import ScanExtent
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.inspection.reflectance_scan import ScanResult, ScanSettings

_MOVE_S = 2.0


@Parameter(name="*")
@dataclass(frozen=True)
class Lights:
    """Lamps of a scan.

    Attributes:
        channel: Light channel of the rig file; given several times, one scan with all of them.
    """

    rig: Annotated[
        tuple[Path, ...],
        Parameter(
            name=["--rig", "-g"],
            negative="",
            consume_multiple=False,
            help="Rig file (TOML); given several times, a lamp each, one scan with all of them.",
        ),
    ] = ()
    channel: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False, group=MORE)] = ()


LIGHTS = Lights()


@with_options(
    extent=Options(
        ScanExtent,
        names={"tilt_deg": "--max-tilt"},
        groups=dict.fromkeys(("stages", "tilts", "exposure_s"), MORE),
        whole=True,
    )
)
def scan(
    *,
    lights: Lights = LIGHTS,
    scanned: Scanned = SCANNED,
    out: Annotated[Path | None, Parameter(help="New folder for frames, table and budget.")] = None,
    continue_: Annotated[Path | None, Parameter(name="--continue")] = None,
    extent: Given[ScanExtent],
    dry_run: DryRun = False,
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Measure the BRDF of a coupon or a part over stage and tilt, with the uncertainty of every value.

    Poses are dense where facets mirror the light. The seating of a coupon is found from the scan; one that is not flat
    is refused. Writes brdf.csv for fit brdf, readings.csv for calibrate material --readings, budget.json, and with a
    lamp of known wavelength goniometer.csv for ink fit. The stage homes and turns: keep its path free.
    With several rig files or channels each lamp has a folder, and the tables of all lamps lie above them.

    Args:
        continue_: Continue the interrupted scan of this folder.

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

    rig, channel, recipe = lights.rig, lights.channel, scanned.recipe
    if continue_ is not None:
        if rig or recipe or out or scanned.coupon or scanned.part or channel:
            raise UsageError("--continue goes on with what the folder says: leave the other options out")
        with progress("scan", quiet=json_) as advance:
            if (continue_ / LAMPS).exists():
                return _show_lamps(resume_lamps(continue_, advance), continue_, as_json=json_)
            return _show(resume_scan(continue_, advance), continue_, as_json=json_)
    specimen, how = scanned.specimen(), extent.made()
    if not rig or recipe is None or (len(rig) > 1 and channel):
        raise UsageError("a scan needs --rig FILE (one, where --channel is given) and --recipe FILE")
    only, lamps = next(iter(channel), None), max(len(rig), len(channel))
    if dry_run:
        job, settings = planned_scan(rig[0], recipe, specimen, extent=how, channel=only)
        return _show_plan(settings, job.recipe.acquisition.frames_per_pose, lamps, as_json=json_)
    if out is None:
        raise UsageError("--out FOLDER says where the scan goes; --dry-run prints the plan only")
    ask_to_turn(*rig, yes=yes)
    if lamps > 1:
        planned = planned_lamps(rig, recipe, specimen, extent=how, channels=channel)
        with progress("scan", quiet=json_) as advance:
            return _show_lamps(begin_lamps(planned, out, advance), out, as_json=json_)
    with progress("scan", quiet=json_) as advance:
        found = begin_scan(rig[0], recipe, specimen, out, extent=how, channel=only, on_progress=advance)
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
