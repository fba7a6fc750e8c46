"""Radiances of a wafer in every state of its uncertain inputs (etching, lamp, seat), by the model itself.

A seat that is two standard uncertainties off lets a bright order into the lens: no expansion to second order knows it.
Directions cost little once the orders of the tile are known, so that the nearest state of the inputs is sought among
the radiances themselves.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.wafers.etched import EtchedPredictor, NearWidths
from anisoscope.kinds.wafers.lighting import light_steps, recipe_wafer
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.profile_likelihood import FARTHEST
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.sim.light.wave.choice import edge_widening_um

DEPTH, WIDTH = "depth of the etch passes", "width of the etched features"
EDGES = ("edges of the steps, in phase", "edges of the steps, out of phase")
"""Real and imaginary part of the widening that stands for what scalar waves neglect at edges."""

SCATTER = "share of scattered light"
"""Counterpart of a plastic's albedo."""
STATE_OF: Mapping[str, tuple[str, float]] = {
    "etched too deep by ": (DEPTH, 1.0),
    "etched too shallow by ": (DEPTH, -1.0),
    "features too wide by ": (WIDTH, 1.0),
    "features too narrow by ": (WIDTH, -1.0),
}
"""State of each named defect, by its words, and its sign."""
BEYOND = ", beyond the slope"
_STEP = 0.002  # u, of a derivative
_WIDTHS = 2.0  # u, between the widths that are drawn
_ETCHED = 40.0
_LEAST_WIDTH_NM = 20.0
_LEAST = 0.5  # of its nominal value: no lamp or lens is less than that


def width_step_nm(recipe: WaferRecipe) -> float:
    """Between the widths at which a wafer is drawn, for others near them."""
    return _WIDTHS * (recipe.uncertainty.etch_width_nm or _LEAST_WIDTH_NM)


def edges_u_nm(recipe: WaferRecipe, wafer: EtchedPredictor, light_angle_deg: float) -> float:
    """Standard uncertainty, in nm, of either part of the widening by the waves of edges.

    Half the bound's modulus: that of a disc on which all values are equally likely. The recipe may state another one.
    """
    stated = recipe.uncertainty.step_edges_nm
    if stated is not None:
        return stated
    levels = np.ptp(wafer.tile.levels_um)
    tilt = max(abs(angle) for angle in recipe.poses.tilts_deg) + abs(light_angle_deg)
    slant = float(np.tan(np.radians(min(tilt, 80.0))))
    return 500.0 * edge_widening_um(float(levels), 1e-3 * wafer.light.wavelength_nm, slant)


@dataclass(frozen=True)
class _Inputs:
    """Inputs of one state, in the units of the recipe; `wider_nm` and `edges_nm` are those of its wafer."""

    state: State
    wafer: EtchedPredictor
    wider_nm: float = 0.0
    edges_nm: complex = 0.0


_Mover = Callable[[_Inputs, float], _Inputs]


