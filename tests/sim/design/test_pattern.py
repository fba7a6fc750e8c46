"""Patterns: labels and dithering, layouts in bounded memory, the inversion at 90°, masks there and back."""

import tracemalloc

import gdstk
import numpy as np
import pytest

from anisoscope.base.errors import ConfigError, HeightMapError, ModelError
from anisoscope.sim.design.appearance import mirrored_dots, pattern_under, screen, spectral_density
from anisoscope.sim.design.designfile import (
    DesignFile,
    mixed,
    read_design,
    read_layout,
    write_design,
    write_layout,
)
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.lobe import LobeTask, design_lobe
from anisoscope.sim.design.mask import rectangles, write_gds
from anisoscope.sim.design.maskreading import read_gds
from anisoscope.sim.design.models import AntiMirrorModel, LobeModel, MirrorModel, MixtureModel, model_density
from anisoscope.sim.design.pattern import PatternOptions, classes_of, diffused, make_layout
from anisoscope.sim.light.wave.fused import density
from anisoscope.sim.light.wave.halfvectors import half_vector
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

WHITE_PASSES = (107.3, 157.5)


def lobe_design(name, sigma_x, sigma_y, passes=(125.0,)):
    found = design_lobe(LobeTask(sigma_x), LobeTask(sigma_y))
    (wx, px), (wy, py) = ((a.widths_um.tolist(), a.probabilities.tolist()) for a in (found.x, found.y))
    model = LobeModel(widths_x_um=wx, p_a_x=px, widths_y_um=wy, p_a_y=py)
    return DesignFile(name=name, model=model, passes_nm=passes, band_nm=(500.0, 500.0))


@pytest.fixture(scope="module")
def wide_x():
    return lobe_design("wide x", 0.04, 0.01)


@pytest.fixture(scope="module")
def wide_y():
    return lobe_design("wide y", 0.01, 0.04)


@pytest.fixture(scope="module")
def hole():
    model = AntiMirrorModel(arrangement=(2, 2), widths_um=(2.0, 3.0), levels=2)
    return DesignFile(name="hole", model=model, passes_nm=(125.0,), band_nm=(500.0, 500.0))


MIRROR = DesignFile(name="mirror", model=MirrorModel(), passes_nm=(), band_nm=(400.0, 700.0))


def test_labels_are_ordered_by_brightness():
    np.testing.assert_array_equal(
        classes_of(np.array([[9, 200], [30, 9]]), 3, dither=False), [[0, 2], [1, 0]]
    )


def test_dithering_keeps_the_local_mean():
    level = np.tile(np.linspace(0.0, 2.0, 96), (64, 1))
    found = diffused(level)
    assert set(np.unique(found)) == {0, 1, 2}
    assert (
        np.abs(
            found.reshape(4, 16, 6, 16).mean(axis=(1, 3)) - level.reshape(4, 16, 6, 16).mean(axis=(1, 3))
        ).max()
        < 0.05
    )
    neighbours = np.abs(found - level).max()
    assert neighbours < 1.5


def test_more_classes_than_designs_are_refused_with_the_remedy():
    with pytest.raises(ModelError, match=r"5 different values, but there are 2 designs.*--dither"):
        classes_of(np.arange(5)[None], 2, dither=False)
    with pytest.raises(ModelError, match="leave designs out"):
        classes_of(np.arange(2)[None], 3, dither=False)


