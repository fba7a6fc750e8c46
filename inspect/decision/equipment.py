"""Camera, lens and lamp with which parts were measured: golden parts serve only where these are the same.

The ratios of a part's radiances are compared with those of golden parts, so that what all of them share cancels: errors
of the camera, stray light, the cones of light of lens and lamp, the wavelength, the angle of the light. Another camera,
lens or lamp changes these ratios, and no scatter between parts contains that. Stage, fixture, white tile and
calibrations of the same camera may differ: they change no ratio, or one within the uncertainty of a single inspection.
"""

from collections.abc import Mapping
from typing import Any, Self

from anisoscope.base.toml_file import Part
from anisoscope.recipe.material_file import Difference, MaterialLightPart
from anisoscope.record.schema import Record
from anisoscope.rig.rigfile import RigFile

SAME_PIXEL_SHARE = 0.02
"""Relative difference of the size of a pixel up to which the lens is the same: focus, and how well it was measured."""
SAME_LIGHT_ANGLE_DEG = 0.2
"""Difference up to which the light stands the same: mirror directions move by half of it, the scatter of seating.

With three golden parts, ridges of 5, 10 and 15° and tilts of 0 and ±10°, it flags at most 2.5 % of good parts at 1 %.
"""


class Equipment(Part):
    """Camera, lens and lamp of an inspection; None where unknown.

    Attributes:
        camera: its name, which ends with its serial number; None where frames do not state it.
        pixel_um: size of a pixel on the sample.
        light_angle_deg: between light and camera.
        light: wavelength, bandwidth and cones of light.
    """

    camera: str | None = None
    pixel_um: float
    light_angle_deg: float
    light: MaterialLightPart = MaterialLightPart()

    @classmethod
    def of_rig(cls, rig: RigFile, camera: str | None = None) -> Self:
        """Equipment of a rig file; the camera comes from the flat, else from the frames."""
        return cls._of(rig.model_dump(mode="json", include={"camera", "light"}), camera)

    @classmethod
    def of_record(cls, record: Record) -> Self | None:
        """Equipment of a finished inspection; None where its record does not hold it."""
        try:
            return cls._of(record.rig, record.camera)
        except KeyError:
            return None

    @classmethod
    def _of(cls, rig: Mapping[str, Any], camera: str | None) -> Self:
        lens, lamp = rig["camera"], rig["light"]
        light = MaterialLightPart(
            wavelength_nm=lamp.get("wavelength_nm"),
            bandwidth_nm=lamp.get("bandwidth_nm"),
            lamp_half_angle_deg=lamp.get("half_angle_deg"),
            aperture_half_angle_deg=lens.get("half_angle_deg"),
        )
        known = None if camera in (None, "", UNKNOWN) else camera
        return cls(camera=known, pixel_um=lens["pixel_um"], light_angle_deg=lamp["angle_deg"], light=light)

    def other(self, here: "Equipment") -> Difference | None:
        """Difference from other equipment, or None; only items that both state are compared."""
        if self.camera and here.camera and not _same_camera(self.camera, here.camera):
            return Difference("camera", "", self.camera, here.camera)
        if abs(here.pixel_um / self.pixel_um - 1.0) > SAME_PIXEL_SHARE:
            return Difference("lens", "pixel_um", f"{self.pixel_um:g}", f"{here.pixel_um:g}")
        if abs(here.light_angle_deg - self.light_angle_deg) > SAME_LIGHT_ANGLE_DEG:
            return Difference("lamp", "angle_deg", f"{self.light_angle_deg:g}°", f"{here.light_angle_deg:g}°")
        return self.light.other(here.light)

    def completed(self, by: "Equipment | None") -> "Equipment":
        """The same, with what only the other one states."""
        if by is None:
            return self
        light = by.light.model_dump(exclude_none=True) | self.light.model_dump(exclude_none=True)
        changes = {"camera": self.camera or by.camera, "light": MaterialLightPart(**light)}
        return self.model_copy(update=changes)

    def __str__(self) -> str:
        """One line for tables."""
        light, lamp = self.light, [f"{self.light_angle_deg:g}°"]
        lamp += [] if light.wavelength_nm is None else [f"{light.wavelength_nm:g} nm"]
        return f"camera {self.camera or UNKNOWN}, {self.pixel_um:g} µm pixels, light at {', '.join(lamp)}"


UNKNOWN = "unknown"
"""What records hold where frames do not name their camera."""


def _same_camera(one: str, other: str) -> bool:
    """Whether the names are of one camera: equal, or one the serial number with which the other ends."""
    return one == other or f" {one}".endswith(f" {other}") or f" {other}".endswith(f" {one}")
