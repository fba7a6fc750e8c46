"""Predict a folder of published height maps and compare with the reflectance that was published with each.

The folder is that of Zeng et al., "Designing and Fabricating Color BRDFs with Differentiable Wave Optics" (ACM TOG,
2025, doi 10.1145/3763275; repository color-brdfs-with-wave-optics): each ``…/hmap.exr`` (heights in µm, one unit of a
surface that repeats) has a ``scale=8_render.exr`` beside it (64 × 64 directions of the light, rows along x). Names say
``pixelsize=…`` (a cell: eight pixels of the map, µm), ``sigma=…_blur`` (Gaussian coherence at 500 nm in µm, 2.6 where
it is missing) and, of the inner folder, ``sigma=…`` (blur of the cells in µm). Nothing is fetched or kept.

**The unit.** A published map is the corner of three by three units, blurred as if there were no height beyond: two of
its edges are not those of the surface that was rendered. The map is linear in the heights of its 32 × 32 cells, which
follow from it to 3·10⁻⁷; from them the unit is made anew, blurred as one that repeats.

**Coherence.** A Gaussian coherence of the standard deviation σ·λ/500 nm is a lamp of the standard deviation
500 nm/(2√2·π·σ) in direction cosines. Their factor of the angles is (1 + cos θ)²/(4·cos θ·λ²); ours (Levin et al. 2013,
Eq. 23) is turned into it. One scale is fitted a design; what is compared is the luminance of eight wavelengths. The
largest direction cosine is in no file: that of `REACHES` is taken which is nearest.

**Pieces.** They take the surface for Gaussian pieces of the width of a pixel (Yan et al. 2018), each with the slope of
its two neighbours. `pieces` does the same, absolutely, and agrees with what was published: what is left between that
and a prediction is the pieces, which are no scalar waves where a step is as wide as a pixel. The same pieces of half a
pixel (the unit interpolated by its Fourier series) say so: the last column compares the prediction with them.

``--design STEPS`` designs the targets that have a formula anew, by the search of ``anisoscope design hologram``, with
their cells, range of heights and blur, and compares both designs with the target by `pieces`.

    python -Im pip install 'anisoscope[exr]'
    python tools/public_designs.py FOLDER
"""

import argparse
import re
import sys
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import OpenEXR
from scipy.signal import resample

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.prediction.angular import AngularTask, angular_reflectance
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.design.gradient import PictureTask, design_picture
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import matching_functions
from anisoscope.sim.light.colour.spaces import XYZ_TO_SRGB

NM = tuple(420.0 + 32.5 * (k + 0.5) for k in range(8))
ALUMINIUM = np.array([0.92272, 0.92042, 0.91842, 0.91635, 0.91442, 0.91111, 0.90800, 0.90336])
REACHES = (0.25, 0.3, 0.4, 0.5)
POINTS, CELLS, REPEATED = 64, 32, 8
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
INTERPOLATED = 1, 2, 4
POINT_DEG = 1e-4
"""Lens: single directions, not means over their squares."""
FARTHEST = 4.5
"""Standard deviations of the coherence, as spectrum, within which orders count."""
NODES, FEW_NODES, FINER = 8, 4, 2
GAMMA, LEVELS = 2.2, 256
COHERENCE = 2.0 * np.sqrt(2.0) * np.pi / np.sqrt(12.0)
"""Coherence length whose square lamp has the variance of their Gaussian one, in standard deviations of theirs."""
COLOURS = {
    "red": (1.0, 0.0, 0.0), "orange": (1.0, 0.5, 0.0), "yellow": (1.0, 1.0, 0.0), "green": (0.0, 1.0, 0.0),
    "cyan": (0.0, 1.0, 1.0), "blue": (0.0, 0.0, 1.0), "purple": (0.5, 0.0, 1.0), "white": (1.0, 1.0, 1.0),
}  # fmt: skip
DISC, UNIFORM = 0.09, 0.15
"""Radius of the disc of colour, and reach of the uniform targets, direction cosines."""


def channels(path: Path) -> FloatArray:
    """(rows, cols) heights, or (rows, cols, 3) colours, of a file."""
    with OpenEXR.File(str(path)) as file:
        found = file.channels()
        return np.array(found["RGB" if "RGB" in found else next(iter(found))].pixels, dtype=np.float64)


