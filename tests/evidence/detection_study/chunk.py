"""One rig of the study: its golden and judged parts, photographed and measured as by ``inspect``.

What follows from radiances alone (significance, diagnosis) is computed at evaluation, from the stored radiances. A rig
depends only on the seed, the world and its number. It is cached: an interrupted study resumes, and a larger one reuses
the rigs of a smaller one.

A part is cut from its sheet, gets its own shape, plastic and seating, and is photographed through the rig's lamp, lens
and sensor. A change that is uniform along the ridges acts on the radiance as on smooth ridges with the whole roughness
in the lobe. It is applied as the ratio of one profile in this state to the nominal one, column by column, from
polynomials (`detection_study.surrogate`). A test compares this product with the radiance of the rough
surface in that state.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache, Entry
from anisoscope.base.errors import MeasurementError, Saturated
from anisoscope.calibration.white_reference import make_reference
from anisoscope.imaging.defect_regions import MarkForm, form_of
from anisoscope.imaging.deviation_map import cell_map, judge_area
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference, linearise, stack
from anisoscope.imaging.pose_radiance import Measured, drift_error, measure
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.parameters.geometry import Pose
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.sim.bench.optics import Lamp, image_of_surface, pixel_from_mm, vignette
from anisoscope.sim.bench.sensor import Sensor
from detection_study.product import (
    BEND_MM,
    BY_NAME,
    CHOSEN,
    EXPOSURE_S,
    FRAMES,
    GOOD,
    LED_DISTANCE_MM,
    LIGHT_DEG,
    MARKER_ERROR_PX,
    NONLINEARITY,
    PITCH_UM,
    POSES,
    RECIPES,
    SEEN,
    VIEWS,
    WORLDS,
    RecipeName,
    RigState,
    Size,
    Specimen,
    World,
    draw,
    draw_batch,
    draw_rig,
    recipe_of,
    whole_expectation,
    whole_recipe,
)
from detection_study.sheets import (
    POINTS,
    SheetTask,
    cut,
    sheet_of,
    sheets_of,
)
from detection_study.surrogate import (
    UNITS,
    Surrogate,
    SurrogateTask,
    bases_of,
    state_of,
    surrogate_of,
)

Image = npt.NDArray[np.float32]
Bounces = tuple[tuple[str, tuple[float, ...]], ...]
"""Radiances in 1/sr of light that reflects more than once, by class; empty: local defects do not change it."""

TILE = 0.99
DARK = 1e-3
"""Radiance in 1/sr of a shadow."""
_FLAT_FRAMES, _DARK_FRAMES = 16, 8
SEATS, _LIGHT = [4, 5], 6  # of the state of a part
FRAME_NOISE, LAMP_NOISE = 0.0003, 0.0005
"""Relative noise of the mean of a pose by camera and photons, and by the flicker of the lamp, as pictures have it."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera that reads out a window of its sensor, with what was calibrated on it: dark frames, white reference."""

    sensor: Sensor
    shade: Image
    dark: Stack
    white: WhiteReference


class Window(Sensor):
    """The middle of a sensor: the same pixels, fewer of them.

    Args:
        whole: the sensor.
        shape: (rows, cols) of the window.
    """

    def __init__(self, whole: Sensor, shape: tuple[int, int]) -> None:
        rows, cols = _middle(shape, (whole.part.rows, whole.part.cols))
        self.part = whole.part.model_copy(update={"rows": shape[0], "cols": shape[1]})
        self._rng = whole._rng
        self._response = whole._response[rows, cols]
        self._offset_e = whole._offset_e[rows, cols]
        self._dark_e_s = whole._dark_e_s[rows, cols]


