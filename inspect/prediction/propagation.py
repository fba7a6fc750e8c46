"""First-order propagation of uncertainty through a predictor by finite differences of every input."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import principal
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import LONGEST_TAIL
from anisoscope.prediction.sensitivity import (
    ALPHA_RANGE,
    DARK,
    SHAPE_RANGE,
    Budget,
    Contribution,
    Correlation,
    State,
    Surface,
    evaluate,
)

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile

SEATING = "seating tilt about x", "seating tilt about y"
PLASTIC_AND_SEAT = (
    "roughness along the ridges",
    "roughness across the ridges",
    "albedo of the plastic",
    "refractive index",
    "light angle",
    *SEATING,
)
"""Names of the sources that a recipe states of plastic, lamp and seat."""
TAIL = "tail of the lobe"
"""Name of the source that a recipe states for a lobe without measurement."""
RIDGE_ANGLE = "ridge angle of the design"
"""Name of the source that a recipe states of the shape: how much good parts spread."""
UNMEASURED_TAIL = 0.5
"""Tail over which ln L of a plastic with an unmeasured lobe is uncertain in budgets."""
_ANGLE_STEP = 0.1  # degrees
_TAIL_STEP = (
    0.5  # a lobe of no tail gains one; the change is nearly as large per unit over this step as it ever is
)
_FIELD_NODE = np.sqrt(0.6)  # three-point Gauss-Legendre rule on −1…1, weights 5/18, 8/18, 5/18
_STAGE = "stage"
_MATERIAL_SHARE = 0.1  # of the standard uncertainty
_ROUNDING = 1e-9  # of the largest eigenvalue of a covariance


@dataclass(frozen=True, eq=False)
class _Probe:
    """Two states below and above the nominal one, with their distances from it."""

    low: State
    high: State
    below: float
    above: float


@dataclass(frozen=True)
class _Source:
    """A source, the probe of its sensitivity, and its standard uncertainty in the unit of the probe."""

    name: str
    probe: str
    u: float
    correlation: Correlation = "shared"


def _sources(nominal: State, inputs: InputUncertainty) -> list[_Source]:
    material = nominal.material
    return [
        _Source("roughness along the ridges", "alpha_along", inputs.alpha_share * material.alpha_along),
        _Source("roughness across the ridges", "alpha_across", inputs.alpha_share * material.alpha_across),
        _Source("albedo of the plastic", "albedo", inputs.albedo),
        _Source("refractive index", "index", inputs.index),
        _Source(TAIL, "tail", UNMEASURED_TAIL if inputs.tail is None else inputs.tail),
        _Source("light angle", "light", inputs.light_angle_deg),
        _Source("seating tilt about x", "seating_x", inputs.seating_tilt_deg),
        _Source("seating tilt about y", "seating_y", inputs.seating_tilt_deg),
        _Source("stage angle of each pose", _STAGE, inputs.stage_deg, "independent"),
        _Source("zero of the stage", _STAGE, inputs.stage_zero_deg),
        _Source("tilt of each pose", "tilt", inputs.tilt_deg, "independent"),
        _Source("zero of the tilt", "tilt", inputs.tilt_zero_deg),
        _Source(RIDGE_ANGLE, "ridge_angle_deg", inputs.ridge_angle_deg),
        _Source("height loss of the design", "height_loss", inputs.height_loss),
        _Source("height scale of the map", "height_factor", inputs.height_scale_share),
        # a larger pixel flattens all slopes by the same share, and direct light depends on no other length
        _Source("pixel size of the map", "height_factor", -inputs.pixel_size_share),
    ]


def _probe(nominal: State, name: str) -> _Probe:
    material = nominal.material
    if name in ("alpha_along", "alpha_across"):
        value = getattr(material, name)
        return _material_probe(nominal, name, 0.01 * value, ALPHA_RANGE)
    if name == "albedo":
        return _material_probe(nominal, name, 0.01, (0.0, 1.0))
    if name == "index":
        return _material_probe(nominal, name, min(0.005, 0.5 * (material.index - 1.0)), (1.0, 4.0))
    if name == "tail":
        return _material_probe(nominal, name, _TAIL_STEP, (0.0, LONGEST_TAIL))
    if name in SHAPE_RANGE:
        value = getattr(nominal.shape, name)
        step = 0.05 if name == "ridge_angle_deg" else 0.005
        ends = _ends(value, step, SHAPE_RANGE[name])
        low, high = (replace(nominal, shape=replace(nominal.shape, **{name: end})) for end in ends)
        return _Probe(low, high, value - ends[0], ends[1] - value)
    h, light, (x, y) = _ANGLE_STEP, nominal.light_angle_deg, nominal.seating_deg
    changes: dict[str, tuple[State, State]] = {
        "light": (replace(nominal, light_angle_deg=light - h), replace(nominal, light_angle_deg=light + h)),
        "seating_x": (replace(nominal, seating_deg=(x - h, y)), replace(nominal, seating_deg=(x + h, y))),
        "seating_y": (replace(nominal, seating_deg=(x, y - h)), replace(nominal, seating_deg=(x, y + h))),
        _STAGE: (replace(nominal, stage_deg=-h), replace(nominal, stage_deg=h)),
        "tilt": (replace(nominal, tilt_deg=-h), replace(nominal, tilt_deg=h)),
    }
    return _Probe(*changes[name], h, h)


def _ends(value: float, step: float, limits: tuple[float, float]) -> tuple[float, float]:
    return max(value - step, limits[0]), min(value + step, limits[1])


def _material_probe(nominal: State, name: str, step: float, limits: tuple[float, float]) -> _Probe:
    value = getattr(nominal.material, name)
    ends = _ends(value, step, limits)
    changed: list[dict[str, Any]] = [{name: end} for end in ends]
    low, high = (replace(nominal, material=replace(nominal.material, **change)) for change in changed)
    return _Probe(low, high, value - ends[0], ends[1] - value)


def _slope(probe: _Probe, values: FloatArray, middle: FloatArray, radiance: FloatArray) -> FloatArray:
    """(P,) sensitivity of L per unit: by ln L where there is light, by L itself where there is next to none.

    ``values`` are the radiances (low, high) and ``middle`` the nominal ones of the surface that was probed, of which
    ``radiance`` is the nominal one of the surface that is meant.
    """
    down, up = values
    bright = (np.minimum(down, up) > DARK) & (radiance > DARK)
    ratio = np.where(bright, up, 1.0) / np.where(bright, down, 1.0)
    change = np.where(bright, radiance * np.log(ratio), (up - down) * _gain(middle, radiance))
    return np.asarray(change / (probe.below + probe.above))


def _gain(middle: FloatArray, radiance: FloatArray) -> FloatArray:
    """(P,) ratio of the intended radiance to the probed one; 1 where either is dark."""
    bright = (middle > DARK) & (radiance > DARK)
    return np.where(bright, radiance / np.where(bright, middle, 1.0), 1.0)


def _curvature(probe: _Probe, values: FloatArray, middle: FloatArray, u: float) -> FloatArray:
    """(P,) |L''|·u²/√2, the second-order part of the standard deviation for a normal input.

    At a physical limit half the distribution is cut off, and the first order itself is in doubt.
    """
    if min(probe.below, probe.above) <= 0.0:
        return np.asarray(np.abs(values[1] - values[0]) / (probe.below + probe.above) * abs(u))
    bend = (values[1] - middle) / probe.above - (middle - values[0]) / probe.below
    return np.asarray(np.abs(bend) * 2.0 / (probe.below + probe.above) * u**2 / np.sqrt(2.0))


def propagate(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
    *,
    radiance: FloatArray | None = None,
    additional: Sequence[Contribution] = (),
    on_progress: Advance = silent,
) -> Budget:
    """Budget of the pose radiances to first order, by central differences.

    Steps are 1 % of a roughness, 0.01 of the albedo, 0.005 of the index, 0.1° of an angle (0.05° of the ridge angle),
    0.005 of height loss and scale; one-sided at a physical limit. Sources without uncertainty cost nothing.

    Args:
        surface: predictor of a shape; `prediction.sensitivity.fixed` makes one of any model.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted; its light angle is that of ``nominal``.
        inputs: standard uncertainties of the inputs.
        radiance: (P,) nominal radiances where ``surface`` is a cheaper stand-in (part of a map); else its own.
        additional: contributions that are not those of an input, such as the scatter of the ridges.
        on_progress: called at every call of the predictor.

    Raises:
        ModelError: a pose so close to the horizon that a step leads below it.
    """
    sources = _sources(nominal, inputs)
    probes = {source.probe: _probe(nominal, source.probe) for source in sources if source.u != 0.0}
    probes.setdefault(_STAGE, _probe(nominal, _STAGE))
    field = _over_the_field(nominal, inputs.light_field_deg)
    states = [nominal, *field, *(end for probe in probes.values() for end in (probe.low, probe.high))]
    values = evaluate(surface, states, poses, convention, on_progress)
    middle, first = values[0], 1 + len(field)
    meant = middle if radiance is None else radiance
    found = {name: values[first + 2 * k : first + 2 * k + 2] for k, name in enumerate(probes)}
    gain, zero = _gain(middle, meant), np.zeros(middle.size)
    contributions = []
    for source in sources:
        if source.u != 0.0:
            probe, pair = probes[source.probe], found[source.probe]
            change = _slope(probe, pair, middle, meant) * source.u
            bend = gain * _curvature(probe, pair, middle, source.u)
            contributions.append(Contribution(source.name, change, source.correlation, curvature=bend))
        elif source.probe not in SHAPE_RANGE:  # designs have no scale, maps no ridge angle: not in the budget
            contributions.append(Contribution(source.name, zero, source.correlation))
    if field:
        shift = gain * 5.0 / 18.0 * (values[1] + values[2] - 2.0 * middle)
        contributions.append(Contribution("light angle over the field", shift))
    per_degree = _slope(probes[_STAGE], found[_STAGE], middle, meant)
    return Budget(meant, (*contributions, *additional), per_degree)


def input_slopes(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """(P,) radiances, and by source the (P,) change of ln L by one standard uncertainty, without a budget.

    Arguments and steps as for `propagate`; only sources with an uncertainty cost anything. Of dark poses the changes
    mean nothing.
    """
    sources = [source for source in _sources(nominal, inputs) if source.u != 0.0]
    probes = {source.probe: _probe(nominal, source.probe) for source in sources}
    states = [nominal, *(end for probe in probes.values() for end in (probe.low, probe.high))]
    middle, *ends = evaluate(surface, states, poses, convention)
    pairs = {name: np.array(ends[2 * k : 2 * k + 2]) for k, name in enumerate(probes)}
    lit = np.maximum(middle, DARK)
    slopes = {
        one.name: _slope(probes[one.probe], pairs[one.probe], middle, middle) * one.u / lit for one in sources
    }
    return middle, slopes


def calibrated_material(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    file: "MaterialFile",
) -> FloatArray:
    """(K, P) changes of ln L, independent of each other, that a calibrated material leaves at its tail.

    Its parameters are correlated, so that one source for each would state too much. Their covariance at a given tail is
    C = Σ_k v_k v_kᵀ with K orthogonal vectors; the covariance of ln L is J C Jᵀ = Σ_k (J v_k)(J v_k)ᵀ (JCGM 102:2011,
    6.2), and every J v_k is a central difference over v_k, which may be large, of a tenth of it. The tail itself, with
    what follows it on average, is a source of its own along its curve (`lobe_doubt`).

    Args:
        surface: the predictor of a shape.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted.
        file: the material with its covariance.
    """
    from anisoscope.recipe.material_file import material_at  # noqa: PLC0415 - pydantic, for a recipe only

    names, values = file.covariance.parameters, file.values()
    _, covariance = file.covariance.given_tail()
    size, directions = principal(covariance)
    moves = (np.sqrt(np.maximum(size, 0.0))[:, None] * directions)[size > _ROUNDING * size[-1]]
    moves[:, [name == "tail" for name in names]] = 0.0

    def at(moved: FloatArray) -> State:
        return replace(nominal, material=material_at(nominal.material, names, moved))

    ends = [at(values + side * move) for move in moves for side in (-_MATERIAL_SHARE, _MATERIAL_SHARE)]
    if not ends:
        return np.zeros((0, len(poses)))
    light = evaluate(surface, ends, poses, convention)
    change = np.diff(np.log(np.maximum(light, DARK)).reshape(len(moves), 2, -1), axis=1)[:, 0]
    return np.asarray(change / (2.0 * _MATERIAL_SHARE))


def _over_the_field(nominal: State, half_width_deg: float) -> list[State]:
    """The outer nodes of the rule over the light angles of the field; none where it does not vary."""
    if half_width_deg == 0.0:
        return []
    reach = half_width_deg * float(_FIELD_NODE)
    return [replace(nominal, light_angle_deg=nominal.light_angle_deg + side * reach) for side in (-1.0, 1.0)]
