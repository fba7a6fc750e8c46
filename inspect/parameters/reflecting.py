"""How the reflectance of a surface is computed (`anisoscope.operations.reflectance`)."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Reflecting:
    """Computation of the reflectance of ridges or of a height map.

    Attributes:
        bounces: ridges: most reflections, or 'all'; direct light by default: a file of 16 s takes over 8 min with 2.
        optics: height map: rays on plastic, or waves on a mirror, for steps and depths below a µm.
        lamp_half_angle_deg: height map by waves: half of the angle that the lamp subtends, degrees.
        steps: number of plateaus of a stepped height map, for waves; found if not given.
        pitch_um: pitch of a height map, where it is not to be found in it.
        name: name of a height map.
    """

    bounces: int | Literal["all"] = 1
    optics: Literal["rays", "waves"] = "rays"
    lamp_half_angle_deg: float = 0.9
    steps: int | None = None
    pitch_um: float | None = None
    name: str = "height map"
