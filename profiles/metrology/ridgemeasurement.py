"""What is measured on the ridges of a map."""

from dataclasses import dataclass

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.metrology.burrlist import Outlier
from anisoscope.profiles.metrology.quantity import Quantity


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
        direction_deg: of the ridge line, counter-clockwise from +y as seen from +z, within (−90, 90].
        ridge_angle_deg: mean angle between facets and the plane through equal places of all ridges.
        wall_angle_deg: angle of the narrow walls against the same plane, or a lower bound.
        height_um: from foot to crest.
        height_loss: share of the full height (facet and wall prolonged until they meet) missing at the crest.
        edge_radius_um: radius of the crest, or an upper bound.
        alpha_along: Beckmann roughness of the facets along the ridges: √2 times the standard deviation of the slope.
        alpha_across: the same across the ridges.
        noise_um: white noise of the heights, already taken off the roughness.
        bandwidth_um: shortest and longest lateral distance that the roughness covers: the pixel, the facet.
        lean_deg: azimuth, counter-clockwise from +x, toward which the large facets fall; 0 for ideal ridges.
        angle_variation_deg: standard deviation of the ridge angle between ridges.
        height_variation_um: the same of the height.
        shift_variation_um: the same of the position in an even row.
        ridges: the ridges one by one, those with too few points left out.
        burrs: what stands out, largest volume first.
        missing_share: share of the map that was not measured.
        facet_share: share of the pitch that the facets take.
        plateau: whether the crest ends in a level top rather than an edge or an arc.
        score: share of the variance that the other ridges predict.
        mean_ridge: the mean ridge.
    """

    pitch_um: Quantity
    direction_deg: Quantity
    ridge_angle_deg: Quantity
    wall_angle_deg: Quantity
    height_um: Quantity
    height_loss: Quantity
    edge_radius_um: Quantity
    alpha_along: Quantity
    alpha_across: Quantity
    noise_um: Quantity
    bandwidth_um: tuple[float, float]
    lean_deg: float
    angle_variation_deg: Quantity
    height_variation_um: Quantity
    shift_variation_um: Quantity
    ridges: tuple[Ridge, ...]
    burrs: tuple[Outlier, ...]
    missing_share: float
    facet_share: float
    plateau: bool
    score: float
    mean_ridge: MeanRidge
