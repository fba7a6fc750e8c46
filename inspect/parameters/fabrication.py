"""Light and fabrication of etched steps (`anisoscope.sim.design`)."""

import math
from dataclasses import dataclass

from anisoscope.base.errors import ModelError


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
