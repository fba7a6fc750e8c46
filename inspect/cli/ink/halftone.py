"""``anisoscope ink halftone``: an image as dots of three or four inks, with a film for every screen."""

from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.cli.help_page import MORE
from anisoscope.cli.ink.options import NAMES, InksOption, printed_inks
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Flag, Json, Overwrite, check_new, check_target
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.proof import FilmSettings
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.operations.proofing import Films


@with_options(films=Options(FilmSettings, names=NAMES, groups={"substrate": MORE}, whole=True))
def halftone(
    image: Path,
    /,
    *,
    out: Path,
    inks: InksOption = None,
    films: Given[FilmSettings],
    negative: Flag = False,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Place dots of three or four inks that never meet, and write the films for their screens.

    Args:
        image: The picture; its colour profile is applied.
        out: PNG of all dots; the films are written next to it as NAME-INK.png.
        negative: Films with white where the ink goes; else black, as screens need them.

    Examples:
        anisoscope ink halftone image.png --out dots.png --print-width 60 --dpi 300
    """
    from anisoscope.operations.proofing import film_paths
    from anisoscope.operations.proofing import halftone as placed

    check_target(out, "--out", (image,), ".png")
    chosen, settings = printed_inks(inks), films.made()
    paths = film_paths(out, chosen)
    for film in paths[1:]:
        check_target(film, "the film", (image,), ".png")
    check_new(paths, overwrite=overwrite)
    with progress("halftone", quiet=json_) as advance:
        found = placed(
            image,
            chosen,
            films=settings,
            on_progress=advance,
        )
    written = found.write(out, negative=negative)
    if json_:
        print_json({**fields_of(found), "files": written})
    else:
        _print(found)
        print_lines(*(f"{path}: written" for path in written))
    return 0


def _print(films: "Films") -> None:
    from anisoscope.operations.proofing import percent

    found, dpi = films.halftone, films.dpi
    size = f"{films.cols / dpi * 25.4:.1f} × {films.rows / dpi * 25.4:.1f} mm at {dpi:g} dpi"
    rows = [(name, aimed, films.printed[name]) for name, aimed in films.aimed.items()]
    rows.append(("no ink", 1.0 - found.aimed.sum(), 1.0 - found.printed.sum()))
    print_table(
        f"{films.cols} × {films.rows} dots, {size}, {films.method}",
        ["ink", "coverage aimed at [%]", "coverage of the dots [%]"],
        [[name, f"{100 * aimed:.2f}", f"{100 * printed:.2f}"] for name, aimed, printed in rows],
    )
    if films.block_error_max is not None:
        mean = float((found.block_error**2).mean() ** 0.5)
        print_lines(
            f"Blocks of 64 × 64 dots: coverage off by {mean:.4f} (rms), {films.block_error_max:.4f} at most."
        )
    print_lines(
        f"Out of gamut: {percent(found.outside)} of the pixels; "
        f"coverages above 1 in sum, scaled down: {percent(found.scaled)}. Inks on one dot: none, by construction."
    )
    plan = films.separation
    if plan.way == "match":
        print_lines(
            f"Coverage is linear; white is the brightest neutral of the inks under {plan.illuminant} "
            f"with light and eye at {plan.angle_deg:g}°."
        )
    print_lines(*(f"Image: {note}." for note in films.notes))
