"""Views made by hand: what is in the region, and what makes a measurement unfit."""

import re
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import MeasurementError, RegistrationError, Saturated
from anisoscope.decision.decision import decide
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.pose_radiance import drift_error, measure, region_grid
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.kinds.ridges.kind import RIDGES
from anisoscope.prediction.expectation import expectation
from anisoscope.record.verdict import Verdict

SIZE = 200
LEVELS = {0.0: 0.30, 90.0: 0.05, 180.0: 0.04}


def view(angle, level=None, *, turned=0.0, pixel_um=8.0, shift_px=(0.0, 0.0), noise=0.001):
    """A picture of one radiance all over, the fixture at ``angle + turned``."""
    factor = np.exp(1j * np.radians(angle + turned)) * 1000.0 / pixel_um
    axis = tuple((SIZE - 1) / 2 + s for s in shift_px)
    matrix = np.array([[factor.real, -factor.imag, axis[0]], [-factor.imag, -factor.real, axis[1]]])
    place = Placement(matrix, (angle + turned) % 360.0, pixel_um, axis, 0.05, 4)
    value = np.full((SIZE, SIZE), LEVELS[angle] if level is None else level, np.float32)
    image = RadianceImage(value, np.full_like(value, noise), np.zeros(value.shape, bool), 0.5)
    return View(angle, 0.0, image, place)


def with_image(seen, **fields):
    return replace(seen, image=replace(seen.image, **fields))


@pytest.fixture
def recipe(make_recipe):
    return make_recipe(region={"size_mm": [0.8, 0.6]})


@pytest.fixture
def expected(recipe):
    return expectation(recipe, 10.0)


@pytest.fixture
def views():
    return [view(angle) for angle in LEVELS]


def test_radiances_are_those_of_the_pictures(views, recipe, expected):
    found = measure(views, view(0.0, 0.303), recipe, expected, 8.0)
    np.testing.assert_allclose(found.radiance, list(LEVELS.values()), rtol=1e-6)
    assert found.drift == pytest.approx(0.01, rel=1e-4)
    np.testing.assert_allclose(found.cells, found.radiance[:, None, None] + 0 * found.cells, rtol=1e-6)


def test_only_the_region_counts(views, recipe, expected):
    for seen in views:
        rows, cols = np.indices(seen.image.value.shape) - (SIZE - 1) / 2
        seen.image.value[np.hypot(rows, cols) > 67] = 9.0  # half the diagonal is 62.5 pixels
    np.testing.assert_allclose(
        measure(views, None, recipe, expected, 8.0).radiance, list(LEVELS.values()), rtol=1e-6
    )


def test_the_region_spans_whole_pitches_and_quarter_pitch_cells(make_recipe):
    grid, per_cell = region_grid(make_recipe(region={"size_mm": [0.77, 0.35], "center_mm": [0.1, 0.0]}), 8.0)
    along, across = grid.size_mm
    assert (across, along) == pytest.approx((0.7, 0.3))
    assert per_cell * grid.pixel_mm == pytest.approx(0.025)
    assert grid.center_mm == (0.1, 0.0)


def test_ridges_are_averaged_over_whole_pitches(make_recipe, expected):
    """A stripe pattern of one pitch has the same mean wherever its phase is."""
    means = []
    for phase in (0.0, 0.3, 0.7):
        seen = [view(angle) for angle in LEVELS]
        col = np.arange(SIZE) - (SIZE - 1) / 2
        seen[0].image.value[:] = 0.3 * (1 + 0.8 * np.sin(2 * np.pi * (col * 0.08 + phase)))
        means.append(
            measure(seen, None, make_recipe(region={"size_mm": [0.8, 0.6]}), expected, 8.0).radiance[0]
        )
    np.testing.assert_allclose(means, 0.3, rtol=2e-3)


