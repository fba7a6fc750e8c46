"""``anisoscope rig snap``: one frame to a file, with its quality figures."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.language import decimal, message, per_cent
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, Overwrite
from anisoscope.cli.rig.options import OF_SHOT, RigPath, write_line
from anisoscope.parameters.taking import Shot
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.operations.rigging import Snapped

SATURATED_SHARE = 0.001


@with_options(shot=OF_SHOT)
def snap(
    *,
    rig: RigPath,
    out: Annotated[Path, Parameter(help="File to write (.tif): 16 bits, with our metadata.")],
    shot: Given[Shot],
    frames: Annotated[int, Parameter(name="--count", help="Frames to average, rounded to counts.")] = 1,
    preview: Annotated[bool, Parameter(negative="", help="Also write a PNG preview next to it.")] = False,
    stage: Annotated[bool, Parameter(name="--read-axes", negative="--no-read-axes")] = True,
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Take a picture and write it to a file; nothing moves.

    Prints mean, saturated share and sharpness (Tenengrad; larger is sharper, for the same object). The file of a colour
    camera holds the unchanged mosaic; the preview is in colour.

    Args:
        stage: Read the axes and write their angles into the file.

    Examples:
        anisoscope rig snap --rig rig.toml --exposure 0.005 --out picture.tif
    """
    from anisoscope.operations.rigging import snap as taken

    found = taken(
        rig,
        out,
        shot=shot.made(),
        frames=frames,
        preview=preview,
        read_angles=stage,
        overwrite=overwrite,
    )
    if found.not_homed:
        names = " and ".join(found.not_homed)
        write_line(f"{names}: not homed since connected; the angle in the file is what was read")
    if json_:
        print_json(found)
    else:
        _print(found)
    return 0


def _print(found: "Snapped") -> None:
    dark = math.isnan(found.sharpness)
    sharp = message("not measurable, too dark") if dark else f"{found.sharpness:.3g}"
    at = "" if math.isnan(found.angle_deg) else decimal(f", {found.angle_deg:.3f}°")
    print(  # noqa: T201
        message(
            "{path}: {size}, {exposure} s, gain {gain}; mean {mean} counts ({level} of full scale), saturated {share}, "
            "sharpness {sharpness}",
            path=found.file,
            size=f"{found.rows} × {found.cols}{at}",
            exposure=f"{found.exposure_s:g}",
            gain=f"{found.gain:g}",
            mean=f"{found.mean_counts:.1f}",
            level=per_cent(f"{found.mean:.1%}"),
            share=per_cent(f"{found.saturated_share:.3%}"),
            sharpness=sharp,
        )
    )
    if found.filters != "mono":
        print(message("{path}: raw mosaic, filters {name}", path=found.file, name=found.filters))  # noqa: T201
    if found.preview is not None:
        print(message("{path}: preview", path=found.preview))  # noqa: T201
    if found.saturated_share > SATURATED_SHARE:
        write_line(message("too many saturated pixels to measure anything: expose shorter"))
