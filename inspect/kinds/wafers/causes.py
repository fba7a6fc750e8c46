"""Causes of a deviating etched wafer: their signatures, and the poses and lamps that discriminate between them.

Signatures come from wave optics on the recipe's tile. Etching too deep leaves a mean phase, and so a spike in the
mirror direction. Features too wide do so too, because the levels then have unequal areas; they also move the lobes.
A pattern that is turned is a cause as well; of several passes each by itself is too deep or too shallow, and its mask
shifted against the first one. Causes of plastic parts (burrs, wear, …) are not considered.

Further stage angles, further tilts, and the same poses under a second lamp are evaluated one by one. Etching a design
without a spike too deep or too shallow changes the radiance by the square of the error at the design's wavelength. With
an oblique half vector, or at another wavelength, the mean phase of the levels does not vanish, and the two differ.
Every option is weighted as `separability` weights the recipe's own poses: with all stated uncertainties, to second
order in every input by itself. The scale of a second lamp is free, because no reflectance is known there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import AnisoscopeError, ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.cause_model import CauseModel, Option
from anisoscope.diagnosis.cause_words import RIG_WORDS
from anisoscope.diagnosis.causes import Cause, all_causes
from anisoscope.diagnosis.separability import planned_covariance, separability
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.kinds.wafers.etched import EtchedPredictor, NearWidths
from anisoscope.kinds.wafers.lighting import moved_light, needed_reach, recipe_tile, recipe_wafer
from anisoscope.kinds.wafers.recipe import WaferRecipe, of_wafer
from anisoscope.kinds.wafers.states import DEPTH, EDGES, SCATTER, WIDTH, edges_u_nm, width_step_nm
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.expectation import Component, Expectation
from anisoscope.prediction.input_doubt import NEGLIGIBLE
from anisoscope.prediction.sensitivity import State, evaluate, fixed
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.sim.light.geometry import pose_grid
from anisoscope.sim.light.wave.choice import NUMERICAL_ERROR

DEPTHS_NM = (2.0, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0)
WIDTHS_NM = (50.0, 100.0, 150.0, 200.0, 275.0, 350.0, 500.0, 700.0, 900.0)
SCATTERED = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
ANGLES_DEG = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
TURNS_DEG = (1.0, 2.0, 4.0, 7.0, 12.0, 20.0, 30.0, 45.0, 60.0, 75.0, 83.0, 90.0)
SHIFTS_NM = (250.0, 500.0, 1000.0, 2000.0)
"""In whole pixels of the tile, at least one."""
DEEP_PASS, SHALLOW_PASS = "pass {number} etched too deep, by", "pass {number} etched too shallow, by"
SHIFTED = {"x": "mask {number} shifted along x, by", "y": "mask {number} shifted along y, by"}
_DOUBT_OF_DEPTH, _DOUBT_OF_WIDTH = 0.05, 0.1
"""Passes are not all off by the same, nor all edges; of one pass and straight edges these are generous."""


def wafer_causes(tile: Etched) -> tuple[Cause, ...]:
    """Every cause that is looked for on a wafer.

    Too deep and too shallow look alike where the design has no spike, and nearly so do too wide and too narrow: each is
    a cause of its own, so that a tie says so instead of an interval over both.

    Args:
        tile: of the recipe.
    """
    rig = [cause for cause in all_causes() if cause.group == "rig"]
    both = tuple(sorted((0.0, *ANGLES_DEG, *(-angle for angle in ANGLES_DEG))))
    deep, wide = "etching: time, gas or temperature of the passes", "etching or exposure: edges move sideways"
    return (
        _of("over-etch", "etched too deep, by", "nm", deep, DEPTHS_NM, _DOUBT_OF_DEPTH),
        _of("under-etch", "etched too shallow, by", "nm", deep, DEPTHS_NM, _DOUBT_OF_DEPTH),
        _of("width-bias", "etched features too wide, by", "nm", wide, WIDTHS_NM, _DOUBT_OF_WIDTH),
        _of("width-loss", "etched features too narrow, by", "nm", wide, WIDTHS_NM, _DOUBT_OF_WIDTH),
        *_of_passes(tile),
        replace(
            _of("turned", "pattern turned, by", "°", "loading: the wafer lies turned", (), 0.0),
            extents=(*(-turn for turn in reversed(TURNS_DEG)), 0.0, *TURNS_DEG),
        ),
        replace(
            _of(
                "scatter",
                "scattered light, share added",
                "",
                "handling: dirt, film, scratches",
                SCATTERED,
                0.1,
            ),
            group="finish",
        ),
        *(replace(cause, extents=both) for cause in rig),
    )


def _of_passes(tile: Etched) -> list[Cause]:
    """Of several passes: every one by itself too deep or too shallow, and the masks after the first one shifted."""
    count, pixel_nm = len(tile.passes_um), 1e3 * tile.pixel_um
    if count == 1:
        return []
    steps = sorted({max(round(shift / pixel_nm), 1) * pixel_nm for shift in SHIFTS_NM})
    shifts = (*(-one for one in reversed(steps)), 0.0, *steps)
    etching, overlay = "etching: time, gas or temperature of this pass", "exposure: overlay of the masks"
    found = []
    for number in range(1, count + 1):
        for name, title in (("deep-pass", DEEP_PASS), ("shallow-pass", SHALLOW_PASS)):
            called = title.format(number=number)
            found.append(_of(f"{name}-{number}", called, "nm", etching, DEPTHS_NM, _DOUBT_OF_DEPTH))
        for axis, title in SHIFTED.items() if number > 1 else ():
            one = _of(
                f"mask-{axis}-{number}", title.format(number=number), "nm", overlay, (), _DOUBT_OF_WIDTH
            )
            found.append(replace(one, extents=shifts))
    return found


def _of(name: str, title: str, unit: str, explains: str, extents: tuple[float, ...], doubt: float) -> Cause:
    return Cause(name, title, unit, "shape", explains, (0.0, *extents), _not_on_maps, doubt)


def _not_on_maps(_surface: HeightMap, _state: State, extent: float) -> tuple[HeightMap, State]:
    raise ModelError(f"a change of {extent:g} on a wafer is made of its tile, not of a height map")


def _scattering(wafer: EtchedPredictor, state: State, extent: float) -> tuple[EtchedPredictor, State]:
    albedo = min(1.0, state.material.albedo + extent)
    return wafer, replace(state, material=replace(state.material, albedo=albedo))


def spoiled(
    cause: Cause, wafer: EtchedPredictor, state: State, extent: float, surface: HeightMap
) -> tuple[EtchedPredictor, State]:
    """A wafer with a cause of this extent, and the state of scatter, lamp and seat; ``surface`` is its height map."""
    if cause.name == "scatter":
        return _scattering(wafer, state, extent)
    if cause.name == "turned":
        return wafer, replace(state, stage_deg=state.stage_deg + extent)
    if cause.group == "shape":
        name, _, number = cause.name.rpartition("-")
        made = _CHANGES[name if number.isdecimal() else cause.name]
        return made(wafer, extent, int(number) - 1 if number.isdecimal() else 0), state
    return wafer, cause.change(surface, state, extent)[1]


_CHANGES: dict[str, Callable[[EtchedPredictor, float, int], EtchedPredictor]] = {
    "over-etch": lambda wafer, nm, _: wafer.with_depths(nm),
    "under-etch": lambda wafer, nm, _: wafer.with_depths(-nm),
    "width-bias": lambda wafer, nm, _: wafer.with_widths(nm),
    "width-loss": lambda wafer, nm, _: wafer.with_widths(-nm),
    "deep-pass": lambda wafer, nm, number: replace(wafer, tile=wafer.tile.pass_deeper(number, 1e-3 * nm)),
    "shallow-pass": lambda wafer, nm, number: replace(wafer, tile=wafer.tile.pass_deeper(number, -1e-3 * nm)),
    "mask-x": lambda wafer, nm, number: wafer.with_pattern(wafer.tile.mask_shifted(number, 1e-3 * nm, 0.0)),
    "mask-y": lambda wafer, nm, number: wafer.with_pattern(wafer.tile.mask_shifted(number, 0.0, 1e-3 * nm)),
}
"""By name, without the number of the pass: wafer, extent and number of the pass."""


def wafer_signatures(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    advance: Advance = silent,
    names: Sequence[str] | None = None,
) -> Signatures:
    """Compute what every cause would change; arguments as for `diagnosis.signatures.signatures`.

    Raises:
        HeightMapError, RecipeError: the recipe's tile cannot be read or used.
    """
    wafer, surface = recipe_wafer(of_wafer(recipe), light_angle_deg)
    poses = recipe.poses.poses()
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)
    state = State(recipe.material.material(), light_angle_deg)
    good = evaluate(fixed(wafer), [state], poses, convention)[0]
    causes = [cause for cause in wafer_causes(wafer.tile) if names is None or cause.name in names]
    found, left_out = [], []
    for number, cause in enumerate(causes):
        advance(f"signature of {cause.name}", number, len(causes))
        extents, changes = [], []
        try:
            for extent in cause.extents:
                changed, moved = spoiled(cause, wafer, state, extent, surface)
                changed_radiance = (
                    good if extent == 0.0 else evaluate(fixed(changed), [moved], poses, convention)[0]
                )
                extents.append(extent)
                changes.append(np.log(changed_radiance / good))
        except AnisoscopeError as problem:
            left_out.append((cause.name, str(problem)))
            continue
        found.append(Signature(cause, np.array(extents), np.array(changes), np.zeros(len(extents))))
    advance("signatures", len(causes), len(causes))
    return Signatures(poses, good, 0.0, tuple(found), tuple(left_out))


LogRadiance = Callable[[EtchedPredictor, State], FloatArray]

FURTHER_ANGLES_DEG = (45.0, 135.0, 270.0)
FURTHER_TILTS_DEG = (10.0, 20.0)
LAMPS_NM = (450.0, 470.0, 505.0, 530.0, 590.0, 625.0, 660.0)
"""Middle wavelengths of LEDs that are sold for such lamps."""
_APART = 0.05  # of the wavelength: a lamp that is nearer is no other one
_EACH_WAY = 2  # lamps on either side
_EVERY = 3  # of a cause's extents: a threshold need not be known better
FREE = 1.0
"""Standard uncertainty of ln of an unknown scale."""


@dataclass(frozen=True, eq=False)
class _Views:
    """Views of the wafer, under its own lamp or a second one. ``groups`` name the poses of each option."""

    lamps: tuple[tuple[float, tuple[Pose, ...]], ...]
    groups: tuple[tuple[str, str, tuple[int, ...]], ...]
    own: tuple[int, ...]

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All poses, lamp by lamp."""
        return tuple(pose for _, poses in self.lamps for pose in poses)


