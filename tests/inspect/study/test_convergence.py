"""Deviations vanish with the defect, at the order that physics says."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.study.convergence import (
    IMPERFECTIONS,
    Sampling,
    convergence,
    ideal_map,
    signed_contrasts,
    with_defect,
)

DESIGN = RidgeDesign(100.0, 10.0)
SMALL = Sampling(2, 60.0, 1.0, 4)


@pytest.fixture(scope="module")
def study():
    return convergence(tuple(IMPERFECTIONS), DESIGN, Material(), SMALL, Workers(), severities=4)


def curve(study, defect):
    return next(found for found in study.curves if found.defect == defect)


@pytest.mark.parametrize("defect", ["angle-error", "height-loss", "edge-rounding"])
def test_systematic_defects_vanish_at_first_order(study, defect):
    found = curve(study, defect)
    assert (np.diff(found.total) > 0).all()
    assert found.orders["total"].slope == pytest.approx(1.0, abs=0.1)
    assert found.orders["total"].low <= found.orders["total"].slope <= found.orders["total"].high
    assert set(found.orders) == {"total"}
    assert (found.scatter == 0).all()


def test_roughness_widens_the_lobe_at_second_order(study):
    found = curve(study, "roughness")
    assert (np.diff(found.total) > 0).all()
    mild = np.log(found.bias[1] / found.bias[0]) / np.log(found.severity[1] / found.severity[0])
    assert mild == pytest.approx(2.0, abs=0.25)
    assert found.orders["scatter"].slope < found.orders["bias"].slope


def test_resolved_roughness_is_that_of_the_lobe():
    """Slopes of the map and slopes below its pixels add in square: the corrected model with their sum."""
    large = Sampling(4, 120.0, 1.0, 4)
    found = convergence(["roughness"], DESIGN, Material(0.1, 0.1), large, Workers(), severities=3)
    alpha = float(np.hypot(0.1, found.curves[0].severity[0]))
    poses = directions(pose_grid((0.0, 90.0, 180.0), (-20.0, -10.0, 0.0, 10.0, 20.0)), Convention())
    ideal, rough = (
        signed_contrasts(corrected.radiance(*poses, DESIGN, Material(value, value))) for value in (0.1, alpha)
    )
    expected = np.sqrt(np.mean((rough - ideal) ** 2) / np.mean(ideal**2))
    assert found.curves[0].bias[0] == pytest.approx(expected, rel=0.15)


def test_burrs_hide_the_area_that_they_cover(study):
    found = curve(study, "burrs")
    assert found.orders["total"].slope == pytest.approx(1.0, abs=0.3)
    assert found.total == pytest.approx(found.severity, rel=0.5)


def test_sampling_is_finer_than_what_it_shows(study):
    for found in study.curves:
        assert found.sampling_bias < 0.2 * found.total[0]


@pytest.mark.parametrize("defect", IMPERFECTIONS)
def test_one_seed_is_one_piece_of_surface(defect):
    surface = ideal_map(DESIGN, SMALL)
    size = 0.5 * IMPERFECTIONS[defect].largest
    one, two = (with_defect(surface, defect, size, DESIGN, 3) for _ in range(2))
    assert all((a.height_um == b.height_um).all() for a, b in zip(one, two, strict=True))


def test_opposite_fields_cancel():
    surface = ideal_map(DESIGN, SMALL)
    up, down = with_defect(surface, "roughness", 0.05, DESIGN, 3)
    assert 0.5 * (up.height_um + down.height_um) == pytest.approx(surface.height_um)


def test_senseless_studies_are_refused():
    with pytest.raises(UsageError, match="at least three"):
        convergence(["burrs"], DESIGN, Material(), SMALL, Workers(), severities=2)
    with pytest.raises(UsageError, match="'dust' is no defect"):
        convergence(["dust"], DESIGN, Material(), SMALL, Workers())
    with pytest.raises(UsageError, match="flat"):
        convergence(["burrs"], RidgeDesign(100.0, 0.0), Material(), SMALL, Workers())
