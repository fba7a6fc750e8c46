"""Stage, light, sample and camera see each other."""

import numpy as np
import pytest

from anisoscope.base.errors import NotConnected, RigFileError, Stalled
from anisoscope.imaging.registration.placement import angle_between, locate
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.rig.lights.serial import SerialLight
from anisoscope.rig.stages.elliptec import Elliptec
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.benchfile import read_bench
from anisoscope.sim.bench.camera import open_camera, open_light

EXPOSURE_S = 0.008
IDEAL_SENSOR = {"prnu": 0.0, "dsnu_e": 0.0, "read_noise_e": 0.0, "dark_current_e_s": 0.0}


def photograph(bench, count=1, exposure_s=EXPOSURE_S):
    return np.mean([bench.photograph(exposure_s, 1.0) for _ in range(count)], axis=0)


def seen_angle(bench):
    """Angle of the sample as the picture shows it, −180 to 180."""
    bench.light_on = True
    picture = (photograph(bench, 2) - 64.0).astype(np.float32)
    return angle_between(0.0, locate(picture, bench.file.fixture).angle_deg)


@pytest.fixture
def open_stage(bench_path):
    """``open_stage(stage={...})`` gives the bench of a file and its stage, driven through ``sim://``."""
    opened = []

    def open_(**changes):
        path = bench_path(**changes)
        stage = Elliptec.open(f"sim://elliptec?bench={path}", move_gap_s=0.0)
        opened.append(stage)
        return shared_bench(path), stage

    yield open_
    for stage in opened:
        stage.close()


@pytest.fixture
def scenes(monkeypatch, tmp_path):
    """``scenes()`` counts the scenes in a cache of the test's own."""
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    return lambda: len(list((tmp_path / "cache" / "scenes").glob("*.entry")))


def test_a_scene_is_rendered_once_for_all_benches_of_one_file(bench_path, scenes):
    """The second bench takes it from the cache; it has no renderer that it could call."""
    first, again = (Bench(read_bench(bench_path())) for _ in range(2))
    for bench in (first, again):
        bench.light_on = True
    again._image_of_samples = None  # it must not be called
    assert np.array_equal(photograph(first), photograph(again))
    assert scenes() == 1


def test_a_scene_is_that_of_the_content_of_the_height_map(bench_path, scenes, tmp_path):
    surface = tmp_path / "map.npz"
    for angle in (10.0, 12.0):
        write_height_map(ridges(RidgeDesign(100.0, angle), (101, 401), (2.0, 1.0)), surface)
        bench = Bench(read_bench(bench_path(sample={"kind": "height-map", "file": str(surface)})))
        bench.light_on = True
        photograph(bench)
    assert scenes() == 2


def test_what_is_seen_while_the_stage_turns_is_not_cached(bench_path, scenes):
    bench = Bench(read_bench(bench_path(stage={"time_scale": 1e6})))
    bench.light_on = True
    bench.axis.start_move(90.0)
    photograph(bench)
    assert scenes() == 0


@pytest.mark.parametrize("turns", ["ccw", "cw"])
def test_the_picture_turns_with_the_stage_in_the_sense_of_the_bench(open_stage, turns):
    bench, stage = open_stage(stage={"turns": turns, "zero_deg": 25.0})
    stage.home()
    sign = 1.0 if turns == "ccw" else -1.0
    for reading in (25.0, 62.0, 115.0):
        stage.move_to(reading)
        assert seen_angle(bench) == pytest.approx(sign * (reading - 25.0), abs=0.05)


def test_the_camera_sees_the_sample_and_not_the_encoder(open_stage):
    bench, stage = open_stage(stage={"backlash_deg": 1.5})
    stage.home()
    stage.move_to(80.0)
    assert seen_angle(bench) == pytest.approx(70.0, abs=0.05)
    assert stage.move_to(40.0) == pytest.approx(40.0, abs=0.01)
    assert seen_angle(bench) == pytest.approx(31.5, abs=0.05)


