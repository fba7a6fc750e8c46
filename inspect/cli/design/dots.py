"""``anisoscope design``: dots, surfaces of many of them, their masks, heights and pages."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Html, Json, Overwrite, check_new
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.parameters.etching import GDS, DotSearch, EtchedHeights, PatternOptions, check_seed
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap

USUAL = "16:16,56:16,112:16,160:16,160:80"
MOST_RANDOM = 100


@with_options(options=Options(DotSearch, names={"method": "--search"}, whole=True))
def refine(
    design: Path,
    /,
    *,
    options: Given[DotSearch],
    out: Annotated[Path | None, Parameter(help="Write the dot as a layout *.npz.")] = None,
    png: Annotated[Path | None, Parameter(help="Write a picture of the dot.")] = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Search the dot of a lobe whose own reflectance is closest to the expected one.

    Args:
        design: Lobe, *.toml.

    Examples:
        anisoscope design refine wide.toml --seconds 2 --dot 56 --out dot.npz --png dot.png
    """
    from anisoscope.operations.design.etched import refine_dot
    from anisoscope.sim.design.designfile import read_design, write_layout

    search = options.made()
    _check_written(out, png, html)
    chosen = read_design(design)
    with progress("refine", quiet=json_) as advance:
        found = refine_dot(chosen, search=search, on_progress=advance)
    if out is not None:
        write_layout(found.layout, out, (chosen,))
    if png is not None:
        from anisoscope.sim.design.mask import write_tile_preview

        write_tile_preview(found.layout, 0, png)
    if html is not None:
        from anisoscope.operations.design.pages import write_refined_report

        write_refined_report(chosen, found.layout, found.found, html)
    if json_:
        return print_json(found)
    print_table(
        f"dot of {chosen.name}",
        ["quantity", "value", "unit"],
        [
            ["relative error of the best random dot", f"{found.found.start_error:.4f}", "1"],
            ["relative error", f"{found.found.error:.4f}", "1"],
            ["best found after", f"{found.seconds:.2f}", "s"],
            ["generations", str(found.found.generations), ""],
            ["ended by", found.found.stopped, ""],
        ],
    )
    return _print_written(out, png, html)


