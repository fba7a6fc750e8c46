"""Height parameters of ISO 25178-2 of a whole map, without levelling or filtering."""

from dataclasses import dataclass

import numpy as np

from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap


@dataclass(frozen=True)
class Amplitude:
    """Mean (Sa), root mean square (Sq) and greatest (Sz) height in µm about the mean height."""

    sa_um: float
    sq_um: float
    sz_um: float


def amplitude(surface: HeightMap) -> Amplitude:
    """Sa, Sq and Sz over the measured points of a map, (rows, cols) in µm.

    Only the mean is removed: form and tilt count. Source: ISO 25178-2, 4.1.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    height = surface.height_um[np.isfinite(surface.height_um)]
    residual = height - height.mean()
    return Amplitude(
        sa_um=float(np.abs(residual).mean()),
        sq_um=float(np.sqrt(np.square(residual).mean())),
        sz_um=float(height.max() - height.min()),
    )
