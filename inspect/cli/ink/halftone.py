"""``anisoscope ink halftone``: an image as dots of three or four inks, with a film for every screen."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.ink.options import (
    AngleOption,
    GainOption,
    IlluminantOption,
    InksOption,
    OverwriteOption,
    check_new,
    check_target,
    percent,
    printed_inks,
)
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.sim.light.ink.ink import Ink
    from anisoscope.sim.proof.halftone import Halftone
    from anisoscope.sim.proof.separation import Separation


def halftone(
    image: Path,
    /,
    *,
    out: Annotated[
        Path, Parameter(help="PNG of all dots; the films are written next to it as NAME-INK.png.")
    ],
    inks: InksOption = None,
    method: Annotated[
        Literal["mask", "diffusion"],
        Parameter(help="How the dots are placed: void-and-cluster mask, or vector error diffusion."),
    ] = "mask",
    separation: Annotated[
        Literal["match", "channels"],
        Parameter(help="Coverages that meet the image's colours, or its linear R, G, B as coverages."),
    ] = "match",
    illuminant: IlluminantOption = "d65",
    angle: AngleOption = 20.0,
    image_gain: GainOption = 1.0,
    print_width: Annotated[
        float | None, Parameter(help="Width of the print in mm; else one dot a pixel.")
    ] = None,
    dpi: Annotated[float, Parameter(help="Dots per inch, written into the files.")] = 300.0,
    negative: Annotated[
        bool,
        Parameter(negative="", help="Films with white where the ink goes; else black, as screens need them."),
    ] = False,
    overwrite: OverwriteOption = False,
    json_: Json = False,
) -> int:
    """Place dots of three or four inks that never meet, and write the films for their screens.

    Args:
        image: The picture; its colour profile is applied.

    Examples:
        anisoscope ink halftone image.png --out dots.png --print-width 60 --dpi 300
    """
    from anisoscope.sim.materials.spectra import find_illuminant
    from anisoscope.sim.proof.halftone import halftone as place_dots
    from anisoscope.sim.proof.imagefile import MM_AN_INCH, read_image, to_dots
    from anisoscope.sim.proof.separation import separation as plan_separation

    check_target(out, "--out", (image,), ".png")
    if not 1.0 <= dpi <= 20000.0:
        raise UsageError(f"--dpi takes 1 to 20000, not {dpi:g}")
    if print_width is not None and not 0.0 < print_width < np.inf:
        raise UsageError(f"--print-width takes millimetres above 0, not {print_width:g}")
    chosen = printed_inks(inks)
    films = _films(out, chosen)
    for film in films:
        check_target(film, "the film", (image,), ".png")
    check_new((out, *films), overwrite=overwrite)
    plan = plan_separation(
        chosen, find_illuminant(illuminant), way=separation, angle_deg=angle, gain=image_gain
    )
    picture = read_image(image)
    dots = picture.srgb.shape[1] if print_width is None else round(print_width / MM_AN_INCH * dpi)
    with progress("halftone", quiet=json_) as advance:
        found = place_dots(to_dots(picture, dots), plan, method, advance=advance)
    written = _write(found, plan, out, films, dpi, negative)
    if json_:
        print_json(_as_json(found, chosen, written, dpi, picture.notes))
        return 0
    _print(found, plan, chosen, dpi, picture.notes)
    for path in written:
        print_lines(f"{path}: written")
    return 0


def _films(out: Path, inks: "tuple[Ink, ...]") -> list[Path]:
    """Path of each ink's film: next to the picture of all dots, named after the ink."""
    names = [out]
    for number, ink in enumerate(inks, start=1):
        slug = re.sub(r"[^a-z0-9]+", "-", ink.name.lower()).strip("-") or f"ink-{number}"
        path = out.with_name(f"{out.stem}-{slug}.png")
        names.append(out.with_name(f"{out.stem}-{slug}-{number}.png") if path in names else path)
    return names[1:]


def _write(
    found: "Halftone", plan: "Separation", out: Path, films: list[Path], dpi: float, negative: bool
) -> list[Path]:
    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.sim.light.colour.spaces import encode
    from anisoscope.sim.proof.imagefile import dots_png, film_png

    tints = encode(plan.colours.T / plan.colours.max()).srgb
    palette = np.rint(255.0 * np.vstack([np.zeros(3), tints])).astype(np.uint8)
    write_bytes(out, dots_png(found.dots, palette, dpi))
    for number, path in enumerate(films):
        write_bytes(path, film_png(found.mask(number), dpi, positive=not negative))
    return [out, *films]


def _print(
    found: "Halftone", plan: "Separation", inks: "tuple[Ink, ...]", dpi: float, notes: tuple[str, ...]
) -> None:
    rows, cols = found.dots.shape
    title = f"{cols} × {rows} dots, {cols / dpi * 25.4:.1f} × {rows / dpi * 25.4:.1f} mm at {dpi:g} dpi, {found.method}"
    table = [
        [ink.name, f"{100 * aimed:.2f}", f"{100 * printed:.2f}"]
        for ink, aimed, printed in zip(inks, found.aimed, found.printed, strict=True)
    ]
    table.append(["no ink", f"{100 * (1 - found.aimed.sum()):.2f}", f"{100 * (1 - found.printed.sum()):.2f}"])
    print_table(title, ["ink", "coverage aimed at [%]", "coverage of the dots [%]"], table)
    if found.block_error.size:
        mean = float(np.sqrt(np.mean(found.block_error**2)))
        print_lines(
            f"Blocks of 64 × 64 dots: coverage off by {mean:.4f} (rms), {found.block_error.max():.4f} at most."
        )
    print_lines(
        f"Out of gamut: {percent(found.outside)} of the pixels; "
        f"coverages above 1 in sum, scaled down: {percent(found.scaled)}. Inks on one dot: none, by construction."
    )
    if plan.way == "match":
        print_lines(
            f"Coverage is linear; white is the brightest neutral of the inks under {plan.illuminant} "
            f"with light and eye at {plan.angle_deg:g}°."
        )
    for note in notes:
        print_lines(f"Image: {note}.")


def _as_json(
    found: "Halftone", inks: "tuple[Ink, ...]", written: list[Path], dpi: float, notes: tuple[str, ...]
) -> dict[str, Any]:
    names = [ink.name for ink in inks]
    return {
        "rows": found.dots.shape[0],
        "cols": found.dots.shape[1],
        "dpi": dpi,
        "method": found.method,
        "aimed": dict(zip(names, found.aimed.tolist(), strict=True)),
        "printed": dict(zip(names, found.printed.tolist(), strict=True)),
        "block_error_max": float(found.block_error.max()) if found.block_error.size else None,
        "out_of_gamut": found.outside,
        "scaled_down": found.scaled,
        "files": [str(path) for path in written],
        "notes": list(notes),
    }
