"""Real files: dimensions, pixel, missing points and Sq as the files' own repositories assert them."""

import numpy as np
import pytest
from scipy import ndimage

from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.textures.amplitude import amplitude

# file, (rows, cols), field (y, x) in µm, missing points, Sq in µm, reader
FILES = [
    (
        "opengps_ski.x3p",
        (940, 1197),
        (940 * 3.680270397, 1197 * 3.678887926),
        4272,
        18.15496570,
        "anisoscope",
    ),
    (
        "opengps_rubber.x3p",
        (634, 860),
        (634 * 2.279794519, 860 * 2.279984215),
        5296,
        3.398871811,
        "anisoscope",
    ),
    (
        "digitalsurf_ridged.x3p",
        (650, 650),
        (204.4783737930349, 82.9767313942749),
        0,
        0.07728033,
        "anisoscope",
    ),
    ("sensofar_ground.plu", (576, 768), (956.160049, 1274.880066), 0, 2.834391, "anisoscope"),
    ("alicona.al3d", (296, 200), (129.655992, 87.6054), 0, 7.688266, "SurfaceTopography"),
    ("wyko.opd", (480, 640), (94.431855, 125.909140), 116, 0.00835645116, "anisoscope"),
    ("iso25178-71_ascii.sdf", (4, 7), (4.0, 7.0), 0, 0.0136028973, "anisoscope"),
    ("digitalsurf.sur", (484, 563), (484 * 3.484, 563 * 3.484), 117, 0.0175179, "anisoscope"),
    ("zygo_metropro.dat", (480, 640), (527.1610, 702.8813), 0, 0.07528822, "anisoscope"),
]
CURVED = [("sensofar_ground.plu", 0.01818, 1e-4), ("zygo_metropro.dat", 0.003911386, 1e-5)]

pytestmark = pytest.mark.realdata


@pytest.mark.parametrize("name", ["wyko.opd", "zygo_metropro.dat"])
def test_the_intensity_lies_on_the_heights(name, real_file):
    """Slopes reflect less light into the objective: the picture is darker there, in this orientation and no other."""
    surface = read_height_map(real_file(name))
    height = np.nan_to_num(surface.height_um, nan=float(np.nanmedian(surface.height_um)))
    fine, light = (
        ndimage.gaussian_filter(one, 1.5) - ndimage.gaussian_filter(one, 8.0)
        for one in (height, surface.layers["intensity"].astype(float))
    )
    slope = np.hypot(*np.gradient(fine))
    turns = (light, light[::-1], light[:, ::-1], light[::-1, ::-1])
    right, *wrong = (float(np.corrcoef(slope.ravel(), turn.ravel())[0, 1]) for turn in turns)
    assert right < -0.3
    assert max(map(abs, wrong)) < 0.05


@pytest.mark.parametrize(("name", "shape", "field", "missing", "sq", "reader"), FILES)
def test_dimensions_pixel_missing_points_and_sq(real_file, name, shape, field, missing, sq, reader):
    surface = read_height_map(real_file(name))
    assert surface.shape == shape
    assert surface.extent_um == pytest.approx(field, rel=1e-6)
    assert np.count_nonzero(np.isnan(surface.height_um)) == missing
    assert amplitude(surface).sq_um == pytest.approx(sq, rel=1e-5)
    assert surface.origin["reader"].startswith(reader)


@pytest.mark.parametrize(("name", "sq", "tolerance"), CURVED)
def test_sq_without_curvature(real_file, name, sq, tolerance):
    height = read_height_map(real_file(name)).height_um
    y, x = (axis / max(height.shape) for axis in np.mgrid[: height.shape[0], : height.shape[1]].astype(float))
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=-1).reshape(-1, 6)
    found, *_ = np.linalg.lstsq(terms, height.ravel(), rcond=None)
    assert np.std(height.ravel() - terms @ found) == pytest.approx(sq, rel=tolerance)


@pytest.mark.parametrize(
    "name", ["sensofar_ground.plu", "wyko.opd", "zygo_metropro.dat", "opengps_rubber.x3p"]
)
def test_own_readers_agree_with_the_library(real_file, name):
    from anisoscope.profiles.files.library import read_library

    keys = {".plu": "plu", ".opd": "opd", ".dat": "metropro", ".x3p": "x3p"}
    path = real_file(name)
    library = read_library(path, key=keys[path.suffix])
    height = read_height_map(path, rows="up").height_um
    height = height[::-1] if path.suffix == ".opd" else height  # the library turns columns top down
    np.testing.assert_allclose(height, library.height_um, rtol=1e-9)


def test_metadata_travel(real_file):
    plu = read_height_map(real_file("sensofar_ground.plu")).origin
    assert plu["instrument"] == {"manufacturer": "Sensofar", "model": "PLu neox"}
    assert plu["date"] == "2023-03-10T16:35:59"
    assert read_height_map(real_file("wyko.opd")).origin["date"] == "2015-07-07T16:19:48"
    assert read_height_map(real_file("zygo_metropro.dat")).origin["date"].startswith("2011-07-23T16:49:36")
    assert "76340.7" in str(read_height_map(real_file("alicona.al3d")).origin["corrected"])
