"""``anisoscope msa``: measurement systems analysis."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.history.options import ALL, Place, Selection
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, Html, Json
from anisoscope.cli.statistics.source import SOURCE, Alpha, Number, Readable, print_grid, readings_from
from anisoscope.cli.tables import print_lines
from anisoscope.parameters.measurement_process import ProcessInputs
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.report.statistics_sections import Grid

ABOUT = "Measurement system analysis: gauge R&R, bias, linearity, stability, attributes, type 1, VDA 5."
app = App(name="msa", help=ABOUT)

Reference = Annotated[float | None, Parameter(help="Known value of the part.")]


@app.command
def gauge(
    *,
    source: Readable = SOURCE,
    tolerance: float | None = None,
    nested: Flag = False,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Gauge R&R: parts measured by several appraisers, each equally often or not, or each by one of them (nested).

    Columns of the CSV file: part, appraiser, and a number. In the history, the serial number is the part and the
    operator the appraiser.

    Exit codes: 0 the gauge is good or usable, 1 it is not good enough, 64 and above no analysis is possible.

    Args:
        tolerance: Width between the limits of good parts, for the share of the tolerance.
        nested: Parts of the same name are others with every appraiser (destroyed by measuring).

    Examples:
        anisoscope msa gauge --csv gauge.csv --tolerance 0.4
    """
    from anisoscope.operations.statistics import msa_gauge, values_of
    from anisoscope.report.msa_page import anova, components, write_gauge_page

    readings = source.readings()
    name, _ = values_of(readings, source.number)
    study = msa_gauge(readings, name, tolerance=tolerance, nested=nested)
    if html is not None:
        write_gauge_page(html, f"Gauge R&R: {name}", readings.source, study)
    _show(study, (components(study), anova(study)), study.notes, html, json_=json_)
    return 0 if study.usable else 1