def test_designs_that_cannot_be_etched_together_are_refused(wide_x):
    other = wide_x.model_copy(update={"name": "other", "passes_nm": WHITE_PASSES})
    with pytest.raises(ModelError, match="one wafer is etched at once"):
        make_layout(np.array([[0, 1]]), [wide_x, other], np.random.default_rng(0))
    for light in ({"wavelength_nm": 600.0}, {"coherence_um": 8.0}):
        with pytest.raises(ModelError, match="one wafer is seen in one light"):
            make_layout(
                np.array([[0, 1]]), [wide_x, wide_x.model_copy(update=light)], np.random.default_rng(0)
            )
    with pytest.raises(ModelError, match="2 classes, but there are 1 designs"):
        make_layout(np.array([[0, 1]]), [wide_x], np.random.default_rng(0))
    with pytest.raises(ModelError, match="smaller picture"):
        make_layout(np.zeros((1000, 2), dtype=int), [wide_x], np.random.default_rng(0))
    with pytest.raises(ModelError, match="mirrors only"):
        make_layout(np.zeros((2, 2), dtype=int), [MIRROR], np.random.default_rng(0))


def test_no_feature_of_any_tile_is_below_the_smallest(wide_x, wide_y, hole):
    layout = make_layout(np.array([[0, 1, 2, 3]]), [wide_x, wide_y, hole, MIRROR], np.random.default_rng(0))
    for tile in layout.tiles.astype(int):
        for axis in (0, 1):
            turns = np.flatnonzero((np.diff(tile, axis=axis) != 0).any(axis=1 - axis)) + 1
            assert np.diff(turns, prepend=0, append=tile.shape[0]).min() * layout.grid_um >= 2.0


def seen(tile, h, passes_um=0.125):
    """Density of one tile in the direction of a half vector, by the wave engine that predictions use."""
    surface = WaveSurface.of(-passes_um * tile.astype(float), 0.25, cells=True)
    light = np.array([2.0 * h[0], 2.0 * h[1], np.sqrt(1.0 - 4.0 * (h[0] ** 2 + h[1] ** 2))])
    half = half_vector(light, np.array([0.0, 0.0, 1.0]))
    return density(surface, half, 0.5, Window(Extent("rect", 0.5 / 16.0)))


def test_a_quarter_turn_inverts_an_anisotropic_pattern(wide_x, wide_y):
    layout = make_layout(
        np.array([[0, 1]]), [wide_x, wide_y], np.random.default_rng(0), PatternOptions(tiles=2)
    )
    side, above = (0.06, 0.0), (0.0, 0.06)
    x = np.mean(
        [[seen(tile, h) for h in (side, above)] for tile in layout.tiles[layout.tile_class == 0]], axis=0
    )
    y = np.mean(
        [[seen(tile, h) for h in (side, above)] for tile in layout.tiles[layout.tile_class == 1]], axis=0
    )
    assert x[0] > 5.0 * y[0]
    assert y[1] > 5.0 * x[1]
    pictures = [pattern_under(layout, (wide_x, wide_y), *h)[0] for h in (side, above)]
    assert pictures[0][0, 0] > 5.0 * pictures[0][0, 1]
    assert pictures[1][0, 1] > 5.0 * pictures[1][0, 0]


def test_what_the_page_says_of_a_class_is_what_its_tiles_reflect(wide_x):
    layout = make_layout(
        np.zeros((1, 1), dtype=int), [wide_x], np.random.default_rng(1), PatternOptions(tiles=8)
    )
    for h in ((0.0, 0.0), (0.03, 0.0), (0.06, 0.0)):
        found = np.mean([seen(tile, h) for tile in layout.tiles])
        f = [np.array([4.0 * value]) for value in h]
        assert found == pytest.approx(model_density(wide_x.model, *f, 16.0, 112.0, 0.0)[0, 0], rel=0.25)


