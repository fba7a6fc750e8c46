"""What ``anisoscope optimise`` prints and draws."""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from anisoscope.cli.console import console, print_table

if TYPE_CHECKING:
    from anisoscope.report.study_page import Chart, Map, Table
    from anisoscope.study.objective import Scoring
    from anisoscope.study.optimum import Optimum


LABELS = {
    "ridge_angle": "ridge angle [°]",
    "pitch": "pitch [µm]",
    "alpha_along": "alpha along [1]",
    "alpha_across": "alpha across [1]",
}


CONTRAST_UNITS = {"difference": "1/sr", "michelson": "1", "log_ratio": "1"}


def scoring_text(scoring: "Scoring") -> str:
    """What is maximised, in words."""
    pairs = ", ".join(f"{a:g}°/{b:g}°" for a, b in scoring.pairs_deg)
    tilts = ", ".join(f"{t:g}°" for t in scoring.tilts_deg)
    text = f"{scoring.over} |{scoring.contrast}| [{CONTRAST_UNITS[scoring.contrast]}], pairs {pairs}, tilts {tilts}"
    if scoring.score == "snr":
        text += ", over its standard deviation"
    if scoring.tolerances is not None:
        sizes = ", ".join(f"{name} {value:g}" for name, value in asdict(scoring.tolerances).items() if value)
        rule = "" if scoring.score == "snr" else f", mean − {scoring.z:g} sd"
        if scoring.quantile is not None:
            rule = f", quantile {scoring.quantile:g}"
        text += f"{rule}; sd: {sizes or 'none'}; {scoring.samples} parts"
    return text


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _optimum_as_json(found: "Optimum") -> dict[str, Any]:
    return {
        "part": asdict(found.part),
        "score": found.scored.score,
        "mean": found.scored.mean,
        "sd": found.scored.sd,
        "nominal_contrast": found.nominal.mean,
        "parameters": [
            {**asdict(one), "scores": [_finite(value) for value in one.scores]} for one in found.slices
        ],
        "hills": [_finite(value) for value in found.hills],
        "evaluations": found.evaluations,
    }


def best_as_json(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> dict[str, Any]:
    """The optimum as a table for JSON."""
    shape = best.landscape
    grid: Any = [_finite(float(value)) for value in shape.scores.ravel()]
    return {
        "scoring": asdict(scoring),
        "unit": CONTRAST_UNITS[scoring.contrast],
        "optimum": _optimum_as_json(best),
        "nominal_optimum": None if plain is None else _optimum_as_json(plain),
        "landscape": {
            "names": list(shape.names),
            "axes": [axis.tolist() for axis in shape.axes],
            "scores": grid,
        },
    }


def tables(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> "list[Table]":
    """The tables of terminal and page."""
    from anisoscope.report.study_page import Table
    from anisoscope.study.objective import score

    unit = CONTRAST_UNITS[scoring.contrast]
    rows = []
    for one in best.slices:
        remark = (
            "flat: it hardly matters" if one.flat else f"at the {one.at_bound} bound" if one.at_bound else ""
        )
        spread = "–" if one.sampling_sd is None else f"{one.sampling_sd:.2g}"
        value = getattr(best.part, one.name)
        rows.append(
            (LABELS[one.name], f"{value:.4g}", f"{one.kept[0]:.4g} … {one.kept[1]:.4g}", spread, remark)
        )
    columns = ("parameter", "optimum", "keeps 99 % of the score", "sd between samples", "remark")
    tables = [Table("Optimum", columns, tuple(rows))]
    shown = [("optimum", best.part, best.scored, best.nominal)]
    if plain is not None:
        under = score(plain.part, scoring)
        shown = [("robust", *shown[0][1:]), ("nominal", plain.part, under, plain.nominal)]
    names = [one.name for one in best.slices]
    tables.append(
        Table(
            "What it gives",
            (
                "design",
                *(LABELS[n] for n in names),
                f"contrast, nominal [{unit}]",
                f"mean [{unit}]",
                f"sd [{unit}]",
                "score",
            ),
            tuple(
                (
                    label,
                    *(f"{getattr(part, n):.4g}" for n in names),
                    f"{ideal.mean:.5g}",
                    f"{scored.mean:.5g}",
                    f"{scored.sd:.3g}",
                    f"{scored.score:.5g}",
                )
                for label, part, scored, ideal in shown
            ),
        )
    )
    around = [
        (LABELS[one.name], f"{value:.4g}", f"{at:.5g}" if math.isfinite(at) else "–")
        for one in best.slices
        for value, at in zip(one.values[::6], one.scores[::6], strict=True)
    ]
    tables.append(Table("Around the optimum", ("parameter, others held", "value", "score"), tuple(around)))
    return tables


def notes(best: "Optimum") -> list[str]:
    """What a reader should know of an optimum."""
    found = ["Model: corrected, direct light; reflections between facet and wall are left out."]
    if best.scored.score <= 0.0:
        found.append(
            "The score is not positive: the tolerances exceed the contrast everywhere within these bounds."
        )
    if len(best.hills) > 1:
        heights = ", ".join(f"{value:.4g}" for value in best.hills)
        found.append(f"Hills climbed: {len(best.hills)}; scores at their tops: {heights}.")
    if any(one.name == "pitch" for one in best.slices):
        found.append(
            "The pitch enters through the edge radius alone: light knows angles only. Wall width, roughness and "
            "camera pixels beside the pitch, and what the eye resolves, are not part of the score."
        )
    return found


def print_best(best: "Optimum", plain: "Optimum | None", scoring: "Scoring") -> None:
    """Print the optimum."""
    for table in tables(best, plain, scoring):
        print_table(table.title, list(table.columns), [list(row) for row in table.rows])
    for text in (scoring_text(scoring), *notes(best)):
        console().print(text, markup=False, highlight=False, soft_wrap=True)


def charts(best: "Optimum", scoring: "Scoring") -> "list[Chart | Map]":
    """The pictures of the page."""
    import numpy as np

    from anisoscope.report.study_page import Chart, Curve, Map

    shape = best.landscape
    unit = "1" if scoring.score == "snr" else CONTRAST_UNITS[scoring.contrast]
    charts: list[Chart | Map] = []
    if len(shape.names) > 1:
        rest = tuple(range(2, len(shape.names)))
        filled = np.where(np.isfinite(shape.scores), shape.scores, np.nanmin(shape.scores))
        x, y = shape.names[:2]
        charts.append(
            Map(
                "Score" + (", best over the other parameters" if rest else ""),
                LABELS[x],
                LABELS[y],
                f"score [{unit}]",
                shape.axes[0],
                shape.axes[1],
                filled.max(axis=rest).T if rest else filled.T,
                (getattr(best.part, x), getattr(best.part, y)),
                x != "ridge_angle",
                y != "ridge_angle",
            )
        )
    for number, one in enumerate(best.slices):
        values, scores = np.array(one.values), np.array(one.scores)
        if len(shape.names) == 1:
            values, scores = shape.axes[0], shape.scores
        finite = np.isfinite(scores)
        curve = Curve(f"{number}", values[finite], scores[finite])
        title = f"Score by {one.name.replace('_', ' ')}" + (
            "" if len(shape.names) == 1 else ", others at the optimum"
        )
        mark = getattr(best.part, one.name)
        charts.append(Chart(title, LABELS[one.name], f"score [{unit}]", (curve,), mark_x=mark, points=False))
    return charts
