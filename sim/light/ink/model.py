"""The BRDF of an ink: the goniochromatic model of Pranovich 2024, and the standard ones it is compared with.

* "goniochromatic": Eq. 5, D/4 · ρ · exp(c·(1 − cos((θi + θo)/2))). Reciprocal; it does not conserve energy.
* "schlick": Torrance-Sparrow (Eq. 2) with Schlick's Fresnel term (Schlick 1994), ρ at normal incidence.
* "tio2": Torrance-Sparrow with the Fresnel reflectance of TiO2, times ρ.

Eq. 7 of the paper is Eq. 5 in the mirror direction. It says ω_i = ω_o there, which would be the direction back to the
light: Eq. 5 is 17 to 526 times smaller there at 20° to 65° for α = 0.19.
"""

from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink import tio2
from anisoscope.sim.light.ink.angles import goniometer, half_vector, shift
from anisoscope.sim.light.ink.distributions import density, masking
from anisoscope.sim.light.ink.ink import Ink

Model = Literal["goniochromatic", "schlick", "tio2"]
MODELS: tuple[Model, ...] = ("goniochromatic", "schlick", "tio2")


def brdf(
    ink: Ink,
    to_light: FloatArray,
    to_camera: FloatArray,
    model: Model = "goniochromatic",
    *,
    tio2_source: str = tio2.DEFAULT,
) -> FloatArray:
    """(…, W) BRDF in 1/sr at (…, 3) unit vectors in the frame of the surface; 0 where one lies below it.

    Raises:
        ModelError: no such model or TiO2 data set, or wavelengths for which its index is not known.
    """
    value, argument = lobe(ink, to_light, to_camera, model)
    return np.asarray(value[..., None] * spectral_term(ink, argument, model, tio2_source=tio2_source))


def lobe(
    ink: Ink, to_light: FloatArray, to_camera: FloatArray, model: Model = "goniochromatic"
) -> tuple[FloatArray, FloatArray]:
    """The BRDF without what depends on wavelength (…,), 0 below the surface, and the argument of that part (…,).

    Arguments as for :func:`brdf`.
    """
    light, camera = np.broadcast_arrays(ink.in_brush_frame(to_light), ink.in_brush_frame(to_camera))
    cos_i, cos_o = light[..., 2], camera[..., 2]
    half = half_vector(light, camera)
    value = density(half, ink.alpha, ink.across, ink.distribution) / 4.0
    if model != "goniochromatic":
        hidden = masking(light, camera, ink.alpha, ink.across, ink.distribution)
        value = value * hidden / np.maximum(cos_i * cos_o, 1e-12)
    value = np.where((cos_i > 0.0) & (cos_o > 0.0), value, 0.0)
    return value, table_argument(model, cos_i, cos_o, np.sum(light * half, axis=-1))


def table_argument(model: Model, cos_i: FloatArray, cos_o: FloatArray, cos_d: FloatArray) -> FloatArray:
    """(…,) the one number in [0, 1] on which the colour of an ink depends.

    1 − cos((θi + θo)/2) for the goniochromatic model; 1 − cosθd, of the angle between light and half vector, for the
    standard ones.
    """
    if model == "goniochromatic":
        return shift(cos_i, cos_o)
    return np.asarray(1.0 - np.clip(cos_d, 0.0, 1.0))


def spectral_term(
    ink: Ink, argument: FloatArray, model: Model, *, tio2_source: str = tio2.DEFAULT
) -> FloatArray:
    """(…, W) what depends on wavelength, at (…,) arguments as :func:`table_argument` gives them.

    E of Eq. 4 for the goniochromatic model, the Fresnel term for the standard ones.

    Raises:
        ModelError: no such model or TiO2 data set, or wavelengths for which its index is not known.
    """
    at = np.asarray(argument, dtype=np.float64)[..., None]
    rho = ink.rho_brdf
    if model == "goniochromatic":
        return np.asarray(rho * np.exp(ink.c_values * at))
    if model == "schlick":
        return np.asarray(rho + (1.0 - rho) * at**5)
    if model == "tio2":
        return np.asarray(rho * tio2.fresnel(1.0 - at[..., 0], tio2.index(ink.nm, tio2_source)))
    raise ModelError(f"no model is named {model!r}; known: {', '.join(MODELS)}")


def brdf_at_angles(
    ink: Ink,
    theta_i_deg: FloatArray | float,
    theta_o_deg: FloatArray | float,
    model: Model = "goniochromatic",
    *,
    tio2_source: str = tio2.DEFAULT,
) -> FloatArray:
    """(…, W) BRDF in 1/sr in the plane of incidence; θo = θi is the mirror direction, θo < 0 the light's side.

    Raises:
        ModelError: as :func:`brdf`.
    """
    light, camera = goniometer(np.asarray(theta_i_deg), np.asarray(theta_o_deg))
    return brdf(ink, light, camera, model, tio2_source=tio2_source)
