"""The relief predictor: against plain numpy, how it grows with poses and pixels, and against the memory's speed."""

import subprocess
import sys

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.material import diffuse_scale, fresnel, smith_lambda, transmittance
from anisoscope.sim.light.relief import Relief, radiance

pytestmark = pytest.mark.benchmark


def plain_shares(z, pixel, tangent):
    """Running horizon along x for light from +x, column by column, rows at once."""
    middle = 0.5 * (z[1:] + z[:-1])
    s = np.arange(z.shape[1]) * pixel - tangent * middle
    limit = np.minimum.accumulate(s[:, ::-1], axis=1)[:, ::-1][:, 1:]
    length = s[:, 1:] - s[:, :-1]
    share = np.clip((limit - s[:, :-1]) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    return np.where(length > 0, share, 0.0)


def plain_radiance(z, pixel, light, camera, material):
    """One pose at stage angle 0 or 180, tilt 0: all facets, in numpy."""
    flip = light[0] < 0
    if flip:
        z, light, camera = z[:, ::-1], light * [-1, 1, 1], camera * [-1, 1, 1]
    gx = 0.5 * (z[:-1, 1:] - z[:-1, :-1] + z[1:, 1:] - z[1:, :-1]) / pixel
    gy = 0.5 * (z[1:, :-1] - z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:]) / pixel
    size = np.sqrt(1 + gx**2 + gy**2)
    slant = np.sqrt(1 + gy**2)

    def local(v):
        across = (slant**2 * v[0] - gx * gy * v[1] + gx * v[2]) / (size * slant)
        return (v[1] + gy * v[2]) / slant, across, (v[2] - gx * v[0] - gy * v[1]) / size

    half = light + camera
    half /= np.linalg.norm(half)
    (hu, hv, hn), (iu, iv, cos_i), (ou, ov, cos_o) = local(half), local(light), local(camera)
    au, av = material.alpha_along, material.alpha_across
    front = (cos_i > 0) & (cos_o > 0)
    ci, co = np.where(front, cos_i, 1.0), np.where(front, cos_o, 1.0)
    d = np.exp(-((hu / au) ** 2 + (hv / av) ** 2) / hn**2) / (np.pi * au * av * hn**4)
    shadow = 1 + smith_lambda(np.hypot(au * iu, av * iv) / ci) + smith_lambda(np.hypot(au * ou, av * ov) / co)
    lobe = fresnel(np.array(light @ half), material.index) * d / (4 * shadow)
    base = diffuse_scale(material) * transmittance(ci, material) * transmittance(co, material) * ci * co
    share = plain_shares(z, pixel, light[0] / light[2])
    return float(np.mean(np.where(front, share * (lobe + base) * size / camera[2], 0.0)))


def test_relief_against_plain_numpy(bench):
    surface = rough(1000)
    relief, material = Relief(surface), Material()
    to_light, to_camera = directions(pose_grid((0.0, 180.0)), Convention())
    poses = list(zip(to_light, to_camera, strict=True))
    found = bench.compare(
        "1000 × 1000 facets, two poses",
        {
            "relief": lambda: radiance(relief, to_light, to_camera, material),
            "plain numpy": lambda: [plain_radiance(surface.height_um, 1.0, i, o, material) for i, o in poses],
        },
    )
    # plain numpy does not split facets that straddle an edge
    np.testing.assert_allclose(found["relief"].result, found["plain numpy"].result, rtol=0.1)


def rough(side):
    surface = ridges(RidgeDesign(100.0, 10.0), (side, side), 1.0)
    return add_facet_roughness(surface, 0.05, 0.05, 6.0, np.random.default_rng(1))


def work(surface, poses):
    to_light, to_camera = directions(poses, Convention())
    return lambda: radiance(Relief(surface), to_light, to_camera, Material())


def test_poses_share_the_work_and_pixels_cost_alike(bench):
    tilts = (-20.0, -10.0, 0.0, 10.0, 20.0)
    sets = {1: pose_grid((0.0,)), 3: pose_grid((0.0, 90.0, 180.0)), 15: pose_grid((0.0, 90.0, 180.0), tilts)}
    sets[60] = pose_grid(tuple(np.arange(12) * 30.0), tilts)
    surface = rough(1000)
    bench.growth("1000 × 1000 points", "poses", {n: work(surface, poses) for n, poses in sets.items()})
    sizes = {side**2: work(rough(side), sets[15]) for side in (500, 1000, 2000, 4000)}
    bench.growth("15 poses", "points", sizes)


def test_the_march_against_the_speed_of_memory(bench):
    """One march reads heights and writes shares once: 8 bytes a facet, against a copy of arrays as large."""
    from anisoscope.sim.light.horizon_kernels import march

    side = 4000
    z = np.random.default_rng(0).random((side + 1, side + 1), dtype=np.float32)
    out, other = np.empty((side, side), np.float32), np.empty((side + 1, side + 1), np.float32)
    out[:], other[:] = 0.0, 0.0
    found = bench.compare(
        "4000 × 4000 heights",
        {
            "march along an axis": lambda: march(z, 1.0, 0.2, 0.0, False, 5, 0, 0, 0, out),
            "slanting march": lambda: march(z, 1.0, 0.2, 0.5, False, 5, 0, 0, 0, out),
            "copy": lambda: np.copyto(other, z),
        },
    )
    rates = {name: 8.0 * side**2 / min(one.wall_s) / 1e9 for name, one in found.timings.items()}
    bench.note(", ".join(f"{name} {rate:.1f} GB/s" for name, rate in rates.items()))


def test_a_map_of_4096_squared_in_bounded_memory(bench):
    """In a process of its own: peak memory with 15 and with 60 poses, in multiples of the map (goal: 4)."""
    script = """
import sys, time
from pathlib import Path
import numpy as np
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.geometry import Convention, directions, pose_grid
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.relief import Relief, radiance
rng = np.random.default_rng(1)
x = np.arange(4096.0)
z = (100.0 - x % 100.0) * np.tan(np.radians(10.0)) + 0.02 * rng.standard_normal((4096, 4096), dtype=np.float32)
surface = HeightMap(z, 1.0, 1.0)
del z
poses = pose_grid(tuple(np.arange(int(sys.argv[1])) * 30.0), (-20.0, -10.0, 0.0, 10.0, 20.0))
def mib(name):  # getrusage counts whoever started this process, too
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024
small = HeightMap(surface.height_um[:64, :64], 1.0, 1.0)
radiance(Relief(small), *directions(poses, Convention()), Material())  # loads the kernels: they are the program
size = surface.height_um.nbytes / 2**20
program = mib("VmRSS") - size
Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
start = time.perf_counter()
radiance(Relief(surface), *directions(poses, Convention()), Material())
peak = mib("VmHWM")
taken = time.perf_counter() - start
print(f"4096 × 4096 points, {len(poses)} poses: {taken:.1f} s, peak {peak:.0f} MiB, "
      f"{(peak - program) / size:.1f} times the map of {size:.0f} MiB without the program")
"""
    for count in ("3", "12"):
        done = subprocess.run(
            [sys.executable, "-c", script, count], check=True, capture_output=True, text=True
        )
        bench.note(done.stdout.strip())
        assert float(done.stdout.split("MiB, ")[1].split()[0]) <= 4.0