def wafer_options(
    recipe: SurfaceRecipe, light_angle_deg: float, names: Sequence[str], advance: Advance = silent
) -> tuple[Option, ...]:
    """Options that separate causes of a wafer, whatever their extents.

    Args:
        recipe: of a wafer.
        light_angle_deg: of the rig.
        names: the causes.
        advance: progress.

    Raises:
        HeightMapError, RecipeError: the recipe's tile cannot be read or used.
    """
    recipe = of_wafer(recipe)
    views = _views(recipe)
    wafer, surface = _wafer(recipe, light_angle_deg, views)
    state = State(recipe.material.material(), light_angle_deg)
    convention = Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg)

    def log_radiance(etched: EtchedPredictor, at: State) -> FloatArray:
        found = [
            evaluate(fixed(_under(etched, shift_nm)), [at], poses, convention)[0]
            for shift_nm, poses in views.lamps
        ]
        return np.asarray(np.log(np.concatenate(found)))

    good = log_radiance(wafer, state)
    advance("what would distinguish causes", 0, 1 + len(names))
    expected = _expected(recipe, views, wafer, state, log_radiance, good, convention)
    covariance = planned_covariance(recipe, expected)
    found = []
    for number, cause in enumerate(one for one in wafer_causes(wafer.tile) if one.name in names):
        advance("what would distinguish causes", 1 + number, 1 + len(names))
        found.append(_signature(cause, wafer, state, surface, log_radiance, good))
    known = Signatures(views.poses, np.exp(good), 0.0, tuple(found), ())
    advance("what would distinguish causes", 1 + len(names), 1 + len(names))
    options = []
    for kind, text, added in views.groups:
        chosen = [*views.own, *added]
        rows = separability(known.of(chosen), covariance[np.ix_(chosen, chosen)], with_map=False)
        options.append(Option(kind, text, {row.cause: row.separation_extents for row in rows}))
    return tuple(options)


