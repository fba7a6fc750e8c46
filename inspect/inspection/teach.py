"""Teach a recipe by a good part: exposure, region and tolerances as its pictures suggest; or by limits of a file."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import MeasurementError, RigFileError, Saturated, UsageError
from anisoscope.base.notation import p_value_text
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import bounded_text
from anisoscope.base.toml_edits import with_values
from anisoscope.decision.reference_parts import golden_path
from anisoscope.history.aqdef import read_aqdef
from anisoscope.imaging.registration.lens import Lens
from anisoscope.imaging.registration.placement import Grid, Placement, locate, resample
from anisoscope.inspection.frame_table import Replay
from anisoscope.inspection.job import Job, check_serial, prepare
from anisoscope.inspection.replay import inspect_frames, read_given
from anisoscope.inspection.run import Inspected, Methods, inspect_part
from anisoscope.kinds.kind import AnyKind
from anisoscope.kinds.parts import Reference, Teaching
from anisoscope.kinds.recipes import read_any_recipe
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.recipe.teaching import Change, Taught, previous_version_path
from anisoscope.record.schema import Record
from anisoscope.record.surface_details import contrast_label
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import Rig, open_rig, run_plan
from anisoscope.rig.bayer import grey_of
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame, read_frame
from anisoscope.rig.rigfile import RigFile, read_replay_rig
from anisoscope.sim.light.contrasts import contrasts

UNLIKE = 2.0  # factor in brightness from which on a stretch along the border is not the part
POINTS_A_PITCH = 4
QUIET = 1.25  # markers need white around them


def largest_region(
    pictures: Sequence[FloatArray], places: Sequence[Placement], fixture: Fixture, recipe: RecipeBase
) -> float:
    """Side of the largest square about the recipe's middle of the region, whole pitches or cells of the map, in mm.

    Args:
        pictures: one a pose, proportional to radiance.
        places: where the part stands in them.
        fixture: the markers.
        recipe: pitch or cell, middle and direction of the region.

    Raises:
        MeasurementError: not even two pitches or cells fit.
    """
    pitch_mm = recipe.step_mm
    turn = recipe.poses.facet_azimuth_deg
    best = 0
    most = int(_reach(fixture, recipe) / pitch_mm)
    reference = [_middle(picture, place, recipe) for picture, place in zip(pictures, places, strict=True)]
    for count in range(2, most + 1):
        grid = _grid(recipe, count, turn)
        if not _clear_of_markers(fixture, recipe, count * pitch_mm):
            best -= recipe.margin_at_markers  # its edge may lie here as well
            break
        if not all(
            _shows(picture, place, grid, middle)
            for picture, place, middle in zip(pictures, places, reference, strict=True)
        ):
            best -= 1  # the part ends here: keep a pitch away from its edge
            break
        best = count
    if best < 2:
        raise MeasurementError(
            f"around region.center_mm not even two {recipe.steps} of the part show in all poses: centre the part, or "
            "correct region.center_mm in the recipe"
        )
    return round(best * pitch_mm, 6)


def _reach(fixture: Fixture, recipe: RecipeBase) -> float:
    """Largest side of a square between the markers."""
    x, y = recipe.region.center_mm
    return 2.0 * max(float(np.hypot(one.x_mm - x, one.y_mm - y)) for one in fixture.markers)


def _grid(recipe: RecipeBase, count: int, turn_deg: float) -> Grid:
    points = count * POINTS_A_PITCH
    step = recipe.step_mm / POINTS_A_PITCH
    return Grid(recipe.region.center_mm, step, (points, points), turn_deg)


def _clear_of_markers(fixture: Fixture, recipe: RecipeBase, side_mm: float) -> bool:
    """Does a square keep off all markers and their white rims?"""
    turn = np.radians(recipe.poses.facet_azimuth_deg)
    reach = 0.5 * side_mm + 0.5 * QUIET * fixture.marker_mm * (abs(np.cos(turn)) + abs(np.sin(turn)))
    for marker in fixture.markers:
        x, y = np.subtract((marker.x_mm, marker.y_mm), recipe.region.center_mm)
        u, v = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
        if max(abs(u), abs(v)) < reach:
            return False
    return True


def _middle(picture: FloatArray, place: Placement, recipe: RecipeBase) -> float:
    middle = resample(picture.astype(np.float32), place, _grid(recipe, 2, recipe.poses.facet_azimuth_deg))
    return float(np.nanmean(middle)) if np.isfinite(middle).any() else 0.0


def _shows(picture: FloatArray, place: Placement, grid: Grid, middle: float) -> bool:
    """Is all of the square in the picture, and are its border stretches about as bright as its middle?"""
    patch = resample(picture.astype(np.float32), place, grid).astype(np.float64)
    if middle <= 0.0 or not np.isfinite(patch).all():
        return False
    n = patch.shape[0] // POINTS_A_PITCH
    blocks = patch.reshape(n, POINTS_A_PITCH, n, POINTS_A_PITCH).mean(axis=(1, 3))
    border = np.concatenate([blocks[0], blocks[-1], blocks[1:-1, 0], blocks[1:-1, -1]])
    return bool(np.all((border > middle / UNLIKE) & (border < middle * UNLIKE)))


LEVEL = 0.7  # of full scale, of the brightest pose
BRIGHT_PERCENTILE = 99.9
MAX_TRIES = 8


@dataclass(frozen=True, eq=False)
class _Probe:
    """One picture a pose: the exposure, pictures above black, and the place of the part in them.

    Attributes:
        exposure_s: exposure; the shortest one of brackets.
        brackets: further exposures, as multiples of it; None where they stay as the recipe has them.
        level: brightness of the brightest pose, as a share of full scale.
        pictures: counts above black.
        places: where the part stands in them.
    """

    exposure_s: float
    brackets: tuple[float, ...] | None
    level: float
    pictures: tuple[FloatArray, ...]
    places: tuple[Placement, ...]


def teach(
    recipe_path: Path,
    rig_path: Path,
    serial: str,
    out: Path,
    advance: Advance = silent,
    *,
    methods: Methods | None = None,
) -> Taught:
    """Photograph a good part and write a new version of a recipe; the old one is saved next to it.

    The part is photographed once to find exposure and region, then inspected with them; tolerances follow from the
    uncertainty of that inspection, and from the golden parts of the recipe where there are any. The tolerances of a
    print follow from its golden prints, or where there are too few from the uncertainty and from what the print itself
    deviates.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: of the good part.
        out: folder that receives the inspection folder.
        advance: progress.
        methods: what varies in an inspection, for tests.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: before anything moves.
        RigError: hardware.
        MeasurementError: the part cannot be photographed well, or its inspection is INVALID; the recipe stays as it is.
        RecordError: a file cannot be written.
    """
    check_serial(serial)
    if read_replay_rig(rig_path).without_devices:
        raise RigFileError(
            f"{rig_path} describes no devices, so that no part can be photographed: teach by frames that exist, with "
            "--frames"
        )
    job = prepare(recipe_path, rig_path, serial)
    fixture = _fixture(job.fixture, rig_path)
    previous_version_path(recipe_path, job.recipe.version)
    with open_rig(job.rig) as rig:
        info = rig.camera.info
        job.kind.check_filters(info.filters, f"camera {info.serial}", job.white.filters)
        probe = _probe(rig, job, fixture, advance)

    def inspect(candidate: Path) -> Inspected:
        return inspect_part(candidate, rig_path, serial, out, advance, methods=methods)

    part = _GoodPart(job.kind, job.recipe, job.rig, fixture, job.reference)
    return _taught(recipe_path, part, probe, inspect, ())


def teach_by_frames(
    recipe_path: Path,
    frames: Path,
    serial: str,
    out: Path,
    advance: Advance = silent,
    *,
    rig_path: Path | None = None,
    reflectance: float = 0.99,
    methods: Methods | None = None,
) -> Taught:
    """Teach a recipe by frames of a good part, as `teach` does; the exposure is that of the frames.

    Args:
        recipe_path: recipe file.
        frames: folder with ``frames.csv``.
        serial: of the good part.
        out: folder that receives the inspection folder.
        advance: progress.
        rig_path: rig file, for its geometry; by default ``rig.toml`` next to the frames.
        reflectance: reflectance of the tile in the flat frames, if there are any.
        methods: what varies in an inspection, for tests.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError, MeasurementError, RecordError: as for
            `teach` and `anisoscope.inspection.replay.inspect_frames`.
    """
    given = read_given(frames, recipe_path, serial, rig_path, reflectance)
    fixture = _fixture(given.fixture, given.rig_path)
    previous_version_path(recipe_path, given.recipe.version)
    probe = _probe_of(given.replay, given.recipe, fixture)

    def inspect(candidate: Path) -> Inspected:
        return inspect_frames(
            frames,
            candidate,
            serial,
            out,
            advance,
            rig_path=given.rig_path,
            reflectance=reflectance,
            methods=methods,
        )

    part = _GoodPart(given.kind, given.recipe, given.rig, fixture, given.reference)
    note = (
        f"the exposure is that of the frames, whose brightest pose reaches {probe.level:.0%} of full scale "
        f"({LEVEL:.0%} is sought on a rig); not checked: whether another one would show more"
    )
    return _taught(recipe_path, part, probe, inspect, (note,))


def teach_by_limits(recipe_path: Path, rig_path: Path, source: Path) -> Taught:
    """Write a new version of a recipe with tolerances from the limits of an AQDEF file; nothing moves.

    A recipe predicts its contrasts and has one tolerance on both sides of each: the distance from the prediction to the
    nearer limit, so that no part passes which the limits refuse. Notes give nominal value, limits and prediction.

    Args:
        recipe_path: recipe with contrasts between poses.
        rig_path: rig file, for its light angle.
        source: ``.dfq``, or ``.dfd``; its characteristics are named as in the history, such as ``ln 0-90``.

    Raises:
        UsageError: the recipe has no such contrasts, a limit is missing, or a prediction is not within its limits.
        RecipeError, RigFileError, RecordError: a file.
    """
    kind = kind_of(recipe_path)
    recipe = kind.read_recipe(recipe_path)
    if not isinstance(recipe, SurfaceRecipe):
        raise UsageError(
            f"{recipe_path}: limits are taken for contrasts between poses, which {kind.one} has not"
        )
    previous = previous_version_path(recipe_path, recipe.version)
    given = read_aqdef(source)
    rig = read_replay_rig(rig_path, recipe.acquisition.light_channel)
    expected = kind.predict(recipe, rig, cached=True)
    found, notes = [], []
    for one in contrasts(expected.poses, expected.radiance):
        name = contrast_label(recipe.decision.contrast, one.from_deg, one.to_deg, one.tilt_deg)
        predicted = float(getattr(one, recipe.decision.contrast))
        low, high = given.limits.get(name, (None, None))
        if low is None or high is None:
            raise UsageError(
                f"{source}: {name!r} needs a lower and an upper limit (K2110, K2111); it describes "
                f"{', '.join(given.numbers)}"
            )
        if low >= high:
            raise UsageError(
                f"{source}: {name}: the lower limit {low:g} (K2110) is not below the upper one {high:g} (K2111)"
            )
        if not low < predicted < high:
            raise UsageError(
                f"{source}: {name} must be within {low:g} and {high:g}, where {recipe_path} predicts {predicted:+.4f}: "
                "the file is that of another part, or the recipe's height map or design is not that of a good one"
            )
        found.append(float(f"{min(predicted - low, high - predicted):.6g}"))
        nominal = f"nominal {given.nominal[name]:+.4f}, " if name in given.nominal else ""
        notes.append(
            f"{name}: {nominal}limits {low:+.4f} to {high:+.4f}, predicted {predicted:+.4f}: ±{found[-1]:g}"
        )
    if given.product != recipe.product:
        notes.append(f"the part of {source.name} is {given.product!r}, that of the recipe {recipe.product!r}")
    text = bounded_text(recipe_path)
    values = {("version",): recipe.version + 1, ("decision", "tolerance"): found}
    candidate = recipe_path.with_name(f".{recipe_path.stem}-taught.toml")
    try:
        write_text(candidate, with_values(text, values))
        kind.read_recipe(candidate)
    finally:
        candidate.unlink(missing_ok=True)
    write_text(previous, text)
    write_text(recipe_path, with_values(text, values))
    change = Change("decision.tolerance", recipe.decision.tolerance, found, f"the limits of {source.name}")
    return Taught(recipe.version + 1, previous, None, (change,), tuple(notes))


def _fixture(fixture: Fixture | None, rig_path: Path) -> Fixture:
    if fixture is None:
        raise RigFileError(f"{rig_path} describes no [fixture]: teaching finds the part between its markers")
    return fixture


@dataclass(frozen=True, eq=False)
class _GoodPart:
    """The kind of part that teaches, by recipe and rig, and the golden parts."""

    kind: AnyKind
    recipe: RecipeBase
    rig: RigFile
    fixture: Fixture
    reference: Reference | None


def _taught(
    recipe_path: Path,
    part: _GoodPart,
    probe: _Probe,
    inspect: Callable[[Path], Inspected],
    notes: tuple[str, ...],
) -> Taught:
    """Write the new version of a recipe by a first look at a good part, and by its inspection."""
    recipe, text = part.recipe, bounded_text(recipe_path)
    previous = previous_version_path(recipe_path, recipe.version)
    size = largest_region(probe.pictures, probe.places, part.fixture, recipe)
    values: dict[tuple[str, ...], Any] = {
        ("version",): recipe.version + 1,
        ("acquisition", "exposure_s"): probe.exposure_s,
        ("region", "size_mm"): [size, size],
    }
    if probe.brackets is not None and probe.brackets != recipe.acquisition.brackets:
        values["acquisition", "brackets"] = list(probe.brackets)
    candidate = recipe_path.with_name(f".{recipe_path.stem}-taught.toml")
    try:
        write_text(candidate, with_values(text, values))
        inspected = inspect(candidate)
    finally:
        candidate.unlink(missing_ok=True)
    record = inspected.record
    if record.verdict == "INVALID":
        raise MeasurementError(
            f"the part cannot teach the recipe, which stays as it is: {'; '.join(record.reasons)} ({inspected.folder})"
        )
    limits = (
        part.kind.taught_limits(record, recipe, part.reference, part.rig)
        if isinstance(part.kind, Teaching)
        else {}
    )
    why = {
        "exposure_s": f"the brightest pose reaches {probe.level:.0%} of full scale",
        "brackets": "the exposures of the frames",
        "size_mm": "the part shows in all poses and between the markers",
    }
    reasons = {key: why[key[-1]] for key in values if key[-1] in why}
    reasons |= {key: reason for key, (_, reason) in limits.items()}
    values |= {key: value for key, (value, _) in limits.items()}
    write_text(previous, text)
    write_text(recipe_path, with_values(text, values))
    taught = read_any_recipe(recipe_path)
    changes = tuple(
        Change(".".join(key), _value(recipe, key), _value(taught, key), reason)
        for key, reason in reasons.items()
    )
    notes = (*_notes(record, recipe_path, recipe), *notes)
    return Taught(taught.version, previous, inspected.folder, changes, notes)


def _value(recipe: RecipeBase, key: tuple[str, ...]) -> Any:  # noqa: ANN401 - of any type
    return getattr(getattr(recipe, key[0]), key[1])


def _probe(rig: Rig, job: Job, fixture: Fixture, advance: Advance) -> _Probe:
    """Photograph every pose once, exposed so that the brightest one reaches the target level.

    Raises:
        Saturated: no exposure was found.
    """
    recipe = job.recipe
    exposure_s = recipe.acquisition.exposure_s
    poses = tuple(Pose(pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses())
    for attempt in range(MAX_TRIES):
        advance(f"exposure of {exposure_s:.3g} s", attempt, MAX_TRIES)
        frames = _photograph(rig, Plan(poses, exposure_s, recipe.acquisition.gain, return_to_first=False))
        level = _level(frames)
        if level < 0.99 and abs(level / LEVEL - 1.0) < 0.1:
            return _seen(frames, fixture, level, None, job.calibrations.lens)
        exposure_s = float(f"{exposure_s * (0.25 if level >= 0.99 else LEVEL / max(level, 0.01)):.3g}")
    raise Saturated(
        f"no exposure brings the brightest pose to {LEVEL:.0%} of full scale (last tried: {exposure_s:g} s): "
        "is the light on, and is it steady?"
    )


def _probe_of(replay: Replay, recipe: RecipeBase, fixture: Fixture) -> _Probe:
    """The first frame of every pose of a folder, at its shortest exposure."""
    required = [Pose(pose.stage_deg, pose.tilt_deg) for pose in recipe.poses.poses()]
    samples = [(one, pose) for one, pose in replay.entries if one.kind == "sample" and not one.again]
    of_pose = [[entry for entry, pose in samples if pose == wanted] for wanted in required]
    frames = [min(entries, key=lambda entry: entry.exposure_s).load() for entries in of_pose]
    longer = sorted({entry.exposure_s / frames[0].exposure_s for entry in of_pose[0]})[1:]
    return _seen(frames, fixture, _level(frames), tuple(float(f"{ratio:.4g}") for ratio in longer))


def _above_black(frame: Frame) -> FloatArray:
    return np.asarray(frame.counts, dtype=np.float64) - frame.black_level


def _level(frames: Sequence[Frame]) -> float:
    """Brightness of the brightest frame, as a share of full scale."""
    full = frames[0].full_scale - frames[0].black_level
    return max(float(np.percentile(_above_black(frame), BRIGHT_PERCENTILE)) for frame in frames) / full


def _seen(
    frames: Sequence[Frame],
    fixture: Fixture,
    level: float,
    brackets: tuple[float, ...] | None,
    lens: Lens | None = None,
) -> _Probe:
    grey = [grey_of(_above_black(frame).astype(np.float32), frame.filters) for frame in frames]
    places = tuple(
        locate(picture, fixture, frame.tilt_deg, lens=lens)
        for picture, frame in zip(grey, frames, strict=True)
    )
    pictures = tuple(picture.astype(np.float64) for picture in grey)
    return _Probe(float(f"{frames[0].exposure_s:.3g}"), brackets, level, pictures, places)


def _photograph(rig: Rig, plan: Plan) -> list[Frame]:
    """The lit frames of a plan, in its order."""
    with tempfile.TemporaryDirectory(prefix="anisoscope-teach-") as name:
        folder = Path(name)
        run_plan(plan, rig, folder)
        lines = sorted(read_journal(folder).by_step.items())
        return [read_frame(folder / line.name) for _, line in lines if line.kind == "sample"]


def _notes(record: Record, recipe_path: Path, recipe: RecipeBase) -> tuple[str, ...]:
    notes = []
    if record.p_value is not None and record.p_value < recipe.decision.alpha:
        notes.append(
            f"the part deviates significantly from the prediction (p {p_value_text(record.p_value)}): is it good, and "
            f"{recipe.described_in} right?"
        )
    if golden_path(recipe_path).exists():
        notes.append(
            f"the golden parts in {golden_path(recipe_path)} belong to the version before: inspect good parts anew"
        )
    return tuple(notes)
