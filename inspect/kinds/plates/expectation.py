"""What a plate should show: radiances of every class of direction in every pose, and of fields with defects.

A class is the ridges of the recipe turned to its azimuth, so that its prediction is that of ridges
(`anisoscope.prediction.expectation`), and errors of plastic, ridge angle, lamp and seat move all classes together.
"""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.kinds.plates.field_outliers import class_middles
from anisoscope.kinds.plates.plate_map import fields_by_map, plate_surface
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.cache import cached_expectation
from anisoscope.prediction.expectation import Component, Expectation, expectation
from anisoscope.prediction.predict import predict_design
from anisoscope.prediction.propagation import SEATING
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.plates import Plan

FLAT_DEG = 0.01
"""Ridge angle of a field without ridges."""
REFLECTIONS = 2
"""Reflections after which light of changed ridges is no more followed; the rest is below .5 % of dark fields."""
WORN_SHARE, FILLED_LOSS, MERGED_SHARE = 0.2, 0.6, 0.5
"""Radius of worn crests over the pitch; height loss of filled fields; share of another direction in merged ones."""
FAINTEST = 1e-9


@dataclass(frozen=True, eq=False)
class Lying:
    """A position of the plate in its seat: how far it is turned, and whether the plan is mirrored.

    Attributes:
        quarters: quarter turns, counter-clockwise.
        mirrored: whether the places are mirrored left to right, as on the plan of the mould; with or without the
            directions.
        classes: (rows, cols) of the fields as they lie, -1 for flat ones.
        ln: (C, P) ln radiance of the classes, by `quick_light`.
    """

    quarters: int
    mirrored: bool
    classes: npt.NDArray[np.int64]
    ln: FloatArray


@dataclass(frozen=True, eq=False)
class ExpectedPlate:
    """Prediction of a plate.

    Attributes:
        plan: its fields.
        poses: P poses.
        convention: how the angles are counted.
        radiance: (C, P) of the classes, in the order of ``plan.letters``, in 1/sr.
        components: uncertainties of ln L of all classes and poses, (C·P,) each, classes slowest.
        per_degree: (C, P) change of ln L per degree of stage angle.
        lying: positions of the plate, the right one first.
        defects: by name the (C, P) change of ln L of a field with this defect.
        flat: (P,) radiance of a flat field.
        optics: rays or waves, and why.
        fields: (P, rows, cols) radiance of every field by the height map; None without one.
    """

    plan: Plan
    poses: tuple[Pose, ...]
    convention: Convention
    radiance: FloatArray
    components: tuple[Component, ...]
    per_degree: FloatArray
    lying: tuple[Lying, ...]
    defects: Mapping[str, FloatArray]
    flat: FloatArray
    optics: dict[str, Any] | None = None
    model: str = "corrected"
    surface: HeightMap | None = field(default=None)
    fields: FloatArray | None = None

    def covariance(self) -> FloatArray:
        """(C·P, C·P) covariance of ln L."""
        return np.asarray(np.sum([one.covariance() for one in self.components], axis=0))


def expected_plate(recipe: PlateRecipe, plan: Plan, light_angle_deg: float, *, cached: bool) -> ExpectedPlate:
    """Predict the classes of a plate, and with a height map every field.

    Args:
        recipe: the recipe.
        plan: its plan.
        light_angle_deg: the rig's angle between light and camera.
        cached: predictions of the classes may come from the cache.

    Raises:
        HeightMapError: the height map cannot be read, or is not that of the plan.
        RecipeError: as for `anisoscope.prediction.expectation.expectation`.
    """
    surface = None if recipe.surface.height_map is None else plate_surface(recipe, plan)
    predict = cached_expectation if cached else expectation
    azimuths = [plan.azimuths_deg[letter] for letter in plan.letters]
    found = [
        predict(
            recipe.of_class(plan.azimuths_deg[letter], plan.ridge_angles_deg.get(letter)), light_angle_deg
        )
        for letter in plan.letters
    ]
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    poses = recipe.poses.poses()
    design = recipe.surface.ridge_design()
    designs = [plan.design_of(letter, design) for letter in plan.letters]

    quick = quick_light(recipe, poses, convention)

    places = plan.classes()
    lying = tuple(
        Lying(
            quarters,
            mirrored,
            np.rot90(places[:, ::-1] if mirrored else places, quarters),
            np.array(
                [
                    quick(each, (180.0 - one if leaning else one) + 90.0 * quarters)
                    for each, one in zip(designs, azimuths, strict=True)
                ]
            ),
        )
        for mirrored, leaning in ((False, False), (True, False), (True, True))
        for quarters in range(4)
    )
    upright = lying[0].ln
    flat = quick(replace(design, ridge_angle_deg=FLAT_DEG, edge_radius_um=0.0), 0.0)
    radiance, fields = np.array([one.radiance for one in found]), None
    if surface is not None:
        fields = fields_by_map(surface, recipe, plan, poses, convention)
        radiance = np.exp(class_middles(np.log(fields), plan.classes(), len(plan.letters))[0])
    level = float(np.mean(np.log(radiance) - upright))
    return ExpectedPlate(
        plan,
        poses,
        convention,
        radiance,
        _components(found, azimuths),
        np.array([one.per_degree for one in found]),
        lying,
        _defects(designs, azimuths, upright, flat, quick),
        np.exp(flat + level),
        found[0].optics,
        found[0].model if fields is None else "relief",
        fields=fields,
    )


