"""What stands out of a ridged surface: burrs, spikes and pits."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.heightmap import row_blocks

Mask = npt.NDArray[np.bool_]
Kind = Literal["burr", "spike", "pit"]
OUTLINE = 3.5
PEAK = 6.0
SPIKE_POINTS = 4
MARGIN = 3


@dataclass(frozen=True)
class Outlier:
    """Outlier from the ridges.

    Attributes:
        kind: "burr" (raised) or "pit" (sunken) of more than four points, or "spike" of fewer, up or down.
        x_um: position of its centre.
        y_um: position of its centre.
        height_um: largest height over the ridge, below 0 for what is sunken.
        area_um2: area above the outline, 3.5 standard deviations of the surface.
        volume_um3: volume between it and the ridge within that area.
        points: measured points within that area.
    """

    kind: Kind
    x_um: float
    y_um: float
    height_um: float
    area_um2: float
    volume_um3: float
    points: int


FINEST = 0.01
KINK = 0.35  # a corner between two bins makes 0.25 of points, of medians of bins more
ASIDE = 0.1  # of the range over two bins


def limits(
    sigma_um: float, spread_um: FloatArray, height_um: FloatArray, inside: Mask, *, resolved: bool
) -> tuple[FloatArray, FloatArray]:
    """(bins,) outline and least peak height of outliers.

    Off the facets the spread about the median ridge counts. Where walls are not resolved, one that stands a little
    aside makes large differences, and the height range of the median ridge within a bin is added; where they are, what
    straight lines between bins make of a corner, or what a wall a fifth of a bin aside makes. Nothing below a
    hundredth of what a facet falls from bin to bin stands out: on a surface without noise rounding would.

    Args:
        sigma_um: standard deviation of the facets about their planes.
        spread_um: (bins,) spread about the median ridge.
        height_um: (bins,) median ridge.
        inside: (bins,) whether the bin lies on the facet.
        resolved: whether walls are wider than about two pixels.
    """
    near = np.stack([np.roll(height_um, k) for k in (-1, 0, 1)])
    kink = KINK * np.abs(near[0] - 2.0 * near[1] + near[2])
    corner = np.max([np.roll(kink, k) for k in (-1, 0, 1)], axis=0)
    steep = np.ptp(near, axis=0)
    jump = np.where(inside, 0.0, np.maximum(corner, ASIDE * steep) if resolved else steep)
    finest = max(sigma_um, FINEST * float(np.median(np.abs(np.diff(height_um)))))
    sigma = np.where(inside, finest, np.maximum(finest, spread_um))
    return OUTLINE * sigma + jump, PEAK * sigma + jump


def find_outliers(
    above_um: FloatArray,
    place: npt.NDArray[np.int16],
    outline_um: FloatArray,
    peak_um: FloatArray,
    pixel_um: tuple[float, float],
) -> tuple[tuple[Outlier, ...], Mask]:
    """List outliers, largest volume first, and mask them with a margin.

    Points beyond the outline, of one sign, with gaps of four pixels at most, count together if one of them reaches the
    least peak height of its place. The gaps are for burrs that lie across a wall, where the outline is higher.

    Args:
        above_um: (rows, cols) height over the ridge, NaN where unknown.
        place: (rows, cols) bin of the folded ridge.
        outline_um: (bins,) height from which a point may belong to something.
        peak_um: (bins,) least peak height.
        pixel_um: (y, x).

    Returns:
        The list; and (rows, cols) the points of everything listed, with a margin of three pixels around burrs and
        pits, whose flanks lie below the outline, and of one around spikes.
    """
    import cv2  # noqa: PLC0415 - slow to import

    found: list[Outlier] = []
    large, small = (np.zeros(above_um.shape, dtype=np.uint8) for _ in range(2))
    for sign in (1.0, -1.0):
        beyond = np.empty(above_um.shape, dtype=np.uint8)
        for block in row_blocks(above_um.shape):
            beyond[block] = sign * above_um[block] > outline_um[place[block]]
        where = np.flatnonzero(beyond)
        if where.size == 0:
            continue
        near = cv2.dilate(beyond, np.ones((5, 5), dtype=np.uint8))
        labels = cv2.connectedComponents(near, connectivity=8, ltype=cv2.CV_32S)[1].ravel()[where]
        order = np.argsort(labels, kind="stable")
        where, labels = where[order], labels[order]
        starts = np.flatnonzero(np.diff(labels, prepend=-1))
        height = sign * above_um.ravel()[where]
        peak = np.maximum.reduceat(height, starts)
        listed = np.logical_or.reduceat(height >= peak_um[place.ravel()[where]], starts)
        count = np.diff(np.append(starts, labels.size))
        volume = np.add.reduceat(height, starts)
        i, j = np.divmod(where, above_um.shape[1])
        y, x = np.add.reduceat(i, starts) / count, np.add.reduceat(j, starts) / count
        for target, of in ((large, count > SPIKE_POINTS), (small, count <= SPIKE_POINTS)):
            target.ravel()[where[np.repeat(listed & of, count)]] = 1
        area = pixel_um[0] * pixel_um[1]
        for k in np.flatnonzero(listed).tolist():
            raised: Kind = "burr" if sign > 0 else "pit"
            kind: Kind = "spike" if count[k] <= SPIKE_POINTS else raised
            found.append(
                Outlier(
                    kind, float(x[k] * pixel_um[1]), float(y[k] * pixel_um[0]), float(sign * peak[k]),
                    float(count[k] * area), float(sign * volume[k] * area), int(count[k]),
                )
            )  # fmt: skip
    found.sort(key=lambda one: -abs(one.volume_um3))
    wide = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN + 1, 2 * MARGIN + 1))
    out = (cv2.dilate(large, wide) > 0) | (cv2.dilate(small, np.ones((3, 3), dtype=np.uint8)) > 0)
    return tuple(found), out
