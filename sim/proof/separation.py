"""From an image to coverages of three or four inks.

Coverage is linear: an ink that covers a share w of the paper adds w times its colour, so there is no dot gain and no
gamma to correct, and an ICC profile has nothing to say about the print. The image is sRGB (an embedded profile is
applied when it is read); it is made linear, adapted from sRGB's white to the white of the light (Bradford), and met by
non-negative least squares in linear sRGB with the inks' own colours, seen in one geometry. The brightest neutral that
the inks can mix is the white of the image. A sheet that is not black shows where no ink is: colours then count from it.

With a fourth ink, such as a white one, a colour has many mixtures: the one with the least ink is taken. It leaves room
for brighter colours, so that neutrals are printed with the white ink as far as it goes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import white_point, xyz_weights
from anisoscope.sim.light.colour.spaces import SRGB_TO_XYZ, SRGB_WHITE, XYZ_TO_SRGB, bradford, linear_srgb
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import brdf_at_angles

Float32 = npt.NDArray[np.float32]
Way = Literal["match", "channels"]

FEWEST_INKS, MOST_INKS = 3, 4
CHANNELS = 3
ALIKE = 50.0
"""Condition of the matrix of three colours from which one counts as mixed from the others."""
ANGLE_DEG = 20.0
TOLERANCE = 0.02
"""Distance in linear sRGB, white at 1, from which a colour counts as out of gamut."""


@dataclass(frozen=True, eq=False)
class Separation:
    """Separation of colours into coverages.

    Attributes:
        way: "match": mixed from the inks' colours; "channels": R, G, B of the linear image are the coverages, and what
            they have in common is that of a fourth ink.
        colours: (3, K) linear sRGB of the inks, a column each, scaled so that ``white`` is met with a sum of 1.
        white: (3,) linear sRGB of the image's white, adapted to the light.
        neutral: (K,) coverages of that white.
        adaptation: (3, 3) of the image's linear sRGB to the light.
        gain: on the image's linear values; above 1 the bright parts are cut.
        angle_deg: inclination of light and eye, on opposite sides.
        illuminant: name of the light.
        bare: (3,) linear sRGB of the sheet without ink, in the scale of ``colours``.
    """

    way: Way
    colours: FloatArray
    white: FloatArray
    neutral: FloatArray
    adaptation: FloatArray
    gain: float
    angle_deg: float
    illuminant: str
    bare: FloatArray = field(default_factory=lambda: np.zeros(CHANNELS))

    @property
    def added(self) -> FloatArray:
        """(3, K) by how much an ink changes the colour of the sheet where it covers it."""
        return self.colours - self.bare[:, None]

    @property
    def sheet_share(self) -> float:
        """Light of the sheet over that of the white, of the channel where it is largest: no print gets darker."""
        return float((self.bare / self.white).max())

    @property
    def inks(self) -> int:
        """Number K of inks."""
        return int(self.colours.shape[1])

    @property
    def solvers(self) -> tuple[Float32, int]:
        """(S, K, 3) least-squares solutions on sets of inks, rows of inks left out zero; how many meet any colour.

        Those are of three inks and come first.
        """
        exact = [_solver(self.added, chosen) for chosen in _mixing(self.added)]
        sets = [list(one) for count in (2, 1) for one in combinations(range(self.inks), count)]
        found = exact + [_solver(self.added, chosen) for chosen in sets]
        return np.array(found, dtype=np.float32), len(exact)


def _solver(colours: FloatArray, chosen: list[int]) -> FloatArray:
    found = np.zeros((colours.shape[1], CHANNELS))
    found[chosen] = np.linalg.pinv(colours[:, chosen])
    return found


def _mixing(colours: FloatArray) -> list[list[int]]:
    """Sets of three inks none of which can be mixed from the others."""
    directions = colours / np.maximum(np.linalg.norm(colours, axis=0), 1e-300)
    sets = [list(one) for one in combinations(range(colours.shape[1]), CHANNELS)]
    return [one for one in sets if np.linalg.cond(directions[:, one]) <= ALIKE]


def _least_ink(colours: FloatArray, aim: FloatArray) -> FloatArray | None:
    """The mixture of a colour with the smallest sum of coverages; None where there is none."""
    found = [_solver(colours, chosen) @ aim for chosen in _mixing(colours)]
    inside = [one for one in found if one.min() >= 0.0]
    return min(inside, key=lambda one: float(one.sum())) if inside else None


def separation(
    inks: Sequence[Ink],
    illuminant: Illuminant,
    *,
    way: Way = "match",
    angle_deg: float = ANGLE_DEG,
    gain: float = 1.0,
    substrate: float = 0.0,
) -> Separation:
    """Make ready to turn images into coverages of three or four inks.

    Args:
        inks: red, green, blue, and perhaps white.
        illuminant: the light.
        way: of the separation.
        angle_deg: inclination of light and eye, on opposite sides.
        gain: on the image's linear values.
        substrate: diffuse reflectance of the sheet.

    Raises:
        ModelError: a sheet brighter than the inks, fewer or more inks, inks of which one can be mixed from the others
            or which cannot mix a white, an angle outside of 0 to 85°, or a gain that is not above 0.
    """
    if not FEWEST_INKS <= len(inks) <= MOST_INKS:
        raise ModelError(f"dot off dot needs three or four inks, not {len(inks)}")
    if not 0.0 <= angle_deg <= 85.0:
        raise ModelError(f"the angle of light and eye lies in 0 to 85°, not at {angle_deg:g}°")
    if not 0.0 < gain < np.inf:
        raise ModelError(f"the gain must be a number above 0, not {gain:g}")
    seen = np.stack(
        [
            linear_srgb(brdf_at_angles(ink, angle_deg, angle_deg) @ xyz_weights(illuminant, ink.nm))
            for ink in inks
        ],
        axis=1,
    )
    if np.linalg.norm(seen, axis=0).min() <= 0.0 or not _mixing(seen):
        raise ModelError(
            f"the {len(inks)} inks are too much alike to mix colours: choose a red, a green and a blue one"
        )
    turn = XYZ_TO_SRGB @ bradford(SRGB_WHITE, white_point(illuminant)) @ SRGB_TO_XYZ
    white = turn @ np.ones(CHANNELS)
    amounts = _least_ink(seen, white)
    if amounts is None:
        least = inks[int(np.argmin(_solver(seen, _mixing(seen)[0]) @ white))].name
        raise ModelError(
            f"the inks mix no neutral under {illuminant.name} ({least} would be needed less than not at all)"
        )
    bare = substrate / np.pi * amounts.sum() * linear_srgb(white_point(illuminant))
    if np.any(bare >= white):
        raise ModelError(
            f"a sheet of reflectance {substrate:g} is brighter than the white of the inks at {angle_deg:g}°, so that "
            "ink would darken it: take a darker sheet"
        )
    neutral = amounts / amounts.sum()
    return Separation(way, seen * amounts.sum(), white, neutral, turn, gain, angle_deg, illuminant.name, bare)


def decode_srgb() -> FloatArray:
    """(256,) linear values of 8-bit sRGB (IEC 61966-2-1)."""
    value = np.arange(256) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
