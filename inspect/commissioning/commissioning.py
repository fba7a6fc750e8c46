"""Commissioning of a rig: from pictures to findings, their record, and the rig file that takes them."""

import json
import tempfile
import threading
import tomllib
import uuid
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from anisoscope.base.atomic_write import write_bytes, write_text
from anisoscope.base.errors import RecordError, RigFileError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.toml_edits import with_values
from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.calibration.record import CalibrationRecord
from anisoscope.calibration.white_reference import read_reference
from anisoscope.commissioning.angles import Angles, Assumed, evaluate
from anisoscope.commissioning.findings import findings_of
from anisoscope.commissioning.light import LightFit
from anisoscope.commissioning.observation import Observed, Picture, observe
from anisoscope.commissioning.part import RidgedPart
from anisoscope.commissioning.record import (
    Commissioning,
    Finding,
    FitRecord,
    ParameterRecord,
    PoseRecord,
)
from anisoscope.commissioning.series import PictureSet, Series, take
from anisoscope.imaging.linearisation import WhiteReference
from anisoscope.imaging.registration.placement import check_fixture
from anisoscope.parameters.taking import KnownPart, Taking, Turning
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.metrology.ridges import measure_ridges
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.material_file import MaterialFile
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import sha256_of
from anisoscope.rig.rigfile import RigFile, read_rig

Value = str | int | float
Changes = Mapping[tuple[str, ...], Value]


@dataclass(frozen=True)
class Written:
    """Outcome of writing the rig file: backup of the old one, and whether its comments were preserved."""

    backup: Path
    comments_preserved: bool


def update_rig_file(
    path: Path, changes: Changes, remarks: Mapping[tuple[str, ...], str] | None = None
) -> Written:
    """Change values of a rig file atomically; the old file is saved under a name with its date.

    Args:
        path: the rig file.
        changes: new values by the names of tables and key.
        remarks: comments that stand behind them then.

    Raises:
        RigFileError: the file cannot be read, or would no longer be a rig file.
        RecordError: it cannot be written.
    """
    read_rig(path)
    before = bounded_bytes(path)
    text = before.decode("utf-8-sig")
    try:
        edited, preserved = with_values(text, changes, RigFileError, "rig file", remarks), True
    except RigFileError:  # such as tables in one line
        edited, preserved = _dumped(text, changes), False
    backup = path.with_name(f"{path.name}.{datetime.now(UTC):%Y%m%dT%H%M%S%f}.bak")
    write_bytes(backup, before)
    write_text(path, edited)
    try:
        read_rig(path)
    except RigFileError:
        write_bytes(path, before)
        raise
    return Written(backup, preserved)


def _dumped(text: str, changes: Changes) -> str:
    """The changed file written anew, without its comments."""
    import tomli_w  # noqa: PLC0415 - start-up time

    tables = tomllib.loads(text)
    for place, value in changes.items():
        table = tables
        for name in place[:-1]:
            table = table.setdefault(name, {})
        table[place[-1]] = value
    return tomli_w.dumps(tables)


MAX_DRIFT = 0.02


@dataclass(frozen=True, eq=False)
class Commissioned:
    """Result of a commissioning: its record, and the data that only the page shows."""

    record: Commissioning
    pictures: tuple[Picture, ...]
    angles: Angles
    part: RidgedPart


_LOBE = ("ln_alpha_along", "ln_alpha_across", "ln_albedo", "tail")


def known_part(known: KnownPart, recipe: SurfaceRecipe | None) -> RidgedPart:
    """The ridged part on the stage: that of its recipe, or ideal ridges, with what was stated of it.

    Args:
        known: what was stated.
        recipe: that of `KnownPart.recipe`, where it names one.

    Raises:
        HeightMapError: the recipe's height map cannot be read, or has no ridges.
    """
    if recipe is not None:
        part = part_of_recipe(recipe, known.ridge_angle_deg, known.u_ridge_angle_deg)
    else:
        assert known.pitch_um is not None
        assert known.ridge_angle_deg is not None
        part = RidgedPart(known.pitch_um, known.ridge_angle_deg, u_ridge_angle_deg=known.u_ridge_angle_deg)
    if known.pitch_um is not None:
        part = replace(part, pitch_um=known.pitch_um)
    if known.spot_mm is not None:
        part = replace(part, spot_mm=known.spot_mm)
    if known.u_alpha is not None:
        part = replace(part, u_alpha_share=known.u_alpha, alpha_covariance=None)
    if known.alpha is not None:
        part = replace(part, alpha_along=known.alpha[0], alpha_across=known.alpha[-1])
    return part


