"""How much of the light an ink sends back: Eq. 5 may send back more than it got."""

from functools import cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.sim.light.ink.angles import in_plane
from anisoscope.sim.light.ink.distributions import density, normals_by_share
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import Model, lobe, spectral_term

WATCHED_DEG = (0, 15, 30, 45, 60, 70, 80)
BINS = 64


def directional_albedo(
    ink: Ink, theta_i_deg: float, model: Model = "goniochromatic", *, shares: int = 48, azimuths: int = 64
) -> FloatArray:
    """(W,) share of the light from one inclination, azimuth 0, that is sent back into the hemisphere.

    ∫ f cosθo dω_o over half vectors (dω_o = 4 (ω_i·h) dω_h), placed where the lobe has its weight.

    Args:
        ink: the ink.
        theta_i_deg: inclination of the light, below 90.
        model: of the BRDF.
        shares: nodes over the inclination of the half vector.
        azimuths: nodes over its azimuth.

    Raises:
        ModelError: as :func:`~anisoscope.sim.light.ink.model.brdf`.
    """
    node, weight = _nodes(shares)
    azimuth = (np.arange(azimuths) + 0.5) * 2.0 * np.pi / azimuths
    share, turn = np.meshgrid(0.5 * (node + 1.0), azimuth, indexing="ij")
    local = normals_by_share(share, turn, ink.alpha, ink.across, ink.distribution)
    light = ink.in_brush_frame(in_plane(np.array(theta_i_deg)))
    facing = local @ light
    camera = 2.0 * facing[..., None] * local - light
    reached = (facing > 0.0) & (camera[..., 2] > 0.0)
    solid = 4.0 * facing / (density(local, ink.alpha, ink.across, ink.distribution) * local[..., 2])
    part = np.where(reached, solid * camera[..., 2], 0.0) * (0.5 * weight / azimuths)[:, None]
    lit, seen = part[reached], camera[reached]
    value, argument = lobe(ink, _brush_to_surface(ink, light), _brush_to_surface(ink, seen), model)
    return _over_bins(lit * value, argument) @ spectral_term(ink, np.linspace(0.0, 1.0, BINS), model)


def _over_bins(weight: FloatArray, argument: FloatArray) -> FloatArray:
    """Weights at any arguments in 0 to 1 as weights at ``BINS`` even ones, which spares most exponentials."""
    position = np.clip(argument, 0.0, 1.0) * (BINS - 1)
    index = np.minimum(position.astype(np.intp), BINS - 2)
    share = position - index
    low = np.bincount(index, weight * (1.0 - share), BINS)
    return np.asarray(low + np.bincount(index + 1, weight * share, BINS))


@cache
def _nodes(count: int) -> tuple[FloatArray, FloatArray]:
    node, weight = np.polynomial.legendre.leggauss(count)
    return node, weight


def _brush_to_surface(ink: Ink, vectors: FloatArray) -> FloatArray:
    turn = np.radians(ink.brush_deg)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], axis=-1)


def albedo_warning(ink: Ink, model: Model = "goniochromatic") -> str | None:
    """Where the albedo exceeds 1 for light at up to 80°; None where it does not."""
    found = np.stack(
        [directional_albedo(ink, float(angle), model, shares=16, azimuths=24) for angle in WATCHED_DEG]
    )
    if found.max() <= 1.0:
        return None
    begin = WATCHED_DEG[int(np.argmax(found.max(axis=1) > 1.0))]
    row, column = np.unravel_index(int(np.argmax(found)), found.shape)
    return (
        f"{ink.name}: the albedo exceeds 1 from {begin}° on (up to {found[row, column]:.2f} at {WATCHED_DEG[row]}° and "
        f"{ink.wavelengths_nm[column]:g} nm): more light comes back than fell in"
    )
