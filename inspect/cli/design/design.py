"""``anisoscope design``: stepped surfaces with a given reflectance lobe."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Html, Json
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.etching import DepthSearch, LobeShape, StepBlocks
from anisoscope.parameters.fabrication import Fabrication
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.operations.design.etched import EtchedDesign
    from anisoscope.sim.design.designfile import DesignFile

OutOption = Annotated[Path | None, Parameter(help="Write the design *.toml.")]
NameOption = Annotated[str | None, Parameter(help="Name of the design.")]

app = App(
    name="design",
    help="Design surfaces: diffractive steps, depths, dots, patterns and masks, and codes made of ridges.",
)
app.command("anisoscope.cli.design.dots:refine")
app.command("anisoscope.cli.design.dots:pattern")
app.command("anisoscope.cli.design.dots:relight")
app.command("anisoscope.cli.design.dots:mask")
app.command("anisoscope.cli.design.dots:height")
app.command("anisoscope.cli.design.plates:code")
app.command("anisoscope.cli.design.plates:plate")
app.command("anisoscope.cli.design.dots:resolution")
app.command("anisoscope.cli.design.pictures:picture")
app.command("anisoscope.cli.design.pictures:hologram")
app.command("anisoscope.cli.design.pictures:compare_lobe")


def parse_band(text: str, option: str = "--band") -> tuple[float, float]:
    """Two rising wavelengths, or one, in nm.

    Raises:
        UsageError: not one or two positive rising numbers.
    """
    numbers = parse_numbers(text, option)
    if len(numbers) not in (1, 2) or not 0.0 < numbers[0] <= numbers[-1]:
        raise UsageError(f"{option} takes two rising wavelengths in nm, LOW,HIGH, or one, not {text!r}")
    return numbers[0], numbers[-1]


OF_STEPS = Options(
    Fabrication,
    Group("Light and fabrication"),
    readers={"depths_nm": parse_numbers, "band_nm": parse_band},
)
FOR_DEPTHS = "the depths are what is sought"
OF_BAND = replace(
    OF_STEPS,
    help={
        "band_nm": "Wavelengths in nm, LOW,HIGH, or one.",
        "coherence_um": "Coherence length of the source for the spike, µm.",
    },
    default=Fabrication(band_nm=(400.0, 700.0)),
    without=dict.fromkeys(("wavelength_nm", "depths_nm", "min_width_um", "grid_um"), FOR_DEPTHS),
)


@app.command
@with_options(shape=Options(LobeShape, flags=True, whole=True), fabrication=OF_STEPS)
def lobe(
    *,
    shape: Given[LobeShape],
    fabrication: Given[Fabrication],
    name: NameOption = None,
    out: OutOption = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Find the mixture of step widths whose reflectance comes closest to a Gaussian lobe.

    Prints the part of the target that no mixture reaches. A lobe that is out of reach of the smallest feature or the
    source is refused, with what would help.

    Examples:
        anisoscope design lobe --sigma 0.04 --sigma-y 0.01 --name "wide x" --out wide.toml
    """
    from anisoscope.operations.design.etched import etched_lobe

    found = etched_lobe(shape=shape.made(), fabrication=fabrication.over(Fabrication()), name=name)
    return _deliver(found, out, html, as_json=json_)


@app.command
@with_options(
    blocks=Options(
        StepBlocks, default={"arrangement": "2,2", "width_um": "2", "crossed": False}, flags=True, whole=True
    ),
    fabrication=OF_STEPS,
)
def antimirror(
    *,
    blocks: Given[StepBlocks],
    fabrication: Given[Fabrication],
    name: NameOption = None,
    out: OutOption = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Design a surface that reflects everywhere except in the mirror direction.

    Examples:
        anisoscope design antimirror --arrangement 2,2 --width 2 --name hole --out hole.toml
    """
    from anisoscope.operations.design.etched import etched_antimirror

    found = etched_antimirror(blocks=blocks.made(), fabrication=fabrication.over(Fabrication()), name=name)
    return _deliver(found, out, html, as_json=json_)


@app.command
def mixture(
    parts: Annotated[list[Path], Parameter(help="Designs *.toml.")],
    /,
    *,
    shares: Annotated[str, Parameter(help="Share of the area of each design, comma-separated, 1 together.")],
    name: NameOption = None,
    out: OutOption = None,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Mix designs by shares of the area: their reflectances add.

    Examples:
        anisoscope design mixture wide.toml hole.toml --shares 0.7,0.3 --out both.toml
    """
    from anisoscope.operations.design.etched import EtchedDesign
    from anisoscope.sim.design.designfile import mixed, read_design

    design = mixed([read_design(part) for part in parts], parse_numbers(shares, "--shares"), name)
    return _deliver(EtchedDesign(design), out, html, as_json=json_)


@app.command
@with_options(search=Options(DepthSearch, whole=True), light=OF_BAND)
def depths(
    *,
    search: Given[DepthSearch],
    light: Given[Fabrication],
    json_: Json = False,
) -> int:
    """Find depths of etch passes whose levels have a zero mean phase, at one wavelength or over a band.

    Examples:
        anisoscope design depths --levels 4 --band 400,700
    """
    from anisoscope.operations.design.etched import etch_depths

    made, asked = light.over(Fabrication(band_nm=(400.0, 700.0))), search.made()
    found = etch_depths(search=asked, band_nm=made.bandwidth_nm, coherence_um=made.coherence_um)
    if json_:
        return print_json(found)
    low, high = found.band_nm
    at = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
    spike = f"spike over lobe there (Δc {made.coherence_um:g} µm, steps {asked.width_um:g} µm)"
    print_table(
        f"{found.levels} levels {at}",
        ["quantity", "value", "unit"],
        [
            ["etch passes", ", ".join(f"{depth:.1f}" for depth in found.depths_nm), "nm"],
            ["levels", ", ".join(f"{level:.1f}" for level in sorted(found.levels_nm, reverse=True)), "nm"],
            ["largest |τ|, ε", f"{found.epsilon:.5f}", "1"],
            ["at", f"{found.worst_nm:.0f}", "nm"],
            [spike, f"{100.0 * found.spike_over_lobe:.3g}", "%"],
        ],
    )
    return 0


def _deliver(found: "EtchedDesign", out: Path | None, html: Path | None, *, as_json: bool) -> int:
    """Write and print a design."""
    design = found.design
    if out is not None:
        from anisoscope.sim.design.designfile import write_design

        write_design(design, out)
    if html is not None:
        from anisoscope.operations.design.pages import write_design_report

        write_design_report(design, html, found.axes, found.warnings)
    if as_json:
        return print_json(found)
    from anisoscope.operations.design.pages import figure_rows

    print_table(design.name, ["quantity", "value", "unit"], [list(row) for row in figure_rows(design)])
    rows = _width_rows(design)
    if rows:
        print_table("steps", ["axis", "width [µm]", "p_a"], rows)
    print_lines(*found.warnings)
    for path in (out, html):
        if path is not None:
            sys.stdout.write(f"written: {path}\n")
    return 0


def _width_rows(design: "DesignFile") -> list[list[str]]:
    """Widths of the steps of a lobe and how often each is drawn."""
    from anisoscope.sim.design.models import LobeModel

    if not isinstance(design.model, LobeModel):
        return []
    model = design.model
    rows = [["x", f"{a:g}", f"{p:.4f}"] for a, p in zip(model.widths_x_um, model.p_a_x, strict=True)]
    return rows + [["y", f"{a:g}", f"{p:.4f}"] for a, p in zip(model.widths_y_um, model.p_a_y, strict=True)]
