"""Pages of measurement systems analysis: gauge R&R, bias, linearity, stability, attributes, capability of a process."""

from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.quality.gauge import GOOD_SHARE, POOR_SHARE, GaugeStudy
from anisoscope.quality.linearity import GaugeLinearity
from anisoscope.report.figures import BLUE, GREEN, INK, MUTED, ORANGE, PAPER, RED, new_figure, svg_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from anisoscope.quality.attribute import AttributeStudy, Kappa, Share, Zone
from anisoscope.quality.bias import Bias
from anisoscope.quality.measurement_process import COVERAGE, MeasurementProcess, TypeOne
from anisoscope.quality.stability import Stability
from anisoscope.report.page import write_page
from anisoscope.report.spc_page import study_content
from anisoscope.report.statistics_sections import Grid, Picture, chance, number, share

SHADES = (BLUE, ORANGE, GREEN, RED, MUTED)
MARKS = ("o", "s", "^", "D", "v")
NAMED = 40  # parts up to which the axis names them


def share_picture(study: GaugeStudy) -> str:
    """Every component as a share of the study variation and of the tolerance, as a data URI."""
    components = [one for one in study.components if one.name != "total"]
    with new_figure(9.4, 0.9 + 0.55 * len(components)) as (figure, axes):
        rows = np.arange(len(components), dtype=np.float64)
        kinds = [("of the study variation", BLUE, "", [study.share_of_study(one) for one in components])]
        if study.tolerance is not None:
            kinds.append(
                (
                    "of the tolerance",
                    ORANGE,
                    "//",
                    [study.share_of_tolerance(one) or 0.0 for one in components],
                )
            )
        height = 0.8 / len(kinds)
        for k, (name, colour, hatch, shares) in enumerate(kinds):
            at = rows - 0.4 + height * (k + 0.5)
            bars = axes.barh(
                at, 100.0 * np.array(shares), height, color=colour, hatch=hatch, edgecolor=PAPER, label=name
            )
            axes.bar_label(bars, fmt="%.1f %%", padding=3, fontsize=8, color=INK)
        for level in (10.0, 30.0):
            axes.axvline(level, color=RED, linewidth=0.9, linestyle="--")
        axes.set_yticks(rows, [one.name for one in components])
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.set_xlabel("standard deviation [%];  dashes: 10 % and 30 %, the limits for the gauge")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def crossing_picture(study: GaugeStudy) -> str:
    """Every measurement over its part, and the means of every appraiser, as a data URI."""
    data = study.data
    counts = (~np.isnan(data.values)).sum(axis=2)
    means = np.divide(
        np.nansum(data.values, axis=2), counts, out=np.full(counts.shape, np.nan), where=counts > 0
    )
    with new_figure(9.4, 3.6) as (figure, axes):
        at = np.arange(len(data.parts), dtype=np.float64)
        count = len(data.appraisers)
        for k, name in enumerate(data.appraisers):
            colour, mark = SHADES[k % len(SHADES)], MARKS[k % len(MARKS)]
            shift = 0.0 if count == 1 else 0.3 * (k / (count - 1) - 0.5)
            cells = data.values[:, k, :]
            axes.plot(
                np.repeat(at + shift, cells.shape[1]),
                cells.ravel(),
                mark,
                color=colour,
                markersize=3.5,
                alpha=0.55,
            )
            axes.plot(
                at + shift,
                means[:, k],
                marker=mark,
                color=colour,
                linewidth=1.2,
                markersize=5,
                label=name,
            )
        _name_parts(axes, data.parts)
        axes.grid(axis="y")
        axes.set_xlabel("part")
        axes.set_ylabel("measured")
        axes.legend(frameon=False, fontsize=8, title="appraiser", title_fontsize=8)
        return svg_uri(figure)


def _name_parts(axes: "Axes", parts: tuple[str, ...]) -> None:
    if len(parts) <= NAMED:
        long = sum(map(len, parts)) > 80
        axes.set_xticks(range(len(parts)), parts, rotation=90 if long else 0, fontsize=8)


