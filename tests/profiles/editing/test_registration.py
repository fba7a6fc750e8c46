"""Registration against positions that are known exactly: sampled waves, ridges of closed form, stitched fields."""

import numpy as np
import pytest

from anisoscope.base.errors import RegistrationError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.editing.registration import register, registered, white_noise
from anisoscope.profiles.editing.steps import edit_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.patterns import turned_ridges


class Waves:
    """A random surface known between all points: a sum of waves of 12 to 60 µm."""

    def __init__(self, seed=0, count=60):
        rng = np.random.default_rng(seed)
        length, angle = rng.uniform(12.0, 60.0, count), rng.uniform(0.0, np.pi, count)
        self.k = 2 * np.pi / length * np.stack([np.cos(angle), np.sin(angle)])
        self.phase = rng.uniform(0.0, 2 * np.pi, count)

    def at(self, y, x):
        return sum(np.cos(kx * x + ky * y + p) for kx, ky, p in zip(*self.k, self.phase, strict=True)) * 0.2


def view(surface, shape, pixel, centre, angle_deg=0.0, scale=1.0, noise=0.02, seed=0, missing=0.03):
    """A map of a surface whose middle stands at ``centre`` (x, y), the surface turned counter-clockwise in it."""
    rng = np.random.default_rng(seed)
    y = (np.arange(shape[0]) - (shape[0] - 1) / 2)[:, None] * pixel[0] / scale
    x = (np.arange(shape[1]) - (shape[1] - 1) / 2)[None, :] * pixel[1] / scale
    a = np.radians(angle_deg)
    z = surface.at(centre[1] + np.cos(a) * y - np.sin(a) * x, centre[0] + np.cos(a) * x + np.sin(a) * y)
    z = z + noise * rng.standard_normal(shape)
    z[rng.random(shape) < missing] = np.nan
    return HeightMap(z, pixel[1], pixel[0])


@pytest.mark.parametrize(
    ("centre", "angle", "pixel"),
    [
        pytest.param((7.3, -4.6), 0.0, (1.0, 1.0), marks=pytest.mark.soak),
        ((-31.2, 18.4), 5.3, (1.0, 1.0)),
        ((11.1, 2.2), -2.0, (1.4, 0.8)),
    ],
)
def test_position_within_a_hundredth_of_a_pixel(centre, angle, pixel):
    surface = Waves()
    first = view(surface, (140, 160), (1.0, 1.0), (0.0, 0.0), seed=1)
    second = view(surface, (130, 170), pixel, centre, angle, seed=2)
    tilted = second.with_height(second.height_um + 3.0 + 0.01 * np.arange(170) * pixel[1])
    found = register(first, tilted)
    a = np.radians(angle)
    x, y = -centre[0] * np.cos(a) + centre[1] * np.sin(a), -centre[0] * np.sin(a) - centre[1] * np.cos(a)
    assert abs(found.x_um - x) < min(0.01, 4.5 * found.u_x_um)
    assert abs(found.y_um - y) < min(0.01, 4.5 * found.u_y_um)
    assert found.angle_deg == pytest.approx(angle, abs=0.01)
    assert found.scale == pytest.approx(1.0, abs=1e-3)
    assert found.scale_agrees
    assert found.slope_x == pytest.approx(0.01 * np.cos(a), abs=1e-4)
    left = registered(first, tilted, found).height_um - first.height_um
    assert 0.02 < np.nanstd(left) < 0.035
    assert abs(np.nanmedian(left)) < 0.003


def test_another_scale_is_noticed():
    surface = Waves()
    first = view(surface, (140, 160), (1.0, 1.0), (0.0, 0.0), seed=1)
    second = view(surface, (140, 160), (1.0, 1.0), (3.0, 2.0), scale=1.004, seed=2)
    found = register(first, second)
    assert found.scale == pytest.approx(1.004, abs=6e-4)
    assert not found.scale_agrees


def rough_ridges(shape, phase, shift_y, seed, noise=0.03):
    """Ridges of 40 µm at any phase with a texture that moves with them, means over pixels as an instrument gives."""
    fine = turned_ridges(
        RidgeDesign(40.0, 10.0), (2, 8 * shape[1]), (1.0, 0.125), phase=(phase + 0.4375) / 40.0
    )
    ridges = fine.with_height(np.tile(fine.height_um[0].reshape(-1, 8).mean(axis=1), (shape[0], 1)))
    y, x = np.mgrid[: shape[0], : shape[1]] * 1.0
    z = ridges.height_um + 0.1 * Waves(5).at(y - shift_y, x - phase)
    return HeightMap(z + noise * np.random.default_rng(seed).standard_normal(shape), 1.0, 1.0)


