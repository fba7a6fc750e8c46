"""Colour map of a print: colour differences and lean of the flakes cell by cell, deviating spots and their area.

Each cell is compared with the whole region, so that uniform deviations cancel; the difference to the prediction is
computed as well. A linear fit over all poses gives the lean of every cell, and a plane through the leans the curl of
the sheet.

The area of a spot is counted in pixels, because the cells that a spot touches are larger than the spot. The pixels of
the mosaic are taken in quads, each with all its colours, in the pose in which the spot has most contrast. Pixels beyond
the limit of a cell count, in the spot's cells and in the cells around them: a rim that extends into a cell without
making it deviate belongs to the spot.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.prints.colour import Eye
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PrintFit
from anisoscope.kinds.prints.measurement import MeasuredPrint, Mosaics, fours_of
from anisoscope.kinds.prints.recipe import PrintArea
from anisoscope.kinds.prints.record import MOST_SPOTS, PrintMapRecord, SpotRecord
from anisoscope.kinds.prints.reference_comparison import GoldenArea
from anisoscope.record.verdict import Verdict

MAX_NOISE_SHARE = 0.25
"""Largest noise floor of the map, as a share of the limit of a cell."""
FIELD_TILT_DEG = 0.03
"""Standard uncertainty of a tilt across the region: the light's direction changes a little over the field."""
U_OF_LAMP = 0.2
"""Relative standard uncertainty of what a near lamp turns: the lobe of real flakes is not that of the ink file."""
_LOCAL = ("tilt_x_deg", "tilt_y_deg", "alpha", "red", "green", "blue")
_FLOOR = 0.005
U_EDGE_SHARE = 0.05
"""Relative standard uncertainty of an area counted in pixels: lens and pixels blur its edge."""


@dataclass(frozen=True, eq=False)
class PrintMap:
    """The cells of a print, (rows, cols), first row at the top.

    Attributes:
        local: CIEDE2000 of every cell against the region, the largest over the poses.
        total: CIEDE2000 against the prediction, the largest over the poses.
        lean_deg: (2, rows, cols) lean of the flakes toward +x and +y of the print, against the region's.
        deviating: cells whose local difference exceeds the limit.
        record: its numbers and verdict. The limit of golden prints has no guard band, because their scatter holds the
            uncertainty of the measurement.
    """

    local: FloatArray
    total: FloatArray
    lean_deg: FloatArray
    deviating: npt.NDArray[np.bool_]
    record: PrintMapRecord

    def with_learnt_limit(self, golden: GoldenArea, alpha: float) -> "PrintMap":
        """The same map judged by the areas of the golden prints."""
        verdict = Verdict.FAIL if golden.p_value < alpha else Verdict.PASS
        learnt = {"max_share": golden.limit, "verdict": verdict, "learnt": True, "p_value": golden.p_value}
        return replace(self, record=self.record.model_copy(update=learnt))