def bias_picture(values: FloatArray, reference: float, interval: tuple[float, float]) -> str:
    """Measurements in order, the reference, and the interval of their mean, as a data URI.

    Args:
        values: (N,), NaN is missing.
        reference: the known value.
        interval: of the bias.
    """
    with new_figure(9.4, 3.0) as (figure, axes):
        axes.plot(
            np.arange(1, len(values) + 1),
            values,
            "o-",
            color=BLUE,
            linewidth=0.8,
            markersize=4,
            label="measured",
        )
        axes.axhspan(
            reference + interval[0],
            reference + interval[1],
            color=ORANGE,
            alpha=0.3,
            linewidth=0,
            label="interval of the mean",
        )
        axes.axhline(reference, color=GREEN, linewidth=1.6, label="reference")
        axes.set_xlabel("measurement")
        axes.set_ylabel("value")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def linearity_picture(study: GaugeLinearity) -> str:
    """Biases over the reference values, the line through them and its band, as a data URI."""
    x = np.linspace(study.references.min(), study.references.max(), 201)
    line, low, high = study.band(x)
    with new_figure(9.4, 3.8) as (figure, axes):
        axes.plot(study.references, study.biases, "o", color=BLUE, markersize=3.5, alpha=0.6, label="bias")
        axes.plot(
            [level.reference for level in study.levels],
            [level.bias for level in study.levels],
            "D",
            color=ORANGE,
            markersize=6,
            markeredgecolor=INK,
            label="mean at each reference",
        )
        axes.plot(x, line, color=RED, linewidth=1.4, label="line")
        axes.fill_between(
            x, low, high, color=RED, alpha=0.18, linewidth=0, label=f"{100 - 100 * study.alpha:.0f} % band"
        )
        axes.axhline(0.0, color=GREEN, linewidth=1.4, label="no bias")
        axes.set_xlabel("reference value")
        axes.set_ylabel("measured − reference")
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def write_gauge_page(path: Path, title: str, source: str, study: GaugeStudy) -> None:
    """Write the page of a gauge R&R study, atomically.

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
            f"{np.count_nonzero(~np.isnan(data.values))} measurements of {p} parts by {o} appraisers, {r} times each "
            f"at most, from {number(float(np.nanmin(data.values)))} to {number(float(np.nanmax(data.values)))}",
            "Every measurement, and the mean of every part."
            if study.design == "nested"
            else "Every measurement, and the means of every appraiser: lines that cross mean that appraisers treat "
            "parts differently.",
        ),
    )
    largest = max(study.share_of_study(gauge), study.share_of_tolerance(gauge) or 0.0)
    good = True if largest < GOOD_SHARE else None if largest <= POOR_SHARE else False
    _write(
        path, (title, source), (study.verdict, good), pictures, (components(study), anova(study)), study.notes
    )


def components(study: GaugeStudy) -> Grid:
    """Variance components, their shares of the total, and their intervals."""
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
    notes = [f"{study.confidence:.0%} intervals of the gauge: {between(study.share)} of the study variation"]
    notes += (
        [] if study.tolerance_interval is None else [f"{between(study.tolerance_interval)} of the tolerance"]
    )
    return ", ".join(notes) + f". Distinct categories (ndc): {ndc}, interval {low} to {high}."


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
        "Analysis of variance", f"Parts and appraisers at random, {study.design}", columns, rows, "anova"
    )


def write_bias_page(path: Path, title: str, source: str, study: Bias, values: FloatArray) -> None:
    """Write the page of a bias study, atomically.

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
    """Write the page of a linearity study, atomically.

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
    """Write the page of a stability study, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    chart = study_content(study.chart)
    tables = [*chart["tables"], *([] if study.bias is None else [biases((study.bias,))])]
    good = study.chart.stable and not (study.bias and study.bias.significant)
    _write(path, (title, source), (study.verdict, good), chart["pictures"], tables, chart["notes"])


def effectiveness_picture(study: AttributeStudy) -> str:
    """Effectiveness of every appraiser with its interval, as a data URI."""
    with new_figure(9.4, 1.1 + 0.45 * len(study.appraisers)) as (figure, axes):
        rows = np.arange(len(study.appraisers), dtype=np.float64)
        found = [one.effectiveness for one in study.appraisers]
        value = 100.0 * np.array([one.count / one.of for one in found])
        reach = [value - [100.0 * one.low for one in found], [100.0 * one.high for one in found] - value]
        axes.errorbar(value, rows, xerr=reach, fmt="o", color=BLUE, capsize=4)
        for level in (80.0, 90.0):
            axes.axvline(level, color=RED, linewidth=0.9, linestyle="--")
        axes.set_yticks(rows, [one.name for one in study.appraisers])
        axes.margins(y=0.3)
        axes.invert_yaxis()
        axes.set_xlabel("effectiveness [%];  dashes: 80 % and 90 %")
        return svg_uri(figure)


