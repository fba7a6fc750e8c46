"""Calibrations taken on the virtual rig give back what the bench was made of, and tell when something is wrong."""

import numpy as np
import pytest
import tifffile

from anisoscope.base.errors import CalibrationError, RegistrationError, RigFileError, UsageError
from anisoscope.calibration.corrections import read_picture
from anisoscope.calibration.linearity import calibrate_linearity
from anisoscope.calibration.pictures import calibrate_dark, calibrate_flat, calibrate_stray
from anisoscope.calibration.record import read_calibration
from anisoscope.calibration.rotation import calibrate_rotation
from anisoscope.calibration.white_reference import inspect_tile, read_reference
from anisoscope.parameters.taking import Taking
from anisoscope.rig.rigfile import read_rig

ROWS, COLS, PIXEL_UM = 288, 320, 14.0
EXPOSURE_S = 0.004
TILE = {"kind": "white-tile"}
BLACK_GLASS = {"kind": "white-tile", "reflectance": 0.0}


@pytest.fixture
def small(virtual_rig):
    """``small(name, sample={...}, …)`` lays out a rig of 288 × 320 pixels with changes to its bench."""

    def lay_out(name="small", rig=None, **bench):
        found = {
            "sample": {"size_mm": 0.6},
            "sensor": {"rows": ROWS, "cols": COLS, "hot_pixel_share": 0.0},
            "optics": {"pixel_um": PIXEL_UM, "blur_um": 8.0, "electrons": 6.0e6, "lamp_noise": 0.0},
        }
        for table, values in bench.items():
            found[table] = {**found.get(table, {}), **values}
        return virtual_rig(name, bench=found, rig={"camera": {"pixel_um": PIXEL_UM}, **(rig or {})})

    return lay_out


@pytest.fixture
def small_flat(small, tmp_path):
    """A white reference of the small rig."""
    calibrate_flat(small("tile", sample=TILE).rig, tmp_path / "small.tif", Taking(EXPOSURE_S))
    return tmp_path / "small.tif"


def test_a_flat_has_a_record_beside_it_that_fits(small, tmp_path):
    taking = Taking(EXPOSURE_S, frames=4, valid_days=5.0, operator="ada", temperature_c=21.5)
    meta, record = calibrate_flat(small(sample=TILE).rig, tmp_path / "flat.tif", taking)
    assert read_calibration(tmp_path / "flat.tif", "flat") == record
    assert (record.operator, record.temperature_c, record.valid_for_days) == ("ada", 21.5, 5.0)
    assert record.number("radiance") == meta["radiance"] == read_reference(tmp_path / "flat.tif").radiance
    assert record.in_limits
    assert not record.remarks


