"""Pages of measurement systems analysis: gauge R&R, bias, linearity, stability; they open offline."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from anisoscope.quality.bias import Bias
from anisoscope.quality.gaugestudy import GaugeStudy
from anisoscope.quality.individuals import FloatArray
from anisoscope.quality.linearity import GaugeLinearity
from anisoscope.quality.stability import Stability
from anisoscope.report.msa_figures import bias_picture, crossing_picture, linearity_picture, share_picture
from anisoscope.report.page import write_page
from anisoscope.report.spc_page import study_content
from anisoscope.report.statistics_parts import Grid, Picture, chance, number, share


def write_gauge_page(path: Path, title: str, source: str, study: GaugeStudy) -> None:
    """Write the page of a gauge R&R study, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    data, gauge = study.data, study.gauge
    p, o, r = data.values.shape
    shares = ", ".join(f"{one.name} {share(study.share_of_study(one))}" for one in study.components[:-1])
    pictures = (
        Picture(
            share_picture(study),
            f"Shares of the study variation: {shares}",
            "What the variation is made of. Shares of variance add up to 100 %, those of deviations do not.",
        ),
        Picture(
            crossing_picture(study),
            f"{data.values.size} measurements of {p} parts by {o} appraisers, {r} times each, from "
            f"{number(float(data.values.min()))} to {number(float(data.values.max()))}",
            "Every measurement, and the means of every appraiser: lines that cross mean that appraisers treat parts "
            "differently.",
        ),
    )
    good = study.share_of_study(gauge) <= 0.3 and (study.share_of_tolerance(gauge) or 0.0) <= 0.3
    _write(
        path, (title, source), (study.verdict, good), pictures, (components(study), anova(study)), study.notes
    )


def components(study: GaugeStudy) -> Grid:
    """Variances, what they are of the whole, and their intervals."""
    rows = tuple(
        (
            one.name,
            number(one.sigma),
            number(one.variance),
            f"{number(one.low, 3)} to {number(one.high, 3)}",
            share(one.variance / study.total.variance),
            share(study.share_of_study(one)),
            share(study.share_of_tolerance(one)),
        )
        for one in study.components
    )
    columns = (
        "source", "sigma", "variance", f"{study.confidence:.0%} interval of the variance", "of variance", "of study",
        "of tolerance",
    )  # fmt: skip
    return Grid("Components", "Components of variance", columns, rows, "components", note=_reach(study))


def _reach(study: GaugeStudy) -> str:
    """Shares of the gauge and ndc with their intervals, in a sentence."""

    def between(ends: tuple[float, float]) -> str:
        return f"{share(ends[0])} to {share(ends[1])}"

    low, high = ("none" if end is None else str(end) for end in study.categories_interval)
    ndc = "–" if study.categories is None else str(study.categories)
    said = [f"{study.confidence:.0%} intervals of the gauge: {between(study.share)} of the study variation"]
    said += (
        [] if study.tolerance_interval is None else [f"{between(study.tolerance_interval)} of the tolerance"]
    )
    return ", ".join(said) + f". Distinct categories (ndc): {ndc}, interval {low} to {high}."


def anova(study: GaugeStudy) -> Grid:
    """The table of the analysis of variance."""
    rows = tuple(
        (
            line.source,
            str(line.freedom),
            number(line.sum_squares, 6),
            number(line.value, 6),
            number(line.f),
            "–" if line.f is None else chance(line.p),
        )
        for line in study.table
    )
    columns = ("source", "degrees of freedom", "sum of squares", "mean square", "F", "p")
    return Grid(
        "Analysis of variance", "Two-way analysis, parts and appraisers at random", columns, rows, "anova"
    )


def write_bias_page(path: Path, title: str, source: str, study: Bias, values: FloatArray) -> None:
    """Write the page of a bias study, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    picture = Picture(
        bias_picture(values, study.reference, (study.low, study.high)),
        f"{study.count} measurements about a reference of {number(study.reference)}; mean {number(study.mean, 6)}",
        "Measurements in their order. The band is the interval of the mean: if it holds the reference, there is none.",
    )
    _write(path, (title, source), (study.verdict, not study.significant), (picture,), (biases((study,)),), ())


def biases(found: Sequence[Bias]) -> Grid:
    """Bias at one or more reference values."""
    rows = tuple(
        (
            number(one.reference),
            str(one.count),
            number(one.mean, 6),
            number(one.bias),
            number(one.sigma),
            number(one.u),
            number(one.t),
            chance(one.p),
            f"{number(one.low, 3)} to {number(one.high, 3)}",
        )
        for one in found
    )
    columns = ("reference", "n", "mean", "bias", "sigma", "u of the mean", "t", "p", "interval of the bias")
    return Grid("Bias", f"Bias, with {1 - found[0].alpha:.0%} intervals", columns, rows, "bias")


def write_linearity_page(path: Path, title: str, source: str, study: GaugeLinearity) -> None:
    """Write the page of a linearity study, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    picture = Picture(
        linearity_picture(study),
        f"Bias over reference: slope {number(study.slope.value)}, intercept {number(study.intercept.value)}; means "
        + ", ".join(f"{number(one.bias)} at {number(one.reference)}" for one in study.levels),
        "Where the band does not hold the line of no bias, the gauge is biased there.",
    )
    tables = (line_table(study), biases(study.levels))
    _write(path, (title, source), (study.verdict, study.fit), (picture,), tables, ())


def line_table(study: GaugeLinearity) -> Grid:
    """The line of bias over reference."""
    rows = tuple(
        (name, number(one.value, 6), number(one.u), number(one.t, 5), chance(one.p))
        for name, one in (("slope", study.slope), ("intercept", study.intercept))
    )
    title = (
        f"bias = slope · reference + intercept; scatter {number(study.sigma)}, R² {share(study.r2)}, limit of t "
        f"{number(study.t_limit)}"
    )
    return Grid("Line", title, ("what", "value", "u", "t", "p"), rows, "line")


def write_stability_page(path: Path, title: str, source: str, study: Stability) -> None:
    """Write the page of a stability study, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    chart = study_content(study.chart)
    tables = [*chart["tables"], *([] if study.bias is None else [biases((study.bias,))])]
    good = study.chart.stable and not (study.bias and study.bias.significant)
    _write(path, (title, source), (study.verdict, good), chart["pictures"], tables, chart["notes"])


def _write(
    path: Path,
    heading: tuple[str, str],
    verdict: tuple[str, bool],
    pictures: Sequence[Picture],
    tables: Sequence[Grid],
    notes: Sequence[str],
) -> None:
    content: dict[str, Any] = {
        "title": heading[0],
        "source": heading[1],
        "verdict": verdict[0],
        "good": verdict[1],
        "pictures": pictures,
        "tables": tables,
        "notes": notes,
    }
    write_page(path, "msa.html", content)
