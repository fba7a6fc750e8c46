"""Wear of closed form: worn round crests of ridges, shallow pits, and tools with their parts."""

import numpy as np
import pytest

from anisoscope.base.errors import RegistrationError, UsageError
from anisoscope.profiles.comparison import compare_maps, turned_over
from anisoscope.profiles.editing.registration import register
from anisoscope.profiles.heightmap import HeightMap

PITCH, FACET = 50.0, np.radians(10.0)
RIDGE = PITCH * np.sin(FACET) * np.cos(FACET)
INSIDE = 1.0 - np.pi / 4.0
"""Area that an arc of radius 1 misses at an edge of 90°."""
PARTS = 16


def profile(t, radius=0.0, scale=1.0, facet=FACET):
    """Ridges with perpendicular walls whose crests at multiples of the pitch are round; closed form."""
    ridge = PITCH * np.sin(facet) * np.cos(facet)
    wall = ridge * np.tan(facet)
    t = (t + wall) % PITCH - wall
    z = np.where(t < 0.0, ridge + t / np.tan(facet), ridge - t * np.tan(facet))
    if radius:
        middle = radius * (np.cos(facet) - np.sin(facet)), ridge - radius * (np.cos(facet) + np.sin(facet))
        arc = (t > -radius * np.sin(facet)) & (t < radius * np.cos(facet))
        z = np.where(arc, middle[1] + np.sqrt(np.maximum(radius**2 - (t - middle[0]) ** 2, 0.0)), z)
    return scale * z


def texture(y, x, seed=5, count=60):
    rng = np.random.default_rng(seed)
    length, angle = rng.uniform(12.0, 60.0, count), rng.uniform(0.0, np.pi, count)
    phase = rng.uniform(0.0, 2 * np.pi, count)
    kx, ky = 2 * np.pi / length * np.cos(angle), 2 * np.pi / length * np.sin(angle)
    return 0.02 * sum(np.cos(a * x + b * y + c) for a, b, c in zip(kx, ky, phase, strict=True))


def ridged(
    shape, moved=(0.0, 0.0), radius=0.0, seed=1, noise=0.03, missing=0.02, scale=1.0, facet=FACET,
    size=1.0, change=lambda y, x: 0.0,
):  # fmt: skip
    """Means over pixels of 1 µm of a ridged, textured surface moved by (x, y), ``size`` times as large."""
    rng = np.random.default_rng(seed)
    rows, cols = (0.5 * (number - 1) for number in shape)
    places = (np.arange(shape[1] * PARTS) + 0.5) / PARTS - 0.5 - moved[0]
    line = profile((places - cols) / size + cols, radius, scale, facet).reshape(-1, PARTS).mean(axis=1)
    y, x = np.mgrid[: shape[0], : shape[1]] * 1.0
    y, x = (y - moved[1] - rows) / size + rows, (x - moved[0] - cols) / size + cols
    z = line + texture(y, x) + change(y, x) + noise * rng.standard_normal(shape)
    z[rng.random(shape) < missing] = np.nan
    return HeightMap(z, 1.0, 1.0)


def lost_over(comparison, radius):
    """Volume that round crests miss over the rows and columns that both maps have."""
    common = np.isfinite(comparison.difference.height_um)
    rows, cols = np.flatnonzero(common.any(axis=1)), np.flatnonzero(common.any(axis=0))
    places = (np.arange(cols[0] * PARTS, (cols[-1] + 1) * PARTS) + 0.5) / PARTS - 0.5
    return rows.size * float(np.sum(profile(places) - profile(places, radius))) / PARTS


def test_the_reference_is_the_closed_form():
    t = np.arange(0.0, 500.0, 1e-3)
    lost = float(np.sum(profile(t) - profile(t, 4.0))) * 1e-3 / 10.0
    assert lost == pytest.approx(INSIDE * 16.0, rel=1e-4)


@pytest.mark.parametrize(
    ("radius", "moved"), [(4.0, (7.3, 3.6)), pytest.param(6.0, (-11.75, 2.2), marks=pytest.mark.soak)]
)
def test_worn_crests(radius, moved):
    shape = (160, 330)
    found = compare_maps(ridged(shape), ridged(shape, moved, radius, 2))
    assert found.placed.x_um == pytest.approx(moved[0], abs=0.05)
    assert found.placed.y_um == pytest.approx(moved[1], abs=0.05)
    expected = lost_over(found, radius)
    assert found.lost.volume_um3.value == pytest.approx(expected, rel=0.02)
    assert abs(found.lost.volume_um3.value - expected) < 4.0 * found.lost.volume_um3.u + 0.01 * expected
    assert found.gained.volume_um3.value < 0.01 * expected
    assert len(found.ridges) >= 4
    for ridge in found.ridges:
        assert ridge.lost_area_um2.value == pytest.approx(INSIDE * radius**2, rel=0.06)
        assert ridge.height_change_um.value < -0.3
        assert ridge.radius_b_um.value == pytest.approx(radius, abs=4.0 * ridge.radius_b_um.u)
    mean = np.mean([ridge.radius_b_um.value for ridge in found.ridges])
    assert mean == pytest.approx(radius, rel=0.2)
    assert "lost" in repr(found)


