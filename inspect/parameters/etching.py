"""Searches for etched dots, patterns and pictures, and photographs of their lobes (`anisoscope.operations.design`)."""

import math
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

GDS = (".gds", ".gds2", ".gdsii")
"""Extensions of mask files."""
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
class LobeShape:
    """Gaussian lobe that a mixture of step widths comes closest to.

    Attributes:
        sigma: σ of the Gaussian lobe along x, in half vectors h.
        sigma_y: σ along y; as along x if not given.
        max_width_um: widest step, µm.
        nearest: take the nearest lobe if the wanted one is out of reach.
    """

    sigma: float
    sigma_y: float | None = None
    max_width_um: float = 20.0
    nearest: bool = False


@dataclass(frozen=True)
class StepBlocks:
    """Steps of a surface without a mirror direction.

    Attributes:
        arrangement: steps in a block, M or MX,MY.
        width_um: width of a step, A or AX,AY in µm.
        crossed: a sequence along each axis instead of blocks: the hole is a cross.

    Raises:
        UsageError: other than one or two numbers, or parts of steps.
    """

    arrangement: tuple[float, ...] = (2, 2)
    width_um: tuple[float, ...] = (2.0,)
    crossed: bool = False

    def __post_init__(self) -> None:
        many = self.arrangement
        if not {len(many), len(self.width_um)} <= {1, 2} or any(m != int(m) for m in many):
            raise UsageError("--arrangement takes one or two whole numbers, --width one or two numbers of µm")


@dataclass(frozen=True)
class DepthSearch:
    """Search of depths whose levels have a zero mean phase.

    Attributes:
        levels: levels K: 2, 4, 8, … from log₂ K etch passes.
        h_z: z component of the half vector; 1 where light and camera stand above.
        width_um: width of the steps for the spike, µm.
        seed: seed of the global search.

    Raises:
        UsageError: a width or seed that is none.
    """

    levels: int = 4
    h_z: float = 1.0
    width_um: float = 2.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.width_um > 0.0:
            raise UsageError(f"--width must be a positive number of µm, not {self.width_um:g}")
        check_seed(self.seed)


@dataclass(frozen=True)
class EtchedHeights:
    """Part of a design, a layout or a GDSII file that becomes a height map.

    Attributes:
        corner_um: lower left corner X,Y of the window, µm.
        window_size_um: size W,H of the window, µm; all if not given.
        dots: dots along each side, of a design *.toml.
        dot_um: side of a dot, µm, of a design *.toml.
        seed: seed, of a design *.toml.
        depths_nm: depth of every pass in nm, of a GDSII that does not say.
        pixel_um: pixel size in µm, of a GDSII.

    Raises:
        UsageError: a window, seed or pixel that is none.
    """

    corner_um: tuple[float, ...] = (0.0, 0.0)
    window_size_um: tuple[float, ...] | None = None
    dots: int = 4
    dot_um: float = 112.0
    seed: int = 0
    depths_nm: tuple[float, ...] | None = None
    pixel_um: float | None = None

    def __post_init__(self) -> None:
        check_seed(self.seed)
        extent = self.window_size_um
        if len(self.corner_um) != 2 or (
            extent is not None and (len(extent) not in (1, 2) or min(extent) <= 0.0)
        ):
            raise UsageError("--corner takes X,Y in µm, --window-size one or two positive numbers of µm")
        if self.pixel_um is not None and not self.pixel_um > 0.0:
            raise UsageError(f"--pixel must be positive, not {self.pixel_um:g} µm")

    @property
    def corner_yx_um(self) -> tuple[float, float]:
        """The corner, rows first, as windows of a layout count."""
        return self.corner_um[1], self.corner_um[0]

    @property
    def window_yx_um(self) -> tuple[float, float] | None:
        """The size, rows first."""
        return None if self.window_size_um is None else (self.window_size_um[-1], self.window_size_um[0])


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