def _middle(shape: tuple[int, int], whole: tuple[int, int]) -> tuple[slice, slice]:
    rows, cols = (
        slice((big - small) // 2, (big + small) // 2) for small, big in zip(shape, whole, strict=True)
    )
    return rows, cols


def _whole(size: Size) -> tuple[int, int]:
    return size.sensor.rows, size.sensor.cols


def new_cameras(size: Size, world: World, rng: np.random.Generator) -> dict[tuple[int, int], Camera]:
    """One camera, by the shape of the window that it reads out; in some worlds it is not quite linear."""
    part = size.sensor
    if WORLDS[world].nonlinear:
        part = part.model_copy(update={"nonlinearity": NONLINEARITY})
    whole = Sensor(part, rng)
    shapes = {size.window(pose.stage_deg) for pose in VIEWS}
    return {shape: _calibrated(whole, shape, size) for shape in sorted(shapes)}


def _calibrated(whole: Sensor, shape: tuple[int, int], size: Size) -> Camera:
    sensor = Window(whole, shape)
    shade = vignette(size.optics, whole.part)[_middle(shape, _whole(size))]
    exposure = EXPOSURE_S
    cosine = float(np.cos(np.radians(LIGHT_DEG)))
    dark_scene = np.zeros(shade.shape)
    tile = TILE / np.pi * cosine * shade * size.optics.electrons * exposure

    def frames(kind: FrameKind, signal: FloatArray, count: int) -> Stack:
        return stack(_frame(sensor, signal, exposure, kind) for _ in range(count))

    dark = frames("dark", dark_scene, _DARK_FRAMES)
    reference = make_reference(
        frames("flat", np.asarray(tile, dtype=np.float64), _FLAT_FRAMES),
        frames("dark", dark_scene, _FLAT_FRAMES),
        reflectance=TILE,
        light_cosine=cosine,
        camera="virtual",
        full_scale=sensor.full_scale,
    )
    white = WhiteReference(reference["signal"], reference["meta"]["radiance"], "virtual", "", TILE, "")
    return Camera(sensor, shade, dark, white)


def _frame(
    sensor: Sensor, signal: FloatArray, exposure_s: float, kind: FrameKind, pose: Pose | None = None
) -> Frame:
    where = pose or Pose(0.0)
    counts = sensor.expose(signal, exposure_s, 1.0)
    return Frame(
        counts, kind, sensor.part.bit_depth, sensor.part.black_level, exposure_s, 1.0,
        where.stage_deg, where.stage_deg, where.tilt_deg, "", "virtual",
    )  # fmt: skip


@lru_cache(maxsize=32)
def _surrogate(task: SurrogateTask) -> Surrogate:
    return surrogate_of(task)


def radiance_of_part(
    cut_out: npt.NDArray[np.float16],
    specimen: Specimen,
    rig: RigState,
    extent: float,
    task: SurrogateTask,
    bounced: FloatArray | None,
) -> tuple[list[Image], FloatArray]:
    """The part's radiance in every view, and (V,) its mean without errors of the stage: the true value.

    Args:
        cut_out: (P, rows, cols) piece of a sheet.
        specimen: the part.
        rig: its rig.
        extent: of its defect.
        task: world and class, as for `surrogate_of`; the extent is put in here.
        bounced: (P,) factor of the local defects of its class on the light that reflects more than once; None: 1.
    """
    good = _surrogate(SurrogateTask(task.world, GOOD, 0.0, task.folder))
    base = extent if extent in bases_of(task.kind) else 0.0
    own = good if base == 0.0 else _surrogate(SurrogateTask(task.world, task.kind, base, task.folder))
    state = state_of(specimen, rig, base, task.kind if base else "")
    ideal = state.copy()
    ideal[:, -1] = 0.0
    usual = np.maximum(good.radiance(0.0 * state), DARK)
    ratio, true_ratio = own.radiance(state) / usual, own.radiance(ideal) / usual
    reflected = own.reflected(state)
    if bounced is not None:
        reflected = reflected * bounced[[*range(len(SEEN)), 0]]
    views, truth = [], []
    inner_rows, inner_cols = slice(POINTS // 2, -(POINTS // 2) or None), slice(POINTS // 2, None)
    for view in range(len(VIEWS)):
        pose = view if view < len(SEEN) else 0
        radiance = cut_out[pose].astype(np.float32)
        repeats = radiance.shape[1] // POINTS
        columns = radiance[inner_rows].mean(axis=0, dtype=np.float64).reshape(repeats, POINTS)
        columns = columns * true_ratio[view]
        whole = columns.ravel()[inner_cols][: (repeats - 1) * POINTS]
        more = float(reflected[view])
        truth.append(float(whole.mean()) + more)
        radiance *= np.tile(ratio[view].astype(np.float32), repeats)
        radiance += np.float32(more)
        if WORLDS[task.world].near_lamp:
            radiance *= _near_led(view, radiance.shape, good)
        views.append(radiance)
    return views, np.array(truth)


@lru_cache(maxsize=64)
def _near_led(view: int, shape: tuple[int, int], good: Surrogate) -> Image:
    """(rows, cols) factor of a lamp that stands so near that its angle varies over the part."""
    step = PITCH_UM / 1000.0 / POINTS
    x = (np.arange(shape[1]) - (shape[1] - 1) / 2.0) * step
    y = (np.arange(shape[0]) - (shape[0] - 1) / 2.0) * step
    turn = np.radians(VIEWS[view].stage_deg)
    toward = np.cos(turn) * x[None, :] - np.sin(turn) * y[:, None]  # mm toward the lamp, in the picture
    # a point nearer to the lamp sees it less aslant
    off_deg = -np.degrees(toward / LED_DISTANCE_MM)
    slope = np.where(good.dark[view], 0.0, good.direct[1 + _LIGHT, view] / UNITS[_LIGHT])
    slope = np.tile(slope, shape[1] // POINTS)
    return np.asarray(np.exp(slope[None, :] * off_deg), dtype=np.float32)


def photograph(
    radiance: list[Image],
    specimen: Specimen,
    rig: RigState,
    cameras: dict[tuple[int, int], Camera],
    size: Size,
    rng: np.random.Generator,
) -> list[View]:
    """All views of a part, linearised, with their placement: the true one plus the error of the marker fit.

    Args:
        radiance: radiance of the part in every view.
        specimen: the part.
        rig: its rig.
        cameras: the camera, by window.
        size: of the study.
        rng: scatter of the lamp.
    """
    optics = size.optics.model_copy(update={"lamp_drift_per_frame": specimen.drift})
    lamp = Lamp(optics, rng)
    lamp.level = 1.0
    step_um = PITCH_UM / POINTS
    found = []
    for view, pose in enumerate(VIEWS):
        camera = cameras[size.window(pose.stage_deg)]
        part = camera.sensor.part
        angle = pose.stage_deg + float(specimen.stage_deg[view])
        picture, _ = image_of_surface(radiance[view], (step_um, step_um), optics, part, angle, pose.tilt_deg)
        light = (picture.astype(np.float64) + rig.stray) * camera.shade
        light *= specimen.gain[view] * rig.linearity[view] * optics.electrons * EXPOSURE_S
        frames = stack(
            _frame(
                camera.sensor,
                np.maximum(light * lamp.brightness(), 0.0),
                EXPOSURE_S,
                "sample",
                pose,
            )
            for _ in range(FRAMES)
        )
        image: RadianceImage = linearise(frames, camera.dark, camera.white, camera.sensor.full_scale)
        matrix = pixel_from_mm(optics, part, angle, pose.tilt_deg)
        matrix[:, 2] += specimen.shift_px[view]
        top, left = (middle.start for middle in _middle((part.rows, part.cols), _whole(size)))
        axis = float(matrix[0, 2] + left), float(matrix[1, 2] + top)
        place = Placement(matrix, angle % 360.0, size.pixel_um, axis, MARKER_ERROR_PX, 4)
        found.append(View(pose.stage_deg, pose.tilt_deg, image, place))
    return found


Row = dict[str, Any]
Columns = dict[str, npt.NDArray[Any]]

MEASURED_SOURCES = (
    "noise of camera and photons",
    "flicker of the lamp",
    "flat field",
    "linearity of the camera",
    "drift of the lamp",
    "stray light",
    "stage angle",
    "registration",
)


@dataclass(frozen=True)
class ChunkTask:
    """Which rig.

    Attributes:
        world: the world.
        number: of the rig.
        size: of its parts.
        seed: of everything random.
        folder: of its cache.
        bounces: light of many reflections by class.
        pictured: its parts are photographed; otherwise only the means of their poses are computed.
    """

    world: World
    number: int
    size: Size
    seed: int
    folder: Path | None
    bounces: Bounces
    pictured: bool = True

    @property
    def entry(self) -> Entry:
        """Its place in the cache."""
        given = [self.world, self.number, self.seed, asdict(self.size), self.pictured]
        return Cache(self.folder).entry("detection-rigs", given, __name__)

    def sheet(self, kind: str) -> SheetTask:
        """The sheet that parts of a kind are cut from."""
        own = kind if kind in BY_NAME and BY_NAME[kind].local else GOOD
        return SheetTask(
            self.world, own, self.number % sheets_of(own, self.size), self.size, self.seed, self.folder
        )


def inspect_chunk(task: ChunkTask) -> Columns:
    """Columns of a rig, each (parts, …), golden parts first, computed unless cached."""
    return task.entry.result(lambda: _simulated_chunk(task), _packed, _unpacked)


def _simulated_chunk(task: ChunkTask) -> Columns:
    _one_thread()
    rows = _inspected(task) if task.pictured else _computed(task)
    return _columns([_flat(row) for row in rows])


def _packed(columns: Columns) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **columns)
    return stream.getvalue()


def _unpacked(content: bytes) -> Columns:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _one_thread() -> None:
    """Chunks share the machine, not their kernels."""
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _columns(rows: list[Row]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _flat(row: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            found.update(_flat(value, f"{before}{name}/"))
        else:
            found[before + name] = value
    return found


def _inspected(task: ChunkTask) -> list[Row]:
    size, roster = task.size, task.size.roster(pictured=True)
    entropy = [task.seed, list(WORLDS).index(task.world), task.number]
    rig_rng, *parts = np.random.SeedSequence([7, *entropy]).spawn(1 + len(roster))
    rng = np.random.default_rng(rig_rng)
    rig, cameras = draw_rig(rng), new_cameras(size, task.world, rng)
    batches = _batches(roster, rng)
    rows: list[Row] = []
    bounces = {kind: np.array(light) for kind, light in task.bounces}
    sheets = {kind: sheet_of(task.sheet(kind)) for kind, _, _ in roster}
    for (kind, batch, of_lot), child in zip(roster, parts, strict=True):
        sheet, bounced = sheets[kind], None
        if kind in bounces:  # 1 where so few paths were traced that none of them came back
            usual = bounces[GOOD]
            bounced = np.divide(bounces[kind], usual, out=np.ones_like(usual), where=usual > 0.0)
        rng = np.random.default_rng(child)
        specimen, extent = draw(BY_NAME.get(kind), rng, batches[batch], WORLDS[task.world].scatter)
        where = cut(sheet, kind, size, rng)
        own = SurrogateTask(task.world, kind, extent, task.folder)
        radiance, truth = radiance_of_part(sheet.radiance[:, *where], specimen, rig, extent, own, bounced)
        views = photograph(radiance, specimen, rig, cameras, size, rng)
        rows.append(
            _of_part(kind, task.number, batch, specimen, extent, of_lot=of_lot)
            | {"spoiled": float(sheet.spoiled[where].mean()), **judge(views, truth, size)}
        )
    return rows


def _batches(roster: Sequence[tuple[str, int, bool]], rng: np.random.Generator) -> list[FloatArray]:
    return [draw_batch(rng) for _ in range(1 + max(batch for _, batch, _ in roster))]


def _of_part(kind: str, rig: int, batch: int, part: Specimen, extent: float, *, of_lot: bool) -> Row:
    return {
        "kind": kind,
        "rig": rig,
        "batch": batch,
        "lot": of_lot,
        "extent": extent,
        "ridge_angle_deg": part.ridge_angle_deg,
        "across": np.log(part.across),
    }


def _mean_near_led(size: Size, good: Surrogate) -> FloatArray:
    """(V, POINTS) mean over the region of the factor of a near lamp, to second order."""
    turn = np.radians([pose.stage_deg for pose in VIEWS])
    half = 0.5 * PITCH_UM / 1000.0 * np.hypot(np.cos(turn) * size.ridges, np.sin(turn) * size.pitches)
    scatter = np.degrees(half / LED_DISTANCE_MM) / np.sqrt(3.0)
    slope = np.where(good.dark, 0.0, good.direct[1 + _LIGHT] / UNITS[_LIGHT])
    return np.asarray(1.0 + 0.5 * (slope * scatter[:, None]) ** 2)


def _computed(task: ChunkTask) -> list[Row]:
    """Rows of a rig whose parts have smooth ridges: the means of their poses, with the errors of a measurement.

    Errors of single frames are drawn as the components of the measurement state them; the rest is put in as in
    pictures. Local defects need pictures.
    """
    entropy = [task.seed, list(WORLDS).index(task.world), task.number]
    rng = np.random.default_rng(np.random.SeedSequence([13, *entropy]))
    rig, rows, roster = draw_rig(rng), [], task.size.roster(pictured=False)
    batches = _batches(roster, rng)
    uncertainty, expected = recipe_of("tilted", task.size).uncertainty, whole_expectation(task.size)
    full_well, electrons = task.size.sensor.full_well_e, task.size.optics.electrons * EXPOSURE_S
    places = _places(task.size) if WORLDS[task.world].curved else np.zeros((1, len(UNITS)))
    for kind, batch, of_lot in roster:
        part, extent = draw(BY_NAME.get(kind), rng, batches[batch], WORLDS[task.world].scatter)
        base = extent if extent in bases_of(kind) else 0.0
        own = _surrogate(SurrogateTask(task.world, kind if base else GOOD, base, task.folder))
        state = state_of(part, rig, base, kind if base else "")
        each = [own.radiance(one) + own.reflected(one)[:, None] for one in state + places[:, None]]
        light = np.mean(each, axis=0) + rig.stray
        if WORLDS[task.world].nonlinear:
            light *= 1.0 - NONLINEARITY * light * electrons / full_well
        if WORLDS[task.world].near_lamp:
            light *= _mean_near_led(task.size, own)
        seen = light.mean(axis=1) * part.gain * rig.linearity
        drift = abs(part.drift) * FRAMES * len(VIEWS)
        seen *= 1.0 + np.linspace(0.0, part.drift * FRAMES * len(VIEWS), len(VIEWS))
        seen *= 1.0 + np.hypot(FRAME_NOISE, LAMP_NOISE) * rng.standard_normal(len(VIEWS))
        radiance = seen[:-1]
        even = np.ones(len(SEEN))
        components = {
            "noise of camera and photons": FRAME_NOISE * even,
            "flicker of the lamp": LAMP_NOISE * even,
            "flat field": uncertainty.flat_share * even,
            "linearity of the camera": uncertainty.linearity_share * even,
            "drift of the lamp": drift / np.sqrt(12.0) * even,
            "stray light": uncertainty.stray_radiance / radiance,
            "stage angle": uncertainty.stage_deg * expected.per_degree,
            "registration": 0.0 * even,
        }
        rows.append(
            _of_part(kind, task.number, batch, part, extent, of_lot=of_lot)
            | {
                "spoiled": 0.0,
                "valid": True,
                "reason": "",
                "log_radiance": np.log(radiance),
                "error": np.full(len(SEEN), np.nan),
                "own": np.array([components[source] for source in MEASURED_SOURCES]),
                "areas": {name: _no_area(name) for name in RECIPES},
            }
        )
    return rows


def _places(size: Size) -> FloatArray:
    """(4, K) places of a bent part as seatings, of which the mean is that of the part (Gauss)."""
    ends = np.degrees(
        0.5 * PITCH_UM / 1000.0 / BEND_MM * np.array([size.pitches, size.ridges]) / np.sqrt(3.0)
    )
    found = np.zeros((4, len(UNITS)))
    found[:, SEATS] = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) * ends / UNITS[SEATS]
    return found


def judge(views: list[View], truth: FloatArray, size: Size) -> Row:
    """What is stored of one part: its radiances in all poses, and its area by every recipe.

    Args:
        views: of the whole series.
        truth: (V,) radiances of an ideal measurement.
        size: of the study.
    """
    recipe = whole_recipe(size)
    try:
        measured = measure(views[:-1], views[-1], recipe, whole_expectation(size), size.pixel_um)
        areas = {name: _area_of(measured, size, name) for name in RECIPES}
    except (MeasurementError, Saturated) as error:
        return _invalid_row(str(error))
    invalid = drift_error(measured.drift, recipe.limits.drift) is not None
    assert tuple(c.source for c in measured.components) == MEASURED_SOURCES
    return {
        "valid": not invalid,
        "reason": "drift" if invalid else "",
        "log_radiance": np.log(measured.radiance),
        "error": np.log(measured.radiance / truth[:-1]),
        "own": np.array([c.relative for c in measured.components]),
        "areas": areas,
    }


def _area_of(measured: Measured, size: Size, name: RecipeName) -> Row:
    recipe, chosen = recipe_of(name, size), list(CHOSEN[name])
    seen = replace(
        measured,
        radiance=measured.radiance[chosen],
        aligned=tuple(measured.aligned[k] for k in chosen),
        cells=measured.cells[chosen],
        cell_noise=measured.cell_noise[chosen],
    )
    area, over = judge_area(seen, cell_map(seen, recipe), recipe.area, recipe.decision.coverage)
    assert area is not None
    assert over is not None
    form = form_of(over) or MarkForm(0, 0.0, 0.0, 0.0)
    return {
        "share": area.share,
        "u_share": area.u,
        "cells": area.cells,
        "limit": area.limit,
        "covariance": np.array(area.cell_covariance),
        **asdict(form),
    }


def _no_area(name: RecipeName) -> Row:
    """The same of a part whose cells are not known."""
    poses = len(POSES[name])
    form = asdict(MarkForm(0, 0.0, 0.0, 0.0))
    unknown = {
        "share": np.nan,
        "u_share": np.nan,
        "limit": np.nan,
        "covariance": np.full((poses, poses), np.nan),
    }
    return {**unknown, "cells": 0, **form}


def _invalid_row(reason: str) -> Row:
    """Row of a part with an INVALID measurement."""
    nan = np.full(len(SEEN), np.nan)
    return {
        "valid": False,
        "reason": reason,
        "log_radiance": nan,
        "error": nan,
        "own": np.full((len(MEASURED_SOURCES), len(SEEN)), np.nan),
        "areas": {name: _no_area(name) for name in RECIPES},
    }