def _views(recipe: WaferRecipe) -> _Views:
    """The recipe's poses, further poses under its own lamp, and its poses under every second lamp."""
    assert recipe.light is not None
    angles, tilts = recipe.poses.angles_deg, recipe.poses.tilts_deg
    own = recipe.poses.poses()
    further = tuple(angle for angle in FURTHER_ANGLES_DEG if angle not in angles)
    more = []
    if further:
        more.append(("angles", f"stage angles of {listed(further, '°')} besides", pose_grid(further, tilts)))
    more += [
        ("tilt", f"a tilt of {tilt:g}° besides", pose_grid(angles, (tilt,)))
        for tilt in FURTHER_TILTS_DEG
        if tilt not in tilts
    ]
    poses, groups = list(own), []
    for kind, text, added in more:
        groups.append((kind, text, tuple(range(len(poses), len(poses) + len(added)))))
        poses += added
    lamps = [(0.0, tuple(poses))]
    start = len(poses)
    for lamp in second_lamps(recipe.light.wavelength_nm):
        text = f"a second lamp of {lamp:g} nm with the same poses"
        groups.append(("lamp", text, tuple(range(start, start + len(own)))))
        lamps.append((lamp - recipe.light.wavelength_nm, own))
        start += len(own)
    return _Views(tuple(lamps), tuple(groups), tuple(range(len(own))))


