"""Product of the detection study: recipes, variation of good parts and of rigs, defect classes, and the worlds.

A rig (light, zero of the tilt, linearity, stray light, camera) is drawn once for every set of golden parts; all parts
of the set, golden and judged ones, meet it. Parts of one batch share half of the variance of ridge angle, roughness and
albedo; every judged part is of another batch, but for those of a lot. What a part has of its own is the other half, its
seating, and the errors of one inspection.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.expectation import Expectation, expectation
from anisoscope.recipe.material_file import MaterialFile
from anisoscope.recipe.poses import PosesPart
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart
from anisoscope.sim.light.geometry import pose_grid

World = Literal["same", "reflections", "ggx", "two-scale", "wide-base", "alike", "lamp", "curved", "other"]
RecipeName = Literal["standard", "tilted", "suggested"]
RECIPES: tuple[RecipeName, ...] = get_args(RecipeName)


@dataclass(frozen=True)
class WorldPart:
    """What a world has that the prediction may not know. Light reflects between facet and wall in all of them.

    Attributes:
        lobe: of the facets, the last two outside of every fitted family; widths and albedo are those whose best
            Beckmann fit is the recipe's material.
        traced: rendered by the path tracer, which shares nothing with the prediction.
        nonlinear: the camera is not quite linear.
        near_lamp: the lamp stands near.
        curved: the parts are bent.
        scatter: of the parts, as a multiple of the stated standard deviations.
    """

    lobe: Literal["beckmann", "ggx", "two-scale", "wide-base"] = "beckmann"
    traced: bool = True
    nonlinear: bool = False
    near_lamp: bool = False
    curved: bool = False
    scatter: float = 1.0


WORLDS: dict[World, WorldPart] = {
    "same": WorldPart(traced=False),
    "other": WorldPart("ggx", nonlinear=True, near_lamp=True, curved=True),
    "ggx": WorldPart("ggx"),
    "two-scale": WorldPart("two-scale"),
    "wide-base": WorldPart("wide-base"),
    "reflections": WorldPart(),
    "alike": WorldPart(scatter=0.3),
    "lamp": WorldPart(near_lamp=True),
    "curved": WorldPart(curved=True),
}


def rendered_as(world: World) -> World:
    """The first world whose surfaces send the same light: some differ in camera and lamp alone."""
    own = WORLDS[world]
    return next(name for name, part in WORLDS.items() if (part.lobe, part.traced) == (own.lobe, own.traced))


STAGE_DEG = (0.0, 90.0, 180.0)
POSES: dict[RecipeName, tuple[Pose, ...]] = {
    "standard": pose_grid(STAGE_DEG, (0.0,)),
    "tilted": pose_grid(STAGE_DEG, (0.0, -10.0, 10.0)),
    # quarter turns, as `recipe suggest` finds them for ridge angle, roughness and height loss
    "suggested": tuple(
        Pose(*one)
        for one in ((0.0, 0.0), (90.0, 0.0), (180.0, 0.0), (90.0, -15.0), (90.0, -5.0), (0.0, -10.0))
    ),
}
SEEN = (*POSES["tilted"], *(pose for pose in POSES["suggested"] if pose not in POSES["tilted"]))
"""All poses that are photographed; the first of them once more at the end (`VIEWS`)."""
VIEWS = (*SEEN, SEEN[0])
CHOSEN: dict[RecipeName, tuple[int, ...]] = {
    name: tuple(SEEN.index(pose) for pose in poses) for name, poses in POSES.items()
}
LIGHT_DEG = 10.0
PITCH_UM = 100.0
RIDGE_ANGLE_DEG = 10.0
LOBE = Material(0.055, 0.095, 0.2, 1.5)
RESOLVED_ALPHA = 0.03
"""Roughness resolved by the surfaces; the recipe states the sum of both."""
WHOLE = Material(
    float(np.hypot(LOBE.alpha_along, RESOLVED_ALPHA)),
    float(np.hypot(LOBE.alpha_across, RESOLVED_ALPHA)),
    LOBE.albedo,
    LOBE.index,
)
GOOD, GOLDEN = "good", "golden"
BURRS_ON_GOOD = 0.002
RIDGE_ANGLE_SPREAD_DEG = 0.1
ALPHA_SPREAD, ALBEDO_SPREAD = 0.05, 0.03
"""Relative standard deviations of roughness and albedo between good parts."""
OF_BATCH = 0.5
"""Share of the variance of ridge angle, roughness and albedo that parts of a batch have in common."""
UNKNOWN_ALPHA_SHARE, UNKNOWN_ALBEDO_SHARE = 0.2, 0.1
"""What is stated of a plastic that was not calibrated; its lobe is unmeasured (no `u_tail`)."""
EXPOSURE_S, FRAMES = 0.0009, 2
NONLINEARITY = 0.003
LED_DISTANCE_MM = 150.0
BEND_MM = 300.0
"""Radius of bent parts, in both directions."""
MARKER_ERROR_PX = 0.03


TILT_ZERO_DEG = 0.05


@dataclass(frozen=True)
class Size:
    """Size of parts, frames and chunks.

    Attributes:
        ridges: ridges across the judged region.
        pitches: its length along the ridges, in pitches.
        pixel_um: of the camera on the part.
        sheets: rendered surfaces of good parts; there is one of every area defect.
        golden: golden parts of a rig, by batch.
        good: judged good parts of a rig.
        bad: judged parts of every class of a rig.
        lot: good parts of the lot of a rig, which has `LOT_BAD` parts of every class that is uniform besides.
        golden_pictured: golden parts of a rig whose parts are photographed; it has no lot.
        good_pictured: judged good parts of such a rig.
        bad_pictured: judged parts of every class of such a rig.
        causes: causes that the diagnosis looks for, all if None.
    """

    ridges: int = 25
    pitches: int = 7
    pixel_um: float = 12.5
    sheets: int = 2
    golden: tuple[int, ...] = (25, 25, 5, 5, 5)
    good: int = 14
    bad: int = 2
    lot: int = 10
    golden_pictured: tuple[int, ...] = (3, 3)
    good_pictured: int = 20
    bad_pictured: int = 5
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

    def roster(self, *, pictured: bool) -> tuple[tuple[str, int, bool], ...]:
        """Kind, batch, and whether it is of the lot, of every part of a rig; local defects need pictures."""
        golden, good, bad, lot = (
            (self.golden_pictured, self.good_pictured, self.bad_pictured, 0)
            if pictured
            else (self.golden, self.good, self.bad, self.lot)
        )
        found = [(GOLDEN, batch, False) for batch, count in enumerate(golden) for _ in range(count)]
        judged = [GOOD] * good
        judged += [kind.name for kind in CLASSES if pictured or not kind.local for _ in range(bad)]
        found += [(kind, len(golden) + number, False) for number, kind in enumerate(judged)]
        if lot:
            members = [GOOD] * lot + [name for name in UNIFORM for _ in range(LOT_BAD)]
            found += [(kind, len(golden) + len(judged), True) for kind in members]
        return tuple(found)

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
    """

    name: str
    title: str
    cause: str
    extent: float
    signed: bool = False
    local: bool = False