@pytest.mark.parametrize(
    ("radius", "moved"), [pytest.param(4.0, (3.5, 0.0), marks=pytest.mark.soak), (6.0, (-11.75, 2.2))]
)
def test_worn_ridges_with_nothing_but_walls_to_tell_their_place_by(monkeypatch, radius, moved):
    """Walls of 1.5 pixels: what shows their place shows their worn crests too, and the uncertainty says so."""
    monkeypatch.setitem(globals(), "texture", lambda y, x: 0.0 * (y + x))
    placed = register(ridged((100, 330)), ridged((100, 330), moved, radius, 2))
    aside = placed.x_um - moved[0]
    aside -= PITCH * np.round(aside / PITCH)
    assert abs(aside) < 0.15
    assert abs(aside) < 2.0 * placed.u_x_um < 0.7
    assert placed.u_y_um is None


def test_nothing_has_changed():
    shape = (150, 260)
    found = compare_maps(ridged(shape), ridged(shape, (3.4, -2.7), seed=2))
    field = np.count_nonzero(np.isfinite(found.difference.height_um))
    assert found.lost.volume_um3.value + found.gained.volume_um3.value < 0.003 * field
    assert abs(found.net_um3.value) < 4.0 * found.net_um3.u
    ratio = found.difference.height_um / found.u_um
    assert 0.7 < np.nanstd(ratio) < 1.1
    assert found.replication.relief.value == pytest.approx(1.0, abs=4.0 * found.replication.relief.u + 0.003)


@pytest.mark.parametrize(
    ("size", "moved"), [(1.001, (3.4, -2.7)), pytest.param(0.9985, (-5.2, 1.1), marks=pytest.mark.soak)]
)
def test_another_scale_is_no_wear(size, moved):
    """Of an unchanged part whose scale differs by 0.1 %, hundreds of µm³ were called lost."""
    found = compare_maps(ridged((120, 400)), ridged((120, 400), moved, seed=2, size=size))
    assert found.replication.shrinkage.value == pytest.approx(1.0 - size, abs=4e-4)
    assert found.lost.volume_um3.value + found.gained.volume_um3.value < 15.0
    assert abs(found.net_um3.value) < 3.0 * found.net_um3.u < 2000.0
    assert found.placed.x_um == pytest.approx(moved[0], abs=2.5 * found.placed.u_x_um)


def test_pits_on_ridges():
    """Six Gaussian pits of 1 µm on facets and walls; nothing is gained."""
    rng = np.random.default_rng(9)
    middles = [(rng.uniform(60.0, 340.0), rng.uniform(40.0, 160.0)) for _ in range(6)]

    def pits(y, x):
        return -sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / 72.0) for a, b in middles)

    found = compare_maps(ridged((200, 400)), ridged((200, 400), (3.4, -2.7), seed=2, change=pits))
    lost = found.lost.volume_um3
    assert abs(lost.value - 6.0 * 2.0 * np.pi * 36.0) < 2.0 * lost.u < 100.0
    assert found.gained.volume_um3.value == 0.0
    assert found.replication.shrinkage.value is None


def test_small_wear_at_sharp_walls_is_in_the_sum_of_all_differences():
    found = compare_maps(ridged((120, 330)), ridged((120, 330), (3.4, -2.7), 1.5, 2))
    expected = lost_over(found, 1.5)
    assert found.lost.volume_um3.value < 0.5 * expected
    assert abs(found.net_um3.value + expected) < 2.0 * found.net_um3.u


def test_a_shallow_pit_in_a_rough_surface():
    """A Gaussian pit of 0.3 µm, ten times the noise: 2π σ² d lost, and no ridges."""
    y, x = np.mgrid[:140, :150] * 1.0
    rng = np.random.default_rng(3)
    base = 6.0 * texture(y, x)
    moved = 6.0 * texture(y - 1.6, x + 4.3)
    pit = 0.3 * np.exp(-((x - 70.0) ** 2 + (y - 60.0) ** 2) / (2.0 * 8.0**2))
    first = HeightMap(base + 0.03 * rng.standard_normal(base.shape), 1.0, 1.0)
    worn = moved - pit + 0.03 * rng.standard_normal(base.shape)
    worn[rng.random(base.shape) < 0.02] = np.nan
    found = compare_maps(first, HeightMap(worn + 5.0 - 0.01 * x, 1.0, 1.0))
    expected = 2.0 * np.pi * 8.0**2 * 0.3
    assert found.lost.volume_um3.value == pytest.approx(expected, rel=0.04)
    assert found.lost.depth_um == pytest.approx(0.3, abs=0.05)
    assert found.placed.x_um == pytest.approx(-4.3, abs=0.02)
    away = np.hypot(x - 70.0 + 4.3, y - 60.0 - 1.6)
    assert (found.changed[away < 8.0] == -1).mean() > 0.9
    assert (found.changed[away > 30.0] != 0).mean() < 0.005
    assert found.ridges == ()
    assert "no ridges found" in found.ridges_note


