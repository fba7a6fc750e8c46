"""Uncertainty of texture parameters from noise, height scale and pixel size, against closed forms."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.parameters.texture import MapUncertainty
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.textures.texture import heights, hybrid, texture_uncertainty

DRAWS = 200
SHAPE = (48, 64)


@pytest.fixture(scope="module")
def surface():
    i, j = np.indices(SHAPE)
    return HeightMap(0.5 * np.sin(2.0 * np.pi * j / 16.0) + 0.2 * np.cos(2.0 * np.pi * i / 12.0), 1.0, 2.0)


def parameters(surface):
    found = heights(surface)
    return {
        "Sa": (found.sa_um, "µm"),
        "Sq": (found.sq_um, "µm"),
        "Sdq": (hybrid(surface).sdq, ""),
    }


def test_noise_adds_in_quadrature_to_sq(surface):
    sigma, count = 0.3, SHAPE[0] * SHAPE[1]
    sq = heights(surface).sq_um
    found = texture_uncertainty(surface, parameters, MapUncertainty(height_noise_um=sigma, draws=DRAWS))["Sq"]
    whole = np.hypot(sq, sigma)
    u = np.sqrt(4.0 * sigma**2 * sq**2 + 2.0 * sigma**4) / np.sqrt(count) / (2.0 * whole)
    assert found.shift == pytest.approx(whole - sq, abs=4.0 * u / np.sqrt(DRAWS))
    assert found.u == pytest.approx(u, rel=0.2)


def test_the_height_scale_is_the_share_of_all_heights(surface):
    found = texture_uncertainty(surface, parameters, MapUncertainty(height_scale=0.03, draws=DRAWS))
    for name, (value, _) in parameters(surface).items():
        assert found[name].u / value == pytest.approx(0.03, rel=0.2)
    assert found["Sq"].shift == pytest.approx(0.0, abs=4.0 * found["Sq"].u / np.sqrt(DRAWS))


def test_the_pixel_size_is_the_share_of_slopes_alone(surface):
    found = texture_uncertainty(surface, parameters, MapUncertainty(pixel_size=0.02, draws=DRAWS))
    assert found["Sdq"].u / hybrid(surface).sdq == pytest.approx(0.02, rel=0.2)
    assert found["Sa"].u == pytest.approx(0.0, abs=1e-12)


def test_the_seed_makes_the_draws(surface):
    first, same, other = (
        texture_uncertainty(surface, parameters, MapUncertainty(0.1, draws=3, seed=seed))
        for seed in (4, 4, 5)
    )
    assert first == same
    assert first != other


def test_directions_repeat_after_half_a_turn():
    whole = HeightMap(np.full((4, 4), 180.0), 1.0, 1.0)

    def direction(surface):
        return {"Std": (float(surface.height_um.mean()) % 180.0, "°")}

    found = texture_uncertainty(whole, direction, MapUncertainty(height_scale=0.01, draws=DRAWS))
    assert found["Std"].u == pytest.approx(1.8, rel=0.2)


def test_a_value_that_the_draws_lack_has_no_uncertainty(surface):
    found = texture_uncertainty(surface, lambda _: {"Std": (float("nan"), "°")}, MapUncertainty(0.1, draws=3))
    assert np.isnan(found["Std"].u)


@pytest.mark.parametrize("inputs", [(), (-0.1,), (0.0, 0.3), (float("nan"),)])
def test_impossible_uncertainties_are_refused(inputs):
    with pytest.raises(UsageError, match=r"uncertaint|--u-height-noise"):
        MapUncertainty(*inputs, draws=3)
