"""Forms of a surface: planes, polynomials, spheres and cylinders, fitted to the measured points.

Planes and polynomials are least squares of the heights. Spheres and cylinders are least squares of the distances of the
points from the surface (total least squares, as ISO 10360-6 understands an associated sphere or cylinder), written
with the curvature κ and the normal n at the middle of the field:

    d(q) = (κ|q|² + 2 q·n) / (1 + √(1 + 2κ q·n + κ²|q|²)),

for a cylinder with the part of q at right angles to its axis. This is finite at κ = 0, where both become a plane.
"""

import re
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import principal
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap, known_mean, row_blocks

MAX_ORDER = 10
FIT_SAMPLES = 40_000
FLAT = 1e-12
FORMS = "none, plane, poly1 … poly10, sphere, cylinder"


@dataclass(frozen=True, eq=False)
class FittedForm:
    """A form fitted to a map.

    Attributes:
        name: the form.
        height_um: (rows, cols) its heights, at missing points too; NaN where a sphere or cylinder has none.
        values: its numbers: ``tilt_x_deg`` and ``tilt_y_deg`` at the middle of the field; ``radius_um`` of a sphere or
            cylinder, negative where it is hollow and left out where it is flat; ``axis_deg`` of a cylinder,
            counter-clockwise from +y.
    """

    name: str
    height_um: FloatArray
    values: dict[str, float]


def form_order(form: str) -> int | None:
    """Order of a polynomial form: 0 for "none", 1 for "plane"; None for "sphere" and "cylinder".

    Raises:
        HeightMapError: no such form.
    """
    if form in ("none", "plane"):
        return ("none", "plane").index(form)
    if form in ("sphere", "cylinder"):
        return None
    found = re.fullmatch(r"poly(\d{1,2})", form)
    if found is None or not 1 <= int(found[1]) <= MAX_ORDER:
        raise HeightMapError(f"a form is one of {FORMS}, not {form!r}")
    return int(found[1])


def fit_form(surface: HeightMap, form: str) -> FittedForm:
    """Fit a form to the measured points of a map, (rows, cols) in µm.

    Args:
        surface: the map; missing points weigh nothing.
        form: "none" (the mean height), "plane", "poly1" to "poly10" (total order), "sphere" or "cylinder".

    Raises:
        HeightMapError: no such form, nothing was measured, or too few points to determine the form.
    """
    order = form_order(form)
    check_heights("height map", surface.height_um)
    return _round(surface, form) if order is None else _polynomial(surface, form, order)


def _axes(surface: HeightMap) -> tuple[FloatArray, FloatArray]:
    rows, cols = surface.shape
    return np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, cols)


def _polynomial(surface: HeightMap, form: str, order: int) -> FittedForm:
    """Least squares in Legendre polynomials of both axes, from sums over rows."""
    y, x = _axes(surface)
    powers = [(a, b) for total in range(order + 1) for a in range(total, -1, -1) for b in (total - a,)]
    in_x = np.polynomial.legendre.legvander(x, order)
    in_y = np.polynomial.legendre.legvander(y, order)
    height, side = surface.height_um, order + 1
    mean = known_mean(height)
    # sums over x row by row, then over y: all products of two polynomials
    products_x = (in_x[:, :, None] * in_x[:, None, :]).reshape(x.size, -1)
    counts, sums = np.zeros((y.size, side * side)), np.zeros((y.size, side))
    for block in row_blocks(height.shape):
        part = height[block]
        known = np.isfinite(part)
        counts[block] = known.astype(np.float64) @ products_x
        sums[block] = np.where(known, part - mean, 0.0) @ in_x
    products_y = (in_y[:, :, None] * in_y[:, None, :]).reshape(y.size, -1)
    moments = (products_y.T @ counts).reshape(side, side, side, side)
    normal = np.array([[moments[b, d, a, c] for c, d in powers] for a, b in powers])
    right = np.array([(in_y.T @ sums)[b, a] for a, b in powers])
    # NaN and infinity have been left out, so a singular matrix means points on one line or too few of them
    if np.linalg.cond(normal) > 1e12:
        raise HeightMapError(f"the measured points do not determine the form {form!r}; take --form none")
    factors = np.zeros((order + 1, order + 1))
    for (a, b), factor in zip(powers, np.linalg.solve(normal, right), strict=True):
        factors[b, a] = factor
    found = in_y @ factors @ in_x.T
    found += mean
    return FittedForm(form, found, _tilt(*_middle_slopes(surface, factors)))


