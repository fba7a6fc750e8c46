"""Product of the detection study: recipes, variation of good parts, defect classes, and the two worlds.

Every part is inspected on its own rig, drawn from the uncertainties that the recipe states. Rates are means over parts
and rigs.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.light.material import Material

World = Literal["same", "ggx", "student", "two-scale", "reflections", "camera", "lamp", "other"]
RecipeName = Literal["standard", "tilted"]

RECIPES: tuple[RecipeName, ...] = ("standard", "tilted")


@dataclass(frozen=True)
class WorldPart:
    """What a world has that the prediction may not know.

    Attributes:
        lobe: of the facets; its widths and albedo are those whose best Beckmann fit is the recipe's material.
        traced: rendered by the path tracer, which shares nothing with the prediction.
        reflections: light is reflected more than once.
        nonlinear: the camera is not quite linear.
        near_lamp: the lamp stands near.
    """

    lobe: Literal["beckmann", "ggx", "student", "two-scale"] = "beckmann"
    traced: bool = True
    reflections: bool = False
    nonlinear: bool = False
    near_lamp: bool = False


WORLDS: dict[World, WorldPart] = {
    "same": WorldPart(traced=False),
    "other": WorldPart("ggx", reflections=True, nonlinear=True, near_lamp=True),
    "ggx": WorldPart("ggx", reflections=True),
    "student": WorldPart("student", reflections=True),
    "two-scale": WorldPart("two-scale", reflections=True),
    "reflections": WorldPart(reflections=True),
    "camera": WorldPart(nonlinear=True),
    "lamp": WorldPart(near_lamp=True),
}
TILTS_DEG: dict[RecipeName, tuple[float, ...]] = {"standard": (0.0,), "tilted": (0.0, -10.0, 10.0)}
LIGHT_DEG = 10.0
PITCH_UM = 100.0
RIDGE_ANGLE_DEG = 10.0
LOBE = Material(0.055, 0.095, 0.2, 1.5)
RESOLVED_ALPHA = 0.03
"""Roughness that lies in the surfaces themselves; the recipe knows the sum of both."""
WHOLE = Material(
    float(np.hypot(LOBE.alpha_along, RESOLVED_ALPHA)),
    float(np.hypot(LOBE.alpha_across, RESOLVED_ALPHA)),
    LOBE.albedo,
    LOBE.index,
)
GOOD = "good"
BURRS_ON_GOOD = 0.002
RIDGE_ANGLE_SPREAD_DEG = 0.1
NONLINEARITY = 0.003
LED_DISTANCE_MM = 150.0
MARKER_ERROR_PX = 0.03


@dataclass(frozen=True)
class Size:
    """Size of parts, frames and chunks.

    Attributes:
        ridges: ridges across the judged region.
        pitches: its length along the ridges, in pitches.
        pixel_um: of the camera on the part.
        sheets: rendered surfaces of good parts; a quarter as many of every area defect.
        chunk: parts that share a camera, a flat and dark frames.
        causes: causes that the diagnosis looks for, all if None.
    """

    ridges: int = 25
    pitches: int = 7
    pixel_um: float = 12.5
    sheets: int = 8
    chunk: int = 25
    causes: tuple[str, ...] | None = None

    @property
    def sensor(self) -> SensorPart:
        """A sensor that just holds the part at 0°, 90° and 180°."""
        rows, cols = self.window(0.0)
        return SensorPart(rows=max(rows, cols), cols=max(rows, cols))

    def window(self, stage_deg: float) -> tuple[int, int]:
        """Rows and columns in the middle of the sensor that are read out at a stage angle: those that see the part."""
        along, across = (
            max(64, 8 * int(np.ceil((pitches + 1) * PITCH_UM / self.pixel_um / 8.0)))
            for pitches in (self.pitches, self.ridges)
        )
        return (across, along) if round(stage_deg / 90.0) % 2 else (along, across)

    @property
    def optics(self) -> OpticsPart:
        """Lens and light; the axis nearly in the middle, the scatter of the lamp as of a usual bench."""
        return OpticsPart(
            pixel_um=self.pixel_um, blur_um=5.0, electrons=2.4e7, axis_px=(0.4, -0.2), stray_radiance=0.0
        )


@dataclass(frozen=True)
class DefectClass:
    """One kind of bad part.

    Attributes:
        name: short name.
        title: what is wrong, with its size.
        cause: the cause that the diagnosis should name.
        extent: its extent in the unit of the diagnosis; the sign is random if `signed`.
        signed: half of the parts have the opposite sign.
        local: visible in the map; otherwise uniform over the surface.
        values: further settings of `profiles.defect_injection`, for local ones.
    """

    name: str
    title: str
    cause: str
    extent: float
    signed: bool = False
    local: bool = False
    values: dict[str, float] = field(default_factory=dict)


# densities such that scratches spoil 1 % and grains 2 % of the area: measured on the sheets, reported in the results
CLASSES = (
    DefectClass("ridge-angle", "ridge angle ±0.5°", "ridge-angle", 0.5, signed=True),
    DefectClass("roughness", "roughness across the ridges +20 %", "roughness-across", 0.2),
    DefectClass("height-loss", "height loss 10 %", "incomplete-filling", 0.1),
    DefectClass("wear", "edges worn to 5 µm", "wear", 5.0),
    DefectClass("burrs", "burrs, 2 % of the area", "burrs", 0.02, local=True),
    DefectClass("scratches", "scratches, 1 % of the area", "scratches", 11.7, local=True),
    DefectClass("missing-ridges", "missing ridges, 1 in 25", "missing-ridges", 0.04, local=True),
    DefectClass("dust", "dust, 2 % of the area", "dust", 157.0, local=True),
)
BY_NAME = {kind.name: kind for kind in CLASSES}


def recipe_of(name: RecipeName, size: Size, *, stated: bool = False) -> RidgeRecipe:
    """The recipe: an ideal design, its material and the rig with the uncertainties that the parts are drawn from.

    Args:
        name: of the recipe.
        size: of the study.
        stated: the recipe also states the spread of the ridge angle of good parts.
    """
    design = {
        "ridge_angle_deg": RIDGE_ANGLE_DEG,
        "u_ridge_angle_deg": RIDGE_ANGLE_SPREAD_DEG if stated else 0.0,
    }
    table: dict[str, Any] = {
        "schema": 1,
        "product": "ridged plate of the detection study",
        "surface": {"pitch_um": PITCH_UM, "design": design, "reflections": "direct"},
        "material": {
            "alpha_along": WHOLE.alpha_along,
            "alpha_across": WHOLE.alpha_across,
            "albedo": WHOLE.albedo,
            "index": WHOLE.index,
            "u_tail": 0.0,
            "u_alpha_share": 0.05,
            "u_albedo": 0.006,
            "u_index": 0.005,
        },
        "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": list(TILTS_DEG[name])},
        "acquisition": {"exposure_s": 0.0015, "frames_per_pose": 2, "dark_frames": 8},
        "region": {"size_mm": [size.ridges * PITCH_UM / 1000.0, size.pitches * PITCH_UM / 1000.0]},
        "uncertainty": {"seating_tilt_deg": 0.1},
    }
    return RidgeRecipe.model_validate(table)


@lru_cache(maxsize=8)
def expected_of(name: RecipeName, size: Size, *, stated: bool = False) -> Expectation:
    """Prediction of the recipe; arguments as for `recipe_of`."""
    return expectation(recipe_of(name, size, stated=stated), LIGHT_DEG)


@dataclass(frozen=True, eq=False)
class Specimen:
    """True state of one part on one rig.

    Attributes:
        ridge_angle_deg: of its ridges.
        height_loss: share of the height that is missing.
        wear_um: radius of its crests.
        along: factor on the roughness along the ridges.
        across: factor on that across.
        albedo: of the plastic.
        index: of the plastic.
        seating_deg: (2,) tilt about x and y.
        light_deg: true light angle.
        stage_deg: (V,) error of the stage angle in every view; the last view closes the series.
        gain: (V,) factor on the light in every view: flat field and linearity.
        stray: stray light, 1/sr; dark frames do not contain it.
        drift: of the lamp, per frame.
        shift_px: (V, 2) error of the marker fit.
    """

    ridge_angle_deg: float
    height_loss: float
    wear_um: float
    along: float
    across: float
    albedo: float
    index: float
    seating_deg: FloatArray
    light_deg: float
    stage_deg: FloatArray
    gain: FloatArray
    stray: float
    drift: float
    shift_px: FloatArray

    def plastic(self, base: Material) -> Material:
        """Material of the part, where that of a nominal one is ``base``."""
        return replace(
            base,
            alpha_along=base.alpha_along * self.along,
            alpha_across=base.alpha_across * self.across,
            albedo=base.albedo * self.albedo / LOBE.albedo,
            index=self.index,
        )


def draw(kind: DefectClass | None, views: int, rng: np.random.Generator) -> tuple[Specimen, float]:
    """A part of a class (None: good) on a rig, and the extent of its defect (0 for good)."""
    recipe = recipe_of("tilted", Size())
    part, rig = recipe.material, recipe.uncertainty
    normal = rng.standard_normal
    linear, flat = rig.linearity_share, rig.flat_share
    extent = 0.0 if kind is None else kind.extent
    if kind is not None and kind.signed:
        extent *= float(rng.choice([-1.0, 1.0]))
    name = "" if kind is None else kind.name
    found = Specimen(
        ridge_angle_deg=RIDGE_ANGLE_DEG
        + RIDGE_ANGLE_SPREAD_DEG * float(normal())
        + (extent if name == "ridge-angle" else 0.0),
        height_loss=extent if name == "height-loss" else 0.0,
        wear_um=extent if name == "wear" else 0.0,
        along=float(np.exp(part.u_alpha_share * normal())),
        across=float(np.exp(part.u_alpha_share * normal()))
        * (1.0 + (extent if name == "roughness" else 0.0)),
        albedo=float(np.clip(part.albedo + part.u_albedo * normal(), 0.01, 0.99)),
        index=float(part.index + part.u_index * normal()),
        seating_deg=rig.seating_tilt_deg * normal(2),
        light_deg=LIGHT_DEG + rig.light_angle_deg * float(normal()),
        stage_deg=rig.stage_deg * normal(views),
        gain=1.0 + np.hypot(linear, flat) * normal(views),
        stray=rig.stray_radiance * float(normal()),
        drift=2e-4 * float(normal()),
        shift_px=MARKER_ERROR_PX * normal((views, 2)),
    )
    return found, extent
