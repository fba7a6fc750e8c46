"""Sheets of marks of drawn sizes on ridges of drawn designs: what `mark_classes` is fitted to, and what judges it.

    python tests/evidence/marks.py --fit 800         # writes inspect/imaging/data/mark-classes.json
    python tests/evidence/marks.py --judge 24        # the table of docs/evidence/marks.md
    python tests/evidence/marks.py --cells 4         # which cells of a mark are found

The fit sees the prediction's own light (`relief`). The judge is the path tracer, which shares nothing with it: sheets
drawn in the same way with other seeds, and parts with the defects of `inject_defect`, other code for other shapes.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from anisoscope.base.errors import MeasurementError
from anisoscope.base.parallel import for_each
from anisoscope.imaging.deviation_map import CellMap, cell_map
from anisoscope.imaging.mark_classes import (
    CELLS,
    TEXTURE,
    UNKNOWN,
    MarkClasses,
    classes_of,
    group_numbers,
    known_classes,
)
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness
from anisoscope.recipe.poses import PosesPart
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer
from detection_study.traced import Part, recipe_of

FILE = Path(__file__).parents[2] / "inspect" / "imaging" / "data" / "mark-classes.json"
NAMES = ("scratch", "burr", "missing ridge", "filled groove", "dust", "fibre", "weld line", TEXTURE)
NINE = tuple(Pose(angle, tilt) for tilt in (0.0, -10.0, 10.0) for angle in (0.0, 90.0, 180.0))
LOOKS = {"upright": range(3), "tilted": range(9)}
POINT_UM, PICTURE_UM, BLUR_UM, NOISE = 2.0, 4.0, 3.0, 0.005
LIGHT_DEG = 10.0
PITCHES = (64.0, 80.0, 96.0, 112.0, 128.0, 144.0)
"""Of whole points a cell."""
SHRINK = 20.0
"""Parts that the mean covariance of all kinds is worth in that of one."""
MANY = 0.3
"""Share of the sheets with many marks of one kind."""
JUDGED = {
    "10°, α 0.08, Beckmann": (10.0, 96.0, 0.08, "beckmann"),
    "15°, α 0.11, GGX": (15.0, 80.0, 0.11, "ggx"),
}


@dataclass(frozen=True, eq=False)
class Sheet:
    """A surface, and which mark every point belongs to.

    Attributes:
        surface: heights.
        number: (rows, cols) of the mark, from 1; 0 for none.
        kinds: of the marks, as numbers of `NAMES`.
        pitch_um: of the ridges.
    """

    surface: HeightMap
    number: np.ndarray
    kinds: tuple[int, ...]
    pitch_um: float


class _Draw:
    """Marks that are drawn into heights one after the other."""

    def __init__(self, rng: np.random.Generator, angle: float, pitch: float, lean: float = 0.1) -> None:
        self.rng, self.pitch, self.size = rng, pitch, (14.0 * pitch, 11.0 * pitch)
        cols, rows = (int(one / POINT_UM) // 2 * 2 + 1 for one in self.size)
        x = np.arange(cols) * POINT_UM - rng.random() * pitch
        design = RidgeDesign(pitch, angle + lean * rng.standard_normal())
        # a crest is one chord of the mesh: ridges are stretched from foot to foot, so that its slope stays
        self.ridge = np.floor((x + design.wall_width_um) / pitch).astype(int)
        self.groove = np.floor(x / pitch).astype(int)
        self.line = design.profile(x)
        for number in np.unique(self.ridge):
            own = np.radians(design.ridge_angle_deg + lean * rng.standard_normal())
            self.line[self.ridge == number] *= np.tan(own) / np.tan(np.radians(design.ridge_angle_deg))
        plain = HeightMap(np.tile(self.line, (rows, 1)), POINT_UM, POINT_UM, {"pitch_um": pitch})
        rms = rng.uniform(0.02, 0.04)
        self.surface = add_facet_roughness(plain, rms, rms, rng.uniform(6.0, 10.0), rng)
        self.z = self.surface.height_um.copy()
        self.number = np.zeros(self.z.shape, np.uint8)
        self.x, self.y = np.meshgrid(np.arange(cols) * POINT_UM, np.arange(rows) * POINT_UM)
        self.kinds: list[int] = []

    def put(self, where: np.ndarray, name: str) -> None:
        self.kinds.append(NAMES.index(name))
        self.number[where] = len(self.kinds)

    @staticmethod
    def at(numbers: np.ndarray, x: float) -> np.ndarray:
        return np.asarray(numbers == numbers[int(np.clip(x / POINT_UM, 0, len(numbers) - 1))])

    def turned(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        angle = self.rng.uniform(0.0, np.pi)
        right, up = self.x - x, self.y - y
        return right * np.cos(angle) + up * np.sin(angle), up * np.cos(angle) - right * np.sin(angle)

    def missing_ridge(self) -> None:
        rng, high = self.rng, self.size[1]
        chosen = self.ridge == rng.choice(np.unique(self.ridge)[2:-3])
        ends = [(0.0, high), (0.0, high * rng.uniform(0.2, 0.8)), (high * rng.uniform(0.2, 0.8), high)]
        low, top = ends[rng.choice(3, p=(0.5, 0.25, 0.25))]
        where = chosen[None, :] & (self.y >= low) & (self.y <= top)
        self.z[where] -= rng.uniform(0.4, 1.0) * np.tile(self.line - self.line.min(), (len(self.y), 1))[where]
        self.put(where, "missing ridge")

    def weld_line(self) -> None:
        rng, (wide, high) = self.rng, self.size
        turn, middle = rng.uniform(-0.5, 0.5), high * rng.uniform(0.2, 0.8)
        off = (self.y - middle) * np.cos(turn) + (self.x - 0.5 * wide) * np.sin(turn)
        self.z -= rng.uniform(1.5, 4.0) * np.exp(-(off**2) / 2.0 / rng.uniform(8.0, 18.0) ** 2)
        self.put(np.abs(off) < 30.0, "weld line")

    def scratch(self, x: float, y: float) -> None:
        rng = self.rng
        long, wide, deep = rng.uniform(50.0, 260.0), rng.uniform(3.0, 9.0), rng.uniform(1.0, 5.0)
        along, off = self.turned(x, y)
        top = self.line.max() - 2.0 * deep * (1.0 - np.abs(off) / wide)
        low = np.minimum(self.z, np.maximum(top, self.z - deep))
        cut = (np.abs(along) < long) & (np.abs(off) < wide) & (low < self.z - 0.05)
        self.z[cut] = low[cut]
        bank = (np.abs(along) < long) & (np.abs(off) >= wide) & (np.abs(off) < 1.6 * wide)
        bank &= self.z > self.line.max() - 2.0 * deep
        self.z[bank] += 0.3 * deep * rng.uniform(0.3, 1.0)
        self.put(cut | bank, "scratch")

    def burr(self, x: float, y: float) -> None:
        rng, own = self.rng, self.at(self.ridge, x)
        crest = self.x[0][own][np.argmax(self.line[own])] + rng.uniform(-6.0, 6.0)
        long, wide, high = rng.uniform(8.0, 50.0), rng.uniform(4.0, 14.0), rng.uniform(2.0, 8.0)
        square = ((self.y - y) / long) ** 2 + ((self.x - crest) / wide) ** 2
        where = square < 1.0
        self.z[where] += high * np.sqrt(1.0 - square[where])
        self.put(where, "burr")

    def fill(self, x: float, y: float) -> None:
        rng, own = self.rng, self.at(self.groove, x)
        long, low = rng.uniform(20.0, 150.0), self.line.min()
        level = low + rng.uniform(0.25, 0.9) * (self.line.max() - low)
        rim = long * (1.0 + 0.1 * np.sin(self.x / 7.0))
        where = own[None, :] & (np.abs(self.y - y) < rim) & (self.z < level)
        self.z[where] = level + 0.2 * np.sin(self.x[where] / 23.0 + self.y[where] / 31.0)
        self.put(where, "filled groove")

    def dust(self, x: float, y: float) -> None:
        radius = self.rng.uniform(3.0, 30.0)
        square = (self.x - x) ** 2 + (self.y - y) ** 2
        where = square < radius**2
        ball = np.median(self.z[where]) + np.sqrt(radius**2 - square[where]) * self.rng.uniform(0.6, 1.2)
        self.z[where] = np.maximum(self.z[where], ball)
        self.put(where, "dust")

    def fibre(self, x: float, y: float) -> None:
        rng, (along, off) = self.rng, self.turned(x, y)
        long, radius = rng.uniform(60.0, 400.0), rng.uniform(4.0, 10.0)
        off = off - rng.uniform(-40.0, 40.0) * np.sin(2.0 * along / long)
        where = (np.abs(off) < radius) & (np.abs(along) < long)
        self.z[where] = self.line.max() + radius + np.sqrt(radius**2 - off[where] ** 2)
        self.put(where, "fibre")


def sheet_of(rng: np.random.Generator, angle: float, pitch: float) -> Sheet:
    """A sheet with some of the marks, each in its own place, or with many of one kind."""
    draw = _Draw(rng, angle, pitch)
    wide, high = draw.size
    if rng.random() < MANY:
        kind = (draw.scratch, draw.burr, draw.dust)[rng.integers(3)]
        for _ in range(int(rng.integers(8, 60))):
            kind(wide * rng.random(), high * rng.random())
        return Sheet(draw.surface.with_height(draw.z), draw.number, tuple(draw.kinds), pitch)
    sites = [(wide * (k % 3 + 0.5) / 3.0, high * (k // 3 + 0.5) / 2.0) for k in range(6)]
    rng.shuffle(sites)
    if rng.random() < 0.6:
        draw.missing_ridge()
    if rng.random() < 0.4:
        draw.weld_line()
    one_each = (draw.scratch, draw.burr, draw.fill, draw.dust, draw.fibre)
    many = (*one_each, draw.scratch, draw.burr, draw.dust, draw.fill)
    for (x, y), kind in zip(sites, rng.permutation(len(many))[: int(rng.integers(3, 7))], strict=False):
        many[kind](x + rng.uniform(-0.4, 0.4) * pitch, y + rng.uniform(-0.6, 0.6) * pitch)
    return Sheet(draw.surface.with_height(draw.z), draw.number, tuple(draw.kinds), pitch)


PARTS = {
    "scratches": ("scratch", ("scratches", {"density_per_mm2": 11.7})),
    "burrs, 2 %": ("burr", ("burrs", {"coverage": 0.02})),
    "burrs, 5 %": ("burr", ("burrs", {"coverage": 0.05})),
    "dust": ("dust", ("dust", {"density_per_mm2": 40.0})),
}
"""Defects of the library: kind and values."""
CHANGED_UM = 0.2
"""Change of a height that makes a mark."""
Light = Callable[[Sheet, np.ndarray, np.ndarray], list[np.ndarray]]
"""Radiance maps of a surface for (P, 3) directions of light and camera."""


def by_prediction(rng: np.random.Generator, alpha: float) -> Light:
    """The prediction's light, with a drawn share from further reflections."""
    along, across = alpha * rng.uniform(0.8, 1.2, 2)
    material, share = Material(along, across, rng.uniform(0.05, 0.5), 1.5), rng.uniform(0.0, 0.06)

    def seen(sheet: Sheet, lights: np.ndarray, cameras: np.ndarray) -> list[np.ndarray]:
        views = radiance_maps(Relief(sheet.surface, sheet.pitch_um), lights, cameras, material)
        return [np.nan_to_num(one) + share * float(np.nanmean(one)) for one in views]

    return seen


