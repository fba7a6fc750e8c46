"""Live picture for display: 8 bits, with ridge direction, focus and saturation drawn in; and as a JPEG."""

import math

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, RecordError
from anisoscope.live_view.view import Counts, View, signal_of
from anisoscope.rig.bayer import demosaicked
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.frame import SATURATION

Picture = npt.NDArray[np.uint8]

WIDTH_PX = 960
JPEG_QUALITY = 80
RED, GREEN, WHITE, BLACK = (60, 60, 230), (120, 220, 90), (245, 245, 245), (0, 0, 0)  # blue, green, red


def draw(counts: Counts, info: CameraInfo, view: View, relative_focus: float) -> Picture:
    """Draw a frame for the eye.

    Args:
        counts: (rows, cols) raw counts.
        info: the camera.
        view: what was found in the frame.
        relative_focus: focus over the best focus seen; NaN if it is not known.

    Returns:
        (rows, cols, 3) blue, green, red; at most 960 wide. Saturated pixels are red; a line through the middle
        runs along the ridges, if they have a direction.
    """
    picture = to_show(counts, info)
    picture = picture if picture.ndim == 3 else np.repeat(picture[:, :, None], 3, axis=2)
    scale = min(1.0, WIDTH_PX / counts.shape[1])
    full_scale = (1 << info.bit_depth) - 1
    burnt = (counts >= SATURATION * full_scale).astype(np.uint8)
    if scale < 1.0:
        size = (round(counts.shape[1] * scale), max(1, round(counts.shape[0] * scale)))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        # a single saturated pixel must stay visible in the smaller picture
        spread = cv2.dilate(burnt, np.ones((math.ceil(1.0 / scale),) * 2, np.uint8))
        burnt = np.asarray(cv2.resize(spread, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    picture[burnt > 0] = RED
    if view.ridge_deg is not None:
        _draw_direction(picture, view.ridge_deg)
    _write(picture, words(view, relative_focus))
    return picture


def words(view: View, relative_focus: float) -> list[str]:
    """Ridge direction, focus and saturation in plain ASCII, one line each."""
    ridges = "undefined" if view.ridge_deg is None else f"{view.ridge_deg:+.1f} deg"
    focus = "too dark" if math.isnan(relative_focus) else f"{100.0 * relative_focus:.0f} % of best"
    return [f"ridges {ridges}", f"focus {focus}", f"saturated {100.0 * view.saturated_share:.2f} %"]


def to_show(counts: Counts, info: CameraInfo) -> Picture:
    """Frame for display: (rows, cols), or (rows, cols, 3) blue, green, red of a colour camera, white not balanced."""
    if info.filters == "mono":
        return eight_bits(counts, info)
    return np.ascontiguousarray(eight_bits(demosaicked(counts, info.filters)[:, :, ::-1], info))


def eight_bits(counts: Counts, info: CameraInfo) -> Picture:
    """Black level to full scale as 0 to 255, in the shape of the counts; brightened for display (square root)."""
    return np.asarray(np.sqrt(np.clip(signal_of(counts, info), 0.0, 1.0)) * 255.0 + 0.5, dtype=np.uint8)


def as_jpeg(picture: Picture) -> bytes:
    """A picture as a JPEG file.

    Raises:
        CameraError: it has no pixels.
    """
    return _encoded(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def as_png(picture: Picture) -> bytes:
    """A picture as a PNG file; errors as for `as_jpeg`."""
    return _encoded(".png", picture, [])


def _encoded(kind: str, picture: Picture, options: list[int]) -> bytes:
    try:
        done, data = cv2.imencode(kind, picture, options)
    except cv2.error as problem:
        raise CameraError(f"the frame of shape {picture.shape} cannot be shown: {problem.err}") from problem
    if not done:
        raise RecordError(f"OpenCV cannot write {kind} pictures here")
    return bytes(data)


def _draw_direction(picture: Picture, ridge_deg: float) -> None:
    rows, cols = picture.shape[:2]
    length = 0.35 * min(rows, cols)
    # counter-clockwise from upright, in pixels: columns to the right, rows downwards
    step = np.array([-math.sin(math.radians(ridge_deg)), -math.cos(math.radians(ridge_deg))]) * length
    middle = np.array([cols / 2, rows / 2])
    ends = [tuple(int(v) for v in np.round(middle + sign * step)) for sign in (-1.0, 1.0)]
    thick = max(1, rows // 250)
    cv2.line(picture, ends[0], ends[1], BLACK, thick + 2, cv2.LINE_AA)
    cv2.line(picture, ends[0], ends[1], GREEN, thick, cv2.LINE_AA)


def _write(picture: Picture, lines: list[str]) -> None:
    size = max(0.4, picture.shape[1] / 1400.0)
    step = round(30.0 * size)
    width = max(cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0] for line in lines)
    cv2.rectangle(picture, (0, 0), (width + 12, step * len(lines) + step // 2), BLACK, cv2.FILLED)
    for number, line in enumerate(lines):
        at = (6, (number + 1) * step)
        cv2.putText(picture, line, at, cv2.FONT_HERSHEY_SIMPLEX, size, WHITE, 1, cv2.LINE_AA)
