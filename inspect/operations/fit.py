"""Fits of ridge angle, plastic, seating and scale to measured values."""

from pathlib import Path

from anisoscope.base.progress import Advance, silent
from anisoscope.fit.fitting import Fit, fit_or_rival
from anisoscope.fit.parameters import USUAL, checked_values, parse_free
from anisoscope.fit.problem import Problem, Readings, Scene
from anisoscope.fit.table import read_readings
from anisoscope.operations.plastic import plastic_of
from anisoscope.parameters.fitting import FitStart, TableValues
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.geometry import directions


def start_values(design: RidgeDesign, material: Material, start: FitStart) -> dict[str, float]:
    """All parameters of a fit by name; of free ones it is where the search starts.

    Args:
        design: ridge angle and height loss.
        material: roughness, albedo, index and tail.
        start: seating and scale.

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
            "seating_x_deg": start.seating_x_deg,
            "seating_y_deg": start.seating_y_deg,
            "k": start.k,
        }
    )


@by_keywords(values=TableValues, start=FitStart)
def fit_ridges(
    table: Path | str,
    *,
    values: TableValues,
    start: FitStart,
    ridge_angle_deg: float = 10.0,
    design: RidgeDesign | None = None,
    material: Material | Path | str | None = None,
    convention: Convention | None = None,
    on_progress: Advance = silent,
) -> Fit:
    """Ridge angle, roughness and scale from measured exposures or contrasts of one part: ``anisoscope fit ridges``.

    Args:
        table: CSV file: stage_deg,tilt_deg,value[,u] or from_deg,to_deg,tilt_deg,value[,u].
        values: `TableValues`.
        start: `FitStart`; ridge angle, roughness and scale are free where it names none; "all" alone is every parameter
            that these values know but albedo, index and tail.
        ridge_angle_deg: where the search starts, or the fixed value.
        design: likewise, with wall, height loss and radius of the crests.
        material: likewise for the plastic; or a material file.
        convention: how angles are counted, and the light angle.
        on_progress: called at every step.

    Raises:
        UsageError: a table that cannot be read, or parameters that cannot be fitted to it.
        RecipeError: a material file that cannot be read.
    """
    plastic, _ = plastic_of(material)
    part, counted = design or RidgeDesign(100.0, ridge_angle_deg), convention or Convention()
    poses, readings = read_readings(Path(table), values.kind, values.errors, values.covariance)
    scene = Scene(
        *directions(poses, counted),
        poses=poses,
        convention=counted,
        model=start.model,
        bounces=start.counted(),
        design=part,
        material=plastic,
    )
    chosen = tuple(name for name in USUAL if readings.scaled or name != "k")
    if start.free is not None:
        chosen = parse_free(",".join(start.free))
        if [one.strip() for one in start.free] == ["all"]:
            chosen = tuple(name for name in chosen if _enters(name, readings, scene))
    return fit_or_rival(Problem(scene, readings, start_values(part, plastic, start), chosen), on_progress)


def _enters(name: str, readings: Readings, scene: Scene) -> bool:
    if name == "k":
        return readings.scaled
    return name != "height_loss" or scene.model == "corrected"
