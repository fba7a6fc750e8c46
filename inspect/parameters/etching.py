"""Searches for etched dots, patterns and pictures, and photographs of their lobes (`anisoscope.operations.design`)."""

import math
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

MARKS = "COL,ROW=X,Y of four marks, ;-separated"


def check_seed(seed: int) -> None:
    """Refuse a seed that is none.

    Raises:
        UsageError: below 0.
    """
    if seed < 0:
        raise UsageError(f"--seed must be 0 or a positive whole number, not {seed}")


def _check_dot(dot_um: float) -> None:
    if dot_um <= 0.0 or dot_um == math.inf:
        raise UsageError(f"--dot must be a positive length in µm, not {dot_um:g}")


@dataclass(frozen=True)
class DotSearch:
    """Search of a dot whose own reflectance is closest to the expected one.

    Attributes:
        dot_um: side of a dot, µm; 112 are 227 dpi.
        seconds: time to search, 30 unless --generations is given; Ctrl-C ends it earlier and keeps the best.
        generations: end after so many generations: repeatable.
        good: end at this relative error.
        method: genetic search with polish, or one of them alone.
        population: dots that the genetic search keeps.
        seed: seed of everything random.

    Raises:
        UsageError: a dot or seed that is none.
    """

    dot_um: float = 112.0
    seconds: float | None = None
    generations: int | None = None
    good: float | None = None
    method: Literal["both", "genetic", "polish"] = "both"
    population: int = 6
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        _check_dot(self.dot_um)


@dataclass(frozen=True)
class PatternOptions:
    """Dots of a picture.

    Attributes:
        dot_um: side of a dot, µm; 112 are 227 dpi; taken to whole steps of the grid.
        tiles: number of different tiles per reflectance, against periodic artefacts.
        refine_s: seconds to refine every tile of a lobe; 0 leaves them random.
        dither: mix designs where the picture has values between theirs.
        seed: seed of everything random.

    Raises:
        UsageError: a dot or seed that is none.
    """

    dot_um: float = 112.0
    tiles: int = 4
    refine_s: float = 0.0
    dither: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        _check_dot(self.dot_um)


@dataclass(frozen=True)
class StepMixture:
    """Mixture of step structures that comes closest to targets.

    Attributes:
        weights: weight of every target in their sum, comma-separated; 1 if not given.
        reach: largest |h_x| and |h_y| of a target.
        etch_passes: passes of a quarter wave and its halves: 1 to 4; their levels have a zero mean phase.
        max_width_um: widest step, µm.
        nearest: take the nearest reflectance if the wanted one is out of reach.

    Raises:
        UsageError: another number of passes.
    """

    weights: tuple[float, ...] | None = None
    reach: float = 0.2
    etch_passes: int = 1
    max_width_um: float = 20.0
    nearest: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.etch_passes <= 4:
            raise UsageError(f"--etch-passes takes 1 to 4, not {self.etch_passes}")


@dataclass(frozen=True)
class LobePhoto:
    """Photograph of the screen that a lobe falls on: lamp, sample, screen and camera.

    Attributes:
        wavelength_nm: wavelength of the lamp, nm.
        distance_mm: from the sample to where the mirrored beam meets the screen, mm.
        light: direction of the light: inclination and azimuth, degrees.
        screen_tilt: turns of the screen about its x and y axes, degrees; 0,0 faces the beam.
        marks: COL,ROW=X,Y of four marks, ;-separated: pixels, and mm on the screen from the mirrored beam.
        pixel_mm: instead of marks: mm on the screen of a pixel; seen straight on.
        center: with --pixel-mm: COL,ROW of the mirrored beam; the middle if not given.
        from_behind: with --pixel-mm: the camera looks at the back of the screen.
        background: grey value without the lamp.
        tone: greys of the photograph: proportional to light, or sRGB of a camera for people.
        lamp_half_angle_deg: half of the angle subtended by a round lamp, degrees; the design's source if not given.
        reach: largest |h_x| and |h_y|, from the mirrored beam.
        points: directions along each axis, 16 to 256.

    Raises:
        UsageError: a number outside its range, or neither marks nor a scale.
    """

    wavelength_nm: float
    distance_mm: float
    light: tuple[float, float] = (0.0, 0.0)
    screen_tilt: tuple[float, float] = (0.0, 0.0)
    marks: str | None = None
    pixel_mm: float | None = None
    center: tuple[float, float] | None = None
    from_behind: bool = False
    background: float = 0.0
    tone: Literal["linear", "srgb"] = "linear"
    lamp_half_angle_deg: float | None = None
    reach: float = 0.12
    points: int = 64

    def __post_init__(self) -> None:
        if not 16 <= self.points <= 256 or not 100.0 <= self.wavelength_nm <= 20000.0:
            raise UsageError("--points takes 16 to 256, --wavelength 100 to 20000 nm")
        if (self.marks is None) == (self.pixel_mm is None):
            raise UsageError(f"give either --marks ({MARKS}), or --pixel-mm")
        if self.lamp_half_angle_deg is not None and not 0.0 < self.lamp_half_angle_deg <= 10.0:
            raise UsageError(f"--lamp-half-angle takes above 0 to 10°, not {self.lamp_half_angle_deg:g}°")
        if self.pixel_mm is not None and not 0.0 < self.pixel_mm < math.inf:
            raise UsageError(f"--pixel-mm must be a positive length, not {self.pixel_mm}")
