"""The table of a bench file that describes a printed sheet, and all that may be wrong with it."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from anisoscope.base.toml_file import NameOrFile, Part, Positive, Share

SmallAngle = Annotated[float, Field(ge=-30.0, le=30.0)]


class SpotPart(Part):
    """A round place where ink is missing: all of it, or a share of its area."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    diameter_mm: Positive
    missing_share: Share = 1.0


class DentPart(Part):
    """A round place where the sheet bulges towards the camera (or away, for a negative tilt).

    The slope grows from the middle up to ``tilt_deg`` at half the radius, and is gone well before twice the radius.
    """

    x_mm: float = 0.0
    y_mm: float = 0.0
    diameter_mm: Positive
    tilt_deg: SmallAngle


class PrintPart(Part):
    """A sheet printed with a structural-colour ink.

    Attributes:
        ink: one that comes with the package, or an ink file.
        coverage: share of the area under ink; dots are too fine to be seen one by one. 1 is solid.
        substrate: reflectance of the bare sheet, diffuse; or a file ``wavelength_nm,reflectance``.
        raster_um: size of the pixels in which the sheet is computed; by default that of the camera's.
        distribution: of the flakes' normals, if it is not that of the ink file.
        grain_share: standard deviation of the ink's brightness from place to place, as every print has it.
        grain_um: correlation length of the grain.
        alpha: roughness in place of the ink file's: another binder.
        alpha_share: share by which the roughness is too large.
        anisotropy: α across the brushing over α along it, in place of the ink file's; their product stays. 1 leaves
            the ink as it is.
        brush_deg: direction of the brushing, counter-clockwise from +x.
        missing_share: share of the inked area that lacks its ink, too fine to be seen.
        flake_tilt_deg: how far the flakes' mean normal leans away from the sheet's: shingled flakes.
        flake_azimuth_deg: the side to which it leans, counter-clockwise from +x.
        film_shift_nm: how far a thicker film on the flakes moves the spectra of ρ and c to longer wavelengths.
        wrong_ink: another ink that got among it.
        wrong_share: share of the inked area that is the wrong ink.
        curl_deg: how far the normal leans half a ``size_mm`` away from the middle, apart from each other at both ends.
        curl_azimuth_deg: direction across which the sheet curls, counter-clockwise from +x.
        pinhole_share: share of the area in pinholes, of ``pinhole_um`` in diameter, at random places.
        spots: places where ink is missing.
        dents: places where the sheet is bent.
    """

    ink: NameOrFile = "synthetic-red"
    coverage: Share = 1.0
    substrate: Share | NameOrFile = 0.04
    raster_um: Positive | None = None
    distribution: Literal["ggx", "beckmann"] | None = None
    grain_share: Annotated[float, Field(ge=0.0, le=0.3)] = 0.01
    grain_um: Positive = 25.0
    alpha: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    alpha_share: Annotated[float, Field(gt=-1.0, le=2.0)] = 0.0
    anisotropy: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    brush_deg: float = 0.0
    missing_share: Share = 0.0
    flake_tilt_deg: SmallAngle = 0.0
    flake_azimuth_deg: float = 0.0
    film_shift_nm: Annotated[float, Field(ge=-100.0, le=100.0)] = 0.0
    wrong_ink: NameOrFile | None = None
    wrong_share: Share = 0.0
    curl_deg: SmallAngle = 0.0
    curl_azimuth_deg: float = 0.0
    pinhole_share: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    pinhole_um: Positive = 60.0
    spots: tuple[SpotPart, ...] = ()
    dents: tuple[DentPart, ...] = ()

    @model_validator(mode="after")
    def _names_the_wrong_ink(self) -> Self:
        if self.wrong_share > 0.0 and self.wrong_ink is None:
            raise ValueError("wrong_share needs to know which ink it is: set wrong_ink")
        return self
