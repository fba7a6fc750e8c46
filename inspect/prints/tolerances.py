"""Limits of a print's recipe as a good print suggests them."""

from decimal import ROUND_UP, Decimal

from anisoscope.prints.recipe import PrintRecipe
from anisoscope.record import Record

WANTED_RATIO = 4.0  # T/U, U = 2 u
SIGMAS = 3.0
KEYS = {
    "alpha x": "alpha_share",
    "alpha y": "alpha_share",
    "ratio": "ln_ratio",
    "skew": "ln_ratio",
    "gain": "gain_share",
    "chromaticity": "chromaticity",
    "tilt": "tilt_deg",
    "delta_e": "delta_e",
    "curl": "curl_deg",
}
"""The limit under which each quantity stands in the recipe."""
WHY = f"{WANTED_RATIO:g} times the expanded uncertainty, or what this print deviates and {SIGMAS:g} u if that is more"


def taught_tolerances(record: Record, recipe: PrintRecipe) -> dict[str, float]:
    """Limits by their keys, for all that was judged; rounded up to two digits.

    Args:
        record: the inspection of a good print.
        recipe: its recipe, whose other limits stay.
    """
    assert record.print is not None
    found: dict[str, float] = {}
    for one in record.print.quantities:
        wanted = max(WANTED_RATIO * 2.0 * one.u, abs(one.deviation) + SIGMAS * one.u)
        key = KEYS[one.name]
        found[key] = max(found.get(key, 0.0), wanted)
    stays = recipe.tolerances.model_dump()
    return {key: _rounded_up(value) if value > 0.0 else stays[key] for key, value in found.items()}


def _rounded_up(value: float) -> float:
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 1), rounding=ROUND_UP))