def test_a_stalled_stage_shows_the_sample_at_the_obstacle(open_stage):
    bench, stage = open_stage(stage={"faults": ["stall:60"]})
    stage.home()
    with pytest.raises(Stalled):
        stage.move_to(100.0)
    assert seen_angle(bench) == pytest.approx(50.0, abs=0.05)


def test_without_light_or_with_the_cap_on_the_picture_is_dark(make_bench):
    dark, capped = make_bench(), make_bench(optics={"lens_cap": True})
    capped.light_on = True
    for bench in (dark, capped):
        picture = photograph(bench)
        assert picture.mean() == pytest.approx(64.0, abs=0.1)
        assert picture.std() < 1.5


@pytest.mark.parametrize("light_angle", [0.0, 10.0, 25.0])
def test_a_white_tile_has_the_radiance_of_a_white_tile(make_bench, light_angle):
    bench = make_bench(
        sample={"kind": "white-tile", "reflectance": 0.8},
        sensor=IDEAL_SENSOR,
        optics={"vignetting": 0.0, "stray_radiance": 0.0, "electrons": 5.0e6},
        geometry={"light_angle_deg": light_angle},
    )
    bench.light_on = True
    radiance = (photograph(bench) - 64.0) * 7.5 / (5.0e6 * EXPOSURE_S)
    assert radiance.mean() == pytest.approx(0.8 * np.cos(np.radians(light_angle)) / np.pi, rel=1e-3)


def test_stray_light_is_added_everywhere(make_bench):
    with_stray, without = (
        make_bench(sensor=IDEAL_SENSOR, optics={"stray_radiance": s, "vignetting": 0.0}) for s in (0.01, 0.0)
    )
    for bench in (with_stray, without):
        bench.light_on = True
    more = photograph(with_stray, 4) - photograph(without, 4)
    assert more.mean() * 7.5 / (6.0e6 * EXPOSURE_S) == pytest.approx(0.01, rel=0.01)


def test_lamp_drift_grows_from_lit_frame_to_lit_frame(make_bench):
    bench = make_bench(
        sample={"kind": "white-tile"}, sensor=IDEAL_SENSOR, optics={"lamp_drift_per_frame": 0.01}
    )
    bench.photograph(EXPOSURE_S, 1.0)  # in the dark: the lamp does not age
    bench.light_on = True
    levels = np.array([photograph(bench).mean() for _ in range(4)]) - 64.0
    np.testing.assert_allclose(levels / levels[0], 1.0 + 0.01 * np.arange(4), rtol=5e-4)


@pytest.mark.parametrize("angle", [0.0, 90.0, 215.0])
def test_a_burr_in_the_height_map_is_a_burr_in_the_picture(make_bench, tmp_path, angle):
    surface = ridges(RidgeDesign(100.0, 10.0), (251, 501), (2.0, 1.0))
    x_um, y_um = 110.0, -60.0  # from the middle of the map
    row, col = np.indices(surface.shape)
    away = np.hypot(col - 250 - x_um, (row - 125) * 2.0 - y_um)
    burr = surface.height_um + 12.0 * np.clip(1 - (away / 30.0) ** 2, 0.0, None)
    pictures = []
    for name, height in (("bare", surface.height_um), ("burr", burr)):
        write_height_map(HeightMap(height, 1.0, 2.0), tmp_path / f"{name}.x3p")
        bench = make_bench(
            sample={"kind": "height-map", "file": str(tmp_path / f"{name}.x3p"), "size_mm": 0.5},
            sensor=IDEAL_SENSOR,
            optics={"pixel_um": 5.0, "blur_um": 5.0, "axis_px": [0.0, 0.0]},
        )
        bench.axis.start_move(bench.file.stage.zero_deg + angle)
        bench.light_on = True
        pictures.append(photograph(bench, 6))
    shot = np.sqrt((pictures[0] - 64.0) / 7.5 / 6 * 2) + 0.3
    changed = np.argwhere(np.abs(pictures[1] - pictures[0]) > 6.0 * shot)
    turned = (x_um + 1j * y_um) * np.exp(1j * np.radians(angle)) / 5.0
    rows, cols = bench.file.sensor.rows, bench.file.sensor.cols
    expected = np.array([(rows - 1) / 2 - turned.imag, (cols - 1) / 2 + turned.real])
    assert len(changed) > 30
    # the burr itself, its blur, and the short shadow that it casts under light at 10°
    assert np.linalg.norm(changed - expected, axis=1).max() < (30.0 + 12.0) / 5.0 + 2.0
    np.testing.assert_allclose(changed.mean(axis=0), expected, atol=2.0)