@dataclass(frozen=True)
class Design:
    """A published design.

    Attributes:
        path: its height map.
    """

    path: Path

    def _named(self, pattern: str, usual: float | None = None) -> float:
        found = re.search(pattern, str(self.path.parent))
        if found is None and usual is None:
            raise SystemExit(
                f"{self.path}: its folder says no {pattern}: give the folder of the published designs"
            )
        return float(found[1]) if found else float(usual or 0.0)

    @property
    def cell_um(self) -> float:
        """Side of a cell."""
        return self._named(r"pixelsize=([\d.]+)")

    @property
    def sigma_um(self) -> float:
        """Standard deviation of the coherence at 500 nm."""
        return self._named(r"sigma=([\d.]+)_blur", 2.6)

    @property
    def blur_um(self) -> float:
        """Standard deviation of the blur of the cells."""
        return self._named(r"/sigma=([\d.]+)_noise")

    @cached_property
    def height_um(self) -> FloatArray:
        """(256, 256) heights as they were published, rows along x."""
        return channels(self.path)

    @cached_property
    def colours(self) -> FloatArray:
        """(64, 64, 3) linear sRGB as it was published, rows along x."""
        return channels(self.path.with_name("scale=8_render.exr"))

    @cached_property
    def cells(self) -> FloatArray:
        """(32, 32) heights of the cells."""
        back = np.linalg.pinv(blur(self.cell_um, self.blur_um, CELLS)[0])
        return np.asarray(back @ self.height_um @ back.T)

    def surface(self, cells: FloatArray) -> FloatArray:
        """(8 N, 8 N) heights of a unit of (N, N) cells of this design's size, blurred as one that repeats."""
        number = len(cells)
        wide = blur(self.cell_um * CELLS / number, self.blur_um, number)[1]
        return np.asarray(wide @ cells @ wide.T)