def by_path_tracer(rng: np.random.Generator, alpha: float, lobe: str, seed: int) -> Light:
    """Traced light of up to three reflections."""
    along, across = alpha * (1.0 + 0.05 * rng.standard_normal(2))
    plastic = Plastic(along, across, rng.choice([0.1, 0.3]), 1.5, lobe)

    def seen(sheet: Sheet, lights: np.ndarray, cameras: np.ndarray) -> list[np.ndarray]:
        tracer = PathTracer(sheet.surface, plastic, reflections=3, paths=65536, seed=seed)
        return [tracer.radiance(*pair) for pair in zip(lights, cameras, strict=True)]

    return seen


def photographed(
    sheet: Sheet, light: Light, rng: np.random.Generator, look: range
) -> tuple[list[np.ndarray], np.ndarray]:
    """Pictures in some of the poses, and which mark a pixel shows."""
    rows, cols = (size // 2 * 2 for size in sheet.number.shape)
    pictures = []
    poses = [NINE[k] for k in look]
    for view in light(sheet, *directions(poses, Convention(LIGHT_DEG))):
        seen = cv2.GaussianBlur(np.asarray(view, dtype=np.float32), (0, 0), BLUR_UM / POINT_UM)[::-1]
        whole = np.ascontiguousarray(seen[:rows, :cols])
        size = whole.shape[1] // 2, whole.shape[0] // 2
        small = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
        pictures.append((small * (1.0 + NOISE * rng.standard_normal(small.shape))).astype(np.float32))
    high, wide = pictures[0].shape
    number = sheet.number[::-1][: 2 * high, : 2 * wide].reshape(high, 2, wide, 2).max(axis=(1, 3))
    return pictures, number


def _cropped(picture: np.ndarray, pitch_um: float) -> np.ndarray:
    """Without a pitch at every side, and of whole pitches."""
    pitch = round(pitch_um / PICTURE_UM)
    rows, cols = (size // pitch for size in picture.shape)
    return np.ascontiguousarray(picture[pitch : (rows - 1) * pitch, pitch : (cols - 1) * pitch])


def map_of(pictures: list[np.ndarray], angle: float, pitch_um: float, alpha: float, look: range) -> CellMap:
    """How the cells of a photographed sheet deviate."""
    seen = tuple(_cropped(pictures[k], pitch_um) for k in range(len(look)))
    per_cell = round(pitch_um / CELLS_PER_PITCH / PICTURE_UM)
    size = seen[0].shape[1] // per_cell, seen[0].shape[0] // per_cell
    cells = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in seen])
    measured = Measured(
        np.array([one.mean() for one in seen]), (), seen, cells.astype(np.float64),
        np.full(len(seen), 0.001), Grid((0.0, 0.0), PICTURE_UM / 1000.0, seen[0].shape, 0.0), None,
    )  # fmt: skip
    poses = PosesPart(stage_and_tilt_deg=tuple((NINE[k].stage_deg, NINE[k].tilt_deg) for k in look))
    recipe = recipe_of(angle, pitch_um, alpha).model_copy(update={"poses": poses})
    return cell_map(measured, recipe)


