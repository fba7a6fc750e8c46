"""``anisoscope ink``: structural-colour inks, fitted to goniometer readings and shown as colours."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Html, Json, Overwrite, check_new, check_suffix
from anisoscope.cli.tables import console, print_lines, print_table
from anisoscope.parameters.ink import InkFitting, InkTable, InkView
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.ink.appearance import Show
    from anisoscope.ink.fitting import InkFit


HORIZON_DEG = 90.0
NEEDED_NM = (400.0, 700.0)

app = App(name="ink", help="Fit, show, halftone and soft-proof structural-colour inks.")
app.command("anisoscope.cli.ink.halftone:halftone")
app.command("anisoscope.cli.ink.proof:proof")
app.command("anisoscope.cli.ink.compare:compare")


@app.command
@with_options(fitting=Options(InkFitting, names={"method": "--fit-method"}, whole=True))
def fit(
    data: Path,
    /,
    *,
    fitting: Given[InkFitting],
    name: Annotated[str | None, Parameter(help="Name of the ink.")] = None,
    out: Annotated[Path | None, Parameter(help="Write the ink file *.toml.")] = None,
    html: Html = None,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Fit roughness, reflectance and goniochromatism of an ink to goniometer readings.

    Args:
        data: CSV: theta_i_deg,theta_o_deg,wavelength_nm,value; θo counts away from the light, θo = θi is the mirror.

    Examples:
        anisoscope ink fit red.csv --out red.toml --html red-fit.html
    """
    from anisoscope.ink.text import summary
    from anisoscope.operations.inks import fit_ink
    from anisoscope.sim.materials.inks import write_ink

    asked = fitting.made()
    check_suffix(out, "--out", ".toml")
    check_suffix(html, "--html", ".html", ".htm")
    check_new((out, html), overwrite=overwrite)
    found = fit_ink(data, fitting=asked)
    ink = found.ink(name or data.stem, f"fitted to {data.name} ({summary(found)})")
    if out is not None:
        write_ink(ink, out)
    if html is not None:
        from anisoscope.report.ink_page import write_ink_fit_page

        write_ink_fit_page(found, ink, f"Ink {ink.name}", html)
    if json_:
        print_json(found)
    else:
        print_fit(found, f"Fit of {data.name}")
        for path in (out, html):
            if path is not None:
                print_lines(f"{path}: written")
    return 0 if found.fits else 3


