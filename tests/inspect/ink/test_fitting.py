"""The fit of an ink on synthetic goniometer readings.

Angles of the light as in the paper: 20° to 70° by 10°, and 65°. It does not list those of the detector; here 0° to 75°
by 5° and the mirror direction, from 50° on also the light's side down to −15°.
"""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.ink.fitting import fit
from anisoscope.ink.goniometer import Readings
from anisoscope.sim.light.ink.model import brdf_at_angles
from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink

TRIALS = 100


def places():
    found = []
    for i in (20, 30, 40, 50, 60, 65, 70):
        back = range(-15, 0, 5) if i >= 50 else ()
        found += [(i, o) for o in sorted({*range(0, 76, 5), i, *back})]
    return np.array(found, dtype=float)


def readings(ink, rng=None, noise=0.03, at=None):
    at = places() if at is None else np.array(at, dtype=float)
    value = brdf_at_angles(ink, at[:, 0], at[:, 1])
    if rng is not None:
        value = value * (1 + noise * rng.standard_normal(value.shape))
    count = len(ink.nm)
    angles = np.repeat(at, count, axis=0)
    lines = tuple(range(2, 2 + value.size))
    return Readings(angles[:, 0], angles[:, 1], np.tile(ink.nm, len(at)), value.ravel(), lines)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("name", SYNTHETIC)
def test_without_noise_the_joint_fit_is_exact(name):
    ink = synthetic_ink(name)
    found = fit(readings(ink))
    assert found.alpha == pytest.approx(0.19, rel=1e-9)
    np.testing.assert_allclose(found.rho, ink.rho, rtol=1e-8)
    np.testing.assert_allclose(found.c, ink.c, atol=1e-8)
    assert found.warnings == ()


def test_a_hundred_trials_at_three_percent(rng):
    """The numbers that the fit promises: bias, scatter, and that 2u means what it says."""
    ink = synthetic_ink("synthetic-green")
    fits = [fit(readings(ink, rng)) for _ in range(TRIALS)]
    alpha, u_alpha = (np.array([getattr(one, name) for one in fits]) for name in ("alpha", "u_alpha"))
    rho, c = np.array([one.rho / ink.rho_brdf for one in fits]), np.array([one.c for one in fits])
    assert abs(np.mean(alpha) / 0.19 - 1) < 2e-4
    assert rms(alpha / 0.19 - 1) < 1e-3
    assert rms(rho - 1) < 0.01
    assert rms(c - ink.c_values) < 0.03
    inside_rho = np.abs(rho - 1) < 2 * np.array([one.u_rho / ink.rho_brdf for one in fits])
    inside_c = np.abs(c - ink.c_values) < 2 * np.array([one.u_c for one in fits])
    assert 0.87 < np.mean(np.abs(alpha - 0.19) < 2 * u_alpha) <= 1.0  # 100 draws: 95 ± 2 of them
    assert 0.90 < np.mean(inside_rho) < 0.98
    assert 0.90 < np.mean(inside_c) < 0.98


@pytest.mark.parametrize(("angle_deg", "level"), [(0.3, 0.0), (0.0, 0.02)])
def test_errors_that_a_place_shares_count_in_u_of_alpha(rng, angle_deg, level):
    """All wavelengths of a place share its angles and level; from single readings alone 40 % would lie within 2u."""
    ink, at = synthetic_ink("synthetic-green"), places()
    inside = []
    for _ in range(40):
        off = at + angle_deg * rng.standard_normal(at.shape)
        shared = 1 + level * rng.standard_normal((len(at), 1))
        value = shared * brdf_at_angles(ink, off[:, 0], off[:, 1])
        value = value * (1 + 0.03 * rng.standard_normal(value.shape))
        found = fit(replace(readings(ink, at=at), value=value.ravel()))
        inside.append(abs(found.alpha - 0.19) < 2 * found.u_alpha)
    assert np.mean(inside) >= 0.85  # 40 draws: 95 ± 3.4 % of them


def test_a_place_whose_only_reading_is_left_out_is_no_place():
    """One reading at a wavelength of its own: too few there, and nothing else at its angles."""
    ink = synthetic_ink("synthetic-red")
    some = readings(ink)
    more = Readings(
        np.append(some.theta_i_deg, 20.0), np.append(some.theta_o_deg, 80.0), np.append(some.wavelength_nm, 785.0),
        np.append(some.value, 0.01), (*some.lines, 9999),
    )  # fmt: skip
    for method in ("joint", "paper"):
        plain, found = fit(some, method), fit(more, method)
        assert np.isfinite(found.grid.value).any(axis=1).all()
        assert found.alpha == pytest.approx(plain.alpha, rel=1e-12)
        assert [one.line for one in found.grid.dropped if "too few" in one.reason] == [9999]


