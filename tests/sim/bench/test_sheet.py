"""A printed sheet in its plane: curl, dents, spots, pinholes and grain have the size that was set."""

import numpy as np
import pytest

from anisoscope.sim.bench.printpart import DentPart, PrintPart, SpotPart
from anisoscope.sim.bench.prints import grain, grid_of, inked, normals, pinholes

SIZE_MM = 2.0


def lean_deg(part, grid, azimuth_deg=0.0):
    """(rows, cols) degrees by which the normals lean towards an azimuth, within that plane."""
    x, y, z = np.moveaxis(normals(part, grid, SIZE_MM).astype(float), -1, 0)
    turn = np.radians(azimuth_deg)
    return np.degrees(np.arctan2(np.cos(turn) * x + np.sin(turn) * y, z))


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 35.0])
@pytest.mark.parametrize("curl_deg", [1.0, -3.0])
def test_curl_leans_the_normals_in_proportion_to_the_place(curl_deg, azimuth_deg):
    grid = grid_of(SIZE_MM, 20.0)
    part = PrintPart(curl_deg=curl_deg, curl_azimuth_deg=azimuth_deg)
    turn = np.radians(azimuth_deg)
    across_mm = np.cos(turn) * grid.x_mm + np.sin(turn) * grid.y_mm
    np.testing.assert_allclose(
        lean_deg(part, grid, azimuth_deg), curl_deg * across_mm / (0.5 * SIZE_MM), atol=2e-5
    )
    np.testing.assert_allclose(lean_deg(part, grid, azimuth_deg + 90.0), 0.0, atol=2e-5)


def test_a_flat_sheet_is_flat():
    np.testing.assert_array_equal(normals(PrintPart(), grid_of(1.0, 20.0), 1.0) - [0.0, 0.0, 1.0], 0.0)


def test_a_dent_leans_outwards_as_far_as_it_should_and_nowhere_else():
    grid = grid_of(SIZE_MM, 5.0)
    part = PrintPart(dents=(DentPart(x_mm=0.4, y_mm=-0.3, diameter_mm=0.6, tilt_deg=2.0),))
    lean = lean_deg(part, grid)
    row = int(np.argmin(np.abs(grid.y_mm[:, 0] + 0.3)))
    at_mm = grid.x_mm[0] - 0.4
    assert lean[row].max() == pytest.approx(2.0, abs=1e-3)
    assert at_mm[np.argmax(lean[row])] == pytest.approx(0.15, abs=0.005)  # half its radius
    assert at_mm[np.argmin(lean[row])] == pytest.approx(-0.15, abs=0.005)
    assert lean[row, np.argmin(np.abs(at_mm))] == pytest.approx(0.0, abs=1e-3)
    away = np.hypot(grid.x_mm - 0.4, grid.y_mm + 0.3) > 0.6
    assert np.abs(lean[away]).max() < 0.01


def test_spots_lack_the_ink_of_their_area():
    grid = grid_of(SIZE_MM, 10.0)
    part = PrintPart(
        coverage=0.8,
        spots=(
            SpotPart(x_mm=0.3, y_mm=0.2, diameter_mm=0.5),
            SpotPart(x_mm=-0.5, diameter_mm=0.4, missing_share=0.25),
        ),
    )
    share = inked(part, grid, np.random.default_rng(1))
    lost_mm2 = float(np.sum(0.8 - share)) * 0.01**2 / 0.8
    assert lost_mm2 == pytest.approx(np.pi / 4 * (0.5**2 + 0.25 * 0.4**2), rel=0.005)
    row, col = np.argmin(np.abs(grid.y_mm[:, 0] - 0.2)), np.argmin(np.abs(grid.x_mm[0] - 0.3))
    assert share[row, col] == 0.0
    assert share.max() == pytest.approx(0.8)


@pytest.mark.parametrize("pinhole_um", [40.0, 6.0])
def test_pinholes_take_the_share_that_was_set(pinhole_um):
    """Larger than a pixel of the raster, and smaller; holes fall at random, so their share scatters a little."""
    grid = grid_of(3.0, 10.0)
    part = PrintPart(pinhole_share=0.08, pinhole_um=pinhole_um)
    shares = [pinholes(part, grid, np.random.default_rng(seed)).mean() for seed in range(16)]
    assert np.mean(shares) == pytest.approx(0.08, rel=0.06)  # 1.024 ± .010 of large ones
    assert inked(part, grid, np.random.default_rng(0)).mean() == pytest.approx(1.0 - shares[0])


def test_a_missing_share_is_taken_of_the_covered_area():
    share = inked(PrintPart(coverage=0.6, missing_share=0.1), grid_of(1.0, 50.0), np.random.default_rng(1))
    np.testing.assert_allclose(share, 0.54)


def test_grain_has_its_mean_its_spread_its_length_and_its_seed():
    grid = grid_of(4.0, 10.0)
    part = PrintPart(grain_share=0.02, grain_um=40.0)
    found = grain(part, grid, np.random.default_rng(3))
    assert found.mean() == pytest.approx(1.0, abs=1e-12)
    assert found.std() == pytest.approx(0.02, rel=1e-9)
    spread = found - 1.0
    # a Gaussian filter of standard deviation s makes a correlation exp(-d²/4s²): 1/e at d = 2s
    at_length = np.mean(spread[:, :-4] * spread[:, 4:]) / np.mean(spread**2)
    assert at_length == pytest.approx(np.exp(-1.0), abs=0.04)
    np.testing.assert_array_equal(found, grain(part, grid, np.random.default_rng(3)))
    assert not np.array_equal(found, grain(part, grid, np.random.default_rng(4)))
    assert np.all(grain(PrintPart(grain_share=0.0), grid, np.random.default_rng(3)) == 1.0)