def second_lamps(wavelength_nm: float) -> tuple[float, ...]:
    """Wavelengths of second lamps that are tried, the nearest first."""
    others = [lamp for lamp in LAMPS_NM if abs(lamp / wavelength_nm - 1.0) > _APART]
    below = sorted((lamp for lamp in others if lamp < wavelength_nm), reverse=True)[:_EACH_WAY]
    above = sorted(lamp for lamp in others if lamp > wavelength_nm)[:_EACH_WAY]
    return tuple(sorted((*below, *above), key=lambda lamp: abs(lamp - wavelength_nm)))


def _wafer(recipe: WaferRecipe, light_angle_deg: float, views: _Views) -> tuple[EtchedPredictor, HeightMap]:
    """The predictor, sampled for every direction and wavelength that is looked at."""
    assert recipe.light is not None
    tilts = tuple(sorted({pose.tilt_deg for pose in views.lamps[0][1]}))
    tilted = recipe.model_copy(update={"poses": recipe.poses.model_copy(update={"tilts_deg": tilts})})
    shortest = recipe.light.wavelength_nm + min(shift for shift, _ in views.lamps)
    lamp = recipe.light.model_copy(update={"wavelength_nm": shortest})
    reach = max(
        needed_reach(one, light_angle_deg) for one in (tilted, recipe.model_copy(update={"light": lamp}))
    )
    return recipe_wafer(recipe, light_angle_deg, reach)


def _under(wafer: EtchedPredictor, shift_nm: float) -> EtchedPredictor:
    """The same wafer, lens and size of the lamp, at another wavelength."""
    if shift_nm == 0.0:
        return wafer
    return wafer.under(replace(wafer.light, wavelength_nm=wafer.light.wavelength_nm + shift_nm))


