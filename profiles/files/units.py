"""Units that a file does not state and a user must; and units that a file states."""

from collections.abc import Sequence

from anisoscope.base.errors import HeightMapError

MICROMETRES_PER = {"um": 1.0, "µm": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6}
STATED_MICROMETRES_PER = {
    **MICROMETRES_PER,
    "\u03bcm": 1.0,  # Greek mu; the key above is the micro sign
    "cm": 1e4,
    "pm": 1e-6,
    "\u00c5": 1e-4,  # the letter
    "\u212b": 1e-4,  # the sign of the unit
}
MOST_NAMED = 20


def chosen_channel(name: str, wanted: str, names: Sequence[str]) -> int:
    """Place of a channel that the user names, by its name whatever its case, or by its number from 1.

    Raises:
        HeightMapError: none, or several of that name; says which there are.
    """
    found = [k for k, one in enumerate(names) if one.strip().casefold() == wanted.strip().casefold()]
    if not found and wanted.strip().isdecimal():
        found = [int(wanted) - 1] if 0 < int(wanted) <= len(names) else []
    if len(found) != 1:
        listed = ", ".join(f"{k} {one[:40]}" for k, one in enumerate(names[:MOST_NAMED], 1))
        raise HeightMapError(
            f"{name}: channel: {'several are' if found else 'none is'} called {wanted[:40]!r}; take one of {listed} "
            "with --channel, by name or number"
        )
    return found[0]


def micrometres_per(unit: str) -> float:
    """Factor from a length unit (um, nm, mm, m) to µm.

    Raises:
        HeightMapError: another unit.
    """
    if unit not in MICROMETRES_PER:
        raise HeightMapError(f"unknown length unit {unit!r}; use um, nm, mm or m")
    return MICROMETRES_PER[unit]


def stated_micrometres_per(name: str, axis: str, unit: str | None) -> float:
    """Factor to µm from the unit that a file states for an axis.

    Raises:
        HeightMapError: no unit, or one that is no length, as of channels that are not heights.
    """
    factor = STATED_MICROMETRES_PER.get((unit or "").strip())
    if factor is None:
        raise HeightMapError(
            f"{name}: unit of {axis}: {(unit or 'none')[:40]!r} is no length; export a height channel in metres"
        )
    return factor


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


def stated_or_given_pixel(
    name: str, stated: tuple[float, float] | None, given: tuple[float, float] | None
) -> tuple[float, float]:
    """The (y, x) pixel size in µm of a file that may state one; the user may give it only where it does not.

    Raises:
        HeightMapError: both, or neither.
    """
    if stated is not None and given is not None:
        raise HeightMapError(
            f"{name}: units: the file states its own pixel, {stated[0]:.6g} × {stated[1]:.6g} µm (y, x); "
            "leave the pixel size out"
        )
    return require_pixel(name, stated or given)
