"""A printed sheet as the bench photographs it: ink on a substrate, by the model of Pranovich 2024 (Eq. 5).

Radiance under a lamp of unit irradiance: cosθi (Σ over inks of w·f + (1 − Σ w)·ρ/π), with w the share of the area under
an ink, f its BRDF and ρ the reflectance of the substrate, each as the camera's channels see it. Fine dots are mixed in
radiance.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError, RigFileError
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.bench.sheet import grain, grid_of, inked, normals, towards
from anisoscope.sim.light import threads
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import spectral_term
from anisoscope.sim.light.ink.shading import lobes
from anisoscope.sim.materials.inks import find_ink
from anisoscope.sim.materials.spectra import read_reflectance

Image = npt.NDArray[np.float32]

ENTRIES = 1024


def with_thicker_film(ink: Ink, shift_nm: float) -> Ink:
    """The ink with its spectra of ρ and c moved to longer wavelengths; what comes from beyond the ends is held."""
    if shift_nm == 0.0:
        return ink
    moved = ink.nm - shift_nm
    rho, c = (np.interp(moved, ink.nm, values) for values in (ink.rho, ink.c))
    return replace(ink, rho=tuple(rho.tolist()), c=tuple(c.tolist()))


def brushed(ink: Ink, anisotropy: float, brush_deg: float) -> Ink:
    """The ink with α across over α along the brushing as given; α_x·α_y stays, and so the brightness head-on.

    A brushing that the ink itself has is replaced.
    """
    if anisotropy == 1.0:
        return ink
    middle, stretch = np.sqrt(ink.alpha * ink.across), np.sqrt(anisotropy)
    return replace(ink, alpha=float(middle / stretch), alpha_y=float(middle * stretch), brush_deg=brush_deg)


def printed_ink(part: PrintPart) -> Ink:
    """The ink as it was printed, with the faults that concern all of it.

    Raises:
        RigFileError: there is no such ink, or it cannot be printed so.
    """
    ink = _found(part.ink, "ink")
    try:
        if part.alpha is not None:
            ink = replace(ink, alpha=part.alpha, alpha_y=None)
        if part.distribution is not None:
            ink = replace(ink, distribution=part.distribution)
        across = None if ink.alpha_y is None else ink.alpha_y * (1.0 + part.alpha_share)
        ink = replace(ink, alpha=ink.alpha * (1.0 + part.alpha_share), alpha_y=across)
        return brushed(with_thicker_film(ink, part.film_shift_nm), part.anisotropy, part.brush_deg)
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print: {problem}") from None


def _found(text: str, key: str) -> Ink:
    try:
        return find_ink(text)
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print.{key}: {problem}") from None


def _printed_inks(part: PrintPart) -> tuple[Ink, ...]:
    """The ink as it was printed, and the wrong one where some of it got among it.

    Raises:
        RigFileError: there is no such ink, or it cannot be printed so.
    """
    inks = (printed_ink(part),)
    if part.wrong_ink is None:
        return inks
    wrong = _found(part.wrong_ink, "wrong_ink")
    if part.wrong_share == 0.0:
        return inks
    return (*inks, wrong if part.distribution is None else replace(wrong, distribution=part.distribution))


def _tables(inks: tuple[Ink, ...], vision: Vision) -> Image:
    """(K, N, 6) tables of the inks; see `_table`.

    Raises:
        RigFileError: an ink whose wavelengths give no colour.
    """
    try:
        return np.stack([_table(ink, vision) for ink in inks])
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.print: {problem}") from None


def check_print(part: PrintPart, vision: Vision) -> None:
    """Look up all that the table of a print names, so that a wrong name shows before the first picture.

    Raises:
        RigFileError: an ink or a spectrum that cannot be used; the message names the key.
    """
    _tables(_printed_inks(part), vision)
    _reflectance(part.substrate, vision)


class PrintSample:
    """A printed sheet.

    Args:
        part: the print.
        size_mm: side of the sheet.
        raster_um: size of its pixels, if the print does not say it.
        vision: the camera's channels under the lamp.
        rng: grain and pinholes.

    Raises:
        RigFileError: an ink or a spectrum that cannot be used.
    """

    def __init__(
        self, part: PrintPart, size_mm: float, raster_um: float, vision: Vision, rng: np.random.Generator
    ) -> None:
        grid = grid_of(size_mm, part.raster_um or raster_um)
        self.pixel_um = (grid.raster_um, grid.raster_um)
        self.inks = _printed_inks(part)
        shares = [1.0 - part.wrong_share, part.wrong_share][: len(self.inks)]
        self._flakes = (np.radians(part.flake_tilt_deg), towards(part.flake_azimuth_deg))
        self._normal = normals(part, grid, size_mm)
        under_ink = inked(part, grid, rng)
        self._coverage = ((under_ink * grain(part, grid, rng))[..., None] * shares).astype(np.float32)
        self._colours = _tables(self.inks, vision)
        paper = _reflectance(part.substrate, vision)
        self._channels = len(paper)
        self._bare = ((1.0 - under_ink) / np.pi).astype(np.float32)[None] * paper.astype(np.float32)[
            :, None, None
        ]

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(channels, rows, cols) radiance; see `anisoscope.sim.bench.samples.Sample`."""
        facing = self._normal @ to_light.astype(np.float32)
        seen = np.maximum(facing, np.float32(0.0)) * (self._normal @ to_camera.astype(np.float32) > 0.0)
        shine = np.moveaxis(self._shine(to_light, to_camera), -1, 0)[: self._channels]
        return np.asarray(shine + self._bare * seen, dtype=np.float32)

    def _shine(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(rows, cols, 3) light from the inks."""
        from anisoscope.sim.light.ink.kernels import SCRATCH, shade  # noqa: PLC0415 - loads the compiler

        half = shingled(half_vector(to_light, to_camera), *self._flakes)
        beams = np.array([[*to_light, *half, 0.25, 0.0]], dtype=np.float32)
        tangent = self._tangent()
        result = np.empty_like(self._normal)
        eye = tuple(np.float32(value) for value in to_camera)
        given = (self._coverage, eye, beams, lobes(self.inks), self._colours[None], False)

        def rows(share: tuple[int, int]) -> None:
            work = np.empty((SCRATCH, tangent.shape[1]), dtype=np.float32)
            shade(self._normal, tangent, *given, *share, work, result)  # type: ignore[arg-type]

        threads.each(rows, threads.runs(len(tangent), threads.count()))
        return result

    def _tangent(self) -> Image:
        """(rows, cols, 3) the direction on the sheet that was +x before it was bent."""
        if all(ink.isotropic for ink in self.inks):
            return self._normal
        x = -self._normal[..., :1] * self._normal
        x[..., 0] += 1.0
        return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True), dtype=np.float32)


def shingled(half: FloatArray, tilt_rad: float, side: tuple[float, float]) -> FloatArray:
    """(3,) half vector as flakes see it whose mean normal leans by an angle to the side of (x, y), a unit vector.

    The sheet's own normal stays. On a sheet that is bent as well, the order of the two small turns is left open: a
    degree of each makes a twist of 0.01° about the normal.
    """
    x, y = side
    along, across, up = x * half[0] + y * half[1], y * half[0] - x * half[1], half[2]
    cosine, sine = np.cos(tilt_rad), np.sin(tilt_rad)
    along, up = cosine * along - sine * up, sine * along + cosine * up
    return np.array([x * along + y * across, y * along - x * across, up])


def _table(ink: Ink, vision: Vision) -> Image:
    """(N, 6) what depends on wavelength in the BRDF of an ink, as three channels see it, and its steps.

    A camera without filters has the first channel only. The layout is that of `sim.light.ink.kernels.shade`.
    """
    term = spectral_term(ink, np.linspace(0.0, 1.0, ENTRIES), "goniochromatic")
    seen = term @ vision.weights(ink.nm)
    seen = np.pad(seen, ((0, 0), (0, 3 - seen.shape[1])))
    steps = np.diff(seen, axis=0, append=seen[-1:])
    return np.concatenate([seen, steps], axis=1).astype(np.float32)


def _reflectance(substrate: float | str, vision: Vision) -> FloatArray:
    """(channels,) reflectance of the sheet as the channels see it.

    Raises:
        RigFileError: there is no such file, or it holds no reflectance.
    """
    if isinstance(substrate, str):
        try:
            nm, share = read_reflectance(Path(substrate))
        except AnisoscopeError as problem:
            raise RigFileError(f"sample.print.substrate: {problem}") from None
    else:
        nm, share = np.array([380.0, 780.0]), np.full(2, substrate)
    return np.asarray(share @ vision.weights(nm))
