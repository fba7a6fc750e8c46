"""An inspection before the first picture: what is known and checked."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from anisoscope.base.errors import RecordError, RigFileError, UsageError
from anisoscope.base.signature import signer_in_use
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.record import Kind, record_path
from anisoscope.calibration.white_reference import read_reference
from anisoscope.decision.certificate import CERTIFICATE, valid_certificate
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.reference_parts import AnyReferenceSet, golden_path, write_golden
from anisoscope.imaging.linearisation import WhiteReference
from anisoscope.imaging.registration.placement import check_fixture
from anisoscope.imaging.views import Viewing
from anisoscope.inspection.folder import INPUTS
from anisoscope.kinds.kind import AnyKind
from anisoscope.kinds.parts import Reference, References, reference_on
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.base import RecipeBase, check_region
from anisoscope.recipe.logo import LOGO
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import Record, read_record, sha256_of
from anisoscope.record.verdict import Verdict
from anisoscope.report.peers import LotMate
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.rigfile import CalibrationPart, RigFile, read_rig

LONGEST_SERIAL = 64
LOT = "parts of the lot"
LOT_NAME = "lot.json"
"""Role and name of the file with the other parts of the lot of a part."""
MOST_OF_LOT = 12
"""Number of parts of a lot with which a part is compared, the latest ones."""
Role = str
"""What a file is to an inspection, such as "recipe", "height map" or "flat record"; kinds of parts have their own."""


@dataclass(frozen=True)
class Source:
    """A file that an inspection starts from, and its hash when it was read."""

    role: Role
    path: Path
    sha256: str


@dataclass(frozen=True, eq=False)
class Job:
    """All that is read before the first picture.

    Attributes:
        serial: serial number of the part.
        kind: which kind of part it is.
        recipe: what the part should look like and how it is judged.
        rig: the rig file.
        fixture: its markers; None where the pictures are aligned by their edges.
        white: the white reference.
        sources: the files, as they were read.
        reference: parts that are known to be good, or None.
        calibrations: those of the rig that have records.
    """

    serial: str
    kind: AnyKind
    recipe: RecipeBase
    rig: RigFile
    fixture: Fixture | None
    white: WhiteReference
    sources: tuple[Source, ...]
    reference: Reference | None = None
    calibrations: Calibrations = field(default_factory=Calibrations)

    @property
    def surface_recipe(self) -> SurfaceRecipe:
        """The recipe of a part with a surface.

        Raises:
            UsageError: it is that of a part without one.
        """
        if not isinstance(self.recipe, SurfaceRecipe):
            raise UsageError(f"{self.recipe.product}: this works with recipes of surfaces only")
        return self.recipe

    def viewing(self) -> Viewing:
        """By what its frames become views."""
        pixel_um, guides = self.rig.camera.pixel_um, self.kind.guides
        return Viewing(self.white, self.calibrations, self.fixture, pixel_um, self.recipe, guides)

    def lot_parts(self, lot: str | None, mates: Sequence[LotMate]) -> AnyReferenceSet | None:
        """The other parts of the lot of the part; None where it is not compared with them.

        Args:
            lot: name of the lot; None where it is not known.
            mates: inspections of the lot, the oldest first.
        """
        kind, recipe = self.kind, self.recipe
        if lot is None or not (isinstance(kind, References) and kind.compares_with_lot(recipe)):
            return None
        serve = (mate for mate in mates if mate.folder and mate.verdict != Verdict.INVALID.value)
        last = {mate.serial: mate for mate in serve if mate.serial != self.serial}
        folders = [Path(mate.folder) for mate in list(last.values())[-MOST_OF_LOT:]]
        equipment = Equipment.of_rig(self.rig, self.white.camera)
        seen = kind.conditions_on(recipe, self.rig, self.white.filters)
        return kind.reference_set.of_lot(recipe, lot, equipment, seen, _records(folders))

    def of_lot(self, lot: str | None, mates: Sequence[LotMate], folder: Path) -> Self:
        """The job with the other parts of a lot as reference, if it has none; they are written into the folder.

        Args:
            lot: name of the lot, or None.
            mates: inspections of the lot, the oldest first.
            folder: the inspection folder.

        Raises:
            RecordError: the folder cannot be written.
        """
        found = None if self.reference is not None else self.lot_parts(lot, mates)
        if found is None:
            return self
        path = folder / INPUTS / LOT_NAME
        path.parent.mkdir(exist_ok=True)
        write_golden(path, found)
        source = Source(LOT, path, sha256_of(path))
        return replace(self, reference=found, sources=(*self.sources, source))

    def plan(self, place_mm: tuple[float, float] | None = None) -> Plan:
        """Acquisition plan of a part, with its place (x, y) on the plate in mm from the stage's axis.

        Raises:
            CalibrationError: the place is beyond the focus map of the rig.
        """
        acquisition = self.recipe.acquisition
        return Plan(
            poses=tuple(Pose(pose.stage_deg, pose.tilt_deg) for pose in self.recipe.poses.poses()),
            exposure_s=acquisition.exposure_s,
            gain=acquisition.gain,
            frames_per_pose=acquisition.frames_per_pose,
            dark_frames=acquisition.dark_frames,
            settle_s=acquisition.settle_s,
            brackets=acquisition.brackets,
            seat=self.calibrations.seat(place_mm),
        )


def _records(folders: Sequence[Path]) -> Iterator[Record]:
    """Records of inspections, each read at its turn."""
    for folder in folders:
        with contextlib.suppress(RecordError):  # an archived or damaged folder: the others serve
            yield read_record(folder)


def check_serial(serial: str) -> str:
    """A serial number that can be shown, searched and typed: letters of any script, and signs between them.

    Raises:
        UsageError: it is too long, begins with a sign, ends with a blank, or holds what cannot be printed.
    """
    if (
        not 1 <= len(serial) <= LONGEST_SERIAL
        or not serial[0].isalnum()
        or not serial.isprintable()
        or serial != serial.strip()
    ):
        raise UsageError(
            f"the serial number {serial[:LONGEST_SERIAL]!r} cannot be used: give 1 to {LONGEST_SERIAL} letters, "
            "digits, signs or blanks, beginning with a letter or a digit"
        )
    return serial


def prepare(
    recipe_path: Path,
    rig_path: Path,
    serial: str,
    *,
    without: Kind | None = None,
    channel: str | None = None,
) -> Job:
    """Read and check everything that an inspection needs; nothing moves and nothing is written.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number of the part.
        without: a calibration that is not looked at, because it is about to be taken.
        channel: light channel in place of that of the recipe.

    Raises:
        UsageError: the serial number.
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file that is missing or wrong.
        ConfigError: the signing key cannot be used.
    """
    check_serial(serial)
    signer_in_use()  # a key that is missing shows before anything moves
    kind = kind_of(recipe_path)
    recipe = kind.read_recipe(recipe_path)
    rig = read_rig(rig_path, channel=channel or recipe.acquisition.light_channel)
    rig = rig if rig.light.channel else rig.in_channel(None)  # one of several must be chosen
    white_path, fixture = flat_of(rig, rig_path), fixture_of(rig, rig_path)
    assert rig.calibration is not None
    check_calibration_files(rig_path, rig.calibration, without)
    followed = rig.x is not None and rig.y is not None
    calibrations = replace(read_calibrations(rig.calibration, without), followed=followed)
    calibrations.check_light(rig.light)
    white = read_reference(white_path)
    kind.check_filters(white.filters, f"camera {white.camera} of the flat", white.filters)
    sources = (
        *sources_of(recipe_path, rig_path, kind, recipe, rig),
        Source("white reference", white_path, white.sha256),
        *sources_of_calibrations(calibrations),
    )
    reference, white = (
        reference_on(kind, recipe_path, recipe, rig, white.camera),
        calibrations.white(white),
    )
    return Job(serial, kind, recipe, rig, fixture, white, sources, reference, calibrations)


def sources_of_calibrations(calibrations: Calibrations) -> tuple[Source, ...]:
    """The files of calibrations with their hashes."""
    return tuple(Source(role, path, sha256_of(path)) for role, path in calibrations.files.items())


def sources_of(
    recipe_path: Path, rig_path: Path, kind: AnyKind, recipe: RecipeBase, rig: RigFile
) -> tuple[Source, ...]:
    """Recipe, rig file and what they name, such as height map, inks and golden parts; with their hashes.

    Raises:
        HeightMapError: the height map is missing.
        CalibrationError: the certificate of false alarms is damaged.
        RecipeError: light or camera would stand below the part's horizon, or the region covers a marker.
        RigFileError: the rig file lacks what the kind needs, or has another lamp than the recipe.
    """
    kind.check(recipe, rig, recipe_path, rig_path)
    check_region(recipe, rig.fixture, recipe_path)
    files: list[tuple[Role, Path]] = [("recipe", recipe_path), ("rig", rig_path)]
    files += [*kind.sources(recipe, rig).items(), *_golden_files(recipe_path)]
    files += [] if recipe.report.logo is None else [(LOGO, recipe.report.logo)]
    return tuple(Source(role, path, sha256_of(path)) for role, path in files)


def _golden_files(recipe_path: Path) -> list[tuple[Role, Path]]:
    path, certificate = golden_path(recipe_path), valid_certificate(recipe_path)
    files: list[tuple[Role, Path]] = [("golden parts", path)] if path.is_file() else []
    return files if certificate is None else [*files, (CERTIFICATE, certificate)]


def check_calibration_files(path: Path, part: CalibrationPart, without: Kind | None = None) -> None:
    """Refuse a rig file whose calibrations are not where it says, as after it was moved alone.

    Args:
        path: the rig file.
        part: its table ``calibration``.
        without: a calibration that is not looked at.

    Raises:
        RigFileError: names all files that are missing.
    """
    named = {name: file for name, file in part if file is not None and name != without}
    missing = [name for name, file in named.items() if not (file.exists() or record_path(file).exists())]
    if missing:
        listed = ", ".join(f"{name} = {named[name]}" for name in missing)
        raise RigFileError(
            f"{path}: [calibration] names files that do not exist: {listed}; paths count from the folder of the rig "
            f"file: move them with it, or take them again (anisoscope calibrate {missing[0]})"
        )


def flat_of(rig: RigFile, path: Path) -> Path:
    """The file of the rig's white reference.

    Raises:
        RigFileError: the rig file names none.
    """
    if rig.calibration is None:
        raise RigFileError(
            f"{path} names no flat, so that radiances have no scale: take one with `anisoscope calibrate flat` "
            "and name it under [calibration] flat"
        )
    return rig.calibration.flat


def fixture_of(rig: RigFile, path: Path) -> Fixture | None:
    """The fixture of a rig, with which pictures can be aligned; without one, edges have to do.

    Raises:
        RigFileError: it is not fit for this.
    """
    if rig.fixture is None:
        return None
    try:
        check_fixture(rig.fixture)
    except RigFileError as error:
        raise RigFileError(f"{path}: {error}") from None
    return rig.fixture