# densities such that scratches spoil 1 % and grains 2 % of the area: measured on the sheets, reported in the results
CLASSES = (
    DefectClass("ridge-angle", "ridge angle ±0.5°", "ridge-angle", 0.5, signed=True),
    DefectClass("ridge-angle-1", "ridge angle −1°", "ridge-angle", -1.0),
    DefectClass("roughness", "roughness across the ridges +20 %", "roughness-across", 0.2),
    DefectClass("height-loss", "height loss 10 %", "incomplete-filling", 0.1),
    DefectClass("wear", "edges worn to 5 µm", "wear", 5.0),
    DefectClass("burrs", "burrs, 2 % of the area", "burrs", 0.02, local=True),
    DefectClass("scratches", "scratches, 1 % of the area", "scratches", 11.7, local=True),
    DefectClass("missing-ridges", "missing ridges, 1 in 25", "missing-ridges", 0.04, local=True),
    DefectClass("dust", "dust, 2 % of the area", "dust", 157.0, local=True),
)
BY_NAME = {kind.name: kind for kind in CLASSES}
UNIFORM = tuple(kind.name for kind in CLASSES if not kind.local)
OF_INTEREST = ("ridge-angle", "roughness", "height-loss", "wear")
"""Classes of exactly the smallest interesting size."""
LOT_BAD = 2


