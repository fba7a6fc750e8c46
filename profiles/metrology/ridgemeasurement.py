"""What is measured on the ridges of a map."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.notebook import axes_or_new, data_frame, html_table
from anisoscope.profiles.metrology.burrlist import Outlier
from anisoscope.profiles.metrology.quantity import Quantity, as_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MOST_BOW = 0.01
MIN_SEGMENTS = 3
CLEAR = 6.0
OF_STRAIGHT_FACETS = (
    "ridge_angle_deg",
    "wall_angle_deg",
    "height_um",
    "height_loss",
    "edge_radius_um",
    "foot_loss",
    "foot_radius_um",
    "alpha_across",
    "angle_variation_deg",
    "along_variation_deg",
    "height_variation_um",
)
OF_ALL_RIDGES = {
    "line_drift_um": "lines of the scan differ in height by {:.2g} µm from one to the next (rms); alpha is without "
    "these steps and has the wider u",
    "lay_um": "heights step by {:.2g} µm (rms) from line to line along the ridges: marks of machining, or drift of the "
    "instrument; alpha across holds them and has the wider u",
    "strip_um": "strips of the map are out of place by {:.2g} µm (rms), as stitched fields and lateral drift are: "
    "pitch and direction have the wider u",
    "height_step_um": "heights are rounded to steps of {:.3g} µm, which alpha feels: save the map with finer steps",
    "short_share": "{:.0%} of what looks like noise may be roughness shorter than three pixels; alpha has the wider u: "
    "measure with smaller pixels",
    "seen_limit_um": "an instrument with a lateral period limit of {:.3g} µm would round sharp crests and feet like "
    "these; wall angle, height, losses, radii and alpha have the wider u: give --period-limit",
}
"""Remarks on what all ridges share, by the field that holds its amount."""


@dataclass(frozen=True)
class Segment:
    """A length of the map along its ridges.

    Attributes:
        place_um: middle of the length, along the ridges from the middle of the map.
        angle_deg: mean ridge angle of all ridges there.
    """

    place_um: float
    angle_deg: Quantity


@dataclass(frozen=True)
class Ridge:
    """One ridge: a large facet and the wall before it.

    Attributes:
        number: counted from 1 in the direction in which the facets fall.
        position_um: distance of its wall from the map's first point, across the ridges.
        angle_deg: ridge angle.
        height_um: from foot to crest at its wall.
        shift_um: how far its wall stands from its place in an even row.
        points: measured points on its facet.
    """

    number: int
    position_um: float
    angle_deg: Quantity
    height_um: Quantity
    shift_um: Quantity
    points: int


@dataclass(frozen=True, eq=False)
class MeanRidge:
    """The mean ridge about its wall, for drawing.

    Attributes:
        x_um: (n,) position from the wall, facets falling toward +x.
        height_um: (n,) heights.
        facet_um: where the fitted facet begins and ends.
        facet_height_um: heights of the fitted plane there.
        slopes_across: (m,) slopes of single points of the facets across the ridges, in units of height per length.
        slopes_along: (m,) the same along them.
    """

    x_um: FloatArray
    height_um: FloatArray
    facet_um: tuple[float, float]
    facet_height_um: tuple[float, float]
    slopes_across: FloatArray
    slopes_along: FloatArray


@dataclass(frozen=True, eq=False)
class RidgeMeasurement:
    """The ridges of a map; every quantity with its standard uncertainty (coverage factor 1).

    Attributes:
        pitch_um: distance of neighbouring ridges, in the plane of the map.
        surface_pitch_um: the same in the plane through equal places of all ridges, where the map is tilted.
        direction_deg: of the ridge line, counter-clockwise from +y as seen from +z, within (−90, 90].
        ridge_angle_deg: mean angle between facets and the plane through equal places of all ridges.
        wall_angle_deg: angle of the narrow walls against the same plane, or a lower bound.
        height_um: from foot to crest.
        height_loss: share of the full height (facet and wall prolonged until they meet) missing at the crest.
        edge_radius_um: radius of the crest, or an upper bound.
        foot_loss: share of the full height that a rounded or level foot fills.
        foot_radius_um: radius of the foot, or an upper bound.
        alpha_along: Beckmann roughness of the facets along the ridges: √2 times the standard deviation of the slope.
        alpha_across: the same across the ridges.
        noise_um: white noise of the heights, already taken off the roughness.
        bandwidth_um: shortest and longest lateral distance that the roughness covers: the pixel, the facet.
        lean_deg: azimuth, counter-clockwise from +x, toward which the large facets fall; 0 for ideal ridges.
        angle_variation_deg: standard deviation of the ridge angle between ridges.
        height_variation_um: the same of the height.
        shift_variation_um: the same of the position in an even row.
        along_variation_deg: standard deviation of the ridge angle between lengths along the ridges.
        segments: ridge angles of these lengths.
        ridges: the ridges one by one, those with too few points left out.
        burrs: what stands out, largest volume first.
        missing_share: share of the map that was not measured.
        facet_share: share of the pitch that the facets take.
        plateau: whether the crest ends in a level top rather than an edge or an arc.
        score: share of the variance that the other ridges predict.
        mean_ridge: the mean ridge.
        form_um: rms of the form (waviness, curvature) that was removed before; 0 where there was none that counts.
        facet_bow: rms distance of the mean facet from a straight line, as a share of its rise.
        second_direction_deg: direction of other ridges that cross these; None where there are none.
        line_drift_um: rms step between neighbouring lines of the scan, taken off alpha; 0 where none counts.
        height_step_um: step to which heights are rounded, where alpha feels it; else 0.
        short_share: share of the noise that is roughness shorter than three pixels, where alpha feels it; else 0.
        lay_um: rms step across that whole ridges share, where alpha across holds it; else 0.
        period_limit_um: lateral period limit of the instrument that was given, and its blur taken off; else None.
        strip_um: rms shift between strips of the map, where that is more than tiles scatter; else 0.
        tip_radius_um: radius of the instrument's tip that was given, and taken off crest, foot and height; else None.
        seen_limit_um: one that alone would round crest and foot as they are, where none was given; else 0.
    """

    pitch_um: Quantity
    surface_pitch_um: Quantity
    direction_deg: Quantity
    ridge_angle_deg: Quantity
    wall_angle_deg: Quantity
    height_um: Quantity
    height_loss: Quantity
    edge_radius_um: Quantity
    foot_loss: Quantity
    foot_radius_um: Quantity
    alpha_along: Quantity
    alpha_across: Quantity
    noise_um: Quantity
    bandwidth_um: tuple[float, float]
    lean_deg: float
    angle_variation_deg: Quantity
    height_variation_um: Quantity
    shift_variation_um: Quantity
    along_variation_deg: Quantity
    segments: tuple[Segment, ...]
    ridges: tuple[Ridge, ...]
    burrs: tuple[Outlier, ...]
    missing_share: float
    facet_share: float
    plateau: bool
    score: float = field(metadata=json_field("periodicity"))
    mean_ridge: MeanRidge = field(metadata=LEFT_OUT)
    form_um: float = 0.0
    facet_bow: float = 0.0
    second_direction_deg: float | None = None
    line_drift_um: float = 0.0
    height_step_um: float = 0.0
    short_share: float = 0.0
    lay_um: float = 0.0
    period_limit_um: float | None = None
    seen_limit_um: float = 0.0
    strip_um: float = 0.0
    tip_radius_um: float | None = None

    @property
    @in_json()
    def varies_along(self) -> bool:
        """Whether ridge angles differ along the ridges by more than the ridges of each length explain."""
        known = [one.angle_deg for one in self.segments]
        if len(known) < MIN_SEGMENTS or not self.straight:
            return False
        angles, errors = np.array([(one.value, one.u) for one in known], dtype=np.float64).T
        weight = 1.0 / np.maximum(errors, 1e-9) ** 2
        away = float(weight @ np.square(angles - float(weight @ angles / weight.sum())))
        freedom = len(known) - 1
        return bool(away > freedom + CLEAR * np.sqrt(2.0 * freedom))

    @property
    @in_json()
    def straight(self) -> bool:
        """Whether the facets are straight, within 1 % of their rise; else a ridge angle describes no facet."""
        return self.facet_bow <= MOST_BOW

    def remarks(self) -> tuple[str, ...]:
        """Remarks on the numbers: round flanks, ridges of another direction, form that was removed."""
        found = []
        if not self.straight:
            found.append(
                "NO STRAIGHT FACETS: ridge angle, wall angle, ridge height, height loss, edge radius and alpha across "
                f"have no value; the flanks leave a straight line by {self.facet_bow:.1%} of their rise (rms, limit "
                f"{MOST_BOW:.0%}), as those of a wave do"
            )
        if self.second_direction_deg is not None:
            found.append(
                f"other ridges run at {self.second_direction_deg:.1f}°; the numbers are of those listed only"
            )
        if self.form_um > 0.0:
            found.append(
                f"form of {self.form_um:.3g} µm (rms) was removed: waviness or curvature beneath the ridges"
            )
        if self.varies_along:
            angles = [one.angle_deg.value for one in self.segments if one.angle_deg.value is not None]
            found.append(
                f"the ridge angle is not the same along the ridges: {min(angles):.2f}° to {max(angles):.2f}° in "
                f"{len(angles)} lengths; the ridge angle is their mean, and its u is not the spread"
            )
        shared = ((text, getattr(self, name)) for name, text in OF_ALL_RIDGES.items())
        return (*found, *(text.format(amount) for text, amount in shared if amount > 0.0))

    def stated(self) -> Self:
        """Numbers for table, page and JSON: none of straight facets where there are none."""
        if self.straight:
            return self
        none = Quantity(None)
        ridges = tuple(replace(one, angle_deg=none, height_um=none) for one in self.ridges)
        without: dict[str, Any] = dict.fromkeys(OF_STRAIGHT_FACETS, none)
        return replace(self, ridges=ridges, **without)

    def quantities(self) -> dict[str, Quantity]:
        """All numbers that have an uncertainty, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Quantity)}

    def __repr__(self) -> str:
        """One line: pitch, ridge angle, height, how many ridges and burrs."""
        found = self.stated()
        pitch, angle, height = (
            " ± ".join(as_text(value)) for value in (found.pitch_um, found.ridge_angle_deg, found.height_um)
        )
        return (
            f"RidgeMeasurement(pitch {pitch} µm, ridge angle {angle}°, height {height} µm, "
            f"{len(self.ridges)} ridges, {len(self.burrs)} burrs)"
        )

    def _repr_html_(self) -> str:
        rows = [(name, *as_text(value)) for name, value in self.stated().quantities().items()]
        title = f"{len(self.ridges)} ridges, {len(self.burrs)} burrs, {self.missing_share:.2%} missing"
        return html_table(title, ("quantity", "value", "u"), rows)

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the mean ridge about its wall, and the plane fitted to its facet.

        Args:
            axes: of matplotlib, to draw into; a new figure where they are not given.
        """
        axes, mean = axes_or_new(axes), self.mean_ridge
        axes.plot(mean.x_um, mean.height_um, label="mean ridge")
        axes.plot(mean.facet_um, mean.facet_height_um, "--", label="fitted facet")
        axes.set(xlabel="across the ridges [µm]", ylabel="height [µm]")
        axes.legend()
        return axes

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas need not be installed
        """The numbers as a pandas data frame: quantity, value, u, and bounds where only these are known.

        Raises:
            UsageError: pandas is not installed.
        """
        found = self.stated().quantities()
        columns = {
            name: [getattr(one, name) for one in found.values()]
            for name in ("value", "u", "at_least", "at_most")
        }
        return data_frame({"quantity": list(found), **columns})
