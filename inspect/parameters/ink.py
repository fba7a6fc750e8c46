"""Readings of an ink, its fit and its pictures (`anisoscope.ink`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class InkReadings:
    """Meaning of goniometer readings.

    Attributes:
        values: values are ratios to the white reference, or BRDF in 1/sr.
        reflectance: reflectance of the white reference; 0.99 where it is not given.

    Raises:
        UsageError: a white reference of values that are the BRDF.
    """

    values: Literal["factor", "brdf"] = "factor"
    reflectance: float | None = None

    def __post_init__(self) -> None:
        if self.values == "brdf" and self.reflectance is not None:
            raise UsageError("--reflectance needs --values factor: a BRDF has no white reference")


@dataclass(frozen=True)
class InkFitting(InkReadings):
    """Fit of an ink to goniometer readings.

    Attributes:
        method: all parameters at once, or the published two steps.
        white_table: CSV: theta_i_deg[,theta_o_deg],correction: BRDF of the reference over a Lambertian one.
        white_readings: CSV as DATA: readings of the reference, where values are not divided yet.
        u_reading: relative standard uncertainty of a reading, by which the model is tested; for the weights 0.03 where
            it is not given.
        floor: noise floor in 1/sr; readings up to 3 times as large are dropped.
    """

    method: Literal["joint", "paper"] = "joint"
    white_table: Path | None = None
    white_readings: Path | None = None
    u_reading: float | None = None
    floor: float | None = None


@dataclass(frozen=True)
class InkSpheres:
    """Spheres on which models of an ink are compared.

    Attributes:
        alpha: roughness to show the models with, in place of the fitted one.
        illuminant: illuminant: d65, a, led-b3 …, or CSV wavelength_nm,power.
        size: side of the pictures in pixels.
        seed: seed of the noise of made-up readings.

    Raises:
        UsageError: pictures too large, or a negative seed.
    """

    alpha: float | None = None
    illuminant: str = "d65"
    size: int = 512
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.size <= 2048 or self.seed < 0:
            raise UsageError("--picture-size takes pixels up to 2048, --seed 0 or more")


@dataclass(frozen=True)
class InkView:
    """Light and eye that show an ink.

    Attributes:
        illuminant: illuminant: d65, a, led-b1 … led-b5, led-bh1, led-rgb1, led-v1, led-v2, or CSV wavelength_nm,power.
        light_angles_deg: angles of the light to the normal in degrees, comma-separated.
        off_mirror_deg: angle between eye and mirror direction, in degrees.
        ink_model: the ink model, or a standard one.
        exposure: factor on XYZ before it is shown; else the brightest channel becomes 1.
        adapt: adapt the light's white to that of sRGB (Bradford).
    """

    illuminant: str = "d65"
    light_angles_deg: tuple[float, ...] | None = None
    off_mirror_deg: float = 0.0
    ink_model: Literal["goniochromatic", "schlick", "tio2"] = "goniochromatic"
    exposure: float | None = None
    adapt: bool = False


@dataclass(frozen=True)
class InkTable:
    """Published table of an ink.

    Attributes:
        alpha: roughness α of the print, which a table does not hold.
        scale: scale of ρ: Eq. 5 gives 1/sr (brdf), or the ratio to a white reference (factor).
        reflectance: reflectance of the white reference of a factor; 0.99 if not given.
        name: name of the ink; else that of the file.
        source: where the table is from.

    Raises:
        UsageError: a white reference of a BRDF.
    """

    alpha: float
    scale: Literal["brdf", "factor"] = "brdf"
    reflectance: float | None = None
    name: str | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if self.scale == "brdf" and self.reflectance is not None:
            raise UsageError("--reflectance needs --scale factor: a BRDF has no white reference")
