"""Uncertainty of a prediction by its inputs: of designs and maps that options state, and of those of a recipe, alike.

Inputs that all poses share count to second order; the tail of the lobe counts along its curve (`lobe_doubt`).
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.material import Material
from anisoscope.prediction.lobe_doubt import LobeDoubt, lobe_doubt
from anisoscope.prediction.propagation import (
    PLASTIC_AND_SEAT,
    RIDGE_ANGLE,
    TAIL,
    UNMEASURED_TAIL,
    calibrated_material,
    propagate,
)
from anisoscope.prediction.second_order import Response, known_inputs, response_of
from anisoscope.prediction.sensitivity import DARK, SECOND_ORDER, Budget, State, Surface, evaluate
from anisoscope.sim.light.material import interface_bound

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile

SCATTER = "scatter of parts: "
"""Begin of the name of an input in the budget whose uncertainty is the scatter between good parts alone."""
SCATTERED = (*PLASTIC_AND_SEAT[:3], RIDGE_ANGLE)
FAMILY = "family of the lobe"
FAMILY_SHARE = 0.015
"""What the best tail leaves of ln L of lobes of two scales: rms in a pose, independent of other poses."""
INTERFACE = "light between base and interface"
NEGLIGIBLE_INTERFACE = 2e-3  # of the albedo
NEGLIGIBLE = 5e-4  # of ln L: a quarter of what cameras and lamps leave in a pose at best


@dataclass(frozen=True, eq=False)
class Doubt:
    """One source of uncertainty.

    Attributes:
        source: its name in words.
        relative: (P,) standard uncertainty of ln L; signed where it is shared.
        shared: fully correlated between poses; otherwise independent.
    """

    source: str
    relative: FloatArray
    shared: bool = True


@dataclass(frozen=True, eq=False)
class InputDoubt:
    """What uncertain inputs do to P poses.

    Attributes:
        budget: first order of all inputs but the tail.
        straight: by source, (P,) change of ln L per u of the inputs that `response` knows.
        response: second-order response of ln L to them, or None where unknown.
        lobes: ln L over the tail of the lobe where that is uncertain, or None.
        unmeasured: the lobe was not measured.
    """

    budget: Budget
    straight: dict[str, FloatArray]
    response: Response | None
    lobes: LobeDoubt | None
    unmeasured: bool

    def of_the_tail(self) -> list[Doubt]:
        """From the tail of the lobe, and of an unmeasured one from what no tail describes."""
        if self.lobes is None:
            return []
        u = UNMEASURED_TAIL if np.isinf(self.lobes.u) else self.lobes.u
        found = [Doubt(TAIL, self.lobes.contribution(u))]
        if self.unmeasured:
            found.append(Doubt(FAMILY, np.full(self.budget.radiance.size, FAMILY_SHARE), shared=False))
        return found


def input_doubt(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    inputs: InputUncertainty,
    radiance: FloatArray,
    *,
    rays: Surface | None = None,
    file: "MaterialFile | None" = None,
    on_progress: Advance = silent,
) -> InputDoubt:
    """Probe the inputs of a prediction.

    Args:
        surface: predictor of a shape, for the sensitivities.
        nominal: the state in which the prediction is made.
        poses: P poses.
        convention: how the angles are counted.
        inputs: standard uncertainties of the inputs.
        radiance: (P,) nominal radiances in 1/sr.
        rays: predictor by rays, for lobes that ``surface`` does not know; None where it knows them.
        file: the calibrated material, whose tail is correlated with its other parameters.
        on_progress: called at every call of the predictor for the first order.

    Raises:
        ModelError: a pose so close to the horizon that a probe leads below it.
    """
    others = replace(inputs, tail=0.0)  # along its curve
    budget = propagate(
        surface, nominal, poses, convention, others, radiance=radiance, on_progress=on_progress
    )
    per_u = {c.source: budget.relative(c.absolute) for c in budget.contributions if np.any(c.absolute)}
    straight = {source: per_u[source] for source in known_inputs(tuple(per_u))}
    response = response_of(surface, nominal, poses, convention, others, straight) if straight else None
    u, along = inputs.tail, None
    if file is not None and u == 0.0:
        u = file.covariance.u().get("tail", 0.0)
        along = partial(_calibrated_at, file, nominal.material)
    lobes = None
    if u != 0.0:
        known, common = (surface, None) if rays is None else (rays, response)
        lobes = lobe_doubt(known, nominal, poses, convention, others, straight, u, common, along)
    return InputDoubt(budget, straight, response, lobes, inputs.tail is None)


def _calibrated_at(file: "MaterialFile", material: Material, tail: float) -> Material:
    """A calibrated material whose other parameters follow their regression on another tail."""
    from anisoscope.recipe.material_file import material_at  # noqa: PLC0415 - pydantic, for a material file only

    slope, _ = file.covariance.given_tail()
    values = file.values() + slope * (tail - material.tail)
    return material_at(material, file.covariance.parameters, values)


def of_the_calibration(
    surface: Surface,
    nominal: State,
    poses: tuple[Pose, ...],
    convention: Convention,
    file: "MaterialFile | None",
) -> list[Doubt]:
    """Of a calibrated material at its tail: directions of the covariance; what its family leaves."""
    if file is None:
        return of_the_interface(surface, nominal, poses, convention)
    changes = calibrated_material(surface, nominal, poses, convention, file)
    found = [
        Doubt(f"calibrated material, direction {number + 1}", change)
        for number, change in enumerate(sorted(changes, key=lambda change: -float(np.ptp(change))))
        if np.any(change)
    ]
    if file.test is not None:
        found.append(Doubt(FAMILY, np.full(len(poses), file.test.discrepancy_share), shared=False))
    return found


def of_the_interface(
    surface: Surface, nominal: State, poses: tuple[Pose, ...], convention: Convention
) -> list[Doubt]:
    """Of light between the base of an uncalibrated plastic and its interface: within 0 and `interface_bound`, evenly.

    A calibrated albedo has it.
    """
    material = nominal.material
    u = interface_bound(material) / np.sqrt(3.0)
    if u < NEGLIGIBLE_INTERFACE:
        return []
    brighter = replace(nominal, material=replace(material, albedo=min(material.albedo * (1.0 + u), 1.0)))
    light = evaluate(surface, [nominal, brighter], poses, convention)
    return [Doubt(INTERFACE, np.diff(np.log(np.maximum(light, DARK)), axis=0)[0])]


def of_second_order(response: Response | None) -> list[Doubt]:
    """Of the inputs: ½ h (z² − 1) of each and h z z' of every two, shared by all poses.

    None of them correlates with another or with a slope, because odd moments of normal inputs vanish.
    """
    if response is None:
        return []
    found = []
    for a, source in enumerate(response.sources):
        found.append((source, response.bend[:, a, a] / np.sqrt(2.0)))
        found += [(f"{response.sources[b]} with {source}", response.bend[:, a, b]) for b in range(a)]
    return [
        Doubt(f"{source}{SECOND_ORDER}", bend) for source, bend in found if np.abs(bend).max() > NEGLIGIBLE
    ]
