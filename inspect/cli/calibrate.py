"""``anisoscope calibrate``: what the rig must know about itself."""

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from anisoscope.cli.console import console, progress

app = App(name="calibrate", help="Calibrate the rig.")


@app.command
def flat(
    *,
    rig: Annotated[Path, Parameter(name=["--rig", "-g"], help="Rig file (TOML).")],
    out: Annotated[Path, Parameter(help="File to write, such as flat.tif.")],
    exposure: Annotated[float, Parameter(help="Exposure in seconds.")],
    reflectance: Annotated[float, Parameter(help="Reflectance of the white tile, 0 to 1.")] = 0.99,
    frames: Annotated[int, Parameter(help="Frames to average.")] = 16,
    json_: Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")] = False,
) -> int:
    """Photograph a white tile: the picture's shading and the scale of radiance.

    Lay the tile on the stage so that it fills the picture, then run this; name the file in the rig file under
    [calibration] flat.
    """
    from anisoscope.calibration import take_flat

    with progress("flat", quiet=json_) as advance:
        meta = take_flat(
            rig, out, exposure_s=exposure, frames=frames, reflectance=reflectance, on_progress=advance
        )
    if json_:
        json.dump({"file": str(out), **meta}, sys.stdout, indent=2)
        sys.stdout.write("\n")
    else:
        console().print(
            f"{out}: {meta['frames']} frames, median {meta['level']:.0%} of full scale, "
            f"radiance of the tile {meta['radiance']:.4f} 1/sr",
            markup=False,
            highlight=False,
        )
    return 0
