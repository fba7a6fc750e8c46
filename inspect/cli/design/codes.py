"""``anisoscope design code``: a code made of ridges, as plan, height maps of part and mould insert, and recipe."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.kinds.plates.expectation import ExpectedPlate
    from anisoscope.kinds.plates.recipe import Symbology
    from anisoscope.profiles.plates import Plan

MOST_MESH_POINTS = 4_000_000
"""Points of a mesh: 400 MB of STL."""
LIGHT_DEG = 10.0


@everyday("out", "symbology", "pitch", "ridge_angle", "module_mm", "plate_mm", "stl", "overwrite", "json_")
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
    pixel: Annotated[float, Parameter(help="Pixel size of the height maps in µm.")] = 2.0,
    stl: Annotated[bool, Parameter(negative="", help="Write part and insert as STL meshes, too.")] = False,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
    json_: Json = False,
) -> int:
    """Make a code of ridges in two directions, which exchange light and dark when the part is turned.

    Writes plan.csv, part.x3p, insert.x3p (mirrored negative, for the mould), with --stl both as STL in mm, and
    recipe.toml of kind plates; prints the contrast that is predicted and its grade.

    Args:
        text: What the code says.

    Examples:
        anisoscope design code A17 --out code
        anisoscope design code "LOT 7" --symbology qr --pitch 40 --module-mm 0.16 --draft 5 --out qr-code
    """
    from anisoscope.kinds.plates.expectation import expected_plate
    from anisoscope.kinds.plates.recipe import PlateRecipe
    from anisoscope.kinds.registry import kind_named
    from anisoscope.profiles.comparison import turned_over
    from anisoscope.profiles.files.load import write_height_map
    from anisoscope.profiles.ideal import RidgeDesign
    from anisoscope.profiles.plates import plan_of_modules, plate_map
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
        raise UsageError(
            f"{text!r} needs {len(plan.rows)} × {len(plan.rows)} modules with its quiet zone, {plan.size_mm[0]:g} mm "
            f"of {module_mm:g} mm each; the plate has {plate_mm:g} mm: make modules of at most "
            f"{plate_mm / len(plan.rows):.3g} mm, or the text shorter"
        )
    wall: Any = "perpendicular" if draft is None else draft
    design = RidgeDesign(pitch, ridge_angle, wall)
    surface = plate_map(plan, design, pixel)
    if stl and surface.height_um.size > MOST_MESH_POINTS:
        raise UsageError(
            f"a mesh of {surface.shape[0]} × {surface.shape[1]} points is too large (at most {MOST_MESH_POINTS:,}): "
            "take a larger --pixel"
        )
    maps = {"part": surface, "insert": turned_over(surface)}
    names = ["plan.csv", "recipe.toml", *(f"{name}.x3p" for name in maps)]
    names += [f"{name}.stl" for name in maps] if stl else []
    _check_folder(out, names, overwrite=overwrite)
    (out / "plan.csv").write_text("".join(f"{','.join(row)}\n" for row in plan.rows), encoding="utf-8")
    (out / "recipe.toml").write_text(
        recipe_text(text, symbology, plan, pitch, ridge_angle, draft), encoding="utf-8"
    )
    for name in names[2:]:
        stem, _, _ = name.partition(".")
        write_height_map(maps[stem], out / name)
    recipe = kind_named("plates").read_recipe(out / "recipe.toml")
    assert isinstance(recipe, PlateRecipe)
    expected = expected_plate(recipe, plan, LIGHT_DEG, cached=True)
    _print(text, symbology, plan, expected, [out / name for name in names], as_json=json_)
    return 0


def _check_folder(out: Path, names: list[str], *, overwrite: bool) -> None:
    """Make the folder.

    Raises:
        UsageError: files exist, or the folder cannot be made.
    """
    existing = [name for name in names if (out / name).exists()]
    if existing and not overwrite:
        raise UsageError(f"{out / existing[0]} exists; give another folder, or --overwrite")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UsageError(f"cannot make the folder {out}: {problem.strerror}") from None


def recipe_text(
    text: str, symbology: str, plan: "Plan", pitch_um: float, ridge_angle_deg: float, draft_deg: float | None
) -> str:
    """Text of the recipe of a code; plastic, exposure and tolerances are to be adapted."""
    import tomli_w

    design: dict[str, Any] = {"ridge_angle_deg": ridge_angle_deg, "u_ridge_angle_deg": 0.1}
    if draft_deg is not None:
        design["wall"] = draft_deg
    tables = {
        "schema": 1,
        "kind": "plates",
        "product": f"{symbology} {text} of ridges",
        "surface": {"pitch_um": pitch_um, "design": design},
        "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2},
        "plan": {
            "file": "plan.csv",
            "module_mm": plan.module_mm,
            "facet_azimuths_deg": dict(plan.azimuths_deg),
        },
        "code": {"text": text, "symbology": symbology, "read_at_deg": [0.0, 90.0]},
        "poses": {"angles_deg": [0.0, 90.0]},
        "acquisition": {"exposure_s": 0.006},
        "region": {"size_mm": [round(one, 6) for one in plan.size_mm]},
        "decision": {"tolerance": 0.4},
    }
    head = (
        "# Recipe of a plate whose code is made of ridges. To be adapted: [material] (its lobe is unmeasured here),\n"
        "# [acquisition], [decision] and [fields]; `anisoscope recipe check` reads it.\n"
    )
    return head + tomli_w.dumps(tables)


def _print(
    text: str,
    symbology: "Symbology",
    plan: "Plan",
    expected: "ExpectedPlate",
    paths: list[Path],
    *,
    as_json: bool,
) -> None:
    import numpy as np

    from anisoscope.kinds.plates.code_grades import OVERALL
    from anisoscope.kinds.plates.decision import predicted_code

    rows = list[dict[str, Any]]()
    readings, grades = predicted_code(expected, symbology)
    for number, pose in enumerate(expected.poses):
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
        "files": [str(path) for path in paths],
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
        caption=f"light {LIGHT_DEG:g}° from the camera; grades after ISO/IEC 29158 and 15415; written: "
        + ", ".join(str(path) for path in paths),
    )
