"""The rig file: which devices stand on the rig, where, and how they are oriented. TOML, schema 1."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from anisoscope.errors import RigFileError
from anisoscope.rig.fixture import Fixture
from anisoscope.tomlfile import LocalPath, Part, Positive, read_toml_model

Option = str | int | float | bool


class StagePart(Part):
    """The rotation stage.

    Attributes:
        driver: name of the driver.
        port: COM port, device path, ``socket://host:port`` or ``sim://…``.
        zero_deg: stage reading at which the sample stands at 0°.
        turns: sense in which a growing reading turns the sample, seen from the camera.
        approach_deg: every reading is approached from this far below, because of backlash.
        options: further options of the driver.
    """

    driver: str
    port: Annotated[str, Field(min_length=1)]
    zero_deg: float = 0.0
    turns: Literal["ccw", "cw"] = "ccw"
    approach_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 2.0
    options: dict[str, Option] = Field(default_factory=dict)

    def reading_deg(self, angle_deg: float) -> float:
        """Stage reading at which the sample stands at an angle; both in degrees."""
        return self.zero_deg + (angle_deg if self.turns == "ccw" else -angle_deg)

    def angle_deg(self, reading_deg: float) -> float:
        """Sample angle at a stage reading; both in degrees."""
        return reading_deg - self.zero_deg if self.turns == "ccw" else self.zero_deg - reading_deg


class CameraPart(Part):
    """The camera; `pixel_um` is the size of one of its pixels on the sample."""

    driver: str
    pixel_um: Positive
    options: dict[str, Option] = Field(default_factory=dict)


class LightPart(Part):
    """The light; `angle_deg` is the angle between light and camera, seen from the sample."""

    driver: str = "manual"
    angle_deg: float = 10.0
    options: dict[str, Option] = Field(default_factory=dict)


class GeometryPart(Part):
    """How the camera arm stands: `tilt_deg` from the normal of the stage, fixed."""

    tilt_deg: Annotated[float, Field(gt=-90.0, lt=90.0)] = 0.0


class CalibrationPart(Part):
    """Where the white reference is: the file that ``calibrate flat`` wrote."""

    flat: LocalPath


class RigFile(Part):
    """A rig, as its file describes it."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    stage: StagePart
    camera: CameraPart
    light: LightPart
    geometry: GeometryPart = GeometryPart()
    fixture: Fixture | None = None
    calibration: CalibrationPart | None = None


def read_rig(path: Path) -> RigFile:
    """Read a rig file; ``${here}`` in it stands for its own folder.

    Raises:
        RigFileError: the file is missing or wrong; the message names the key.
    """
    here = str(path.resolve().parent)
    return read_toml_model(path, RigFile, error=RigFileError, substitutions={"here": here})
