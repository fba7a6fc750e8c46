"""Causes of a deviating etched wafer and their signatures, computed by wave optics on the recipe's tile.

Etching too deep leaves a mean phase, and so a spike in the mirror direction; features too wide do so too, because the
levels then have unequal areas, and move the lobes besides. Causes that plastics have (burrs, wear, …) are not looked
for, as these are not looked for on plastics.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from anisoscope.base.errors import AnisoscopeError, ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.causes import Cause, all_causes
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.kinds.wafers.etched import EtchedPredictor
from anisoscope.kinds.wafers.lighting import recipe_wafer
from anisoscope.kinds.wafers.recipe import of_wafer
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import Convention

Changed = Callable[[EtchedPredictor, State, float], tuple[EtchedPredictor, State]]

DEPTHS_NM = (2.0, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0)
WIDTHS_NM = (50.0, 100.0, 150.0, 200.0, 275.0, 350.0, 500.0)
SCATTERED = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
ANGLES_DEG = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
_DOUBT_OF_DEPTH, _DOUBT_OF_WIDTH = 0.05, 0.1
"""Passes are not all off by the same, nor all edges; of one pass and straight edges these are generous."""


def wafer_causes() -> tuple[Cause, ...]:
    """Every cause that is looked for on a wafer.

    Too deep and too shallow look alike where the design has no spike, and nearly so do too wide and too narrow: each is
    a cause of its own, so that a tie says so instead of an interval over both.
    """
    rig = [cause for cause in all_causes() if cause.group == "rig"]
    both = tuple(sorted((0.0, *ANGLES_DEG, *(-angle for angle in ANGLES_DEG))))
    deep, wide = "etching: time, gas or temperature of the passes", "etching or exposure: edges move sideways"
    return (
        _of("over-etch", "etched too deep, by", "nm", deep, DEPTHS_NM, _DOUBT_OF_DEPTH),
        _of("under-etch", "etched too shallow, by", "nm", deep, DEPTHS_NM, _DOUBT_OF_DEPTH),
        _of("width-bias", "etched features too wide, by", "nm", wide, WIDTHS_NM, _DOUBT_OF_WIDTH),
        _of("width-loss", "etched features too narrow, by", "nm", wide, WIDTHS_NM, _DOUBT_OF_WIDTH),
        replace(
            _of(
                "scatter",
                "scattered light, share added",
                "",
                "handling: dirt, film, scratches",
                SCATTERED,
                0.1,
            ),
            group="finish",
        ),
        *(replace(cause, extents=both) for cause in rig),
    )


def _of(name: str, title: str, unit: str, explains: str, extents: tuple[float, ...], doubt: float) -> Cause:
    return Cause(name, title, unit, "shape", explains, (0.0, *extents), _not_on_maps, doubt)


def _not_on_maps(_surface: HeightMap, _state: State, extent: float) -> tuple[HeightMap, State]:
    raise ModelError(f"a change of {extent:g} on a wafer is made of its tile, not of a height map")


def _deeper(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    return wafer.with_depths(extent), state


def _shallower(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    return wafer.with_depths(-extent), state


def _wider(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    return wafer.with_widths(extent), state


def _narrower(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    return wafer.with_widths(-extent), state


def _scattering(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    albedo = min(1.0, state.material.albedo + extent)
    return wafer, replace(state, material=replace(state.material, albedo=albedo))


def spoiled(
    cause: Cause, wafer: EtchedPredictor, state: State, extent: float, surface: HeightMap
) -> tuple[EtchedPredictor, State]:
    """A wafer with a cause of this extent, and the state of scatter, lamp and seat; ``surface`` is its height map."""
    if cause.name in _CHANGES:
        return _CHANGES[cause.name](wafer, state, extent)
    return wafer, cause.change(surface, state, extent)[1]


_CHANGES: dict[str, Changed] = {
    "over-etch": _deeper,
    "under-etch": _shallower,
    "width-bias": _wider,
    "width-loss": _narrower,
    "scatter": _scattering,
}


def wafer_signatures(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    advance: Advance = silent,
    names: Sequence[str] | None = None,
) -> Signatures:
    """Compute what every cause would change; arguments as for `diagnosis.signatures.signatures`.

    Raises:
        HeightMapError, RecipeError: the recipe's tile cannot be read or used.
    """
    wafer, surface = recipe_wafer(of_wafer(recipe), light_angle_deg)
    poses = recipe.poses.poses()
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    state = State(recipe.material.material(), light_angle_deg)
    good = evaluate(fixed(wafer), [state], poses, convention)[0]
    causes = [cause for cause in wafer_causes() if names is None or cause.name in names]
    found, left_out = [], []
    for number, cause in enumerate(causes):
        advance(f"signature of {cause.name}", number, len(causes))
        extents, changes = [], []
        try:
            for extent in cause.extents:
                changed, moved = spoiled(cause, wafer, state, extent, surface)
                changed_radiance = (
                    good if extent == 0.0 else evaluate(fixed(changed), [moved], poses, convention)[0]
                )
                extents.append(extent)
                changes.append(np.log(changed_radiance / good))
        except AnisoscopeError as problem:
            left_out.append((cause.name, str(problem)))
            continue
        found.append(Signature(cause, np.array(extents), np.array(changes), np.zeros(len(extents))))
    advance("signatures", len(causes), len(causes))
    return Signatures(poses, good, 0.0, tuple(found), tuple(left_out))
