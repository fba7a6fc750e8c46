"""Every uncertain input of a wafer's recipe, one standard uncertainty to either side: wafer, scatter, lamp and seat."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.models import moved_light
from anisoscope.prediction.etched import EtchedPredictor
from anisoscope.prediction.sensitivity import State
from anisoscope.recipe import Recipe

Made = tuple[EtchedPredictor, State]
SQUARE = float(np.sqrt(2.0))
"""Standard deviation of the square of a normal z."""
SQUARE_OF_ETCHING = float(np.sqrt(3.0))
"""Its root mean square, which counts where a slope may vanish, as in the budget."""


@dataclass(frozen=True, eq=False)
class Moved:
    """One uncertain input.

    Attributes:
        source: its name.
        low: the wafer and its state one standard uncertainty below.
        high: above.
        square: what counts of the square of the input.
        of_lamp: every lamp has an error of its own.
    """

    source: str
    low: Made
    high: Made
    square: float = SQUARE
    of_lamp: bool = False


def moved_inputs(recipe: Recipe, wafer: EtchedPredictor, state: State) -> tuple[Moved, ...]:
    """All inputs that the recipe states as uncertain.

    Args:
        recipe: of a wafer.
        wafer: its predictor.
        state: its nominal state.
    """
    assert recipe.light is not None
    told, part = recipe.uncertainty, recipe.material
    moves: list[tuple[str, float, Callable[[float], Made], float]] = [
        (
            "depth of the etch passes",
            told.etch_depth_nm,
            lambda u: (wafer.with_depths(u), state),
            SQUARE_OF_ETCHING,
        ),
        (
            "width of the etched features",
            told.etch_width_nm,
            lambda u: (wafer.with_widths(u), state),
            SQUARE_OF_ETCHING,
        ),
        ("share of scattered light", part.u_albedo, lambda u: (wafer, _scattering(state, u)), SQUARE),
        (
            "seating tilt about x",
            told.seating_tilt_deg,
            lambda u: (wafer, replace(state, seating_deg=(u, 0.0))),
            SQUARE,
        ),
        (
            "seating tilt about y",
            told.seating_tilt_deg,
            lambda u: (wafer, replace(state, seating_deg=(0.0, u))),
            SQUARE,
        ),
        ("zero of the tilt", told.tilt_deg, lambda u: (wafer, replace(state, tilt_deg=u)), SQUARE),
        ("light angle", told.light_angle_deg, lambda u: (wafer, _lit(state, u)), SQUARE),
    ]
    found = [Moved(name, make(-u), make(u), square) for name, u, make, square in moves if u > 0.0]
    for name, low, high in moved_light(recipe.light, wafer.light):
        of_lamp = name != "aperture of the lens"
        found.append(Moved(name, (wafer.under(low), state), (wafer.under(high), state), of_lamp=of_lamp))
    return tuple(found)


def _scattering(state: State, more: float) -> State:
    albedo = min(max(state.material.albedo + more, 0.0), 1.0)
    return replace(state, material=replace(state.material, albedo=albedo))


def _lit(state: State, more: float) -> State:
    return replace(state, light_angle_deg=state.light_angle_deg + more)
