"""The fixture's ArUco markers in one picture: found on a reduced picture, measured on the linear one at full size.

A side of a marker is a straight line through the centres of the brightness steps on many lines across it; corners are
crossings of sides. Blur rounds a corner, but leaves the middle of a side where it is; dirt moves some steps, but not
most of them.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.linear import upper_quantile
from anisoscope.rig.fixture import Fixture

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_PADDING = 16
_REDUCED_PX = 768  # a picture is reduced while its longer side stays above
_COMPRESSIONS = (0.7, 1.0, 0.5)
_MAX_LINES = 160
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class Marker:
    """A marker as seen.

    Attributes:
        id: its number in the dictionary.
        corners: (4, 2) column and row, top left first, clockwise.
        blur_px: standard deviation of the edge spread across its sides.
        black_share: brightness of its black border by that of its white label.
    """

    id: int
    corners: FloatArray
    blur_px: float
    black_share: float


def dictionary_of(fixture: Fixture) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a fixture's markers."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, fixture.dictionary))


def marker_corners_mm(fixture: Fixture) -> dict[int, FloatArray]:
    """Corners of every marker in sample millimetres, (4, 2): top left first, clockwise as seen, as OpenCV counts."""
    half = fixture.marker_mm / 2.0
    offsets = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    return {marker.id: offsets + np.array([marker.x_mm, marker.y_mm]) for marker in fixture.markers}


def find_markers(image: Image, fixture: Fixture) -> list[Marker]:
    """The fixture's markers in a linear picture (rows, cols), NaN where a pixel has no value.

    Where the reduced picture shows less than all of them, the whole one is searched.
    """
    thinned = image[::4, ::4]
    known = np.isfinite(thinned)
    top = max(upper_quantile(thinned if known.all() else thinned[known], 0.995), 1e-9)
    wanted = {marker.id for marker in fixture.markers}
    factor = max(1, max(image.shape) // _REDUCED_PX)
    found = _detect(image, fixture, top, factor)
    if factor > 1 and not wanted <= {number for number, _ in found}:
        found = _detect(image, fixture, top, 1)
    modules = dictionary_of(fixture).markerSize + 2
    return [_measured(image, number, corners, modules, top) for number, corners in found]


def _detect(image: Image, fixture: Fixture, top: float, factor: int) -> list[tuple[int, FloatArray]]:
    """The fixture's markers and their rough corners (4, 2).

    Compressed pictures show dim markers beside a bright part, but blur eats their black; so several are tried.
    """
    small = _reduced(image, factor)
    calm = np.clip(cv2.GaussianBlur(small, (0, 0), 1.0) / top, 0.0, 1.0)  # noise in the dark hides markers
    detector = cv2.aruco.ArucoDetector(dictionary_of(fixture), _detection())
    wanted = {marker.id for marker in fixture.markers}
    found: list[tuple[int, FloatArray]] = []
    for power in _COMPRESSIONS:
        missing = wanted - {number for number, _ in found}
        if not missing:
            break
        squeezed = np.asarray(255.0 * calm**power, dtype=np.uint8)
        # OpenCV misses labels that nearly touch the edge of the picture
        seen = cv2.copyMakeBorder(squeezed, _PADDING, _PADDING, _PADDING, _PADDING, cv2.BORDER_REPLICATE)
        corners, ids, _ = detector.detectMarkers(seen)
        numbers = [int(number) for number in ids.ravel()] if corners else []
        found += [
            (number, (one.reshape(4, 2).astype(np.float64) - _PADDING + 0.5) * factor - 0.5)
            for number, one in zip(numbers, corners, strict=True)
            if number in missing
        ]
    return found


def _reduced(image: Image, factor: int) -> Image:
    """The picture without gaps, ``factor`` × ``factor`` pixels made one."""
    if factor > 1:
        rows, cols = (size - size % factor for size in image.shape)
        image = np.asarray(
            cv2.resize(image[:rows, :cols], (cols // factor, rows // factor), interpolation=cv2.INTER_AREA)
        )
    return np.nan_to_num(image)


def _detection() -> cv2.aruco.DetectorParameters:
    """Thresholds that noise in the dark does not cross, over windows from a fraction of a module to several."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = 15
    parameters.adaptiveThreshWinSizeMax = 53
    return parameters


def _measured(image: Image, number: int, corners: FloatArray, modules: int, top: float) -> Marker:
    """A marker whose corners are the crossings of lines through its sides, refined in two rounds."""
    edge, across = np.zeros(2), np.zeros(2)
    for _ in range(_ROUNDS):
        points, along, edge, across = _sides(image, corners, modules, top)
        before, beside = np.roll(points, 1, axis=0), np.roll(along, 1, axis=0)
        turn = beside[:, 0] * along[:, 1] - beside[:, 1] * along[:, 0]
        gap = points - before
        steps = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / np.where(np.abs(turn) < 1e-3, 1.0, turn)
        corners = before + steps[:, None] * beside
    return Marker(number, corners, _spread(edge, across), float(edge[0] / max(edge[-1], 1e-9)))


