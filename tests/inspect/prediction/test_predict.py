import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predict import predict_design, predict_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.profiles.patterns import GrooveDesign, turned_ridges, v_grooves
from anisoscope.sim.light.geometry import pose_grid

POSES = pose_grid((0.0, 90.0, 180.0, 270.0), (0.0, 10.0))
MATERIAL = Material(0.08, 0.12)


@pytest.mark.parametrize("angle", [6.0, 10.0, 16.0])
def test_design_and_height_map_agree_on_ideal_ridges(angle):
    design = RidgeDesign(100.0, angle)
    ideal = predict_design(design, MATERIAL, POSES, Convention())
    relief = predict_height_map(ridges(design, (6, 1601), (1.0, 0.25)), MATERIAL, POSES, Convention())
    np.testing.assert_allclose(relief.radiance, ideal.radiance, rtol=0.02)
    assert relief.notes["pitch_um"] == pytest.approx(100.0, rel=1e-3)
    assert "warning" not in relief.notes


@pytest.mark.parametrize("direction", [90.0, 180.0, pytest.param(-90.0, marks=pytest.mark.soak)])
def test_quarter_turns_of_a_map_change_nothing(direction):
    design = RidgeDesign(100.0, 10.0)
    turned = turned_ridges(design, (401, 401), 1.0, direction_deg=direction, phase=0.2)
    found = predict_height_map(turned, MATERIAL, POSES, Convention(facet_azimuth_deg=30.0))
    ideal = predict_design(design, MATERIAL, POSES, Convention(facet_azimuth_deg=30.0))
    np.testing.assert_allclose(found.radiance, ideal.radiance, rtol=0.02)
    assert found.notes["facet_azimuth_on_map_deg"] == pytest.approx(direction, abs=0.01)


def test_symmetric_ridges_are_placed_by_the_direction_of_their_lines():
    grooves = GrooveDesign(100.0, 12.0)
    upright, turned = (v_grooves(grooves, (401, 401), 1.0, direction_deg=d) for d in (0.0, 90.0))
    found = [
        predict_height_map(s, MATERIAL, POSES, Convention(), bounces=1).radiance for s in (upright, turned)
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=0.01)


def test_a_seated_askew_map_is_levelled():
    design = RidgeDesign(100.0, 10.0)
    surface = ridges(design, (40, 801), (1.0, 0.5))
    rows, cols = np.indices(surface.shape)
    askew = surface.with_height(surface.height_um + 0.02 * cols - 0.01 * rows + 7.0)
    there, here = (predict_height_map(s, MATERIAL, POSES, Convention()).radiance for s in (askew, surface))
    np.testing.assert_allclose(there, here, rtol=0.01)


def test_a_map_without_ridges_says_that_it_has_none():
    rng = np.random.default_rng(4)
    found = predict_height_map(
        HeightMap(0.05 * rng.normal(size=(80, 90)), 1.0, 1.0), MATERIAL, POSES, Convention()
    )
    assert "no ridges" in found.notes["warning"]
    assert "pitch_um" not in found.notes
    assert np.all(found.radiance > 0)


def test_missing_points_are_told_and_too_many_are_refused():
    surface = ridges(RidgeDesign(100.0, 10.0), (20, 801), (1.0, 0.5))
    height = surface.height_um.copy()
    height[5, 100:140] = np.nan
    found = predict_height_map(surface.with_height(height), MATERIAL, POSES, Convention())
    assert 0 < found.notes["missing_share"] < 0.02
    height[:10] = np.nan
    with pytest.raises(HeightMapError, match="missing"):
        predict_height_map(surface.with_height(height), MATERIAL, POSES, Convention())


def test_the_printed_model_is_not_the_corrected_one():
    design = RidgeDesign(100.0, 15.0)
    printed, corrected = (
        predict_design(design, MATERIAL, POSES, Convention(), model) for model in ("printed", "corrected")
    )
    assert (printed.model, corrected.model) == ("printed", "corrected")
    assert not np.allclose(printed.radiance, corrected.radiance, rtol=0.05)
    assert len(printed.contrasts) == 6


def test_uncertainty_is_there_when_asked_for_and_leaves_the_prediction_alone():
    design = RidgeDesign(100.0, 10.0)
    surface = ridges(design, (20, 601), (1.0, 1.0))
    inputs = InputUncertainty(alpha_share=0.0, index=0.0)
    for predict, what in ((predict_design, design), (predict_height_map, surface)):
        bare = predict(what, MATERIAL, POSES, Convention())
        found = predict(what, MATERIAL, POSES, Convention(), inputs=inputs)
        assert bare.budget is bare.drawn is bare.covariance is bare.contrast_covariance("michelson") is None
        np.testing.assert_array_equal(found.radiance, bare.radiance)
        np.testing.assert_array_equal(found.budget.radiance, bare.radiance)
        assert np.linalg.eigvalsh(found.covariance).min() > -1e-15
        assert found.contrast_covariance("log_ratio").shape == (6, 6)


def test_a_map_narrower_than_its_pitch_is_refused():
    surface = ridges(RidgeDesign(100.0, 10.0), (20, 81), (1.0, 1.0))
    with pytest.raises(HeightMapError, match="80 µm wide, less than one pitch of 100 µm"):
        predict_height_map(surface, MATERIAL, POSES, Convention(), pitch_um=100.0)


def test_the_limit_of_missing_points_can_be_moved():
    surface = ridges(RidgeDesign(100.0, 10.0), (20, 801), (1.0, 0.5))
    height = surface.height_um.copy()
    height[:10] = np.nan
    holed = surface.with_height(height)
    found = predict_height_map(holed, MATERIAL, POSES, Convention(), max_missing_share=0.6)
    whole = predict_height_map(surface, MATERIAL, POSES, Convention())
    # the crests that are fitted to both differ by 0.02 µm, whose glint is 1 % of the darkest pose
    np.testing.assert_allclose(found.radiance, whole.radiance, rtol=1.5e-2)
    with pytest.raises(HeightMapError, match="limit 5%"):
        predict_height_map(holed, MATERIAL, POSES, Convention(), max_missing_share=0.05)
