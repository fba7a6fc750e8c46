import importlib.util
import itertools
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridges import measure_ridges

SPEC = importlib.util.spec_from_file_location("ridgesurfaces", Path(__file__).with_name("ridgesurfaces.py"))
surfaces = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(surfaces)
Truth = surfaces.Truth

DEFAULT = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "heightmaps"
DATA = Path(os.environ.get("ANISOSCOPE_TEST_DATA", DEFAULT))
CLEAN = {"noise": 0.0, "missing": 0.0, "burrs": 0, "spikes": 0, "slope_across": 1e-4, "slope_along": 1e-4}


def real(name):
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not in ANISOSCOPE_TEST_DATA")
    return read_height_map(DATA / name)


@pytest.mark.parametrize(
    ("pitch", "angle", "direction", "missing"),
    [
        (50.0, 5.0, 30.0, 0.02),
        pytest.param(100.0, 10.0, 0.0, 0.15, marks=pytest.mark.soak),
        pytest.param(150.0, 20.0, -70.0, 0.05, marks=pytest.mark.soak),
        pytest.param(100.3, 5.0, 3.0, 0.02, marks=pytest.mark.soak),
    ],
)
def test_goals_on_spoiled_surfaces(pitch, angle, direction, missing):
    truth = Truth(pitch=pitch, angle=angle, direction=direction, missing=missing)
    found = measure_ridges(truth.surface(2))
    assert found.pitch_um.value == pytest.approx(pitch, abs=0.05)
    assert found.direction_deg.value == pytest.approx(direction, abs=0.01)
    assert found.ridge_angle_deg.value == pytest.approx(truth.ridge_angle(), abs=0.05)
    assert found.alpha_across.value == pytest.approx(truth.alpha_across, rel=0.02)
    assert found.alpha_along.value == pytest.approx(truth.alpha_along, rel=0.02)
    assert found.noise_um.value == pytest.approx(0.05, rel=0.01)
    assert found.height_um.value == pytest.approx(truth.full_height, abs=2 * found.height_um.u)
    assert found.lean_deg == pytest.approx(direction, abs=0.02)
    assert found.missing_share == pytest.approx(missing, abs=0.01)


@pytest.mark.soak
def test_noise_above_the_slopes_is_taken_off():
    truth = Truth(slope_across=0.03, slope_along=0.03, direction=30.0)
    found = measure_ridges(truth.surface(3))
    # 50 nm over 1 µm make slopes of 0.07: left in, α would be 2.6 times too large
    assert found.alpha_across.value == pytest.approx(truth.alpha_across, rel=0.05)
    assert found.alpha_along.value == pytest.approx(truth.alpha_along, rel=0.05)
    smooth = measure_ridges(replace(truth, slope_across=1e-4, slope_along=1e-4).surface(3))
    assert smooth.alpha_across.value is None
    assert 0.0 < smooth.alpha_across.at_most < 0.02


EACH_RUN = {(0.0, 1), (3.0, -1), (45.0, 1), (90.0, -1), (-70.0, 1)}


@pytest.mark.parametrize(
    ("direction", "lean"),
    [
        pytest.param(*pair, marks=() if pair in EACH_RUN else pytest.mark.soak)
        for pair in itertools.product([0.0, 3.0, 45.0, 90.0, -70.0], [-1, 1])
    ],
)
def test_direction_and_lean_of_clean_ridges(direction, lean):
    truth = Truth(direction=direction, lean=lean, shape=(500, 600), pixel=(1.3, 1.0), pitch=61.7, **CLEAN)
    found = measure_ridges(truth.surface(1))
    away = (found.direction_deg.value - direction + 90.0) % 180.0 - 90.0
    assert abs(away) < 0.02
    toward = direction + (0.0 if lean == 1 else 180.0)
    assert abs((found.lean_deg - toward + 180.0) % 360.0 - 180.0) < 0.02
    assert found.pitch_um.value == pytest.approx(61.7, abs=0.02)
    assert found.ridge_angle_deg.value == pytest.approx(truth.ridge_angle(), abs=0.005)


@pytest.mark.parametrize(
    ("angle", "wall"),
    [
        pytest.param(10.0, None, marks=pytest.mark.soak),
        pytest.param(20.0, None, marks=pytest.mark.soak),
        (20.0, 55.0),
        pytest.param(15.0, 80.0, marks=pytest.mark.soak),
    ],
)
def test_wall_angle_where_the_wall_is_resolved(angle, wall):
    truth = Truth(angle=angle, wall=wall, direction=3.0, shape=(500, 1000))
    found = measure_ridges(truth.surface(4))
    assert found.wall_angle_deg.value == pytest.approx(truth.wall_angle(), abs=2.5 * found.wall_angle_deg.u)
    assert found.wall_angle_deg.u < 0.3
    assert found.height_um.value == pytest.approx(truth.full_height, rel=0.01)