def series_of(turning: Turning, recipe: SurfaceRecipe | None) -> Series:
    """The pictures of a commissioning; exposure and channel that are not stated are the recipe's.

    Raises:
        UsageError: an exposure is stated nowhere.
    """
    exposure, channel = turning.exposure_s, turning.channel
    if recipe is not None:
        exposure = recipe.acquisition.exposure_s if exposure is None else exposure
        channel = recipe.acquisition.light_channel if channel is None else channel
    if exposure is None:
        raise UsageError("give --exposure SECONDS, or --recipe FILE whose exposure is taken")
    step, frames = turning.step_deg, turning.frames
    return Series(
        exposure,
        turning.gain,
        step,
        turning.tilts_deg,
        max(step, 60.0),
        frames,
        max(frames, 4),
        turning.settle_s,
        channel,
    )


def part_of_recipe(
    recipe: SurfaceRecipe, ridge_angle_deg: float | None, u_ridge_angle_deg: float
) -> RidgedPart:
    """The ridged part that a recipe describes; the spot is the largest circle in its region.

    With a material file the roughness, albedo and tail are known as well as its covariance says, and as parts of the
    plastic scatter. A recipe's roughness is what its height map does not resolve. Where it has a map, ridge angle and
    resolved roughness are measured there, and the two roughnesses add in quadrature.

    Args:
        recipe: the recipe.
        ridge_angle_deg: ridge angle, where it is known better than by design or height map.
        u_ridge_angle_deg: its standard uncertainty.

    Raises:
        HeightMapError: the recipe's height map cannot be read, or has no ridges.
    """
    material, design = recipe.material, recipe.surface.design
    along, across, u_share = material.alpha_along, material.alpha_across, material.u_alpha_share
    angle = ridge_angle_deg if ridge_angle_deg is not None or design is None else design.ridge_angle_deg
    if recipe.surface.height_map is not None and design is None:
        found = measure_ridges(
            read_height_map(
                recipe.surface.height_map, pixel_um=recipe.surface.pixel_um, role=recipe.surface.role
            )
        )
        along, across = (
            float(np.hypot(own, estimate.value or 0.0))
            for own, estimate in ((along, found.alpha_along), (across, found.alpha_across))
        )
        if angle is None:
            angle, u_ridge_angle_deg = found.ridge_angle_deg.value, float(found.ridge_angle_deg.u or 0.1)
    if angle is None:
        raise UsageError("the height map of the recipe shows no ridge angle: give --ridge-angle")
    part = RidgedPart(
        pitch_um=recipe.surface.pitch_um,
        ridge_angle_deg=angle,
        alpha_along=along,
        alpha_across=across,
        albedo=material.albedo,
        index=material.index,
        u_ridge_angle_deg=max(u_ridge_angle_deg, 1e-3),
        u_alpha_share=max(u_share, 1e-4),
        u_albedo=max(material.u_albedo, 1e-5),
        u_index=max(material.u_index, 1e-5),
        u_seating_deg=max(recipe.uncertainty.seating_tilt_deg, 1e-3),
        wall="perpendicular" if design is None else design.wall,
        edge_radius_um=(design and design.edge_radius_um) or 0.0,
        foot_radius_um=(design and design.foot_radius_um) or 0.0,
        facet_azimuth_deg=recipe.poses.facet_azimuth_deg,
        center_mm=recipe.region.center_mm,
        spot_mm=min(recipe.region.size_mm),
        tail=material.tail,
        u_tail=material.u_tail or 0.0,
        second_lobe=material.second_lobe,
        internal_reflection=material.internal_reflection,
    )
    return part if material.calibrated is None else _calibrated(part, recipe, material.calibrated)


