import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.experiment.experiment import (
    COLUMNS,
    PAIRS_DEG,
    RIDGE_ANGLES_DEG,
    SHAPE,
    TILTS_DEG,
    Setup,
    absolute_contrasts,
    combinations,
    findings,
    read_measured,
    run_experiment,
)
from anisoscope.experiment.findings_map import findings_share
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected, printed
from anisoscope.sim.light.geometry import directions

IN_PLANE = Convention(tilt_plane="in-plane")
HEADER = ",".join(COLUMNS)


@pytest.fixture
def table(tmp_path):
    """``table("5,0,0,90,1.0", ...)`` writes a CSV with these lines below the header and gives its path."""

    def write(*lines, header=HEADER, name="measured.csv"):
        path = tmp_path / name
        path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize("model", ["printed", "corrected"])
def test_contrasts_are_those_of_the_model_pose_by_pose(model):
    setup = Setup(model)
    found = absolute_contrasts(setup)
    assert found.shape == SHAPE
    compute = {"printed": printed, "corrected": corrected}[model].radiance

    def exposure(angle, tilt, stage):
        to_light, to_camera = directions((Pose(stage, tilt),), setup.convention)
        return compute(to_light, to_camera, RidgeDesign(50.0, angle), setup.material)[0]

    for index, (angle, tilt, first, second) in combinations():
        by_hand = abs(exposure(angle, tilt, first) - exposure(angle, tilt, second))
        assert found[index] == pytest.approx(by_hand, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("model", ["printed", "corrected"])
def test_the_published_findings_come_out_at_the_defaults(model):
    found = run_experiment(Setup(model))
    assert found.k == 1.0
    assert found.findings.max_at_zero_tilt
    assert found.findings.first_pair_larger
    assert found.findings.best_ridge_angle_deg == 5.0
    assert found.findings.as_published


def test_the_lambertian_base_is_what_keeps_the_corrected_model_from_falling_monotonically():
    assert run_experiment(Setup("printed")).findings.falls_on_both_sides
    assert run_experiment(Setup("corrected", Material(albedo=0.0))).findings.falls_on_both_sides
    assert not run_experiment(Setup("corrected")).findings.falls_on_both_sides


GRID = np.geomspace(0.03, 0.3, 12)


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0, 270.0])
def test_with_the_light_in_the_tilt_plane_no_roughness_gives_the_findings(azimuth):
    convention = Convention(tilt_plane="in-plane", facet_azimuth_deg=azimuth)
    found = findings_share(Setup(convention=convention), GRID, GRID)
    assert found.share == 0.0
    assert found.extent is None


@pytest.mark.parametrize("model", ["printed", "corrected"])
def test_reciprocity_is_what_forbids_the_findings_in_plane(model):
    """Tilt 0 is tilt -10 with light and camera exchanged and the part turned by 180°, which swaps the pairs."""
    found = absolute_contrasts(Setup(model, convention=IN_PLANE))
    zero, minus_ten = found[:, TILTS_DEG.index(0.0)], found[:, TILTS_DEG.index(-10.0), ::-1]
    np.testing.assert_allclose(zero, np.cos(np.radians(10.0)) * minus_ten, rtol=1e-6)


def test_map_of_findings_agrees_with_single_experiments():
    along, across = np.array([0.04, 0.08, 0.2]), np.array([0.05, 0.14])
    found = findings_share(Setup(), along, across)
    for i, a in enumerate(along):
        for j, b in enumerate(across):
            single = run_experiment(Setup(material=Material(float(a), float(b)))).findings
            assert found.all_three[i, j] == single.as_published
            assert found.falling_too[i, j] == (single.as_published and single.falls_on_both_sides)
            assert found.max_at_zero_tilt[i, j] == single.max_at_zero_tilt
            assert found.best_at_five[i, j] == (single.best_ridge_angle_deg == 5.0)
    assert found.share == np.mean(found.all_three)
    assert 0.0 < found.share < 1.0


def test_the_findings_need_smooth_ridges_along_their_length():
    """Somewhere, but not everywhere; and the map names the corner values of its region."""
    found = findings_share(Setup(), GRID, GRID)
    assert 0.3 < found.share < 0.6
    assert found.falling_too.mean() < found.share
    low, high = found.extent["alpha_along"]
    assert low == GRID[0]
    assert found.all_three[GRID < 0.06].all()
    assert not found.all_three[high < GRID].any()


