"""``anisoscope profile``: look at height maps and convert them."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.options import LENGTH, HeightMaps, Json, check_new, parse_pixel
from anisoscope.cli.profile.many import (
    NO_TABLE,
    NONE,
    ManyOptions,
    OutOptions,
    Values,
    check_table,
    measure_maps,
    write_each,
    written_suffix,
)
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from anisoscope.profiles.heightmap import HeightMap
from anisoscope.cli.progress import progress
from anisoscope.parameters.height_map_file import FileScales
from anisoscope.parameters.texture import Filtering
from anisoscope.views.options import Given, Options, options_class

app = App(
    name="profile",
    help="Read, measure, edit, compare, convert and make height maps.",
    default_parameter=Parameter(json_list=False),  # a pattern such as [ab]*.x3p is no JSON
)
app.command("anisoscope.cli.profile.ridges:ridges")
app.command("anisoscope.cli.profile.texture:texture")
app.command("anisoscope.cli.profile.lines:lines")
app.command("anisoscope.cli.profile.step:step")
app.command("anisoscope.cli.profile.surfaces:make")
app.command("anisoscope.cli.profile.surfaces:spoil")
app.command("anisoscope.cli.profile.editing:edit")
app.command("anisoscope.cli.profile.comparison:compare")
for _step in (
    "level",
    "form",
    "filter",
    "crop",
    "rotate",
    "mask",
    "fill",
    "outliers",
    "align-lines",
    "scars",
    "resample",
    "subtract",
    "stitch",
):
    app.command(
        f"anisoscope.cli.profile.editing:{_step.replace('filter', 'filter_').replace('-', '_')}", name=_step
    )

Layer = Literal["intensity", "colour", "interpolated"]
PeriodLimit = Annotated[
    float | None,
    LENGTH,
    Parameter(
        help="Lateral period limit of the instrument in µm (ISO 25178-600), whose blur is taken off the ridges."
    ),
]
TipRadius = Annotated[
    float | None,
    LENGTH,
    Parameter(
        help="Radius of the tip of a stylus or probe in µm, which is taken off crest, foot and height."
    ),
]
VIEW_SUFFIX, MOST_EXAGGERATION = "-view.html", 1e6


FILE_FORMAT = Group("File format", help="For what the file of a height map does not say itself.", sort_key=60)
OF_SCALES = Options(
    FileScales,
    names={"mask_regions": "--mask-from-x3p"},
    readers={
        "pixel_um": parse_pixel,
        "mask_regions": lambda text, _: tuple(part.strip() for part in text.split(",") if part.strip()),
    },
    repeated=("missing", "trust"),
    whole=True,
)
if TYPE_CHECKING:
    Which = Given[FileScales]
else:
    Which = options_class(OF_SCALES)
OF_FILTERING = Options(
    Filtering, names={"s_filter": "--s-filter-type", "l_filter": "--l-filter-type"}, whole=True
)
AS_STATED = Which()
Scales = Annotated[Which, Parameter(name="*", group=FILE_FORMAT)]


def reader(scales: Which) -> "Callable[[Path], HeightMap]":
    """How a command reads height maps."""
    from anisoscope.profiles.files.load import read_height_map

    return partial(read_height_map, scales=scales.made())


@app.command
def info(
    *files: HeightMaps,
    json_: Json = False,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Size, missing share and height parameters (ISO 25178-2, mean removed, not levelled) of height maps.

    Examples:
        anisoscope profile info part.x3p
        anisoscope profile info 'lot/*.x3p' --table lot.csv
    """
    from anisoscope.operations.map_series import map_values

    return measure_maps(files, many, reader(scales), map_values, _print_info, to_json=json_, content=_info)


def _info(surface: "HeightMap") -> dict[str, object]:
    from anisoscope.profiles.textures.amplitude import amplitude

    found, (rows, cols) = amplitude(surface), surface.shape
    return {
        "rows": rows,
        "cols": cols,
        "pixel_um": [surface.pixel_y_um, surface.pixel_x_um],
        "missing_share": surface.missing_share,
        "sa_um": found.sa_um,
        "sq_um": found.sq_um,
        "sz_um": found.sz_um,
        "field_um": list(surface.extent_um),
        "layers": list(surface.layers),
        "origin": surface.origin,
    }


