"""``anisoscope design refine`` and ``design pattern``: dots, and surfaces of many of them."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.image import read_image
from anisoscope.cli.design.output import check_seed
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.layout import Layout
    from anisoscope.sim.design.refine import Refined

HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
DotOption = Annotated[float, Parameter(help="Side of a dot, µm; 112 are 227 dpi.")]
SeedOption = Annotated[int, Parameter(help="Seed of everything random.")]
MIRROR = "mirror"
SECONDS = 30.0


def refine(
    design: Path,
    /,
    *,
    seconds: Annotated[
        float | None,
        Parameter(
            help="Time to search, 30 unless --generations is given; Ctrl-C ends it earlier and keeps the best."
        ),
    ] = None,
    dot: DotOption = 112.0,
    population: Annotated[int, Parameter(help="Dots that the genetic search keeps.")] = 6,
    search: Annotated[
        Literal["both", "genetic", "polish"],
        Parameter(help="Genetic search with polish, or one of them alone."),
    ] = "both",
    generations: Annotated[int | None, Parameter(help="End after so many generations: repeatable.")] = None,
    good: Annotated[float | None, Parameter(help="End at this relative error.")] = None,
    seed: SeedOption = 0,
    out: Annotated[Path | None, Parameter(help="Write the dot as a layout *.npz.")] = None,
    png: Annotated[Path | None, Parameter(help="Write a picture of the dot.")] = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Search the dot of a lobe whose own reflectance is closest to the expected one.

    Args:
        design: Lobe, *.toml.

    Examples:
        anisoscope design refine wide.toml --seconds 2 --dot 56 --out dot.npz --png dot.png
    """
    import numpy as np

    from anisoscope.sim.design.designfile import read_design
    from anisoscope.sim.design.models import LobeModel
    from anisoscope.sim.design.pattern import dot_task
    from anisoscope.sim.design.refine import Limits
    from anisoscope.sim.design.refine import refine as refined

    check_seed(seed)
    _check_written(out, png, html)
    _check_dot(dot)
    if seconds is None and generations is None:
        seconds = SECONDS
    chosen = read_design(design)
    if not isinstance(chosen.model, LobeModel):
        raise UsageError(f"{design}: a {chosen.model.kind} has no widths to draw from: refine takes a lobe")
    side = round(dot / chosen.grid_um) * chosen.grid_um
    with progress("refine", quiet=json_) as advance:
        found = refined(
            dot_task(chosen, chosen.model, side), np.random.default_rng(seed), Limits(seconds, generations, good),
            method=search, population=population, on_progress=advance,
        )  # fmt: skip
    layout = _one_dot(chosen, found)
    _write(layout, (chosen,), out, None)
    if png is not None:
        from anisoscope.sim.design.mask import write_tile_preview

        write_tile_preview(layout, 0, png)
    if html is not None:
        from anisoscope.cli.design.report import write_refined_report

        write_refined_report(chosen, layout, found, html)
    if json_:
        print_json(
            {
                "design": chosen.name, "error": found.error, "start_error": found.start_error,
                "generations": found.generations, "stopped": found.stopped, "method": search, "seed": seed,
                "seconds": found.history[-1][0], "dot_um": side, "history": [list(one) for one in found.history],
            }
        )  # fmt: skip
        return 0
    print_table(
        f"dot of {chosen.name}",
        ["quantity", "value", "unit"],
        [
            ["relative error of the best random dot", f"{found.start_error:.4f}", "1"],
            ["relative error", f"{found.error:.4f}", "1"],
            ["best found after", f"{found.history[-1][0]:.2f}", "s"],
            ["generations", str(found.generations), ""],
            ["ended by", found.stopped, ""],
        ],
    )
    return _print_written(out, png, html)


def _one_dot(design: "DesignFile", found: "Refined") -> "Layout":
    import numpy as np

    from anisoscope.sim.design.layout import Layout
    from anisoscope.sim.design.pattern import rasterised

    tile = rasterised(found.dot, design.grid_um)
    return Layout(
        tile[None], np.zeros(1, dtype=np.int64), np.zeros((1, 1), dtype=np.uint16), design.passes_nm, design.grid_um,
        (design.name,), design.wavelength_nm, design.coherence_um,
    )  # fmt: skip