def test_equal_mean_roughness_shares_its_tables_without_changing_the_findings():
    grid = np.geomspace(0.05, 0.2, 2)
    found = findings_share(Setup("corrected"), grid, grid)
    single = run_experiment(Setup("corrected", Material(0.05, 0.2)))
    assert found.all_three[0, 1] == single.findings.as_published


@pytest.mark.parametrize("tilt_plane", ["perpendicular", "in-plane"])
@pytest.mark.parametrize("frame", ["pitch-normal", "half-vector"])
def test_index_and_albedo_only_scale_the_printed_experiment(tilt_plane, frame):
    """So no fit to this experiment can tell them."""
    convention = Convention(tilt_plane=tilt_plane)
    base = absolute_contrasts(Setup("printed", Material(), convention, frame))
    other = absolute_contrasts(Setup("printed", Material(albedo=0.8, index=1.9), convention, frame))
    seen = base > 1e-9
    ratio = other[seen] / base[seen]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert abs(ratio[0] - 1.0) > 0.1
    assert findings(base) == findings(other)


def test_index_and_albedo_do_more_than_scale_the_corrected_experiment():
    base = absolute_contrasts(Setup("corrected"))
    other = absolute_contrasts(Setup("corrected", Material(albedo=0.8)))
    assert np.ptp(other / base) > 0.1


def test_k_recovers_a_known_scale():
    predicted = absolute_contrasts(Setup())
    found = run_experiment(Setup(), 37.5 * predicted)
    assert found.k == pytest.approx(37.5, rel=1e-12)
    assert found.rms_residual == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.predicted, 37.5 * predicted, rtol=1e-12)
    assert found.measured_findings == found.findings


def test_k_is_the_least_squares_one_over_the_rows_given(rng):
    setup = Setup("corrected")
    predicted = absolute_contrasts(setup)
    measured = 3.0 * predicted + 0.05 * rng.random(SHAPE)
    given = rng.random(SHAPE) < 0.5
    measured[~given] = np.nan
    found = run_experiment(setup, measured)

    def rms(k):
        return np.sqrt(np.mean((k * predicted[given] - measured[given]) ** 2))

    assert found.rms_residual == pytest.approx(rms(found.k), rel=1e-12)
    assert all(rms(found.k) < rms(found.k * (1.0 + step)) for step in (-1e-3, 1e-3))
    assert np.sum((found.predicted - measured)[given] * predicted[given]) == pytest.approx(0.0, abs=1e-12)
    assert found.measured_findings is None


@pytest.mark.parametrize("scale", [0.0, 1e308])
def test_a_scale_that_cannot_be_fitted_is_refused(scale):
    with pytest.raises(UsageError, match="no scale k"):
        run_experiment(Setup(), np.full(SHAPE, scale))


def test_marginal_means_by_brute_force(rng):
    measured = 0.3 * rng.random(SHAPE)
    measured[rng.random(SHAPE) < 0.3] = np.nan
    measured[:, 1] = np.nan
    found = run_experiment(Setup(), measured)
    rows = [(row, found.predicted[index], measured[index]) for index, row in combinations()]
    keys = {"ridge_angle": lambda r: r[:1], "tilt": lambda r: r[1:2], "pair": lambda r: r[2:]}
    levels = {
        "ridge_angle": [(a,) for a in RIDGE_ANGLES_DEG],
        "tilt": [(t,) for t in TILTS_DEG],
        "pair": list(PAIRS_DEG),
    }
    for name, key in keys.items():
        assert [m.level_deg for m in found.means[name]] == levels[name]
        for mean in found.means[name]:
            here = [(p, m) for row, p, m in rows if key(row) == mean.level_deg]
            both = [(p, m) for p, m in here if np.isfinite(m)]
            assert mean.predicted == pytest.approx(sum(p for p, _ in here) / len(here))
            assert mean.measured_rows == len(both)
            if both:
                assert mean.measured == pytest.approx(sum(m for _, m in both) / len(both))
                assert mean.predicted_same_rows == pytest.approx(sum(p for p, _ in both) / len(both))
            else:
                assert (mean.measured, mean.predicted_same_rows) == (None, None)
    assert found.means["tilt"][1].measured is None


