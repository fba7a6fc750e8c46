import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.bounces import Groove, interreflection
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.material import brdf_table, facet_brdf
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

ALONG = np.array([0.0, 1.0, 0.0])
TABLE = directions(pose_grid((0, 90, 180), (-20, -10, 0, 10, 20)), Convention())
BATCHES, RAYS, FEWER_RAYS, DEPTH = 16, 1500, 500, 8

# wall, ridge angle, roughness, albedo, height loss: with CORNERS all corners of 5–20°, 0.05–0.2, 0.05–0.5, both walls,
# and some between
CASES = [
    ("perpendicular", 5.0, (0.05, 0.05), 0.05, 0.0),
    ("perpendicular", 5.0, (0.2, 0.2), 0.5, 0.0),
    ("perpendicular", 10.0, (0.05, 0.05), 0.05, 0.0),
    ("perpendicular", 10.0, (0.06, 0.10), 0.2, 0.0),
    ("perpendicular", 20.0, (0.05, 0.05), 0.05, 0.0),
    ("perpendicular", 20.0, (0.05, 0.05), 0.5, 0.0),
    ("perpendicular", 20.0, (0.2, 0.2), 0.05, 0.0),
    ("perpendicular", 20.0, (0.2, 0.2), 0.5, 0.0),
    ("perpendicular", 20.0, (0.1, 0.1), 0.2, 0.3),
    ("vertical", 5.0, (0.05, 0.05), 0.05, 0.0),
    ("vertical", 10.0, (0.06, 0.10), 0.2, 0.0),
    ("vertical", 20.0, (0.05, 0.05), 0.05, 0.0),
    ("vertical", 20.0, (0.05, 0.05), 0.5, 0.0),
    ("vertical", 20.0, (0.2, 0.2), 0.5, 0.2),
]
# the usual part, most reflections, cut crests, and the other wall; the others are a campaign
ALWAYS = (3, 7, 8, 12)
# the corners at which fewer rays are enough
CORNERS = [
    ("perpendicular", 5.0, (0.05, 0.05), 0.5, 0.0),
    ("perpendicular", 5.0, (0.2, 0.2), 0.05, 0.0),
    ("vertical", 5.0, (0.05, 0.05), 0.5, 0.0),
    ("vertical", 5.0, (0.2, 0.2), 0.05, 0.0),
    ("vertical", 5.0, (0.2, 0.2), 0.5, 0.0),
    ("vertical", 20.0, (0.2, 0.2), 0.05, 0.0),
    ("vertical", 20.0, (0.2, 0.2), 0.5, 0.0),
]


