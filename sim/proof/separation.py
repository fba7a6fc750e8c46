"""From an image to coverages of three inks.

Coverage is linear: an ink that covers a share w of the paper adds w times its colour, so there is no dot gain and no
gamma to correct, and an ICC profile has nothing to say about the print. The image is sRGB (an embedded profile is
applied when it is read); it is made linear, adapted from sRGB's white to the white of the light (Bradford), and met by
non-negative least squares in linear sRGB with the inks' own colours, seen in one geometry. The brightest neutral that
the inks can mix is the white of the image.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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

INKS = 3
ANGLE_DEG = 20.0
TOLERANCE = 0.02
"""Distance in linear sRGB, white at 1, from which a colour counts as out of gamut."""


@dataclass(frozen=True, eq=False)
class Separation:
    """How colours become coverages.

    Attributes:
        way: "match": mixed from the inks' colours; "channels": R, G, B of the linear image are the coverages.
        colours: (3, 3) linear sRGB of the inks, a column each, scaled so that ``white`` is met with a sum of 1.
        white: (3,) linear sRGB of the image's white, adapted to the light.
        neutral: (3,) coverages of that white.
        adaptation: (3, 3) of the image's linear sRGB to the light.
        gain: on the image's linear values; above 1 the bright parts are cut.
        angle_deg: inclination of light and eye, on opposite sides.
        illuminant: name of the light.
    """

    way: Way
    colours: FloatArray
    white: FloatArray
    neutral: FloatArray
    adaptation: FloatArray
    gain: float
    angle_deg: float
    illuminant: str

    @property
    def solvers(self) -> Float32:
        """(7, 3, 3) least-squares solutions on all sets of inks, all three first; rows of inks left out are zero."""
        found = []
        for count in range(INKS, 0, -1):
            for chosen in map(list, combinations(range(INKS), count)):
                solver = np.zeros((INKS, 3))
                solver[chosen] = np.linalg.pinv(self.colours[:, chosen])
                found.append(solver)
        return np.array(found, dtype=np.float32)


def separation(
    inks: Sequence[Ink],
    illuminant: Illuminant,
    *,
    way: Way = "match",
    angle_deg: float = ANGLE_DEG,
    gain: float = 1.0,
) -> Separation:
    """Make ready to turn images into coverages of three inks.

    Raises:
        ModelError: not three inks, inks of which one can be mixed from the others or which cannot mix a white, an angle
            outside of 0 to 85°, or a gain that is not above 0.
    """
    from scipy.optimize import nnls  # noqa: PLC0415 - loads in half a second

    if len(inks) != INKS:
        raise ModelError(f"dot off dot needs three inks, not {len(inks)}")
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
    lengths = np.linalg.norm(seen, axis=0)
    if lengths.min() <= 0.0 or np.linalg.cond(seen / lengths) > 50.0:
        raise ModelError(
            "the three inks are too much alike to mix colours: choose a red, a green and a blue one"
        )
    turn = XYZ_TO_SRGB @ bradford(SRGB_WHITE, white_point(illuminant)) @ SRGB_TO_XYZ
    white = turn @ np.ones(3)
    amounts = nnls(seen, white)[0]
    if amounts.min() <= 0.0:
        least = inks[int(np.argmin(amounts))].name
        raise ModelError(
            f"the inks mix no neutral under {illuminant.name} ({least} would be needed less than not at all)"
        )
    return Separation(
        way, seen * amounts.sum(), white, amounts / amounts.sum(), turn, gain, angle_deg, illuminant.name
    )


def decode_srgb() -> FloatArray:
    """(256,) linear values of 8-bit sRGB (IEC 61966-2-1)."""
    value = np.arange(256) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
