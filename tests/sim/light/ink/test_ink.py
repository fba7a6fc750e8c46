"""Inks: what is refused, the scale of ρ, and the albedo."""

import re

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink.angles import in_plane
from anisoscope.sim.light.ink.model import MODELS, albedo_warning, brdf, brdf_at_angles, directional_albedo


def test_a_factor_for_a_brdf_is_317_percent(make_ink):
    """White/π: skipped, everything is π/0.99 = 3.17 times too bright."""
    as_factor = make_ink(convention="factor")
    ratio = brdf_at_angles(make_ink(), 30.0, 40.0) / brdf_at_angles(as_factor, 30.0, 40.0)
    np.testing.assert_allclose(ratio, np.pi / 0.99)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"alpha": 0.0}, "alpha must"),
        ({"alpha": float("nan")}, "alpha must"),
        ({"alpha_y": 1.2}, "alpha_y must"),
        ({"convention": "percent"}, "'brdf' or 'factor'"),
        ({"distribution": "phong"}, "ggx, beckmann"),
        ({"wavelengths_nm": (400.0, 500.0)}, "as many rho and c"),
        ({"wavelengths_nm": tuple(np.arange(0.38, 0.7801, 0.01))}, "look like µm"),
        ({"wavelengths_nm": tuple(np.arange(780.0, 379.0, -10.0))}, "770 nm follows 780 nm"),
        ({"wavelengths_nm": (*np.arange(380.0, 771.0, 10.0), 900.0)}, "gap between 770 and 900"),
        ({"rho": (float("nan"), *[0.1] * 40)}, "rho at 380 nm is nan"),
        ({"rho": (*[0.1] * 40, -0.1)}, "rho at 780 nm is -0.1"),
        ({"c": (*[0.1] * 40, float("inf"))}, "c at 780 nm is inf"),
        ({"white": 99.0}, "white reference"),
    ],
)
def test_what_is_no_ink_is_refused(make_ink, changes, words):
    with pytest.raises(ModelError, match=words):
        make_ink(**changes)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
def test_albedo_equals_plain_quadrature(make_ink, hemisphere, model, kind):
    """The nodes that follow the lobe against nodes that know nothing of it."""
    ink = make_ink(alpha=0.35, alpha_y=0.25, brush_deg=30.0, distribution=kind)
    camera, solid = hemisphere(90, 160)
    for theta in (0.0, 50.0):
        light = in_plane(np.array(theta))
        plain = (camera[:, 2] * solid) @ brdf(ink, light, camera, model)
        np.testing.assert_allclose(directional_albedo(ink, theta, model), plain, rtol=4e-3)


def test_albedo_beyond_one_is_told(make_ink):
    """ρ = 1 and c = 4 sends back 1.46 of the light that falls in at 45°."""
    bright = make_ink(rho=(1.0,) * 41, c=(4.0,) * 41)
    assert directional_albedo(bright, 45.0)[0] == pytest.approx(1.457, abs=2e-3)
    assert re.search(r"exceeds 1 from 15° on \(up to 1.5[89] at 60°", albedo_warning(bright))
    assert albedo_warning(make_ink()) is None
    assert directional_albedo(bright, 45.0, "schlick").max() < 1.0
