"""``anisoscope design mask`` and ``design height``: mask for the lithographer, and height map for instruments."""

import sys
from pathlib import Path
from shutil import disk_usage
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.output import check_seed
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.sim.design.layout import Layout

GDS = (".gds", ".gds2", ".gdsii")


def mask(
    layout: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="Masks to write, *.gds.")],
    png: Annotated[Path | None, Parameter(help="Write a picture of the classes, one pixel per dot.")] = None,
    json_: Json = False,
) -> int:
    """Write etch masks as GDSII: one cell per tile, one layer per pass, units µm.

    Args:
        layout: Layout *.npz of ``design pattern`` or ``design refine``.

    Examples:
        anisoscope design mask disc.npz --out disc.gds --png classes.png
    """
    from anisoscope.sim.design.designfile import read_layout
    from anisoscope.sim.design.mask import FIRST_LAYER, write_gds, write_preview

    if out.suffix.lower() not in GDS:
        raise UsageError(f"masks are written as *.gds, not {out.name}")
    found, _ = read_layout(layout)
    counts = write_gds(found, out)
    if png is not None:
        write_preview(found, png)
    high, wide = (1e-3 * side for side in found.size_um)
    layers = {str(FIRST_LAYER + n): depth for n, depth in enumerate(found.passes_nm)}
    if json_:
        print_json({**counts, "layers_nm": layers, "size_mm": [high, wide], "bytes": out.stat().st_size})
        return 0
    print_table(
        out.name,
        ["quantity", "value", "unit"],
        [
            ["size along x, y", f"{wide:.3f}, {high:.3f}", "mm"],
            *([f"depth of layer {layer}", f"{depth:.1f}", "nm"] for layer, depth in layers.items()),
            ["cells", str(counts["cells"]), ""],
            ["rectangles in cells", str(counts["polygons"]), ""],
            ["references", str(counts["references"]), ""],
        ],
    )
    return 0


def height(
    source: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="Map to write: x3p or npz; npy row by row, for any size.")],
    corner: Annotated[str, Parameter(help="Lower left corner X,Y of the window, µm.")] = "0,0",
    window_size: Annotated[
        str | None, Parameter(help="Size W,H of the window, µm; all if not given.")
    ] = None,
    dots: Annotated[int, Parameter(help="Dots along each side, of a design *.toml.")] = 4,
    dot: Annotated[float, Parameter(help="Side of a dot, µm, of a design *.toml.")] = 112.0,
    seed: Annotated[int, Parameter(help="Seed, of a design *.toml.")] = 0,
    depths: Annotated[
        str | None, Parameter(help="Depth of every pass in nm, of a GDSII that does not say.")
    ] = None,
    pixel: Annotated[float | None, Parameter(help="Pixel size in µm, of a GDSII.")] = None,
    overwrite: Annotated[bool, Parameter(negative="", help="Replace the map if it exists.")] = False,
    json_: Json = False,
) -> int:
    """Make a height map of a design, a layout or a GDSII file: ``predict`` and the virtual rig read it.

    Args:
        source: Design *.toml, layout *.npz or masks *.gds.

    Examples:
        anisoscope design height disc.gds --window-size 60,40 --out masks.x3p
    """
    if out.exists() and not overwrite:
        raise UsageError(f"{out} exists; give another name, or --overwrite")
    if not out.parent.is_dir():
        raise UsageError(f"{out}: there is no folder {out.parent}; make it first")
    check_seed(seed)
    at = parse_numbers(corner, "--corner")
    extent = None if window_size is None else parse_numbers(window_size, "--window-size")
    if len(at) != 2 or (extent is not None and (len(extent) not in (1, 2) or min(extent) <= 0.0)):
        raise UsageError("--corner takes X,Y in µm, --window-size one or two positive numbers of µm")
    # Options are X,Y; windows of a layout count rows (y) first.
    low, window = (at[1], at[0]), None if extent is None else (extent[-1], extent[0])
    kind = source.suffix.lower()
    if kind not in GDS and (depths is not None or pixel is not None):
        raise UsageError(f"--depths and --pixel are for GDSII files; {source.name} says its own")
    if kind in GDS:
        from anisoscope.sim.design.maskreading import read_gds

        passes = None if depths is None else parse_numbers(depths, "--depths")
        if pixel is not None and not pixel > 0.0:
            raise UsageError(f"--pixel must be positive, not {pixel:g} µm")
        return _deliver(
            read_gds(source, corner_um=low, size_um=window, grid_um=pixel, passes_nm=passes),
            out,
            as_json=json_,
        )
    layout = _layout_of(source, dots, dot, seed)
    # A whole pattern can exceed the memory: .npy is written strip by strip.
    if out.suffix.lower() == ".npy" and extent is None and low == (0.0, 0.0):
        return _stream(layout, out, as_json=json_)
    return _deliver(layout.window(low, window), out, as_json=json_)


def _layout_of(source: Path, dots: int, dot: float, seed: int) -> "Layout":
    import numpy as np

    from anisoscope.sim.design.designfile import read_design, read_layout
    from anisoscope.sim.design.pattern import PatternOptions, make_layout

    kind = source.suffix.lower()
    if kind == ".npz":
        return read_layout(source)[0]
    if kind != ".toml":
        raise UsageError(f"{source.name}: give a design *.toml, a layout *.npz or masks *.gds")
    if not 1 <= dots <= 1000:
        raise UsageError(f"--dots must be 1 to 1000, not {dots}")
    design = read_design(source)
    classes = np.zeros((dots, dots), dtype=np.int64)
    return make_layout(classes, [design], np.random.default_rng(seed), PatternOptions(dot, min(dots**2, 16)))


def _deliver(surface: "HeightMap", out: Path, *, as_json: bool) -> int:
    from anisoscope.cli.profile.surfaces_output import deliver

    return deliver(surface, out, as_json=as_json)


def _stream(layout: "Layout", out: Path, *, as_json: bool) -> int:
    """The whole surface, a row of dots at a time, float32 in µm."""
    import numpy as np

    n = layout.tiles.shape[1]
    rows, cols = (n * many for many in layout.index.shape)
    table = layout.heights_um.astype(np.float32)
    needed, free = 4 * rows * cols, disk_usage(out.resolve().parent).free
    if needed > free:
        raise UsageError(
            f"{rows} × {cols} heights take {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: give --window-size"
        )
    header = {"descr": "<f4", "fortran_order": False, "shape": (rows, cols)}
    try:
        with out.open("wb") as stream:
            np.lib.format.write_array_header_1_0(stream, header)
            for block in layout.dot_rows():
                stream.write(table[block].tobytes())
    except (OSError, KeyboardInterrupt) as error:
        out.unlink(missing_ok=True)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise UsageError(f"{out}: cannot be written ({error.strerror}); check folder and space") from None
    result = {"file": str(out), "rows": rows, "cols": cols, "pixel_um": layout.grid_um}
    if as_json:
        print_json(result)
        return 0
    sys.stdout.write(
        f"written: {out}, {rows} × {cols} heights in µm, pixel {layout.grid_um:g} µm (--pixel)\n"
    )
    return 0
