"""Attribute agreement: the AIAG example, another program's example, an independent library, and intervals that hold."""

import math

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.attribute import (
    AttributeData,
    attribute_study,
    cohen,
    decisions_of_history,
    fleiss,
    read_decisions,
)
from anisoscope.quality.readings import Readings


def data_of(decisions, reference, values=None):
    parts, appraisers, _ = decisions.shape
    return AttributeData(
        tuple(map(str, range(parts))), tuple("ABCDE"[:appraisers]), decisions, reference, values
    )


@pytest.fixture(scope="module")
def aiag(published):
    return attribute_study(data_of(*published.aiag_attribute), tolerance=0.1)


def test_aiag_tables_of_pairs_and_kappas(aiag):
    """MSA 4th edition, III-C: cross tables of 150 decisions and kappas as printed."""
    assert {one.first + one.second: one.table for one in aiag.pairs} == {
        "AB": (44, 6, 3, 97),
        "AC": (43, 7, 8, 92),
        "BC": (42, 5, 9, 94),
    }
    assert [round(one.kappa.value, 2) for one in aiag.pairs] == [0.86, 0.78, 0.79]
    assert [round(one.with_reference.kappa.value, 2) for one in aiag.appraisers] == [0.88, 0.92, 0.77]


def test_aiag_table_of_effectiveness(aiag):
    """The same: matched parts, their scores and 95 % limits in whole percent; system scores 78 %, 64 to 89 %."""
    found = [(one.effectiveness, one.consistent) for one in aiag.appraisers]
    assert [(own.count, same.count) for own, same in found] == [(42, 42), (45, 45), (40, 40)]
    ends = [(100 * own.low, 100 * own.high) for own, _ in found]
    assert [(round(low), round(high)) for low, high in ends] == [(71, 93), (78, 97), (66, 90)]
    for whole in (aiag.all_agree, aiag.all_right):
        assert (whole.count, round(100 * whole.value), round(100 * whole.low)) == (39, 78, 64)
        assert 100 * whole.high == pytest.approx(89, abs=0.6)  # 88.5, printed as 89


def test_aiag_table_of_misses_and_false_alarms(aiag):
    """The same: 6.3 and 4.9 %, 6.3 and 2.0 %, 12.5 and 8.8 %."""
    rates = [(100 * one.miss.value, 100 * one.false_alarm.value) for one in aiag.appraisers]
    assert np.array(rates) == pytest.approx(np.array([[6.3, 4.9], [6.3, 2.0], [12.5, 8.8]]), abs=0.0501)
    assert [one.rating for one in aiag.appraisers] == ["unacceptable"] * 3
    assert not aiag.acceptable
    assert "kappa 0.77 at least (C)" in aiag.verdict


def test_aiag_signal_detection(aiag):
    """The same, and figure 6 of ISO 22514-7:2012: d 0.024135 and 0.023448, mean 0.0237915, 24 % of the tolerance."""
    zone = aiag.zone
    assert zone.upper[0] - zone.upper[1] == pytest.approx(0.023448, abs=5e-7)
    assert zone.lower[0] - zone.lower[1] == pytest.approx(0.024135, abs=5e-7)
    assert (zone.width, zone.share) == (pytest.approx(0.0237915, abs=5e-8), pytest.approx(0.24, abs=0.005))
    assert zone.uncertainty == zone.width / 2


