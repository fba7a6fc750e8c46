"""The fit of a print: states come back, with uncertainties that hold; poses that tell too little are refused."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.kinds.prints.expectation import rig_sources
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, fit_print
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.sources import of_each, total
from anisoscope.sim.light.geometry import pose_grid

STATES = [
    State(),
    State(alpha=np.log(0.30 / 0.19)),
    State(ratio=0.14, skew=-0.05, lobe=0.2),
    State(tilt_x_deg=1.0, tilt_y_deg=-0.5, alpha=0.1),
    State(alpha=-0.2, red=0.2, green=-0.1, blue=0.05, lobe=1.0),
]


@pytest.mark.parametrize("state", STATES)
def test_an_exact_print_is_found_exactly(good, state):
    recipe, expected = good
    sources = (*expected.common, *rig_sources(recipe, expected))
    fit = fit_print(expected.scene, expected.scene.log_channels(state), sources)
    for name in PARAMETERS:
        assert fit.value(name) == pytest.approx(getattr(state, name), abs=2e-4), name
    assert fit.chi2 < 1e-3
    assert fit.dof == 63 - 9


def test_uncertainties_hold(good):
    """Errors drawn from all sources: pulls of unit size, χ² as many as degrees of freedom."""
    recipe, expected = good
    sources = (*expected.common, *rig_sources(recipe, expected))
    root = np.linalg.cholesky(total(sources, 63))
    rng, pulls, chi2 = np.random.default_rng(7), [], []
    for _ in range(20):
        logs = expected.scene.log_channels() + root @ rng.standard_normal(63)
        fit = fit_print(expected.scene, logs, sources)
        pulls.append([fit.value(name) / fit.u(name) for name in PARAMETERS])
        chi2.append(fit.chi2)
    spread = np.sqrt(np.mean(np.square(pulls)))  # of 180 numbers, about 1 ± 0.06
    assert 0.8 < spread < 1.2
    assert np.mean(chi2) == pytest.approx(54.0, abs=4.0 * np.sqrt(2.0 * 54.0 / 20.0))


def test_the_gain_tells_what_a_change_of_channels_does(good):
    recipe, expected = good
    sources = (*expected.common, *rig_sources(recipe, expected))
    logs = expected.scene.log_channels()
    fit, rng = fit_print(expected.scene, logs, sources), np.random.default_rng(1)
    step = 1e-4 * rng.standard_normal(63)
    again = fit_print(expected.scene, logs + step, sources)
    moved = [again.value(name) - fit.value(name) for name in PARAMETERS]
    assert moved == pytest.approx(fit.gain @ step, rel=0.02, abs=1e-6)


def test_poses_that_do_not_tell_everything_are_refused(good):
    _, expected = good
    scene = replace(expected.scene, poses=pose_grid((0.0, 90.0), (0.0,)))
    with pytest.raises(MeasurementError, match="poses of the recipe do not determine"):
        fit_print(scene, scene.log_channels(), (of_each("noise", "measurement", np.full(6, 0.01)),))


def test_without_any_uncertainty_nothing_is_weighed(good):
    _, expected = good
    with pytest.raises(MeasurementError, match="no source of uncertainty"):
        fit_print(expected.scene, expected.scene.log_channels(), ())
