"""How ln L of good parts scatters on one rig, and what the smallest interesting defects change of it.

What is not known of rig and material ([uncertainty], [material]) is common to all parts of a rig; what differs from
part to part ([scatter]) is not. Both act through the same inputs, so one response to second order serves for both.
"""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.errors import HeightMapError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.prediction.cache import prediction_key
from anisoscope.prediction.crest_edges import crest_edges, worn_edges
from anisoscope.prediction.crests import EDGE_RADIUS, CrestEdges
from anisoscope.prediction.expectation import (
    PLASTIC,
    SurfaceOptics,
    nominal_shape,
    recipe_uncertainty,
)
from anisoscope.prediction.lobe_doubt import likely_tails
from anisoscope.prediction.propagation import RIDGE_ANGLE, propagate
from anisoscope.prediction.recipe_models import read_surface
from anisoscope.prediction.reflections import fitted_groove
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import ridge_edges
from anisoscope.prediction.second_order import Response, known_inputs, response_of
from anisoscope.prediction.sensitivity import DARK, State, Surface, evaluate
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.recipe.surface import DesignPart, SurfaceRecipe

CAMERA_SHARE = 0.003
"""Relative standard uncertainty of a pose by camera and lamp, where no inspection states it."""


@dataclass(frozen=True, eq=False)
class PartScatter:
    """Response of ln L of P poses to what differs between good parts, and to what is common to them.

    Attributes:
        response: to K inputs, each in the unit √(u² + s²) of its uncertainty and its scatter between parts.
        lobes: the same with every tail that the lobe may as likely have; only the first one where it is known.
        common: (K,) u in that unit.
        own: (K,) s in that unit.
        changes: (L, P) change of ln L by every named defect at its smallest interesting size, with each of L lobes.
        tails: (L,) of the lobes.
        states: of those that are a state of one input, the input and how far it is off, in that unit.
        prior_parts: number of golden parts as which the scatter counts; None: they show how large it is.
    """

    response: Response
    lobes: tuple[Response, ...]
    common: FloatArray
    own: FloatArray
    changes: Mapping[str, FloatArray]
    tails: FloatArray
    states: Mapping[str, tuple[str, float]]
    prior_parts: int | None = None

    @property
    def defects(self) -> dict[str, FloatArray]:
        """(P,) changes by the named defects, the mean over the lobes."""
        return {name: np.mean(change, axis=0) for name, change in self.changes.items()}


def part_scatter(
    recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics = PLASTIC
) -> PartScatter | None:
    """Scatter of good parts of a recipe on one rig, from the cache where it is known.

    Args:
        recipe: the recipe.
        light_angle_deg: the rig's angle between light and camera.
        optics: of its kind of surface.

    Returns:
        The scatter; None where ln L has no response to second order (a kind with states of its own, or no light in a
        state nearby).

    Raises:
        HeightMapError, RecipeError: as for `expectation.expectation`.
    """
    recipe = recipe.deciding()
    if optics.states(recipe, light_angle_deg) is not None:
        return None
    key = prediction_key(recipe, light_angle_deg, optics) | {
        "scatter": recipe.stated_scatter.model_dump(mode="json", exclude={"prior_parts"}),
        "defects": recipe.defects.model_dump(mode="json"),
    }
    found = (
        Cache()
        .entry("part-scatter", key, __name__, type(optics).__module__)
        .result(lambda: _computed(recipe, light_angle_deg, optics), _packed, _unpacked)
    )
    prior = recipe.stated_scatter.prior_parts
    return found if found is None or prior is None else replace(found, prior_parts=prior)


def _computed(recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics) -> PartScatter | None:
    try:
        recipe = with_design(recipe)
    except HeightMapError:  # no ridges of which an angle could scatter
        return None
    poses = recipe.poses.poses()
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    models = optics.models(recipe, poses, convention)
    nominal = State(recipe.material.material(), light_angle_deg, shape=nominal_shape(recipe))
    common, own = recipe_uncertainty(recipe), scatter_of_inputs(recipe)
    both = replace(
        common,
        alpha_share=float(np.hypot(common.alpha_share, own.alpha_share)),
        albedo=float(np.hypot(common.albedo, own.albedo)),
        seating_tilt_deg=own.seating_tilt_deg,
        ridge_angle_deg=own.ridge_angle_deg,
    )
    # waves know no tail: of what they predict the scatter is that of the nominal lobe
    tails = (
        likely_tails(nominal.material.tail, recipe.material.u_tail)
        if models.rays is None
        else (nominal.material.tail,)
    )
    found = [
        _with_lobe(models.sampled, recipe, _of_tail(nominal, tail), poses, convention, both)
        for tail in (nominal.material.tail, *tails)
    ]
    known = [one for one in found if one is not None]
    if len(known) < len(found):
        return None
    response, _, edges = known[0]
    shares = np.array([_shares(source, common, own, edges) for source in response.sources])
    lobes = known[1:]
    names = [name for name in lobes[0][1] if all(name in changes for _, changes, _ in lobes)]
    changed = {name: np.array([changes[name] for _, changes, _ in lobes]) for name in names}
    return PartScatter(
        response,
        tuple(one for one, _, _ in lobes),
        shares[:, 0],
        shares[:, 1],
        changed,
        np.array(tails),
        {
            name: state
            for name, state in _states_of_defects(recipe, both).items()
            if name in changed and state[0] in response.sources
        },
    )


