"""Lamp and lens of a recipe: what cannot be a lamp is refused when the recipe is read."""

import pytest
from pydantic import ValidationError

from anisoscope.parameters.light import LightSpectrum
from anisoscope.recipe.surface import WIDEST, LightPart
from anisoscope.sim.bench.wafer import LINES
from anisoscope.sim.bench.waferpart import WaferPart


@pytest.mark.parametrize("wavelength_nm", [200.0, 300.0, 450.0])
def test_a_spectrum_that_is_too_wide_for_its_wavelength_is_refused(wavelength_nm, tmp_path):
    """The widest that is taken has wavelengths that light can have; the bench and the recipe agree on it."""
    widest = WIDEST * wavelength_nm
    assert LightPart(wavelength_nm=wavelength_nm, bandwidth_nm=widest).bandwidth_nm == widest
    lines = LightSpectrum.led(wavelength_nm, widest, LINES).wavelengths_um
    assert min(lines) > 0.1
    for part in (LightPart, lambda **told: WaferPart(file=tmp_path / "tile.npz", **told)):
        with pytest.raises(ValidationError, match=f"too wide for a lamp about {wavelength_nm:g} nm"):
            part(wavelength_nm=wavelength_nm, bandwidth_nm=1.001 * widest)
