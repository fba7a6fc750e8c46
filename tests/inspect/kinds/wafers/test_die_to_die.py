"""Marks on wafers by their repeated tiles alone; the wafers are pictures of the bench, the marks are drawn here."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.wafers.kind import LEAST_TILES, die_to_die, local_decision
from anisoscope.operations.demo import wafers as demo
from anisoscope.parameters.geometry import Convention
from anisoscope.record.verdict import Verdict
from anisoscope.sim.bench.wafer import build_wafer
from anisoscope.sim.bench.waferpart import WaferPart
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 3.0))
TILES, DIFFUSE = 3, 0.05
PICTURES, GRADIENT = 0.003, 0.02
CELLS = TILES * CELLS_PER_PITCH


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """``photographed(seed)``: (P, rows, cols) radiances of a good wafer of 3 × 3 tiles, and its generator."""
    folder, kept = tmp_path_factory.mktemp("dies"), {}
    demo.write_tile(folder, np.random.default_rng(3))

    def take(seed):
        rng = np.random.default_rng(seed)
        table = demo.sample("good", rng)
        made = build_wafer(
            WaferPart.model_validate({**table["wafer"], "file": folder / "wafer.npz"}), table["size_mm"], rng
        )
        seat = seating_rotation(*table["seating_tilt_deg"])
        rows, cols = (round(TILES * demo.TILE_UM / pixel) for pixel in made.pixel_um)
        return np.array(
            [
                made.radiance(to_light @ seat, to_camera @ seat)[0, :rows, :cols]
                for to_light, to_camera in zip(*directions(POSES, Convention(0.0)), strict=True)
            ]
        )

    return lambda seed: kept.setdefault(seed, take(seed))


def particle(size, share, rng):
    """A grain that covers a share of the area."""
    found, radius = np.zeros(size, np.float32), np.sqrt(share * size[0] * size[1] / np.pi)
    at = [float(rng.uniform(radius, side - radius)) for side in size[::-1]]
    cv2.circle(found, tuple(round(one) for one in at), round(radius), 1.0, -1)
    return found


def scratch(size, share, rng):
    """A line right across, of an area that is this share."""
    found, turn = np.zeros(size, np.float32), rng.uniform(0.0, np.pi)
    middle, half = np.array(size[::-1]) * rng.uniform(0.3, 0.7, 2), 0.4 * size[0]
    ends = [
        tuple(int(v) for v in middle + side * half * np.array([np.cos(turn), np.sin(turn)]))
        for side in (-1, 1)
    ]
    cv2.line(found, *ends, 1.0, max(1, round(share * size[0] * size[1] / (2.0 * half))))
    return found


def verdict(pictures, rng, mark=None, noise=PICTURES):
    """Of a wafer with lamp and flat uneven, noise of the pictures, and a mark that scatters what falls on it."""
    size = pictures.shape[1:]
    even = np.outer(*(1.0 + GRADIENT * rng.standard_normal() * np.linspace(-1.0, 1.0, side) for side in size))
    seen = pictures * even
    if mark is not None:
        seen = seen * (1.0 - mark) + mark * DIFFUSE / np.pi
    cells = np.array([cv2.resize(one, (CELLS, CELLS), interpolation=cv2.INTER_AREA) for one in seen])
    cells *= np.exp(noise * rng.standard_normal(cells.shape))
    grid = Grid((0.0, 0.0), demo.TILE_UM * TILES / 1000.0 / size[0], size, 0.0)
    measured = SimpleNamespace(
        cells=cells, cell_noise=np.full(len(cells), PICTURES), mirroring=None, grid=grid
    )
    return local_decision(measured, POSES, 0.005, 1.645)[0].verdict


def uneven(pictures, rng):
    """Some cells at the border are darker by 0.8 % in one pose, as where the picture of the fixture ends."""
    found, side = pictures.copy(), pictures.shape[1] // CELLS
    for _ in range(4):
        col, pose = rng.integers(CELLS), rng.integers(len(pictures))
        found[pose, :side, col * side : (col + 1) * side] *= 0.992
    return found


@pytest.mark.statistics
def test_particles_and_scratches_are_found_and_good_wafers_pass(photographed):
    """Ten wafers, each ten times with other pictures and marks; of the quiet ones a few cells are off by 0.8 %."""
    counts = {"good": [], "particle": [], "scratch": [], "quiet": []}
    for seed in range(10):
        pictures, rng = photographed(seed), np.random.default_rng([1, seed])
        size = pictures.shape[1:]
        for _ in range(10):
            counts["good"].append(verdict(pictures, rng))
            counts["particle"].append(verdict(pictures, rng, particle(size, 0.01, rng)))
            counts["scratch"].append(verdict(pictures, rng, scratch(size, 0.01, rng)))
            counts["quiet"].append(verdict(uneven(pictures, rng), rng, noise=0.001))
    print({name: {str(one): found.count(one) for one in set(found)} for name, found in counts.items()})  # noqa: T201
    for name in ("good", "quiet"):
        assert counts[name].count(Verdict.FAIL) == 0
        assert counts[name].count(Verdict.PASS) >= 98
    for name in ("particle", "scratch"):
        assert counts[name].count(Verdict.FAIL) >= 95


def test_the_place_of_a_mark_is_said_and_few_tiles_are_not_compared():
    """A grain of alike tiles is no deviation, though cells differ by half."""
    rng = np.random.default_rng(4)
    tile = np.exp(0.5 * rng.standard_normal((len(POSES), CELLS_PER_PITCH, CELLS_PER_PITCH)))
    cells = np.tile(tile, (1, TILES, TILES)) * np.exp(0.01 * rng.standard_normal((len(POSES), CELLS, CELLS)))
    grid = Grid((1.0, 2.0), 0.01, (120, 120), 0.0)
    measured = SimpleNamespace(cells=cells, cell_noise=np.full(len(cells), 0.01), mirroring=None, grid=grid)
    area, regions, _, _ = local_decision(measured, POSES, 0.005, 1.645)
    assert (area.verdict, area.cells, regions) == (Verdict.PASS, CELLS**2, ())
    cells[:, 2:4, 9] *= 0.8
    area, (region,), _, over = local_decision(measured, POSES, 0.005, 1.645)
    assert (area.verdict, over.sum()) == (Verdict.FAIL, 2)
    assert (region.x, region.y) == pytest.approx((1.35, 2.3))
    few = SimpleNamespace(cells=cells[:, :8, :8], grid=grid)
    assert LEAST_TILES > 4
    assert die_to_die(few, POSES) is None
