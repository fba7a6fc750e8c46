"""Material file: a calibrated plastic with its covariance, what it was measured with, and where it holds.

``anisoscope calibrate material`` writes it. The values are those of `parameters.material.Material`; their covariance is
over logarithms of widths and albedo, and over the tail itself, which may be 0:

    schema = 1
    id = "material-20261123-1f0c9a7e"
    name = "ABS, eroded"
    taken_at = "2026-11-23T02:00:00Z"
    [material]        # alpha_along, alpha_across, albedo, index, internal_reflection, tail, second_lobe
    [covariance]      # parameters = ["ln_alpha_along", …], matrix = [[…], …]
    [validity]        # half_angle_deg = [5.0, 20.6], and until when
    [light]           # lamp and lens with which it was measured
    [scan]            # specimen, rig, poses, light_angle_deg
    [test]            # residuals against their noise, and what the family of lobes leaves

A covariance of a plastic that was not calibrated may be 0; ``light``, ``scan`` and ``test`` may then be missing.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import ModelError, RecipeError
from anisoscope.base.toml_file import NotNegative, Part, Positive, read_toml_model
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import InternalReflection, Material
from anisoscope.sim.light.geometry import directions

Parameter = Literal[
    "ln_alpha_along", "ln_alpha_across", "tail", "ln_albedo", "ln_second_weight", "ln_second_width", "ln_lobe"
]
"""``ln_lobe`` is the amplitude of a lobe that its family does not describe; scans determine albedo over amplitude."""
SLACK_DEG = 0.5
"""By how much the half angles of a recipe may exceed those of the scan: seating and the zeros of the axes."""
SAME_WAVELENGTH_NM, SAME_BANDWIDTH_NM, SAME_HALF_ANGLE_DEG = 10.0, 20.0, 1.0
"""Differences of lamp and lens up to which a material is the same."""
_EIGENVALUE = -1e-9  # share of the largest: rounding of the digits in the file


class LobePart(Part):
    """Values of the material, as in `parameters.material.Material`."""

    alpha_along: Positive
    alpha_across: Positive
    albedo: Annotated[float, Field(ge=0.0, le=1.0)]
    index: Annotated[float, Field(gt=1.0, le=4.0)] = 1.5
    internal_reflection: InternalReflection = "nonlinear"
    tail: NotNegative = 0.0
    second_lobe: tuple[Positive, Positive] | None = None

    @model_validator(mode="after")
    def _is_a_material(self) -> Self:
        try:
            self.material()
        except ModelError as error:
            raise ValueError(str(error)) from None
        return self

    def material(self) -> Material:
        """The material of the reflectance models."""
        return Material(**dict(self))


class CovariancePart(Part):
    """Covariance of the values: of their natural logarithms, and of the tail itself; names say which."""

    parameters: Annotated[tuple[Parameter, ...], Field(min_length=1)]
    matrix: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _is_a_covariance(self) -> Self:
        count = len(self.parameters)
        if len(set(self.parameters)) != count:
            raise ValueError("parameters holds a name twice")
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError(f"matrix must have {count} rows of {count} numbers, one for each of parameters")
        matrix = self.array()
        size = float(np.abs(matrix).max())
        if not np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-6 * size):
            raise ValueError("matrix is not symmetric, so it is no covariance")
        if np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0] < _EIGENVALUE * size:
            raise ValueError("matrix has a negative eigenvalue, so it is no covariance")
        return self

    def array(self) -> FloatArray:
        """(n, n) covariance in the order of the parameters."""
        return np.array(self.matrix, dtype=np.float64)

    def u(self) -> dict[Parameter, float]:
        """Standard uncertainty of every parameter."""
        return dict(
            zip(self.parameters, np.sqrt(np.maximum(np.diag(self.array()), 0.0)).tolist(), strict=True)
        )

    def given_tail(self) -> tuple[FloatArray, FloatArray]:
        """(n,) mean of the parameters per unit of the tail (regression on it), and (n, n) covariance at a given tail.

        Where the tail has no uncertainty the mean does not move, and the covariance is the whole one.
        """
        whole = self.array()
        tail = self.parameters.index("tail") if "tail" in self.parameters else None
        if tail is None or whole[tail, tail] <= 0.0:
            return np.zeros(len(whole)), whole
        slope = whole[tail] / whole[tail, tail]
        return slope, whole - np.outer(slope, whole[tail])


class ValidityPart(Part):
    """Where and until when the values hold: angles between half vector and facet normal that the scan spans."""

    half_angle_deg: tuple[NotNegative, Annotated[float, Field(gt=0.0, le=90.0)]]
    until: datetime | None = None

    @field_validator("half_angle_deg")
    @classmethod
    def _from_low_to_high(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError(f"half_angle_deg must rise, not {value[0]:g} to {value[1]:g}")
        return value


class Difference(NamedTuple):
    """Camera, lens or lamp that is another one here: which, and both values with their unit."""

    what: Literal["camera", "lens", "lamp"]
    key: str
    own: str
    here: str

    def text(self, here: str = "here") -> str:
        """Both values, such as "wavelength_nm 520 nm, here 630 nm"."""
        return f"{self.key} {self.own}, {here} {self.here}".strip()


class MaterialLightPart(Part):
    """Lamp and lens of the scan, as far as the rig file states them."""

    wavelength_nm: Positive | None = None
    bandwidth_nm: NotNegative | None = None
    lamp_half_angle_deg: NotNegative | None = None
    aperture_half_angle_deg: NotNegative | None = None

    def other(self, light: Self) -> Difference | None:
        """By what lamp or lens are others here, or None; only what both state is compared."""
        limits = {
            "wavelength_nm": (SAME_WAVELENGTH_NM, " nm"),
            "bandwidth_nm": (SAME_BANDWIDTH_NM, " nm"),
            "lamp_half_angle_deg": (SAME_HALF_ANGLE_DEG, "°"),
            "aperture_half_angle_deg": (SAME_HALF_ANGLE_DEG, "°"),
        }
        for key, (limit, unit) in limits.items():
            own, here = getattr(self, key), getattr(light, key)
            if own is not None and here is not None and abs(own - here) > limit:
                what: Literal["lens", "lamp"] = "lens" if key.startswith("aperture") else "lamp"
                return Difference(what, key, f"{own:g}{unit}", f"{here:g}{unit}")
        return None


class ScanPart(Part):
    """The scan: specimen, rig, and (stage, tilt) of its poses in degrees."""

    specimen: Literal["coupon", "part"]
    rig: str = ""
    camera: str = ""
    operator: str | None = None
    light_angle_deg: float
    poses: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]


class ResidualPart(Part):
    """Residual test of the fit.

    Attributes:
        residual_over_noise: rms of the weighted residuals over √(degrees of freedom/poses); 1 for a family that fits.
        birge_ratio: factor by which the covariance's uncertainties were enlarged; 1 or more.
        degrees_of_freedom: poses less parameters.
        rms_share: rms of the residuals of ln L.
        discrepancy_share: relative standard uncertainty that the family of lobes leaves in a pose, independently.
        family: "tail" or "second lobe".
        p_value: of the residuals; below .001 the family is rejected. None in files of earlier versions.
        bic_advantage: by how much the Bayesian information criterion of the other family is larger; None if not fitted.
    """

    residual_over_noise: NotNegative
    birge_ratio: Annotated[float, Field(ge=1.0)]
    degrees_of_freedom: Annotated[int, Field(ge=0)]
    rms_share: NotNegative
    discrepancy_share: NotNegative
    family: Literal["tail", "second lobe"]
    p_value: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    bic_advantage: float | None = None


class MaterialFile(Part):
    """A calibrated material."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    id: Annotated[str, Field(min_length=1)]
    name: Annotated[str, Field(min_length=1, max_length=200)]
    taken_at: datetime | None = None
    software: str | None = None
    material: LobePart
    covariance: CovariancePart
    validity: ValidityPart
    light: MaterialLightPart = MaterialLightPart()
    scan: ScanPart | None = None
    test: ResidualPart | None = None
    remarks: tuple[str, ...] = ()
    seal: str | None = None

    @model_validator(mode="after")
    def _covariance_of_this_material(self) -> Self:
        second = {"ln_second_weight", "ln_second_width"} & set(self.covariance.parameters)
        if second and self.material.second_lobe is None:
            raise ValueError(f"covariance.parameters names {min(second)}, but material has no second_lobe")
        return self

    def values(self) -> FloatArray:
        """(n,) values of the covariance's parameters."""
        return parameter_values(self.material.material(), self.covariance.parameters)

    def digest(self) -> str:
        """SHA-256 of the content without its seal."""
        return hashlib.sha256(self.model_copy(update={"seal": None}).model_dump_json().encode()).hexdigest()

    def uncovered(
        self, poses: Sequence[Pose], convention: Convention, ridge_angles_deg: Sequence[float]
    ) -> str | None:
        """Why this material must not be used for facets seen in these poses, in one line, or None.

        Args:
            poses: of the recipe.
            convention: of the rig.
            ridge_angles_deg: of the facets; 0 for a flat part.
        """
        found = half_angles_deg(tuple(poses), convention, ridge_angles_deg)
        low, high = self.validity.half_angle_deg
        if found.min() >= low - SLACK_DEG and found.max() <= high + SLACK_DEG:
            return None
        angles = " and ".join(f"{angle:g}°" for angle in ridge_angles_deg)
        return (
            f"the material {self.id} was measured at half angles of {low:.1f}° to {high:.1f}°, but facets of {angles} "
            f"are seen at {found.min():.1f}° to {found.max():.1f}° in these poses: calibrate on a ridged part or with "
            "other tilts, or leave such poses out"
        )

    def other_light(self, light: MaterialLightPart) -> str | None:
        """Why this material belongs to another lamp or lens, in one line, or None; only what both state is compared."""
        found = self.light.other(light)
        if found is None:
            return None
        return (
            f"the material {self.id} was measured with another {found.what}: {found.text()}: calibrate it again with "
            f"this {found.what}"
        )

    def expired(self, at: datetime) -> str | None:
        """Why this material no longer holds at a time, in one line, or None."""
        until = self.validity.until
        if until is not None and until.tzinfo is None:
            until = until.replace(tzinfo=UTC)
        if until is None or at < until:
            return None
        return (
            f"the material {self.id} expired at {until:%Y-%m-%d %H:%M} UTC: take a new one with "
            "`anisoscope calibrate material`"
        )


