"""``anisoscope bsdf``: reflectance to and from renderers and instruments."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.ink.options import InksOption, printed_inks
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import OF_PLASTIC, Flag, Json, Overwrite, check_new, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console, print_table
from anisoscope.parameters.material import Material
from anisoscope.parameters.reflecting import Reflecting
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.bsdf.rgl import Resolution
    from anisoscope.operations.reflectance import Surface

SOURCE = Group(
    "Surface", help="One of --ridge-angle, --ink, --design, --height-map and --from-file.", sort_key=10
)
OF_RIDGES = Options(
    RidgeDesign,
    SOURCE,
    help={
        "ridge_angle_deg": "Ridges along y: ridge angle in degrees; 0 is a flat surface.",
        "pitch_um": "Ridges, height map: pitch in µm; 100, and found in a map.",
    },
)
OF_SURFACE = replace(OF_PLASTIC, group=SOURCE)
NodesOption = Annotated[
    str | None,
    Parameter(help="RGL: inclinations and azimuths of the light, and side of the square: 24,37,48."),
]
MaterialFile = Annotated[
    Path | None, Parameter(help="Plastic: file of calibrate material; options have precedence.")
]


@Parameter(name="*", group=SOURCE)
@dataclass(frozen=True)
class SourceOptions:
    """What reflects, but ridges.

    Attributes:
        from_file: File of another format (RGL, MERL, Klems, tensor tree, Zemax), or a table *.csv of bsdf import.
        pixel: Height map: pixel size in µm where it states none, SIZE or Y,X.
    """

    ink: Annotated[str | None, Parameter(help="Structural-colour ink: file *.toml, or a name.")] = None
    design: Annotated[Path | None, Parameter(help="Etched steps: file *.toml of anisoscope design.")] = None
    height_map: Annotated[Path | None, Parameter(help="Height map, x as the reflectance's.")] = None
    from_file: Path | None = None
    pixel: str | None = None

    def surface(self, ridges: Given[RidgeDesign], how: Reflecting) -> "tuple[Surface, Reflecting]":
        """The surface that is named, and how its reflectance is computed.

        Raises:
            UsageError: none or several surfaces, or a file that cannot be used.
            HeightMapError, ConfigError: the map or the design cannot be read.
        """
        given = {
            "--ridge-angle": "ridge_angle_deg" in ridges or None,
            "--ink": self.ink,
            "--design": self.design,
            "--height-map": self.height_map,
            "--from-file": self.from_file,
        }
        if sum(value is not None for value in given.values()) != 1:
            raise UsageError(f"say what reflects: one of {', '.join(given)}")
        if self.ink is not None:
            from anisoscope.sim.materials.inks import find_ink

            return find_ink(self.ink), how
        if self.design is not None:
            from anisoscope.sim.design.designfile import read_design

            return read_design(self.design), how
        if self.from_file is not None:
            from anisoscope.operations.reflectance import reflectance_file

            return reflectance_file(self.from_file), how
        if self.height_map is None:
            return ridges.over(RidgeDesign(100.0, 0.0)), how
        from anisoscope.cli.options import parse_pixel
        from anisoscope.profiles.files.load import read_height_map

        ridges.refuse(
            ["wall", "height_loss", "edge_radius_um", "foot_radius_um"], "belongs to ridges (--ridge-angle)"
        )
        how = replace(how, pitch_um=ridges.values.get("pitch_um"), name=self.height_map.stem)
        return read_height_map(self.height_map, pixel_um=parse_pixel(self.pixel)), how


def _plastic(file: Path | None, plastic: Given[Material]) -> Material:
    """The plastic of a file of ``calibrate material``, or the usual one, under the options."""
    if file is None:
        return plastic.over(Material())
    from anisoscope.recipe.material_file import read_material_file

    return plastic.over(read_material_file(file).material.material())


def _resolution(nodes: str | None) -> "Resolution | None":
    """The resolution of an RGL file; None for the usual one.

    Raises:
        UsageError: something else than three whole numbers, or too few nodes.
    """
    from anisoscope.bsdf.rgl import Resolution

    if nodes is None:
        return None
    numbers = parse_numbers(nodes, "--nodes", "24,37,48")
    if len(numbers) != 3 or any(n != int(n) for n in numbers):
        raise UsageError(f"--nodes takes three whole numbers, such as 24,37,48, not {nodes!r}")
    theta, phi, square = (int(n) for n in numbers)
    return Resolution(theta, phi, square)


app = App(name="bsdf", help="Exchange reflectance with renderers and instruments: export, import, show.")


@Parameter(name="*")
@dataclass(frozen=True)
class FileOptions:
    """File for a renderer.

    Attributes:
        coarse: Write ridges as Klems or tensor tree, which blur them.
    """

    format_: Annotated[
        Literal["rgl", "merl", "zemax", "klems", "tensor-tree"] | None,
        Parameter(
            name="--file-format", help="Format; by the extension .bsdf (RGL), .binary (MERL), .xml (Klems)."
        ),
    ] = None
    wavelength: Annotated[float | None, Parameter(help="Keep one wavelength in nm.")] = None
    nodes: NodesOption = None
    scene: Annotated[Path | None, Parameter(help="RGL: also write a scene *.xml for Mitsuba.")] = None
    scene_shape: Annotated[Literal["sphere", "plate"], Parameter(help="Shape in the scene.")] = "sphere"
    coarse: Flag = False
    overwrite: Overwrite = False


USUAL_FILE = FileOptions()


@app.command
@with_options(
    ridges=OF_RIDGES,
    plastic=OF_SURFACE,
    how=Options(
        Reflecting,
        SOURCE,
        without={"pitch_um": "that of the ridges", "name": "that of the file"},
        whole=True,
    ),
)
def export(
    target: Path,
    /,
    *,
    source: SourceOptions | None = None,
    ridges: Given[RidgeDesign],
    material: Annotated[MaterialFile, Parameter(group=SOURCE)] = None,
    plastic: Given[Material],
    how: Given[Reflecting],
    file: FileOptions = USUAL_FILE,
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
    from anisoscope.bsdf.formats import format_of
    from anisoscope.operations.reflectance import export_bsdf, reflectance_of

    name, scene, nodes = file.format_ or format_of(target), file.scene, file.nodes
    if name != "rgl" and (nodes is not None or scene is not None):
        raise UsageError(f"--{'nodes' if nodes is not None else 'scene'} belongs to RGL .bsdf files")
    check_suffix(scene, "--scene", ".xml")
    check_new((target, scene), overwrite=file.overwrite)
    resolution, plastics = _resolution(nodes), _plastic(material, plastic)
    with progress(target.name, quiet=json_) as advance:
        surface, asked = (source or SourceOptions()).surface(ridges, how.made())
        found = export_bsdf(
            reflectance_of(surface, material=plastics, how=asked, on_progress=advance),
            target,
            file_format=name,
            wavelength_nm=file.wavelength,
            resolution=resolution,
            scene=None if scene is None else (scene, file.scene_shape),
            coarse=file.coarse,
            on_progress=advance,
        )
    if json_:
        return print_json(found)
    done = found.written
    _line(f"{target}: {found.name}, {done.format}, {done.size / 1e6:.3g} MB")
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
    out: Annotated[Path, Parameter(help="CSV file to write: one row a pair of directions, for fit brdf.")],
    columns: str | None = None,
    angle_unit: Literal["deg", "rad"] | None = None,
    values_are: Literal["brdf", "radiance", "factor"] = "brdf",
    pairs: Annotated[int, Parameter(help="Of a gridded file: pairs of directions to sample.")] = 2000,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Turn an instrument's table or a renderer's file into the table that fit brdf reads.

    Args:
        file: CSV with a header, ASTM E2387-style ASCII (a line VARS), RGL .bsdf, MERL, Klems or tensor-tree XML,
            or Zemax.
        columns: CSV: our columns by those of the file or by numbers: theta_i_deg=AOI,phi_i_deg=0,value=BRDF.
        angle_unit: Angles of the file; E2387 ASCII rad, CSV deg by default.
        values_are: Values: BRDF in 1/sr, BRDF × cos θi (CCBRDF), or ratios to a perfect white (π × BRDF).

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
        table = tables.imported(read_reflectance(file), pairs)
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
        return print_json(answer)
    _line(f"{out}: {len(table.rows)} rows ({', '.join(table.columns)})")
    for remark in table.remarks:
        _line(remark)
    if negative:
        _line(f"warning: {negative} of {len(table.rows)} values are negative")
    return 0


@Parameter(name="*")
@dataclass(frozen=True)
class TextureOptions:
    """Textures and their scene.

    Attributes:
        pixel: Pixel size in µm: of a plate's heights (2), of a map that states none.
        wavelength: Dots: keep one wavelength in nm; spectral files are large.
    """

    pixel: str | None = None
    inks: InksOption = None
    wavelength: float | None = None
    nodes: NodesOption = None
    light_angle: Annotated[float, Parameter(help="Scene: angle between light and camera in degrees.")] = 10.0


TEXTURES = TextureOptions()


@app.command
@with_options(plastic=OF_PLASTIC)
def textures(
    source: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="New folder for textures, reflectances and scene.")],
    how: TextureOptions = TEXTURES,
    material: MaterialFile = None,
    plastic: Given[Material],
    json_: Json = False,
) -> int:
    """Write heights, normals, masks and reflectances of a surface as textures, with a scene for Mitsuba.

    A plate is given by its recipe *.toml, dots by a layout *.npz of design pattern or by the PNG of ink halftone, all
    else is a height map. Fields and dots become masks and a .bsdf each class; heights become EXR and 16-bit PNG.

    Args:
        source: Recipe of a plate, layout of dots, PNG of a halftone, or height map.

    Examples:
        anisoscope bsdf textures plate/recipe.toml --out textures
        anisoscope bsdf textures dots.png --inks synthetic-red,synthetic-green,synthetic-blue --out textures
        anisoscope bsdf textures part.x3p --out textures
    """
    from anisoscope.cli.options import parse_pixel
    from anisoscope.operations.reflectance import SCENE, bsdf_textures

    resolution, plastics = _resolution(how.nodes), _plastic(material, plastic)
    with progress(str(source), quiet=json_) as advance:
        done = bsdf_textures(
            source,
            out,
            pixel_um=parse_pixel(how.pixel),
            inks=None if how.inks is None else printed_inks(how.inks),
            wavelength_nm=how.wavelength,
            resolution=resolution,
            light_angle_deg=how.light_angle,
            material=plastics,
            on_progress=advance,
        )
    if json_:
        return print_json(done.as_json())
    for line in (f"{out}: {', '.join(done.files)}", *done.notes, f"mitsuba -m scalar_spectral {out / SCENE}"):
        _line(line)
    return 0


def _mapping(text: str | None) -> dict[str, str]:
    pairs = [] if text is None else [part.partition("=") for part in text.split(",")]
    for name, sign, column in pairs:
        if not (name.strip() and sign and column.strip()):
            raise UsageError(f"--columns takes NAME=COLUMN, comma-separated, not {text!r}")
    return {name.strip(): column.strip() for name, _, column in pairs}


def _line(text: str) -> None:
    console().print(text, markup=False, highlight=False, soft_wrap=True)