@dataclass(frozen=True, eq=False)
class Group:
    """A group of deviating cells: its numbers, its size, and its mark: kind and number; `TEXTURE` for none."""

    numbers: np.ndarray
    cells: int
    kind: int
    mark: int


def groups_of(cells: CellMap, number: np.ndarray, kinds: tuple[int, ...], pitch_um: float) -> list[Group]:
    """The groups of a map; those over marks of two kinds are left out."""
    count, labels = cv2.connectedComponents(cells.deviating().astype(np.uint8), connectivity=8)
    if count == 1:
        return []
    found = group_numbers(labels, count, cells.score, cells.limit, cells.signs)
    size = cells.score.shape[::-1]
    known = _cropped(number, pitch_um)
    shares = [
        cv2.resize((known == k + 1).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for k in range(len(kinds))
    ]
    groups = []
    for label in range(1, count):
        inside = labels == label
        covered = np.array([share[inside].sum() for share in shares] or [0.0])
        most, cover, area = int(covered.argmax()), float(covered.sum()), int(inside.sum())
        if cover < 0.05:
            groups.append(Group(found[label - 1], area, NAMES.index(TEXTURE), -label))
            continue
        alike = float(covered[np.equal(kinds, kinds[most])].sum())
        if alike > 0.6 * cover and alike >= 0.05 * area:
            groups.append(Group(found[label - 1], area, kinds[most], most))
    return groups


def trained(number: int) -> dict[str, list[Group]]:
    """Groups of a sheet in the prediction's light, by look."""
    rng = np.random.default_rng([7, number])
    pitch, angle, alpha = float(rng.choice(PITCHES)), rng.uniform(6.0, 18.0), rng.uniform(0.05, 0.14)
    sheet = sheet_of(rng, angle, pitch)
    pictures, marks = photographed(sheet, by_prediction(rng, alpha), rng, LOOKS["tilted"])
    return _by_look(pictures, marks, sheet, angle, alpha)


def judged(number: int) -> dict[str, list[Group]]:
    """Groups of a sheet that the path tracer rendered, by look."""
    angle, pitch, alpha, lobe = list(JUDGED.values())[number % len(JUDGED)]
    rng = np.random.default_rng([11, number])
    sheet = sheet_of(rng, angle, pitch)
    light = by_path_tracer(rng, alpha, lobe, number)
    pictures, marks = photographed(sheet, light, rng, LOOKS["tilted"])
    return _by_look(pictures, marks, sheet, angle, alpha)


def judged_part(name: str, number: int) -> dict[str, list[Group]]:
    """Groups of a traced part with defects of the library, by look."""
    angle, pitch, alpha, lobe = list(JUDGED.values())[number % len(JUDGED)]
    kind, spoiled = PARTS[name]
    part = Part(
        20_000 + 10 * number, NINE, angle=angle, pitch=pitch, alpha=alpha, lobe=lobe, size=(1340.0, 1020.0),
        spread=0.1, phase=np.random.default_rng(number).random(), spoiled=spoiled,
    )  # fmt: skip
    marks = (part.changed > CHANGED_UM).astype(np.uint8)
    found = {}
    for look, poses in LOOKS.items():
        cells = map_of(part.pictures, angle, pitch, alpha, poses)
        groups = groups_of(cells, marks, (NAMES.index(kind),), pitch)
        found[look] = [replace(one, mark=k) for k, one in enumerate(groups) if NAMES[one.kind] == kind]
    return found


CELL_PARTS = {
    "scratches, 1 %": ("scratches", {"density_per_mm2": 11.7}),
    **{
        f"burrs, {share:.0%}".replace("%", " %"): ("burrs", {"coverage": share})
        for share in (0.02, 0.05, 0.08)
    },
    "missing ridges": ("missing-ridges", {"share": 0.08}),
    "good": None,
}
"""Parts whose cells are counted: defects of the library and their values."""
CHANGED_CELL_UM, CHANGED_SHARE = 0.5, 0.1
"""Change of a height, and the share of a cell with it from which on the cell is spoiled."""


GOLDEN = 3
"""Good parts of a design whose limits stand beside that of the part itself."""
LOOKED = tuple((look, golden) for look in LOOKS for golden in (False, True))


def traced_maps(name: str, number: int, design: int) -> tuple[Part, dict[str, CellMap]]:
    """A traced part with a defect of the library, and its cells, by look."""
    angle, pitch, alpha, lobe = list(JUDGED.values())[design]
    part = Part(
        70_000 + 100 * number + len(name), NINE, angle=angle, pitch=pitch, alpha=alpha, lobe=lobe,
        size=(1400.0, 1200.0), spread=0.1, phase=np.random.default_rng(number).random(), spoiled=CELL_PARTS[name],
    )  # fmt: skip
    pictures = {look: [part.pictures[k] for k in poses] for look, poses in LOOKS.items()}
    return part, {look: map_of(seen, angle, pitch, alpha, LOOKS[look]) for look, seen in pictures.items()}


def golden_limits(number: int) -> dict[str, float]:
    """Limits of a golden part, by look."""
    _, maps = traced_maps("good", 500 + number, number % len(JUDGED))
    return {look: one.limit for look, one in maps.items()}


def judged_cells(
    name: str, number: int, golden: list[dict[str, float]]
) -> dict[tuple[str, bool], tuple[int, int, int, float]]:
    """Spoiled cells found, good ones that deviate, spoiled ones missed, and the share that deviates.

    By look, alone and with golden parts.
    """
    design = number % len(JUDGED)
    part, maps = traced_maps(name, number, design)
    pitch = list(JUDGED.values())[design][1]
    spoiled = part.spoiled_share(CHANGED_CELL_UM, pitch, 1) > CHANGED_SHARE
    found = {}
    for look, with_golden in LOOKED:
        limits = [one[look] for one in golden[design :: len(JUDGED)]] if with_golden else []
        over = maps[look].by(limits).deviating()
        counts = (int(np.sum(one)) for one in (over & spoiled, over & ~spoiled, spoiled & ~over))
        found[look, with_golden] = (*counts, float(over.mean()))
    return found


def cells_table(count: int) -> str:
    """F1 of the cells of a mark, and the largest share of a good part that deviates."""
    heads = [f"{look}, {GOLDEN} golden" if golden else look for look, golden in LOOKED]
    lines = ["| part | " + " | ".join(heads) + " |", "|---|" + "---|" * len(heads)]
    golden = for_each(golden_limits, range(GOLDEN * len(JUDGED)), 2)
    for name in CELL_PARTS:
        found = for_each(lambda k, name=name: judged_cells(name, k, golden), range(count), 2)
        cells = []
        for look in LOOKED:
            hit, false, missed, share = np.array([one[look] for one in found]).T
            score = 2.0 * hit.sum() / max(2.0 * hit.sum() + false.sum() + missed.sum(), 1.0)
            cells.append(f"{100.0 * share.max():.1f} % of the worst" if name == "good" else f"{score:.2f}")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _by_look(
    pictures: list[np.ndarray], marks: np.ndarray, sheet: Sheet, angle: float, alpha: float
) -> dict[str, list[Group]]:
    found: dict[str, list[Group]] = {}
    for name, look in LOOKS.items():
        try:
            cells = map_of(pictures, angle, sheet.pitch_um, alpha, look)
        except MeasurementError:
            continue
        if cells.signs is not None:
            found[name] = groups_of(cells, marks, sheet.kinds, sheet.pitch_um)
    return found


def _moments(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariance of what is known: crowded sheets have no continuation, upright poses no tilted ones."""
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    mean = np.divide(np.nansum(rows, axis=0), count, out=np.full(rows.shape[1], np.nan), where=count > 0)
    away = np.where(known, rows - mean, 0.0) * np.sqrt(len(rows) / np.maximum(count, 1))
    return mean, away.T @ away / (len(rows) - 1)


def _table(groups: list[Group], temper: float) -> dict:
    """Means and covariances of every kind, shrunk towards the mean of all kinds."""
    rows = [np.array([one.numbers for one in groups if one.kind == k]) for k in range(len(NAMES))]
    means, own = zip(*map(_moments, rows), strict=True)
    pool = np.mean(own, axis=0)
    size = len(pool)
    triangles = []
    for one, matrix in zip(rows, own, strict=True):
        shrunk = (len(one) * matrix + SHRINK * pool) / (len(one) + SHRINK) + 1e-3 * np.eye(size)
        triangles.append([float(f"{value:.5g}") for value in shrunk[np.tril_indices(size)]])
    return {
        "names": NAMES,
        "temper": temper,
        "means": [[float(f"{one:.5g}") if np.isfinite(one) else None for one in mean] for mean in means],
        "triangles": triangles,
    }


def named(classes: MarkClasses, groups: list[Group]) -> list[tuple[Group, np.ndarray]]:
    """The groups of a part that have a kind, with the weights of their kinds."""
    some = [one for one in groups if one.cells >= CELLS]
    return (
        list(zip(some, classes.weights(np.array([one.numbers for one in some])), strict=True)) if some else []
    )


def largest(rows: list[tuple[Group, np.ndarray]]) -> list[tuple[Group, np.ndarray]]:
    """The largest group of every mark."""
    found: dict[int, tuple[Group, np.ndarray]] = {}
    for one in rows:
        mark = one[0].mark
        if mark not in found or one[0].cells > found[mark][0].cells:
            found[mark] = one
    return list(found.values())


def log_score(classes: MarkClasses, sheets: list[list[Group]]) -> float:
    """Mean log weight of the true kinds of marks."""
    return float(
        np.mean(
            [
                np.log(row[one.kind])
                for groups in sheets
                for one, row in largest(named(classes, groups))
                if NAMES[one.kind] != TEXTURE
            ]
        )
    )


def fit(count: int) -> None:
    """Fit the classes to sheets, and the temper to a third of them that was left out; write the file."""
    sheets = for_each(trained, range(count), 2)
    tables = {}
    for look in LOOKS:
        groups = [[one for one in sheet.get(look, []) if one.cells >= CELLS] for sheet in sheets]
        kept = [one for k, sheet in enumerate(groups) if k % 3 for one in sheet]
        left = groups[::3]
        tempers = np.linspace(0.2, 1.0, 17)
        scores = [log_score(classes_of(_table(kept, temper)), left) for temper in tempers]
        temper = float(tempers[int(np.argmax(scores))])
        tables[look] = _table([one for sheet in groups for one in sheet], temper)
        sys.stdout.write(f"{look}: {sum(map(len, groups))} groups, temper {temper:.2f}\n")
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(tables), encoding="utf-8")


def parts_table(parts: dict[str, list[dict[str, list[Group]]]]) -> str:
    """How often the groups of a part with one defect have its name, and the name of most of them."""
    lines = ["| part | " + " | ".join(LOOKS) + " |", "|---|" + "---|" * len(LOOKS)]
    for name, found in parts.items():
        cells = []
        for look in LOOKS:
            classes, hits = known_classes()[look == "tilted"], []
            for part in found:
                hits += [int(row.argmax()) == one.kind for one, row in named(classes, part[look])]
            cells.append(f"{np.mean(hits):.0%} of {len(hits)} regions" if hits else "–")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def table_of(sheets: list[dict[str, list[Group]]]) -> str:
    """How often marks get the right name first, and how often stated weights hold."""
    lines = ["| kind | " + " | ".join(LOOKS) + " |", "|---|" + "---|" * len(LOOKS)]
    right: dict[str, list[list[bool]]] = {look: [[] for _ in NAMES] for look in LOOKS}
    stated: dict[str, list[tuple[float, bool]]] = {look: [] for look in LOOKS}
    for look in LOOKS:
        classes = known_classes()[look == "tilted"]
        for sheet in sheets:
            for one, row in largest(named(classes, sheet.get(look, []))):
                hit = int(row.argmax()) == one.kind
                right[look][one.kind].append(hit)
                if NAMES[one.kind] != TEXTURE and (*NAMES, UNKNOWN)[int(row.argmax())] != TEXTURE:
                    stated[look].append((float(row.max()), hit))
    for k, name in enumerate(NAMES):
        cells = [f"{sum(right[look][k])} of {len(right[look][k])}" for look in LOOKS]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    every = [
        [hit for k, one in enumerate(right[look]) if NAMES[k] != TEXTURE for hit in one] for look in LOOKS
    ]
    lines.append(
        "| **all marks** | " + " | ".join(f"**{np.mean(one):.0%}** of {len(one)}" for one in every) + " |"
    )
    lines += ["", "| stated weight | " + " | ".join(LOOKS) + " |", "|---|" + "---|" * len(LOOKS)]
    for low, high in ((0.0, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.01)):
        cells = []
        for look in LOOKS:
            some = [one for one in stated[look] if low <= one[0] < high]
            mean = np.mean([one[0] for one in some]) if some else np.nan
            cells.append(
                f"{mean:.2f}: right {np.mean([one[1] for one in some]):.2f} of {len(some)}" if some else "–"
            )
        lines.append(f"| {low:g} to {min(high, 1.0):g} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Fit, judge, or count cells."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = options.add_mutually_exclusive_group(required=True)
    what.add_argument("--fit", type=int, help="sheets in the prediction's light")
    what.add_argument("--judge", type=int, help="sheets of the path tracer")
    what.add_argument("--cells", type=int, help="parts of a defect, cell by cell")
    options.add_argument("--first", type=int, default=0, help="number of the first sheet to judge")
    chosen = options.parse_args()
    if chosen.fit is not None:
        fit(chosen.fit)
    elif chosen.cells is not None:
        sys.stdout.write(cells_table(chosen.cells))
    else:
        sys.stdout.write(
            table_of(for_each(judged, range(chosen.first, chosen.first + chosen.judge), 2)) + "\n"
        )
        number = range(max(chosen.judge // 6, 1))
        parts = {name: for_each(lambda k, name=name: judged_part(name, k), number, 2) for name in PARTS}
        sys.stdout.write(parts_table(parts))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
