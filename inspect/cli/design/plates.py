"""``anisoscope design plate``: grey pictures made of ridges, another one after a turn of the stage."""

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

MOST_POINTS = 60_000_000
"""Points of a height map: half a gigabyte."""
LEAST_PITCH_UM = 50.0


@everyday("out", "angles", "field_count", "field_um", "pitch", "pixel", "overwrite", "json_")
def plate(
    first: Path,
    second: Path | None = None,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for table, map and pictures; made if it is missing.")],
    angles: Annotated[str, Parameter(help="Stage angles at which the pictures are seen.")] = "0,90",
    field_count: Annotated[
        int | None,
        Parameter(
            "--field-count",
            help="Field count along the longer side; one a pixel of the picture if not given.",
        ),
    ] = None,
    field_um: Annotated[float, Parameter(help="Side of a field in µm, two ridges or more.")] = 100.0,
    pitch: Annotated[float, Parameter(help="Pitch of the ridges in µm, 50 or more.")] = 50.0,
    pixel: Annotated[float, Parameter(help="Pixel size of the height map in µm.")] = 5.0,
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10,
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2,
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace files that exist.")] = False,
    json_: Json = False,
) -> int:
    """Make a plate of ridges that shows a grey picture, and another one when it is turned.

    Direction and ridge angle of every field are chosen so that its radiance is nearest to what the pictures ask for at
    their stage angles. Writes fields.csv (row, column, azimuth of the facets, ridge angle), plate.x3p, and a predicted
    picture a stage angle; prints SSIM and cross-talk of the predicted pictures.

    Args:
        first: Picture that is seen at the first stage angle.
        second: Picture of the same shape at the second one; without it there is one picture.

    Examples:
        anisoscope design plate portrait.png --field-count 128 --out portrait
        anisoscope design plate day.png night.png --angles 0,90 --field-um 120 --out day-and-night
    """
    import cv2

    from anisoscope.profiles.files.load import write_height_map
    from anisoscope.profiles.plates import map_of_fields
    from anisoscope.sim.design.plates import design_pictures
    from anisoscope.sim.light.material import Material

    paths = (first,) if second is None else (first, second)
    stages = parse_numbers(angles, "--angles")[: len(paths)]
    if len(stages) != len(paths):
        raise UsageError(f"--angles must name a stage angle a picture, {len(paths)} of them, not {angles}")
    if pitch < LEAST_PITCH_UM:
        raise UsageError(
            f"--pitch must be {LEAST_PITCH_UM:g} µm or more, not {pitch:g}: finer ridges diffract, and are not milled"
        )
    pictures = _pictures(paths, field_count)
    steps = round(field_um / pixel)
    points = pictures[0].size * steps * steps
    if points > MOST_POINTS:
        raise UsageError(
            f"a map of {points / 1e6:.0f} million points is too large (at most {MOST_POINTS / 1e6:.0f}): take fewer "
            "--field-count, or a larger --pixel"
        )
    names = ["fields.csv", "plate.x3p", *(f"predicted-{stage:g}.png" for stage in stages)]
    existing = [name for name in names if (out / name).exists()]
    if existing and not overwrite:
        raise UsageError(f"{out / existing[0]} exists; give another folder, or --overwrite")
    found = design_pictures(pictures, stages, Material(alpha_along, alpha_across, albedo), light_angle)
    surface = map_of_fields(found.azimuth_deg, found.ridge_angle_deg, field_um, pitch, pixel)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UsageError(f"cannot make the folder {out}: {problem.strerror}") from None
    rows, cols = np.indices(found.azimuth_deg.shape)
    table = np.stack([rows, cols, found.azimuth_deg, found.ridge_angle_deg], axis=-1).reshape(-1, 4)
    head = "row,column,facet_azimuth_deg,ridge_angle_deg"
    np.savetxt(
        out / "fields.csv", table, fmt=("%d", "%d", "%g", "%g"), delimiter=",", header=head, comments=""
    )
    write_height_map(surface, out / "plate.x3p")
    white = float(found.shown.max())
    for stage, shown in zip(stages, found.shown, strict=True):
        cv2.imwrite(str(out / f"predicted-{stage:g}.png"), np.rint(255.0 * shown / white).astype(np.uint8))
    size_mm = tuple(1e-3 * field_um * n for n in pictures[0].shape[::-1])
    if json_:
        print_json(
            {
                "fields": pictures[0].shape,
                "size_mm": size_mm,
                "stages_deg": stages,
                "ssim": found.similarity,
                "cross_talk": found.cross_talk,
                "range_per_sr": [float(found.wanted.min()), float(found.wanted.max())],
                "files": [str(out / name) for name in names],
            }
        )
        return 0
    print_table(
        f"{pictures[0].shape[1]} × {pictures[0].shape[0]} fields, {size_mm[0]:g} mm × {size_mm[1]:g} mm",
        ["stage [°]", "picture", "SSIM", "cross-talk"],
        [
            [f"{stage:g}", path.name, f"{one:.3f}", f"{talk:.1%}"]
            for stage, path, one, talk in zip(stages, paths, found.similarity, found.cross_talk, strict=True)
        ],
        caption=f"of predicted pictures, direct light {light_angle:g}° from the camera; written: "
        + ", ".join(str(out / name) for name in names),
    )
    return 0


def _pictures(paths: tuple[Path, ...], fields: int | None) -> np.ndarray:
    """(K, rows, cols) grey pictures from 0 to 1.

    Raises:
        UsageError: one cannot be read, or they differ in shape.
    """
    import cv2

    found = []
    for path in paths:
        content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, np.uint8)
        grey = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if content.size else None
        if grey is None:
            raise UsageError(f"{path}: there is no such picture, or it cannot be read")
        if fields is not None:
            if fields < 1:
                raise UsageError(f"--field-count must be 1 or more, not {fields}")
            scale = fields / max(grey.shape)
            size = tuple(max(1, round(scale * n)) for n in grey.shape[::-1])
            grey = cv2.resize(grey, (size[0], size[1]), interpolation=cv2.INTER_AREA)
        found.append(np.asarray(grey, dtype=np.float64) / 255.0)
    if len({one.shape for one in found}) > 1:
        shapes = " and ".join(f"{one.shape[1]} × {one.shape[0]}" for one in found)
        raise UsageError(f"the two pictures have {shapes} fields: give pictures of one shape")
    return np.array(found)