def test_a_dirty_or_unevenly_lit_tile_is_told(rng):
    y, x = np.meshgrid(np.linspace(-1, 1, ROWS), np.linspace(-1, 1, COLS), indexing="ij")
    clean = 1000.0 * (1.0 - 0.15 * (x**2 + y**2) / 2.0) * (1.0 + 0.005 * rng.standard_normal(x.shape))
    found = inspect_tile(clean.astype(np.float32), 0.005)
    assert not found.remarks
    assert found.gradient < 0.01
    assert found.structure < 0.002
    dusty = clean.copy()
    dusty[60:66, 40:46] *= 0.9
    dusty[200:206, 240:246] *= 0.9
    assert "spots" in inspect_tile(dusty.astype(np.float32), 0.005).remarks[0]
    mottled = clean * (
        1.0 + 0.05 * rng.standard_normal((ROWS // 3, COLS // 4 + 1)).repeat(3, 0).repeat(4, 1)[:, :COLS]
    )
    assert "mottled" in " ".join(inspect_tile(mottled.astype(np.float32), 0.005).remarks)
    tilted = inspect_tile((clean * (1.0 + 0.15 * x)).astype(np.float32), 0.005)
    assert tilted.gradient == pytest.approx(0.3, abs=0.01)
    assert "across the picture" in tilted.remarks[0]


def test_a_dark_calibration_gives_level_noise_and_hot_pixels(small, tmp_path):
    sensor = {"hot_pixel_share": 0.001, "read_noise_e": 15.0, "black_level": 80.0, "dark_current_e_s": 200.0}
    rig = small(sensor=sensor)
    record = calibrate_dark(rig.rig, tmp_path / "dark", Taking(0.1, frames=16))
    dn = 1.0 / 7.5
    assert record.number("level") == pytest.approx(80.0 + 200.0 * 0.1 * dn, abs=0.1)
    noise = np.sqrt((15.0**2 + 200.0 * 0.1) * dn**2 + 1.0 / 12.0)
    assert record.number("noise") == pytest.approx(noise, rel=0.02)
    assert record.number("hot_share") == pytest.approx(0.001, rel=0.5)
    mean, hot = read_picture(tmp_path / "dark.tif", "dark")
    assert hot.mean() == pytest.approx(record.number("hot_share"))
    assert mean[hot > 0.5].min() > mean[hot < 0.5].max()
    assert not rig.bench.light_on


def test_light_in_the_dark_is_out_of_limits(small, tmp_path):
    record = calibrate_dark(
        small(sensor={"black_level": 1500.0}).rig, tmp_path / "dark", Taking(0.01, frames=2)
    )
    assert not record.in_limits
    assert "does light reach the camera" in record.remarks[0]


@pytest.mark.parametrize("truth", [0.0, pytest.param(0.0002, marks=pytest.mark.soak), 0.002])
def test_the_stray_light_of_the_bench_comes_back(small, small_flat, tmp_path, truth):
    rig = {"calibration": {"flat": str(small_flat)}}
    black = small("black", rig=rig, sample=BLACK_GLASS, optics={"stray_radiance": truth})
    record = calibrate_stray(black.rig, tmp_path / "stray.json", Taking(0.05))
    u = record.uncertainty("stray_radiance")
    assert record.number("stray_radiance") == pytest.approx(truth, abs=3.0 * u + 0.01 * truth)
    assert 0.0 < u < 3e-5
    signal = read_picture(tmp_path / "stray.tif", "stray")
    assert signal.shape == (ROWS, COLS)
    assert not black.bench.light_on


def test_something_bright_is_no_light_trap(small, small_flat, tmp_path):
    rig = {"calibration": {"flat": str(small_flat)}}
    with pytest.raises(CalibrationError, match="lay black glass"):
        calibrate_stray(
            small("grey", rig=rig, sample={**TILE, "reflectance": 0.2}).rig, tmp_path / "s", Taking(0.004)
        )
    with pytest.raises(RigFileError, match="names no flat"):
        calibrate_stray(small("none", rig={"calibration": None}).rig, tmp_path / "s", Taking(0.004))
    assert not list(tmp_path.glob("s.*"))


SENSORS = {
    "usual": {},
    "quiet": {"gain_e_per_dn": 4.0, "full_well_e": 12_000.0, "read_noise_e": 12.0},
}


@pytest.mark.parametrize("sensor", SENSORS)
def test_gain_and_read_noise_of_the_bench_come_back(small, tmp_path, sensor):
    made = {"gain_e_per_dn": 7.5, "full_well_e": 30_000.0, "read_noise_e": 16.0} | SENSORS[sensor]
    rig = small(sample=TILE, sensor=made)
    record = calibrate_linearity(rig.rig, tmp_path / "linearity.json", Taking(0.002, frames=8), steps=20)
    assert 1.0 / record.number("gain") == pytest.approx(made["gain_e_per_dn"], rel=0.02)
    assert record.number("read_noise") == pytest.approx(made["read_noise_e"], rel=0.02)
    assert record.number("saturation") == pytest.approx(made["full_well_e"], rel=0.08)
    assert record.number("linearity_error") < 0.002
    assert record.details["response_per_count"] == 0.0
    assert record.in_limits


def test_filters_are_no_unevenness_of_the_pixels(small, tmp_path):
    """EMVA 1288 takes colours one by one: full well and PRNU are those of the sensor, however filters differ."""
    rig = small(sample=TILE, sensor={"filters": "grbg", "read_noise_e": 16.0, "prnu": 0.004})
    record = calibrate_linearity(rig.rig, tmp_path / "linearity.json", Taking(0.002, frames=8), steps=12)
    assert 1.0 / record.number("gain") == pytest.approx(7.5, rel=0.03)
    assert record.number("prnu") == pytest.approx(0.004, rel=0.15)
    assert record.number("saturation") == pytest.approx(30_000.0, rel=0.08)
    assert record.in_limits


def test_a_bent_response_is_found_and_fitted(small, tmp_path):
    rig = small(sample=TILE, sensor={"nonlinearity": 0.05})
    record = calibrate_linearity(rig.rig, tmp_path / "linearity.json", Taking(0.002, frames=8), steps=20)
    assert record.number("raw_error") > 0.005
    assert record.number("linearity_error") < 0.002
    # s = e·(1 − n·e/well)/K, so light ∝ s·(1 + n·K·s/well) to first order
    assert record.details["response_per_count"] == pytest.approx(0.05 * 7.5 / 30_000.0, rel=0.15)
    assert "inspections at this gain correct it" in record.remarks[0]


def test_a_clipped_or_dark_start_is_refused(small, tmp_path):
    rig = small(sample=TILE)
    for exposure_s, word in ((0.1, "shorten"), (1e-5, "lengthen")):
        with pytest.raises(CalibrationError, match=f"{word} --exposure"):
            calibrate_linearity(rig.rig, tmp_path / "l.json", Taking(exposure_s))
    with pytest.raises(UsageError, match="steps"):
        calibrate_linearity(rig.rig, tmp_path / "l.json", Taking(0.002), steps=3)


@pytest.mark.parametrize(
    ("axis_px", "filters"),
    [pytest.param((3.4, -2.2), "mono", marks=pytest.mark.soak), ((-11.3, 7.9), "rggb")],
)
def test_rotation_centre_and_pixel_size_of_the_bench_come_back(small, tmp_path, axis_px, filters):
    rig = small(optics={"axis_px": list(axis_px)}, sensor={"filters": filters})
    record = calibrate_rotation(rig.rig, tmp_path / "rotation.json", Taking(0.006, frames=2), angles=8)
    centre = (COLS - 1) / 2 + axis_px[0], (ROWS - 1) / 2 + axis_px[1]
    found = record.number("centre_column"), record.number("centre_row")
    assert found == pytest.approx(centre, abs=0.05)
    assert record.uncertainty("centre_column") < 0.05
    assert record.number("pixel") == pytest.approx(PIXEL_UM, rel=1e-3)
    assert abs(record.number("fixture_angle")) < 0.02
    assert record.number("runout") < 0.1
    assert record.in_limits
    assert record.stage


def test_a_wrong_pixel_size_is_told_and_missing_markers_end_it(small, tmp_path):
    rig = small(rig={"camera": {"pixel_um": 15.0}})
    record = calibrate_rotation(rig.rig, tmp_path / "rotation.json", Taking(0.006, frames=2), angles=6)
    assert not record.in_limits
    assert "correct camera.pixel_um" in record.remarks[0]
    dark = small("dark", optics={"lens_cap": True})
    with pytest.raises(RegistrationError, match="markers"):
        calibrate_rotation(dark.rig, tmp_path / "other.json", Taking(0.006, frames=2), angles=6)
    with pytest.raises(RigFileError, match=r"no \[fixture\]"):
        calibrate_rotation(small("bare", rig={"fixture": None}).rig, tmp_path / "x.json", Taking(0.006))
    assert not dark.bench.light_on


def test_senseless_settings_are_refused_before_the_rig_is_opened(tmp_path):
    for settings, message in (
        ({"frames": 1}, "2 frames"),
        ({"gain": 0.0}, "gain"),
        ({"exposure_s": -1.0}, "exposure"),
    ):
        with pytest.raises(UsageError, match=message):
            Taking(**({"exposure_s": 0.1} | settings))
    with pytest.raises(UsageError, match="--valid-days"):
        calibrate_dark(tmp_path / "none.toml", tmp_path / "dark", Taking(0.1, valid_days=-2.0))


def test_a_flat_of_an_earlier_version_stays_readable(small_flat):
    small_flat.with_suffix(".json").unlink()
    assert read_reference(small_flat).signal.shape == (ROWS, COLS)


def test_pictures_of_calibrations_are_plain_tiff(small, tmp_path):
    calibrate_dark(small().rig, tmp_path / "dark.tif", Taking(0.001, frames=2))
    assert tifffile.imread(tmp_path / "dark.tif").dtype == np.float32
    assert read_rig(small("again").rig).calibration is not None
    (tmp_path / "dark.tif").write_bytes(b"II*\0")
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_picture(tmp_path / "dark.tif", "dark")
