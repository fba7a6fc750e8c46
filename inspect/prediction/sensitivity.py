"""Sensitivity of a prediction: from the uncertainty of its inputs to a covariance of the pose radiances.

The law of propagation of uncertainty (JCGM 100:2008, 5.2; for several outputs JCGM 102:2011, 6.2): every input is
moved a small step down and up, everything else held, and half the change of the radiances per step times the
standard uncertainty of the input is its contribution. Works with any predictor that takes directions and a
material. All states with the same material and shape are evaluated in one call of the predictor.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.sim.light.geometry import directions, seating_rotation

Correlation = Literal["shared", "independent", "partial"]
Model = Callable[[FloatArray, FloatArray, Material], FloatArray]

DARK = 1e-9  # 1/sr; below it ln L is meaningless
ALPHA_RANGE = (0.001, 1.0)
SHAPE_RANGE = {
    "ridge_angle_deg": (0.0, 44.9),
    "height_loss": (0.0, 1.0),
    "height_factor": (0.0, float("inf")),
}
SECOND_ORDER = ", second order"
"""End of the name of a source that is the second order of others."""
_CURVED = 0.3  # share of the linear u above which the second order is reported
_ROUGHLY_LINEAR = 0.3  # relative u of one source, likewise


@dataclass(frozen=True)
class Shape:
    """Uncertain parameters of the shape of a surface.

    Attributes:
        ridge_angle_deg: ridge angle of a design.
        height_loss: height loss of a design, a share.
        height_factor: factor on the heights of a map.
    """

    ridge_angle_deg: float = 0.0
    height_loss: float = 0.0
    height_factor: float = 1.0


Surface = Callable[[Shape], Model]


@dataclass(frozen=True, eq=False)
class State:
    """All inputs of one prediction; rotations are one number or (P,) values, in degrees."""

    material: Material
    light_angle_deg: float
    stage_deg: float | FloatArray = 0.0
    tilt_deg: float | FloatArray = 0.0
    seating_deg: tuple[float, float] = (0.0, 0.0)
    shape: Shape = Shape()


@dataclass(frozen=True, eq=False)
class Contribution:
    """Contribution of one source to the uncertainty of the pose radiances.

    Attributes:
        source: its name in words.
        absolute: (P,) standard uncertainty in 1/sr; signed where it is shared.
        correlation: "shared": one error moves all poses together; "independent": every pose has its own;
            "partial": as ``matrix`` says.
        matrix: (P, P) covariance in 1/sr², for "partial" only.
        curvature: (P,) standard deviation in 1/sr that the second order of the model adds; not in the covariance.
        rectangular: evenly distributed within its bounds, else normal.
        kind: of the uncertain quantity.
    """

    source: str
    absolute: FloatArray
    correlation: Correlation = "shared"
    matrix: FloatArray | None = None
    curvature: FloatArray | None = None
    rectangular: bool = False
    kind: str = "prediction"

    def covariance(self) -> FloatArray:
        """(P, P) covariance of the radiances in 1/sr²."""
        if self.matrix is not None:
            return self.matrix
        if self.correlation == "shared":
            return np.outer(self.absolute, self.absolute)
        return np.diag(self.absolute**2)


@dataclass(frozen=True, eq=False)
class Budget:
    """All contributions to the uncertainty of P pose radiances.

    Attributes:
        radiance: (P,) nominal radiances in 1/sr.
        contributions: the sources.
        per_degree: (P,) change of L per degree of stage angle, in 1/sr.
    """

    radiance: FloatArray
    contributions: tuple[Contribution, ...]
    per_degree: FloatArray

    @property
    def dark(self) -> npt.NDArray[np.bool_]:
        """(P,) True where L ≤ 1e-9 1/sr, so that relative uncertainties mean nothing."""
        return self.radiance <= DARK

    def covariance(self) -> FloatArray:
        """(P, P) covariance of the radiances in 1/sr²."""
        count = self.radiance.size
        parts = [np.zeros((count, count)), *(c.covariance() for c in self.contributions)]
        return np.asarray(np.sum(parts, axis=0))

    def u(self) -> FloatArray:
        """(P,) standard uncertainties in 1/sr."""
        return np.asarray(np.sqrt(np.diag(self.covariance())))

    def first_order(self) -> "Budget":
        """The budget without the second order of its sources."""
        parts = tuple(one for one in self.contributions if not one.source.endswith(SECOND_ORDER))
        return replace(self, contributions=parts)

    def relative(self, absolute: FloatArray) -> FloatArray:
        """(P,) values in 1/sr as shares of L; 0 in dark poses."""
        return np.where(self.dark, 0.0, absolute / np.where(self.dark, 1.0, self.radiance))

    def not_linear(self) -> npt.NDArray[np.bool_]:
        """(P,) True where first-order propagation is in doubt.

        Either the second order of some sources, added in squares, exceeds 0.3 of the first-order u (as at the top
        of a lobe, where the slope vanishes), or one source alone moves L by more than 30 %.
        """
        zero = np.zeros(self.radiance.size)
        curved = [zero if c.curvature is None else c.curvature for c in self.contributions]
        second = np.sqrt(np.sum([zero, *(value**2 for value in curved)], axis=0))
        largest = np.max([zero, *(np.abs(self.relative(c.absolute)) for c in self.contributions)], axis=0)
        bent = second > np.maximum(_CURVED * self.u(), DARK)
        return np.asarray(bent | (largest > _ROUGHLY_LINEAR))


def fixed(model: Model) -> Surface:
    """A surface of exactly known shape, from its predictor."""
    return lambda _shape: model


def _turned_directions(
    state: State, poses: Sequence[Pose], convention: Convention
) -> tuple[FloatArray, FloatArray]:
    turn, tilt = (np.broadcast_to(angle, len(poses)) for angle in (state.stage_deg, state.tilt_deg))
    moved = tuple(
        Pose(pose.stage_deg + float(a), pose.tilt_deg + float(b))
        for pose, a, b in zip(poses, turn, tilt, strict=True)
    )
    seen = replace(convention, light_angle_deg=state.light_angle_deg)
    to_light, to_camera = _seated(moved, seen, state.seating_deg)
    low = np.minimum(to_light[:, 2], to_camera[:, 2]) < 1e-3
    if low.any():
        pose = poses[int(np.argmax(low))]
        raise ModelError(
            f"at {pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°, light or camera stands within the uncertainty of the "
            "angles from the horizon of the sample: leave the pose out, or predict it without uncertainty"
        )
    return to_light, to_camera


@lru_cache(maxsize=128)
def _seated(
    poses: tuple[Pose, ...], convention: Convention, seating_deg: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Directions (P, 3) to light and camera as a seated sample sees them, from a cache: read-only."""
    to_light, to_camera = directions(poses, convention)
    seat = seating_rotation(*seating_deg)
    return to_light @ seat, to_camera @ seat


def evaluate(
    surface: Surface,
    states: Sequence[State],
    poses: tuple[Pose, ...],
    convention: Convention,
    on_progress: Advance = silent,
) -> FloatArray:
    """Radiances of all poses in all states, (S, P) in 1/sr; one call of the predictor per material and shape.

    Raises:
        ModelError: in some state light or camera is at or below the horizon of the sample.
    """
    groups: dict[tuple[Shape, Material], list[int]] = {}
    for number, state in enumerate(states):
        groups.setdefault((state.shape, state.material), []).append(number)
    result = np.empty((len(states), len(poses)))
    for step, ((shape, material), members) in enumerate(groups.items()):
        on_progress("uncertainty", step, len(groups))
        bent = [_turned_directions(states[number], poses, convention) for number in members]
        to_light, to_camera = (np.concatenate([pair[side] for pair in bent]) for side in (0, 1))
        result[members] = surface(shape)(to_light, to_camera, material).reshape(len(members), len(poses))
    return result