def recipe_of(name: RecipeName, size: Size, material: MaterialFile | None = None) -> RidgeRecipe:
    """The recipe of an ideal design on the rig that the parts are drawn for.

    Args:
        name: of the recipe.
        size: of the study.
        material: the calibrated plastic; None: about what it is made of, with the doubt of a plastic that was never
            measured.
    """
    plastic: dict[str, Any] = {
        "alpha_along": WHOLE.alpha_along,
        "alpha_across": WHOLE.alpha_across,
        "albedo": WHOLE.albedo,
        "index": WHOLE.index,
        "u_alpha_share": UNKNOWN_ALPHA_SHARE,
        "u_albedo": UNKNOWN_ALBEDO_SHARE * WHOLE.albedo,
        "u_index": 0.005,
    }
    if material is not None:
        known = {"u_alpha_share": 0.0, "u_albedo": 0.0, "u_tail": 0.0, "u_index": 0.005}
        plastic = {**dict(material.material), **known, "file": f"{material.id}.toml", "calibrated": material}
    table: dict[str, Any] = {
        "schema": 1,
        "product": "ridged plate of the detection study",
        "surface": {
            "pitch_um": PITCH_UM,
            "design": {
                "ridge_angle_deg": RIDGE_ANGLE_DEG,
                "u_ridge_angle_deg": RIDGE_ANGLE_SPREAD_DEG,
                "edge_radius_um": 0.0,  # the crests of all parts are made sharp, but for worn ones
            },
        },
        "material": plastic,
        "poses": {"stage_and_tilt_deg": [(pose.stage_deg, pose.tilt_deg) for pose in POSES[name]]},
        "acquisition": {"exposure_s": EXPOSURE_S, "frames_per_pose": FRAMES, "dark_frames": 8},
        "region": {"size_mm": [size.ridges * PITCH_UM / 1000.0, size.pitches * PITCH_UM / 1000.0]},
        "area": {"max_share": 0.02},
        "uncertainty": {"seating_tilt_deg": 0.1, "tilt_deg": TILT_ZERO_DEG},
        "scatter": {"alpha_share": ALPHA_SPREAD, "albedo_share": ALBEDO_SPREAD},
        "decision": {"unexcluded": "inconclusive"},
    }
    return RidgeRecipe.model_validate(table)


def whole_recipe(size: Size) -> RidgeRecipe:
    """The recipe with all poses that are photographed."""
    recipe = recipe_of("tilted", size)
    seen = tuple((pose.stage_deg, pose.tilt_deg) for pose in SEEN)
    return recipe.model_copy(update={"poses": PosesPart(stage_and_tilt_deg=seen)})


@lru_cache(maxsize=4)
def whole_expectation(size: Size) -> Expectation:
    """Prediction of all poses that are photographed, of the plastic that was never measured."""
    return expectation(whole_recipe(size), LIGHT_DEG)


@dataclass(frozen=True, eq=False)
class RigState:
    """True state of one rig.

    Attributes:
        light_deg: true light angle.
        tilt_zero_deg: error of the zero of the tilt.
        stray: stray light, 1/sr; dark frames do not contain it.
        linearity: (V,) factor on the light in every view.
    """

    light_deg: float
    tilt_zero_deg: float
    stray: float
    linearity: FloatArray


