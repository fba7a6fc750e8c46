"""``anisoscope ink compare``: models of an ink against pictures rendered from readings."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.ink.options import OverwriteOption, check_new, check_suffix
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.ink.goniometer import Readings
    from anisoscope.sim.proof.comparison import Comparison
    from anisoscope.sim.proof.measured import Measured

MOST_SIZE = 2048
NAMES = {"goniochromatic": "ours", "schlick": "standard, Schlick", "tio2": "standard, TiO2 × ρ"}


def compare(
    *readings: Path,
    synthetic: Annotated[
        bool, Parameter(negative="", help="Compare on made-up readings of the three synthetic inks.")
    ] = False,
    seed: Annotated[int, Parameter(help="Seed of the noise of made-up readings.")] = 1,
    values: Annotated[
        Literal["factor", "brdf"],
        Parameter(help="Values are ratios to the white reference, or BRDF in 1/sr."),
    ] = "factor",
    reflectance: Annotated[
        float | None, Parameter(help="Reflectance of the white reference; else 0.99.")
    ] = None,
    alpha: Annotated[
        float | None, Parameter(help="Roughness to show the models with, in place of the fitted one.")
    ] = None,
    illuminant: Annotated[
        str, Parameter(help="Illuminant: d65, a, led-b3 …, or CSV wavelength_nm,power.")
    ] = "d65",
    picture_size: Annotated[int, Parameter(help="Side of the pictures in pixels.")] = 512,
    png: Annotated[
        Path | None,
        Parameter(help="Write the spheres to this *.png: a row an ink; readings, then the models."),
    ] = None,
    overwrite: OverwriteOption = False,
    json_: Json = False,
) -> int:
    """Compare spheres shown by the models with ones made from readings: RMSE, SSIM and frame time.

    Args:
        readings: CSV files theta_i_deg,theta_o_deg,wavelength_nm,value, one an ink; each is fitted first.

    Examples:
        anisoscope ink compare --synthetic
        anisoscope ink compare red.csv green.csv blue.csv --png spheres.png
    """
    from anisoscope.sim.materials.spectra import find_illuminant
    from anisoscope.sim.proof.comparison import CONVENTION
    from anisoscope.sim.proof.comparison import compare as run

    check_suffix(png, "--png", ".png")
    check_new((png,), overwrite=overwrite)
    if not picture_size <= MOST_SIZE or seed < 0:
        raise UsageError(f"--picture-size takes pixels up to {MOST_SIZE}, --seed 0 or more")
    if bool(readings) == synthetic:
        raise UsageError("ink compare needs readings (CSV files), or --synthetic in their place")
    if values == "brdf" and reflectance is not None:
        raise UsageError("--reflectance needs --values factor: a BRDF has no white reference")
    lamp = find_illuminant(illuminant)
    found, warnings = [], []
    sets = (
        _synthetic_sets(seed)
        if synthetic
        else [(path.stem, _read(path, values, reflectance)) for path in readings]
    )
    with progress("compare", quiet=json_) as advance:
        for done, (name, (read, measured)) in enumerate(sets):
            advance(name, done, len(sets))
            from anisoscope.ink.fitting import fit

            fitted = fit(read)
            if not synthetic:  # made-up readings have on purpose what the fit would warn of
                warnings += [f"{name}: {warning}" for warning in fitted.warnings]
            ink = fitted.ink(name, "fitted to the readings")
            # A given roughness replaces the fitted one only in the models, not in the readings they are compared with.
            ink = ink if alpha is None else replace(ink, alpha=alpha)
            found.append(run(measured, ink, illuminant=lamp, size=picture_size))
    if png is not None:
        _write_png(found, png)
    if json_:
        print_json({"synthetic": synthetic, "convention": CONVENTION, "inks": found, "warnings": warnings})
        return 0
    _print(found, synthetic, picture_size)
    for warning in warnings:
        print_lines(f"warning: {warning}")
    print_lines(f"Convention: {CONVENTION}.")
    if png is not None:
        print_lines(f"{png}: written")
    return 0


Set = tuple["Readings", "Measured"]


def _read(path: Path, values: Literal["factor", "brdf"], white: float | None) -> Set:
    from anisoscope.base.errors import ModelError
    from anisoscope.ink.goniometer import White, read_goniometer, to_brdf
    from anisoscope.sim.light.ink.ink import SPECTRALON

    read = to_brdf(read_goniometer(path), values, White(SPECTRALON if white is None else white))
    try:
        return read, _by_place(read, path)
    except ModelError as problem:
        raise UsageError(f"{path}: {problem}") from None


def _by_place(read: "Readings", path: Path) -> "Measured":
    """Readings as places × wavelengths; a place that was read twice is averaged."""
    import numpy as np

    from anisoscope.sim.proof.measured import Measured

    angles, place = np.unique(
        np.stack([read.theta_i_deg, read.theta_o_deg], axis=-1), axis=0, return_inverse=True
    )
    nm, column = np.unique(read.wavelength_nm, return_inverse=True)
    total, count = np.zeros((len(angles), len(nm))), np.zeros((len(angles), len(nm)))
    np.add.at(total, (place.ravel(), column), read.value)
    np.add.at(count, (place.ravel(), column), 1.0)
    if not count.all():
        at, band = np.argwhere(count == 0.0)[0]
        raise UsageError(
            f"{path}: no reading at θi {angles[at, 0]:g}°, θo {angles[at, 1]:g}°, {nm[band]:g} nm: "
            "pictures need every wavelength at every place"
        )
    return Measured(angles[:, 0], angles[:, 1], nm, total / count)


def _synthetic_sets(seed: int) -> list[tuple[str, Set]]:
    import numpy as np

    from anisoscope.ink.goniometer import Readings
    from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
    from anisoscope.sim.proof.comparison import synthetic_readings

    found: list[tuple[str, Set]] = []
    for name, rng in zip(SYNTHETIC, np.random.default_rng(seed).spawn(len(SYNTHETIC)), strict=True):
        measured = synthetic_readings(synthetic_ink(name), rng)
        places, bands = measured.value.shape
        read = Readings(
            np.repeat(measured.theta_i_deg, bands),
            np.repeat(measured.theta_o_deg, bands),
            np.tile(measured.wavelengths_nm, places),
            measured.value.ravel(),
            tuple(range(measured.value.size)),
        )
        found.append((name, (read, measured)))
    return found


def _print(found: "list[Comparison]", synthetic: bool, size: int) -> None:
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
    if synthetic:
        print_lines(
            "The readings are synthetic: they show that the comparison works, and nothing about real inks."
        )


def _write_png(found: "list[Comparison]", path: Path) -> None:
    import numpy as np

    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.sim.proof.imagefile import picture_png

    sheet: np.ndarray = np.concatenate(
        [np.concatenate([one.reference, *(row.srgb for row in one.rows)], axis=1) for one in found], axis=0
    )
    write_bytes(path, picture_png(np.rint(255.0 * sheet).astype(np.uint8)))
