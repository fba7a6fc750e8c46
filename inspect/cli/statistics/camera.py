"""``anisoscope camera``: data sheet of a camera after EMVA 1288."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Html, Json
from anisoscope.cli.statistics.source import print_grid
from anisoscope.cli.tables import print_lines


def camera(
    source: Annotated[
        Path, Parameter(help="Rig file (TOML), or the record of a linearity calibration (JSON).")
    ],
    /,
    *,
    html: Html = None,
    json_: Json = False,
) -> int:
    """Show the properties of the camera after EMVA 1288, from its linearity calibration.

    Take the calibration with `anisoscope calibrate linearity`.

    Exit codes: 0 fit for measuring, 3 not.

    Examples:
        anisoscope camera rig.toml --html camera.html
    """
    from anisoscope.quality.camera import read_camera
    from anisoscope.report.camera_page import values_table, write_camera_page

    sheet = read_camera(source)
    if html is not None:
        write_camera_page(html, sheet)
    if json_:
        print_json(sheet)
    else:
        record = sheet.record
        until = f"valid until {record.valid_until:%Y-%m-%d}"
        print_lines(f"camera {record.camera.model} at gain {record.gain:g}: {record.id}, {until}")
        print_grid(values_table(sheet))
        print_lines(*sheet.notes, sheet.verdict)
        if html is not None:
            print_lines(f"{html}: the page")
    return 0 if sheet.record.in_limits else 3
