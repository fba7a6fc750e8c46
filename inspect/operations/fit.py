"""Fits of ridge angle, plastic, seating and scale to measured values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from anisoscope.base.progress import Advance, silent
from anisoscope.fit.fitting import Fit, fit_or_rival
from anisoscope.fit.parameters import USUAL, checked_values, parse_free
from anisoscope.fit.problem import Problem, Readings, Scene
from anisoscope.fit.table import read_readings
from anisoscope.operations.plastic import plastic_of
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.geometry import directions


def start_values(
    design: RidgeDesign, material: Material, seating_deg: tuple[float, float] = (0.0, 0.0), k: float = 1.0
) -> dict[str, float]:
    """All parameters of a fit by name; of free ones it is where the search starts.

    Args:
        design: ridge angle and height loss.
        material: roughness, albedo, index and tail.
        seating_deg: about x and about y.
        k: scale between radiance and the unit of the values.

    Raises:
        UsageError: a value outside its bounds.
    """
    return checked_values(
        {
            "ridge_angle_deg": design.ridge_angle_deg,
            "alpha_along": material.alpha_along,
            "alpha_across": material.alpha_across,
            "albedo": material.albedo,
            "index": material.index,
            "tail": material.tail,
            "height_loss": design.height_loss,
            "seating_x_deg": seating_deg[0],
            "seating_y_deg": seating_deg[1],
            "k": k,
        }
    )


def fit_ridges(
    table: Path | str,
    *,
    kind: Literal["exposure", "difference", "michelson", "log_ratio"] | None = None,
    free: Sequence[str] | None = None,
    ridge_angle_deg: float = 10.0,
    design: RidgeDesign | None = None,
    material: Material | Path | str | None = None,
    convention: Convention | None = None,
    seating_deg: tuple[float, float] = (0.0, 0.0),
    k: float = 1.0,
    model: Literal["printed", "corrected"] = "corrected",
    bounces: int | None = None,
    errors: Literal["shared", "independent"] = "shared",
    covariance: Path | None = None,
    on_progress: Advance = silent,
) -> Fit:
    """Ridge angle, roughness and scale from measured exposures or contrasts of one part: ``anisoscope fit ridges``.

    Args:
        table: CSV file: stage_deg,tilt_deg,value[,u] or from_deg,to_deg,tilt_deg,value[,u].
        kind: what the values are; of exposures, which contrasts are formed and fitted.
        free: parameters, such as "ridge_angle", "alpha_along", "k"; ridge angle, roughness and scale where not given;
            "all" alone is every one that these values know but albedo, index and tail.
        ridge_angle_deg: where the search starts, or the fixed value.
        design: likewise, with wall, height loss and radius of the crests.
        material: likewise for the plastic; or a material file.
        convention: how angles are counted, and the light angle.
        seating_deg: seating about x and y, likewise.
        k: scale between radiance and the values, likewise.
        model: corrected, or as published.
        bounces: largest number of reflections; None follows all.
        errors: contrasts that share a photograph are correlated, or independent.
        covariance: CSV file without header, N × N, in place of u.
        on_progress: called at every step.

    Raises:
        UsageError: a table that cannot be read, or parameters that cannot be fitted to it.
        RecipeError: a material file that cannot be read.
    """
    plastic, _ = plastic_of(material)
    part, counted = design or RidgeDesign(100.0, ridge_angle_deg), convention or Convention()
    poses, readings = read_readings(Path(table), kind, errors, covariance)
    scene = Scene(
        *directions(poses, counted),
        poses=poses,
        convention=counted,
        model=model,
        bounces=1 if model == "printed" else bounces,
        design=part,
        material=plastic,
    )
    chosen = tuple(name for name in USUAL if readings.scaled or name != "k")
    if free is not None:
        chosen = parse_free(",".join(free))
        if [one.strip() for one in free] == ["all"]:
            chosen = tuple(name for name in chosen if _enters(name, readings, scene))
    return fit_or_rival(
        Problem(scene, readings, start_values(part, plastic, seating_deg, k), chosen), on_progress
    )


def _enters(name: str, readings: Readings, scene: Scene) -> bool:
    if name == "k":
        return readings.scaled
    return name != "height_loss" or scene.model == "corrected"
