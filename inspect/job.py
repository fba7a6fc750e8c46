"""An inspection before the first picture: what is known, checked, and where it will be kept."""

import contextlib
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.errors import CalibrationError, RecordError, RigFileError, UsageError
from anisoscope.expectation import Expectation, expectation
from anisoscope.linear import WhiteReference
from anisoscope.recipe import Recipe, read_recipe
from anisoscope.record import InputFile, sha256_of
from anisoscope.registration import check_fixture
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.rigfile import RigFile, read_rig
from anisoscope.whitereference import read_reference

SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+#-]{0,63}")


@dataclass(frozen=True, eq=False)
class Job:
    """All that is known before the first picture.

    Attributes:
        serial: serial number of the part.
        recipe: what the part should look like and how it is judged.
        rig: the rig file.
        fixture: its markers.
        white: the white reference.
        expected: the prediction.
        inputs: names and hashes of the files, as they were read.
    """

    serial: str
    recipe: Recipe
    rig: RigFile
    fixture: Fixture
    white: WhiteReference
    expected: Expectation
    inputs: tuple[InputFile, ...]


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


def prepare(recipe_path: Path, rig_path: Path, serial: str) -> Job:
    """Read and check everything that an inspection needs; nothing moves and nothing is written.

    Raises:
        UsageError: the serial number.
        RecipeError, RigFileError, HeightMapError, CalibrationError: a file that is missing or wrong.
    """
    check_serial(serial)
    recipe, rig = read_recipe(recipe_path), read_rig(rig_path)
    white_path, fixture = _white_path(rig, rig_path), _fixture(rig, rig_path)
    white = read_reference(white_path)
    expected = expectation(recipe, rig.light.angle_deg)
    files = [recipe_path, rig_path, white_path]
    if recipe.surface.height_map is not None:
        files.append(recipe.surface.height_map)
    inputs = tuple(InputFile(name=path.name, sha256=sha256_of(path)) for path in files)
    return Job(serial, recipe, rig, fixture, white, expected, inputs)


def _white_path(rig: RigFile, path: Path) -> Path:
    if rig.calibration is None:
        raise CalibrationError(
            f"{path} names no flat, so that radiances have no scale: take one with `anisoscope calibrate flat` "
            "and name it under [calibration] flat"
        )
    return rig.calibration.flat


def _fixture(rig: RigFile, path: Path) -> Fixture:
    if rig.fixture is None:
        raise RigFileError(f"{path} describes no [fixture]: the turned pictures are aligned by its markers")
    check_fixture(rig.fixture)
    return rig.fixture


def make_folder(out: Path, serial: str) -> Path:
    """A new folder ``<serial>-<UTC time>`` below ``out``.

    Raises:
        RecordError: it cannot be made.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    base = f"{serial.replace(' ', '_').replace('#', '')}-{stamp}"
    try:
        out.mkdir(parents=True, exist_ok=True)
        for number in range(1000):
            folder = out / (base if number == 0 else f"{base}-{number}")
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder.resolve()
    except OSError as error:
        raise RecordError(f"cannot make an inspection folder in {out}: {error.strerror}") from error
    raise RecordError(f"{out} already holds a thousand inspections named {base}")


def remove_if_empty(folder: Path) -> None:
    """Leave no folder behind that holds nothing."""
    for path in (folder / "frames", folder):
        with contextlib.suppress(OSError):
            path.rmdir()