def test_the_published_two_steps_are_biased(rng):
    """Without noise α is off by about 1 % and ρ by more; at 3 % its ρ and c scatter 4 times as much."""
    ink = synthetic_ink("synthetic-green")
    exact = fit(readings(ink), "paper")
    assert 0.005 < abs(exact.alpha / 0.19 - 1) < 0.015
    assert rms(exact.rho / ink.rho_brdf - 1) > 0.01
    assert {one.reason for one in exact.grid.dropped} == {"angle left out"}
    pairs = [(fit(one), fit(one, "paper")) for one in (readings(ink, rng) for _ in range(8))]
    ours, theirs = zip(*pairs, strict=True)
    assert rms([one.c - ink.c_values for one in theirs]) > 3 * rms([one.c - ink.c_values for one in ours])
    errors = [rms([one.rho / ink.rho_brdf - 1 for one in group]) for group in (ours, theirs)]
    assert errors[1] > 4 * errors[0]


def test_steps_two_of_the_published_fit_alone_is_exact():
    """With c = 0 nothing skews the lobe: then also the published way finds α."""
    ink = synthetic_ink("synthetic-blue")
    flat = replace(ink, c=(0.0,) * 41)
    found = fit(readings(flat), "paper")
    assert found.alpha == pytest.approx(0.19, rel=1e-5)
    np.testing.assert_allclose(found.rho, flat.rho, rtol=1e-4)


def test_dark_noise_is_weighed_and_dropped(rng):
    """Additive noise of 0.1 % of the largest reading, told as the floor: α stays within 0.2 %."""
    ink = synthetic_ink("synthetic-red")
    true = readings(ink)
    dark = 1e-3 * true.value.max()
    noisy = true.value * (1 + 0.03 * rng.standard_normal(true.value.shape)) + dark * rng.standard_normal(
        true.value.shape
    )
    found = fit(
        Readings(true.theta_i_deg, true.theta_o_deg, true.wavelength_nm, noisy, true.lines), floor=dark
    )
    assert found.alpha == pytest.approx(0.19, rel=2e-3)
    dropped = found.grid.dropped
    assert len(dropped) == np.count_nonzero(noisy <= 3 * dark)
    assert any(one.value <= 0.0 for one in dropped)
    assert f"{len(dropped)} readings dropped: {len(dropped)} near the noise floor" in found.warnings
    assert noisy[dropped[0].line - 2] == dropped[0].value


def test_readings_in_any_order_and_twice(rng):
    ink = synthetic_ink("synthetic-red")
    one = readings(ink, rng)
    order = rng.permutation(len(one.value))
    shuffled = Readings(
        one.theta_i_deg[order], one.theta_o_deg[order], one.wavelength_nm[order], one.value[order],
        tuple(int(n) for n in order),
    )  # fmt: skip
    first, second = fit(one), fit(shuffled)
    assert second.alpha == pytest.approx(first.alpha, rel=1e-9)
    twice = Readings(*(np.concatenate([part, part]) for part in (
        one.theta_i_deg, one.theta_o_deg, one.wavelength_nm, one.value)), one.lines * 2)  # fmt: skip
    doubled = fit(twice)
    assert doubled.alpha == pytest.approx(first.alpha, rel=1e-6)
    assert doubled.u_alpha == pytest.approx(first.u_alpha / np.sqrt(2), rel=0.02)


def test_weak_coverage_is_told(rng):
    ink = synthetic_ink("synthetic-red")
    narrow = fit(readings(ink, rng, at=[(i, i + d) for i in (20, 40, 60) for d in (-6, 0, 6)]))
    assert any("half angles end at 3°" in one for one in narrow.warnings)
    same = fit(readings(ink, rng, at=[(i, o) for i in (30, 34) for o in range(0, 75, 5)]))
    steady = fit(readings(ink, rng, at=[(45, 45), (44, 45), (40, 50), (35, 55.5), (46, 45)]))
    assert any("c is known to no better" in one for one in steady.warnings)
    assert not any("weak" in one for one in same.warnings)
    outside = fit(readings(ink, rng, at=[(i, i - d) for i in (40, 50, 60) for d in (30, 40)]))
    assert any("no reading lies within the lobe" in one for one in outside.warnings)


def test_a_lobe_that_is_not_the_models_is_told():
    ink = replace(synthetic_ink("synthetic-red"), distribution="beckmann")
    assert any("exceed twice the noise" in one for one in fit(readings(ink), floor=1e-4).warnings)