@app.command(name="import")
@with_options(read=Options(InkTable, whole=True))
def import_(
    table: Path,
    /,
    *,
    out: Annotated[Path, Parameter(help="Ink file *.toml to write.")],
    read: Given[InkTable],
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Make an ink file of a published table of spectral parameters.

    Args:
        table: CSV wavelength_nm,rho,c: a row a wavelength, from 400 nm or less to 700 nm or more.

    Examples:
        anisoscope ink import red.csv --alpha 0.19 --out red.toml
    """
    from anisoscope.sim.light.ink.ink import SPECTRALON
    from anisoscope.sim.light.ink.model import albedo_warning
    from anisoscope.sim.materials.inks import read_ink_table, write_ink

    how = read.made()
    check_suffix(out, "--out", ".toml")
    check_new((out,), overwrite=overwrite)
    white = SPECTRALON if how.reflectance is None else how.reflectance
    ink = read_ink_table(
        table, how.alpha, convention=how.scale, white=white, name=how.name or table.stem, source=how.source
    )
    low, high = float(ink.nm.min()), float(ink.nm.max())
    if low > NEEDED_NM[0] or high < NEEDED_NM[1]:
        raise UsageError(
            f"{table}: wavelengths from {low:g} to {high:g} nm have no colour; 400 to 700 nm are needed"
        )
    write_ink(ink, out)
    warning = albedo_warning(ink)
    if json_:
        return print_json(
            {
                "ink": ink.name, "alpha": how.alpha, "wavelengths": int(ink.nm.size), "from_nm": low, "to_nm": high,
                "scale": how.scale, "written": out, "warnings": [] if warning is None else [warning],
            }
        )  # fmt: skip
    print_lines(f"{ink.name}: {ink.nm.size} wavelengths from {low:g} to {high:g} nm, alpha {how.alpha:g}")
    if warning is not None:
        print_lines(f"warning: {warning}")
    print_lines(f"{out}: written")
    return 0


@app.command
@with_options(
    view=Options(
        InkView,
        names={"exposure": "--brightness"},
        flags=("adapt",),
        whole=True,
    )
)
def show(
    *inks: str,
    view: Given[InkView],
    html: Html = None,
    png: Path | None = None,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Colour of inks against angle.

    Args:
        inks: Ink files *.toml, or synthetic-red, synthetic-green, synthetic-blue.
        png: Write a picture of the colours and spectra: *.png or *.svg.

    Examples:
        anisoscope ink show synthetic-red synthetic-green synthetic-blue --png inks.png
        anisoscope ink show red.toml --illuminant led-b3 --light-angles 0,30,60
    """
    from anisoscope.ink.appearance import ANGLES_DEG, show_inks
    from anisoscope.sim.materials.inks import SYNTHETIC, find_ink
    from anisoscope.sim.materials.spectra import find_illuminant

    if not inks:
        raise UsageError(f"ink show needs an ink: a file *.toml, or {', '.join(SYNTHETIC)}")
    check_suffix(html, "--html", ".html", ".htm")
    check_suffix(png, "--png", ".png", ".svg")
    check_new((html, png), overwrite=overwrite)
    seen = view.made()
    usual = tuple(angle for angle in ANGLES_DEG if abs(angle + seen.off_mirror_deg) < HORIZON_DEG)
    if not usual:
        raise UsageError(f"--off-mirror takes degrees between -90 and 90, not {seen.off_mirror_deg:g}")
    shown = show_inks(
        [find_ink(text) for text in inks],
        find_illuminant(seen.illuminant),
        theta_deg=seen.light_angles_deg or usual,
        off_mirror_deg=seen.off_mirror_deg,
        model=seen.ink_model,
        exposure=seen.exposure,
        adapt=seen.adapt,
    )
    if html is not None or png is not None:
        from anisoscope.report.ink_page import write_ink_picture, write_ink_show_page

        if html is not None:
            write_ink_show_page(shown, "Inks against angle", html)
        if png is not None:
            write_ink_picture(shown, png)
    if json_:
        print_json(shown)
    else:
        print_show(shown)
        for path in (html, png):
            if path is not None:
                print_lines(f"{path}: written")
    return 0


def print_fit(found: "InkFit", title: str) -> None:
    """The table of a fit, and its warnings."""
    from anisoscope.ink.text import FIT_COLUMNS, fit_rows, summary

    print_table(title, list(FIT_COLUMNS), fit_rows(found), caption=summary(found))
    print_lines(
        f"Scale: {found.scale}; noise floor {found.grid.floor:.2g}/sr; one plane was read: taken as isotropic."
    )
    for warning in found.warnings:
        print_lines(f"warning: {warning}")


def print_show(shown: "Show") -> None:
    """One table of colours for every ink, each with its swatch."""
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    from anisoscope.ink.text import SHOW_COLUMNS, show_notes, show_rows

    for number, one in enumerate(shown.inks):
        rough = f"{one.ink.alpha:g}" if one.ink.isotropic else f"{one.ink.alpha:g} × {one.ink.across:g}"
        table = Table(title=escape(f"{one.ink.name}, alpha {rough}"), title_justify="left")
        for column in SHOW_COLUMNS:
            table.add_column(escape(column), justify="right")
        table.add_column("")
        for row, code in zip(show_rows(shown, number), one.hexes, strict=True):
            table.add_row(*(escape(cell) for cell in row), Text("      ", style=f"on {code}"))
        console().print(table)
        if one.ink.source:
            print_lines(f"Source: {one.ink.source}.")
    for note in show_notes(shown):
        print_lines(note)
