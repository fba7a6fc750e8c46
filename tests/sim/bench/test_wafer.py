"""A wafer on the bench: its picture against the power spectrum, its errors, its files, and what is refused."""

import numpy as np
import pytest
import tomli_w

from anisoscope.base.errors import RigFileError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.light import LightSpectrum
from anisoscope.profiles.files.load import write_height_map
from anisoscope.sim.bench.bench import Bench
from anisoscope.sim.bench.benchfile import read_bench
from anisoscope.sim.bench.wafer import build_wafer, etched_tile
from anisoscope.sim.bench.waferpart import WaferPart
from anisoscope.sim.design.designfile import DesignFile, write_design, write_layout
from anisoscope.sim.design.mask import write_gds
from anisoscope.sim.design.models import LobeModel
from anisoscope.sim.design.pattern import PatternOptions, make_layout
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.wave import fused
from anisoscope.sim.light.wave.halfvectors import across_beam, half_vector
from anisoscope.sim.light.wave.reflectance import radiance_scale
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

TILE_UM = 64.0
POSES = pose_grid((0.0, 90.0), (0.0, 3.0))
LIGHT = {
    "wavelength_nm": 520.0,
    "bandwidth_nm": 10.0,
    "lamp_half_angle_deg": 0.6,
    "aperture_half_angle_deg": 1.5,
}
CLEAN = {"scatter": 0.0, "reflectance": 1.0, **LIGHT}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """One tile of 64 µm as a layout, a mask, a height map, and its design."""
    folder = tmp_path_factory.mktemp("wafer")
    model = LobeModel(widths_x_um=(2.0,), p_a_x=(1.0,), widths_y_um=(4.0, 5.0), p_a_y=(0.5, 0.5))
    design = DesignFile(
        name="wide x", model=model, passes_nm=(130.0,), wavelength_nm=520.0, band_nm=(520.0, 520.0)
    )
    classes = np.zeros((2, 2), dtype=np.int64)
    layout = make_layout(classes, (design,), np.random.default_rng(3), PatternOptions(0.5 * TILE_UM, 4))
    write_design(design, folder / "design.toml")
    write_layout(layout, folder / "layout.npz", (design,))
    write_gds(layout, folder / "mask.gds")
    write_height_map(layout.window(), folder / "map.npz")
    return folder


def seen_by(sample):
    """(P,) mean radiance of one tile in every pose, and the pictures of one tile."""
    rows, cols = (round(TILE_UM / pixel) for pixel in sample.pixel_um)
    pictures = [
        sample.radiance(to_light, to_camera)[0, :rows, :cols]
        for to_light, to_camera in zip(*directions(POSES, Convention(0.0)), strict=True)
    ]
    return np.array([picture.mean(dtype=float) for picture in pictures]), pictures


def test_the_mean_of_the_picture_is_the_blurred_power_spectrum_of_many_tiles(files):
    """Abbe's sum over lamp points against the quadratic form over a patch of tiles, whose edge falls off as 1/n."""
    tile = etched_tile(WaferPart(file=files / "layout.npz", **CLEAN), np.random.default_rng(0))
    heights = np.array(tile.levels_um)[tile.labels]
    found, _ = seen_by(
        build_wafer(WaferPart(file=files / "layout.npz", **CLEAN), 0.2, np.random.default_rng(0))
    )
    lines = LightSpectrum.led(520.0, 10.0, 3)
    by_tiles = np.zeros((2, len(POSES)))
    for row, n in enumerate((2, 4)):
        surface = WaveSurface.of(np.tile(heights, (n, n)), tile.pixel_um, cells=True)
        for k, (light, camera) in enumerate(zip(*directions(POSES, Convention(0.0)), strict=True)):
            half = half_vector(light, camera)
            window = Window(
                *(
                    Extent(
                        "disc", 2.0 * np.sin(np.radians(LIGHT[f"{name}_half_angle_deg"])), across_beam(axis)
                    )
                    for name, axis in (("lamp", light), ("aperture", camera))
                )
            )
            by_tiles[row, k] = sum(
                share * radiance_scale(half, wave) * fused.density(surface, half, wave, window)
                for wave, share in zip(lines.wavelengths_um, lines.weights, strict=True)
            )
    assert found == pytest.approx(2.0 * by_tiles[1] - by_tiles[0], rel=0.03)


