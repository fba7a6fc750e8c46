"""The corrected model's direct light against rays counted on an explicit row of ridges.

Nothing of the reflectance code is used but the function under test and the numbers of a material: directions, ridges,
visibility and plastic are written again here, from the literature, in other formulae where there are any.
"""

import numpy as np
import pytest
from scipy.special import erf

from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.corrected import radiance

NODES = np.polynomial.legendre.leggauss(64)
PITCH, RAYS = 100.0, 6_007
ANGLES, TILTS = (5.0, 10.0, 15.0, 20.0), (-20.0, -10.0, 0.0, 10.0, 20.0)
STAGES = (0.0, 90.0, 180.0, 33.0, 127.0, 251.0)
PLASTICS = [Material(0.06, 0.10, 0.2), Material(0.15, 0.05, 0.5), Material(0.05, 0.05, 0.05, 1.58, "linear")]
PLASTICS += [Material(0.06, 0.10, 0.2, tail=1.0)]


def rig(stage_deg, tilt_deg, apart_deg=10.0):
    """Directions to light and camera on a sample that is turned counter-clockwise beneath them.

    The light stands beside the camera along x, and both tilt about x.
    """
    tilt, apart, turn = np.radians([tilt_deg, apart_deg, -stage_deg])
    lean = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return tuple(spin @ lean @ [np.sin(a), 0.0, np.cos(a)] for a in (apart, 0.0))


def outline(angle_deg, wall, loss):
    """Corners of one period: crest, foot, next crest, cut off where height is lost."""
    theta = np.radians(angle_deg)
    facet = PITCH / np.cos(theta) ** (0 if wall == "perpendicular" else 1)  # length along the slope
    if wall == "perpendicular":
        facet = PITCH * np.cos(theta)
    foot, top = facet * np.cos(theta), facet * np.sin(theta)
    level = (1.0 - loss) * top
    corners = [(loss * foot, level), (foot, 0.0), (PITCH - loss * (PITCH - foot), level)]
    return np.array([*corners, (PITCH + loss * foot, level)] if loss else corners)


def row_of_ridges(corners, slope):
    """Starts, ends and kinds of all segments that rays of this slope out of the middle period can meet."""
    reach = 1 + int(np.ceil(abs(slope) * np.ptp(corners[:, 1]) / PITCH))
    shifts = [np.array([n * PITCH, 0.0]) for n in range(-reach, reach + 1)]
    return [(corners[k] + d, corners[k + 1] + d, k) for d in shifts for k in range(len(corners) - 1)]


def first_hit(origin, ray, segments):
    """Distance (in units of the ray) and kind of the first segment that each ray meets; infinite, −1 without."""
    nearest, kind = np.full(len(origin), np.inf), np.full(len(origin), -1)
    for start, end, number in segments:
        edge, gap_x, gap_z = end - start, start[0] - origin[:, 0], start[1] - origin[:, 1]
        turned = ray[0] * edge[1] - ray[1] * edge[0]
        if turned == 0.0:
            continue
        place = (gap_x * ray[1] - gap_z * ray[0]) / turned
        distance = (gap_x * edge[1] - gap_z * edge[0]) / turned
        met = (distance > 1e-7 * PITCH) & (place >= 0.0) & (place <= 1.0) & (distance < nearest)
        nearest[met], kind[met] = distance[met], number
    return nearest, kind


def fresnel(cosine, index):
    """Walter et al. 2007, Eq. 22; 1 beyond total reflection."""
    square = index**2 - 1.0 + cosine**2
    g = np.sqrt(np.maximum(square, 0.0))
    ratio = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0)
    return np.where(square < 0.0, 1.0, 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1.0 + ratio**2))


def shadowing(alpha_tangents, tail=0.0):
    """Height-correlated Smith, Heitz 2014, Eqs. 66, 72 and 99."""
    total = 1.0
    for alpha_tangent in alpha_tangents:
        if tail == 1.0:
            total = total + 0.5 * (np.sqrt(1.0 + alpha_tangent**2) - 1.0)
            continue
        a = 1.0 / np.maximum(alpha_tangent, 1e-12)
        total = total + 0.5 * (erf(a) - 1.0) + np.exp(-(a**2)) / (2.0 * a * np.sqrt(np.pi))
    return 1.0 / total


def reflected_share(cosine, alpha, index):
    """Share that the rough interface reflects: over half vectors drawn from their distribution (Walter, Eq. 28)."""
    node, weight = NODES
    turn = (np.arange(48) + 0.5) * np.pi / 48  # the other half is its mirror image
    tangent = alpha * np.sqrt(-np.log(0.5 * (1.0 - node)))[:, None]
    cos_half = 1.0 / np.sqrt(1.0 + tangent**2)
    half = np.stack(
        [tangent * cos_half * np.cos(turn), tangent * cos_half * np.sin(turn), cos_half + 0.0 * turn]
    )
    inward = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
    dot = np.tensordot(inward, half, axes=1)
    out = 2.0 * dot * cos_half - cosine
    usable = (dot > 0.0) & (out > 0.0)
    tan_out = np.sqrt(np.maximum(1.0 - out**2, 0.0)) / np.where(usable, out, 1.0)
    value = fresnel(np.abs(dot), index) * dot / (cosine * cos_half)
    value = value * shadowing([alpha * inward[0] / cosine, alpha * tan_out])
    return float(0.5 * weight @ np.where(usable, value, 0.0).mean(axis=1))


