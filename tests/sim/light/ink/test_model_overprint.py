"""Overprints: limits of the layer model, and energy."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.ink.model import brdf_at_angles, directional_albedo, overprint
from anisoscope.sim.materials.inks import synthetic_ink

RED, GREEN = (synthetic_ink(f"synthetic-{name}") for name in ("red", "green"))
MIRROR = np.arange(0.0, 61.0, 20.0)


def scaled(ink, factor):
    return replace(ink, rho=tuple(factor * one for one in ink.rho))


def seen(ink):
    return brdf_at_angles(ink, MIRROR, MIRROR)


def test_over_black_paper_and_over_nothing():
    np.testing.assert_allclose(seen(overprint([scaled(GREEN, 0.0), RED])), seen(RED), rtol=1e-6)
    assert overprint([RED]) is RED


def test_beneath_an_ink_that_reflects_next_to_nothing_the_lower_one_is_seen():
    np.testing.assert_allclose(seen(overprint([GREEN, scaled(RED, 1e-4)])), seen(GREEN), rtol=2e-3)


def test_two_layers_are_those_of_the_formula_within_the_form_of_an_ink():
    """Light of the lower ink goes through the upper one twice; a computation of its own at each angle."""
    over = overprint([GREEN, RED])
    lost = directional_albedo(RED, MIRROR)
    expected = seen(RED) + (1.0 - lost) ** 2 * seen(GREEN)
    np.testing.assert_allclose(seen(over), expected, rtol=0.03)
    assert np.all(seen(over) < seen(RED) + seen(GREEN))
    both = directional_albedo(over, MIRROR).max()
    assert both < directional_albedo(RED, MIRROR).max() + directional_albedo(GREEN, MIRROR).max()
    assert over.name == "synthetic red over synthetic green"


def test_the_order_counts_little_where_inks_are_weak_and_more_where_they_are_not():
    def apart(factor):
        one, other = (
            seen(overprint([scaled(a, factor), scaled(b, factor)])) for a, b in ((RED, GREEN), (GREEN, RED))
        )
        return np.abs(one - other).max() / one.max()

    assert apart(0.05) < 0.1 * apart(1.0)


def test_brushed_inks_are_refused():
    with pytest.raises(ModelError, match="isotropic"):
        overprint([GREEN, replace(RED, alpha_y=0.3)])