def zone_picture(study: AttributeStudy, zone: Zone) -> str:
    """Share of accepting decisions over the reference value and the zones of disagreement, as a data URI."""
    assert study.data.values is not None
    with new_figure(9.4, 3.2) as (figure, axes):
        accepted = 100.0 * study.data.decisions.reshape(study.parts, -1).mean(axis=1)
        axes.plot(study.data.values, accepted, "o", color=BLUE, markersize=4)
        for ends in (zone.upper, zone.lower):
            if ends is not None:
                axes.axvspan(*sorted(ends), color=ORANGE, alpha=0.3, linewidth=0)
        axes.set_xlabel("reference value")
        axes.set_ylabel("accepted [%]")
        return svg_uri(figure)


def write_attribute_page(path: Path, title: str, source: str, study: AttributeStudy) -> None:
    """Write the page of an attribute study, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    texts = ", ".join(f"{one.name} {share(one.effectiveness.value)}" for one in study.appraisers)
    pictures = [
        Picture(
            effectiveness_picture(study),
            f"Effectiveness: {texts}",
            "Parts on which all trials of an appraiser agree with the reference.",
        )
    ]
    if study.zone is not None:
        pictures.append(
            Picture(
                zone_picture(study, study.zone),
                f"Zones of disagreement of a mean width of {number(study.zone.width)}",
                "The bands reach from the last part that all reject to the first that all accept.",
            )
        )
    verdict = (study.verdict, study.acceptable)
    _write(path, (title, source), verdict, pictures, attribute_tables(study), study.notes)


def attribute_tables(study: AttributeStudy) -> tuple[Grid, ...]:
    """Rates of appraisers, kappas, tables of pairs, and signal detection."""
    confidence = f"{study.confidence:.0%}"

    def of(one: Share) -> str:
        return f"{share(one.value)} ({one.count}/{one.of}; {share(one.low)} to {share(one.high)})"

    rates = tuple(
        (one.name, of(one.consistent), of(one.effectiveness), of(one.miss), of(one.false_alarm), one.rating)
        for one in study.appraisers
    )
    columns = ("appraiser", "own trials agree", "effectiveness", "miss rate", "false alarms", "rating")
    whole = f"All decisions agree on {of(study.all_agree)}, and with the reference on {of(study.all_right)}."
    pairs = [*study.pairs, *(one.with_reference for one in study.appraisers)]
    rows = [
        (f"{one.first} × {one.second}", "Cohen", *_kappa(one.kappa), *map(str, one.table)) for one in pairs
    ]
    own = [(f"{one.name}, own trials", one.within) for one in study.appraisers]
    rows += [
        (name, "Fleiss", *_kappa(found), "", "", "", "")
        for name, found in [*own, ("all decisions", study.among)]
        if found is not None
    ]
    cells = ("both bad", "only 2nd good", "only 1st good", "both good")
    table = ("agreement of", "kappa of", "kappa", f"{confidence} interval", *cells)
    found = [
        Grid("Rates", f"Rates with {confidence} intervals", columns, rates, "rates", note=whole),
        Grid("Kappa", "Agreement beyond chance; intervals over parts", table, tuple(rows), "kappa"),
    ]
    if study.zone is not None:
        zone = study.zone
        ends = [
            "–" if one is None else f"{number(one[0], 6)} to {number(one[1], 6)}"
            for one in (zone.upper, zone.lower)
        ]
        row = (*ends, number(zone.width, 6), number(zone.uncertainty, 6), share(zone.share))
        names = ("upper zone", "lower zone", "d", "U = d/2", "d of the tolerance")
        found.append(Grid("Signal detection", "Zones of disagreement", names, (row,), "zone"))
    return tuple(found)


def _kappa(one: Kappa) -> tuple[str, str]:
    return number(one.value, 3), f"{number(one.low, 2)} to {number(one.high, 2)}"


def type_one_picture(values: FloatArray, study: TypeOne) -> str:
    """Measurements in order between ±10 % of the tolerance about the reference, as a data URI."""
    with new_figure(9.4, 3.0) as (figure, axes):
        axes.plot(np.arange(1, len(values) + 1), values, "o-", color=BLUE, linewidth=0.8, markersize=4)
        axes.axhline(study.bias.reference, color=GREEN, linewidth=1.6)
        for sign in (-1.0, 1.0):
            level = study.bias.reference + sign * 0.1 * study.tolerance
            axes.axhline(level, color=RED, linewidth=1.0, linestyle="--")
        axes.set_xlabel("measurement")
        axes.set_ylabel("value")
        return svg_uri(figure)


def write_type_one_page(path: Path, title: str, source: str, study: TypeOne, values: FloatArray) -> None:
    """Write the page of a type-1 study, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    picture = Picture(
        type_one_picture(values, study),
        f"{study.bias.count} measurements, reference {number(study.bias.reference)}, dashes at ±10 % of the tolerance",
        "Measurements in their order; the line is the reference, the dashes are ±10 % of the tolerance about it.",
    )
    _write(
        path, (title, source), (study.verdict, study.capable), (picture,), type_one_tables(study), study.notes
    )