def _signature(
    cause: Cause,
    wafer: EtchedPredictor,
    state: State,
    surface: HeightMap,
    log_radiance: LogRadiance,
    good: FloatArray,
) -> Signature:
    """Changes by a cause, at a third of its extents, both ends and 0 among them."""
    side = [extent for extent in cause.extents if extent > 0.0][::-1][::_EVERY]
    extents = sorted({0.0, *side, *(-extent for extent in side if -extent in cause.extents)})
    changes = [
        np.zeros_like(good)
        if extent == 0.0
        else log_radiance(*spoiled(cause, wafer, state, extent, surface)) - good
        for extent in extents
    ]
    return Signature(cause, np.array(extents), np.array(changes), np.zeros(len(extents)))


def _expected(
    recipe: WaferRecipe,
    views: _Views,
    wafer: EtchedPredictor,
    state: State,
    log_radiance: LogRadiance,
    good: FloatArray,
    convention: Convention,
) -> Expectation:
    """The prediction of all that is looked at, with what the recipe states as uncertain."""
    lamp_of = np.concatenate([np.full(len(poses), k) for k, (_, poses) in enumerate(views.lamps)])
    found = []
    for one in moved_inputs(recipe, wafer, state):
        down, up = log_radiance(*one.low) - good, log_radiance(*one.high) - good
        slope, bend = 0.5 * (up - down), one.square * 0.5 * (up + down)
        parts = [slope] if np.abs(bend).max() <= NEGLIGIBLE else [slope, bend]
        each = [lamp_of == k for k in range(len(views.lamps))]
        masks = each if one.of_lamp else [np.full(len(good), fill_value=True)]
        found += [
            Component(one.source, "prediction", part * mask, shared=True)
            for part in parts
            for mask in masks
            if np.any(part * mask)
        ]
    own = np.full(len(good), NUMERICAL_ERROR)
    found.append(Component("numerical error of the wave model", "prediction", own, shared=False))
    for k in range(1, len(views.lamps)):
        found.append(Component("scale of a second lamp", "measurement", FREE * (lamp_of == k), shared=True))
    step = max(recipe.uncertainty.stage_deg, 0.01)
    back, ahead = (log_radiance(wafer, replace(state, stage_deg=turn)) for turn in (-step, step))
    per_degree = (ahead - back) / (2.0 * step)
    return Expectation("wave", views.poses, np.exp(good), tuple(found), per_degree, None, convention)


def listed(values: Sequence[float], unit: str = "") -> str:
    """Numbers in a row, such as ``45°, 135° and 270°``."""
    texts = [f"{value:g}{unit}" for value in values]
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"


EtchedState = tuple[EtchedPredictor, State]
SQUARE = float(np.sqrt(2.0))
"""Standard deviation of the square of a normal z."""
SQUARE_OF_ETCHING = float(np.sqrt(3.0))
"""Its root mean square, which counts where a slope may vanish, as in the budget."""


@dataclass(frozen=True, eq=False)
class Moved:
    """One uncertain input.

    Attributes:
        source: its name.
        low: the wafer and its state one standard uncertainty below.
        high: above.
        square: what counts of the square of the input.
        of_lamp: every lamp has an error of its own.
    """

    source: str
    low: EtchedState
    high: EtchedState
    square: float = SQUARE
    of_lamp: bool = False


