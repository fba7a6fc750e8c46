"""Photographs of a lobe on a screen, made here ray by ray from the Fraunhofer integral, and what is read from them.

Nothing is shared with what is tested: rays of a pinhole camera meet the plane of the screen, the wave of the steps is
summed at every point of the lamp, and marks are projected by the same camera.
"""

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.design.appearance import (
    Grid,
    Screen,
    compared_lobes,
    designed_intensity,
    photographed_intensity,
)
from anisoscope.sim.design.layout import Layout

NM, CELL_UM, CELLS = 532.0, 2.0, 12
COHERENCE_UM = 12.0
PASSES_NM = (70.0, 133.0)
REACH, POINTS = 0.1, 41
SIZE = (96, 112)
LIGHT_DEG = (12.0, 30.0)
TILT_DEG = (10.0, -15.0)
DISTANCE_MM = 400.0
FOCAL = 190.0


def labels():
    return np.random.default_rng(5).integers(0, 4, (CELLS, CELLS))


def layout():
    return Layout(
        labels()[None].astype(np.uint16), np.zeros(1, dtype=np.int64), np.zeros((1, 1), dtype=np.uint16), PASSES_NM,
        CELL_UM, ("unit",), NM, COHERENCE_UM,
    )  # fmt: skip


def rotation(axis, degrees):
    return cv2.Rodrigues(np.radians(degrees) * np.asarray(axis, dtype=float))[0]


def light_direction():
    theta, phi = np.radians(LIGHT_DEG)
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def plane():
    """Middle, x, y and normal of the screen: facing the mirrored beam, turned about its y, then about its new x."""
    beam = light_direction() * [-1.0, -1.0, 1.0]
    x = np.cross([0.0, 1.0, 0.0], beam)
    x /= np.linalg.norm(x)
    y = np.cross(beam, x)
    turn = rotation(y, TILT_DEG[1])
    x, n = turn @ x, turn @ beam
    turn = rotation(x, TILT_DEG[0])
    return DISTANCE_MM * beam, x, turn @ y, turn @ n


def camera():
    """Rotation rows (right, down, ahead) and place of a pinhole camera next to the sample, looking at the screen."""
    place = np.array([150.0, -60.0, 20.0])
    ahead = plane()[0] - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead]), place


def pixel_of(point):
    turn, place = camera()
    x, y, z = turn @ (point - place)
    return np.array([FOCAL * x / z + 0.5 * (SIZE[1] - 1), FOCAL * y / z + 0.5 * (SIZE[0] - 1)])


def lit_by(v):
    """(P,) radiant intensity toward (P, 3) unit vectors: the sum over 5 × 5 points of a square lamp."""
    light, um = light_direction(), 1e-3 * NM
    heights = -1e-3 * ((labels() & 1) * PASSES_NM[0] + (labels() >> 1) * PASSES_NM[1])
    heights = np.tile(heights, (2, 2))
    edges = np.arange(2 * CELLS + 1) * CELL_UM
    node, weight = np.polynomial.legendre.leggauss(5)
    middle_z = 0.5 * (light[2] + v[:, 2])
    found = np.zeros(v.shape[0])
    levels, which = np.unique(heights, return_inverse=True)
    which = which.reshape(heights.shape)
    phase = np.exp(-4j * np.pi * middle_z[:, None] * levels / um)
    for a, wa in zip(node, weight, strict=True):
        for b, wb in zip(node, weight, strict=True):
            off = 0.5 * um / COHERENCE_UM * np.array([a, b])
            fx, fy = ((light[k] + off[k] + v[:, k]) / um + 1e-9 for k in (0, 1))
            wave_x, wave_y = (np.exp(-2j * np.pi * np.outer(f, edges)) for f in (fx, fy))
            wave_x, wave_y = (
                np.diff(w, axis=1) / (-2j * np.pi * f[:, None]) for w, f in ((wave_x, fx), (wave_y, fy))
            )
            sums = [
                np.einsum("py,yx,px->p", wave_y, which == k, wave_x, optimize=True)
                for k in range(levels.size)
            ]
            found += wa * wb * np.abs(np.sum(phase.T * sums, axis=0)) ** 2
    dot = v @ light
    return found * ((1.0 + dot) / (v[:, 2] + light[2])) ** 2


