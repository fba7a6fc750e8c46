"""How much of the area a spot covers, from the pixels: cells that it touches are larger than what is off in them.

The pixels of the mosaic are taken by fours, each with all its colours, in the pose in which the spot stands out most.
Counted are those beyond the limit of a cell, in the spot's cells and in the cells around: a rim that reaches into a
cell without making it deviate belongs to the spot as well.
"""

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.prints.colour import Eye
from anisoscope.kinds.prints.measurement import Mosaics
from anisoscope.rig.bayer import CHANNELS, channel_of_pixels

Labels = npt.NDArray[np.int32]

_DARK = 1e-7


def spot_shares(
    labels: Labels, off: FloatArray, pictures: Mosaics, grid: Grid, eye: Eye, usual: FloatArray, limit: float
) -> FloatArray:
    """(spots,) share of the map's area in which pixels are off by more than a limit.

    Args:
        labels: (cell rows, cell cols) number of the spot of each cell from 1 on, 0 for none.
        off: (P, cell rows, cell cols) CIEDE2000 of the cells.
        pictures: of the P poses.
        grid: raster of the cells.
        eye: conversion of channels to colours.
        usual: (P, 3) channels of the region, from which pixels are off.
        limit: CIEDE2000.
    """
    found, assigned = np.zeros(int(labels.max())), labels > 0
    by_pose: dict[int, tuple[FloatArray, npt.NDArray[np.intp]]] = {}
    for spot in range(1, len(found) + 1):
        inside = labels == spot
        pose = int(off[:, inside].mean(axis=1).argmax())
        around = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~assigned
        assigned |= around
        if pose not in by_pose:
            by_pose[pose] = _fours(pictures, pose, grid)
        fours, cell = by_pose[pose]
        chosen = (inside | around).ravel()[cell]
        apart = eye.difference(fours[chosen], np.broadcast_to(usual[pose], (int(chosen.sum()), 3)))
        number = np.bincount(cell[chosen], minlength=labels.size)
        over = np.bincount(cell[chosen][apart > limit], minlength=labels.size)
        found[spot - 1] = np.sum(over / np.maximum(number, 1)) / labels.size
    return found


def fours_of(value: npt.NDArray[np.float32], filters: str) -> npt.NDArray[np.float32]:
    """(3, rows/2, cols/2) red, green, blue of the fours of pixels of a mosaic; NaN where one cannot be used."""
    rows, cols = (size - size % 2 for size in value.shape)
    found = np.zeros((len(CHANNELS), rows // 2, cols // 2), dtype=np.float32)
    channel = channel_of_pixels(filters, (2, 2))
    for (i, j), k in np.ndenumerate(channel):
        found[k] += value[i:rows:2, j:cols:2] / np.float32(np.sum(channel == k))
    return found


def _fours(pictures: Mosaics, pose: int, grid: Grid) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """(N, 3) channels of the usable fours of pixels in the region, and (N,) their cells."""
    view = pictures.views[pose]
    fours = fours_of(view.image.value, pictures.filters)
    y, x = np.mgrid[: fours.shape[1], : fours.shape[2]] * 2.0 + 0.5
    back = np.linalg.inv(view.placement.homography @ grid.to_mm())
    across, down, scale = np.einsum("ij,jrc->irc", back, np.stack([x, y, np.ones_like(x)]))
    column, row = (np.floor(axis / scale + 0.5).astype(np.intp) for axis in (across, down))
    inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
    inside &= np.isfinite(fours).all(axis=0)
    return np.maximum(fours[:, inside].T.astype(np.float64), _DARK), row[inside] * grid.shape[1] + column[
        inside
    ]
