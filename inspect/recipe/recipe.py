"""The recipe: what a part should look like, how it is photographed, and how it is judged."""

import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from anisoscope.base.errors import ModelError, RecipeError, RigFileError
from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive, Share, read_toml_model
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.rig.acquisition.plan import LEAST_STEP
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.geometry import Convention, Pose, directions, pose_grid
from anisoscope.sim.light.material import Material

MIRROR: dict[str, float] = {"alpha_along": 0.001, "alpha_across": 0.001, "albedo": 0.0}
"""Of a material that is given as a mirror, where nothing else is said: polished, and it scatters nothing."""

CERTAIN: dict[str, float] = {"u_alpha_share": 0.0, "u_albedo": 0.0, "u_index": 0.0}
"""Likewise: what is uncertain of a plastic, and is of no account on a mirror."""


WIDEST = 0.4
"""Largest full width of a lamp's spectrum, by its wavelength: the bench's lamps are no wider."""


_SOURCES = {"albedo of the plastic": "share of scattered light"}
"""Sources of uncertainty that are called otherwise on a wafer than the model's input of the same place."""


def source_name(source: str, *, wafer: bool) -> str:
    """What a source of uncertainty is called in a budget."""
    if wafer:
        for plastic, mirror in _SOURCES.items():
            source = source.replace(plastic, mirror)
    return source


class LightPart(Part):
    """Lamp and lens as the part sees them, with standard uncertainties: what waves make of a part depends on them.

    ``bandwidth_nm`` is the full width of the lamp's spectrum at half of its height; half angles are those of the cones
    of light that fall in and that the lens collects.
    """

    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] = 550.0
    bandwidth_nm: Annotated[float, Field(ge=0.0, le=200.0)] = 0.0
    lamp_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    aperture_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    u_wavelength_nm: NotNegative = 0.5
    u_bandwidth_share: Share = 0.1
    u_lamp_share: Share = 0.05
    u_aperture_share: Share = 0.02

    @model_validator(mode="after")
    def _light_is_light(self) -> Self:
        if self.bandwidth_nm > WIDEST * self.wavelength_nm:
            raise ValueError(
                f"bandwidth_nm = {self.bandwidth_nm:g} is too wide for a lamp about {self.wavelength_nm:g} nm: at most "
                f"{WIDEST * self.wavelength_nm:.3g}"
            )
        return self


ContrastKind = Literal["log_ratio", "michelson", "difference"]
Surface = Literal["height_map", "design"]
AskedOptics = Literal["auto", "geometric", "wave"]


class DesignPart(Part):
    """Ideal ridges; ``u_ridge_angle_deg`` is how much the angle of good parts spreads, a standard deviation."""

    ridge_angle_deg: Annotated[float, Field(ge=0.0, lt=45.0)]
    u_ridge_angle_deg: NotNegative = 0.0
    wall: Literal["perpendicular", "vertical"] = "perpendicular"


class SurfacePart(Part):
    """What the part is compared with: a measured height map, an ideal design, or both.

    ``pitch_um`` is needed in all cases: means and the contrast map are taken over whole pitches. Of a wafer it is the
    side of the tile that repeats, and ``height_map`` is that tile. Of both surfaces, ``compare`` says which one
    decides; the other is compared with as well. ``optics`` says how light is predicted: "auto" takes rays or waves,
    whichever is right, "geometric" and "wave" insist.
    """

    pitch_um: Positive
    height_map: LocalPath | None = None
    pixel_um: tuple[Positive, Positive] | None = None
    role: Literal["part", "tool"] = "part"
    design: DesignPart | None = None
    compare: Surface | None = None
    optics: AskedOptics = "auto"

    @model_validator(mode="after")
    def _something_decides(self) -> Self:
        if self.height_map is None and self.design is None:
            raise ValueError("give height_map (a file) or design (a table), or both of them with compare")
        if self.height_map is not None and self.design is not None and self.compare is None:
            raise ValueError(
                'of height_map and design, say with compare = "height_map" or "design" which one decides'
            )
        if self.compare is not None and getattr(self, self.compare) is None:
            raise ValueError(f'compare = "{self.compare}", but there is no {self.compare}')
        if self.compare == "height_map" and self.design is not None and self.design.u_ridge_angle_deg > 0.0:
            raise ValueError(
                "design.u_ridge_angle_deg is the spread of ideal ridges, and cannot be given to those of a height_map "
                'that decides: leave it out, or let the design decide (compare = "design")'
            )
        return self

    @property
    def decides(self) -> Surface:
        """What the verdict compares with."""
        return self.compare or ("height_map" if self.design is None else "design")

    @property
    def both(self) -> bool:
        """There is a second comparison."""
        return self.height_map is not None and self.design is not None

    def ridge_design(self) -> RidgeDesign:
        """The ideal design of this table; only where ``design`` is given."""
        assert self.design is not None
        return RidgeDesign(
            pitch_um=self.pitch_um, ridge_angle_deg=self.design.ridge_angle_deg, wall=self.design.wall
        )