@dataclass(frozen=True, eq=False)
class WaferStates:
    """Change of ln L of the poses with everything that is uncertain; `profile_likelihood.States`.

    Attributes:
        recipe: with the poses that decide.
        light_angle_deg: of the rig.
        designed: (P,) ln L of the wafer without a defect, where this one has one.
        pinned: what has a known value here, and is none of the inputs.
        made: the wafer with its defect.
        near: the same at other widths.
    """

    recipe: WaferRecipe
    light_angle_deg: float
    designed: FloatArray | None = None
    pinned: str = ""
    made: EtchedPredictor | None = None
    near: NearWidths | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """K names of the inputs, as the budget has them."""
        return tuple(self._movers)

    @property
    def farthest(self) -> FloatArray:
        """(K,) standard uncertainties to which the inputs are known: etching far beyond what turns or colours light."""
        return np.array([_ETCHED if source in (DEPTH, WIDTH) else FARTHEST for source in self.sources])

    def holds(self, source: str) -> bool:
        """Is what the budget calls so part of these states?"""
        return source.removesuffix(BEYOND) in self._movers

    def change(self, z: FloatArray) -> FloatArray:
        """(…, P) change at inputs (…, K), in units of their standard uncertainties.

        Raises:
            HeightMapError: the recipe's height map cannot be read, or is no surface of level steps.
            ModelError: a state in which light or camera stand below the horizon.
        """
        flat = np.reshape(z, (-1, len(self._movers)))
        ln = np.array([self._ln_radiance(one) for one in flat]) - self._nominal
        return np.asarray(ln.reshape(*np.shape(z)[:-1], -1))

    def tangent(self, z: FloatArray) -> FloatArray:
        """(…, P, K) derivative at inputs (…, K), by differences; errors as of `change`."""
        near = np.asarray(z)[..., None, :] + _STEP * np.eye(len(self._movers))
        return np.swapaxes((self.change(near) - self.change(z)[..., None, :]) / _STEP, -1, -2)

    @property
    def defects(self) -> tuple[NamedDefect, ...]:
        """Passes and widths off to either side, at the sizes of the recipe."""
        return self.recipe.defects.of_wafers

    def with_defect(self, defect: NamedDefect, extent: float) -> "WaferStates":
        """States of wafers whose depth or width is off by a multiple of its size, whatever the recipe expects of it."""
        source, sign = STATE_OF[defect.words]
        off_nm = sign * extent * defect.size
        if source == DEPTH:
            made, at_width = self._wafer.with_depths(off_nm), self._at_width

            def near(wider_nm: float, edges_nm: complex = 0.0) -> EtchedPredictor:
                return at_width(wider_nm, edges_nm).with_depths(off_nm)

            return replace(self, designed=self._nominal, pinned=DEPTH, made=made, near=near)
        made = self._wafer.with_widths(off_nm) if off_nm else self._wafer
        return replace(self, designed=self._nominal, pinned=WIDTH, made=made)

    @cached_property
    def _wafer(self) -> EtchedPredictor:
        return self.made or recipe_wafer(self.recipe, self.light_angle_deg)[0]

    @cached_property
    def _at_width(self) -> NearWidths:
        return self.near or self._wafer.near_widths(width_step_nm(self.recipe))

    @cached_property
    def _nominal(self) -> FloatArray:
        if self.designed is not None:
            return self.designed
        return self._ln_radiance(np.zeros(len(self._movers)))

    def _ln_radiance(self, z: FloatArray) -> FloatArray:
        recipe = self.recipe
        at = _Inputs(State(recipe.material.material(), self.light_angle_deg), self._wafer)
        for mover, share in zip(self._movers.values(), z, strict=True):
            at = mover(at, float(share))
        convention = Convention(self.light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
        return np.asarray(np.log(evaluate(fixed(at.wafer), [at.state], recipe.poses.poses(), convention)[0]))

    @cached_property
    def _movers(self) -> dict[str, _Mover]:
        """By source, what a number of standard uncertainties makes of the inputs; those that are certain are left out.

        Width and edges come first: they take the wafer that was drawn at another width.
        """
        stated, material = self.recipe.uncertainty, self.recipe.material
        found: dict[str, _Mover] = {}
        if stated.etch_width_nm > 0.0 and self.pinned != WIDTH:
            found[WIDTH] = self._widened
        if (u_nm := edges_u_nm(self.recipe, self._wafer, self.light_angle_deg)) > 0.0:
            found |= {name: self._edged(u_nm * phase) for name, phase in zip(EDGES, (1.0, 1.0j), strict=True)}
        if stated.etch_depth_nm > 0.0 and self.pinned != DEPTH:
            found[DEPTH] = self._deepened
        if material.u_albedo > 0.0:
            found[SCATTER] = self._scattering
        if stated.light_angle_deg > 0.0:
            found["light angle"] = self._lit
        if stated.seating_tilt_deg > 0.0:
            found["seating tilt about x"] = self._seated_x
            found["seating tilt about y"] = self._seated_y
        if stated.tilt_deg > 0.0:
            found["zero of the tilt"] = self._tilted
        assert self.recipe.light is not None
        for name, field, u in light_steps(self.recipe.light):
            found[name] = _lamp(field, u)
        return found

    def _widened(self, at: _Inputs, share: float) -> _Inputs:
        wider_nm = at.wider_nm + share * self.recipe.uncertainty.etch_width_nm
        return replace(at, wider_nm=wider_nm, wafer=self._at_width(wider_nm, at.edges_nm))

    def _edged(self, u_nm: complex) -> _Mover:
        def edged(at: _Inputs, share: float) -> _Inputs:
            edges_nm = at.edges_nm + share * u_nm
            return replace(at, edges_nm=edges_nm, wafer=self._at_width(at.wider_nm, edges_nm))

        return edged

    def _deepened(self, at: _Inputs, share: float) -> _Inputs:
        return replace(at, wafer=at.wafer.with_depths(share * self.recipe.uncertainty.etch_depth_nm))

    def _scattering(self, at: _Inputs, share: float) -> _Inputs:
        part, material = self.recipe.material, at.state.material
        albedo = min(max(part.albedo + share * part.u_albedo, 0.0), 1.0)
        return replace(at, state=replace(at.state, material=replace(material, albedo=albedo)))

    def _lit(self, at: _Inputs, share: float) -> _Inputs:
        off = share * self.recipe.uncertainty.light_angle_deg
        return replace(at, state=replace(at.state, light_angle_deg=self.light_angle_deg + off))

    def _seated_x(self, at: _Inputs, share: float) -> _Inputs:
        seat = share * self.recipe.uncertainty.seating_tilt_deg, at.state.seating_deg[1]
        return replace(at, state=replace(at.state, seating_deg=seat))

    def _seated_y(self, at: _Inputs, share: float) -> _Inputs:
        seat = at.state.seating_deg[0], share * self.recipe.uncertainty.seating_tilt_deg
        return replace(at, state=replace(at.state, seating_deg=seat))

    def _tilted(self, at: _Inputs, share: float) -> _Inputs:
        return replace(at, state=replace(at.state, tilt_deg=share * self.recipe.uncertainty.tilt_deg))


def _lamp(field: str, u: float) -> _Mover:
    """Moves lamp or lens."""

    def moved(at: _Inputs, share: float) -> _Inputs:
        value = getattr(at.wafer.light, field)
        return replace(
            at,
            wafer=at.wafer.under(replace(at.wafer.light, **{field: max(value + share * u, _LEAST * value)})),
        )

    return moved
