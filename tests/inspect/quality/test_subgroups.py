"""Charts of subgroups and of counts: published examples, tables of constants, and how readings form subgroups."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.capability import Specification
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.limits import (
    counted_points,
    deviation_moments,
    given_limits,
    individuals,
    limits_of,
    range_moments,
    subgroup_points,
)
from anisoscope.quality.readings import read_readings
from anisoscope.quality.subgroups import COUNTED, charted_points, repeated, subgroups


def names(count):
    return tuple(map(str, range(1, count + 1)))


def study(groups, chart, settings=None, specification=None):
    points = subgroup_points(list(groups), names(len(groups)), chart)
    return control_study("ring", points, settings or Settings(chart=chart), specification)


def counted(table, chart, **more):
    counts, sizes = (
        np.asarray(table[0], dtype=float),
        np.broadcast_to(np.asarray(table[1], dtype=float), (len(table[0]),)),
    )
    return control_study(
        "x", counted_points(counts, sizes, names(len(counts)), chart), Settings(chart=chart, **more)
    )


def test_constants_are_those_of_published_tables(published):
    """Montgomery, Introduction to Statistical Quality Control, appendix VI, n = 2 to 25, to the printed digit."""
    for n, (c4, d2, d3) in enumerate(published.chart_constants, start=2):
        assert deviation_moments(n)[0] == pytest.approx(c4, abs=5.1e-5)
        assert range_moments(n) == (pytest.approx(d2, abs=5.1e-4), pytest.approx(d3, abs=6e-4))
    (d2, d3), (c4, spread) = range_moments(7), deviation_moments(7)
    limits = [1.0 - 3.0 * d3 / d2, 1.0 + 3.0 * d3 / d2, 1.0 - 3.0 * spread / c4, 1.0 + 3.0 * spread / c4]
    assert limits == pytest.approx([0.076, 1.924, 0.118, 1.882], abs=5e-4)
    assert range_moments(2) == (
        pytest.approx(2.0 / np.sqrt(np.pi)),
        pytest.approx(np.sqrt(2.0 - 4.0 / np.pi)),
    )


def test_piston_rings_by_range_and_by_deviation(published):
    """Montgomery, table 6.3, first 25 samples of 5: as the R package qcc prints them, which has d2 as 2.326."""
    rings = published.piston_rings[:25]
    by_range, by_deviation = (study(rings, chart) for chart in ("xbar-r", "xbar-s"))
    assert by_range.limits.center == pytest.approx(74.00118, abs=5e-6)
    assert by_range.limits.sigma * range_moments(5)[0] / 2.326 == pytest.approx(0.009785039, abs=5e-10)
    assert (by_range.limits.lower, by_range.limits.upper) == pytest.approx((73.98805, 74.0143), abs=5e-6)
    assert by_range.limits.range_center == pytest.approx(0.02276, abs=5e-9)
    assert by_range.limits.range_upper == pytest.approx(0.04812533, abs=2e-6)
    assert by_deviation.limits.sigma == pytest.approx(0.009829977, abs=5e-10)
    assert by_deviation.limits.range_center == pytest.approx(0.009240037, abs=5e-10)
    assert by_deviation.limits.range_upper == pytest.approx(0.019302416, abs=5e-9)
    assert by_deviation.spread.lower.max() == 0.0
    assert "among 25 subgroups" in by_range.verdict
    assert len(by_range.points.single) == 125


def test_limits_of_the_first_samples_judge_later_ones(published):
    """The same, phase II: of samples 26 to 40 the means 37, 38 and 39 lie above the limits of the first 25."""
    found = study(published.piston_rings, "xbar-r", Settings(25, chart="xbar-r"))
    assert np.flatnonzero(found.line.outside).tolist() == [36, 37, 38]
    later = study(published.piston_rings[25:], "xbar-r", Settings(chart="xbar-r", known=found.basis))
    np.testing.assert_array_equal(later.line.upper, found.line.upper[25:])


def test_subgroups_of_unequal_size_have_limits_of_their_own(published):
    """As in the example of qcc twelve values are left out; its sigma is 0.009856701 by weights of one."""
    rings = published.piston_rings.copy()
    gone = np.array([9, 10, 30, 35, 45, 64, 65, 74, 75, 85, 99, 100]) - 1
    rings.ravel()[gone] = np.nan
    found = study(rings[:25], "xbar-r")
    assert found.limits.center == pytest.approx(74.00075, abs=5e-6)
    mean, deviation = found.points.spread_moments()
    each, weight = found.points.within / mean, (mean / deviation) ** 2
    assert each.mean() == pytest.approx(0.009856701, rel=2e-4)
    assert found.limits.sigma == pytest.approx(np.average(each, weights=weight))
    assert (found.limits.upper, found.limits.range_upper) == (None, None)
    sizes = (~np.isnan(rings[:25])).sum(axis=1)
    np.testing.assert_allclose(
        found.line.upper - found.limits.center, 3.0 * found.limits.sigma / np.sqrt(sizes)
    )
    point = as_json(found)["points"][1]
    assert (point["label"], point["size"]) == ("2", 3)


def test_sigma_within_subgroups_is_unbiased_and_has_its_degrees_of_freedom(rng):
    for chart in ("xbar-r", "xbar-s"):
        found = [
            limits_of(subgroup_points([rng.normal(size=n) for n in (2, 3, 5, 8, 12)], names(5), chart))
            for _ in range(1500)
        ]
        sigma = np.array([one.sigma for one in found])
        assert sigma.mean() == pytest.approx(1.0, abs=4.0 * sigma.std() / np.sqrt(1500))
        assert 0.5 / sigma.var() == pytest.approx(found[0].freedom, rel=0.15)
    assert found[0].freedom == pytest.approx(25.0, rel=0.05)  # of a pooled variance: 1 + 2 + 4 + 7 + 11


def test_capability_is_of_single_values_and_sigma_within(published):
    """qcc, process capability of the piston rings between 73.95 and 74.05: Cp 1.703, Cpk 1.663."""
    able = study(published.piston_rings[:25], "xbar-r", specification=Specification(73.95, 74.05)).capability
    assert (able.cp.value, able.cpk.value) == pytest.approx((1.703, 1.663), abs=5e-4)
    assert able.count == 125


def test_orange_juice_cans(published):
    """Montgomery, table 7.1: share of bad cans, samples of 50; as qcc prints it, samples 15 and 23 are above."""
    found = counted((published.orange_juice, 50), "p")
    assert found.limits.center == pytest.approx(0.2313333, abs=5e-8)
    assert (found.limits.lower, found.limits.upper) == pytest.approx((0.05242755, 0.4102391), abs=5e-8)
    assert np.flatnonzero(found.line.outside).tolist() == [14, 22]
    assert "scatter more than by chance (chi-square 85." in " ".join(found.notes)
    kept = np.delete(published.orange_juice, [14, 22])
    assert (counted((kept, 50), "p").limits.lower, counted((kept, 50), "p").limits.upper) == pytest.approx(
        (0.04070284, 0.3892972), abs=5e-8
    )


def test_purchase_orders_with_limits_that_follow_the_number_of_orders(published):
    """Montgomery, table 7.4: mean share 234/2450; limits at 80, 100 and 120 orders; sample 11 alone is above."""
    found = counted(published.purchase_orders, "p")
    assert found.limits.center == pytest.approx(234.0 / 2450.0)
    upper = dict(zip(published.purchase_orders[1].tolist(), found.line.upper.tolist(), strict=True))
    assert [upper[80.0], upper[100.0], upper[120.0]] == pytest.approx([0.194, 0.184, 0.176], abs=6e-4)
    assert np.flatnonzero(found.line.outside).tolist() == [10]
    assert found.limits.upper is None


def test_dyed_cloth(published):
    """Montgomery, table 7.11: defects for each 50 m² on rolls of 8 to 13 such pieces; all within their limits."""
    found = counted(published.dyed_cloth, "u")
    assert found.limits.center == pytest.approx(153.0 / 107.5)
    at = {8.0: (0.16, 2.68), 10.0: (0.29, 2.55), 12.0: (0.39, 2.45), 13.0: (0.43, 2.41)}
    for size, lower, upper in zip(
        published.dyed_cloth[1].tolist(), found.line.lower, found.line.upper, strict=True
    ):
        if size in at:
            assert (lower, upper) == pytest.approx(at[size], abs=0.011)
    assert not found.line.outside.any()
    assert as_json(found)["points"][4]["size"] == 9.5


def test_laney_with_equal_sizes_is_the_chart_of_individual_values(published):
    """Laney 2002: p' limits p ± 3 sigma_p sigma_z are then those of an individuals chart of the shares."""
    shares = published.orange_juice / 50.0
    own = control_study("x", individuals(shares), Settings()).limits
    found = counted((published.orange_juice, 50), "p-laney")
    assert found.limits.upper == pytest.approx(own.upper)
    assert (found.limits.lower, own.lower < 0.0) == (0.0, True)
    assert found.spread.name == "moving range of z"
    assert "scatter more" not in " ".join(found.notes)