def test_wall_narrower_than_two_pixels_is_a_bound():
    truth = Truth(angle=5.0, direction=3.0)  # wall 0.76 µm wide, at 85°
    found = measure_ridges(truth.surface(4))
    assert found.wall_angle_deg.value is None
    assert 70.0 < found.wall_angle_deg.at_least < 85.0
    assert found.height_um.value == pytest.approx(truth.full_height, abs=2 * found.height_um.u)


@pytest.mark.parametrize("loss", [0.05, pytest.param(0.2, marks=pytest.mark.soak)])
def test_height_loss_is_the_plateau(loss):
    truth = Truth(loss=loss, direction=-70.0, shape=(1000, 600))
    found = measure_ridges(truth.surface(5))
    assert found.plateau
    assert found.height_loss.value == pytest.approx(loss, abs=max(0.003, 2 * found.height_loss.u))
    assert found.height_um.value == pytest.approx((1 - loss) * truth.full_height, abs=2 * found.height_um.u)
    assert found.edge_radius_um.value is None


def test_edge_radius_of_a_round_crest_and_bound_of_a_sharp_one():
    worn = measure_ridges(Truth(radius=9.0, angle=20.0, direction=30.0, shape=(600, 800)).surface(6))
    assert not worn.plateau
    assert worn.edge_radius_um.value == pytest.approx(9.0, abs=2 * worn.edge_radius_um.u)
    sharp = measure_ridges(Truth(angle=20.0, direction=30.0, shape=(600, 800)).surface(6))
    assert sharp.edge_radius_um.value is None
    assert sharp.edge_radius_um.at_most < 4.0


def test_burrs_and_spikes_are_listed_where_they_are():
    truth = Truth(burrs=12, spikes=25, direction=30.0, missing=0.02)
    surface = truth.surface(7)
    found = measure_ridges(surface)
    high = [
        one for one in truth.made if one[2] > 4 and one[4] > 3 and min(one[:2]) > 60 and max(one[:2]) < 940
    ]
    burrs = [one for one in found.burrs if one.kind == "burr"]
    for x, y, height, half, width in high:
        j, i = round(x), round(y)
        if not np.isfinite(surface.height_um[i - 3 : i + 4, j - 3 : j + 4]).mean() > 0.9:
            continue
        near = [one for one in burrs if np.hypot(one.x_um - x, one.y_um - y) < half]
        assert near, (x, y, height)
        assert max(one.height_um for one in near) > 0.6 * height
        assert sum(one.area_um2 for one in near) < 1.6 * np.pi * half * width
    assert len(burrs) <= len(truth.made) + 5
    spikes = sum(one.kind == "spike" for one in found.burrs)
    assert 17 <= spikes <= 28  # some fall on missing points, on walls or on burrs


def test_a_clean_surface_has_no_burrs():
    assert measure_ridges(Truth(burrs=0, spikes=0).surface(8)).burrs == ()


def test_variation_between_ridges():
    even, uneven = (
        measure_ridges(Truth(jitter_deg=j, direction=3.0, shape=(500, 1000)).surface(9)) for j in (0.0, 0.3)
    )
    assert even.angle_variation_deg.value < 0.02
    assert uneven.angle_variation_deg.value == pytest.approx(0.3, abs=2.5 * uneven.angle_variation_deg.u)
    assert uneven.ridge_angle_deg.u > 5 * even.ridge_angle_deg.u
    assert len(uneven.ridges) >= 8
    steps = np.diff([ridge.position_um for ridge in uneven.ridges])
    np.testing.assert_allclose(steps, 100.0, atol=0.3)


def test_measuring_does_not_depend_on_tilt_offset_and_half_turn():
    surface = Truth(tilt=(0.0, 0.0), direction=30.0, shape=(500, 600)).surface(10)
    first = measure_ridges(surface)
    rows, cols = surface.shape
    y, x = np.arange(rows)[:, None], np.arange(cols)[None, :]
    tilted = measure_ridges(surface.with_height(surface.height_um + 0.01 * x - 0.02 * y + 77.0))
    turned = measure_ridges(surface.with_height(surface.height_um[::-1, ::-1]))
    for other, pitch in ((tilted, 2e-3), (turned, 2e-3)):
        assert other.pitch_um.value == pytest.approx(first.pitch_um.value, abs=pitch)
        assert other.direction_deg.value == pytest.approx(first.direction_deg.value, abs=1e-3)
        assert other.alpha_across.value == pytest.approx(first.alpha_across.value, rel=2e-3)
    assert turned.ridge_angle_deg.value == pytest.approx(first.ridge_angle_deg.value, abs=2e-3)
    assert abs((turned.lean_deg - first.lean_deg) % 360.0 - 180.0) < 1e-2


