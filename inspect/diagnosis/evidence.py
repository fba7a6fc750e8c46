"""What a diagnosis rests on: the deviation with its covariance, the share of deviating cells, and uncertain inputs."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.expectation import Component, Expectation
from anisoscope.recipe import Recipe
from anisoscope.response import Response

FloatArray = npt.NDArray[np.float64]

FARTHEST = 6.0  # u from the nominal state to which the second order is trusted
SHARE_FLOOR = 0.003  # cells that deviate on one good part and not on another
SHARE_RELATIVE = 0.3  # how well a share of deviating cells is predicted: size and form of real marks vary


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a diagnosis rests on.

    Attributes:
        deviation: (P,) ln L measured − ln L predicted.
        covariance: (P, P) of it, the scale included.
        share: share of cells that deviate in the contrast map, or None.
        u_share: its standard uncertainty.
        background: share of cells that deviate on good parts.
        u_background: its standard uncertainty.
        inputs: of the prediction, that may be causes too, or None.
    """

    deviation: FloatArray
    covariance: FloatArray
    share: float | None = None
    u_share: float = 0.0
    background: float = 0.0
    u_background: float = 0.0
    inputs: "Inputs | None" = None


def covariance_of(components: tuple[Component, ...], scale_share: float, poses: int) -> FloatArray:
    """(P, P) covariance of ln L from all sources, and a scale that all poses share."""
    total = np.full((poses, poses), scale_share**2)
    for component in components:
        total += component.covariance()
    return total


@dataclass(frozen=True, eq=False)
class Inputs:
    """Uncertain inputs of the prediction that may be causes themselves.

    Attributes:
        response: of ln L to the inputs.
        u: standard uncertainties of inputs by name, in the unit of the cause's extent.
        rest: (P, P) covariance of everything else.
    """

    response: Response
    u: Mapping[str, float]
    rest: FloatArray

    def covariance(self, source: str, extent: float | FloatArray) -> FloatArray:
        """(…, P, P) covariance of ln L where one input is off by extents (…), and not uncertain itself."""
        k = self.response.sources.index(source)
        z = np.clip(np.asarray(extent) / self.u[source], -FARTHEST, FARTHEST)
        others = np.arange(len(self.response.sources)) != k
        tangent = self.response.slope[:, others] + self.response.bend[:, others, k] * z[..., None, None]
        bend = self.response.bend[:, others][:, :, others]
        alone = self.rest + 0.5 * np.einsum("pab,qab->pq", bend, bend)
        return np.asarray(alone + tangent @ np.swapaxes(tangent, -1, -2))


def inputs_of(recipe: Recipe, expected: Expectation, measured: tuple[Component, ...]) -> Inputs | None:
    """The uncertain inputs of a recipe's prediction that may be causes, in the units of their extents."""
    if expected.response is None:
        return None
    part, rig = recipe.material, recipe.uncertainty
    u = {
        "roughness along the ridges": part.u_alpha_share,
        "roughness across the ridges": part.u_alpha_share,
        "albedo of the plastic": part.u_albedo / part.albedo if part.albedo > 0.0 else 0.0,
        "seating tilt about x": rig.seating_tilt_deg,
        "seating tilt about y": rig.seating_tilt_deg,
        "light angle": rig.light_angle_deg,
    }
    known = {source: value for source, value in u.items() if source in expected.response.sources and value}
    rest = covariance_of(expected.alone + measured, rig.scale_share, len(expected.poses))
    return Inputs(expected.response, known, rest)


def background_of(max_share: float) -> tuple[float, float]:
    """Share of deviating cells on good parts, and its uncertainty.

    All that the limit allows, the less likely the nearer to it: a triangular distribution that falls to 0 at the limit
    (JCGM 100:2008, 4.3.9, one side of it).
    """
    return max_share / 3.0, float(max_share / np.sqrt(18.0))


def whitening(covariance: FloatArray) -> FloatArray:
    """W with WᵀW = V⁻¹ within the range of V: (rank, P)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0.0) * values.size * np.finfo(np.float64).eps
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T)


def share_variance(shares: FloatArray, u_share: float, u_background: float) -> FloatArray:
    """Variances of a share of deviating cells against the (E,) shares that causes predict."""
    return np.asarray(u_share**2 + u_background**2 + SHARE_FLOOR**2 + (SHARE_RELATIVE * shares) ** 2)
