"""Type-1 study, ISO 22514-7 and VDA 5: worked examples of the standard and of another program, and identities."""

import math

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.quality.gauge import GaugeData, gauge_study
from anisoscope.quality.measurement_process import measurement_process, standards_study, type_one


def levels(published):
    references = np.repeat(list(published.iso_standards), 4)
    return references, np.concatenate(list(published.iso_standards.values()))


def parts_of(values):
    names = tuple(map(str, range(values.shape[1])))
    return gauge_study(GaugeData(names, tuple("ABC"[: values.shape[0]]), values.transpose(1, 0, 2)))


def test_line_of_iso_22514_7(published):
    """Annex A.1 and table A.3: line, u_LIN 0.0533, u_EVR 0.0641, F 0.6918 of the lack of fit."""
    found = standards_study(*levels(published), corrected=True)
    assert (found.intercept, found.slope) == (
        pytest.approx(0.2358, abs=5e-5),
        pytest.approx(0.9870, abs=5e-5),
    )
    assert (found.linearity, found.repeatability) == (
        pytest.approx(0.0533, abs=6e-5),
        pytest.approx(0.0641, abs=6e-5),
    )
    assert found.lack_of_fit[0] == pytest.approx(0.6918, abs=5e-5)


def test_worked_example_of_iso_22514_7(published):
    """Annex A.2 to A.5: U_MS 0.1672, U_MP 0.4185, Q 3.7 and 9.3 %, C_MS 5.38 and C_MP 4.30 of a tolerance of 9."""
    gauge = parts_of(published.iso_parts)
    assert (gauge.appraiser.sigma, gauge.repeatability.sigma) == (
        pytest.approx(0.08683, abs=1e-5),
        pytest.approx(0.1827, abs=5e-5),
    )
    standards = standards_study(*levels(published), corrected=True)
    found = measurement_process(9.0, standards, gauge, {"CAL": 0.005}, resolution=0.005)
    system, process = found.system, found.process
    assert (system.standard, system.expanded) == (
        pytest.approx(0.0836, abs=5e-5),
        pytest.approx(0.1672, abs=5e-5),
    )
    assert (process.standard, process.expanded) == (
        pytest.approx(0.2093, abs=6e-5),
        pytest.approx(0.4185, abs=5e-5),
    )
    assert (100 * system.share, 100 * process.share) == (
        pytest.approx(3.7, abs=0.05),
        pytest.approx(9.3, abs=0.05),
    )
    assert (system.capability, process.capability) == (
        pytest.approx(5.38, abs=5e-3),
        pytest.approx(4.30, abs=5e-3),
    )
    assert found.capable
    assert as_json(found)["process"]["components"]["AV"] == gauge.appraiser.sigma


def test_type_one_of_another_program(published):
    """Example of JASP's module for quality control: bias, t test, Cg 1.19, Cgk 1.15, 16.8 % of the tolerance."""
    study = type_one(published.jasp_type_one, -4.0, 15.0)
    assert (study.bias.bias, study.bias.sigma) == (pytest.approx(0.054), pytest.approx(0.420014577006512))
    assert (study.bias.t, study.bias.p) == (
        pytest.approx(0.909105737620188),
        pytest.approx(0.367744349288335),
    )
    assert (study.bias.low, study.bias.high) == (
        pytest.approx(-0.0653668220476197),
        pytest.approx(0.17336682204762),
    )
    assert (study.cg.value, study.cgk.value) == (pytest.approx(1.19, abs=5e-3), pytest.approx(1.15, abs=5e-3))
    assert 100 * study.repeatability_share == pytest.approx(16.8, abs=0.05)
    assert not study.capable


def test_the_smallest_tolerance_is_just_capable(published):
    wide = type_one(published.jasp_type_one, -4.0, 15.0).smallest_tolerance
    assert type_one(published.jasp_type_one, -4.0, wide * (1 + 1e-9)).capable
    assert not type_one(published.jasp_type_one, -4.0, wide * 0.999).capable
    coarse = type_one(published.jasp_type_one, -4.0, wide * 1.01, resolution=wide)
    assert not coarse.capable
    assert coarse.smallest_tolerance == pytest.approx(20 * wide)


def test_the_smallest_tolerance_of_a_process_is_just_capable(published):
    gauge, standards = parts_of(published.iso_parts), standards_study(*levels(published))
    first = measurement_process(9.0, standards, gauge)
    for which in ("system", "process"):
        smallest = getattr(first, which).smallest_tolerance
        assert getattr(measurement_process(smallest, standards, gauge), which).share == pytest.approx(
            getattr(first, which).limit
        )


def test_bias_of_standards_that_are_not_corrected(rng):
    references = np.repeat([1.0, 2.0, 3.0], 12)
    off = np.repeat([0.01, -0.05, 0.02], 12)
    noise = rng.normal(0.0, 0.01, 36).reshape(3, 12)
    noise -= noise.mean(axis=1, keepdims=True)
    found = standards_study(references, references + off + noise.ravel())
    assert found.bias == pytest.approx(0.05 / math.sqrt(3))
    assert found.repeatability == pytest.approx(math.sqrt(np.mean(noise.var(axis=1, ddof=1))))
    assert found.linearity == 0.0
    two = standards_study(references[:24], (references + off + noise.ravel())[:24])
    assert two.lack_of_fit is None


def test_the_largest_repeatability_counts_once(published):
    gauge, standards = parts_of(published.iso_parts), standards_study(*levels(published), corrected=True)
    coarse = measurement_process(9.0, standards, gauge, resolution=1.0)
    assert (
        coarse.system.components["EV"]
        == coarse.process.components["EV"]
        == pytest.approx(1.0 / math.sqrt(12))
    )
    assert not coarse.capable
    assert "resolution is coarser" in coarse.verdict
    by_error = measurement_process(9.0, standards, gauge, largest_error=0.3)
    assert by_error.system.standard == pytest.approx(0.3 / math.sqrt(3))
    assert by_error.process.components["EV"] == gauge.repeatability.sigma


def test_what_carries_no_capability_is_refused(published):
    standards = standards_study(*levels(published))
    with pytest.raises(UsageError, match="finite width"):
        measurement_process(0.0, standards)
    with pytest.raises(UsageError, match="no component 'X'"):
        measurement_process(1.0, standards, None, {"X": 1.0})
    with pytest.raises(UsageError, match="must be 0 or more"):
        measurement_process(1.0, standards, None, {"CAL": -1.0})
    with pytest.raises(UsageError, match="need measurements of parts"):
        measurement_process(1.0, standards, None, {"T": 1.0})
    with pytest.raises(UsageError, match="twice or more"):
        standards_study(np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    with pytest.raises(UsageError, match="all readings"):
        standards_study(np.array([1.0, 1.0]), np.array([1.0, 1.0]))
    with pytest.raises(UsageError, match="3 or more standards"):
        standards_study(np.array([1.0, 1.0]), np.array([1.0, 1.1]), corrected=True)


def test_what_the_reader_should_know_is_noted(published, rng):
    x = np.repeat([1.0, 2.0, 3.0], 4)
    bent = standards_study(x, x + (x - 2.0) ** 2 + 0.01 * rng.normal(size=12))
    notes = " ".join(measurement_process(9.0, bent, parts_of(published.iso_parts[:1])).notes)
    for word in ("12 measurements of standards", "do not lie on a line", "one appraiser"):
        assert word in notes
    assert "only 10 measurements" in type_one(rng.normal(size=10), 0.0, 100.0).notes[0]
