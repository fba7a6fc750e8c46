"""Poses for named defects: distances against reference numbers of another model, and what the choice gains."""

from itertools import pairwise

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.imaging.facet_fit import poses_for_angles
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.recipe.surface import DefectsPart
from anisoscope.sim.light.geometry import pose_grid
from anisoscope.study.best_poses import best_poses, ideal_distances, sizes_in_toml, with_sizes

TABLE = {
    "schema": 1,
    "product": "plate",
    "acquisition": {"exposure_s": 0.01},
    "region": {"size_mm": [2.0, 2.0]},
    "surface": {"pitch_um": 100.0, "design": {"ridge_angle_deg": 10.0}},
    "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2, "u_tail": 0.0},
    "area": None,
}
PLUS, MINUS, ROUGHER = "ridge angle +0.5°", "ridge angle −0.5°", "roughness across the ridges +20%"
QUARTERS = [[0, 0], [90, 0], [180, 0], [90, -15], [90, -5], [0, -10]]


def recipe(poses=None, reflections="all"):
    surface = TABLE["surface"] | {"reflections": reflections}
    return RidgeRecipe.model_validate(TABLE | {"surface": surface, "poses": poses or {}})


# an independent prototype, two reflections by quadrature, Beckmann lobe, noise 0.3 %
@pytest.mark.parametrize(
    ("poses", "plus", "minus", "rougher"),
    [
        ({}, 2.5, 2.4, 1.0),
        ({"tilts_deg": [0, -10, 10]}, 3.7, 3.1, 9.7),
        ({"stage_and_tilt_deg": QUARTERS}, 3.7, 3.5, 13.0),
    ],
)
def test_distances_are_those_of_an_independent_model(poses, plus, minus, rougher):
    found = ideal_distances(recipe(poses), 10.0)
    assert [found[PLUS], found[MINUS]] == pytest.approx([plus, minus], rel=0.2)
    assert found[ROUGHER] == pytest.approx(rougher, rel=0.35, abs=0.5)


def test_chosen_poses_show_all_defects_better_than_as_many_upright_ones():
    rules = recipe(reflections="direct")
    upright = ideal_distances(recipe({"angles_deg": [0, 90, 180, 270]}, "direct"), 10.0)
    found = best_poses(
        rules, 10.0, poses=4, angles_deg=(0.0, 90.0, 180.0, 270.0), tilts_deg=(-15.0, 0.0, 15.0)
    )
    wanted = [one for one in found.shown if not one.defect.startswith("roughness along")]
    assert min(one.distance for one in wanted) > min(upright[one.defect] for one in wanted)
    assert len(found.poses) == len(set(found.poses)) == 4
    again = recipe({"stage_and_tilt_deg": [list(pose) for pose in found.poses]}, "direct")
    assert again.poses.poses()[0].tilt_deg == found.poses[0][1]
    # a defect that is hardly found leaves its level to the others
    assert sum(one.power[1] for one in found.shown) < sum(one.power[25] for one in found.shown)
    for one in found.shown:
        assert one.area == pytest.approx(1.0, abs=0.5)
    reached = [found.frames[n] for n in sorted(found.frames) if found.frames[n] is not None]
    assert reached == sorted(reached, reverse=True)  # more golden parts need fewer frames
    assert (found.golden is None) == (rules.acquisition.frames_per_pose not in reached)
    loss = next(one for one in found.shown if one.defect.startswith("height loss"))
    assert (loss.area, loss.power[1]) == (pytest.approx(1.0, abs=1e-3), pytest.approx(1.0, abs=0.01))


def test_poses_for_the_angle_map_come_first():
    rules = recipe(reflections="direct")
    angles, tilts = (0.0, 90.0, 180.0, 270.0), (-10.0, 0.0, 10.0)
    allowed, convention = pose_grid(angles, tilts), Convention(10.0)
    first = {
        (allowed[k].stage_deg, allowed[k].tilt_deg) for k in poses_for_angles(rules, allowed, convention, 3)
    }
    # the mirror direction, where no roughness counts, and the lean along from 90° or its mirror image
    assert (0.0, 0.0) in first
    assert first & {(90.0, -10.0), (270.0, 10.0)}
    found = best_poses(rules, 10.0, poses=4, angles_deg=angles, tilts_deg=tilts, angle_map=True)
    assert first < set(found.poses)
    few = best_poses(rules, 10.0, poses=3, angles_deg=angles, tilts_deg=tilts, angle_map=True)
    assert len(set(few.poses)) == 3
    assert len({tilt for _, tilt in few.poses}) < 3


