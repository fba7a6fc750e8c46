"""Signatures of causes: change of ln radiance of every pose, and of the share of deviating cells.

Each defect is applied to the recipe's surface in steps of its extent and predicted like the good surface
(`anisoscope.sim.light`); the difference of the two is its signature. Random defects have the same places in every step.
Defects that are uniform along the ridges of a design are computed on a profile fine enough for rounded edges.

Light that reflects more than once is that of the groove that the cause leaves: turned with the ridge angle, shortened
by wear and by incomplete filling, rougher with its facets; unchanged by local defects.
"""

import contextlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.causes import TAIL, Cause, all_causes, tail_cause
from anisoscope.diagnosis.cell_levels import U_SMEAR, USUAL_SMEAR, SmearedLevels
from anisoscope.diagnosis.tangents import Tangents, looked_at, slopes_of
from anisoscope.imaging.defect_regions import MarkForm, form_of
from anisoscope.imaging.deviation_map import CellScatter
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import nominal_shape, part_uncertainty
from anisoscope.prediction.height_map_uncertainty import best_band, relief_model
from anisoscope.prediction.reflections import (
    Followed,
    Groove,
    StandIn,
    added,
    groove_of_design,
    reflections_of_map,
)
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import LEAST_ANGLE_DEG, ridge_edges
from anisoscope.prediction.sensitivity import Model, Shape, State, Surface, evaluate, fixed
from anisoscope.profiles.defect_injection import COMPUTED_RIDGES
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.relief import Relief, radiance_maps, radiance_of_cells
from anisoscope.sim.light.threads import each
from anisoscope.sim.light.unresolved import resolve

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


ROWS_PITCHES = 8
POINTS_ACROSS, POINTS_ALONG = 50, 25  # a pitch
MAX_ROWS, MAX_COLS = 200, 1000
PER_CELL = (4, 2)
TABLE = 193
PROFILE_PITCHES = 6
PROFILE_PIXEL_UM = 0.34  # the largest ball that rolls along edges may have 60 points in its radius
PROFILE_POINTS = (50, 1500)  # a pitch, at least and at most
DOUBT_ON_MAPS = 0.3  # of changes at edges that lie between the points of a map
DOUBTFUL = 0.2
"""Doubt of a signature from which on it hides how differently the inputs act on the spoiled surface."""


