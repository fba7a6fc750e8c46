"""``anisoscope design plate``: grey pictures made of ridges, another one after a turn of the stage."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.manufacture import (
    Manufacture,
    inspected_at,
    new_folder,
    plan_text,
    recipe_of,
    recipe_text,
)
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.sim.design.plates import PictureDesign

Tone = Literal["linear", "srgb"]


@everyday(
    "out", "angles", "field_count", "field_um", "pitch", "draft", "manufacture", "trial", "overwrite", "json_"
)
def plate(
    first: Path,
    second: Path | None = None,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for tables, maps and pictures; made if it is missing.")],
    angles: Annotated[str, Parameter(help="Stage angles at which the pictures are seen.")] = "0,90",
    field_count: Annotated[
        int | None,
        Parameter(
            "--field-count",
            help="Field count along the longer side; one a pixel of the picture if not given.",
        ),
    ] = None,
    field_um: Annotated[
        float, Parameter(help="Side of a field in µm, two ridges or more, whole ones.")
    ] = 100.0,
    pitch: Annotated[float, Parameter(help="Pitch of the ridges in µm, 50 or more.")] = 50.0,
    draft: Annotated[
        float, Parameter(help="Draft of walls and borders in degrees from the vertical, 1 or more.")
    ] = 10.0,
    tool_radius: Annotated[
        float, Parameter(help="Radius of the tool's tip in µm, that of the crests.")
    ] = 1.0,
    class_count: Annotated[
        int,
        Parameter("--class-count", help="Most classes of fields: directions and ridge angles that differ."),
    ] = 64,
    tone: Annotated[
        Tone,
        Parameter(
            help="Greys of the pictures: proportional to radiance, as a camera sees them, or sRGB, for the eye."
        ),
    ] = "linear",
    pixel: Annotated[float, Parameter(help="Pixel size of the height maps in µm.")] = 5.0,
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10,
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2,
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0,
    manufacture: Manufacture | None = None,
    trial: Annotated[
        bool,
        Parameter(negative="", help="Trial on the virtual rig: photograph the plate, and compare."),
    ] = False,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
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
    from anisoscope.kinds.registry import kind_named
    from anisoscope.operations.demo.plates import check_trial, photograph
    from anisoscope.parameters.material import Material
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.report.plate_page import write_plate_page
    from anisoscope.sim.design.plates import design_pictures

    paths = (first,) if second is None else (first, second)
    stages = parse_numbers(angles, "--angles")[: len(paths)]
    if len(stages) != len(paths):
        raise UsageError(f"--angles must name a stage angle a picture, {len(paths)} of them, not {angles}")
    pictures = _pictures(paths, field_count, tone)
    design, material = (
        RidgeDesign(pitch, 8.0, draft, edge_radius_um=tool_radius),
        Material(alpha_along, alpha_across, albedo),
    )
    found = design_pictures(pictures, stages, design, field_um, material, light_angle, class_count)
    make = manufacture or Manufacture()
    make.check(found.plan, design, pixel)
    if trial:
        check_trial(found.plan)
    shown = [f"predicted-{stage:g}.png" for stage in stages]
    seen = [f"camera-{stage:g}.png" for stage in stages] if trial else []
    names = ["plan.csv", "fields.csv", "recipe.toml", "appearance.html", *shown, *seen, *make.names()]
    new_folder(out, names, overwrite=overwrite)
    length_m = make.write(out, found.plan, design, pixel)
    (out / "plan.csv").write_text(plan_text(found.plan), encoding="utf-8")
    (out / "fields.csv").write_text(_fields_text(found), encoding="utf-8")
    tables = recipe_of(found.plan, design, f"plate that shows {' and '.join(path.name for path in paths)}")
    lobe = {"alpha_along": alpha_along, "alpha_across": alpha_across, "albedo": albedo}
    tables |= {"material": lobe, "poses": {"angles_deg": inspected_at(stages)}}
    (out / "recipe.toml").write_text(recipe_text(tables), encoding="utf-8")
    kind_named("plates").read_recipe(out / "recipe.toml")
    title = " and ".join(path.stem for path in paths)
    write_plate_page(
        out / "appearance.html",
        title,
        found.plan,
        design,
        material,
        light_angle,
        stages,
        (found.black, found.white),
    )
    for name, one in zip(shown, found.shown, strict=True):
        _write_picture(out / name, one, found)
    rows, tried = {"predicted": found.likeness()}, None
    if trial:
        with progress("trial", quiet=json_) as advance:
            tried = photograph(out, found.plan, design, lobe, advance)
        photographs = tried.radiance[: len(stages)]
        for name, one in zip(seen, photographs, strict=True):
            _write_picture(out / name, one, found)
        rows["camera"] = found.likeness(photographs)
    if json_:
        files = [str(out / name) for name in names]
        report = None if tried is None else {"verdict": tried.verdict, "report": str(tried.report)}
        print_json(_content(found, rows, length_m, files) | {"trial": report})
    else:
        written = f"in {out}: {', '.join(names)}"
        written += "" if tried is None else f"; inspected: {tried.verdict}, {tried.report}"
        _print(found, rows, [path.name for path in paths], light_angle, length_m, written)
    return 0


def _content(
    found: "PictureDesign", rows: dict[str, Any], length_m: float | None, files: list[str]
) -> dict[str, Any]:
    likeness = {name: {"ssim": ssim, "cross_talk": talk} for name, (ssim, talk) in rows.items()}
    return {
        "fields": found.plan.shape,
        "size_mm": found.plan.size_mm,
        "stages_deg": found.stages_deg,
        **likeness["predicted"],
        "camera": likeness.get("camera"),
        "black_per_sr": found.black,
        "white_per_sr": found.white,
        "classes": len(found.plan.letters),
        "missed": found.missed,
        "cut_length_m": length_m,
        "files": files,
    }


def _print(
    found: "PictureDesign",
    rows: dict[str, Any],
    pictures: list[str],
    light_angle: float,
    length_m: float | None,
    files: str,
) -> None:
    plan = found.plan
    cuts = "" if length_m is None else f"; cuts of {length_m:.3g} m"
    print_table(
        f"{plan.shape[1]} × {plan.shape[0]} fields of {len(plan.letters)} classes, {plan.size_mm[0]:g} mm × "
        f"{plan.size_mm[1]:g} mm{cuts}",
        ["stage [°]", "picture", "", "SSIM", "cross-talk"],
        [
            [f"{stage:g}", picture, name, f"{ssim[number]:.3f}", f"{talk[number]:.1%}"]
            for name, (ssim, talk) in rows.items()
            for number, (stage, picture) in enumerate(zip(found.stages_deg, pictures, strict=True))
        ],
        caption=f"black {found.black:.4f}/sr, white {found.white:.4f}/sr ({found.white / found.black:.1f} times), "
        f"greys are missed by {found.missed:.1%} of that at most; direct light {light_angle:g}° from the camera; "
        f"written {files}",
    )


def _fields_text(found: "PictureDesign") -> str:
    plan = found.plan
    tail = {one: f"{one},{plan.azimuths_deg[one]:g},{plan.ridge_angles_deg[one]:g}\n" for one in plan.letters}
    lines = [f"{row},{col},{tail[one]}" for row, text in enumerate(plan.rows) for col, one in enumerate(text)]
    return "row,column,class,facet_azimuth_deg,ridge_angle_deg\n" + "".join(lines)


def _write_picture(path: Path, radiance: np.ndarray, found: "PictureDesign") -> None:
    """Write radiances as grey levels from black to white."""
    import cv2

    grey = np.clip((radiance - found.black) / (found.white - found.black), 0.0, 1.0)
    cv2.imwrite(str(path), np.rint(255.0 * grey).astype(np.uint8))


def _pictures(paths: tuple[Path, ...], fields: int | None, tone: Tone) -> np.ndarray:
    """(K, rows, cols) grey pictures from 0 to 1.

    Raises:
        UsageError: one cannot be read, or they differ in shape.
    """
    import cv2

    found = []
    for path in paths:
        content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, np.uint8)
        decoded = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if content.size else None
        if decoded is None:
            raise UsageError(f"{path}: there is no such picture, or it cannot be read")
        grey = np.asarray(decoded, dtype=np.float64) / 255.0
        if tone == "srgb":
            # IEC 61966-2-1
            grey = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
        if fields is not None:
            if fields < 1:
                raise UsageError(f"--field-count must be 1 or more, not {fields}")
            scale = fields / max(grey.shape)
            size = tuple(max(1, round(scale * n)) for n in grey.shape[::-1])
            grey = np.asarray(cv2.resize(grey, (size[0], size[1]), interpolation=cv2.INTER_AREA))
        found.append(grey)
    if len({one.shape for one in found}) > 1:
        shapes = " and ".join(f"{one.shape[1]} × {one.shape[0]}" for one in found)
        raise UsageError(f"the two pictures have {shapes} fields: give pictures of one shape")
    return np.array(found)
