"""How inputs act on spoiled parts, against the closed form; and the intervals that rest on it, on parts drawn so."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.evidence import Evidence, covariance_of, inputs_of
from anisoscope.diagnosis.likelihood import fit_extent, interval
from anisoscope.diagnosis.signatures import DOUBTFUL, _Scene, signatures
from anisoscope.diagnosis.tangents import A_SIDE, Tangents, looked_at, slopes_of
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT, RIDGE_ANGLE
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

LOSS = 0.1
SPREAD = 0.3
LIGHT = 10.0
UNITS = {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 1.0, "index": 1.0}


@pytest.fixture(scope="module")
def recipe():
    """Roughness, index and sharp edges are known, and light is direct, so that a part is computed in a millisecond."""
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "plate",
            "surface": {
                "pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0, "edge_radius_um": 0.0}, "reflections": "direct",
            },
            "material": {
                "alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2,
                "u_tail": 0.0, "u_alpha_share": 0.0, "u_index": 0.0,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, -10.0, 10.0]},
            "acquisition": {"exposure_s": 0.006},
            "region": {"size_mm": [2.0, 2.0]},
            "uncertainty": {"seating_tilt_deg": 0.2, "scale_share": 0.01},
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def found(recipe):
    return {
        one.cause.name: one
        for one in signatures(recipe, LIGHT, names=("incomplete-filling", "missing-ridges")).found
    }


@pytest.fixture(scope="module")
def reflected(recipe):
    """Signatures with all reflections."""
    surface = recipe.surface.model_copy(update={"reflections": "all"})
    told = recipe.model_copy(update={"surface": surface})
    return {one.cause.name: one for one in signatures(told, LIGHT, names=("incomplete-filling",)).found}


@pytest.fixture(scope="module")
def spread(recipe):
    """The recipe that states how much the ridge angle of good parts spreads."""
    told = recipe.model_dump() | {"schema": 1}
    del told["schema_version"]
    told["surface"]["design"]["u_ridge_angle_deg"] = SPREAD
    return RidgeRecipe.model_validate(told)


@pytest.fixture(scope="module")
def turned(spread):
    names = ("incomplete-filling", "ridge-angle")
    return {one.cause.name: one for one in signatures(spread, LIGHT, names=names).found}


def cut(loss, angle_deg=10.0, bounces=1):
    """The closed form of ridges whose crests are missing."""

    def model(to_light, to_camera, material):
        design = RidgeDesign(100.0, angle_deg, height_loss=loss)
        return corrected.radiance(to_light, to_camera, design, material, bounces=bounces)

    return model


def nominal(recipe):
    return State(recipe.material.material(), LIGHT)


def by_closed_form(recipe, loss, source, poses, bounces):
    """Change of ln L per unit of one input, by steps that are larger than those of the propagation."""
    state, part = nominal(recipe), recipe.material.material()
    ends = []
    for side in (-1.0, 1.0):
        if source in ("roughness along the ridges", "roughness across the ridges"):
            field = "alpha_along" if "along" in source else "alpha_across"
            changed = replace(part, **{field: getattr(part, field) * np.exp(side * 0.02)})
            ends.append((replace(state, material=changed), 0.04))
        elif source == "albedo of the plastic":
            ends.append((replace(state, material=replace(part, albedo=part.albedo + side * 0.004)), 0.008))
        else:
            ends.append((replace(state, seating_deg=(0.0, side * 0.04)), 0.08))
    states = [state for state, _ in ends]
    low, high = evaluate(fixed(cut(loss, bounces=bounces)), states, poses, Convention(LIGHT))
    return np.log(high / low) / ends[0][1]


def test_worn_crests_are_arcs_whatever_their_radius(recipe):
    """By the closed form, in the poses where the crest shines: a ball that rolls along points leaves notches in it."""
    scene = _Scene(recipe, LIGHT)
    wear = next(one for one in all_causes(10.0) if one.name == "wear")
    sides = directions(scene.poses, Convention(LIGHT))
    for radius_um in (5.0, 8.0, 20.0):
        found = scene.look_along(scene.spoiled_profile(wear, scene.design, radius_um), None)
        worn = replace(scene.design, edge_radius_um=radius_um)
        closed = corrected.radiance(*sides, worn, scene.state.material, bounces=1)
        np.testing.assert_allclose(np.log(found / closed), 0.0, atol=0.008)


@pytest.mark.parametrize("bounces", [1, None])
@pytest.mark.parametrize(
    "source",
    ["roughness along the ridges", "albedo of the plastic", "seating tilt about y"],
)
def test_inputs_act_on_a_cut_crest_as_the_closed_form_says(recipe, found, reflected, source, bounces):
    poses = recipe.poses.poses()
    good, spoiled = (by_closed_form(recipe, loss, source, poses, bounces) for loss in (0.0, LOSS))
    told = (found if bounces == 1 else reflected)["incomplete-filling"].tangents.change(LOSS, (source,))[:, 0]
    np.testing.assert_allclose(told, spoiled - good, atol=0.02 * np.abs(good).max())
    assert np.abs(spoiled - good).max() > 0.15 * np.abs(good).max()  # it is worth while


def test_what_is_in_doubt_anyway_is_not_looked_at(found):
    assert found["missing-ridges"].cause.doubt >= DOUBTFUL > found["incomplete-filling"].cause.doubt
    assert found["missing-ridges"].tangents is None


def test_the_ridge_angle_acts_on_a_cut_crest_as_the_closed_form_says(spread, found, turned):
    poses, state = spread.poses.poses(), nominal(spread)

    def slope(loss):
        low, high = (
            evaluate(fixed(cut(loss, 10.0 + side)), [state], poses, Convention(LIGHT))[0]
            for side in (-0.08, 0.08)
        )
        return np.log(high / low) / 0.16

    told = turned["incomplete-filling"].tangents.change(LOSS, (RIDGE_ANGLE,))[:, 0]
    np.testing.assert_allclose(told, slope(LOSS) - slope(0.0), atol=0.02 * np.abs(slope(0.0)).max())
    assert np.abs(told).max() > 0.1 * np.abs(slope(0.0)).max()
    assert (
        not found["incomplete-filling"].tangents.change(LOSS, (RIDGE_ANGLE,)).any()
    )  # costs nothing if not stated


def own_of(expected):
    return (Component("own", "measurement", np.full(len(expected.poses), 0.004), shared=False),)


def evidence_of(recipe, change):
    expected = expectation(recipe, LIGHT)
    own = own_of(expected)
    V = covariance_of(expected.components + own, recipe.uncertainty.scale_share, len(expected.poses))
    return Evidence(change, V, inputs=inputs_of(recipe, expected, own))


def test_a_ridge_angle_is_fitted_without_its_own_spread(recipe, spread, turned):
    """As an albedo is: its severity is how far it is off in all, and what it is by chance is not added to its u."""
    angle = turned["ridge-angle"]
    assert angle.cause.sources == (RIDGE_ANGLE,)
    change, _ = angle.at(1.2)
    alone, stated = (evidence_of(one, change) for one in (recipe, spread))
    assert stated.inputs.u[RIDGE_ANGLE] == SPREAD
    without = fit_extent(angle, alone, as_input=True)
    found = fit_extent(angle, stated, as_input=True)
    assert (found.extent, found.u) == pytest.approx((without.extent, without.u), rel=1e-3)
    assert found.extent == pytest.approx(1.2, abs=0.05)
    counted = fit_extent(angle, stated)
    assert counted.u == pytest.approx(np.hypot(found.u, SPREAD), rel=0.1)
    assert interval(angle, stated, found) == pytest.approx(interval(angle, alone, without), abs=2e-3)


def drawn(recipe, loss, count, rng):
    """(count, P) ln L of parts with a height loss: albedo, seating and lamp as the recipe says, 0.4 % in every pose."""
    part, rig, design = recipe.material.material(), recipe.uncertainty, recipe.surface.design
    states = [
        State(
            replace(part, albedo=part.albedo + recipe.material.u_albedo * rng.standard_normal()),
            LIGHT + rig.light_angle_deg * rng.standard_normal(),
            seating_deg=tuple(rig.seating_tilt_deg * rng.standard_normal(2)),
        )
        for _ in range(count)
    ]
    poses = recipe.poses.poses()
    turns = (
        design.u_ridge_angle_deg * rng.standard_normal(count) if design.u_ridge_angle_deg else np.zeros(count)
    )
    radiance = np.vstack(
        [
            evaluate(fixed(cut(loss, design.ridge_angle_deg + turn)), [state], poses, Convention(LIGHT))
            for state, turn in zip(states, turns, strict=True)
        ]
    )
    own = 0.004 * rng.standard_normal(radiance.shape) + rig.scale_share * rng.standard_normal((count, 1))
    return np.log(radiance) + own


def test_intervals_hold_the_truth_as_often_as_they_say_because_of_the_tangents(recipe, found):
    """Inputs taken to act as on the good part leave intervals too short: a flat crest answers otherwise."""
    parts = drawn(recipe, LOSS, 400, np.random.default_rng(4)) - np.log(expectation(recipe, LIGHT).radiance)
    sure = certain(found["incomplete-filling"], recipe)
    assert 0.91 <= held(sure, recipe, parts) <= 0.985  # .95 ± .011
    assert held(replace(sure, tangents=None), recipe, parts[:60]) < 0.7


@pytest.mark.statistics
def test_intervals_hold_the_truth_of_parts_whose_ridge_angle_spreads_where_that_is_stated(
    recipe, spread, found, turned
):
    parts = drawn(spread, LOSS, 400, np.random.default_rng(8)) - np.log(expectation(spread, LIGHT).radiance)
    assert 0.91 <= held(certain(turned["incomplete-filling"], spread), spread, parts) <= 0.985
    assert held(certain(found["incomplete-filling"], recipe), recipe, parts[:60]) < 0.8


def certain(signature, recipe):
    """The signature by the closed form, beyond doubt."""
    poses = recipe.poses.poses()
    shown = [
        evaluate(fixed(cut(e)), [nominal(recipe)], poses, Convention(LIGHT))[0] for e in signature.extents
    ]
    return replace(signature, cause=replace(signature.cause, doubt=0.0), change=np.log(shown / shown[0]))


def held(signature, recipe, parts):
    """How often the intervals hold the true height loss."""
    ends = []
    known = evidence_of(recipe, parts[0])
    for change in parts:
        evidence = replace(known, deviation=change)
        ends.append(interval(signature, evidence, fit_extent(signature, evidence)))
    low, high = np.array(ends, dtype=float).T
    return np.mean((low <= LOSS) & (high >= LOSS))


def test_nil_and_the_outermost_extents_are_looked_at():
    assert looked_at((-3.0, -2.0, -1.0, 0.0, 5.0)) == (-3.0, -2.0, -1.0, 0.0, 5.0)
    many = tuple(np.linspace(0.0, 1.0, 30))
    assert looked_at(many)[0] == 0.0
    assert looked_at(many)[-1] == 1.0
    assert len(looked_at(many)) == A_SIDE + 1
    assert looked_at((0.0,)) == (0.0,)


def test_slopes_change_by_nothing_on_the_good_part_and_not_for_other_inputs():
    slope = np.zeros((3, 2, len(PLASTIC_AND_SEAT)))
    slope[:, :, 2] = [[1.0, 2.0], [0.5, 0.5], [0.0, 1.0]]
    told = Tangents(np.array([-1.0, 0.0, 2.0]), slope)
    found = told.change(
        np.array([-1.0, 0.0, 2.0, 7.0]),
        (PLASTIC_AND_SEAT[2], "depth of the etch passes", PLASTIC_AND_SEAT[0]),
    )
    assert found.shape == (4, 2, 3)
    np.testing.assert_allclose(found[:, :, 0], [[0.5, 1.5], [0.0, 0.0], [-0.5, 0.5], [-0.5, 0.5]])
    assert not found[:, :, 1:].any()


def test_black_parts_have_no_slopes(recipe):
    def black(to_light, to_camera, material):
        return np.zeros(len(to_light))

    assert slopes_of(fixed(black), nominal(recipe), recipe.poses.poses(), Convention(LIGHT)) is None
