"""Reference part of a commissioning, and how well it is known."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.errors import UsageError
from anisoscope.parameters.material import InternalReflection
from anisoscope.parameters.ridges import Wall


@dataclass(frozen=True)
class RidgedPart:
    """Reference part: values and standard uncertainties.

    Attributes:
        pitch_um: pitch of the ridges.
        ridge_angle_deg, u_ridge_angle_deg: ridge angle.
        alpha_along, alpha_across, u_alpha_share: roughness and its relative standard uncertainty.
        alpha_covariance: of ln α along and ln α across, where they were measured together; u_alpha_share of each
            otherwise.
        tail, u_tail: tail of the lobe.
        second_lobe: weight and width of a second lobe, as in `parameters.material.Material`.
        internal_reflection: as there.
        albedo, u_albedo: albedo of the plastic.
        index, u_index: its refractive index.
        u_seating_deg: standard uncertainty of its seating about either axis.
        wall: shape of the wall.
        edge_radius_um: radius of the crests, 0 for sharp ones.
        foot_radius_um: radius of the feet, likewise.
        facet_azimuth_deg: azimuth in the fixture toward which the facets are said to lean.
        center_mm: middle of the ridged area in the fixture.
        spot_mm: diameter of the spot that is looked at.
    """

    pitch_um: float
    ridge_angle_deg: float
    alpha_along: float = 0.06
    alpha_across: float = 0.10
    albedo: float = 0.2
    index: float = 1.5
    u_ridge_angle_deg: float = 0.1
    u_alpha_share: float = 0.05
    u_albedo: float = 0.01
    u_index: float = 0.01
    u_seating_deg: float = 0.1
    wall: Wall = "perpendicular"
    edge_radius_um: float = 0.0
    foot_radius_um: float = 0.0
    alpha_covariance: tuple[tuple[float, float], tuple[float, float]] | None = None
    tail: float = 0.0
    u_tail: float = 0.0
    second_lobe: tuple[float, float] | None = None
    internal_reflection: InternalReflection = "nonlinear"
    facet_azimuth_deg: float = 0.0
    center_mm: tuple[float, float] = (0.0, 0.0)
    spot_mm: float = 1.0

    def __post_init__(self) -> None:
        if not 0.5 <= self.ridge_angle_deg < 45.0:
            raise UsageError(
                f"commissioning needs ridges of 0.5° to 45°, not {self.ridge_angle_deg:g}°: a flat part looks alike "
                "all round"
            )
        if not self.spot_mm > 2.0 * self.pitch_um / 1000.0:
            raise UsageError(f"the spot must span at least two pitches, not {self.spot_mm:g} mm")

    @property
    def u_log_mean(self) -> float:
        """Standard uncertainty of ln √(α along · α across)."""
        ((along, both), (_, across)) = self._alpha_covariance
        return float(0.5 * np.sqrt(along + across + 2.0 * both))

    @property
    def u_log_ratio(self) -> float:
        """Standard uncertainty of ln (α across/α along)."""
        ((along, both), (_, across)) = self._alpha_covariance
        return float(np.sqrt(along + across - 2.0 * both))

    @property
    def _alpha_covariance(self) -> tuple[tuple[float, float], tuple[float, float]]:
        each = self.u_alpha_share**2
        return self.alpha_covariance or ((each, 0.0), (0.0, each))
