"""Where the sample stands, fitted to the corners of its fixture's markers; one marker that lies is found out.

The model is a similarity (turn, scale, shift) of a plate that is foreshortened along the picture's rows by the cosine
of the tilt. Where the plate is tilted and the markers show it, one more number q says how much smaller its far side
looks: with (X, Y) the similarity in pixels from the middle of the picture and c the cosine,
u = X/(1 + qY), v = cY/(1 + qY), a pinhole camera whose axis is tilted about the picture's horizontal axis
(Hartley and Zisserman, Multiple View Geometry, 2nd edition, 8.1; q = sin(tilt) · focal length/distance).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.errors import RegistrationError
from anisoscope.registration.markers import Marker

FloatArray = npt.NDArray[np.float64]

MIN_MARKERS = 3
OFF_PX = 0.3
"""A marker off by less is within what printing and focus do."""
OFF_SIGMA = 4.0
_MIN_SQUEEZE_CHANGE = 2e-4  # tilts below 1° show no perspective
_MIN_F = 12.0
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted plate.

    Attributes:
        homography: (3, 3) map from sample millimetres to (column, row, 1), its last element 1.
        angle_deg: angle of the sample, counter-clockwise as seen, 0 to 360.
        pixel_um: size of a pixel on the sample, at its origin.
        residual_px: rms distance of the corners from the fit.
        parameters: number of parameters.
    """

    homography: FloatArray
    angle_deg: float
    pixel_um: float
    residual_px: float
    parameters: int

    def to_pixels(self, points_mm: FloatArray) -> FloatArray:
        """(N, 2) column and row of points (N, 2)."""
        seen = np.column_stack([points_mm, np.ones(len(points_mm))]) @ self.homography.T
        return np.asarray(seen[:, :2] / seen[:, 2:])


@dataclass(frozen=True, eq=False)
class Agreed:
    """A fit to markers that agree with each other.

    Attributes:
        fit: the fit.
        markers: those it rests on.
        dropped: ids of the others.
        squeeze: foreshortening of the rows that the markers show, by the one that was assumed.
        u_squeeze: its standard uncertainty.
    """

    fit: Fit
    markers: tuple[Marker, ...]
    dropped: tuple[int, ...]
    squeeze: float
    u_squeeze: float


def agree(
    found: Sequence[Marker], known_mm: dict[int, FloatArray], squeeze: float, middle_px: tuple[float, float]
) -> Agreed:
    """Fit the plate to the markers that agree.

    Args:
        found: markers as seen, all of them known.
        known_mm: (4, 2) corners of every marker of the fixture.
        squeeze: cosine of the tilt.
        middle_px: (column, row) of the middle of the picture.

    Raises:
        RegistrationError: a marker is off, and there are too few to tell which.
    """

    def fitted(markers: Sequence[Marker]) -> Fit:
        points = np.concatenate([known_mm[marker.id] for marker in markers])
        return fit_plate(points, np.concatenate([m.corners for m in markers]), squeeze, middle_px)

    def off(marker: Marker, fit: Fit) -> float:
        return float(np.sqrt(np.mean(np.sum((fit.to_pixels(known_mm[marker.id]) - marker.corners) ** 2, 1))))

    kept = tuple(found)
    whole = fitted(kept)
    without = {i: fitted([*kept[:i], *kept[i + 1 :]]) for i in range(len(kept)) if len(kept) > MIN_MARKERS}
    suspects = [i for i, fit in without.items() if off(kept[i], fit) > _allowed(fit)]
    dropped: tuple[int, ...] = ()
    if suspects:
        # one that is off makes every fit that holds it bad; the right one to leave out is clearly the best
        order = sorted(suspects, key=lambda i: without[i].residual_px)
        best = without[order[0]]
        rest = [without[i].residual_px for i in without if i != order[0]]
        if best.residual_px > OFF_PX or min(rest) < 1.5 * best.residual_px:
            raise RegistrationError(_contradiction(kept, [off(m, whole) for m in kept]))
        dropped = (kept[order[0]].id,)
        kept = (*kept[: order[0]], *kept[order[0] + 1 :])
        whole = best
    seen, u_seen, rest_px = _seen_squeeze(
        np.concatenate([known_mm[m.id] for m in kept]), np.concatenate([m.corners for m in kept])
    )
    # markers that agree on another foreshortening say that the arm stands elsewhere; that is for a gate to judge
    if whole.residual_px > OFF_PX and rest_px > OFF_PX:
        raise RegistrationError(_contradiction(kept, [off(m, whole) for m in kept]))
    return Agreed(whole, kept, dropped, seen / squeeze, u_seen / squeeze)


