"""Defects of ridged surfaces: what they are, and their injection into height maps by name.

A defect is one object of `Defect`, found by the entry point of its name in the group ``anisoscope.defects``, so that a
third party's counts like a built-in one (`anisoscope.profiles.ridge_defects`): ``profile spoil`` makes it, and the
diagnosis looks for it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import HeightMapError
from anisoscope.base.plugins import Registry
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap

__all__ = [
    "DEFECTS", "CauseWords", "Defect", "HeightMap", "Setting", "Values", "inject_defect", "values_of",
]  # fmt: skip

Values = Mapping[str, float]
Groove = Any
"""What the prediction knows of the groove between two ridges: `anisoscope.prediction.reflections.Groove`."""
_STEPS = (0.05, 0.12, 0.25, 0.5, 1.0)
_FINE_STEPS = (0.02, 0.05, 0.08, 0.12, 0.16, 0.2, 0.25, 0.32, 0.4, 0.5, 0.65, 0.8, 1.0)
COMPUTED_RIDGES = 24
"""Ridges of the surface on which the diagnosis computes local defects."""
_STEEPEST_FALL = 0.8
"""Share of the ridge angle by which facets are at most made flatter: none is turned beyond flat."""


@dataclass(frozen=True)
class Setting:
    """One dimension of a defect: its name with the unit, its meaning, and its default."""

    name: str
    unit: str
    meaning: str
    default: float


@dataclass(frozen=True)
class Defect:
    """A defect. What has a default here need not be given.

    Attributes:
        name: what it is called, as its entry point.
        cause: what goes wrong in moulding, tooling or handling.
        extent: the dimension that the severity scales; its default is the value at severity 1, and the largest that
            the diagnosis considers.
        settings: its other dimensions.
        apply: makes the spoiled map from a map, all values by name, and a source of randomness.
        title: what it is, and of what its extent is, for people; "" from name and extent.
        plain: what was found in plain words, and what to do next; None: made of the name.
        doubt: relative standard uncertainty of the change of ln L that is computed for it: real ones vary in size and
            form.
        local: on places of the surface, visible in the contrast map; else all over it.
        extruded: the same all along a ridge.
        signed: of either sign.
        turns_facets: its extent is added to the ridge angle: it is that input of the prediction.
        scales_pitch: its extent is the change of the pitch in per cent, which is measured besides.
        guessed: share of the area, per unit of extent (of a length: per pitch), whose texture is a guess.
        computed: extents that the diagnosis computes, where these are not shares of the largest.
        groove: the groove with it, of groove, extent and pitch in µm; None: light between the ridges stays as it is.
        design: ridges with it, of design and extent, where ideal ones have it exactly.
        place: in lists; the same place is sorted by name.
    """

    name: str
    cause: str
    extent: Setting
    settings: tuple[Setting, ...]
    apply: Callable[[HeightMap, Values, np.random.Generator], HeightMap]
    title: str = ""
    plain: CauseWords | None = None
    doubt: float = 0.3
    local: bool = False
    extruded: bool = False
    signed: bool = False
    turns_facets: bool = False
    scales_pitch: bool = False
    guessed: float = 0.0
    computed: tuple[float, ...] = ()
    groove: Callable[[Groove, float, float], Groove] | None = None
    design: Callable[[RidgeDesign, float], RidgeDesign] | None = None
    place: int = 100

    @property
    def called(self) -> str:
        """Its title."""
        return self.title or f"{self.name.replace('-', ' ')}, {self.extent.meaning}"

    @property
    def words(self) -> CauseWords:
        """It in plain words."""
        if self.plain is not None:
            return self.plain
        spoken = self.name.replace("-", " ").capitalize()
        return CauseWords(f"{spoken}: {self.extent.meaning} of about {{size}}", "Reject the part")

    def guessed_share(self, pitch_um: float) -> float:
        """Share of the area, per unit of extent, whose texture is a guess."""
        return self.guessed / pitch_um if self.extent.unit == "µm" else self.guessed

    def extents(self, ridge_angle_deg: float | None) -> tuple[float, ...]:
        """Extents that the diagnosis computes, ascending, with 0.

        Args:
            ridge_angle_deg: of the design, or None.
        """
        if self.computed:
            return (0.0, *self.computed)
        most = self.extent.default
        sizes = [share * most for share in (_FINE_STEPS if self.extruded else _STEPS)]
        if not self.signed:
            return (0.0, *sizes)
        least = -_STEEPEST_FALL * (ridge_angle_deg or np.inf) if self.turns_facets else -np.inf
        every = sorted({0.0, *sizes, *(-size for size in sizes)})
        return tuple(size for size in every if size > least)


DEFECTS = Registry("anisoscope.defects", "defect", Defect, HeightMapError)
"""All defects by name."""


def values_of(defect: Defect, severity: float | None, given: Values) -> dict[str, float]:
    """All values of a defect: those given, the extent by severity, defaults for the rest.

    Raises:
        HeightMapError: an unknown or infinite value, a severity outside 0–1, both or neither of severity and extent.
    """
    known = [defect.extent.name, *(setting.name for setting in defect.settings)]
    for name, value in given.items():
        if name not in known:
            raise HeightMapError(f"{defect.name} has no parameter {name!r}; it has {', '.join(known)}")
        if not np.isfinite(value):
            raise HeightMapError(f"{name} of {defect.name} must be a finite number, not {value}")
    if (severity is None) == (defect.extent.name not in given):
        raise HeightMapError(
            f"{defect.name} takes either a severity of 0 to 1 or {defect.extent.name} ({defect.extent.meaning})"
        )
    values = {setting.name: setting.default for setting in defect.settings}
    if severity is not None:
        if not 0.0 <= severity <= 1.0:
            raise HeightMapError(f"a severity lies between 0 (none) and 1 (gross), not {severity}")
        values[defect.extent.name] = severity * defect.extent.default
    return {**values, **given}


def inject_defect(
    surface: HeightMap,
    name: str,
    rng: np.random.Generator,
    *,
    severity: float | None = None,
    values: Values | None = None,
    **note: object,
) -> HeightMap:
    """Add a defect to a map.

    Args:
        surface: the map; missing points stay missing.
        name: one of `DEFECTS`.
        rng: source of randomness.
        severity: 0 (none) to 1 (gross); scales the extent of the defect. Leave it out where the extent is
            in ``values``.
        values: dimensions of the defect by name, with the unit in the name; defaults for those not given.
        note: further entries of the provenance, such as the seed.

    Returns:
        The spoiled map; ``origin["defects"]`` lists all defects added so far with their values.

    Raises:
        HeightMapError: unknown defect or parameter, a value outside its range, or a map that cannot have this defect.
    """
    defect = DEFECTS.get(name)
    if defect is None:
        raise HeightMapError(f"unknown defect {name!r}; there are {', '.join(DEFECTS)}")
    found = values_of(defect, severity, values or {})
    result = surface if found[defect.extent.name] == 0.0 else defect.apply(surface, found, rng)
    entry = {"defect": name, "severity": severity, "parameters": found, **note}
    return surface.with_height(result.height_um, defects=[*surface.origin.get("defects", []), entry])
