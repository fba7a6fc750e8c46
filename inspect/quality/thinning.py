"""Fewer points for a chart of many: the outline stays, and so does every point that was flagged."""

import numpy as np
import numpy.typing as npt

from anisoscope.quality.individuals import BoolArray, FloatArray

IntArray = npt.NDArray[np.int64]
BUCKETS = 1200
LEVELS = 500


def outline(values: FloatArray, buckets: int = BUCKETS) -> IntArray:
    """Places of the lowest and the highest value of every stretch of a series, in order; all if they are few.

    A gap of missing values that fills a stretch stays a gap: its first place is kept.

    Args:
        values: (N,), NaN is missing.
        buckets: stretches.
    """
    count = len(values)
    if count <= 2 * buckets:
        return np.arange(count)
    edges = np.linspace(0, count, buckets + 1).astype(np.int64)[:-1]
    low = np.fmin.reduceat(values, edges)
    high = np.fmax.reduceat(values, edges)
    bucket = np.searchsorted(edges, np.arange(count), side="right") - 1
    places = np.flatnonzero((values == low[bucket]) | (values == high[bucket]))
    # of ties, which rounded values have by the thousand, the first of each stretch is enough
    _, first = np.unique(
        np.stack([bucket[places], values[places] == high[bucket[places]]]), axis=1, return_index=True
    )
    empty = edges[np.isnan(low)]
    return np.sort(np.concatenate([places[first], empty]))


def distinct_on_paper(values: FloatArray, marked: BoolArray, levels: int = LEVELS) -> IntArray:
    """Places of marked values, less those that would be drawn on top of another one.

    Args:
        values: (N,).
        marked: (N,).
        levels: distinct heights on the paper; along the series there are ``BUCKETS`` distinct places.
    """
    places = np.flatnonzero(marked & ~np.isnan(values))
    if len(places) <= BUCKETS:
        return places
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    along = places * BUCKETS // len(values)
    up = np.round((values[places] - low) / max(high - low, 1e-300) * levels).astype(np.int64)
    _, first = np.unique(along * (levels + 1) + up, return_index=True)
    return np.sort(places[first])
