"""``anisoscope design plate`` and ``design code``: pictures and codes made of ridges."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.cli.help_page import MORE, everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_PLASTIC, OF_RIDGES, Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.parameters.manufacture import CodeDesign, GreyPictures, Manufacture, PlateDesign
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.operations.design.plates import DesignedCode, DesignedPlate

OF_MOULD = Options(
    Manufacture, Group("Mould and tool", sort_key=20), names={"base_mm": "--base-mm"}, flags=True
)
OF_CODE = replace(
    OF_RIDGES,
    names={"wall": "--draft", "edge_radius_um": "--tool-radius"},
    help={
        "wall": "Draft of the walls in degrees from the vertical; perpendicular to the facets if not given.",
        "edge_radius_um": "Radius of the tool's tip in µm, that of the crests.",
    },
    default=RidgeDesign(50.0, 10.0),
    without={"height_loss": "a design has whole crests"},
)
OF_PICTURE = replace(
    OF_CODE,
    help={
        "pitch_um": "Pitch of the ridges in µm, 50 or more.",
        "wall": "Draft of walls and borders in degrees from the vertical, 1 or more.",
        "edge_radius_um": "Radius of the tool's tip in µm, that of the crests.",
    },
    default=RidgeDesign(50.0, 8.0, 10.0, edge_radius_um=1.0),
    without={"height_loss": "a design has whole crests", "ridge_angle_deg": "chosen for every field"},
)
UNMEASURED = "the recipe to begin with has an unmeasured lobe"
OF_LOBE = replace(
    OF_PLASTIC, without=dict.fromkeys(("internal_reflection", "tail", "second_lobe"), UNMEASURED)
)
OutOption = Annotated[Path, Parameter(help="Folder for the files; made if it is missing.")]
OF_PLATE = Options(
    PlateDesign,
    names={"stages_deg": "--angles", "field_um": "--field-um"},
    groups=dict.fromkeys(("pixel_um", "light_angle_deg", "class_count"), MORE),
    whole=True,
    flags=True,
)
OF_SYMBOL = Options(
    CodeDesign,
    names={"module_mm": "--module-mm", "plate_mm": "--plate-mm"},
    groups=dict.fromkeys(("pixel_um", "facet_azimuths_deg"), MORE),
    whole=True,
    flags=True,
)


@with_options(
    options=OF_PLATE,
    greys=Options(GreyPictures, groups={"tone": MORE}, whole=True),
    ridges=OF_PICTURE,
    plastic=OF_LOBE,
    manufacture=OF_MOULD,
)
def plate(
    first: Path,
    second: Path | None = None,
    /,
    *,
    out: OutOption,
    options: Given[PlateDesign],
    greys: Given[GreyPictures],
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    manufacture: Given[Manufacture],
    json_: Json = False,
) -> int:
    """Make a plate of ridges that shows a grey picture, and another one when it is turned.

    Direction and ridge angle of every field are chosen so that its radiance is nearest to what the pictures ask for at
    their stage angles. Writes plan.csv and fields.csv (row, column, class, azimuth of the facets, ridge angle),
    recipe.toml of kind plates, the height maps part.x3p and insert.x3p (mirrored negative, for the mould), a predicted
    picture a stage angle, and appearance.html, a page to turn the part under light from any side; on request, bodies of
    part and insert as STL, and the cuts of the insert. Prints SSIM and cross-talk of the predicted pictures.

    Args:
        first: Picture that is seen at the first stage angle.
        second: Picture of the same shape at the second one; without it there is one picture.

    Examples:
        anisoscope design plate portrait.png --field-count 128 --out portrait
        anisoscope design plate day.png night.png --angles 0,90 --field-um 150 --stl --path --out day-and-night
    """
    from anisoscope.operations.design.plates import PICTURE_RIDGES, design_plate, read_grey

    paths = (first,) if second is None else (first, second)
    asked = greys.made()
    pictures = [read_grey(path, asked.field_count, asked.tone) for path in paths]
    with progress("trial", quiet=json_) as advance:
        found = design_plate(
            pictures,
            out,
            plate=options.made(),
            names=[path.name for path in paths],
            ridges=ridges.over(PICTURE_RIDGES),
            material=plastic.over(Material()),
            make=manufacture.over(Manufacture()),
            on_progress=advance,
        )
    if json_:
        print_json(found)
    else:
        _print(found, [path.name for path in paths], out)
    return 0


def cuts_text(found: "DesignedPlate | DesignedCode") -> str:
    """Length and time of the cuts of an insert, for the title of a table."""
    if found.cut_length_m is None:
        return ""
    return f"; cuts of {found.cut_length_m:.3g} m in {found.cut_minutes:.0f} min"


def _print(found: "DesignedPlate", pictures: list[str], out: Path) -> None:
    plan, design = found.found.plan, found.found
    cuts = cuts_text(found)
    files = f"in {out}: {', '.join(path.name for path in found.files)}"
    files += "" if found.trial is None else f"; inspected: {found.trial.verdict}, {found.trial.report}"
    judged = [("predicted", found.likeness)] + ([("camera", found.camera)] if found.camera else [])
    print_table(
        f"{plan.shape[1]} × {plan.shape[0]} fields of {len(plan.letters)} classes, {plan.size_mm[0]:g} mm × "
        f"{plan.size_mm[1]:g} mm{cuts}",
        ["stage [°]", "picture", "", "SSIM", "cross-talk"],
        [
            [f"{stage:g}", picture, name, f"{like.ssim[number]:.3f}", f"{like.cross_talk[number]:.1%}"]
            for name, like in judged
            for number, (stage, picture) in enumerate(zip(found.stages_deg, pictures, strict=True))
        ],
        caption=f"black {design.black:.4f}/sr, white {design.white:.4f}/sr ({design.white / design.black:.1f} times), "
        f"greys are missed by {found.missed:.1%} of that at most; direct light {found.light_angle_deg:g}° from the "
        f"camera; written {files}",
    )


@with_options(options=OF_SYMBOL, ridges=OF_CODE, manufacture=OF_MOULD)
@everyday("out", "options", "ridges", "manufacture", "json_")
def code(
    text: str,
    /,
    *,
    out: OutOption,
    options: Given[CodeDesign],
    ridges: Given[RidgeDesign],
    manufacture: Given[Manufacture],
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
    from anisoscope.kinds.plates.code_grades import OVERALL
    from anisoscope.operations.design.plates import CODE_RIDGES, LIGHT_DEG, design_code

    symbol = options.made()
    with progress("trial", quiet=json_) as advance:
        found = design_code(
            text,
            out,
            code=symbol,
            ridges=ridges.over(CODE_RIDGES),
            make=manufacture.over(Manufacture()),
            on_progress=advance,
        )
    if json_:
        return print_json(found)
    tried = (
        "" if found.trial is None else f"; on the virtual rig: {found.trial.verdict}, {found.trial.report}"
    )
    print_table(
        f"{symbol.symbology} {text!r}: {found.modules[1]} × {found.modules[0]} modules of {symbol.module_mm:g} mm"
        f"{cuts_text(found)}",
        ["stage [°]", "light [1/sr]", "dark [1/sr]", "cell contrast", OVERALL, "predicted picture says"],
        [
            [
                f"{one.stage_deg:g}",
                f"{one.light:.4f}",
                f"{one.dark:.4f}",
                f"{1.0 - one.dark / one.light:.2f}",
                str(one.grades[0].grade),
                f"{one.reads!r}" + (", inverted" if one.inverted else ""),
            ]
            for one in found.poses
        ],
        caption=f"light {LIGHT_DEG:g}° from the camera; grades after ISO/IEC 29158 and 15415; written in {out}: "
        f"{', '.join(path.name for path in found.files)}{tried}",
    )
    return 0