def _middle_slopes(surface: HeightMap, factors: FloatArray) -> tuple[float, float]:
    rows, cols = surface.shape
    legendre = np.polynomial.legendre
    along_x = legendre.legval2d(0.0, 0.0, legendre.legder(factors.T, axis=0)) if factors.size > 1 else 0.0
    along_y = legendre.legval2d(0.0, 0.0, legendre.legder(factors.T, axis=1)) if factors.size > 1 else 0.0
    return (
        2.0 * float(along_x) / ((cols - 1) * surface.pixel_x_um),
        2.0 * float(along_y) / ((rows - 1) * surface.pixel_y_um),
    )


def _tilt(slope_x: float, slope_y: float) -> dict[str, float]:
    return {
        "tilt_x_deg": float(np.degrees(np.arctan(slope_x))),
        "tilt_y_deg": float(np.degrees(np.arctan(slope_y))),
    }


def _round(surface: HeightMap, form: str) -> FittedForm:
    """Total least squares of a sphere or cylinder, lengths in half the diagonal of the field."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow to import

    rows, cols = surface.shape
    x = (np.arange(cols, dtype=np.float64) - 0.5 * (cols - 1)) * surface.pixel_x_um
    y = (np.arange(rows, dtype=np.float64) - 0.5 * (rows - 1)) * surface.pixel_y_um
    unit = float(np.hypot(x[-1], y[-1]))
    i, j = np.nonzero(np.isfinite(surface.height_um))
    step = max(1, i.size // FIT_SAMPLES)
    i, j = i[::step], j[::step]
    px, py, pz = x[j] / unit, y[i] / unit, surface.height_um[i, j] / unit
    design = np.stack([np.ones_like(px), px, py, px * px, px * py, py * py], axis=1)
    normal = design.T @ design
    if np.linalg.cond(normal) > 1e12:
        raise HeightMapError(f"the measured points do not determine the form {form!r}; take --form none")
    c = np.linalg.solve(normal, design.T @ pz)
    bend = np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
    values, directions = principal(bend)
    strong = int(np.argmax(np.abs(values)))
    axis = np.arctan2(*directions[1 - strong, ::-1])
    curvature = -float(np.mean(values)) if form == "sphere" else -float(values[strong])
    start = np.array([c[0], -c[1], -c[2], curvature, *((axis,) if form == "cylinder" else ())])
    shape = _Round(px, py)

    def off(p: FloatArray) -> FloatArray:
        return shape.distance(p, pz)

    found = least_squares(off, start, method="lm", xtol=1e-14, ftol=1e-14)
    height = unit * _Round(x[None, :] / unit, y[:, None] / unit).height(found.x)
    numbers = _tilt(-float(found.x[1]), -float(found.x[2]))
    if abs(found.x[3]) > FLAT:
        numbers["radius_um"] = float(unit / found.x[3])
    if form == "cylinder":
        numbers["axis_deg"] = float(90.0 - (90.0 - (np.degrees(found.x[4]) - 90.0)) % 180.0)
    return FittedForm(form, height, numbers)


@dataclass(frozen=True, eq=False)
class _Round:
    """Points (x, y) against a sphere or cylinder of parameters z₀, −∂z/∂x, −∂z/∂y, κ and the axis's azimuth."""

    x: FloatArray
    y: FloatArray

    @staticmethod
    def _frame(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal = np.array([p[1], p[2], 1.0])
        normal /= np.linalg.norm(normal)
        if p.size < 5:
            return normal, np.zeros(3)
        axis = np.array([np.cos(p[4]), np.sin(p[4]), 0.0])
        axis -= (axis @ normal) * normal
        return normal, axis / np.linalg.norm(axis)

    def distance(self, p: FloatArray, z: FloatArray) -> FloatArray:
        """Signed distances of the points from the surface."""
        normal, axis = self._frame(p)
        zeta = z - p[0]
        out = normal[0] * self.x + normal[1] * self.y + normal[2] * zeta
        along = axis[0] * self.x + axis[1] * self.y + axis[2] * zeta
        square = self.x**2 + self.y**2 + zeta**2 - along**2
        root = np.maximum(1.0 + 2.0 * p[3] * out + p[3] ** 2 * square, 0.0)
        return np.asarray((p[3] * square + 2.0 * out) / (1.0 + np.sqrt(root)))

    def height(self, p: FloatArray) -> FloatArray:
        """Heights of the surface, NaN where it has none."""
        normal, axis = self._frame(p)
        flat = axis[0] * self.x + axis[1] * self.y
        a = p[3] * (1.0 - axis[2] ** 2)
        b = normal[2] - p[3] * axis[2] * flat
        c = p[3] * (self.x**2 + self.y**2 - flat**2) + 2.0 * (normal[0] * self.x + normal[1] * self.y)
        root = b * b - a * c
        safe = np.sqrt(np.maximum(root, 0.0))
        return np.asarray(np.where(root >= 0.0, p[0] - c / (b + safe), np.nan))