@pytest.mark.parametrize("chart", ["p", "u"])
def test_scatter_by_chance_is_called_so_and_more_is_found(rng, chart):
    sizes = rng.integers(100, 400, size=40)
    means = np.full(40, 0.1)
    told = [
        "scatter more" in " ".join(counted((rng.binomial(sizes, rates), sizes), chart).notes)
        for rates in [*[means] * 60, rng.beta(3.0, 27.0, size=40)]
    ]
    assert sum(told[:-1]) <= 4
    assert told[-1]


def test_rules_of_counts_are_the_first_four(published):
    every = counted((published.orange_juice, 50), "p", rules=(1, 2, 3, 4, 5, 6))
    assert {flag.rule for flag in every.flags} - {
        flag.rule for flag in counted((published.orange_juice, 50), "p").flags
    }


READINGS = """time,serial,lot,cavity,verdict,height,marks,looked,deviation a,tolerance a
2026-11-01 08:00,A1,L1,1,PASS,1.0,2,10,0.1,0.2
2026-11-01 09:00,A2,L1,2,FAIL,2.0,0,12,0.3,0.2
2026-11-02 08:00,A3,L2,1,INVALID,3.0,1,10,0.1,0.2
2026-11-02 09:00,A4,L2,2,FAIL,4.0,4,8,-0.3,0.2
2026-11-03 08:00,A5,,1,PASS,5.0,1,10,0.1,0.2
2026-11-03 09:00,A6,L1,1,INCONCLUSIVE,6.0,1,10,-0.1,0.2
"""


