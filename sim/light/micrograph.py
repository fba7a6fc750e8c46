"""Microscope pictures of a relief: its facets, imaged through a lens onto the pixels of a camera.

Every facet stands in the picture at its place in the map, whatever its height (no parallax), and shows its
radiance along the camera's axis (the aperture's cone of directions is not averaged). The lens is ideal: its
transfer function is that of a circular pupil in incoherent light, 2/π·(arccos s − s·√(1 − s²)) with
s = ν·λ/(2·NA) (Goodman, Introduction to Fourier Optics, section 6.3), times, out of focus, that of the
geometric disc of confusion, 2·J1(x)/x with x = 2π·ν·r and r = |Δz|·tan(arcsin NA). A pixel averages its square.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.microscope import Lens
from anisoscope.sim.light.picture import View

FloatImage = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

MAX_FINE_POINTS = 24_000_000


def transfer(lens: Lens, frequency_per_um: FloatArray) -> FloatArray:
    """Transfer of contrast at frequencies in the plane of the sample, 1 at 0."""
    if lens.na == 0.0:
        return np.ones_like(frequency_per_um)
    s = np.minimum(frequency_per_um / lens.cutoff_per_um, 1.0)
    passed = 2.0 / np.pi * (np.arccos(s) - s * np.sqrt(1.0 - s**2))
    if lens.disc_um > 0.0:
        from scipy.special import j1  # noqa: PLC0415 - slow to import

        x = np.maximum(2.0 * np.pi * lens.disc_um * frequency_per_um, 1e-6)
        passed = passed * (2.0 * j1(x) / x)
    return np.asarray(passed, dtype=np.float64)


@dataclass(frozen=True)
class Micrograph:
    """A microscope picture.

    Attributes:
        radiance: (rows, cols) in 1/sr per unit irradiance; NaN where ``missing`` or beyond the map.
        missing: (rows, cols) pixels that mostly show points that were not measured.
        covered: (rows, cols) pixels that mostly show the map, measured or not.
    """

    radiance: FloatImage
    missing: BoolArray
    covered: BoolArray


def subpixels(view: View, facet_um: tuple[float, float], lens: Lens) -> int:
    """Points along a side of a pixel: fine enough for the smallest facet and for all that the lens transfers.

    Raises:
        ModelError: the picture would take more than 24 million points.
    """
    smallest = min(facet_um[0] * view.squeeze[1], facet_um[1] * view.squeeze[0])
    count = max(1, int(np.ceil(view.pixel_um * max(1.0 / smallest, 2.0 * lens.cutoff_per_um) - 1e-6)))
    if count**2 * view.shape[0] * view.shape[1] > MAX_FINE_POINTS:
        raise ModelError(
            f"{view.shape[0]} × {view.shape[1]} pixels of {view.pixel_um:.3g} µm need {count} × {count} points each, "
            "too many at once: take a smaller region or a smaller numerical aperture"
        )
    return count


def facet_lookup(
    view: View, shape: tuple[int, int], facet_um: tuple[float, float], fine: int
) -> tuple[npt.NDArray[np.int32], BoolArray]:
    """Index of the facet at every point of the picture.

    Args:
        view: the view; the middle of the map stands on the rotation axis.
        shape: (rows, cols) of the facets; rows rise with +y.
        facet_um: size of a facet (y, x).
        fine: points along a side of a pixel.

    Returns:
        Flat index of the facet at each of (rows·fine, cols·fine) points, and whether the map is there.
    """
    row = (np.arange(view.shape[0] * fine) + 0.5) / fine - 0.5
    column = (np.arange(view.shape[1] * fine) + 0.5) / fine - 0.5
    x, y = view.sample_xy(row[:, None], column[None, :])
    i = np.floor(y / facet_um[0] + 0.5 * shape[0]).astype(np.int32)
    j = np.floor(x / facet_um[1] + 0.5 * shape[1]).astype(np.int32)
    inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
    return np.where(inside, i * np.int32(shape[1]) + j, 0).astype(np.int32), inside


def blurred(image: FloatImage, point_um: float, lens: Lens) -> FloatImage:
    """An image as the lens passes it on; the dark continues beyond its edges.

    Args:
        image: (rows, cols) at points no further apart than half the inverse cutoff.
        point_um: distance of the points.
        lens: the lens.
    """
    if lens.na == 0.0:
        return image
    from scipy import fft  # noqa: PLC0415 - slow to import

    reach = int(np.ceil((4.0 * lens.wavelength_um / lens.na + 2.0 * lens.disc_um) / point_um))
    rows, cols = (fft.next_fast_len(n + reach, real=True) for n in image.shape)
    fy, fx = np.fft.fftfreq(rows, point_um)[:, None], np.fft.rfftfreq(cols, point_um)[None, :]
    spectrum = fft.rfft2(image, s=(rows, cols))
    spectrum *= transfer(lens, np.hypot(fy, fx)).astype(np.float32)
    return np.asarray(fft.irfft2(spectrum, s=(rows, cols))[: image.shape[0], : image.shape[1]], np.float32)


def _binned(image: FloatImage, fine: int) -> FloatImage:
    rows, cols = image.shape[0] // fine, image.shape[1] // fine
    return np.asarray(image.reshape(rows, fine, cols, fine).mean(axis=(1, 3)), dtype=np.float32)


def micrograph(facets: FloatImage, facet_um: tuple[float, float], view: View, lens: Lens) -> Micrograph:
    """Image the radiances of facets onto the pixels of a camera.

    Blur is averaged over measured facets only: at a gap or at the edge of the map, pixels show their neighbours.

    Args:
        facets: (rows, cols) radiances per macroscopic area, rows rise with +y; NaN where not measured.
        facet_um: size of a facet (y, x).
        view: the view; the middle of the map stands on the rotation axis.
        lens: the lens.

    Raises:
        ModelError: too many points.
    """
    fine = subpixels(view, facet_um, lens)
    index, inside = facet_lookup(view, (facets.shape[0], facets.shape[1]), facet_um, fine)
    values = facets.ravel()[index]
    known = np.isfinite(values) & inside
    point_um = view.pixel_um / fine
    light = _binned(blurred(np.where(known, values, 0.0).astype(np.float32), point_um, lens), fine)
    weight = _binned(blurred(known.astype(np.float32), point_um, lens), fine)
    covered = _binned(inside.astype(np.float32), fine) >= 0.5
    present = _binned(known.astype(np.float32), fine)
    missing = covered & (present < 0.5 * _binned(inside.astype(np.float32), fine))
    shown = np.where(covered & ~missing, light / np.maximum(weight, 1e-3), np.nan)
    return Micrograph(shown.astype(np.float32), missing, covered)
