"""What all ridges of a map share: effects that no scatter between ridges shows."""

import importlib.util
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import grey_dilation

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridges import measure_ridges

SPEC = importlib.util.spec_from_file_location("shared_effects", Path(__file__).with_name("shared_effects.py"))
effects = importlib.util.module_from_spec(SPEC)
sys.modules[SPEC.name] = effects
SPEC.loader.exec_module(effects)
Case, draw, usual, within = effects.Case, effects.draw, effects.usual, effects.within

OF_SIGMA = np.pi * np.sqrt(2.0 / np.log(2.0))
"""Lateral period limit over σ: exp(−2π²σ²/D²) = 1/2."""


def measured(case, period_limit_um=None):
    heights, truth = draw(case)
    return measure_ridges(HeightMap(heights, 1.0, 1.0), period_limit_um), truth


def remarks(found, words):
    return any(words in one for one in found.remarks())


def some(low, high):
    return lambda rng: float(rng.uniform(low, high))


def either(low, high):
    return lambda rng: float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


# what is drawn, words of the remark that tells of it, what covers it, and results that nothing on a map can cover
EFFECTS = {
    "none": ({}, None, "scatter between ridges, and the grid", ()),
    "tilt": (
        {"tilt": either(0.5, 3.0), "tilt_along": either(0.0, 1.0)},
        None,
        "angles are against the surface; `surface_pitch_um`",
        (),
    ),
    "drift along rows": (
        {"row_step": some(0.01, 0.1)},
        "lines of the scan|along the ridges",
        "`line_drift_um` is taken off alpha; `lay_um`, where rows run along the ridges, is in its u",
        (),
    ),
    "drift along columns": (
        {"column_step": some(0.01, 0.05)},
        "lines of the scan|along the ridges",
        "the same",
        (),
    ),
    "rounded heights": (
        {"rounded": some(0.02, 1.5)},
        "rounded to",
        "`height_step_um`; u of angle and alpha, or alpha withheld",
        (),
    ),
    "lateral scale": (
        {"lateral": lambda rng: 1.0 + either(0.001, 0.005)(rng)},
        None,
        "calibration of the axes",
        ("pitch", "angle"),
    ),
    "height scale": (
        {"vertical": lambda rng: 1.0 + either(0.005, 0.02)(rng)},
        None,
        "calibration of the axes",
        ("angle", "height", "wall", "alpha"),
    ),
    "orthogonality": (
        {"shear": either(0.1, 0.5)},
        None,
        "calibration of the axes",
        ("pitch", "direction", "angle"),
    ),
    "form": ({"bow": either(0.3, 3.0)}, "form of", "`form_um` is taken off", ()),
    "foot radius": ({"foot": some(0.2, 0.8)}, None, "`foot_radius_um`, `foot_loss`", ()),
    "crest radius": ({"crest": some(0.2, 0.8)}, None, "`edge_radius_um`, `height_loss`", ()),
    "lateral resolution": (
        {"blur": some(0.4, 2.0)},
        "period limit",
        "`seen_limit_um`; u of what it changes",
        (),
    ),
    "the same, given": ({"blur": some(0.4, 2.0)}, None, "`--period-limit` is taken off", ()),
    "period ambiguity": (
        {"lower": some(0.1, 0.7)},
        None,
        "half, third and double pitch are tried; ridges that alternate by a tenth of their height are pairs",
        (),
    ),
    "gaps": (
        {"missing": some(0.1, 0.3), "lost_columns": some(0.1, 0.4)},
        None,
        "missing points have no weight",
        (),
    ),
    "stitching": (
        {"fields": lambda _: 3, "field_step": some(0.1, 0.5), "field_shift": some(0.1, 0.5)},
        "strips of the map",
        "`strip_um`; u of pitch and direction",
        (),
    ),
}
RESULTS = {
    "pitch": ("pitch_um",),
    "direction": ("direction_deg",),
    "angle": ("ridge_angle_deg",),
    "height": ("height_um",),
    "wall": ("wall_angle_deg",),
    "radii": ("edge_radius_um", "foot_radius_um"),
    "alpha": ("alpha_along", "alpha_across"),
}
MAPS = 20
PAGE = Path(__file__).parents[3] / "docs" / "evidence" / "ridges.md"
BEGIN, END = (
    "<!-- common effects: written by the soak test of this name -->\n",
    "<!-- end of common effects -->",
)
NOT_COVERED = "not covered"


