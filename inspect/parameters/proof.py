"""Prints: separation into inks, films, and how a soft proof is looked at."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError

MOST_TURN_DEG = 1e6


@dataclass(frozen=True)
class ProofView:
    """How a page of a proof begins, and what its picture shows.

    Attributes:
        shape: Shape that is printed on.
        yaw_deg: Turn about the upright axis, degrees.
        pitch_deg: Tilt about the horizontal axis, degrees.
        azimuth_deg: Azimuth of the light, counter-clockwise from the right, degrees.
        elevation_deg: Elevation of the light above the picture, degrees.
        second: A second light, half as bright, from the right.
        ink_model: The ink model, or a standard one.
        process: Roughness by the printing process: brushed 0.19, binder-mixed 0.30 (assumed).
        match: Add what photographs show: highlight and scattering of the paper, light behind.

    Raises:
        UsageError: an angle outside its range.
    """

    shape: Literal["sphere", "cylinder", "plane", "mesh"] | None = None
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    azimuth_deg: float = 135.0
    elevation_deg: float = 45.0
    second: bool = True
    ink_model: Literal["goniochromatic", "schlick", "tio2"] = "goniochromatic"
    process: Literal["brushed", "binder-mixed"] | None = None
    match: bool = False

    def __post_init__(self) -> None:
        if not (abs(self.pitch_deg) <= 90.0 and abs(self.elevation_deg) <= 90.0):
            raise UsageError("pitch and elevation take degrees from -90 to 90")
        if not (abs(self.yaw_deg) < MOST_TURN_DEG and abs(self.azimuth_deg) < MOST_TURN_DEG):
            raise UsageError("yaw and azimuth take degrees up to a million")


@dataclass(frozen=True)
class Separating:
    """Separation of an image into inks.

    Attributes:
        method: How the dots are placed: void-and-cluster mask, or vector error diffusion.
        way: Coverages that meet the image's colours, or its linear R, G, B as coverages.
        angle_deg: Inclination of light and eye, on opposite sides, for which it is separated, in degrees.
        gain: Factor on the image's linear light; above 1 the bright parts are cut.
        substrate: Diffuse reflectance of the sheet between the inks.

    Raises:
        UsageError: a reflectance outside of 0 to 1.
    """

    method: Literal["mask", "diffusion"] = "mask"
    way: Literal["match", "channels"] = "match"
    angle_deg: float = 20.0
    gain: float = 1.0
    substrate: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.substrate <= 1.0:
            raise UsageError(f"--substrate takes a reflectance of 0 to 1, not {self.substrate:g}")


@dataclass(frozen=True)
class FilmSettings(Separating):
    """Dots of a print, and films for its screens.

    Attributes:
        illuminant: Illuminant for which the image is separated: d65, a, led-b3 …, or CSV wavelength_nm,power.
        width_mm: Width of the print in mm; else one dot a pixel.
        dpi: Dots per inch, written into the files.

    Raises:
        UsageError: a size that means nothing.
    """

    illuminant: str = "d65"
    width_mm: float | None = None
    dpi: float = 300.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1.0 <= self.dpi <= 20000.0:
            raise UsageError(f"--dpi takes 1 to 20000, not {self.dpi:g}")
        if self.width_mm is not None and not 0.0 < self.width_mm < math.inf:
            raise UsageError(f"--print-width takes millimetres above 0, not {self.width_mm:g}")


@dataclass(frozen=True)
class ProofSettings(Separating):
    """Print of a soft proof.

    Attributes:
        mesh: Mesh *.obj to print on.
        illuminants: Illuminants: names or CSV files; the first is that of the separation and the picture.
        dots: Dots across the print; 0: one a pixel of the image.
    """

    mesh: Path | None = None
    illuminants: tuple[str, ...] = ("d65", "a", "led-b1", "led-b3", "led-b5", "led-rgb1", "led-v1")
    dots: int = 768
