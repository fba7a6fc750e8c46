"""``anisoscope bsdf``: reflectance to and from renderers and instruments."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.bsdf.sources import NodesOption, SourceOptions, resolution_of
from anisoscope.cli.ink.options import OverwriteOption, check_new, check_suffix
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console, print_table

app = App(name="bsdf", help="Exchange reflectance with renderers and instruments: export, import, fit, show.")
app.command("anisoscope.cli.fit.fit:reflectance", name="fit")
app.command("anisoscope.cli.bsdf.textures:textures")


@app.command
def export(
    target: Path,
    /,
    *,
    source: SourceOptions | None = None,
    format_: Annotated[
        Literal["rgl", "merl", "zemax", "klems", "tensor-tree"] | None,
        Parameter(
            name="--file-format", help="Format; by the extension .bsdf (RGL), .binary (MERL), .xml (Klems)."
        ),
    ] = None,
    wavelength: Annotated[float | None, Parameter(help="Keep one wavelength in nm.")] = None,
    nodes: NodesOption = None,
    scene: Annotated[Path | None, Parameter(help="RGL: also write a scene *.xml for Mitsuba.")] = None,
    scene_shape: Annotated[Literal["sphere", "plate"], Parameter(help="Shape in the scene.")] = "sphere",
    overwrite: OverwriteOption = False,
    json_: Json = False,
) -> int:
    """Write the reflectance of ridges, an ink, etched steps, a height map or a file for renderers.

    Formats: RGL .bsdf, MERL, Zemax, and Klems or tensor tree in XML. The file is read back and compared; what the
    format does not hold is printed in numbers.

    Args:
        target: file to write.

    Examples:
        anisoscope bsdf export ridges.bsdf --ridge-angle 10 --scene ridges.xml
        anisoscope bsdf export plastic.binary --ridge-angle 0 --alpha-along 0.1 --alpha-across 0.1
        anisoscope bsdf export lobe.bsdf --design lobe.toml
    """
    from anisoscope.bsdf.formats import export as write
    from anisoscope.bsdf.formats import format_of

    source = source or SourceOptions()
    name = format_ or format_of(target)
    if name != "rgl" and (nodes is not None or scene is not None):
        raise UsageError(f"--{'nodes' if nodes is not None else 'scene'} belongs to RGL .bsdf files")
    check_suffix(scene, "--scene", ".xml")
    check_new((target, scene), overwrite=overwrite)
    resolution = resolution_of(nodes)
    with progress(target.name, quiet=json_) as advance:
        surface = source.reflectance(advance)
        if wavelength is not None:
            surface = surface.at(wavelength)
        drawn = None if scene is None else (scene, scene_shape)
        done = write(surface, target, name, resolution, advance, drawn)
    if json_:
        print_json({"file": str(target), "format": done.format, "bytes": done.size, "rms": done.rms,
                    "losses": list(done.losses), "scene": None if scene is None else str(scene)})  # fmt: skip
        return 0
    _line(f"{target}: {surface.name}, {done.format}, {done.size / 1e6:.3g} MB")
    _line(f"read back: {done.rms:.2%} rms off, directions to 60° and half vectors to 30° from the normal")
    for loss in done.losses:
        _line(f"lost: {loss}")
    if scene is not None:
        _line(f"{scene}: mitsuba -m scalar_spectral {scene}")
    return 0


@app.command
def show(
    file: Path,
    /,
    *,
    json_: Json = False,
) -> int:
    """Show what a reflectance file holds: wavelengths, albedo, and whether it is reciprocal and positive.

    Args:
        file: RGL .bsdf, MERL, Klems or tensor-tree XML, or Zemax, identified by its content.

    Examples:
        anisoscope bsdf show ridges.bsdf
    """
    from anisoscope.bsdf.formats import read_reflectance
    from anisoscope.bsdf.reflectance import WATCHED_DEG, physics_of

    found = read_reflectance(file)
    physics = physics_of(found)
    nm = found.wavelengths_nm
    if json_:
        print_json({"file": str(file), "name": found.name, "wavelengths_nm": list(nm), "isotropic": found.isotropic,
                    "albedo": dict(zip((f"{deg:g}" for deg in WATCHED_DEG), physics.albedo, strict=True)),
                    "reciprocity_rms": physics.reciprocity_rms, "negative_share": physics.negative_share,
                    "anisotropy": physics.anisotropy,
                    "warnings": [*found.notes, *physics.warnings()]})  # fmt: skip
        return 0
    waves = "one value for all light" if not nm else f"{nm[0]:g} nm" if len(nm) == 1 else (
        f"{len(nm)}, {nm[0]:g} to {nm[-1]:g} nm"
    )  # fmt: skip
    rows = [
        ["wavelengths", waves],
        *(
            [f"albedo, light at {deg:g}°", f"{value:.4g}"]
            for deg, value in zip(WATCHED_DEG, physics.albedo, strict=True)
        ),
        ["change by a quarter turn, rms", f"{physics.anisotropy:.2%}"],
        ["light and camera exchanged, rms", f"{physics.reciprocity_rms:.2%}"],
    ]
    print_table(found.name, ["quantity", "value"], rows)
    for warning in (*found.notes, *physics.warnings()):
        _line(f"warning: {warning}")
    return 0


@app.command(name="import")
def import_(
    file: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="CSV file to write: one row a pair of directions, for bsdf fit.")],
    columns: Annotated[
        str | None,
        Parameter(
            help="CSV: our columns by those of the file or by numbers: theta_i_deg=AOI,phi_i_deg=0,value=BRDF."
        ),
    ] = None,
    angle_unit: Annotated[
        Literal["deg", "rad"] | None,
        Parameter(help="Angles of the file; E2387 ASCII rad, CSV deg by default."),
    ] = None,
    values_are: Annotated[
        Literal["brdf", "radiance", "factor"],
        Parameter(
            help="Values: BRDF in 1/sr, BRDF × cos θi (CCBRDF), or ratios to a perfect white (π × BRDF)."
        ),
    ] = "brdf",
    pairs: Annotated[int, Parameter(help="Of a gridded file: pairs of directions to sample.")] = 2000,
    overwrite: OverwriteOption = False,
    json_: Json = False,
) -> int:
    """Turn an instrument's table or a renderer's file into the table that bsdf fit reads.

    Args:
        file: CSV with a header, ASTM E2387-style ASCII (a line VARS), RGL .bsdf, MERL, Klems or tensor-tree XML,
            or Zemax.

    Examples:
        anisoscope bsdf import gonio.csv --columns theta_i_deg=AOI,phi_i_deg=0,theta_o_deg=Det,phi_o_deg=180 --out t.csv
        anisoscope bsdf import chrome.binary --out chrome.csv
    """
    from anisoscope.base.atomic_write import write_text
    from anisoscope.bsdf import directions_table as tables
    from anisoscope.bsdf.formats import is_reflectance_file, read_reflectance

    check_suffix(out, "--out", ".csv")
    check_new((out,), overwrite=overwrite)
    if not 1 <= pairs <= 1_000_000:
        raise UsageError(f"--pairs takes 1 to 1000000, not {pairs}")
    gridded = is_reflectance_file(file)
    if columns is not None and (gridded or tables.is_astm(file)):
        raise UsageError("--columns belongs to CSV files; this one names its own")
    if gridded and (angle_unit is not None or values_are != "brdf"):
        raise UsageError("--angle-unit and --values-are belong to tables; this format states its own units")
    if gridded:
        table = tables.sampled(read_reflectance(file), pairs)
    elif tables.is_astm(file):
        table = tables.read_astm(file, radians=angle_unit != "deg", quantity=values_are)
    else:
        mapping = _mapping(columns)
        table = tables.read_mapped(file, mapping, radians=angle_unit == "rad", quantity=values_are)
    write_text(out, table.csv())
    negative = int((table.column("value") < 0.0).sum())
    answer: dict[str, Any] = {"file": str(out), "rows": len(table.rows), "columns": list(table.columns),
                              "negative": negative, "remarks": list(table.remarks)}  # fmt: skip
    if json_:
        print_json(answer)
        return 0
    _line(f"{out}: {len(table.rows)} rows ({', '.join(table.columns)})")
    for remark in table.remarks:
        _line(remark)
    if negative:
        _line(f"warning: {negative} of {len(table.rows)} values are negative")
    return 0


def _mapping(text: str | None) -> dict[str, str]:
    pairs = [] if text is None else [part.partition("=") for part in text.split(",")]
    for name, sign, column in pairs:
        if not (name.strip() and sign and column.strip()):
            raise UsageError(f"--columns takes NAME=COLUMN, comma-separated, not {text!r}")
    return {name.strip(): column.strip() for name, _, column in pairs}


def _line(text: str) -> None:
    console().print(text, markup=False, highlight=False, soft_wrap=True)
