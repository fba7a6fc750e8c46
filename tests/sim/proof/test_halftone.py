"""Separation and halftones: nothing overlaps, coverages come out as they were asked for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog, nnls

from anisoscope.base.errors import ModelError
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.materials.inks import PACKAGED, synthetic_ink
from anisoscope.sim.proof.halftone import BLOCK, coverage, halftone
from anisoscope.sim.proof.separation import decode_srgb, separation


def flat(coverages, rows=256, cols=320):
    return np.broadcast_to(np.float32(coverages), (rows, cols, 3)).astype(np.float32)


TINTS = [
    (0.1, 0.2, 0.3),
    (0.33, 0.33, 0.34),
    (0.02, 0.5, 0.4),
    (0.25, 0.0, 0.6),
    (0.05, 0.05, 0.05),
    (0.0, 1.0, 0.0),
]


@pytest.mark.parametrize("tint", TINTS)
def test_blocks_of_even_tints_are_covered_as_asked(plan, tint):
    direct = replace(plan, way="channels")
    found = halftone(flat(tint), direct)
    assert found.block_error.shape == (20,)
    assert found.block_error.max() <= 0.004
    np.testing.assert_allclose(found.aimed, tint, atol=1e-6)
    blocks = found.dots[:, :, None] == np.arange(1, 4)
    smaller = blocks.reshape(8, 32, 10, 32, 3).mean(axis=(1, 3)) - tint
    assert np.sqrt(np.mean(smaller**2)) <= 0.004  # blocks of 32 × 32, rms
    diffused = halftone(flat(tint), direct, "diffusion")
    assert np.abs(diffused.printed - tint).max() <= 0.004
    inner = diffused.dots[BLOCK:-BLOCK, BLOCK:-BLOCK, None] == np.arange(1, 4)
    assert np.abs(inner.reshape(2, 64, 3, 64, 3).mean(axis=(1, 3)) - tint).max() <= 0.004


@pytest.mark.parametrize("method", ["mask", "diffusion"])
def test_no_dot_bears_two_inks_and_every_dot_of_a_full_tint_bears_one(plan, rng, method):
    image = rng.integers(0, 256, (200, 301, 3), dtype=np.uint8)
    found = halftone(image, plan, method)
    assert sum(found.mask(k).astype(int) for k in range(3)).max() == 1
    np.testing.assert_allclose(found.printed, found.aimed, atol=0.004)
    full = halftone(flat((0.5, 0.2, 0.3)), replace(plan, way="channels"), method)
    assert full.printed.sum() == pytest.approx(
        1.0, abs=2e-3 if method == "mask" else 0.01
    )  # errors begin at 0


def test_too_much_ink_is_scaled_down_and_told(plan):
    found = halftone(flat((0.9, 0.6, 0.3)), replace(plan, way="channels"))
    np.testing.assert_allclose(found.aimed, [0.5, 1 / 3, 1 / 6], atol=1e-6)
    assert found.scaled == 1.0
    assert halftone(flat((0.3, 0.3, 0.4)), replace(plan, way="channels")).scaled == 0.0


def test_coverages_are_the_non_negative_least_squares_solution(plan, rng):
    image = rng.integers(0, 256, (20, 20, 3), dtype=np.uint8)
    found = coverage(image, plan)
    linear = decode_srgb()[image] @ plan.adaptation.T
    for got, aim in zip(found.reshape(-1, 3), linear.reshape(-1, 3), strict=True):
        expected = nnls(plan.colours, aim)[0]
        expected /= max(1.0, expected.sum())
        np.testing.assert_allclose(got, expected, atol=3e-5)


def test_colours_of_the_inks_come_back_under_either_light(inks):
    for name in ("d65", "a"):
        plan = separation(inks, standard(name))
        mixed = np.array([0.2, 0.1, 0.05])
        aim = np.linalg.solve(plan.adaptation, plan.colours @ mixed).astype(np.float32)
        np.testing.assert_allclose(coverage(aim.reshape(1, 1, 3), plan)[0, 0], mixed, atol=1e-5)
        white = coverage(np.full((1, 1, 3), 255, dtype=np.uint8), plan)[0, 0]
        assert white.sum() == pytest.approx(1.0, abs=1e-5)
        np.testing.assert_allclose(white, plan.neutral, atol=1e-4)


def test_a_sheet_that_shines_between_the_dots_is_counted(inks, d65):
    """Spectra of the print, summed: 20 % of grey sheet and the image's colour come out, up to what white is."""
    plan = separation(inks, d65, substrate=0.2)
    image = np.float32([[[0.9, 0.8, 0.7], [0.4, 0.5, 0.5], [0.6, 0.45, 0.4]]])
    covered = coverage(image, plan)[0]
    assert covered.min() > 0.0
    spectra = np.stack([brdf_at_angles(ink, 20.0, 20.0) for ink in inks])
    shown = covered @ spectra + (1.0 - covered.sum(axis=1, keepdims=True)) * 0.2 / np.pi
    seen = linear_srgb(shown @ xyz_weights(d65, inks[0].nm))
    white = linear_srgb(plan.neutral @ spectra @ xyz_weights(d65, inks[0].nm))
    np.testing.assert_allclose(seen / white, image[0], rtol=5e-3)
    black = coverage(np.zeros((1, 1, 3), dtype=np.uint8), plan)
    assert black.sum() == 0.0  # no darker than the sheet
    with pytest.raises(ModelError, match="brighter than the white of the inks"):
        separation([replace(ink, alpha=0.6) for ink in inks], d65, substrate=0.9)


