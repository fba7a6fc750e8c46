"""``anisoscope calibrate`` as the operator runs it."""

import pytest

from anisoscope.calibration.record import read_calibration

SMALL = {
    "sensor": {"rows": 288, "cols": 320, "hot_pixel_share": 0.0},
    "optics": {"pixel_um": 14.0, "blur_um": 8.0, "electrons": 6.0e6, "lamp_noise": 0.0},
}
RIG = {"camera": {"pixel_um": 14.0}}


@pytest.fixture
def small(virtual_rig):
    """``small(name, {"kind": …})`` lays out a small rig with a sample, and gives its rig file."""

    def lay_out(name, sample, rig=None):
        return virtual_rig(name, bench={**SMALL, "sample": sample}, rig={**RIG, **(rig or {})}).rig

    return lay_out


def test_the_calibrations_of_a_rig_one_after_the_other(anisoscope, small, tmp_path):
    tile = small("tile", {"kind": "white-tile"})
    flat = tmp_path / "flat.tif"
    done = anisoscope("calibrate", "flat", "-g", tile, "--out", flat, "--exposure", 0.004, "--json")
    assert done.code == 0, done.err
    assert (done.json["file"], done.json["camera"]) == (str(flat), done.json["record"]["camera"]["serial"])
    assert done.json["record"]["kind"] == "flat"

    named = {"calibration": {"flat": str(flat)}}
    glass = small("glass", {"kind": "white-tile", "reflectance": 0.0}, named)
    done = anisoscope("calibrate", "stray", "-g", glass, "--out", tmp_path / "stray", "--exposure", 0.05)
    assert done.code == 0, done.err
    for word in ("stray radiance", "share of tile", "valid until", "[calibration] stray"):
        assert word in done.out
    read_calibration(tmp_path / "stray.json", "stray")

    lit = small("lit", {"kind": "white-tile"}, named)
    done = anisoscope(
        "calibrate", "dark", "-g", lit, "--out", tmp_path / "dark.tif", "--exposure", 0.01, "--count", 4
    )
    assert done.code == 0, done.err

    calibration = {kind: str(tmp_path / f"{kind}.json") for kind in ("stray", "dark")}
    whole = small("whole", {"kind": "white-tile"}, {"calibration": {"flat": str(flat), **calibration}})
    done = anisoscope("calibrate", "list", "-g", whole, "--json")
    assert done.code == 0, done.err
    assert {one["kind"]: one["state"] for one in done.json} == {
        "flat": "valid",
        "dark": "valid",
        "stray": "valid",
        "linearity": "missing",
        "rotation": "missing",
        "focus": "missing",
        "check": "missing",
        "fixture": "missing",
    }
    flat.unlink()
    done = anisoscope("calibrate", "list", "-g", whole)
    assert done.code == 3
    assert "calibrate flat" in done.out


def test_rotation_and_linearity_print_what_was_found(anisoscope, small, tmp_path):
    part = small("part", {"size_mm": 0.6})
    done = anisoscope(
        *("calibrate", "rotation", "-g", part, "--out", tmp_path / "rotation.json"),
        *("--exposure", 0.006, "--steps", 6, "--operator", "ada", "--json"),
    )
    assert done.code == 0, done.err
    assert done.json["operator"] == "ada"
    assert done.json["values"]["pixel"]["value"] == pytest.approx(14.0, rel=1e-3)
    tile = small("tile", {"kind": "white-tile"})
    done = anisoscope(
        *("calibrate", "linearity", "-g", tile, "--out", tmp_path / "linearity.json"),
        *("--exposure", 0.002, "--steps", 14),
    )
    assert done.code == 0, done.err
    assert "read noise" in done.out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("dark", "--exposure", "0.01", "--count", "1"), 64, "2 frames"),
        (("dark", "--exposure", "0.01", "--valid-days", "0"), 64, "--valid-days"),
        (("flat", "--exposure", "0.004", "--reflectance", "2"), 64, "reflectance"),
        (("linearity", "--exposure", "0.002", "--steps", "2"), 64, "steps"),
        (("rotation", "--exposure", "0.002", "--steps", "3"), 78, "no such file"),
        (("check", "--recipe", "none.toml", "--serial", "K-1"), 64, "--teach"),
        (("dark", "--exposure", "0.01"), 78, "no such file"),
    ],
)
def test_what_makes_no_sense_is_one_line(anisoscope, tmp_path, arguments, code, message):
    kind, *options = arguments
    done = anisoscope("calibrate", kind, "-g", tmp_path / "none.toml", "--out", tmp_path / "x", *options)
    assert done.code == code
    assert message in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_a_clipped_tile_ends_with_exit_code_3(anisoscope, small, tmp_path):
    tile = small("tile", {"kind": "white-tile"})
    done = anisoscope("calibrate", "flat", "-g", tile, "--out", tmp_path / "flat.tif", "--exposure", 0.5)
    assert done.code == 3
    assert "shorten --exposure" in done.err
    assert not (tmp_path / "flat.tif").exists()


def test_an_inspection_with_an_expired_calibration_is_invalid(anisoscope, virtual_rig, tmp_path):
    rig = virtual_rig("part")
    own = tmp_path / "dark.tif"
    taken = anisoscope(
        *("calibrate", "dark", "-g", rig.rig, "--out", own, "--exposure", 0.01, "--count", 2),
        *("--valid-days", 1e-9),
    )
    assert taken.code == 0, taken.err
    rig.rig.write_text(rig.rig.read_text().replace("[calibration]", f'[calibration]\ndark = "{own}"'))
    done = anisoscope("inspect", "-r", rig.recipe, "-g", rig.rig, "-s", "T-1", "--out", rig.out, "--json")
    assert done.code == 3, done.err
    assert done.json["verdict"] == "INVALID"
    assert "calibrate dark" in done.json["reasons"][0]
    assert len(rig.folders) == 1