def _states_of_defects(recipe: SurfaceRecipe, both: InputUncertainty) -> dict[str, tuple[str, float]]:
    """Input of every named defect that is a state of one, and how far it is off in the unit of the response."""
    turned, back, _, along, across, *_ = (one.name for one in named_defects(recipe))
    size = recipe.defects
    states: dict[str, tuple[str, float]] = {}
    if both.ridge_angle_deg > 0.0:
        turn = size.ridge_angle_deg / both.ridge_angle_deg
        states |= {turned: (RIDGE_ANGLE, turn), back: (RIDGE_ANGLE, -turn)}
    if both.alpha_share > 0.0:
        rougher = size.roughness_share / both.alpha_share
        states[along] = ("roughness along the ridges", rougher)
        states[across] = ("roughness across the ridges", rougher)
    return states


def _of_tail(nominal: State, tail: float) -> State:
    return replace(nominal, material=replace(nominal.material, tail=tail))


def _with_lobe(
    surface: Surface,
    recipe: SurfaceRecipe,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    both: InputUncertainty,
) -> tuple[Response, dict[str, FloatArray], CrestEdges | None] | None:
    """Response to what differs and what is common, changes by the defects, and crests, of one lobe; None without."""
    radiance = evaluate(surface, [nominal], poses, convention)[0]
    if np.any(radiance <= DARK):
        return None
    budget = propagate(surface, nominal, poses, convention, both, radiance=radiance)
    per_unit = {c.source: c.absolute / radiance for c in budget.contributions if np.any(c.absolute)}
    straight = {source: per_unit[source] for source in known_inputs(tuple(per_unit))}
    response = response_of(surface, nominal, poses, convention, both, straight) if straight else None
    if response is None:
        return None
    edges = crest_edges(recipe, nominal.material, convention)
    if edges is not None:
        unit_um = float(np.hypot(edges.u_um, edges.scatter_um))
        response = response.with_linear(EDGE_RADIUS, edges.per_um * unit_um)
    return response, defect_changes(surface, recipe, nominal, poses, convention, radiance), edges


def with_design(recipe: SurfaceRecipe) -> SurfaceRecipe:
    """The recipe with ideal ridges in place of a height map: of the measured angle, as rough as map and lobe together.

    A map cannot be turned to another ridge angle; what parts differ by is taken from ideal ridges like it.

    Raises:
        HeightMapError: the map cannot be read, or has no ridges.
    """
    table = recipe.surface
    if table.design is not None:
        return recipe
    assert table.height_map is not None
    try:
        content = hashlib.sha256(bounded_bytes(table.height_map, MOST_PICTURE_BYTES)).hexdigest()
    except OSError:  # reading it as a height map says why
        fitted, resolved = _ridges_of(recipe)
    else:
        key = {"map": content, "surface": table.model_dump(mode="json", exclude={"height_map"})}
        entry = Cache().entry("ridges-of-a-map", key, __name__)
        fitted, resolved = entry.result(
            lambda: _ridges_of(recipe), lambda found: json.dumps(found).encode(), json.loads
        )
    design = DesignPart.model_validate(fitted)
    surface = recipe.surface.model_copy(
        update={"height_map": None, "compare": None, "design": design, "roughness": "lobe"}
    )
    if recipe.surface.roughness == "plastic":
        return recipe.model_copy(update={"surface": surface})
    material = recipe.material.model_copy(
        update={
            "alpha_along": float(np.hypot(recipe.material.alpha_along, resolved[0])),
            "alpha_across": float(np.hypot(recipe.material.alpha_across, resolved[1])),
        }
    )
    return recipe.model_copy(update={"surface": surface, "material": material})


def _ridges_of(recipe: SurfaceRecipe) -> tuple[dict[str, Any], tuple[float, float]]:
    """Fields of the design of the ridges of a height map, and the roughness that the map resolves along and across."""
    relief, _ = prepare_relief(read_surface(recipe), recipe.surface.pitch_um)
    groove = fitted_groove(relief, edges=ridge_edges(relief) if recipe.surface.walls == "fitted" else None)
    fitted = groove.design
    return {
        "ridge_angle_deg": fitted.ridge_angle_deg,
        "wall": fitted.wall,
        "edge_radius_um": fitted.edge_radius_um,
    }, groove.resolved