def parameter_values(material: Material, parameters: Sequence[Parameter]) -> FloatArray:
    """(n,) values of a material in the scales of the covariance."""
    weight, width = material.second_lobe or (np.nan, np.nan)
    found = {
        "ln_alpha_along": np.log(material.alpha_along),
        "ln_alpha_across": np.log(material.alpha_across),
        "tail": material.tail,
        "ln_albedo": np.log(max(material.albedo, 1e-12)),
        "ln_second_weight": np.log(weight),
        "ln_second_width": np.log(width),
        "ln_lobe": 0.0,
    }
    return np.array([found[name] for name in parameters])


def material_at(material: Material, parameters: Sequence[Parameter], values: FloatArray) -> Material:
    """The material with other values of these parameters, in the scales of the covariance.

    A lobe of another amplitude is that of the model over an albedo that is smaller by as much, but for the scale k.

    Raises:
        ModelError: a value outside the range of the model.
    """
    found: dict[str, float] = dict(zip(parameters, map(float, values), strict=True))
    changes: dict[str, Any] = {"tail": found["tail"]} if "tail" in found else {}
    if "ln_lobe" in found:
        found["ln_albedo"] = found.get("ln_albedo", float(np.log(material.albedo))) - found["ln_lobe"]
    changes |= {name[3:]: float(np.exp(found[name])) for name in _LOGS if name in found}
    if material.second_lobe is not None:
        weight, width = (float(np.log(value)) for value in material.second_lobe)
        changes["second_lobe"] = (
            float(np.exp(found.get("ln_second_weight", weight))),
            float(np.exp(found.get("ln_second_width", width))),
        )
    return replace(material, **changes)