def quick_light(
    recipe: PlateRecipe, poses: tuple[Pose, ...], convention: Convention
) -> Callable[..., FloatArray]:
    """A function of ridges, of the azimuth toward which they lean, and of a plastic: (P,) ln radiance.

    Of light reflected up to `REFLECTIONS` times, by ideal ridges.
    """

    def quick(
        ridges: RidgeDesign,
        azimuth_deg: float,
        material: Material | None = None,
        light_deg: float | None = None,
    ) -> FloatArray:
        frame = replace(
            convention,
            facet_azimuth_deg=convention.facet_azimuth_deg + azimuth_deg,
            light_angle_deg=convention.light_angle_deg if light_deg is None else light_deg,
        )
        plastic = recipe.material.material() if material is None else material
        return np.asarray(
            np.log(
                np.maximum(
                    predict_design(ridges, plastic, poses, frame, bounces=REFLECTIONS).radiance, FAINTEST
                )
            )
        )

    return quick


def _components(found: list[Expectation], azimuths: list[float]) -> tuple[Component, ...]:
    """Sources of all classes; what is shared moves all classes together."""
    count, poses = len(found), len(found[0].radiance)
    sources = list(dict.fromkeys(one.source for each in found for one in each.components))
    by_class = [
        {one.source: one for one in _about_plate(each.components, turn)}
        for each, turn in zip(found, azimuths, strict=True)
    ]
    components = []
    for source in sources:
        relative, shared, kind = np.zeros((count, poses)), True, "prediction"
        for number, each in enumerate(by_class):
            if source in each:
                relative[number] = each[source].relative
                shared, kind = each[source].shared, each[source].kind
        components.append(Component(source, kind, relative.ravel(), shared))
    return tuple(components)


def _about_plate(components: tuple[Component, ...], turn_deg: float) -> list[Component]:
    """The components of ridges that lean toward an azimuth, with the seating about the axes of the plate."""
    by_name = {one.source: one for one in components}
    if not all(name in by_name for name in SEATING):
        return list(components)
    cos, sin = float(np.cos(np.radians(turn_deg))), float(np.sin(np.radians(turn_deg)))
    x, y = (by_name[name] for name in SEATING)
    by_name[x.source] = replace(x, relative=cos * x.relative - sin * y.relative)
    by_name[y.source] = replace(y, relative=sin * x.relative + cos * y.relative)
    return list(by_name.values())


def _defects(
    designs: list[RidgeDesign],
    azimuths: list[float],
    good: FloatArray,
    flat: FloatArray,
    quick: Callable[[RidgeDesign, float], FloatArray],
) -> dict[str, FloatArray]:
    """(C, P) changes of ln L of fields with defects, by name."""

    def changed(**change: float) -> FloatArray:
        shown = [quick(replace(one, **change), turn) for one, turn in zip(designs, azimuths, strict=True)]
        return np.array(shown) - good

    found = {"missing": np.array([flat - one for one in good])}
    with contextlib.suppress(HeightMapError):  # no facet is left between such crests
        found["worn"] = changed(edge_radius_um=WORN_SHARE * designs[0].pitch_um)
    found["filled"] = changed(height_loss=FILLED_LOSS, edge_radius_um=0.0)
    if len(azimuths) > 1:
        other = np.roll(good, -1, axis=0)
        found["wrong direction"] = other - good
        both = np.log((1.0 - MERGED_SHARE) * np.exp(good) + MERGED_SHARE * np.exp(other))
        found["merged"] = both - good
    return found