def statements(name, seed):
    """Which numbers of one map hold the truth, by result, and whether the effect is told; (values, held) each."""
    what, words, _, _ = EFFECTS[name]
    rng = np.random.default_rng([seed, list(EFFECTS).index(name)])
    case = usual(100 * list(EFFECTS).index(name) + seed, **{key: value(rng) for key, value in what.items()})
    heights, truth = draw(case)
    limit = OF_SIGMA * case.blur if name == "the same, given" else None
    found = measure_ridges(HeightMap(heights, 1.0, 1.0), limit).stated()
    held = {
        result: [within(getattr(found, number), truth[number]) for number in numbers]
        for result, numbers in RESULTS.items()
    }
    return held, words is not None and any(re.search(words, one) for one in found.remarks())


def table_of_page():
    """(effects) cells of the table of the page."""
    text = PAGE.read_text(encoding="utf-8")
    rows = text[text.index(BEGIN) + len(BEGIN) : text.index(END)].splitlines()
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_page_says_of_every_effect_and_result_how_it_is_covered():
    head, _, *rows = table_of_page()
    assert head == ["effect", "covered by", *RESULTS]
    assert [row[:2] for row in rows] == [[name, how] for name, (_, _, how, _) in EFFECTS.items()]
    for row in rows:
        _, _, _, hopeless = EFFECTS[row[0]]
        for result, cell in zip(RESULTS, row[2:], strict=True):
            assert (cell == NOT_COVERED) == (result in hopeless), (row[0], result)
            assert cell == NOT_COVERED or re.fullmatch(r"\d+ %(, told)?", cell)


@pytest.mark.parametrize("name", ["period ambiguity", "stitching"])
def test_a_map_of_an_effect_holds_what_the_page_says(name):
    held, told = statements(name, 0)
    for result, each in held.items():
        assert all(each) or told, result


@pytest.mark.soak
def test_common_effects_on_three_hundred_maps():
    """Writes the table of the page with ANISOSCOPE_WRITE_DOCS: shares of numbers within 2 u."""
    rows = [["effect", "covered by", *RESULTS], ["---"] * (2 + len(RESULTS))]
    short = []
    for name, (_, _, how, hopeless) in EFFECTS.items():
        count = {result: [0, 0, 0] for result in RESULTS}  # numbers, those held, those held or told
        for seed in range(MAPS):
            try:
                held, told = statements(name, seed)
            except HeightMapError:  # too rough for its ridges, or too coarse: nothing is stated
                continue
            for result, each in held.items():
                count[result][0] += len(each)
                count[result][1] += sum(each)
                count[result][2] += len(each) if told else sum(each)
        row = [name, how]
        for result, (numbers, good, known) in count.items():
            assert numbers > 0.8 * MAPS
            due, share = int(0.95 * numbers), f"{good / numbers:.0%}".replace("%", " %")
            row.append(NOT_COVERED if result in hopeless else share if good >= due else f"{share}, told")
            if known < due and result not in hopeless:
                short.append((name, result, good, known, numbers))
        rows.append(row)
    if "ANISOSCOPE_WRITE_DOCS" in os.environ and not short:
        text = PAGE.read_text(encoding="utf-8")
        table = "".join("| " + " | ".join(row) + " |\n" for row in rows)
        PAGE.write_text(
            text[: text.index(BEGIN) + len(BEGIN)] + table + text[text.index(END) :], encoding="utf-8"
        )
    assert not short, rows