def test_the_seed_makes_the_frames(make_bench):
    def take(bench):
        bench.light_on = True
        bench.axis.start_move(47.0)
        return np.stack([bench.photograph(EXPOSURE_S, 1.0) for _ in range(2)])

    changes = {"optics": {"lamp_noise": 0.001}}
    first, same, other = (take(make_bench(seed=seed, **changes)) for seed in (5, 5, 6))
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first[0], first[1])


def test_all_devices_of_a_file_share_one_bench(bench_path):
    path = bench_path(sample={"kind": "white-tile"})
    light, camera = open_light(bench=path), open_camera(bench=str(path.parent / "." / path.name))
    camera.configure(EXPOSURE_S, 1.0)
    dark = camera.grab().mean()
    light.on()
    assert camera.grab().mean() > 2 * dark
    assert shared_bench(path) is shared_bench(str(path))
    with Elliptec.open(f"sim://elliptec?bench={path}") as stage:
        stage.home()
        stage.move_to(33.0)
    assert shared_bench(path).sample_angle_deg == pytest.approx(23.0, abs=0.01)


@pytest.mark.parametrize("level", [30, 100])
def test_the_light_controller_dims_the_lamp_that_the_camera_sees(bench_path, level):
    path = bench_path(sample={"kind": "white-tile"}, sensor=IDEAL_SENSOR)
    bench = shared_bench(path)
    bench.light_on = True
    full = photograph(bench, 2).mean() - 64.0
    light = SerialLight(f"sim://light?bench={path}", level_percent=level, timeout_s=0.5, boot_s=0.0)
    assert not bench.light_on
    light.on()
    assert bench.light_on
    assert (photograph(bench, 2).mean() - 64.0) / full == pytest.approx(level / 100, abs=2e-3)
    light.close()
    assert not bench.light_on


def test_a_lamp_nobody_talks_to_goes_dark_in_the_picture(make_bench):
    bench = make_bench(sample={"kind": "white-tile"})
    now = [0.0]
    bench.light_firmware._clock = lambda: now[0]
    bench.device("light").write(b"ON\n")
    assert photograph(bench).mean() > 200.0
    now[0] += 11.0
    assert photograph(bench).mean() == pytest.approx(64.0, abs=0.2)


@pytest.mark.parametrize("share", [0.1, -0.1])
def test_a_cold_lamp_warms_up_from_lit_frame_to_lit_frame(make_bench, share):
    changes = {"lamp_warmup_share": share, "lamp_warmup_frames": 3.0}
    bench = make_bench(sample={"kind": "white-tile"}, sensor=IDEAL_SENSOR, optics=changes)
    bench.light_on = True
    levels = np.array([photograph(bench).mean() for _ in range(40)]) - 64.0
    expected = 1.0 + share * np.exp(-np.arange(40) / 3.0)
    np.testing.assert_allclose(levels / levels[-1], expected, rtol=1e-3)


def test_a_changed_file_makes_a_new_bench(bench_path):
    before = shared_bench(bench_path())
    after = shared_bench(bench_path(seed=99))
    assert after is not before
    assert after.file.seed == 99


def test_a_missing_or_wrong_bench_file_is_named(tmp_path, bench_path):
    with pytest.raises(RigFileError, match=r"none\.toml: there is no such file"):
        shared_bench(tmp_path / "none.toml")
    wrong = bench_path(stage={"faults": ["no-such-fault"]})
    with pytest.raises(NotConnected, match=r"stage: there is no fault"):
        Elliptec.open(f"sim://elliptec?bench={wrong}")