def test_with_a_stated_noise_beckmanns_lobe_and_a_matte_print_are_found(rng):
    red = synthetic_ink("synthetic-red")
    own = fit(readings(red, rng), noise=0.03)
    assert (own.fits, own.distribution, len(own.tests)) == (True, "ggx", 1)
    bell = fit(readings(replace(red, distribution="beckmann"), rng), noise=0.03, floor=1e-4)
    assert (bell.fits, bell.distribution, bell.ink("bell").distribution) == (True, "beckmann", "beckmann")
    assert abs(bell.alpha - 0.19) < 3.0 * bell.u_alpha
    dull = readings(red, at=places())
    flat = replace(dull, value=0.1 * (1.0 + 0.03 * rng.standard_normal(len(dull.value))))
    matte = fit(flat, noise=0.03)
    assert (matte.fits, matte.alpha) == (True, 1.0)
    np.testing.assert_allclose(matte.rho, 0.4 * np.pi, rtol=0.1)


def test_paper_below_the_flakes_is_a_base(rng):
    """Of a reflectance of 20 % for red, which adds R/π everywhere; the ink that is made of the fit has it."""
    red, sheet = synthetic_ink("synthetic-red"), np.linspace(0.05, 0.35, 41)
    noise = 1.0 + 0.02 * rng.standard_normal((len(places()), 41))
    at = places()
    value = noise * (brdf_at_angles(red, at[:, 0], at[:, 1]) + sheet / np.pi)
    found = fit(replace(readings(red), value=value.ravel()), noise=0.02)
    assert found.fits
    (paper,) = found.base
    assert (paper.name, paper.alpha) == ("paper", 1.0)
    np.testing.assert_allclose(paper.rho / 4.0, sheet, rtol=0.08)
    assert abs(found.alpha - 0.19) < 4.0 * found.u_alpha
    assert abs(found.distribution - 1.0) < 0.1
    ink = found.ink("on paper")
    np.testing.assert_allclose(brdf_at_angles(ink, 30.0, -70.0), sheet / np.pi, rtol=0.15)


def test_an_ink_that_no_model_describes_is_rejected(rng, anisoscope, tmp_path):
    """A lobe with rings."""
    red = synthetic_ink("synthetic-red")
    both = readings(red, rng)
    half = np.abs(both.theta_i_deg - both.theta_o_deg) / 2.0
    both = replace(both, value=both.value * (1.0 + 0.4 * np.cos(np.radians(36.0 * half))))
    columns = both.theta_i_deg, both.theta_o_deg, both.wavelength_nm, both.value
    rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
    (tmp_path / "red.csv").write_text(
        "\n".join(["theta_i_deg,theta_o_deg,wavelength_nm,value", *rows]) + "\n"
    )
    arguments = "ink", "fit", tmp_path / "red.csv", "--values", "brdf"
    done = anisoscope(*arguments, "--u-reading", 0.03)
    assert done.code == 3, done.err
    assert "the model is rejected" in " ".join(done.out.split())
    assert " ± " not in done.out
    assert anisoscope(*arguments).code == 0  # without a noise only the warning


def test_a_bright_ink_is_told(rng):
    ink = synthetic_ink("synthetic-red")
    bright = replace(ink, rho=tuple(4 * value for value in ink.rho))
    assert any("albedo exceeds 1" in one for one in fit(readings(bright, rng)).warnings)


@pytest.mark.parametrize(
    ("at", "method", "words"),
    [
        ([(30, 30), (30, 30), (30, 30)], "joint", "does not tell rho from c"),
        ([(20, 20), (40, 40), (60, 60)], "joint", "how wide the lobe is"),
        ([(20, 20), (40, 40)], "joint", "3 readings"),
        ([(20, 10), (20, 20), (20, 30)], "paper", "mirror direction"),
        ([(20, 20), (40, 40), (60, 60)], "paper", "away from the mirror direction"),
        ([(20, 10), (20, 20), (20, 20), (20, 20), (20, 30)], "paper", "three angles"),
    ],
)
def test_too_little_to_fit_is_refused(at, method, words):
    with pytest.raises(UsageError, match=words):
        fit(readings(synthetic_ink("synthetic-red"), at=at), method)


def test_nonsense_is_refused(rng):
    some = readings(synthetic_ink("synthetic-red"))
    with pytest.raises(UsageError, match="share in 0 to 1"):
        fit(some, noise=3.0)
    with pytest.raises(UsageError, match="noise floor must"):
        fit(some, floor=1e9)
    dark = Readings(some.theta_i_deg, some.theta_o_deg, some.wavelength_nm, -some.value, some.lines)
    with pytest.raises(UsageError, match="above 0"):
        fit(dark)
