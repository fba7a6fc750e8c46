"""The relief predictor against Mitsuba 3 on one rough, burred map: accuracy, and time at the same error.

Same surface: Mitsuba gets a mesh with two triangles a cell, cut from (row, col) to (row + 1, col + 1), face
normals, and around it MARGIN pixels that repeat the nearest edge, as `relief` takes them to go on without a pitch.
Same measure: parallel rays from an even grid of cells on the map's rectangle, so that the mean of the picture is
the radiance per macroscopic area, under a directional light of unit irradiance. Same plastic: isotropic roughness,
`nonlinear`. Mitsuba's depth D is D − 1 reflections.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects import burrs
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.material import facet_brdf
from anisoscope.sim.light.relief import Relief, radiance
from anisoscope.sim.light.relief_paths import interreflection
from anisoscope.sim.light.ridge_profile import ridge_polyline
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

try:
    import mitsuba
except ImportError:
    mitsuba = None

pytestmark = [
    pytest.mark.benchmark,
    pytest.mark.skipif(mitsuba is None, reason="needs the extra [benchmark]: make benchmark installs it"),
]
MARGIN = 60
PICTURE = 64  # pixels a side: shares the work among the cores, and shows the scatter
SCALAR, COMPILED = "scalar_rgb", "llvm_ad_rgb"
OLDEST_LLVM = 16  # older ones abort the process: they lack the instruction fminimum on x86
MATERIAL = Material(0.1, 0.1, 0.2)
POSES = pose_grid((0.0, 90.0, 180.0), (-20.0, -10.0, 0.0, 10.0, 20.0))
TO_LIGHT, TO_CAMERA = directions(POSES, Convention())
DEPTH = 6
FEWEST_PATHS, MOST_PATHS = 512, 1 << 17
REPEATS = 3


def llvm_version():
    """The newest LLVM of the system, which Dr.Jit loads; 0 where there is none."""
    names = [
        path.name for folder in ("/usr/lib", "/usr/local/lib") for path in Path(folder).rglob("libLLVM*.so*")
    ]
    found = [int(match[1]) for name in names if (match := re.search(r"LLVM(?:-|\.so\.)(\d+)", name))]
    return max(found, default=0)


VARIANTS = (SCALAR, COMPILED) if llvm_version() >= OLDEST_LLVM else (SCALAR,)


@pytest.fixture(scope="module")
def surface():
    rng = np.random.default_rng(1)
    ideal = ridges(RidgeDesign(100.0, 10.0), (1000, 1000), 1.0)
    rough = add_facet_roughness(ideal, 0.05, 0.05, 6.0, rng)
    return burrs(rough, 0.02, pitch_um=100.0, rng=rng).map


def relief_of(surface):
    """Prepared anew, so that nothing is remembered from another run."""
    return Relief(surface, facets="diagonal")


def plastic(material):
    return {
        "type": "roughplastic",
        "distribution": getattr(material, "lobe", "beckmann"),
        "alpha": material.alpha_along,
        "int_ior": material.index,
        "ext_ior": 1.0,
        "nonlinear": True,
        "diffuse_reflectance": {"type": "rgb", "value": material.albedo},
    }


def mesh_of(surface, material):
    z = np.pad(surface.height_um, MARGIN, mode="edge")
    rows, cols = z.shape
    y, x = np.mgrid[-MARGIN : rows - MARGIN, -MARGIN : cols - MARGIN]
    points = np.stack([x * surface.pixel_x_um, y * surface.pixel_y_um, z], axis=-1).astype(np.float32)
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    faces = np.stack(
        [corner, corner + 1, corner + cols + 1, corner, corner + cols + 1, corner + cols], axis=-1
    )
    return mesh(points.reshape(-1, 3), faces.reshape(-1, 3), material)


def mesh(points, faces, material):
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(plastic(material))
    properties["face_normals"] = True
    found = mitsuba.Mesh("map", len(points), len(faces), props=properties)
    parameters = mitsuba.traverse(found)
    parameters["vertex_positions"] = np.asarray(points, dtype=np.float32).ravel()
    parameters["faces"] = np.asarray(faces, dtype=np.uint32).ravel()
    parameters.update()
    return found


def ideal_mesh(design, material):
    """Ridges as the few long triangles that they are: 30 periods, of which the camera sees the middle ten."""
    x, z = ridge_polyline(design)
    count = x.size - 1
    line_x = np.concatenate([x[:-1] + n * design.pitch_um for n in range(-10, 20)])
    line_z = np.tile(z[:-1], 30)
    points = np.concatenate(
        [np.stack([line_x, np.full_like(line_x, y), line_z], axis=-1) for y in (-3000.0, 4000.0)]
    )
    first = np.arange(30 * count - 1)
    far = first + 30 * count
    faces = np.concatenate([np.stack([first, first + 1, far + 1], -1), np.stack([first, far + 1, far], -1)])
    return mesh(points, faces, material)


def camera_of(surface, to_camera):
    """Parallel rays that fill the map's rectangle at its mean height: a sheared orthographic camera."""
    rows, cols = surface.shape
    half_x, half_y = 0.5 * (cols - 1) * surface.pixel_x_um, 0.5 * (rows - 1) * surface.pixel_y_um
    middle, top = float(np.mean(surface.height_um)), float(np.max(surface.height_um)) + 1.0
    start = np.array([half_x, half_y, middle]) + to_camera * (top - middle) / to_camera[2]
    frame = np.eye(4)
    frame[:3, 0], frame[:3, 1], frame[:3, 2], frame[:3, 3] = [half_x, 0, 0], [0, half_y, 0], -to_camera, start
    film = {"type": "hdrfilm", "width": PICTURE, "height": PICTURE, "pixel_format": "luminance"}
    return {
        "type": "orthographic",
        "to_world": mitsuba.ScalarTransform4f(frame),
        "near_clip": 1e-3,
        "far_clip": 1e5,
        "film": {**film, "rfilter": {"type": "box"}, "component_format": "float32"},
        "sampler": {"type": "independent"},
    }


