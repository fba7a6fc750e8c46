"""A picture becomes a surface: every pixel a dot with a reflectance of its own.

Pictures with as many values as there are reflectances are taken as labels. Others are dithered between reflectances
that are neighbours in brightness: dots are so small that the eye takes them together (Levin et al. 2013, section 4).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.etching import PatternOptions
from anisoscope.sim.design.designfile import DesignFile
from anisoscope.sim.design.dot import Dot, DotTask
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.models import AntiMirrorModel, LobeModel, MirrorModel, MixtureModel, random_dot
from anisoscope.sim.design.refine import Limits, refine

Classes = npt.NDArray[np.int64]

MOST_MM = 100.0
"""Side of the largest wafer that is laid out."""

MOST_TILES = 2**16
"""Largest number that the index of a layout can distinguish."""

MOST_POINTS = 2**29
"""Grid points of all tiles together: 1 GB."""


def classes_of(picture: npt.NDArray[np.integer], designs: int, *, dither: bool) -> Classes:
    """(rows, cols) class of every pixel, by brightness: the darkest is class 0.

    Args:
        picture: (rows, cols) grey values.
        designs: how many classes there are.
        dither: take the classes as even steps of brightness, and mix neighbours in between.

    Raises:
        ModelError: more values in the picture than designs, and no dithering; or fewer.
    """
    values = np.unique(picture)
    if dither:
        if designs < 2:
            raise ModelError("dithering mixes neighbours: give two designs or more")
        low, high = float(values[0]), float(values[-1])
        level = (picture - low) / max(high - low, 1.0) * (designs - 1)
        return diffused(np.asarray(level, dtype=np.float64))
    if values.size > designs:
        raise ModelError(
            f"the picture has {values.size} different values, but there are {designs} designs: name a design for each, "
            "from dark to bright, reduce the picture to labels, or ask for --dither"
        )
    if values.size < designs:
        raise ModelError(
            f"{designs} designs for a picture of {values.size} different values: leave designs out, or ask for --dither"
        )
    return np.searchsorted(values, picture).astype(np.int64)


def diffused(level: FloatArray) -> Classes:
    """(rows, cols) whole numbers whose local mean follows ``level``: error diffusion of Floyd and Steinberg.

    Rows run to and fro, so that no worms grow.
    """
    rows, cols = level.shape
    found = np.empty((rows, cols), dtype=np.int64)
    top = int(np.ceil(level.max()))
    ahead = [0.0] * (cols + 2)
    for row in range(rows):
        here, ahead = ahead, [0.0] * (cols + 2)
        line, step = level[row].tolist(), 1 if row % 2 == 0 else -1
        for col in range(cols)[::step]:
            target = line[col] + here[col + 1]
            rounded = min(max(round(target), 0), top)
            found[row, col] = rounded
            off = target - rounded
            here[col + 1 + step] += off * 7.0 / 16.0
            ahead[col + 1 - step] += off * 3.0 / 16.0
            ahead[col + 1] += off * 5.0 / 16.0
            ahead[col + 1 + step] += off * 1.0 / 16.0
    return found


def check_together(designs: Sequence[DesignFile]) -> tuple[tuple[float, ...], float]:
    """Etch passes and grid that all designs share.

    A mirror is etched by no pass and goes with any.

    Raises:
        ModelError: designs with different passes, grids, wavelengths or coherence lengths.
    """
    etched = [design for design in designs if not isinstance(design.model, MirrorModel)]
    if not etched:
        raise ModelError("a pattern of mirrors only shows nothing: give a design with steps")
    first = etched[0]
    for other in etched[1:]:
        same = len(other.passes_nm) == len(first.passes_nm) and np.allclose(
            other.passes_nm, first.passes_nm, atol=0.05
        )
        if (other.wavelength_nm, other.coherence_um) != (first.wavelength_nm, first.coherence_um):
            raise ModelError(
                f"{first.name} is designed for {first.wavelength_nm:g} nm and a coherence length of "
                f"{first.coherence_um:g} µm, {other.name} for {other.wavelength_nm:g} nm and {other.coherence_um:g} "
                "µm: one wafer is seen in one light; design them with the same --wavelength and --coherence"
            )
        if not same or other.grid_um != first.grid_um:
            raise ModelError(
                f"{first.name} and {other.name} have different etch passes or grids ({_nm(first)} on {first.grid_um:g} "
                f"µm, {_nm(other)} on {other.grid_um:g} µm): one wafer is etched at once; design them with the same "
                "--depths and --grid"
            )
    return first.passes_nm, first.grid_um


def _nm(design: DesignFile) -> str:
    return " + ".join(f"{depth:.1f}" for depth in design.passes_nm) + " nm"


def make_layout(
    classes: Classes,
    designs: Sequence[DesignFile],
    rng: np.random.Generator,
    options: PatternOptions | None = None,
    on_progress: Advance = silent,
) -> Layout:
    """Lay out dots.

    Args:
        classes: (rows, cols) class of every dot, row 0 at the top of the picture.
        designs: of every class.
        rng: source of randomness.
        options: how; the defaults of `PatternOptions`.
        on_progress: called after every tile.

    Raises:
        ModelError: more classes than designs, designs that do not go together, or a pattern larger than a wafer.
    """
    how = PatternOptions() if options is None else options
    if int(classes.max()) >= len(designs):
        raise ModelError(
            f"the pattern has {int(classes.max()) + 1} classes, but there are {len(designs)} designs: give one for each"
        )
    passes, grid = check_together(designs)
    if not grid <= how.dot_um <= 1e3 * MOST_MM:
        raise ModelError(
            f"a dot must be a grid step of {grid:g} µm to {1e3 * MOST_MM:g} µm wide, not {how.dot_um:g} µm"
        )
    points = round(how.dot_um / grid)
    size_mm = 1e-3 * points * grid * max(classes.shape)
    if size_mm > MOST_MM:
        raise ModelError(
            f"{classes.shape[0]} × {classes.shape[1]} dots of {how.dot_um:g} µm are {size_mm:.0f} mm; at most "
            f"{MOST_MM:g} mm: take a smaller picture or smaller dots"
        )
    if how.tiles < 1 or points < 2:
        raise ModelError(
            "a pattern needs at least one tile for every design, and dots of two grid steps or more"
        )
    many = sum(_tile_count(design, how.tiles) for design in designs)
    if many > MOST_TILES or many * points**2 > MOST_POINTS:
        raise ModelError(
            f"{many} tiles of {points} × {points} grid points are too many (at most {MOST_TILES} tiles and "
            f"{MOST_POINTS} points): take fewer tiles, smaller dots, or larger shares in mixtures"
        )
    tiles: list[npt.NDArray[np.uint16]] = []
    owner: list[int] = []
    for number, design in enumerate(designs):
        for turn, model in enumerate(_models(design, how.tiles)):
            on_progress(f"{design.name}, tile {turn + 1}", len(tiles), many)
            tiles.append(make_tile(design, model, points, rng, how.refine_s))
            owner.append(number)
    tile_class = np.array(owner)
    index = np.empty(classes.shape, dtype=np.uint16)
    for number in range(len(designs)):
        mine = np.flatnonzero(tile_class == number)
        where = classes == number
        index[where] = rng.choice(mine, int(where.sum()))
    names = tuple(design.name for design in designs)
    first = next(design for design in designs if not isinstance(design.model, MirrorModel))
    return Layout(
        np.stack(tiles), tile_class, np.ascontiguousarray(index[::-1]), passes, grid, names, first.wavelength_nm,
        first.coherence_um,
    )  # fmt: skip


def _tile_count(design: DesignFile, count: int) -> int:
    """Number of tiles of a design: a mixture has so many that its smallest share gets one."""
    if isinstance(design.model, MirrorModel):
        return 1
    if isinstance(design.model, MixtureModel):
        return max(count, round(1.0 / min(design.model.shares)))
    return count


def _models(design: DesignFile, count: int) -> list[LobeModel | AntiMirrorModel | MirrorModel]:
    """Model of every tile of a design; in a mixture each model in proportion to its share, at least once."""
    if not isinstance(design.model, MixtureModel):
        return [design.model] * _tile_count(design, count)
    shares, total = np.asarray(design.model.shares), _tile_count(design, count)
    parts = np.floor(shares * total).astype(int)
    late = np.argsort(parts - shares * total, kind="stable")[: total - int(parts.sum())]
    parts[late] += 1
    return [model for model, many in zip(design.model.models, parts, strict=True) for _ in range(many)]


def make_tile(
    design: DesignFile,
    model: LobeModel | AntiMirrorModel | MirrorModel,
    points: int,
    rng: np.random.Generator,
    refine_s: float = 0.0,
) -> npt.NDArray[np.uint16]:
    """(points, points) levels of one tile, refined on request if the model is a lobe.

    Raises:
        ModelError: features below the smallest, or not on the grid.
    """
    if refine_s > 0.0 and isinstance(model, LobeModel):
        task = dot_task(design, model, points * design.grid_um)
        found = refine(task, rng, Limits(refine_s)).dot
        return rasterised(found, design.grid_um)
    return random_dot(model, 2 ** len(design.passes_nm), points, design.grid_um, design.min_width_um, rng)


def dot_task(design: DesignFile, model: LobeModel, dot_um: float) -> DotTask:
    """Task of the refinement for a design."""
    x, y = model.axes(design.min_width_um)
    return DotTask(x, y, design.depths.levels_um, dot_um, design.coherence_um, 1e-3 * design.wavelength_nm)


def rasterised(dot: Dot, grid_um: float) -> npt.NDArray[np.uint16]:
    """(n, n) levels of a dot on the grid."""
    y, x = (_counts(edges, grid_um) for edges in (dot.edges_y_um, dot.edges_x_um))
    return np.asarray(np.repeat(np.repeat(dot.levels, y, axis=0), x, axis=1), dtype=np.uint16)


def _counts(edges_um: FloatArray, grid_um: float) -> Classes:
    at: Classes = np.rint(edges_um / grid_um).astype(np.int64)
    return at[1:] - at[:-1]