def test_heights_and_lengths_scale():
    surface = Truth(direction=30.0, shape=(600, 600)).surface(11)
    first = measure_ridges(surface)
    larger = measure_ridges(HeightMap(2.5 * surface.height_um, 2.5, 2.5))
    assert larger.pitch_um.value == pytest.approx(2.5 * first.pitch_um.value, rel=1e-6)
    assert larger.height_um.value == pytest.approx(2.5 * first.height_um.value, rel=1e-6)
    assert larger.ridge_angle_deg.value == pytest.approx(first.ridge_angle_deg.value, abs=1e-4)
    assert larger.alpha_along.value == pytest.approx(first.alpha_along.value, rel=1e-6)
    assert larger.height_um.u == pytest.approx(2.5 * first.height_um.u, rel=1e-3)


NAMES = (
    "pitch",
    "direction",
    "ridge angle",
    "wall angle",
    "height",
    "height loss",
    "alpha along",
    "alpha across",
    "noise",
)


def errors(truth, found):
    """(9, 3) error, standard uncertainty and truth of every quantity with a value, else NaN."""
    pairs = [
        (found.pitch_um, truth.pitch),
        (found.direction_deg, truth.direction),
        (found.ridge_angle_deg, truth.ridge_angle()),
        (found.wall_angle_deg, truth.wall_angle()),
        (found.height_um, truth.full_height * (1 - truth.loss)),
        (found.height_loss, truth.loss),
        (found.alpha_along, truth.alpha_along),
        (found.alpha_across, truth.alpha_across),
        (found.noise_um, truth.noise),
    ]
    return [(np.nan,) * 3 if q.value is None else (q.value - true, q.u, true) for q, true in pairs]


def drawn(seed):
    """One of the surfaces of the goals; roughness of one correlation length of at least four pixels."""
    rng = np.random.default_rng(10_000 + seed)
    across, along = np.exp(rng.uniform(np.log(0.03), np.log(0.2), 2))
    along = float(np.clip(along, across / 3, across * 3))
    return Truth(
        pitch=float(rng.choice([50, 100, 150]) + rng.uniform(-0.5, 0.5)),
        angle=float(rng.choice([5, 10, 20])),
        direction=float(rng.choice([0, 3, 30, -70]) + rng.uniform(-0.5, 0.5) * (rng.random() < 0.7)),
        slope_across=float(across),
        slope_along=along,
        length=float(rng.uniform(7, 9)),
        missing=float(rng.uniform(0.02, 0.15)),
        burrs=int(rng.integers(10, 80)),
        spikes=int(rng.integers(0, 100)),
        lean=int(rng.choice([-1, 1])),
        tilt=tuple(rng.uniform(-0.5, 0.5, 2)),
        loss=float(rng.choice([0, 0, 0.08])),
    )


@pytest.mark.soak
def test_eight_surfaces_lie_within_their_uncertainties():
    all_errors = np.array([errors(truth := drawn(n), measure_ridges(truth.surface(n))) for n in range(8)])
    z = all_errors[..., 0] / all_errors[..., 1]
    known = z[np.isfinite(z)]
    assert known.size > 60
    assert np.mean(np.abs(known) <= 2) > 0.88
    assert 0.6 < np.sqrt(np.mean(known**2)) < 1.3


@pytest.mark.soak
def test_two_hundred_surfaces_lie_within_their_uncertainties():
    all_errors = np.array([errors(truth := drawn(n), measure_ridges(truth.surface(n))) for n in range(200)])
    lines, shares = [], []
    for n, name in enumerate(NAMES):
        error, u, true = all_errors[np.isfinite(all_errors[:, n, 0]), n].T
        shares.append(float(np.mean(np.abs(error) <= 2 * u)))
        spread = f"rms {np.sqrt(np.mean(error**2)):.2g}, largest {np.abs(error).max():.2g}"
        relative = np.sqrt(np.mean((error[true != 0] / true[true != 0]) ** 2))
        lines.append(
            f"{name}: {error.size} values, {shares[-1]:.1%} within 2u, {spread}, relative rms {relative:.2%}"
        )
    sys.stdout.write("\n" + "\n".join(lines) + "\n")
    assert min(shares) >= 0.90, lines


