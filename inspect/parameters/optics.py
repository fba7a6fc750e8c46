"""Lamp and lens as the sample sees them (`anisoscope.sim.light.optics`)."""

import math
from dataclasses import dataclass

from anisoscope.base.errors import ModelError


@dataclass(frozen=True)
class Optics:
    """Apertures of lamp and lens, distance of the lamp, and size of the field.

    Attributes:
        lamp_half_angle_deg: half of the angle that the lamp subtends at the sample, degrees.
        aperture_half_angle_deg: half of the angle of the lens's aperture, degrees; arcsin of its numerical aperture.
        lamp_distance_mm: from the middle of the field to the lamp, mm; far away where it is left out.
        field_mm: width (along the line from camera to light) and height of the field on the sample, mm; the camera
            itself is telecentric: it sees all places under the same angle.
        disc_rings: rings of directions that stand for a disc; 1 is exact for polynomials of degree 5 over the disc,
            n > 1 of degree 4n − 1.

    Raises:
        ModelError: a value that no rig has.
    """

    lamp_half_angle_deg: float = 0.0
    aperture_half_angle_deg: float = 0.0
    lamp_distance_mm: float | None = None
    field_mm: tuple[float, float] = (0.0, 0.0)
    disc_rings: int = 1

    def __post_init__(self) -> None:
        for name, angle in (("light", self.lamp_half_angle_deg), ("camera", self.aperture_half_angle_deg)):
            if not 0.0 <= angle < 60.0:
                raise ModelError(f"the half angle of the {name} must lie between 0° and 60°, not {angle}°")
        if min(self.field_mm) < 0.0 or not all(map(math.isfinite, self.field_mm)):
            raise ModelError(f"the field must have a size of 0 mm or more, not {self.field_mm}")
        if self.lamp_distance_mm is not None and not self.lamp_distance_mm > max(self.field_mm):
            raise ModelError(
                f"the light must stand further away than the field is wide ({max(self.field_mm):g} mm), not "
                f"{self.lamp_distance_mm:g} mm"
            )
        if self.disc_rings < 1:
            raise ModelError(f"a disc of directions needs at least one ring, not {self.disc_rings}")

    @property
    def is_point_like(self) -> bool:
        """Every pose has one direction to the light and one to the camera."""
        near = self.lamp_distance_mm is not None and max(self.field_mm) > 0.0
        return not near and self.lamp_half_angle_deg == 0.0 and self.aperture_half_angle_deg == 0.0


POINT_LIKE = Optics()
