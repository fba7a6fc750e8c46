"""Signatures against the corrected model; the fit along them against generalised least squares."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.causes import Cause, all_causes
from anisoscope.diagnosis.evidence import Evidence, background_of, covariance_of, inputs_of
from anisoscope.diagnosis.likelihood import fit_extent, interval
from anisoscope.diagnosis.ranking import NOTHING, diagnose
from anisoscope.diagnosis.separability import planned_covariance, separability
from anisoscope.diagnosis.signature_cache import cached_signatures
from anisoscope.diagnosis.signatures import Signature, Signatures, signatures
from anisoscope.imaging.defect_regions import MarkForm
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.prediction.propagation import PLASTIC_AND_SEAT
from anisoscope.profiles.defect_injection import DEFECTS
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.bounces import interreflection
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps

POSES = (Pose(0.0), Pose(90.0), Pose(180.0), Pose(0.0, 10.0), Pose(90.0, 10.0), Pose(180.0, 10.0))


def cause(name, extents=(-1.0, 0.0, 1.0), group="shape", **more):
    return Cause(name, name, "", group, "", extents, lambda surface, state, _: (surface, state), **more)


def line(name, slope, share=0.0, extents=(-1.0, -0.5, 0.0, 0.5, 1.0), **more):
    """A cause that changes everything in proportion to its extent."""
    extents = np.array(extents)
    return Signature(cause(name, **more), extents, np.outer(extents, slope), np.abs(extents) * share)


def known(*found, share=0.0):
    return Signatures(POSES, np.full(len(POSES), 0.05), share, found, ())


@pytest.fixture
def rng():
    """Every test draws for itself: what one finds does not depend on which others ran before it."""
    return np.random.default_rng(5)


def covariance(rng):
    return covariance_of(
        (
            Component("shared", "prediction", rng.normal(size=len(POSES)) * 0.02, shared=True),
            Component("alone", "measurement", np.full(len(POSES), 0.01), shared=False),
        ),
        0.05,
        len(POSES),
    )


@pytest.fixture(scope="module")
def recipe():
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "plate",
            "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
            "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0},
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, 10.0]},
            "acquisition": {"exposure_s": 0.006},
            "region": {"size_mm": [2.0, 2.0]},
        }
    )


@pytest.fixture(scope="module")
def of_the_recipe(recipe):
    names = ("ridge-angle", "colour", "seating-y", "burrs", "wear", "incomplete-filling")
    return signatures(recipe, 10.0, names=names)


def test_the_fit_along_a_line_is_generalised_least_squares(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    d = 0.3 * slope + 0.01 * rng.normal(size=len(POSES))
    inverse = np.linalg.inv(V)
    expected = slope @ inverse @ d / (slope @ inverse @ slope)
    found = fit_extent(line("a", slope), Evidence(d, V))
    assert found.extent == pytest.approx(expected, abs=1e-4)
    assert found.u == pytest.approx((slope @ inverse @ slope) ** -0.5, rel=1e-6)
    rest = d - expected * slope
    assert found.chi2 == pytest.approx(rest @ inverse @ rest, rel=1e-4)


def test_fitted_extents_scatter_as_their_uncertainty_says(rng):
    V, slope = covariance(rng), 0.1 * rng.normal(size=len(POSES))
    root = np.linalg.cholesky(V)
    one = line("a", slope, extents=(-4.0, 0.0, 4.0))
    z = []
    for _ in range(400):
        d = 0.2 * slope + root @ rng.normal(size=len(POSES))
        found = fit_extent(one, Evidence(d, V))
        z.append((found.extent - 0.2) / found.u)
    assert np.std(z) == pytest.approx(1.0, abs=0.14)  # 4 standard deviations of what 400 draws give
    assert np.mean(z) == pytest.approx(0.0, abs=0.2)


def test_the_interval_of_a_line_is_that_of_the_normal_distribution(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    one, evidence = line("a", slope), Evidence(0.1 * slope, V)
    found = fit_extent(one, evidence)
    low, high = interval(one, evidence, found)
    assert (low, high) == pytest.approx(
        (found.extent - 1.96 * found.u, found.extent + 1.96 * found.u), rel=2e-3
    )


def test_an_interval_beyond_what_was_looked_at_is_open_and_one_from_nil_is_not(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    slope *= 0.2 * (slope @ np.linalg.inv(V) @ slope) ** -0.5  # u is five times what was looked at
    one = line("a", slope, extents=(0.0, 0.5, 1.0))
    assert interval(one, Evidence(0.0 * slope, V), fit_extent(one, Evidence(0.0 * slope, V))) == (0.0, None)


@pytest.mark.parametrize("truth", [0.15, *(pytest.param(one, marks=pytest.mark.soak) for one in (0.0, 0.6))])
def test_intervals_hold_the_truth_where_a_signature_bends(truth):
    """A change with the square of the extent, one-sided: a part may look good though it has some of the defect."""
    rng, V = np.random.default_rng(3), 1e-4 * np.eye(len(POSES))
    slope = np.full(len(POSES), 0.05)
    extents = np.linspace(0.0, 1.5, 31)
    bent = Signature(cause("bent", tuple(extents)), extents, np.outer(extents**2, slope), 0.0 * extents)
    held = {"likelihood": 0, "curvature": 0}
    for _ in range(400):
        evidence = Evidence(truth**2 * slope + 0.01 * rng.normal(size=len(POSES)), V)
        found = fit_extent(bent, evidence)
        low, high = interval(bent, evidence, found)
        held["likelihood"] += (low is None or low <= truth) and (high is None or truth <= high)
        held["curvature"] += abs(found.extent - truth) <= 1.96 * found.u
    assert held["likelihood"] >= 0.93 * 400
    if truth == 0.15:
        assert held["curvature"] < 0.93 * 400


def test_the_cause_that_was_there_comes_first_and_a_scale_is_no_cause(rng):
    V = covariance(rng)
    slopes = rng.normal(size=(3, len(POSES)))
    found = known(*(line(name, slope) for name, slope in zip("abc", slopes, strict=True)))
    d = 0.5 * slopes[1] + 0.1  # a tenth brighter in all poses: the lamp, not the part
    first = diagnose(found, Evidence(d, V)).causes[0]
    assert first.cause == "b"
    assert abs(first.severity - 0.5) < 3.0 * first.u
    assert first.weight > 0.99


def test_a_part_as_predicted_has_nothing(rng):
    V = covariance(rng)
    found = known(line("a", rng.normal(size=len(POSES))))
    result = diagnose(found, Evidence(np.zeros(len(POSES)), V))
    assert result.causes[0].cause == NOTHING
    assert result.ties == (result.causes[0],)
    assert sum(finding.weight for finding in result.causes) == pytest.approx(1.0)


def test_twins_are_said_to_be_a_tie_and_never_told_apart(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    found = known(
        line("a", slope), line("twin", 2.0 * slope, extents=(-0.5, 0.0, 0.5)), line("b", rng.normal(size=6))
    )
    result = diagnose(found, Evidence(0.6 * slope, V))
    assert {finding.cause for finding in result.ties} == {"a", "twin"}
    rows = {row.cause: row for row in separability(found, V, with_map=False)}
    assert rows["a"].inseparable_causes == ("twin",)
    assert rows["a"].separation_extent is None
    assert rows["b"].inseparable_causes == ()


def test_the_extent_that_shows_is_three_sigma(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    row = separability(known(line("a", slope)), V, with_map=False)[0]
    sigma = (slope @ np.linalg.inv(V) @ slope) ** -0.5
    assert abs(row.detection_extent) == pytest.approx(3.0 * sigma, abs=0.02)


def test_marks_in_the_map_tell_twins_apart(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    found = known(line("smooth", slope), line("spots", slope, share=0.2))
    d = 0.5 * slope
    assert diagnose(found, Evidence(d, V, 0.1, 0.005)).causes[0].cause == "spots"
    assert diagnose(found, Evidence(d, V, 0.0, 0.005)).causes[0].cause == "smooth"


def test_the_form_of_marks_tells_twins_of_one_area_apart(rng):
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    forms = {"crests": (1.0, 0.8, 0.1), "anywhere": (0.55, 0.1, 0.05), "lines": (1.0, 0.7, 0.5)}
    found = known(
        *(replace(line(name, slope, share=0.2), forms=np.full((5, 3), form)) for name, form in forms.items())
    )
    d = 0.5 * slope
    alone = diagnose(found, Evidence(d, V, 0.1, 0.005))
    assert {one.cause for one in alone.ties} == set(forms)
    for name, form in forms.items():
        seen = Evidence(d, V, 0.1, 0.005, form=MarkForm(40, *form))
        assert seen.data == len(POSES) + 4
        result = diagnose(found, seen)
        assert [one.cause for one in result.ties] == [name]
        assert result.unexplained_p > 0.05
    few = diagnose(found, Evidence(d, V, 0.1, 0.005, form=MarkForm(2, 1.0, 0.8, 0.0)))
    assert {one.cause for one in few.ties} == set(forms)  # of two groups of cells the form is hardly known


@pytest.mark.parametrize("aligned", [0.0, 0.02, 0.07, 0.5, 0.98, 1.0])
def test_no_form_fits_better_than_well(rng, aligned):
    """A part exactly as a cause says has χ² near 0, never below: of a negative one no p value is known."""
    V, slope = 1e-4 * np.eye(len(POSES)), rng.normal(size=len(POSES))
    sure = known(replace(line("crests", slope, share=0.2), forms=np.full((5, 3), (0.97, 0.82, aligned))))
    for seen in (0.0, 0.02, 0.07, 0.5, 0.98, 1.0):
        evidence = Evidence(0.5 * slope, V, 0.1, 0.005, form=MarkForm(291, 0.97, 0.82, seen))
        (first, *_) = diagnose(sure, evidence).causes
        assert first.chi2 >= 0.0


def test_a_doubted_signature_is_believed_as_far_as_it_is_known():
    """A change that is 30 % off in one pose: too much for a certain signature, within the doubt of another."""
    V, slope = 1e-4 * np.eye(6), np.array([1.0, -0.5, 0.3, 0.8, -0.7, 0.2])
    real = slope * np.array([1.3, 1.0, 1.0, 1.0, 1.0, 1.0])
    certain, doubted = line("certain", slope), line("doubted", slope, doubt=0.2)
    assert diagnose(known(certain), Evidence(0.5 * real, V)).unexplained_p < 1e-6
    result = diagnose(known(doubted), Evidence(0.5 * real, V))
    assert result.unexplained_p > 0.05
    assert abs(result.causes[0].severity - 0.5) < 2.0 * result.causes[0].u


def test_extents_are_not_drawn_to_either_side_by_the_doubt():
    slope, rng = np.array([0.4, -0.2, 0.1, 0.3, -0.25, 0.05]), np.random.default_rng(8)
    V, one = 4e-6 * np.eye(6), line("a", slope, doubt=0.1)
    z = []
    for _ in range(300):
        real = 0.5 * slope * (1.0 + 0.1 * rng.standard_normal(6)) + 2e-3 * rng.standard_normal(6)
        found = fit_extent(one, Evidence(real, V))
        z.append((found.extent - 0.5) / found.u)
    assert np.mean(z) == pytest.approx(0.0, abs=0.25)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)


def test_what_good_parts_show_in_the_map_is_no_mark(rng):
    """A part with a share of cells that the limit allows: not taken for burrs, whatever the shape says."""
    V, slope = covariance(rng), rng.normal(size=len(POSES))
    found = known(line("shape", slope), line("marks", slope, share=0.4))
    told = Evidence(0.3 * slope, V, 0.01, 0.001, *background_of(0.03))
    assert {one.cause for one in diagnose(found, told).ties} >= {"shape"}
    assert diagnose(found, told).causes[0].cause == "shape"
    mean, u = background_of(0.03)
    shares = 0.03 * (
        1.0 - np.sqrt(1.0 - (np.arange(1000) + 0.5) / 1000)
    )  # density that falls to 0 at the limit
    assert (mean, u) == (pytest.approx(shares.mean(), rel=1e-3), pytest.approx(shares.std(), rel=1e-2))


def test_an_input_that_is_a_cause_is_fitted_without_its_own_uncertainty(recipe):
    """Albedo 30 % off: its extent is as certain as all else allows, not only to the 5 % that the recipe states."""
    expected = expectation(recipe, 10.0)
    alone = (Component("own", "measurement", np.full(len(POSES), 0.002), shared=False),)
    inputs = inputs_of(recipe, expected, alone)
    source = "albedo of the plastic"
    V = covariance_of(expected.components + alone, recipe.uncertainty.scale_share, len(POSES))
    reduced = inputs.covariance({source})
    k = expected.response.sources.index(source)
    rest = np.delete(np.arange(len(expected.response.sources)), k)
    slope = expected.response.slope[:, rest]
    assert np.linalg.eigvalsh(V - reduced).min() > -2e-4  # of cross terms left out of V
    np.testing.assert_allclose(np.diag(reduced - inputs.rest), np.sum(slope**2, axis=1), rtol=0.1, atol=1e-6)


def test_worn_and_cut_crests_are_those_of_the_exact_profile(recipe, of_the_recipe):
    """Height loss against the closed form; worn edges against points four times as close."""
    by_name = {one.cause.name: one for one in of_the_recipe.found}
    to_light, to_camera = directions(POSES, Convention())
    material = recipe.material.material()
    good, cut = (
        corrected.radiance(
            to_light, to_camera, RidgeDesign(100.0, 10.0, height_loss=loss), material, bounces=None
        )
        for loss in (0.0, 0.1)
    )
    change, share = by_name["incomplete-filling"].at(0.1)
    np.testing.assert_allclose(change, np.log(cut / good), rtol=0.01, atol=0.003)
    assert share == 0.0
    fine = ridges(RidgeDesign(100.0, 10.0), (2, 6 * 1180 + 1), (100.0, 100.0 / 1180))
    middle = slice(1180, 5 * 1180)

    def looked(surface, loss):
        """Direct light of the profile, and the light of its groove, shortened."""
        maps = radiance_maps(Relief(surface, 100.0), to_light, to_camera, material)
        groove = RidgeDesign(100.0, 10.0, height_loss=loss)
        direct = np.array([view[:, middle].mean(dtype=float) for view in maps])
        return direct + interreflection(to_light, to_camera, groove, material)

    lost = 0.8 * 5.0 / (100.0 * np.sin(np.radians(10.0)))
    worn = np.log(looked(edge_wear(fine, 5.0), lost) / looked(fine, 0.0))
    np.testing.assert_allclose(by_name["wear"].at(5.0)[0], worn, rtol=0.02, atol=0.004)


def test_what_no_cause_explains_is_said(rng):
    V = covariance(rng)
    result = diagnose(known(line("a", np.eye(6)[0])), Evidence(np.eye(6)[1], V))
    assert result.unexplained_p < 1e-6


def test_every_defect_and_every_part_of_the_rig_is_a_cause():
    names = {one.name for one in all_causes(10.0)}
    assert set(DEFECTS) < names
    assert {"roughness-along", "roughness-across", "colour", "seating-x", "seating-y", "light-angle"} < names
    for one in all_causes(5.0):
        assert 0.0 in one.extents
        assert list(one.extents) == sorted(one.extents)
        if one.name == "ridge-angle":
            assert min(one.extents) > -5.0


def test_a_ridge_angle_has_the_signature_of_the_corrected_model(recipe, of_the_recipe):
    signature = next(one for one in of_the_recipe.found if one.cause.name == "ridge-angle")
    to_light, to_camera = directions(POSES, Convention())
    material = recipe.material.material()
    good, wrong = (
        corrected.radiance(to_light, to_camera, RidgeDesign(100.0, angle), material, bounces=None)
        for angle in (10.0, 11.0)
    )
    change, _ = signature.at(1.0)
    np.testing.assert_allclose(change, np.log(wrong / good), atol=0.02)


def test_seating_askew_is_a_wrong_ridge_angle_where_the_part_is_not_tilted(of_the_recipe):
    """A part tilted about the ridges turns its facets as a wrong ridge angle does: the walls alone tell."""
    by_name = {one.cause.name: one for one in of_the_recipe.found}
    steeper, _ = by_name["ridge-angle"].at(0.5)
    tilted, _ = by_name["seating-y"].at(0.5)
    np.testing.assert_allclose(steeper[0], tilted[0], atol=0.02)


def test_burrs_show_in_the_map_and_colour_does_not(of_the_recipe):
    by_name = {one.cause.name: one for one in of_the_recipe.found}
    assert by_name["burrs"].at(0.2)[1] > 0.1
    assert by_name["colour"].share.max() == 0.0
    assert (np.diff(by_name["burrs"].share) >= 0.0).all()


def test_the_recipe_says_beforehand_what_it_can_tell(recipe, of_the_recipe):
    V = planned_covariance(recipe, expectation(recipe, 10.0))
    rows = {row.cause: row for row in separability(of_the_recipe, V, with_map=True)}
    assert 0.1 < abs(rows["ridge-angle"].detection_extent) < 1.5
    assert rows["ridge-angle"].separation_extents["colour"] is not None
    signature = next(one for one in of_the_recipe.found if one.cause.name == "ridge-angle")
    change, share = signature.at(1.5)
    result = diagnose(of_the_recipe, Evidence(change, V, float(share), 0.003))
    assert result.causes[0].cause in {"ridge-angle", "seating-y"}
    assert result.causes[0].severity == pytest.approx(1.5, abs=0.1)


def test_signatures_are_computed_once(recipe, of_the_recipe, monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))
    calls = []

    def compute(*_):
        calls.append(1)
        return of_the_recipe

    causes = replace(PLASTIC_CAUSES, signatures=compute)
    first, second = (cached_signatures(recipe, 10.0, causes=causes) for _ in range(2))
    assert len(calls) == 1
    for one, other in zip(first.found, second.found, strict=True):
        assert one.cause.name == other.cause.name
        np.testing.assert_array_equal(one.change, other.change)
        np.testing.assert_array_equal(one.at(0.3)[0], other.at(0.3)[0])
        assert (one.tangents is None) == (other.tangents is None)
        if one.tangents is not None:
            np.testing.assert_array_equal(
                *(side.tangents.change(0.2, PLASTIC_AND_SEAT) for side in (one, other))
            )
    assert (
        sum(one.tangents is not None for one in second.found) == len(of_the_recipe.found) - 1
    )  # not of burrs
    rougher = recipe.model_copy(update={"material": replace_material(recipe)})
    cached_signatures(rougher, 10.0, causes=causes)
    assert len(calls) == 2
    for file in (tmp_path / "signatures").iterdir():
        file.write_bytes(b"damaged")
    cached_signatures(recipe, 10.0, causes=causes)
    assert len(calls) == 3
    monkeypatch.setattr("anisoscope.base.cache.source_digest", lambda *_: "other code")
    cached_signatures(recipe, 10.0, causes=causes)
    assert len(calls) == 4


def replace_material(recipe):
    return recipe.material.model_copy(update={"alpha_along": 0.07})


def test_an_unlimited_extent_has_an_infinite_uncertainty(rng):
    V = covariance(rng)
    flat = line("flat", np.zeros(len(POSES)))
    assert fit_extent(flat, Evidence(np.ones(len(POSES)), V)).u == np.inf
    assert replace(flat, share=flat.share).bounds == (-1.0, 1.0)