_LOGS: tuple[Parameter, ...] = ("ln_alpha_along", "ln_alpha_across", "ln_albedo")


def half_angles_deg(
    poses: tuple[Pose, ...], convention: Convention, ridge_angles_deg: Sequence[float]
) -> FloatArray:
    """(F, P) angles in degrees between the half vector and the normal of F facets.

    Args:
        poses: P poses.
        convention: how their angles are counted.
        ridge_angles_deg: (F,) slopes of the facets toward +x.
    """
    to_light, to_camera = directions(poses, convention)
    half = to_light + to_camera
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    theta = np.radians(np.asarray(ridge_angles_deg, dtype=np.float64))
    normal = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(normal @ half.T, -1.0, 1.0))))


def write_material_file(file: MaterialFile, path: Path) -> MaterialFile:
    """Write a material as TOML, sealed; returns it with its seal.

    Raises:
        RecordError: it cannot be written.
    """
    import tomli_w  # noqa: PLC0415 - start-up time

    content = file.model_copy(update={"seal": None}).model_dump(mode="json", by_alias=True, exclude_none=True)
    read_back = MaterialFile.model_validate(content)
    sealed = read_back.model_copy(update={"seal": read_back.digest()})
    content = {"schema": content.pop("schema"), "seal": sealed.seal} | content
    write_text(path, tomli_w.dumps(content))
    return sealed


def read_material_file(path: Path) -> MaterialFile:
    """Read a material; one without a seal was written by hand.

    Raises:
        RecipeError: missing, wrong, or changed after it had been written.
    """
    found = read_toml_model(path, MaterialFile, error=RecipeError)
    if found.seal is not None and found.seal != found.digest():
        raise RecipeError(
            f"{path}: changed after it had been written: calibrate again, or take out the line seal to vouch for the "
            "values yourself"
        )
    return found
