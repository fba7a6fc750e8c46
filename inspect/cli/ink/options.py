"""Common options of the commands on prints: inks, separation, size."""

from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.light.ink.ink import Ink

InksOption = Annotated[
    str | None,
    Parameter(
        help="Inks (red, green, blue, and perhaps white), comma-separated: files *.toml or names; else synthetic ones."
    ),
]
NAMES = {"way": "--separation", "gain": "--image-gain", "width_mm": "--print-width"}
"""Options of a separation that have another name than its fields."""


def printed_inks(text: str | None) -> tuple["Ink", ...]:
    """Inks by their names.

    Raises:
        UsageError: not three or four, or no such ink.
    """
    from anisoscope.sim.materials.inks import SYNTHETIC, find_ink

    names = list(SYNTHETIC) if text is None else [name.strip() for name in text.split(",")]
    if len(names) not in (3, 4):
        raise UsageError(
            f"--inks takes three inks or four separated by commas, not {len(names)}: {', '.join(SYNTHETIC)}"
        )
    return tuple(find_ink(name) for name in names)
