"""Recipes and their golden parts: checked, taught by good parts, poses chosen, false alarms certified."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.white_reference import exposure_for
from anisoscope.decision.certificate import (
    FalseAlarmCertificate,
    StoredCertificate,
    certificate,
    certificate_path,
)
from anisoscope.decision.reference_parts import golden_path, write_golden
from anisoscope.inspection import teach as by_part
from anisoscope.inspection.replay import check_with_frames
from anisoscope.kinds.parts import Reference, collecting, taught
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.kinds.registry import add_golden as added_golden
from anisoscope.kinds.registry import kind_of
from anisoscope.parameters.detection import PoseChoice
from anisoscope.parameters.inspecting import PartFrames, Teaching
from anisoscope.parameters.keywords import by_keywords
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.recipe.teaching import Taught
from anisoscope.record.schema import Record, read_record, sha256_of
from anisoscope.rig.rigfile import RigFile, read_rig
from anisoscope.study.best_poses import Suggestion, best_poses, sizes_in_toml, with_sizes


@by_keywords(foreign=PartFrames)
def check_recipe(
    recipe: Path | str,
    rig: Path | str | None = None,
    *,
    foreign: PartFrames,
    light_angle_deg: float | None = None,
    try_tilts_deg: Sequence[float] = (10.0, 20.0),
    on_progress: Advance = silent,
) -> RecipeCheck:
    """Predict the poses of a recipe, their uncertainties, and which causes it can distinguish; nothing moves.

    Args:
        recipe: recipe file.
        rig: rig file, for its geometry; its devices may be missing.
        foreign: `PartFrames`; whether a part can be measured by them is checked as well.
        light_angle_deg: angle of the light, without a rig file; None is a usual one, and the check says so.
        try_tilts_deg: tilts to try as additions.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file.
    """
    path, rig_path, tries = Path(recipe), None if rig is None else Path(rig), tuple(try_tilts_deg)
    if foreign.frames is None:
        found: RecipeCheck = kind_of(path).check_recipe(path, rig_path, light_angle_deg, tries, on_progress)
        return found
    return check_with_frames(
        path,
        Path(foreign.frames),
        rig_path,
        reflectance=foreign.reflectance,
        tries=tries,
        advance=on_progress,
    )


@by_keywords(by=Teaching, foreign=PartFrames)
def teach(
    recipe: Path | str,
    rig: Path | str | None = None,
    *,
    by: Teaching,
    foreign: PartFrames,
    out: Path | str = "inspections",
    on_progress: Advance = silent,
) -> Taught:
    """Set exposure, region and tolerances of a recipe by a good part, by its golden parts, or by a file of limits.

    A good part is photographed, or frames of it are taken. The recipe becomes a new version; the old one is saved next
    to it.

    Args:
        recipe: recipe file.
        rig: rig file; with frames the rig.toml in their folder where it is not given.
        by: `Teaching`.
        foreign: `PartFrames` of the good part, whose exposure stays.
        out: folder that receives the inspection folder.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: neither a rig nor frames, or frames without a part.
        AnisoscopeError: a file, hardware, or a part that cannot be photographed well.
    """
    path, rig_path, frames = Path(recipe), None if rig is None else Path(rig), foreign.frames
    if by.serial is None and frames is not None:
        raise UsageError("--frames teaches by a good part: it goes with --serial")
    if rig_path is None and frames is None:
        raise UsageError(
            "name a rig file with --rig" + (", or a folder of frames with --frames" if by.serial else "")
        )
    if by.serial is not None:
        if frames is not None:
            return by_part.teach_by_frames(
                *(path, Path(frames), by.serial, Path(out), on_progress),
                rig_path=rig_path,
                reflectance=foreign.reflectance,
            )
        assert rig_path is not None
        return by_part.teach(path, rig_path, by.serial, Path(out), on_progress)
    assert rig_path is not None
    if by.limits is not None:
        return by_part.teach_by_limits(path, rig_path, by.limits)
    try:
        return taught(kind_of(path), path).teach_by_reference(path, rig_path, by.share, by.golden_of)
    except CalibrationError as error:  # no part is judged here: no exit code may look like a verdict
        raise UsageError(str(error)) from error


@dataclass(frozen=True)
class Suggested:
    """Chosen poses, and what a recipe states for them.

    Attributes:
        suggestion: poses, and how well they show each defect.
        in_recipe: lines for the recipe file: poses, acquisition, sizes of the defects.
    """

    suggestion: Suggestion = field(metadata=json_field(merged=True))
    in_recipe: tuple[str, ...] = field(metadata=LEFT_OUT)

    @property
    def reached(self) -> list[tuple[int, int]]:
        """(golden parts, frames per pose) with which every defect is found with the required probability."""
        return [(n, frames) for n, frames in sorted(self.suggestion.frames.items()) if frames is not None]


@by_keywords(choice=PoseChoice)
def suggest_poses(
    recipe: Path | str,
    *,
    choice: PoseChoice,
    rig: Path | str | None = None,
    light_angle_deg: float = 10.0,
    on_progress: Advance = silent,
) -> Suggested:
    """Choose poses that show defects best among good parts that differ ([scatter] of the recipe).

    Args:
        recipe: recipe file.
        choice: allowed poses and what they must show, or its fields as keywords.
        rig: rig file, for its light angle and white reference.
        light_angle_deg: angle of the light, without a rig file.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: a kind of part without scatter, too few allowed poses, or no defect that can be shown.
        RecipeError, RigFileError, HeightMapError: a file.
    """
    path = Path(recipe)
    kind = kind_of(path)
    rules = kind.read_recipe(path)
    if not getattr(getattr(kind, "reference_set", None), "predictive", False):
        raise UsageError(
            f"{path}: poses are chosen where a recipe states how good parts differ ([scatter]), not for {kind.one}"
        )
    sized: SurfaceRecipe
    sized, asked = with_sizes(rules, choice.defects)
    rig_file = None if rig is None else read_rig(Path(rig), channel=rules.acquisition.light_channel)
    angle = light_angle_deg if rig_file is None else rig_file.light.angle_deg
    found = best_poses(sized, angle, on_progress, asked, choice=choice)
    listed = ", ".join(f"[{stage:g}, {tilt:g}]" for stage, tilt in found.poses)
    reached = [frames for _, frames in sorted(found.frames.items()) if frames is not None]
    lines = ["[poses]", f"stage_and_tilt_deg = [{listed}]", "[acquisition]"]
    lines.append(f"frames_per_pose = {reached[-1] if reached else rules.acquisition.frames_per_pose}")
    lines.append(f"brackets = [{', '.join(f'{factor:g}' for factor in found.brackets)}]")
    lines.append(_exposure_line(rig_file, found.brightest, rules.acquisition.gain))
    sizes = sizes_in_toml(sized, rules)
    return Suggested(found, (*lines, *(("[defects]", *sizes) if sizes else ())))


def _exposure_line(rig: RigFile | None, brightest: float, gain: float) -> str:
    """Exposure of the brightest pose, as the white reference of the rig says; how to find it where there is none."""
    flat = None if rig is None or rig.calibration is None else rig.calibration.flat
    if flat is None:
        return "# exposure_s: with --rig, from the white reference of the rig file; or by `anisoscope recipe teach`"
    level = by_part.LEVEL
    try:
        seconds = exposure_for(flat, brightest, level, gain)
    except CalibrationError as problem:
        return f"# exposure_s: {problem}; or by `anisoscope recipe teach`"
    return f"exposure_s = {seconds:.2g}  # predicted: the brightest pose reaches {level:.0%} of full scale on average"


@dataclass(frozen=True)
class GoldenParts:
    """Golden parts of a recipe.

    Attributes:
        file: they are in.
        count: how many.
        lacking: why they cannot serve as a reference yet, or None.
        noun: word for one of them.
        failed: serial numbers of added parts whose verdict was FAIL.
        left_out: serial numbers of parts that deviate from the others of their lot, and were not added.
        changed: word and number: how many were added or removed.
    """

    file: Path
    count: int
    lacking: str | None
    noun: str = field(metadata=LEFT_OUT)
    failed: tuple[str, ...] = field(default=(), metadata=LEFT_OUT)
    left_out: tuple[str, ...] = ()
    changed: dict[str, int] = field(default_factory=dict, metadata=json_field(merged=True))

    @property
    @in_json()
    def compared_with(self) -> bool:
        """Inspections are compared with them."""
        return self.lacking is None and self.count > 0

    @staticmethod
    def of(path: Path, known: Reference, **changes: Any) -> "GoldenParts":  # noqa: ANN401 - fields
        """State of a set."""
        count = len(known.parts)
        return GoldenParts(path, count, known.lacking if count else None, known.noun, **changes)


def add_golden(recipe: Path | str, folders: Sequence[Path | str], *, unlabelled: bool = False) -> GoldenParts:
    """Add inspected parts that are known to be good to the golden parts of a recipe; all of them or none.

    Args:
        recipe: recipe file.
        folders: finished inspections.
        unlabelled: they are parts of a lot of unknown quality: those that deviate from the others are left out.

    Raises:
        UsageError: no folder.
        CalibrationError: a part of another kind, or one that does not fit the others.
        RecordError: a folder holds no finished inspection.
    """
    path = Path(recipe)
    if not folders:
        raise UsageError("name the folders of one or more finished inspections")
    rig = None
    if unlabelled:
        from anisoscope.inspection.manifest import reopen

        rig = reopen(Path(folders[0]))[1].rig
    known, failed, left_out = added_golden(path, [Path(one) for one in folders], unlabelled_on=rig)
    return GoldenParts.of(
        golden_path(path),
        known,
        failed=tuple(failed),
        left_out=tuple(left_out),
        changed={"added": len(folders) - len(left_out)},
    )


def remove_golden(recipe: Path | str, serials: Sequence[str]) -> GoldenParts:
    """Remove golden parts of a recipe by serial number; an empty set is deleted.

    Raises:
        UsageError: no serial number.
        CalibrationError: there are no such parts.
    """
    path, kind = golden_path(Path(recipe)), kind_of(Path(recipe))
    if not serials:
        raise UsageError("name the serial numbers of one or more golden parts")
    rules = kind.read_recipe(Path(recipe))
    known: Any = collecting(kind, rules).read_reference(path, rules)
    if known is None:
        raise CalibrationError(f"{path}: there are no golden parts of this recipe")
    before = len(known.parts)
    for serial in serials:
        known = known.without(serial)
    if known.parts:
        write_golden(path, known)
    else:
        path.unlink()
    return GoldenParts.of(path, known, changed={"removed": before - len(known.parts)})


@dataclass(frozen=True)
class Certified:
    """Certificate of the rate of false alarms.

    Attributes:
        certificate: the rate, and what the parts say of it.
        invalid: INVALID inspections, which say nothing.
        stored: file that reports of later inspections read, or None.
    """

    certificate: FalseAlarmCertificate = field(metadata=json_field(merged=True))
    invalid: int = field(metadata=LEFT_OUT)
    stored: Path | None = field(metadata=LEFT_OUT)


def certify_golden(
    recipe: Path | str,
    folders: Sequence[Path | str],
    *,
    false_alarms: float = 0.01,
    confidence: float = 0.95,
    for_reports: bool = False,
) -> Certified:
    """Certify the rate of false alarms from inspections of good parts, whatever their distribution.

    Args:
        recipe: recipe file.
        folders: finished inspections of different parts, none golden, judged by the recipe and its golden parts as
            they are now.
        false_alarms: largest rate that is wanted.
        confidence: one-sided.
        for_reports: store it next to the recipe: reports of later inspections print it.

    Raises:
        UsageError: no folder, a golden part, a part twice, or one that was judged by another recipe.
        CalibrationError, RecordError, RecipeError: a file.
    """
    path = Path(recipe)
    if not folders:
        raise UsageError("name the folders of finished inspections of good parts")
    kind, golden = kind_of(path), golden_path(path)
    rules = kind.read_recipe(path)
    known = collecting(kind, rules).read_reference(golden, rules)
    judged = _judged(
        [Path(one) for one in folders],
        set() if known is None else {one.serial for one in known.parts},
        [(file.name, sha256_of(file)) for file in (path, golden) if file.is_file()],
    )
    records = [one for one in judged if one.verdict != "INVALID"]
    found = certificate(
        [one.verdict for one in records],
        [one.p_value for one in records],
        false_alarms,
        confidence,
        getattr(rules.decision, "alpha", None),
    )
    target = certificate_path(path) if for_reports else None
    if target is not None:
        serials = [one.serial for one in records]
        StoredCertificate.of(path, found, serials, f"{datetime.now(UTC):%Y-%m-%d}").write(target)
    return Certified(found, len(judged) - len(records), target)


def _judged(folders: Sequence[Path], golden: set[str], now: Sequence[tuple[str, str]]) -> list[Record]:
    """Inspections of different parts, none golden, by the files (name and SHA-256) that are in use now."""
    seen: dict[str, Path] = {}
    records = []
    for folder in folders:
        record = read_record(folder)
        if record.serial in golden:
            raise UsageError(
                f"{folder}: {record.serial} is a golden part: it made the rule and proves nothing about it"
            )
        if record.serial in seen:
            raise UsageError(
                f"{folder}: {record.serial} is the part of {seen[record.serial]}: name each part once"
            )
        seen[record.serial] = folder
        used = {one.sha256 for one in record.inputs}
        changed = next((name for name, digest in now if digest not in used), None)
        if changed is not None:
            raise UsageError(
                f"{folder}: was judged by another {changed} than the present one: inspect the part again"
            )
        records.append(record)
    return records
