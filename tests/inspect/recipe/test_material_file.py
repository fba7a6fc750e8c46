"""Material files: written, read, refused; where a material holds."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, RecipeError
from anisoscope.diagnosis.evidence import inputs_of
from anisoscope.kinds.ridges.kind import RIDGES
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.input_doubt import SCATTER
from anisoscope.prediction.propagation import TAIL
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.material_file import (
    MaterialFile,
    MaterialLightPart,
    half_angles_deg,
    material_at,
    parameter_values,
    read_material_file,
    write_material_file,
)
from anisoscope.recipe.surface import ScatterPart, check_material
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid

NAMES = ("ln_alpha_along", "ln_alpha_across", "tail", "ln_albedo")
COVARIANCE = np.diag([0.01, 0.02, 0.03, 0.04]) ** 2
CONTENT = {
    "id": "material-20261123-01234567",
    "name": "ABS, eroded",
    "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "tail": 0.7},
    "covariance": {"parameters": NAMES, "matrix": COVARIANCE.tolist()},
    "validity": {"half_angle_deg": (5.0, 20.6), "until": datetime(2027, 1, 1, tzinfo=UTC)},
    "light": {"wavelength_nm": 525.0, "aperture_half_angle_deg": 1.0},
    "scan": {"specimen": "coupon", "light_angle_deg": 10.0, "poses": [(0.0, 0.0), (90.0, -20.0)]},
}
UPRIGHT = pose_grid((0.0, 90.0, 180.0))


def file(**changes):
    return MaterialFile.model_validate(CONTENT | changes)


def covariance(matrix, names=NAMES):
    return {"covariance": {"parameters": names, "matrix": np.asarray(matrix).tolist()}}


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "abs.toml"
    written = write_material_file(file(), path)
    assert read_material_file(path) == written
    assert written.material.material() == Material(0.06, 0.1, 0.2, tail=0.7)
    assert written.covariance.u()["tail"] == pytest.approx(0.03)


def test_a_changed_file_is_refused_until_its_seal_is_taken_out(tmp_path):
    path = tmp_path / "abs.toml"
    write_material_file(file(), path)
    text = path.read_text().replace("tail = 0.7", "tail = 0.6")
    path.write_text(text)
    with pytest.raises(RecipeError, match=r"abs\.toml: changed after"):
        read_material_file(path)
    path.write_text("".join(line for line in text.splitlines(keepends=True) if not line.startswith("seal")))
    assert read_material_file(path).material.tail == 0.6


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (covariance(COVARIANCE - 0.05 * np.eye(4)), "negative eigenvalue"),
        (covariance(COVARIANCE + np.triu(0.01 * np.ones((4, 4)), 1)), "not symmetric"),
        (covariance(COVARIANCE[:3]), "4 rows of 4"),
        (covariance(COVARIANCE, ("tail", *NAMES[:3])), "twice"),
        (covariance(COVARIANCE, (*NAMES[:3], "ln_second_width")), "no second_lobe"),
        ({"material": CONTENT["material"] | {"tail": 2.0}}, "tail"),
        ({"validity": {"half_angle_deg": (20.0, 5.0)}}, "must rise"),
        ({"colour": "red"}, "unknown key"),
    ],
)
def test_what_is_no_material_is_one_line_that_names_file_and_key(tmp_path, changes, words):
    import tomli_w

    path = tmp_path / "abs.toml"
    path.write_text(tomli_w.dumps({"schema": 1} | CONTENT | changes))
    with pytest.raises(RecipeError, match=words) as found:
        read_material_file(path)
    assert "\n" not in str(found.value)
    assert str(path) in str(found.value)


def test_values_in_the_scales_of_the_covariance_and_back():
    one = Material(0.06, 0.1, 0.2, second_lobe=(0.15, 2.5))
    names = ("ln_alpha_along", "ln_alpha_across", "ln_albedo", "ln_second_weight", "ln_second_width")
    moved = material_at(one, names, parameter_values(one, names) + np.log([1.1, 1.2, 1.3, 1.4, 1.5]))
    found = [moved.alpha_along, moved.alpha_across, moved.albedo, *moved.second_lobe]
    np.testing.assert_allclose(found, np.array([0.06, 0.1, 0.2, 0.15, 2.5]) * [1.1, 1.2, 1.3, 1.4, 1.5])


@pytest.mark.parametrize(
    ("angle_deg", "expected"),
    [
        (5.0, (0.0, 7.1, 10.0)),
        (10.0, (5.0, 11.2, 15.0)),
        (15.0, (10.0, 15.8, 20.0)),
        (20.0, (15.0, 20.6, 25.0)),
    ],
)
def test_half_angles_of_facets_in_the_upright_poses(angle_deg, expected):
    """Light 10° from the camera: θ − 5°, arccos(cos θ·cos 5°), θ + 5°."""
    found = half_angles_deg(UPRIGHT, Convention(), (angle_deg,))
    np.testing.assert_allclose(found[0], expected, atol=0.05)


def test_a_coupon_serves_ridges_whose_half_angles_it_shows():
    one, convention = file(), Convention()
    assert one.uncovered(UPRIGHT, convention, (10.0,)) is None
    assert one.uncovered(UPRIGHT, convention, (15.0,)) is None
    assert "facets of 20° are seen at 15.0° to 25.0°" in one.uncovered(UPRIGHT, convention, (20.0,))
    assert "0.0° to 10.0°" in one.uncovered(
        UPRIGHT, convention, (5.0,)
    )  # the core, which a coupon does not show
    assert one.uncovered((Pose(0.0, 30.0),), convention, (0.0,))


def test_another_lamp_or_lens_is_named_and_what_is_not_stated_is_not_compared():
    one = file()
    assert one.other_light(MaterialLightPart()) is None
    assert one.other_light(MaterialLightPart(wavelength_nm=530.0, bandwidth_nm=30.0)) is None
    assert "another lamp: wavelength_nm 525 nm, here 630 nm" in one.other_light(
        MaterialLightPart(wavelength_nm=630.0)
    )
    assert "another lens" in one.other_light(MaterialLightPart(aperture_half_angle_deg=4.0))


def test_a_material_expires():
    assert file().expired(datetime(2026, 12, 31, tzinfo=UTC)) is None
    assert "expired at 2027-01-01" in file().expired(datetime(2027, 1, 1, tzinfo=UTC))
    by_hand = file(validity={"half_angle_deg": (5.0, 25.6), "until": "2027-01-01T00:00:00"})
    assert by_hand.expired(datetime(2026, 12, 31, tzinfo=UTC)) is None
    assert "expired" in by_hand.expired(datetime(2027, 1, 2, tzinfo=UTC))


def test_an_inspection_with_an_expired_material_is_invalid(recipe_with):
    recipe = recipe_with()
    RIDGES.check_valid(recipe, datetime(2026, 12, 31, tzinfo=UTC))
    with pytest.raises(CalibrationError, match="expired at 2027-01-01"):
        RIDGES.check_valid(recipe, datetime(2027, 1, 1, tzinfo=UTC))


@pytest.fixture
def recipe_with(make_recipe, tmp_path):
    """``recipe_with(**changes)``: a recipe whose material is a file with these changes."""
    import tomli_w

    from anisoscope.kinds.ridges.recipe import RidgeRecipe

    def build(name="abs.toml", table=None, **changes):
        write_material_file(file(**changes), tmp_path / "abs.toml")
        content = make_recipe().model_dump(mode="json", by_alias=True, exclude_none=True)
        content["material"] = name if table is None else table
        path = tmp_path / "recipe.toml"
        path.write_text(tomli_w.dumps(content))
        return RidgeRecipe.read(path)

    return build


def test_a_recipe_takes_its_material_from_a_file(recipe_with):
    for table in (None, {"file": "abs.toml", "u_index": 0.02}):
        part = recipe_with(table=table).material
        assert part.material() == Material(0.06, 0.1, 0.2, tail=0.7)
        assert (part.u_alpha_share, part.u_albedo, part.u_tail) == (0.0, 0.0, 0.0)
        assert part.calibrated.covariance.u()["tail"] == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"file": "abs.toml", "alpha_along": 0.1}, "leave alpha_along out"),
        ({"file": "none.toml"}, r"none\.toml: there is no such file"),
    ],
)
def test_a_recipe_with_a_wrong_material_file_is_one_line(recipe_with, table, words):
    with pytest.raises(RecipeError, match=words) as found:
        recipe_with(table=table)
    assert "\n" not in str(found.value)


def test_a_recipe_is_refused_whose_material_was_measured_elsewhere(recipe_with, virtual_rig):
    rig = read_rig(virtual_rig(rig={"light": {"wavelength_nm": 630.0}}).rig)
    same = read_rig(virtual_rig().rig)
    one = recipe_with()
    check_material(one, same, "recipe.toml")
    with pytest.raises(RecipeError, match=r"recipe\.toml: the material .* another lamp"):
        check_material(one, rig, "recipe.toml")
    narrow = recipe_with(validity={"half_angle_deg": (5.0, 12.0)})
    with pytest.raises(RecipeError, match=r"5\.0° to 15\.0° in these poses"):
        check_material(narrow, same, "recipe.toml")
    with pytest.raises(RecipeError, match=r"facets of 20° are seen"):
        check_material(one, same, "recipe.toml", 20.0)


def test_ridges_of_a_height_map_are_compared_with_the_half_angles(recipe_with, virtual_rig, tmp_path):
    path = tmp_path / "map.x3p"
    write_height_map(ridges(RidgeDesign(100.0, 20.0), (251, 501), (2.0, 1.0)), path)
    rig = read_rig(virtual_rig().rig)
    recipe = recipe_with()
    surface = recipe.surface.model_copy(update={"design": None, "height_map": path})
    with pytest.raises(RecipeError, match=r"facets of (20|19\.9)\S*° are seen at"):
        RIDGES.check(
            recipe.model_copy(update={"surface": surface}),
            rig,
            tmp_path / "recipe.toml",
            tmp_path / "rig.toml",
        )
    RIDGES.check(recipe, rig, tmp_path / "recipe.toml", tmp_path / "rig.toml")


def test_the_budget_of_a_prediction_is_that_of_the_correlated_material(recipe_with):
    """J C Jᵀ by components equals that by an independent Jacobian; correlation cancels what the diagonal states."""
    spread = np.diag([0.02, 0.02, 0.05, 0.02])
    correlation = np.full((4, 4), 0.9) + 0.1 * np.eye(4)
    matrix = spread @ correlation @ spread
    recipe = recipe_with(**covariance(matrix), test=TEST)
    recipe = recipe.model_copy(
        update={"surface": recipe.surface.model_copy(update={"reflections": "direct"})}
    )
    found = expectation(recipe, 10.0)
    own = [one for one in found.components if one.source.startswith(("calibrated material", TAIL))]
    assert [one.source for one in own] == [TAIL, *(f"calibrated material, direction {k}" for k in (1, 2, 3))]
    total = np.sum([one.covariance() for one in own], axis=0)
    nominal, design = recipe.material.material(), recipe.surface.ridge_design()
    values = parameter_values(nominal, NAMES)

    def log_light(at):
        return np.log(
            corrected.radiance(*directions(UPRIGHT, Convention()), design, material_at(nominal, NAMES, at))
        )

    slopes = np.stack(
        [(log_light(values + h) - log_light(values - h)) / 2e-4 for h in 1e-4 * np.eye(4)], axis=1
    )
    np.testing.assert_allclose(total, slopes @ matrix @ slopes.T, rtol=0.02, atol=1e-7)
    (family,) = [one for one in found.components if one.source == "family of the lobe"]
    np.testing.assert_allclose(family.relative, 0.005)
    assert not family.shared


def test_the_scatter_of_parts_of_a_calibrated_plastic_is_in_the_budget_once(recipe_with):
    """V = B + W: terms of [scatter] beside the directions of the file; as large as those of the same plastic alone."""
    scatter = ScatterPart(ridge_angle_deg=0.2, alpha_share=0.04, albedo_share=0.02, seating_tilt_deg=0.3)
    recipe = recipe_with(**covariance(COVARIANCE)).model_copy(update={"scatter": scatter})
    recipe = recipe.model_copy(
        update={"surface": recipe.surface.model_copy(update={"reflections": "direct"})}
    )
    stated = {"u_alpha_share": 0.04, "u_albedo": 0.004, "u_tail": 0.0, "file": None, "calibrated": None}
    alike = recipe.model_copy(update={"material": recipe.material.model_copy(update=stated)})
    found, plain = expectation(recipe, 10.0), expectation(alike, 10.0)
    terms = {one.source: one.relative for one in found.components}
    own = [name for name in terms if name.startswith(SCATTER)]
    assert [name.removeprefix(SCATTER) for name in own] == [
        "roughness along the ridges",
        "roughness across the ridges",
        "albedo of the plastic",
        "ridge angle of the design",
    ]
    for one in plain.components:
        name = SCATTER + one.source if SCATTER + one.source in terms else one.source
        np.testing.assert_allclose(terms[name], one.relative, rtol=1e-9, atol=1e-12)
    assert not any(one.source in found.response.sources for one in found.alone)
    assert not any(one.source.startswith(SCATTER) for one in found.alone)
    assert [one.source for one in found.alone] == [
        TAIL,
        *(f"calibrated material, direction {k}" for k in (1, 2, 3)),
    ]
    inputs, without_file = inputs_of(recipe, found, ()), inputs_of(alike, plain, ())
    assert inputs.u == pytest.approx(without_file.u)
    assert inputs.u["seating tilt about x"] == 0.3
    left = recipe.model_copy(update={"scatter": scatter.model_copy(update={"in_prediction": False})})
    narrow = {one.source: one.relative for one in expectation(left, 10.0).components}
    assert not any(name.startswith((SCATTER, "ridge angle")) for name in narrow)
    np.testing.assert_array_equal(narrow["roughness along the ridges"], 0.0)


def test_an_inspection_recorded_before_edges_counted_is_computed_again_with_sharp_ones(make_recipe):
    recipe = make_recipe(surface={"design": {"edge_radius_um": None}})
    before = recipe.model_dump(mode="json")
    before["surface"]["design"] |= {"edge_radius_um": 0.0}
    del before["surface"]["design"]["edge_form"], before["scatter"]["edge_radius_share"]
    then = RIDGES.as_recorded(recipe, before)
    assert then.surface.ridge_design() == recipe.surface.ridge_design()
    assert (then.surface.design.edge_radius_um, then.scatter.edge_radius_share) == (0.0, 0.0)
    assert then.scatter.in_prediction
    assert RIDGES.as_recorded(recipe, recipe.model_dump(mode="json")) == recipe


def test_an_inspection_recorded_before_scatter_counted_is_computed_again_without_it(recipe_with):
    recipe = recipe_with()
    before = recipe.model_dump(mode="json")
    del before["scatter"]["in_prediction"]
    assert not RIDGES.as_recorded(recipe, before).scatter.in_prediction
    assert RIDGES.as_recorded(recipe, recipe.model_dump(mode="json")).scatter.in_prediction
    del before["scatter"]
    assert RIDGES.as_recorded(recipe, before).scatter is None


@pytest.mark.parametrize("tail", [0.0, 0.05, 0.7])
def test_a_calibrated_lobe_is_in_doubt_along_the_regression_on_its_tail(recipe_with, tail):
    """At 2 u of the tail the plastic has the roughness and the albedo that are to be expected there; none below 0."""
    plain = CONTENT["material"] | {"tail": tail}
    spread = np.array([0.03, 0.05, 0.05, 0.03])
    matrix = spread[:, None] * spread * (np.full((4, 4), -0.7) + 1.7 * np.eye(4))
    matrix[np.ix_([0, 1, 3], [0, 1, 3])] = np.diag(spread[[0, 1, 3]] ** 2) * 2.0
    recipe = recipe_with(material=plain, **covariance(matrix))
    recipe = recipe.model_copy(
        update={"surface": recipe.surface.model_copy(update={"reflections": "direct"})}
    )
    found, names = expectation(recipe, 10.0), recipe.material.calibrated.covariance.parameters
    k = names.index("tail")
    values = recipe.material.calibrated.values() + 2.0 * matrix[k] / np.sqrt(matrix[k, k])
    followed = material_at(recipe.material.material(), names, values)
    alone = replace(recipe.material.material(), tail=followed.tail)
    sides, design = directions(recipe.poses.poses(), Convention()), recipe.surface.ridge_design()
    off, other = (
        np.log(corrected.radiance(*sides, design, one) / found.radiance) for one in (followed, alone)
    )
    curve, _ = found.lobes.at(followed.tail)
    np.testing.assert_allclose(curve, off, atol=5e-4)
    assert np.abs(other - off).max() > 0.02
    assert found.lobes.penalty(followed.tail) == pytest.approx(4.0)
    assert found.lobes.tails[0] == max(tail - 0.15, 0.0)


TEST = {
    "residual_over_noise": 1.0,
    "birge_ratio": 1.0,
    "degrees_of_freedom": 27,
    "rms_share": 0.003,
    "discrepancy_share": 0.005,
    "family": "tail",
}
