"""Light between worn ridges: the predictor's shortened groove against the path tracer, which shares nothing with it."""

import numpy as np
import pytest

from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.corrected import indirect_radiance
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

ALPHA, ALBEDO, PITCH_UM = 0.08, 0.1, 100.0


def traced(design, side, points):
    """Radiance of two to six reflections on a mesh of so many points a pitch."""
    surface = ridges(design, (3, 2 * points + 1), (PITCH_UM, PITCH_UM / points))
    plastic = Plastic(ALPHA, ALPHA, ALBEDO, 1.5, "beckmann")
    tracer = PathTracer(surface, plastic, pitch_um=PITCH_UM, reflections=6, seed=1, paths=1 << 18)
    return tracer.indirect(*side).mean


@pytest.mark.parametrize("radius", [pytest.param(0.0, marks=pytest.mark.soak), 10.0])
def test_light_between_worn_ridges_is_that_of_the_shortened_groove(radius):
    """A mesh cuts the corner at the foot of the wall, in proportion to its cells: the limit of fine cells counts."""
    design = RidgeDesign(PITCH_UM, 10.0, edge_radius_um=radius)
    sides = directions([Pose(180.0, 0.0)], Convention(10.0))
    coarse, fine = (traced(design, [side[0] for side in sides], points) for points in (500, 1000))
    found = indirect_radiance(*sides, design, Material(ALPHA, ALPHA, ALBEDO))
    np.testing.assert_allclose(found, 2.0 * fine - coarse, rtol=0.04)  # 1.3 % of it is the paths' own
