"""Checkerboards of two ridge directions, turned on the grid of their map."""

import numpy as np

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap


def turned_board(turn_deg, points, pixel_um, field_um, design=None, directions_deg=(0.0, -90.0)):
    """A square map of a checkerboard turned counter-clockwise, and where it has its second direction."""
    design = RidgeDesign(100.0, 10.0) if design is None else design
    place = (np.arange(points) - 0.5 * (points - 1)) * pixel_um
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    # the corner of four fields stands off the middle, so that fields of all sizes are cut alike by the rim
    x = np.round(cos * place[None, :] + sin * place[:, None], 9) + 1e6 * field_um
    y = np.round(cos * place[:, None] - sin * place[None, :], 9) + 1e6 * field_um
    second = (np.floor(x / field_um) + np.floor(y / field_um)) % 2 == 1
    fields = [
        design.profile(
            np.round(np.cos(np.radians(one)), 12) * (x % field_um - 0.5 * field_um)
            + np.round(np.sin(np.radians(one)), 12) * (y % field_um - 0.5 * field_um)
            + 0.5 * field_um
        )
        for one in directions_deg
    ]
    return HeightMap(np.where(second, fields[1], fields[0]), pixel_um, pixel_um), second
