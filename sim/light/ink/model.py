"""The BRDF of an ink: the goniochromatic model of Pranovich 2024, and the standard ones it is compared with.

* "goniochromatic": Eq. 5, D/4 · ρ · exp(c·(1 − cos((θi + θo)/2))). Reciprocal; it does not conserve energy.
* "schlick": Torrance-Sparrow (Eq. 2) with Schlick's Fresnel term (Schlick 1994), ρ at normal incidence.
* "tio2": Torrance-Sparrow with the Fresnel reflectance of TiO2, times ρ.

Eq. 7 of the paper is Eq. 5 in the mirror direction. It says ω_i = ω_o there, which would be the direction back to the
light: Eq. 5 is 17 to 526 times smaller there at 20° to 65° for α = 0.19.

The directional albedo is the share of the light that an ink reflects: that of Eq. 5 may exceed 1.

Inks over each other: coated mica does not absorb, so that what the upper film does not reflect goes through it, to the
lower ink and back,

    f = f_upper + (1 − A_upper(θi)) (1 − A_upper(θo)) f_lower,

with the directional albedo A of the upper ink. Light that goes back and forth between the films more than once, and
what a film blurs, is left out. The spectra of the mirror direction are then those of Eq. 5, fitted in ln f: an
overprint is an ink as the others, and a measured one can stand in its place.
"""

from collections.abc import Sequence
from functools import cache, reduce
from typing import Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink import tio2
from anisoscope.sim.light.ink.angles import goniometer, half_vector, in_plane, shift
from anisoscope.sim.light.ink.distributions import density, masking, normals_by_share
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
    """(…, W) BRDF in 1/sr at (…, 3) unit vectors in the frame of the surface; 0 below it.

    Raises:
        ModelError: no such model or TiO2 data set, or wavelengths for which its index is not known.
    """
    found: FloatArray | float = 0.0
    for part in ink.parts:
        value, argument = lobe(part, to_light, to_camera, model)
        found = found + value[..., None] * spectral_term(part, argument, model, tio2_source=tio2_source)
    return np.asarray(found)


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


WATCHED_DEG = (0, 15, 30, 45, 60, 70, 80)
BINS = 64


def directional_albedo(
    ink: Ink,
    theta_i_deg: FloatArray | float,
    model: Model = "goniochromatic",
    *,
    shares: int = 48,
    azimuths: int = 64,
) -> FloatArray:
    """(…, W) share of the light from (…) inclinations, azimuth 0, that is sent back into the hemisphere.

    ∫ f cosθo dω_o over half vectors (dω_o = 4 (ω_i·h) dω_h), placed where the lobe has its weight.

    Args:
        ink: the ink.
        theta_i_deg: inclinations of the light, below 90.
        model: of the BRDF.
        shares: nodes over the inclination of the half vector.
        azimuths: nodes over its azimuth.

    Raises:
        ModelError: as :func:`~anisoscope.sim.light.ink.model.brdf`.
    """
    if ink.base:
        albedos = [
            directional_albedo(part, theta_i_deg, model, shares=shares, azimuths=azimuths)
            for part in ink.parts
        ]
        return np.asarray(sum(albedos))
    node, weight = _nodes(shares)
    azimuth = (np.arange(azimuths) + 0.5) * 2.0 * np.pi / azimuths
    share, turn = np.meshgrid(0.5 * (node + 1.0), azimuth, indexing="ij")
    local = normals_by_share(share.ravel(), turn.ravel(), ink.alpha, ink.across, ink.distribution)
    each = (np.repeat(0.5 * weight / azimuths, azimuths) * 4.0) / (
        density(local, ink.alpha, ink.across, ink.distribution) * local[:, 2]
    )
    light = ink.in_brush_frame(in_plane(np.ravel(theta_i_deg)))[:, None]  # (N, 1, 3)
    facing = light[:, 0] @ local.T
    camera = 2.0 * facing[..., None] * local - light
    reached = (facing > 0.0) & (camera[..., 2] > 0.0)
    camera = np.where(reached[..., None], camera, [0.0, 0.0, 1.0])
    value, argument = lobe(ink, _brush_to_surface(ink, light), _brush_to_surface(ink, camera), model)
    lit = np.where(reached, each * facing * camera[..., 2] * value, 0.0)
    found = _over_bins(lit, argument) @ spectral_term(ink, np.linspace(0.0, 1.0, BINS), model)
    return np.asarray(found.reshape(*np.shape(theta_i_deg), -1))


