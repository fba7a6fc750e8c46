"""Reflectances of our models: ridges, inks, height maps by rays and by waves, and designs of etched steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, hemisphere, refuse_huge, shuffled
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light import corrected, relief
from anisoscope.sim.light.ink import model as ink_model
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.wave.claims import mean_phase
from anisoscope.sim.light.wave.correlation import angular_map
from anisoscope.sim.light.wave.surface import WaveSurface, sampling_of
from anisoscope.sim.light.wave.windows import Extent, Window

Floats = npt.NDArray[np.float32]
Density = Callable[[FloatArray, float, float], FloatArray]
"""(F,) rising frequencies from 0, a wavelength in nm and |τ| to the (F, F) density in µm² over (y, x)."""

WAVE_NM = tuple(float(nm) for nm in range(400, 701, 20))
MIRROR = (
    "the surface reflects all light: multiply by the reflectance of its metal; no shadows, no polarisation"
)
_TILE = 512  # points a side: many coherence lengths, and its transform fits into the cache
_PHASE = (
    0.7  # radians by which the phase between highest and lowest point may change from one h_z to the next
)
_MOST_NODES = 48
_LEAST_H_Z = 0.1
_WITHIN_LAMP = 4.0  # nodes over the width of the lamp in the spectrum


def of_ridges(
    design: RidgeDesign,
    material: Material,
    bounces: int | None = 1,
    name: str = "ridges",
    *,
    neglected: bool = False,
) -> Reflectance:
    """Ridges of plastic by the corrected model; a ridge angle of 0 is a flat surface.

    Args:
        design: the ridges, along y.
        material: the plastic.
        bounces: reflections that count; None all, which takes 10 ms for each pair of directions.
        name: of the surface.
        neglected: say in the notes how much the next reflection would add; takes a second.
    """

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        found = corrected.radiance(to_light, to_camera, design, material, bounces)
        return np.asarray(found / to_light[:, 2])

    flat = design.ridge_angle_deg == 0.0
    notes: tuple[str, ...] = ()
    if not flat and bounces is not None:
        text = f"light that reflects more than {bounces} time{'s' * (bounces > 1)} between facets and walls is left out"
        notes = (text + (f"; {_next_reflection(design, material, bounces)}" if neglected else ""),)
    return Reflectance(
        name,
        lambda light, camera: above_horizon(light, camera, value),
        isotropic=flat and material.alpha_along == material.alpha_across,
        notes=notes,
        ridged=not flat,
    )


def _next_reflection(design: RidgeDesign, material: Material, bounces: int) -> str:
    """What the next reflection would add, over a few directions to 40°."""
    light, camera = hemisphere(16, 40.0), shuffled(hemisphere(16, 40.0, 0.5))
    known, more = (
        corrected.radiance(light, camera, design, material, count) for count in (bounces, bounces + 1)
    )
    share = more / known - 1.0
    return f"the next one would add {np.median(share):.1%} (median of directions to 40°, most {np.max(share):.0%})"


def of_ink(ink: Ink, model: ink_model.Model = "goniochromatic") -> Reflectance:
    """A structural-colour ink at the wavelengths of its file."""

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        return ink_model.brdf(ink, to_light, to_camera, model)

    return Reflectance(
        ink.name,
        lambda light, camera: above_horizon(light, camera, value),
        tuple(float(nm) for nm in ink.nm),
        isotropic=ink.alpha == ink.across,
    )


def of_heights(surface: relief.Relief, material: Material, name: str) -> Reflectance:
    """A height map by rays: direct light, with shadows; some tenths of a millisecond for each pair of directions.

    Args:
        surface: the map, prepared; its x axis is that of the reflectance.
        material: the plastic, with the roughness that the map does not resolve.
        name: of the surface.
    """

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        return relief.radiance(surface, to_light, to_camera, material) / to_light[:, 2]

    notes = [
        "light that reflects more than once on the map is left out (1 to 4 % at 5°, 10 to 25 % at 20° ridges)"
    ]
    if surface.missing_share > 0.0:
        notes.append(f"{surface.missing_share:.2%} of the facets have no height and are left out")
    return Reflectance(
        name,
        lambda light, camera: above_horizon(light, camera, value),
        notes=tuple(notes),
        costly=True,
    )


def of_design(
    name: str,
    density: Density,
    levels_um: Sequence[float],
    lengths_um: tuple[float, float, float],
    wavelengths_nm: Sequence[float] = WAVE_NM,
) -> Reflectance:
    """Etched steps by the mean spectrum of their design (Levin et al. 2013, Eq. 2, 5 and 23, claims 1 and 2).

    Args:
        name: of the design.
        density: its spectrum in half vectors' frequencies ω = 2h/λ, even in both.
        levels_um: heights, for the mirror-like share |τ|² at every wavelength and angle.
        lengths_um: side of a dot, widest block of steps and coherence length: what shows in the spectrum.
        wavelengths_nm: W rising wavelengths.

    Raises:
        UsageError: tables that would be huge.
    """
    axes, tables = [], []
    dot_um, block_um, coherence_um = lengths_um
    near = 1.0 / coherence_um + 4.0 / dot_um
    step = max(0.02 / block_um, 0.1 / coherence_um)
    for nm in wavelengths_nm:
        end = 2.0e3 / nm
        parts = np.arange(0.0, min(near, end), 0.1 / dot_um), np.arange(near, end, step), [end]
        axis = np.unique(np.concatenate(parts))
        refuse_huge(8 * axis.size**2 * len(wavelengths_nm), name)
        axes.append(axis)
        tables.append(np.stack([density(axis, nm, tau) for tau in (0.0, 1.0)]).astype(np.float32))

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        half = 0.5 * (to_light + to_camera)
        found = np.empty((len(half), len(tables)))
        for number, (nm, axis, table) in enumerate(zip(wavelengths_nm, axes, tables, strict=True)):
            row, col = (
                np.interp(np.abs(half[:, k]) * 2.0e3 / nm, axis, np.arange(axis.size)) for k in (1, 0)
            )
            share = np.array([abs(mean_phase(levels_um, 1e-3 * nm, h_z)) ** 2 for h_z in _NODES_H_Z])
            mirrored = np.interp(half[:, 2], _NODES_H_Z, share)
            wide, spike = (_bilinear(one, row, col) for one in table)
            found[:, number] = np.maximum((1.0 - mirrored) * wide + mirrored * spike, 0.0)
        return found * _wave_scale(half, to_light, to_camera, wavelengths_nm)

    return Reflectance(
        name,
        lambda light, camera: above_horizon(light, camera, value),
        tuple(map(float, wavelengths_nm)),
        notes=(MIRROR,),
    )


_NODES_H_Z = np.linspace(0.0, 1.0, 65)


def of_heights_by_waves(
    surface: WaveSurface,
    lamp_half_angle_deg: float,
    name: str,
    wavelengths_nm: Sequence[float] = WAVE_NM[::3],
    on_progress: Advance = silent,
) -> Reflectance:
    """A height map by scalar waves: the spectrum of its tiles, blurred by a lamp of some size.

    Args:
        surface: the heights: complete, and sampled finely enough for the phase.
        lamp_half_angle_deg: half of the angle under which the lamp is seen; renderers have none of their own.
        name: of the surface.
        wavelengths_nm: W rising wavelengths.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        HeightMapError: the map samples the phase too coarsely.
        ModelError: a lamp without size, or a map too deep for this.
        UsageError: tables that would be huge.
    """
    if not 0.0 < lamp_half_angle_deg <= 10.0:
        raise ModelError(
            f"waves need a lamp of some size, half an angle of more than 0° and up to 10°, not "
            f"{lamp_half_angle_deg:g}°: a point makes grain in all directions"
        )
    shortest = 1e-3 * min(wavelengths_nm)
    sampling_of(surface, shortest).check()
    depth = float(np.ptp(surface.height_um))
    nodes = 2 + int(np.ceil(4.0 * np.pi * depth / shortest * (1.0 - _LEAST_H_Z) / _PHASE))
    if nodes > _MOST_NODES:
        raise ModelError(
            f"the map is {depth:.3g} µm deep; for all directions waves take maps up to "
            f"{_PHASE * (_MOST_NODES - 2) * shortest / (4.0 * np.pi * (1.0 - _LEAST_H_Z)):.2g} µm: take rays "
            "(--optics rays), or fewer directions with `predict --model wave`"
        )
    h_z = np.linspace(_LEAST_H_Z, 1.0, nodes)
    window = Window(Extent("disc", 2.0 * float(np.sin(np.radians(lamp_half_angle_deg)))))
    lamps: list[_Spectra] = []
    for number, nm in enumerate(wavelengths_nm):
        on_progress("wavelengths", number, len(wavelengths_nm))
        lamps.append(_spectra(surface, 1e-3 * nm, window, h_z))
        refuse_huge(lamps[0].table.nbytes * len(wavelengths_nm), name)
    on_progress("wavelengths", len(wavelengths_nm), len(wavelengths_nm))

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        half = 0.5 * (to_light + to_camera)
        found = np.stack([one.at(half) for one in lamps], axis=-1)
        return found * _wave_scale(half, to_light, to_camera, wavelengths_nm)

    rows, cols = surface.shape
    size = f"{cols * surface.pixel_x_um:.4g} × {rows * surface.pixel_y_um:.4g} µm"
    resolved = 0.5e-3 * min(wavelengths_nm) / (2.0 * max(surface.pixel_x_um, surface.pixel_y_um))
    notes = [MIRROR, f"mean over {size} under a lamp of {2.0 * lamp_half_angle_deg:g}°"]
    if resolved < 1.0:
        notes.append(f"half vectors beyond {resolved:.2f} (of 1) are not resolved by its pixels: 0 there")
    return Reflectance(
        name,
        lambda light, camera: above_horizon(light, camera, value),
        tuple(map(float, wavelengths_nm)),
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Mean spectrum (K, Y, X) in µm² at K rising h_z, over even frequencies."""

    table: Floats
    h_z: FloatArray
    first: tuple[float, float]
    step: tuple[float, float]
    wavelength_um: float

    def at(self, half: FloatArray) -> FloatArray:
        """(N,) values at (N, 3) half vectors; 0 beyond what the pixels resolve."""
        place = [
            (2.0 * half[:, axis] / self.wavelength_um - self.first[k]) / self.step[k]
            for k, axis in enumerate((1, 0))
        ]
        inside = np.ones(len(half), dtype=bool)
        for one, count in zip(place, self.table.shape[1:], strict=True):
            inside &= (one >= 0.0) & (one <= count - 1)
        level = np.interp(half[:, 2], self.h_z, np.arange(self.h_z.size))
        low = np.minimum(level.astype(np.intp), self.h_z.size - 2)
        row, col = place
        below, above = (_bilinear(self.table, row, col, low + more) for more in (0, 1))
        return np.where(inside, np.maximum(below + (level - low) * (above - below), 0.0), 0.0)


