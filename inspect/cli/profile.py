"""``anisoscope profile``: look at height maps and convert them."""

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

from anisoscope.cli.console import parse_numbers, print_table
from anisoscope.errors import UsageError

app = App(name="profile", help="Look at height maps, and convert them.")

Unit = Literal["um", "nm", "mm", "m"]
Layout = Literal["auto", "matrix", "xyz"]
Role = Literal["part", "tool"]


def parse_pixel(text: str | None) -> tuple[float, float] | None:
    """Pixel size (y, x) in µm of an option SIZE or Y,X.

    Raises:
        UsageError: not one or two positive numbers.
    """
    if text is None:
        return None
    numbers = parse_numbers(text, "--pixel")
    if len(numbers) not in (1, 2) or min(numbers) <= 0:
        raise UsageError(f"--pixel takes one or two positive numbers of µm, SIZE or Y,X, not {text!r}")
    return numbers[0], numbers[-1]


@app.command
def info(
    file: Path,
    /,
    *,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
    pixel: str | None = None,
    z_unit: Unit = "um",
    xy_unit: Unit | None = None,
    layout: Layout = "auto",
    role: Annotated[
        Literal["part", "tool"], Parameter(help="Map of the part, or of the tool (mould).")
    ] = "part",
) -> int:
    """Size, missing share and height parameters (ISO 25178-2, mean removed, not levelled) of a height map.

    Args:
        file: Height map: x3p, npy, npz, csv, txt or xyz.
        json_: Print JSON.
        pixel: Pixel size in µm of a file without one: SIZE or Y,X.
        z_unit: Unit of the heights of a file that states none.
        xy_unit: Unit of x and y of a list of points; that of the heights if not given.
        layout: What a text file with three columns holds.
        role: Map of the part, or of the tool (mould), whose negative the part is.
    """
    from anisoscope.profiles.amplitude import amplitude
    from anisoscope.profiles.load import read_height_map

    surface = read_height_map(
        file, pixel_um=parse_pixel(pixel), z_unit=z_unit, role=role, xy_unit=xy_unit, layout=layout
    )
    rows, cols = surface.shape
    found = amplitude(surface)
    if json_:
        result = {
            "rows": rows,
            "cols": cols,
            "pixel_um": [surface.pixel_y_um, surface.pixel_x_um],
            "missing_share": surface.missing_share,
            "sa_um": found.sa_um,
            "sq_um": found.sq_um,
            "sz_um": found.sz_um,
            "field_um": list(surface.extent_um),
            "origin": surface.origin,
        }
        json.dump(result, sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
        return 0
    field_y, field_x = surface.extent_um
    print_table(
        file.name,
        ["quantity", "value", "unit"],
        [
            ["rows", str(rows), ""],
            ["columns", str(cols), ""],
            ["pixel along y, x", f"{surface.pixel_y_um:.6g}, {surface.pixel_x_um:.6g}", "µm"],
            ["field along y, x", f"{field_y:.6g}, {field_x:.6g}", "µm"],
            ["missing", f"{100 * surface.missing_share:.3g}", "%"],
            ["Sa", f"{found.sa_um:.6g}", "µm"],
            ["Sq", f"{found.sq_um:.6g}", "µm"],
            ["Sz", f"{found.sz_um:.6g}", "µm"],
        ],
        caption=f"format {surface.origin['format']}, role {role}",
    )
    return 0


@app.command
def convert(
    source: Path,
    target: Path,
    /,
    *,
    pixel: str | None = None,
    z_unit: Unit = "um",
    xy_unit: Unit | None = None,
    layout: Layout = "auto",
    role: Annotated[
        Literal["part", "tool"], Parameter(help="Map of the part, or of the tool (mould).")
    ] = "part",
) -> int:
    """Read a height map and write it in the format of another extension.

    Args:
        source: Height map: x3p, npy, npz, csv, txt or xyz.
        target: File to write: x3p, npy, csv or txt.
        pixel: Pixel size in µm of a file without one: SIZE or Y,X.
        z_unit: Unit of the heights of a file that states none.
        xy_unit: Unit of x and y of a list of points; that of the heights if not given.
        layout: What a text file with three columns holds.
        role: Map of the part, or of the tool (mould), whose negative the part is.
    """
    from anisoscope.profiles.load import read_height_map, write_height_map

    surface = read_height_map(
        source, pixel_um=parse_pixel(pixel), z_unit=z_unit, role=role, xy_unit=xy_unit, layout=layout
    )
    write_height_map(surface, target)
    return 0