@dataclass(frozen=True, eq=False)
class Signature:
    """Signature of one cause.

    Attributes:
        cause: the cause.
        extents: (S,) extents at which it was computed, ascending; those impossible on the surface are left out.
        change: (S, P) ln L − ln L of the good part.
        share: (S,) share of the cells of the contrast map that deviate, beyond those of the good part.
        tangents: response to the inputs of the prediction along the cause; None: as on the good part.
        levels: of the cells of the contrast map at every extent; None where no map was predicted.
        forms: (S, 3) `MarkForm.in_line`, ``along`` and ``aligned`` of the deviating cells; NaN where none deviates,
            None without a map.
        u_share: (S,) standard uncertainty of the share, by the number of marks and the smear of the picture; None
            before the scatter of its cells is known.
    """

    cause: Cause
    extents: FloatArray
    change: FloatArray
    share: FloatArray
    tangents: Tangents | None = None
    levels: tuple[SmearedLevels, ...] | None = None
    forms: FloatArray | None = None
    u_share: FloatArray | None = None

    @cached_property
    def _curve(self) -> "PchipInterpolator":
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - 0.3 s

        return PchipInterpolator(self.extents, np.column_stack([self.change, self.share]), axis=0)

    @property
    def complete(self) -> bool:
        """Whether fewer poses would leave nothing more to be known."""
        bends = self.tangents is not None or not _bends(self.cause)
        return bends and len(self.extents) == len(self.cause.extents)

    @cached_property
    def table(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(T,) finely spaced extents, with (T, P) changes and (T,) shares."""
        extents = np.unique(np.concatenate([np.linspace(*self.bounds, TABLE), self.extents]))
        return extents, *self.at(extents)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest extent."""
        return float(self.extents[0]), float(self.extents[-1])

    def at(self, extent: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """(…, P) change of ln L and (…,) share of deviating cells at extents between the bounds."""
        found = self._curve(np.clip(extent, *self.bounds))
        return found[..., :-1], found[..., -1]

    def form_at(self, extent: float | FloatArray) -> FloatArray:
        """(…, 3) form of the deviating cells at extents, linear between those computed; NaN where it is unknown."""
        at = np.asarray(extent, dtype=np.float64)
        if self.forms is None or not (known := np.isfinite(self.forms[:, 0])).any():
            return np.full((*at.shape, 3), np.nan)
        columns = [np.interp(at, self.extents[known], column[known]) for column in self.forms.T]
        return np.stack(columns, axis=-1)

    def share_scatter(self, extent: float | FloatArray) -> FloatArray:
        """(…,) variance of the share at extents, by the number of marks and the smear of the picture."""
        if self.u_share is None:
            return np.zeros_like(np.asarray(extent, dtype=np.float64))
        return np.asarray(np.interp(extent, self.extents, self.u_share) ** 2)

    def of(self, poses: Sequence[int]) -> "Signature":
        """Restrict the signature to selected poses."""
        tangents = self.tangents and self.tangents.of(poses)
        change = self.change[:, list(poses)]
        return replace(self, change=change, tangents=tangents, levels=None, forms=None, u_share=None)

    def by_scatter(
        self, good_share: float, scatter: CellScatter, smear: float, cells: int | None
    ) -> "Signature":
        """The same with the shares that the scatter of the cells of a part gives, beyond that of the good part."""
        if self.levels is None:
            return self
        found = [one.deviating(scatter, smear) for one in self.levels]
        sharper, softer = (
            np.array([one.deviating(scatter, (1.0 + step) * smear).share for one in self.levels])
            for step in (-U_SMEAR, U_SMEAR)
        )
        # marks are counted on this map, and once more on the part
        counted = np.array(
            [
                one.variance * (1.0 + (0.0 if cells is None else levels.cells / cells))
                for one, levels in zip(found, self.levels, strict=True)
            ]
        )
        return replace(
            self,
            share=np.array([max(one.share - good_share, 0.0) for one in found]),
            forms=_forms([one.form for one in found]),
            u_share=np.sqrt(counted + (0.5 * (sharper - softer)) ** 2),
        )

    def slope(self, extent: float) -> tuple[FloatArray, float]:
        """(P,) derivative of the change and derivative of the share with respect to the extent."""
        found = self._curve(np.clip(extent, *self.bounds), 1)
        return found[:-1], float(found[-1])


@dataclass(frozen=True, eq=False)
class Signatures:
    """The signatures of all causes for the poses of one recipe.

    Attributes:
        poses: P poses.
        radiance: (P,) of the good part in 1/sr, as this surface predicts it.
        share: share of cells that deviate on the good part.
        found: one a cause.
        left_out: causes impossible on this surface, with the reason.
        tail: signature of a lobe with another tail, which is no cause but a sign of another plastic; None if not
            computed.
        levels: of the cells of the good part; None where no map was predicted.
        scatter: of the cells of a height map by their own texture, without noise; None without a map, and for a
            design, which has no texture.
    """

    poses: tuple[Pose, ...]
    radiance: FloatArray
    share: float
    found: tuple[Signature, ...]
    left_out: tuple[tuple[str, str], ...]
    tail: Signature | None = None
    levels: SmearedLevels | None = None
    scatter: CellScatter | None = None

    def by_scatter(
        self, scatter: CellScatter | None, smear: float = USUAL_SMEAR, cells: int | None = None
    ) -> "Signatures":
        """The same with the shares that the scatter of the cells of a part gives.

        Args:
            scatter: of the good cells of the part.
            smear: standard deviation in pitches of what smears its pictures.
            cells: number of its cells, among which its marks are counted; None: infinitely many.
        """
        if self.levels is None or scatter is None:
            return self
        share = self.levels.deviating(scatter, smear).share
        found = tuple(one.by_scatter(share, scatter, smear, cells) for one in self.found)
        return replace(self, share=share, found=found)

    def of(self, poses: Sequence[int]) -> "Signatures":
        """Restrict the signatures to selected poses."""
        selected = list(poses)
        return replace(
            self,
            poses=tuple(self.poses[k] for k in selected),
            radiance=self.radiance[selected],
            found=tuple(one.of(selected) for one in self.found),
            tail=self.tail and self.tail.of(selected),
            levels=None,
        )


def signatures(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    advance: Advance = silent,
    names: Sequence[str] | None = None,
    known: Signatures | None = None,
) -> Signatures:
    """Compute the signatures of the causes for the poses of a recipe.

    Args:
        recipe: the recipe.
        light_angle_deg: angle between light and camera.
        advance: called when a cause is begun; causes are computed by several threads.
        names: causes to compute, "tail" for another tail of the lobe; all of them if None.
        known: of the same recipe with further poses; what they hold is not computed again.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
    """
    recipe = recipe.deciding()
    scene = _Scene(recipe, light_angle_deg)
    places = [] if known is None else [known.poses.index(pose) for pose in scene.poses]
    every = () if known is None else (*known.found, *([] if known.tail is None else [known.tail]))
    held = {one.cause.name: one for one in every if one.complete}
    good = scene.look(scene.surface, scene.state, scene.groove, with_map=True)
    causes = [cause for cause in causes_of(recipe) if names is None or cause.name in names]
    begun = itertools.count()

    def signature(cause: Cause) -> Signature:
        if cause.name in held:
            return _among(held[cause.name], places, good)
        return _signature(scene, cause, good)

    def signature_of(cause: Cause) -> Signature | str:
        advance(f"signature of {cause.name}", next(begun), len(causes))
        try:
            return signature(cause)
        except (HeightMapError, ModelError) as problem:
            return str(problem)

    computed = list(zip(causes, each(signature_of, causes), strict=True))
    found = tuple(one for _, one in computed if isinstance(one, Signature))
    left_out = tuple((cause.name, one) for cause, one in computed if isinstance(one, str))
    tail = None
    asked = names is None or TAIL in names
    if asked and recipe.material.material().second_lobe is None:
        with contextlib.suppress(HeightMapError, ModelError):
            tail = signature(tail_cause(recipe.material.material().tail))
    advance("signatures", len(causes), len(causes))
    share = 0.0 if good.share is None else good.share
    scatter = None if good.levels is None or scene.design is not None else good.scatter
    return Signatures(scene.poses, good.radiance, share, found, left_out, tail, good.levels, scatter)


def causes_of(recipe: SurfaceRecipe) -> tuple[Cause, ...]:
    """All causes considered for the part of a recipe."""
    design = recipe.surface.design
    return all_causes(None if design is None else design.ridge_angle_deg, recipe.surface.pitch_um)


def changes_at(
    recipe: SurfaceRecipe, light_angle_deg: float, extents: Mapping[str, float]
) -> dict[str, FloatArray]:
    """(P,) change of ln L by causes of given extents, without their signatures; those impossible are left out.

    Args:
        recipe: with the poses.
        light_angle_deg: angle between light and camera.
        extents: by name of the cause.

    Raises:
        HeightMapError: the recipe's height map cannot be read or used.
    """
    recipe = recipe.deciding()
    scene = _Scene(recipe, light_angle_deg)
    found = {}
    for cause in causes_of(recipe):
        if cause.name not in extents:
            continue
        one = replace(cause, extents=(0.0, extents[cause.name]))
        with contextlib.suppress(HeightMapError, ModelError):
            good = scene.look(scene.surface, scene.state, scene.groove, with_map=False)
            found[cause.name] = _signature(scene, one, good, bare=True).change[-1]
    return found


@dataclass(frozen=True, eq=False)
class _Look:
    """(P,) radiances of a surface, and share, levels and scatter of the cells of its map, if predicted."""

    radiance: FloatArray
    share: float | None = None
    levels: SmearedLevels | None = None
    scatter: CellScatter | None = None
    form: MarkForm | None = None


def _forms(found: Sequence[MarkForm | None]) -> FloatArray:
    """(S, 3) of forms; NaN for none."""
    return np.array(
        [3 * (np.nan,) if one is None else (one.in_line, one.along, one.aligned) for one in found]
    )


def _signature(scene: "_Scene", cause: Cause, good: _Look, *, bare: bool = False) -> Signature:
    """Signature of a cause; ``bare`` without the share of deviating cells and the response to the inputs."""
    profile = scene.profile if cause.extruded else None
    if profile is None and cause.defect is not None and cause.extruded and not cause.defect.turns_facets:
        cause = replace(cause, doubt=DOUBT_ON_MAPS)
    base = good if profile is None else _Look(scene.look_along(profile, scene.groove))
    with_map = not bare and cause.group in ("shape", "area")

    def seen(extent: float) -> _Look:
        if extent == 0.0:
            return base
        groove = scene.groove_with(cause, extent)
        if profile is not None:
            assert scene.design is not None
            return _Look(scene.look_along(scene.spoiled_profile(cause, scene.design, extent), groove))
        return scene.look(*cause.change(scene.surface, scene.state, extent), groove, with_map=with_map)

    looks = {extent: look for extent in cause.extents if np.all((look := seen(extent)).radiance > 0.0)}
    if len(looks) < 2:
        raise ModelError(f"{cause.name}: the part would be black in some pose at every extent")
    tangents = scene.tangents(cause, list(looks)) if _bends(cause) and not bare else None
    changes = [np.log(look.radiance / base.radiance) for look in looks.values()]
    own = good.share or 0.0
    shares = [max((own if look.share is None else look.share) - own, 0.0) for look in looks.values()]
    known = tuple(look.levels for look in looks.values() if look.levels is not None)
    levels = known if len(known) == len(looks) else None
    forms = _forms([look.form for look in looks.values()]) if with_map and profile is None else None
    extents = np.array(list(looks))
    return Signature(cause, extents, np.array(changes), np.array(shares), tangents, levels, forms)


def _bends(cause: Cause) -> bool:
    """Whether a signature says how differently the inputs act on the spoiled surface."""
    return (cause.doubt < DOUBTFUL or cause.extruded) and cause.name != TAIL


def _among(known: Signature, places: Sequence[int], good: _Look) -> Signature:
    """A signature for some of its poses, with the cells that deviate in these."""
    found = known.of(places)
    if known.levels is None:
        return replace(found, forms=known.forms)
    levels = tuple(one.of_poses(places) for one in known.levels)
    judged = [_judged(one) for one in levels]
    shares = np.array([max(share - (good.share or 0.0), 0.0) for share, _, _ in judged])
    return replace(found, share=shares, levels=levels, forms=_forms([form for _, _, form in judged]))


def _judged(levels: SmearedLevels) -> tuple[float, CellScatter, MarkForm | None]:
    """Share and form of the cells that deviate by the scatter of their own surface, and that scatter."""
    sharp = levels.each[0]
    scatter = CellScatter.of_texture(sharp.off)
    over = sharp.deviating(scatter)
    return float(np.mean(over)), scatter, form_of(over)


class _Scene:
    """The recipe's surface, cropped to a size that is quick to predict, under the rig's light and camera."""

    def __init__(self, recipe: SurfaceRecipe, light_angle_deg: float) -> None:
        self.poses = recipe.poses.poses()
        self.pitch_um = recipe.surface.pitch_um
        self.state = State(recipe.material.material(), light_angle_deg, shape=nominal_shape(recipe))
        self.azimuth_deg = recipe.poses.facet_azimuth_deg
        self.judges_area = recipe.area is not None
        self.design = None if recipe.surface.design is None else recipe.surface.ridge_design()
        self.turning = part_uncertainty(recipe).ridge_angle_deg > 0.0
        self.relief = (
            _measured(recipe)
            if self.design is None
            else Relief(_ideal(self.design), self.pitch_um, max_missing_share=1.0)
        )
        self.surface = self.relief.surface
        self.resolved = resolve(self.relief) if recipe.surface.roughness == "plastic" else None
        self.profile = None if self.design is None else _profile(self.design)
        self._slopes_of_good: dict[bool, FloatArray | None] = {}
        self._good_band = best_band(self.relief)
        self.groove, self._followed = self._reflections(recipe.surface.bounces)
        sides = directions(self.poses, Convention(light_angle_deg, facet_azimuth_deg=self.azimuth_deg))
        nominal = *sides, self._lobe(self.state.material)
        self._stand_in = None if self.groove is None else StandIn(self.groove, *nominal)
        self._constant = None if self._followed is None else self._followed.light(*nominal)

    def _reflections(self, bounces: int | None) -> tuple[Groove | None, Followed | None]:
        """The groove of the good surface, or paths on it where there is none."""
        if self.design is not None:
            return groove_of_design(self.design, bounces), None
        found = reflections_of_map(self.relief, bounces, ridge_edges(self.relief))
        return (None, found) if isinstance(found, Followed) else (found, None)

    def groove_with(self, cause: Cause, extent: float) -> Groove | None:
        """The groove that a cause leaves; local defects leave it as it is."""
        groove = self.groove
        if groove is None or extent == 0.0:
            return groove
        if cause.defect is None or cause.defect.groove is None:
            return groove
        changed: Groove = cause.defect.groove(groove, extent, self.pitch_um)
        return changed

    def _lobe(self, material: Material) -> Material:
        """The material of the facets: a plastic's without the slopes that the map resolves."""
        return material if self.resolved is None else self.resolved.lobe(material)

    def _with_reflections(self, direct: Model, groove: Groove | None) -> Model:
        """Predictor of the light that a surface and its groove reflect, as a function of the recipe's material."""
        model = direct
        if groove is not None:
            assert self._stand_in is not None
            model = added(direct, self._stand_in.of(groove))
        return lambda to_light, to_camera, material: model(to_light, to_camera, self._lobe(material))

    def look_along(self, profile: HeightMap, groove: Groove | None) -> FloatArray:
        """(P,) radiances of ridges that are uniform along their length."""
        convention = Convention(self.state.light_angle_deg, facet_azimuth_deg=self.azimuth_deg)
        model = self._with_reflections(self._along(profile), groove)
        return model(*directions(self.poses, convention), self.state.material)

    def _along(self, profile: HeightMap) -> Model:
        """Predictor of ridges that are uniform along their length, from the inner ones."""
        relief = Relief(profile, self.pitch_um)
        points = (profile.shape[1] - 1) // PROFILE_PITCHES
        inner = slice(points, (PROFILE_PITCHES - 1) * points)  # crests on both sides shadow them

        def predict(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
            maps = radiance_maps(relief, to_light, to_camera, material)
            return np.array([float(np.mean(view[:, inner], dtype=np.float64)) for view in maps])

        return predict

    def _band(self, surface: HeightMap) -> Model:
        """Predictor of the band of a surface that sensitivities need."""
        band = self._good_band if surface is self.surface else best_band(self._relief_of(surface))
        return relief_model(band)

    def _relief_of(self, surface: HeightMap) -> Relief:
        """A surface as the recipe's is prepared; the recipe's own is one object, which knows its slopes and shadows."""
        return self.relief if surface is self.surface else replace(self.relief, surface=surface)

    def tangents(self, cause: Cause, extents: Sequence[float]) -> Tangents | None:
        """Response to the inputs along a cause; None where they cannot be varied on the good part."""
        found = {extent: self._slopes(cause, extent) for extent in looked_at(extents)}
        known = {extent: slopes for extent, slopes in found.items() if slopes is not None}
        if 0.0 not in known or len(known) < 2:
            return None
        return Tangents(np.array(list(known)), np.array(list(known.values())))

    def _slopes(self, cause: Cause, extent: float) -> FloatArray | None:
        """Response to the inputs with a cause; that of the good part is computed once for all causes."""
        along = self._is_uniform(cause)
        if extent == 0.0 and along in self._slopes_of_good:
            return self._slopes_of_good[along]
        spoiled, state = self._spoiled(cause, extent)
        convention = Convention(self.state.light_angle_deg, facet_azimuth_deg=self.azimuth_deg)
        slopes = None
        with contextlib.suppress(ModelError):  # a step would lead below the horizon
            slopes = slopes_of(spoiled, state, self.poses, convention, turning=self.turning)
        if extent == 0.0:
            self._slopes_of_good[along] = slopes
        return slopes

    def spoiled_profile(self, cause: Cause, design: RidgeDesign, extent: float) -> HeightMap:
        """A profile of ridges with a cause that is uniform along them."""
        if cause.defect is not None and cause.defect.design is not None and extent > 0.0:
            with contextlib.suppress(HeightMapError):  # no ideal ridges have it to this extent
                return _profile(cause.defect.design(design, extent))
        return cause.change(_profile(design), self.state, extent)[0]

    def _is_uniform(self, cause: Cause) -> bool:
        """Whether a cause leaves the ridges of a design uniform along their length."""
        return self.profile is not None and (cause.extruded or cause.group in ("finish", "rig"))

    def _spoiled(self, cause: Cause, extent: float) -> tuple[Surface, State]:
        """Predictor of the surface with a cause as a function of the good shape, and its state."""
        along = self._is_uniform(cause)
        predictor = self._along if along else self._band
        surface, state = cause.change(self.surface, self.state, extent)
        if along:
            assert self.design is not None
            surface = self.spoiled_profile(cause, self.design, extent)
        groove = self.groove_with(cause, extent)
        nominal = self._with_reflections(predictor(surface), groove)

        def shaped(shape: Shape) -> Model:
            if self.design is None or shape == self.state.shape:
                return nominal
            turned = replace(self.design, ridge_angle_deg=shape.ridge_angle_deg)
            step = shape.ridge_angle_deg - self.state.shape.ridge_angle_deg
            steeper = groove and groove.turned(max(groove.design.ridge_angle_deg + step, LEAST_ANGLE_DEG))
            if along:
                steep = self.spoiled_profile(cause, turned, extent)
            else:
                steep = cause.change(_ideal(turned), self.state, extent)[0]
            return self._with_reflections(predictor(steep), steeper)

        return shaped, state

    def look(self, surface: HeightMap, state: State, groove: Groove | None, *, with_map: bool) -> _Look:
        """The surface in all poses, with its contrast map where the recipe has a limit of the area."""
        relief = self._relief_of(surface)
        convention = Convention(state.light_angle_deg, facet_azimuth_deg=self.azimuth_deg)
        if not with_map or not self.judges_area:
            model = fixed(self._with_reflections(relief_model(relief), groove))
            found = evaluate(model, [state], self.poses, convention)[0]
            return _Look(found if self._constant is None else found + self._constant)
        seat = seating_rotation(*state.seating_deg)
        to_light, to_camera = (side @ seat for side in directions(self.poses, convention))
        indirect = np.zeros(len(self.poses)) if self._constant is None else self._constant
        if groove is not None:
            assert self._stand_in is not None
            indirect = self._stand_in.of(groove)(to_light, to_camera, self._lobe(state.material))
        side, material = self.pitch_um / CELLS_PER_PITCH, self._lobe(state.material)
        fine = self._per_cell
        means, cells = radiance_of_cells(relief, to_light, to_camera, material, side / fine)
        levels = SmearedLevels.of(cells + indirect[:, None, None], fine)
        share, scatter, form = _judged(levels)
        return _Look(means + indirect, share, levels, scatter, form)

    @property
    def _per_cell(self) -> int:
        """Parts a side of a cell, each of at least two points of the surface."""
        least = 2.0 * max(self.relief.pixels_um)
        return next((n for n in PER_CELL if n * least <= self.pitch_um / CELLS_PER_PITCH), 1)


@lru_cache(maxsize=16)
def _profile(design: RidgeDesign) -> HeightMap:
    """Two rows of a design, a pitch apart so that no ball reaches from one to the other."""
    pitch = design.pitch_um
    points = int(np.clip(pitch / PROFILE_PIXEL_UM, *PROFILE_POINTS))
    shape = 2, PROFILE_PITCHES * points + 1
    return ridges(design, shape, (pitch, pitch / points))


@lru_cache(maxsize=16)  # one object for one design, so that the ridges of every cause are found once
def _ideal(design: RidgeDesign) -> HeightMap:
    pitch = design.pitch_um
    shape = ROWS_PITCHES * POINTS_ALONG + 1, COMPUTED_RIDGES * POINTS_ACROSS + 1
    return ridges(design, shape, (pitch / POINTS_ALONG, pitch / POINTS_ACROSS))


def _measured(recipe: SurfaceRecipe) -> Relief:
    part = recipe.surface
    assert part.height_map is not None
    try:
        written_ns = part.height_map.stat().st_mtime_ns
    except OSError:
        written_ns = 0  # the reader states what is wrong
    return _measured_map(part.height_map.resolve(), written_ns, part.pixel_um, part.role, part.pitch_um)


@lru_cache(maxsize=2)
def _measured_map(
    path: Path, _written_ns: int, pixel_um: tuple[float, float] | None, role: str, pitch_um: float
) -> Relief:
    """The map of a file, prepared and cropped: one object for one file, so that its ridges are measured once."""
    relief, _ = prepare_relief(read_height_map(path, pixel_um=pixel_um, role=role), pitch_um)
    cut = relief.surface.with_height(relief.surface.height_um[:MAX_ROWS, :MAX_COLS])
    return replace(relief, surface=cut, max_missing_share=1.0)