def scatter_of_inputs(recipe: SurfaceRecipe) -> InputUncertainty:
    """Standard deviations of what differs from part to part; zero for what all parts share."""
    part = recipe.stated_scatter
    return InputUncertainty(
        alpha_share=part.alpha_share,
        albedo=part.albedo_share * recipe.material.albedo,
        index=0.0,
        light_angle_deg=0.0,
        stage_deg=0.0,
        stage_zero_deg=0.0,
        tilt_deg=0.0,
        tilt_zero_deg=0.0,
        seating_tilt_deg=recipe.scattered_seating_deg,
        ridge_angle_deg=recipe.scattered_ridge_angle_deg,
    )


def _shares(
    source: str, common: InputUncertainty, own: InputUncertainty, edges: CrestEdges | None
) -> tuple[float, float]:
    """Uncertainty and scatter of an input, in the unit of the response."""
    if source in (RIDGE_ANGLE, "seating tilt about x", "seating tilt about y"):
        return 0.0, 1.0  # every part is seated, and has its own angle
    pairs = {
        "roughness along the ridges": (common.alpha_share, own.alpha_share),
        "roughness across the ridges": (common.alpha_share, own.alpha_share),
        "albedo of the plastic": (common.albedo, own.albedo),
        EDGE_RADIUS: (0.0, 0.0) if edges is None else (edges.u_um, edges.scatter_um),
    }
    u, s = pairs.get(source, (1.0, 0.0))
    unit = float(np.hypot(u, s))
    return (u / unit, s / unit) if unit > 0.0 else (0.0, 0.0)


def named_defects(recipe: SurfaceRecipe) -> tuple[NamedDefect, ...]:
    """The defects for which a part is tested separately, at the sizes of the recipe."""
    size = recipe.defects
    share = 100.0 * size.roughness_share
    return (
        NamedDefect("ridge angle +", size.ridge_angle_deg, "°"),
        NamedDefect("ridge angle −", size.ridge_angle_deg, "°"),
        NamedDefect("height loss ", 100.0 * size.height_loss, "%"),
        NamedDefect("roughness along the ridges +", share, "%"),
        NamedDefect("roughness across the ridges +", share, "%"),
        *(() if size.wear_um is None else (NamedDefect("edges worn to ", size.wear_um, " µm"),)),
    )


def defect_changes(
    surface: Surface,
    recipe: SurfaceRecipe,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    radiance: FloatArray,
) -> dict[str, FloatArray]:
    """Change of ln L by each named defect at its smallest interesting size, as far as the surface can show it.

    Args:
        surface: predictor of a shape.
        recipe: with the sizes.
        nominal: state of a good part.
        poses: P poses.
        convention: how the angles are counted.
        radiance: (P,) of a good part in 1/sr.

    Returns:
        (P,) changes by the name of the defect.
    """
    size, material, shape = recipe.defects, nominal.material, nominal.shape
    grown = 1.0 + size.roughness_share

    def turned(by_deg: float) -> State:
        return replace(nominal, shape=replace(shape, ridge_angle_deg=shape.ridge_angle_deg + by_deg))

    def rougher(field: str) -> State:
        value = min(getattr(material, field) * grown, 1.0)
        return replace(nominal, material=replace(material, **{field: value}))

    step = size.ridge_angle_deg
    cut = replace(nominal, shape=replace(shape, height_loss=size.height_loss))
    made = (turned(step), turned(-step), cut, rougher("alpha_along"), rougher("alpha_across"))
    states = dict(zip((one.name for one in named_defects(recipe)[: len(made)]), made, strict=True))
    if recipe.surface.design is None:
        states = {name: state for name, state in states.items() if state.shape == shape}
    found = evaluate(surface, list(states.values()), poses, convention)
    changes = dict(zip(states, np.log(np.maximum(found, DARK) / radiance), strict=True))
    worn = None if size.wear_um is None else worn_edges(recipe, material, poses, convention, size.wear_um)
    if worn is not None:
        changes[named_defects(recipe)[-1].name] = worn
    return {
        name: change
        for name, change in changes.items()
        if np.ptp(change) > 1e-6  # a shape that this model cannot vary
    }


def _packed(found: PartScatter | None) -> bytes:
    header = (
        {"sources": None}
        if found is None
        else {
            "sources": found.response.sources,
            "defects": list(found.changes),
            "tails": list(found.tails),
            "states": found.states,
        }
    )
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    }
    if found is not None:
        arrays |= {
            "slope": np.array([one.slope for one in (found.response, *found.lobes)]),
            "bend": np.array([one.bend for one in (found.response, *found.lobes)]),
            "common": found.common,
            "own": found.own,
            "changes": np.array(list(found.changes.values())),
        }
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked(content: bytes) -> PartScatter | None:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        header = json.loads(bytes(arrays["header"]))
        if header["sources"] is None:
            return None
        response, *lobes = (
            Response(tuple(header["sources"]), slope, bend)
            for slope, bend in zip(arrays["slope"], arrays["bend"], strict=True)
        )
        changes = dict(zip(header["defects"], arrays["changes"], strict=True))
        states = {name: (source, extent) for name, (source, extent) in header["states"].items()}
        return PartScatter(
            response,
            tuple(lobes),
            arrays["common"],
            arrays["own"],
            changes,
            np.array(header["tails"]),
            states,
        )
