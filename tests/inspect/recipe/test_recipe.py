import pytest
import tomli_w

from anisoscope.base.errors import RecipeError
from anisoscope.kinds.registry import read_recipe
from anisoscope.prediction.expectation import expectation, recipe_uncertainty
from anisoscope.recipe.poses import check_poses

GOOD = {
    "schema": 1,
    "product": "plate",
    "surface": {"pitch_um": 100.0, "height_map": "${here}/map.x3p"},
    "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0},
    "acquisition": {"exposure_s": 0.01},
    "region": {"size_mm": [2.0, 1.0]},
}
DESIGN = {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}}


@pytest.fixture
def read(tmp_path):
    def read_(**changes):
        tables = {**GOOD, **{key: value for key, value in changes.items() if value is not None}}
        for key in [key for key, value in changes.items() if value is None]:
            del tables[key]
        path = tmp_path / "recipe.toml"
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        return read_recipe(path)

    return read_


def test_a_good_recipe(read, tmp_path):
    recipe = read(
        poses={"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, 10.0]}, decision={"tolerance": 0.2}
    )
    assert recipe.surface.height_map == tmp_path / "map.x3p"
    assert [(p.stage_deg, p.tilt_deg) for p in recipe.poses.poses()][2:4] == [(180.0, 0.0), (0.0, 10.0)]
    assert recipe.tolerances() == (0.2,) * 4  # pairs are of one tilt


def test_a_tolerance_a_pair(read):
    assert read(decision={"tolerance": [0.1, 0.2]}).tolerances() == (0.1, 0.2)
    assert read(decision={}).tolerances() is None


def test_the_design_is_the_one_of_the_file(read):
    design = read(
        surface={**DESIGN, "design": {"ridge_angle_deg": 12.0, "wall": "vertical"}}
    ).surface.ridge_design()
    assert (design.pitch_um, design.ridge_angle_deg, design.wall) == (100.0, 12.0, "vertical")


def test_crests_and_walls_of_the_design_are_those_of_the_file(read):
    assert read(surface=DESIGN).surface.ridge_design().edge_radius_um == 0.0
    table = {"ridge_angle_deg": 12.0, "wall": 4.5, "edge_radius_um": 1.5}
    surface = read(surface={**DESIGN, "design": table}).surface
    assert (surface.ridge_design().wall, surface.ridge_design().edge_radius_um) == (4.5, 1.5)
    assert surface.design.u_edge_radius_share == 0.4
    with pytest.raises(RecipeError, match=r"design\.edge_radius_um .* larger than the pitch"):
        read(surface={**DESIGN, "design": {**table, "edge_radius_um": 400.0}})
    rounded = read(surface={**DESIGN, "design": {**table, "foot_radius_um": 2.5}}).surface
    assert rounded.ridge_design().foot_radius_um == 2.5
    with pytest.raises(RecipeError, match=r"design\.foot_radius_um.* larger than the pitch"):
        read(surface={**DESIGN, "design": {**table, "foot_radius_um": 400.0}})
    with pytest.raises(RecipeError, match=r"radii whose sum is at most"):
        read(surface={**DESIGN, "design": {**table, "edge_radius_um": 8.0, "foot_radius_um": 12.0}})


def test_the_spread_of_the_ridge_angle_is_nil_unless_it_is_stated(read):
    assert read(surface=DESIGN).surface.design.u_ridge_angle_deg == 0.0
    stated = {**DESIGN, "design": {"ridge_angle_deg": 10.0, "u_ridge_angle_deg": 0.1}}
    assert read(surface=stated).surface.design.u_ridge_angle_deg == 0.1
    both = {**stated, "height_map": "x", "compare": "design"}
    recipe = read(surface=both)
    assert recipe.surface.decides == "design"
    assert recipe_uncertainty(recipe.deciding()).ridge_angle_deg == 0.1
    assert (
        recipe_uncertainty(recipe.against("height_map")).ridge_angle_deg == 0.0
    )  # its ridges are what they are


MATERIAL = GOOD["material"]
SPREAD = {"ridge_angle_deg": 10.0, "u_ridge_angle_deg": 0.1}
MISTAKES = {
    "surface.pitch_mm: unknown key; did you mean 'pitch_um'?": {"surface": {**DESIGN, "pitch_mm": 0.1}},
    "tolerances: unknown key": {"tolerances": 0.1},
    "surface.pitch_um: missing": {"surface": {"height_map": "x"}},
    "material: missing": {"material": None},
    "material.albedo": {"material": {**MATERIAL, "albedo": "20 %"}},
    "material.alpha_along": {"material": {**MATERIAL, "alpha_along": -0.1}},
    "material: roughness alpha along": {"material": {**MATERIAL, "alpha_along": 1.5}},
    "material.index": {"material": {**MATERIAL, "index": 0.9}},
    'surface: of height_map and design, say with compare = "height_map" or "design" which one decides': {
        "surface": {**DESIGN, "height_map": "x"}
    },
    "give height_map (a file) or design (a table), or both of them": {"surface": {"pitch_um": 100.0}},
    'compare = "height_map", but there is no height_map': {"surface": {**DESIGN, "compare": "height_map"}},
    "surface.role": {"surface": {"pitch_um": 100.0, "height_map": "x", "role": "mould"}},
    "surface.design.ridge_angle_deg": {"surface": {**DESIGN, "design": {"ridge_angle_deg": 50.0}}},
    "surface.design.u_ridge_angle_deg": {
        "surface": {**DESIGN, "design": {"ridge_angle_deg": 10.0, "u_ridge_angle_deg": -0.1}}
    },
    "surface: design.u_ridge_angle_deg is the spread of ideal ridges": {
        "surface": {**DESIGN, "design": SPREAD, "height_map": "x", "compare": "height_map"}
    },
    "decision.tolerance lists 1 values for 2 pairs": {"decision": {"tolerance": [0.1]}},
    "decision.tolerance": {"decision": {"tolerance": -0.1}},
    "decision.contrast": {"decision": {"contrast": "ratio"}},
    "decision.alpha": {"decision": {"alpha": 1.0}},
    "region.size_mm must span at least two pitches (0.2 mm)": {"region": {"size_mm": [0.15, 1.0]}},
    "region.size_mm[1]": {"region": {"size_mm": [1.0]}},
    "region.center_mm[0]": {"region": {"size_mm": [1.0, 1.0], "center_mm": [float("nan"), 0.0]}},
    "poses: angles_deg names an angle twice": {"poses": {"angles_deg": [0.0, 90.0, 0.0]}},
    "poses.angles_deg": {"poses": {"angles_deg": [0.0]}},
    "acquisition.frames_per_pose": {"acquisition": {"exposure_s": 0.1, "frames_per_pose": 1}},
    "acquisition.exposure_ms: unknown key; did you mean 'exposure_s'?": {"acquisition": {"exposure_ms": 10}},
    "product": {"product": ""},
    "schema": {"schema": 2},
}


@pytest.mark.parametrize("message", MISTAKES)
def test_mistakes_are_one_line_that_names_file_and_key(read, tmp_path, message):
    with pytest.raises(RecipeError) as caught:
        read(**MISTAKES[message])
    text = str(caught.value)
    assert message in text
    assert text.startswith(str(tmp_path / "recipe.toml"))
    assert "\n" not in text


@pytest.mark.parametrize(
    ("tilt", "light", "name"), [(95.0, 10.0, "light"), (-91.0, 0.0, "light"), (90.0, 20.0, "light")]
)
def test_a_pose_below_the_horizon_names_file_key_and_pose(read, tmp_path, tilt, light, name):
    recipe = read(poses={"tilts_deg": [0.0, tilt]})
    path = tmp_path / "recipe.toml"
    with pytest.raises(RecipeError, match=f"at tilt {tilt:g}° the {name} stands at or below") as caught:
        check_poses(recipe.poses, light, path)
    text = str(caught.value)
    assert text.startswith(f"{path}: poses.tilts_deg: ")
    assert text.endswith(f"with the light {light:g}° from the camera: tilt less")
    check_poses(read(poses={"tilts_deg": [0.0, 80.0]}).poses, light, path)
    with pytest.raises(RecipeError, match=r"^poses\.tilts_deg: at tilt"):
        expectation(recipe, light)


def test_a_recipe_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RecipeError, match=r"none\.toml: there is no such file"):
        read_recipe(tmp_path / "none.toml")


