"""Evidence of a diagnosis: deviation and covariance, share of deviating cells, and uncertain inputs."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import ROUNDING, root
from anisoscope.diagnosis.tangents import Tangents
from anisoscope.imaging.defect_regions import MarkForm
from anisoscope.prediction.expectation import Component, Expectation, part_uncertainty
from anisoscope.prediction.propagation import RIDGE_ANGLE
from anisoscope.prediction.second_order import Response
from anisoscope.recipe.surface import SurfaceRecipe

FARTHEST = 6.0  # range in u about the nominal state within which the second order is valid
SHARE_FLOOR = 0.003  # cells that deviate on one good part and not on another
SHARE_RELATIVE = 0.3  # uncertainty of a predicted share of deviating cells: size and form of real marks vary
Acting = tuple[float | FloatArray, Tangents | None]
"""Extents (…) of a cause, and the response of ln L to the inputs along it."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of a diagnosis.

    Attributes:
        deviation: (P,) ln L measured − ln L predicted.
        covariance: (P, P) of it on a part as predicted, the scale included.
        share: share of cells that deviate in the contrast map, or None.
        u_share: its standard uncertainty.
        background: share of cells that deviate on good parts.
        u_background: its standard uncertainty.
        inputs: of the prediction, that may be causes too, or None.
        learnt: scatter learnt from golden parts if the deviation is from their mean, or None.
        share_relative: relative standard uncertainty of a share of deviating cells that a signature predicts.
        share_floor: standard uncertainty of any such share.
        form: of the cells that deviate, or None.
        pitch: by how much the pitch that was measured in the pictures is off, and its standard uncertainty, in the
            unit of the cause "pitch"; None where it was not measured.
    """

    deviation: FloatArray
    covariance: FloatArray
    share: float | None = None
    u_share: float = 0.0
    background: float = 0.0
    u_background: float = 0.0
    inputs: "Inputs | None" = None
    learnt: "Learnt | None" = None
    share_relative: float = SHARE_RELATIVE
    share_floor: float = SHARE_FLOOR
    pitch: tuple[float, float] | None = None
    form: MarkForm | None = None

    @property
    def data(self) -> int:
        """Number of data."""
        more = (self.share is not None) + (self.pitch is not None) + 3 * (self.form is not None)
        return len(self.deviation) + more

    def share_variance(self, shares: FloatArray) -> FloatArray:
        """(E,) variances of the share against the (E,) shares that causes predict."""
        return share_variance(shares, self.u_share, self.u_background, self.share_relative, self.share_floor)

    @property
    def good(self) -> FloatArray:
        """(P, P) covariance of the deviation of a good part."""
        stated = self.stated()
        return stated if self.learnt is None else self.learnt.applied(stated)

    def stated(self, sources: Collection[str] = (), causes: Sequence[Acting] = ()) -> FloatArray:
        """(…, P, P) covariance as the budget states it; arguments as for `Inputs.covariance`."""
        return self.covariance if self.inputs is None else self.inputs.covariance(sources, causes)


@dataclass(frozen=True, eq=False)
class Learnt:
    """Scatter of good parts and error of the model, learnt from golden parts.

    The scatter of n parts is known to n − 1 degrees of freedom only, so that the stated covariance goes in as a prior
    (inverse Wishart, worth as many parts as there are poses; Gelman et al., Bayesian Data Analysis, 3.6): few parts
    leave it as it is, many replace it. What a cause makes of the stated one it makes of theirs.

    Attributes:
        scatter: (P, P) covariance of the distance of a good part from the mean of the golden ones, in units of the
            root of the stated covariance.
        freedom: degrees of freedom to which it is known.
        misfit: (P,) relative doubt of every change of ln L: by how much the mean of the golden parts lies off the
            prediction in that pose, and on average over the poses, the scale aside. A model that misses L by a share
            misses its changes by that share at least, and the agreement in one pose may be accidental.
    """

    scatter: FloatArray
    freedom: float
    misfit: FloatArray

    def applied(self, stated: FloatArray) -> FloatArray:
        """(…, P, P) covariances of the deviation from golden parts, from (…, P, P) stated ones."""
        half = root(stated, least=ROUNDING)
        return np.asarray(half @ self.scatter @ half)


def against(evidence: Evidence, golden: FloatArray, scale_share: float) -> Evidence:
    """Evidence relative to golden parts instead of the prediction: the model's own error cancels.

    Args:
        evidence: against the prediction.
        golden: (n, P) ln L of golden parts over the predicted ones, n ≥ 1.
        scale_share: relative standard uncertainty of a scale that all poses share: golden parts need not show it.
    """
    count, poses = golden.shape
    mean, stated = golden.mean(axis=0), evidence.stated()
    half = root(stated, least=ROUNDING)
    own = (np.cov(golden, rowvar=False) if count > 1 else np.zeros_like(half)) + scale_share**2
    whitened = np.linalg.solve(half, np.linalg.solve(half, own).T)
    known = float(poses + count - 1)
    scatter = (poses * np.eye(poses) + (count - 1) * whitened) / known * (1.0 + 1.0 / count)
    freedom = max(known, poses + 1.0)  # a share of the area is one value more than there are poses
    off = mean - np.median(mean)
    learnt = Learnt(scatter, freedom, np.hypot(off, np.sqrt(np.mean(off**2))))
    return replace(evidence, deviation=evidence.deviation - mean, learnt=learnt)


def covariance_of(components: tuple[Component, ...], scale_share: float, poses: int) -> FloatArray:
    """(P, P) covariance of ln L from all sources, and a scale common to all poses."""
    total = np.full((poses, poses), scale_share**2)
    for component in components:
        total += component.covariance()
    return total


@dataclass(frozen=True, eq=False)
class Inputs:
    """Uncertain inputs of the prediction that may be causes themselves.

    Attributes:
        response: of ln L to the inputs, in units of their standard uncertainties.
        u: standard uncertainties of inputs by name, in the unit of the cause's extent.
        rest: (P, P) covariance of all other sources.
        units: (K,) standard uncertainties of the response's inputs, in the units of `Tangents`.
    """

    response: Response
    u: Mapping[str, float]
    rest: FloatArray
    units: FloatArray

    def covariance(self, sources: Collection[str] = (), causes: Sequence[Acting] = ()) -> FloatArray:
        """(…, P, P) covariance of ln L where causes have extents (…).

        Args:
            sources: the inputs identical with a cause: they are shifted by its extent, and not uncertain themselves.
            causes: extents (…) of every cause, and the response of the part to the inputs along it. Without a response
                it is that of the good part, to second order.
        """
        others = np.array([name not in sources for name in self.response.sources])
        tangent = self.response.slope
        for extent, tangents in causes:
            if tangents is not None:
                tangent = tangent + tangents.change(extent, self.response.sources) * self.units
                continue
            for name in sources:
                k = self.response.sources.index(name)
                z = np.clip(np.asarray(extent) / self.u[name], -FARTHEST, FARTHEST)
                tangent = tangent + self.response.bend[:, :, k] * z[..., None, None]
        tangent = tangent[..., others]
        bend = self.response.bend[:, others][:, :, others]
        alone = self.rest + 0.5 * np.einsum("pab,qab->pq", bend, bend)
        return np.asarray(alone + tangent @ np.swapaxes(tangent, -1, -2))

    def of(self, poses: Sequence[int]) -> "Inputs":
        """Restrict to selected poses."""
        selected = list(poses)
        whole = self.response
        response = Response(whole.sources, whole.slope[selected], whole.bend[selected])
        return replace(self, response=response, rest=self.rest[np.ix_(selected, selected)])


def inputs_of(recipe: SurfaceRecipe, expected: Expectation, measured: tuple[Component, ...]) -> Inputs | None:
    """Uncertain inputs of a recipe's prediction; those that may be causes in the units of their extents."""
    if expected.response is None:
        return None
    of_part, albedo, sources = part_uncertainty(recipe), recipe.material.albedo, expected.response.sources
    units = {
        "roughness along the ridges": of_part.alpha_share,
        "roughness across the ridges": of_part.alpha_share,
        "albedo of the plastic": of_part.albedo,
        "refractive index": of_part.index,
        "seating tilt about x": of_part.seating_tilt_deg,
        "seating tilt about y": of_part.seating_tilt_deg,
        "light angle": of_part.light_angle_deg,
        RIDGE_ANGLE: of_part.ridge_angle_deg,
    }
    u = {**units, "albedo of the plastic": of_part.albedo / albedo if albedo > 0.0 else 0.0}
    del u["refractive index"]
    known = {source: value for source, value in u.items() if source in sources and value}
    rest = covariance_of(expected.alone + measured, recipe.uncertainty.scale_share, len(expected.poses))
    return Inputs(expected.response, known, rest, np.array([units.get(source, 0.0) for source in sources]))


