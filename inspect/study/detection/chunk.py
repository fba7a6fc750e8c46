"""Chunk of the study: parts that share one camera, photographed, measured and decided as by ``inspect``.

Quantities that follow from radiances alone (significance, diagnosis) are computed at evaluation, from the stored
radiances. A chunk depends only on the seed, the world, the class and its number. It is cached: an interrupted study
resumes, and a larger one reuses the chunks of a smaller one.

A part is cut from its sheet, gets its own shape, lobe, seating and lamp, and is photographed through lens and sensor.
A change that is uniform along the ridges acts on the radiance as on smooth ridges with the whole roughness in the lobe.
It is applied as the ratio of one profile in this state to the nominal one, column by column, exactly for every part. A
test compares this product with the radiance of the rough surface in that state.
"""

import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache, Entry
from anisoscope.base.errors import MeasurementError
from anisoscope.calibration.white_reference import make_reference
from anisoscope.decision.decision import Decision, decide
from anisoscope.imaging.linearisation import RadianceImage, Stack, WhiteReference, linearise, stack
from anisoscope.imaging.pose_radiance import drift_error, measure
from anisoscope.imaging.registration.placement import Placement, View
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import RidgeDesign, ridges
from anisoscope.rig.frame import Frame, FrameKind
from anisoscope.sim.bench.lamp import Lamp
from anisoscope.sim.bench.optics import image_of_surface, pixel_from_mm, vignette
from anisoscope.sim.bench.sensor import Sensor
from anisoscope.sim.light.geometry import Convention, Pose, directions, seating_rotation
from anisoscope.sim.light.relief import Relief, shine_maps
from anisoscope.sim.pathtracer.tracer import PathTracer
from anisoscope.study.detection.lobes import POINTS_A_PITCH, lobes_of, plastic_of, quick_shine
from anisoscope.study.detection.product import (
    BY_NAME,
    GOOD,
    LED_DISTANCE_MM,
    LIGHT_DEG,
    MARKER_ERROR_PX,
    NONLINEARITY,
    PITCH_UM,
    RECIPES,
    RIDGE_ANGLE_DEG,
    WORLDS,
    RecipeName,
    Size,
    Specimen,
    World,
    draw,
    expected_of,
    recipe_of,
)
from anisoscope.study.detection.sheets import (
    POINTS,
    SheetTask,
    cut,
    sheet_of,
    sheets_of,
)

Image = npt.NDArray[np.float32]

TILE = 0.99
TRACED_ROWS = 33
_FLAT_FRAMES = 16


@lru_cache(maxsize=1)
def views_of_series() -> tuple[Pose, ...]:
    """The poses of the tilted recipe, and the first of them once more at the end; the standard ones come first."""
    poses = expected_of("tilted", Size()).poses
    return (*poses, poses[0])


def _profile(specimen: Specimen) -> HeightMap:
    design = RidgeDesign(PITCH_UM, specimen.ridge_angle_deg, height_loss=specimen.height_loss)
    rows = 2 if specimen.wear_um == 0.0 else 5
    step = PITCH_UM / POINTS_A_PITCH
    surface = ridges(design, (rows, 3 * POINTS_A_PITCH + 1), (PITCH_UM / POINTS, step))
    return edge_wear(surface, specimen.wear_um) if specimen.wear_um > 0.0 else surface


