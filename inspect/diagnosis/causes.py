"""Causes of deviations: surface defects, finish and colour of the plastic, position of part and lamp."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from anisoscope.prediction.propagation import RIDGE_ANGLE
from anisoscope.prediction.sensitivity import State
from anisoscope.profiles.defect_injection import DEFECTS, Defect, inject_defect
from anisoscope.profiles.heightmap import HeightMap

Group = Literal["shape", "area", "finish", "rig"]
Change = Callable[[HeightMap, State, float], tuple[HeightMap, State]]

ROUGHNESS_ALONG, ROUGHNESS_ACROSS = "roughness along the ridges", "roughness across the ridges"
_STEPS = (0.05, 0.12, 0.25, 0.5, 1.0)
_LOBE_STEPS = (0.05, 0.12, 0.25, 0.375, 0.5, 0.75, 1.0)
_DOUBT_OF_LOBES = 0.05
_DOUBT_OF_TAIL = 0.1
TAIL = "tail"
TAILS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.4)
"""Tails of the lobes of real plastics, from Beckmann's to somewhat beyond GGX."""
_SEED = 7  # the same places at every extent, so that a signature varies smoothly


@dataclass(frozen=True)
class Cause:
    """A cause of deviations with its range of extents.

    Attributes:
        name: short name, as in the record.
        title: what it is, for people.
        unit: of its extent; "" for a share.
        group: "shape" and "area": the surface, uniformly or locally; "finish": the plastic; "rig":
            not the part.
        explains: its usual origin.
        extents: extents to compute, ascending, including 0.
        change: the surface and the state of material and rig at an extent.
        doubt: relative standard uncertainty of the change of ln L that is computed for it.
        sources: names of the sources of uncertainty of the prediction that it is itself.
        guessed: share of the area, per unit of extent, whose texture is a guess, and with it the share of cells that
            deviate there; 0 where the share is predicted.
        defect: the defect that it is, or None.
    """

    name: str
    title: str
    unit: str
    group: Group
    explains: str
    extents: tuple[float, ...]
    change: Change
    doubt: float = 0.0
    sources: tuple[str, ...] = ()
    guessed: float = 0.0
    defect: Defect | None = None

    @property
    def extruded(self) -> bool:
        """Whether it is a defect that is the same all along a ridge."""
        return self.defect is not None and self.defect.extruded

    @property
    def scales_pitch(self) -> bool:
        """Whether it is a defect whose extent is the change of the pitch."""
        return self.defect is not None and self.defect.scales_pitch


def all_causes(ridge_angle_deg: float | None = None, pitch_um: float = 100.0) -> tuple[Cause, ...]:
    """All causes considered.

    Args:
        ridge_angle_deg: nominal ridge angle, so that no facet is turned beyond flat; None if unknown.
        pitch_um: of the ridges.
    """
    defects = (_of_defect(one, ridge_angle_deg, pitch_um) for one in DEFECTS.values())
    return (*defects, *_finish(), *_rig())


def tail_cause(tail: float = 0.0) -> Cause:
    """Lobe with another tail than the recipe's: no separate cause, but a sign of another plastic.

    Args:
        tail: of the recipe's lobe.
    """

    def tailed(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        return surface, replace(state, material=replace(state.material, tail=max(tail + extent, 0.0)))

    extents = tuple(sorted({0.0, *(round(one - tail, 6) for one in TAILS)}))
    explains = "material: another plastic or finish than that of the recipe"
    return Cause(
        "tail", "tail of the lobe, longer by", "", "finish", explains, extents, tailed, _DOUBT_OF_TAIL
    )


def _both_ways(extent: float, low: float = -np.inf, steps: tuple[float, ...] = _STEPS) -> tuple[float, ...]:
    values = sorted({0.0, *(s * extent for s in steps), *(-s * extent for s in steps)})
    return tuple(value for value in values if value > low)


def _of_defect(defect: Defect, ridge_angle_deg: float | None, pitch_um: float) -> Cause:
    def change(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        if extent == 0.0:
            return surface, state
        values = {defect.extent.name: extent}
        return inject_defect(surface, defect.name, np.random.default_rng(_SEED), values=values), state

    return Cause(
        defect.name,
        defect.called,
        defect.extent.unit,
        "area" if defect.local else "shape",
        defect.cause,
        defect.extents(ridge_angle_deg),
        change,
        defect.doubt,
        (RIDGE_ANGLE,) if defect.turns_facets else (),
        defect.guessed_share(pitch_um),
        defect,
    )


def _finish() -> list[Cause]:
    def along(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        alpha = float(np.clip(state.material.alpha_along * (1.0 + extent), 0.001, 1.0))
        return surface, replace(state, material=replace(state.material, alpha_along=alpha))

    def across(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        alpha = float(np.clip(state.material.alpha_across * (1.0 + extent), 0.001, 1.0))
        return surface, replace(state, material=replace(state.material, alpha_across=alpha))

    def both(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        return across(*along(surface, state, extent), extent)

    def colour(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        albedo = float(np.clip(state.material.albedo * (1.0 + extent), 0.0, 1.0))
        return surface, replace(state, material=replace(state.material, albedo=albedo))

    return [
        Cause(
            "roughness-along",
            "roughness along the ridges, relative change",
            "",
            "finish",
            "tooling: polish of the tool worn or renewed; moulding: other surface of the melt",
            _both_ways(0.8, steps=_LOBE_STEPS),
            along,
            _DOUBT_OF_LOBES,
            (ROUGHNESS_ALONG,),
        ),
        Cause(
            "roughness-across",
            "roughness across the ridges, relative change",
            "",
            "finish",
            "tooling: marks of the cutter; moulding: other surface of the melt",
            _both_ways(0.8, steps=_LOBE_STEPS),
            across,
            _DOUBT_OF_LOBES,
            (ROUGHNESS_ACROSS,),
        ),
        Cause(
            "roughness",
            "roughness in both directions, relative change",
            "",
            "finish",
            "moulding: other surface of the melt, cold tool; tooling: blasted or corroded tool",
            _both_ways(0.8, steps=_LOBE_STEPS),
            both,
            _DOUBT_OF_LOBES,  # and the two of them differ as their own uncertainties say
        ),
        Cause(
            "colour",
            "albedo of the plastic, relative change",
            "",
            "finish",
            "material: another batch or pigment, degraded melt; handling: stain or film",
            _both_ways(0.8),
            colour,
            _DOUBT_OF_LOBES,
            ("albedo of the plastic",),
        ),
    ]


def _rig() -> list[Cause]:
    def tilted(axis: int) -> Change:
        def change(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
            seat = list(state.seating_deg)
            seat[axis] += extent
            return surface, replace(state, seating_deg=(seat[0], seat[1]))

        return change

    def lamp(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        return surface, replace(state, light_angle_deg=state.light_angle_deg + extent)

    return [
        Cause(
            f"seating-{name}",
            f"the part lies tilted about {name}",
            "°",
            "rig",
            "handling: dirt under the part, part not pressed home",
            _both_ways(3.0),
            tilted(axis),
            sources=(f"seating tilt about {name}",),
        )
        for axis, name in enumerate("xy")
    ] + [
        Cause(
            "light-angle",
            "the lamp stands at another angle, off by",
            "°",
            "rig",
            "rig: lamp or camera was moved since it was commissioned",
            _both_ways(3.0, low=-9.0),
            lamp,
            sources=("light angle",),
        )
    ]
