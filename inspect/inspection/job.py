"""An inspection before the first picture: what is known and checked."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

from anisoscope.base.errors import CalibrationError, HeightMapError, RigFileError, UsageError
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.record import Kind
from anisoscope.calibration.white_reference import read_reference
from anisoscope.decision.reference_parts import GoldenSet, golden_path, read_golden
from anisoscope.imaging.linearisation import WhiteReference
from anisoscope.imaging.registration.placement import check_fixture
from anisoscope.imaging.views import Guide, Viewing
from anisoscope.inspection.recipe_file import read_any_recipe
from anisoscope.inspection.surface_kind import SurfaceKind, surface_kind
from anisoscope.kinds.prints.lighting import check_filters, check_print_rig, print_files
from anisoscope.kinds.prints.recipe import AnyRecipe, PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints, read_golden_prints
from anisoscope.recipe.poses import check_poses
from anisoscope.recipe.surface import SurfaceRecipe, check_lamp
from anisoscope.record.schema import sha256_of
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.rigfile import RigFile, read_rig

SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+#-]{0,63}")
Role = Literal[
    "recipe",
    "rig",
    "white reference",
    "height map",
    "frame table",
    "golden parts",
    "flat record",
    "dark record",
    "dark picture",
    "stray record",
    "stray picture",
    "linearity record",
    "rotation record",
    "check record",
    "ink",
    "wrong ink 1",
    "wrong ink 2",
    "wrong ink 3",
    "wrong ink 4",
    "lamp spectrum",
    "sensitivities",
]


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
        recipe: what the part should look like and how it is judged.
        rig: the rig file.
        fixture: its markers; None where the pictures are aligned by their edges.
        white: the white reference.
        sources: the files, as they were read.
        golden: parts that are known to be good, or None.
        calibrations: those of the rig that have records.
        golden_prints: prints that are known to be good, or None.
    """

    serial: str
    recipe: AnyRecipe
    rig: RigFile
    fixture: Fixture | None
    white: WhiteReference
    sources: tuple[Source, ...]
    golden: GoldenSet | None = None
    calibrations: Calibrations = field(default_factory=Calibrations)
    golden_prints: GoldenPrints | None = None

    @property
    def ridged(self) -> SurfaceRecipe:
        """The recipe of a part with a surface.

        Raises:
            UsageError: it is that of a print.
        """
        if isinstance(self.recipe, PrintRecipe):
            raise UsageError(
                f"{self.recipe.product}: this works with recipes of surfaces, not with those of prints"
            )
        return self.recipe

    def viewing(self, guides: tuple[Guide, ...] = ()) -> Viewing:
        """By what its frames become views; ``guides`` as of `anisoscope.imaging.views.Viewing`."""
        pixel_um = self.rig.camera.pixel_um
        return Viewing(self.white, self.calibrations, self.fixture, pixel_um, self.recipe, guides)

    @property
    def kind(self) -> SurfaceKind:
        """What is done in its own way for the recipe's kind of surface; errors as of `ridged`."""
        return surface_kind(self.ridged)

    def plan(self) -> Plan:
        """What is to be photographed."""
        acquisition = self.recipe.acquisition
        return Plan(
            poses=tuple(Pose(pose.stage_deg, pose.tilt_deg) for pose in self.recipe.poses.poses()),
            exposure_s=acquisition.exposure_s,
            gain=acquisition.gain,
            frames_per_pose=acquisition.frames_per_pose,
            dark_frames=acquisition.dark_frames,
            settle_s=acquisition.settle_s,
            brackets=acquisition.brackets,
        )


def check_serial(serial: str) -> str:
    """A serial number that can name a folder.

    Raises:
        UsageError: it holds anything but letters, digits, blanks and ``. _ + # -``, or begins with a blank or a sign.
    """
    if not SERIAL.fullmatch(serial) or serial != serial.strip():
        raise UsageError(
            f"the serial number {serial[:64]!r} cannot be used: 1 to 64 letters, digits, blanks or . _ + # -, "
            "beginning with a letter or a digit"
        )
    return serial


