"""``anisoscope research pod``: how probably a defect is found, over its size."""

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.study.optimise import HtmlOption, JobsOption, SchedulerOption
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.quality.detection_probability import DetectionCurve
    from anisoscope.report.study_page import Table

Scaled = Literal["linear", "log"]


@everyday("recipe", "defect", "csv", "parts", "golden_parts", "threshold", "rig", "json_", "html")
def pod_command(
    *,
    recipe: Annotated[
        Path | None, Parameter(name=["--recipe", "-r"], help="Recipe file of simulated parts (TOML).")
    ] = None,
    defect: Annotated[
        str,
        Parameter(
            help="Defect of simulated parts: height_loss, edge_radius [µm], ridge_angle [°], alpha, albedo."
        ),
    ] = "height_loss",
    csv: Annotated[
        Path | None,
        Parameter(
            name="--csv",
            help="CSV file of master parts instead: size,hit (1 or 0) or size,signal.",
        ),
    ] = None,
    parts: Annotated[int, Parameter(help="Simulated parts with a defect.")] = 400,
    largest: Annotated[
        float | None, Parameter(help="Largest simulated size; else found by a short series of trials.")
    ] = None,
    golden_parts: Annotated[
        int, Parameter(help="Golden parts of every rig; with 0 the prediction is the reference.")
    ] = 3,
    rig: Annotated[
        Path | None, Parameter(name=["--rig", "-g"], help="Rig file, for its light angle.")
    ] = None,
    light_angle: Annotated[float, Parameter(help="Without --rig: angle of the light, degrees.")] = 10.0,
    threshold: Annotated[
        float | None, Parameter(help="Of signals: a defect counts as found from this signal on.")
    ] = None,
    noise: Annotated[
        float | None, Parameter(help="Noise: signals at or below this are known to be so only.")
    ] = None,
    saturation: Annotated[
        float | None, Parameter(help="Saturation: signals at or above this are known to be so only.")
    ] = None,
    size_scale: Annotated[Scaled, Parameter(help="The curve is over the size or its logarithm.")] = "log",
    signal_scale: Annotated[Scaled, Parameter(help="Of signals: the signal or its logarithm.")] = "log",
    link: Annotated[
        Literal["logit", "probit"], Parameter(help="Of hits: logistic or normal curve.")
    ] = "logit",
    confidence: Annotated[float, Parameter(help="Confidence of intervals and of a90/95.")] = 0.95,
    seed: Annotated[int, Parameter(help="Seed of parts, rigs and errors.")] = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    json_: Json = False,
    html: HtmlOption = None,
) -> int:
    """Probability of detection over the size of a defect: a50, a90, a90/95 (MIL-HDBK-1823A).

    From simulated parts of a recipe, each on a rig of its own and found by the verdict FAIL, or from master parts.

    Examples:
        anisoscope research pod --recipe recipe.toml --defect height_loss --html pod.html
        anisoscope research pod --csv scratches.csv
    """
    from anisoscope.quality.detection_probability import Trials, hit_miss, read_trials, signal_over_size

    if (recipe is None) == (csv is None):
        raise UsageError("name the parts: --recipe FILE for simulated ones, or --csv FILE for master parts")
    if csv is not None:
        sizes, signal, hit = read_trials(csv)
        name, what = csv.stem, str(csv)
        if signal is None:
            assert hit is not None
            found = hit_miss(Trials(sizes, hit), size_scale, link, confidence)
        elif threshold is None:
            raise UsageError(f"{csv}: signals need --threshold, from which on a defect counts as found")
        else:
            found = signal_over_size(
                sizes, signal, threshold, (size_scale, signal_scale), noise=noise, saturation=saturation,
                confidence=confidence,
            )  # fmt: skip
    else:
        from anisoscope.rig.rigfile import read_rig
        from anisoscope.study.lot import lot_of
        from anisoscope.study.part_yield import detection_trials
        from anisoscope.study.sweep import Workers

        assert recipe is not None
        angle = light_angle if rig is None else read_rig(rig).light.angle_deg
        lot = lot_of(recipe, angle, parts=parts, rigs=2, golden=golden_parts)
        with progress(defect, quiet=json_) as advance:
            trials = detection_trials(lot, defect, largest, Workers(jobs, scheduler), seed, advance)
        found = hit_miss(trials, size_scale, link, confidence)
        reference = f"{golden_parts} golden parts" if golden_parts else "the prediction"
        name, what = defect, f"{recipe.name}: simulated parts, each on a rig of its own, against {reference}"
    if html is not None:
        _write_page(html, name, what, found)
    if json_:
        print_json(found)
        return 0
    for table in _tables(found):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows], table.note or None)
    print_lines(*(what, f"{name}: {found.verdict}"))
    return 0


def _write_page(path: Path, defect: str, source: str, found: "DetectionCurve") -> None:
    from anisoscope.report.study_page import Chart, Curve, write_study_page

    curve = Curve("probability of detection", found.grid, found.probability, found.low, found.high)
    chart = Chart(
        found.verdict, f"size of {defect}", "probability of detection [1]", (curve,),
        mark_x=found.sizes[1].size, points=False,
    )  # fmt: skip
    note = f"Band and limits: profile likelihood ratio, {found.confidence:.0%}; the line marks a90."
    tables = _tables(found)
    write_study_page(
        path, f"Probability of detection: {defect}", source, [chart], tables, [found.verdict, note]
    )


def _tables(found: "DetectionCurve") -> "list[Table]":
    from anisoscope.report.study_page import Table

    level = f"{found.confidence:.0%}"

    def text(value: float) -> str:
        return f"{value:.4g}" if isfinite(value) else "none"

    rows = tuple(
        (
            f"a{100 * one.probability:.0f}",
            *(text(value) for value in (one.size, one.low, one.high, one.bound)),
        )
        for one in found.sizes
    )
    note = f"{found.method}: {found.found} of {found.count} defects found"
    if found.false_calls is not None:
        hits, of, low, high = found.false_calls
        note += f"; false calls: {hits} of {of} parts without one ({low:.1%} to {high:.1%})"
    columns = ("size found", "estimate", f"{level} from", "to", f"upper {level} limit")
    fit = tuple((name, f"{value:.6g}") for name, value in found.parameters.items())
    return [
        Table("Sizes", columns, rows, note),
        Table(
            f"Fit over the {'logarithm of the ' if found.size_scale == 'log' else ''}size",
            ("parameter", "value"),
            fit,
        ),
    ]