def _calibrated(part: RidgedPart, recipe: SurfaceRecipe, file: MaterialFile) -> RidgedPart:
    """A part of a calibrated plastic, known as its mean is, and as parts of it scatter.

    Correlations of roughness with tail and albedo are left out, which states too much, never too little.
    """
    names, scatter, own = file.covariance.parameters, recipe.stated_scatter, recipe.material
    covariance = dict.fromkeys(((a, b) for a in _LOBE for b in _LOBE), 0.0)
    known = file.covariance.array()
    covariance |= {(a, b): float(known[i, j]) for i, a in enumerate(names) for j, b in enumerate(names)}
    lobe = (
        ("ln_alpha_along", own.alpha_along, part.alpha_along),
        ("ln_alpha_across", own.alpha_across, part.alpha_across),
    )
    total = np.array([[covariance[a, b] for b, _, _ in lobe] for a, _, _ in lobe])
    # of the slopes that a map resolves nothing is unknown here
    share = np.array([(value / whole) ** 2 for _, value, whole in lobe])
    total = np.outer(share, share) * (total + scatter.alpha_share**2 * np.eye(2))
    u_albedo = part.albedo * float(
        np.hypot(np.sqrt(covariance["ln_albedo", "ln_albedo"]), scatter.albedo_share)
    )
    return replace(
        part,
        alpha_covariance=((total[0, 0], total[0, 1]), (total[1, 0], total[1, 1])),
        u_albedo=max(u_albedo, 1e-5),
        u_tail=float(np.sqrt(covariance["tail", "tail"])),
    )


def commission(
    rig_path: Path,
    part: RidgedPart,
    series: Series,
    assumed: Assumed | None = None,
    *,
    frames: Path | None = None,
    on_progress: Advance = silent,
    cancel: threading.Event | None = None,
) -> Commissioned:
    """Photograph a ridged part over a full turn and under tilts, and determine the geometry of the rig.

    Of the rig file only devices, fixture, pixel size and the zero of the tilt are used, the last as a first guess; no
    file is changed.

    Args:
        rig_path: rig file.
        part: the part on the stage.
        series: what to photograph.
        assumed: what is assumed of rig and model.
        frames: empty or missing folder that keeps the frames; by default they are thrown away.
        on_progress: progress.
        cancel: setting it stops the axes and ends the series with a `RigError`.

    Raises:
        RigFileError, RigError: the rig.
        UsageError: the folder for the frames holds something.
        CalibrationError: the white reference does not fit.
        MeasurementError: the pictures do not carry it.
        RecordError: the frames cannot be written.
    """
    file = read_rig(rig_path, channel=series.light_channel)
    if file.fixture is not None:
        check_fixture(file.fixture)
    white = _white(file)
    assumed = assumed or Assumed()
    with ExitStack() as cleanup:
        folder = frames or Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="commissioning-")))
        if folder.exists() and any(folder.iterdir()):
            raise UsageError(f"the folder {folder} for the frames is not empty: name a new one")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(f"cannot make the folder {folder}: {error.strerror}") from error
        picture_set = take(file, series, folder, white, on_progress, cancel)
        observed = observe(picture_set, file, part, on_progress)
    on_progress("fit", 0, 1)
    angles = evaluate(observed, file, part, assumed, picture_set.absolute)
    record = _record(rig_path, file, part, series, assumed, picture_set, observed, angles)
    on_progress("done", 1, 1)
    return Commissioned(record, observed.pictures, angles, part)


def _white(file: RigFile) -> WhiteReference | None:
    return None if file.calibration is None else read_reference(file.calibration.flat)


def changes_of(record: Commissioning) -> dict[tuple[str, ...], str | int | float]:
    """Changes for ``--write``: findings that differ, rounded to a tenth of their uncertainty."""
    found = {}
    for finding in record.findings:
        if not finding.goes_to_rig_file or finding.status != "found" or finding.value is None:
            continue
        value = finding.value
        if isinstance(value, float):
            value = round(value, _decimals(finding))
        if value != finding.old:
            found[tuple(finding.key.split("."))] = value
    return found


