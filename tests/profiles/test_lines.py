"""Profile parameters of ISO 21920-2 against the closed forms of a sine, a triangle and a rectangle."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.lines import line_parameters, mean_spacing, profile_parameters
from anisoscope.profiles.patterns import turned_ridges

X = np.arange(4000) * 0.25
PERIOD = 50.0
PHASE = 2 * np.pi * (X + 0.1) / PERIOD


def test_sine():
    found = profile_parameters(2.0 * np.sin(PHASE), 0.25)
    expected = {
        "Ra": 4.0 / np.pi, "Rq": np.sqrt(2.0), "Rz": 4.0, "Rp": 2.0, "Rv": 2.0, "Rt": 4.0, "Rsk": 0.0, "Rku": 1.5,
        "Rz_hills": 4.0, "Rdq": 2.0 * 2 * np.pi / PERIOD / np.sqrt(2.0), "Rsm": PERIOD,
    }  # fmt: skip
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-6)


def test_triangle_and_rectangle():
    triangle = profile_parameters(np.abs((X / PERIOD) % 1.0 - 0.5) * 8.0, 0.25)
    assert [triangle[name] for name in ("Ra", "Rq", "Rku", "Rt")] == pytest.approx(
        [1.0, 2.0 / np.sqrt(3.0), 1.8, 4.0], rel=2e-3
    )
    rectangle = profile_parameters(np.where((X / PERIOD) % 1.0 < 0.25, 3.0, -1.0), 0.25)
    assert [rectangle[name] for name in ("Ra", "Rq", "Rsk", "Rp", "Rv", "Rsm")] == pytest.approx(
        [1.5, np.sqrt(3.0), 2.0 / np.sqrt(3.0), 3.0, 1.0, PERIOD], rel=5e-3
    )


def test_small_waves_are_no_elements():
    wave = np.sin(PHASE) + 0.15 * np.sin(2 * np.pi * X / 3.0)
    assert profile_parameters(wave, 0.25)["Rsm"] == pytest.approx(PERIOD, rel=0.01)
    assert mean_spacing(wave, 0.25, 0.0) < 0.95 * PERIOD


def test_sections_are_means_and_the_whole_is_not():
    z = np.sin(PHASE)
    z[100] = 9.0
    found = profile_parameters(z, 0.25, 5)
    assert found["Rt"] == pytest.approx(10.0, rel=0.01)
    assert found["Rz"] == pytest.approx((4 * 2.0 + 10.0) / 5.0, rel=0.01)


def test_a_flank_does_not_count_in_the_next_section():
    z = 0.5 * np.sin(2 * np.pi * np.arange(500) / 20.0)
    z[90:111] = 8.0 - np.abs(np.arange(90, 111) - 102) * 0.6  # its summit lies in the second of five sections
    z[290:310] = -6.0  # a dale whose first point lies in the third
    mean = z.mean()
    found = profile_parameters(z, 1.0, 5)
    top, flank, bottom = 8.0 - mean, 8.0 - 3 * 0.6 - mean, 6.0 + mean
    hill, dale = 0.5 - mean, 0.5 + mean
    assert found["Rz"] == pytest.approx((top + flank + 3 * hill + 2 * bottom + 3 * dale) / 5.0, rel=2e-3)
    assert found["Rz_hills"] == pytest.approx((top + 4 * hill + bottom + 4 * dale) / 5.0, rel=2e-3)


def test_gaps_stay_out():
    z = 2.0 * np.sin(PHASE)
    z[np.random.default_rng(0).random(z.size) < 0.02] = np.nan
    found = profile_parameters(z, 0.25)
    assert found["Ra"] == pytest.approx(4.0 / np.pi, rel=0.02)
    assert found["Rsm"] == pytest.approx(PERIOD, rel=0.01)
    assert profile_parameters(np.full(100, np.nan), 0.25) == {}


@pytest.mark.parametrize("angle", [0.0, 30.0, -70.0])
def test_across_and_along_turned_ridges(angle):
    surface = turned_ridges(RidgeDesign(40.0, 10.0), (240, 240), (1.0, 1.0), direction_deg=angle)
    across, along = (line_parameters(surface, name) for name in ("across", "along"))
    height = 40.0 * np.sin(np.radians(10.0)) * np.cos(np.radians(10.0))
    assert across.values["Rsm"] == pytest.approx(40.0, rel=0.03)
    assert across.values["Rq"] == pytest.approx(height / np.sqrt(12.0), rel=0.05)
    assert along.values["Rq"] < 0.1 * across.values["Rq"]
    assert across.angle_deg == pytest.approx(angle, abs=0.2)


def test_the_l_filter_halves_a_wave_of_its_length_and_sets_the_sections():
    z = np.tile(np.sin(2 * np.pi * np.arange(1000) / 50.0), (8, 1))
    surface = HeightMap(z, 1.0, 1.0)
    found = line_parameters(surface, "x", l_filter_um=50.0, form="none")
    assert found.sections == 20
    assert found.values["Rq"] == pytest.approx(0.5 / np.sqrt(2.0), rel=0.03)
    assert line_parameters(surface, "x", s_filter_um=50.0).values["Rq"] == pytest.approx(
        0.5 / np.sqrt(2.0), rel=0.03
    )


def test_lines_that_cannot_be():
    rough = HeightMap(np.random.default_rng(0).standard_normal((60, 60)), 1.0, 1.0)
    with pytest.raises(HeightMapError, match="no ridges found"):
        line_parameters(rough)
    with pytest.raises(UsageError, match="across, along, x or y"):
        line_parameters(rough, "up")
    with pytest.raises(HeightMapError, match="below the L-filter"):
        line_parameters(rough, "x", s_filter_um=20.0, l_filter_um=10.0)
    with pytest.raises(HeightMapError, match="measured points"):
        line_parameters(HeightMap(np.random.default_rng(0).random((60, 12)), 1.0, 1.0), "x")