class Tracer:
    """Path tracer that knows nothing of the model but `facet_brdf`: rays against segments, random directions.

    Three neighbouring periods stand side by side; a ray that leaves the middle one is put back there.
    """

    def __init__(self, design, material, rng, rays=RAYS):
        theta = np.radians(design.ridge_angle_deg)
        foot = design.pitch_um * (1.0 if design.wall == "vertical" else np.cos(theta) ** 2)
        top = foot * np.tan(theta)
        keep = 1.0 - design.height_loss
        wall_end = np.array([foot + keep * (design.pitch_um - foot), keep * top])
        crest = np.array([foot * design.height_loss, keep * top])
        points = [crest, np.array([foot, 0.0]), wall_end, crest + np.array([design.pitch_um, 0])]
        ends = [(points[n], points[n + 1]) for n in range(3 if design.height_loss else 2)]
        self.frames, self.start, self.edge = [], [], []
        for first, last in ends:
            run, rise = (last - first) / np.linalg.norm(last - first)
            normal = np.array([-rise, 0.0, run])
            self.frames.append((ALONG, np.cross(normal, ALONG), normal))
            for copy in (-1, 0, 1):
                self.start.append(first + np.array([copy * design.pitch_um, 0.0]))
                self.edge.append(last - first)
        self.alpha = np.array([material.alpha_along, material.alpha_across])
        self.material, self.rng, self.pitch, self.top = material, rng, design.pitch_um, keep * top
        self.rays, self.tail = rays, material.tail

    def hit(self, origin, ray):
        """Nearest segment along each ray: its kind (−1: none) and the point hit, within the middle period."""
        nearest, kind = np.full(len(ray), np.inf), np.full(len(ray), -1)
        for n, (start, edge) in enumerate(zip(self.start, self.edge, strict=True)):
            across = ray[:, 0] * edge[1] - ray[:, 2] * edge[0]
            gap = start - origin
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = (gap[:, 0] * edge[1] - gap[:, 1] * edge[0]) / across
                place = (gap[:, 0] * ray[:, 2] - gap[:, 1] * ray[:, 0]) / across
            closer = (distance > 1e-9 * self.pitch) & (place >= 0) & (place <= 1) & (distance < nearest)
            nearest[closer], kind[closer] = distance[closer], n // 3
        point = origin + np.where(kind >= 0, nearest, 0.0)[:, None] * ray[:, ::2]
        point[:, 0] %= self.pitch
        return kind, point

    def brdf(self, kind, first, second):
        values = np.zeros(len(kind))
        for n, frame in enumerate(self.frames):
            mine = kind == n
            values[mine] = facet_brdf(first[mine], second[mine], *frame, self.material)
        return values

    def local(self, kind):
        return np.stack([np.stack(frame) for frame in self.frames])[kind]

    def glossy(self, kind, view):
        """Random mirror images of ``view`` in the microfacets of segments ``kind``."""
        frame = self.local(kind)
        slope = self.rng.normal(size=(len(kind), 2)) / np.sqrt(2) * self.alpha
        if self.tail > 0.0:  # a mixture of widths
            slope = slope / np.sqrt(self.rng.gamma(1.0 / self.tail, self.tail, size=(len(kind), 1)))
        half = np.column_stack([-slope, np.ones(len(kind))])
        half = np.einsum("nji,nj->ni", frame, half / np.linalg.norm(half, axis=1, keepdims=True))
        return 2 * np.sum(half * view, axis=1, keepdims=True) * half - view

    def glossy_pdf(self, kind, view, ray):
        half = view + ray
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
        middle = np.einsum("nij,nj->ni", self.local(kind), half)
        cosine = np.maximum(np.abs(middle[:, 2]), 1e-6)
        square = np.sum((middle[:, :2] / self.alpha) ** 2, axis=1) / cosine**2
        tail = self.tail
        slopes = (1.0 + tail * square) ** (-1.0 - 1.0 / tail) if tail > 0.0 else np.exp(-square)
        density = slopes / cosine**3
        return density / (4 * np.pi * np.prod(self.alpha) * np.maximum(np.abs(np.sum(half * view, 1)), 1e-6))

    def scattered(self, kind, back, light):
        """Random directions and their weight f·cos/pdf.

        A third each: the lobe, a cosine, and toward the lobe of the opposite side about the light.
        """
        opposite = np.where(kind == 0, 1, 0)
        radius, turn = np.sqrt(self.rng.random(len(kind))), 2 * np.pi * self.rng.random(len(kind))
        even = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)])
        even = np.einsum("nji,nj->ni", self.local(kind), even)
        ways = np.stack([self.glossy(kind, back), even, -self.glossy(opposite, light)])
        ray = ways[self.rng.integers(0, 3, len(kind)), np.arange(len(kind))]
        cosine = np.maximum(np.einsum("ni,ni->n", self.local(kind)[:, 2], ray), 0.0)
        pdf = self.glossy_pdf(kind, back, ray) + self.glossy_pdf(opposite, light, -ray) + cosine / np.pi
        weight = self.brdf(kind, ray, back) * cosine / np.where(cosine > 0, pdf / 3.0, 1.0)
        return ray, weight

    def trace(self, to_light, to_camera):
        """(DEPTH, P, BATCHES) radiance by number of reflections."""
        shape = (len(to_light), BATCHES, self.rays)
        where = (np.arange(self.rays) + self.rng.random(shape)) / self.rays * self.pitch
        pixel = np.repeat(np.arange(len(to_light) * BATCHES), self.rays)
        back = to_camera[pixel // BATCHES]
        lift = 0.01 * self.pitch  # start a little above the crests, where that point of the image hovers
        origin = np.column_stack([where.ravel(), np.full(pixel.size, self.top + lift)])
        kind, point = self.hit(origin, -back)
        carried, shown = np.ones(pixel.size), np.zeros((DEPTH, len(to_light) * BATCHES))
        for depth in range(DEPTH):
            light = to_light[pixel // BATCHES]
            cosine = np.maximum(np.einsum("ni,ni->n", self.local(kind)[:, 2], light), 0.0)
            dark = self.hit(point, light)[0] >= 0
            value = carried * self.brdf(kind, light, back) * np.where(dark, 0.0, cosine)
            shown[depth] = np.bincount(pixel, value, minlength=shown.shape[1]) / self.rays
            ray, weight = self.scattered(kind, back, light)
            next_kind, next_point = self.hit(point, ray)
            on = (next_kind >= 0) & (weight > 0)
            kind, point, back = next_kind[on], next_point[on], -ray[on]
            carried, pixel = (carried * weight)[on], pixel[on]
        return shown.reshape(DEPTH, len(to_light), BATCHES)


def against_paths(case, seed, table=TABLE, rays=RAYS):
    """Largest number of reflections → nrmse (of the mean), the largest excess over noise in one pose, the dim poses.

    The last is the largest relative error of a pose that is dimmer than half the mean of the table, 0 without any.
    """
    wall, angle, (along, across), albedo, loss, *tail = case
    design = RidgeDesign(100.0, angle, wall=wall, height_loss=loss)
    material = Material(along, across, albedo, tail=tail[0] if tail else 0.0)
    tracer = Tracer(design, material, np.random.default_rng(seed), rays)
    paths = np.cumsum(tracer.trace(*table), axis=0)
    result = {}
    for bounces in (1, 2, None):
        sample = paths[-1 if bounces is None else bounces - 1]
        mean, noise = sample.mean(axis=1), sample.std(axis=1, ddof=1) / np.sqrt(BATCHES)
        error = radiance(*table, design, material, bounces) - mean
        excess = np.max((np.abs(error) - 4.0 * noise) / mean)
        dim = np.where(mean < 0.5 * mean.mean(), np.abs(error) / mean, 0.0)
        result[bounces] = float(np.sqrt(np.mean(error**2)) / mean.mean()), float(excess), float(dim.max())
    return result


@pytest.mark.parametrize(
    ("case", "rays"),
    [pytest.param(CASES[n], FEWER_RAYS, id=str(CASES[n])) for n in ALWAYS]
    + [
        pytest.param(case, RAYS, marks=pytest.mark.soak, id=str(case))
        for n, case in enumerate(CASES)
        if n not in ALWAYS
    ]
    + [pytest.param(case, FEWER_RAYS, marks=pytest.mark.soak, id=str(case)) for case in CORNERS],
)
def test_agrees_with_a_path_tracer(case, rays):
    """The mean error over the poses, the error of every pose beyond four standard errors, and that of dim poses."""
    found = against_paths(case, seed=20, rays=rays)
    assert found[1][0] < 0.002
    assert found[2][0] < 0.01
    assert found[2][1] < 0.005
    assert found[None][0] < 0.01
    assert found[None][1] < 0.005
    assert max(found[2][2], found[None][2]) < 0.04


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_agrees_with_a_path_tracer_at_slanting_poses(wall):
    poses = pose_grid((20, 110, 250), (-40, -15, 5, 30, 45))
    table = directions(poses, Convention(light_angle_deg=25.0, tilt_plane="in-plane"))
    found = against_paths((wall, 15.0, (0.08, 0.12), 0.3, 0.1), seed=8, table=table, rays=FEWER_RAYS)
    assert max(found[2][0], found[None][0]) < 0.01
    assert max(found[2][1], found[None][1]) < 0.005


@pytest.mark.parametrize("tail", [0.5, pytest.param(1.0, marks=pytest.mark.soak), 1.6])
def test_lobes_with_a_tail_agree_with_a_path_tracer(tail):
    found = against_paths(("perpendicular", 10.0, (0.06, 0.10), 0.2, 0.0, tail), seed=20, rays=FEWER_RAYS)
    assert found[1][0] < 0.002
    assert max(found[2][0], found[None][0]) < 0.01
    assert max(found[2][1], found[None][1]) < 0.005
    assert max(found[2][2], found[None][2]) < 0.04


@pytest.mark.parametrize("case", [(w, 20.0, (0.02, 0.02), 0.2, 0.0) for w in ("perpendicular", "vertical")])
def test_narrow_lobes_are_widened_only_from_three_reflections_on(case):
    found = against_paths(case, seed=20, rays=FEWER_RAYS)
    assert found[2][0] < 0.005
    assert found[2][1] < 0.001
    assert found[None][0] < 0.01
    assert found[None][1] < 0.01


def random_directions(seed):
    raw = np.random.default_rng(seed).normal(size=(2, 60, 3))
    raw[..., 2] = np.abs(raw[..., 2]) + 0.3
    return raw / np.linalg.norm(raw, axis=-1, keepdims=True)


@pytest.mark.parametrize("lobe", [{}, {"tail": 1.0}, {"tail": 0.3, "second_lobe": (0.2, 2.0)}])
def test_the_brdf_between_directions_is_that_of_a_facet(lobe):
    first, second = random_directions(3)
    material = Material(0.2, 0.35, 0.4, **lobe)
    frame = ALONG, -np.eye(3)[0], np.eye(3)[2]
    turned = [np.column_stack([d[:, 1], -d[:, 0], d[:, 2]]) for d in (first, second)]
    shown = brdf_table(turned[0], turned[1], material)
    expected = [facet_brdf(first, np.broadcast_to(d, first.shape), *frame, material) for d in second]
    np.testing.assert_allclose(shown, np.array(expected).T, rtol=1e-4 if lobe else 1e-6)


@pytest.mark.parametrize("side", [0, 1])
def test_the_grid_scatters_as_the_brdf_between_its_directions(side):
    groove = Groove((1.0, 0.5), 1.2, Material(0.1, 0.2, 0.3, tail=0.4))
    ways = groove.grid.sides[side]
    field = np.random.default_rng(1).random((1, 2, len(ways)), dtype=np.float32)
    arriving = field * (ways[:, 2] * groove.grid.weight)
    expected = arriving @ brdf_table(ways, ways, groove.material)
    np.testing.assert_allclose(groove.reflected(side, field), expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("wall", "angle", "alpha"),
    [
        ("perpendicular", 20.0, 0.02),
        ("vertical", 20.0, 0.05),
        ("vertical", 5.0, 0.2),
        ("vertical", 5.0, 0.02),
    ],
)
@pytest.mark.parametrize(
    "lobe",
    [{}, {"tail": 0.3}, {"tail": 1.6}, {"second_lobe": (0.1, 3.0)}],
    ids=["none", "short", "long", "two"],
)
def test_quadrature_of_two_reflections_has_converged(wall, angle, alpha, lobe):
    design, material = RidgeDesign(100.0, angle, wall=wall), Material(alpha, alpha, 0.2, **lobe)
    coarse, fine = (interreflection(*TABLE, design, material, 2, nodes=n) for n in (6, 14))
    scale = corrected.radiance(*TABLE, design, material)
    assert np.max(np.abs(coarse - fine) / scale) < 1e-4


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
@pytest.mark.parametrize(("bounces", "tolerance"), [(2, 1e-10), (3, 1e-5), (None, 1e-5)])
def test_interreflection_is_reciprocal(wall, bounces, tolerance):
    first, second = random_directions(5)
    design, material = RidgeDesign(100.0, 18.0, wall=wall, height_loss=0.2), Material(0.05, 0.1, 0.5)
    there = interreflection(first, second, design, material, bounces) / first[:, 2]
    back = interreflection(second, first, design, material, bounces) / second[:, 2]
    assert there.max() > 0.01
    np.testing.assert_allclose(there, back, rtol=tolerance, atol=1e-5 * there.max() * (bounces != 2))


@pytest.mark.parametrize(
    ("wall", "tilt", "azimuth"),
    [("perpendicular", 40.0, 180.0), ("vertical", 40.0, 180.0), ("perpendicular", 0.0, 0.0)],
)
def test_white_furnace_with_all_reflections(wall, tilt, azimuth, hemisphere):
    """Direct light returns 0.63 to 0.81 here; in the end only reflections within the roughness are missing."""
    out, solid_angle = hemisphere(8, 12)
    theta, phi = np.radians([tilt, azimuth])
    vector = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    light = np.broadcast_to(vector, out.shape)
    design, material = RidgeDesign(100.0, 20.0, wall=wall), Material(0.15, 0.15, albedo=1.0)
    direct, everything = (
        np.sum(radiance(light, out, design, material, n) * out[:, 2] * solid_angle) / vector[2]
        for n in (1, None)
    )
    assert direct < 0.82
    assert 0.95 < everything <= 1.0


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_every_reflection_adds_light(wall):
    design, material = RidgeDesign(100.0, 20.0, wall=wall), Material(0.1, 0.1, 0.5)
    steps = [radiance(*TABLE, design, material, n) for n in (1, 2, 3, 4, 8)]
    assert np.all(np.diff(steps, axis=0) >= 0)
    everything = radiance(*TABLE, design, material, None)
    assert np.all(everything >= steps[-1] * (1 - 1e-6))
    np.testing.assert_allclose(everything, steps[-1], rtol=1e-3)


@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_flat_surfaces_exchange_no_light(wall):
    assert not interreflection(*TABLE, RidgeDesign(100.0, 0.0, wall=wall), Material()).any()
    flattened = RidgeDesign(100.0, 15.0, wall=wall, height_loss=1.0)
    assert not interreflection(*TABLE, flattened, Material()).any()
    assert (
        interreflection(TABLE[0][:0], TABLE[1][:0], RidgeDesign(100.0, 15.0, wall=wall), Material()).size == 0
    )
    nearly = interreflection(*TABLE, RidgeDesign(100.0, 0.01, wall=wall), Material())
    assert np.all(nearly < 1e-4 * radiance(*TABLE, RidgeDesign(100.0, 0.0), Material(), None))


def test_pitch_does_not_matter():
    small, large = (interreflection(*TABLE, RidgeDesign(p, 15.0), Material()) for p in (20.0, 500.0))
    np.testing.assert_allclose(small, large, rtol=1e-5)


@pytest.mark.parametrize(
    ("angle", "material", "mean", "largest"),
    [
        (5.0, Material(), 0.012, 0.053),
        (20.0, Material(), 0.125, 0.48),
        (5.0, Material(0.05, 0.05, 0.05), 0.042, 0.36),
        (20.0, Material(0.05, 0.05, 0.05), 0.312, 1.53),
        (20.0, Material(0.2, 0.2, 0.5), 0.080, 0.142),
    ],
)
def test_size_of_the_effect(angle, material, mean, largest):
    """What interreflection adds to direct light: the mean and the largest share over the 15 poses."""
    design = RidgeDesign(100.0, angle)
    share = interreflection(*TABLE, design, material) / corrected.radiance(*TABLE, design, material)
    assert share.mean() == pytest.approx(mean, rel=0.05)
    assert share.max() == pytest.approx(largest, rel=0.05)


def test_corrected_model_passes_the_reflections_on():
    design, material = RidgeDesign(100.0, 15.0), Material()
    direct = corrected.radiance(*TABLE, design, material)
    np.testing.assert_array_equal(interreflection(*TABLE, design, material, 1), 0.0)
    for bounces in (2, None):
        np.testing.assert_array_equal(
            corrected.radiance(*TABLE, design, material, bounces=bounces),
            direct + interreflection(*TABLE, design, material, bounces),
        )
    with pytest.raises(ModelError, match="at least once"):
        corrected.radiance(*TABLE, design, material, bounces=0)


@pytest.mark.parametrize("foot", [20.0, 60.0])
def test_a_foot_that_leaves_no_wall_shines_as_its_height_map(foot):
    """Its arc ends at the crest; the path tracer of the virtual rig sees heights alone."""
    design, sides = (
        RidgeDesign(100.0, 10.0, foot_radius_um=foot),
        directions(pose_grid((180, 90)), Convention()),
    )
    surface = ridges(design, (3, 2001), (100.0, 0.05))
    tracer = PathTracer(surface, Plastic(0.08, 0.08, 0.3), pitch_um=100.0, reflections=5, paths=2**14)
    found = [tracer.radiance(*pose).mean(dtype=float) for pose in zip(*sides, strict=True)]
    light = corrected.radiance(*sides, design, Material(0.08, 0.08, 0.3), bounces=None)
    assert light == pytest.approx(found, rel=5e-3)
