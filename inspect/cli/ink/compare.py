"""``anisoscope ink compare``: models of an ink against pictures rendered from readings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.ink.options import OverwriteOption
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, Json, check_new, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.sim.proof.comparison import Comparison

MOST_SIZE = 2048
NAMES = {"goniochromatic": "ours", "schlick": "standard, Schlick", "tio2": "standard, TiO2 × ρ"}


def compare(
    *readings: Path,
    synthetic: Flag = False,
    seed: Annotated[int, Parameter(help="Seed of the noise of made-up readings.")] = 1,
    values: Literal["factor", "brdf"] = "factor",
    reflectance: float | None = None,
    alpha: float | None = None,
    illuminant: str = "d65",
    picture_size: Annotated[int, Parameter(help="Side of the pictures in pixels.")] = 512,
    png: Path | None = None,
    overwrite: OverwriteOption = False,
    json_: Json = False,
) -> int:
    """Compare spheres shown by the models with ones made from readings: RMSE, SSIM and frame time.

    Args:
        readings: CSV files theta_i_deg,theta_o_deg,wavelength_nm,value, one an ink; each is fitted first.
        values: Values are ratios to the white reference, or BRDF in 1/sr.
        reflectance: Reflectance of the white reference; else 0.99.
        alpha: Roughness to show the models with, in place of the fitted one.
        illuminant: Illuminant: d65, a, led-b3 …, or CSV wavelength_nm,power.
        png: Write the spheres to this *.png: a row an ink; readings, then the models.
        synthetic: Compare on made-up readings of the three synthetic inks.

    Examples:
        anisoscope ink compare --synthetic
        anisoscope ink compare red.csv green.csv blue.csv --png spheres.png
    """
    from anisoscope.operations.inks import compare_inks

    check_suffix(png, "--png", ".png")
    check_new((png,), overwrite=overwrite)
    if not picture_size <= MOST_SIZE or seed < 0:
        raise UsageError(f"--picture-size takes pixels up to {MOST_SIZE}, --seed 0 or more")
    if bool(readings) == synthetic:
        raise UsageError("ink compare needs readings (CSV files), or --synthetic in their place")
    if values == "brdf" and reflectance is not None:
        raise UsageError("--reflectance needs --values factor: a BRDF has no white reference")
    with progress("compare", quiet=json_) as advance:
        found = compare_inks(
            readings,
            values,
            reflectance=reflectance,
            alpha=alpha,
            illuminant=illuminant,
            size=picture_size,
            seed=seed,
            on_progress=advance,
        )
    if png is not None:
        found.write_picture(png)
    if json_:
        return print_json(found)
    _print(found.inks, synthetic, picture_size)
    print_lines(
        *(f"warning: {warning}" for warning in found.warnings),
        f"Convention: {found.convention}.",
        *([] if png is None else [f"{png}: written"]),
    )
    return 0


def _print(found: "Sequence[Comparison]", synthetic: bool, size: int) -> None:
    rows = [
        [
            NAMES[row.model] if number == 0 else "",
            one.ink.name,
            f"{row.rmse:.4f}",
            f"{row.ssim:.4f}",
            f"{1e3 * row.frame_s:.2f}",
        ]
        for model in range(len(found[0].rows))
        for number, one in enumerate(found)
        for row in (one.rows[model],)
    ]
    what = "made-up readings of synthetic inks" if synthetic else "readings"
    print_table(
        f"Spheres of {size} × {size} pixels, two lights, against {what}",
        ["model", "ink", "RMSE [1]", "SSIM [1]", "frame [ms]"],
        rows,
        caption="lower RMSE and higher SSIM are better; frame time on this machine's processor",
    )
    shares = ", ".join(f"{one.ink.name} {one.measured_share:.0%}" for one in found)
    print_lines(f"Compared where directions were read, of the lit sphere: {shares}.")
    if synthetic:
        print_lines(
            "The readings are synthetic: they show that the comparison works, and nothing about real inks."
        )
