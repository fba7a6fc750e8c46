"""The bounds that stand beside a prediction hold."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predict import lost_in_roughness, predict_design
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 10.0))


def predicted(angle, material, bounces=1):
    return predict_design(
        RidgeDesign(100.0, angle), material, POSES, Convention(), bounces=bounces, inputs=InputUncertainty()
    )


def test_a_smooth_lobe_loses_nothing_and_a_rough_one_more_and_more():
    lost = [lost_in_roughness(Material(alpha, alpha), 30.0) for alpha in (0.05, 0.1, 0.2, 0.3, 0.5)]
    assert lost[0] < 1e-3
    assert np.all(np.diff(lost) > 0.0)
    assert 0.005 < lost[3] < 0.02


def test_what_a_second_reflection_would_add_is_what_it_adds():
    direct = predicted(20.0, Material(0.05, 0.05, 0.05))
    twice = predicted(20.0, Material(0.05, 0.05, 0.05), bounces=2)
    added = np.max(twice.radiance / direct.radiance - 1.0)
    assert direct.notes["second_reflection_would_add"] == pytest.approx(added, rel=1e-9)
    assert "second_reflection_would_add" not in twice.notes


def test_nothing_is_said_where_nothing_is_lost():
    notes = predicted(1.0, Material(0.05, 0.05, 0.5)).notes
    assert "second_reflection_would_add" not in notes
    assert "lost_in_roughness" not in notes