def prepare(recipe_path: Path, rig_path: Path, serial: str, *, without: Kind | None = None) -> Job:
    """Read and check everything that an inspection needs; nothing moves and nothing is written.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number of the part.
        without: a calibration that is not looked at, because it is about to be taken.

    Raises:
        UsageError: the serial number.
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file that is missing or wrong.
    """
    check_serial(serial)
    recipe, rig = read_any_recipe(recipe_path), read_rig(rig_path)
    white_path, fixture = flat_of(rig, rig_path), fixture_of(rig, rig_path)
    assert rig.calibration is not None
    calibrations = read_calibrations(rig.calibration, without)
    white = read_reference(white_path)
    if isinstance(recipe, PrintRecipe):
        check_filters(white.filters, f"camera {white.camera} of the flat", white.filters)
    sources = (
        *sources_of(recipe_path, rig_path, recipe, rig),
        Source("white reference", white_path, white.sha256),
        *sources_of_calibrations(calibrations),
    )
    golden, white = known_good(recipe_path, recipe), calibrations.white(white)
    prints = good_prints(recipe_path, recipe, rig)
    return Job(serial, recipe, rig, fixture, white, sources, golden, calibrations, prints)


def sources_of_calibrations(calibrations: Calibrations) -> tuple[Source, ...]:
    """The files of calibrations with their hashes."""
    return tuple(
        Source(cast("Role", role), path, sha256_of(path)) for role, path in calibrations.files.items()
    )


def sources_of(recipe_path: Path, rig_path: Path, recipe: AnyRecipe, rig: RigFile) -> tuple[Source, ...]:
    """Recipe, rig file and what they name: height map and golden parts, or inks and spectra; with their hashes.

    Raises:
        HeightMapError: the height map is missing.
        RecipeError: light or camera would stand below the part's horizon.
        RigFileError: the rig file lacks what a print needs, or has another lamp than the recipe.
    """
    files: list[tuple[Role, Path]] = [("recipe", recipe_path), ("rig", rig_path)]
    if isinstance(recipe, PrintRecipe):
        check_print_rig(rig, rig_path)
        files += [(cast("Role", role), path) for role, path in print_files(recipe, rig).items()]
        files += _golden_file(recipe_path)
        return tuple(Source(role, path, sha256_of(path)) for role, path in files)
    check_lamp(recipe, rig, rig_path)
    check_poses(recipe.poses, rig.light.angle_deg, recipe_path)
    if recipe.surface.height_map is not None:
        files.append(("height map", check_map(recipe.surface.height_map)))
    files += _golden_file(recipe_path)
    return tuple(Source(role, path, sha256_of(path)) for role, path in files)


def _golden_file(recipe_path: Path) -> list[tuple[Role, Path]]:
    path = golden_path(recipe_path)
    return [("golden parts", path)] if path.is_file() else []


def known_good(recipe_path: Path, recipe: AnyRecipe) -> GoldenSet | None:
    """The golden parts beside a recipe, or None; those of a print are of another kind (`good_prints`).

    Raises:
        CalibrationError: their file is damaged, or belongs to another recipe.
    """
    return None if isinstance(recipe, PrintRecipe) else read_golden(golden_path(recipe_path), recipe)


def good_prints(recipe_path: Path, recipe: AnyRecipe, rig: RigFile) -> GoldenPrints | None:
    """The golden prints beside the recipe of a print, or None.

    Raises:
        CalibrationError: their file is damaged, or belongs to another recipe, lamp or camera.
    """
    if not isinstance(recipe, PrintRecipe):
        return None
    return read_golden_prints(golden_path(recipe_path), recipe, rig)


def check_map(path: Path) -> Path:
    """The file of a height map, which is there.

    Raises:
        HeightMapError: it is not.
    """
    if not path.is_file():
        raise HeightMapError(f"{path}: there is no such file")
    return path


def flat_of(rig: RigFile, path: Path) -> Path:
    """The file of the rig's white reference.

    Raises:
        CalibrationError: the rig file names none.
    """
    if rig.calibration is None:
        raise CalibrationError(
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
