"""A chunk of the study: parts that share one camera, photographed, measured and judged as by ``inspect``.

What can be told from radiances alone (significance, diagnosis) is told from what is kept, when the study is evaluated.
A chunk depends on the seed, the world, the class and its number alone; it is kept in a file, so that a study that was
cut off goes on where it stopped, and a larger one uses what a smaller one made.
"""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.atomicfile import write_bytes
from anisoscope.decision import Decision, decide
from anisoscope.errors import MeasurementError
from anisoscope.measurement import View, drift_complaint, measure
from anisoscope.study.detection_pictures import (
    new_cameras,
    photograph,
    radiance_of_part,
    views_of_series,
)
from anisoscope.study.detection_product import (
    BY_NAME,
    GOOD,
    RECIPES,
    RecipeName,
    Size,
    World,
    draw,
    expected_of,
    recipe_of,
)
from anisoscope.study.detection_sheets import FORMAT, SheetTask, cut, make_sheet, read_sheet, sheets_of

FloatArray = npt.NDArray[np.float64]
Row = dict[str, Any]

CAMERA = 2  # of chunks that are kept: another simulated camera makes other pictures
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
    """Which chunk: of which world and class, the how-manieth, how large, seeded how, kept where."""

    world: World
    kind: str
    number: int
    size: Size
    seed: int
    folder: Path
    bounces: tuple[float, ...]

    @property
    def path(self) -> Path:
        """Its file."""
        told = [
            FORMAT,
            CAMERA,
            self.world,
            self.kind,
            self.number,
            self.seed,
            asdict(self.size),
            self.bounces,
        ]
        key = hashlib.sha256(json.dumps(told).encode()).hexdigest()[:24]
        return self.folder / f"chunk-{key}.npz"

    @property
    def sheet(self) -> SheetTask:
        """The sheet that its parts are cut from."""
        local = self.kind in BY_NAME and BY_NAME[self.kind].local
        kind = self.kind if local else GOOD
        return SheetTask(
            self.world, kind, self.number % sheets_of(kind, self.size), self.size, self.seed, self.folder
        )


def inspect_chunk(task: ChunkTask) -> Path:
    """Make a chunk unless it is there; returns its file."""
    if not task.path.exists():
        _one_thread()
        columns = _columns([_flat(row) for row in _inspected(task)])
        stream = io.BytesIO()
        np.savez_compressed(stream, allow_pickle=False, **columns)
        write_bytes(task.path, stream.getvalue())
    return task.path


def _one_thread() -> None:
    """Chunks share the machine, not their kernels."""
    import cv2  # noqa: PLC0415
    import numba  # noqa: PLC0415

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def read_chunk(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Columns of a chunk, each (parts, …)."""
    with np.load(path, allow_pickle=False) as kept:
        return {name: kept[name] for name in kept.files}


def _columns(rows: list[dict[str, Any]]) -> dict[str, npt.NDArray[Any]]:
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
    make_sheet(task.sheet)
    sheet = read_sheet(task.sheet.path)
    worlds, kinds = ("same", "other"), (GOOD, *BY_NAME)
    entropy = [task.seed, worlds.index(task.world), kinds.index(task.kind), task.number]
    camera_rng, *parts = np.random.SeedSequence([7, *entropy]).spawn(1 + task.size.chunk)
    cameras = new_cameras(task.size, task.world, np.random.default_rng(camera_rng))
    kind = BY_NAME.get(task.kind)
    rows = []
    for child in parts:
        rng = np.random.default_rng(child)
        specimen, extent = draw(kind, len(views_of_series()), rng)
        where = cut(sheet, task.kind, task.size, rng)
        shown, truth = radiance_of_part(
            sheet.shown[:, *where], specimen, task.world, np.array(task.bounces or np.zeros(len(sheet.shown)))
        )
        views = photograph(shown, specimen, cameras, task.size, rng)
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
    """Everything that the study keeps of one part under one recipe.

    Args:
        views: of the whole series.
        truth: (V,) radiances that an ideal measurement finds.
        name: of the recipe.
        size: of the study.
    """
    recipe, expected = recipe_of(name, size), expected_of(name, size)
    poses = len(expected.poses)
    try:
        measured = measure(views[:poses], views[-1], recipe, expected, size.pixel_um)
        unfit = drift_complaint(measured, recipe) is not None
        decision = decide(expected, measured, recipe)
    except MeasurementError as error:
        return {**_nothing(poses), "reason": str(error)}
    deviation = np.log(measured.radiance / expected.radiance)
    own = np.array([c.relative for c in measured.components])
    assert tuple(c.source for c in measured.components) == MEASURED_SOURCES
    return {
        "valid": not unfit,
        "reason": "drift" if unfit else "",
        "deviation": deviation,
        "error": np.log(measured.radiance / truth[:poses]),
        "own": own,
        **_of_map(decision),
        **_of_means(decision),
    }


def _of_means(decision: Decision) -> Row:
    return {
        "p_means": decision.p_value,
        "pair_deviation": np.array([pair.deviation for pair in decision.pairs]),
        "pair_u": np.array([pair.u for pair in decision.pairs]),
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


def _nothing(poses: int) -> Row:
    """The row of a part that could not be judged."""
    nan = np.full(poses, np.nan)
    pairs = np.full(poses - poses // 3, np.nan)
    own = np.full((len(MEASURED_SOURCES), poses), np.nan)
    return {
        "valid": False, "reason": "", "deviation": nan, "error": nan, "own": own,
        "share": np.nan, "u_share": np.nan, "share_fails": False, "p_marks": np.nan, "mark_cells": 0,
        "mark_kind": "", "p_means": np.nan, "pair_deviation": pairs, "pair_u": pairs,
    }  # fmt: skip
