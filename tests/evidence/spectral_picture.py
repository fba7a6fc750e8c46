"""The picture of inks straightforwardly: every wavelength at every pixel, in numpy."""

import numpy as np

from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.distributions import density, masking
from anisoscope.sim.light.ink.model import spectral_term, table_argument


def spectral_picture(
    surface, inks, lights, *, coverage=None, to_camera=(0.0, 0.0, 1.0), model="goniochromatic"
):
    """(rows, cols, 3) linear sRGB of `anisoscope.sim.light.ink.shading.picture` in float64."""
    covered = np.ones((1, 1, 1)) if coverage is None else np.asarray(coverage, dtype=np.float32)
    camera = np.array(to_camera) / np.linalg.norm(to_camera)
    result = np.zeros(surface.normal.shape)
    for light in lights:
        toward = np.array(light.to_light) / np.linalg.norm(light.to_light)
        for number, ink in enumerate(inks):
            weights = linear_srgb(xyz_weights(light.illuminant, ink.nm))
            shown = _reflection(surface, ink, toward, camera, model) @ weights
            result += light.irradiance * covered[..., number, None] * shown
    return result


def _reflection(surface, ink, toward, camera, model):
    """(rows, cols, W) f·cosθi in 1/sr."""
    light, seen = _in_frame(surface, ink, toward), _in_frame(surface, ink, camera)
    half = _in_frame(surface, ink, (toward + camera) / np.linalg.norm(toward + camera))
    cos_i, cos_o = light[..., 2], seen[..., 2]
    lobe = density(half, ink.alpha, ink.across, ink.distribution) / 4.0
    if model == "goniochromatic":
        lobe = lobe * cos_i
    else:
        lobe = lobe * masking(light, seen, ink.alpha, ink.across, ink.distribution) / np.maximum(cos_o, 1e-12)
    argument = table_argument(model, cos_i, cos_o, np.sum(light * half, axis=-1))
    lobe = np.where((cos_i > 0.0) & (cos_o > 0.0), lobe, 0.0)
    return lobe[..., None] * spectral_term(ink, argument, model)


def _in_frame(surface, ink, direction):
    """(rows, cols, 3) components of a direction along tangent, bitangent and normal, turned into the brushing."""
    normal, tangent = surface.normal.astype(np.float64), surface.tangent.astype(np.float64)
    across = np.cross(normal, tangent)
    local = np.stack([tangent @ direction, across @ direction, normal @ direction], axis=-1)
    return ink.in_brush_frame(local)
