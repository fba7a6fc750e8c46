import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.material import fresnel

RIDGE_ANGLES = (5.0, 10.0, 15.0, 20.0)
TILTS = (-20.0, -10.0, 0.0, 10.0, 20.0)
POSES = pose_grid((0.0, 90.0, 180.0), TILTS)


def experiment(convention, material):
    """Absolute contrasts (ridge angle, tilt, pair) of the published experiment."""
    to_light, to_camera = directions(POSES, convention)
    tables = []
    for angle in RIDGE_ANGLES:
        exposure = printed.radiance(to_light, to_camera, RidgeDesign(100.0, angle), material).reshape(
            len(TILTS), 3
        )
        tables.append(np.abs(np.diff(exposure, axis=1)))
    return np.array(tables)


def findings(table):
    tilt, angle, pair = table.mean((0, 2)), table.mean((1, 2)), table.mean((0, 1))
    falling = tilt[0] < tilt[1] < tilt[2] > tilt[3] > tilt[4]
    return bool(falling), bool(pair[0] > pair[1]), RIDGE_ANGLES[int(np.argmax(angle))]


def test_the_three_published_findings_come_out_at_the_defaults():
    assert findings(experiment(Convention(), Material())) == (True, True, 5.0)


def test_no_roughness_gives_the_findings_with_the_light_in_the_tilt_plane():
    for along in np.geomspace(0.03, 0.3, 9):
        for across in np.geomspace(0.03, 0.3, 9):
            table = experiment(Convention(tilt_plane="in-plane"), Material(float(along), float(across)))
            assert findings(table) != (True, True, 5.0)


def test_index_and_albedo_only_scale_the_printed_experiment():
    base = experiment(Convention(), Material())
    other = experiment(Convention(), Material(albedo=0.7, index=1.8))
    ratio = other[base > 1e-9] / base[base > 1e-9]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)


def test_the_printed_model_reflects_more_than_it_receives(hemisphere):
    """A known error of the paper: no cos θr for the facet's area, so that the white furnace exceeds one."""
    directions_out, solid_angle = hemisphere(200, 400)
    lean = np.radians(20.0)
    normal = np.broadcast_to([np.sin(lean), 0.0, np.cos(lean)], directions_out.shape)
    design, material = RidgeDesign(100.0, 20.0), Material(0.1, 0.1, albedo=0.0)
    lobe = printed.ridge_brdf(normal, directions_out, design, material)
    half = normal + directions_out
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lossless = lobe / fresnel(np.sum(normal * half, axis=1), material.index)
    furnace = np.sum(lossless * directions_out[:, 2] * solid_angle)
    assert furnace > 1.015


def test_with_the_half_vector_as_axis_almost_nothing_is_shadowed():
    """Eq. 6 read literally; Appendix A means the pitch normal."""
    to_light, to_camera = directions(pose_grid((180.0,)), Convention())
    design, material = RidgeDesign(100.0, 20.0), Material(0.3, 0.3)
    literal = printed.ridge_brdf(to_light, to_camera, design, material, "half-vector")
    meant = printed.ridge_brdf(to_light, to_camera, design, material)
    assert literal[0] > 1.1 * meant[0]


@pytest.mark.parametrize("angle", RIDGE_ANGLES)
def test_michelson_contrast_needs_the_corrected_model(angle):
    to_light, to_camera = directions(pose_grid((0.0, 90.0)), Convention())
    design = RidgeDesign(100.0, angle)
    michelson = []
    for model in (printed, corrected):
        first, second = model.radiance(to_light, to_camera, design, Material())
        michelson.append((first - second) / (first + second))
    assert michelson[0] > michelson[1]


def test_a_lobe_with_a_tail_is_refused():
    to_light, to_camera = directions(POSES, Convention())
    with pytest.raises(ModelError, match="corrected"):
        printed.radiance(to_light, to_camera, RidgeDesign(100.0, 10.0), Material(tail=0.5))