def _spectra(surface: WaveSurface, wavelength_um: float, window: Window, h_z: FloatArray) -> _Spectra:
    rows, cols = surface.shape
    down, over = (max(1, round(n / _TILE)) for n in (rows, cols))
    tiles = [
        WaveSurface(part, surface.pixel_x_um, surface.pixel_y_um, surface.is_profile, surface.cells)
        for band in np.array_split(surface.height_um, down)
        for part in np.array_split(band, over, axis=1)
        if part.shape == (rows // down, cols // over)
    ]
    layers, first, step = [], [0.0, 0.0], [1.0, 1.0]
    for one in h_z:
        maps = [angular_map(tile, wavelength_um, window, float(one)) for tile in tiles]
        mean = np.mean([found.density for found in maps], axis=0)
        axes = maps[0].frequency_y, maps[0].frequency_x
        coarse = [
            max(1, int(window.source.size / wavelength_um / _WITHIN_LAMP / (axis[1] - axis[0])))
            for axis in axes
        ]
        layers.append(_block_means(mean, coarse))
        step = [float(axis[1] - axis[0]) * n for axis, n in zip(axes, coarse, strict=True)]
        first = [float(axis[:n].mean()) for axis, n in zip(axes, coarse, strict=True)]
    table = np.stack(layers).astype(np.float32)
    return _Spectra(table, h_z, (first[0], first[1]), (step[0], step[1]), wavelength_um)


def _block_means(values: npt.NDArray[np.floating], sides: Sequence[int]) -> npt.NDArray[np.floating]:
    """Means of blocks; the rest at the end, which is at the edge of what is resolved, is left out."""
    rows, cols = (n // side for n, side in zip(values.shape, sides, strict=True))
    cut = values[: rows * sides[0], : cols * sides[1]]
    return np.asarray(cut.reshape(rows, sides[0], cols, sides[1]).mean(axis=(1, 3)))


def _bilinear(
    table: Floats, y: FloatArray, x: FloatArray, layer: npt.NDArray[np.intp] | None = None
) -> FloatArray:
    """(N,) values of a table (rows, cols), or (layers, rows, cols), at fractional rows and columns."""
    rows, cols = table.shape[-2:]
    row, col = (np.clip(np.floor(at).astype(np.intp), 0, n - 2) for at, n in ((y, rows), (x, cols)))
    down, over = np.clip(y - row, 0.0, 1.0), np.clip(x - col, 0.0, 1.0)
    first = () if layer is None else (layer,)
    top = (1.0 - over) * table[(*first, row, col)] + over * table[(*first, row, col + 1)]
    low = (1.0 - over) * table[(*first, row + 1, col)] + over * table[(*first, row + 1, col + 1)]
    return np.asarray((1.0 - down) * top + down * low)


def _wave_scale(
    half: FloatArray, to_light: FloatArray, to_camera: FloatArray, wavelengths_nm: Sequence[float]
) -> FloatArray:
    """(N, W) γ²/(v_z·l_z): BRDF of a spectral density of 1 µm²."""
    angle = np.sum(half**2, axis=1) / half[:, 2]
    um = 1e-3 * np.asarray(wavelengths_nm, dtype=np.float64)
    return np.asarray((angle**2 / (to_light[:, 2] * to_camera[:, 2]))[:, None] / um**2)