def test_noise_of_the_mean_is_noise_by_the_root_of_the_pixels(recipe, expected, rng):
    """The stated uncertainty is the spread of many measurements of pure noise."""
    found = []
    for _ in range(60):
        seen = [view(angle, noise=0.02) for angle in LEVELS]
        for one in seen:
            one.image.value[:] += 0.02 * rng.standard_normal(one.image.value.shape).astype(np.float32)
        found.append(measure(seen, None, recipe, expected, 8.0))
    spread = np.std([np.log(m.radiance) for m in found], axis=0)
    stated = found[0].components[0].relative
    assert found[0].components[0].source.startswith("noise")
    np.testing.assert_allclose(stated, spread, rtol=0.35)  # 60 draws: 9 % standard error
    np.testing.assert_allclose(
        found[0].cell_noise, np.std([np.log(m.cells[:, 4, 5]) for m in found], axis=0), rtol=0.5
    )


def test_hot_pixels_in_the_region_leave_the_mean_alone(views, recipe, expected, rng):
    for seen in views:
        seen.image.value[rng.random(seen.image.value.shape) < 0.002] = np.nan
    found = measure(views, None, recipe, expected, 8.0)
    np.testing.assert_allclose(found.radiance, list(LEVELS.values()), rtol=1e-6)
    assert np.isfinite(found.cells).all()


def test_without_a_closing_picture_drift_is_unknown_and_its_limit_counts(views, recipe, expected):
    found = measure(views, None, recipe, expected, 8.0)
    (drift,) = (c for c in found.components if "drift" in c.source)
    assert found.drift is None
    np.testing.assert_allclose(drift.relative, recipe.limits.drift / np.sqrt(3))


def saturated(seen):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[90:110, 90:110] = True
    return with_image(seen, saturated=mask, value=np.where(mask, np.nan, seen.image.value).astype(np.float32))


def mirroring(seen, first=60, wide=12, beside=0.3):
    """One ridge is missing: its land saturates, with a seam of bright pixels."""
    mask, value = np.zeros((SIZE, SIZE), bool), seen.image.value.copy()
    value[:, first - 1 : first + wide + 1] = beside
    mask[:, first : first + wide] = True
    return with_image(seen, saturated=mask, value=np.where(mask, np.nan, value).astype(np.float32))


def test_a_defect_that_saturates_is_a_fail(views, recipe, expected):
    views[2] = mirroring(views[2])
    found = measure(views, view(0.0), recipe, expected, 8.0)
    assert found.drift == pytest.approx(0.0, abs=1e-6)
    columns = np.flatnonzero(found.mirroring.mean(axis=0) > 0.9)
    assert 3 <= len(columns) <= 5
    assert np.all(found.cells[2][:, columns] > 0.2)
    decided = decide(expected, found, recipe)
    assert decided.verdict is Verdict.FAIL
    assert re.match(
        r"1\d\.\d% of the area is saturated where the same flanks .* it mirrors", decided.reasons[0]
    )
    assert np.all(decided.deviating[found.mirroring])
    kept = RIDGES.kept(recipe, found)
    again = RIDGES.decide_again(kept, recipe, expected, None)[1]
    assert (again.verdict, again.reasons) == (Verdict.FAIL, decided.reasons)


OVEREXPOSED = {
    "the same flanks are nearly as bright": lambda seen: mirroring(
        with_image(seen, value=np.full_like(seen.image.value, 0.28))
    ),
    "most of the region": lambda seen: mirroring(seen, first=20, wide=110),
    "points everywhere": lambda seen: with_image(
        seen, saturated=np.indices((SIZE, SIZE)).sum(axis=0) % 9 == 0
    ),
}


@pytest.mark.parametrize("case", OVEREXPOSED)
def test_general_over_exposure_stays_invalid(case, views, recipe, expected):
    views[0] = OVEREXPOSED[case](views[0])
    with pytest.raises(Saturated, match=r"at 0° .* saturated .*shorten acquisition.exposure_s"):
        measure(views, None, recipe, expected, 8.0)


def residual(seen):
    return replace(seen, placement=replace(seen.placement, residual_px=0.7))


def blind(seen):
    value = seen.image.value.copy()
    value[90:110, 60:140] = np.nan
    return with_image(seen, value=value)