def test_four_centimetres_are_described_in_little_memory(wide_x, wide_y):
    classes = np.random.default_rng(0).integers(0, 2, (357, 357))
    tracemalloc.start()
    layout = make_layout(classes, [wide_x, wide_y], np.random.default_rng(0))
    rows = layout.dot_rows()
    first = next(rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert max(layout.size_um) == pytest.approx(39984.0)
    assert first.shape == (448, 357 * 448)
    assert peak < 4e8  # one row of dots; the whole surface has 2.6e10 points
    with pytest.raises(HeightMapError, match="choose a window"):
        layout.window()


def test_windows_are_parts_of_the_whole(wide_x, hole):
    layout = make_layout(
        np.array([[0, 1], [1, 1]]), [wide_x, hole], np.random.default_rng(0), PatternOptions(28.0)
    )
    whole = layout.window()
    part = layout.window((13.5, 20.25), (30.0, 10.5))
    np.testing.assert_array_equal(part.height_um, whole.height_um[54:174, 81:123])
    stacked = layout.heights_um[np.concatenate(list(layout.dot_rows()))]
    np.testing.assert_array_equal(stacked, whole.height_um)
    # the picture's first row is the top: y rises, so it comes last
    np.testing.assert_array_equal(layout.classes, [[1, 1], [0, 1]])
    with pytest.raises(HeightMapError, match="choose a window inside"):
        layout.window((50.0, 0.0), (30.0, 10.0))


@pytest.mark.parametrize("passes", [(125.0,), WHITE_PASSES], ids=["one pass", "two passes"])
def test_masks_come_back_as_the_same_heights(tmp_path, passes):
    designs = [lobe_design("a", 0.04, 0.02, passes), lobe_design("b µ/2", 0.02, 0.04, passes)]
    layout = make_layout(
        np.array([[0, 1, 1], [1, 0, 0]]), designs, np.random.default_rng(0), PatternOptions(28.0, 2)
    )
    counts = write_gds(layout, tmp_path / "m.gds")
    assert counts["cells"] == 1 + np.unique(layout.index).size
    np.testing.assert_allclose(read_gds(tmp_path / "m.gds").height_um, layout.window().height_um, atol=1e-12)
    with pytest.raises(ConfigError, match=r"undersampled.*--grid 0\.25"):
        read_gds(tmp_path / "m.gds", grid_um=1.0)
    part = read_gds(tmp_path / "m.gds", corner_um=(10.5, 30.25), size_um=(20.0, 40.0))
    np.testing.assert_allclose(
        part.height_um, layout.window((10.5, 30.25), (20.0, 40.0)).height_um, atol=1e-12
    )
    library = gdstk.read_gds(tmp_path / "m.gds")
    assert {polygon.layer for cell in library.cells for polygon in cell.polygons} == set(
        range(1, len(passes) + 1)
    )
    assert library.unit == pytest.approx(1e-6)


def test_a_drawing_of_somebody_else_is_read_with_depths_and_grid(tmp_path):
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    cell, top = library.new_cell("PART"), library.new_cell("TOP")
    cell.add(
        gdstk.rectangle((0.0, 0.0), (4.0, 2.0), layer=1), gdstk.regular_polygon((2.0, 5.0), 2.0, 6, layer=2)
    )
    top.add(
        gdstk.Reference(cell, (10.0, 0.0), rotation=np.pi / 2.0),
        gdstk.Reference(cell, (12.0, 0.0), columns=2, rows=1, spacing=(8.0, 8.0)),
    )
    library.write_gds(tmp_path / "t.gds")
    with pytest.raises(ConfigError, match="give --depths"):
        read_gds(tmp_path / "t.gds")
    with pytest.raises(ConfigError, match="layer 2"):
        read_gds(tmp_path / "t.gds", grid_um=0.1, passes_nm=(100.0,))
    with pytest.raises(ConfigError, match="undersampled"):
        read_gds(tmp_path / "t.gds", grid_um=2.5, passes_nm=(100.0, 50.0))
    found = read_gds(tmp_path / "t.gds", grid_um=0.05, passes_nm=(100.0, 50.0))
    area = {depth: np.isclose(found.height_um, -depth).sum() * 0.05**2 for depth in (0.1, 0.05)}
    assert area[0.1] == pytest.approx(3 * 8.0, rel=0.01)
    corner = 2.0 * np.sin(np.pi / 6.0)
    side = 2.0 * corner  # gdstk takes the side of a regular polygon
    assert area[0.05] == pytest.approx(3 * 1.5 * np.sqrt(3.0) * side**2, rel=0.02)


@pytest.mark.parametrize(
    "points",
    [
        [(0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)],
        [(np.cos(0.8 * np.pi * n), np.sin(0.8 * np.pi * n)) for n in range(5)],
        [(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (1.0, -1.0), (0.0, 3.0)],
    ],
    ids=["bow tie", "star", "dent through the other side"],
)
def test_an_outline_that_crosses_itself_is_refused(tmp_path, points):
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    library.new_cell("TOP").add(gdstk.Polygon(points, layer=1))
    library.write_gds(tmp_path / "t.gds")
    with pytest.raises(ConfigError, match=r"a polygon of layer 1 near .* crosses itself"):
        read_gds(tmp_path / "t.gds", grid_um=0.1, passes_nm=(100.0,))


def test_a_ring_cut_open_crosses_nothing(tmp_path):
    """Holes are drawn by an outline that goes in and comes back along one line."""
    ring = gdstk.boolean(gdstk.rectangle((0, 0), (4, 4)), gdstk.rectangle((1, 1), (3, 3)), "not", layer=1)
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    library.new_cell("TOP").add(*ring)
    library.write_gds(tmp_path / "t.gds")
    found = read_gds(tmp_path / "t.gds", grid_um=0.1, passes_nm=(100.0,))
    assert np.isclose(found.height_um, -0.1).sum() == pytest.approx(1200, abs=50)


def test_rectangles_cover_a_mask_once():
    mask = np.random.default_rng(0).random((40, 50)) < 0.5
    count = np.zeros(mask.shape, dtype=int)
    for x0, y0, x1, y1 in rectangles(mask):
        count[y0:y1, x0:x1] += 1
    np.testing.assert_array_equal(count, mask)


def test_files_come_back(tmp_path, wide_x, hole):
    for design in (wide_x, hole, mixed([wide_x, hole], (0.7, 0.3))):
        write_design(design, tmp_path / "d.toml")
        assert read_design(tmp_path / "d.toml") == design
    layout = make_layout(np.array([[0, 1]]), [wide_x, hole], np.random.default_rng(0), PatternOptions(28.0))
    write_layout(layout, tmp_path / "l.npz", (wide_x, hole))
    again, designs = read_layout(tmp_path / "l.npz")
    assert designs == (wide_x, hole)
    np.testing.assert_array_equal(again.window().height_um, layout.window().height_um)


def test_a_mixture_has_tiles_of_every_part_by_its_share(wide_x, hole):
    both = mixed([wide_x, hole], (0.75, 0.25))
    assert isinstance(both.model, MixtureModel)
    layout = make_layout(
        np.zeros((1, 1), dtype=int), [both], np.random.default_rng(0), PatternOptions(28.0, 8)
    )
    assert len(layout.tiles) == 8
    with pytest.raises(ModelError, match="add up to 1"):
        mixed([wide_x, hole], (0.7, 0.7))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("schema_version = 1\n", "missing"),
        ("schema_version = 2\n", "schema_version"),
        ("nonsense", "not valid TOML"),
        (
            "schema_version=1\nname='a'\npasses_nm=[]\nband_nm=[500,500]\n[model]\nkind='antimirror'\narrangement=[2,2]\nwidths_um=[2,2]\nlevels=2\n",
            "steps without levels",
        ),
        (
            "schema_version=1\nname='a'\npasses_nm=[125]\nband_nm=[500,500]\n[model]\nkind='antimirror'\narrangement=[2,2]\nwidths_um=[1,2]\nlevels=2\n",
            "narrower than min_width_um",
        ),
        (
            "schema_version=1\nname='a'\npasses_nm=[125]\nband_nm=[500,500]\n[model]\nkind='lobe'\nwidths_x_um=[]\np_a_x=[]\nwidths_y_um=[2]\np_a_y=[1]\n",
            "widths_x_um",
        ),
    ],
)
def test_design_files_that_are_none_are_refused_in_one_line(tmp_path, text, match):
    (tmp_path / "d.toml").write_text(text)
    with pytest.raises(ConfigError, match=match):
        read_design(tmp_path / "d.toml")


