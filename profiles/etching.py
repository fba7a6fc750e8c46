"""Etched surfaces of level steps: their passes, and errors of depth, width and overlay.

n etch passes, each masked or not, leave up to 2ⁿ levels. Two errors are common: all passes a little too deep, and
etched features a little too wide, because the etch works sideways too (Levin et al. 2013, section 5).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.heightmap import HeightMap

Labels = npt.NDArray[np.uint8]
Booleans = npt.NDArray[np.bool_]
Shares = npt.NDArray[np.float32]

MOST_PASSES = 8
SAME_LEVEL_UM = 2e-4
"""Heights that differ by less are one level: a fifth of a nanometre, the step of an atom."""


@dataclass(frozen=True, eq=False)
class Etched:
    """A tile of etched steps that goes on beyond its edges with itself.

    Attributes:
        labels: (rows, cols) bit i: etched in pass i.
        passes_um: depth of every pass.
        pixel_um: distance of the points.
        wider_um: by how much etched features are wider than the labels say, half of it at each edge.
    """

    labels: Labels
    passes_um: tuple[float, ...]
    pixel_um: float
    wider_um: float = 0.0

    @classmethod
    def of(cls, surface: HeightMap) -> Self:
        """From a height map of level steps.

        The shallowest level that no sum of earlier passes explains is a pass of its own. Two passes of the same depth
        cannot be distinguished from one of twice the depth where both etched.

        Raises:
            HeightMapError: missing points, pixels that are no squares, or heights that are not a few levels.
        """
        if surface.missing_share > 0.0:
            raise HeightMapError(
                "an etched surface needs all of its heights: crop the map to where it is whole"
            )
        if abs(surface.pixel_x_um / surface.pixel_y_um - 1.0) > 1e-6:
            raise HeightMapError(
                f"an etched surface needs square pixels, not {surface.pixel_x_um:g} × {surface.pixel_y_um:g} µm"
            )
        height = surface.height_um
        top = float(height.max())
        depths = _levels(top - height)
        sums: dict[float, int] = {0.0: 0}
        passes: list[float] = []
        for depth in depths:
            if _found(sums, depth) is None:
                sums |= {total + depth: bits | 1 << len(passes) for total, bits in sums.items()}
                passes.append(depth)
        if not 1 <= len(passes) <= MOST_PASSES:
            raise HeightMapError(
                f"{len(depths)} levels are no surface of 1 to {MOST_PASSES} etch passes: give the map of etched steps"
            )
        labels = np.zeros(height.shape, dtype=np.uint8)
        for depth in depths:
            labels[np.abs(top - height - depth) <= SAME_LEVEL_UM] = _found(sums, depth) or 0
        return cls(labels, tuple(passes), surface.pixel_x_um)

    @property
    def levels_um(self) -> tuple[float, ...]:
        """Heights of all 2ⁿ levels, 0 for the one that no pass etched."""
        bits = (np.arange(2 ** len(self.passes_um))[:, None] >> np.arange(len(self.passes_um))) & 1
        return tuple((-(bits @ np.asarray(self.passes_um)) + 0.0).tolist())

    def over_etched(self, deeper_um: float = 0.0, share: float = 0.0) -> Self:
        """Every pass deeper by a length, and by a share of itself.

        Raises:
            HeightMapError: a pass would not etch at all.
        """
        passes = tuple(depth * (1.0 + share) + deeper_um for depth in self.passes_um)
        if min(passes) <= 0.0:
            raise HeightMapError(f"passes of {min(passes) * 1e3:g} nm do not etch: take a smaller under-etch")
        return replace(self, passes_um=passes)

    def widened(self, wider_um: float) -> Self:
        """Every etched feature wider by a length, narrower where it is negative."""
        return replace(self, wider_um=self.wider_um + wider_um)

    def pass_deeper(self, number: int, deeper_um: float) -> Self:
        """One pass deeper by a length; passes are numbered from the shallowest.

        Raises:
            HeightMapError: the pass would not etch at all.
        """
        passes = [depth + deeper_um * (at == number) for at, depth in enumerate(self.passes_um)]
        if passes[number] <= 0.0:
            raise HeightMapError(
                f"a pass of {passes[number] * 1e3:g} nm does not etch: take a smaller under-etch"
            )
        return replace(self, passes_um=tuple(passes))

    def mask_shifted(self, number: int, right_um: float, up_um: float) -> Self:
        """The mask of one pass shifted against the others, by whole pixels.

        Args:
            number: of the pass.
            right_um: towards higher columns.
            up_um: towards higher rows.
        """
        bit = self.labels & np.uint8(1 << number)
        by = tuple(round(length / self.pixel_um) for length in (up_um, right_um))
        return replace(self, labels=self.labels - bit + np.roll(bit, by, axis=(0, 1)))

    def pieces(self) -> Iterator["Piece"]:
        """The tile as pieces of pixels: whole ones, or a middle, four strips and four corners where edges have moved.

        Edges move by half the width bias to all sides, each pass for itself, by any part of a pixel: what an edge that
        moved leaves of a pixel is exact, also where strips of two passes cross.
        """
        moved = 0.5 * self.wider_um / self.pixel_um
        whole = round(moved)
        edge, grows = abs(moved - whole), moved > whole
        masks = [_grown((self.labels >> bit) & 1 == 1, whole) for bit in range(len(self.passes_um))]
        if edge < 1e-9:
            yield Piece(_labels(masks), (1.0, 1.0), (0.0, 0.0), f"{whole}")
            return
        far = 0.5 - 0.5 * edge
        lines = ((-1, edge, -far), (0, 1.0 - 2.0 * edge, 0.0), (1, edge, far))
        for dy, high, at_y in lines:
            for dx, wide, at_x in lines:
                strips = [_strip(mask, dy, dx, grows=grows) for mask in masks]
                yield Piece(_labels(strips), (high, wide), (at_y, at_x), f"{whole} {grows} {dy} {dx}")

    def shares(self) -> dict[int, Shares]:
        """(rows, cols) share of every pixel covered by a level, by the number of the level."""
        found: dict[int, Shares] = {}
        for piece in self.pieces():
            for number in np.unique(piece.labels).tolist():
                share = found.setdefault(number, np.zeros(self.labels.shape, dtype=np.float32))
                np.add(
                    share, np.float32(piece.size[0] * piece.size[1]), out=share, where=piece.labels == number
                )
        return found


@dataclass(frozen=True, eq=False)
class Piece:
    """The same rectangle of every pixel of a tile.

    Attributes:
        labels: (rows, cols) level of it.
        size: (y, x) in pixels.
        middle: (y, x) of its middle from that of the pixel, in pixels.
        key: pieces of one tile with the same key have the same labels, whatever their size.
    """

    labels: Labels
    size: tuple[float, float]
    middle: tuple[float, float]
    key: str


def _labels(masks: list[Booleans]) -> Labels:
    found = np.zeros(masks[0].shape, dtype=np.uint8)
    for bit, mask in enumerate(masks):
        found |= mask.astype(np.uint8) << bit
    return found


def _levels(depth_um: npt.NDArray[np.float64]) -> list[float]:
    """Distinct depths, rising, from 0 on; stops soon after there are too many."""
    left = depth_um.ravel()
    found: list[float] = []
    while left.size and len(found) <= 2**MOST_PASSES:
        at = left[0]
        same = np.abs(left - at) <= SAME_LEVEL_UM
        found.append(float(left[same].mean()))
        left = left[~same]
    return sorted(0.0 if depth < SAME_LEVEL_UM else depth for depth in found)


def _found(sums: dict[float, int], depth: float) -> int | None:
    """Passes that add up to a depth."""
    near = min(sums, key=lambda total: abs(total - depth))
    return sums[near] if abs(near - depth) <= 2.0 * SAME_LEVEL_UM else None


def _grown(mask: Booleans, pixels: int) -> Booleans:
    """A mask that goes on with itself, grown by whole pixels to all sides, or shrunk."""
    for _ in range(abs(pixels)):
        for axis in (0, 1):
            neighbours = np.roll(mask, 1, axis), np.roll(mask, -1, axis)
            mask = (
                mask | neighbours[0] | neighbours[1] if pixels > 0 else mask & neighbours[0] & neighbours[1]
            )
    return mask


def _strip(mask: Booleans, dy: int, dx: int, *, grows: bool) -> Booleans:
    """Whether the strip (or corner) of a pixel next to its neighbour is etched when edges move."""
    join = np.logical_or if grows else np.logical_and
    found = mask
    if dy:
        found = join(found, np.roll(mask, -dy, axis=0))
    if dx:
        found = join(found, np.roll(found, -dx, axis=1))
    return np.asarray(found)
