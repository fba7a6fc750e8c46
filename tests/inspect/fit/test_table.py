import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.fit.table import matrix_of_shared, read_readings
from anisoscope.parameters.geometry import Pose

EXPOSURES = "stage_deg,tilt_deg,value"
CONTRASTS = "from_deg,to_deg,tilt_deg,value"


@pytest.fixture
def table(tmp_path):
    """``table(header, *lines)`` writes a CSV file and gives its path."""

    def write(header, *lines, name="table.csv"):
        path = tmp_path / name
        path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
        return path

    return write


def test_exposures_as_they_are(table):
    poses, found = read_readings(table(EXPOSURES + ",u", "0,-10,5,0.1", "", " 90 , -10 , 2 , 0.2 "), None)
    assert poses == (Pose(0.0, -10.0), Pose(90.0, -10.0))
    assert found.kind == "exposure"
    assert found.noise_known
    np.testing.assert_array_equal(found.value, [5.0, 2.0])
    np.testing.assert_allclose(found.covariance, np.diag([0.01, 0.04]))


def test_a_repeated_pose_is_a_second_measurement(table):
    _, found = read_readings(table(EXPOSURES, "0,0,5", "0,0,6"), None)
    assert not found.noise_known
    assert found.covariance[0, 1] == 0.0
    assert "estimated from the residuals" in found.assumption


@pytest.mark.parametrize("kind", ["difference", "michelson", "log_ratio"])
def test_contrasts_of_exposures_carry_the_covariance_of_a_simulation(table, kind):
    value, u = np.array([5.0, 2.0, 3.0, 7.0]), np.array([0.01, 0.02, 0.01, 0.03])
    rows = [
        f"{a},{t},{v},{s}"
        for (a, t), v, s in zip([(0, 0), (90, 0), (180, 0), (0, 10)], value, u, strict=True)
    ]
    _, found = read_readings(table(EXPOSURES + ",u", *rows), kind)
    assert len(found.value) == 2  # the pair across tilts is no contrast
    rng = np.random.default_rng(1)
    noisy = value + u * rng.standard_normal((100_000, 4))
    many = np.array([found.predicted(one, 1.0) for one in noisy[:20_000]])
    np.testing.assert_allclose(found.value, many.mean(axis=0), rtol=1e-3)
    np.testing.assert_allclose(found.covariance, np.cov(many.T), rtol=0.06)
    assert found.covariance[0, 1] < 0.0
    assert found.labels == ("0° / 90°, tilt 0°", "90° / 180°, tilt 0°")


def test_contrasts_that_share_a_photograph_share_half_of_their_variance(table):
    path = table(CONTRASTS + ",u", "0,90,0,1.5,0.2", "90,180,0,-0.5,0.1", "0,90,10,1,0.3")
    poses, found = read_readings(path, "difference")
    assert len(poses) == 5
    np.testing.assert_allclose(np.diag(found.covariance), [0.04, 0.01, 0.09])
    assert found.covariance[0, 1] == pytest.approx(-0.5 * 0.2 * 0.1)
    assert found.covariance[0, 2] == found.covariance[1, 2] == 0.0
    assert "half of the variance" in found.assumption
    _, apart = read_readings(path, "difference", "independent")
    assert apart.covariance[0, 1] == 0.0
    assert "independent" in apart.assumption


def test_the_sign_of_the_shared_part_follows_the_direction_of_the_pairs():
    first, second = np.array([0, 0, 1]), np.array([1, 2, 0])
    found = matrix_of_shared(np.diag([1.0, 1.0, 1.0]), first, second)
    assert found[0, 1] == pytest.approx(0.5)  # both start from 0
    assert found[0, 2] == pytest.approx(-1.0)  # the same two, the other way


def test_a_covariance_of_its_own(table):
    path = table(CONTRASTS, "0,90,0,0.2", "90,180,0,0.1")
    given = table("4e-4,-1e-4", "-1e-4,9e-4", name="covariance.csv")
    _, found = read_readings(path, "michelson", covariance=given)
    np.testing.assert_allclose(found.covariance, [[4e-4, -1e-4], [-1e-4, 9e-4]])
    assert found.noise_known


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["1,0"], "2 lines of 2 finite numbers"),
        (["1,0", "0,x"], "2 lines of 2 numbers"),
        (["1,0,0", "0,1"], "2 lines of 2 numbers"),
        (["1,2", "2,1"], "no covariance"),
        (["1,0.5", "0.1,1"], "no covariance"),
        (["0,0", "0,1"], "no covariance"),
        (["1,nan", "nan,1"], "finite"),
    ],
)
def test_what_is_no_covariance_is_refused(table, lines, words):
    path = table(CONTRASTS, "0,90,0,0.2", "90,180,0,0.1")
    with pytest.raises(UsageError, match=words):
        read_readings(path, "michelson", covariance=table(*lines, name="covariance.csv"))


@pytest.mark.parametrize(
    ("header", "lines", "kind", "words"),
    [
        ("stage,tilt,value", ["0,0,1"], None, "line 1: the header must read stage_deg,tilt_deg,value"),
        (EXPOSURES + ",v", ["0,0,1,1"], None, "line 1: the header must read"),
        (EXPOSURES + ",u,u", ["0,0,1,1,1"], None, "line 1: the header must read"),
        (EXPOSURES, [], None, "line 1: no values follow"),
        (EXPOSURES, ["0,0,1", "0,0"], None, "line 3: 3 values expected, 2 found"),
        (EXPOSURES, ["0,0,bright"], None, "line 2: value is not a number: 'bright'"),
        (EXPOSURES, ["0,nan,1"], None, "line 2: tilt_deg must be a finite number, not 'nan'"),
        (EXPOSURES + ",u", ["0,0,1,0.1", "", "90,0,1,0"], None, "line 4: u must be a finite number above 0"),
        (EXPOSURES + ",u", ["0,0,1,-1"], None, "line 2: u must be"),
        (EXPOSURES, ["0,0,1", "90,0,-1"], "log_ratio", "line 3: the ratio of an exposure of -1"),
        (EXPOSURES, ["0,0,1", "90,10,1"], "difference", "no two consecutive lines share a tilt"),
        (CONTRASTS, ["0,90,0,1"], None, "say which with --quantity"),
        (CONTRASTS, ["0,90,0,1"], "exposure", "say which with --quantity"),
        (CONTRASTS, ["0,90,0,0.5", "90,90,0,1"], "difference", "line 3: a contrast of 90° with itself"),
        (CONTRASTS, ["0,90,0,1", "90,0,0,1", "0,90,0,1"], "difference", "line 4: this pair is given twice"),
        (CONTRASTS, ["0,90,0,-1"], "michelson", "line 2: a Michelson contrast lies between -1 and 1"),
        (EXPOSURES, ["0,0," + "1" * 140_000], None, "line 2: field larger"),
    ],
)
def test_wrong_lines_are_named(table, header, lines, kind, words):
    with pytest.raises(UsageError) as caught:
        read_readings(table(header, *lines), kind)
    assert words in str(caught.value)
    assert "table.csv" in str(caught.value)


def test_a_pair_given_twice_may_be_independent(table):
    _, found = read_readings(table(CONTRASTS, "0,90,0,1", "0,90,0,2"), "difference", "independent")
    assert len(found.value) == 2


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        read_readings(tmp_path / "nowhere.csv", None)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not UTF-8"):
        read_readings(tmp_path / "binary.csv", None)