def test_fifteen_parts_of_another_program():
    """Example of JASP's module for quality control: Cohen with the standard, Fleiss within, and exact intervals."""
    differing = {
        3: "100100111",
        5: "111111111",
        6: "111000111",
        7: "000000001",
        8: "000000100",
        10: "000000101",
    }
    differing |= {1: "000000111", 13: "000000000"}
    reference = np.array([1, 0, 1, 1, 1, 0, 1, 0, 0, 1, 0, 1, 1, 1, 1])
    texts = [differing.get(part, "1" * 9) for part in range(15)]
    decisions = np.array([[int(one) for one in text] for text in texts]).reshape(15, 3, 3)
    study = attribute_study(data_of(decisions, reference))
    kappas = [one.with_reference.kappa.value for one in study.appraisers]
    assert kappas == pytest.approx([0.612903225806452, 0.492307692307692, 0.264150943396226])
    within = [one.within.value for one in study.appraisers]
    assert within == pytest.approx([0.905462184873949, 0.91, 0.543918918918919])
    assert study.among.value == pytest.approx(0.641666666666666)
    effective = [one.effectiveness for one in study.appraisers]
    assert [(one.low, one.high) for one in effective] == [
        (pytest.approx(low, abs=5e-6), pytest.approx(high, abs=5e-6))
        for low, high in [(0.51911, 0.95669), (0.449, 0.92213), (0.32287, 0.83664)]
    ]
    assert (study.all_agree.count, study.all_right.count) == (9, 7)


def random_decisions(rng, parts=60, appraisers=3, trials=3, hit=0.9):
    reference = (rng.random(parts) < 0.6).astype(int)
    right = rng.random((parts, appraisers, trials)) < hit
    return np.where(right, reference[:, None, None], 1 - reference[:, None, None]), reference


@pytest.fixture(scope="module")
def library():
    """Kappas of others; importing them takes a second, which tests of other things need not wait for."""
    from statsmodels.stats import inter_rater

    return inter_rater


def test_kappas_are_those_of_an_independent_library(rng, library):
    decisions, _ = random_decisions(rng, 40, 4, 1)
    raters = decisions[:, :, 0]
    assert fleiss(raters) == pytest.approx(
        library.fleiss_kappa(library.aggregate_raters(raters)[0]), abs=1e-12
    )
    table = np.array([[20, 5], [10, 15]])
    assert cohen(table) == pytest.approx(library.cohens_kappa(table).kappa, abs=1e-12)


def test_intervals_of_single_trials_approach_the_asymptotic_ones(rng, library):
    """Of 4000 parts judged once, the jackknife has the standard error of Fleiss, Cohen and Everitt (1969)."""
    decisions, reference = random_decisions(rng, 4000, 1, 1, 0.85)
    study = attribute_study(data_of(decisions, reference))
    pair = study.appraisers[0].with_reference
    other = library.cohens_kappa(np.array(pair.table).reshape(2, 2))
    assert (pair.kappa.low, pair.kappa.high) == pytest.approx((other.kappa_low, other.kappa_upp), abs=1e-3)


@pytest.mark.parametrize(
    ("studies", "low"), [(100, 0.85), pytest.param(1500, 0.91, marks=pytest.mark.statistics)]
)
def test_intervals_of_kappa_hold_where_trials_of_a_part_depend_on_each_other(rng, studies, low):
    """Difficult parts: trials of one part agree more than chance, and the interval over parts still holds.

    It holds in 93.3 ± 1 %; limits are 3.3 standard deviations of a hundred and of 1500 studies below.
    """

    def drawn(count):
        reference = (rng.random(count) < 0.5).astype(int)
        hit = rng.beta(2.0, 0.4, count)
        right = rng.random((count, 1, 3)) < hit[:, None, None]
        return np.where(right, reference[:, None, None], 1 - reference[:, None, None]), reference

    truth = 2.0 * 2.0 / 2.4 - 1.0  # balanced reference: kappa is twice the mean hit rate less 1
    hits = 0
    for _ in range(studies):
        found = attribute_study(data_of(*drawn(60))).appraisers[0].with_reference.kappa
        hits += found.low <= truth <= found.high
    assert hits / studies >= low


def test_perfect_agreement_and_its_absence(rng):
    decisions, reference = random_decisions(rng, hit=1.0)
    study = attribute_study(data_of(decisions, reference))
    assert study.acceptable
    assert study.among.value == study.among.high == 1.0
    assert study.appraisers[0].rating == "acceptable"
    all_good = attribute_study(data_of(np.ones_like(decisions), reference))
    assert math.isnan(all_good.among.value)
    assert as_json(all_good)["among"]["value"] is None
    assert not all_good.acceptable


