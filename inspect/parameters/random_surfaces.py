"""Random surfaces over which the effects of imperfections are simulated (`anisoscope.study`)."""

from dataclasses import dataclass
from typing import Literal

Quality = Literal["quick", "normal", "fine"]


@dataclass(frozen=True)
class RandomSurfaces:
    """Height maps of a simulation.

    Attributes:
        quality: size of the height maps and number of random surfaces; fine takes many times as long.
        seed: seed of the random surfaces.
    """

    quality: Quality = "normal"
    seed: int = 1
