"""The soft proof of a print: its inks and photographic effects.

Three extras bring a picture nearer to a photograph (Pranovich 2024, Figs. 8 and 9). They are off unless asked for; the
paper does not print their sizes, so that the ones here are ours. All have the colour of the light and know nothing of
the print's texture: a broad Phong highlight (Phong 1975, in the energy-conserving form of Lafortune and Willems
1994), single scattering in the black paper (Hanrahan and Krueger 1993, Eq. for an isotropic half space without an
interface), and a dim light opposite to the first, for what shines through the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import white_point
from anisoscope.sim.light.colour.spaces import (
    SRGB_TO_XYZ,
    SRGB_WHITE,
    XYZ_TO_SRGB,
    bradford,
    encode,
    linear_srgb,
)
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import Model
from anisoscope.sim.light.ink.shading import UPWARD, Light, picture
from anisoscope.sim.light.ink.shapes import Surface

Float32 = npt.NDArray[np.float32]

ROUGHNESS = {"brushed": 0.19, "binder-mixed": 0.30}
"""α by the way of printing: brushed is the paper's fit; binder-mixed is rougher, it says: 0.30 is our assumption."""


@dataclass(frozen=True)
class Extras:
    """Photographic effects in addition to the inks; 0 switches each off.

    Attributes:
        phong: share of the light that a broad highlight of the paper sends back.
        shininess: exponent of that highlight; low for a broad one.
        scattering: single-scattering albedo of the paper.
        behind: irradiance of a light opposite to the first one, as a share of it.
    """

    phong: float = 0.0
    shininess: float = 4.0
    scattering: float = 0.0
    behind: float = 0.0

    def __post_init__(self) -> None:
        shares = {"phong": self.phong, "scattering": self.scattering, "behind": self.behind}
        for name, value in shares.items():
            if not 0.0 <= value <= 1.0:
                raise ModelError(f"{name} is a share of 0 to 1, not {value:g}")
        if not 0.0 <= self.shininess <= 1000.0:
            raise ModelError(f"the shininess lies in 0 to 1000, not at {self.shininess:g}")


PHOTO = Extras(phong=0.02, shininess=4.0, scattering=0.06, behind=0.08)
"""Extras that look like the photograph of the paper; chosen by eye."""


def direction(azimuth_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    """Unit vector at an azimuth counter-clockwise from +x (right) and an elevation above the plane of the picture."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return float(x), float(y), float(np.sin(elevation))


def proof_picture(
    where: Surface,
    inks: Sequence[Ink],
    lights: Sequence[Light],
    coverage: npt.ArrayLike | None,
    *,
    model: Model = "goniochromatic",
    extras: Extras | None = None,
    substrate: float = 0.0,
) -> Float32:
    """(rows, cols, 3) linear sRGB of a print, as `anisoscope.sim.light.ink.shading.picture` gives it, with extras.

    Raises:
        ModelError: as that function.
    """
    more = extras or Extras()
    shining = list(lights)
    if more.behind > 0.0 and lights:
        x, y, z = lights[0].to_light
        shining.append(
            replace(lights[0], to_light=(-x, -y, -z), irradiance=more.behind * lights[0].irradiance)
        )
    found = picture(where, inks, shining, coverage=coverage, model=model)
    bare = np.zeros(1)
    if substrate > 0.0 and coverage is not None:  # one ink without a coverage leaves nothing bare
        bare = substrate / np.pi * np.clip(1.0 - np.sum(coverage, axis=2), 0.0, 1.0)
    if more.phong > 0.0 or more.scattering > 0.0 or bare.any():
        for light in shining:
            found += _paper(where, light, more, bare)
    return found


def _paper(where: Surface, light: Light, extras: Extras, bare: FloatArray) -> Float32:
    """(rows, cols, 3) light that the paper sends back beneath the inks, and, by its (rows, cols) BRDF, between them."""
    to_light = np.array(light.to_light) / np.linalg.norm(light.to_light)
    camera = np.array(UPWARD)
    normal = where.normal.astype(np.float64)
    cos_i, cos_o = normal @ to_light, normal @ camera
    mirrored = np.maximum(2.0 * cos_i * cos_o - float(to_light @ camera), 0.0)
    lobe = extras.phong * (extras.shininess + 2.0) / (2.0 * np.pi) * mirrored**extras.shininess
    scattered = extras.scattering / (4.0 * np.pi) / np.maximum(cos_i + cos_o, 1e-12)
    value = np.where((cos_i > 0.0) & (cos_o > 0.0), light.irradiance * cos_i * (lobe + scattered + bare), 0.0)
    return np.asarray(value[..., None] * linear_srgb(white_point(light.illuminant)), dtype=np.float32)


def adaptation(illuminant: Illuminant) -> FloatArray:
    """(3, 3) of linear sRGB, from the white of a light to that of sRGB (Bradford)."""
    return np.asarray(XYZ_TO_SRGB @ bradford(white_point(illuminant), SRGB_WHITE) @ SRGB_TO_XYZ)


def to_screen(
    linear: npt.ArrayLike, exposure: float = 1.0, adapt: FloatArray | None = None
) -> npt.NDArray[np.uint8]:
    """(…, 3) 8-bit sRGB of (…, 3) linear sRGB times ``exposure``, adapted where a matrix is given."""
    value = exposure * np.asarray(linear, dtype=np.float64)
    if adapt is not None:
        value = value @ adapt.T
    return np.asarray(np.rint(255.0 * encode(value).srgb), dtype=np.uint8)