def blur(cell_um: float, sigma_um: float, cells: int) -> tuple[FloatArray, FloatArray]:
    """(8 N, N) heights along a line by those of its cells: of the first of three units, and of the middle one."""
    places = np.arange(-REPEATED, REPEATED + 1)
    kernel = np.exp(-0.5 * (places * cell_um / REPEATED / sigma_um) ** 2)
    line = np.tile(np.kron(np.eye(cells), np.ones((REPEATED, 1))), (3, 1))
    found, size = np.zeros_like(line), len(line)
    for place, weight in zip(places.tolist(), kernel / kernel.sum(), strict=True):
        first, last = max(0, -place), min(size, size - place)
        found[first:last] += weight * line[first + place : last + place]
    return found[: size // 3], found[size // 3 : 2 * size // 3]


def lights(reach: float) -> FloatArray:
    """(64,) direction cosines of the light."""
    return np.asarray(((np.arange(POINTS) + 0.5) / POINTS * 2.0 - 1.0) * reach)


def pieces(
    height_um: FloatArray, pixel_um: float, sigma_um: float, v: FloatArray, nodes: int = NODES
) -> FloatArray:
    """(8, P, P) reflectance of a unit that repeats as Gaussian pieces, light at cosines v (P,), rows along x.

    The field of a piece at μ with height z and slopes s is exp(−2πi((1 + cos θ)z/λ + ψ·μ))·exp(−2π²(l/2)²·|(1 +
    cos θ)s/λ + ψ|²) with ψ = ω/λ; it is interpolated between so many ``nodes``, directions along each axis.
    """
    points, reach = len(v), float(np.abs(v).max())
    slopes = [
        (np.roll(height_um, -1, axis) - np.roll(height_um, 1, axis)) / (2.0 * pixel_um) for axis in (0, 1)
    ]
    node = reach * np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    share = np.ones((points, nodes))
    for one in range(nodes):
        for other in (k for k in range(nodes) if k != one):
            share[:, one] *= (v - node[other]) / (node[one] - node[other])
    frequency = np.fft.fftfreq(len(height_um), pixel_um)
    found = np.zeros((len(NM), points, points))
    for number, um in enumerate(1e-3 * np.array(NM)):
        narrow = 2.0 * np.pi * sigma_um * um / 0.5
        near = np.flatnonzero(np.abs(frequency) < reach / um + FARTHEST / narrow)
        fields = np.empty((nodes, nodes, len(near), len(near)), dtype=np.complex128)
        for i, x in enumerate(node):
            for j, y in enumerate(node):
                up = 1.0 + np.sqrt(max(1.0 - x * x - y * y, 0.0))
                off = (up * slopes[0] + x) ** 2 + (up * slopes[1] + y) ** 2
                wave = np.exp(-2j * np.pi / um * up * height_um - 0.5 * (np.pi * pixel_um / um) ** 2 * off)
                fields[i, j] = np.fft.fft2(wave)[np.ix_(near, near)] / wave.size
        away = frequency[near] - v[:, None] / um
        weight = np.where(np.abs(away) < FARTHEST / narrow, np.exp(-((narrow * away) ** 2)), 0.0)
        for i in range(points):
            rows = np.flatnonzero(weight[i])
            along = np.tensordot(share[i], fields[:, :, rows], axes=(0, 0))
            for j in range(points):
                cols = np.flatnonzero(weight[j])
                order = np.tensordot(share[j], along[:, :, cols], axes=(0, 0))
                up = np.sqrt(1.0 - v[i] ** 2 - v[j] ** 2)
                factor = (1.0 + up) ** 2 / (4.0 * um**2 * up) * narrow**2 / np.pi
                found[number, i, j] = factor * (weight[i, rows] @ np.abs(order) ** 2 @ weight[j, cols])
    return found


def seen(spectrum: FloatArray) -> FloatArray:
    """(P, P, 3) linear sRGB of (8, P, P) reflectances on aluminium, luminance 1 where all are 1."""
    nm, matching = matching_functions()
    weight = np.stack([np.interp(NM, nm, one) for one in matching.T], axis=-1)
    weight *= ALUMINIUM[:, None] / weight[:, 1].sum()
    return np.asarray(np.tensordot(spectrum, weight, axes=(0, 0)) @ XYZ_TO_SRGB.T)


def predicted(height_um: FloatArray, design: Design, reach: float) -> FloatArray:
    """(8, 64, 64) the same by the angular map of ``predict --map``."""
    lamp = float(np.degrees(np.arcsin(0.5 / (2.0 * np.sqrt(2.0) * np.pi * design.sigma_um))))
    edge = reach * (1.0 - 1.0 / POINTS)
    task = AngularTask(NM, (0.0, 0.0), edge, POINTS, 0.0, POINT_DEG, lamp_sigma_deg=lamp)
    pixel_um = design.cell_um / REPEATED
    surface = HeightMap(height_um.T.copy(), pixel_um, pixel_um)
    for times in INTERPOLATED:  # some are steeper than their pixels resolve; the heights are smooth
        try:
            found = angular_reflectance(surface, task, interpolate=times, periodic=True)
        except HeightMapError:
            if times == INTERPOLATED[-1]:
                raise
        else:
            break
    v_x, v_y = np.meshgrid(found.v, found.v)
    upright = 0.5 * (1.0 + np.sqrt(1.0 - v_x**2 - v_y**2))
    return np.asarray((upright**2 * found.brdf).transpose(0, 2, 1))


def off(found: FloatArray, wanted: FloatArray) -> float:
    """Rms of the difference over that of what is wanted, at the best scale."""
    scale = float(np.sum(found * wanted) / np.sum(found**2))
    return float(np.sqrt(np.mean((scale * found - wanted) ** 2) / np.mean(wanted**2)))


def reach_of(design: Design) -> float:
    """The largest direction cosine of what was published."""
    surface, pixel_um = design.surface(design.cells), design.cell_um / REPEATED
    wanted = (design.colours @ LUMINANCE)[::4, ::4]

    def misfit(reach: float) -> float:
        return off(
            seen(pieces(surface, pixel_um, design.sigma_um, lights(reach)[::4], FEW_NODES)) @ LUMINANCE,
            wanted,
        )

    return min(REACHES, key=misfit)


def target(design: Design, reach: float) -> FloatArray | None:
    """(64, 64, 3) linear sRGB that the design was made for, where its folder names a formula; rows along x.

    Theirs are formulas of the angle θ to the mirror direction, in colours as displayed (power 1/2.2).
    """
    name = design.path.parent.parent.name if "_noise" in design.path.parent.name else design.path.parent.name
    kind = re.search(r"_((?:aniso_)?anti_mirror|diffuse|uniform)_pixelsize=[\d.]+_(.+?)(?:_32)?$", name)
    if kind is None:
        return None
    x, y = np.meshgrid(lights(reach), lights(reach), indexing="ij")
    up = np.sqrt(1.0 - x**2 - y**2)
    angle = np.arccos(np.clip(up, -1.0, 1.0))
    hole = 1.0 - np.exp(-(angle**2) / (2.0 * 0.05**2))
    half = np.stack([x, y], axis=-1) / np.sqrt(2.0 + 2.0 * up)[..., None]
    narrow, wide = 0.015, 0.06
    streak = np.exp(-0.5 * ((half[..., 0] / narrow) ** 2 + (half[..., 1] / wide) ** 2))
    light = {
        "anti_mirror": hole * np.exp(-(angle**2) / (2.0 * 0.12**2)),
        "aniso_anti_mirror": (1.0 - np.exp(-(angle**2) / (2.0 * 0.7**2))) * streak,
        "diffuse": np.exp(-(angle**2) / (2.0 * 0.15**2)),
        "uniform": np.ones_like(angle),
    }[kind[1]]
    red, blue = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    inside = np.hypot(x, y) <= DISC
    colour = {
        "iri": np.where((y > 0.0)[..., None], blue, red),
        "disk_iri": np.where(inside[..., None], red, blue),
        "inv_disk_iri": np.where(inside[..., None], blue, red),
    }.get(kind[2])
    if colour is None:
        colour = np.array(COLOURS[kind[2]])
    return np.asarray((light[..., None] * colour) ** GAMMA)


def score(found: FloatArray, wanted: FloatArray) -> float:
    """`off` of colours as displayed, at the scale that is best there."""
    shown, aim = (np.maximum(one, 0.0) ** (1.0 / GAMMA) for one in (found, wanted))
    return off(shown, aim)


def designed(design: Design, wanted: FloatArray, reach: float, steps: int, seed: int = 1) -> FloatArray:
    """(256, 256) or so heights of an own design of a target, with their cells, range of heights and blur."""
    task = PictureTask(
        np.ascontiguousarray(wanted.transpose(1, 0, 2)),
        tuple(np.linspace(0.0, float(np.ptp(design.cells)), LEVELS).tolist()),
        Illuminant("equal energy", (380.0, 780.0), (1.0, 1.0)),
        cells=CELLS,
        cell_um=design.cell_um,
        coherence_um=COHERENCE * design.sigma_um,
        reach=0.5 * reach,
        blur_um=design.blur_um,
        displayed=True,
    )
    found = design_picture(task, np.random.default_rng(seed), steps)
    return design.surface(found.height_um.T)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of the published designs, such as output")
    parser.add_argument("--design", type=int, metavar="STEPS", help="design targets anew, in so many steps")
    parser.add_argument("--only", default="", help="designs whose folder holds this text")
    given = parser.parse_args()
    designs = [Design(one) for one in sorted(given.folder.rglob("hmap.exr")) if given.only in str(one)]
    if not designs:
        raise SystemExit(f"{given.folder}: holds no hmap.exr: give the folder of the published designs")
    (_judged if given.design is None else _designed)(designs, given)
    return 0


def _row(cells: list[str]) -> None:
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


def _head(cells: list[str]) -> None:
    _row(cells)
    _row(["---"] * len(cells))


def _judged(designs: list[Design], given: argparse.Namespace) -> None:
    columns = "map as published", "unit", "pieces", "unit and half a pixel"
    _head(["design", "cell [µm]", "coherence [µm]", "reach", *columns])
    every = []
    for one in designs:
        reach, wanted = reach_of(one), one.colours @ LUMINANCE
        unit, v = one.surface(one.cells), lights(reach)
        finer = resample(resample(unit, FINER * len(unit), axis=0), FINER * len(unit), axis=1)
        shown = [
            seen(spectrum) @ LUMINANCE
            for spectrum in (
                predicted(one.height_um, one, reach),
                predicted(unit, one, reach),
                pieces(unit, one.cell_um / REPEATED, one.sigma_um, v),
                pieces(finer, one.cell_um / REPEATED / FINER, one.sigma_um, v, FEW_NODES),
            )
        ]
        rms = [*(off(light, wanted) for light in shown[:3]), off(shown[1], shown[3])]
        every.append(rms)
        numbers = [f"{number:g}" for number in (one.cell_um, one.sigma_um, reach)]
        _row([str(one.path.parent.relative_to(given.folder)), *numbers, *(f"{number:.1%}" for number in rms)])
    for words, shares in zip(columns, np.array(every).T, strict=True):
        within = f"{np.sum(shares <= 0.03)} of {len(shares)} within 3 %"
        sys.stdout.write(
            f"\n{words}: median {np.median(shares):.1%} rms, {within}, worst {shares.max():.1%}\n"
        )


def _designed(designs: list[Design], given: argparse.Namespace) -> None:
    _head(["design", "s of processor", "theirs", "ours"])
    every = []
    for one in designs:
        if target(one, UNIFORM) is None:
            continue
        reach = UNIFORM if "_uniform_" in str(one.path) else reach_of(one)
        wanted = np.asarray(target(one, reach))
        begin = time.process_time()
        own = designed(one, wanted, reach, given.design)
        took = time.process_time() - begin
        scores = [
            score(
                seen(pieces(height, CELLS * one.cell_um / len(height), one.sigma_um, lights(reach))), wanted
            )
            for height in (one.surface(one.cells), own)
        ]
        every.append(scores)
        name = str(one.path.parent.relative_to(given.folder))
        _row([name, f"{took:.0f}", *(f"{number:.1%}" for number in scores)])
    better = int(np.sum(np.diff(np.array(every), axis=1) < 0.0))
    sys.stdout.write(f"\n{len(every)} targets: ours are nearer in {better}\n")


if __name__ == "__main__":
    sys.exit(main())