@pytest.mark.parametrize(
    "moved",
    [*(pytest.param(moved, marks=pytest.mark.soak) for moved in ((0.37, 0.62), (13.25, -7.5))), (52.6, 20.1)],
)
def test_ridges_are_found_at_their_own_place_not_pitches_away(moved):
    first, second = rough_ridges((150, 260), 0.0, 0.0, 1), rough_ridges((150, 260), moved[0], moved[1], 2)
    found = register(first, second)
    assert found.x_um == pytest.approx(moved[0], abs=0.05), found
    assert found.y_um == pytest.approx(moved[1], abs=0.05)
    assert abs(found.angle_deg) < 0.02
    assert found.ambiguity < 0.7


def test_ideal_ridges_say_what_they_do_not_tell():
    first, second = (
        HeightMap(
            turned_ridges(RidgeDesign(40.0, 10.0), (100, 260), (1.0, 1.0), phase=phase).height_um
            + 0.02 * np.random.default_rng(seed).standard_normal((100, 260)), 1.0, 1.0,
        )
        for seed, phase in ((1, 0.0), (2, 0.2))
    )  # fmt: skip
    found = register(first, second)
    assert (found.x_um - 8.0 + 20.0) % 40.0 - 20.0 == pytest.approx(0.0, abs=0.05)
    assert found.u_y_um is None
    assert found.ambiguity > 0.8


def test_worn_ridges_without_noise_are_not_moved_by_pitches():
    first = turned_ridges(RidgeDesign(100.0, 10.0), (100, 300), (2.0, 2.0))
    found = register(first, edge_wear(first, 10.0))
    assert (found.x_um, found.y_um, found.angle_deg) == pytest.approx((0.0, 0.0, 0.0), abs=0.25)
    assert found.ambiguity > 0.5


def test_maps_with_nothing_in_common_are_refused():
    first, second = (view(Waves(seed), (80, 90), (1.0, 1.0), (0.0, 0.0), seed=seed) for seed in (1, 2))
    with pytest.raises(RegistrationError, match="too little in common"):
        register(first, second)


def test_noise_of_a_steep_surface():
    _, x = np.mgrid[:200, :200] * 1.0
    z = 0.3 * x + 0.05 * np.random.default_rng(0).standard_normal(x.shape)
    z[:, 100:] += 20.0
    assert white_noise(HeightMap(z, 1.0, 1.0)) == pytest.approx(0.05, rel=0.03)


def test_stitched_fields_are_the_whole_field():
    surface = Waves(3)
    whole = view(surface, (100, 200), (1.0, 1.0), (0.0, 0.0), noise=0.0, missing=0.0)
    left = whole.with_height(whole.height_um[:, :120])
    right = view(surface, (100, 110), (1.0, 1.0), (44.7, 3.3), 1.0, noise=0.0, missing=0.0)
    tilted = right.with_height(right.height_um + 2.0 - 0.02 * np.arange(110))
    found = edit_map(left, [{"step": "stitch", "map": tilted, "x": 85.0, "y": 8.0}])
    rows, cols = found.shape
    assert cols >= 198
    facts = found.origin["history"][0]["found"]
    assert facts["overlap"] < 0.5
    assert facts["residual_um"] < 0.002
    below = max(0, rows - 100)
    top = [
        k for k in range(below + 1) if np.allclose(found.height_um[k : k + 100, :60], whole.height_um[:, :60])
    ]
    assert len(top) == 1
    part = found.height_um[top[0] : top[0] + 100, :200]
    off = part - whole.height_um[:, : part.shape[1]]
    assert np.nanmax(np.abs(off[:, 125:])) < 0.07
    aligned = edit_map(whole, [{"step": "subtract", "map": tilted, "align": True}])
    assert np.nanmax(np.abs(aligned.height_um)) < 0.07
    nominal = edit_map(left, [{"step": "stitch", "map": whole, "align": False}])
    np.testing.assert_allclose(nominal.height_um, whole.height_um, atol=1e-12)
