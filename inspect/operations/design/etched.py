"""Etched steps: reflectances, the dots that have them, and surfaces of many dots."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from shutil import disk_usage
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.etching import (
    GDS,
    DepthSearch,
    DotSearch,
    EtchedHeights,
    LobeShape,
    PatternOptions,
    StepBlocks,
)
from anisoscope.parameters.fabrication import Fabrication
from anisoscope.parameters.keywords import by_keywords
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.design.antimirror import AntiMirror
from anisoscope.sim.design.depths import Depths, design_depths
from anisoscope.sim.design.designfile import DesignFile, read_design, read_layout
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.lobe import AxisLobe, LobeTask, design_lobe
from anisoscope.sim.design.maskreading import read_gds
from anisoscope.sim.design.models import AntiMirrorModel, AnyModel, LobeModel, MirrorModel
from anisoscope.sim.design.pattern import classes_of, dot_task, make_layout, rasterised
from anisoscope.sim.design.refine import Limits, Refined, refine

FAINT_TAU = 0.05
"""Mean phase of the levels from which on a warning is due."""
MIRROR = "mirror"
SECONDS = 30.0
MOST_DOTS = 10**7


def _keys_of(design: DesignFile) -> dict[str, Any]:
    """A design and its figures for JSON; those of a lobe by axis as well."""
    model = design.model.model_dump(mode="json")
    found: dict[str, Any] = {
        "name": design.name,
        "model": model,
        "depths_nm": design.passes_nm,
        "epsilon": design.depths.epsilon if design.passes_nm else None,
        "wavelength_nm": design.wavelength_nm,
        "band_nm": design.band_nm,
        "coherence_um": design.coherence_um,
        "min_width_um": design.min_width_um,
        "grid_um": design.grid_um,
        **design.figures,
    }
    if model["kind"] == "lobe":
        axes = ("x", "y")
        found["p_a"] = {
            axis: list(zip(model[f"widths_{axis}_um"], model[f"p_a_{axis}"], strict=True)) for axis in axes
        }
        found["unreachable"] = {axis: design.figures.get(f"unreachable_{axis}") for axis in axes}
    return found


@dataclass(frozen=True)
class EtchedDesign:
    """A designed reflectance.

    Attributes:
        design: as its file holds it.
        axes: of a lobe, what was found along x and y.
        warnings: what to know of it.
    """

    design: DesignFile = field(metadata=json_field(by=_keys_of, merged=True))
    axes: tuple[AxisLobe, ...] = field(default=(), metadata=LEFT_OUT)
    warnings: tuple[str, ...] = ()


def _design_of(
    name: str, model: AnyModel, passes: Depths, fabrication: Fabrication, figures: dict[str, float]
) -> DesignFile:
    return DesignFile(
        name=name,
        model=model,
        passes_nm=passes.passes_nm,
        band_nm=passes.band_nm,
        wavelength_nm=fabrication.wavelength_nm,
        coherence_um=fabrication.coherence_um,
        min_width_um=fabrication.min_width_um,
        grid_um=fabrication.grid_um,
        figures=figures,
    )


@by_keywords(shape=LobeShape)
def etched_lobe(
    *, shape: LobeShape, fabrication: Fabrication | None = None, name: str | None = None
) -> EtchedDesign:
    """The mixture of step widths whose reflectance comes closest to a Gaussian lobe: ``anisoscope design lobe``.

    Args:
        shape: `LobeShape`.
        fabrication: light, etch passes, smallest feature and grid.
        name: of the design.

    Raises:
        ModelError: the lobe is out of reach, or depths that are none.
    """
    sigma, sigma_y = shape.sigma, shape.sigma_y
    made = fabrication or Fabrication()
    passes = Depths(made.passes_nm, made.bandwidth_nm)
    limits = made.min_width_um, shape.max_width_um, made.grid_um, 1e-3 * made.wavelength_nm, made.coherence_um
    found = design_lobe(*(LobeTask(one, *limits) for one in (sigma, sigma if sigma_y is None else sigma_y)))
    if not shape.nearest:
        found.check()
    x, y = found.x, found.y
    model = LobeModel(
        widths_x_um=tuple(x.widths_um.tolist()),
        p_a_x=tuple(x.probabilities.tolist()),
        widths_y_um=tuple(y.widths_um.tolist()),
        p_a_y=tuple(y.probabilities.tolist()),
    )
    figures = {"sigma_x": x.task.sigma, "sigma_y": y.task.sigma, "rel_l2": found.rel_l2}
    kinds = {
        "rel_l2": "rel_l2",
        "one_width": "one_width",
        "intrinsic": "intrinsic",
        "unreachable": "unreachable_share",
    }
    for key, name_of in kinds.items():
        figures |= {f"{key}_{axis}": getattr(one, name_of) for axis, one in (("x", x), ("y", y))}
    title = name or (f"lobe {sigma:g}" if sigma_y in (None, sigma) else f"lobe {sigma:g} × {sigma_y:g}")
    warnings = []
    if not (x.feasible and y.feasible):
        warnings.append(
            f"out of reach: {100.0 * found.rel_l2:.1f} % (L2) of the wanted lobe is missed; this is the nearest"
        )
    warnings += _of_phase(passes, made, "a spike stands in the lobe")
    design = _design_of(title, model, passes, made, figures)
    return EtchedDesign(design, (x, y), tuple(warnings))


def _of_phase(passes: Depths, made: Fabrication, what: str) -> list[str]:
    tau = passes.tau_at(made.wavelength_nm)
    if tau < FAINT_TAU:
        return []
    return [f"the levels have a mean phase of {tau:.2f} at {made.wavelength_nm:g} nm: {what}"]


@by_keywords(blocks=StepBlocks)
def etched_antimirror(
    *, blocks: StepBlocks, fabrication: Fabrication | None = None, name: str | None = None
) -> EtchedDesign:
    """A surface that reflects everywhere except in the mirror direction: ``anisoscope design antimirror``.

    Args:
        blocks: `StepBlocks`.
        fabrication: light, etch passes, smallest feature and grid.
        name: of the design.

    Raises:
        ModelError: steps that cannot be made.
    """
    many, widths, crossed = blocks.arrangement, blocks.width_um, blocks.crossed
    arrangement, widths_um = (int(many[0]), int(many[-1])), (widths[0], widths[-1])
    made = fabrication or Fabrication()
    passes = Depths(made.passes_nm, made.bandwidth_nm)
    levels = len(passes.levels_nm)
    found = AntiMirror(arrangement, widths_um, levels, crossed, made.min_width_um)
    folded = found.folds(passes.tau_at(made.wavelength_nm))
    model = AntiMirrorModel(
        arrangement=found.arrangement,
        widths_um=found.widths_um,
        levels=found.levels,
        crossed=crossed,
        folded=folded,
    )
    warnings = _of_phase(passes, made, "the hole is filled by a spike")
    if crossed and not folded:
        passes = Depths(passes.passes_nm * 2, passes.band_nm)
    um = 1e-3 * made.wavelength_nm
    holes = zip(("hole_x", "hole_y"), found.hole(um), strict=True)
    figures = {key: value for key, value in holes if value < float("inf")}
    figures |= {"ring_x": found.ring(um)[0], "ring_y": found.ring(um)[1]}
    figures["hole_floor"] = found.floor(um, made.coherence_um)
    shape = "crossed " if crossed else ""
    title = name or f"{shape}anti-mirror {found.arrangement[0]}×{found.arrangement[1]}"
    return EtchedDesign(_design_of(title, model, passes, made, figures), warnings=tuple(warnings))


@dataclass(frozen=True)
class EtchDepths:
    """Depths of etch passes whose levels have a mean phase of nearly zero.

    Attributes:
        levels: count of the levels.
        depths_nm: of the passes.
        levels_nm: depths of the levels.
        band_nm: wavelengths that they are for.
        epsilon: largest mean phase in the band.
        worst_nm: wavelength where it is.
        spike_over_lobe: mirror-like light over that of the lobe there.
    """

    levels: int
    depths_nm: tuple[float, ...]
    levels_nm: tuple[float, ...]
    band_nm: tuple[float, float]
    epsilon: float
    worst_nm: float
    spike_over_lobe: float


@by_keywords(search=DepthSearch)
def etch_depths(
    *, search: DepthSearch, band_nm: tuple[float, float] = (400.0, 700.0), coherence_um: float = 16.0
) -> EtchDepths:
    """Depths of etch passes whose levels have a zero mean phase, over a band: ``anisoscope design depths``.

    Args:
        search: `DepthSearch`.
        band_nm: wavelengths.
        coherence_um: of the source, for the spike.

    Raises:
        ModelError: another count of levels, or a band or half vector that is none.
    """
    found = design_depths(search.levels, band_nm, search.h_z, search.seed)
    spike = found.spike_over_lobe(coherence_um, search.width_um)
    depths = tuple(found.passes_nm), tuple(found.levels_nm), found.band_nm
    return EtchDepths(search.levels, *depths, found.epsilon, found.worst_nm, spike)


@dataclass(frozen=True)
class RefinedDot:
    """A dot of a lobe whose own reflectance is close to the expected one.

    Attributes:
        file: the design.
        layout: the dot as a layout.
        found: the search.
        method: kinds of search.
        seed: of everything random.
        dot_um: side of the dot.
    """

    file: DesignFile = field(metadata=json_field("design", by=attrgetter("name")))
    layout: Layout = field(metadata=LEFT_OUT)
    found: Refined = field(metadata=json_field(merged=True))
    method: str
    seed: int
    dot_um: float

    @property
    @in_json()
    def seconds(self) -> float:
        """When the dot was found."""
        return self.found.history[-1][0]


@by_keywords(search=DotSearch)
def refine_dot(design: DesignFile, *, search: DotSearch, on_progress: Advance = silent) -> RefinedDot:
    """The dot of a lobe whose own reflectance is closest to the expected one: ``anisoscope design refine``.

    Args:
        design: a lobe.
        search: `DotSearch`; its dot is rounded to the grid of the design.
        on_progress: called along the search.

    Raises:
        UsageError: no lobe, or a dot or seed that is none.
    """
    unlimited = search.seconds is None and search.generations is None
    limits = Limits(SECONDS if unlimited else search.seconds, search.generations, search.good)
    if not isinstance(design.model, LobeModel):
        raise UsageError(
            f"{design.name}: a {design.model.kind} has no widths to draw from: refine takes a lobe"
        )
    side = round(search.dot_um / design.grid_um) * design.grid_um
    found = refine(
        dot_task(design, design.model, side),
        np.random.default_rng(search.seed),
        limits,
        method=search.method,
        population=search.population,
        on_progress=on_progress,
    )
    tile = rasterised(found.dot, design.grid_um)
    layout = Layout(
        tile[None],
        np.zeros(1, dtype=np.int64),
        np.zeros((1, 1), dtype=np.uint16),
        design.passes_nm,
        design.grid_um,
        (design.name,),
        design.wavelength_nm,
        design.coherence_um,
    )
    return RefinedDot(design, layout, found, search.method, search.seed, side)


@dataclass(frozen=True)
class DotClass:
    """Dots of one reflectance."""

    name: str
    dots: int


@dataclass(frozen=True)
class DotPattern:
    """A picture as dots, each with one reflectance.

    Attributes:
        layout: dots and tiles.
        designs: their reflectances.
        seed: of everything random.
    """

    layout: Layout = field(metadata=LEFT_OUT)
    designs: tuple[DesignFile, ...] = field(metadata=LEFT_OUT)
    seed: int

    @property
    @in_json()
    def rows(self) -> int:
        """Dots along y."""
        return int(self.layout.index.shape[0])

    @property
    @in_json()
    def cols(self) -> int:
        """Dots along x."""
        return int(self.layout.index.shape[1])

    @property
    @in_json()
    def dot_um(self) -> float:
        """Side of a dot."""
        return self.layout.dot_um

    @property
    @in_json()
    def size_mm(self) -> list[float]:
        """(along y, along x)."""
        return [1e-3 * side for side in self.layout.size_um]

    @property
    @in_json()
    def tiles(self) -> int:
        """Different dots."""
        return len(self.layout.tiles)

    @property
    @in_json()
    def depths_nm(self) -> tuple[float, ...]:
        """Depth of every etch pass."""
        return self.layout.passes_nm

    @property
    @in_json()
    def classes(self) -> tuple[DotClass, ...]:
        """Dots of each reflectance."""
        counts = np.bincount(self.layout.classes.ravel(), minlength=len(self.designs))
        pairs = zip(self.layout.names, counts, strict=True)
        return tuple(DotClass(name, int(count)) for name, count in pairs)


@by_keywords(options=PatternOptions)
def dot_pattern(
    grey: npt.NDArray[np.uint8],
    designs: Sequence[DesignFile],
    *,
    options: PatternOptions,
    on_progress: Advance = silent,
) -> DotPattern:
    """Lay out a picture as dots, each with one reflectance: ``anisoscope design pattern``.

    Args:
        grey: (rows, cols) picture, a dot a pixel: labels, or shades with ``dither``.
        designs: from dark to bright (`mirror_design` is the bare wafer).
        options: `PatternOptions`.
        on_progress: called along the way.

    Raises:
        UsageError: another count of values than of designs, or a dot or seed that is none.
    """
    labels = classes_of(grey, len(designs), dither=options.dither)
    layout = make_layout(labels, designs, np.random.default_rng(options.seed), options, on_progress)
    return DotPattern(layout, tuple(designs), options.seed)


def mirror_design() -> DesignFile:
    """The bare wafer."""
    return DesignFile(name=MIRROR, model=MirrorModel(), passes_nm=(), band_nm=(400.0, 700.0))


def resized(
    grey: npt.NDArray[np.uint8], size_mm: tuple[float, float], dot_um: float
) -> npt.NDArray[np.uint8]:
    """A picture with as many pixels as dots on a plate of that size (wide, high).

    Raises:
        UsageError: too many dots.
    """
    cols, rows = (max(1, round(1e3 * side / dot_um)) for side in size_mm)
    if rows * cols > MOST_DOTS:
        raise UsageError(
            f"--plate-size {size_mm[0]:g},{size_mm[1]:g} mm with --dot {dot_um:g} µm are {rows * cols} dots: take "
            "larger dots"
        )
    return np.asarray(cv2.resize(grey, (cols, rows), interpolation=cv2.INTER_NEAREST), dtype=np.uint8)


@by_keywords(how=EtchedHeights)
def etched_heights(source: Path, *, how: EtchedHeights) -> HeightMap:
    """Height map of a design, a layout or a GDSII file, or of a window of it: ``anisoscope design height``.

    Args:
        source: design *.toml, layout *.npz or masks *.gds.
        how: `EtchedHeights`.

    Raises:
        UsageError: another file, or options of another one.
    """
    if source.suffix.lower() not in GDS:
        return layout_of(source, how).window(how.corner_yx_um, how.window_yx_um)
    return read_gds(
        source,
        corner_um=how.corner_yx_um,
        size_um=how.window_yx_um,
        grid_um=how.pixel_um,
        passes_nm=how.depths_nm,
    )


def layout_of(source: Path, how: EtchedHeights) -> Layout:
    """The layout in a file, or random dots of a design.

    Args:
        source: layout *.npz, or design *.toml.
        how: dots of a design, side and seed.

    Raises:
        UsageError: another file, a number of dots outside 1 to 1000, or options of GDSII files.
    """
    if how.depths_nm is not None or how.pixel_um is not None:
        raise UsageError(f"--depths and --pixel are for GDSII files; {source.name} says its own")
    kind = source.suffix.lower()
    if kind == ".npz":
        return read_layout(source)[0]
    if kind != ".toml":
        raise UsageError(f"{source.name}: give a design *.toml, a layout *.npz or masks *.gds")
    if not 1 <= how.dots <= 1000:
        raise UsageError(f"--dots must be 1 to 1000, not {how.dots}")
    design = read_design(source)
    classes = np.zeros((how.dots, how.dots), dtype=np.int64)
    options = PatternOptions(how.dot_um, min(how.dots**2, 16))
    return make_layout(classes, [design], np.random.default_rng(how.seed), options)


@dataclass(frozen=True)
class WrittenHeights:
    """A map that was written row by row.

    Attributes:
        file: npy of float32 in µm.
        rows: points along y.
        cols: points along x.
        pixel_um: pixel size.
    """

    file: Path
    rows: int
    cols: int
    pixel_um: float


def write_heights(layout: Layout, out: Path) -> WrittenHeights:
    """Write the whole surface of a layout, a row of dots at a time: it may exceed the memory.

    Raises:
        UsageError: no space, or a file that cannot be written.
    """
    n = layout.tiles.shape[1]
    rows, cols = (n * many for many in layout.index.shape)
    table = layout.heights_um.astype(np.float32)
    needed, free = 4 * rows * cols, disk_usage(out.resolve().parent).free
    if needed > free:
        raise UsageError(
            f"{rows} × {cols} heights take {needed / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: give --window-size"
        )
    header = {"descr": "<f4", "fortran_order": False, "shape": (rows, cols)}
    try:
        with out.open("wb") as stream:
            np.lib.format.write_array_header_1_0(stream, header)
            for block in layout.dot_rows():
                stream.write(table[block].tobytes())
    except (OSError, KeyboardInterrupt) as error:
        out.unlink(missing_ok=True)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise UsageError(f"{out}: cannot be written ({error.strerror}); check folder and space") from None
    return WrittenHeights(out, rows, cols, layout.grid_um)
