"""Calibration of a material: a coupon or a part is scanned over stage and tilt, and its lobe fitted.

The scan is photographed and measured as an inspection is (`inspection.pipeline`), with the poses of the scan in place
of the recipe's; the fit is that of `fit.lobe`. Readings that were taken otherwise come from a table.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.json_fields import json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.record import MAX_DAYS
from anisoscope.fit.lobe import (
    Family,
    LobeFit,
    LobeInformation,
    Scan,
    Specimen,
    check_poses_suffice,
    coupon,
    coupon_poses,
    fit_lobe,
    part_poses,
    planned,
    ridged,
)
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.inspection.frames import read_frames
from anisoscope.inspection.job import Job, prepare
from anisoscope.inspection.manifest import Manifest, begin
from anisoscope.inspection.pipeline import measure_frames
from anisoscope.inspection.replay import WHITE_NAME, measured_by, read_given
from anisoscope.kinds.registry import kind_of
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.taking import MaterialEntry
from anisoscope.prediction.expectation import Expectation
from anisoscope.prediction.height_map_uncertainty import best_band, relief_model
from anisoscope.prediction.recipe_models import read_surface
from anisoscope.prediction.reflections import fitted_groove
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import ridge_edges
from anisoscope.recipe.base import CommonUncertainty, RecipeBase
from anisoscope.recipe.material_file import (
    CovariancePart,
    LobePart,
    MaterialFile,
    MaterialLightPart,
    ResidualPart,
    ScanPart,
    ValidityPart,
    write_material_file,
)
from anisoscope.recipe.surface import DesignPart, SurfacePart, SurfaceRecipe
from anisoscope.record.schema import Particulars
from anisoscope.rig.acquisition.runner import Progress, check_plan, open_rig, run_plan
from anisoscope.rig.framefolder import read_frame_folder
from anisoscope.rig.rigfile import RigFile, read_replay_rig, read_rig
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid

SERIAL = "material"
VALID_DAYS = 365.0
MOVE_S = 2.0
"""Usual time of a move of the stage, for the time that a scan is said to take."""
_STAGE_STEP_DEG = 0.1
JUDGED_POSES = pose_grid((0.0, 90.0, 180.0), (0.0, -10.0, 10.0))
JUDGED_DESIGN = RidgeDesign(100.0, 10.0)
"""Part and poses for which a plan says the uncertainty of ln ratios where the recipe has no ridges."""

SpecimenName = Literal["coupon", "part"]
_FAMILIES: dict[str, tuple[Family, ...]] = {
    "auto": ("tail", "second lobe"),
    "tail": ("tail",),
    "second-lobe": ("second lobe",),
}


@dataclass(frozen=True, eq=False)
class Setup:
    """Setup of a scan.

    Attributes:
        specimen: its model.
        material: about what it is made of: that of the recipe, or a usual one.
        poses: P poses of the scan.
        convention: how their angles are counted.
        rig: the rig file.
        recipe: with the surface and the poses of the scan; None where readings of a coupon come from a table.
    """

    specimen: Specimen
    material: Material
    poses: tuple[Pose, ...]
    convention: Convention
    rig: RigFile
    recipe: SurfaceRecipe | None


def _pairs(poses: Sequence[Pose]) -> list[list[float]]:
    return [[pose.stage_deg, pose.tilt_deg] for pose in poses]


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """A scan before it is taken.

    Attributes:
        setup: what is scanned.
        information: what it would say, with the noise of `fit.lobe.POSE_NOISE`.
        seconds: about how long it takes; None where nothing is photographed.
        u_log_ratios: (Q, Q) standard uncertainty of ln(L_i/L_j) that the material would leave.
        judged: Q poses of these ratios.
        ridge_angle_deg: of the part that they belong to.
    """

    setup: Setup = field(metadata=json_field("poses", by=lambda setup: _pairs(setup.poses)))
    information: LobeInformation = field(
        metadata=json_field(by=lambda found: {"u": found.u, "remarks": found.not_identified()}, merged=True)
    )
    seconds: float | None
    u_log_ratios: FloatArray
    judged: tuple[Pose, ...] = field(metadata=json_field("ratios_between", by=_pairs))
    ridge_angle_deg: float


def scan_setup(
    rig_path: Path,
    recipe_path: Path | None,
    name: SpecimenName,
    *,
    tilt_deg: float = 20.0,
    step_deg: float | None = None,
    poses: tuple[Pose, ...] | None = None,
) -> Setup:
    """Read what a scan needs; nothing moves.

    Args:
        rig_path: rig file.
        recipe_path: recipe with exposure and region; of a part also with its surface. None for readings of a coupon.
        name: "coupon" or "part".
        tilt_deg: largest tilt of the scan.
        step_deg: of the tilt; 2.5° for a coupon, 10° for a part.
        poses: those of readings or frames, in place of a scan; the rig file may then describe no devices.

    Raises:
        UsageError: a tilt or a step that is none, too few poses, or a part without a recipe.
        RecipeError, RigFileError, HeightMapError: a file.
    """
    recipe = None if recipe_path is None else kind_of(recipe_path).read_recipe(recipe_path)
    channel = None if recipe is None else recipe.acquisition.light_channel
    rig = read_rig(rig_path, channel=channel) if poses is None else read_replay_rig(rig_path, channel)
    return setup_of(rig, recipe, name, tilt_deg=tilt_deg, step_deg=step_deg, poses=poses)


def setup_of(
    rig: RigFile,
    recipe: RecipeBase | None,
    name: SpecimenName,
    *,
    tilt_deg: float = 20.0,
    step_deg: float | None = None,
    poses: tuple[Pose, ...] | None = None,
) -> Setup:
    """The same of files that were read.

    Raises:
        UsageError: as for `scan_setup`.
    """
    optics = Optics(rig.light.half_angle_deg or 0.0, rig.camera.half_angle_deg or 0.0)
    step = step_deg if step_deg is not None else (2.5 if name == "coupon" else 10.0)
    if not (0.0 < tilt_deg <= 60.0 and 0.5 <= step <= tilt_deg):
        raise UsageError(
            f"--max-tilt {tilt_deg:g} and --step {step:g}: a tilt of up to 60° and steps from 0.5° to it"
        )
    scanned = poses or (coupon_poses if name == "coupon" else part_poses)(tilt_deg, step)
    check_poses_suffice(scanned)
    if recipe is None:
        if name == "part":
            raise UsageError("--part needs --recipe FILE with its design or height map")
        specimen = replace(coupon(optics), u_light_angle_deg=CommonUncertainty().light_angle_deg)
        return Setup(specimen, Material(), scanned, Convention(rig.light.angle_deg), rig, None)
    if not isinstance(recipe, SurfaceRecipe):
        raise UsageError(f"{recipe.product}: a scan needs the recipe of a plastic surface")
    convention = Convention(rig.light.angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    material = recipe.material.material()
    recipe = _scanning(recipe.deciding(), scanned, name)
    specimen = coupon(optics) if name == "coupon" else _part(recipe, optics)
    specimen = replace(specimen, u_light_angle_deg=recipe.uncertainty.light_angle_deg)
    return Setup(specimen, material, scanned, convention, rig, recipe)


def _scanning(recipe: SurfaceRecipe, poses: Sequence[Pose], name: SpecimenName) -> SurfaceRecipe:
    """The recipe with the poses of the scan, and without ridges for a coupon."""
    angles = tuple(dict.fromkeys(pose.stage_deg for pose in poses))
    tilts = tuple(dict.fromkeys(pose.tilt_deg for pose in poses))
    changes: dict[str, object] = {
        "poses": recipe.poses.model_copy(update={"angles_deg": angles, "tilts_deg": tilts}),
        "decision": recipe.decision.model_copy(update={"tolerance": None}),
    }
    if name == "coupon":
        changes["surface"] = SurfacePart(
            pitch_um=recipe.surface.pitch_um, design=DesignPart(ridge_angle_deg=0.0)
        )
    return recipe.model_copy(update=changes)


def _part(recipe: SurfaceRecipe, optics: Optics) -> Specimen:
    """A ridged part by its design, or by its height map."""
    if recipe.surface.design is not None:
        return ridged(recipe.surface.ridge_design(), optics, recipe.surface.bounces)
    surface = read_surface(recipe)
    relief, _ = prepare_relief(surface, recipe.surface.pitch_um)
    edges = ridge_edges(relief)
    rays = relief_model(best_band(relief), optics, edges=edges)
    groove = replace(fitted_groove(relief, edges=edges).design, pitch_um=recipe.surface.pitch_um)

    def direct(
        to_light: FloatArray, to_camera: FloatArray, _design: RidgeDesign, material: Material
    ) -> FloatArray:
        return rays(to_light, to_camera, material)

    def indirect(
        to_light: FloatArray, to_camera: FloatArray, design: RidgeDesign, material: Material
    ) -> FloatArray:
        return corrected.indirect_radiance(to_light, to_camera, design, material)

    return Specimen(groove, direct, indirect, shape_known=True, name="part")


def plan_scan(setup: Setup) -> ScanPlan:
    """Planned poses and duration of a scan, and the uncertainty that it would reach."""
    information = planned(setup.specimen, setup.material, setup.poses, setup.convention)
    judged, design = JUDGED_POSES, JUDGED_DESIGN
    seconds = None
    if setup.recipe is not None:
        acquisition = setup.recipe.acquisition
        one = acquisition.exposure_s * (1.0 + sum(acquisition.brackets)) * acquisition.frames_per_pose
        seconds = len(setup.poses) * (MOVE_S + acquisition.settle_s + one)
        if setup.specimen.name == "part":
            design = setup.specimen.design
    convention = Convention(setup.convention.light_angle_deg)
    u = information.u_log_ratios(design, judged, convention)
    return ScanPlan(setup, information, seconds, u, judged, design.ridge_angle_deg)


def scan_specimen(
    setup: Setup, rig_path: Path, recipe_path: Path, on_progress: Advance = silent
) -> tuple[Scan, str]:
    """Photograph a scan on a rig.

    Returns:
        The radiances, and the serial number of the camera.

    Raises:
        RigFileError, RigError: the rig.
        MeasurementError: the pictures cannot be used, or a calibration does not hold.
    """
    assert setup.recipe is not None
    job = replace(prepare(recipe_path, rig_path, SERIAL), recipe=setup.recipe, reference=None)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        here = rig_path.resolve().parent
        plan = job.plan()
        manifest = begin(folder, job, Particulars(), plan=plan, frames=plan.frame_count, rig_folder=here)
        serial = photograph(job, manifest, folder, on_progress)
        on_progress("measurement", 0, 1)
        measured = measure_scan(setup, job, manifest, folder)
    return _scan_of(setup, job, measured), serial


def frame_poses(frames: Path) -> tuple[Pose, ...]:
    """The poses of a scan that was photographed before: stage angles by tilts of the sample frames of a folder.

    Raises:
        UsageError, RecordError: no folder of frames.
    """
    shown = read_frame_folder(frames).of_kind("sample")
    angles = {round(one.stage_deg % 360.0, 3) for one in shown}
    return pose_grid(tuple(sorted(angles)), tuple(sorted({round(one.tilt_deg, 3) for one in shown})))


def scan_of_frames(
    setup: Setup, frames: Path, rig_path: Path, recipe_path: Path, reflectance: float = 0.99
) -> tuple[Scan, str]:
    """A scan from the frames of a folder (``frames.csv``), as `scan_specimen`.

    Args:
        setup: of the poses of these frames (`frame_poses`).
        frames: the folder.
        rig_path: rig file, for its geometry and calibrations; devices are not needed.
        recipe_path: recipe with the region.
        reflectance: of the tile in the flat frames, if there are any.

    Raises:
        RecordError: a pose, or dark or flat frames are missing.
        MeasurementError: the pictures cannot be used.
    """
    given = read_given(frames, recipe_path, SERIAL, rig_path, reflectance, setup.recipe)
    with tempfile.TemporaryDirectory() as temporary:
        job = replace(given.job(Path(temporary) / WHITE_NAME), reference=None)
        measured = measured_by(given, job, _expected(setup))
    return _scan_of(setup, job, measured), job.white.camera


def _scan_of(setup: Setup, job: Job, measured: Measured) -> Scan:
    reason = job.kind.drift_error(measured, job.recipe)
    if reason:
        raise CalibrationError(reason)
    own = [one.relative**2 for one in measured.components if not one.shared]
    noise = np.sqrt(np.sum(own, axis=0)) if own else np.zeros(len(setup.poses))
    return Scan(setup.poses, setup.convention, measured.radiance, noise)


def photograph(job: Job, manifest: Manifest, folder: Path, on_progress: Advance = silent) -> str:
    """Take the frames of a scan that its folder lacks; returns the serial number of the camera.

    Raises:
        RigFileError, RigError: the rig.
        CalibrationError: the flat was taken with another camera.
    """

    def report(now: Progress) -> None:
        on_progress(now.text, now.done, now.total)

    assert manifest.plan is not None
    with open_rig(job.rig) as rig:
        check_plan(manifest.plan, rig)
        serial = rig.camera.info.serial
        if job.white.camera != serial:
            raise CalibrationError(
                f"the flat was taken with camera {job.white.camera}, this is {serial}: take a new one with "
                "`anisoscope calibrate flat`"
            )
        run_plan(manifest.plan, rig, folder, on_progress=report)
    return serial


def measure_scan(setup: Setup, job: Job, manifest: Manifest, folder: Path) -> Measured:
    """Radiances of the poses of a scan from the frames of its folder.

    Raises:
        MeasurementError: the pictures cannot be used, or a calibration does not hold.
    """
    measured: Measured
    _, measured, _ = measure_frames(manifest.began, job, _expected(setup), read_frames(folder, manifest))
    reason = job.kind.drift_error(measured, job.recipe)
    if reason:
        raise CalibrationError(reason)
    return measured


def _expected(setup: Setup) -> Expectation:
    """Poses of the scan with the change of ln L with the stage angle, of direct light."""
    assert setup.recipe is not None

    def log_light(step_deg: float) -> FloatArray:
        moved = tuple(Pose(pose.stage_deg + step_deg, pose.tilt_deg) for pose in setup.poses)
        to_light, to_camera = directions(moved, setup.convention)
        light = corrected.radiance(to_light, to_camera, setup.specimen.design, setup.material)
        return np.log(np.maximum(light, 1e-12))

    per_degree = (log_light(_STAGE_STEP_DEG) - log_light(-_STAGE_STEP_DEG)) / (2.0 * _STAGE_STEP_DEG)
    return Expectation(
        "corrected",
        setup.recipe.poses.poses(),
        np.exp(log_light(0.0)),
        (),
        per_degree,
        None,
        setup.convention,
    )


@by_keywords(entry=MaterialEntry)
def calibrate_material(
    setup: Setup,
    scan: Scan,
    out: Path,
    *,
    entry: MaterialEntry,
    camera: str = "",
    on_progress: Advance = silent,
) -> tuple[MaterialFile, LobeFit]:
    """Fit the material of a scan and write its file.

    Args:
        setup: what was scanned.
        scan: its radiances.
        out: file to write (TOML).
        entry: name, validity, operator and family of lobes, or these as keywords; lobe "auto" takes the one with the
            smaller information criterion.
        camera: serial number of the camera.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        UsageError: a validity that is none.
        CalibrationError: a coupon that is not flat.
        RecordError: the file cannot be written.
    """
    days = VALID_DAYS if entry.valid_days is None else entry.valid_days
    if not 0.0 < days <= MAX_DAYS:
        raise UsageError(
            f"a material holds for more than 0 and at most {MAX_DAYS:g} days, not {days:g}: correct --valid-days"
        )
    found = fit_lobe(scan, setup.specimen, setup.material, _FAMILIES[entry.lobe], on_progress)
    now = datetime.now(UTC).replace(microsecond=0)
    light = setup.rig.light
    content = MaterialFile(
        id="material",
        name=entry.name or out.stem,
        taken_at=now,
        software=f"anisoscope {version('anisoscope')}",
        material=LobePart(**vars(found.material)),
        covariance=CovariancePart(
            parameters=found.information.lobe,
            matrix=tuple(map(tuple, found.information.material_covariance.tolist())),
        ),
        validity=ValidityPart(half_angle_deg=found.half_angle_deg, until=now + timedelta(days=days)),
        light=MaterialLightPart(
            wavelength_nm=light.wavelength_nm,
            bandwidth_nm=light.bandwidth_nm,
            lamp_half_angle_deg=light.half_angle_deg,
            aperture_half_angle_deg=setup.rig.camera.half_angle_deg,
        ),
        scan=ScanPart(
            specimen=setup.specimen.name,
            rig=setup.rig.name,
            camera=camera,
            operator=entry.operator,
            light_angle_deg=setup.convention.light_angle_deg,
            poses=tuple((pose.stage_deg, pose.tilt_deg) for pose in scan.poses),
        ),
        test=residual_test(found),
        remarks=(*found.warnings(), *found.information.not_identified()),
    )
    named = content.model_copy(update={"id": f"material-{now:%Y%m%d}-{content.digest()[:8]}"})
    return write_material_file(named, out), found


def residual_test(found: LobeFit) -> ResidualPart:
    """Test of a family of lobes by the residuals of a fit, as a material file states it."""
    return ResidualPart(
        residual_over_noise=found.residual_over_noise,
        birge_ratio=found.misfit.birge_ratio,
        degrees_of_freedom=round(found.misfit.dof),
        p_value=found.misfit.p_value,
        rms_share=found.rms_share,
        discrepancy_share=found.discrepancy_share,
        family=found.family,
        bic_advantage=None if found.other_bic is None else found.other_bic - found.misfit.bic,
    )
