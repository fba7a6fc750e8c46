"""``anisoscope design code``: a code made of ridges, as plan, height maps of part and mould insert, and recipe."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.manufacture import Manufacture, new_folder, plan_text, recipe_of, recipe_text
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.kinds.plates.expectation import ExpectedPlate
    from anisoscope.kinds.plates.recipe import Symbology
    from anisoscope.operations.demo.plates import Trial
    from anisoscope.profiles.plates import Plan

LIGHT_DEG = 10.0
READ_AT_DEG = 0.0, 90.0
SHOWN = 40  # characters of a long text in a message


@everyday(
    "out",
    "symbology",
    "pitch",
    "ridge_angle",
    "module_mm",
    "plate_mm",
    "draft",
    "manufacture",
    "trial",
    "overwrite",
    "json_",
)
def code(
    text: str,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for plan, maps and recipe; made if it is missing.")],
    symbology: Annotated[
        Literal["datamatrix", "qr"], Parameter(help="Kind of code; the smallest symbol that holds the text.")
    ] = "datamatrix",
    pitch: Annotated[float, Parameter(help="Pitch of the ridges in µm.")] = 50.0,
    ridge_angle: Annotated[float, Parameter(help="Ridge angle in degrees.")] = 10.0,
    module_mm: Annotated[float, Parameter(help="Side of a module in mm, two ridges or more.")] = 0.2,
    facet_azimuths: Annotated[
        str,
        Parameter(help="Azimuths toward which the facets of light and dark modules fall at stage angle 0."),
    ] = "0,-90",
    draft: Annotated[
        float | None,
        Parameter(
            help="Draft of the walls in degrees from the vertical; perpendicular to the facets if not given."
        ),
    ] = None,
    plate_mm: Annotated[
        float | None, Parameter(help="Side of the plate in mm, which the code must fit; any if not given.")
    ] = None,
    tool_radius: Annotated[
        float, Parameter(help="Radius of the tool's tip in µm, that of the crests.")
    ] = 0.0,
    pixel: Annotated[float, Parameter(help="Pixel size of the height maps in µm.")] = 2.0,
    manufacture: Manufacture | None = None,
    trial: Annotated[
        bool,
        Parameter(negative="", help="Trial on the virtual rig: photograph the plate, and read its code."),
    ] = False,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
    json_: Json = False,
) -> int:
    """Make a code of ridges in two directions, which exchange light and dark when the part is turned.

    Writes plan.csv, recipe.toml of kind plates, the height maps part.x3p and insert.x3p (mirrored negative, for the
    mould) and appearance.html, a page to turn the part under light from any side; on request, bodies of part and insert
    as STL, and the cuts of the insert. Prints the contrast that is predicted and its grade.

    Args:
        text: What the code says.

    Examples:
        anisoscope design code A17 --out code
        anisoscope design code "LOT 7" --symbology qr --module-mm 0.16 --pitch 40 --draft 5 --stl --out qr-code
    """
    from anisoscope.kinds.plates.expectation import expected_plate
    from anisoscope.kinds.plates.recipe import PlateRecipe
    from anisoscope.kinds.registry import kind_named
    from anisoscope.operations.demo.plates import check_trial, photograph
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.profiles.plates import plan_of_modules
    from anisoscope.report.plate_page import write_plate_page
    from anisoscope.sim.design.plates import modules_of_code

    azimuths = parse_numbers(facet_azimuths, "--facet-azimuths")
    if len(azimuths) != 2:
        raise UsageError(
            f"--facet-azimuths takes two azimuths, of light and of dark modules, not {facet_azimuths}"
        )
    dark = modules_of_code(text, symbology)
    plan = plan_of_modules(dark, module_mm, (azimuths[0], azimuths[1]))
    plan.check_ridges(pitch)
    if plate_mm is not None and max(plan.size_mm) > plate_mm * (1.0 + 1e-9):
        shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
        raise UsageError(
            f"{shown!r} needs {len(plan.rows)} × {len(plan.rows)} modules with its quiet zone, {plan.size_mm[0]:g} mm "
            f"of {module_mm:g} mm each; the plate has {plate_mm:g} mm: make modules of at most "
            f"{plate_mm / len(plan.rows):.3g} mm, or the text shorter"
        )
    wall: Any = "perpendicular" if draft is None else draft
    design = RidgeDesign(pitch, ridge_angle, wall, edge_radius_um=tool_radius)
    make = manufacture or Manufacture()
    make.check(plan, design, pixel)
    if trial:
        check_trial(plan)
    names = ["plan.csv", "recipe.toml", "appearance.html", *make.names()]
    new_folder(out, names, overwrite=overwrite)
    make.write(out, plan, design, pixel)
    (out / "plan.csv").write_text(plan_text(plan), encoding="utf-8")
    tables = recipe_of(plan, design, f"{symbology} {text} of ridges")
    tables["code"] = {"text": text, "symbology": symbology, "read_at_deg": list(READ_AT_DEG)}
    (out / "recipe.toml").write_text(recipe_text(tables), encoding="utf-8")
    recipe = kind_named("plates").read_recipe(out / "recipe.toml")
    assert isinstance(recipe, PlateRecipe)
    expected = expected_plate(recipe, plan, LIGHT_DEG, cached=True)
    ends = float(expected.radiance.min()), float(expected.radiance.max())
    title, plastic = f"{symbology} {text}", recipe.material.material()
    write_plate_page(out / "appearance.html", title, plan, design, plastic, LIGHT_DEG, READ_AT_DEG, ends)
    tried = None
    if trial:
        lobe = {
            "alpha_along": plastic.alpha_along,
            "alpha_across": plastic.alpha_across,
            "albedo": plastic.albedo,
        }
        with progress("trial", quiet=json_) as advance:
            tried = photograph(out, plan, design, lobe, advance)
    _print(text, symbology, plan, expected, out, names, tried, as_json=json_)
    return 0


def _print(
    text: str,
    symbology: "Symbology",
    plan: "Plan",
    expected: "ExpectedPlate",
    out: Path,
    names: list[str],
    tried: "Trial | None",
    *,
    as_json: bool,
) -> None:
    import numpy as np

    from anisoscope.kinds.plates.code_grades import OVERALL
    from anisoscope.kinds.plates.decision import predicted_code

    rows = list[dict[str, Any]]()
    readings, grades = predicted_code(expected, symbology)
    for number, pose in enumerate(expected.poses):
        if pose.stage_deg not in READ_AT_DEG:
            continue
        darker = int(np.argmin(expected.radiance[:, number]))
        light, dim = float(expected.radiance[:, number].max()), float(expected.radiance[:, number].min())
        rows.append(
            {
                "stage_deg": pose.stage_deg,
                "light": light,
                "dark": dim,
                "inverted": darker == 0,
                "reads": readings[number],
                "grades": [fields_of(one) for one in grades[number]],
            }
        )
    content = {
        "text": text,
        "symbology": symbology,
        "modules": plan.shape,
        "size_mm": plan.size_mm,
        "poses": rows,
        "files": [str(out / name) for name in names],
        "trial": None if tried is None else {"verdict": tried.verdict, "report": str(tried.report)},
    }
    if as_json:
        print_json(content)
        return
    print_table(
        f"{symbology} {text!r}: {plan.shape[1]} × {plan.shape[0]} modules of {plan.module_mm:g} mm",
        ["stage [°]", "light [1/sr]", "dark [1/sr]", "cell contrast", OVERALL, "predicted picture says"],
        [
            [
                f"{one['stage_deg']:g}",
                f"{one['light']:.4f}",
                f"{one['dark']:.4f}",
                f"{1.0 - one['dark'] / one['light']:.2f}",
                str(one["grades"][0]["grade"]),
                f"{one['reads']!r}" + (", inverted" if one["inverted"] else ""),
            ]
            for one in rows
        ],
        caption=f"light {LIGHT_DEG:g}° from the camera; grades after ISO/IEC 29158 and 15415; written in {out}: "
        f"{', '.join(names)}"
        + ("" if tried is None else f"; on the virtual rig: {tried.verdict}, {tried.report}"),
    )
