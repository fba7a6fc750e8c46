"""The rig as a goniometer: a coupon or a ridged part photographed over stage and tilt, as a table of its BRDF with u.

Photographs and radiances are those of `calibrate material` (`inspection.material_calibration`); added here are the
places of the poses, a folder from which the scan can be resumed, and the budget of every value (JCGM 100:2008): noise,
flicker, flat, linearity, drift, stray light and registration as of an inspection, the scale of the white tile, and the
angles, through the slopes of the scanned lobe itself.

The seating of a coupon is found from its scan: a lobe fitted to the radiances stands about the normal of the coupon
(`fit.lobe`), and the directions of the table are those that the coupon sees. Parts of the region whose radiances follow
other normals say how flat it is.

So is the light angle, where the plastic tells it. Light reaches a flat coupon half of it off the plane of the tilts, so
that with the roughnesses α and β along and across, ln L(0°)/L(90°) at tilt 0 is about tan²(angle/2) (1/α² − 1/β²), and
tilts measure both. A coupon of even roughness, or a lobe that no family fits, leaves the angle as it is stated.
"""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.errors import AnisoscopeError, CalibrationError, RecordError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.toml_file import one_line
from anisoscope.bsdf.directions_table import COLUMNS, DirectionsTable, polar_degrees
from anisoscope.fit.lobe import Scan, fit_lobe
from anisoscope.fit.table import read_readings
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.inspection.folder import SCAN, sweep, working_in
from anisoscope.inspection.frames import check_frames, missing_frames
from anisoscope.inspection.job import Job, prepare
from anisoscope.inspection.manifest import Manifest, begin, reopen
from anisoscope.inspection.material_calibration import Setup, measure_scan, photograph, setup_of
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.taking import ScanExtent
from anisoscope.record.schema import Particulars
from anisoscope.rig.acquisition.journal import JOURNAL, read_journal
from anisoscope.rig.rigfile import check_arm
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

LAMPS = "lamps.json"
TABLE, READINGS, BUDGET, GONIOMETER = "brdf.csv", "readings.csv", "budget.json", "goniometer.csv"
FLATNESS_LIMIT_DEG = 0.5
"""Normals of a coupon may lean so far from their mean."""
BRACKETS = (4.0, 16.0)
"""Exposures that a recipe without brackets gets: a lobe spans more than one frame."""
_FINE_STAGE, _FINE_TILT = 2.5, 0.5
_SEATING_STEP_DEG = 0.05
_PARTS = 3  # along a side of the region
_SPREAD = 0.4  # share of the poses that are spread evenly, whatever the lobe


class Lamps(BaseModel):
    """Scan with several lamps, one after the other, each in a subfolder; ``lamps.json`` of the folder."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    rigs: tuple[Path, ...]
    recipe: Path
    specimen: Literal["coupon", "part"]
    tilt_deg: float
    stages: int
    tilts: int
    exposure_s: float | None
    folders: tuple[str, ...]
    channels: tuple[str | None, ...] = ()


class ScanSettings(BaseModel):
    """Settings of a scan; ``scan.json`` of the folder."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    specimen: Literal["coupon", "part"]
    angles_deg: tuple[float, ...]
    tilts_deg: tuple[float, ...]
    exposure_s: float
    brackets: tuple[float, ...]
    light_channel: str | None = None

    @model_validator(mode="after")
    def _some_poses(self) -> Self:
        if not self.angles_deg or not self.tilts_deg:
            raise ValueError("no poses")
        return self