def _over_bins(weight: FloatArray, argument: FloatArray) -> FloatArray:
    """(N, K) weights at any arguments in 0 to 1 as (N, BINS) weights at even ones, which spares most exponentials."""
    position = np.clip(argument, 0.0, 1.0) * (BINS - 1)
    index = np.minimum(position.astype(np.intp), BINS - 2)
    share = position - index
    index += BINS * np.arange(len(index))[:, None]
    size, flat = BINS * len(index), index.ravel()
    low = np.bincount(flat, (weight * (1.0 - share)).ravel(), size)
    return np.asarray(low + np.bincount(flat + 1, (weight * share).ravel(), size)).reshape(-1, BINS)


@cache
def _nodes(count: int) -> tuple[FloatArray, FloatArray]:
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight


def _brush_to_surface(ink: Ink, vectors: FloatArray) -> FloatArray:
    turn = np.radians(ink.brush_deg)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], axis=-1)


def albedo_warning(ink: Ink, model: Model = "goniochromatic") -> str | None:
    """Warning where the albedo exceeds 1 for light at up to 80°; else None."""
    found = directional_albedo(ink, np.array(WATCHED_DEG, dtype=np.float64), model, shares=16, azimuths=24)
    if found.max() <= 1.0:
        return None
    begin = WATCHED_DEG[int(np.argmax(found.max(axis=1) > 1.0))]
    row, column = np.unravel_index(int(np.argmax(found)), found.shape)
    return (
        f"{ink.name}: the albedo exceeds 1 from {begin}° on (up to {found[row, column]:.2f} at {WATCHED_DEG[row]}° and "
        f"{ink.wavelengths_nm[column]:g} nm): more light comes back than fell in"
    )


OVERPRINT_DEG = tuple(float(angle) for angle in range(0, 71, 10))
_DARK = 1e-6


def overprint(inks: Sequence[Ink]) -> Ink:
    """Inks on top of each other, the first one below, as one ink in 1/sr on the wavelengths of the last.

    Raises:
        ModelError: no ink, or one that is brushed or has another distribution of normals than the others.
    """
    if not inks:
        raise ModelError("an overprint needs an ink")
    for ink in inks:
        if not ink.isotropic or ink.distribution != inks[0].distribution:
            raise ModelError(
                f"{ink.name}: overprints are modelled of isotropic inks with one distribution of normals; give a "
                "measured one"
            )
    return reduce(_over, inks)


def _over(lower: Ink, upper: Ink) -> Ink:
    angles, nm = np.array(OVERPRINT_DEG), upper.nm
    cosine = np.cos(np.radians(angles))
    x = shift(cosine, cosine)
    through = np.square(1.0 - np.minimum(directional_albedo(upper, angles, shares=24, azimuths=32), 1.0))
    above = 4.0 * np.pi * brdf_at_angles(upper, angles, angles)
    of_lower = 4.0 * np.pi * brdf_at_angles(lower, angles, angles)
    below = through * np.stack([np.interp(nm, lower.nm, values) for values in of_lower])
    flux = float(above.sum() * upper.alpha**2), float(below.sum() * lower.alpha**2)
    alpha = (flux[0] * upper.alpha + flux[1] * lower.alpha) / max(sum(flux), _DARK)
    slope, start = np.polyfit(x, np.log(np.maximum((above + below) * alpha**2, _DARK)), 1)
    return Ink(
        f"{upper.name} over {lower.name}", float(alpha), tuple(nm.tolist()), tuple(np.exp(start).tolist()),
        tuple(slope.tolist()), source="modelled: what the upper ink does not reflect reaches the lower one",
        distribution=upper.distribution,
    )  # fmt: skip