@pytest.mark.parametrize("step_um", [pytest.param(0.02, marks=pytest.mark.soak), 0.1])
def test_lines_that_drift_are_taken_off_alpha(step_um):
    found, truth = measured(Case(1, row_step=step_um))
    assert within(found.alpha_along, truth["alpha_along"], 2.5)
    assert within(found.alpha_across, truth["alpha_across"], 2.5)
    assert found.line_drift_um == pytest.approx(step_um, rel=0.2)
    assert remarks(found, "lines of the scan")


def test_steps_along_the_ridges_are_told():
    found, truth = measured(Case(2, column_step=0.07))
    assert found.lay_um == pytest.approx(0.07, rel=0.3)
    assert remarks(found, "along the ridges")
    assert within(found.alpha_along, truth["alpha_along"], 2.5)


@pytest.mark.parametrize("step_um", [0.1, 1.4])
def test_rounded_heights_widen_alpha_or_withhold_it(step_um):
    found, truth = measured(Case(3, rounded=step_um))
    for name in ("alpha_along", "alpha_across", "ridge_angle_deg", "height_um", "wall_angle_deg"):
        assert within(getattr(found, name), truth[name], 2.5)
    assert found.height_step_um in (0.0, pytest.approx(step_um))
    if step_um > 1.0:
        assert found.alpha_along.value is None
        assert remarks(found, "rounded")


def test_facets_of_two_heights_have_a_pitch_and_no_angle():
    found, truth = measured(replace(usual(2), rounded=12.0))
    assert found.pitch_um.value == pytest.approx(truth["pitch_um"], abs=3.0 * found.pitch_um.u)
    assert found.stated().ridge_angle_deg.value is None
    assert remarks(found, "rounded to steps of 12 µm")


@pytest.mark.parametrize(("length", "noise"), [(1.0, 0.005), (2.4, 0.05)])
def test_roughness_of_less_than_three_pixels_is_no_noise(length, noise):
    found, truth = measured(Case(4, length=length, noise=noise))
    assert within(found.alpha_along, truth["alpha_along"], 2.5)
    assert within(found.alpha_across, truth["alpha_across"], 2.5)
    assert remarks(found, "three pixels") or found.alpha_along.u < 0.02 * truth["alpha_along"]


def test_a_rounded_foot_has_a_radius_and_takes_from_the_height():
    heights, truth = draw(Case(5, wall=70.0, foot=6.0))
    found = measure_ridges(HeightMap(heights, 1.0, 1.0))
    assert within(found.height_um, truth["height_um"], 2.5)
    assert within(found.foot_radius_um, 6.0, 2.5)
    assert found.foot_loss.value > 3.0 * found.foot_loss.u
    turned = measure_ridges(HeightMap(-heights, 1.0, 1.0))  # what was the foot is the crest
    assert turned.edge_radius_um.value == pytest.approx(found.foot_radius_um.value, rel=0.02)
    assert turned.height_loss.value == pytest.approx(found.foot_loss.value, rel=0.02)
    assert turned.height_um.value == pytest.approx(found.height_um.value, rel=5e-3)


@pytest.mark.parametrize("end", ["crest", pytest.param("foot", marks=pytest.mark.soak)])
def test_a_radius_of_more_than_ten_pixels_is_measured(end):
    found, truth = measured(Case(9, pitch=90.0, angle=14.0, wall=70.0, **{end: 15.0}))
    for name in ("edge_radius_um", "foot_radius_um", "wall_angle_deg", "height_um"):
        assert within(getattr(found, name), truth[name], 2.5)
    radius = found.edge_radius_um if end == "crest" else found.foot_radius_um
    assert radius.u < 1.0
    assert found.wall_angle_deg.u < 4.0