@dataclass(frozen=True, eq=False)
class ScanResult:
    """A scan that was measured.

    Attributes:
        poses: P poses.
        to_light: (P, 3) unit vectors in the frame of the sample.
        to_camera: (P, 3).
        brdf: (P,) in 1/sr.
        budget: relative standard uncertainties (P,) by their source.
        wavelength_nm: of the lamp, where the rig file states it.
        coupon: seating and flatness; None of a part, whose seating is that of the recipe's uncertainty.
    """

    poses: tuple[Pose, ...]
    to_light: FloatArray
    to_camera: FloatArray
    brdf: FloatArray
    budget: dict[str, FloatArray]
    wavelength_nm: float | None = None
    coupon: "CouponSeat | None" = None

    @property
    def u(self) -> FloatArray:
        """(P,) relative standard uncertainty."""
        return np.asarray(np.sqrt(np.sum([part**2 for part in self.budget.values()], axis=0)))

    def table(self) -> DirectionsTable:
        """The rows that `fit brdf` reads."""
        angles = np.column_stack([polar_degrees(self.to_light), polar_degrees(self.to_camera)])
        rows = np.column_stack([angles, self.brdf, self.brdf * self.u])
        if self.wavelength_nm is None:
            return DirectionsTable((*COLUMNS, "u"), rows)
        rows = np.column_stack([rows, np.full(len(rows), self.wavelength_nm)])
        return DirectionsTable((*COLUMNS, "u", "wavelength_nm"), rows)

    def goniometer_csv(self) -> str:
        """The rows that `ink fit --values brdf` reads, of a scan whose wavelength is known.

        A structural-colour ink depends on the angle of the half vector and on the mean of both inclinations alone
        (Pranovich 2024, Eq. 5): each row is the pair in the plane of incidence that has the same two.
        """
        assert self.wavelength_nm is not None
        half = self.to_light + self.to_camera
        lean = np.degrees(np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]))
        mean = 0.5 * (polar_degrees(self.to_light)[:, 0] + polar_degrees(self.to_camera)[:, 0])
        rows = [
            [number_text(f"{x:.9g}") for x in (a + b, a - b, self.wavelength_nm, value)]
            for a, b, value in zip(mean, lean, self.brdf, strict=True)
        ]
        return csv_text([("theta_i_deg", "theta_o_deg", "wavelength_nm", "value"), *rows])


@dataclass(frozen=True, eq=False)
class CouponSeat:
    """Seat of a coupon on the stage, found from its scan.

    Attributes:
        about_x_deg, about_y_deg: seating, as of `seating_rotation`.
        u_deg: standard uncertainties of both.
        log_slopes: (P, 3) change of ln L per degree about x, about y, and of the light angle.
        light_angle_deg: light angle, found from the scan as far as it tells it.
        u_light_angle_deg: its standard uncertainty.
        flatness_deg: largest angle between the normal of a ninth of the region and their mean.
        u_flatness_deg: its standard uncertainty.
    """

    about_x_deg: float
    about_y_deg: float
    u_deg: tuple[float, float]
    log_slopes: FloatArray
    light_angle_deg: float
    u_light_angle_deg: float
    flatness_deg: float
    u_flatness_deg: float


