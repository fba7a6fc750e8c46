"""Closed forms of random stepped surfaces against samples of them."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.wave import claims, sampling
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import WaveSurface
from anisoscope.sim.light.wave.windows import Extent, Window

WAVELENGTH, COHERENCE, PIXEL = 0.5, 16.0, 0.25
WINDOW = Window(Extent("rect", WAVELENGTH / COHERENCE))
BINARY = (0.0, 0.125)
FOUR = (0.0, 0.0625, 0.125, 0.1875)
A_WINDOW = int(COHERENCE / PIXEL)


def steps_map(widths_x, widths_y, levels_um, shape, pixel_um, rng):
    """(rows, cols) heights of sampling process 1 in two: a level for each rectangle of two sequences."""
    rows, cols = widths_y.cells(shape[0], pixel_um, rng), widths_x.cells(shape[1], pixel_um, rng)
    levels = rng.choice(np.asarray(levels_um, dtype=np.float64), (int(rows[-1]) + 1, int(cols[-1]) + 1))
    return levels[np.ix_(rows, cols)]


def permuted_profile(levels_um, width_um, count, pixel_um, rng):
    """(count,) heights of sampling process 2: after each other all m levels in random order, steps of equal width.

    Raises:
        ModelError: fewer than two levels, or a width that is not whole pixels.
    """
    step = _pixels(width_um, pixel_um)
    blocks = _blocks(levels_um, -(-count // (step * len(levels_um))), rng)
    return np.repeat(blocks.ravel(), step)[:count]


def permuted_map(levels_um, arrangement, widths_um, shape, pixel_um, rng):
    """(rows, cols) heights of sampling process 2 in blocks of m_x × m_y rectangles a0x × a0y, all given (x, y).

    Raises:
        ModelError: an arrangement that does not hold all levels once, or widths that are not whole pixels.
    """
    many_x, many_y = arrangement
    if many_x * many_y != len(levels_um):
        raise ModelError(f"{many_x} × {many_y} rectangles do not hold {len(levels_um)} levels once each")
    step_x, step_y = (_pixels(width, pixel_um) for width in widths_um)
    down, over = -(-shape[0] // (step_y * many_y)), -(-shape[1] // (step_x * many_x))
    blocks = _blocks(levels_um, down * over, rng).reshape(down, over, many_y, many_x)
    cells = blocks.transpose(0, 2, 1, 3).reshape(down * many_y, over * many_x)
    return np.repeat(np.repeat(cells, step_y, axis=0), step_x, axis=1)[: shape[0], : shape[1]]


def crossed_map(profile_x_um, profile_y_um):
    """(rows, cols) heights whose wave is the product of those of two profiles: heights add."""
    return np.add.outer(profile_y_um, profile_x_um)


def _pixels(width_um, pixel_um):
    step = round(width_um / pixel_um)
    if step < 1 or abs(step * pixel_um - width_um) > 1e-6 * width_um:
        raise ModelError(f"steps of {width_um:g} µm are not whole pixels of {pixel_um:g} µm")
    return step


def _blocks(levels_um, count, rng):
    """(count, m) random orders of the levels."""
    if len(levels_um) < 2:
        raise ModelError("sampling process 2 needs two levels or more")
    return rng.permuted(np.tile(np.asarray(levels_um, dtype=np.float64), (count, 1)), axis=1)


def deviation(heights, expected, reach=1.0, window=WINDOW):
    """Rms deviation from a closed form over its peak, over |ω| < reach."""
    spread = angular_map(WaveSurface.of(heights, PIXEL, cells=True), WAVELENGTH, window)
    inside = np.abs(spread.frequency_x) < reach
    nodes = np.linspace(-reach, reach, 1601)
    reference = np.interp(spread.frequency_x[inside], nodes, expected(nodes))
    return np.sqrt(np.mean((spread.density[0, inside] - reference) ** 2)) / reference.max()


def speckle(expected, windows, reach=1.0):
    """Rms deviation over the peak of fully developed speckle, of as many windows, of steps of one eighth of each."""
    density = expected(np.linspace(-reach, reach, 1601))
    return np.sqrt(np.mean(density**2) * (1.0 - 2.0 / COHERENCE) / windows) / density.max()


def of_steps(f):
    return claims.lobe(f, np.array([2.0]), np.array([1.0]), COHERENCE)


def of_permutations(f):
    return claims.anti_mirror(f, 4, 2.0, COHERENCE)


@pytest.mark.parametrize(
    ("draw", "expected"),
    [
        (lambda n, rng: sampling.steps_profile(sampling.Widths((2.0,)), BINARY, n, PIXEL, rng), of_steps),
        (lambda n, rng: permuted_profile(FOUR, 2.0, n, PIXEL, rng), of_permutations),
    ],
    ids=["claim 1", "claim 2"],
)
def test_samples_approach_the_closed_form_as_one_over_root_n(draw, expected):
    """Windows are speckles: each is off by its own mean, so that rms/peak is √(mean S²/N)/peak, less the share a/Δc.

    About eight speckles lie under the lobe, half of them mirror images: one sample scatters by 0.5/√8·√2, a quarter.
    """
    rng = np.random.default_rng(7)
    for windows, times in ((16, 48), (256, 16), (1024, 8)):
        errors = [deviation(draw(windows * A_WINDOW, rng), expected) for _ in range(times)]
        found = np.sqrt(np.mean(np.square(errors)))
        assert found == pytest.approx(speckle(expected, windows), rel=max(0.2, 4.0 * 0.25 / np.sqrt(times)))


@pytest.mark.parametrize(("reach", "of_one"), [(1.0, 0.382), (8.0, 0.135)])
def test_rms_over_peak_depends_on_the_band_it_is_taken_over(reach, of_one):
    """0.135/√N over all that pixels of 1/16 µm resolve (0.138, 0.070, 0.034, … of one sample each), 0.38 to the first
    zeros."""
    assert speckle(of_steps, 1, reach) == pytest.approx(of_one, abs=0.002)


def test_claim_2_with_the_printed_sinc_or_without_blur_does_not_fit():
    rng = np.random.default_rng(11)
    heights = permuted_profile((0.0, 0.125), 2.0, 4096 * A_WINDOW, PIXEL, rng)
    right = deviation(heights, lambda f: claims.anti_mirror(f, 2, 2.0, COHERENCE), 0.25)

    def printed(f):
        centred = f * 2.0 - np.rint(f * 2.0)
        return 2.0 * (1.0 - np.sinc(2.0 * centred) ** 2) * 2.0 * np.sinc(2.0 * f) ** 2

    assert right < 0.025
    assert deviation(heights, printed, 0.25) > 2.0 * right
    spread = angular_map(WaveSurface.of(heights, PIXEL, cells=True), WAVELENGTH, WINDOW)
    assert spread.at(np.zeros(1))[0] > 0.015 * spread.density.max()  # without the blur there would be nothing


def test_mixed_widths_count_by_area():
    """Per step, as Eq. 13 is printed, wide steps would count too much: Σ p·a² sinc² is not normalised by E[a]."""
    widths, drawn = np.array([2.0, 6.0]), np.array([0.7, 0.3])
    rng = np.random.default_rng(12)
    heights = sampling.steps_profile(
        sampling.Widths((2.0, 6.0), (0.7, 0.3)), BINARY, 4096 * A_WINDOW, PIXEL, rng
    )
    right = deviation(heights, lambda f: claims.lobe(f, widths, drawn, COHERENCE))
    naive = deviation(
        heights,
        lambda f: sum(p * claims.blurred_sinc2(f, a, COHERENCE) for a, p in zip(widths, drawn, strict=True)),
    )
    assert right < 0.012
    assert naive > 10.0 * right
    assert claims.area_shares(widths, drawn).sum() == pytest.approx(1.0)


def test_a_mean_that_is_not_zero_leaves_a_spike():
    levels = (0.0, 0.1)
    tau = claims.mean_phase(levels, WAVELENGTH)
    rng = np.random.default_rng(13)
    heights = sampling.steps_profile(sampling.Widths((2.0,)), levels, 4096 * A_WINDOW, PIXEL, rng)
    spread = angular_map(WaveSurface.of(heights, PIXEL, cells=True), WAVELENGTH, WINDOW)
    f = np.array([0.0, 0.02, 0.1, 0.3])
    expected = claims.with_spike(tau, of_steps(f), claims.spike(f, COHERENCE))
    np.testing.assert_allclose(spread.at(0.5 * WAVELENGTH * f), expected, rtol=0.1)
    assert expected[0] > 1.8 * expected[2]


def test_spike_over_lobe_of_etched_levels():
    """Δc = 16 µm, a = 2 µm: 4 levels of two passes leave a spike of 51 % of the lobe, 8 levels 2.2 %."""
    assert claims.spike_over_lobe(0.0893, 16.0, 2.0) == pytest.approx(0.51, abs=0.01)
    assert claims.spike_over_lobe(0.0188, 16.0, 2.0) == pytest.approx(0.022, abs=0.001)


@pytest.mark.parametrize(("count", "floor"), [(2, 0.024), (3, 0.045), (4, 0.074), (8, 0.23)])
def test_the_source_fills_the_hole(count, floor):
    f = np.linspace(-1.0, 1.0, 801)
    found = claims.anti_mirror(f, count, 2.0, COHERENCE)
    assert found[400] / found.max() == pytest.approx(floor, rel=0.1)
    assert claims.anti_mirror(np.zeros(1), count, 2.0)[0] == 0.0


def test_densities_integrate_to_one():
    f = np.linspace(-60.0, 60.0, 24_001)
    step = f[1] - f[0]
    for density in (
        of_steps(f),
        of_permutations(f),
        claims.anti_mirror(f, 8, 2.0),
        claims.mixture((0.25, 0.75), (of_steps(f), of_permutations(f))),
    ):
        assert density.sum() * step == pytest.approx(1.0, abs=3e-3)


@pytest.mark.parametrize(
    ("arrangement", "widths"), [((2, 2), (2.0, 2.0)), ((4, 1), (2.0, 2.0)), ((2, 2), (2.0, 4.0))]
)
def test_blocks_in_two_dimensions(arrangement, widths):
    rng = np.random.default_rng(14)
    heights = permuted_map(FOUR, arrangement, widths, (512, 512), PIXEL, rng)
    found, expected = _in_two(
        heights, lambda x, y: claims.anti_mirror_2d(x, y, arrangement, widths, COHERENCE)
    )
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.06 * expected.max()
    centre = found[found.shape[0] // 2, found.shape[1] // 2]
    assert centre < 0.25 * found.max()


def test_crossed_sequences_leave_a_cross():
    rng = np.random.default_rng(15)
    x, y = (permuted_profile(BINARY, 2.0, 768, PIXEL, rng) for _ in range(2))
    heights = crossed_map(x, y)

    def product(fx, fy):
        return claims.crossed(*(claims.anti_mirror(f, 2, 2.0, COHERENCE) for f in (fx, fy)))

    found, expected = _in_two(heights, product)
    middle = found.shape[0] // 2
    assert found[middle].max() < 0.1 * found.max()
    assert found[:, middle].max() < 0.1 * found.max()
    assert np.corrcoef(found.ravel(), expected.ravel())[0, 1] > 0.6  # one sample of each axis only


def _in_two(heights, expected):
    spread = angular_map(WaveSurface.of(heights, PIXEL, cells=True), WAVELENGTH, WINDOW)
    inside = np.abs(spread.frequency_x) < 0.6
    f = spread.frequency_x[inside]
    return spread.density[np.ix_(inside, inside)], expected(f, f)


def test_rectangles_in_two_dimensions_are_products():
    rng = np.random.default_rng(16)
    wide = sampling.Widths((4.0,))
    heights = steps_map(sampling.Widths((2.0,)), wide, BINARY, (512, 512), PIXEL, rng)
    found, expected = _in_two(
        heights,
        lambda x, y: np.outer(claims.lobe(y, np.array([4.0]), np.ones(1), COHERENCE), of_steps(x)),
    )
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.08 * expected.max()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: sampling.Widths((1.5,)), "narrower than the smallest feature of 2 µm"),
        (lambda: sampling.Widths((2.0, 3.0), (1.0,)), "probability"),
        (lambda: claims.anti_mirror(np.zeros(1), 1, 2.0), "two steps"),
        (lambda: claims.mixture((0.5, 0.4), (np.zeros(1), np.zeros(1))), "1 all together"),
        (lambda: permuted_profile(FOUR, 2.1, 10, 0.25, np.random.default_rng(1)), "whole pixels"),
        (
            lambda: permuted_map(FOUR, (3, 1), (2.0, 2.0), (64, 64), 0.25, np.random.default_rng(1)),
            "do not hold 4 levels",
        ),
    ],
)
def test_models_that_cannot_be_made_are_refused(wrong, words):
    with pytest.raises(ModelError, match=words):
        wrong()
