"""Colours of a print: the matrix, differences and their uncertainty."""

import numpy as np
import pytest

from anisoscope.base.covariance import root
from anisoscope.kinds.prints.colour import worst_direction
from anisoscope.kinds.prints.model import State
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import lab
from anisoscope.sim.materials.spectra import find_illuminant


def test_the_matrix_gives_the_colours_of_the_spectra(good):
    _, expected = good
    eye, scene = expected.eye, expected.scene
    weights = xyz_weights(find_illuminant("led-white"), scene.ink.nm)
    for state in (State(), State(shift_nm=5.0), State(missing=0.05), State(alpha=0.05)):
        wanted = lab(eye.exposure * np.pi * scene.spectra(state) @ weights, eye.white)
        off = np.linalg.norm(wanted - eye.lab(scene.channels(state)), axis=1)
        assert off.max() < 1.0
    assert eye.residual < 0.3
    assert eye.residual <= eye.residual_changed < 1.0
    assert float((expected.xyz[:, 1] * eye.exposure).max()) == pytest.approx(1.0)


def test_the_metric_is_that_of_small_differences(good):
    rng, (_, expected) = np.random.default_rng(4), good
    eye, channels = expected.eye, expected.channels
    metric = eye.metric(channels)
    for _ in range(5):
        step = 0.004 * rng.standard_normal(channels.shape)
        seen = eye.difference(channels * np.exp(step), channels)
        assert np.sqrt(np.einsum("pi,pij,pj->p", step, metric, step)) == pytest.approx(seen, rel=0.05)


def test_the_worst_direction_bounds_the_spread_of_differences(good):
    _, expected = good
    rng, eye, channels = np.random.default_rng(2), expected.eye, expected.channels[:1]
    half = 0.004 * rng.standard_normal((3, 3))
    covariance, metric = half @ half.T, eye.metric(channels)[0]
    worst = worst_direction(covariance, metric)
    size = float(worst @ metric @ worst)
    assert worst @ np.linalg.solve(covariance, worst) == pytest.approx(1.0)  # one standard uncertainty away
    drawn = rng.standard_normal((4000, 3)) @ root(covariance)
    squares = np.einsum("ni,ij,nj->n", drawn, metric, drawn)
    assert size <= squares.mean() * 1.05 <= 3.3 * size


def test_chromaticity_does_not_depend_on_brightness(good):
    _, expected = good
    assert expected.eye.uv(0.3 * expected.channels) == pytest.approx(expected.eye.uv(expected.channels))
