"""Sheets: large rough surfaces of every kind of local defect, rendered once per pose, from which parts are cut.

A sheet holds the radiance of the nominal part in every view, with its roughness and local marks resolved. Cuts at
different positions give parts with different surfaces. Changes that are uniform along a ridge (angle, worn or missing
crests, roughness of the lobe, seating, lamp) are applied afterwards (`detection_study.chunk`).
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache, Entry
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.defects import burrs
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, shine_maps
from anisoscope.sim.pathtracer.tracer import PathTracer
from detection_study.lobes import lobes_of, plastic_of, quick_shine
from detection_study.product import (
    BURRS_ON_GOOD,
    BY_NAME,
    CLASSES,
    GOOD,
    LIGHT_DEG,
    PITCH_UM,
    RESOLVED_ALPHA,
    RIDGE_ANGLE_DEG,
    SEEN,
    WORLDS,
    Size,
    World,
    rendered_as,
)

POINTS = 25  # a pitch, each way, of what is kept; facets are half as wide
CORRELATION_UM = 8.0
CHANGED_UM = 0.05
PARTS_ACROSS, PARTS_ALONG = 2, 2
_PATHS = 1 << 16
_SETTINGS = {
    "burrs": ("burrs", "coverage"),
    "scratches": ("scratches", "density_per_mm2"),
    "missing-ridges": ("missing-ridges", "share"),
    "dust": ("dust", "density_per_mm2"),
}


@dataclass(frozen=True, eq=False)
class Sheet:
    """One rendered surface.

    Attributes:
        radiance: (P, rows, cols) radiance in 1/sr, single precision halved; row index rises with +y.
        spoiled: (rows, cols) True where a local defect changed the height.
    """

    radiance: npt.NDArray[np.float16]
    spoiled: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SheetTask:
    """Which sheet: world, class, number, size, seed, and the folder of its cache."""

    world: World
    kind: str
    number: int
    size: Size
    seed: int
    folder: Path | None = None

    @property
    def entry(self) -> Entry:
        """Its place in the cache."""
        given: list[object] = [rendered_as(self.world), self.kind, self.number, self.seed]
        given += [self.size.ridges, self.size.pitches, self.size.sheets]
        return Cache(self.folder).entry("detection-sheets", given, __name__)


def sheets_of(kind: str, size: Size) -> int:
    """Number of sheets of a class; shape defects are applied to the sheets of good parts."""
    return size.sheets if kind == GOOD else 1


def sheet_tasks(worlds: tuple[World, ...], size: Size, seed: int, folder: Path | None) -> list[SheetTask]:
    """All sheets that a study needs."""
    kinds = (GOOD, *(kind.name for kind in CLASSES if kind.local))
    return [
        SheetTask(world, kind, number, size, seed, folder)
        for world in dict.fromkeys(rendered_as(world) for world in worlds)
        for kind in kinds
        for number in range(sheets_of(kind, size))
    ]


def sheet_of(task: SheetTask) -> Sheet:
    """A sheet, rendered unless it is cached."""
    return task.entry.result(lambda: _rendered_sheet(task), _packed, _unpacked)


def prepare_sheet(task: SheetTask) -> None:
    """Render a sheet unless it is cached."""
    sheet_of(task)


def _rendered_sheet(task: SheetTask) -> Sheet:
    surface, spoiled = sheet_surface(task)
    radiance = np.stack([_reduced(view, 2) for view in _rendered(surface, task.world)])
    return Sheet(radiance.astype(np.float16), spoiled)


def _packed(sheet: Sheet) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, radiance=sheet.radiance, spoiled=sheet.spoiled)
    return stream.getvalue()


def _unpacked(content: bytes) -> Sheet:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return Sheet(stored["radiance"], stored["spoiled"])


def sheet_surface(task: SheetTask) -> tuple[HeightMap, npt.NDArray[np.bool_]]:
    """Surface, and the mask of a local defect on the stored points."""
    entropy = [task.seed, ("sheet", GOOD, *BY_NAME).index(task.kind), task.number]
    base, marks = (np.random.default_rng(child) for child in np.random.SeedSequence(entropy).spawn(2))
    across, along = task.size.ridges + 1, task.size.pitches + 1
    cols, rows = PARTS_ACROSS * across * 2 * POINTS + 1, PARTS_ALONG * along * POINTS + 1
    pixels = PITCH_UM / POINTS, PITCH_UM / POINTS / 2
    surface = ridges(RidgeDesign(PITCH_UM, RIDGE_ANGLE_DEG), (rows, cols), pixels)
    surface = add_facet_roughness(surface, RESOLVED_ALPHA, RESOLVED_ALPHA, CORRELATION_UM, base)
    number = sheets_of(GOOD, task.size)
    coverage = BURRS_ON_GOOD * ((task.number + 0.5) / number if task.kind == GOOD else 0.5)
    good = burrs(surface, coverage, pitch_um=PITCH_UM, rng=base).map
    if task.kind == GOOD:
        return good, np.zeros(((rows - 1), (cols - 1) // 2), dtype=np.bool_)
    bad = _spoiled(good, task, marks)
    changed = np.abs(bad.height_um - good.height_um) > CHANGED_UM
    return bad, _reduced(changed[:-1, :-1].astype(np.float32), 2) >= 0.5


def _spoiled(surface: HeightMap, task: SheetTask, rng: np.random.Generator) -> HeightMap:
    kind = BY_NAME[task.kind]
    values = {_SETTINGS[task.kind][1]: kind.extent}
    if task.kind != "missing-ridges":
        return inject_defect(surface, task.kind, rng, values=values)
    # as many as stated in every part, none in the margins: parts of this class are cut at whole parts only
    across = (task.size.ridges + 1) * 2 * POINTS
    height = surface.height_um.copy()
    half = POINTS  # the margin: half a pitch on either side
    for part in range(PARTS_ACROSS):
        inner = slice(part * across + half, (part + 1) * across - half + 1)
        block = HeightMap(height[:, inner], surface.pixel_x_um, surface.pixel_y_um, {})
        height[:, inner] = inject_defect(block, task.kind, rng, values=values).height_um
    return surface.with_height(height)


def _rendered(surface: HeightMap, world: World) -> list[npt.NDArray[np.float32]]:
    """Direct light of a surface in every pose: by the predictor's facets, or by the path tracer."""
    sides = directions(SEEN, Convention(LIGHT_DEG))
    material = lobes_of(world).textured
    if WORLDS[world].traced:
        tracer = PathTracer(surface, plastic_of(world, material), pitch_um=PITCH_UM, reflections=1)
        return [tracer.direct(light, camera) for light, camera in zip(*sides, strict=True)]
    shines = [quick_shine(light, camera, material) for light, camera in zip(*sides, strict=True)]
    return list(shine_maps(Relief(surface, PITCH_UM), shines))


