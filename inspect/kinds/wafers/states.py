"""Radiances of a wafer in every state of its uncertain inputs (etching, lamp, seat), by the model itself.

A seat that is two standard uncertainties off lets a bright order into the lens: no expansion to second order knows it.
Directions cost little once the orders of the tile are known, so that the nearest state of the inputs is sought among
the radiances themselves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.wafers.etched import EtchedPredictor, NearWidths
from anisoscope.kinds.wafers.lighting import light_steps, recipe_wafer
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.parameters.geometry import Convention, Pose
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
        return tuple(self._u)

    @property
    def farthest(self) -> FloatArray:
        """(K,) standard uncertainties to which the inputs are known: etching far beyond what turns or colours light."""
        return np.array([_ETCHED if source in (DEPTH, WIDTH) else FARTHEST for source in self.sources])

    def holds(self, source: str) -> bool:
        """Is what the budget calls so part of these states?"""
        return source.removesuffix(BEYOND) in self._u

    def change(self, z: FloatArray) -> FloatArray:
        """(…, P) change at inputs (…, K), in units of their standard uncertainties.

        Raises:
            HeightMapError: the recipe's height map cannot be read, or is no surface of level steps.
            ModelError: a state in which light or camera stand below the horizon.
        """
        flat = np.reshape(z, (-1, len(self._u)))
        ln = np.array([self._ln_radiance(one) for one in flat]) - self._nominal
        return np.asarray(ln.reshape(*np.shape(z)[:-1], -1))

    def tangent(self, z: FloatArray) -> FloatArray:
        """(…, P, K) derivative at inputs (…, K), by differences; errors as of `change`."""
        near = np.asarray(z)[..., None, :] + _STEP * np.eye(len(self._u))
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
        return self._ln_radiance(np.zeros(len(self._u)))

    def _ln_radiance(self, z: FloatArray) -> FloatArray:
        recipe, light = self.recipe, self._wafer.light
        off = {source: share * u for (source, u), share in zip(self._u.items(), z.tolist(), strict=True)}

        def moved(source: str) -> float:
            return float(off.get(source, 0.0).real)

        wafer = self._wafer
        if not off.keys().isdisjoint((WIDTH, *EDGES)):
            wafer = self._at_width(moved(WIDTH), sum(off.get(name, 0.0) for name in EDGES))
        if DEPTH in off:
            wafer = wafer.with_depths(moved(DEPTH))
        lamp = {
            field: max(getattr(light, field) + moved(name), _LEAST * getattr(light, field))
            for name, field in self._of_lamp
        }
        material = recipe.material.material()
        state = State(
            replace(material, albedo=min(max(material.albedo + moved(SCATTER), 0.0), 1.0)),
            self.light_angle_deg + moved("light angle"),
            seating_deg=(moved("seating tilt about x"), moved("seating tilt about y")),
            tilt_deg=moved("zero of the tilt"),
        )
        convention = Convention(self.light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
        changed = wafer.under(replace(light, **lamp)) if lamp else wafer
        return np.asarray(np.log(evaluate(fixed(changed), [state], self._poses, convention)[0]))

    @cached_property
    def _poses(self) -> tuple[Pose, ...]:
        return self.recipe.poses.poses()

    @cached_property
    def _of_lamp(self) -> tuple[tuple[str, str], ...]:
        assert self.recipe.light is not None
        return tuple((name, field) for name, field, _ in light_steps(self.recipe.light))

    @cached_property
    def _u(self) -> dict[str, complex]:
        """By source, its standard uncertainty in the unit of the recipe; those that are certain are left out.

        Of the waves of edges it is complex.
        """
        stated = self.recipe.uncertainty
        edges = edges_u_nm(self.recipe, self._wafer, self.light_angle_deg)
        assert self.recipe.light is not None
        found: dict[str, complex] = {
            WIDTH: stated.etch_width_nm,
            **{name: edges * phase for name, phase in zip(EDGES, (1.0, 1.0j), strict=True)},
            DEPTH: stated.etch_depth_nm,
            SCATTER: self.recipe.material.u_albedo,
            "light angle": stated.light_angle_deg,
            "seating tilt about x": stated.seating_tilt_deg,
            "seating tilt about y": stated.seating_tilt_deg,
            "zero of the tilt": stated.tilt_deg,
            **{name: u for name, _, u in light_steps(self.recipe.light)},
        }
        return {source: u for source, u in found.items() if u != 0.0 and source != self.pinned}
