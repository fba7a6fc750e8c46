"""What differences between two maps do to contrasts: known designs, one property changed at a time."""

import numpy as np
import pytest
from scipy import ndimage

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.contrast_change import contrast_change
from anisoscope.prediction.predict import predict_design
from anisoscope.profiles.comparison import compare_maps
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import pose_grid

TOOL, PART = RidgeDesign(60.0, 10.0), RidgeDesign(60.0, 9.0, edge_radius_um=5.0)


def mapped(design, seed, moved=0):
    """A map of a design with its own noise and one mark by which its place is found."""
    made = ridges(design, (60, 420), 0.75)
    rng = np.random.default_rng(seed)
    z = made.height_um + 0.002 * rng.standard_normal(made.shape)
    y, x = np.mgrid[: made.shape[0], : made.shape[1]]
    z -= 1.5 * np.exp(-((x - 170.0) ** 2 + (y - 30.0) ** 2) / 60.0)
    return HeightMap(z[:, moved:], 0.75, 0.75)


@pytest.fixture(scope="module")
def changed(surface_recipe):
    found = compare_maps(mapped(TOOL, 1), mapped(PART, 2, moved=5))
    return found, contrast_change(found, surface_recipe)


@pytest.fixture(scope="module")
def surface_recipe():
    table = {
        "schema": 1, "product": "plate", "surface": {"pitch_um": 60.0, "design": {"ridge_angle_deg": 10.0}},
        "material": {"alpha_along": 0.06, "alpha_across": 0.1, "albedo": 0.2},
        "poses": {"angles_deg": (0.0, 90.0, 180.0)}, "region": {"size_mm": (1.0, 1.0)},
        "acquisition": {"exposure_s": 0.01},
    }  # fmt: skip
    return SurfaceRecipe.model_validate(table)


def test_the_contrasts_of_both_maps_are_those_of_their_designs(changed):
    """Mitsuba stands behind the design's model (tests/benchmarks); here maps, predicted as measured, meet it."""
    poses = pose_grid((0.0, 90.0, 180.0), (0.0,))
    for design, key in ((TOOL, "first"), (PART, "second")):
        ideal = predict_design(design, Material(), poses, Convention()).contrasts
        for one, expected in zip(changed[1], ideal, strict=True):
            assert getattr(one, key) == pytest.approx(expected.log_ratio, abs=0.06)


def test_causes_add_up_to_the_change(changed):
    for one in changed[1]:
        assert set(one.causes) == {"ridge angle", "height loss", "edge radius"}
        total = sum(part.value for part in one.causes.values()) + one.rest
        assert total == pytest.approx(one.second - one.first, abs=1e-12)
        assert abs(one.rest) < 0.35 * abs(one.second - one.first) + 0.03
        assert one.causes["height loss"].value == pytest.approx(0.0, abs=1e-9)  # crests are round, not level


def test_every_ridge_has_its_own_change(changed):
    found, contrasts = changed
    assert len(found.ridges) >= 4
    for one in contrasts:
        both = one.causes["ridge angle"].value + one.causes["edge radius"].value
        for ridge in found.ridges:
            assert one.ridges[ridge.number] == pytest.approx(both, abs=0.3 * abs(both) + 0.03)


def test_without_ridges_only_the_maps_are_compared(surface_recipe):
    rng = np.random.default_rng(3)
    rough = HeightMap(20.0 * ndimage.gaussian_filter(rng.standard_normal((150, 150)), 4.0), 1.0, 1.0)
    one, *_ = contrast_change(compare_maps(rough, rough), surface_recipe)
    assert one.causes == {}
    assert one.rest is None
    assert one.first == pytest.approx(one.second, abs=1e-9)
