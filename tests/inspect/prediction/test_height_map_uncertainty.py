"""What a map adds to the uncertainty, against brute force."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import (
    best_band,
    height_noise,
    map_contributions,
    pixel_bias,
    relief_surface,
    ridge_scatter,
)
from anisoscope.prediction.predict import predict_height_map
from anisoscope.prediction.sensitivity import Shape
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief, radiance

POSES = pose_grid((0.0, 90.0, 180.0))
SEEN = directions(POSES, Convention())
PLASTIC = Material()
IDEAL = ridges(RidgeDesign(100.0, 10.0), (41, 501), (2.0, 1.0), 0.3)


def relief_of(surface):
    return Relief(surface, 100.0)


def of(relief):
    return radiance(relief, *SEEN, PLASTIC)


def test_noise_of_a_map_shifts_and_scatters_its_radiance_as_stated():
    relief, noise = relief_of(IDEAL), 0.02
    rng = np.random.default_rng(7)
    plain = of(relief)
    found = np.array(
        [
            of(relief_of(IDEAL.with_height(IDEAL.height_um + noise * rng.normal(size=IDEAL.shape))))
            for _ in range(60)
        ]
    )
    shift, scatter = height_noise(
        relief, SEEN, PLASTIC, plain, noise, np.random.default_rng(0), realisations=40
    )
    error = np.sqrt(np.diag(scatter.matrix) * (1 / 40 + 1 / 60))
    assert np.all(np.abs(shift.absolute - (found.mean(axis=0) - plain)) < 4.0 * error)
    assert np.abs(shift.absolute[0]) > 10.0 * error[0]  # a shift that is there
    np.testing.assert_allclose(np.sqrt(np.diag(scatter.matrix)), found.std(axis=0, ddof=1), rtol=0.44)
    stated = np.corrcoef(found.T)[0, 1]
    got = scatter.matrix[0, 1] / np.sqrt(scatter.matrix[0, 0] * scatter.matrix[1, 1])
    assert got == pytest.approx(stated, abs=0.5)


def test_the_scatter_of_a_band_is_scaled_to_the_whole_map():
    tall = ridges(RidgeDesign(100.0, 10.0), (640, 201), (2.0, 1.0), 0.3)
    relief = relief_of(tall)
    plain = of(relief)
    assert best_band(relief).surface.shape[0] == 160
    _, scatter = height_noise(relief, SEEN, PLASTIC, plain, 0.02, np.random.default_rng(0), realisations=30)
    rng = np.random.default_rng(5)
    whole = [
        of(relief_of(tall.with_height(tall.height_um + 0.02 * rng.normal(size=tall.shape))))
        for _ in range(25)
    ]
    np.testing.assert_allclose(np.sqrt(np.diag(scatter.matrix)), np.std(whole, axis=0, ddof=1), rtol=0.58)


def test_the_scatter_between_ridges_is_that_of_maps_of_as_many_ridges(rng):
    angles = 10.0 + 0.5 * rng.standard_normal(200)

    def made(some):
        heights = [ridges(RidgeDesign(100.0, a), (4, 100), (1.0, 1.0)).height_um for a in some]
        lowest = [height - height.min() for height in heights]
        joined = np.concatenate([*lowest, lowest[0][:, :1]], axis=1)
        return relief_of(ridges(RidgeDesign(100.0, 10.0), joined.shape, (1.0, 1.0)).with_height(joined))

    means = np.array([of(made(angles[8 * k : 8 * k + 8])) for k in range(25)])
    stated = [ridge_scatter(made(angles[8 * k : 8 * k + 8]), SEEN, PLASTIC).matrix for k in range(25)]
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.mean(stated, axis=0)))[0], means.std(axis=0, ddof=1)[0], rtol=0.44
    )
    one = ridge_scatter(made(angles[:8]), SEEN, PLASTIC).matrix
    both = ridge_scatter(made(angles[:8]), SEEN, PLASTIC, ridges_seen=4).matrix
    np.testing.assert_allclose(both, 3.0 * one)


def test_ideal_ridges_do_not_scatter_and_few_tell_nothing():
    scatter = ridge_scatter(relief_of(IDEAL), SEEN, PLASTIC)
    assert np.all(scatter.absolute < 1e-3 * of(relief_of(IDEAL)))
    three = ridges(RidgeDesign(100.0, 10.0), (4, 301), (1.0, 1.0))
    assert ridge_scatter(Relief(three, 100.0), SEEN, PLASTIC) is None
    assert ridge_scatter(Relief(IDEAL), SEEN, PLASTIC) is None


def test_missing_ridges_are_left_out_of_the_scatter():
    wide = ridges(RidgeDesign(100.0, 10.0), (5, 801), (2.0, 1.0), 0.3)
    height = wide.height_um.copy()
    height[:, 100:205] = np.nan
    holed = Relief(wide.with_height(height), 100.0, max_missing_share=0.5)
    scatter = ridge_scatter(holed, SEEN, PLASTIC)
    assert scatter is not None
    assert np.isfinite(scatter.absolute).all()


def test_pixels_larger_by_a_share_are_heights_smaller_by_it():
    """Direct light knows no length but the map's own; the pixel-size term rests on this."""
    from anisoscope.profiles.heightmap import HeightMap

    stretched = HeightMap(IDEAL.height_um, 1.01 * IDEAL.pixel_x_um, 1.01 * IDEAL.pixel_y_um)
    flat = relief_surface(relief_of(IDEAL))(Shape(height_factor=1.0 / 1.01))
    np.testing.assert_allclose(flat(*SEEN, PLASTIC), of(Relief(stretched, 101.0)), rtol=1e-4)


def test_scale_and_pixel_size_stand_in_the_budget_with_opposite_signs():
    inputs = InputUncertainty(alpha_share=0.0, index=0.0, height_scale_share=0.01, pixel_size_share=0.02)
    budget = predict_height_map(IDEAL, PLASTIC, POSES, Convention(), inputs=inputs).budget
    by_source = {c.source: c.absolute for c in budget.contributions}
    np.testing.assert_allclose(
        by_source["pixel size of the map"], -2.0 * by_source["height scale of the map"]
    )
    higher, lower = (
        predict_height_map(IDEAL.with_height(f * IDEAL.height_um), PLASTIC, POSES, Convention()).radiance
        for f in (1.01, 0.99)
    )
    np.testing.assert_allclose(
        by_source["height scale of the map"], 0.5 * (higher - lower), rtol=0.05, atol=1e-5
    )


def test_a_map_without_ridges_has_no_walls_and_no_scatter_between_them(rng):
    rough = Relief(IDEAL.with_height(0.05 * rng.normal(size=IDEAL.shape)))
    found = map_contributions(rough, SEEN, PLASTIC, of(rough), InputUncertainty())
    assert [c.source for c in found] == ["height map, overall"]


def test_the_pixel_term_is_a_rectangular_bound_of_one_pixel_a_pitch():
    found = pixel_bias(2.0, 50.0, np.array([1.0, 3.0]))
    np.testing.assert_allclose(found.absolute, np.array([1.0, 3.0]) * 0.04 / np.sqrt(3.0))
    assert (found.correlation, found.rectangular) == ("independent", True)
