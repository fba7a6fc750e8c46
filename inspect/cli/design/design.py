"""``anisoscope design``: stepped surfaces with a given reflectance lobe."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.output import check_seed, design_json, figure_rows, width_rows
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.sim.design.depths import Depths
    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.lobe import AxisLobe
    from anisoscope.sim.design.models import AnyModel

HtmlOption = Annotated[Path | None, Parameter(help="Write a self-contained HTML page to this file.")]
OutOption = Annotated[Path | None, Parameter(help="Write the design *.toml.")]
NameOption = Annotated[str | None, Parameter(help="Name of the design.")]

app = App(
    name="design",
    help="Design surfaces: diffractive steps, depths, dots, patterns and masks, and codes made of ridges.",
)
app.command("anisoscope.cli.design.dots:refine")
app.command("anisoscope.cli.design.dots:pattern")
app.command("anisoscope.cli.design.dots:relight")
app.command("anisoscope.cli.design.masks:mask")
app.command("anisoscope.cli.design.masks:height")
app.command("anisoscope.cli.design.codes:code")
app.command("anisoscope.cli.design.plates:plate")
app.command("anisoscope.cli.design.resolution:resolution")
app.command("anisoscope.cli.design.pictures:picture")
app.command("anisoscope.cli.design.pictures:hologram")
app.command("anisoscope.cli.design.lobe_photo:compare_lobe")


@Parameter(name="*")
@dataclass(frozen=True)
class Fabrication:
    """Light and fabrication."""

    wavelength: Annotated[float, Parameter(help="Wavelength that the design is made for, nm.")] = 500.0
    coherence: Annotated[
        float, Parameter(help="Coherence length of the source, λ/Δa, µm; 16 is a lamp of 1.8°.")
    ] = 16.0
    depths: Annotated[
        str | None,
        Parameter(help="Depth of every etch pass in nm, comma-separated; a quarter wave if not given."),
    ] = None
    band: Annotated[
        str | None,
        Parameter(help="Wavelengths that --depths are for, LOW,HIGH in nm; --wavelength if not given."),
    ] = None
    min_width: Annotated[
        float, Parameter(help="Smallest feature, µm: 2 for optical lithography, less for electron beams.")
    ] = 2.0
    grid: Annotated[float, Parameter(help="Grid that all edges lie on, µm.")] = 0.25

    def etched(self) -> "Depths":
        """The etch passes.

        Raises:
            UsageError: depths or a band that are none, or steps off the grid.
            ModelError: depths that are not positive.
        """
        from anisoscope.sim.design.depths import Depths

        if not 100.0 <= self.wavelength <= 20000.0:
            raise UsageError(f"--wavelength takes 100 to 20000 nm, not {self.wavelength:g} nm")
        if not 0.0 < self.coherence < float("inf"):
            raise UsageError(f"--coherence must be a positive length in µm, not {self.coherence:g}")
        if not (0.0 < self.min_width < float("inf") and 0.0 < self.grid < float("inf")):
            raise UsageError(
                f"--min-width and --grid must be positive lengths in µm, not {self.min_width:g} and {self.grid:g}"
            )
        if abs(self.min_width / self.grid - round(self.min_width / self.grid)) > 1e-6:
            raise UsageError(
                f"--min-width {self.min_width:g} µm is not a whole number of --grid {self.grid:g} µm"
            )
        passes = (self.wavelength / 4.0,) if self.depths is None else parse_numbers(self.depths, "--depths")
        return Depths(passes, parse_band(self.band) if self.band else (self.wavelength, self.wavelength))


FABRICATION = Fabrication()

FAINT_TAU = 0.05
"""Mean phase of the levels from which on a warning is due."""


def parse_band(text: str) -> tuple[float, float]:
    """Two rising wavelengths, or one, in nm.

    Raises:
        UsageError: not one or two positive rising numbers.
    """
    numbers = parse_numbers(text, "--band")
    if len(numbers) not in (1, 2) or not 0.0 < numbers[0] <= numbers[-1]:
        raise UsageError(f"--band takes two rising wavelengths in nm, LOW,HIGH, or one, not {text!r}")
    return numbers[0], numbers[-1]


@app.command
def lobe(
    *,
    sigma: Annotated[float, Parameter(help="σ of the Gaussian lobe along x, in half vectors h.")],
    sigma_y: Annotated[float | None, Parameter(help="σ along y; as along x if not given.")] = None,
    max_width: Annotated[float, Parameter(help="Widest step, µm.")] = 20.0,
    nearest: Annotated[
        bool, Parameter(negative="", help="Take the nearest lobe if the wanted one is out of reach.")
    ] = False,
    fabrication: Annotated[Fabrication, Parameter(group="Light and fabrication")] = FABRICATION,
    name: NameOption = None,
    out: OutOption = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Find the mixture of step widths whose reflectance comes closest to a Gaussian lobe.

    Prints the part of the target that no mixture reaches. A lobe that is out of reach of the smallest feature or the
    source is refused, with what would help.

    Examples:
        anisoscope design lobe --sigma 0.04 --sigma-y 0.01 --name "wide x" --out wide.toml
    """
    from anisoscope.sim.design.lobe import LobeTask, design_lobe
    from anisoscope.sim.design.models import LobeModel

    etched = fabrication.etched()
    tasks = [
        LobeTask(
            one,
            fabrication.min_width,
            max_width,
            fabrication.grid,
            1e-3 * fabrication.wavelength,
            fabrication.coherence,
        )
        for one in (sigma, sigma if sigma_y is None else sigma_y)
    ]
    found = design_lobe(*tasks)
    if not nearest:
        found.check()
    (wx, px), (wy, py) = ((a.widths_um.tolist(), a.probabilities.tolist()) for a in (found.x, found.y))
    model = LobeModel(widths_x_um=tuple(wx), p_a_x=tuple(px), widths_y_um=tuple(wy), p_a_y=tuple(py))
    figures = {
        "sigma_x": found.x.task.sigma, "sigma_y": found.y.task.sigma, "rel_l2": found.rel_l2,
        "rel_l2_x": found.x.rel_l2, "rel_l2_y": found.y.rel_l2,
        "one_width_x": found.x.one_width, "one_width_y": found.y.one_width,
        "intrinsic_x": found.x.intrinsic, "intrinsic_y": found.y.intrinsic,
        "unreachable_x": found.x.unreachable_share, "unreachable_y": found.y.unreachable_share,
    }  # fmt: skip
    title = name or (f"lobe {sigma:g}" if sigma_y in (None, sigma) else f"lobe {sigma:g} × {sigma_y:g}")
    design = _design_file(title, model, etched, fabrication, figures)
    warnings = [] if found.x.feasible and found.y.feasible else [
        f"out of reach: {100.0 * found.rel_l2:.1f} % (L2) of the wanted lobe is missed; this is the nearest"
    ]  # fmt: skip
    tau = etched.tau_at(fabrication.wavelength)
    if tau >= FAINT_TAU:
        warnings.append(
            f"the levels have a mean phase of {tau:.2f} at {fabrication.wavelength:g} nm: a spike stands in the lobe"
        )
    return _deliver(design, out, html, as_json=json_, axes=(found.x, found.y), warnings=warnings)