def background_of(max_share: float) -> tuple[float, float]:
    """Share of deviating cells on good parts, and its uncertainty.

    Any share within the limit, with a probability that decreases towards it: a triangular distribution, 0 at the limit
    (JCGM 100:2008, 4.3.9, one side of it).
    """
    return max_share / 3.0, float(max_share / np.sqrt(18.0))


def background_of_parts(shares: Sequence[float]) -> tuple[float, float]:
    """Share of deviating cells on good parts, and its uncertainty for one more, from golden parts.

    The scatter between parts is that of theirs, with `SHARE_FLOOR` as a prior worth two parts (scaled inverse χ²;
    Gelman et al., Bayesian Data Analysis, 3.3).

    Args:
        shares: of golden parts, one or more.
    """
    found, count = np.asarray(shares, dtype=np.float64), len(shares)
    squares = 2.0 * SHARE_FLOOR**2 + float(np.sum((found - found.mean()) ** 2))
    return float(found.mean()), float(np.sqrt(squares / (count + 1.0) * (1.0 + 1.0 / count)))


def share_variance(
    shares: FloatArray,
    u_share: float,
    u_background: float,
    relative: float = SHARE_RELATIVE,
    floor: float = SHARE_FLOOR,
) -> FloatArray:
    """Variances of a share of deviating cells about the (E,) shares that causes predict."""
    return np.asarray(u_share**2 + u_background**2 + floor**2 + (relative * shares) ** 2)