class MaterialPart(Part):
    """The plastic, with standard uncertainties: relative for the roughness, absolute for the rest.

    With ``reflectance`` it is a mirror instead, such as a coated wafer: of the light that falls on it this share is
    reflected, whatever the angle, and the share ``albedo`` of that is scattered everywhere.
    """

    alpha_along: Positive
    alpha_across: Positive
    albedo: Share
    index: Annotated[float, Field(gt=1.0, le=4.0)] = 1.5
    internal_reflection: Literal["nonlinear", "linear"] = "nonlinear"
    u_alpha_share: Share = 0.05
    u_albedo: NotNegative = 0.01
    u_index: NotNegative = 0.01
    reflectance: Annotated[float, Field(gt=0.0, le=1.0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_a_mirror(cls, table: Any) -> Any:  # noqa: ANN401
        if isinstance(table, dict) and table.get("reflectance") is not None:
            return {**MIRROR, **CERTAIN, **table}
        return table

    def material(self) -> Material:
        """The material of the reflectance model."""
        return Material(
            self.alpha_along, self.alpha_across, self.albedo, self.index, self.internal_reflection
        )


class PosesPart(Part):
    """Stage angles in the order in which they are photographed, and tilts, in degrees."""

    angles_deg: Annotated[tuple[float, ...], Field(min_length=2)] = (0.0, 90.0, 180.0)
    tilts_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    facet_azimuth_deg: float = 0.0

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for name, values in (("angles_deg", self.angles_deg), ("tilts_deg", self.tilts_deg)):
            if len(set(values)) != len(values):
                raise ValueError(f"{name} names an angle twice")
        return self

    def poses(self) -> tuple[Pose, ...]:
        """All poses, stage angles fastest."""
        return pose_grid(self.angles_deg, self.tilts_deg)


class AcquisitionPart(Part):
    """Exposure and repetition.

    ``brackets`` are further exposures of every pose, as multiples of ``exposure_s``, for parts whose dark poses are
    lost in noise at the exposure that the bright ones bear. Frames are counted for every exposure.
    """

    exposure_s: Positive
    brackets: Annotated[tuple[float, ...], Field(max_length=4)] = ()
    gain: Positive = 1.0
    frames_per_pose: Annotated[int, Field(ge=2, le=256)] = 4
    dark_frames: Annotated[int, Field(ge=2, le=256)] = 4
    settle_s: NotNegative = 0.1

    @model_validator(mode="after")
    def _brackets_rise(self) -> Self:
        for before, after in pairwise((1.0, *self.brackets)):
            if not after >= LEAST_STEP * before:
                raise ValueError(
                    f"brackets are multiples of exposure_s that rise by {LEAST_STEP:g} or more, such as [4.0, 16.0]: "
                    f"{after:g} follows {before:g}"
                )
        return self


class RegionPart(Part):
    """The rectangle of the part that is judged, in mm.

    ``center_mm`` is (x, y) from the rotation axis at stage angle 0, ``size_mm`` (across the ridges, along them).
    """

    center_mm: tuple[float, float] = (0.0, 0.0)
    size_mm: tuple[Positive, Positive]


class DecisionBase(Part):
    """How a part of any kind is judged.

    ``alpha`` is the level of significance; ``deviation`` says what a significant deviation within the tolerance does;
    the guard band is ``coverage`` standard uncertainties wide. What is INCONCLUSIVE is photographed up to ``remeasure``
    times more.
    """

    alpha: Annotated[float, Field(gt=0.0, lt=0.5)] = 0.01
    deviation: Literal["warn", "fail"] = "warn"
    coverage: Positive = 1.645
    remeasure: Annotated[int, Field(ge=0, le=9)] = 1


class DecisionPart(DecisionBase):
    """How contrasts are judged.

    ``tolerance`` is the largest deviation |measured − predicted| of a good part, one number for all pairs or
    one a pair; without it a significant deviation at ``alpha`` fails the part. ``deviation`` says what a
    significant deviation within the tolerance does. What is INCONCLUSIVE is photographed up to ``remeasure`` times
    more.
    """

    contrast: ContrastKind = "log_ratio"
    tolerance: Positive | tuple[Positive, ...] | None = None


class AreaPart(Part):
    """How the contrast map is judged: cells a quarter of a pitch wide, against the median along their flank.

    A cell deviates where its ln ratio is off by more than ``cell_deviation``; the part fails where more than
    ``max_share`` of the area does.
    """

    cell_deviation: Positive = 0.3
    max_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.03


class LimitsPart(Part):
    """What makes a measurement INVALID."""

    saturated_share: Share = 0.001
    registration_px: Positive = 0.5
    angle_deg: Positive = 0.5
    scale_share: Share = 0.02
    drift: Positive = 0.02
    min_signal_share: Share = 0.01


class CommonUncertainty(Part):
    """Standard uncertainties of the rig that one inspection of any kind of part cannot see."""

    light_angle_deg: NotNegative = 0.1
    stage_deg: NotNegative = 0.05
    seating_tilt_deg: NotNegative = 0.1
    flat_share: NotNegative = 0.002
    scale_share: NotNegative = 0.02
    linearity_share: NotNegative = 0.001
    stray_radiance: NotNegative = 0.0003


class RigUncertainty(CommonUncertainty):
    """Standard uncertainties of the rig that one inspection cannot see.

    ``tilt_deg`` is of the zero of the tilt; ``etch_…`` are of good wafers: depth of the passes, width of features.
    """

    height_map_share: NotNegative = 0.01
    tilt_deg: NotNegative = 0.0
    etch_depth_nm: NotNegative = 1.0
    etch_width_nm: NotNegative = 20.0


class RecipeBase(Part):
    """What the recipes of all kinds of parts have in common; a kind adds its own tables, and may narrow these."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    kind: str | None = None
    product: Annotated[str, Field(min_length=1, max_length=200)]
    version: Annotated[int, Field(ge=1)] = 1
    poses: PosesPart = PosesPart()
    acquisition: AcquisitionPart
    region: RegionPart
    decision: DecisionBase = DecisionBase()
    limits: LimitsPart = LimitsPart()
    uncertainty: CommonUncertainty = CommonUncertainty()


class Recipe(RecipeBase):
    """A recipe, as read from its TOML file."""

    surface: SurfacePart
    material: MaterialPart
    decision: DecisionPart = DecisionPart()
    area: AreaPart | None = AreaPart()
    uncertainty: RigUncertainty = RigUncertainty()
    light: LightPart | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        pairs = len(self.poses.tilts_deg) * (len(self.poses.angles_deg) - 1)
        tolerance = self.decision.tolerance
        if isinstance(tolerance, tuple) and len(tolerance) != pairs:
            raise ValueError(f"decision.tolerance lists {len(tolerance)} values for {pairs} pairs of angles")
        pitches, words = (1.0, "at least one tile") if self.is_wafer else (2.0, "at least two pitches")
        smallest_mm = pitches * self.surface.pitch_um / 1000.0
        if min(self.region.size_mm) < smallest_mm * (1.0 - 1e-9):
            raise ValueError(f"region.size_mm must span {words} ({smallest_mm:g} mm)")
        if self.is_wafer:
            self._check_wafer()
        return self

    def _check_wafer(self) -> None:
        if self.area is not None and "area" in self.model_fields_set:
            raise ValueError(
                "area compares cells along the flanks of ridges: leave [area] out for a wafer (material.reflectance)"
            )
        object.__setattr__(self, "area", None)  # the default is one for ridges
        if self.surface.height_map is None or self.surface.design is not None:
            raise ValueError(
                "surface: a wafer (material.reflectance) is compared with a height_map of the tile that repeats on it; "
                "`anisoscope design height` makes one of a design, a layout or a mask"
            )
        if self.surface.optics == "geometric":
            raise ValueError(
                'surface.optics: rays know nothing of level steps; take "auto" or "wave" for a wafer'
            )
        if (
            self.light is None
            or not max(self.light.lamp_half_angle_deg, self.light.aperture_half_angle_deg) > 0.0
        ):
            raise ValueError(
                "light: what a wafer shows depends on lamp and lens: give lamp_half_angle_deg and "
                "aperture_half_angle_deg, and wavelength_nm"
            )

    @property
    def is_wafer(self) -> bool:
        """The part is a mirror with steps, which waves only can predict."""
        return self.material.reflectance is not None

    def tolerances(self) -> tuple[float, ...] | None:
        """One tolerance a pair, or None."""
        tolerance = self.decision.tolerance
        if tolerance is None or isinstance(tolerance, tuple):
            return tolerance
        return (tolerance,) * (len(self.poses.tilts_deg) * (len(self.poses.angles_deg) - 1))

    def against(self, surface: Surface) -> "Recipe":
        """The recipe with one of its surfaces alone."""
        other = "design" if surface == "height_map" else "height_map"
        alone = self.surface.model_copy(update={other: None, "compare": None})
        return self.model_copy(update={"surface": alone})

    def deciding(self) -> "Recipe":
        """The recipe with the surface alone that decides."""
        return self.against(self.surface.decides) if self.surface.both else self


def is_print(path: Path) -> bool:
    """Is this the recipe of a print, with a [print] table? What is wrong with a file shows when it is read."""
    try:
        return "print" in tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return False


def check_poses(recipe: Recipe, light_angle_deg: float, path: Path | None = None) -> None:
    """Do light and camera stand above the part in every pose?

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig, between light and camera.
        path: of the recipe's file, for the message.

    Raises:
        RecipeError: in some pose one of them does not.
    """
    try:
        directions(recipe.poses.poses(), Convention(light_angle_deg))
    except ModelError as problem:
        file = "" if path is None else f"{path}: "
        raise RecipeError(
            f"{file}poses.tilts_deg: {problem}, with the light {light_angle_deg:g}° from the camera: tilt less"
        ) from None


def read_recipe(path: Path) -> Recipe:
    """Read a recipe; ``${here}`` in it stands for its own folder.

    Raises:
        RecipeError: the file is missing or wrong, or the recipe of a print; the message names file, key and what is
            expected.
    """
    if is_print(path):
        raise RecipeError(f"{path}: the recipe of a print; this works with recipes of surfaces only")
    recipe = read_toml_model(
        path, Recipe, error=RecipeError, substitutions={"here": str(path.resolve().parent)}
    )
    try:
        recipe.material.material()
    except ModelError as error:
        raise RecipeError(f"{path}: material: {error}") from None
    return recipe


APART = 3.0
"""Standard uncertainties of the recipe by which the two may differ."""


def check_lamp(recipe: Recipe, rig: RigFile, path: Path) -> None:
    """Compare the recipe's lamp and lens with those of the rig file; what either leaves out is not compared.

    Args:
        recipe: with ``[light]`` or without.
        rig: the rig.
        path: of the rig file, for the message.

    Raises:
        RigFileError: they differ by more than the recipe's uncertainties explain.
    """
    told = recipe.light
    if told is None:
        return
    pairs = (
        ("light.wavelength_nm", "nm", rig.light.wavelength_nm, told.wavelength_nm, told.u_wavelength_nm),
        (
            "light.bandwidth_nm",
            "nm",
            rig.light.bandwidth_nm,
            told.bandwidth_nm,
            told.u_bandwidth_share * told.bandwidth_nm,
        ),
        (
            "light.half_angle_deg",
            "°",
            rig.light.half_angle_deg,
            told.lamp_half_angle_deg,
            told.u_lamp_share * told.lamp_half_angle_deg,
        ),
        (
            "camera.half_angle_deg",
            "°",
            rig.camera.half_angle_deg,
            told.aperture_half_angle_deg,
            told.u_aperture_share * told.aperture_half_angle_deg,
        ),
    )
    for key, unit, has, meant, u in pairs:
        if has is not None and abs(has - meant) > APART * u + 1e-9 * abs(meant):
            space = "" if unit == "°" else " "
            raise RigFileError(
                f"{path}: {key} is {has:g}{space}{unit}, the recipe predicts for {meant:g} ± {u:g}{space}{unit} "
                "([light]): use the rig that the recipe is made for, or correct the one that is wrong"
            )
