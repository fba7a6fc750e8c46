"""Parameters of a fit: their bounds, and the uncertainty from which on they count as undetermined."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class Parameter:
    """Parameter of the model. A fit works with its internal value: the logarithm where `logarithmic`.

    Attributes:
        name: with its unit, as in ``ridge_angle_deg``.
        words: what it is.
        unit: as printed; "" for a pure number, "value·sr" for the scale.
        low: lower bound.
        high: upper bound.
        default: value where nothing is given; None for one that then is no part of the model.
        step: internal step of the finite differences.
        limit: largest standard uncertainty, internal, at which the parameter counts as determined.
        logarithmic: it is fitted as its natural logarithm.
    """

    name: str
    words: str
    unit: str
    low: float
    high: float
    default: float | None
    step: float
    limit: float
    logarithmic: bool = False

    def internal(self, value: float) -> float:
        """The value as the fit sees it."""
        return float(np.log(value)) if self.logarithmic else value

    def external(self, internal: float) -> float:
        """The value in its unit."""
        return float(np.exp(internal)) if self.logarithmic else internal

    @property
    def bounds(self) -> tuple[float, float]:
        """Internal bounds."""
        return self.internal(self.low), self.internal(self.high)


PARAMETERS = {
    one.name: one
    for one in (
        Parameter("ridge_angle_deg", "ridge angle", "°", 0.0, 44.0, 10.0, 0.01, 2.0),
        Parameter("alpha_along", "roughness along the ridges", "", 0.002, 0.9, 0.06, 1e-3, 0.5, True),
        Parameter("alpha_across", "roughness across the ridges", "", 0.002, 0.9, 0.10, 1e-3, 0.5, True),
        Parameter("height_loss", "height loss", "", 0.0, 0.95, 0.0, 1e-3, 0.2),
        Parameter("seating_x_deg", "seating tilt about x", "°", -10.0, 10.0, 0.0, 0.01, 2.0),
        Parameter("seating_y_deg", "seating tilt about y", "°", -10.0, 10.0, 0.0, 0.01, 2.0),
        Parameter("k", "scale k", "value·sr", 1e-30, 1e30, 1.0, 1e-3, 0.5, True),
        Parameter("albedo", "albedo", "", 0.0, 1.0, 0.2, 1e-3, 0.15),
        Parameter("index", "refractive index", "", 1.05, 3.5, 1.5, 1e-3, 0.15),
        Parameter("tail", "tail of the lobe", "", 0.0, 1.6, 0.0, 1e-2, 0.3),
        Parameter("second_weight", "weight of the second lobe", "", 0.005, 0.6, None, 1e-2, 1.0, True),
        Parameter("second_width", "width of the second lobe", "", 1.1, 6.0, None, 1e-2, 0.5, True),
        Parameter("edge_radius_um", "radius of the crests", "µm", 0.0, 100.0, None, 0.05, 5.0),
        Parameter("foot_radius_um", "radius of the feet", "µm", 0.0, 100.0, None, 0.05, 5.0),
        Parameter("draft_deg", "draft of the wall", "°", 0.0, 60.0, None, 0.05, 10.0),
        Parameter("matte_deg", "roughness of a matte surface", "°", 0.0, 60.0, None, 0.1, 10.0),
    )
}
OPTIONAL = {
    "second_weight": 0.15,
    "second_width": 2.0,
    "edge_radius_um": 3.0,
    "foot_radius_um": 2.0,
    "draft_deg": 20.0,
    "matte_deg": 20.0,
}
"""Where the search of a parameter begins that has no default."""
GEOMETRY = tuple(n for n in PARAMETERS if n not in ("albedo", "index", "tail") and n not in OPTIONAL)
OPTICS = ("albedo", "index")
USUAL = ("ridge_angle_deg", "alpha_along", "alpha_across", "k")


def parse_free(text: str) -> tuple[str, ...]:
    """Names of a comma-separated list, in the order of `PARAMETERS`; the unit may be left out.

    "all" stands for ridge angle, roughness, height loss, seating and scale, "none" for nothing.

    Raises:
        UsageError: an unknown name.
    """
    if text.strip() in ("all", "none"):
        return GEOMETRY if text.strip() == "all" else ()
    known = {_short(name): name for name in PARAMETERS} | {name: name for name in PARAMETERS}
    names = [part.strip().replace("-", "_") for part in text.split(",")]
    for name in names:
        if name not in known:
            short = ", ".join(map(_short, PARAMETERS))
            raise UsageError(f"--free knows {short}, all and none, not {name!r}")
    chosen = {known[name] for name in names}
    return tuple(name for name in PARAMETERS if name in chosen)


def _short(name: str) -> str:
    return name.removesuffix("_deg").removesuffix("_um")


def checked_values(given: Mapping[str, float]) -> dict[str, float]:
    """All parameters, the given ones in place of the defaults.

    Raises:
        UsageError: a value outside its bounds.
    """
    usual = {name: one.default for name, one in PARAMETERS.items() if one.default is not None}
    values = usual | dict(given)
    for name, value in values.items():
        one = PARAMETERS[name]
        if not one.low <= value <= one.high:
            raise UsageError(f"{one.words}: {value:g} lies outside {one.low:g} to {one.high:g}")
    return values