def _decimals(finding: Finding) -> int:
    return 6 if not finding.u else min(max(1 - int(np.floor(np.log10(finding.u))), 0), 6)


def write_to_rig_file(rig_path: Path, record: Commissioning) -> Written | None:
    """Write the findings to the rig file, each with its u as a comment; None if nothing differs.

    Raises:
        UsageError: the rig file was changed since the pictures were taken.
        RigFileError, RecordError: it cannot be read or written.
    """
    if sha256_of(rig_path) != record.rig_file_sha256:
        raise UsageError(f"{rig_path} was changed since it was commissioned: commission the rig again")
    changes: Changes = changes_of(record)
    told = {tuple(one.key.split(".")): _stated(one, record.created_at[:10]) for one in record.findings}
    return update_rig_file(rig_path, changes, {key: told[key] for key in changes}) if changes else None


def _stated(finding: Finding, day: str) -> str:
    """What stands behind a finding in the rig file."""
    return f"commissioned {day}" + (f", u = {finding.u:.2g} {finding.unit}" if finding.u else "")


def tilts_of(rig_path: Path, recipe: RecipeBase) -> tuple[float, ...]:
    """Tilts of a recipe at which the markers are taught; empty where no axis tilts the arm."""
    if read_rig(rig_path).tilt is None:
        return ()
    return tuple(sorted({pose.tilt_deg for pose in recipe.poses.poses()}))


@dataclass(frozen=True)
class Taught:
    """Reference of a fixture that was taught: its record and file; ``written`` where the rig file named none."""

    record: CalibrationRecord
    path: Path
    written: Written | None


def lacks_reference(file: RigFile) -> bool:
    """Whether the markers of a rig could be taught, as it has a fixture and a flat, and were not yet."""
    return file.fixture is not None and file.calibration is not None and file.calibration.fixture is None


def teach_fixture(
    rig_path: Path, taking: Taking, *, tilts: Sequence[float] = (), on_progress: Advance = silent
) -> Taught:
    """Photograph the markers all round, and name their reference in the rig file.

    The file is the one that the rig file names, else ``fixture.json`` beside it, with the name of the light channel
    where it has channels. A reference that is out of its limits is not named anew.

    Args:
        rig_path: rig file with a fixture and a flat.
        taking: exposure, gain and frames of every pose, and the light channel.
        tilts: of the arm, degrees, as of `anisoscope.calibration.fixture.calibrate_fixture`.
        on_progress: progress.

    Raises:
        RigFileError, RigError, CalibrationError, RegistrationError, MeasurementError, RecordError: as of that function,
            and of `update_rig_file`.
    """
    file = read_rig(rig_path, channel=taking.light_channel)
    name = "fixture.json" if file.light.channel is None else f"fixture-{file.light.channel}.json"
    path = (file.calibration and file.calibration.fixture) or rig_path.parent / name
    record = calibrate_fixture(rig_path, path, taking, tilts=tilts, on_progress=on_progress)
    written = name_in_rig(rig_path, "fixture", path, taking.light_channel) if record.in_limits else None
    return Taught(record, path, written)


def name_in_rig(
    rig_path: Path, kind: Literal["flat", "fixture"], path: Path, channel: str | None = None
) -> Written | None:
    """Name a calibration in the rig file, under its light channel where it has channels; None if it is named there.

    Args:
        rig_path: rig file.
        kind: of the calibration.
        path: its file; named from the folder of the rig file where it lies there.
        channel: light channel; None for the one that the rig file uses by default.

    Raises:
        RigFileError, RecordError: as of `update_rig_file`.
    """
    file = read_rig(rig_path, channel=channel)
    named = None if file.calibration is None else getattr(file.calibration, kind)
    path, home = path.resolve(), rig_path.resolve().parent
    if named is not None and named.resolve() == path:
        return None
    own = file.light.channel
    place = ("calibration", kind) if own is None else ("light", "channels", own, kind)
    inside = path.is_relative_to(home)
    return update_rig_file(rig_path, {place: path.relative_to(home).as_posix() if inside else str(path)})