def map_of(
    measured: MeasuredPrint, expected: PrintExpectation, fit: PrintFit, rule: PrintArea, coverage: float
) -> PrintMap:
    """Judge the map of a print.

    Args:
        measured: cells and region.
        expected: the prediction.
        fit: the print as a whole.
        rule: thresholds.
        coverage: guard band by the standard uncertainty of the share.

    Raises:
        MeasurementError: the cells are too noisy.
    """
    eye, usual = expected.eye, np.median(measured.cells, axis=(2, 3))
    measured = _under_far_lamp(measured, expected)
    cells = np.maximum(np.moveaxis(measured.cells, 1, -1), 1e-7)
    apart = eye.difference(cells, np.broadcast_to(usual[:, None, None], cells.shape))
    local = apart.max(axis=0)
    predicted = np.broadcast_to(expected.channels[:, None, None], cells.shape)
    total = eye.difference(cells, predicted).max(axis=0)
    noise = _noise_floor(eye, usual, measured.cell_noise)
    limit = MAX_NOISE_SHARE * rule.cell_delta_e
    if noise > limit:
        raise MeasurementError(
            f"noise alone makes ΔE {noise:.2f} in a cell, too much to tell one of {rule.cell_delta_e:g} (limit "
            f"{limit:.2f}): take more frames_per_pose, a longer exposure (acquisition.brackets), or larger cells"
        )
    lean = _lean(measured, expected, fit, usual)
    curl, u_curl = _curl(lean)
    if expected.lamp_distance_mm is not None:
        turned = np.degrees(
            0.5 * max(measured.grid.shape) * measured.grid.pixel_mm / expected.lamp_distance_mm
        )
        u_curl = float(np.hypot(u_curl, U_OF_LAMP * turned))
    threshold = max(rule.cell_delta_e, rule.scatters * _between_neighbours(eye, cells))
    deviating = local > threshold
    labels = _labels(deviating)
    spots = _spots(labels, local, measured.grid)
    share, low, high = (float(np.mean(local > threshold + off)) for off in (0.0, -noise, noise))
    of_edges = 0.5 / local.size
    if measured.pictures is not None:
        areas = spot_shares(labels, apart, measured.pictures, measured.grid, eye, usual, threshold)
        spots = [
            spot.model_copy(update={"area_share": float(area)})
            for spot, area in zip(spots, areas, strict=True)
        ]
        share = float(areas.sum())
        of_edges = U_EDGE_SHARE * share
    u = float(np.hypot(0.5 * (low - high), of_edges))
    (xx, xy), (yx, yy) = curl.tolist()
    record = PrintMapRecord(
        cell_mm=rule.cell_mm,
        rows=local.shape[0],
        cols=local.shape[1],
        cell_delta_e=rule.cell_delta_e,
        cell_limit=threshold if threshold > rule.cell_delta_e else None,
        noise=noise,
        share=share,
        u=u,
        max_share=rule.max_share,
        verdict=_judged(share, u, rule.max_share, coverage),
        curl_deg=((xx, xy), (yx, yy)),
        u_curl_deg=u_curl,
        spots=tuple(sorted(spots, key=lambda spot: -spot.area_share)[:MOST_SPOTS]),
    )
    return PrintMap(local, total, lean, deviating, record)


def _between_neighbours(eye: Eye, cells: FloatArray) -> float:
    """Median ΔE of neighbours over √2, of (P, rows, cols, 3) cells: what dots scatter, and no gradient or spot does."""
    pairs = (cells[:, 1:], cells[:, :-1]), (cells[:, :, 1:], cells[:, :, :-1])
    apart = [eye.difference(one, other).max(axis=0).ravel() for one, other in pairs]
    each = np.concatenate(apart)
    return float(np.median(each) / np.sqrt(2.0)) if each.size else 0.0


def _under_far_lamp(measured: MeasuredPrint, expected: PrintExpectation) -> MeasuredPrint:
    """Cells as a lamp far away shows them: by a near one half vectors turn by half the place over its distance."""
    if expected.lamp_distance_mm is None:
        return measured
    rows, cols = measured.grid.shape
    row, col = (one.ravel() - one.mean() for one in np.mgrid[:rows, :cols])
    off_mm = measured.grid.pixel_mm * np.stack([col, -row], axis=-1)
    turned = expected.scene.leaning(np.degrees(0.5 * off_mm / expected.lamp_distance_mm)) / expected.channels
    by_cell = np.moveaxis(turned, 0, -1).reshape(measured.cells.shape)
    return replace(measured, cells=measured.cells / by_cell)


def _judged(share: float, u: float, limit: float, coverage: float) -> Verdict:
    if share <= limit - coverage * u:
        return Verdict.PASS
    return Verdict.FAIL if share >= limit + coverage * u else Verdict.INCONCLUSIVE


def _noise_floor(eye: Eye, channels: FloatArray, noise: FloatArray) -> float:
    """Root mean square of ΔE that noise makes in a cell, in the worst pose; (P, 3) channels and noise of their ln."""
    metric = eye.metric(channels)
    return float(np.sqrt(np.einsum("pii,pi->p", metric, noise**2).max()))


