"""Units that a file does not state and a user must."""

from anisoscope.errors import HeightMapError

MICROMETRES_PER = {"um": 1.0, "µm": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6}


def micrometres_per(unit: str) -> float:
    """Factor from a length unit (um, nm, mm, m) to µm.

    Raises:
        HeightMapError: another unit.
    """
    if unit not in MICROMETRES_PER:
        raise HeightMapError(f"unknown length unit {unit!r}; use um, nm, mm or m")
    return MICROMETRES_PER[unit]


def require_pixel(name: str, pixel_um: tuple[float, float] | None) -> tuple[float, float]:
    """The (y, x) pixel size in µm, which the user must give where the file has none.

    Raises:
        HeightMapError: no pixel size was given; says how to give one.
    """
    if pixel_um is None:
        raise HeightMapError(
            f"{name}: pixel size: the file has none; "
            "give it in µm with --pixel SIZE or --pixel Y,X (pixel_um= in Python)"
        )
    return pixel_um
