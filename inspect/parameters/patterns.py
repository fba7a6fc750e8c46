"""Ideal surfaces (`anisoscope.profiles.patterns`)."""

from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

Pattern = Literal["ridges", "v-grooves", "checkerboard", "flat", "staircase"]
MAX_POINTS = 100_000_000


@dataclass(frozen=True)
class Grid:
    """Field of a made map.

    Attributes:
        size_um: size (y, x) of the field in µm: SIZE or Y,X.
        pixel_um: pixel size in µm: SIZE or Y,X.

    Raises:
        UsageError: more points than `MAX_POINTS`.
    """

    size_um: tuple[float, float] = (1000.0, 1000.0)
    pixel_um: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        rows, cols = self.shape
        if rows * cols > MAX_POINTS:
            raise UsageError(
                f"--size and --pixel give {rows} × {cols} points; at most {MAX_POINTS // 10**6} million"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return round(self.size_um[0] / self.pixel_um[0]), round(self.size_um[1] / self.pixel_um[1])


@dataclass(frozen=True)
class Lines:
    """Place and direction of ridges, alone or on a checkerboard, and of V-grooves; shape of grooves.

    Attributes:
        lay_deg: direction of ridges or grooves in degrees, counter-clockwise from +y.
        phase: place of the first crest or groove as a share of the pitch.
        second_lay_deg: direction of the ridges in every second square of a checkerboard.
        square_um: side of a square of a checkerboard in µm.
        flank_deg: slope of both flanks of V-grooves in degrees.
        land_um: flat land between V-grooves in µm.
    """

    lay_deg: float = 0.0
    phase: float = 0.0
    second_lay_deg: float = -90.0
    square_um: float = 250.0
    flank_deg: float = 45.0
    land_um: float = 0.0


@dataclass(frozen=True)
class Stairs:
    """Staircases.

    Attributes:
        levels: number of levels, evenly spaced.
        step_height_nm: height between two levels in nm.
        passes_nm: depths of etch passes in nm, comma-separated: 2ⁿ levels instead of --levels.
        width_um: width of a step in µm, the least width if --random.
        random: rectangles of random width and level instead of stairs.
        spread: widths of --random exceed the least by up to this share.
    """

    levels: int = 2
    step_height_nm: float = 127.3
    passes_nm: tuple[float, ...] | None = None
    width_um: float = 2.0
    random: bool = False
    spread: float = 1.0


@dataclass(frozen=True)
class Rough:
    """Gaussian roughness added along z.

    Attributes:
        alpha_along: Beckmann roughness along the ridges or grooves (along +y where there are none).
        alpha_across: Beckmann roughness across the ridges or grooves.
        correlation_um: mean correlation length in µm.
    """

    alpha_along: float = 0.0
    alpha_across: float = 0.0
    correlation_um: float = 8.0


@dataclass(frozen=True)
class Injection:
    """Extent of a defect that is added to a height map.

    Attributes:
        severity: 0 (none) to 1 (gross).
        seed: seed of everything random.

    Raises:
        UsageError: a seed that is none.
    """

    severity: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise UsageError(f"--seed takes a whole number from 0, not {self.seed}")
