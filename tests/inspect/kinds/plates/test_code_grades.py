"""Grades of codes: symbols in plans, tables of the standards, and error correction as zxing-cpp counts it."""

import numpy as np
import pytest

from anisoscope.kinds.plates.code_grades import (
    AVERAGE_STEPS,
    AXIAL_STEPS,
    CLOCK_STEPS,
    CONTRAST_STEPS,
    FINDER_STEPS,
    GRID_STEPS,
    MODULATION_STEPS,
    SIDE_STEPS,
    UNUSED_STEPS,
    Cells,
    at_least,
    at_most,
    graded,
)
from anisoscope.kinds.plates.code_symbol import find_symbol, unused_correction
from anisoscope.sim.design.plates import modules_of_code

LIGHT, DARK = 0.27, 0.03


def symbol_of(text="A17", symbology="datamatrix"):
    """A symbol on its plan, class 1 dark."""
    return find_symbol(modules_of_code(text, symbology).astype(np.int64), symbology)


def grades(radiance, symbol, *, read=True, axial=0.0, grid=0.0):
    """Grades by parameter."""
    found = graded(Cells(radiance, 0.985, read, axial, grid), symbol)
    return {one.parameter: one for one in found}


@pytest.mark.parametrize("symbology", ["datamatrix", "qr"])
@pytest.mark.parametrize("text", ["A17", "A17-00-XYZ lot 77", "0123456789" * 12])
def test_symbols_are_found_whichever_class_is_dark(symbology, text):
    dark = modules_of_code(text, symbology)
    for classes in (dark, ~dark):
        found = find_symbol(classes.astype(np.int64), symbology)
        np.testing.assert_array_equal(found.dark, dark)
        fixed = np.any(list(found.segments.values()), axis=0)
        assert not (fixed & found.data).any()
    rng = np.random.default_rng(1)
    assert find_symbol(rng.integers(0, 2, dark.shape), symbology) is None


@pytest.mark.parametrize(
    ("symbology", "text"), [("datamatrix", "A17-00-XYZ lot 77"), ("qr", "A17-00-XYZ lot 77")]
)
def test_every_wrong_data_module_costs_a_codeword_at_most_and_fixed_ones_none(symbology, text):
    symbol = symbol_of(text, symbology)
    places = np.argwhere(symbol.data)
    rng = np.random.default_rng(2)
    for _ in range(20):
        wrong = np.zeros_like(symbol.dark)
        wrong[tuple(places[rng.integers(len(places))])] = True
        assert 0.5 < unused_correction(symbol, wrong) <= 1.0
    fixed = np.any(list(symbol.segments.values()), axis=0)
    assert unused_correction(symbol, fixed) == 1.0
    assert unused_correction(symbol, symbol.data) is None


def test_one_wrong_codeword_of_a_matrix_of_ten_uses_two_of_its_five():
    symbol = symbol_of()  # 10 × 10: three codewords of data and five of correction, which correct two errors
    row, col = np.argwhere(symbol.data)[20]
    wrong = np.zeros_like(symbol.dark)
    wrong[row, col] = True
    assert unused_correction(symbol, wrong) == pytest.approx(0.6)
    shown = np.where(symbol.dark ^ wrong, DARK, LIGHT)
    found = grades(shown, symbol)
    assert found["unused error correction"].value == pytest.approx(0.6)
    assert found["unused error correction"].grade == 3
    # the cell is an erasure at every level: four of five codewords of correction are left
    assert found["cell modulation"].value == 0.0
    assert found["cell modulation"].grade == 4
    assert found["overall grade"].grade == 3


def test_good_cells_have_the_best_grades_also_light_on_dark():
    symbol = symbol_of()
    for light, dark in ((LIGHT, DARK), (DARK, LIGHT)):
        found = grades(np.where(symbol.dark, dark, light), symbol)
        assert {one.grade for one in found.values()} == {4}
        assert found["cell contrast"].value == pytest.approx(1.0 - DARK / LIGHT)
        assert found["minimum reflectance"].value == pytest.approx(np.pi * LIGHT / 0.985)


@pytest.mark.parametrize(
    ("change", "parameter", "grade"),
    [
        ({"light": 0.0398, "dark": 0.03}, "cell contrast", 2),
        ({"light": 0.0153, "dark": 0.001}, "minimum reflectance", 0),
        ({"axial": 0.07}, "axial non-uniformity", 3),
        ({"grid": 0.7}, "grid non-uniformity", 1),
        ({"read": False}, "decode", 0),
    ],
)
def test_each_parameter_bounds_the_overall_grade(change, parameter, grade):
    symbol, change = symbol_of(), dict(change)
    shown = np.where(symbol.dark, change.pop("dark", DARK), change.pop("light", LIGHT))
    found = grades(shown, symbol, **change)
    assert found[parameter].grade == grade
    assert found["overall grade"].grade == min(one.grade for one in found.values()) <= grade


def test_damage_of_the_finder_is_graded_by_sides():
    symbol = symbol_of()
    shown = np.where(symbol.dark, DARK, LIGHT)
    shown[3, 1] = LIGHT  # one of ten modules of the left side: more than 9 %, up to 13 %
    assert grades(shown, symbol)["fixed pattern damage"].grade == 2
    shown[4, 1] = LIGHT
    found = grades(shown, symbol)["fixed pattern damage"]
    assert (found.value, found.grade) == (pytest.approx(0.2), 0)


def test_damage_of_a_qr_code_is_counted_in_its_finders():
    symbol = symbol_of(symbology="qr")
    shown = np.where(symbol.dark, DARK, LIGHT)
    shown[4, 4:6] = LIGHT
    assert grades(shown, symbol)["fixed pattern damage"].grade == 2


def test_tables_are_those_of_the_standards():
    """As makers of verifiers print them: Cognex DataMan 475, VisionPro, Omron V430, NI Vision, and two open ones."""
    for steps, published in (
        (UNUSED_STEPS, {0.63: 4, 0.55: 3, 0.4: 2, 0.3: 1, 0.2: 0}),
        (MODULATION_STEPS, {0.55: 4, 0.45: 3, 0.35: 2, 0.25: 1, 0.1: 0}),
        (CONTRAST_STEPS, {0.31: 4, 0.26: 3, 0.21: 2, 0.16: 1, 0.1: 0}),
        (AVERAGE_STEPS, {4.0: 4, 3.6: 3, 3.0: 2, 2.5: 1, 2.4: 0}),
    ):
        assert {value: int(at_least(value, steps)) for value in published} == published
    for steps, published in (
        (AXIAL_STEPS, {0.06: 4, 0.07: 3, 0.09: 2, 0.11: 1, 0.13: 0}),
        (GRID_STEPS, {0.38: 4, 0.5: 3, 0.63: 2, 0.75: 1, 0.76: 0}),
        (CLOCK_STEPS, {0.10: 4, 0.15: 3, 0.2: 2, 0.25: 1, 0.26: 0}),
        (FINDER_STEPS, {0: 4, 1: 3, 2: 2, 3: 1, 4: 0}),
        (SIDE_STEPS, {0.0: 4, 0.09: 3, 0.13: 2, 0.17: 1, 0.18: 0}),
    ):
        assert {value: int(at_most(value, steps)) for value in published} == published
