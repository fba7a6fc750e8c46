"""Pictures of a turned sample: where the camera sees what, plates of ridged fields, and how radiance is shown.

The camera looks from far away along its axis (parallel projection). At zero tilt x of the rig, toward the light,
points right in the picture and y up; a tilt foreshortens the axis that lies in its plane. The sample turns in the
picture as the stage turns it, counter-clockwise unless the convention says otherwise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.light.corrected import radiance
from anisoscope.sim.light.geometry import directions

BoolArray = npt.NDArray[np.bool_]
Bytes = npt.NDArray[np.uint8]
Transfer = Literal["srgb", "linear"]

SUBSAMPLES = 4
STEPS_PER_ALPHA = 6.0
LEAST_LATTICE, MAX_LATTICE = 9, 201


@dataclass(frozen=True)
class View:
    """View of a camera onto the plane of the sample; the rotation axis is in the middle of the picture.

    Attributes:
        shape: (rows, cols) of the picture.
        pixel_um: size of a pixel in the plane through the sample perpendicular to the camera's axis.
        turn_deg: turn of the sample in the picture, counter-clockwise.
        squeeze: (x, y) foreshortening of the horizontal and the vertical of the picture, 0 to 1.
    """

    shape: tuple[int, int]
    pixel_um: float
    turn_deg: float = 0.0
    squeeze: tuple[float, float] = (1.0, 1.0)

    def sample_xy(self, row: FloatArray, column: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x, y in µm on the sample, from the rotation axis, that positions in the picture show.

        Args:
            row: counted downward, pixel centres integer; broadcasts against ``column``.
            column: counted to the right.
        """
        right = (column - 0.5 * (self.shape[1] - 1)) * (self.pixel_um / self.squeeze[0])
        up = (0.5 * (self.shape[0] - 1) - row) * (self.pixel_um / self.squeeze[1])
        cos, sin = _turn(self.turn_deg)
        return cos * right + sin * up, cos * up - sin * right

    def row_column(self, x_um: FloatArray, y_um: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Row and column at which points of the sample appear: the inverse of :meth:`sample_xy`."""
        cos, sin = _turn(self.turn_deg)
        right, up = cos * x_um - sin * y_um, sin * x_um + cos * y_um
        row = 0.5 * (self.shape[0] - 1) - up * self.squeeze[1] / self.pixel_um
        return row, 0.5 * (self.shape[1] - 1) + right * self.squeeze[0] / self.pixel_um

    def extent_um(self, size_um: tuple[float, float]) -> tuple[float, float]:
        """(height, width) in the picture of a rectangle (y, x) of the sample."""
        cos, sin = np.abs(_turn(self.turn_deg))
        return (
            float((sin * size_um[1] + cos * size_um[0]) * self.squeeze[1]),
            float((cos * size_um[1] + sin * size_um[0]) * self.squeeze[0]),
        )


def _turn(angle_deg: float) -> tuple[float, float]:
    """Cosine and sine; quarter turns are exact, so that their pictures are."""
    quarter = round(angle_deg / 90.0)
    if abs(angle_deg - 90.0 * quarter) < 1e-9:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter % 4]
    return float(np.cos(np.radians(angle_deg))), float(np.sin(np.radians(angle_deg)))


def view_of(pose: Pose, convention: Convention, shape: tuple[int, int], pixel_um: float) -> View:
    """The view of a pose under a convention."""
    sense = 1.0 if convention.rotation_sense == "ccw" else -1.0
    squeeze = float(np.cos(np.radians(pose.tilt_deg)))
    return View(
        shape,
        pixel_um,
        sense * pose.stage_deg + convention.facet_azimuth_deg,
        (1.0, squeeze) if convention.tilt_plane == "perpendicular" else (squeeze, 1.0),
    )


@dataclass(frozen=True)
class Plate:
    """A flat plate of square cells, each with ridges in one of two directions.

    Attributes:
        second: (rows, cols) cells with the second direction; the first row is at the top, at +y.
        cell_um: side of a cell.
        ridge_deg: directions of the ridges, counter-clockwise from +y, of the other and of the ``second`` cells.
        design: the ridges.
        material: the plastic.
    """

    second: BoolArray
    cell_um: float
    design: RidgeDesign
    material: Material
    ridge_deg: tuple[float, float] = (0.0, 90.0)

    @property
    def size_um(self) -> tuple[float, float]:
        """(along y, along x)."""
        rows, cols = self.second.shape
        return rows * self.cell_um, cols * self.cell_um


@dataclass(frozen=True)
class PlatePicture:
    """Picture of a plate.

    Attributes:
        radiance: (rows, cols) in 1/sr per unit irradiance at the rotation axis; NaN beyond the plate.
        fields: mean radiance of the visible cells of the first and of the second direction; NaN without any.
        cover: (rows, cols) share of the pixel that the plate covers.
    """

    radiance: FloatArray
    fields: tuple[float, float]
    cover: FloatArray


def checkerboard(count: int) -> BoolArray:
    """``count`` × ``count`` fields; the one at the top left is not ``second``."""
    return np.asarray(np.indices((count, count)).sum(axis=0) % 2 == 1)


def plate_picture(
    plate: Plate,
    pose: Pose,
    convention: Convention,
    view: View,
    light_distance_um: float | None = None,
    bounces: int | None = 1,
) -> PlatePicture:
    """Picture of a plate of ridged cells in one pose.

    Cells are far larger than ridges: each has the radiance of the corrected model for its direction. Edges are
    averaged over 4 × 4 points of a pixel. A near light is a point at ``light_distance_um`` from the rotation
    axis; its direction and its irradiance (inverse square) then vary over the plate. The camera stays far.

    Args:
        plate: the plate.
        pose: stage angle and tilt.
        convention: how the angles are counted.
        view: the view of that pose (`view_of`).
        light_distance_um: distance of the light, or None for parallel light.
        bounces: reflections counted, as in `corrected.radiance`; a near light takes 1 only.

    Raises:
        ModelError: a near light with interreflection, or one too near for so smooth a plastic.
    """
    row, column = np.arange(view.shape[0], dtype=float)[:, None], np.arange(view.shape[1], dtype=float)
    shares = np.zeros((2, *view.shape))
    for offset in np.ndindex(SUBSAMPLES, SUBSAMPLES):
        shift = (np.array(offset) + 0.5) / SUBSAMPLES - 0.5
        kind = _kinds(plate, *view.sample_xy(row + shift[0], column + shift[1]))
        shares += np.stack([kind == 0, kind == 1]) / SUBSAMPLES**2
    to_light, to_camera = (found[0] for found in directions((pose,), convention))
    levels = []
    for ridge_deg in plate.ridge_deg:
        if light_distance_um is None:
            level = _of_field(plate, ridge_deg, to_light[None], to_camera, bounces)
            levels.append(np.broadcast_to(level, view.shape))
        else:
            if bounces != 1:
                raise ModelError("a near light is followed for direct light only: leave the bounces at 1")
            near = _near_field(plate, ridge_deg, light_distance_um * to_light, to_camera)
            levels.append(near(*view.sample_xy(row, column)))
    cover = shares.sum(axis=0)
    light = shares[0] * levels[0] + shares[1] * levels[1]
    means = [
        float(np.sum(share * level) / np.sum(share)) if share.any() else float("nan")
        for share, level in zip(shares, levels, strict=True)
    ]
    shown = np.where(cover > 0.5, light / np.maximum(cover, 0.5), np.nan)
    return PlatePicture(shown, (means[0], means[1]), cover)


def _kinds(plate: Plate, x_um: FloatArray, y_um: FloatArray) -> npt.NDArray[np.int8]:
    """0 or 1 by the direction of the cell at every point, −1 beyond the plate."""
    rows, cols = plate.second.shape
    column = np.floor(x_um / plate.cell_um + 0.5 * cols).astype(np.intp)
    row = np.floor(0.5 * rows - y_um / plate.cell_um).astype(np.intp)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < cols)
    kind = plate.second[np.clip(row, 0, rows - 1), np.clip(column, 0, cols - 1)]
    return np.where(inside, kind, -1).astype(np.int8)


def _of_field(
    plate: Plate, ridge_deg: float, to_light: FloatArray, to_camera: FloatArray, bounces: int | None = 1
) -> FloatArray:
    """(N,) radiances of cells whose ridges are turned, for lights (N, 3) in the frame of the plate."""
    cos, sin = _turn(-ridge_deg)
    back = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]).T
    camera = np.broadcast_to(to_camera, to_light.shape)
    return radiance(to_light @ back, camera @ back, plate.design, plate.material, bounces)


def _near_field(
    plate: Plate, ridge_deg: float, light_um: FloatArray, to_camera: FloatArray
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Radiance of one direction of ridges under a near light, as a function of x and y: a cubic spline.

    Between its nodes the half vector turns by less than a sixth of the smaller roughness.
    """
    from scipy.interpolate import RectBivariateSpline  # noqa: PLC0415 - slow to import

    alpha = min(plate.material.alpha_along, plate.material.alpha_across)
    distance = float(np.linalg.norm(light_um))
    axes: list[FloatArray] = []
    for size in plate.size_um:
        count = int(np.ceil(0.5 * size / distance * STEPS_PER_ALPHA / alpha)) + 1
        if count > MAX_LATTICE:
            raise ModelError(
                f"a light {distance / 1000:g} mm from a plate of {size / 1000:g} mm with roughness {alpha:g} "
                "needs too fine a grid: move the light away, or take a smaller plate or a rougher plastic"
            )
        axes.append(np.linspace(-0.5 * size, 0.5 * size, max(count, LEAST_LATTICE)))
    y, x = np.meshgrid(*axes, indexing="ij")
    ray: FloatArray = light_um - np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    length = np.sqrt(np.sum(ray * ray, axis=1))
    level = _of_field(plate, ridge_deg, ray / length[:, None], to_camera) * np.square(distance / length)
    spline = RectBivariateSpline(axes[0], axes[1], level.reshape(x.shape))
    return lambda x_um, y_um: np.maximum(np.asarray(spline.ev(y_um, x_um), dtype=np.float64), 0.0)


def displayed(
    radiance_: FloatArray | npt.NDArray[np.float32], white: float, transfer: Transfer = "srgb"
) -> Bytes:
    """Grey levels 0 to 255 of radiances; ``white`` becomes 255, missing values 0.

    "srgb" is the transfer of IEC 61966-2-1: the screen then shows radiances in proportion. "linear" hands them on
    uncoded.
    """
    linear = np.clip(np.nan_to_num(np.asarray(radiance_, dtype=np.float64)) / white, 0.0, 1.0)
    if transfer == "srgb":
        linear = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(255.0 * linear + 0.5, dtype=np.uint8)
