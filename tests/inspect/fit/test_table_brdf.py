"""A BRDF table against the models, in the frame of the sample."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.fit.fitting import fit
from anisoscope.fit.parameters import checked_values
from anisoscope.fit.problem import Problem, Scene
from anisoscope.fit.table import COLUMNS, read_brdf, reciprocity, unit_vectors
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected
from anisoscope.sim.light.material import facet_brdf

HEADER = ",".join(COLUMNS)


@pytest.fixture
def table(tmp_path):
    """``table(rows, header)`` writes a CSV file and gives its path."""

    def write(rows, header=HEADER):
        path = tmp_path / "brdf.csv"
        path.write_text("\n".join([header, *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
        return path

    return write


def angles_near_the_mirror(rng, count):
    theta_i, phi_i = rng.uniform(0.0, 50.0, count), rng.uniform(0.0, 360.0, count)
    theta_o = np.abs(theta_i + rng.uniform(-12.0, 12.0, count))
    return np.stack([theta_i, phi_i, theta_o, phi_i + 180.0 + rng.uniform(-20.0, 20.0, count)], axis=1)


def ridged(angles, ridge_angle, material):
    light, camera = unit_vectors(angles[:, 0], angles[:, 1]), unit_vectors(angles[:, 2], angles[:, 3])
    return corrected.radiance(light, camera, RidgeDesign(100.0, ridge_angle), material) / light[:, 2]


def problem(read, free=(), bounces=None, **values):
    scene = Scene(read.to_light, read.to_camera, bounces=bounces)
    return Problem(scene, read.readings, checked_values(values), free)


def test_a_flat_surface_is_the_brdf_of_its_plastic(table, rng):
    """No factor between them: radiance per perpendicular irradiance over cos θi is the BRDF."""
    material = Material(0.08, 0.15, 0.4)
    angles = angles_near_the_mirror(rng, 30)
    light, camera = unit_vectors(angles[:, 0], angles[:, 1]), unit_vectors(angles[:, 2], angles[:, 3])
    axes = np.eye(3)
    value = facet_brdf(light, camera, axes[1], axes[0], axes[2], material)
    read = read_brdf(table(np.column_stack([angles, value])))
    plastic = {"ridge_angle_deg": 0.0, "alpha_along": 0.08, "alpha_across": 0.15, "albedo": 0.4}
    found = fit(problem(read, **plastic))
    np.testing.assert_allclose(found.fitted, value, rtol=1e-4)


def test_azimuths_count_from_x_where_the_facets_lean(table):
    """The mirror direction of the facets, for light from straight above, is at azimuth 0."""
    rows = [[0.0, 0.0, 20.0, phi, 1.0] for phi in (0.0, 90.0, 180.0, 270.0)]
    found = fit(problem(read_brdf(table(rows)), ridge_angle_deg=10.0))
    assert np.argmax(found.fitted) == 0
    assert found.fitted[0] > 10.0 * found.fitted[1]


def test_material_and_ridge_angle_come_back_with_true_uncertainties(table, rng):
    truth = {"ridge_angle_deg": 7.0, "alpha_along": 0.08, "alpha_across": 0.12, "albedo": 0.3}
    angles = angles_near_the_mirror(rng, 14)
    value = ridged(angles, 7.0, Material(0.08, 0.12, 0.3))
    u = 0.01 * value
    noisy = value + u * rng.standard_normal(value.size)
    read = read_brdf(table(np.column_stack([angles, noisy, u]), HEADER + ",u"))
    found = fit(problem(read, tuple(truth), bounces=1), starts=1)
    assert found.p_value > 1e-3
    for one in found.estimates:
        assert one.value == pytest.approx(truth[one.name], rel=0.04)
        assert abs(one.value - truth[one.name]) < 4.0 * one.u


def test_far_from_the_mirror_the_roughness_is_not_determined(table):
    angles = np.array([[60.0, phi, 50.0 - 0.1 * phi, phi + 20.0] for phi in range(0, 360, 30)])
    value = ridged(angles, 0.0, Material(albedo=0.5))
    read = read_brdf(table(np.column_stack([angles, value, 0.02 * value]), HEADER + ",u"))
    found = fit(problem(read, ("alpha_along", "alpha_across", "albedo"), ridge_angle_deg=0.0, albedo=0.4))
    assert {one.name for one in found.estimates if one.value is None} == {"alpha_along", "alpha_across"}
    assert found.estimates[2].value == pytest.approx(0.5, rel=0.02)
    assert found.advice is None


def test_reciprocity_of_the_table_and_of_the_model(table, rng):
    angles = angles_near_the_mirror(rng, 12)
    swapped = angles[:, [2, 3, 0, 1]] + np.array(
        [0.0, 360.0, 0.0, -360.0]
    )  # azimuths are taken as directions
    both = np.vstack([angles, swapped])
    value = ridged(both, 9.0, Material())
    read = read_brdf(table(np.column_stack([both, value])))
    found = reciprocity(read)
    assert found.pairs == 12
    assert found.worst_share == pytest.approx(0.0, abs=1e-9)
    value[3] *= 1.1
    found = reciprocity(read_brdf(table(np.column_stack([both, value]))))
    assert found.worst_share == pytest.approx(0.1 / 1.05, rel=1e-6)
    assert found.rms_share == pytest.approx(0.1 / 1.05 / np.sqrt(12.0), rel=1e-6)
    assert found.worst_lines == (5, 17)
    assert reciprocity(read_brdf(table(np.column_stack([angles, value[:12]])))).pairs == 0


def test_what_noise_explains_of_a_table_that_is_not_physical(table):
    """One pair 3σ/√2 apart: χ² = 4.5 of one degree of freedom; one value 2 u below 0."""
    rows = [[10, 0, 20, 180, 0.5, 0.1], [20, 180, 10, 0, 0.2, 0.1], [40, 0, 50, 90, -0.2, 0.1]]
    found = reciprocity(read_brdf(table(rows, HEADER + ",u")))
    assert found.largest_k == pytest.approx(0.3 / np.hypot(0.1, 0.1))
    assert (found.pairs, found.negative) == (1, 1)
    assert found.p_value == pytest.approx(0.033895, rel=1e-4)
    assert found.negative_p_value == pytest.approx(0.045500, rel=1e-4)
    without = reciprocity(read_brdf(table([row[:5] for row in rows])))
    assert (without.p_value, without.negative, without.negative_p_value) == (None, 1, None)


def test_one_wavelength_at_a_time(table):
    header = HEADER + ",wavelength_nm,u"
    rows = [[0, 0, 10, 0, 0.5, 450, 0.1], [0, 0, 20, 0, 0.4, 550, 0.1], [0, 0, 30, 0, 0.3, 450, 0.2]]
    path = table(rows, header)
    with pytest.raises(UsageError, match=r"2 wavelengths \(450, 550 nm\): choose one"):
        read_brdf(path)
    read = read_brdf(path, 450.0)
    assert (read.lines, read.wavelength_nm) == ((2, 4), 450.0)
    np.testing.assert_allclose(np.diag(read.readings.covariance), [0.01, 0.04])
    with pytest.raises(UsageError, match="no rows at 500 nm"):
        read_brdf(path, 500.0)
    assert read_brdf(table(rows[:1], header)).wavelength_nm == 450.0
    with pytest.raises(UsageError, match="leave --wavelength out"):
        read_brdf(table([rows[0][:5]]), 450.0)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ([90.0, 0, 10, 0, 1], "line 2: theta_i_deg must lie between 0 and 89, not 90"),
        ([10, 0, -1, 0, 1], "line 2: theta_o_deg must lie"),
        ([10, 0, 10, 0], "line 2: 5 values expected, 4 found"),
        ([10, 0, 10, 0, float("inf")], "line 2: value must be a finite number"),
    ],
)
def test_wrong_lines_are_named(table, row, words):
    with pytest.raises(UsageError, match=words):
        read_brdf(table([row]))
