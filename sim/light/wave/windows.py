"""What blurs a diffraction pattern: the source, the camera's aperture, roughness below the pixels.

Arrays of distances may be on a graphics card (`gpu`).

Every one of them multiplies the mutual coherence of two points of the surface, a distance (Δx, Δy) apart, by the
Fourier transform of its distribution over directions: sinc for a rectangle, 2·J₁(r)/r for a disc, a Gaussian for
slopes. Frequencies are ω = 2·h/λ in cycles per µm, with h = (l + v)/2; an angular extent Δa widens a line of the
spectrum to Δa/λ. Source: Levin et al. 2013, section 2.2; sinc(x) = sin πx / πx.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave.gpu import bessel_j1

TAIL = 4.5
"""Standard deviations after which a Gaussian counts as nothing: e⁻¹⁰."""


@dataclass(frozen=True, eq=False)
class Extent:
    """Angular extent of a source or of an aperture in direction cosines, uniform over its area or a Gaussian.

    Attributes:
        shape: "rect" (a square; of a profile, a line), "disc" or "gauss".
        size: full width, diameter or standard deviation in direction cosines, about radians; 0 is a point.
        axes: (2, 2) x and y components (columns) on the sample of two unit vectors (rows) across the axis of the
            beam; None takes the x and y axes themselves.

    Raises:
        ModelError: a size outside 0 to 2.
    """

    shape: Literal["rect", "disc", "gauss"] = "rect"
    size: float = 0.0
    axes: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.shape not in ("rect", "disc", "gauss"):
            raise ModelError(f"an angular extent is a rect, a disc or a gauss, not {self.shape!r}")
        if not 0.0 <= self.size <= 2.0:
            raise ModelError(f"an angular extent must be 0 to 2 in direction cosines, not {self.size:g}")

    def coherence(self, x_um: FloatArray, y_um: FloatArray, wavelength_um: float) -> FloatArray:
        """Degree of coherence of points (x, y) apart, 1 at no distance; shapes broadcast."""
        if self.size == 0.0:
            return np.ones_like(x_um + y_um)
        scale = self.size / wavelength_um
        if self.axes is None:
            u, v = scale * x_um, scale * y_um
        else:
            u, v = (scale * (axis[0] * x_um + axis[1] * y_um) for axis in self.axes)
        if self.shape == "rect":
            return np.sinc(u) * np.sinc(v)
        if self.shape == "gauss":
            return np.exp(-2.0 * np.pi**2 * (u**2 + v**2))
        r = np.pi * np.hypot(u, v)
        far = r > 1e-6
        return np.where(far, 2.0 * bessel_j1(np.where(far, r, 1.0)) / np.where(far, r, 1.0), 1.0)

    @property
    def reach(self) -> tuple[float, float]:
        """Half-widths along x and y in direction cosines."""
        axes = np.eye(2) if self.axes is None else self.axes
        width = np.abs(axes).sum(axis=0) if self.shape == "rect" else np.sqrt((axes**2).sum(axis=0))
        half = (TAIL if self.shape == "gauss" else 0.5) * self.size
        return half * float(width[0]), half * float(width[1])


POINT = Extent()


@dataclass(frozen=True, eq=False)
class Window:
    """Everything that blurs, together.

    Attributes:
        source: extent of the source.
        aperture: extent of the camera's aperture, a second blur of the same kind.
        slope_variance: (2, 2) covariance along x and y of slopes that the map does not show, or None. They are those
            of a surface rough against the wavelength: its spectrum has the shape of the distribution of its slopes.
    """

    source: Extent = POINT
    aperture: Extent = POINT
    slope_variance: FloatArray | None = None

    def coherence(self, x_um: FloatArray, y_um: FloatArray, wavelength_um: float, h_z: float) -> FloatArray:
        """Degree of coherence K of points (x, y) µm apart; shapes broadcast, K(0, 0) = 1."""
        found = self.source.coherence(x_um, y_um, wavelength_um)
        found = found * self.aperture.coherence(x_um, y_um, wavelength_um)
        if self.slope_variance is not None:
            c = self.slope_variance
            spread = c[0, 0] * x_um**2 + 2.0 * c[0, 1] * x_um * y_um + c[1, 1] * y_um**2
            found = found * np.exp(-0.5 * (4.0 * np.pi * h_z / wavelength_um) ** 2 * spread)
        return found

    def half_width(self, wavelength_um: float, h_z: float) -> tuple[float, float]:
        """(x, y) half width of the window in cycles per µm."""
        found = np.add(self.source.reach, self.aperture.reach) / wavelength_um
        if self.slope_variance is not None:
            sigma = np.sqrt(np.diag(self.slope_variance))
            found = found + TAIL * sigma * 2.0 * h_z / wavelength_um
        return float(found[0]), float(found[1])


def coherence_length_um(wavelength_um: float, extent: float) -> float:
    """Δc = λ/Δa in µm, infinite for a point source (Levin et al. 2013, section 2.2)."""
    return wavelength_um / extent if extent > 0.0 else float("inf")