GATES = {
    "saturated": (
        0,
        saturated,
        Saturated,
        "at 0° .* of the region are saturated .* shorten acquisition.exposure_s",
    ),
    "markers": (
        1,
        residual,
        RegistrationError,
        "at 90° the fixture markers fit with 0.70 px rms, limit 0.5 px",
    ),
    "cap": (
        2,
        lambda seen: with_image(seen, signal_share=0.004),
        MeasurementError,
        "at 180° the brightest parts reach 0.4% of full scale .*lens cap",
    ),
    "stage": (
        1,
        lambda _: view(90.0, turned=0.7),
        RegistrationError,
        "the stage says 90°, the markers 90.70°",
    ),
    "sense": (1, lambda _: view(90.0, turned=180.0), RegistrationError, "rotation sense"),
    "scale": (0, lambda _: view(0.0, pixel_um=8.3), RegistrationError, "8.300 µm a pixel, the rig file 8 µm"),
    "centre": (2, lambda _: view(180.0, shift_px=(9.0, 9.0)), RegistrationError, "centre moved by 102 µm"),
    "blind": (1, blind, MeasurementError, "at 90° .* of the region have no usable pixels"),
    "black": (1, lambda _: view(90.0, -0.001), MeasurementError, "darker than the dark frames"),
}


@pytest.mark.parametrize("gate", GATES)
def test_gates(views, recipe, expected, gate):
    which, spoil, error, message = GATES[gate]
    views[which] = spoil(views[which])
    with pytest.raises(error, match=message) as caught:
        measure(views, None, recipe, expected, 8.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("turned", [3.0, 90.0, -90.0])
def test_a_fixture_turned_on_the_stage_is_noticed(recipe, expected, turned):
    with pytest.raises(
        RegistrationError, match=rf"stands {re.escape(f'{turned:+.2f}°')} from where .*zero_deg"
    ):
        measure([view(angle, turned=turned) for angle in LEVELS], None, recipe, expected, 8.0)


@pytest.mark.parametrize(("again", "words"), [(0.28, "6.7% darker"), (0.32, "6.7% brighter"), (0.301, None)])
def test_drift_is_noticed(views, recipe, expected, again, words):
    drift = measure(views, view(0.0, again), recipe, expected, 8.0).drift
    complaint = drift_error(drift, recipe.limits.drift)
    assert complaint is None if words is None else words in complaint


def test_flicker_common_to_all_pixels_does_not_average_over_the_region(recipe, expected):
    flickering = [view(angle) for angle in LEVELS]
    for number, seen in enumerate(flickering):
        image = replace(seen.image, flicker=0.01 * (number + 1), frames=4)
        flickering[number] = replace(seen, image=image)
    found = measure(flickering, None, recipe, expected, 8.0)
    (part,) = (c for c in found.components if c.source == "flicker of the lamp")
    pooled = np.sqrt(np.mean([0.01**2, 0.02**2, 0.03**2]))
    np.testing.assert_allclose(part.covariance(), (pooled / 2.0) ** 2 * np.eye(3))


def test_a_region_larger_than_the_picture_is_noticed(views, make_recipe, expected):
    with pytest.raises(
        RegistrationError, match=r"of the region lie outside the picture: make region\.size_mm smaller"
    ):
        measure(views, None, make_recipe(region={"size_mm": [1.8, 0.6]}), expected, 8.0)


def test_the_budget_states_what_the_recipe_states(views, make_recipe):
    stated = {"flat_share": 0.011, "linearity_share": 0.007, "stray_radiance": 0.002, "stage_deg": 0.3}
    recipe = make_recipe(uncertainty=stated, region={"size_mm": [0.8, 0.6]})
    expected = expectation(recipe, 10.0)
    parts = {c.source: c for c in measure(views, None, recipe, expected, 8.0).components}
    np.testing.assert_allclose(parts["flat field"].relative, 0.011)
    np.testing.assert_allclose(parts["linearity of the camera"].relative, 0.007)
    np.testing.assert_allclose(
        parts["stray light"].relative, 0.002 / np.array(list(LEVELS.values())), rtol=1e-5
    )
    np.testing.assert_allclose(parts["stage angle"].relative, 0.3 * expected.per_degree)
    assert parts["stray light"].shared
    assert not parts["flat field"].shared