@app.command
def bias(
    *,
    source: Readable = SOURCE,
    reference: Reference = None,
    alpha: Alpha = 0.05,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Bias: one part of known value, measured repeatedly.

    The known value is --reference, or the column `reference` of the CSV file.

    Exit codes: 0 no significant bias, 1 bias, 64 and above no analysis is possible.

    Examples:
        anisoscope msa bias --csv bias.csv --reference 6
    """
    from anisoscope.operations.statistics import msa_bias, values_of
    from anisoscope.report.msa_page import biases, write_bias_page

    readings = source.readings()
    name, values = values_of(readings, source.number)
    study = msa_bias(readings, name, reference=reference, alpha=alpha)
    if html is not None:
        write_bias_page(html, f"Bias: {name}", readings.source, study, values)
    _show(study, (biases((study,)),), (), html, json_=json_)
    return 1 if study.significant else 0


@app.command
def linearity(
    *,
    csv: Annotated[Path, Parameter(help="CSV file with the columns reference and a number.")],
    number: Number = None,
    alpha: Alpha = 0.05,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Linearity: bias over parts of several known values.

    Exit codes: 0 no significant bias over the whole range, 1 bias, 64 and above no analysis is possible.

    Examples:
        anisoscope msa linearity --csv linearity.csv
    """
    from anisoscope.operations.statistics import msa_linearity, values_of
    from anisoscope.quality.readings import read_readings
    from anisoscope.report.msa_page import biases, line_table, write_linearity_page

    readings = read_readings(csv)
    name, _ = values_of(readings, number)
    study = msa_linearity(readings, name, alpha=alpha)
    if html is not None:
        write_linearity_page(html, f"Linearity: {name}", readings.source, study)
    _show(study, (biases(study.levels), line_table(study)), (), html, json_=json_)
    return 0 if study.fit else 1


@app.command
def stability(
    *,
    source: Readable = SOURCE,
    reference: Reference = None,
    baseline: Annotated[
        int | None, Parameter(help="Limits from this many measured values at the start; else from all.")
    ] = None,
    alpha: Alpha = 0.05,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Stability: a check standard over days and weeks, on a control chart.

    Of the history, choose the standard with --serial.

    Exit codes: 0 stable, 1 not stable or biased, 64 and above no analysis is possible.

    Examples:
        anisoscope msa stability --serial CHECK-1 --number "ln 0-90"
    """
    from anisoscope.operations.statistics import msa_stability, values_of
    from anisoscope.report.msa_page import biases, write_stability_page
    from anisoscope.report.spc_page import tables

    readings = source.readings()
    name, _ = values_of(readings, source.number)
    study = msa_stability(readings, name, reference=reference, baseline=baseline, alpha=alpha)
    if html is not None:
        write_stability_page(html, f"Stability: {name}", readings.source, study)
    grids = (*tables(study.chart, 20), *(() if study.bias is None else (biases((study.bias,)),)))
    _show(study, grids, study.chart.notes, html, json_=json_)
    return 0 if study.acceptable else 1


Tolerance = Annotated[float, Parameter(help="Tolerance: width between the limits of good parts.")]
Resolution = Annotated[float | None, Parameter(help="Resolution of the gauge.")]


@app.command
def attribute(
    *,
    csv: Path | None = None,
    masters: Path | None = None,
    place: Place = None,
    which: Selection = ALL,
    tolerance: float | None = None,
    confidence: Annotated[float, Parameter(help="Confidence of the intervals.")] = 0.95,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Attribute agreement: decisions good or bad on parts of known quality.

    Kappa of Cohen and Fleiss, effectiveness, miss and false-alarm rates; with measured references signal detection.

    Exit codes: 0 acceptable, 1 not, 64 and above no analysis is possible.

    Args:
        csv: CSV file of decisions: part, appraiser, decision, reference and, if measured, value.
        masters: Decisions of the history on these parts: CSV file with the columns part and reference.
        tolerance: Tolerance, width between the limits of good parts, for signal detection.

    Examples:
        anisoscope msa attribute --csv decisions.csv --tolerance 0.1
        anisoscope msa attribute --masters masters.csv --since 7d
    """
    from anisoscope.quality.attribute import attribute_study, decisions_of_history, read_decisions
    from anisoscope.report.msa_page import attribute_tables, write_attribute_page

    if csv is not None and masters is None and place is None:
        data, source = read_decisions(csv), str(csv)
    elif masters is not None and csv is None:
        readings = readings_from(None, place, which)
        data, source = decisions_of_history(readings, masters), readings.source
    else:
        raise UsageError("name the decisions: --csv FILE, or --masters FILE for those of the history")
    study = attribute_study(data, tolerance, confidence)
    if html is not None:
        write_attribute_page(html, "Attribute agreement", source, study)
    _show(study, attribute_tables(study), study.notes, html, json_=json_)
    return 0 if study.acceptable else 1


@app.command
def type1(
    *,
    source: Readable = SOURCE,
    reference: Reference = None,
    tolerance: Tolerance,
    resolution: Resolution = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Type-1 study: one standard measured repeatedly, Cg and Cgk.

    Exit codes: 0 capable, 1 not, 64 and above no analysis is possible.

    Examples:
        anisoscope msa type1 --csv standard.csv --reference 6 --tolerance 0.5 --resolution 0.01
    """
    from anisoscope.operations.statistics import msa_type1, values_of
    from anisoscope.report.msa_page import type_one_tables, write_type_one_page

    readings = source.readings()
    name, values = values_of(readings, source.number)
    study = msa_type1(readings, name, tolerance=tolerance, reference=reference, resolution=resolution)
    if html is not None:
        write_type_one_page(html, f"Type 1: {name}", readings.source, study, values)
    _show(study, type_one_tables(study), study.notes, html, json_=json_)
    return 0 if study.capable else 1


@app.command
@with_options(
    inputs=Options(
        ProcessInputs,
        groups=dict.fromkeys(
            (
                "u_linearity",
                "u_stability",
                "u_gauges",
                "u_other",
                "largest_error",
                "system_limit",
                "process_limit",
            ),
            MORE,
        ),
        flags=("corrected",),
        whole=True,
    )
)
def process(
    *,
    standards: Annotated[Path, Parameter(help="CSV file with repeated readings: reference and a number.")],
    gauge_study_: Annotated[Path | None, Parameter(name="--gauge-study")] = None,
    number: Number = None,
    inputs: Given[ProcessInputs],
    html: Html = None,
    json_: Json = False,
) -> int:
    """Capability of a measuring system and its process: ISO 22514-7 and VDA 5.

    %Q_MS and %Q_MP, twice the expanded uncertainty (k = 2) over the tolerance, and the smallest tolerance.

    Exit codes: 0 capable, 1 not, 64 and above no analysis is possible.

    Args:
        gauge_study_: CSV file of a gauge study: part, appraiser and a number.

    Examples:
        anisoscope msa process --standards standards.csv --gauge-study gauge.csv --tolerance 0.4 --u-calibration 0.002
    """
    from anisoscope.operations.statistics import msa_process, values_of
    from anisoscope.quality.readings import read_readings
    from anisoscope.report.msa_page import process_tables, write_process_page

    readings = read_readings(standards)
    name, _ = values_of(readings, number)
    study = msa_process(
        readings,
        None if gauge_study_ is None else read_readings(gauge_study_),
        number,
        inputs=inputs.made(),
    )
    if html is not None:
        write_process_page(html, f"Measurement process: {name}", readings.source, study)
    _show(study, process_tables(study), study.notes, html, json_=json_)
    return 0 if study.capable else 1


class _Study(Protocol):
    @property
    def verdict(self) -> str: ...


def _show(
    study: "_Study",
    grids: "tuple[Grid, ...]",
    notes: tuple[str, ...],
    html: Path | None,
    *,
    json_: bool,
) -> None:
    if json_:
        print_json(study)
        return
    for grid in grids:
        print_grid(grid)
    print_lines(*notes, study.verdict)
    if html is not None:
        print_lines(f"{html}: the page")
