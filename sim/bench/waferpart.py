"""Table of a bench file for an etched wafer: etching errors and illumination."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive, Share

SmallHalfAngle = Annotated[float, Field(gt=0.0, le=10.0)]


class WaferPart(Part):
    """A wafer with a pattern of level steps, coated so that it reflects like a mirror.

    Attributes:
        file: what is etched: a design or a layout of dots (as ``anisoscope design`` writes them), an etch mask
            (GDSII), or a height map. It is a tile that is repeated over the sample.
        dot_um: side of a random dot, where the file is a design of one reflectance.
        dots: number of different dots in the tile of a design, along x and along y.
        grid_um: of a mask that does not say it.
        passes_nm: depths of the etch passes of a mask that does not say them.
        over_etch_nm: every pass is deeper by this.
        over_etch_share: and by this share of itself.
        width_bias_nm: every etched feature is wider by this, half of it at each edge.
        reflectance: of the coating.
        scatter: share of the reflected light that fine dirt and roughness scatter everywhere (Lambert).
        wavelength_nm: middle of the lamp's spectrum.
        bandwidth_nm: full width of it at half of its height.
        lamp_half_angle_deg: half of the angle that the lamp subtends.
        aperture_half_angle_deg: half of the angle of the lens's aperture.
    """

    file: LocalPath
    dot_um: Positive = 128.0
    dots: Annotated[int, Field(ge=1, le=64)] = 4
    grid_um: Positive | None = None
    passes_nm: tuple[Positive, ...] | None = None
    over_etch_nm: float = 0.0
    over_etch_share: Annotated[float, Field(gt=-1.0, le=1.0)] = 0.0
    width_bias_nm: float = 0.0
    reflectance: Share = 0.9
    scatter: Share = 0.001
    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] = 520.0
    bandwidth_nm: NotNegative = 10.0
    lamp_half_angle_deg: SmallHalfAngle = 0.3
    aperture_half_angle_deg: SmallHalfAngle = 0.7

    @model_validator(mode="after")
    def _light_is_light(self) -> Self:
        if self.bandwidth_nm > 0.4 * self.wavelength_nm:
            raise ValueError(
                f"bandwidth_nm = {self.bandwidth_nm:g} is too wide for a lamp about {self.wavelength_nm:g} nm"
            )
        return self