class Plastic:
    """A rough dielectric over a Lambertian body, for a facet that falls by an angle toward +x."""

    def __init__(self, material):
        self.m = material
        self.alpha = np.sqrt(material.alpha_along * material.alpha_across)
        node, weight = np.polynomial.legendre.leggauss(60)
        mu = 0.5 * (node + 1.0)
        inside = [reflected_share(c, self.alpha, 1.0 / material.index) for c in mu]
        returned = float(np.sum(weight * mu * inside))  # 2 ∫ μ R(μ) dμ
        kept = material.albedo * returned if material.internal_reflection == "nonlinear" else returned
        self.body = material.albedo / (1.0 - kept) / (np.pi * material.index**2)

    def brdf(self, light, camera, fall):
        """Value for one facet whose normal is (sin fall, 0, cos fall)."""
        m = self.m
        frame = np.array([[0, 1, 0], [np.cos(fall), 0, -np.sin(fall)], [np.sin(fall), 0, np.cos(fall)]])
        i, o = frame @ light, frame @ camera
        if min(i[2], o[2]) <= 0.0:
            return 0.0
        h = (i + o) / np.linalg.norm(i + o)
        slopes = (h[0] / h[2] / m.alpha_along) ** 2 + (h[1] / h[2] / m.alpha_across) ** 2
        peak = np.exp(-slopes) if m.tail == 0.0 else 1.0 / (1.0 + slopes) ** 2
        density = peak / (np.pi * m.alpha_along * m.alpha_across * h[2] ** 4)
        spread = [np.hypot(m.alpha_along * w[0], m.alpha_across * w[1]) / w[2] for w in (i, o)]
        lobe = fresnel(i @ h, m.index) * density * shadowing(spread, m.tail) / (4.0 * i[2] * o[2])
        passed = [1.0 - reflected_share(w[2], self.alpha, m.index) for w in (i, o)]
        return float(lobe + self.body * passed[0] * passed[1])


def counted(light, camera, corners, plastic):
    """Mean over evenly spaced camera rays of f·cos_i at the first hit, where the light reaches it."""
    origin = np.column_stack(
        [(np.arange(RAYS) + 0.5) / RAYS * PITCH, np.full(RAYS, corners[:, 1].max() + 1e-3)]
    )
    distance, seen = first_hit(origin, -camera[::2], row_of_ridges(corners, camera[0] / camera[2]))
    assert np.all(seen >= 0)
    point = origin - distance[:, None] * camera[::2]
    point[:, 0] %= PITCH
    dark = first_hit(point, light[::2], row_of_ridges(corners, light[0] / light[2]))[1] >= 0
    edges = np.diff(corners, axis=0)
    falls = np.arctan2(-edges[:, 1], edges[:, 0])
    value = [
        plastic.brdf(light, camera, fall) * max(light @ [np.sin(fall), 0.0, np.cos(fall)], 0.0)
        for fall in falls
    ]
    return float(np.mean(np.where(dark, 0.0, np.array(value)[seen])))


def compare(material, wall, loss, poses, angles=ANGLES):
    """Greatest relative deviation of the model from the count."""
    plastic = Plastic(material)
    worst = 0.0
    for angle in angles:
        corners = outline(angle, wall, loss)
        to_light, to_camera = (np.array(d) for d in zip(*poses, strict=True))
        found = radiance(
            to_light, to_camera, RidgeDesign(PITCH, angle, wall=wall, height_loss=loss), material
        )
        count = [counted(light, camera, corners, plastic) for light, camera in poses]
        worst = max(worst, float(np.max(np.abs(found / count - 1.0))))
    return worst


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_every_pose_of_the_table_and_between(wall, loss):
    poses = [rig(stage, tilt) for stage in STAGES for tilt in TILTS]
    assert compare(PLASTICS[0], wall, loss, poses) < 1e-3


@pytest.mark.parametrize("material", PLASTICS[1:], ids=["rough along", "smooth and dark", "with a tail"])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_other_plastics(wall, material):
    poses = [rig(stage, tilt) for stage in STAGES[::2] + STAGES[1:2] for tilt in TILTS[::2]]
    assert compare(material, wall, 0.3, poses, angles=(5.0, 20.0)) < 1e-3


@pytest.mark.parametrize("stages", [(0.0, 45.0, 300.0), (180.0, 200.0)], ids=["front", "back"])
@pytest.mark.parametrize("wall", ["perpendicular", "vertical"])
def test_light_that_grazes_the_facets(wall, stages):
    poses = [rig(stage, tilt, 60.0) for stage in stages for tilt in (-35.0, 0.0, 50.0)]
    assert compare(PLASTICS[0], wall, 0.0, poses, angles=(20.0,)) < 1e-3


def test_the_bound_would_see_another_surface():
    """Half a degree of ridge angle, or a tenth of the height, is far beyond the bound."""
    plastic, poses = Plastic(PLASTICS[0]), [rig(0.0, 0.0), rig(90.0, 10.0), rig(180.0, 0.0)]
    to_light, to_camera = (np.array(d) for d in zip(*poses, strict=True))
    found = radiance(to_light, to_camera, RidgeDesign(PITCH, 10.0), PLASTICS[0])
    for corners in (outline(10.5, "perpendicular", 0.0), outline(10.0, "perpendicular", 0.1)):
        count = np.array([counted(light, camera, corners, plastic) for light, camera in poses])
        assert np.max(np.abs(found / count - 1.0)) > 0.01