def made(tilt=(1, 2, 3, 2, 1), angle=(4, 3, 2, 1), pair=(2, 1)):
    """A table with these marginal means, up to a factor."""
    return np.einsum("a,t,p->atp", *(np.array(v, dtype=float) for v in (angle, tilt, pair)))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (True, True, True, 5.0)),
        ({"tilt": (2, 1, 3, 2, 1)}, (True, False, True, 5.0)),
        ({"tilt": (1, 2, 3, 1, 1)}, (True, False, True, 5.0)),
        ({"tilt": (1, 3, 3, 2, 1)}, (False, False, True, 5.0)),
        ({"tilt": (4, 2, 3, 2, 1)}, (False, False, True, 5.0)),
        ({"pair": (1, 2)}, (True, True, False, 5.0)),
        ({"pair": (1, 1 - 1e-13)}, (True, True, False, 5.0)),
        ({"angle": (3, 4, 2, 1)}, (True, True, True, 10.0)),
        ({"angle": (4, 4, 2, 1)}, (True, True, True, None)),
        ({"tilt": (0, 0, 0, 0, 0)}, (False, False, False, None)),
    ],
)
def test_findings_of_made_tables(changes, expected):
    found = findings(made(**changes))
    assert (
        found.max_at_zero_tilt,
        found.falls_on_both_sides,
        found.first_pair_larger,
        found.best_ridge_angle_deg,
    ) == expected
    assert found.as_published == (expected[0] and expected[2] and expected[3] == 5.0)


def test_a_frame_for_the_corrected_model_is_refused():
    with pytest.raises(UsageError, match="printed model only"):
        Setup("corrected", shadow_frame="half-vector")


def test_reading_keeps_what_is_missing_missing(table):
    found = read_measured(table("20,-20,90,180,0.5", "", " 5 , 0.0 , 0 , 90 , 1e-3 "))
    assert found[3, 0, 1] == 0.5
    assert found[0, 2, 0] == 1e-3
    assert np.isfinite(found).sum() == 2


def test_reading_takes_files_of_spreadsheets(tmp_path):
    path = tmp_path / "sheet.csv"
    path.write_bytes(b"\xef\xbb\xbf" + HEADER.encode() + b'\r\n"5","0","0","90","0.25"\r\n')
    assert read_measured(path)[0, 2, 0] == 0.25


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["5,0,0,90,0.5", "7,0,0,90,0.5"], "line 3: the experiment has no ridge angle 7°"),
        (["5,5,0,90,0.5"], "line 2: the experiment has no ridge angle 5°, tilt 5°"),
        (["5,0,90,0,0.5"], "pair 90°/0°"),
        (["5,0,0,180,0.5"], "pair 0°/180°"),
        (["5,0,0,90,0.5", "", "5,0,0,90,0.6"], "line 4: this combination is given twice"),
        (["5,0,0,90"], "line 2: 5 values expected, 4 found"),
        (["5;0;0;90;0,5"], "line 2: 5 values expected, 2 found"),
        (["5,0,0,90,bright"], "line 2: contrast is not a number: 'bright'"),
        (["five,0,0,90,0.5"], "line 2: ridge_angle_deg is not a number"),
        (["5,0,0,90,"], "line 2: contrast is not a number: ''"),
        (["5,0,0,90,-0.5"], "line 2: contrast must be a finite number, 0 or more"),
        (["5,0,0,90,nan"], "line 2: contrast must be a finite number"),
        (["5,inf,0,90,0.5"], "line 2: tilt_deg must be a finite number"),
        ([], "line 1: no contrasts follow"),
        (["5,0,0,90," + "1" * 140_000], "line 2: field larger"),
    ],
)
def test_wrong_lines_are_named(table, lines, words):
    with pytest.raises(UsageError) as caught:
        read_measured(table(*lines))
    assert words in str(caught.value)
    assert "measured.csv" in str(caught.value)


@pytest.mark.parametrize(
    "header", ["", "a,b", HEADER + ",measured", HEADER.replace("contrast", "c"), "5,0,0,90,1"]
)
def test_a_wrong_header_is_line_one(table, header):
    with pytest.raises(UsageError, match="line 1: the header must read ridge_angle_deg"):
        read_measured(table("5,0,0,90,1", header=header))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        read_measured(tmp_path / "nowhere.csv")
    with pytest.raises(UsageError, match="Is a directory"):
        read_measured(tmp_path)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not UTF-8"):
        read_measured(tmp_path / "binary.csv")