def _allowed(fit: Fit) -> float:
    return max(OFF_PX, OFF_SIGMA * fit.residual_px)


def _contradiction(markers: Sequence[Marker], off_px: list[float]) -> str:
    worst = max(zip(off_px, (marker.id for marker in markers), strict=True))
    return (
        f"the fixture markers contradict each other (marker {worst[1]} is off by {worst[0]:.2f} px, limit "
        f"{OFF_PX:g} px): clean them, check focus and tilt, and that all stand where the rig file says"
    )


def fit_plate(
    points_mm: FloatArray, pixels: FloatArray, squeeze: float, middle_px: tuple[float, float]
) -> Fit:
    """Least squares for the plate, with perspective where it is tilted and the points show it.

    Args:
        points_mm: (N, 2) sample millimetres.
        pixels: (N, 2) column and row.
        squeeze: cosine of the tilt.
        middle_px: (column, row) of the middle of the picture.
    """
    centred = pixels - np.asarray(middle_px)
    plain = _solve(points_mm, centred, squeeze, None)
    if 1.0 - squeeze < _MIN_SQUEEZE_CHANGE:
        return _as_fit(points_mm, pixels, plain, squeeze, middle_px, 4)
    bent = plain
    for _ in range(_ROUNDS):
        bent = _solve(points_mm, centred, squeeze, bent)
    fits = (
        _as_fit(points_mm, pixels, plain, squeeze, middle_px, 4),
        _as_fit(points_mm, pixels, bent, squeeze, middle_px, 5),
    )
    first, second = (len(points_mm) * fit.residual_px**2 for fit in fits)
    free = 2 * len(points_mm) - 5
    return fits[1] if (first - second) * free > _MIN_F * second else fits[0]


def _solve(
    points_mm: FloatArray, centred: FloatArray, squeeze: float, previous: FloatArray | None
) -> FloatArray:
    """(5,) real and imaginary part of the similarity, its shift, and q; q only where a previous solution is given."""
    x, y = points_mm.T
    u, v = centred.T
    one, none = np.ones_like(x), np.zeros_like(x)
    columns = [
        np.concatenate([x, -squeeze * y]),
        np.concatenate([y, squeeze * x]),
        np.concatenate([one, none]),
        np.concatenate([none, squeeze * one]),
    ]
    if previous is not None:
        depth = previous[1] * x - previous[0] * y + previous[3]
        columns.append(np.concatenate([-u * depth, -v * depth]))
    # rows are scaled, so that all count as distances in the plate
    found = np.linalg.lstsq(np.stack(columns, axis=1), np.concatenate([u, v]), rcond=None)[0]
    return np.asarray(np.pad(found, (0, 5 - len(found))), dtype=np.float64)


def _as_fit(
    points_mm: FloatArray,
    pixels: FloatArray,
    found: FloatArray,
    squeeze: float,
    middle_px: tuple[float, float],
    parameters: int,
) -> Fit:
    a, b, right, down, q = (float(value) for value in found)
    inner = np.array(
        [
            [a, b, right],
            [squeeze * b, -squeeze * a, squeeze * down],
            [q * b, -q * a, 1.0 + q * down],
        ]
    )
    homography = np.array([[1.0, 0.0, middle_px[0]], [0.0, 1.0, middle_px[1]], [0.0, 0.0, 1.0]]) @ inner
    homography /= homography[2, 2]
    factor = complex(a, b)
    fit = Fit(
        homography,
        float(-np.degrees(np.angle(factor)) % 360.0),
        float(1000.0 * (1.0 + q * down) / abs(factor)),
        0.0,
        parameters,
    )
    residual = float(np.sqrt(np.mean(np.sum((fit.to_pixels(points_mm) - pixels) ** 2, axis=1))))
    return Fit(homography, fit.angle_deg, fit.pixel_um, residual, parameters)


def _seen_squeeze(points_mm: FloatArray, pixels: FloatArray) -> tuple[float, float, float]:
    """Scale of the rows by that of the columns, from a free affine fit; its standard uncertainty; the rms rest."""
    design = np.column_stack([points_mm, np.ones(len(points_mm))])
    affine = np.linalg.lstsq(design, pixels, rcond=None)[0]
    rest = pixels - design @ affine
    variance = float(np.sum(rest**2)) / (2 * len(points_mm) - 6) * np.linalg.inv(design.T @ design)
    scales = np.linalg.norm(affine[:2], axis=0)
    across = affine[:2].T / scales[:, None]
    u_share = [float(np.sqrt(row @ variance[:2, :2] @ row)) for row in across] / scales
    ratio = float(scales[1] / scales[0])
    rest_px = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    return ratio, ratio * float(np.hypot(*u_share)), rest_px