def test_the_files_of_one_tile_give_one_wafer(files):
    rng = np.random.default_rng(0)
    tiles = [etched_tile(WaferPart(file=files / name), rng) for name in ("layout.npz", "mask.gds", "map.npz")]
    for other in tiles[1:]:
        assert np.array_equal(other.labels, tiles[0].labels)
        assert other.passes_um == pytest.approx(tiles[0].passes_um, abs=1e-7)
    drawn = etched_tile(WaferPart(file=files / "design.toml", dot_um=16.0, dots=3), rng)
    assert drawn.labels.shape == (192, 192)
    assert drawn.passes_um == pytest.approx((0.13,))


def test_wrong_etching_raises_the_spike_and_wrong_widths_turn_the_contrast(files):
    """The spike is |τ|² of the pixels' areas; poses at tilt 0 show it, those at 3° the lobe."""
    found = {}
    for name, wrong in {
        "good": {},
        "deep": {"over_etch_nm": 20.0},
        "share": {"over_etch_share": 20.0 / 130.0},
        "wide": {"width_bias_nm": 300.0},
    }.items():
        part = WaferPart(file=files / "layout.npz", **CLEAN, **wrong)
        found[name], _ = seen_by(build_wafer(part, 0.2, np.random.default_rng(0)))
    assert found["deep"][0] > 1.3 * found["good"][0]
    assert found["deep"][2:] == pytest.approx(
        found["good"][2:] * 0.94, rel=0.02
    )  # 1 − τ², τ = sin(2π·20/520)
    assert found["share"] == pytest.approx(found["deep"], rel=1e-9)
    assert found["wide"][0] > 1.05 * found["good"][0]
    inversion = [np.log(found[name][2] / found[name][3]) for name in ("good", "wide")]
    assert abs(inversion[1] - inversion[0]) > 0.02


def test_the_grain_of_finite_windows_is_in_the_picture(files):
    """A narrower lens resolves less, shows coarser and stronger grain; without a lobe to interfere there is none."""
    grain = {}
    for lamp in (0.1, 1.5):
        part = WaferPart(file=files / "layout.npz", **{**CLEAN, "lamp_half_angle_deg": lamp})
        _, pictures = seen_by(build_wafer(part, 0.2, np.random.default_rng(0)))
        grain[lamp] = pictures[3].std() / pictures[3].mean()
    assert grain[0.1] > 0.5  # nearly coherent: speckle
    assert grain[1.5] < 0.8 * grain[0.1]  # a lamp as wide as the lens washes half of it out


def test_scatter_is_a_lambertian_share(files):
    part = WaferPart(file=files / "layout.npz", **LIGHT, scatter=1.0, reflectance=0.5)
    found, _ = seen_by(build_wafer(part, 0.2, np.random.default_rng(0)))
    cosines = directions(POSES, Convention(0.0))[0][:, 2]
    assert found == pytest.approx(0.5 / np.pi * cosines, rel=1e-6)


def table(**wafer):
    return {"schema": 1, "sample": {"kind": "wafer", "size_mm": 0.3, "wafer": wafer}}


def test_a_bench_photographs_a_wafer_that_its_file_describes(files, tmp_path):
    path = files / "bench.toml"
    optics = {
        "sensor": {"rows": 128, "cols": 128},
        "optics": {"electrons": 1e5},
        "geometry": {"light_angle_deg": 0.0},
    }
    path.write_text(tomli_w.dumps({**table(file="layout.npz", **LIGHT), **optics}))
    bench = Bench(read_bench(path))
    bench.light_on = True
    frame = bench.photograph(1e-3, 1.0).astype(float)
    assert frame.shape == (128, 128)
    assert frame[60:68, 60:68].mean() > 200.0  # a mirror in the mirror direction
    assert frame[:8, :8].mean() < 120.0  # beside the wafer there is nothing


@pytest.mark.parametrize(
    ("wafer", "match"),
    [
        (None, "needs a table"),
        ({"file": "nothing.npz"}, "no such file"),
        ({"file": "bench.toml"}, "sample.wafer.file"),
        ({"file": "layout.npz", "over_etch_nm": -200.0}, "do not etch"),
        ({"file": "layout.npz", "bandwidth_nm": 400.0}, "too wide for a lamp"),
    ],
)
def test_what_cannot_be_a_wafer_is_refused(files, wafer, match):
    path = files / "refused.toml"
    (files / "bench.toml").write_text("schema = 1\n")
    content = {"schema": 1, "sample": {"kind": "wafer"}} if wafer is None else table(**wafer)
    path.write_text(tomli_w.dumps(content))
    with pytest.raises(RigFileError, match=match):
        bench = Bench(read_bench(path))
        bench.light_on = True
        bench.photograph(1e-3, 1.0)
