"""Surfaces without noise whose ridges run along the grid: every wall is sampled at the same places."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from anisoscope.profiles.metrology.burrlist import find_outliers
from anisoscope.profiles.metrology.ridges import measure_ridges

SPEC = importlib.util.spec_from_file_location("ridgesurfaces", Path(__file__).with_name("ridgesurfaces.py"))
surfaces = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(surfaces)
Truth = surfaces.Truth

CLEAN = {"noise": 0.0, "missing": 0.0, "burrs": 0, "spikes": 0}
SMOOTH = CLEAN | {"slope_across": 1e-4, "slope_along": 1e-4, "tilt": (0.0, 0.0)}


def drawn(seed):
    """One clean surface: pitch 50 to 150 µm, most of them whole, most along the grid, pixels of 0.5, 1 or 2 µm."""
    rng = np.random.default_rng(500 + seed)
    pixel = float(rng.choice([0.5, 1.0, 2.0]))
    whole = rng.random() < 0.6
    pitch = float(rng.choice([50, 60, 80, 100, 120, 150])) if whole else float(rng.uniform(50, 150))
    angle = float(rng.choice([5, 8, 12, 15, 20]))
    wall = float(rng.choice([75, 78, 80, 82, 85, 88, 90 - angle, 90]))
    radius, direction = float(rng.choice([0, 0, 1, 2, 3])), float(rng.choice([0, 90, 0, 90, 3, 30, -70]))
    side = int(max(420.0, 5.2 * pitch / pixel))
    return Truth(
        pitch=pitch,
        angle=angle,
        wall=wall,
        radius=radius,
        direction=direction,
        pixel=(pixel, pixel),
        shape=(side, side),
        slope_across=float(rng.choice([0.0, 0.0, 1e-4])),
        slope_along=1e-4,
        tilt=(0.0, 0.0) if rng.random() < 0.5 else (0.3, -0.2),
        lean=int(rng.choice([-1, 1])),
        **CLEAN,
    )


def statements(truth, found):
    """Every statement about the surface: name, error over uncertainty (0 for a bound that holds, else infinite)."""
    pairs = {
        "pitch": (found.pitch_um, truth.pitch),
        "direction": (found.direction_deg, truth.direction),
        "ridge angle": (found.ridge_angle_deg, truth.ridge_angle()),
        "wall angle": (found.wall_angle_deg, truth.wall_angle()),
        "height": (found.height_um, truth.full_height * (1.0 - truth.whole_loss)),
        "height loss": (found.height_loss, truth.whole_loss),
        "edge radius": (found.edge_radius_um, truth.radius),
    }
    for name, (quantity, true) in pairs.items():
        if quantity.value is None:
            low = -np.inf if quantity.at_least is None else quantity.at_least
            high = np.inf if quantity.at_most is None else quantity.at_most
            yield name, 0.0 if low - 1e-6 <= true <= high + 1e-6 else np.inf
            continue
        error = quantity.value - true
        if name == "direction":
            error = (error + 90.0) % 180.0 - 90.0
        assert quantity.u > 0.0
        yield name, abs(error) / quantity.u


@pytest.mark.parametrize("pitch", [60.0, pytest.param(80.0, marks=pytest.mark.soak), 100.0])
@pytest.mark.parametrize(
    ("angle", "wall", "radius"), [(12.0, 78.0, 0.0), (8.0, 82.0, 2.0), (8.0, 82.0, 0.0), (5.0, 85.0, 2.0)]
)
def test_whole_pixel_pitches_along_the_grid(pitch, angle, wall, radius):
    truth = Truth(pitch=pitch, angle=angle, wall=wall, radius=radius, shape=(150, 540), **SMOOTH)
    found = measure_ridges(truth.surface(1))
    for name, ratio in statements(truth, found):
        assert ratio <= 3.0, name
    if found.wall_angle_deg.value is not None:
        assert found.wall_angle_deg.u < 2.0


def test_a_wall_sampled_at_a_single_place_is_a_bound():
    """Of this wall, 2.5 pixels wide, one place alone lies between 20 % and 80 % of its height."""
    for seed in range(4):
        truth = Truth(pitch=60.0, angle=12.0, wall=78.0, shape=(120, 330), **SMOOTH)
        found = measure_ridges(truth.surface(seed)).wall_angle_deg
        if found.value is None:
            assert 60.0 < found.at_least <= 78.0
        else:
            assert 0.01 < found.u < 2.0
            assert abs(found.value - 78.0) <= 3.0 * found.u


@pytest.mark.parametrize("direction", [0.0, 90.0, 30.0])
def test_a_surface_without_noise_is_measured(direction):
    truth = Truth(angle=15.0, wall=80.0, direction=direction, shape=(430, 430), slope_across=0.0, **CLEAN)
    found = measure_ridges(truth.surface(2))
    for name, ratio in statements(truth, found):
        assert ratio <= 3.0, name
    assert 1e-6 < found.ridge_angle_deg.u < 0.01
    assert found.burrs == ()


def test_a_crest_rounded_down_to_the_foot_has_no_wall_to_measure():
    truth = Truth(pitch=50.0, angle=5.0, wall=82.0, radius=3.0, pixel=(0.5, 0.5), shape=(300, 540), **SMOOTH)
    found = measure_ridges(truth.surface(3))
    assert found.wall_angle_deg.value is None
    assert found.wall_angle_deg.at_least < 82.0
    for name, ratio in statements(truth, found):
        assert ratio <= 3.0, name


@pytest.mark.parametrize("seed", [49, 87])
def test_ideal_facets_of_few_heights_are_not_rounded_ones(seed):
    truth = drawn(seed)
    found = statements(truth, measure_ridges(truth.surface(seed)))
    assert max(abs(ratio) for _, ratio in found) < 3.0


@pytest.mark.soak
def test_three_hundred_clean_surfaces():
    """Statements are right within 3u, bounds hold, and nothing is stated with an uncertainty of 0."""
    ratios = {}
    for seed in range(300):
        truth = drawn(seed)
        for name, ratio in statements(truth, measure_ridges(truth.surface(seed))):
            ratios.setdefault(name, []).append(ratio)
    lines = [f"{name}: {np.mean(np.array(all_) <= 3.0):.2%} of {len(all_)}" for name, all_ in ratios.items()]
    sys.stdout.write("\n" + "\n".join(lines) + "\n")
    assert min(np.mean(np.array(all_) <= 3.0) for all_ in ratios.values()) >= 0.99, lines


def test_what_stands_out_where_nothing_scatters():
    """No limit at all, as of a map without scatter: every height above it stands out, and nothing is divided."""
    above = np.zeros((20, 30))
    above[5:8, 5:8], above[12, 20] = 2.0, -1.0
    limit = np.zeros(4)
    found, out = find_outliers(above, np.zeros(above.shape, dtype=np.int16), limit, limit, (1.0, 1.0))
    assert [(one.kind, one.height_um, one.points) for one in found] == [("burr", 2.0, 9), ("spike", -1.0, 1)]
    assert out[6, 6]
    assert out[12, 20]
