import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.patterns import etched_levels, even_levels, random_steps, staircase

WAVELENGTHS_UM = np.linspace(0.4, 0.7, 601)


def mirror(levels_um):
    """Greatest share of the light from 400 to 700 nm that levels of equal area leave unscattered, as amplitude."""
    phases = -4j * np.pi * np.asarray(levels_um)[:, None] / WAVELENGTHS_UM
    return np.abs(np.exp(phases).mean(axis=0)).max()


@pytest.mark.parametrize(
    ("passes_nm", "left"),
    [
        ([127.3], 0.415),
        ([107.3, 157.5], 0.0893),
        ([103.3, 127.9, 166.5], 0.0188),
        ([101.8, 116.1, 142.3, 170.0], 0.0040),
    ],
)
def test_etch_passes_put_out_the_mirror_over_white_light(passes_nm, left):
    levels = etched_levels([1e-3 * depth for depth in passes_nm])
    assert len(levels) == 2 ** len(passes_nm)
    assert list(levels) == sorted(levels)
    assert levels[-1] == pytest.approx(1e-3 * sum(passes_nm))
    assert mirror(levels) == pytest.approx(left, rel=0.02)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_stairs_climb_through_their_levels_in_order(count):
    levels = even_levels(count, 0.15)
    surface = staircase(levels, (5, 200), (1.0, 0.5), 4.0)
    z = surface.height_um[0]
    assert np.allclose(np.unique(z), levels)
    assert np.allclose(z[: 8 * count : 8], levels)
    assert np.array_equal(z[8 * count :], z[: -8 * count])
    runs = np.diff(np.flatnonzero(np.diff(z) != 0.0))
    assert (runs == 8).all()


def test_turned_stairs_have_edges_along_x():
    z = staircase(even_levels(2, 0.1), (40, 30), 1.0, 5.0, direction_deg=90.0).height_um
    assert np.array_equal(z, np.broadcast_to(z[:, :1], z.shape))
    assert np.mean(z > 0.0) == pytest.approx(0.5)


def test_random_steps_use_all_levels_equally_and_keep_their_width():
    levels = etched_levels([0.1073, 0.1575])
    surface = random_steps(levels, (900, 900), 0.5, (2.0, 3.0), np.random.default_rng(0), spread=1.0)
    z = surface.height_um
    found, counts = np.unique(z, return_counts=True)
    assert np.allclose(found, levels)
    assert counts / z.size == pytest.approx(np.full(4, 0.25), abs=0.01)
    for axis, width in ((0, 2.0), (1, 3.0)):
        edges = np.flatnonzero(np.diff(z, axis=axis).any(axis=1 - axis))
        steps = np.diff(edges) * 0.5
        assert steps.min() >= width - 0.5
        assert steps.max() <= 2 * width + 0.5
        assert steps.mean() == pytest.approx(1.5 * width, rel=0.05)


def test_random_steps_come_back_by_seed_and_lines_stay_lines():
    one, two = (
        random_steps((0.0, 0.1), (50, 60), 1.0, (np.inf, 2.0), np.random.default_rng(3), spread=0.5)
        for _ in range(2)
    )
    assert np.array_equal(one.height_um, two.height_um)
    assert np.array_equal(one.height_um, np.broadcast_to(one.height_um[:1], one.shape))
    assert one.origin["width_um"] == [None, 2.0]


@pytest.mark.parametrize(
    "make",
    [
        lambda: even_levels(1, 0.1),
        lambda: even_levels(3, 0.0),
        lambda: etched_levels([]),
        lambda: etched_levels([0.1, -0.1]),
        lambda: staircase((0.0, 0.1), (9, 9), 1.0, 0.5),
        lambda: staircase((0.0,), (9, 9), 1.0, 5.0),
        lambda: random_steps((0.0, 0.1), (9, 9), 1.0, (0.5, 2.0), np.random.default_rng(0)),
        lambda: random_steps((0.0, 0.1), (9, 9), 1.0, (2.0, 2.0), np.random.default_rng(0), spread=-1.0),
    ],
)
def test_stairs_that_cannot_be(make):
    with pytest.raises(HeightMapError):
        make()
