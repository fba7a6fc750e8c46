"""Exported textures shown by Mitsuba 3 and by our own pictures: plates, dots and normal maps, within 1 % rms."""

import cv2
import numpy as np
import pytest

from anisoscope.bsdf.formats import export
from anisoscope.bsdf.mitsuba_scene import write_classes_scene, write_normals_scene
from anisoscope.bsdf.models import of_ink, of_ridges
from anisoscope.bsdf.textures import write_height_textures
from anisoscope.operations.reflectance import design_reflectance
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.models import LobeModel, MirrorModel
from anisoscope.sim.light.picture import Plate, plate_picture, view_of
from anisoscope.sim.light.relief import Relief, radiance_maps
from anisoscope.sim.materials.inks import find_ink

try:
    import mitsuba
except ImportError:
    mitsuba = None

pytestmark = [
    pytest.mark.benchmark,
    pytest.mark.skipif(mitsuba is None, reason="needs the extra [benchmark]: make benchmark installs it"),
]
LIGHT_DEG = 10.0
TO_LIGHT = np.array([[np.sin(np.radians(LIGHT_DEG)), 0.0, np.cos(np.radians(LIGHT_DEG))]])
TO_CAMERA = np.array([[0.0, 0.0, 1.0]])


def rendered(scene, cells, samples=16):
    """(rows, cols) means of the cells of a scene."""
    mitsuba.set_variant("scalar_spectral")
    picture = np.array(mitsuba.render(mitsuba.load_file(str(scene)), spp=samples))[..., 0]
    rows, cols = cells
    side = picture.shape[0] // rows, picture.shape[1] // cols
    return picture.reshape(rows, side[0], cols, side[1]).mean(axis=(1, 3))


def rms(found, wanted):
    return float(np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


def test_a_plate_of_two_directions(tmp_path):
    """Against `render checkerboard`'s picture of the same plate."""
    design, material = RidgeDesign(100.0, 10.0), Material(0.08, 0.12)
    second = np.array([[0, 1, 1], [1, 0, 0]], dtype=bool)
    for number, turn in enumerate((0.0, 90.0)):
        export(of_ridges(design, material).turned(turn), tmp_path / f"{number}.bsdf", "rgl")
    write_classes_scene(tmp_path / "s.xml", second.astype(int), ["0.bsdf", "1.bsdf"], LIGHT_DEG)
    plate = Plate(second, 1000.0, design, material, (0.0, 90.0))
    view = view_of(Pose(0.0), Convention(LIGHT_DEG), (8, 12), 250.0)
    picture = plate_picture(plate, Pose(0.0), Convention(LIGHT_DEG), view).radiance
    wanted = picture.reshape(2, 4, 3, 4).mean(axis=(1, 3))
    found = rendered(tmp_path / "s.xml", second.shape)
    print(f"\nplate: {rms(found, wanted):.2%} rms")
    assert rms(found, wanted) < 0.01


def dots_of_inks():
    return [None, *(of_ink(find_ink(f"synthetic-{name}")).at(550.0) for name in ("red", "green", "blue"))]


def dots_of_steps():
    """A wide and a narrow lobe, and the bare mirror, on one wafer."""
    depths = {"passes_nm": (107.3, 157.5), "band_nm": (400.0, 700.0)}
    found = []
    for width in (2.0, 3.0):
        lobe = LobeModel(widths_x_um=(width,), p_a_x=(1.0,), widths_y_um=(width,), p_a_y=(1.0,))
        found.append(design_reflectance(DesignFile(name=f"{width:g}", model=lobe, **depths)).at(540.0))
    mirror = DesignFile(name="mirror", model=MirrorModel(), passes_nm=(), band_nm=(400.0, 700.0))
    return [*found, design_reflectance(mirror).at(540.0)]


@pytest.mark.parametrize("dots", [dots_of_inks, dots_of_steps], ids=["halftone", "wafer"])
def test_dots(tmp_path, dots):
    """At one wavelength, which is what one number of the picture can hold."""
    surfaces = dots()
    names = [None if one is None else f"{n}.bsdf" for n, one in enumerate(surfaces)]
    for name, one in zip(names, surfaces, strict=True):
        if one is not None:
            export(one, tmp_path / name, "rgl")
    classes = np.random.default_rng(0).permuted(np.arange(16) % len(surfaces)).reshape(4, 4)
    write_classes_scene(tmp_path / "s.xml", classes, names, LIGHT_DEG)
    cosine = TO_LIGHT[0, 2]
    each = [
        0.0 if one is None else float(one.evaluate(TO_LIGHT, TO_CAMERA)[0, 0]) * cosine for one in surfaces
    ]
    wanted = np.array(each)[classes]
    found = rendered(tmp_path / "s.xml", classes.shape)
    print(f"\n{dots.__name__}: {rms(found, wanted):.2%} rms")
    assert rms(found, wanted) < 0.01


def test_a_normal_map(tmp_path):
    """Against `render microscope`'s radiance of every facet, seen from above: hills without walls or shadows."""
    rng = np.random.default_rng(1)
    heights = cv2.GaussianBlur(rng.standard_normal((61, 81)), (0, 0), 8.0)
    surface = HeightMap(1.5 * heights / heights.std(), pixel_x_um=2.0, pixel_y_um=2.0)
    write_height_textures(surface, tmp_path)
    lobe = {"alpha": 0.1, "albedo": 0.2, "index": 1.5}
    write_normals_scene(tmp_path / "s.xml", "normals.png", (60, 80), lobe, LIGHT_DEG)
    wanted = next(iter(radiance_maps(Relief(surface), TO_LIGHT, TO_CAMERA, Material(0.1, 0.1))))[::-1]
    found = rendered(tmp_path / "s.xml", (60, 80), 64)
    print(f"\nnormal map: {rms(found, wanted):.2%} rms")
    assert rms(found, wanted) < 0.01
