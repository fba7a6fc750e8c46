"""Tangents: response of ln L of a defective part to the inputs of the prediction.

ln L of a defective surface depends differently on roughness, albedo and seating than that of the good one: a cut crest
is a facet of another orientation, a broader lobe masks the Lambertian base. The recipe's uncertainties are therefore
propagated separately (JCGM 100:2008, 5.2) at some extents of a cause, and interpolated between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT, RIDGE_ANGLE, input_slopes
from anisoscope.prediction.sensitivity import DARK, State, Surface

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


INPUTS = (*PLASTIC_AND_SEAT, RIDGE_ANGLE)
"""Inputs that are moved on spoiled surfaces."""
A_SIDE = 3
"""Extents to either side of nil at which the inputs are looked at."""
_UNIT = InputUncertainty(
    alpha_share=1.0,
    albedo=1.0,
    index=1.0,
    light_angle_deg=1.0,
    seating_tilt_deg=1.0,
    stage_deg=0.0,
    stage_zero_deg=0.0,
    tilt_deg=0.0,
    tilt_zero_deg=0.0,
    height_map_share=0.0,
)


@dataclass(frozen=True, eq=False)
class Tangents:
    """Response of ln L to the inputs along one cause.

    Attributes:
        extents: (T,) extents of the cause, ascending, including 0.
        slope: (T, P, K) change of ln L per unit of the K `INPUTS`: of ln α, of the albedo, of the index, per degree.
    """

    extents: FloatArray
    slope: FloatArray

    @cached_property
    def _curve(self) -> "PchipInterpolator":
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - 0.3 s

        good = self.slope[int(np.flatnonzero(self.extents == 0.0)[0])]
        return PchipInterpolator(self.extents, self.slope - good, axis=0)

    def change(self, extent: float | FloatArray, sources: Sequence[str]) -> FloatArray:
        """(…, P, K) difference of the slopes of K sources from those of the good part; 0 for other sources."""
        found = self._curve(np.clip(extent, self.extents[0], self.extents[-1]))
        columns = [INPUTS.index(source) if source in INPUTS else -1 for source in sources]
        known = np.array([column >= 0 for column in columns])
        return np.asarray(found[..., columns] * known)

    def of(self, poses: Sequence[int]) -> "Tangents":
        """Restrict to selected poses."""
        return Tangents(self.extents, self.slope[:, list(poses)])


def looked_at(extents: Sequence[float]) -> tuple[float, ...]:
    """0 and some extents to either side of it, evenly spread and including the outermost ones."""
    found = {0.0}
    for side in ([e for e in extents if e > 0.0], [e for e in reversed(extents) if e < 0.0]):
        places = np.linspace(len(side) - 1, 0, A_SIDE + 1)[:-1] if len(side) > A_SIDE else range(len(side))
        found |= {side[int(np.rint(place))] for place in places}
    return tuple(sorted(found))


def slopes_of(
    surface: Surface, state: State, poses: tuple[Pose, ...], convention: Convention, *, turning: bool = False
) -> FloatArray | None:
    """(P, K) change of ln L per unit of every one of `INPUTS`; None where a pose is dark.

    Args:
        surface: predictor of the defective surface as a function of the good shape.
        state: of the prediction.
        poses: P poses.
        convention: how the angles are counted.
        turning: the ridge angle of the good surface is uncertain too; else its column is 0.
    """
    inputs = replace(_UNIT, ridge_angle_deg=float(turning))
    radiance, slopes = input_slopes(surface, state, poses, convention, inputs)
    if np.any(radiance <= DARK):
        return None
    nil = np.zeros(len(poses))
    return np.column_stack([slopes.get(source, nil) for source in INPUTS])
