"""Selection of ray or wave optics for a surface, and predictions under the selected model."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import POINT_LIKE, Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import best_band, relief_model
from anisoscope.prediction.monte_carlo import MonteCarlo, deviation
from anisoscope.prediction.predict import crest_contributions, with_indirect, with_uncertainty
from anisoscope.prediction.predicted import NEGLECTED_WAVES, Predicted
from anisoscope.prediction.reflections import (
    Followed,
    Groove,
    groove_of_design,
    reflections_note,
    reflections_of_map,
    sampled_with,
)
from anisoscope.prediction.relief_preparation import Levelling, prepare_relief
from anisoscope.prediction.ridge_edges import ridge_edges
from anisoscope.prediction.sensitivity import Contribution, Model, Shape, State, Surface, fixed
from anisoscope.prediction.wave import WavePredictor, design_surface, wave_surface, window_of
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light import corrected
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.material import fresnel
from anisoscope.sim.light.optics import through
from anisoscope.sim.light.wave.choice import (
    NUMERICAL_ERROR,
    SHARP_ERROR,
    OpticsChoice,
    choose_optics,
    effective_coherence_um,
)
from anisoscope.sim.light.wave.halfvectors import HalfVector, half_vector
from anisoscope.sim.light.wave.reflectance import radiance_scale
from anisoscope.sim.light.wave.surface import WaveSurface, on_plateaus, sampling_of
from anisoscope.sim.light.wave.windows import Window

if TYPE_CHECKING:
    from anisoscope.recipe.material_file import MaterialFile

MOST_TIMES = 24
"""Largest number of points that replace one without an option."""

OpticsModel = Literal["auto", "geometric", "wave", "both"]


@dataclass(frozen=True)
class OpticsRequest:
    """Requested optics.

    Attributes:
        model: "auto": what the surface needs; "geometric", "wave", or "both".
        light: the wavelengths, for the choice and for waves.
        interpolate: factor by which heights are interpolated for wave optics.
        bounces: reflections added to waves, by rays; None for all, 1 for direct light.
        steps: number of plateaus of a stepped map; they are found where it is not given.
    """

    model: OpticsModel = "auto"
    light: LightSpectrum = field(default_factory=LightSpectrum)
    interpolate: int = 1
    bounces: int | None = None
    steps: int | None = None


@dataclass(frozen=True)
class Rig:
    """Material, poses and rig of a prediction.

    Attributes:
        material: the plastic.
        poses: P poses.
        convention: how the angles are counted.
        optics: lamp and lens.
        inputs: uncertainties, or None.
        monte_carlo: draws, or None.
        file: the calibrated material, or None.
    """

    material: Material
    poses: tuple[Pose, ...]
    convention: Convention
    optics: Optics = POINT_LIKE
    inputs: InputUncertainty | None = None
    monte_carlo: MonteCarlo | None = None
    file: "MaterialFile | None" = None


def optics_for(surface: HeightMap | RidgeDesign, rig: Rig, request: OpticsRequest) -> OpticsChoice | None:
    """Optics that a surface needs under a rig; None where a map has missing points (rays only).

    Lamp, lens and the roughness of the plastic all reduce the coherence. Inspections use the same choice: it depends
    on nothing that is measured.
    """
    if isinstance(surface, RidgeDesign):
        # walls send no light to the camera, and as jumps they need no fine sampling
        facets = replace(surface, pitch_um=surface.facet_width_um, wall="vertical")
        pixel = min(0.125 * request.light.shortest_um, surface.pitch_um / 64.0)
        count = max(256, int(4.0 * facets.pitch_um / pixel))
        heights = WaveSurface.of(facets.profile(np.asarray((np.arange(count) + 0.5) * pixel)), pixel)
    elif surface.missing_share > 0.0:
        return None
    else:
        heights = _plateaus(wave_surface(surface), request).interpolated(request.interpolate)
    halves = _halves(rig)
    lowest = min(min(half.light_z, half.camera_z) for half in halves)
    slant = float(np.sqrt(1.0 / lowest**2 - 1.0))
    return choose_optics(heights, _window(rig), request.light, max(half.z for half in halves), slant)


def predict_with_optics(
    surface: HeightMap | RidgeDesign,
    geometric: Callable[[Advance], Predicted],
    rig: Rig,
    request: OpticsRequest,
    pitch_um: float | None = None,
    levelling: Levelling = "auto",
    on_progress: Advance = silent,
) -> tuple[Predicted, ...]:
    """One prediction, or a geometric and a wave one if both are requested; the notes of each state the choice.

    Args:
        surface: the map as read, or ideal ridges.
        geometric: makes the geometric prediction.
        rig: everything else that predictions need.
        request: the requested optics.
        pitch_um: as in `relief_preparation.prepare_relief`.
        levelling: as in `relief_preparation.prepare_relief`.
        on_progress: called at every step.

    Raises:
        HeightMapError: waves are requested by name, and the map has missing points or too coarse pixels.
        ModelError: waves are requested by name, with a lamp near the part.
    """
    choice = optics_for(surface, rig, request)
    model = ("geometric" if choice is None else choice.model) if request.model == "auto" else request.model
    rays = None if choice is None or choice.model != "wave" else by_rays_instead(choice, "rays are asked for")
    found = []
    if model in ("wave", "both"):
        try:
            found.append(_by_waves(surface, rig, request, pitch_um, levelling, on_progress))
        except (HeightMapError, ModelError) as problem:
            if request.model != "auto" or choice is None:
                raise
            rays, model = by_rays_instead(choice, problem), "geometric"
    if model in ("geometric", "both"):
        by_rays = geometric(on_progress)
        found.insert(0, by_rays if rays is None else _without_waves(by_rays, rays, rig, request))
    if model == "geometric" and rays is not None:
        choice = rays
    notes = optics_note(choice, request) | error_note(choice, rig, request)
    return tuple(replace(one, notes={**one.notes, "optics": notes}) for one in found)


def _without_waves(found: Predicted, choice: OpticsChoice, rig: Rig, request: OpticsRequest) -> Predicted:
    """A prediction by rays where waves apply: their neglect counts in u of every pose, and is noted."""
    bound = error_note(choice, rig, request)["stated_error_per_sr"]
    notes = {**found.notes, "neglected_waves_per_sr": bound}
    if found.budget is None or bound is None:
        return replace(found, notes=notes)
    u = np.full(len(found.poses), bound / np.sqrt(3.0))  # a bound, rectangular
    own = Contribution(NEGLECTED_WAVES, u, "independent", rectangular=True)
    budget = replace(found.budget, contributions=(*found.budget.contributions, own))
    drawn = found.drawn
    if drawn is not None and rig.monte_carlo is not None:
        rng = np.random.default_rng((rig.monte_carlo.seed, 1))
        drawn = replace(
            drawn, radiance=np.maximum(drawn.radiance + deviation(own, len(drawn.radiance), rng), 0.0)
        )
    return replace(found, notes=notes, budget=budget, drawn=drawn)


def by_rays_instead(choice: OpticsChoice, problem: Exception | str) -> OpticsChoice:
    """Choice of rays with a reason, where wave optics applies but is unavailable and was not requested by name."""
    reason = f"{choice.reason}; but waves cannot be had ({problem}): geometric, with an error"
    error = min(1.0, SHARP_ERROR * choice.coherence_um / choice.f_um)
    return replace(choice, model="geometric", reason=reason, stated_error=error)


def optics_note(choice: OpticsChoice | None, request: OpticsRequest) -> dict[str, Any]:
    """The choice of optics as plain data; lengths in µm, null for infinite ones."""
    note: dict[str, Any] = {"asked": request.model}
    if choice is None:
        return note | {
            "model": "geometric",
            "reason": "the map has missing points, and waves need all of them: geometric",
            "stated_error": None,
            "f_um": None,
            "coherence_um": None,
        }
    return note | {
        "model": choice.model,
        "reason": choice.reason,
        "stated_error": choice.stated_error,
        "f_um": _finite(choice.f_um),
        "coherence_um": _finite(choice.coherence_um),
        "wavelengths_nm": [1e3 * wavelength for wavelength in request.light.wavelengths_um],
    }


def error_note(choice: OpticsChoice | None, rig: Rig, request: OpticsRequest) -> dict[str, float | None]:
    """The stated error in 1/sr: its share of the middle of the brightest lobe, which holds in every pose.

    In a pose at the foot of a lobe the relative error may exceed the stated share: light diffracted out of a lobe falls
    off with the square of the angle, that scattered by roughness much faster.
    """
    if choice is None:
        return {"stated_error_per_sr": None}
    longest, window = request.light.longest_um, _window(rig)
    middles = []
    for half in _halves(rig):
        x, y = effective_coherence_um(window, longest, half.z)
        mirrored = float(fresnel(np.sqrt(np.asarray(half.square)), rig.material.index))
        middles.append(radiance_scale(half, longest) * x * y * mirrored)
    return {"stated_error_per_sr": _finite(choice.stated_error * max(middles))}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _halves(rig: Rig) -> tuple[HalfVector, ...]:
    pairs = zip(*directions(rig.poses, rig.convention), strict=True)
    return tuple(half_vector(to_light, to_camera) for to_light, to_camera in pairs)


def _window(rig: Rig) -> Window:
    to_light, to_camera = directions(rig.poses, rig.convention)
    rough = 0.5 * np.diag([rig.material.alpha_across**2, rig.material.alpha_along**2])
    return window_of(to_light[0], to_camera[0], replace(rig.optics, lamp_distance_mm=None), rough)


def _by_waves(
    surface: HeightMap | RidgeDesign,
    rig: Rig,
    request: OpticsRequest,
    pitch_um: float | None,
    levelling: Levelling,
    on_progress: Advance,
) -> Predicted:
    if rig.optics.lamp_distance_mm is not None:
        raise ModelError("waves need a lamp far away: leave --lamp-distance out, or take --model geometric")
    on_progress("waves", 0, 1)
    source: Groove | Followed | None
    nominal = State(rig.material, rig.convention.light_angle_deg)
    if isinstance(surface, RidgeDesign):
        of, source = _of_design(surface, rig, request), groove_of_design(surface, request.bounces)
        by_rays = design_by_rays(surface, rig)
        nominal = replace(nominal, shape=Shape(surface.ridge_angle_deg, surface.height_loss))
    else:
        of = fixed(_of_map(surface, rig, request, pitch_um, levelling))
        relief, _ = prepare_relief(surface, pitch_um, levelling)
        source = reflections_of_map(relief, request.bounces, ridge_edges(relief))
        by_rays = fixed(relief_model(best_band(relief), rig.optics))
    sides = *directions(rig.poses, rig.convention), rig.material
    direct = of(nominal.shape)(*sides)
    radiance, additional = with_indirect(direct, source, sides, rig.inputs, rig.optics)
    if isinstance(surface, RidgeDesign):
        additional += crest_contributions(
            surface,
            (rig.poses, rig.convention, rig.material),
            rig.optics,
            request.bounces,
            rig.inputs,
            radiance,
        )
    notes = reflections_note(source)

    def groove_of(shape: Shape) -> Groove:
        assert isinstance(source, Groove)
        if not isinstance(surface, RidgeDesign):
            return source
        return source.turned(shape.ridge_angle_deg).shortened(shape.height_loss)

    of, rays = (sampled_with(one, source, sides, rig.optics, groove_of) for one in (of, by_rays))
    found = Predicted(
        "wave", rig.convention, rig.poses, radiance, contrasts(rig.poses, radiance), notes=notes
    )
    on_progress("waves", 1, 1)
    return with_uncertainty(
        found,
        of,
        nominal,
        rig.inputs,
        rig.monte_carlo,
        (*_contributions(surface, rig, direct), *additional),
        on_progress,
        rays=rays,
        file=rig.file,
    )


def wave_model(
    surface: HeightMap | RidgeDesign,
    rig: Rig,
    request: OpticsRequest,
    pitch_um: float | None = None,
) -> Model:
    """The wave predictor of a fixed surface, without uncertainty; arguments as for `predict_with_optics`.

    Raises:
        HeightMapError: the map has missing points or too coarse pixels.
        ModelError: too many points would be needed.
    """
    if isinstance(surface, RidgeDesign):
        return _of_design(surface, rig, request)(Shape(surface.ridge_angle_deg, surface.height_loss))
    return _of_map(surface, rig, request, pitch_um, "auto")


def _contributions(
    surface: HeightMap | RidgeDesign, rig: Rig, radiance: FloatArray
) -> tuple[Contribution, ...]:
    if rig.inputs is None:
        return ()
    own = Contribution("numerical error of the wave model", NUMERICAL_ERROR * radiance, "independent")
    if isinstance(surface, RidgeDesign):
        return (own,)
    share = rig.inputs.height_map_share * radiance
    return own, Contribution("height map, overall", share, "independent")


def design_by_rays(design: RidgeDesign, rig: Rig) -> Surface:
    """Direct light of ideal ridges of any shape, by rays."""

    def shaped(shape: Shape) -> Model:
        ridges = replace(design, ridge_angle_deg=shape.ridge_angle_deg, height_loss=shape.height_loss)

        def direct(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
            return corrected.radiance(to_light, to_camera, ridges, material)

        return through(direct, rig.optics)

    return shaped


def _of_design(design: RidgeDesign, rig: Rig, request: OpticsRequest) -> Surface:
    by_rays = design_by_rays(design, rig)

    def shaped(shape: Shape) -> Model:
        ridges = replace(design, ridge_angle_deg=shape.ridge_angle_deg, height_loss=shape.height_loss)
        heights = design_surface(ridges, request.light)
        return WavePredictor(heights, by_rays(shape), rig.optics, request.light)

    nominal = Shape(design.ridge_angle_deg, design.height_loss)
    nominal_predictor = shaped(nominal)
    return lambda shape: nominal_predictor if shape == nominal else shaped(shape)


def _plateaus(heights: WaveSurface, request: OpticsRequest) -> WaveSurface:
    return on_plateaus(heights, request.light.shortest_um, request.steps)


def _of_map(
    surface: HeightMap,
    rig: Rig,
    request: OpticsRequest,
    pitch_um: float | None,
    levelling: Levelling,
) -> Model:
    if (
        _plateaus(wave_surface(surface), request).cells and levelling == "auto"
    ):  # missing points are refused here
        levelling = "none"
    relief, _ = prepare_relief(surface, pitch_um, levelling)
    if relief.turn_deg != 0.0 and rig.material.alpha_along != rig.material.alpha_across:
        raise HeightMapError(
            f"waves on ridges that run {relief.turn_deg:+.1f}° from the axes of the map's grid need a lobe as wide "
            "along as across: turn the map by `profile edit`, or take the geometric model"
        )
    level = relief.surface
    if relief.pitch_um is not None:
        width = int(level.shape[1] * level.pixel_x_um / relief.pitch_um) * relief.pitch_um
        cols = max(2, round(width / level.pixel_x_um))
        level = level.with_height(level.height_um[:, :cols])
    heights = _plateaus(wave_surface(level), request).interpolated(request.interpolate)
    halves = _halves(rig)
    sampling_of(heights, request.light.shortest_um, max(half.z for half in halves)).check()
    fine = fine_enough(heights, _window(rig), request.light, halves)
    on_grid = relief_model(replace(relief, turn_deg=0.0), rig.optics)
    predictor = WavePredictor(fine, on_grid, rig.optics, request.light)
    if relief.turn_deg == 0.0:
        return predictor

    def placed(to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        return predictor(relief.on_map(to_light), relief.on_map(to_camera), material)

    return placed


def fine_enough(
    surface: WaveSurface, window: Window, light: LightSpectrum, halves: tuple[HalfVector, ...]
) -> WaveSurface:
    """Heights interpolated until the pixels resolve every spatial frequency that the blur passes (no aliasing).

    Steps are not interpolated: their heights apply to whole pixels.

    Raises:
        HeightMapError: too coarse pixels, or too many points.
    """
    if surface.cells:
        return surface
    highest = max(half.z for half in halves)
    wide = max(window.half_width(light.shortest_um, highest))
    turned = max(abs(f) for half in halves for f in half.frequency(light.shortest_um))
    pixel = surface.pixel_x_um if surface.is_profile else max(surface.pixel_x_um, surface.pixel_y_um)
    times = max(1, int(np.ceil(2.0 * (wide + turned) * pixel)))
    if times > MOST_TIMES:
        raise HeightMapError(
            f"pixels of {pixel:g} µm are too coarse for waves on this plastic: they need {times} points in place of "
            f"one, at most {MOST_TIMES} are put by themselves: ask for more (--interpolate {times}), measure with "
            "smaller pixels, or take the geometric model"
        )
    return surface.interpolated(times)