@pytest.mark.parametrize("blur", [pytest.param(1.0, marks=pytest.mark.soak), 2.0])
def test_blur_is_taken_off_where_the_period_limit_is_given_and_else_told(blur):
    heights, truth = draw(Case(10, direction=17.0, wall=76.0, blur=blur))
    surface = HeightMap(heights, 1.0, 1.0)
    names = ("wall_angle_deg", "height_um", "edge_radius_um", "foot_radius_um", "alpha_along", "alpha_across")
    given, without = measure_ridges(surface, OF_SIGMA * blur), measure_ridges(surface)
    for name in names:
        assert within(getattr(given, name), truth[name], 2.5), name
        assert within(getattr(without, name), truth[name], 2.5), name
    assert given.alpha_along.u < without.alpha_along.u
    assert given.period_limit_um == pytest.approx(OF_SIGMA * blur)
    assert not remarks(given, "period limit")
    assert without.seen_limit_um == pytest.approx(OF_SIGMA * blur, rel=0.2)
    assert remarks(without, "period limit")


def test_a_period_limit_that_leaves_no_ridges_is_refused():
    heights, _ = draw(Case(10))
    with pytest.raises(UsageError, match="half of the pitch"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), 40.0)
    with pytest.raises(UsageError, match="at least 0"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), -1.0)


def under_tip(monkeypatch, tip):
    """Outlines as a disk of a radius scans them: their dilation, at steps of a fiftieth of a pixel."""
    plain = effects.outline

    def outline(case):
        x, z, height = plain(case)
        reach = int(tip / (step := case.pitch / effects.FINE))
        ball = np.sqrt(np.maximum(tip**2 - (np.arange(-reach, reach + 1) * step) ** 2, 0.0)) - tip
        return x, grey_dilation(z, footprint=np.ones(ball.shape), structure=ball, mode="wrap"), height

    monkeypatch.setattr(effects, "outline", outline)


@pytest.mark.parametrize(
    ("tip", "crest", "foot"),
    [
        (4.0, 0.0, 5.0),
        (6.0, 3.0, 9.0),
        *(pytest.param(tip, crest, foot, marks=pytest.mark.soak)
          for tip in (2.0, 4.0, 6.0) for crest in (0.0, 3.0, 6.0) for foot in (0.0, 4.0, 10.0)),
    ],
)  # fmt: skip
def test_a_round_tip_is_taken_off(monkeypatch, tip, crest, foot):
    under_tip(monkeypatch, tip)
    heights, truth = draw(Case(11, direction=17.0, wall=72.0, crest=crest, foot=foot))
    found = measure_ridges(HeightMap(heights, 1.0, 1.0), tip_radius_um=tip)
    for name in ("ridge_angle_deg", "wall_angle_deg", "height_um", "edge_radius_um", "foot_radius_um"):
        assert within(getattr(found, name), truth[name], 2.5), name
    if (crest, foot) == (3.0, 9.0):
        assert found.height_um.u < 0.2
        assert found.foot_radius_um.known
        assert found.edge_radius_um.known
    with pytest.raises(UsageError, match="no tip shows a crest sharper than itself"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), tip_radius_um=tip + 10.0)
    with pytest.raises(UsageError, match="in place of a lateral period limit"):
        measure_ridges(HeightMap(heights, 1.0, 1.0), 4.0, tip_radius_um=tip)


def test_ridges_that_change_along_their_length_are_told():
    z, steep = draw(Case(6))[0], draw(Case(6, angle=12.0))[0]
    z[len(z) // 2 :] = steep[len(z) // 2 :]
    found = measure_ridges(HeightMap(z, 1.0, 1.0))
    assert found.varies_along
    assert remarks(found, "not the same along")
    ends = [one.angle_deg.value for one in (found.segments[0], found.segments[-1])]
    assert ends == pytest.approx([10.0, 12.0], abs=0.1)
    same, _ = measured(Case(7))
    assert not same.varies_along
    assert same.remarks() == ()


@pytest.mark.parametrize("tilt", [pytest.param(0.0, marks=pytest.mark.soak), 3.0])
def test_the_pitch_on_a_tilted_surface(tilt):
    found, truth = measured(Case(8, tilt=tilt))
    assert found.surface_pitch_um.value == pytest.approx(70.0, abs=3.0 * found.surface_pitch_um.u)
    assert found.pitch_um.value == pytest.approx(truth["pitch_um"], abs=3.0 * found.pitch_um.u)