def moved_inputs(recipe: WaferRecipe, wafer: EtchedPredictor, state: State) -> tuple[Moved, ...]:
    """All inputs that the recipe states as uncertain.

    Args:
        recipe: of a wafer.
        wafer: its predictor.
        state: its nominal state.
    """
    assert recipe.light is not None
    stated, part = recipe.uncertainty, recipe.material
    moves: list[tuple[str, float, Callable[[float], EtchedState], float]] = [
        (
            DEPTH,
            stated.etch_depth_nm,
            lambda u: (wafer.with_depths(u), state),
            SQUARE_OF_ETCHING,
        ),
        (
            WIDTH,
            stated.etch_width_nm,
            lambda u: (wafer.with_widths(u), state),
            SQUARE_OF_ETCHING,
        ),
        (
            SCATTER,
            part.u_albedo,
            lambda u: (wafer, _with_scatter(state, u)),
            SQUARE,
        ),
        (
            "seating tilt about x",
            stated.seating_tilt_deg,
            lambda u: (wafer, replace(state, seating_deg=(u, 0.0))),
            SQUARE,
        ),
        (
            "seating tilt about y",
            stated.seating_tilt_deg,
            lambda u: (wafer, replace(state, seating_deg=(0.0, u))),
            SQUARE,
        ),
        ("zero of the tilt", stated.tilt_deg, lambda u: (wafer, replace(state, tilt_deg=u)), SQUARE),
        ("light angle", stated.light_angle_deg, lambda u: (wafer, _lit(state, u)), SQUARE),
    ]
    edges = edges_u_nm(recipe, wafer, state.light_angle_deg)
    if edges > 0.0:
        near = wafer.near_widths(width_step_nm(recipe))
        moves += [
            (name, edges, partial(_edged, near, phase, state), SQUARE_OF_ETCHING)
            for name, phase in zip(EDGES, (1.0, 1.0j), strict=True)
        ]
    found = [Moved(name, make(-u), make(u), square) for name, u, make, square in moves if u > 0.0]
    for name, low, high in moved_light(recipe.light, wafer.light):
        of_lamp = name != "aperture of the lens"
        found.append(Moved(name, (wafer.under(low), state), (wafer.under(high), state), of_lamp=of_lamp))
    return tuple(found)


def _edged(near: NearWidths, phase: complex, state: State, u_nm: float) -> EtchedState:
    return near(0.0, u_nm * phase), state


def _with_scatter(state: State, more: float) -> State:
    albedo = min(max(state.material.albedo + more, 0.0), 1.0)
    return replace(state, material=replace(state.material, albedo=albedo))


def _lit(state: State, more: float) -> State:
    return replace(state, light_angle_deg=state.light_angle_deg + more)


WAFER_CAUSES = CauseModel(
    lambda recipe: wafer_causes(recipe_tile(of_wafer(recipe))[0]), wafer_signatures, wafer_options
)

_EITHER_DEPTH = "Etch depth is off by about {size}; the sign cannot be told from these poses"
_EITHER_WIDTH = "Etched widths are off by about {size}; the sign cannot be told from these poses"
_EITHER_PASS = "Depth of pass {name} is off by about {size}; the sign cannot be told from these poses"
_OVERLAY = "Reject the wafer and measure the overlay of its masks: alignment of the exposure sets it"
_ETCH = "Reject the wafer and check time, gas and temperature of the etch passes against a step height"
_WIDTHS = "Reject the wafer and measure line widths: exposure dose, focus and sideways etching set them"
WAFER_WORDS: Mapping[str, CauseWords] = {
    "over-etch": CauseWords(
        "Etched about {size} too deep", _ETCH, opposite="under-etch", either=_EITHER_DEPTH
    ),
    "under-etch": CauseWords(
        "Etched about {size} too shallow", _ETCH, opposite="over-etch", either=_EITHER_DEPTH
    ),
    "width-bias": CauseWords(
        "Etched features are about {size} too wide", _WIDTHS, opposite="width-loss", either=_EITHER_WIDTH
    ),
    "width-loss": CauseWords(
        "Etched features are about {size} too narrow", _WIDTHS, opposite="width-bias", either=_EITHER_WIDTH
    ),
    "deep-pass": CauseWords(
        "Pass {name} is etched about {size} too deep", _ETCH, opposite="shallow-pass", either=_EITHER_PASS
    ),
    "shallow-pass": CauseWords(
        "Pass {name} is etched about {size} too shallow", _ETCH, opposite="deep-pass", either=_EITHER_PASS
    ),
    "mask-x": CauseWords("Mask {name} is shifted by about {size} along x", _OVERLAY),
    "mask-y": CauseWords("Mask {name} is shifted by about {size} along y", _OVERLAY),
    "turned": CauseWords(
        "The pattern is turned by 90°",
        "Do not reject: turn the wafer by 90° in its seat, and inspect it again",
    ),
    "scatter": CauseWords(
        "The wafer scatters about {size} more of the light than it should",
        "Clean the wafer and inspect it again; if it fails again, reject",
    ),
    **RIG_WORDS,
}
"""Causes of etched wafers in plain words."""