def _print_info(name: str, surface: "HeightMap") -> None:
    from anisoscope.profiles.textures.amplitude import amplitude

    found, (rows, cols), (field_y, field_x) = amplitude(surface), surface.shape, surface.extent_um
    print_table(
        name,
        ["quantity", "value", "unit"],
        [
            ["rows", str(rows), ""],
            ["columns", str(cols), ""],
            ["pixel along y, x", f"{surface.pixel_y_um:.6g}, {surface.pixel_x_um:.6g}", "µm"],
            ["field along y, x", f"{field_y:.6g}, {field_x:.6g}", "µm"],
            ["missing", f"{100 * surface.missing_share:.3g}", "%"],
            ["Sa", f"{found.sa_um:.6g}", "µm"],
            ["Sq", f"{found.sq_um:.6g}", "µm"],
            ["Sz", f"{found.sz_um:.6g}", "µm"],
        ],
        caption=_caption(surface),
    )


def _caption(surface: "HeightMap") -> str:
    """Origin of a map, its layers and its processing, in lines of text."""
    origin, layers = surface.origin, surface.layers
    lines = [f"format {origin['format']}, role {origin['role']}, reader {origin['reader']}"]
    instrument = " ".join(str(part) for part in origin.get("instrument", {}).values())
    lines += [f"measured {' '.join((instrument, str(origin.get('date', '')))).strip()}"] if instrument else []
    lines += [f"layers: {', '.join(layers)}"] if layers else []
    lines += [f"other channels: {', '.join(origin['other_channels'])}"] if "other_channels" in origin else []
    lines += [f"not read: {', '.join(origin['not_read'])}"] if "not_read" in origin else []
    lines += [f"mask: {origin['mask']}"] if "mask" in origin else []
    lines += list(origin.get("corrected", []))
    return "\n".join(lines + [f"trusted by --trust: {text}" for text in origin.get("trusted", [])])


@app.command
def convert(
    *files: Path,
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    layer: Layer | None = None,
    several: Annotated[OutOptions, Parameter(name="*", group="Several files")] = NO_TABLE,
    json_: Json = False,
    scales: Scales = AS_STATED,
) -> int:
    """Write height maps in another format: SOURCE TARGET by the extension, or any number of maps with --out-dir.

    x3p, npz and csv keep every bit of the heights, gwy those of metres, sur 31 bits of the largest height, gsf, tif and
    exr 24 bits, png 16 bits of the range. npz, gwy and exr keep intensity and colour. stl and ply are meshes in mm for
    other programs.

    Args:
        files: Source and target: x3p, sur, gwy, gsf, npz, npy, csv, txt, tif, exr, png, stl or ply. With --out-dir:
            height maps, or patterns.
        layer: Write this layer of the map as PNG, instead of the heights.
        format_: Format of the new files in --out-dir: an extension; x3p, of layers png.

    Examples:
        anisoscope profile convert part.sur part.x3p
        anisoscope profile convert 'lot/*.sur' --format x3p --out-dir x3p
        anisoscope profile convert part.opd seen.png --layer intensity
    """
    from anisoscope.operations.map_series import expanded, map_values
    from anisoscope.profiles.files.images import write_layer
    from anisoscope.profiles.files.load import MESH_WRITERS, WRITERS, write_height_map

    def run(path: Path, target: Path) -> Values:
        surface = reader(scales)(path)
        if layer is not None:
            write_layer(surface, layer, target)
        else:
            write_height_map(surface, target)
            note_lost_layers(surface, target)
        return map_values(surface)

    if several.out_dir is not None:
        known = (*WRITERS, *MESH_WRITERS) if layer is None else (".png",)
        suffix = written_suffix(format_ or ("x3p" if layer is None else "png"), known)

        return write_each(expanded(files), run, several, suffix, to_json=json_)
    if len(files) != 2:
        raise UsageError("profile convert takes SOURCE and TARGET, or any number of maps and --out-dir")
    check_table(several, alone="--out-dir")
    source, target = files
    check_new((target,), overwrite=several.overwrite)
    if layer is not None and target.suffix.lower() != ".png":
        raise UsageError(f"{target}: a layer is written as PNG; name it *.png")
    run(source, target)
    return 0