def test_coverage_is_linear_in_light(plan):
    grey = np.float32([[[0.1] * 3, [0.2] * 3, [0.4] * 3]])
    found = coverage(grey, plan)[0]
    np.testing.assert_allclose(found[1], 2 * found[0], rtol=1e-4)
    np.testing.assert_allclose(found[2], 4 * found[0], rtol=1e-4)


def test_out_of_gamut_is_counted(plan):
    pure = np.zeros((8, 8, 3), dtype=np.uint8)
    pure[:, :4, 1] = 255  # greener than the green ink
    pure[:, 4:] = 40
    assert halftone(pure, plan).outside == 0.5


def test_decoding_inverts_the_encoding():
    from anisoscope.sim.light.colour.spaces import encode

    np.testing.assert_allclose(255 * encode(decode_srgb()).srgb, np.arange(256), atol=1e-9)


def test_progress_ends_at_the_end_and_bands_do_not_show(plan, rng):
    seen = []
    image = rng.integers(0, 256, (300, 64, 3), dtype=np.uint8)
    for method in ("mask", "diffusion"):
        seen.clear()
        whole = halftone(image, plan, method, advance=lambda _, done, total: seen.append((done, total)))
        assert seen[-1] == (300, 300)
        top = halftone(image[:140], plan, method)
        np.testing.assert_array_equal(whole.dots[:140], top.dots)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4), np.uint8), "rows, cols, 3"),
        (np.zeros((0, 4, 3), np.uint8), "rows, cols, 3"),
        (np.zeros((4, 4, 3)), "float32"),
    ],
)
def test_images_that_cannot_be_halftoned(plan, image, message):
    with pytest.raises(ModelError, match=message):
        halftone(image, plan)


def test_separations_that_cannot_be_made(inks, d65):
    for given, message in (
        ({"inks": inks[:2]}, "three or four inks"),
        ({"inks": (inks[0], inks[0], inks[2])}, "too much alike"),
        ({"angle_deg": 89.0}, "0 to 85"),
        ({"gain": 0.0}, "gain"),
    ):
        with pytest.raises(ModelError, match=message):
            separation(**({"inks": inks, "illuminant": d65} | given))
    with pytest.raises(ModelError, match="no halftone is named"):
        halftone(np.zeros((4, 4, 3), np.uint8), separation(inks, d65), "dither")


@pytest.fixture(scope="module")
def four():
    return separation([synthetic_ink(name) for name in PACKAGED], standard("d65"))


def test_of_the_mixtures_of_four_inks_the_one_with_the_least_ink_is_taken(four, plan, rng):
    """Against linear programming."""
    image = rng.integers(0, 256, (12, 12, 3), dtype=np.uint8)
    found = coverage(image, four)
    linear = decode_srgb()[image] @ four.adaptation.T
    met = 0
    for got, aim in zip(found.reshape(-1, 4), linear.reshape(-1, 3), strict=True):
        least = linprog(np.ones(4), A_eq=four.colours, b_eq=aim)
        if least.status == 0:
            met += 1
            expected = least.x / max(1.0, least.fun)
        else:
            expected = nnls(four.colours, aim)[0]
            expected /= max(1.0, expected.sum())
        np.testing.assert_allclose(got, expected, atol=1e-4)
    assert met > 10
    # the same light takes less ink, so that white is brighter
    assert four.neutral[3] > 0.3
    white = [np.linalg.norm(one.colours @ one.neutral) for one in (four, plan)]
    np.testing.assert_allclose(white[0], white[1], rtol=1e-9)  # in units of the image's white
    brightest = [colour.sum(axis=0).max() for colour in (four.colours, plan.colours)]
    assert brightest[0] < brightest[1]


@pytest.mark.parametrize("method", ["mask", "diffusion"])
def test_four_inks_never_meet_and_cover_as_asked(four, method):
    direct = replace(four, way="channels")
    found = halftone(flat((0.35, 0.5, 0.25)), direct, method)
    np.testing.assert_allclose(found.aimed, [0.1, 0.25, 0.0, 0.25], atol=1e-6)  # what they share is white
    np.testing.assert_allclose(found.printed, found.aimed, atol=0.004)
    assert sum(found.mask(k).astype(int) for k in range(4)).max() == 1


def test_inks_that_do_not_span_colours_are_refused(inks):
    for names in ([0, 0, 0, 0], [0, 0]):
        with pytest.raises(ModelError, match=r"too much alike|three or four inks"):
            separation([inks[n] for n in names], standard("d65"))
