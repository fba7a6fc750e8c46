"""What recipes of wafers say beyond others: lamp and lens, and a material that is a mirror."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from anisoscope.tomlfile import NotNegative, Part, Share

MIRROR: dict[str, float] = {"alpha_along": 0.001, "alpha_across": 0.001, "albedo": 0.0}
"""Of a material that is given as a mirror, where nothing else is said: polished, and it scatters nothing."""

CERTAIN: dict[str, float] = {"u_alpha_share": 0.0, "u_albedo": 0.0, "u_index": 0.0}
"""Likewise: what is uncertain of a plastic, and is of no account on a mirror."""


WIDEST = 0.4
"""Largest full width of a lamp's spectrum, by its wavelength: the bench's lamps are no wider."""


_SOURCES = {"albedo of the plastic": "share of scattered light"}
"""Sources of uncertainty that are called otherwise on a wafer than the model's input of the same place."""


def source_name(source: str, *, wafer: bool) -> str:
    """What a source of uncertainty is called in a budget."""
    if wafer:
        for plastic, mirror in _SOURCES.items():
            source = source.replace(plastic, mirror)
    return source


class LightPart(Part):
    """Lamp and lens as the part sees them, with standard uncertainties: what waves make of a part depends on them.

    ``bandwidth_nm`` is the full width of the lamp's spectrum at half of its height; half angles are those of the cones
    of light that fall in and that the lens collects.
    """

    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] = 550.0
    bandwidth_nm: Annotated[float, Field(ge=0.0, le=200.0)] = 0.0
    lamp_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    aperture_half_angle_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    u_wavelength_nm: NotNegative = 0.5
    u_bandwidth_share: Share = 0.1
    u_lamp_share: Share = 0.05
    u_aperture_share: Share = 0.02

    @model_validator(mode="after")
    def _light_is_light(self) -> Self:
        if self.bandwidth_nm > WIDEST * self.wavelength_nm:
            raise ValueError(
                f"bandwidth_nm = {self.bandwidth_nm:g} is too wide for a lamp about {self.wavelength_nm:g} nm: at most "
                f"{WIDEST * self.wavelength_nm:.3g}"
            )
        return self
