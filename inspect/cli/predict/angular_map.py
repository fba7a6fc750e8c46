"""``anisoscope predict MAP --map``: the BRDF of a height map over all directions of the camera."""

import io
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.views.options import parse_numbers

if TYPE_CHECKING:
    from anisoscope.parameters.material import Material
    from anisoscope.parameters.optics import Optics
    from anisoscope.prediction.angular import AngularReflectance
    from anisoscope.sim.light.colour.illuminant import Illuminant

MAP_GROUP = Group(
    "Angular map",
    help="BRDF of a height map over all directions of the camera, by waves. The surface reflects all light, as metal.",
    sort_key=41,
)


@dataclass(frozen=True)
class MapOptions:
    """The options; meaning as in `anisoscope.prediction.angular.AngularTask`."""

    picture: Annotated[
        Path | None, Parameter("--map", help="Write the map as a picture *.png, in place of contrasts.")
    ] = None
    table: Annotated[Path | None, Parameter("--map-csv", help="Write the map as a table *.csv.")] = None
    light: Annotated[str, Parameter("--map-light", help="Inclination and azimuth of the light, degrees.")] = (
        "0,0"
    )
    reach: Annotated[
        float, Parameter("--map-reach", help="Largest direction cosine of the camera along x and y.")
    ] = 0.4
    points: Annotated[int, Parameter("--map-points", help="Directions along each axis.")] = 161
    lamp_sigma: Annotated[
        float,
        Parameter(
            "--map-lamp-sigma", help="Gaussian lamp: its standard deviation in degrees, in place of a disc."
        ),
    ] = 0.0
    periodic: Annotated[
        bool, Parameter("--map-periodic", negative="", help="The map is one unit of a surface that repeats.")
    ] = False
    colour: Annotated[
        str | None,
        Parameter(
            "--map-colour", help="Illuminant of a map in colour: d65, a, led-b3 …, or CSV; 400 to 700 nm."
        ),
    ] = None


MAP_DEFAULTS = MapOptions()


@dataclass(frozen=True)
class Blur:
    """Lamp and lens, and the plastic where its roughness is stated: a map then has slopes below the pixels."""

    optics: "Optics"
    plastic: "Material | None"

    @property
    def slope_rms(self) -> tuple[float, float]:
        """Slopes along x and y below the pixels."""
        if self.plastic is None:
            return 0.0, 0.0
        return self.plastic.alpha_across / 2.0**0.5, self.plastic.alpha_along / 2.0**0.5


COLUMNS = ("v_x", "v_y", "inclination_deg", "azimuth_deg", "wavelength_nm", "brdf_per_sr")


def write_angular_map(
    path: Path | None,
    options: MapOptions,
    wavelengths_um: tuple[float, ...] | None,
    blur: Blur,
    interpolate: int,
    steps: int | None,
    pixel: str | None,
    role: Literal["part", "tool"],
    *,
    as_json: bool,
) -> int:
    """Compute and write the map.

    Raises:
        UsageError: options that do not go together.
        HeightMapError: a map that waves cannot take.
        ModelError: more memory or more maps than are taken.
    """
    from anisoscope.cli.options import parse_pixel
    from anisoscope.prediction.angular import COLOUR_NM, AngularTask, angular_reflectance
    from anisoscope.profiles.files.load import read_height_map
    from anisoscope.sim.materials.spectra import find_illuminant

    height_map, light = _checked(path, options, blur, wavelengths_um)
    lamp = None if options.colour is None else find_illuminant(options.colour)
    nm = COLOUR_NM if lamp is not None else tuple(1e3 * um for um in wavelengths_um or (0.55,))
    task = AngularTask(
        nm, light, options.reach, options.points, blur.optics.lamp_half_angle_deg,
        blur.optics.aperture_half_angle_deg, blur.slope_rms, options.lamp_sigma,
    )  # fmt: skip
    surface = read_height_map(height_map, pixel_um=parse_pixel(pixel), role=role)
    with progress("map", quiet=as_json) as advance:
        found = angular_reflectance(
            surface, task, steps=steps, interpolate=interpolate, periodic=options.periodic, advance=advance
        )
    if options.table is not None:
        _write_table(found, options.table)
    if options.picture is not None:
        _write_picture(found, lamp, options.picture)
    if as_json:
        return print_json({"map": height_map, **fields_of(found)})
    _print(found, height_map)
    for target in (options.picture, options.table):
        if target is not None:
            sys.stdout.write(f"written: {target}\n")
    return 0