def _reduced(values: npt.NDArray[np.float32], by: int) -> npt.NDArray[np.float32]:
    """(rows, cols/by) means along the rows."""
    return np.asarray(values.reshape(values.shape[0], -1, by).mean(axis=2), dtype=np.float32)


def cut(sheet: Sheet, kind: str, size: Size, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns of a part on its sheet: anywhere along the ridges, whole pitches across them."""
    rows, cols = (size.pitches + 1) * POINTS, (size.ridges + 1) * POINTS
    _, high, wide = sheet.radiance.shape
    row = int(rng.integers(high - rows + 1))
    step = cols if kind == "missing-ridges" else POINTS
    col = step * int(rng.integers((wide - cols) // step + 1))
    return slice(row, row + rows), slice(col, col + cols)


def bounces_of(which: tuple[World, str]) -> FloatArray:
    """(P,) radiance of light that reflects more than once on good parts or a local class in a traced world, 1/sr.

    Smooth over the picture: traced on a few ridges of the class. Their mesh cuts corners, so that only the ratio of two
    classes is used (`detection_study.chunk`).
    """
    world, kind = which
    sides = directions(SEEN, Convention(LIGHT_DEG))
    # the same piece of surface and the same paths for all, so that classes differ by their defect alone
    surface, _ = sheet_surface(SheetTask(world, GOOD, 0, Size(ridges=24, pitches=4, sheets=1), 1))
    material = lobes_of(world).textured
    if kind != GOOD:
        name, setting = _SETTINGS[kind]
        values = {setting: BY_NAME[kind].extent}
        surface = inject_defect(surface, name, np.random.default_rng(0), values=values)
    tracer = PathTracer(surface, plastic_of(world, material), pitch_um=PITCH_UM, paths=_PATHS)
    return np.array([tracer.indirect(light, camera).mean for light, camera in zip(*sides, strict=True)])