@with_options(options=Options(PatternOptions, whole=True, flags=True))
def pattern(
    image: Path,
    /,
    *,
    classes: str,
    out: Annotated[Path | None, Parameter(help="Write the layout *.npz.")] = None,
    plate_size: str | None = None,
    options: Given[PatternOptions],
    png: Annotated[Path | None, Parameter(help="Write a picture of the classes, one pixel per dot.")] = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Lay out a picture as dots, each with one reflectance.

    Args:
        image: Grey picture: labels, or shades with --dither.
        classes: Designs *.toml from dark to bright, comma-separated; mirror is the bare wafer.
        plate_size: Size W,H in mm; a dot for every pixel of the picture if not given.

    Examples:
        anisoscope design pattern disc.png --classes wide.toml,mirror --out disc.npz --html disc.html
    """
    from anisoscope.operations.design.etched import (
        MIRROR,
        dot_pattern,
        mirror_design,
        resized,
    )
    from anisoscope.operations.design.pictures import read_image
    from anisoscope.sim.design.designfile import read_design, write_layout

    chosen = options.made()
    _check_written(out, png, html)
    designs = [mirror_design() if part == MIRROR else read_design(Path(part)) for part in classes.split(",")]
    grey = read_image(image)
    if plate_size is not None:
        wide = parse_numbers(plate_size, "--plate-size")
        if len(wide) not in (1, 2) or min(wide) <= 0.0:
            raise UsageError(f"--plate-size takes one or two positive numbers of mm, not {plate_size!r}")
        grey = resized(grey, (wide[0], wide[-1]), chosen.dot_um)
    with progress("pattern", quiet=json_) as advance:
        found = dot_pattern(grey, designs, options=chosen, on_progress=advance)
    if out is not None:
        write_layout(found.layout, out, found.designs)
    if png is not None:
        from anisoscope.sim.design.mask import write_preview

        write_preview(found.layout, png)
    if html is not None:
        from anisoscope.operations.design.pages import write_pattern_report

        write_pattern_report(found.layout, designs, html)
    if json_:
        return print_json(found)
    (high, wide_mm), dots = found.size_mm, found.rows * found.cols
    print_table(
        f"{found.cols} × {found.rows} dots of {found.dot_um:g} µm, {wide_mm:.2f} × {high:.2f} mm, {found.tiles} tiles",
        ["reflectance", "dots", "share [%]"],
        [[one.name, str(one.dots), f"{100.0 * one.dots / dots:.1f}"] for one in found.classes],
    )
    return _print_written(out, png, html)


def relight(
    layout: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="Page to write, *.html.")],
    page_light: Annotated[str, Parameter(help="d65, a, led-b3 … or CSV; or one wavelength in nm.")] = "d65",
) -> int:
    """Write a page to turn an etched wafer in the browser, under light from any side.

    Every dot has the radiance that wave optics gives its tile; each is seen by itself.

    Args:
        layout: Layout *.npz of ``design pattern`` or ``design refine``.

    Examples:
        anisoscope design relight disc.npz --out disc.html
        anisoscope design relight disc.npz --page-light 520 --out disc.html
    """
    from anisoscope.report.plate_page import write_layout_page
    from anisoscope.sim.design.designfile import read_layout
    from anisoscope.sim.materials.spectra import find_illuminant

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out writes *.html, not {out.name}")
    _check_written(None, out)
    try:
        line: float | None = float(page_light)
    except ValueError:
        line = None
    if line is not None and not 200.0 <= line <= 2000.0:
        raise UsageError(f"--page-light takes 200 to 2000 nm, or the name of a light, not {page_light}")
    found, _ = read_layout(layout)
    write_layout_page(out, layout.stem, found, find_illuminant(page_light) if line is None else line)
    return _print_written(out)


def _check_written(out: Path | None, *others: Path | None) -> None:
    """Check the output paths before the search: results that cannot be written would be lost."""
    if out is not None and out.suffix.lower() != ".npz":
        raise UsageError(f"a layout is written as *.npz, not {out.name}")
    _check_folders(out, *others)


def _check_folders(*paths: Path | None) -> None:
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}; make it first")


def _print_written(*paths: Path | None) -> int:
    sys.stdout.write("".join(f"written: {path}\n" for path in paths if path is not None))
    return 0


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
        return print_json(
            {**counts, "layers_nm": layers, "size_mm": [high, wide], "bytes": out.stat().st_size}
        )
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


@with_options(how=Options(EtchedHeights, whole=True))
def height(
    source: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="Map to write: x3p or npz; npy row by row, for any size.")],
    how: Given[EtchedHeights],
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Make a height map of a design, a layout or a GDSII file: ``predict`` and the virtual rig read it.

    Args:
        source: Design *.toml, layout *.npz or masks *.gds.

    Examples:
        anisoscope design height disc.gds --window-size 60,40 --out masks.x3p
    """
    from anisoscope.operations.design.etched import etched_heights, layout_of, write_heights

    asked = how.made()
    check_new((out,), overwrite=overwrite)
    _check_folders(out)
    # A whole pattern can exceed the memory: .npy is written strip by strip.
    whole = asked.window_size_um is None and asked.corner_um == (0.0, 0.0)
    if out.suffix.lower() == ".npy" and whole and source.suffix.lower() not in GDS:
        found = write_heights(layout_of(source, asked), out)
        if json_:
            return print_json(found)
        sys.stdout.write(
            f"written: {out}, {found.rows} × {found.cols} heights in µm, pixel {found.pixel_um:g} µm (--pixel)\n"
        )
        return 0
    return _deliver(etched_heights(source, how=asked), out, as_json=json_)


def _deliver(surface: "HeightMap", out: Path, *, as_json: bool) -> int:
    from anisoscope.cli.profile.surfaces_output import deliver

    return deliver(surface, out, as_json=as_json)


def resolution(
    design: Path,
    /,
    *,
    sizes: str = USUAL,
    random_dots: Annotated[int, Parameter(help="Random dots of every pair, 1 to 100.")] = 8,
    seed: Annotated[int, Parameter(help="Seed of the dots.")] = 0,
    png: Path | None = None,
    json_: Json = False,
) -> int:
    """Show how far random dots are from the expected reflectance: spatial against directional resolution.

    A dot averages n = (dot/coherence)² windows; its error falls as 1/√n.

    Args:
        design: Lobe or anti-mirror, *.toml.
        sizes: Dot and coherence length in µm, DOT:COHERENCE, comma-separated.
        png: Picture of expected and observed reflectance: *.png or *.svg.

    Examples:
        anisoscope design resolution wide.toml
        anisoscope design resolution wide.toml --sizes 16:16,160:16,160:80 --png resolution.png
    """
    import numpy as np

    from anisoscope.sim.design.designfile import read_design
    from anisoscope.sim.design.resolution import tradeoff

    check_seed(seed)
    if png is not None and png.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--png {png}: a picture is named *.png or *.svg")
    if not 1 <= random_dots <= MOST_RANDOM:
        raise UsageError(f"--random-dots takes 1 to {MOST_RANDOM}, not {random_dots}")
    pairs = [_pair(part) for part in sizes.split(",")]
    chosen = read_design(design)
    found = tradeoff(chosen, pairs, random_dots, np.random.default_rng(seed))
    if png is not None:
        from anisoscope.operations.design.pages import draw_tradeoff

        draw_tradeoff(chosen, found, png)
    if json_:
        return print_json({"design": chosen.name, "seed": seed, "random_dots": random_dots, "pairs": found})
    print_table(
        f"{chosen.name}: random dots against the expectation, |h| ≤ 0.2",
        ["dot [µm]", "dpi", "Δc [µm]", "source at 500 nm [°]", "windows n", "relative error", "from dot to dot"],
        [
            [
                f"{one.dot_um:g}", f"{25400.0 / one.dot_um:.0f}", f"{one.coherence_um:g}", f"{one.source_deg:.2f}",
                f"{one.windows:.3g}", f"{one.error:.3f}", "–" if np.isnan(one.scatter) else f"± {one.scatter:.3f}",
            ]
            for one in found
        ],
    )  # fmt: skip
    if png is not None:
        sys.stdout.write(f"written: {png}\n")
    return 0


def _pair(text: str) -> tuple[float, float]:
    parts = text.split(":")
    if len(parts) != 2:
        raise UsageError(f"--sizes takes pairs DOT:COHERENCE in µm, such as 112:16, not {text!r}")
    return parse_numbers(parts[0], "--sizes", "112:16")[0], parse_numbers(parts[1], "--sizes", "112:16")[0]