def test_frames_and_brackets_follow_from_noise_and_light():
    only = recipe(reflections="direct").model_copy(
        update={"defects": DefectsPart(ridge_angle_deg=3.0, roughness_share=2.0, height_loss=0.2)}
    )
    options = {"poses": 4, "angles_deg": (0.0, 90.0, 180.0, 270.0), "tilts_deg": (0.0, 10.0), "ignore": ()}
    noisy = best_poses(only, 10.0, **options, u_pose=0.05)
    quiet = best_poses(only, 10.0, **options, u_pose=0.002)
    assert quiet.frames[25] == only.acquisition.frames_per_pose
    assert noisy.frames[25] is None or noisy.frames[25] > quiet.frames[25]
    assert all(quiet.frames[n] is not None for n in (3, 10, 25))
    tiny = only.model_copy(update={"defects": DefectsPart(ridge_angle_deg=0.05)})
    assert set(best_poses(tiny, 10.0, **options).frames.values()) == {None}
    assert quiet.brackets[:1] == (4.0,)  # 0.28 against 0.03 1/sr
    assert all(later == 4.0 * before for before, later in pairwise(quiet.brackets))


def test_what_cannot_be_chosen_is_one_clear_line():
    rules = recipe(reflections="direct")
    allowed = {"poses": 3, "angles_deg": (0.0, 90.0), "tilts_deg": (0.0, 10.0)}
    with pytest.raises(UsageError, match="poses of 4 that are allowed"):
        best_poses(rules, 10.0, **allowed | {"poses": 5})
    with pytest.raises(UsageError, match="no defect is left"):
        best_poses(rules, 10.0, **allowed, ignore=("r", "h", "e"))
    with pytest.raises(UsageError, match="no defect begins with"):
        best_poses(rules, 10.0, **allowed, ignore=("zzz",))
    with pytest.raises(UsageError, match="between 0 and 1"):
        best_poses(rules, 10.0, **allowed, u_pose=-1.0)
    with pytest.raises(UsageError, match="between 0 and 1"):
        best_poses(rules, 10.0, **allowed, power=2.0)


def test_sizes_that_are_asked_for_replace_those_of_the_recipe():
    rules = recipe(reflections="direct")
    asked = ("ridge-angle=1°", "roughness=30%", "height-loss=0.05", "wear=8um")
    sized, begins = with_sizes(rules, asked)
    found = sized.defects
    assert (found.ridge_angle_deg, found.height_loss, found.wear_um) == (1.0, 0.05, 8.0)
    assert found.roughness_share == pytest.approx(0.3)
    assert begins == ("ridge angle", "roughness", "height loss", "edges worn")
    assert sizes_in_toml(sized, rules)[:2] == ("ridge_angle_deg = 1", "roughness_share = 0.3")
    assert with_sizes(rules, ()) == (rules, ())
    options = {"poses": 3, "angles_deg": (0.0, 90.0, 180.0, 270.0), "tilts_deg": (0.0, 10.0), "ignore": ()}
    only, names = with_sizes(rules, ("height-loss=10%",))
    loss = best_poses(only, 10.0, **options, asked=names)
    assert loss.frames[1] is not None  # the ridge angle of the recipe needs more golden parts


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("ridge-angle",), "takes NAME=SIZE"),
        (("angle=1",), r"no defect 'angle'; there are ridge-angle \(°\)"),
        (("ridge-angle=1", "ridge-angle=2"), "asked for twice"),
        (("ridge-angle=20%",), "in °, not in %"),
        (("ridge-angle=-0.5",), "above 0; both signs"),
        (("wear=nan",), "above 0"),
        (("roughness=twenty",), "'twenty' is no size in %"),
        (("roughness=20",), "write roughness=20% or roughness=0.2"),
        (("height-loss=100%",), "height-loss: input should be less than 1"),
    ],
)
def test_a_size_that_is_none_is_one_clear_line(asked, said):
    with pytest.raises(UsageError, match=said):
        with_sizes(recipe(), asked)
