"""Whether a part without ridges follows its fixture: turn of its texture between the aligned pictures of poses.

The power spectrum of a texture does not know where it lies and turns with it. It is sampled over directions and
frequencies; its logarithm, without what changes slowly over the directions, as light from one side makes it, is
correlated with that of the first pose over all turns (E. De Castro and C. Morandi, "Registration of translated and
rotated images using finite Fourier transforms", IEEE PAMI 9, 1987). A turn is seen modulo 180°, of a lattice modulo its
symmetry. What lens and flat leave stands still in the picture, and is no texture of the part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.ridge_waves import MOST_MEDIANS, check_following

Image = npt.NDArray[np.float32]

STEP_DEG = 0.5
LEAST_POINTS = 24
"""Points along the side of a picture in which a turn can be seen."""
SLOWEST, FASTEST, NOISY = 4.0, 0.35, 0.5
"""Frequencies that count, from so many waves in a picture to so many a point; from which on there is noise alone."""
CLEAR, LEAST_RINGS = 1.5, 8
"""Power of a texture over noise, and at how many half waves in a picture it has to stand out."""
SLOW_ORDERS = 4
"""Orders over half a turn that light from one side makes."""
LIKE = 0.5
"""Correlation of spectra of one texture."""
AS_GOOD = 0.8
"""Share of the best correlation at which another turn explains the pictures as well: a lattice looks alike."""


def check_follows(
    pictures: Sequence[Image], stages_deg: Sequence[float], limit_deg: float
) -> tuple[str, ...]:
    """Check by its texture that a part follows its fixture.

    Args:
        pictures: P aligned pictures (rows, cols) of the region, without what several parts have in common.
        stages_deg: their P stage angles.
        limit_deg: largest turn against the first pose.

    Returns:
        A note on poses in which it cannot be seen.

    Raises:
        MeasurementError: the part turned on its fixture.
    """
    first, blind = stages_deg[0], []
    for stage_deg, turn in zip(stages_deg[1:], own_turns(pictures, stages_deg, limit_deg), strict=True):
        if turn is None:
            blind.append(f"{stage_deg:g}°")
        else:
            check_following({first: 0.0, stage_deg: turn}, limit_deg, period_deg=180.0)
    if not blind:
        return ()
    places = ", ".join(dict.fromkeys(blind))
    return (f"not watched: whether the part follows its fixture at {places} (its texture is not seen again)",)


def own_turns(
    pictures: Sequence[Image], stages_deg: Sequence[float], near_deg: float
) -> tuple[float | None, ...]:
    """(P − 1) turns of the texture in degrees, −90 to 90, from the first picture to each other one; None: not seen.

    Where several turns explain a texture as well, as that of a lattice, it is the smallest one. ``near_deg`` is how
    far a turn may be off.
    """
    if min(min(one.shape) for one in pictures) < LEAST_POINTS:
        return (None,) * (len(pictures) - 1)
    first, *others = map(_spectrum, pictures)
    return tuple(
        _turn(first, other, stage_deg - stages_deg[0], near_deg)
        for other, stage_deg in zip(others, stages_deg[1:], strict=True)
    )


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Fourier series over the directions of the logarithm of a power spectrum: (frequencies, orders).

    ``clear`` (frequencies,) is the share of the power that is no noise.
    """

    orders: npt.NDArray[np.complex128]
    clear: FloatArray


def _turn(first: _Spectrum, other: _Spectrum, moved_deg: float, near_deg: float) -> float | None:
    frequency = np.arange(len(first.clear)) + 2.0 * SLOWEST  # points of a circle count alike
    weight = (frequency * first.clear * other.clear)[:, None]
    alike = np.fft.irfft(
        (np.conj(first.orders) * other.orders * weight).sum(axis=0), n=round(180.0 / STEP_DEG)
    )
    power = [float((np.abs(one.orders) ** 2 * weight).sum()) for one in (first, other)]
    alike *= 90.0 / STEP_DEG / max(np.sqrt(power[0] * power[1]), 1e-30)
    turns = (np.arange(len(alike)) * STEP_DEG + 90.0) % 180.0 - 90.0
    best = alike.max()
    if best < LIKE or np.count_nonzero(weight) < LEAST_RINGS:
        return None
    peaks = (alike >= np.maximum(np.roll(alike, 1), np.roll(alike, -1))) & (alike >= AS_GOOD * best)
    turn = float(min(turns[peaks], key=abs))
    stands = abs((turn + moved_deg + 90.0) % 180.0 - 90.0) <= near_deg  # in the picture
    return None if stands and abs(turn) > near_deg else turn


def _spectrum(picture: Image) -> _Spectrum:
    side = min(picture.shape)
    known = np.nan_to_num(picture[:side, :side], nan=float(np.nanmean(picture))).astype(np.float64)
    known = np.minimum(known, MOST_MEDIANS * np.median(known))
    window: FloatArray = np.hanning(side)[:, None] * np.hanning(side)
    power = (
        np.abs(np.fft.fftshift(np.fft.fft2((known / known.mean() - 1.0) * window, (2 * side, 2 * side)))) ** 2
    )
    distance = np.hypot(*np.meshgrid(*[np.arange(-side, side)] * 2))
    noise = float(power[distance > 2.0 * NOISY * side].mean())
    radius = np.arange(2.0 * SLOWEST, 2.0 * FASTEST * side)[:, None]
    angle = np.radians(np.arange(0.0, 180.0, STEP_DEG))
    columns, rows = side + radius * np.cos(angle), side - radius * np.sin(angle)
    polar = cv2.remap(
        power.astype(np.float32), columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR
    ).astype(np.float64)
    orders = np.fft.rfft(np.log(polar + noise + 1e-30), axis=1)
    orders[:, :SLOW_ORDERS] = 0.0
    return _Spectrum(orders, np.clip(1.0 - CLEAR * noise / np.maximum(polar.mean(axis=1), 1e-30), 0.0, 1.0))