def type_one_tables(study: TypeOne) -> tuple[Grid, ...]:
    """Cg and Cgk, and the bias."""
    rows = tuple(
        (name, number(one.value, 3), f"{number(one.low, 3)} to {number(one.high, 3)}")
        for name, one in (("Cg", study.cg), ("Cgk", study.cgk))
    )
    note = (
        f"6 sigma fill {share(study.repeatability_share)} of the tolerance of {number(study.tolerance)}; smallest "
        f"tolerance with Cg and Cgk of 1.33: {number(study.smallest_tolerance)}"
    )
    grid = Grid(
        "Type 1", "Capability of the gauge", ("index", "value", "95 % interval"), rows, "type1", note=note
    )
    return grid, biases((study.bias,))


def process_picture(study: MeasurementProcess) -> str:
    """Every component of the process, or else of the system, as twice its expanded uncertainty over the tolerance."""
    parts = (study.process or study.system).components
    with new_figure(9.4, 0.9 + 0.45 * len(parts)) as (figure, axes):
        rows = np.arange(len(parts), dtype=np.float64)
        widths = [200.0 * COVERAGE * value / study.tolerance for value in parts.values()]
        bars = axes.barh(rows, widths, 0.6, color=BLUE)
        axes.bar_label(bars, fmt="%.1f %%", padding=3, fontsize=8, color=INK)
        axes.set_yticks(rows, list(parts))
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.set_xlabel("Q of the component alone [%]")
        return svg_uri(figure)


def write_process_page(path: Path, title: str, source: str, study: MeasurementProcess) -> None:
    """Write the page of the capability of a measurement process, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    picture = Picture(
        process_picture(study),
        ", ".join(
            f"u({name}) {number(one)}" for name, one in (study.process or study.system).components.items()
        ),
        "What the uncertainty is made of; squares of the bars add up.",
    )
    _write(
        path, (title, source), (study.verdict, study.capable), (picture,), process_tables(study), study.notes
    )


def process_tables(study: MeasurementProcess) -> tuple[Grid, ...]:
    """Components of the uncertainty, and Q of system and process."""
    both = (study.system.components, {} if study.process is None else study.process.components)
    names = tuple(dict.fromkeys([*both[0], *both[1]]))
    parts = tuple((f"u({name})", *(number(one.get(name)) for one in both)) for name in names)
    rows = tuple(
        (
            name,
            number(one.standard),
            number(one.expanded),
            share(one.share),
            share(one.limit),
            number(one.smallest_tolerance),
            number(one.capability, 3),
        )
        for name, one in (("measuring system", study.system), ("measurement process", study.process))
        if one is not None
    )
    columns = ("of", "u", "U (k = 2)", "Q", "limit", "smallest tolerance", "C")
    note = f"Tolerance {number(study.tolerance)}" + (
        "" if study.resolution_share is None else f"; resolution {share(study.resolution_share)} of it"
    )
    return (
        Grid("Capability", "ISO 22514-7 and VDA 5", columns, rows, "process", note=note),
        Grid(
            "Components", "Standard uncertainties", ("component", "system", "process"), parts, "uncertainty"
        ),
    )


def _write(
    path: Path,
    heading: tuple[str, str],
    verdict: tuple[str, bool | None],
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
