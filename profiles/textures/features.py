"""Feature parameters of ISO 25178-2: hills and dales by watershed with Wolf pruning.

Hills are the watershed segments of peaks, dales those of pits. Wolf pruning takes away the peak that stands least
above the saddle to its neighbour, again and again, until all stand above theirs by a share of Sz; what is left are the
peaks whose rise above the saddle reaches that share, which a reconstruction by dilation finds at once. Missing points
are no part of a hill or dale, and segments that touch the border of the field or a gap are open.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap

Labels = npt.NDArray[np.int32]

PRUNING = 0.05
HIGHEST = 5


@dataclass(frozen=True)
class Features:
    """Feature parameters (ISO 25178-2, 6), heights about the mean.

    Attributes:
        pruning: share of Sz by which a peak stands above its saddle, at least.
        peaks: number of peaks.
        pits: number of pits.
        spd_per_um2: density of peaks Spd.
        spc_per_um: arithmetic mean peak curvature Spc, −½(∂²z/∂x² + ∂²z/∂y²).
        s5p_um: mean height of the five highest peaks; NaN with fewer.
        s5v_um: mean depth of the five deepest pits; NaN with fewer.
        s10z_um: S5p + S5v.
        sha_um2: mean area of the closed hills; NaN without one.
        sda_um2: mean area of the closed dales.
        shv_um3: mean volume of the closed hills above the saddle at which each joins a neighbour.
        sdv_um3: mean volume of the closed dales below the saddle at which each overflows.
    """

    pruning: float
    peaks: int
    pits: int
    spd_per_um2: float
    spc_per_um: float
    s5p_um: float
    s5v_um: float
    s10z_um: float
    sha_um2: float
    sda_um2: float
    shv_um3: float
    sdv_um3: float


def hills(height_um: FloatArray, rise_um: float) -> Labels:
    """Hills (rows, cols), numbered from 1; 0 where missing.

    Args:
        height_um: heights, NaN where missing; negated, the hills are the dales.
        rise_um: least rise of a peak above its saddle, above 0.
    """
    from scipy import ndimage  # noqa: PLC0415 - slow to import
    from skimage.morphology import local_maxima, reconstruction  # noqa: PLC0415
    from skimage.segmentation import watershed  # noqa: PLC0415

    known = np.isfinite(height_um)
    lowest = float(np.min(height_um[known])) - 2.0 * rise_um - 1.0
    filled = np.where(known, height_um, lowest)
    lowered = np.maximum(filled - rise_um, lowest)
    flooded = reconstruction(lowered, filled, footprint=np.ones((3, 3)))  # type: ignore[no-untyped-call]
    tops = local_maxima(flooded, connectivity=2) & known  # type: ignore[no-untyped-call]
    # of the summits of one hill the highest counts
    marks, count = ndimage.label(tops, np.ones((3, 3), dtype=np.bool_))
    if count == 0:
        return np.where(known, 1, 0).astype(np.int32)
    found = watershed(-filled, marks, connectivity=2, mask=known)  # type: ignore[no-untyped-call]
    return np.asarray(found, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class _Segments:
    """Segments of one kind, numbered from 1."""

    height: FloatArray
    label: Labels

    @property
    def count(self) -> int:
        return int(self.label.max())

    def tops(self) -> npt.NDArray[np.intp]:
        """Flat index of the highest point of every segment."""
        from scipy import ndimage  # noqa: PLC0415 - slow to import

        filled = np.where(np.isfinite(self.height), self.height, -np.inf)
        places = ndimage.maximum_position(filled, self.label, np.arange(1, self.count + 1))
        return np.array([i * self.height.shape[1] + j for i, j in places], dtype=np.intp)

    def closed(self) -> npt.NDArray[np.bool_]:
        """(count + 1,) which segments touch neither the border nor a gap."""
        padded: Labels = np.pad(self.label, 1)
        near: npt.NDArray[np.bool_] = np.zeros(self.label.shape, dtype=np.bool_)
        rows, cols = self.label.shape
        for di in (0, 1, 2):
            for dj in (0, 1, 2):
                window = slice(di, di + rows), slice(dj, dj + cols)
                near |= padded[window] == 0
        found = np.ones(self.count + 1, dtype=bool)
        found[np.unique(self.label[near])] = False
        found[0] = False
        return found

    def saddles(self) -> FloatArray:
        """(count + 1,) height of the highest saddle to a neighbour; −inf without one."""
        found = np.full(self.count + 1, -np.inf)
        rows, cols = self.label.shape
        for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here = slice(0, rows - di), slice(max(0, -dj), cols - max(0, dj))
            there = slice(di, rows), slice(max(0, dj), cols + min(0, dj))
            one, two = self.label[here], self.label[there]
            pass_ = (one != two) & (one > 0) & (two > 0)
            lower = np.minimum(self.height[here], self.height[there])[pass_]
            np.maximum.at(found, one[pass_], lower)
            np.maximum.at(found, two[pass_], lower)
        return found

    def means(self, pixel_area: float) -> tuple[float, float]:
        """Mean area and mean volume above the saddle of the closed segments."""
        closed = self.closed()
        if not closed.any():
            return float("nan"), float("nan")
        area = np.bincount(self.label.ravel(), minlength=self.count + 1)[closed] * pixel_area
        saddle = self.saddles()
        inside = closed[self.label] & np.isfinite(saddle[self.label])
        above = np.maximum(self.height[inside] - saddle[self.label[inside]], 0.0)
        volume = np.bincount(self.label[inside], above, minlength=self.count + 1)[closed] * pixel_area
        return float(area.mean()), float(volume.mean())


def features(surface: HeightMap, pruning: float = PRUNING, *, border: bool = True) -> Features:
    """Feature parameters of a map.

    Args:
        surface: the scale-limited map, (rows, cols) in µm.
        pruning: least rise of a peak above its saddle, as a share of Sz, above 0 and below 1.
        border: peaks and pits of open hills and dales count too, whose summits may be cut off by the border.

    Raises:
        HeightMapError: nothing was measured, the surface is flat, or a pruning outside its range.
    """
    check_heights("height map", surface.height_um)
    if not 0.0 < pruning < 1.0:
        raise HeightMapError(f"Wolf pruning takes a share of Sz above 0 and below 1, not {pruning:g}")
    known = np.isfinite(surface.height_um)
    height = surface.height_um - float(np.mean(surface.height_um[known]))
    sz = float(np.nanmax(height) - np.nanmin(height))
    if sz <= 1e-12 * max(float(np.nanmax(np.abs(surface.height_um))), 1e-12):
        raise HeightMapError("a flat surface has no hills and dales")
    kinds = [_Segments(sign * height, hills(sign * height, pruning * sz)) for sign in (1.0, -1.0)]
    tops = [kind.tops() if border else kind.tops()[kind.closed()[1:]] for kind in kinds]
    pixel_area = surface.pixel_x_um * surface.pixel_y_um
    heights = [np.sort(kind.height.ravel()[top])[::-1] for kind, top in zip(kinds, tops, strict=True)]
    s5p, s5v = (float(np.mean(one[:HIGHEST])) if one.size >= HIGHEST else float("nan") for one in heights)
    (sha, shv), (sda, sdv) = (kind.means(pixel_area) for kind in kinds)
    return Features(
        pruning, tops[0].size, tops[1].size, float(tops[0].size / (np.count_nonzero(known) * pixel_area)),
        _curvature(surface, height, tops[0]), s5p, s5v, s5p + s5v, sha, sda, shv, sdv,
    )  # fmt: skip


def _curvature(surface: HeightMap, height: FloatArray, tops: npt.NDArray[np.intp]) -> float:
    """Mean of −½∇²z over peaks whose four neighbours were measured; NaN without one."""
    padded = np.pad(height, 1, constant_values=np.nan)
    i, j = np.unravel_index(tops, height.shape)
    i, j = i + 1, j + 1
    along_y = (padded[i + 1, j] - 2.0 * padded[i, j] + padded[i - 1, j]) / surface.pixel_y_um**2
    along_x = (padded[i, j + 1] - 2.0 * padded[i, j] + padded[i, j - 1]) / surface.pixel_x_um**2
    found = -0.5 * (along_x + along_y)
    found = found[np.isfinite(found)]
    return float(found.mean()) if found.size else float("nan")
