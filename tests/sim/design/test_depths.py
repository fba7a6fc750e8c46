"""Etch depths against the reference figures, a brute-force mean over all levels, and a dense search."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.depths import Depths, design_depths, mean_phases, wavelengths
from anisoscope.sim.light.wave.claims import mean_phase


@pytest.mark.parametrize(
    ("levels", "passes", "epsilon"),
    [
        (2, (127.3,), 0.4155),
        (4, (107.3, 157.5), 0.0893),
        (8, (103.3, 127.9, 166.5), 0.019),
        (16, (101.8, 116.1, 142.3, 170.0), 0.0041),
    ],
)
def test_white_light_takes_the_depths_of_the_reference(levels, passes, epsilon):
    found = design_depths(levels)
    assert found.epsilon <= epsilon
    np.testing.assert_allclose(found.passes_nm, passes, atol=0.15)
    assert len(found.levels_nm) == levels


def test_the_product_is_the_mean_over_all_levels():
    found = Depths((107.3, 157.5, 90.0), (400.0, 700.0))
    for nm in (405.0, 511.0, 640.0):
        assert found.tau_at(nm) == pytest.approx(abs(mean_phase(found.levels_um, 1e-3 * nm)), abs=1e-12)


def test_no_pair_of_depths_on_a_dense_grid_is_better():
    found = design_depths(4)
    grid = np.arange(90.0, 190.0, 0.5)
    first, second = np.meshgrid(grid, grid)
    worst = mean_phases(
        np.stack([first.ravel(), second.ravel()], axis=-1), wavelengths((400.0, 700.0))[::10]
    ).max(axis=-1)
    assert found.epsilon <= worst.min() + 1e-3


def test_one_wavelength_takes_quarter_waves():
    found = design_depths(2, (550.0, 550.0))
    assert found.passes_nm == (137.5,)
    assert found.epsilon < 1e-12


def test_the_printed_bound_without_modulus_and_factor_would_accept_what_mirrors():
    """Eq. 18 as printed bounds a mean of exp(−2πi·ζ/λ): half a wave deep would do, and mirrors."""
    levels, nm = np.array([0.0, 250.0]), 500.0
    printed = np.mean(np.exp(-2j * np.pi * levels / nm))
    assert abs(printed) < 1e-12
    assert Depths((250.0,), (nm, nm)).epsilon == pytest.approx(1.0)


def test_the_spike_is_that_of_the_reference():
    assert design_depths(4).spike_over_lobe(16.0, 2.0) == pytest.approx(0.51, abs=0.01)
    assert design_depths(8).spike_over_lobe(16.0, 2.0) == pytest.approx(0.022, abs=0.001)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((3,), "2ⁿ levels"),
        ((1,), "2ⁿ levels"),
        ((4, (700.0, 400.0)), "rising"),
        ((4, (400.0, 700.0), 0.0), "h_z"),
    ],
)
def test_levels_and_bands_that_cannot_be_are_refused(arguments, match):
    with pytest.raises(ModelError, match=match):
        design_depths(*arguments)


def test_steps_without_levels_are_refused():
    with pytest.raises(ModelError, match="steps need levels"):
        Depths((), (500.0, 500.0))