@dataclass(frozen=True, eq=False)
class Specimen:
    """True state of one part in one inspection.

    Attributes:
        ridge_angle_deg: of its ridges.
        height_loss: share of the height that is missing.
        wear_um: radius of its crests.
        along: factor on the roughness along the ridges.
        across: factor on that across.
        albedo: factor on the albedo of the plastic.
        seating_deg: (2,) tilt about x and y.
        stage_deg: (V,) error of the stage angle in every view; the last view closes the series.
        gain: (V,) factor on the light in every view: flat field.
        drift: of the lamp, per frame.
        shift_px: (V, 2) error of the marker fit.
    """

    ridge_angle_deg: float
    height_loss: float
    wear_um: float
    along: float
    across: float
    albedo: float
    seating_deg: FloatArray
    stage_deg: FloatArray
    gain: FloatArray
    drift: float
    shift_px: FloatArray


def draw_rig(rng: np.random.Generator) -> RigState:
    """A rig within the uncertainties that the recipe states."""
    rig = recipe_of("tilted", Size()).uncertainty
    normal = rng.standard_normal
    return RigState(
        light_deg=LIGHT_DEG + rig.light_angle_deg * float(normal()),
        tilt_zero_deg=rig.tilt_deg * float(normal()),
        stray=rig.stray_radiance * float(normal()),
        linearity=1.0 + rig.linearity_share * normal(len(VIEWS)),
    )


def draw_batch(rng: np.random.Generator) -> FloatArray:
    """(4,) what parts of a batch share of ridge angle, both roughnesses and albedo, in their standard deviations."""
    return np.asarray(np.sqrt(OF_BATCH) * rng.standard_normal(4))


def draw(
    kind: DefectClass | None, rng: np.random.Generator, batch: FloatArray | None = None, scatter: float = 1.0
) -> tuple[Specimen, float]:
    """A part and the extent of its defect (0 for good).

    Args:
        kind: its class; None: good.
        rng: of the part.
        batch: what its batch shares; None: it is of a batch of its own.
        scatter: of good parts and their seating, as a multiple of the stated one.
    """
    rig = recipe_of("tilted", Size()).uncertainty
    normal, views = rng.standard_normal, len(VIEWS)
    extent = 0.0 if kind is None else kind.extent
    if kind is not None and kind.signed:
        extent *= float(rng.choice([-1.0, 1.0]))
    state = defective(nominal(), "" if kind is None else kind.name, extent)
    shared = draw_batch(rng) if batch is None else batch
    angle, along, across, albedo = map(float, scatter * (shared + np.sqrt(1.0 - OF_BATCH) * normal(4)))
    found = replace(
        state,
        ridge_angle_deg=state.ridge_angle_deg + RIDGE_ANGLE_SPREAD_DEG * angle,
        along=state.along * float(np.exp(ALPHA_SPREAD * along)),
        across=state.across * float(np.exp(ALPHA_SPREAD * across)),
        albedo=state.albedo * float(np.exp(ALBEDO_SPREAD * albedo)),
        seating_deg=scatter * rig.seating_tilt_deg * normal(2),
        stage_deg=rig.stage_deg * normal(views),
        gain=1.0 + rig.flat_share * normal(views),
        drift=2e-4 * float(normal()),
        shift_px=MARKER_ERROR_PX * normal((views, 2)),
    )
    return found, extent


def nominal() -> Specimen:
    """The part as designed, inspected without error."""
    zero = np.zeros(len(VIEWS))
    return Specimen(
        RIDGE_ANGLE_DEG,
        0.0,
        0.0,
        1.0,
        1.0,
        1.0,
        np.zeros(2),
        zero,
        zero + 1.0,
        0.0,
        np.zeros((len(VIEWS), 2)),
    )


def defective(state: Specimen, name: str, extent: float) -> Specimen:
    """A part with a defect of its shape or roughness; local ones are in the sheets."""
    if name.startswith("ridge-angle"):
        return replace(state, ridge_angle_deg=state.ridge_angle_deg + extent)
    if name == "roughness":
        return replace(state, across=state.across * (1.0 + extent))
    if name == "height-loss":
        return replace(state, height_loss=extent)
    return replace(state, wear_um=extent) if name == "wear" else state
