"""``anisoscope fit``: parameters of the models from measured exposures, contrasts and BRDF tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.fit.fitting import Fit
    from anisoscope.fit.table import BrdfTable, Reciprocity
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.progress import progress

if TYPE_CHECKING:
    from anisoscope.fit.fitting import Fit
    from anisoscope.fit.problem import Problem, Readings, Scene


def show(
    fitted: "Fit",
    title: str,
    json_: bool,
    html: Path | None,
    brdf: "tuple[BrdfTable, Reciprocity] | None" = None,
) -> int:
    """Print a fit, or write its page."""
    from anisoscope.fit.text import fit_as_json, quality

    if json_:
        found = fit_as_json(fitted)
        rows = _rows(fitted, brdf)
        found |= {} if brdf is None else _brdf_as_json(*brdf)
        print_json(found | {"rows": rows})
    elif html is not None:
        from anisoscope.report.fit_page import write_fit_page

        write_fit_page(fitted, title, html, () if brdf is None else (_reciprocity_words(brdf[1]),))
        console().print(f"{html}: {quality(fitted)}", markup=False, highlight=False, soft_wrap=True)
    else:
        _print(fitted, title, brdf)
    return 0


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


MODEL = Group("Model and plastic", sort_key=20)
POSE = Group("Light and camera angles", sort_key=21)
HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
FreeOption = Annotated[
    str,
    Parameter(
        help="Free parameters, comma-separated: ridge_angle, alpha_along, alpha_across, height_loss, seating_x, "
        "seating_y, k, albedo, index, tail; all: everything but albedo, index and tail."
    ),
]

app = App(name="fit", help="Fit the parameters of the reflectance models to measured values.")


@Parameter(name="*", group=MODEL)
@dataclass(frozen=True)
class ModelOptions:
    """Values of the parameters that stay fixed; of a free one it is where the search starts."""

    model: Annotated[
        Literal["printed", "corrected"], Parameter(help="The corrected model, or as published.")
    ] = "corrected"
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = 1.5
    height_loss: Annotated[float, Parameter(help="Share of the ridge height that is missing.")] = 0.0
    seating_x: Annotated[float, Parameter(help="Seating tilt of the part about x in degrees.")] = 0.0
    seating_y: Annotated[float, Parameter(help="Seating tilt of the part about y in degrees.")] = 0.0
    k: Annotated[float, Parameter(help="Scale between radiance and the unit of the table.")] = 1.0
    wall: Annotated[Literal["perpendicular", "vertical"], Parameter(help="Wall of the ridges.")] = (
        "perpendicular"
    )
    internal_reflection: Annotated[
        Literal["nonlinear", "linear"], Parameter(help="Colour of light sent back inside the plastic.")
    ] = "nonlinear"
    bounces: Annotated[
        int | Literal["all"] | None,
        Parameter(
            help="Reflections of the corrected model: 1 is direct light; a larger number, or all. All by default; of "
            "the published experiment 1."
        ),
    ] = None

    def values(self, ridge_angle: float) -> dict[str, float]:
        """All parameters by name, checked."""
        from anisoscope.fit.parameters import checked_values

        return checked_values(
            {
                "ridge_angle_deg": ridge_angle,
                "alpha_along": self.alpha_along,
                "alpha_across": self.alpha_across,
                "albedo": self.albedo,
                "index": self.index,
                "height_loss": self.height_loss,
                "seating_x_deg": self.seating_x,
                "seating_y_deg": self.seating_y,
                "k": self.k,
            }
        )

    def optics(self, bounces: int | None = None) -> dict[str, Any]:
        """The keywords of a scene; ``bounces`` are those by default, None for all."""
        if isinstance(self.bounces, int) and self.bounces < 1:
            raise UsageError(f"--bounces must be 1 or more, or all, not {self.bounces}")
        if self.model == "printed" and self.bounces not in (None, 1):
            raise UsageError(
                f"--bounces {self.bounces} needs --model corrected; printed knows direct light only"
            )
        counted = bounces if self.bounces is None else None if self.bounces == "all" else self.bounces
        return {
            "model": self.model,
            "bounces": 1 if self.model == "printed" else counted,
            "wall": self.wall,
            "internal_reflection": self.internal_reflection,
        }


@Parameter(name="*", group=POSE)
@dataclass(frozen=True)
class PoseOptions:
    """How the angles of a table are counted."""

    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular"
    facet_azimuth: Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°.")] = 0.0


@app.command
def ridges(
    table: Path,
    /,
    *,
    quantity: Annotated[
        Literal["exposure", "difference", "michelson", "log_ratio"] | None,
        Parameter(help="What the values are; of an exposure table: which contrasts are formed and fitted."),
    ] = None,
    free: FreeOption | None = None,
    errors: Annotated[
        Literal["shared", "independent"],
        Parameter(help="Contrasts that share a photograph: correlated, or independent."),
    ] = "shared",
    covariance: Annotated[
        Path | None,
        Parameter(name="--covariance-file", help="CSV without header: N × N covariance, in place of u."),
    ] = None,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees, where it is not free.")] = 10.0,
    options: ModelOptions | None = None,
    angles: PoseOptions | None = None,
    json_: Json = False,
    html: HtmlOption = None,
) -> int:
    """Fit ridge angle, roughness, height loss, seating and scale to exposures or contrasts of one part.

    Args:
        table: CSV: stage_deg,tilt_deg,value[,u] or from_deg,to_deg,tilt_deg,value[,u].

    Examples:
        anisoscope fit ridges table.csv
        anisoscope fit ridges table.csv --free all --html fit.html
    """
    from anisoscope.fit.parameters import USUAL, parse_free
    from anisoscope.fit.problem import Problem, Scene
    from anisoscope.fit.table import read_readings
    from anisoscope.parameters.geometry import Convention
    from anisoscope.sim.light.geometry import directions

    options, angles = options or ModelOptions(), angles or PoseOptions()
    _at_most_one(json_, html)
    poses, readings = read_readings(table, quantity, errors, covariance)
    convention = Convention(angles.light_angle, angles.tilt_plane, angles.facet_azimuth)
    scene = Scene(*directions(poses, convention), poses=poses, convention=convention, **options.optics())
    chosen = tuple(n for n in USUAL if readings.scaled or n != "k") if free is None else parse_free(free)
    if free is not None and free.strip() == "all":
        chosen = tuple(n for n in chosen if _enters(n, readings, scene))
    fitted = _fit(Problem(scene, readings, options.values(ridge_angle), chosen), json_)
    return show(fitted, f"Fit of {table.name}", json_, html)


@app.command
def experiment(
    table: Path,
    /,
    *,
    free: FreeOption = "alpha_along,alpha_across,k",
    options: ModelOptions | None = None,
    angles: PoseOptions | None = None,
    json_: Json = False,
    html: HtmlOption = None,
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
    from anisoscope.parameters.geometry import Convention

    options, angles = options or ModelOptions(), angles or PoseOptions()
    _at_most_one(json_, html)
    chosen = tuple(n for n in parse_free(free) if free.strip() != "all" or n != "ridge_angle_deg")
    problem = experiment_problem(
        read_measured(table),
        Convention(angles.light_angle, angles.tilt_plane, angles.facet_azimuth),
        options.optics(bounces=1),
        options.values(10.0),
        tuple(n for n in chosen if not (n == "height_loss" and options.model == "printed" and free == "all")),
    )
    return show(_fit(problem, json_), f"Fit of {table.name} to the published experiment", json_, html)


@app.command
def brdf(
    table: Path,
    /,
    *,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees; 0 is a flat surface.")],
    fit: Annotated[bool, Parameter(negative="", help="Fit; otherwise only compare.")] = False,
    free: Annotated[
        str | None,
        Parameter(help="Free parameters with --fit, as in fit ridges; ridge angle and both alphas."),
    ] = None,
    wavelength: Annotated[float | None, Parameter(help="Wavelength in nm, of a table with several.")] = None,
    options: ModelOptions | None = None,
    json_: Json = False,
    html: HtmlOption = None,
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

    options = options or ModelOptions()
    _at_most_one(json_, html)
    if free is not None and not fit:
        raise UsageError("--free needs --fit")
    read = read_brdf(table, wavelength)
    chosen: tuple[str, ...] = ("alpha_along", "alpha_across")
    if ridge_angle != 0.0:
        chosen = ("ridge_angle_deg", *chosen)
    if free is not None:
        chosen = parse_free(free)
    scene = Scene(read.to_light, read.to_camera, **options.optics())
    problem = Problem(scene, read.readings, options.values(ridge_angle), chosen if fit else ())
    return show(_fit(problem, json_), f"BRDF of {table.name}", json_, html, (read, reciprocity(read)))


def reflectance(
    table: Path,
    /,
    *,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees; 0 is a flat surface.")],
    fit: Annotated[bool, Parameter(negative="", help="Fit; otherwise only compare.")] = False,
    free: Annotated[str | None, Parameter(help="Free parameters with --fit, as in fit ridges.")] = None,
    wavelength: Annotated[float | None, Parameter(help="Wavelength in nm, of a file with several.")] = None,
    options: ModelOptions | None = None,
    json_: Json = False,
    html: HtmlOption = None,
) -> int:
    """Compare a reflectance file or table with a model, and fit material and ridge angle to it, as fit brdf.

    Args:
        table: file of bsdf import, or RGL .bsdf, MERL, Klems XML, Zemax.

    Examples:
        anisoscope bsdf fit table.csv --ridge-angle 0 --fit
    """
    return brdf(
        table,
        ridge_angle=ridge_angle,
        fit=fit,
        free=free,
        wavelength=wavelength,
        options=options,
        json_=json_,
        html=html,
    )


def _at_most_one(json_: bool, html: Path | None) -> None:
    if json_ and html is not None:
        raise UsageError("--json and --html exclude each other")


def _enters(name: str, readings: "Readings", scene: "Scene") -> bool:
    """A parameter of --free all that this model and kind of value know."""
    if name == "k":
        return readings.scaled
    return name != "height_loss" or scene.model == "corrected"


def _fit(problem: "Problem", quiet: bool) -> "Fit":
    from anisoscope.fit.fitting import fit

    with progress("fitting", quiet=quiet) as advance:
        return fit(problem, advance)