def test_layouts_and_masks_that_are_none_are_refused(tmp_path):
    (tmp_path / "l.npz").write_bytes(b"PK nonsense")
    with pytest.raises(ConfigError, match="not a layout"):
        read_layout(tmp_path / "l.npz")
    np.savez(tmp_path / "o.npz", a=np.zeros(3))
    with pytest.raises(ConfigError, match="not a layout"):
        read_layout(tmp_path / "o.npz")
    np.savez(tmp_path / "c.npz", a=np.zeros(30000))
    (tmp_path / "c.npz").write_bytes((tmp_path / "c.npz").read_bytes()[:-400])
    np.save(tmp_path / "one.npy", np.zeros(3))
    (tmp_path / "one.npy").rename(tmp_path / "n.npz")
    for damaged in ("c.npz", "n.npz"):
        with pytest.raises(ConfigError, match="not a layout"):
            read_layout(tmp_path / damaged)
    (tmp_path / "m.gds").write_bytes(b"not at all")
    with pytest.raises(ConfigError, match="not a GDSII"):
        read_gds(tmp_path / "m.gds")
    with pytest.raises(ConfigError, match="no such file"):
        read_gds(tmp_path / "n.gds")


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (PatternOptions(float("nan")), "must be a grid step"),
        (PatternOptions(50_000.0, 1), "too many"),
        (PatternOptions(28.0, 70_000), "too many"),
    ],
)
def test_dots_and_tiles_beyond_memory_and_index_are_refused(wide_x, options, match):
    with pytest.raises(ModelError, match=match):
        make_layout(np.zeros((1, 1), dtype=int), [wide_x], np.random.default_rng(0), options)