def test_random_surfaces_are_refused():
    fy, fx = np.fft.fftfreq(400)[:, None], np.fft.fftfreq(400)[None, :]
    noise = np.fft.fft2(np.random.default_rng(1).standard_normal((400, 400)))
    z = np.fft.ifft2(noise * np.exp(-0.5 * np.pi**2 * ((15 * fx) ** 2 + (60 * fy) ** 2))).real
    with pytest.raises(HeightMapError, match=r"no ridges found.*0\.5.*score is 0\.\d\d"):
        measure_ridges(HeightMap(z, 1.0, 1.0))


def test_fewer_than_four_ridges_and_fewer_than_eight_pixels_are_refused():
    with pytest.raises(HeightMapError, match="at least four ridges"):
        measure_ridges(Truth(pitch=150.0, shape=(400, 400)).surface(1))
    z = np.tile(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0]), (200, 40))
    with pytest.raises(HeightMapError, match="pixels a pitch"):
        measure_ridges(HeightMap(z, 1.0, 1.0))


@pytest.mark.realdata
def test_ski_base_agrees_with_the_distance_of_its_valleys():
    surface = real("opengps_ski.x3p")
    found = measure_ridges(surface)
    # valleys by hand: heights averaged along the grooves, minima refined by parabolas through 150 µm about them
    angle = np.radians(found.direction_deg.value)
    i, j = np.nonzero(np.isfinite(surface.height_um))
    across = j * surface.pixel_x_um * np.cos(angle) + i * surface.pixel_y_um * np.sin(angle)
    z = surface.height_um[i, j]
    z = z - np.polyval(np.polyfit(across, z, 2), across)
    bins = ((across - across.min()) / 5.0).astype(int)
    count = np.bincount(bins)
    mean = np.where(count > 500, np.bincount(bins, z) / np.maximum(count, 1), np.nan)
    at = across.min() + 5.0 * (np.arange(mean.size) + 0.5)
    smooth = np.convolve(mean, np.ones(21) / 21, mode="same")
    smooth = np.where(np.isfinite(smooth), smooth, np.inf)
    low = [
        k for k in range(60, mean.size - 60) if smooth[k] == smooth[k - 60 : k + 61].min() and smooth[k] < -15
    ]
    valleys = []
    for k in low:
        near = slice(k - 15, k + 16)
        a, b, _ = np.polyfit(at[near] - at[k], mean[near], 2)
        valleys.append(at[k] - b / (2 * a))
    spacing = np.diff(valleys)
    assert len(valleys) >= 4
    assert 680 < spacing.mean() < 700
    spread = spacing.std(ddof=1) / np.sqrt(spacing.size)
    assert abs(found.pitch_um.value - spacing.mean()) < 2 * np.hypot(found.pitch_um.u, spread)
    assert 686 < found.pitch_um.value < 694
    assert found.pitch_um.u < 5


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["opengps_rubber.x3p", "sensofar_ground.plu"])
def test_surfaces_without_ridges_are_refused(name):
    surface = real(name)
    with pytest.raises(HeightMapError, match="no ridges found"):
        measure_ridges(surface)


@pytest.mark.parametrize("tilt_deg", [-2.0, -1.0, 1.0, 2.0])
def test_a_rigid_tilt_leaves_the_wall_angle(tilt_deg):
    pitch, facet, wall, ridges = 100.0, np.radians(10.0), np.radians(65.0), 12
    height = pitch / (1.0 / np.tan(facet) + 1.0 / np.tan(wall))
    valley = np.arange(ridges + 1) * pitch
    crest = valley + height / np.tan(wall)
    x = np.column_stack([valley, crest]).ravel()
    z = np.column_stack([np.zeros_like(valley), np.full_like(valley, height)]).ravel()
    turn = np.radians(tilt_deg)
    turned_x, turned_z = x * np.cos(turn) - z * np.sin(turn), x * np.sin(turn) + z * np.cos(turn)
    at = np.arange(1.0, ridges * pitch - 40.0, 0.5)
    noise = 0.02 * np.random.default_rng(2).standard_normal((40, at.size))
    found = measure_ridges(HeightMap(np.interp(at, turned_x, turned_z) + noise, 0.5, 0.5))
    assert found.wall_angle_deg.value == pytest.approx(65.0, abs=2.0 * found.wall_angle_deg.u)
    assert found.wall_angle_deg.u < 0.5
    assert found.ridge_angle_deg.value == pytest.approx(10.0, abs=2.0 * found.ridge_angle_deg.u + 0.002)