@pytest.fixture
def readings(tmp_path):
    path = tmp_path / "parts.csv"
    path.write_text(READINGS, encoding="utf-8")
    return read_readings(path)


def test_readings_form_subgroups(readings):
    assert subgroups(readings, "lot") == ([("L1", [0, 1, 5]), ("L2", [2, 3])], 1)
    assert [places for _, places in subgroups(readings, "day")[0]] == [[0, 1], [2, 3], [4, 5]]
    assert subgroups(readings, "cavities")[0] == [
        ("A1–A2", [0, 1]),
        ("A3–A4", [2, 3]),
        ("A5", [4]),
        ("A6", [5]),
    ]
    assert subgroups(readings, "4") == ([("A1–A4", [0, 1, 2, 3])], 2)
    points, stand, notes = charted_points(readings, "height", "xbar-s", "lot")
    np.testing.assert_allclose(points.values, [3.0, 4.0])  # A3 is INVALID
    np.testing.assert_array_equal(points.sizes, [3, 1])
    assert (stand.texts["time"], "1 of 6" in notes[0]) == (("2026-11-01 08:00", "2026-11-02 08:00"), True)


def test_what_is_counted(readings):
    points = charted_points(readings, COUNTED["p"], "p", "day")[0]
    np.testing.assert_allclose(points.values, [0.5, 1.0, 0.0])
    np.testing.assert_array_equal(points.sizes, [2, 1, 2])
    points = charted_points(readings, COUNTED["u"], "u", "day")[0]
    np.testing.assert_allclose(points.values, [0.5, 1.0, 0.0])
    points = charted_points(readings, "marks", "u", "lot", "looked")[0]
    np.testing.assert_allclose(points.values, [3.0 / 32.0, 4.0 / 8.0])


@pytest.mark.parametrize(
    ("chart", "number", "subgroup", "of", "word"),
    [
        ("i-mr", "height", "lot", None, "go with --chart"),
        ("xbar-s", "height", None, None, "needs subgroups"),
        ("p", "marks", None, None, "needs subgroups"),
        ("p", "looked", None, "marks", "A1: 10 of 2 is no share"),
        ("xbar-s", "height", "1", None, "2 readings or more"),
        ("xbar-s", "height", "9", None, "no reading belongs"),
        ("xbar-s", "height", "colour", None, "no column 'colour'"),
        ("xbar-s", "height", "²", None, "no column"),
        ("xbar-s", "height", "9" * 5000, None, "no column"),
        ("xbar-s", "height", "lot", "looked", "--of goes with"),
    ],
)
def test_what_does_not_go_together_is_refused(readings, chart, number, subgroup, of, word):
    with pytest.raises(UsageError, match=word):
        charted_points(readings, number, chart, subgroup, of)


def test_limits_without_sense_are_refused(published):
    with pytest.raises(UsageError, match="the centre is 0"):
        counted((np.zeros(9), 50), "p")
    with pytest.raises(UsageError, match="name one of them"):
        study(published.piston_rings, "xbar-r", Settings(5, chart="xbar-r", known=given_limits(74.0, 0.01)))
    with pytest.raises(UsageError, match="no subgroup of the baseline has two values"):
        study(np.arange(9.0)[:, None], "xbar-s")
    with pytest.raises(UsageError, match="--chart takes i-mr"):
        Settings(chart="cusum")


def test_a_part_with_several_inspections_is_said_and_fails_or_passes_once(tmp_path):
    path = tmp_path / "parts.csv"
    rows = ["A1,PASS,1", "A2,INCONCLUSIVE,2", "A2,FAIL,3", "A1,INVALID,4", "A3,PASS,", "A3,PASS,5"]
    path.write_text("\n".join(["serial,verdict,height", *rows]), encoding="utf-8")
    found = read_readings(path)
    points = charted_points(found, COUNTED["p"], "p", "6")[0]
    assert (points.values.tolist(), points.sizes.tolist()) == ([1.0 / 3.0], [3.0])
    assert (
        "3 serial numbers have several inspections, such as A1: the last verdict"
        in repeated(found, COUNTED["p"])[0]
    )
    assert repeated(found, "height") == (
        "1 serial number has several inspections, such as A2: all of them are on the chart",
    )
    assert repeated(found.at([1, 2]), "height") == ()
