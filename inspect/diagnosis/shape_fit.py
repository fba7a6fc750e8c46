"""Ridge angle, roughness, height loss and seating of a part, fitted to its contrasts over several tilts.

Parameters not determined by the poses are reported as such. The optical model is that of the prediction of an ideal
design.
"""

import numpy as np

from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.significance import log_basis
from anisoscope.fit.fitting import Fit, fit
from anisoscope.fit.identifiability import information
from anisoscope.fit.parameters import PARAMETERS, checked_values
from anisoscope.fit.problem import Problem, Readings, Scene, interface_alpha
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Expectation
from anisoscope.prediction.input_doubt import SCATTER
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import EstimateRecord, ShapeRecord
from anisoscope.sim.light.geometry import directions

# In the order in which they are dropped if there are fewer contrasts than parameters.
FREE = ("height_loss", "seating_x_deg", "seating_y_deg", "alpha_across", "alpha_along", "ridge_angle_deg")
SEATING = ("seating_x_deg", "seating_y_deg")
STARTS = 1
# Fitted parameters must not count as uncertainties of the prediction as well.
HELD = ("albedo of the plastic", "refractive index", "light angle")


def fit_shape(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured
) -> tuple[ShapeRecord | None, str | None]:
    """Fit ideal ridges to the contrasts of a part measured at several tilts.

    Returns:
        The fit, or None with fewer than two tilts; and a note where it failed.
    """
    if len(recipe.poses.tilts_deg) < 2:
        return None, None
    try:
        problem = _problem(recipe, expected, measured, FREE)
        known = information(problem, problem.values, problem.readings.covariance)
        if "ridge_angle_deg" in known.undetermined:  # degenerate with a tilted seating: assume none
            shape = tuple(name for name in FREE if name not in SEATING)
            problem = _problem(recipe, expected, measured, shape)
        found = fit(problem, starts=STARTS)
        return _recorded(found), None
    except (AnisoscopeError, ArithmeticError, ValueError, np.linalg.LinAlgError) as failure:
        return None, f"no fit over the tilts: {failure}"


def _problem(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured, parameters: tuple[str, ...]
) -> Problem:
    poses = len(expected.poses)
    basis = log_basis(poses)
    held = HELD if SEATING[0] in parameters else (*HELD, "seating tilt about x", "seating tilt about y")
    prediction_components = [c for c in expected.components if c.source.removeprefix(SCATTER) in held]
    total = np.sum([c.covariance() for c in (*prediction_components, *measured.components)], axis=0)
    dropped = parameters[: max(len(parameters) - (poses - 1), 0)]
    design, material = recipe.surface.design, recipe.material
    nominal = {
        "alpha_along": material.alpha_along,
        "alpha_across": material.alpha_across,
        "albedo": material.albedo,
        "index": material.index,
    }
    if design is not None:
        nominal["ridge_angle_deg"] = design.ridge_angle_deg
    to_light, to_camera = directions(expected.poses, expected.convention)
    scene = Scene(
        to_light,
        to_camera,
        design=RidgeDesign(100.0, 10.0, "perpendicular" if design is None else design.wall),
        bounces=recipe.surface.bounces,
        material=Material(internal_reflection=material.internal_reflection),
        poses=expected.poses,
        convention=expected.convention,
    )
    values = checked_values(nominal)
    scene = scene.anchored(values, interface_alpha(values))
    readings = Readings(
        kind="log_ratio",
        first=np.arange(1, poses),
        second=np.zeros(poses - 1, dtype=np.intp),
        value=basis @ np.log(measured.radiance),
        covariance=basis @ np.asarray(total) @ basis.T,
        noise_known=True,
        labels=tuple(f"{p.stage_deg:g}° @ {p.tilt_deg:g}°" for p in expected.poses[1:]),
        assumption="uncertainty of measurement, albedo, index and light angle",
    )
    free = tuple(name for name in PARAMETERS if name in parameters and name not in dropped)
    return Problem(scene, readings, values, free)


def _recorded(found: Fit) -> ShapeRecord:
    free = found.problem.free
    return ShapeRecord(
        estimates=tuple(
            EstimateRecord(
                name=one.name,
                title=PARAMETERS[one.name].words,
                unit=PARAMETERS[one.name].unit,
                value=one.value,
                u=one.u,
                at_bound=one.at_bound,
            )
            for one in found.estimates
        ),
        held=tuple(name for name in reversed(FREE) if name not in free),
        chi2=found.chi2,
        dof=found.dof,
        p_value=found.p_value,
        advice=found.advice,
    )
