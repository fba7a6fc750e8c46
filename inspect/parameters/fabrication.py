"""Light and fabrication of etched steps (`anisoscope.sim.design`)."""

import math
from dataclasses import dataclass

from anisoscope.base.errors import ModelError, UsageError


@dataclass(frozen=True)
class Fabrication:
    """Light that a design of etched steps is made for, and how it is etched.

    Attributes:
        wavelength_nm: wavelength that the design is made for, nm.
        coherence_um: coherence length of the source, λ/Δa, µm; 16 is a lamp of 1.8°.
        depths_nm: depth of every etch pass in nm, comma-separated; a quarter wave if not given.
        band_nm: wavelengths that --depths are for, LOW,HIGH in nm; --wavelength if not given.
        min_width_um: smallest feature, µm: 2 for optical lithography, less for electron beams.
        grid_um: grid that all edges lie on, µm.

    Raises:
        ModelError: a value outside its range, or features off the grid.
    """

    wavelength_nm: float = 500.0
    coherence_um: float = 16.0
    depths_nm: tuple[float, ...] | None = None
    band_nm: tuple[float, float] | None = None
    min_width_um: float = 2.0
    grid_um: float = 0.25

    def __post_init__(self) -> None:
        if not 100.0 <= self.wavelength_nm <= 20000.0:
            raise ModelError(f"a design takes 100 to 20000 nm, not {self.wavelength_nm:g} nm")
        if not 0.0 < self.coherence_um < math.inf:
            raise ModelError(
                f"the coherence length must be a positive length in µm, not {self.coherence_um:g}"
            )
        if not (0.0 < self.min_width_um < math.inf and 0.0 < self.grid_um < math.inf):
            raise ModelError(
                f"smallest feature and grid must be positive lengths in µm, not {self.min_width_um:g} and "
                f"{self.grid_um:g}"
            )
        if abs(self.min_width_um / self.grid_um - round(self.min_width_um / self.grid_um)) > 1e-6:
            raise ModelError(
                f"a smallest feature of {self.min_width_um:g} µm is not a whole number of grids of "
                f"{self.grid_um:g} µm (--grid)"
            )

    @property
    def passes_nm(self) -> tuple[float, ...]:
        """Depth of every etch pass."""
        return self.depths_nm or (self.wavelength_nm / 4.0,)

    @property
    def bandwidth_nm(self) -> tuple[float, float]:
        """Wavelengths that the depths are for."""
        return self.band_nm or (self.wavelength_nm, self.wavelength_nm)


@dataclass(frozen=True)
class HologramSearch:
    """Cells of the unit of a picture, its lamp and process, and its search.

    Attributes:
        cells: cells of the unit along each axis, 32 to 1024.
        coherence_um: coherence length of the source, µm; half of the unit's side if not given: 128 is 0.25°.
        reach: largest ``|h_x|`` and ``|h_y|`` of the picture.
        blur_um: standard deviation by which the process blurs the heights of the cells, µm; 0: sharp steps.
        displayed: in colour by least squares of what a display shows, in place of ΔE2000 and SSIM.
        search_steps: steps of the search by gradients.
        over_etch_percent: error of all depths to judge as well, −20 to 20 %.
        seed: seed of start and wavelengths.

    Raises:
        ModelError: a value outside its range.
    """

    cells: int = 512
    coherence_um: float | None = None
    reach: float = 0.06
    blur_um: float = 0.0
    displayed: bool = False
    search_steps: int = 400
    over_etch_percent: float = 2.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 32 <= self.cells <= 1024:
            raise ModelError(f"--cells takes 32 to 1024, not {self.cells}")
        if not -20.0 <= self.over_etch_percent <= 20.0:
            raise ModelError(f"--over-etch takes −20 to 20 %, not {self.over_etch_percent:g}")
        if not 0.0 <= self.blur_um < math.inf:
            raise ModelError(f"--blur takes a length in µm, 0 for sharp steps, not {self.blur_um:g}")


@dataclass(frozen=True)
class WantedPicture:
    """Picture over directions, and its light.

    Attributes:
        picture_light: light of a picture in colour: d65, a, led-b3 … or CSV; else grey.
        line_width_nm: full width of the three lines at half of their height, nm.
        picture_points: directions of the picture along each axis.

    Raises:
        UsageError: another number of directions.
    """

    picture_light: str | None = None
    line_width_nm: float = 10.0
    picture_points: int = 40

    def __post_init__(self) -> None:
        if not 16 <= self.picture_points <= 256:
            raise UsageError(f"--picture-points takes 16 to 256, not {self.picture_points}")
