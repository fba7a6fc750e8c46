"""A chunk of the study: parts that share one camera, photographed, measured, judged and diagnosed as by ``inspect``.

A chunk depends on the seed, the world, the class and its number alone; it is kept in a file, so that a study that was
cut off goes on where it stopped, and a larger one uses what a smaller one made.
"""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.atomicfile import write_bytes
from anisoscope.decision import Decision, decide
from anisoscope.diagnosis.diagnosing import Evidence, covariance_of, diagnose
from anisoscope.diagnosis.remembering import remembered_signatures
from anisoscope.diagnosis.signatures import Signatures, signatures
from anisoscope.errors import MeasurementError
from anisoscope.measurement import Measured, View, drift_complaint, measure
from anisoscope.study.detection_pictures import (
    new_cameras,
    photograph,
    radiance_of_part,
    views_of_series,
)
from anisoscope.study.detection_product import (
    BY_NAME,
    GOOD,
    LIGHT_DEG,
    RECIPES,
    DefectClass,
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

NO_CAUSE = ""
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
        told = [FORMAT, self.world, self.kind, self.number, self.seed, asdict(self.size), self.bounces]
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


@lru_cache(maxsize=8)
def signatures_of(name: RecipeName, size: Size) -> Signatures:
    """What every cause would change for the poses of a recipe."""
    recipe = recipe_of(name, size)
    if size.causes is None:
        return remembered_signatures(recipe, LIGHT_DEG)
    return signatures(recipe, LIGHT_DEG, names=size.causes)


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
    wanted = kind is not None or task.number < task.size.diagnosed_good
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
            row[name] = judge(views, truth, name, task.size, kind, wanted=wanted)
        rows.append(row)
    return rows


def judge(
    views: list[View],
    truth: FloatArray,
    name: RecipeName,
    size: Size,
    kind: DefectClass | None,
    *,
    wanted: bool,
) -> Row:
    """Everything that the study keeps of one part under one recipe.

    Args:
        views: of the whole series.
        truth: (V,) radiances that an ideal measurement finds.
        name: of the recipe.
        size: of the study.
        kind: what is wrong with the part, None for nothing.
        wanted: the part is diagnosed.
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
    row: Row = {
        "valid": not unfit,
        "reason": "drift" if unfit else "",
        "deviation": deviation,
        "error": np.log(measured.radiance / truth[:poses]),
        "own": own,
        "fails": decision.verdict == "FAIL",
        **_of_map(decision),
        **_of_means(decision),
    }
    return {**row, **_diagnosed(measured, decision, deviation, name, size, kind, wanted=wanted)}


def _of_means(decision: Decision) -> Row:
    return {
        "d2": decision.d2,
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


def _diagnosed(
    measured: Measured,
    decision: Decision,
    deviation: FloatArray,
    name: RecipeName,
    size: Size,
    kind: DefectClass | None,
    *,
    wanted: bool,
) -> Row:
    """First cause, its extent and uncertainty, and those of the cause that is truly there."""
    found: Row = {
        "first": NO_CAUSE, "second": NO_CAUSE, "tied": False, "right_extent": np.nan, "right_u": np.nan,
        "right_at_bound": False, "unexplained_p": np.nan,
    }  # fmt: skip
    if not wanted:
        return found
    expected = expected_of(name, size)
    scale = recipe_of(name, size).uncertainty.scale_share
    covariance = covariance_of(expected.components + measured.components, scale, len(deviation))
    assert decision.area is not None
    evidence = Evidence(deviation, covariance, decision.area.share, decision.area.u)
    told = diagnose(signatures_of(name, size), evidence)
    found["first"], found["second"] = (finding.cause for finding in told.findings[:2])
    found["unexplained_p"] = told.unexplained_p
    if kind is not None:
        right = next((finding for finding in told.findings if finding.cause == kind.cause), None)
        if right is not None:
            found.update(
                right_extent=right.extent,
                right_u=right.u,
                right_at_bound=right.at_bound,
                tied=right.tie,
            )
    return found


def _nothing(poses: int) -> Row:
    """The row of a part that could not be judged."""
    nan = np.full(poses, np.nan)
    pairs = np.full(poses - poses // 3, np.nan)
    own = np.full((len(MEASURED_SOURCES), poses), np.nan)
    return {
        "valid": False, "reason": "", "deviation": nan, "error": nan, "own": own, "fails": False,
        "share": np.nan, "u_share": np.nan, "share_fails": False, "p_marks": np.nan, "mark_cells": 0,
        "mark_kind": "", "d2": np.nan, "p_means": np.nan, "pair_deviation": pairs, "pair_u": pairs,
        "first": NO_CAUSE, "second": NO_CAUSE, "tied": False, "right_extent": np.nan, "right_u": np.nan,
        "right_at_bound": False, "unexplained_p": np.nan,
    }  # fmt: skip
