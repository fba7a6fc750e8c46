"""What would find a shape defect that the means find too rarely: other poses, or less uncertainty.

A class shifts ln L by δ, and D² of δ alone is how far it lies from all that good parts may be (its Fisher information,
along the curves that uncertain inputs make). D² of parts is a noncentral χ² with it, so that the area under its curve
follows without making a single part.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.separability import planned_covariance
from anisoscope.expectation import Expectation, expectation
from anisoscope.neareststate import nearest
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.recipe import Recipe
from anisoscope.response import Response
from anisoscope.significance import log_basis
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions
from anisoscope.study.detection_product import (
    BY_NAME,
    LIGHT_DEG,
    PITCH_UM,
    RIDGE_ANGLE_DEG,
    WHOLE,
    Size,
    recipe_of,
)

FloatArray = npt.NDArray[np.float64]

SHAPES = ("ridge-angle", "roughness")
WANTED = 0.99
BETTER = 3.0
POSES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "standard poses": ((0.0, 90.0, 180.0), (0.0,)),
    "tilted poses": ((0.0, 90.0, 180.0), (0.0, -10.0, 10.0)),
    "tilts to ±20°": ((0.0, 90.0, 180.0), (0.0, -20.0, -10.0, 10.0, 20.0)),
    "every 45° upright": (tuple(np.arange(0.0, 360.0, 45.0)), (0.0,)),
    "every 45°, tilts to ±10°": (tuple(np.arange(0.0, 360.0, 45.0)), (0.0, -10.0, 10.0)),
}
MATERIAL = ("roughness", "albedo", "refractive")
PLACE = ("seating", "light angle")
RIG = "measurement"
CALIBRATIONS: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "material known 3× better": MATERIAL,
    "seating and lamp 3× better": PLACE,
    "flat field, linearity, drift, stage 3× better": (RIG,),
    "material, seating and lamp 3× better": (*MATERIAL, *PLACE),
    "all of these 3× better": (*MATERIAL, *PLACE, RIG),
}


def outlook() -> dict[str, list[dict[str, Any]]]:
    """By class: poses, calibration, σ of the shift and area under the curve of D², in the order of `POSES`."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in SHAPES}
    for poses, (angles, tilts) in POSES.items():
        recipe = _recipe(angles, tilts)
        expected = expectation(recipe, LIGHT_DEG)
        shifts = {name: _shifts(name, expected) for name in SHAPES}
        for calibration, better in CALIBRATIONS.items():
            good = _good(recipe, expected, better)
            for name in SHAPES:
                sigmas = [_sigmas(shift, good) for shift in shifts[name]]
                areas = [area_of(sigma, len(expected.poses) - 1) for sigma in sigmas]
                row = {"poses": poses, "calibration": calibration}
                found[name].append({**row, "sigmas": float(np.mean(sigmas)), "auc": float(np.mean(areas))})
    return found


def _recipe(angles: tuple[float, ...], tilts: tuple[float, ...]) -> Recipe:
    told = recipe_of("standard", Size(), stated=True).model_dump()
    told["schema"] = 1
    told.pop("schema_version", None)
    told["poses"] |= {"angles_deg": angles, "tilts_deg": tilts}
    return Recipe.model_validate(told)


def _shifts(name: str, expected: Expectation) -> list[FloatArray]:
    """(P,) changes of ln L of a class, of both its signs where it has two."""
    kind = BY_NAME[name]
    seen = directions(expected.poses, expected.convention)
    found = []
    for sign in (-1.0, 1.0) if kind.signed else (1.0,):
        angle, material = RIDGE_ANGLE_DEG, WHOLE
        if name == "ridge-angle":
            angle += sign * kind.extent
        else:
            material = replace(WHOLE, alpha_across=WHOLE.alpha_across * (1.0 + kind.extent))
        bad = corrected.radiance(*seen, RidgeDesign(PITCH_UM, angle), material)
        found.append(np.asarray(np.log(bad / expected.radiance)))
    return found


def _good(recipe: Recipe, expected: Expectation, better: tuple[str, ...]) -> tuple[Response, FloatArray]:
    """How good parts scatter with some sources `BETTER` times smaller, in the basis of ln ratios.

    Returns:
        Response to the inputs, the ridge angle of good parts among them, and (P − 1, P − 1) covariance of the rest.
    """
    told = expected.response
    assert told is not None
    basis = log_basis(len(expected.poses))
    scale = np.array([1.0 / BETTER if better and name.startswith(better) else 1.0 for name in told.sources])
    response = Response(told.sources, told.slope * scale, told.bend * np.outer(scale, scale))
    predicted = np.sum([c.covariance() for c in expected.components], axis=0)
    alone = planned_covariance(recipe, expected) - predicted
    alone = basis @ alone @ basis.T * (BETTER**-2.0 if RIG in better else 1.0)
    return response.within(basis), np.asarray(alone)


def _sigmas(shift: FloatArray, good: tuple[Response, FloatArray]) -> float:
    """Distance of a shifted part from all that good parts may be, in σ."""
    response, alone = good
    off = log_basis(len(shift)) @ shift
    return float(np.sqrt(nearest(response, off[None], alone[None])[0]))


def area_of(sigmas: float, contrasts: int) -> float:
    """Chance that D² of a part that is shifted by some σ exceeds that of a good one."""
    from scipy.stats import chi2, ncx2  # noqa: PLC0415 - 1 s

    levels = (np.arange(2000) + 0.5) / 2000
    return float(np.mean(ncx2.sf(chi2.ppf(levels, contrasts), contrasts, max(sigmas, 1e-6) ** 2)))
