"""Parallel ridges of one shape (`anisoscope.profiles.ideal`)."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from anisoscope.base.errors import HeightMapError
from anisoscope.base.quantity import Likely

if TYPE_CHECKING:
    from anisoscope.base.arrays import FloatArray
    from anisoscope.parameters.ridge_outline import CrestArc, Outlines

Wall = Literal["perpendicular", "vertical"] | float
"""Perpendicular to the facet, vertical, or the draft angle of the wall: degrees from the vertical."""

STEEPEST_DRAFT_DEG = 60.0
LIKELY_PITCH = Likely(0.5, 5000.0, "ridges")  # below it no light shows ridges


@dataclass(frozen=True)
class RidgeDesign:
    """Parallel ridges of one shape. Geometry: Luongo et al. 2017, for the perpendicular wall.

    Attributes:
        pitch_um: pitch p, the distance of neighbouring crests in µm.
        ridge_angle_deg: ridge angle θ, the slope of the large facets in degrees, 0 to 45.
        wall: wall of a ridge: perpendicular to the facet, vertical, or its draft angle in degrees from the vertical.
        height_loss: share of the height that is missing at the crests, which end in plateaus, 0 to 1.
        edge_radius_um: radius of the crests in µm, arcs tangent to facet and wall; 0 is sharp. A ball of this radius
            that rolls beneath the surface leaves out what it does not reach. A lost height cuts the rounded crest.
        foot_radius_um: radius of the feet in µm, arcs tangent to facet and wall; 0 is sharp. A ball of this radius that
            rolls above the surface fills in what it does not reach. Heights count from the sharp foot.

    Raises:
        HeightMapError: a parameter outside its range.
    """

    pitch_um: Annotated[float, LIKELY_PITCH]
    ridge_angle_deg: float
    wall: Wall = "perpendicular"
    height_loss: float = 0.0
    edge_radius_um: float = 0.0
    foot_radius_um: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise HeightMapError(f"the pitch must be a positive number of µm, not {self.pitch_um}")
        if not 0.0 <= self.ridge_angle_deg < 45.0:
            raise HeightMapError(f"the ridge angle must be within 0° and 45°, not {self.ridge_angle_deg}°")
        if isinstance(self.wall, str):
            if self.wall not in ("perpendicular", "vertical"):
                raise HeightMapError(f"a wall is perpendicular, vertical or a draft angle, not {self.wall!r}")
        elif not 0.0 <= self.wall <= STEEPEST_DRAFT_DEG:
            raise HeightMapError(
                f"a wall stands within 0° and {STEEPEST_DRAFT_DEG:g}° of the vertical, not {self.wall:g}°"
            )
        if not 0.0 <= self.height_loss <= 1.0:
            raise HeightMapError(f"the height loss must be a share of 0 to 1, not {self.height_loss}")
        self._check_arcs()

    def _check_arcs(self) -> None:
        for what, radius in (("edge", self.edge_radius_um), ("foot", self.foot_radius_um)):
            if not (math.isfinite(radius) and radius >= 0.0):
                raise HeightMapError(f"the {what} radius must be 0 µm or more, not {radius}")
        if self.full_height_um > 0.0:
            if self.edge_radius_um > 0.0:
                self.crest_arc()
            if self.foot_radius_um > 0.0:
                self.foot_arc()
                if self.edge_radius_um > 0.0 and self.edge_radius_um + self.foot_radius_um > self.arcs_um:
                    raise HeightMapError(
                        f"an edge radius of {self.edge_radius_um:g} µm and a foot radius of {self.foot_radius_um:g} µm "
                        f"meet on the wall: give radii whose sum is at most {self.arcs_um:.3g} µm"
                    )

    @property
    def draft_rad(self) -> float:
        """Angle between the wall and the vertical: θ where it is perpendicular to the facet."""
        if isinstance(self.wall, str):
            return math.radians(self.ridge_angle_deg) if self.wall == "perpendicular" else 0.0
        return math.radians(self.wall)

    @property
    def facet_width_um(self) -> float:
        """Width along x of the facet of the uncut ridge: p/(1 + tan θ·tan δ) with the draft δ; p·cos²θ, or p."""
        slope = math.tan(math.radians(self.ridge_angle_deg))
        return float(self.pitch_um / (1.0 + slope * math.tan(self.draft_rad)))

    @property
    def wall_width_um(self) -> float:
        """Width along x of the wall of the uncut ridge: p·sin²θ, or 0 with a vertical wall."""
        return self.pitch_um - self.facet_width_um

    @property
    def full_height_um(self) -> float:
        """Height from foot to crest of the uncut ridge: p·sin θ·cos θ, or p·tan θ with a vertical wall."""
        return float(self.facet_width_um * math.tan(math.radians(self.ridge_angle_deg)))

    @property
    def height_um(self) -> float:
        """Height from foot to crest, or to the plateau where height is lost."""
        return (1.0 - self.height_loss) * self.full_height_um

    @property
    def wall_length_um(self) -> float:
        """Length of the wall of the uncut ridge in the xz plane."""
        return math.hypot(self.wall_width_um, self.full_height_um)

    @property
    def edge_reach_um(self) -> float:
        """Length of facet and of wall from the uncut crest to where the rounded one begins: R·cot of half their angle.

        That angle is 90° − θ + δ, with the draft δ of the wall.
        """
        corner = 0.5 * math.pi - math.radians(self.ridge_angle_deg) + self.draft_rad
        return float(self.edge_radius_um / math.tan(0.5 * corner))

    @property
    def arcs_um(self) -> float:
        """Sum in µm of the radii of crest and foot at which their arcs meet, where neither is sharp."""
        import numpy as np  # noqa: PLC0415

        from anisoscope.parameters.ridge_outline import widest_arcs_um  # noqa: PLC0415

        return float(widest_arcs_um(*(np.array([one]) for one in self._numbers[:3]))[0])

    def crest_arc(self) -> "CrestArc":
        """The arc in place of the crest, before any height is lost, as arrays of one.

        Where the wall is shorter than the arc would need, the arc ends at the foot of the wall.

        Raises:
            HeightMapError: a radius beyond the pitch, or one that leaves no facet.
        """
        return self._arc("edge", self.edge_radius_um)

    def foot_arc(self) -> "CrestArc":
        """The arc in place of the foot, likewise; its radius is negative.

        Raises:
            HeightMapError: a radius beyond the pitch, or one that leaves no facet.
        """
        return self._arc("foot", self.foot_radius_um)

    def _arc(self, what: Literal["edge", "foot"], radius_um: float) -> "CrestArc":
        import numpy as np  # noqa: PLC0415 - options and recipes are made without it

        from anisoscope.parameters.ridge_outline import crest_arcs, foot_arcs  # noqa: PLC0415

        numbers = (np.array([one]) for one in (*self._numbers[:3], radius_um))
        arc = (crest_arcs if what == "edge" else foot_arcs)(*numbers)
        if not arc.possible[0]:
            why = (
                f"is larger than the pitch of {self.pitch_um:g} µm"
                if radius_um > self.pitch_um
                else f"leaves no facet at a pitch of {self.pitch_um:g} µm and a ridge angle of "
                f"{self.ridge_angle_deg:g}°"
            )
            kind = "an edge" if what == "edge" else "a foot"
            raise HeightMapError(f"{kind} radius of {radius_um:g} µm {why}: give a smaller radius")
        return arc

    @property
    def _numbers(self) -> tuple[float, float, float, float]:
        return self.pitch_um, math.radians(self.ridge_angle_deg), self.draft_rad, self.edge_radius_um

    def outline(
        self, widest_rad: float | None = None, chords: int | None = None, foot_chords: int | None = None
    ) -> "Outlines":
        """One period of the profile (`anisoscope.parameters.ridge_outline`), arrays of one.

        Args:
            widest_rad: turn of the chords of rounded crests and feet; that of the module by default.
            chords: so many equal ones of the crest instead.
            foot_chords: the same of the foot.
        """
        import numpy as np  # noqa: PLC0415

        from anisoscope.parameters import ridge_outline as outline  # noqa: PLC0415

        turn = 0.5 * math.pi + math.radians(self.ridge_angle_deg) - self.draft_rad
        widest = min(widest_rad or outline.WIDEST_RAD, outline.WIDEST_RAD)
        edge, foot = (
            outline.chords_for(radius, turn, widest) if radius > 0.0 else 1
            for radius in (self.edge_radius_um, self.foot_radius_um)
        )
        pitch, angle, draft, radius = (np.array([one]) for one in self._numbers)
        low = np.array([self.foot_radius_um]) if self.foot_radius_um > 0.0 else None
        loss = np.array([self.height_loss])
        return outline.ridge_outlines(
            pitch, angle, draft, radius, loss, chords or edge, low, foot_chords or foot
        )

    def profile(self, x_um: "FloatArray") -> "FloatArray":
        """Height in µm above the foot at positions x in µm; an uncut crest is at x = 0."""
        import numpy as np  # noqa: PLC0415

        position = np.mod(x_um, self.pitch_um)
        facet, full = self.facet_width_um, self.full_height_um
        if full == 0.0:
            return np.zeros_like(position)
        height = full * (1.0 - position / facet)
        if self.wall_width_um > 0.0:
            height = np.where(position > facet, full * (position - facet) / self.wall_width_um, height)
        if self.edge_radius_um > 0.0:
            arc = self.crest_arc()
            (low,), (high,) = (arc.at(turn)[0] - arc.x_um for turn in (arc.first_rad, arc.last_rad))
            offset = np.where(position > facet, position - self.pitch_um, position) - arc.x_um
            rounded = arc.z_um + np.sqrt(np.maximum(arc.radius_um**2 - offset**2, 0.0))
            inside = (offset >= low - 1e-9 * self.edge_radius_um) & (offset < high)
            height = np.where(inside, rounded, height)
        if self.foot_radius_um > 0.0:
            arc = self.foot_arc()
            (low,), (high,) = (arc.at(turn)[0] - arc.x_um for turn in (arc.last_rad, arc.first_rad))
            offset = np.mod(position - arc.x_um - low, self.pitch_um) + low
            filled = arc.z_um - np.sqrt(np.maximum(arc.radius_um**2 - offset**2, 0.0))
            height = np.where(offset < high, filled, height)
        return np.minimum(height, self.height_um)