def _record(
    rig_path: Path,
    file: RigFile,
    part: RidgedPart,
    series: Series,
    assumed: Assumed,
    picture_set: PictureSet,
    observed: Observed,
    angles: Angles,
) -> Commissioning:
    return Commissioning(
        id=uuid.uuid4().hex,
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"anisoscope {version('anisoscope')}",
        rig=file.name,
        rig_file=rig_path.name,
        rig_file_sha256=sha256_of(rig_path),
        devices=picture_set.devices,
        part=_plain(asdict(part)),
        series=_plain(asdict(series) | asdict(assumed) | {"white_reference": picture_set.absolute}),
        findings=findings_of(angles, file, picture_set, part.facet_azimuth_deg),
        poses=_poses(observed, angles),
        fit=_fit(angles.light),
        drift=angles.drift,
        dark_level=picture_set.dark_level,
        dark_noise=picture_set.dark_noise,
        blur_px=observed.blur_px,
        notes=_notes(file, picture_set, angles),
        frames_sha256=picture_set.sha256,
    )


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """Table as it reads back from JSON: lists, no tuples."""
    found: dict[str, Any] = json.loads(json.dumps(table))
    return found


def _poses(observed: Observed, angles: Angles) -> tuple[PoseRecord, ...]:
    light = angles.light
    found = []
    for n, pose in enumerate(one for one in observed.poses if not one.again):
        fix = pose.fix
        found.append(
            PoseRecord(
                reading_deg=pose.reading_deg,
                tilt_reading_deg=pose.tilt_reading_deg,
                marker_deg=None if fix is None else fix.angle_deg,
                marker_residual_px=None if fix is None else fix.residual_px,
                squeeze=None if fix is None else fix.squeeze,
                ridge_deg=pose.ridge_deg,
                radiance=float(angles.corrected[n]),
                u_relative=float(angles.u_relative[n]),
                fitted=float(light.fitted[n]),
                z=float(light.z[n]),
            )
        )
    return tuple(found)


def _fit(light: LightFit) -> FitRecord:
    parameters = tuple(
        ParameterRecord(
            name=one.name,
            words=one.words,
            prior=None if one.u_prior is None else one.prior,
            u_prior=one.u_prior,
            value=one.value,
            u=one.u,
            u_alone=one.u_alone if np.isfinite(one.u_alone) else None,
        )
        for one in light.parameters
    )
    correlation = tuple(tuple(float(x) for x in row) for row in light.correlation)
    return FitRecord(
        parameters=parameters,
        correlation=correlation,
        chi2=light.chi2,
        dof=light.dof,
        widened=light.widened,
        side_chi2=light.side_chi2,
        sign_chi2=light.sign_chi2,
    )


def _notes(file: RigFile, picture_set: PictureSet, angles: Angles) -> tuple[str, ...]:
    found = [] if picture_set.exposure is None else [picture_set.exposure]
    if file.fixture is None:
        found.append("the rig file describes no fixture: centre and pixel size were not measured")
    elif angles.markers is None:
        found.append("fewer than 5 pictures show the markers: sense and zero come from the ridges alone")
    elif file.calibration is None or file.calibration.fixture is None:
        found.append(
            "nothing watches lamp, stray light and camera before the markers are taught: --write does it where the rig "
            "has a flat, else `anisoscope calibrate flat --write` after the tile"
        )
    if angles.ridges is None:
        found.append("the camera does not resolve the ridges: their direction comes from brightness alone")
    if not picture_set.absolute:
        found.append(
            "no white reference: the scale of the radiances is free, and shading stays in the pictures"
        )
    if abs(angles.drift) > MAX_DRIFT:
        found.append(
            f"the lamp drifted by {angles.drift:+.1%} over the series: let it warm up, and commission again"
        )
    if angles.light.widened > 2.0:
        found.append(
            f"the model misses the radiances by {angles.light.widened:.1f} times their uncertainty: is the part the "
            "one described, clean and flat? Uncertainties were widened by this"
        )
    return tuple(found)
