"""``anisoscope ink compare``: models of an ink against pictures rendered from readings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Flag, Json, Overwrite, check_new, check_suffix
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.parameters.ink import InkReadings, InkSpheres
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.sim.proof.comparison import Comparison

NAMES = {"goniochromatic": "ours", "schlick": "standard, Schlick", "tio2": "standard, TiO2 × ρ"}


@with_options(
    how=Options(InkReadings, whole=True),
    spheres=Options(InkSpheres, names={"size": "--picture-size"}, whole=True),
)
def compare(
    *readings: Path,
    synthetic: Flag = False,
    how: Given[InkReadings],
    spheres: Given[InkSpheres],
    png: Path | None = None,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Compare spheres shown by the models with ones made from readings: RMSE, SSIM and frame time.

    Args:
        readings: CSV files theta_i_deg,theta_o_deg,wavelength_nm,value, one an ink; each is fitted first.
        png: Write the spheres to this *.png: a row an ink; readings, then the models.
        synthetic: Compare on made-up readings of the three synthetic inks.

    Examples:
        anisoscope ink compare --synthetic
        anisoscope ink compare red.csv green.csv blue.csv --png spheres.png
    """
    from anisoscope.operations.inks import compare_inks

    check_suffix(png, "--png", ".png")
    check_new((png,), overwrite=overwrite)
    read, shown = how.made(), spheres.made()
    if bool(readings) == synthetic:
        raise UsageError("ink compare needs readings (CSV files), or --synthetic in their place")
    with progress("compare", quiet=json_) as advance:
        found = compare_inks(readings, how=read, spheres=shown, on_progress=advance)
    if png is not None:
        found.write_picture(png)
    if json_:
        return print_json(found)
    _print(found.inks, synthetic, shown.size)
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