def _lean(
    measured: MeasuredPrint, expected: PrintExpectation, fit: PrintFit, usual: FloatArray
) -> FloatArray:
    """(2, rows, cols) lean of every cell, from ln of its channels over the region's in all poses."""
    logs = np.log(np.maximum(measured.cells, 1e-7) / usual[:, :, None, None])
    values = logs.reshape(usual.size, -1)
    slopes = np.stack([expected.scene.slope(name, fit.state) for name in _LOCAL], axis=-1)
    weight = 1.0 / np.hypot(measured.cell_noise.ravel(), _FLOOR)
    found = np.linalg.lstsq(slopes * weight[:, None], values * weight[:, None], rcond=None)[0]
    return np.asarray(found[:2].reshape(2, *measured.grid.shape))


def _curl(lean: FloatArray) -> tuple[FloatArray, float]:
    """(2, 2) change of the lean across the region, from a plane through all but the farthest cells; and its u."""
    rows, cols = lean.shape[1:]
    if min(rows, cols) < 2:
        return np.zeros((2, 2)), np.inf
    down, across = ((np.arange(count) + 0.5) / count - 0.5 for count in (rows, cols))
    y, x = np.meshgrid(-down, across, indexing="ij")
    base = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
    found, inliers = np.zeros((3, 2)), np.ones(x.size, dtype=bool)
    values = lean.reshape(2, -1).T
    for _ in range(5):
        found = np.asarray(np.linalg.lstsq(base[inliers], values[inliers], rcond=None)[0], dtype=np.float64)
        off = np.hypot(*(values - base @ found).T)
        inliers = off <= max(3.0 * float(np.median(off)), 1e-6)
    scatter = float(np.sqrt(np.mean((values - base @ found)[inliers] ** 2)))
    u = float(np.hypot(scatter * np.sqrt(12.0 / inliers.sum()), FIELD_TILT_DEG))
    return np.asarray(found[:2].T), u


def _labels(deviating: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Number of the spot of every cell, from 1 on; cells that touch each other are one, 0 does not deviate."""
    import cv2  # noqa: PLC0415 - start-up time

    return np.asarray(cv2.connectedComponents(deviating.astype(np.uint8), connectivity=8)[1], dtype=np.int32)


def _spots(labels: npt.NDArray[np.int32], local: FloatArray, grid: Grid) -> list[SpotRecord]:
    """The spots in the order of their numbers, with the area of their cells."""
    found = []
    for label in range(1, int(labels.max()) + 1):
        inside = labels == label
        rows, cols = np.nonzero(inside)
        middle = np.array([0.5 * (cols.min() + cols.max()), 0.5 * (rows.min() + rows.max()), 1.0])
        x, y = (grid.to_mm() @ middle)[:2]
        found.append(
            SpotRecord(
                x=float(x),
                y=float(y),
                width=float(np.ptp(cols) + 1) * grid.pixel_mm,
                length=float(np.ptp(rows) + 1) * grid.pixel_mm,
                area_share=len(rows) / labels.size,
                cells=len(rows),
                delta_e=float(local[inside].max()),
            )
        )
    return found


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


def _fours(pictures: Mosaics, pose: int, grid: Grid) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """(N, 3) channels of the usable fours of pixels in the region, and (N,) their cells."""
    view = pictures.views[pose]
    fours = fours_of(view.image.value, pictures.filters)
    y, x = np.mgrid[: fours.shape[1], : fours.shape[2]] * 2.0 + 0.5
    back = np.linalg.inv(view.placement.homography @ grid.to_mm())
    x, y = np.moveaxis(view.placement.straight(np.stack([x, y], axis=-1)), -1, 0)
    across, down, scale = np.einsum("ij,jrc->irc", back, np.stack([x, y, np.ones_like(x)]))
    column, row = (np.floor(axis / scale + 0.5).astype(np.intp) for axis in (across, down))
    inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
    inside &= np.isfinite(fours).all(axis=0)
    return np.maximum(fours[:, inside].T.astype(np.float64), _DARK), row[inside] * grid.shape[1] + column[
        inside
    ]