def profile_radiance(specimen: Specimen, world: World, *, stage_errors: bool = True) -> FloatArray:
    """(V, POINTS) radiance over one pitch of the smooth ridges of a part in every view, 1/sr."""
    errors = specimen.stage_deg if stage_errors else np.zeros_like(specimen.stage_deg)
    poses = tuple(
        Pose(pose.stage_deg + float(error), pose.tilt_deg)
        for pose, error in zip(views_of_series(), errors, strict=True)
    )
    seat = seating_rotation(*specimen.seating_deg)
    sides = [side @ seat for side in directions(poses, Convention(specimen.light_deg))]
    material = specimen.plastic(lobes_of(world).smooth)
    material = replace(material, albedo=min(material.albedo, 0.99))
    middle = slice(POINTS_A_PITCH, 2 * POINTS_A_PITCH)  # the crests to both sides stand
    if WORLDS[world].traced:
        profile = _profile(specimen)
        # many equal rows: whether a cell is lit and seen says a random point of it
        middle_row = profile.height_um[len(profile.height_um) // 2]
        profile = profile.with_height(np.tile(middle_row, (TRACED_ROWS, 1)))
        tracer = PathTracer(profile, plastic_of(world, material), pitch_um=PITCH_UM, reflections=1)
        lines = [tracer.direct(light, camera).mean(axis=0) for light, camera in zip(*sides, strict=True)]
    else:
        shines = [quick_shine(light, camera, material) for light, camera in zip(*sides, strict=True)]
        radiance = list(shine_maps(Relief(_profile(specimen), PITCH_UM), shines))
        lines = [view[len(view) // 2] for view in radiance]
    return np.array([line[middle].reshape(POINTS, -1).mean(axis=1) for line in lines], dtype=np.float64)


def nominal(views: int | None = None) -> Specimen:
    """The part as designed on the rig as described."""
    count = len(views_of_series()) if views is None else views
    part = recipe_of("tilted", Size()).material
    zero = np.zeros(count)
    return Specimen(
        RIDGE_ANGLE_DEG, 0.0, 0.0, 1.0, 1.0, part.albedo, part.index, np.zeros(2), LIGHT_DEG,
        zero, zero + 1.0, 0.0, 0.0, np.zeros((count, 2)),
    )  # fmt: skip


@lru_cache(maxsize=8)
def _nominal_profile(world: World) -> FloatArray:
    return profile_radiance(nominal(), world)


@lru_cache(maxsize=8)
def _per_light_degree(world: World) -> FloatArray:
    """(V, POINTS) change of ln L per degree of light angle."""
    low, high = (
        profile_radiance(replace(nominal(), light_deg=LIGHT_DEG + off), world) for off in (-0.5, 0.5)
    )
    return np.asarray(np.log(np.maximum(high, 1e-9) / np.maximum(low, 1e-9)))


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
        self._rng = whole._rng  # noqa: SLF001 - it is the same sensor
        self._response = whole._response[rows, cols]  # noqa: SLF001
        self._offset_e = whole._offset_e[rows, cols]  # noqa: SLF001
        self._dark_e_s = whole._dark_e_s[rows, cols]  # noqa: SLF001


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
    shapes = {size.window(pose.stage_deg) for pose in views_of_series()}
    return {shape: _calibrated(whole, shape, size) for shape in sorted(shapes)}


def _calibrated(whole: Sensor, shape: tuple[int, int], size: Size) -> Camera:
    sensor = Window(whole, shape)
    shade = vignette(size.optics, whole.part)[_middle(shape, _whole(size))]
    acquisition = recipe_of("tilted", size).acquisition
    exposure = acquisition.exposure_s
    cosine = float(np.cos(np.radians(LIGHT_DEG)))
    dark_scene = np.zeros(shade.shape)
    tile = TILE / np.pi * cosine * shade * size.optics.electrons * exposure

    def frames(kind: FrameKind, signal: FloatArray, count: int) -> Stack:
        return stack(_frame(sensor, signal, exposure, kind) for _ in range(count))

    dark = frames("dark", dark_scene, acquisition.dark_frames)
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


def radiance_of_part(
    cut_out: npt.NDArray[np.float16], specimen: Specimen, world: World, bounces: FloatArray
) -> tuple[list[Image], FloatArray]:
    """The part's radiance in every view, and (V,) its mean without errors of the stage: the true value.

    Args:
        cut_out: (P, rows, cols) piece of a sheet.
        specimen: the part and its rig.
        world: which world.
        bounces: (P,) radiance of light that reflects more than once.
    """
    base = _nominal_profile(world)
    ratio = profile_radiance(specimen, world) / base
    ideal = profile_radiance(specimen, world, stage_errors=False) / base
    views, truth = [], []
    inner_rows, inner_cols = slice(POINTS // 2, -(POINTS // 2) or None), slice(POINTS // 2, None)
    for view in range(len(base)):
        pose = view if view < len(cut_out) else 0
        radiance = cut_out[pose].astype(np.float32)
        repeats = radiance.shape[1] // POINTS
        columns = radiance[inner_rows].mean(axis=0, dtype=np.float64).reshape(repeats, POINTS) * ideal[view]
        whole = columns.ravel()[inner_cols][: (repeats - 1) * POINTS]
        truth.append(float(whole.mean()) + bounces[pose])
        radiance *= np.tile(ratio[view].astype(np.float32), repeats)
        radiance += np.float32(bounces[pose])
        if WORLDS[world].near_lamp:
            radiance *= _near_led(view, radiance.shape, world)
        views.append(radiance)
    return views, np.array(truth)


@lru_cache(maxsize=32)
def _near_led(view: int, shape: tuple[int, int], world: World) -> Image:
    """(rows, cols) factor of a lamp that stands so near that its angle varies over the part."""
    pose = views_of_series()[view]
    step = PITCH_UM / 1000.0 / POINTS
    x = (np.arange(shape[1]) - (shape[1] - 1) / 2.0) * step
    y = (np.arange(shape[0]) - (shape[0] - 1) / 2.0) * step
    turn = np.radians(pose.stage_deg)
    toward = np.cos(turn) * x[None, :] - np.sin(turn) * y[:, None]  # mm toward the lamp, in the picture
    # a point nearer to the lamp sees it less aslant
    off_deg = -np.degrees(toward / LED_DISTANCE_MM)
    slope = np.tile(_per_light_degree(world)[view], shape[1] // POINTS)
    return np.asarray(np.exp(slope[None, :] * off_deg), dtype=np.float32)


def photograph(
    radiance: list[Image],
    specimen: Specimen,
    cameras: dict[tuple[int, int], Camera],
    size: Size,
    rng: np.random.Generator,
) -> list[View]:
    """All views of a part, linearised, with their placement: the true one plus the error of the marker fit.

    Args:
        radiance: radiance of the part in every view.
        specimen: the part and its rig.
        cameras: the camera, by window.
        size: of the study.
        rng: scatter of the lamp.
    """
    acquisition = recipe_of("tilted", size).acquisition
    optics = size.optics.model_copy(update={"lamp_drift_per_frame": specimen.drift})
    lamp = Lamp(optics, rng)
    lamp.level = 1.0
    step_um = PITCH_UM / POINTS
    found = []
    for view, pose in enumerate(views_of_series()):
        camera = cameras[size.window(pose.stage_deg)]
        part = camera.sensor.part
        angle = pose.stage_deg + float(specimen.stage_deg[view])
        picture, _ = image_of_surface(radiance[view], (step_um, step_um), optics, part, angle, pose.tilt_deg)
        light = (picture.astype(np.float64) + specimen.stray) * camera.shade * specimen.gain[view]
        light *= optics.electrons * acquisition.exposure_s
        frames = stack(
            _frame(
                camera.sensor,
                np.maximum(light * lamp.brightness(), 0.0),
                acquisition.exposure_s,
                "sample",
                pose,
            )
            for _ in range(acquisition.frames_per_pose)
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
    """Which chunk: world, class, number, size, seed, and the folder of its cache."""

    world: World
    kind: str
    number: int
    size: Size
    seed: int
    folder: Path | None
    bounces: tuple[float, ...]

    @property
    def entry(self) -> Entry:
        """Its place in the cache."""
        given = [self.world, self.kind, self.number, self.seed, asdict(self.size), self.bounces]
        return Cache(self.folder).entry("detection-chunks", given, __name__)

    @property
    def sheet(self) -> SheetTask:
        """The sheet that its parts are cut from."""
        local = self.kind in BY_NAME and BY_NAME[self.kind].local
        kind = self.kind if local else GOOD
        return SheetTask(
            self.world, kind, self.number % sheets_of(kind, self.size), self.size, self.seed, self.folder
        )


def inspect_chunk(task: ChunkTask) -> Columns:
    """Columns of a chunk, each (parts, …), computed unless cached."""
    return task.entry.result(lambda: _simulated_chunk(task), _packed, _unpacked)


def _simulated_chunk(task: ChunkTask) -> Columns:
    _one_thread()
    return _columns([_flat(row) for row in _inspected(task)])


def _packed(columns: Columns) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **columns)
    return stream.getvalue()


def _unpacked(content: bytes) -> Columns:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _one_thread() -> None:
    """Chunks share the machine, not their kernels."""
    import cv2  # noqa: PLC0415 - start-up time
    import numba  # noqa: PLC0415 - start-up time

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
    sheet = sheet_of(task.sheet)
    worlds, kinds = list(WORLDS), (GOOD, *BY_NAME)
    entropy = [task.seed, worlds.index(task.world), kinds.index(task.kind), task.number]
    camera_rng, *parts = np.random.SeedSequence([7, *entropy]).spawn(1 + task.size.chunk)
    cameras = new_cameras(task.size, task.world, np.random.default_rng(camera_rng))
    kind = BY_NAME.get(task.kind)
    rows = []
    for child in parts:
        rng = np.random.default_rng(child)
        specimen, extent = draw(kind, len(views_of_series()), rng)
        where = cut(sheet, task.kind, task.size, rng)
        radiance, truth = radiance_of_part(
            sheet.radiance[:, *where],
            specimen,
            task.world,
            np.array(task.bounces or np.zeros(len(sheet.radiance))),
        )
        views = photograph(radiance, specimen, cameras, task.size, rng)
        row: Row = {
            "extent": extent,
            "ridge_angle_deg": specimen.ridge_angle_deg,
            "along": np.log(specimen.along),
            "across": np.log(specimen.across),
            "albedo": specimen.albedo,
            "spoiled": float(sheet.spoiled[where].mean()),
        }
        for name in RECIPES:
            row[name] = judge(views, truth, name, task.size)
        rows.append(row)
    return rows


def judge(views: list[View], truth: FloatArray, name: RecipeName, size: Size) -> Row:
    """Stored results of one part under one recipe.

    Args:
        views: of the whole series.
        truth: (V,) radiances of an ideal measurement.
        name: of the recipe.
        size: of the study.
    """
    recipe, expected = recipe_of(name, size), expected_of(name, size)
    poses = len(expected.poses)
    try:
        measured = measure(views[:poses], views[-1], recipe, expected, size.pixel_um)
        invalid = drift_error(measured.drift, recipe.limits.drift) is not None
        decision = decide(expected, measured, recipe)
    except MeasurementError as error:
        return {**_invalid_row(poses), "reason": str(error)}
    deviation = np.log(measured.radiance / expected.radiance)
    own = np.array([c.relative for c in measured.components])
    assert tuple(c.source for c in measured.components) == MEASURED_SOURCES
    return {
        "valid": not invalid,
        "reason": "drift" if invalid else "",
        "deviation": deviation,
        "error": np.log(measured.radiance / truth[:poses]),
        "own": own,
        **_of_map(decision),
        **_of_means(decision),
    }


def _of_means(decision: Decision) -> Row:
    return {
        "p_means": decision.p_value,
        "pair_deviation": np.array([pair.deviation for pair in decision.contrasts]),
        "pair_u": np.array([pair.u for pair in decision.contrasts]),
    }


def _of_map(decision: Decision) -> Row:
    area, first = decision.area, next(iter(decision.regions), None)
    assert area is not None
    return {
        "share": area.share,
        "u_share": area.u,
        "share_fails": area.verdict == "FAIL",
        "p_marks": 1.0 if first is None else first.p_value,
        "mark_cells": max((region.cells for region in decision.regions), default=0),
        "mark_kind": "" if first is None else first.kind,
    }


def _invalid_row(poses: int) -> Row:
    """Row of a part with an INVALID measurement."""
    nan = np.full(poses, np.nan)
    pairs = np.full(poses - poses // 3, np.nan)
    own = np.full((len(MEASURED_SOURCES), poses), np.nan)
    return {
        "valid": False, "reason": "", "deviation": nan, "error": nan, "own": own,
        "share": np.nan, "u_share": np.nan, "share_fails": False, "p_marks": np.nan, "mark_cells": 0,
        "mark_kind": "", "p_means": np.nan, "pair_deviation": pairs, "pair_u": pairs,
    }  # fmt: skip