def _checked(
    path: Path | None, options: MapOptions, blur: Blur, wavelengths_um: tuple[float, ...] | None
) -> tuple[Path, tuple[float, float]]:
    """The height map, and inclination and azimuth of the light."""
    if path is None:
        raise UsageError("--map needs a height map file: name it before the options")
    if options.picture is None and options.table is None:
        raise UsageError("name what to write: --map PICTURE.png, --map-csv TABLE.csv, or both")
    for target, option, ending in ((options.picture, "--map", ".png"), (options.table, "--map-csv", ".csv")):
        if target is not None and target.suffix.lower() == ".bsdf":
            raise UsageError(
                f"all directions of light and camera are written by `anisoscope bsdf export {target} --height-map "
                f"{path} --optics waves`"
            )
        if target is not None and target.suffix.lower() != ending:
            raise UsageError(f"{option} writes *{ending}, not {target.name}")
    if options.colour is not None and wavelengths_um is not None:
        raise UsageError("--map-colour takes wavelengths from 400 to 700 nm itself: leave --wavelengths out")
    light = parse_numbers(options.light, "--map-light", "10,0")
    if len(light) != 2:
        raise UsageError(
            f"--map-light takes inclination and azimuth in degrees, such as 10,0, not {options.light!r}"
        )
    if blur.optics.lamp_distance_mm is not None:
        raise UsageError("--map takes a lamp far away: leave --lamp-distance and --field out")
    return path, (light[0], light[1])


def _write_table(found: "AngularReflectance", path: Path) -> None:
    from anisoscope.base.atomic_write import write_text
    from anisoscope.base.csv_style import csv_text, number_text

    rows = [[number_text(f"{value:.6g}") for value in row] for row in found.rows()]
    write_text(path, csv_text([list(COLUMNS), *rows], file=True))


def _write_picture(found: "AngularReflectance", lamp: "Illuminant | None", path: Path) -> None:
    """The map with its axes; one wavelength has a bar, several have panels, a lamp has one panel in colour."""
    import numpy as np

    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.report.figures import new_figure

    reach = found.task.reach
    extent = (-reach, reach, -reach, reach)
    panels = 1 if lamp is not None else len(found.brdf)
    with new_figure(4.6 * panels, 4.2) as (figure, axes):
        axes.remove()
        for panel, number in zip(figure.subplots(1, panels, squeeze=False)[0], range(panels), strict=True):
            if lamp is not None:
                panel.imshow(found.srgb(lamp), extent=extent)
                panel.set_title("colour, scaled to its brightest", fontsize=9)
            else:
                one = found.brdf[number]
                top = max(float(np.nanquantile(one, 0.997)), 1e-12)
                shown = panel.imshow(one, origin="lower", extent=extent, cmap="inferno", vmin=0.0, vmax=top)
                figure.colorbar(shown, ax=panel, label="BRDF [1/sr]", shrink=0.85)
                panel.set_title(f"{found.task.wavelengths_nm[number]:g} nm", fontsize=9)
            panel.set_xlabel("v_x [1]")
            panel.set_ylabel("v_y [1]")
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_bytes(path, stream.getvalue())


def _print(found: "AngularReflectance", path: Path) -> None:
    task = found.task
    rows = [
        [f"{nm:g}", f"{100.0 * share:.1f}", f"{peak:.4g}", f"({x:.3f}, {y:.3f})".replace("-", "−")]
        for nm, share, peak, (x, y) in zip(
            task.wavelengths_nm, found.light_in_map, found.peak_per_sr, found.peak_at, strict=True
        )
    ]
    print_table(
        f"{path.name}: BRDF by waves, {'steps' if found.stepped else 'smooth'}, all light reflected",
        ["wavelength [nm]", "light within the map [%]", "largest [1/sr]", "at (v_x, v_y)"],
        rows,
        caption=f"light at {task.light_deg[0]:g}°, azimuth {task.light_deg[1]:g}°; |v_x|, |v_y| ≤ {task.reach:g}",
    )