def test_a_part_has_the_relief_of_its_tool_as_far_as_it_was_filled():
    shape = (70, 260)
    tool = ridged(shape, seed=1)
    part = turned_over(ridged(shape, (5.2, 1.1), seed=2, scale=0.9))
    found = compare_maps(tool, part, mirrored=True)
    assert found.mirrored
    assert found.replication.relief.value == pytest.approx(0.9, abs=0.01)
    assert found.replication.height.value == pytest.approx(0.9, abs=0.02)


def test_maps_of_other_surfaces_are_refused():
    with pytest.raises(RegistrationError, match="too little in common"):
        compare_maps(ridged((150, 260)), HeightMap(np.random.default_rng(0).random((150, 260)), 1.0, 1.0))
    with pytest.raises(UsageError, match="two HeightMaps"):
        compare_maps(ridged((150, 260)), np.eye(10))


SHRINKAGE, LOWER_DEG, FILLED = 0.006, 0.35, 5.0
PART_FACET = FACET - np.radians(LOWER_DEG)


@pytest.fixture(scope="module")
def moulded():
    """A tool, and its part: facets less steep, crests round, smaller by its shrinkage, and a patch that sank in."""
    shape = (110, 330)
    part = ridged(shape, (4.6, 2.3), FILLED, seed=2, facet=PART_FACET)
    z = part.height_um.copy()
    z[:55] = np.where(np.arange(shape[1]) > 200, 0.85 * z[:55], z[:55])
    shrunk = HeightMap(z, 1.0 - SHRINKAGE, 1.0 - SHRINKAGE)
    return compare_maps(turned_over(ridged(shape, seed=1)), shrunk, mirrored=True)


def relief_of_a_ridge():
    """Least-squares factor of the closed form of the part on that of the tool."""
    t = np.arange(0.0, PITCH, 0.01)
    tool, part = profile(t), profile(t, FILLED, facet=PART_FACET)
    a, b = tool - tool.mean(), part - part.mean()
    return a @ b / (a @ a)


def test_replication_of_every_ridge(moulded):
    assert moulded.replication.shrinkage.value == pytest.approx(SHRINKAGE, abs=5e-4)
    assert moulded.ridges_note == ""
    good = [one for one in moulded.ridges if one.position_um < 160.0]
    assert len(good) >= 3
    full = PITCH * np.sin(PART_FACET) * np.cos(PART_FACET)
    lower = FILLED * (np.cos(PART_FACET) + np.sin(PART_FACET) - 1.0)  # the top of the arc below the vertex
    for ridge in good:
        assert ridge.angle_a_deg.value == pytest.approx(10.0, abs=4.0 * ridge.angle_a_deg.u)
        assert ridge.angle_change_deg.value == pytest.approx(-LOWER_DEG, abs=0.03)
        assert ridge.radius_a_um.value is None
        assert ridge.radius_a_um.at_most < 3.5
        assert ridge.radius_b_um.value == pytest.approx(FILLED, rel=0.12)
        assert ridge.height_b_um.value == pytest.approx(full - lower, rel=0.05)
        assert ridge.relief.value == pytest.approx(relief_of_a_ridge(), abs=0.01)


def test_the_map_of_the_relief_shows_where_the_part_sank_in(moulded):
    relief = moulded.relief
    good, sunk = np.nanmedian(relief[:, 30:160]), np.nanmedian(relief[10:35, 215:260])
    assert good == pytest.approx(relief_of_a_ridge(), abs=0.01)
    assert sunk / good == pytest.approx(0.85, abs=0.02)
    assert np.isfinite(relief).mean() > 0.6


def test_without_ridges_the_relief_is_that_of_tiles():
    y, x = np.mgrid[:120, :130] * 1.0
    rough = 6.0 * texture(y, x)
    part = np.where(x < 65.0, 1.0, 0.7) * rough
    found = compare_maps(turned_over(HeightMap(rough, 1.0, 1.0)), HeightMap(part, 1.0, 1.0), mirrored=True)
    assert np.nanmedian(found.relief[:, :50]) == pytest.approx(1.0, abs=0.03)
    assert np.nanmedian(found.relief[:, 80:]) == pytest.approx(0.7, abs=0.03)
    assert found.replication.shrinkage.value is None
