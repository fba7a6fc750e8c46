"""How a soft proof is looked at: shape, turn, lights, and the model of the inks."""

from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

MOST_TURN_DEG = 1e6


@dataclass(frozen=True)
class ProofView:
    """How a page of a proof begins, and what its picture shows.

    Attributes:
        shape: Shape that is printed on.
        yaw_deg: Turn about the upright axis, degrees.
        pitch_deg: Tilt about the horizontal axis, degrees.
        azimuth_deg: Azimuth of the light, counter-clockwise from the right, degrees.
        elevation_deg: Elevation of the light above the picture, degrees.
        second: A second light, half as bright, from the right.
        ink_model: The ink model, or a standard one.
        process: Roughness by the printing process: brushed 0.19, binder-mixed 0.30 (assumed).
        match: Add what photographs show: highlight and scattering of the paper, light behind.

    Raises:
        UsageError: an angle outside its range.
    """

    shape: Literal["sphere", "cylinder", "plane", "mesh"] | None = None
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    azimuth_deg: float = 135.0
    elevation_deg: float = 45.0
    second: bool = True
    ink_model: Literal["goniochromatic", "schlick", "tio2"] = "goniochromatic"
    process: Literal["brushed", "binder-mixed"] | None = None
    match: bool = False

    def __post_init__(self) -> None:
        if not (abs(self.pitch_deg) <= 90.0 and abs(self.elevation_deg) <= 90.0):
            raise UsageError("pitch and elevation take degrees from -90 to 90")
        if not (abs(self.yaw_deg) < MOST_TURN_DEG and abs(self.azimuth_deg) < MOST_TURN_DEG):
            raise UsageError("yaw and azimuth take degrees up to a million")
