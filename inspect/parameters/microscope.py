"""Microscope camera that looks at a sample (`anisoscope.sim.light.micrograph`)."""

import math
from dataclasses import dataclass

from anisoscope.base.errors import ModelError


@dataclass(frozen=True)
class Lens:
    """An ideal lens.

    Attributes:
        na: numerical aperture at the sample; 0 leaves diffraction and defocus out.
        wavelength_um: wavelength of the light.
        defocus_um: distance of the sample from the plane in focus.

    Raises:
        ModelError: a value outside its range.
    """

    na: float = 0.1
    wavelength_um: float = 0.55
    defocus_um: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.na < 1.0:
            raise ModelError(f"the numerical aperture must be at least 0 and below 1, not {self.na:g}")
        if not 0.1 <= self.wavelength_um <= 20.0:
            raise ModelError(f"the wavelength must lie between 0.1 and 20 µm, not {self.wavelength_um:g} µm")
        if not math.isfinite(self.defocus_um):
            raise ModelError(f"the defocus must be a number of µm, not {self.defocus_um:g}")

    @property
    def cutoff_per_um(self) -> float:
        """Highest frequency that the lens transfers, 2·NA/λ."""
        return 2.0 * self.na / self.wavelength_um

    @property
    def disc_um(self) -> float:
        """Radius of the disc of confusion."""
        return abs(self.defocus_um) * math.tan(math.asin(self.na))


@dataclass(frozen=True)
class Microscope:
    """Lens, magnification and sensor of a microscope camera.

    Attributes:
        magnification: magnification onto the sensor; where it is left out, the sample fills the panel.
        sensor_pixel_um: pixel of the sensor in µm.
        na: numerical aperture at the sample; 0: no blur by the lens.
        wavelength_nm: wavelength of the light in nm.
        defocus_um: distance from the plane in focus in µm.

    Raises:
        ModelError: a value outside its range.
    """

    magnification: float | None = None
    sensor_pixel_um: float = 3.45
    na: float = 0.1
    wavelength_nm: float = 550.0
    defocus_um: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.sensor_pixel_um < math.inf:
            raise ModelError(
                f"the pixel of a sensor takes a positive number of µm, not {self.sensor_pixel_um:g}"
            )
        if self.magnification is not None and not 0.0 < self.magnification < math.inf:
            raise ModelError(f"the magnification takes a positive number, not {self.magnification:g}")
        _ = self.lens

    @property
    def lens(self) -> Lens:
        """The lens."""
        return Lens(self.na, self.wavelength_nm / 1000.0, self.defocus_um)
