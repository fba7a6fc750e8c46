"""Pictures of ridges against Mitsuba 3: the exported body, path traced, shows both pictures.

64 × 64 and 256 × 256 fields of 100 µm from two photographs of scikit-image; isotropic roughness, because Mitsuba's lobe
cannot turn with the fields. The body of the part is read from its STL by VTK. Parallel rays from above, 8 × 8 pixels a
field, light reflected up to five times; a field is the mean of its pixels.
"""

import cv2
import numpy as np
import pytest
import pyvista
import skimage.data
from skimage.metrics import structural_similarity

from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan
from anisoscope.sim.design.plates import design_pictures
from anisoscope.sim.design.solids import Body, write_body
from anisoscope.sim.light import corrected

try:
    import mitsuba
except ImportError:
    mitsuba = None

pytestmark = [
    pytest.mark.benchmark,
    pytest.mark.skipif(mitsuba is None, reason="needs the extra [benchmark]: make benchmark installs it"),
]
FIELD_UM, PIXELS, SAMPLES = 100.0, 8, 4
STAGES = (0.0, 90.0)
ALPHA, ALBEDO, LIGHT_DEG = 0.08, 0.2, 10.0
VARIANT, DEPTH = "scalar_rgb", 6
PAGE = {64: (0.85, 0.95), 256: (0.81, 0.83)}
"""Likeness of both pictures, of so many fields, that docs/plates.md quotes."""


def photographs(fields):
    grey = [skimage.data.camera(), cv2.cvtColor(skimage.data.astronaut(), cv2.COLOR_RGB2GRAY)]
    return np.array([cv2.resize(one, (fields, fields), interpolation=cv2.INTER_AREA) / 255.0 for one in grey])