def test_a_one_sided_limit_has_one_zone(published):
    decisions, reference, values = published.aiag_attribute
    upper = values > 0.5
    study = attribute_study(data_of(decisions[upper], reference[upper], values[upper]), 0.1)
    assert study.zone.lower is None
    assert study.zone.width == pytest.approx(0.023448)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"reference": np.ones(50, dtype=int)}, "good and bad parts"),
        ({"tolerance": -1.0}, "finite width"),
        ({"confidence": 1.0}, "between 0.5 and 1"),
    ],
)
def test_what_carries_no_attribute_study_is_refused(published, change, word):
    decisions, reference, _ = published.aiag_attribute
    with pytest.raises(UsageError, match=word):
        attribute_study(
            data_of(decisions, change.get("reference", reference)),
            change.get("tolerance"),
            change.get("confidence", 0.95),
        )


HEADER = "part,appraiser,decision,reference,value\n"


def test_a_file_of_decisions_is_read(tmp_path):
    path = tmp_path / "d.csv"
    rows = [
        (p, a, ("good", "0")[p % 2], ("1", "BAD")[p % 2], 0.5 * p)
        for p in range(4)
        for a in "AB"
        for _ in "12"
    ]
    path.write_text(HEADER + "".join(",".join(map(str, row)) + "\n" for row in rows))
    found = read_decisions(path)
    assert found.decisions.shape == (4, 2, 2)
    assert found.reference.tolist() == [1, 0, 1, 0]
    assert found.values.tolist() == [0.0, 0.5, 1.0, 1.5]
    path.write_text("part;decision;reference;value\n1;1;1;0,5\n2;0;0;0,7\n")
    assert read_decisions(path).values.tolist() == [0.5, 0.7]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (HEADER, "line 2: no decisions"),
        ("part,decision\n1,1\n", "needs the columns part, appraiser"),
        (HEADER + "1,A,maybe,1,1\n", "line 2: 'maybe' is no decision"),
        (HEADER + "1,A,1,1\n", "line 2: 5 values expected, 4 found"),
        (HEADER + "1,A,1,1,x\n", "must be a finite number, not 'x'"),
        (HEADER + "1,A,1,1,1\n1,A,1,0,1\n", "line 3: part 1 is good in one line and bad in another"),
        (HEADER + "1,A,1,1,1\n1,A,1,1,2\n", "two reference values, 1 and 2"),
        (HEADER + "1,A,1,1,1\n1,B,1,1,1\n2,A,1,0,1\n", "part 2 was judged 0 times by B, others 1 times"),
    ],
)
def test_a_wrong_file_of_decisions_is_refused(tmp_path, text, word):
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=word):
        read_decisions(path)


def test_decisions_of_the_history(tmp_path):
    masters = tmp_path / "m.csv"
    masters.write_text("part,reference\nM1,good\nM2,bad\n")
    serials = ("M1", "M2", "M1", "M2", "S9", "M1")
    verdicts = ("PASS", "FAIL", "PASS", "INCONCLUSIVE", "PASS", "INVALID")
    texts = {"serial": serials, "operator": ("Ada",) * 6, "verdict": verdicts}
    readings = Readings("history", texts, {"x": np.zeros(6)})
    found = decisions_of_history(readings, masters)
    assert found.decisions.tolist() == [[[1, 1]], [[0, 0]]]
    assert found.notes == ("1 INVALID inspections made no decision and are left out",)
    masters.write_text("part,reference\nM1,good\nM3,bad\n")
    with pytest.raises(UsageError, match="part M3 was never inspected"):
        decisions_of_history(readings, masters)
    masters.write_text("part\nM1\n")
    with pytest.raises(UsageError, match="need the columns part and reference"):
        decisions_of_history(readings, masters)


def test_small_studies_say_so(published):
    decisions, reference, _ = published.aiag_attribute
    notes = attribute_study(data_of(decisions[:20, :1, :2], reference[:20])).notes
    assert (
        sum(word in " ".join(notes) for word in ("20 parts", "2 trial", "one appraiser", "hardly known")) == 4
    )
