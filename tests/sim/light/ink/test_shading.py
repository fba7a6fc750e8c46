"""Pictures by table against the plain sum over 41 wavelengths."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light import threads
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import white_point
from anisoscope.sim.light.colour.spaces import SRGB_TO_XYZ, ciede2000, lab
from anisoscope.sim.light.ink import shading
from anisoscope.sim.light.ink.model import MODELS
from anisoscope.sim.light.ink.shading import Light, picture
from anisoscope.sim.light.ink.shapes import Surface, cylinder, plane, sphere
from anisoscope.sim.light.ink.table import ink_table
from spectral_picture import spectral_picture

LIGHTS = [Light((0.3, 0.4, 1.0)), Light((-1.0, 0.2, 0.5), 2.0, standard("a"))]


def apart(one, other):
    """CIEDE2000 of linear sRGB pictures, of all pixels that are not black."""
    white = white_point(standard("d65"))
    seen = np.any(other != 0.0, axis=-1)
    assert seen.any()
    first, second = (lab(picture[seen] @ SRGB_TO_XYZ.T, white) for picture in (one, other))
    return ciede2000(first, second)


@pytest.mark.parametrize("model", MODELS)
def test_table_shading_equals_the_sum_over_wavelengths(inks, rng, model):
    surface = sphere(48, 56)
    coverage = rng.dirichlet((1, 1, 1), (48, 56))
    given = {"coverage": coverage, "model": model, "to_camera": (0.1, -0.2, 1.0)}
    exact = spectral_picture(surface, inks, LIGHTS, **given)
    assert apart(picture(surface, inks, LIGHTS, **given), exact).max() < 1e-3


@pytest.mark.parametrize("model", ["goniochromatic", "schlick"])
@pytest.mark.parametrize(
    "changes",
    [
        {"alpha_y": 0.35, "brush_deg": 30.0},
        {"distribution": "beckmann"},
        {"alpha": 0.03},
        {"alpha": 0.6, "alpha_y": 0.2, "distribution": "beckmann"},
    ],
)
def test_every_kind_of_lobe(make_ink, inks, changes, model):
    """Beside another ink, so that runs of equal lobes end and begin."""
    surface, painted = cylinder(24, 40), [inks[0], make_ink(**changes), inks[2], inks[1]]
    given = {"coverage": np.full((1, 1, 4), 0.25), "model": model}
    exact = spectral_picture(surface, painted, LIGHTS, **given)
    found = picture(surface, painted, LIGHTS, **given)
    np.testing.assert_allclose(found, exact, atol=3e-5 * exact.max())
    assert apart(found, exact).max() < 2e-3


@pytest.mark.parametrize("by_series", [True, False])
@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("rows", [1, 16])
def test_polynomials_and_tables_show_the_same(make_ink, inks, rng, monkeypatch, by_series, even, rows):
    """Lobes of several widths in turn, pixels with nothing among them, and as many rows as inks cover evenly: one."""
    painted = [inks[0], inks[1], make_ink(alpha=0.3), inks[2]]
    surface = sphere(rows, 40, 1.0 if rows == 1 else 0.6)
    given = {
        "coverage": rng.dirichlet((1, 1, 1, 1), (1, 1) if even else (rows, 40)),
        "to_camera": (0.1, 0.2, 1),
    }
    if not by_series:
        monkeypatch.setattr(shading, "_by_series", lambda *_: None)
    found = picture(surface, painted, LIGHTS, **given)
    exact = spectral_picture(surface, painted, LIGHTS, **given)
    np.testing.assert_allclose(found, exact, atol=3e-5 * exact.max())
    assert np.array_equal(np.any(found != 0.0, axis=-1), np.any(exact != 0.0, axis=-1))


def test_colours_that_no_polynomial_follows_go_by_table(make_ink):
    steep = make_ink(c=tuple(np.linspace(-9.0, 12.0, 41)))
    assert ink_table(steep, standard("d65")).series is None
    exact = spectral_picture(sphere(24, 24), [steep], LIGHTS)
    np.testing.assert_allclose(
        picture(sphere(24, 24), [steep], LIGHTS), exact, rtol=2e-3, atol=1e-4 * exact.max()
    )


def test_a_picture_may_be_filled_again(inks):
    surface, kept = sphere(20, 30), np.full((20, 30, 3), np.nan, dtype=np.float32)
    shown = picture(surface, inks[:1], LIGHTS, out=kept)
    assert shown is kept
    np.testing.assert_array_equal(shown, picture(surface, inks[:1], LIGHTS))
    for wrong in (np.empty((20, 30, 3)), kept[:, ::2], kept[:5]):
        with pytest.raises(ModelError, match=r"filled into a contiguous array of float32 of \(20, 30, 3\)"):
            picture(surface, inks[:1], LIGHTS, out=wrong)


def test_a_table_keeps_what_is_out_of_gamut_and_is_made_once(inks):
    table = ink_table(inks[1], standard("d65"))
    assert table.rgb.shape == (256, 3)
    assert table.rgb.min() < 0.0
    assert ink_table(inks[1], standard("d65")) is table
    finer = ink_table(inks[1], standard("d65"), entries=4001)
    x = np.linspace(0, 1, 3001)
    np.testing.assert_allclose(table.at(x), finer.at(x), atol=2e-5 * finer.rgb.max())


def test_a_plane_has_the_colour_of_its_angles(inks):
    """One pixel by hand: irradiance π, light and eye 25° on either side of the normal, Y as the eye sees it."""
    tilted = plane(2, 3, 25.0, 0.0)
    light = Light((np.sin(np.radians(50)), 0.0, np.cos(np.radians(50))))
    found = picture(tilted, inks[:1], [light])
    x = 1 - np.cos(np.radians(25))
    expected = np.pi * np.cos(np.radians(25)) * ink_table(inks[0], standard("d65")).at(np.array(x))
    np.testing.assert_allclose(found[1, 2], expected / (4 * np.pi * 0.19**2), rtol=1e-4)


def test_threads_change_nothing(inks, monkeypatch):
    surface = sphere(40, 40)
    one, many = [], []
    for count, kept in ((1, one), (5, many)):
        monkeypatch.setattr(threads, "count", lambda count=count: count)
        kept.append(picture(surface, inks[:1], LIGHTS))
    np.testing.assert_array_equal(one[0], many[0])


def test_nothing_is_black_and_light_from_behind_is_not_seen(inks):
    surface = sphere(21, 21)
    behind = picture(surface, inks[:1], [Light((0.0, 0.0, -1.0))])
    assert np.all(behind == 0.0)
    found = picture(surface, inks[:1], LIGHTS)
    assert np.isfinite(found).all()
    assert np.all(found[0, 0] == 0.0)
    assert found[10, 10].max() > 0.0


@pytest.mark.parametrize("surface", [sphere(31, 31), cylinder(20, 31), plane(8, 9, 30.0, 60.0)])
def test_shapes_have_unit_frames(surface):
    seen = np.any(surface.normal != 0.0, axis=-1)
    assert isinstance(surface, Surface)
    np.testing.assert_allclose(np.linalg.norm(surface.normal[seen], axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(surface.tangent[seen], axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sum(surface.normal[seen] * surface.tangent[seen], axis=1), 0.0, atol=1e-6)
    assert np.all((surface.uv[seen] >= 0.0) & (surface.uv[seen] <= 1.0))
    assert np.isnan(surface.uv[~seen]).all()


def test_shapes_know_left_from_right():
    ball = sphere(31, 31)
    assert ball.normal[15, 25, 0] > 0.5
    assert ball.normal[5, 15, 1] > 0.5
    assert ball.uv[15, 25, 0] > 0.6
    assert ball.uv[5, 15, 1] > 0.6
    for shape in ((5, 5), (3, 1), (1, 1)):
        middle = cylinder(*shape).normal[shape[0] // 2, shape[1] // 2]
        np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-6)
    assert cylinder(4, 8, 0.5).normal[1, :, 2].astype(bool).tolist() == [False] * 2 + [True] * 4 + [False] * 2
    np.testing.assert_allclose(plane(3, 3, 30.0, 90.0).normal[0, 0], [0, 0.5, np.sqrt(0.75)], atol=1e-6)


def test_what_does_not_fit_is_refused(inks):
    surface = sphere(8, 8)
    with pytest.raises(ModelError, match="an ink and a light"):
        picture(surface, inks, [])
    with pytest.raises(ModelError, match="need a coverage"):
        picture(surface, inks, LIGHTS)
    with pytest.raises(ModelError, match="rows, cols, inks"):
        picture(surface, inks, LIGHTS, coverage=np.ones((8, 7, 3)))
    with pytest.raises(ModelError, match="direction"):
        picture(surface, inks[:1], [Light((0.0, 0.0, 0.0))])
    with pytest.raises(ModelError, match="90"):
        plane(4, 4, 90.0)
    with pytest.raises(ModelError, match="rows"):
        sphere(0, 4)
    with pytest.raises(ModelError, match="fill"):
        cylinder(4, 4, 0.0)
    with pytest.raises(ModelError, match="two entries"):
        ink_table(inks[0], standard("a"), entries=1)