def _sides(
    image: Image, corners: FloatArray, modules: int, top: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A point (4, 2) and the direction (4, 2) of every side, and the rising profile of the edges and its places."""
    ends = np.roll(corners, -1, axis=0)
    lengths = np.linalg.norm(ends - corners, axis=1)
    along = (ends - corners) / np.maximum(lengths, 1e-9)[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # within the black border on one side and within the white label on the other
    reach = float(np.clip(0.45 * lengths.mean() / modules, 2.0, 8.0))
    across = np.linspace(-reach, reach, int(8 * reach) + 1)
    lines = int(np.clip(0.7 * lengths.mean(), 12, _MAX_LINES))
    base = corners[:, None, :] + np.linspace(0.15, 0.85, lines)[:, None] * (ends - corners)[:, None, :]
    lit = _lit_along(image, base, across[:, None] * normals[:, None, :])
    lit /= top
    np.clip(lit, 0.0, 2.0, out=lit)
    offset, kept = _steps(lit, across)
    ramp = np.linspace(-1.0, 1.0, lines)
    level, slope, kept = _straight(ramp, offset, kept)
    first, last = (np.clip(level + end * slope, -reach, reach)[:, None] * normals for end in (-1.0, 1.0))
    start, stop = base[:, 0] + first, base[:, -1] + last
    direction = (stop - start) / np.maximum(np.linalg.norm(stop - start, axis=1), 1e-9)[:, None]
    edge = np.median([lit[side, kept[side]].mean(axis=0) for side in range(4)], axis=0)
    edge = edge[::-1] if edge[0] > edge[-1] else edge
    return 0.5 * (start + stop), direction, edge, across


def _lit_along(image: Image, base: FloatArray, away: FloatArray) -> FloatArray:
    """Brightness (4, lines, points) at places (4, lines, 2) and points (4, points, 2) away from them."""
    column, row = (
        (base[:, :, None, axis] + away[:, None, :, axis]).astype(np.float32).reshape(-1, away.shape[1])
        for axis in (0, 1)
    )
    seen = cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float64).reshape(*base.shape[:2], -1)


def _steps(lit: FloatArray, across: FloatArray) -> tuple[FloatArray, Mask]:
    """Where brightness steps on every line across the sides: centres (4, lines), and which lines show a usual step.

    Args:
        lit: (4, lines, points) brightness; NaN where a pixel has no value.
        across: (points,) places along the lines.
    """
    middles = 0.5 * (across[1:] + across[:-1])
    # the sum over steps of their height times their place, by parts; NaN where any of the line is
    moment = lit @ (np.pad(middles, (1, 0)) - np.pad(middles, (0, 1)))
    rise = lit[..., -1] - lit[..., 0]
    whole = np.isfinite(moment)
    if not whole.all():
        rise = np.where(whole, rise, 0.0)
        moment = np.nan_to_num(np.diff(lit, axis=2)) @ middles
    sense = np.sign(rise.sum(axis=1))[:, None]  # signed, so that noise cancels
    rise = rise * sense
    usual = _medians(rise)[:, None]
    offset = sense * moment / np.maximum(rise, 0.2 * usual + 1e-12)
    kept = whole & (rise > 0.5 * usual) & (rise < 1.5 * usual)
    kept |= kept.sum(axis=1, keepdims=True) < lit.shape[1] // 3
    return np.clip(offset, across[0], across[-1]), kept


def _medians(values: FloatArray, kept: Mask | None = None) -> FloatArray:
    """Median of every row, of the values kept: one of them at least."""
    count = np.full(len(values), values.shape[1]) if kept is None else kept.sum(axis=1)
    ordered = np.sort(values if kept is None else np.where(kept, values, np.inf), axis=1)
    rows = np.arange(len(values))
    return np.asarray(0.5 * (ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]))


def _straight(ramp: FloatArray, offset: FloatArray, kept: Mask) -> tuple[FloatArray, FloatArray, Mask]:
    """Level and slope (4,) of straight lines through most of the centres, and which were used."""
    level = _medians(offset, kept)
    slope, close = np.zeros(len(level)), kept
    for _ in range(3):
        away = np.abs(offset - level[:, None] - slope[:, None] * ramp)
        close = kept & (away <= np.maximum(3.0 * 1.4826 * _medians(away, kept), 0.05)[:, None])
        count = np.maximum(close.sum(axis=1), 1)
        middle = close @ ramp / count
        mean = (close * offset).sum(axis=1) / count
        centred = close * (ramp - middle[:, None])
        slope = (centred * offset).sum(axis=1) / np.maximum((centred**2).sum(axis=1), 1e-12)
        level = mean - slope * middle
    return level, slope, close


def _spread(edge: FloatArray, across: FloatArray) -> float:
    """Standard deviation of the edge spread of a rising profile, from where it passes 20 and 80 percent."""
    rising = np.maximum.accumulate(edge)
    share = (rising - rising[0]) / max(float(rising[-1] - rising[0]), 1e-12)
    low, high = (float(np.interp(level, share, across)) for level in (0.2, 0.8))
    return (high - low) / (2.0 * 0.8416)
