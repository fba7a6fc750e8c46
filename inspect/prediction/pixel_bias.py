"""How far a coarsely sampled map of ideal ridges is off its design, against the uncertainty stated for it."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.prediction.height_map_uncertainty import pixel_bias
from anisoscope.profiles.ideal import RidgeDesign, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import Convention, Pose, directions
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

_RIDGES, _ROWS = 20, 3
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class PixelBias:
    """Bias of the relief predictor over pixel size.

    Attributes:
        design: the ridges.
        pixel_um: (N,) pixel sizes.
        bias: (N, F, P) ln of relief over corrected radiance, for F places of the pixels against the crests and
            P poses.
        u: (N,) relative standard uncertainty that is stated for it.
    """

    design: RidgeDesign
    pixel_um: FloatArray
    bias: FloatArray
    u: FloatArray

    @property
    def rms(self) -> FloatArray:
        """(N,) root mean square of the bias over places and poses."""
        return np.asarray(np.sqrt(np.mean(self.bias**2, axis=(1, 2))))

    @property
    def within(self) -> FloatArray:
        """(N,) share of places and poses whose bias lies within 2 u."""
        return np.asarray(np.mean(np.abs(self.bias) <= 2.0 * self.u[:, None, None], axis=(1, 2)))


def find_pixel_bias(
    design: RidgeDesign,
    pixel_um: FloatArray,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    places: int = 21,
) -> PixelBias:
    """Sample ideal ridges at many pixel sizes, and compare their prediction with that of the design.

    Args:
        design: the ridges; twenty of them are sampled.
        pixel_um: (N,) pixel sizes.
        material: the plastic.
        poses: P poses, all of them lit.
        convention: how the angles are counted.
        places: F, places of the first crest within a pitch, evenly spread by the golden ratio.
    """
    seen = directions(poses, convention)
    ideal = corrected.radiance(*seen, design, material)
    bias = np.empty((len(pixel_um), places, len(poses)))
    u = np.empty(len(pixel_um))
    for number, pixel in enumerate(pixel_um):
        cols = int(np.ceil(_RIDGES * design.pitch_um / pixel - 1e-9)) + 1
        for place in range(places):
            surface = ridges(design, (_ROWS, cols), (1.0, float(pixel)), (place * _GOLDEN) % 1.0)
            found = relief_radiance(Relief(surface, design.pitch_um), *seen, material)
            bias[number, place] = np.log(found / ideal)
        u[number] = pixel_bias(float(pixel), design.pitch_um, np.ones(1)).absolute[0]
    return PixelBias(design, np.asarray(pixel_um, dtype=np.float64), bias, u)
