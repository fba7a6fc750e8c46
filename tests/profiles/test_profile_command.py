import json
import subprocess
import sys

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.cli.options import parse_pixel
from anisoscope.cli.profile.profile import app
from anisoscope.profiles.files.load import read_height_map


def run(*arguments):
    return app(
        [str(a) for a in arguments], exit_on_error=False, print_error=False, result_action="return_value"
    )


def test_info_as_json_is_one_object(tmp_path, capsys):
    np.save(tmp_path / "a.npy", np.array([[0.0, 2.0, 0.0], [2.0, np.nan, 1.0]]))
    assert run("info", tmp_path / "a.npy", "--json", "--pixel", "2,1.5") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["rows"], found["cols"]) == (2, 3)
    assert found["pixel_um"] == [2.0, 1.5]
    assert found["missing_share"] == pytest.approx(1 / 6)
    assert (found["sa_um"], found["sq_um"], found["sz_um"]) == pytest.approx((0.8, np.sqrt(0.8), 2.0))


def test_info_as_table_names_units(tmp_path, capsys):
    np.save(tmp_path / "a.npy", np.eye(4))
    assert run("info", tmp_path / "a.npy", "--pixel", "2", "--z-unit", "nm", "--role", "tool") == 0
    shown = capsys.readouterr().out
    for word in ("rows", "columns", "µm", "missing", "Sa", "Sq", "Sz", "role tool"):
        assert word in shown


def test_convert(tmp_path):
    np.save(tmp_path / "a.npy", np.eye(4))
    run("convert", tmp_path / "a.npy", tmp_path / "a.x3p", "--pixel", "2,1")
    assert read_height_map(tmp_path / "a.x3p").pixel_y_um == 2.0


def test_errors_are_ours(tmp_path):
    np.save(tmp_path / "a.npy", np.eye(4))
    with pytest.raises(HeightMapError, match="--pixel"):
        run("info", tmp_path / "a.npy")
    for text in ("a", "1,2,3", "0", "-1,1", "nan"):
        with pytest.raises(UsageError):
            parse_pixel(text)
    assert parse_pixel("2") == (2.0, 2.0)
    assert parse_pixel(None) is None


def test_reading_a_map_imports_nothing_slow():
    code = (
        "import sys, anisoscope.profiles.files.load, anisoscope.profiles.level, anisoscope.profiles.defects, "
        "anisoscope.cli.profile.profile; "
        "print([m for m in ('scipy', 'cv2', 'numba', 'matplotlib', 'pydantic', 'urllib.request') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_scales_of_a_picture_and_where_it_came_from(tmp_path, capsys):
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", np.arange(12, dtype=np.uint16).reshape(3, 4))
    scales = ("--pixel", "2,1", "--height-per-count", "10", "--z-unit", "nm", "--rows", "up")
    assert run("info", tmp_path / "a.tif", "--json", *scales) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["sz_um"] == pytest.approx(0.11)
    assert found["origin"]["reader"] == "anisoscope"
    assert "corrected" not in found["origin"]
    assert run("info", tmp_path / "a.tif", *scales[:-2]) == 0
    assert "rows turned" in capsys.readouterr().out


def test_convert_keeps_what_exists(tmp_path):
    np.save(tmp_path / "a.npy", np.eye(4))
    run("convert", tmp_path / "a.npy", tmp_path / "a.gsf", "--pixel", "2,1")
    with pytest.raises(UsageError, match="--overwrite"):
        run("convert", tmp_path / "a.npy", tmp_path / "a.gsf", "--pixel", "2,1")
    assert read_height_map(tmp_path / "a.gsf").pixel_y_um == pytest.approx(2.0)
