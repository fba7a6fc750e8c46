"""A BRDF straight from readings: filtered over the four nearest ones in projected-deviation coordinates.

The projected deviation vector is the difference of the directions to the eye and to the mirror image of the light,
projected onto the surface (Löw et al. 2012; Tongbuasirilai et al. 2017). For an isotropic BRDF that is symmetric about
it, as Pranovich 2024 has it, sine of the inclination of the light and length of the vector remain: in-plane readings
then cover all directions.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.shading import UPWARD, Light
from anisoscope.sim.light.ink.shapes import Surface

NEIGHBOURS = 4
_NEAR = 0.05


@dataclass(frozen=True, eq=False)
class Measured:
    """In-plane readings at G places and W wavelengths.

    Attributes:
        theta_i_deg: (G,) inclination of the light.
        theta_o_deg: (G,) of the detector; θo = θi is the mirror direction, negative on the light's side.
        wavelengths_nm: (W,) rising.
        value: (G, W) BRDF in 1/sr.

    Raises:
        ModelError: shapes that do not fit, fewer than four places, or values that are not finite.
    """

    theta_i_deg: FloatArray
    theta_o_deg: FloatArray
    wavelengths_nm: FloatArray
    value: FloatArray

    def __post_init__(self) -> None:
        places = len(self.theta_i_deg)
        if places < NEIGHBOURS or self.value.shape != (len(self.theta_o_deg), len(self.wavelengths_nm)):
            raise ModelError(
                f"readings need {NEIGHBOURS} places or more and a value at each wavelength, found {places}"
            )
        if not np.all(np.isfinite(self.value)):
            raise ModelError("readings must be finite")

    @property
    def spacing(self) -> FloatArray:
        """(2,) median distance of neighbouring readings along both coordinates; 1 along a coordinate with one value."""
        light, length = self.coordinates.T
        steps = [np.diff(np.unique(light.round(6)))]
        steps.append(
            np.concatenate([np.diff(np.unique(length[light == one].round(6))) for one in np.unique(light)])
        )
        return np.array([float(np.median(step)) if step.size else 1.0 for step in steps])

    @property
    def coordinates(self) -> FloatArray:
        """(G, 2) sine of the light's inclination, and length of the projected deviation vector."""
        light, camera = np.sin(np.radians(self.theta_i_deg)), np.sin(np.radians(self.theta_o_deg))
        return np.stack([light, np.abs(camera - light)], axis=-1)


def deviation(normal: FloatArray, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
    """(…, 2) the coordinates of :class:`Measured` at (…, 3) unit normals for unit vectors (3,) to light and eye."""
    flat = [direction - (normal @ direction)[..., None] * normal for direction in (to_light, to_camera)]
    # the mirror image of the light lies at −(its part along the surface)
    return np.stack([np.linalg.norm(flat[0], axis=-1), np.linalg.norm(flat[0] + flat[1], axis=-1)], axis=-1)


def measured_picture(
    where: Surface, measured: Measured, lights: tuple[Light, ...]
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """(rows, cols, 3) linear sRGB of a surface whose BRDF is that of readings, eye along +z; and where it is measured.

    Both coordinates count in steps of the readings, so that the four nearest ones lie on all sides; each weighs
    1/(distance² + 0.05²). Beyond the readings the nearest ones go on: a pixel is measured where under each of the
    lights that reach it a reading lies within one step.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415 - loads in half a second

    spacing = measured.spacing
    tree = KDTree(measured.coordinates / spacing)
    result, known = np.zeros(where.normal.shape), np.ones(where.normal.shape[:2], dtype=bool)
    normal = where.normal.astype(np.float64)
    camera = np.array(UPWARD)
    for light in lights:
        toward = np.array(light.to_light) / np.linalg.norm(light.to_light)
        cos_i = normal @ toward
        lit = (cos_i > 0.0) & (normal @ camera > 0.0)
        distance, index = tree.query(deviation(normal[lit], toward, camera) / spacing, k=NEIGHBOURS)
        weight = 1.0 / (np.asarray(distance) ** 2 + _NEAR**2)
        weight /= weight.sum(axis=1, keepdims=True)
        colours = linear_srgb(measured.value @ xyz_weights(light.illuminant, measured.wavelengths_nm))
        colour = np.sum(weight[..., None] * colours[index], axis=1)
        result[lit] += light.irradiance * cos_i[lit, None] * colour
        known[lit] &= np.asarray(distance)[:, 0] <= 1.0
    return result, known
