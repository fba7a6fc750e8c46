"""``anisoscope predict MAP --map`` as a user calls it."""

import csv

import cv2
import numpy as np
import pytest


@pytest.fixture(scope="module")
def wafer(tmp_path_factory):
    """Two levels a quarter of 550 nm apart, cells of 2 µm."""
    path = tmp_path_factory.mktemp("map") / "wafer.npz"
    levels = np.random.default_rng(5).choice([0.0, 0.1375], (24, 24))
    np.savez(path, height_um=np.kron(levels, np.ones((4, 4))), pixel_um=[0.5, 0.5])
    return path


def test_picture_and_table_agree(anisoscope, wafer, tmp_path):
    picture, table = tmp_path / "lobe.png", tmp_path / "lobe.csv"
    done = anisoscope(
        "predict", wafer, "--map", picture, "--map-csv", table, "--map-points", 21, "--wavelengths", 550, "--json"
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["stepped"] is True
    with table.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 21 * 21
    assert max(float(row["brdf_per_sr"]) for row in rows) == pytest.approx(
        done.json["peak_per_sr"][0], rel=1e-5
    )
    assert cv2.imread(str(picture)) is not None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--map", "x.jpg"], "--map writes *.png"),
        (["--map-light", "10,0"], "name what to write"),
        (["--map", "x.png", "--map-colour", "d65", "--wavelengths", "500"], "leave --wavelengths out"),
        (["--map", "x.png", "--tilts", "5"], "leave --tilts out"),
        (["--map", "x.png", "--map-light", "10"], "inclination and azimuth"),
    ],
)
def test_mistakes_are_told_in_one_line(anisoscope, wafer, arguments, message):
    done = anisoscope("predict", wafer, *arguments)
    assert done.code not in (0, 1)
    assert message in done.err
    assert done.err.count("\n") == 1
