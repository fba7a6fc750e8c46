"""Uncertainty by Monte Carlo (JCGM 101:2008): joint draws of all inputs through the full model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import root
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import LONGEST_TAIL, Material
from anisoscope.prediction.contrast_uncertainty import contrast_values
from anisoscope.prediction.sensitivity import (
    ALPHA_RANGE,
    DARK,
    SHAPE_RANGE,
    Budget,
    Contribution,
    Shape,
    State,
    Surface,
    evaluate,
)

MIN_DRAWS = 10
_NODES = ((-0.774596669241, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.774596669241, 5.0 / 18.0))  # Gauss-Legendre


@dataclass(frozen=True)
class MonteCarlo:
    """Settings of a Monte Carlo check of the uncertainty.

    Attributes:
        draws: number of draws, at least 10.
        seed: of the generator.
    """

    draws: int
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Drawn:
    """Radiances of N draws.

    Attributes:
        poses: P poses.
        radiance: (N, P) in 1/sr.
    """

    poses: tuple[Pose, ...]
    radiance: FloatArray

    def covariance(self) -> FloatArray:
        """(P, P) covariance of the radiances in 1/sr²."""
        return np.atleast_2d(np.cov(self.radiance.T))

    def u(self) -> FloatArray:
        """(P,) standard deviations in 1/sr."""
        return np.asarray(np.std(self.radiance, axis=0, ddof=1))

    def contrast_covariance(self, kind: str) -> FloatArray:
        """(C, C) covariance of the contrasts of the draws; infinite variance where a draw leaves one undefined."""
        values = contrast_values(self.poses, self.radiance, kind)
        defined = np.isfinite(values).all(axis=0)
        found = np.atleast_2d(np.cov(np.where(defined, values, 0.0).T)).reshape(defined.size, defined.size)
        found[~defined, ~defined] = np.inf
        return np.asarray(found)

    @property
    def u_error_share(self) -> float:
        """Relative standard uncertainty of a u from this many draws, 1/√(2(N − 1))."""
        return float(1.0 / np.sqrt(2.0 * (len(self.radiance) - 1)))


def draw(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
    draws: int,
    rng: np.random.Generator,
    *,
    radiance: FloatArray | None = None,
    additional: Sequence[Contribution] = (),
    on_progress: Advance = silent,
) -> Drawn:
    """Predict for draws of all inputs from their distributions.

    Inputs are normal, truncated at their physical limits; the variation of the light angle over the field is
    averaged in every draw. Additional contributions are drawn with their covariance, the rectangular ones evenly.

    Args:
        surface: predictor of a shape.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted.
        inputs: standard uncertainties.
        draws: N, at least 10.
        rng: generator.
        radiance: (P,) nominal radiances where ``surface`` is a stand-in; changes are then taken relative to its own.
        additional: contributions that are not those of an input.
        on_progress: called at every draw.

    Raises:
        ModelError: too few draws, or a draw with light or camera at or below the horizon.
    """
    if draws < MIN_DRAWS:
        raise ModelError(f"a Monte Carlo needs at least {MIN_DRAWS} draws, not {draws}")
    middle = evaluate(surface, [nominal], poses, convention)[0]
    meant = middle if radiance is None else radiance
    bright = (middle > DARK) & (meant > DARK)
    gain = np.where(bright, meant / np.where(bright, middle, 1.0), 1.0)
    found = np.empty((draws, len(poses)))
    for number in range(draws):
        on_progress("Monte Carlo", number, draws)
        states = _drawn_states(nominal, len(poses), inputs, rng)
        values = evaluate(surface, [state for state, _ in states], poses, convention)
        found[number] = gain * (np.array([weight for _, weight in states]) @ values)
    for contribution in additional:
        found += deviation(contribution, draws, rng) * np.where(
            bright, found / np.where(bright, meant, 1.0), 1.0
        )
    return Drawn(poses, np.maximum(found, 0.0))


def _drawn_states(
    nominal: State, count: int, inputs: InputUncertainty, rng: np.random.Generator
) -> list[tuple[State, float]]:
    """One draw: a state, or three with their weights where the light angle varies over the field."""
    plastic, shape = nominal.material, nominal.shape

    def near(value: float, u: float, limits: tuple[float, float]) -> float:
        return float(np.clip(value + u * rng.standard_normal(), *limits)) if u > 0.0 else value

    material = Material(
        near(plastic.alpha_along, inputs.alpha_share * plastic.alpha_along, ALPHA_RANGE),
        near(plastic.alpha_across, inputs.alpha_share * plastic.alpha_across, ALPHA_RANGE),
        near(plastic.albedo, inputs.albedo, (0.0, 1.0)),
        near(plastic.index, inputs.index, (1.0 + 1e-6, 4.0)),
        plastic.internal_reflection,
        near(plastic.tail, inputs.tail or 0.0, (0.0, LONGEST_TAIL)),
        plastic.second_lobe,
    )
    factor = near(shape.height_factor, inputs.height_scale_share, SHAPE_RANGE["height_factor"])
    drawn = Shape(
        near(shape.ridge_angle_deg, inputs.ridge_angle_deg, SHAPE_RANGE["ridge_angle_deg"]),
        near(shape.height_loss, inputs.height_loss, SHAPE_RANGE["height_loss"]),
        factor / near(1.0, inputs.pixel_size_share, (0.01, 100.0)),
    )
    turned, tilted = (
        own * rng.standard_normal(count) + zero * rng.standard_normal()
        for own, zero in ((inputs.stage_deg, inputs.stage_zero_deg), (inputs.tilt_deg, inputs.tilt_zero_deg))
    )
    about_x, about_y = inputs.seating_tilt_deg * rng.standard_normal(2)
    light = nominal.light_angle_deg + inputs.light_angle_deg * rng.standard_normal()
    half = inputs.light_field_deg
    nodes = _NODES if half > 0.0 else ((0.0, 1.0),)
    return [
        (State(material, light + node * half, turned, tilted, (about_x, about_y), drawn), weight)
        for node, weight in nodes
    ]


def deviation(contribution: Contribution, draws: int, rng: np.random.Generator) -> FloatArray:
    """(N, P) random deviations of a contribution in 1/sr."""
    u = contribution.absolute
    if contribution.matrix is not None:
        return np.asarray(rng.standard_normal((draws, u.size)) @ root(contribution.matrix))
    size = (draws, 1 if contribution.correlation == "shared" else u.size)
    if contribution.rectangular:
        return np.asarray(u * np.sqrt(3.0) * rng.uniform(-1.0, 1.0, size))
    return np.asarray(u * rng.standard_normal(size))


def disagreement(budget: Budget, drawn: Drawn) -> FloatArray:
    """(P,) u of the draws over that of first-order propagation, minus 1; 0 where both vanish."""
    linear, found = budget.first_order().u(), drawn.u()
    both = np.maximum(linear, found) > DARK
    return np.where(both, found / np.maximum(linear, DARK) - 1.0, 0.0)
