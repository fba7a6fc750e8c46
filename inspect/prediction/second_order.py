"""Second-order response of ln L of all poses to their shared inputs.

An uncertain input (roughness, albedo, seating, …) moves all poses together along a curve, and good parts scatter about
that curve. A covariance represents its tangent only: where the bend of the curve exceeds the camera's errors, the
Mahalanobis distance rejects too many good parts. So the curve itself is represented, to second order, and the distance
of a part is that from its nearest point (`profile_likelihood`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import root
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.prediction.propagation import RIDGE_ANGLE
from anisoscope.prediction.sensitivity import ALPHA_RANGE, DARK, SHAPE_RANGE, State, Surface, evaluate

INDEX_RANGE = (1.0, 4.0)
_LEAST_STEP = 0.2  # in u; an input nearer to its physical limit than that is taken as linear
_SEAT = {"seating tilt about x": 0, "seating tilt about y": 1}
_MATERIAL = {
    "roughness along the ridges": ("alpha_along", ALPHA_RANGE),
    "roughness across the ridges": ("alpha_across", ALPHA_RANGE),
    "albedo of the plastic": ("albedo", (0.0, 1.0)),
    "refractive index": ("index", INDEX_RANGE),
}


@dataclass(frozen=True, eq=False)
class Response:
    """Change of P values with K inputs, f(z) = Gz + ½ zᵀHz, every input in units of its standard uncertainty.

    Attributes:
        sources: K names of the inputs.
        slope: (P, K) G.
        bend: (P, K, K) H, symmetric.
    """

    sources: tuple[str, ...]
    slope: FloatArray
    bend: FloatArray

    def change(self, z: FloatArray) -> FloatArray:
        """(…, P) change at inputs (…, K)."""
        half = np.tensordot(z, 0.5 * self.bend, axes=(-1, 2))
        return np.asarray(((half + self.slope) @ z[..., None])[..., 0])

    def tangent(self, z: FloatArray) -> FloatArray:
        """(…, P, K) derivative at inputs (…, K)."""
        return np.asarray(self.slope + np.tensordot(z, self.bend, axes=(-1, 2)))

    def within(self, basis: FloatArray) -> "Response":
        """The response of combinations (m, P) of the values."""
        return Response(self.sources, basis @ self.slope, np.einsum("ip,pab->iab", basis, self.bend))

    def with_linear(self, source: str, slope: FloatArray) -> "Response":
        """The response with one input more, of slope (P,), which acts in proportion and alone."""
        bend = np.pad(self.bend, ((0, 0), (0, 1), (0, 1)))
        return Response((*self.sources, source), np.column_stack([self.slope, slope]), bend)

    def draw(self, covariance: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
        """(count, P) random errors: of normal inputs, plus independent ones with a covariance."""
        alone = rng.standard_normal((count, len(covariance))) @ root(covariance)
        return np.asarray(alone + self.change(rng.standard_normal((count, len(self.sources)))))


@dataclass(frozen=True, eq=False)
class RowResponses:
    """N responses to the same inputs, each for one row of them.

    Attributes:
        sources: K names of the inputs.
        slope: (N, P, K) G of every row.
        bend: (N, P, K, K) H of every row, symmetric.
    """

    sources: tuple[str, ...]
    slope: FloatArray
    bend: FloatArray

    def change(self, z: FloatArray) -> FloatArray:
        """(N, P) change at inputs (N, K)."""
        half = 0.5 * (self.bend @ z[:, None, :, None])[..., 0]
        return np.asarray(((half + self.slope) @ z[..., None])[..., 0])

    def tangent(self, z: FloatArray) -> FloatArray:
        """(N, P, K) derivative at inputs (N, K)."""
        return np.asarray(self.slope + (self.bend @ z[:, None, :, None])[..., 0])

    def row(self, number: int) -> Response:
        """The response of one row."""
        return Response(self.sources, self.slope[number], self.bend[number])


def response_of(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
    straight: dict[str, FloatArray],
) -> Response | None:
    """Second-order response of ln L, from probes one u to either side of every input and of every pair.

    Args:
        surface: the predictor of a shape.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted.
        inputs: standard uncertainties of the inputs.
        straight: (P,) change of ln L per u of every uncertain input, for those that cannot be probed.

    Returns:
        The response, or None where a probe finds no light, so that ln L has no second order.

    Raises:
        ModelError: a pose so close to the horizon that a probe leads below it.
    """
    names = tuple(straight)
    steps = np.array([_step(nominal, name, inputs) for name in names])
    offsets = _offsets(steps)
    states = [_moved(nominal, dict(zip(names, offset, strict=True)), inputs) for offset in offsets]
    radiance = evaluate(surface, states, poses, convention)
    if np.any(radiance <= DARK):
        return None
    change = np.log(radiance / radiance[0])
    slope = np.column_stack([straight[name] for name in names])
    bend = np.zeros((len(poses), len(names), len(names)))
    at = {tuple(offset): row for offset, row in zip(offsets, change, strict=True)}
    unit = np.diag(steps)
    for a in range(len(names)):
        if steps[a] > 0.0:
            up, down = at[tuple(unit[a])], at[tuple(-unit[a])]
            slope[:, a] = (up - down) / (2.0 * steps[a])
            bend[:, a, a] = (up + down) / steps[a] ** 2
        for b in range(a):
            if steps[a] > 0.0 and steps[b] > 0.0:
                both, alone = at[tuple(unit[a] + unit[b])], at[tuple(unit[a])] + at[tuple(unit[b])]
                bend[:, a, b] = bend[:, b, a] = (both - alone) / (steps[a] * steps[b])
    return Response(names, slope, bend)


def _offsets(steps: FloatArray) -> list[FloatArray]:
    """Probed states in units of u: the nominal one, steps along every input, and along every pair."""
    unit = np.diag(steps)
    bent = [k for k in range(len(steps)) if steps[k] > 0.0]
    ends = [sign * unit[k] for k in bent for sign in (-1.0, 1.0)]
    return [np.zeros(len(steps)), *ends, *(unit[a] + unit[b] for a in bent for b in bent if b < a)]


def _step(nominal: State, name: str, inputs: InputUncertainty) -> float:
    """Step of the probe in u, at most one; 0 where it would be too small to determine a bend."""
    if name == RIDGE_ANGLE:
        value, (low, high) = nominal.shape.ridge_angle_deg, SHAPE_RANGE["ridge_angle_deg"]
    elif name in _MATERIAL:
        field, (low, high) = _MATERIAL[name]
        value = getattr(nominal.material, field)
    else:
        return 1.0
    room = 0.99 * min(value - low, high - value) / _u(nominal, name, inputs)
    return float(min(room, 1.0)) if room >= _LEAST_STEP else 0.0


def _u(nominal: State, name: str, inputs: InputUncertainty) -> float:
    if name in _SEAT:
        return inputs.seating_tilt_deg
    if name == "light angle":
        return inputs.light_angle_deg
    if name == RIDGE_ANGLE:
        return inputs.ridge_angle_deg
    field, _ = _MATERIAL[name]
    if field in ("albedo", "index"):
        return float(getattr(inputs, field))
    return float(inputs.alpha_share * getattr(nominal.material, field))


def _moved(nominal: State, offset: dict[str, float], inputs: InputUncertainty) -> State:
    material, light, seat = nominal.material, nominal.light_angle_deg, list(nominal.seating_deg)
    shape = nominal.shape
    for name, share in offset.items():
        step = float(share) * _u(nominal, name, inputs)
        if step == 0.0:
            continue
        if name in _SEAT:
            seat[_SEAT[name]] += step
        elif name == "light angle":
            light += step
        elif name == RIDGE_ANGLE:
            shape = replace(shape, ridge_angle_deg=shape.ridge_angle_deg + step)
        else:
            field, _ = _MATERIAL[name]
            material = replace(material, **{field: getattr(material, field) + step})
    return replace(
        nominal, material=material, light_angle_deg=light, seating_deg=(seat[0], seat[1]), shape=shape
    )


def known_inputs(sources: Sequence[str]) -> tuple[str, ...]:
    """The sources of uncertainty whose inputs can be probed."""
    known = {*_MATERIAL, *_SEAT, "light angle", RIDGE_ANGLE}
    return tuple(source for source in sources if source in known)