def note_lost_layers(surface: "HeightMap", target: Path) -> None:
    """Say on standard error which layers the format of a file has no place for."""
    from anisoscope.profiles.files.load import LAYER_SUFFIXES

    if surface.layers and target.suffix.lower() not in LAYER_SUFFIXES:
        lost = " and ".join(surface.layers)
        sys.stderr.write(
            f"{target.name}: heights alone, without {lost}; {', '.join(LAYER_SUFFIXES)} keep layers, "
            "profile convert --layer writes a PNG\n"
        )


@app.command
def report(
    *files: HeightMaps,
    out: Annotated[Path | None, Parameter(help="HTML file to write, of one map.")] = None,
    period_limit: PeriodLimit = None,
    tip_radius: TipRadius = None,
    several: Annotated[OutOptions, Parameter(name="*", group="Several files")] = NO_TABLE,
    json_: Json = False,
    scales: Scales = AS_STATED,
) -> int:
    """Write one HTML page about each height map: pictures, ridges, roughness, burrs, height parameters, origin.

    A map without ridges gets a page without them.

    Examples:
        anisoscope profile report part.x3p --out report.html
    """
    from anisoscope.operations.map_series import expanded, map_values
    from anisoscope.report.profile_page import write_profile_page

    chosen = expanded(files)
    if several.out_dir is not None:
        if out is not None:
            raise UsageError("--out is one page, --out-dir a page for each map; give one of them")

        def run(path: Path, target: Path) -> Values:
            surface = reader(scales)(path)
            write_profile_page(
                surface, path.name, target, period_limit_um=period_limit, tip_radius_um=tip_radius
            )
            return map_values(surface)

        return write_each(chosen, run, several, ".html", to_json=json_)
    if out is None or len(chosen) != 1:
        raise UsageError("profile report takes one map and --out PAGE.html, or several and --out-dir")
    check_table(several, alone="--out-dir")
    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: a page is named *.html")
    check_new((out,), overwrite=several.overwrite)
    with progress(chosen[0].name) as advance:
        advance("reading", 0, 3)
        surface = reader(scales)(chosen[0])
        write_profile_page(
            surface, chosen[0].name, out, advance, period_limit_um=period_limit, tip_radius_um=tip_radius
        )
    sys.stdout.write(f"{out}\n")
    return 0


@app.command
def view(
    *files: HeightMaps,
    out: Path | None = None,
    exaggerate: float | None = None,
    layer: Layer | None = None,
    several: Annotated[OutOptions, Parameter(name="*", group="Several files")] = NO_TABLE,
    json_: Json = False,
    scales: Scales = AS_STATED,
) -> int:
    """Write one HTML page with each height map in 3-D, to be turned in the browser without network or program.

    Args:
        out: HTML file to write, of one map; NAME-view.html with the map if not given.
        exaggerate: Factor on the heights; one that makes the relief 8 % of the width if not given.
        layer: Layer of the map that colours the relief, instead of the heights.

    Examples:
        anisoscope profile view part.x3p --exaggerate 20
    """
    from anisoscope.operations.map_series import expanded, map_values
    from anisoscope.report.profile_page import write_view_page

    if exaggerate is not None and not 0.0 < exaggerate <= MOST_EXAGGERATION:
        raise UsageError(
            f"--exaggerate takes a positive factor up to {MOST_EXAGGERATION:g}, not {exaggerate:g}"
        )
    chosen = expanded(files)
    if len(chosen) > 1 or several.out_dir is not None or several.table is not None:
        if out is not None:
            raise UsageError(
                "--out is the page of one map; give --out-dir, or no folder for pages with the maps"
            )

        def run(path: Path, target: Path) -> Values:
            surface = reader(scales)(path)
            drawn = write_view_page(surface, path.name, target, exaggerate, layer)
            return {**map_values(surface), "3-D": (float(drawn.scene is not None), "")}

        return write_each(chosen, run, several, VIEW_SUFFIX, to_json=json_)
    source = chosen[0]
    target = out or source.with_name(source.stem + VIEW_SUFFIX)
    if target.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {target}: a page is named *.html")
    check_new((target,), overwrite=several.overwrite)
    with progress(source.name) as advance:
        advance("drawing", 0, 1)
        drawn = write_view_page(reader(scales)(source), source.name, target, exaggerate, layer)
    if drawn.png is None:
        sys.stderr.write(f"no 3-D view: {drawn.note}; the page has a still picture from above\n")
    elif drawn.scene is None:
        sys.stderr.write(f"no view to turn: {drawn.note}\n")
    sys.stdout.write(f"{target}\n")
    return 0