def pattern(
    image: Path,
    /,
    *,
    classes: Annotated[
        str,
        Parameter(help="Designs *.toml from dark to bright, comma-separated; mirror is the bare wafer."),
    ],
    out: Annotated[Path | None, Parameter(help="Write the layout *.npz.")] = None,
    plate_size: Annotated[
        str | None, Parameter(help="Size W,H in mm; a dot for every pixel of the picture if not given.")
    ] = None,
    dot: DotOption = 112.0,
    tiles: Annotated[int, Parameter(help="Number of different tiles per reflectance.")] = 4,
    refine: Annotated[float, Parameter(help="Seconds to refine every tile of a lobe.")] = 0.0,
    dither: Annotated[
        bool, Parameter(negative="", help="Mix designs where the picture has values between theirs.")
    ] = False,
    seed: SeedOption = 0,
    png: Annotated[Path | None, Parameter(help="Write a picture of the classes, one pixel per dot.")] = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Lay out a picture as dots, each with one reflectance.

    Args:
        image: Grey picture: labels, or shades with --dither.

    Examples:
        anisoscope design pattern disc.png --classes wide.toml,mirror --out disc.npz --html disc.html
    """
    import numpy as np

    from anisoscope.sim.design.pattern import PatternOptions, classes_of, make_layout

    check_seed(seed)
    _check_written(out, png, html)
    _check_dot(dot)
    designs = _designs(classes)
    labels = classes_of(_picture(image, plate_size, dot), len(designs), dither=dither)
    with progress("pattern", quiet=json_) as advance:
        layout = make_layout(
            labels, designs, np.random.default_rng(seed), PatternOptions(dot, tiles, refine, dither), advance
        )
    _write(layout, designs, out, png)
    if html is not None:
        from anisoscope.cli.design.report import write_pattern_report

        write_pattern_report(layout, designs, html)
    counts = np.bincount(layout.classes.ravel(), minlength=len(designs))
    rows, cols = layout.index.shape
    if json_:
        print_json(
            {
                "rows": rows, "cols": cols, "dot_um": layout.dot_um, "size_mm": [1e-3 * s for s in layout.size_um],
                "tiles": len(layout.tiles), "depths_nm": list(layout.passes_nm), "seed": seed,
                "classes": [
                    {"name": name, "dots": int(count)} for name, count in zip(layout.names, counts, strict=True)
                ],
            }
        )  # fmt: skip
        return 0
    high, wide = (1e-3 * side for side in layout.size_um)
    print_table(
        f"{cols} × {rows} dots of {layout.dot_um:g} µm, {wide:.2f} × {high:.2f} mm, {len(layout.tiles)} tiles",
        ["reflectance", "dots", "share [%]"],
        [
            [name, str(int(count)), f"{100.0 * count / counts.sum():.1f}"]
            for name, count in zip(layout.names, counts, strict=True)
        ],
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
    for path in (out, *others):
        if path is not None and not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}; make it first")


def _check_dot(dot: float) -> None:
    if not 0.0 < dot < float("inf"):
        raise UsageError(f"--dot must be a positive length in µm, not {dot:g}")


def _designs(text: str) -> "tuple[DesignFile, ...]":
    from anisoscope.sim.design.designfile import DesignFile, read_design
    from anisoscope.sim.design.models import MirrorModel

    mirror = DesignFile(name=MIRROR, model=MirrorModel(), passes_nm=(), band_nm=(400.0, 700.0))
    return tuple(mirror if part == MIRROR else read_design(Path(part)) for part in text.split(","))


def _picture(image: Path, size: str | None, dot: float) -> "npt.NDArray[np.uint8]":
    """Grey values, as many pixels as dots."""
    import cv2
    import numpy as np

    grey = read_image(image)
    if size is None:
        return grey
    wide = parse_numbers(size, "--plate-size")
    if len(wide) not in (1, 2) or min(wide) <= 0.0:
        raise UsageError(f"--plate-size takes one or two positive numbers of mm, not {size!r}")
    cols, rows = (max(1, round(1e3 * side / dot)) for side in (wide[0], wide[-1]))
    if rows * cols > 10**7:
        raise UsageError(
            f"--plate-size {size} mm with --dot {dot:g} µm are {rows * cols} dots: take larger dots"
        )
    nearest = cv2.resize(grey, (cols, rows), interpolation=cv2.INTER_NEAREST)
    return np.asarray(nearest, dtype=np.uint8)


def _write(layout: "Layout", designs: "tuple[DesignFile, ...]", out: Path | None, png: Path | None) -> None:
    if out is not None:
        from anisoscope.sim.design.designfile import write_layout

        write_layout(layout, out, designs)
    if png is not None:
        from anisoscope.sim.design.mask import write_preview

        write_preview(layout, png)


def _print_written(*paths: Path | None) -> int:
    sys.stdout.write("".join(f"written: {path}\n" for path in paths if path is not None))
    return 0