def rendered(path, middle_mm, side_mm, pixels, stage_deg, depth=DEPTH, samples=SAMPLES):
    """(pixels, pixels) radiance of a square of a body, first row at the top; it stays, and the light turns."""
    mitsuba.set_variant(VARIANT)
    body = pyvista.read(path)
    points = np.asarray(body.points, dtype=np.float32)
    faces = np.asarray(body.faces).reshape(-1, 4)[:, 1:].astype(np.uint32)
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(
        {
            "type": "roughplastic",
            "distribution": "beckmann",
            "alpha": ALPHA,
            "int_ior": 1.5,
            "ext_ior": 1.0,
            "nonlinear": True,
            "diffuse_reflectance": {"type": "rgb", "value": ALBEDO},
        }
    )
    properties["face_normals"] = True
    mesh = mitsuba.Mesh("plate", len(points), len(faces), props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"], parameters["faces"] = points.ravel(), faces.ravel()
    parameters.update()
    half = 0.5 * side_mm
    around, lean = np.radians(-stage_deg), np.radians(LIGHT_DEG)
    way = [-np.sin(lean) * np.cos(around), -np.sin(lean) * np.sin(around), -np.cos(lean)]
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1], frame[:3, 2] = [-half, 0, 0], [0, half, 0], [0, 0, -1]  # its x points left
    frame[:3, 3] = [middle_mm, middle_mm, 1.0]
    scene = {
        "type": "scene",
        "plate": mesh,
        "lamp": {"type": "directional", "direction": way, "irradiance": {"type": "rgb", "value": 1.0}},
        "integrator": {"type": "path", "max_depth": depth, "rr_depth": depth + 1},
        "camera": {
            "type": "orthographic",
            "to_world": mitsuba.ScalarTransform4f(frame),
            "near_clip": 1e-3,
            "far_clip": 10.0,
            "film": {
                "type": "hdrfilm",
                "width": pixels,
                "height": pixels,
                "pixel_format": "luminance",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": samples},
        },
    }
    return np.array(mitsuba.render(mitsuba.load_dict(scene), seed=1), dtype=np.float64)[..., 0]


def traced(path, fields, stage_deg):
    """(fields, fields) radiance of the fields of a body."""
    side = fields * FIELD_UM * 1e-3
    picture = rendered(path, 0.5 * side, side, fields * PIXELS, stage_deg)
    return picture.reshape(fields, PIXELS, fields, PIXELS).mean(axis=(1, 3))


def cross_talk(shown, own, other):
    """Weight of the other picture over that of its own."""
    basis = np.stack([own.ravel(), other.ravel(), np.ones(own.size)], axis=1)
    weight = np.linalg.lstsq(basis, shown.ravel(), rcond=None)[0]
    return abs(weight[1] / weight[0])


@pytest.mark.parametrize(
    ("radius", "foot", "depth"), [(1.0, 0.0, 2), (8.0, 0.0, 2), (1.0, 3.0, 2), (1.0, 3.0, 8)]
)
def test_light_of_the_exported_body(bench, tmp_path, judged_figure, radius, foot, depth):
    """Of ten pitches in the middle of a field, seen from above: direct light, and light of up to seven reflections."""
    design = RidgeDesign(50.0, 10.0, 10.0, edge_radius_um=radius, foot_radius_um=foot)
    write_body(Body(Plan(("A",), {"A": 0.0}, 1.0), design, 1000.0), tmp_path / "part.stl", "part")
    stages = (0.0, 45.0, 90.0, 180.0)
    lean, around = np.radians(LIGHT_DEG), np.radians(stages)
    light = np.column_stack(
        [np.sin(lean) * np.cos(around), -np.sin(lean) * np.sin(around), np.full(4, np.cos(lean))]
    )
    camera = np.broadcast_to([0.0, 0.0, 1.0], light.shape)
    expected = corrected.radiance(light, camera, design, Material(ALPHA, ALPHA, ALBEDO), bounces=depth - 1)
    works = {
        f"Mitsuba at {stage:g}°": lambda one=stage: rendered(
            tmp_path / "part.stl", 0.5, 0.5, 256, one, depth, 64
        ).mean()
        for stage in stages
    }
    title = (
        f"light of an exported body, crests of {radius:g} and feet of {foot:g} µm, {depth - 1} reflections"
    )
    run = bench.compare(title, works, rounds=1, warm=False)
    off = np.array([run[name].result for name in works]) / expected - 1.0
    bench.note("off the prediction: " + ", ".join(f"{one:+.2%}" for one in off))
    assert np.abs(off).max() < 0.005
    found = f"{np.abs(off).max():.2%}"
    judged_figure("Outline", title, f"Mitsuba {mitsuba.__version__} on the STL", found, "0.5%")


@pytest.mark.parametrize("fields", [64, 256])
def test_the_exported_body_shows_both_pictures(bench, tmp_path, fields):
    pictures = photographs(fields)
    ridges = RidgeDesign(50.0, 8.0, 10.0, edge_radius_um=1.0)
    material = Material(ALPHA, ALPHA, ALBEDO)
    found = design_pictures(pictures, STAGES, ridges, FIELD_UM, material, LIGHT_DEG)
    write_body(Body(found.plan, ridges, 1000.0), tmp_path / "part.stl", "part")
    works = {"predicted": found.likeness}
    works |= {
        f"Mitsuba at {stage:g}°": lambda one=stage: traced(tmp_path / "part.stl", fields, one)
        for stage in STAGES
    }
    run = bench.compare(f"{fields} × {fields} fields, two pictures", works, rounds=1, warm=False)
    predicted, talk = run["predicted"].result
    for number, stage in enumerate(STAGES):
        light = run[f"Mitsuba at {stage:g}°"].result
        shown = np.clip((light - found.black) / (found.white - found.black), 0.0, 1.0)
        similar = structural_similarity(shown, pictures[number], data_range=1.0)
        mixed = cross_talk(shown, pictures[number], pictures[1 - number])
        off = light / found.shown[number] - 1.0
        bench.note(
            f"at {stage:g}°: SSIM {similar:.3f} (predicted {predicted[number]:.3f}), cross-talk {mixed:.2%} "
            f"({talk[number]:.2%}); fields are brighter than predicted by {np.median(off):+.1%}, rms {np.std(off):.1%}"
        )
        assert similar == pytest.approx(PAGE[fields][number], abs=0.01)  # as docs/plates.md has it
        assert mixed < 0.01
