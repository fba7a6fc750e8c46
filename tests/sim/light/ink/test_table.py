"""Tables of the colour of an ink."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.ink.model import MODELS
from anisoscope.sim.light.ink.table import SERIES_TOLERANCE, TERMS, ink_table


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("off_nm", [0.0, 3.0])
def test_what_is_measured_beyond_the_visible_changes_no_colour(model, off_nm, make_ink):
    """Nor does it stop the model of TiO2, whose index is known within the visible only."""
    ink = make_ink()
    nm = np.arange(340.0, 861.0, 10.0) + off_nm
    wide = replace(
        ink,
        wavelengths_nm=tuple(nm),
        rho=tuple(np.interp(nm, ink.nm, ink.rho)),
        c=tuple(np.interp(nm, ink.nm, ink.c)),
    )
    fine = replace(  # the same function of wavelength, within the visible
        wide,
        wavelengths_nm=tuple(nm[(nm >= 380.0) & (nm <= 780.0)]),
        rho=tuple(np.array(wide.rho)[(nm >= 380.0) & (nm <= 780.0)]),
        c=tuple(np.array(wide.c)[(nm >= 380.0) & (nm <= 780.0)]),
    )
    light = standard("a")
    tolerance = 1e-12 if off_nm == 0.0 else 1e-4
    np.testing.assert_allclose(
        ink_table(wide, light, model).rgb, ink_table(fine, light, model).rgb, rtol=0.0, atol=tolerance
    )


def test_an_entry_and_its_step_lead_to_the_next_entry(make_ink):
    table = ink_table(make_ink(), standard("d65"))
    entries = table.with_steps
    np.testing.assert_allclose(entries[:-1, :3] + entries[:-1, 3:], table.rgb[1:], rtol=1e-6, atol=1e-7)
    assert not entries[-1, 3:].any()


@pytest.mark.parametrize("c", [None, -3.0, 3.0])
def test_a_polynomial_says_what_the_wavelengths_say(make_ink, inks, c):
    """Between the entries too: against a table that is 16 times as fine, where it is less than 1e-7 off."""
    for ink in (make_ink(c=(c,) * 41),) if c is not None else inks:
        for lamp in ("d65", "a", "led-b3"):
            fine = ink_table(ink, standard(lamp), entries=4081).rgb
            series = ink_table(ink, standard(lamp)).series
            assert series.shape == (3, TERMS)
            t = np.linspace(-1.0, 1.0, len(fine), dtype=np.float32)
            off = np.abs(np.polynomial.polynomial.polyval(t, series.T).T - fine)
            assert (off / np.abs(fine).max(axis=1, keepdims=True)).max() < 1.2 * SERIES_TOLERANCE