@app.command
def antimirror(
    *,
    arrangement: Annotated[str, Parameter(help="Steps in a block, M or MX,MY.")] = "2,2",
    width: Annotated[str, Parameter(help="Width of a step, A or AX,AY in µm.")] = "2",
    crossed: Annotated[
        bool,
        Parameter(negative="", help="A sequence along each axis instead of blocks: the hole is a cross."),
    ] = False,
    fabrication: Annotated[Fabrication, Parameter(group="Light and fabrication")] = FABRICATION,
    name: NameOption = None,
    out: OutOption = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Design a surface that reflects everywhere except in the mirror direction.

    Examples:
        anisoscope design antimirror --arrangement 2,2 --width 2 --name hole --out hole.toml
    """
    from anisoscope.sim.design.antimirror import AntiMirror
    from anisoscope.sim.design.depths import Depths
    from anisoscope.sim.design.models import AntiMirrorModel

    etched = fabrication.etched()
    many, widths = parse_numbers(arrangement, "--arrangement"), parse_numbers(width, "--width")
    if not {len(many), len(widths)} <= {1, 2} or any(m != int(m) for m in many):
        raise UsageError("--arrangement takes one or two whole numbers, --width one or two numbers of µm")
    tau = etched.tau_at(fabrication.wavelength)
    found = AntiMirror(
        (int(many[0]), int(many[-1])),
        (widths[0], widths[-1]),
        len(etched.levels_nm),
        crossed,
        fabrication.min_width,
    )
    folded = found.folds(tau)
    model = AntiMirrorModel(
        arrangement=found.arrangement,
        widths_um=found.widths_um,
        levels=found.levels,
        crossed=crossed,
        folded=folded,
    )
    if crossed and not folded:
        etched = Depths(etched.passes_nm * 2, etched.band_nm)
    um = 1e-3 * fabrication.wavelength
    holes = zip(("hole_x", "hole_y"), found.hole(um), strict=True)
    figures = {
        **{key: value for key, value in holes if value < float("inf")},
        "ring_x": found.ring(um)[0], "ring_y": found.ring(um)[1], "hole_floor": found.floor(um, fabrication.coherence),
    }  # fmt: skip
    shape = "crossed " if crossed else ""
    title = name or f"{shape}anti-mirror {found.arrangement[0]}×{found.arrangement[1]}"
    warnings = [] if tau < FAINT_TAU else [
        f"the levels have a mean phase of {tau:.2f} at {fabrication.wavelength:g} nm: the hole is filled by a spike"
    ]  # fmt: skip
    design = _design_file(title, model, etched, fabrication, figures)
    return _deliver(design, out, html, as_json=json_, warnings=warnings)


@app.command
def mixture(
    parts: Annotated[list[Path], Parameter(help="Designs *.toml.")],
    /,
    *,
    shares: Annotated[str, Parameter(help="Share of the area of each design, comma-separated, 1 together.")],
    name: NameOption = None,
    out: OutOption = None,
    html: HtmlOption = None,
    json_: Json = False,
) -> int:
    """Mix designs by shares of the area: their reflectances add.

    Examples:
        anisoscope design mixture wide.toml hole.toml --shares 0.7,0.3 --out both.toml
    """
    from anisoscope.sim.design.designfile import mixed, read_design

    design = mixed([read_design(part) for part in parts], parse_numbers(shares, "--shares"), name)
    return _deliver(design, out, html, as_json=json_)


@app.command
def depths(
    *,
    levels: Annotated[int, Parameter(help="Levels K: 2, 4, 8, … from log₂ K etch passes.")] = 4,
    band: Annotated[str, Parameter(help="Wavelengths in nm, LOW,HIGH, or one.")] = "400,700",
    h_z: Annotated[
        float, Parameter(help="z component of the half vector; 1 where light and camera stand above.")
    ] = 1.0,
    coherence: Annotated[float, Parameter(help="Coherence length of the source for the spike, µm.")] = 16.0,
    width: Annotated[float, Parameter(help="Width of the steps for the spike, µm.")] = 2.0,
    seed: Annotated[int, Parameter(help="Seed of the global search.")] = 0,
    json_: Json = False,
) -> int:
    """Find depths of etch passes whose levels have a zero mean phase, at one wavelength or over a band.

    Examples:
        anisoscope design depths --levels 4 --band 400,700
    """
    from anisoscope.sim.design.depths import design_depths

    if not (coherence > 0.0 and width > 0.0):
        raise UsageError("--coherence and --width must be positive")
    check_seed(seed)
    found = design_depths(levels, parse_band(band), h_z, seed)
    spike = found.spike_over_lobe(coherence, width)
    result = {
        "levels": levels, "depths_nm": list(found.passes_nm), "levels_nm": list(found.levels_nm),
        "band_nm": list(found.band_nm), "epsilon": found.epsilon, "worst_nm": found.worst_nm,
        "spike_over_lobe": spike,
    }  # fmt: skip
    if json_:
        print_json(result)
        return 0
    return _print_depths(found, spike, coherence, width)


def _design_file(
    title: str, model: "AnyModel", etched: "Depths", fabrication: Fabrication, figures: dict[str, float]
) -> "DesignFile":
    from anisoscope.sim.design.designfile import DesignFile

    return DesignFile(
        name=title,
        model=model,
        passes_nm=etched.passes_nm,
        band_nm=etched.band_nm,
        wavelength_nm=fabrication.wavelength,
        coherence_um=fabrication.coherence,
        min_width_um=fabrication.min_width,
        grid_um=fabrication.grid,
        figures=figures,
    )


def _deliver(
    design: "DesignFile",
    out: Path | None,
    html: Path | None,
    *,
    as_json: bool,
    axes: "Sequence[AxisLobe]" = (),
    warnings: Sequence[str] = (),
) -> int:
    """Write and print a design."""
    if out is not None:
        from anisoscope.sim.design.designfile import write_design

        write_design(design, out)
    if html is not None:
        from anisoscope.cli.design.report import write_design_report

        write_design_report(design, html, axes, warnings)
    if as_json:
        print_json(design_json(design) | {"warnings": list(warnings)})
        return 0
    print_table(design.name, ["quantity", "value", "unit"], [list(row) for row in figure_rows(design)])
    rows = width_rows(design)
    if rows:
        print_table("steps", ["axis", "width [µm]", "p_a"], rows)
    sys.stdout.write("".join(f"{line}\n" for line in warnings))
    for path in (out, html):
        if path is not None:
            sys.stdout.write(f"written: {path}\n")
    return 0


def _print_depths(found: "Depths", spike: float, coherence_um: float, width_um: float) -> int:
    """Print etch passes and their levels."""
    low, high = found.band_nm
    at = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
    print_table(
        f"{len(found.levels_nm)} levels {at}",
        ["quantity", "value", "unit"],
        [
            ["etch passes", ", ".join(f"{depth:.1f}" for depth in found.passes_nm), "nm"],
            ["levels", ", ".join(f"{level:.1f}" for level in sorted(found.levels_nm, reverse=True)), "nm"],
            ["largest |τ|, ε", f"{found.epsilon:.5f}", "1"],
            ["at", f"{found.worst_nm:.0f}", "nm"],
            [
                f"spike over lobe there (Δc {coherence_um:g} µm, steps {width_um:g} µm)",
                f"{100.0 * spike:.3g}",
                "%",
            ],
        ],
    )
    return 0
