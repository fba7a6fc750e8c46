"""The further pose that would separate tied causes of ridges."""

from dataclasses import replace

import numpy as np

from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.discriminating_poses import advice_for
from anisoscope.diagnosis.ranking import Diagnosis
from anisoscope.parameters.geometry import Pose
from anisoscope.record.schema import CauseRecord


def cause(name, severity, u, tie=True):
    return CauseRecord(
        cause=name,
        title=name,
        unit="",
        severity=severity,
        u=u,
        weight=0.4,
        chi2=1.0,
        at_bound=False,
        tie=tie,
    )


def advice(recipe, *causes, model=PLASTIC_CAUSES):
    return advice_for(recipe, 10.0, Diagnosis(causes, 0.5), causes=model)


def differing(poses):
    """A model in which every cause differs from the others in a further pose of its own, and nowhere else."""

    def changes(recipe, _light_angle_deg, extents):
        found = {name: np.zeros(len(recipe.poses.poses())) for name in extents}
        for name in extents.keys() & poses.keys():
            found[name][recipe.poses.poses().index(poses[name])] = 0.4
        return found

    return replace(PLASTIC_CAUSES, changes=changes)


def test_the_pose_is_the_one_in_which_the_causes_differ(make_recipe):
    direct = {"reflections": "direct"}
    recipe, best = make_recipe(surface=direct), cause("colour", 0.3, 0.03)
    model = differing({"roughness-across": Pose(180.0, 10.0), "wear": Pose(45.0, 0.0)})
    rougher, worn = cause("roughness-across", 0.3, 0.03), cause("wear", 5.0, 0.3)
    assert advice(recipe, best, rougher, model=model) == "a picture at stage angle 180°, tilt 10°"
    both = advice(recipe, best, rougher, worn, model=model)
    assert sorted(both.split("; ")) == [
        "roughness-across: a picture at stage angle 180°, tilt 10°",
        "wear: a picture at stage angle 45°, tilt 0°",
    ]
    taken = make_recipe(poses={"tilts_deg": [0.0, 10.0]}, surface=direct)
    assert advice(taken, best, rougher, model=differing({})).startswith("no single further picture")


def test_causes_that_turn_the_facets_alike_are_separated_by_no_picture(make_recipe):
    """A ridge angle and a seating about the ridges differ only in what they do to the walls."""
    recipe, steeper = make_recipe(surface={"reflections": "direct"}), cause("ridge-angle", 0.3, 0.1)
    assert advice(recipe, steeper, cause("seating-y", 0.3, 0.1)).startswith("no single further picture")
    assert advice(recipe, steeper, cause("seating-y", 0.3, 0.1, tie=False)) is None
    undetermined = advice(recipe, steeper, cause("roughness-across", 0.3, None))
    assert undetermined.startswith("no single further picture")
