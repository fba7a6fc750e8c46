"""What may be wrong: every defect of a surface, the finish and colour of the plastic, and how part and lamp stand."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from anisoscope.prediction.sensitivity import State
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.spoiling import DEFECTS, spoil

Group = Literal["shape", "area", "finish", "rig"]
Change = Callable[[HeightMap, State, float], tuple[HeightMap, State]]

# Defects that sit here and there, so that the contrast map shows them; the others change the whole surface alike.
LOCAL = ("burrs", "scratches", "dust", "missing-ridges")
SIGNED = ("ridge-angle", "pitch")
_STEPS = (0.05, 0.12, 0.25, 0.5, 1.0)
_SEED = 7  # the same places at every extent, so that a signature grows smoothly


@dataclass(frozen=True)
class Cause:
    """One thing that may be wrong, and how far.

    Attributes:
        name: short name, as in the record.
        title: what it is, for people.
        unit: of its extent; "" for a share.
        group: "shape" and "area": the surface, everywhere alike or here and there; "finish": the plastic; "rig":
            not the part at all.
        explains: what makes it happen.
        extents: extents to look at, ascending, 0 among them.
        change: the surface and the state of material and rig at an extent.
    """

    name: str
    title: str
    unit: str
    group: Group
    explains: str
    extents: tuple[float, ...]
    change: Change


def all_causes(ridge_angle_deg: float | None = None) -> tuple[Cause, ...]:
    """Every cause that is looked for.

    Args:
        ridge_angle_deg: nominal ridge angle, so that no facet is turned beyond flat; None if unknown.
    """
    return (*_defects(ridge_angle_deg), *_finish(), *_rig())


def _both_ways(extent: float, low: float = -np.inf) -> tuple[float, ...]:
    values = sorted({0.0, *(s * extent for s in _STEPS), *(-s * extent for s in _STEPS)})
    return tuple(value for value in values if value > low)


def _defects(ridge_angle_deg: float | None) -> list[Cause]:
    titles = {
        "burrs": "burrs, share of the area",
        "wear": "worn edges, radius",
        "incomplete-filling": "incomplete filling, share of the ridge height that is missing",
        "ridge-angle": "ridge angle, off by",
        "pitch": "pitch, off by",
        "rough-facets": "rough facets, added roughness across the ridges",
        "scratches": "scratches, number per area",
        "dust": "dust, number of grains per area",
        "missing-ridges": "missing ridges, share",
        "chatter": "chatter marks, amplitude",
    }
    found = []
    for name, defect in DEFECTS.items():
        most = defect.extent.default
        if name in SIGNED:
            extents = _both_ways(
                most, low=-0.8 * (ridge_angle_deg or np.inf) if name == "ridge-angle" else -np.inf
            )
        else:
            extents = (0.0, *(s * most for s in _STEPS))
        group: Group = "area" if name in LOCAL else "shape"
        unit = defect.extent.unit
        found.append(Cause(name, titles[name], unit, group, defect.cause, extents, _spoiled(name)))
    return found


def _spoiled(name: str) -> Change:
    def change(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        if extent == 0.0:
            return surface, state
        values = {DEFECTS[name].extent.name: extent}
        return spoil(surface, name, np.random.default_rng(_SEED), values=values), state

    return change


def _finish() -> list[Cause]:
    def along(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        alpha = float(np.clip(state.material.alpha_along * (1.0 + extent), 0.001, 1.0))
        return surface, replace(state, material=replace(state.material, alpha_along=alpha))

    def across(surface: HeightMap, state: State, extent: float) -> tuple[HeightMap, State]:
        alpha = float(np.clip(state.material.alpha_across * (1.0 + extent), 0.001, 1.0))
        return surface, replace(state, material=replace(state.material, alpha_across=alpha))

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
            _both_ways(0.8),
            along,
        ),
        Cause(
            "roughness-across",
            "roughness across the ridges, relative change",
            "",
            "finish",
            "tooling: marks of the cutter; moulding: other surface of the melt",
            _both_ways(0.8),
            across,
        ),
        Cause(
            "colour",
            "albedo of the plastic, relative change",
            "",
            "finish",
            "material: another batch or pigment, degraded melt; handling: stain or film",
            _both_ways(0.8),
            colour,
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
        )
    ]
