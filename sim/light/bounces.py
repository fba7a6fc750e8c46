"""Interreflection of the corrected ridge model: light that reflects two and more times within a groove.

All crests of a ridge profile stand equally high, so light that leaves a side upward past a crest never returns,
and plateaus send nothing back: only the facet and the wall of one groove exchange light. Both are planes, and
ridges are long. So two reflections are a double integral over the direction between the sides, with the length
from which a ray leaves a lit point and meets a seen point in closed form, for the full rough-plastic BRDF at
both reflections (glossy and diffuse in all four combinations). It is evaluated by Gauss-Legendre panels laid
around the lobes. From three reflections on, the field within the groove is followed on a grid.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.material import Material
from anisoscope.sim.light.ridge_profile import ridge_polyline, visible_shares

NODES = 6  # of the Gauss-Legendre rule in each panel
BATCH = 64  # poses followed together, for the sake of memory


@dataclass(frozen=True, eq=False)
class _Sides:
    """Facet (0) and wall (1) of one groove, as P directions see them.

    Attributes:
        local: for each side (P, 3) directions in its frame: along the ridges, up the side, normal.
        visible: for each side (P, 2) visible interval, distances from the foot in µm.
    """

    local: tuple[FloatArray, FloatArray]
    visible: tuple[FloatArray, FloatArray]


def _groove(design: RidgeDesign) -> tuple[FloatArray, tuple[float, float]]:
    """(2, 2) unit vectors (x, z) from the foot up facet and wall, and their lengths in µm."""
    x, z = ridge_polyline(design)
    up = np.array([[x[0] - x[1], z[0] - z[1]], [x[2] - x[1], z[2] - z[1]]])
    length = np.hypot(up[:, 0], up[:, 1])
    return up / length[:, None], (float(length[0]), float(length[1]))


def _sides(directions: FloatArray, design: RidgeDesign) -> _Sides:
    """Facet and wall as (P, 3) unit vectors in the sample frame see them."""
    x, z = ridge_polyline(design)
    up, lengths = _groove(design)
    tangents = directions[:, 0] / directions[:, 2]
    shares = visible_shares(x, z, tangents)[:, :2]
    local, visible = [], []
    for side, turn in ((0, 1.0), (1, -1.0)):  # normals: facet (sin θ, cos θ), wall toward −x
        x_up, z_up = up[side]
        normal = directions[:, 0] * turn * z_up - directions[:, 2] * turn * x_up
        across = directions[:, 0] * x_up + directions[:, 2] * z_up
        local.append(np.stack([directions[:, 1], across, np.maximum(normal, 0.0)], axis=-1))
        part = lengths[side] * np.where(normal > 0, shares[:, side], 0.0)
        at_crest = (tangents >= 0) == (side == 0)
        low = np.where(at_crest, lengths[side] - part, 0.0)
        visible.append(np.stack([low, low + part], axis=-1))
    return _Sides((local[0], local[1]), (visible[0], visible[1]))


def _twice(light: _Sides, camera: _Sides, opening: float, material: Material, nodes: int) -> FloatArray:
    """(P,) light after exactly two reflections, in µm/sr; ``opening`` between the sides in radians."""
    from anisoscope.sim.light.bounces_kernels import two_reflections  # noqa: PLC0415 - numba when first needed
    from anisoscope.sim.light.bounces_series import plastic_numbers  # noqa: PLC0415

    numbers = plastic_numbers(material)
    rule = np.stack(np.polynomial.legendre.leggauss(nodes))
    total = np.zeros(len(light.local[0]))
    for pose in range(len(total)):
        for first in (0, 1):
            views = light.local[first][pose], camera.local[1 - first][pose]
            parts = light.visible[first][pose], camera.visible[1 - first][pose]
            total[pose] += two_reflections(*views, *parts, opening, *numbers, rule)
    return total


def _more_often(
    light: _Sides,
    camera: _Sides,
    lengths: tuple[float, float],
    opening: float,
    material: Material,
    bounces: int | None,
) -> FloatArray:
    """(P,) light after three to ``bounces`` reflections, in µm/sr; lengths of the sides in µm."""
    from anisoscope.sim.light.bounces_series import Groove, higher_reflections  # noqa: PLC0415

    groove = Groove(lengths, opening, material)
    total = np.zeros(len(light.local[0]))
    views = [light.local, camera.local, light.visible, camera.visible]
    for start in range(0, len(total), BATCH):
        part = slice(start, start + BATCH)
        facing = [(view[0][part], view[1][part]) for view in views]
        total[part] = higher_reflections(groove, facing[0], facing[1], facing[2], facing[3], bounces)
    return total


def interreflection(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    bounces: int | None = None,
    nodes: int = NODES,
) -> FloatArray:
    """Radiance [1/sr] of light that reflects two to ``bounces`` times, per unit irradiance of the beam.

    Args:
        to_light: (P, 3) unit vectors in the sample frame, above the horizon.
        to_camera: (P, 3) unit vectors in the sample frame, above the horizon.
        design: the ridges.
        material: the plastic.
        bounces: largest number of reflections; None follows all.
        nodes: Gauss-Legendre nodes per panel for two reflections.

    Returns:
        (P,) radiances.

    Raises:
        ModelError: fewer than one reflection.
    """
    if bounces is not None and bounces < 1:
        raise ModelError(f"light reflects at least once, not {bounces} times")
    if bounces == 1 or design.height_um == 0.0 or len(to_light) == 0:
        return np.zeros(len(to_light))
    light, camera = _sides(to_light, design), _sides(to_camera, design)
    up, lengths = _groove(design)
    opening = float(np.arccos(np.clip(up[0] @ up[1], -1.0, 1.0)))
    total = _twice(light, camera, opening, material, nodes)
    if bounces is None or bounces > 2:
        total += _more_often(light, camera, lengths, opening, material, bounces)
    return np.asarray(total / (design.pitch_um * to_camera[:, 2]))
