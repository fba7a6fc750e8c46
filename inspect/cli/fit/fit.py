"""``anisoscope fit``: parameters of the models from measured exposures, contrasts and BRDF tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_LIGHT, OF_PLASTIC, OF_RIDGES, PRINTED, MaterialOption, Output
from anisoscope.cli.tables import console, print_table
from anisoscope.parameters.fitting import BrdfComparison

if TYPE_CHECKING:
    from anisoscope.fit.fitting import Fit
    from anisoscope.fit.table import BrdfTable, Reciprocity
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.progress import progress
from anisoscope.parameters.fitting import FitStart, TableValues
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.fit.fitting import Fit
    from anisoscope.fit.problem import Problem


def show(
    fitted: "Fit",
    title: str,
    output: Output,
    brdf: "tuple[BrdfTable, Reciprocity] | None" = None,
) -> int:
    """Print a fit, or write its page."""
    from anisoscope.fit.text import fit_as_json, quality

    if output.json_:
        found = fit_as_json(fitted)
        rows = _rows(fitted, brdf)
        found |= {} if brdf is None else _brdf_as_json(*brdf)
        print_json(found | {"rows": rows})
    elif output.html is not None:
        from anisoscope.report.fit_page import write_fit_page

        write_fit_page(fitted, title, output.html, () if brdf is None else (_reciprocity_words(brdf[1]),))
        console().print(f"{output.html}: {quality(fitted)}", markup=False, highlight=False, soft_wrap=True)
    else:
        _print(fitted, title, brdf)
    return 0 if fitted.fits or not fitted.estimates else 3


def _rows(fitted: "Fit", brdf: "tuple[BrdfTable, Reciprocity] | None") -> list[dict[str, float | None]]:
    from anisoscope.bsdf.directions_table import ANGLES
    from anisoscope.fit.text import rows_as_json

    rows = rows_as_json(fitted)
    if brdf is None:
        return rows
    angles = [dict(zip(ANGLES, map(float, row), strict=True)) for row in brdf[0].angles_deg]
    return [
        {"line": line, **place, **row} for line, place, row in zip(brdf[0].lines, angles, rows, strict=True)
    ]


def _brdf_as_json(table: "BrdfTable", pairs: "Reciprocity") -> dict[str, Any]:
    from dataclasses import asdict

    return {"wavelength_nm": table.wavelength_nm, "unit": "1/sr", "reciprocity": asdict(pairs)}


def _reciprocity_words(pairs: "Reciprocity") -> str:
    negative = ""
    if pairs.negative:
        by_noise = (
            "" if pairs.negative_p_value is None else f" (by noise alone p = {pairs.negative_p_value:.2g})"
        )
        negative = f" {pairs.negative} rows are negative{by_noise}."
    if not pairs.pairs or pairs.rms_share is None or pairs.worst_share is None or pairs.worst_lines is None:
        return f"Reciprocity: no row is measured in both directions.{negative}"
    one, other = pairs.worst_lines
    by_noise = "" if pairs.p_value is None else f"; by noise alone p = {pairs.p_value:.2g}"
    if pairs.largest_k is not None:
        by_noise += f", largest difference {pairs.largest_k:.1f} u"
    return (
        f"Reciprocity: {pairs.pairs} rows measured in both directions differ by {100 * pairs.rms_share:.2g} % rms, at "
        f"most {100 * pairs.worst_share:.2g} % (lines {one} and {other}){by_noise}.{negative}"
    )


WORST = 10


def _print(fitted: "Fit", title: str, brdf: "tuple[BrdfTable, Reciprocity] | None") -> None:
    import numpy as np

    from anisoscope.fit.text import notes, number, quality, unit_text

    unit, result = unit_text(fitted), "fitted" if fitted.estimates else "predicted"
    order = list(range(len(fitted.fitted)))
    if brdf is not None:
        order = [int(n) for n in np.argsort(-np.abs(fitted.z), kind="stable")[:WORST]]
    print_table(
        title if brdf is None else f"{title}: the {len(order)} worst of {len(fitted.fitted)} rows",
        [
            "row" if brdf is None else "θi, φi → θo, φo",
            *(f"{w} [{unit}]" for w in ("measured", "u", result)),
            "z [1]",
        ],
        [
            [
                fitted.problem.readings.labels[n],
                number(fitted.problem.readings.value[n]),
                f"{fitted.u_value[n]:.2g}",
                number(fitted.fitted[n]),
                f"{fitted.z[n]:+.2f}",
            ]
            for n in order
        ],
        caption=quality(fitted),
    )
    if fitted.estimates:
        _print_parameters(fitted)
    lines = [*notes(fitted), *([] if brdf is None else [_reciprocity_words(brdf[1])])]
    for line in lines:
        console().print(line, markup=False, highlight=False)


def _print_parameters(fitted: "Fit") -> None:
    import numpy as np

    from anisoscope.fit.parameters import PARAMETERS
    from anisoscope.fit.text import fixed, number, setup_text, value_texts

    names = [PARAMETERS[one.name].words for one in fitted.estimates]
    print_table(
        "Parameters",
        ["parameter", "unit", "value", "u", "95 % interval"],
        [
            [name, PARAMETERS[one.name].unit or "1", *value_texts(one)]
            for name, one in zip(names, fitted.estimates, strict=True)
        ],
        caption=setup_text(fitted)
        + "; fixed: "
        + ", ".join(f"{PARAMETERS[n].words} {number(v)}" for n, v in fixed(fitted).items()),
    )
    if len(names) > 1:
        print_table(
            "Correlation [1]",
            ["", *(str(n + 1) for n in range(len(names)))],
            [
                [f"{n + 1} {name}", *("–" if np.isnan(x) else f"{x:+.3f}" for x in row)]
                for n, (name, row) in enumerate(zip(names, fitted.correlation, strict=True))
            ],
        )


MODEL = Group(
    "Model",
    help="What is not free stays fixed; of what is free the search starts there.",
    sort_key=18,
)
OF_RIDGES_AND_ANGLE = replace(OF_RIDGES, without={"ridge_angle_deg": "it must be stated"})
OF_RIDGES_OF_TABLE = replace(OF_RIDGES, without={"ridge_angle_deg": "the table has the angles"})


def _names(text: str, _option: str) -> tuple[str, ...]:
    return (text,)


OF_START = Options(FitStart, MODEL, readers={"free": _names}, whole=True)

app = App(name="fit", help="Fit the parameters of the reflectance models to measured values.")


def _part(
    ridges: Given[RidgeDesign], plastic: Given[Material], file: Path | None, ridge_angle: float = 10.0
) -> "tuple[RidgeDesign, Material]":
    """Ridges and plastic of the options; what a fit cannot start from is named as its parameter."""
    from anisoscope.fit.parameters import PARAMETERS, checked_values
    from anisoscope.operations.plastic import plastic_of

    stated = {"ridge_angle_deg": ridge_angle, **ridges.values, **plastic.values}
    checked_values({name: value for name, value in stated.items() if name in PARAMETERS})
    return ridges.over(RidgeDesign(100.0, ridge_angle)), plastic.over(plastic_of(file)[0])


@app.command
@with_options(
    values=Options(TableValues, names={"kind": "--quantity", "covariance": "--covariance-file"}, whole=True),
    start=OF_START,
    ridges=OF_RIDGES,
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
)
def ridges(
    table: Path,
    /,
    *,
    values: Given[TableValues],
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    file: MaterialOption = None,
    start: Given[FitStart],
    rig: Given[Convention],
    output: Output = PRINTED,
) -> int:
    """Fit ridge angle, roughness, height loss, seating and scale to exposures or contrasts of one part.

    Args:
        table: CSV: stage_deg,tilt_deg,value[,u] or from_deg,to_deg,tilt_deg,value[,u].

    Examples:
        anisoscope fit ridges table.csv
        anisoscope fit ridges table.csv --free all --html fit.html
    """
    from anisoscope.operations.fit import fit_ridges

    output.one_alone()
    design, material = _part(ridges, plastic, file)
    with progress("fitting", quiet=output.json_) as advance:
        fitted = fit_ridges(
            table,
            values=values.made(),
            start=start.made(),
            design=design,
            material=material,
            convention=rig.over(Convention()),
            on_progress=advance,
        )
    return show(fitted, f"Fit of {table.name}", output)


@app.command
@with_options(
    start=replace(OF_START, default={"free": "alpha_along,alpha_across,k"}),
    ridges=OF_RIDGES_OF_TABLE,
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
)
def experiment(
    table: Path,
    /,
    *,
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    file: MaterialOption = None,
    start: Given[FitStart],
    rig: Given[Convention],
    output: Output = PRINTED,
) -> int:
    """Fit one plastic and one scale to the contrasts of the published experiment, over all its ridge angles.

    Args:
        table: CSV: ridge_angle_deg,tilt_deg,from_deg,to_deg,contrast, as experiment ridges --measured reads it.

    Examples:
        anisoscope fit experiment measured.csv
    """
    from anisoscope.experiment.experiment import read_measured
    from anisoscope.fit.parameters import parse_free
    from anisoscope.fit.table import experiment_problem
    from anisoscope.operations.fit import start_values

    output.one_alone()
    design, material = _part(ridges, plastic, file)
    asked = start.made()
    free = ",".join(asked.free or ())
    chosen = tuple(n for n in parse_free(free) if free.strip() != "all" or n != "ridge_angle_deg")
    problem = experiment_problem(
        read_measured(table),
        rig.over(Convention()),
        _scene(asked, design, material, usual=1),
        start_values(design, material, asked),
        tuple(n for n in chosen if not (n == "height_loss" and asked.model == "printed" and free == "all")),
    )
    return show(_fit(problem, output.json_), f"Fit of {table.name} to the published experiment", output)


def _scene(
    start: FitStart, design: RidgeDesign, material: Material, usual: int | None = None
) -> dict[str, Any]:
    """Keywords of a scene."""
    return {"model": start.model, "bounces": start.counted(usual), "design": design, "material": material}


@app.command
@with_options(
    start=replace(
        OF_START,
        help={"free": "Free parameters with --fit, as in fit ridges; ridge angle and both alphas."},
    ),
    values=Options(BrdfComparison, flags=True, whole=True),
    ridges=OF_RIDGES_AND_ANGLE,
    plastic=OF_PLASTIC,
)
def brdf(
    table: Path,
    /,
    *,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees; 0 is a flat surface.")],
    values: Given[BrdfComparison],
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    file: MaterialOption = None,
    start: Given[FitStart],
    output: Output = PRINTED,
) -> int:
    """Compare a measured BRDF with a model, and fit material and ridge angle to it.

    Args:
        table: CSV: theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value[,u][,wavelength_nm], in the sample's frame; or RGL
            .bsdf, MERL, Klems XML, Zemax.

    Examples:
        anisoscope fit brdf brdf.csv --ridge-angle 8 --fit
    """
    from anisoscope.fit.parameters import parse_free
    from anisoscope.fit.problem import Problem, Scene
    from anisoscope.fit.table import read_brdf, reciprocity
    from anisoscope.operations.fit import start_values

    output.one_alone()
    asked, compared = start.made(), values.made()
    if asked.free is not None and not compared.fit:
        raise UsageError("--free needs --fit")
    design, material = _part(ridges, plastic, file, ridge_angle)
    read = read_brdf(table, compared.wavelength_nm)
    chosen: tuple[str, ...] = ("alpha_along", "alpha_across")
    if ridge_angle != 0.0:
        chosen = ("ridge_angle_deg", *chosen)
    if asked.free is not None:
        chosen = parse_free(",".join(asked.free))
    scene = Scene(read.to_light, read.to_camera, **_scene(asked, design, material))
    found = start_values(design, material, asked)
    problem = Problem(scene, read.readings, found, chosen if compared.fit else ())
    return show(_fit(problem, output.json_), f"BRDF of {table.name}", output, (read, reciprocity(read)))


def _fit(problem: "Problem", quiet: bool) -> "Fit":
    from anisoscope.fit.fitting import fit_or_rival

    with progress("fitting", quiet=quiet) as advance:
        return fit_or_rival(problem, advance)