def test_single_poses_take_the_place_of_the_grid(make_recipe):
    single = [[0, 0], [90, 0], [180, 0], [90, -15]]
    found = make_recipe(poses={"stage_and_tilt_deg": single})
    assert [(pose.stage_deg, pose.tilt_deg) for pose in found.poses.poses()] == [
        tuple(map(float, p)) for p in single
    ]
    assert (found.poses.angles_deg, found.poses.tilts_deg) == ((0.0, 90.0, 180.0), (0.0, -15.0))
    stored = found.model_dump(mode="json", by_alias=True)
    assert type(found).model_validate(stored) == found  # as a record holds it
    assert (
        "stage_and_tilt_deg" not in make_recipe().model_dump(mode="json")["poses"]
    )  # keys of golden parts stay
    tolerant = make_recipe(poses={"stage_and_tilt_deg": single}, decision={"tolerance": 0.2})
    assert tolerant.tolerances() == (0.2, 0.2)  # of 0/90 and 90/180, upright


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ({"stage_and_tilt_deg": [[0, 0], [0, 0]]}, "a pose twice"),
        ({"stage_and_tilt_deg": [[0, 0], [90, 10]]}, "two poses of one tilt"),
        ({"stage_and_tilt_deg": [[0, 0], [90, 0]], "angles_deg": [0, 180]}, "not both"),
    ],
)
def test_single_poses_that_make_no_sense(make_recipe, poses, words):
    with pytest.raises(ValueError, match=words):
        make_recipe(poses=poses)