def planned_poses(
    convention: Convention,
    ridge_angle_deg: float,
    alpha: float,
    *,
    tilt_deg: float = 20.0,
    stages: int = 24,
    tilts: int = 13,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Stage angles and tilts of a scan, dense where facets mirror the light into the camera.

    A share of the poses is spread evenly; the others follow the largest value of the lobe, exp(−(tan δ/α)²) with the
    angle δ between half vector and facet, over the other axis.

    Args:
        convention: of the rig.
        ridge_angle_deg: of the facets; 0 for a coupon.
        alpha: about the roughness.
        tilt_deg: largest tilt, either way.
        stages: number of stage angles.
        tilts: number of tilts.

    Raises:
        UsageError: fewer than four stage angles or three tilts, or a tilt that is none.
    """
    if not (4 <= stages <= 144 and 3 <= tilts <= 161 and 0.0 < tilt_deg <= 60.0):
        raise UsageError(
            f"a scan takes 4 to 144 stage angles, 3 to 161 tilts and a tilt to 60°, not {stages}, {tilts} and "
            f"{tilt_deg:g}°"
        )
    turn = np.arange(0.0, 360.0, _FINE_STAGE)
    tilt = np.arange(-tilt_deg, tilt_deg + 0.5 * _FINE_TILT, _FINE_TILT)
    light, camera = directions(pose_grid(tuple(turn), tuple(tilt)), convention)
    half = light + camera
    theta = np.radians(ridge_angle_deg)
    cosine = half @ [np.sin(theta), 0.0, np.cos(theta)] / np.linalg.norm(half, axis=1)
    lobe = np.exp(-np.minimum((1.0 / cosine**2 - 1.0) / alpha**2, 50.0)).reshape(len(tilt), len(turn))
    return _dense(turn, lobe.max(axis=0), stages, closed=True), _dense(
        tilt, lobe.max(axis=1), tilts, closed=False
    )


def _dense(fine: FloatArray, weight: FloatArray, count: int, *, closed: bool) -> tuple[float, ...]:
    """``count`` of the fine angles, spaced by the density of a weight mixed with an even one."""
    density = _SPREAD / fine.size + (1.0 - _SPREAD) * weight / weight.sum()
    if count >= fine.size:
        return tuple(fine.tolist())
    steps = 0.5 * (density[1:] + density[:-1])
    whole = np.concatenate([[0.0], np.cumsum(steps)])
    end = whole[-1] + 0.5 * (density[0] + density[-1]) if closed else whole[-1]
    wanted = np.linspace(0.0, end, count, endpoint=not closed)
    at = np.abs(whole[None, :] - wanted[:, None]).argmin(axis=1)
    return tuple(fine[np.unique(at)].tolist())


@by_keywords(extent=ScanExtent)
def begin_scan(
    rig_path: Path,
    recipe_path: Path,
    specimen: Literal["coupon", "part"],
    folder: Path,
    *,
    extent: ScanExtent,
    channel: str | None = None,
    on_progress: Advance = silent,
) -> ScanResult:
    """Scan into a new folder.

    Args:
        rig_path: rig file.
        recipe_path: recipe with region and exposure, of a part with its surface.
        specimen: what lies on the stage.
        folder: it must not exist, or be empty.
        extent: `ScanExtent`, or its fields as keywords.
        channel: light channel; that of the recipe or the rig file by default.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: a folder that holds files, or a plan that makes no sense.
        RecipeError, RigFileError, CalibrationError: a file.
        RigError: the rig, or a pose beyond its travel.
        MeasurementError: the pictures cannot be used.
    """
    job, settings = planned_scan(rig_path, recipe_path, specimen, extent=extent, channel=channel)
    _new_folder(folder)
    job, setup = _scanning(job, settings)
    with working_in(folder), _resumable(folder):
        plan = job.plan()
        here = rig_path.resolve().parent
        write_text(folder / SCAN, settings.model_dump_json(by_alias=True, indent=2) + "\n")
        manifest = begin(folder, job, Particulars(), plan=plan, frames=plan.frame_count, rig_folder=here)
        photograph(job, manifest, folder, on_progress)
        return _measured(folder, job, setup, manifest, on_progress)


@by_keywords(extent=ScanExtent)
def planned_scan(
    rig_path: Path,
    recipe_path: Path,
    specimen: Literal["coupon", "part"],
    *,
    extent: ScanExtent,
    channel: str | None = None,
) -> tuple[Job, ScanSettings]:
    """The job and the poses of a scan; nothing moves. Arguments and errors as for `begin_scan`."""
    job = prepare(recipe_path, rig_path, "scan", channel=channel)
    recipe = job.surface_recipe
    angle, surface = 0.0, recipe.surface
    if specimen == "part":
        if surface.design is None:
            raise UsageError(f"{recipe_path}: --part needs a recipe whose surface is a design")
        angle = surface.design.ridge_angle_deg
    convention = Convention(job.rig.light.angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    material = recipe.material.material()
    alpha = float(np.sqrt(material.alpha_along * material.alpha_across))
    angles, all_tilts = planned_poses(
        convention, angle, alpha, tilt_deg=extent.tilt_deg, stages=extent.stages, tilts=extent.tilts
    )
    check_arm(job.rig, all_tilts)
    acquisition = recipe.acquisition
    return job, ScanSettings(
        specimen=specimen,
        angles_deg=angles,
        tilts_deg=all_tilts,
        exposure_s=acquisition.exposure_s if extent.exposure_s is None else extent.exposure_s,
        brackets=acquisition.brackets or BRACKETS,
        light_channel=channel,
    )


def resume_scan(folder: Path, on_progress: Advance = silent) -> ScanResult:
    """Go on with a scan that was interrupted: frames of its folder are not taken again.

    Raises:
        RecordError: no scan began here, or a file is missing or was changed.
        RigError, CalibrationError, MeasurementError: as for `begin_scan`.
    """
    try:
        settings = ScanSettings.model_validate_json(bounded_bytes(folder / SCAN))
    except OSError as problem:
        raise RecordError(f"{folder}: no scan began here: {problem.strerror or problem}") from problem
    except ValidationError as problem:
        raise RecordError(f"{folder / SCAN} is damaged: {one_line(problem, ScanSettings)}") from problem
    with working_in(folder), _resumable(folder):
        manifest, job = reopen(folder, settings.light_channel)
        check_frames(folder)
        sweep(folder)
        job, setup = _scanning(job, settings)
        if missing_frames(manifest, read_journal(folder)) > 0:
            photograph(job, manifest, folder, on_progress)
        return _measured(folder, job, setup, manifest, on_progress)


@by_keywords(extent=ScanExtent)
def planned_lamps(
    rig_paths: Sequence[Path],
    recipe_path: Path,
    specimen: Literal["coupon", "part"],
    *,
    extent: ScanExtent,
    channels: Sequence[str] = (),
) -> Lamps:
    """A scan of one specimen with several lamps; nothing moves.

    Args:
        rig_paths: a rig file for each lamp, with its wavelength and the flat taken under it; or one with channels.
        recipe_path: as for `begin_scan`, as is the rest.
        specimen: what lies on the stage.
        extent: `ScanExtent`, or its fields as keywords.
        channels: light channels of the one rig file, each a lamp.

    Raises:
        UsageError: channels of several rig files, a lamp without a wavelength, or two of one; and as for `begin_scan`.
    """
    if channels and len(rig_paths) > 1:
        raise UsageError("light channels are those of one rig file: name one, or a rig file for each lamp")
    each = [(rig_paths[0], one) for one in channels] if channels else [(path, None) for path in rig_paths]
    folders: list[str] = []
    for path, channel in each:
        job, _ = planned_scan(path, recipe_path, specimen, extent=extent, channel=channel)
        nm, lamp = (
            job.rig.light.wavelength_nm,
            f"{path}" if channel is None else f"{path}, channel {channel},",
        )
        if nm is None or f"{nm:g}nm" in folders:
            what = "states no light.wavelength_nm" if nm is None else f"is a second one of {nm:g} nm"
            raise UsageError(
                f"{lamp} {what}: a scan with several lamps needs a rig file or a light channel for each wavelength"
            )
        folders.append(f"{nm:g}nm")
    return Lamps(
        rigs=tuple(path.resolve() for path, _ in each), channels=tuple(one for _, one in each),
        recipe=recipe_path.resolve(), specimen=specimen, **vars(extent), folders=tuple(folders),
    )  # fmt: skip


def begin_lamps(lamps: Lamps, folder: Path, on_progress: Advance = silent) -> tuple[ScanResult, ...]:
    """Scan with one lamp after the other, into folders within a new one; tables of all lie in the folder itself.

    Raises:
        UsageError: a folder that holds files; and as for `begin_scan`.
    """
    _new_folder(folder)
    write_text(folder / LAMPS, lamps.model_dump_json(by_alias=True, indent=2) + "\n")
    return resume_lamps(folder, on_progress)


def resume_lamps(folder: Path, on_progress: Advance = silent) -> tuple[ScanResult, ...]:
    """Go on with a scan with several lamps: what its folders hold is not taken again.

    Raises:
        RecordError: no such scan began here; and as for `begin_scan`.
    """
    try:
        lamps = Lamps.model_validate_json(bounded_bytes(folder / LAMPS))
    except OSError as problem:
        raise RecordError(f"{folder}: no scan began here: {problem.strerror or problem}") from problem
    except ValidationError as problem:
        raise RecordError(f"{folder / LAMPS} is damaged: {one_line(problem, Lamps)}") from problem
    found: list[ScanResult] = []
    try:
        channels = lamps.channels or (None,) * len(lamps.rigs)
        for rig, name, channel in zip(lamps.rigs, lamps.folders, channels, strict=True):
            here = folder / name
            on_progress(name, len(found), len(lamps.folders))
            if (here / SCAN).exists():
                found.append(resume_scan(here, on_progress))
                continue
            found.append(
                begin_scan(
                    rig,
                    lamps.recipe,
                    lamps.specimen,
                    here,
                    extent=ScanExtent(lamps.tilt_deg, lamps.stages, lamps.tilts, lamps.exposure_s),
                    channel=channel,
                    on_progress=on_progress,
                )
            )
    except (AnisoscopeError, KeyboardInterrupt) as error:
        error.add_note(f"`anisoscope rig scan --continue {folder}` goes on with all lamps")
        raise
    for name, texts in (
        (TABLE, [one.table().csv() for one in found]),
        (GONIOMETER, [one.goniometer_csv() for one in found]),
    ):
        write_text(folder / name, texts[0] + "".join(one.partition("\n")[2] for one in texts[1:]))
    return tuple(found)


def _new_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise UsageError(f"{folder} holds files: name a new folder, or `rig scan --continue {folder}`")
    except OSError as problem:
        raise RecordError(f"cannot make {folder}: {problem.strerror or problem}") from problem


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    try:
        yield
    except (AnisoscopeError, KeyboardInterrupt) as error:
        if (folder / JOURNAL).exists():
            error.add_note(f"`anisoscope rig scan --continue {folder}` goes on from here")
        raise


def _scanning(job: Job, settings: ScanSettings) -> tuple[Job, Setup]:
    """The job with the poses and exposures of a scan."""
    setup = setup_of(
        job.rig, job.recipe, settings.specimen, poses=pose_grid(settings.angles_deg, settings.tilts_deg)
    )
    assert setup.recipe is not None
    exposures = {"exposure_s": settings.exposure_s, "brackets": settings.brackets}
    recipe = setup.recipe.model_copy(
        update={"acquisition": setup.recipe.acquisition.model_copy(update=exposures)}
    )
    return replace(job, recipe=recipe, reference=None), replace(setup, recipe=recipe)


def _measured(folder: Path, job: Job, setup: Setup, manifest: Manifest, on_progress: Advance) -> ScanResult:
    """Measure the frames of a folder, and write its table, its readings and its budget."""
    on_progress("measurement", 0, 1)
    found = _result(job, setup, measure_scan(setup, job, manifest, folder))
    on_progress("measurement", 1, 1)
    write_text(folder / TABLE, found.table().csv())
    rows = [
        [number_text(f"{x:.9g}") for x in (pose.stage_deg, pose.tilt_deg, value, value * u)]
        for pose, value, u in zip(found.poses, found.brdf * found.to_light[:, 2], found.u, strict=True)
    ]
    write_text(folder / READINGS, csv_text([("stage_deg", "tilt_deg", "value", "u"), *rows]))
    seat = found.coupon
    budget = {
        "seating": None
        if seat is None
        else {
            "about_x_deg": seat.about_x_deg,
            "about_y_deg": seat.about_y_deg,
            "u_deg": list(seat.u_deg),
            "light_angle_deg": seat.light_angle_deg,
            "u_light_angle_deg": seat.u_light_angle_deg,
            "flatness_deg": seat.flatness_deg,
            "u_flatness_deg": seat.u_flatness_deg,
        },
        "unit": "relative standard uncertainty of each row of brdf.csv, k = 1",
        "sources": {name: part.tolist() for name, part in found.budget.items()},
        "combined": found.u.tolist(),
    }
    if found.wavelength_nm is not None:
        write_text(folder / GONIOMETER, found.goniometer_csv())
    write_text(folder / BUDGET, json.dumps(budget, indent=1) + "\n")
    return found


def _result(job: Job, setup: Setup, measured: Measured) -> ScanResult:
    light, camera = directions(setup.poses, setup.convention)
    budget = {one.source: np.abs(one.relative) for one in measured.components if one.source != "stage angle"}
    uncertainty = job.surface_recipe.uncertainty
    budget["scale of the white tile"] = np.full(len(light), uncertainty.scale_share)
    by_stage, by_tilt = log_slopes(setup.poses, measured.radiance)
    budget["stage angle"] = np.abs(by_stage) * uncertainty.stage_deg
    seat = None
    if setup.specimen.name == "coupon":
        seat = coupon_seat(setup, measured)
        found = replace(setup.convention, light_angle_deg=seat.light_angle_deg)
        light, camera = directions(setup.poses, found)
        turn = seating_rotation(seat.about_x_deg, seat.about_y_deg)
        light, camera = light @ turn, camera @ turn
        budget["seating, found from the scan"] = np.hypot(*(seat.log_slopes[:, :2] * seat.u_deg).T)
        budget["light angle"] = np.abs(seat.log_slopes[:, 2]) * seat.u_light_angle_deg
        budget["tilt"] = np.abs(by_tilt) * uncertainty.tilt_deg
    else:
        budget["tilt and seating"] = np.abs(by_tilt) * uncertainty.seating_tilt_deg
        # The half vector turns by half of what the light does, in a plane across that of the tilt.
        across = np.hypot(by_tilt, by_stage / np.maximum(_tangent(light, camera), 0.02))
        budget["light angle"] = 0.5 * across * uncertainty.light_angle_deg
    brdf = measured.radiance / light[:, 2]
    return ScanResult(setup.poses, light, camera, brdf, budget, job.rig.light.wavelength_nm, seat)


def coupon_seat(setup: Setup, measured: Measured) -> CouponSeat:
    """Seating of a coupon, light angle, and how flat it is.

    Args:
        setup: what was scanned.
        measured: radiances of the poses.

    Raises:
        CalibrationError: it leans too far, or is not flat.
    """
    own = [one.relative**2 for one in measured.components if not one.shared]
    noise = np.sqrt(np.sum(own, axis=0)) if own else np.zeros(len(setup.poses))
    scan = Scan(setup.poses, setup.convention, measured.radiance, noise)
    u_light_angle_deg = setup.specimen.u_light_angle_deg
    free = fit_lobe(scan, setup.specimen, setup.material, ("tail",))
    # a lobe of another family would be met by turning the light
    still = replace(setup.specimen, u_light_angle_deg=0.0)
    found = (free if free.fits else fit_lobe(scan, still, setup.material, ("tail",))).information
    values = dict(zip(found.names, map(float, found.values), strict=True))
    seat = values["seating_x_deg"], values["seating_y_deg"]
    off, u_off = values.get("light_angle_deg", 0.0), found.u.get("light_angle_deg", u_light_angle_deg)
    slopes = seating_slopes(setup, found.material, (*seat, off))
    flat, u_flat = flatness(np.log(np.maximum(measured.cells, 1e-12)), slopes[:, :2])
    if flat > FLATNESS_LIMIT_DEG + 2.0 * u_flat:
        raise CalibrationError(
            f"the coupon is not flat: normals of parts of the region lean by up to {flat:.2f}° from their mean (u "
            f"{u_flat:.2f}°, limit {FLATNESS_LIMIT_DEG:g}°): take a flatter piece or a smaller region, and see that "
            "the lamp stands far away"
        )
    u = found.u["seating_x_deg"], found.u["seating_y_deg"]
    angle = setup.convention.light_angle_deg + off
    return CouponSeat(*seat, u, slopes, angle, min(u_off, u_light_angle_deg), flat, u_flat)


def seating_slopes(setup: Setup, material: Material, at: tuple[float, float, float]) -> FloatArray:
    """(P, 3) change of ln L per degree of seating about x and about y and of the light angle, by the fitted lobe."""

    def log_light(values: list[float]) -> FloatArray:
        turned = replace(setup.convention, light_angle_deg=setup.convention.light_angle_deg + values[2])
        light, camera = directions(setup.poses, turned)
        turn = seating_rotation(values[0], values[1])
        return np.log(setup.specimen.direct(light @ turn, camera @ turn, setup.specimen.design, material))

    columns = []
    for axis in range(3):
        up, down = list(at), list(at)
        up[axis] += _SEATING_STEP_DEG
        down[axis] -= _SEATING_STEP_DEG
        columns.append((log_light(up) - log_light(down)) / (2.0 * _SEATING_STEP_DEG))
    return np.stack(columns, axis=-1)


def flatness(log_cells: FloatArray, slopes: FloatArray) -> tuple[float, float]:
    """Largest angle in degrees between normals of parts of a region and their mean, and its standard uncertainty.

    Each part follows ln L of the whole by its own normal and a factor of its own (albedo, shading), by least squares.

    Args:
        log_cells: (P, rows, cols) ln of the radiance of cells.
        slopes: (P, 2) change of ln L per degree about x and about y.
    """
    rows, cols = (np.array_split(np.arange(n), min(_PARTS, n)) for n in log_cells.shape[1:])
    parts = np.array(
        [log_cells[:, r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean(axis=(1, 2)) for r in rows for c in cols]
    )
    apart = parts - parts.mean(axis=0)
    design = np.column_stack([slopes, np.ones(len(slopes))])
    found, *_ = np.linalg.lstsq(design, apart.T, rcond=None)
    left = apart.T - design @ found
    scatter = np.sqrt(np.sum(left**2) / max(left.size - 3 * len(parts), 1))
    spread = scatter * np.sqrt(np.trace(np.linalg.pinv(design.T @ design)[:2, :2]))
    return float(np.hypot(found[0], found[1]).max()), float(spread)


def _tangent(light: FloatArray, camera: FloatArray) -> FloatArray:
    """(P,) tangent of the angle between half vector and normal: how far a turn of the stage moves it."""
    half = light + camera
    return np.asarray(np.hypot(half[:, 0], half[:, 1]) / half[:, 2])


def log_slopes(poses: tuple[Pose, ...], radiance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(P,) change of ln L per degree of the stage and of the tilt, from the neighbours in a full grid of poses.

    Args:
        poses: every stage angle at every tilt, stage angles running fastest.
        radiance: (P,).
    """
    stage = np.array(sorted({pose.stage_deg for pose in poses}))
    tilt = np.array(sorted({pose.tilt_deg for pose in poses}))
    table = np.log(np.maximum(radiance, 1e-12)).reshape(len(tilt), len(stage))
    around = np.concatenate([stage[-1:] - 360.0, stage, stage[:1] + 360.0])
    wrapped = np.concatenate([table[:, -1:], table, table[:, :1]], axis=1)
    by_stage = np.asarray(np.gradient(wrapped, around, axis=1))[:, 1:-1]
    by_tilt = np.asarray(np.gradient(table, tilt, axis=0)) if len(tilt) > 1 else np.zeros_like(table)
    return by_stage.ravel(), by_tilt.ravel()


def read_scan(path: Path) -> tuple[tuple[Pose, ...], FloatArray, FloatArray]:
    """Poses, radiances in any unit and their relative noise from a table ``stage_deg,tilt_deg,value[,u]``.

    Raises:
        UsageError: the file cannot be read or used.
    """
    poses, readings = read_readings(path, "exposure")
    if readings.kind != "exposure":
        raise UsageError(f"{path} holds contrasts: a material needs exposures (stage_deg,tilt_deg,value[,u])")
    noise = np.zeros(len(poses))
    if readings.noise_known:
        noise = np.sqrt(np.diag(readings.covariance)) / np.maximum(np.abs(readings.value), 1e-300)
    return poses, readings.value, noise