@pytest.fixture(scope="module")
def photograph():
    """(rows, cols) counts of 12 bits above a dark level of 200, with noise."""
    turn, place = camera()
    middle, _, _, normal = plane()
    row, col = np.mgrid[: SIZE[0], : SIZE[1]]
    rays = (
        np.stack(
            [(col - 0.5 * (SIZE[1] - 1)) / FOCAL, (row - 0.5 * (SIZE[0] - 1)) / FOCAL, np.ones(SIZE)], -1
        )
        @ turn
    )
    along = ((middle - place) @ normal) / (rays @ normal)
    points = place + along[..., None] * rays
    r = np.linalg.norm(points, axis=-1)
    v = points / r[..., None]
    light = (lit_by(v.reshape(-1, 3)).reshape(SIZE)) * (v @ normal) / r**2
    rng = np.random.default_rng(1)
    counts = 3000.0 * light / light.max()
    return np.rint(counts + rng.normal(0.0, 4.0 + 0.1 * np.sqrt(counts)) + 200.0).clip(0, 4095)


def marks():
    middle, x, y, _ = plane()
    places = np.array([[-60.0, -50.0], [70.0, -40.0], [55.0, 60.0], [-65.0, 45.0]])
    return places, np.array([pixel_of(middle + a * x + b * y) for a, b in places])


def homography(shift_mm=(0.0, 0.0)):
    places, pixels = marks()
    return cv2.getPerspectiveTransform((places + shift_mm).astype(np.float32), pixels.astype(np.float32))


SCREEN = Screen(DISTANCE_MM, LIGHT_DEG, TILT_DEG)


def compare(light, screen=SCREEN, shift_mm=(0.0, 0.0), design=None):
    grid = Grid.of(screen, REACH, POINTS)
    seen, _ = photographed_intensity(light, homography(shift_mm), screen, grid)
    return compared_lobes(seen, designed_intensity(design or layout(), grid, NM), grid)


@pytest.fixture(scope="module")
def good(photograph):
    return compare(photograph - 200.0)


def test_the_photograph_of_the_design_is_the_design(good):
    assert good.ssim > 0.97
    assert good.correlation > 0.998
    assert good.rel_l2 < 0.05
    assert np.hypot(*good.shift_h) < 0.001
    assert np.abs(np.array(good.areas) - 1.0).max() < 0.05
    assert np.sum(good.designed_areas) == pytest.approx(1.0)
    assert good.clipped == 0.0


def test_another_design_and_a_wrong_geometry_are_seen(photograph, good):
    light = photograph - 200.0
    other = layout()
    other.tiles[0] = other.tiles[0, ::-1]
    assert compare(light, design=other).correlation < 0.8
    straight = compare(light, Screen(DISTANCE_MM, LIGHT_DEG, (0.0, 0.0)))
    assert straight.rel_l2 > 3.0 * good.rel_l2
    assert compare(photograph).rel_l2 > 2.0 * good.rel_l2  # the background left in


def test_marks_measured_off_displace_the_lobe(photograph):
    """4 mm on a screen at 400 mm are 0.01 of v, and 0.005 of h."""
    found = compare(photograph - 200.0, shift_mm=(4.0, 0.0))
    assert found.shift_h[0] == pytest.approx(0.005, abs=0.0008)
    assert found.shift_h[1] == pytest.approx(0.0, abs=0.0008)


def test_a_clipped_spike_counts_for_nothing(photograph):
    light = np.where(photograph >= 1500.0, np.nan, photograph - 200.0)
    found = compare(light)
    assert 0.0 < found.clipped < 0.2
    assert found.correlation > 0.99
    with pytest.raises(ModelError, match="clipped most"):
        compare(np.full(SIZE, np.nan))


def test_a_dead_area_of_the_lobe_is_named(photograph):
    light = photograph - 200.0
    light[:, : SIZE[1] // 2] *= 0.5
    found = np.array(compare(light).areas)
    assert found.min() < 0.75
    assert found.max() > 1.25


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: Screen(0.0), "positive distance"),
        (lambda: Screen(10.0, (85.0, 0.0)), "0 to 80°"),
        (lambda: Grid.of(Screen(10.0, (60.0, 0.0)), 0.2, 20), "horizon"),
        (lambda: compare(np.zeros((20, 20))), "outside of the photograph"),
        (
            lambda: Screen(10.0, (0.0, 0.0), (70.0, 0.0)).places(Grid.of(Screen(10.0), 0.3, 20).v),
            "do not meet",
        ),
    ],
)
def test_what_cannot_be_read_is_refused(wrong, words):
    with pytest.raises(ModelError, match=words):
        wrong()
