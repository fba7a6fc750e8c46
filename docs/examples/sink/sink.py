"""Sink marks as a defect of a third party: `profile spoil` makes them, and the diagnosis looks for them."""

import numpy as np

from anisoscope.profiles.defect_injection import CauseWords, Defect, HeightMap, Setting, Values


def _sunk(surface: HeightMap, values: Values, _rng: np.random.Generator) -> HeightMap:
    rows, cols = (np.linspace(-1.0, 1.0, size) for size in surface.shape)
    bowl = np.exp(-(rows[:, None] ** 2 + cols**2) / (2.0 * values["radius_share"] ** 2))
    return surface.with_height(surface.height_um - values["depth_um"] * bowl)


SINK = Defect(
    "sink",
    "moulding: packing pressure too low, thick walls behind the surface",
    Setting("depth_um", "µm", "depth in the middle", 20.0),
    (Setting("radius_share", "", "radius, as a share of half the map", 0.5),),
    _sunk,
    title="sink marks, depth",
    plain=CauseWords("The surface has sunk by about {size}", "Reject the part; raise the packing pressure"),
)
