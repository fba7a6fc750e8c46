"""Plates on the virtual rig: every field shows its own state, in its own direction."""

import numpy as np
import pytest
from pydantic import ValidationError

from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predict import predict_design
from anisoscope.sim.bench.bench import plastic
from anisoscope.sim.bench.benchfile import MaterialPart, SamplePart
from anisoscope.sim.bench.plate import PlatePart, PlateSample
from anisoscope.sim.light.geometry import directions

EXACT = {
    "angle_scatter_deg": 0.0,
    "alpha_scatter_share": 0.0,
    "height_loss_scatter": 0.0,
    "misplaced_um": 0.0,
}
POSES = (Pose(0.0), Pose(90.0))
SIDES = directions(POSES, Convention())


def part(**changes):
    table = {"plan": ("AB", ".A"), "facet_azimuths_deg": {"A": 0.0, "B": -90.0}, "module_mm": 0.2}
    return PlatePart.model_validate(table | {"resolved_alpha": 0.0} | EXACT | changes)


def fields(made, pose, **options):
    """(2, 2) means of the fields, first row at the top."""
    sample = PlateSample(made, plastic(MaterialPart()), np.random.default_rng(1), **options)
    found = sample.radiance(SIDES[0][pose], SIDES[1][pose])
    assert found.shape == (1, 400, 400)
    return found[0].reshape(2, 200, 2, 200).mean(axis=(1, 3))[::-1]


def test_fields_are_as_bright_as_ridges_that_lie_their_way():
    """Against the model of ideal ridges, which shares nothing with it; and the classes exchange by a quarter turn."""
    found = [fields(part(), pose, reflections=False) for pose in (0, 1)]
    wanted = {
        azimuth: predict_design(
            RidgeDesign(50.0, 10.0), Material(), POSES, Convention(facet_azimuth_deg=azimuth), bounces=1
        ).radiance
        for azimuth in (0.0, -90.0)
    }
    for pose in (0, 1):
        assert found[pose][0, 0] == pytest.approx(wanted[0.0][pose], rel=0.05)
        assert found[pose][0, 1] == pytest.approx(wanted[-90.0][pose], rel=0.05)
        assert found[pose][1, 1] == pytest.approx(found[pose][0, 0], rel=0.01)


def test_defects_and_scatter_are_in_the_fields_that_have_them():
    good = [fields(part(), pose, reflections=False) for pose in (0, 1)]
    for defect in ("missing", "direction", "merged", "worn", "filled"):
        made = part(defects=({"row": 0, "col": 0, "defect": defect},))
        spoiled = [fields(made, pose, reflections=False) for pose in (0, 1)]
        ratio = [float(a[0, 0] / b[0, 0]) for a, b in zip(spoiled, good, strict=True)]
        assert max(abs(np.log(one)) for one in ratio) > 0.1, defect
        assert spoiled[0][1, 1] == pytest.approx(good[0][1, 1])
        if defect == "direction":
            np.testing.assert_allclose(spoiled[0][0, 0], good[0][0, 1], rtol=0.02)
        if defect == "missing":
            np.testing.assert_allclose([one[0, 0] for one in spoiled], [one[1, 0] for one in good], rtol=1e-6)
    scattered = fields(part(angle_scatter_deg=1.0, resolved_alpha=0.03), 0, reflections=False)
    assert scattered[0, 0] != scattered[1, 1]


def test_no_field_is_higher_than_full_ridges():
    """Fields are mixtures of states, which could have less than no height loss."""
    plan = {"plan": ("ABABAB",) * 6, "module_mm": 0.1}
    full = PlateSample(part(**plan, states=1), plastic(MaterialPart()), np.random.default_rng(1)).height_map()
    made = PlateSample(
        part(**plan, height_loss_scatter=0.05), plastic(MaterialPart()), np.random.default_rng(1)
    )
    for one in (made, made.lot_mate(np.random.default_rng(2), ())):
        highest = one.height_map().height_um.reshape(6, 100, 6, 100).max(axis=(1, 3))
        assert highest.max() <= full.height_um.max() * (1.0 + 1e-6)
        assert np.ptp(highest) > 0.02 * full.height_um.max()


def test_a_plate_that_is_none_is_refused():
    with pytest.raises(ValidationError, match="row 2 of the plan has 1 fields"):
        part(plan=("AB", "A"))
    with pytest.raises(ValidationError, match="the plan has no field in row 5, column 0"):
        part(defects=({"row": 5, "col": 0, "defect": "missing"},))
    with pytest.raises(ValidationError, match="needs a table"):
        SamplePart.model_validate({"kind": "plate"})
    with pytest.raises(ValidationError, match='set kind = "plate"'):
        SamplePart.model_validate({"kind": "ridges", "plate": part().model_dump()})
