"""Sink marks and long marks on parts rendered by the path tracer, which shares nothing with the prediction."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError
from anisoscope.base.parallel import for_each
from anisoscope.imaging.angle_map import AngleMap
from anisoscope.imaging.deviation_map import cell_map, judge_area
from anisoscope.imaging.part_form import FormDeviation, form_deviation
from anisoscope.parameters.geometry import Pose
from anisoscope.record.verdict import Verdict
from detection_study.traced import UPRIGHT, Part, recipe_of

NINE = tuple(Pose(angle, tilt) for tilt in (0.0, -10.0, 10.0) for angle in (0.0, 90.0, 180.0))
PRODUCTS = (
    {"angle": 10.0, "pitch": 100.0, "alpha": 0.08, "lobe": "beckmann"},
    {"angle": 15.0, "pitch": 80.0, "alpha": 0.11, "lobe": "ggx"},
)
SIZE = (1400.0, 1200.0)
CRESTS_UM = (0.0, 2.0, 4.0, 8.0)
"""Radii of the crests of the parts; their recipes say sharp ones."""


def leaning(slope_deg, width=14, height=25):
    """A map whose cells lean as ``slope_deg`` of (x, y) in mm says, with scatter."""
    x, y = 0.1 * (np.arange(width) - 0.5 * (width - 1)), 0.05 * (0.5 * (height - 1) - np.arange(height))
    across, along = np.meshgrid(x, y)
    lean = 10.0 + slope_deg(across, along) + 0.1 * np.random.default_rng(1).standard_normal(across.shape)
    return AngleMap(
        angle_deg=lean, u_deg=np.full(lean.shape, 0.04), along_deg=None, u_along_deg=None,
        x_mm=across, y_mm=along, across_mm=x, along_mm=y, ridge=np.arange(width),
        cell_um=(60.0, 48.0), mean_deg=10.0, u_mean_deg=0.1, alpha=1.0, u_alpha=0.05, pitch_um=100.0,
        turn_deg=0.0, unseen=np.zeros(lean.shape, dtype=bool),
    )  # fmt: skip


def hollow(depth_um, sigma_mm=0.2, x0=0.1, y0=-0.1):
    def slope(x, y):
        fall = depth_um / 1000.0 * np.exp(-0.5 * ((x - x0) ** 2 + (y - y0) ** 2) / sigma_mm**2)
        return np.degrees(np.arctan(-(x - x0) / sigma_mm**2 * fall))

    return slope


def test_the_form_of_a_hollow_and_of_a_bulge():
    for depth in (12.0, -12.0):
        found = form_deviation(leaning(hollow(depth)))
        assert 0.6 * 2.08 < found.lean_deg < 1.05 * 2.08  # 0.61 depth / sigma, less by the window
        assert found.depth_um == pytest.approx(depth, rel=0.25)
        assert np.hypot(found.x_mm - 0.1, found.y_mm + 0.1) < 0.15
        assert found.record(0.5, 1.645).verdict is Verdict.FAIL


def test_a_curved_or_tilted_part_has_no_form():
    found = form_deviation(leaning(lambda x, y: 0.7 * x - 0.4 * y + 0.3))
    assert found.lean_deg < 4.0 * found.u_deg + 0.05
    assert found.record(0.5, 1.645).verdict is Verdict.PASS


def test_marks_of_single_cells_and_a_single_ridge_are_no_form():
    plain = leaning(lambda x, y: 0.0 * x)
    lean = plain.angle_deg.copy()
    lean[:, 5] -= 8.0
    lean[3:7, 9] = np.nan
    assert form_deviation(replace(plain, angle_deg=lean)).lean_deg < 0.3
    lean[:, 1:] = np.nan
    lean[2:, :] = np.nan
    with pytest.raises(MeasurementError, match="too few cells of the angle map are known"):
        form_deviation(replace(plain, angle_deg=lean))


def test_a_flank_without_another_has_no_depth():
    found = form_deviation(leaning(lambda x, y: -3.0 * ((np.abs(x - 0.3) < 0.25) & (np.abs(y) < 0.3))))
    assert found.lean_deg > 1.0
    assert found.depth_um == 0.0


def test_near_the_limit_neither_passes_nor_fails():
    near = FormDeviation(0.5, 0.05, 0.0, 0.0, 4.0, 10.0)
    assert FormDeviation(0.47, 0.15, 0.0, 0.0, 0.0, 10.0).record(0.5, 1.645) is None  # noise alone makes 0.32
    assert near.record(0.5, 1.645).verdict is Verdict.INCONCLUSIVE
    assert near.record(0.58, 1.645).verdict is Verdict.INCONCLUSIVE
    assert near.record(0.6, 1.645).verdict is Verdict.PASS


def sink(rng):
    sigma, x0, y0 = rng.uniform(175.0, 250.0), rng.uniform(350.0, 1050.0), rng.uniform(300.0, 900.0)
    return lambda x, y: -12.0 * np.exp(-0.5 * ((x - x0) ** 2 + (y - y0) ** 2) / sigma**2)


def weld_line(rng):
    sigma, y0, turn = rng.uniform(8.0, 18.0), rng.uniform(250.0, 950.0), rng.uniform(-0.5, 0.5)
    return lambda x, y: (
        -2.5 * np.exp(-0.5 * ((y - y0) * np.cos(turn) + (x - 700.0) * np.sin(turn)) ** 2 / sigma**2)
    )


def fibre(rng):
    """A fibre of 16 µm, 300 to 800 µm long, over the ridges."""
    x0, y0, turn = rng.uniform(450.0, 950.0), rng.uniform(400.0, 800.0), rng.uniform(0.0, np.pi)
    half, bend, radius = rng.uniform(150.0, 400.0), rng.uniform(-40.0, 40.0), 8.0

    def lies(surface, _):
        z = surface.height_um.copy()
        x, y = np.meshgrid(np.arange(z.shape[1]) * 2.0, np.arange(z.shape[0]) * 2.0)
        along = (x - x0) * np.cos(turn) + (y - y0) * np.sin(turn)
        off = (y - y0) * np.cos(turn) - (x - x0) * np.sin(turn) - bend * np.sin(2.0 * along / half)
        where = (np.abs(off) < radius) & (np.abs(along) < half)
        z[where] = z.max() + radius + np.sqrt(radius**2 - off[where] ** 2)
        return surface.with_height(z)

    return lies


FORMED, LYING = {"sink": sink, "weld line": weld_line}, {"fibre": fibre}


def traced(name, number, poses=NINE):
    """A part with a mark, and its recipe."""
    rng = np.random.default_rng([17, number, len(name)])
    product = PRODUCTS[number % len(PRODUCTS)]
    part = Part(
        40_000 + 100 * number + len(name), poses, size=SIZE, spread=0.1, phase=rng.random(), **product,
        crest_um=CRESTS_UM[number // len(PRODUCTS) % len(CRESTS_UM)],
        formed=FORMED[name](rng) if name in FORMED else None,
        spoiled=LYING[name](rng) if name in LYING else None,
    )  # fmt: skip
    angle, pitch, alpha = product["angle"], product["pitch"], product["alpha"]
    return part, recipe_of(angle, pitch, alpha, tail=float(product["lobe"] == "ggx"))


def judged(part, recipe, change=None, shares=None):
    """By 3 poses and by all: whether area, longest mark or form exceed their limits, and by which.

    The shares of deviating cells are added to ``shares``.
    """
    pictures = part.pictures if change is None else change(part.pictures)
    found, pitch = [], recipe.surface.pitch_um
    for count in sorted({3, len(part.poses)}):
        some = Part.__new__(Part)
        some.__dict__.update(part.__dict__, poses=part.poses[:count], pictures=pictures[:count])
        listed = tuple((one.stage_deg, one.tilt_deg) for one in some.poses)
        own = recipe.model_copy(
            update={"poses": type(recipe.poses).model_validate({"stage_and_tilt_deg": listed})}
        )
        seen = some.measured(None, pitch, 1)
        area, _ = judge_area(seen, cell_map(seen, own), own.area, 1.645)
        if shares is not None:
            shares.append((count, area.share))
        form = form_deviation(some.map_by(recipe)).record(recipe.area.max_lean_deg, 1.645)
        found.append(
            (area.verdict is Verdict.FAIL, area.too_long, form is not None and form.verdict is Verdict.FAIL)
        )
    return found


def test_a_sink_mark_and_a_fibre_that_no_share_of_the_area_shows():
    assert judged(*traced("good", 0, UPRIGHT)) == [(False, False, False)]
    assert judged(*traced("sink", 0, UPRIGHT))[0][2]
    assert judged(*traced("fibre", 1, UPRIGHT))[0][1]


@pytest.mark.statistics
@pytest.mark.parametrize("name", ["good", *FORMED, *LYING])
def test_how_often_parts_fail(name):
    """Good ones by 3 and 9 poses at most twice in 200; sink marks, weld lines and fibres in 90 % of 20."""
    count, shares = 200 if name == "good" else 20, []
    found = np.array(for_each(lambda k: judged(*traced(name, k), shares=shares), range(count), 2))
    fails = found.any(axis=2).sum(axis=0)
    if name != "good":
        assert np.all(fails >= 0.9 * count)
        return
    assert np.all(fails <= 0.01 * count)
    for poses in (3, 9):
        of_poses = np.array([share for count, share in shares if count == poses])
        assert np.mean(of_poses <= 0.015) >= 0.99


def stained(picture, depth, turn_deg=0.0):
    """With less light about a place a tenth of the width from the middle, turned about it."""
    y, x = (
        one - 0.5 * (size - 1) for one, size in zip(np.indices(picture.shape), picture.shape, strict=True)
    )
    away, turn = -0.1 * picture.shape[1], np.radians(turn_deg)
    square = (x - away * np.cos(turn)) ** 2 + (y - away * np.sin(turn)) ** 2
    return (picture * (1.0 - depth * np.exp(-0.5 * square / 60.0**2))).astype(np.float32)


def on_a_stained_flat(pictures, depth):
    """More light where the flat had less: at one place of the camera, over which the part turns."""
    return [stained(one, -depth, NINE[k].stage_deg) for k, one in enumerate(pictures)]


def vignetted(picture, depth):
    y, x = (np.linspace(-1.0, 1.0, size) for size in picture.shape)
    return (picture * (1.0 - 0.5 * depth * (x**2 + y[:, None] ** 2))).astype(np.float32)


NUISANCES = {
    "10 % less light in a pose": lambda p: [p[0] * np.float32(0.9), *p[1:]],
    "other light, 2 % of the brightest pose": lambda p: [
        one + np.float32(0.02 * max(float(pose.mean()) for pose in p)) for one in p
    ],
    "gamma 0.95": lambda p: [(one / one.max()) ** np.float32(0.95) * one.max() for one in p],
    "a pose shifted by a point": lambda p: [p[0], np.roll(p[1], 1, 1), *p[2:]],
    "a pose out of focus": lambda p: [p[0], cv2.GaussianBlur(p[1], (0, 0), 2.0), *p[2:]],
    "5 % vignetting in a pose": lambda p: [vignetted(p[0], 0.05), *p[1:]],
    "a stain of 3 % in a pose": lambda p: [stained(p[0], 0.03), *p[1:]],
    "a stain of 5 % on the flat": lambda p: on_a_stained_flat(p, 0.05),
}
DARK = {
    "a stain of 10 % on the flat": lambda p: on_a_stained_flat(p, 0.1),
    "a film on the part that takes 10 %": lambda p: [stained(one, 0.1) for one in p],
}
"""Leans of the facets to three upright poses, by which some parts fail."""


@pytest.mark.statistics
def test_nuisances_fail_no_good_part():
    """None of 25 parts that passed before; of those with a dark place in all poses some do."""

    def each(number):
        part, recipe = traced("good", number)
        return [judged(part, recipe, change) for change in (None, *NUISANCES.values(), *DARK.values())]

    found = np.array(for_each(each, range(600, 625), 2)).any(axis=3)
    failed = (found[:, 1:] & ~found[:, :1]).sum(axis=0)
    assert not failed[: len(NUISANCES)].any()
    by_three, by_nine = failed[len(NUISANCES) :].T
    assert np.all(by_three <= 12)
    assert np.all(by_nine <= 5)