def test_arrays_and_passes_that_no_layout_has_are_refused():
    tiles, one, index = np.zeros((1, 4, 4), np.uint16), np.zeros(1, np.int64), np.zeros((1, 1), np.uint16)
    for parts, passes in (
        ((tiles - 1.5, one, index), (125.0,)),
        ((tiles, one - 1, index), (125.0,)),
        ((tiles, one, index.astype(int) - 1), (125.0,)),
        ((tiles, one, index), (125.0,) * 40),
    ):
        with pytest.raises(ConfigError, match="make"):
            Layout(*parts, passes, 0.25, ("a",))


def test_the_spike_of_two_levels_shows_away_from_its_wavelength_only():
    green = lobe_design("green", 0.04, 0.04, (137.5,))
    h = np.array([0.0, 0.02])  # the spike ends at 1/(2Δc): h = .0078
    found = {
        nm: one[0, 0] / one[1, 1]
        for nm, one in zip((450.0, 550.0), spectral_density(green, (450.0, 550.0), h), strict=True)
    }
    shape = np.exp(0.5 * (0.02 / 0.04) ** 2) ** 2
    assert found[550.0] == pytest.approx(shape * 1.0, rel=0.15)
    assert found[450.0] > 3.0 * found[550.0]


def test_pictures_show_the_lobe_and_scale_it(wide_x):
    lobe = screen(wide_x, white=False).srgb
    assert lobe.shape == (161, 161, 3)
    assert lobe[80, 110, 1] > 5.0 * lobe[110, 80, 1]  # wide along x
    assert lobe[..., 1].max() == pytest.approx(1.0)
    assert lobe[80, 80, 1] > lobe[80, 80, 0]  # 550 nm is green
    dots = mirrored_dots(wide_x, white=True).srgb.sum(axis=2)
    middle = dots[80, [80 - 53, 80, 80 + 53]]
    np.testing.assert_allclose(middle, middle[1], rtol=0.05)
    assert dots[80, 80] > 2.0 * dots[80 + 26, 80]