class Traced:
    """A scene in Mitsuba that is built once; poses move its lamp and its camera."""

    def __init__(self, surface, material, depth, build=None, variant=SCALAR):
        self.surface, self.variant = surface, variant
        mitsuba.set_variant(variant)
        integrator = {"type": "path", "max_depth": depth, "rr_depth": depth + 1}
        parts = {
            "mesh": (build or mesh_of)(surface, material),
            "lamp": lamp_to(TO_LIGHT[0]),
            "integrator": integrator,
        }
        self.scene = mitsuba.load_dict({"type": "scene", **parts})

    def poses(self, samples):
        """(P,) radiances and their standard errors.

        Each picture is the mean of two, whose difference shows the error without the variation over the map.
        """
        mitsuba.set_variant(self.variant)
        values, errors = [], []
        for seed, (light, camera) in enumerate(zip(TO_LIGHT, TO_CAMERA, strict=True)):
            parameters = mitsuba.traverse(self.scene)
            parameters["lamp.to_world"] = mitsuba.load_dict(lamp_to(light)).world_transform()
            parameters.update()
            sensor = mitsuba.load_dict(camera_of(self.surface, camera))
            halves = [
                np.array(
                    mitsuba.render(self.scene, sensor=sensor, spp=samples // 2, seed=2 * seed + half),
                    dtype=np.float64,
                )
                for half in (0, 1)
            ]
            values.append(float(np.mean(halves)))
            errors.append(float(np.std(halves[0] - halves[1])) / (2.0 * PICTURE))
        return np.array(values), np.array(errors)


def lamp_to(light):
    return {
        "type": "directional",
        "direction": (-light).tolist(),
        "irradiance": {"type": "rgb", "value": 1.0},
    }


def rms(deviation):
    return float(np.sqrt(np.mean(np.square(deviation))))


def enough_samples(scene, error):
    """Even number of samples a pixel at which Mitsuba's standard error, rms over the poses, is ``error``."""
    values, errors = scene.poses(4)
    return max(2, 2 * int(np.ceil(2.0 * (rms(errors / values) / error) ** 2)))


def enough_paths(relief, depth, error):
    """Number of paths at which the standard error of our light, rms over the poses, is ``error``.

    Only powers of two are followed.
    """
    direct, paths = radiance(relief, TO_LIGHT, TO_CAMERA, MATERIAL), FEWEST_PATHS
    while paths < MOST_PATHS:
        indirect = interreflection(relief, TO_LIGHT, TO_CAMERA, MATERIAL, depth - 1, paths)
        if rms(indirect.standard_error / (direct + indirect.radiance)) <= error:
            break
        paths *= 2
    return paths


@pytest.mark.parametrize(("alpha", "albedo"), [(0.05, 0.5), (0.1, 0.2), (0.2, 0.5)])
def test_the_plastic_is_the_same(alpha, albedo):
    """Point by point up to 60° from the normal; nearer the horizon the two shadow rough interfaces differently."""
    mitsuba.set_variant(SCALAR)
    material = Material(alpha, alpha, albedo)
    bsdf, context = mitsuba.load_dict(plastic(material)), mitsuba.BSDFContext()
    deviations = []
    for tilt_in, tilt_out, turn in np.radians(
        [[10, 0, 0], [10, 20, 90], [40, 30, 180], [60, 60, 180], [60, 20, 30]]
    ):
        light = np.array([np.sin(tilt_in), 0.0, np.cos(tilt_in)])
        camera = np.array(
            [np.sin(tilt_out) * np.cos(turn), np.sin(tilt_out) * np.sin(turn), np.cos(tilt_out)]
        )
        interaction = mitsuba.SurfaceInteraction3f()
        interaction.wi = mitsuba.Vector3f(*light)
        theirs = bsdf.eval(context, interaction, mitsuba.Vector3f(*camera))[0] / camera[2]
        deviations.append(facet_brdf(light, camera, *np.eye(3)[[1, 0, 2]], material) / theirs - 1.0)
    print(f"\nBRDF, alpha {alpha}, albedo {albedo}: " + ", ".join(f"{100 * d:+.2f} %" for d in deviations))
    assert np.max(np.abs(deviations)) < 0.02


@pytest.mark.parametrize(("depth", "goal", "error"), [(2, 0.003, 0.0044), (DEPTH, 0.01, 0.0044)])
def test_relief_against_mitsuba(bench, surface, depth, goal, error):
    """Both follow as many paths as the standard error needs; direct light of ours has none."""

    def predicted(relief):
        total = radiance(relief, TO_LIGHT, TO_CAMERA, MATERIAL)
        if depth == 2:
            return total, np.zeros_like(total)
        indirect = interreflection(relief, TO_LIGHT, TO_CAMERA, MATERIAL, depth - 1, paths)
        return total + indirect.radiance, indirect.standard_error

    kept, scenes = relief_of(surface), {v: Traced(surface, MATERIAL, depth, variant=v) for v in VARIANTS}
    samples, paths = enough_samples(scenes[SCALAR], error), enough_paths(kept, depth, error)
    works = {
        "relief, map to radiances": lambda: predicted(relief_of(surface)),
        "relief, prepared map": lambda: predicted(kept),
    }
    for variant, scene in scenes.items():
        works[f"Mitsuba {variant}, scene kept"] = lambda one=scene: one.poses(samples)
        works[f"Mitsuba {variant}, map to radiances"] = lambda v=variant: Traced(
            surface, MATERIAL, depth, variant=v
        ).poses(samples)
    kind = "direct light" if depth == 2 else f"up to {depth - 1} reflections"
    found = bench.compare(
        f"{kind}, {len(POSES)} poses, {surface.shape[0]} × {surface.shape[1]} points", works, rounds=REPEATS
    )
    exact, spread = scenes[SCALAR].poses(256)
    ours, our_errors = found["relief, map to radiances"].result
    deviation = ours / exact - 1.0
    values, errors = found[f"Mitsuba {SCALAR}, scene kept"].result
    bench.note(
        f"deviation rms {rms(deviation):.2%}, greatest {np.max(np.abs(deviation)):.2%}, of it Mitsuba's noise "
        f"{rms(spread / exact):.2%}; standard errors in the comparison: ours {rms(our_errors / ours):.2%}, Mitsuba's "
        f"{rms(errors / values):.2%}"
    )
    assert rms(deviation) < goal


def test_the_published_table_against_mitsuba(bench):
    """60 poses of ideal ridges, direct light; the surface is only the rectangle that the camera sees."""
    angles, error = (5.0, 10.0, 15.0, 20.0), 0.0044
    surface = ridges(RidgeDesign(100.0, angles[-1]), (1001, 1001), 1.0)
    designs = [RidgeDesign(100.0, angle) for angle in angles]
    scenes = [Traced(surface, MATERIAL, 2, lambda _, m, one=one: ideal_mesh(one, m)) for one in designs]

    def theirs(samples):
        runs = [scene.poses(samples) for scene in scenes]
        return np.array([run[0] for run in runs]), np.array([run[1] for run in runs])

    values, errors = theirs(4)
    samples = max(2, 2 * int(np.ceil(2.0 * (rms(errors / values) / error) ** 2)))
    found = bench.compare(
        "the published table, 60 poses, ideal ridges",
        {
            "closed form": lambda: np.array(
                [corrected.radiance(TO_LIGHT, TO_CAMERA, design, MATERIAL) for design in designs]
            ),
            f"Mitsuba {SCALAR}, scene kept": lambda: theirs(samples),
        },
        rounds=REPEATS,
    )
    exact, spread = theirs(256)
    accuracy = rms(found["closed form"].result / exact - 1.0)
    bench.note(f"deviation rms {accuracy:.2%}, of it Mitsuba's noise {rms(spread / exact):.2%}")
    assert accuracy < 0.003


@pytest.mark.parametrize("lobe", ["beckmann", "ggx"])
@pytest.mark.parametrize("kind", ["sharp", "rough and burred", "worn"])
def test_the_path_tracer_of_the_virtual_rig(surface, kind, lobe):
    """Another implementation on the same mesh: within the noise of both, direct and with five reflections.

    Shadowing of the rough interface near grazing is where the two differ for GGX.
    """
    made = {
        "sharp": lambda: ridges(RidgeDesign(100.0, 10.0), (400, 801), 1.0),
        "rough and burred": lambda: HeightMap(surface.height_um[:401, :801].copy(), 1.0, 1.0, {}),
        "worn": lambda: edge_wear(ridges(RidgeDesign(100.0, 10.0), (400, 801), 1.0), 10.0),
    }[kind]()
    plastic = Plastic(0.08, 0.08, 0.1, 1.5, lobe)
    tracer = PathTracer(made, plastic, reflections=DEPTH - 1, paths=1 << 18)
    for depth in (2, DEPTH):
        theirs, spread = Traced(made, plastic, depth).poses(128)
        values, errors = [], []
        for light, camera in zip(TO_LIGHT, TO_CAMERA, strict=True):
            value, error = float(np.mean(tracer.direct(light, camera), dtype=float)), 0.0
            if depth > 2:
                indirect = tracer.indirect(light, camera)
                value, error = value + indirect.mean, indirect.standard_error
            values.append(value)
            errors.append(error)
        deviation = np.array(values) / theirs - 1.0
        noise = np.hypot(spread, errors) / theirs
        print(
            f"\n{kind}, {lobe}, up to {depth - 1} reflections: rms {rms(deviation):.2%}, noise {rms(noise):.2%}"
        )
        print(", ".join(f"{100.0 * one:+.2f}" for one in deviation))
        assert np.all(np.abs(deviation) < 4.0 * noise + 0.006)
