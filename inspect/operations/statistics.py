"""Measurement systems analysis and control charts of readings, from a CSV file or a history."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.history.filters import parse_moment
from anisoscope.parameters.charting import Charting
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.measurement_process import ProcessInputs
from anisoscope.quality.bias import ALPHA, Bias, bias_study
from anisoscope.quality.capability import Specification, charted, specification
from anisoscope.quality.chart_limits import read_chart_limits
from anisoscope.quality.control import ControlStudy, Settings, control_study
from anisoscope.quality.drift import Drift, drift_study
from anisoscope.quality.gauge import GaugeStudy, gauge_data, gauge_study
from anisoscope.quality.limits import Limits, Period
from anisoscope.quality.linearity import GaugeLinearity, gauge_linearity
from anisoscope.quality.measurement_process import (
    MeasurementProcess,
    TypeOne,
    measurement_process,
    standards_study,
    type_one,
)
from anisoscope.quality.readings import GROUPS, Readings
from anisoscope.quality.stability import Stability, stability_study
from anisoscope.quality.subgroups import COUNTED, charted_points, repeated

REFERENCE = "reference"
"""Column of known values."""


def values_of(readings: Readings, number: str | None = None) -> tuple[str, FloatArray]:
    """Name and values (N,) of a number; without a name the first one that is no reference.

    Raises:
        UsageError: there is no such number.
    """
    name = number or next((name for name in readings.numbers if name != REFERENCE), None)
    if name is None:
        raise UsageError(f"{readings.source}: there is no number besides the reference")
    return readings.number(name)


def msa_gauge(
    readings: Readings, number: str | None = None, *, tolerance: float | None = None, nested: bool = False
) -> GaugeStudy:
    """Gauge R&R (AIAG manual): parts measured by several appraisers, or nested, each part by one of them.

    Args:
        readings: with the columns part and appraiser, or of a history: serial number and operator.
        number: name of the measured number; the first one by default.
        tolerance: width between the limits of good parts.
        nested: parts of the same name are others with every appraiser.

    Raises:
        UsageError: the study is too small.
    """
    return gauge_study(gauge_data(readings, values_of(readings, number)[0], nested=nested), tolerance)


def msa_bias(
    readings: Readings, number: str | None = None, *, reference: float | None = None, alpha: float = ALPHA
) -> Bias:
    """Bias of repeated measurements of one part.

    Args:
        readings: of the part.
        number: name of the measured number; the first one by default.
        reference: known value; by default the constant of the column ``reference``.
        alpha: significance of the test.

    Raises:
        UsageError: no known value, several, or too few measured values.
    """
    return bias_study(values_of(readings, number)[1], _known(readings, reference), alpha)


def msa_linearity(readings: Readings, number: str | None = None, *, alpha: float = ALPHA) -> GaugeLinearity:
    """Bias over parts of several known values, which are in the column ``reference``.

    Raises:
        UsageError: there is no such column, or too few values.
    """
    values = values_of(readings, number)[1]
    return gauge_linearity(_column(readings, "a linearity study needs"), values, alpha)


def msa_stability(
    readings: Readings,
    number: str | None = None,
    *,
    reference: float | None = None,
    baseline: int | None = None,
    alpha: float = ALPHA,
) -> Stability:
    """Control chart of a check standard, with its bias where its value is known.

    Args:
        readings: in the order in which they were measured.
        number: name of the measured number; the first one by default.
        reference: known value; by default the constant of the column ``reference``, if there is one.
        baseline: measured values at the start on which the limits rest; None for all.
        alpha: significance of the bias.

    Raises:
        UsageError: too few values.
    """
    name, values = values_of(readings, number)
    known = _reference(readings, reference)
    return stability_study(values, readings.labels, Settings(baseline), known, alpha, name=name)


def msa_type1(
    readings: Readings,
    number: str | None = None,
    *,
    tolerance: float,
    reference: float | None = None,
    resolution: float | None = None,
) -> TypeOne:
    """Type-1 study: Cg and Cgk of one standard measured repeatedly.

    Args:
        readings: of the standard.
        number: name of the measured number; the first one by default.
        tolerance: width between the limits of good parts.
        reference: known value; by default the constant of the column ``reference``.
        resolution: of the gauge.

    Raises:
        UsageError: no known value, several, or too few measured values.
    """
    return type_one(values_of(readings, number)[1], _known(readings, reference), tolerance, resolution)


@by_keywords(inputs=ProcessInputs)
def msa_process(
    standards: Readings, gauge: Readings | None = None, number: str | None = None, *, inputs: ProcessInputs
) -> MeasurementProcess:
    """Capability of a measuring system and of its process (ISO 22514-7, VDA 5).

    Args:
        standards: repeated measurements of standards, with the column ``reference``.
        gauge: of a crossed study; None for the measuring system alone.
        number: name of the measured number; the first one by default.
        inputs: tolerance, further uncertainties and limits, or the fields as keywords.

    Raises:
        UsageError: a missing column, or a number that makes no sense.
    """
    values = values_of(standards, number)[1]
    known = _column(standards, "measurements of standards need")
    own = standards_study(known, values, corrected=inputs.corrected)
    crossed = None if gauge is None else msa_gauge(gauge, number, tolerance=inputs.tolerance)
    return measurement_process(
        inputs.tolerance,
        own,
        crossed,
        inputs.stated,
        resolution=inputs.resolution,
        largest_error=inputs.largest_error,
        limits=(inputs.system_limit, inputs.process_limit),
    )


def _column(readings: Readings, why: str) -> FloatArray:
    if REFERENCE not in readings.numbers:
        raise UsageError(f"{readings.source}, line 1: {why} a column {REFERENCE!r}")
    return readings.numbers[REFERENCE]


def _reference(readings: Readings, given: float | None) -> float | None:
    if given is not None or REFERENCE not in readings.numbers:
        return given
    known = set(readings.numbers[REFERENCE].tolist())
    if len(known) != 1:
        raise UsageError(
            f"{readings.source}: the column {REFERENCE!r} holds more than one value: use `anisoscope msa linearity`"
        )
    return float(known.pop())


def _known(readings: Readings, given: float | None) -> float:
    known = _reference(readings, given)
    if known is None:
        raise UsageError("name the known value: --reference, or a column `reference` in the CSV file")
    return known


@dataclass(frozen=True, eq=False)
class Chart:
    """Control study of a number, a reading for each of its points, and its drift where one was looked for."""

    number: str
    readings: Readings
    study: ControlStudy
    drift: Drift | None = None


@dataclass(frozen=True, eq=False)
class Charts:
    """Control charts of readings.

    Attributes:
        source: of the readings.
        charts: one for each number and group.
        studies: their control studies.
        skipped: what has no chart, and why.
        drifts: results of the tests for a drift.
    """

    source: str
    charts: tuple[Chart, ...] = field(metadata=LEFT_OUT)
    studies: tuple[ControlStudy, ...]
    skipped: tuple[str, ...]
    drifts: tuple[Drift, ...] = field(
        default=(), metadata=json_field(by=lambda found: {"drifts": found} if found else {}, merged=True)
    )

    @property
    def stable(self) -> bool:
        """Every chart is stable, and nothing drifts."""
        return all(one.stable for one in self.studies) and not any(one.seen for one in self.drifts)


@by_keywords(charting=Charting)
def control_charts(
    readings: Readings,
    number: str | None = None,
    *,
    charting: Charting,
    tolerances: Mapping[str, float] | None = None,
    on_progress: Advance = silent,
) -> Charts:
    """Control charts and capability: of a number, or of all that are worth a chart.

    Args:
        readings: in the order in which they were measured; with cycle data of machines for ``drift``.
        number: its name; None for all.
        charting: chart type, limits and rules, or its fields as keywords.
        tolerances: of a recipe, by number, in place of those of the readings.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: no number, settings that make no sense, or no chart is possible.
    """
    used = _settings(charting)
    limits, by = None, charting.by
    if charting.lower is not None or charting.upper is not None:
        limits = Specification(charting.lower, charting.upper)
    known = None if charting.limits_from is None else read_chart_limits(charting.limits_from)
    names = _names(readings, number, used.chart)
    if len(names) > 1 and (limits is not None or used.center is not None):
        raise UsageError("limits and known means belong to one number: name it with --number")
    if by is not None and by not in GROUPS:
        raise UsageError(f"--by takes {', '.join(GROUPS)}, not {by!r}")
    groups = readings.grouped(by)
    wanted = [(name, group) for name in names for group in groups]
    charts: list[Chart] = []
    skipped: list[str] = []
    for place, (name, group) in enumerate(wanted):
        title, part = name if by is None else f"{name}, {by} {group or 'not stated'}", groups[group]
        on_progress(title, place, len(wanted))
        try:
            points, stand, left = charted_points(part, name, used.chart, charting.subgroup, charting.of)
            own = replace(
                used,
                period=None if charting.period is None else period_of(stand, charting.period),
                known=_known_of(known, title, used.chart),
            )
            wide = limits if limits or points.counted else specification(part, name, tolerances)
            study = control_study(title, points, own, wide)
            study = replace(study, notes=(*study.notes, *left, *repeated(part, name)))
            values, labels = (
                (study.values, study.labels) if study.points.counted else (part.numbers[name], part.labels)
            )
            beside = (stand if study.points.counted else part).against
            moved = (
                drift_study(title, values, labels, beside(charting.against, name)) if charting.drift else None
            )
        except UsageError as error:
            if len(wanted) == 1:
                raise
            skipped.append(f"{title}: {error}")
        else:
            charts.append(Chart(name, stand, study, moved))
    if not charts:
        raise UsageError(skipped[0])
    return Charts(
        readings.source,
        tuple(charts),
        tuple(one.study for one in charts),
        tuple(skipped),
        tuple(one.drift for one in charts if one.drift is not None),
    )


def _names(readings: Readings, number: str | None, chart: str) -> tuple[str, ...]:
    if number is not None:
        return (readings.number(number)[0],)
    names = (COUNTED[chart[0]],) if chart[0] in COUNTED else charted(readings)
    if not names:
        raise UsageError(f"{readings.source}: there is no number to chart")
    return names


def _settings(charting: Charting) -> Settings:
    return Settings(
        charting.baseline,
        charting.weight,
        charting.width,
        charting.center,
        charting.sigma,
        distribution=charting.distribution,
        rules=charting.rules,
        chart=charting.chart or ("i-mr" if charting.subgroup is None else "xbar-s"),
    )


def _known_of(known: Mapping[str, tuple[str, Limits]] | None, title: str, chart: str) -> Limits | None:
    if known is None:
        return None
    if title not in known:
        raise UsageError(f"{title}: the file of limits has {', '.join(known)} only")
    if known[title][0] != chart:
        raise UsageError(f"{title}: the limits in the file are of the chart {known[title][0]}, not {chart}")
    return known[title][1]


def period_of(readings: Readings, text: str) -> Period:
    """The readings of a period, such as ``2026-11-01..2026-11-07``; either end may be missing.

    Raises:
        UsageError: it is no period, or the readings have no times.
    """
    begin, dots, end = text.partition("..")
    if not dots or not (begin or end):
        raise UsageError(f"--period takes FROM..TO, such as 2026-11-01..2026-11-07, not {text!r}")
    moments = [readings.moment(place) for place in range(len(readings))]
    if not any(moments):
        raise UsageError(f"{readings.source}: no reading has a time, which --period needs")
    now = datetime.now(UTC)
    first = parse_moment(begin, "--period", now=now) if begin else datetime.min.replace(tzinfo=UTC)
    last = parse_moment(end, "--period", now=now, at_end=True) if end else datetime.max.replace(tzinfo=UTC)
    if last < first:
        raise UsageError(f"--period {text} ends before it begins: write the earlier day first")
    inside = np.array([one is not None and first <= one <= last for one in moments], dtype=np.bool_)
    return Period(f"{begin or 'the beginning'} to {end or 'the end'}", inside)
