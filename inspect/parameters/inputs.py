"""Standard uncertainties of the inputs of a prediction (`anisoscope.prediction.sensitivity`)."""

from dataclasses import dataclass, fields

from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import Material

UNMEASURED_SHARE = 0.1
"""Relative standard uncertainty of roughness and albedo of a plastic with an unmeasured lobe."""
USUAL_EDGE_SHARE = 0.4
"""That of a stated radius of the crests."""
SCATTER_ALPHA, SCATTER_ALBEDO, SCATTER_EDGE = 0.05, 0.03, 0.2
"""Relative standard deviations between good parts: of roughness, albedo and radius of the crests."""
SCATTER_DEG = 0.1
"""Standard deviation of the ridge angle of good parts."""


@dataclass(frozen=True)
class InputUncertainty:
    """Standard uncertainties of all inputs of a prediction; the defaults are those of a plastic with a known lobe.

    `default_uncertainty` has those of any plastic, as a recipe that states nothing else.

    Attributes:
        alpha_share: relative, of roughness along and across, independently.
        albedo: of the diffuse albedo.
        index: of the refractive index.
        tail: of the tail of the lobe; 0: the lobe is known. None: it is unmeasured, any tail from 0 to 1 is possible.
        light_angle_deg: of the angle between light and camera, degrees.
        light_field_deg: half-width by which the light angle varies over the field of view, degrees.
        stage_deg: of the stage angle, another error in each pose, degrees.
        stage_zero_deg: of the stage's zero against the ridges, the same in all poses, degrees.
        tilt_deg: of the tilt, another error in each pose, degrees.
        tilt_zero_deg: of the zero of the tilt, the same in all poses, degrees.
        seating_tilt_deg: of the seating about x and about y of the part, each, degrees.
        ridge_angle_deg: of the ridge angle of a design, degrees.
        height_loss: of the height loss of a design, a share.
        edge_radius_share: relative, of the radius of the crests of a design; 0: they are known. None: 0.4 of a stated
            radius, and without one the radius is unmeasured, up to 1 µm.
        height_noise_um: standard deviation of the noise of a height map in µm, independent in every point.
        height_scale_share: relative, of the scale of the heights of a map.
        pixel_size_share: relative, of the pixel size of a map, both axes together.
        height_map_share: relative, of the radiance of a pose, for all other errors of a map.
        reflections_share: relative, of the amplitude of the light that reflects more than once.
        ridges_seen: number of ridges of a height map in the camera's field of view; adds their scatter.

    Raises:
        ModelError: a negative or infinite value, or fewer than one ridge.
    """

    alpha_share: float = 0.05
    albedo: float = 0.01
    index: float = 0.01
    tail: float | None = 0.0
    light_angle_deg: float = 0.1
    light_field_deg: float = 0.0
    stage_deg: float = 0.0
    stage_zero_deg: float = 0.0
    tilt_deg: float = 0.0
    tilt_zero_deg: float = 0.0
    seating_tilt_deg: float = 0.1
    ridge_angle_deg: float = 0.0
    height_loss: float = 0.0
    edge_radius_share: float | None = None
    height_noise_um: float = 0.0
    height_scale_share: float = 0.0
    pixel_size_share: float = 0.0
    height_map_share: float = 0.01
    reflections_share: float = 0.1
    ridges_seen: int | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0.0 <= value < float("inf"):
                name = field.name.replace("_", " ")
                raise ModelError(
                    f"the uncertainty {name!r} must be a finite number, 0 or more, not {value:g}"
                )
        if self.ridges_seen is not None and self.ridges_seen < 1:
            raise ModelError(f"the camera sees one ridge or more, not {self.ridges_seen}")


def default_uncertainty(
    material: Material, tail: float | None = None, *, calibrated: bool = False
) -> InputUncertainty:
    """Standard uncertainties of the inputs where nothing but that of the tail is stated: of options, recipe and API.

    Where neither the tail's uncertainty nor a second lobe is stated, the lobe is unmeasured, and roughness and albedo
    are known to a tenth. Errors of stage and tilt belong to the measurement and are 0.

    Args:
        material: the plastic.
        tail: standard uncertainty of the tail; None where it is not stated.
        calibrated: a material file states the plastic, with a covariance of its own: what is left is the scatter of
            good parts.
    """
    if calibrated:
        albedo = SCATTER_ALBEDO * material.albedo
        return InputUncertainty(alpha_share=SCATTER_ALPHA, albedo=albedo, ridge_angle_deg=SCATTER_DEG)
    if tail is None and material.second_lobe is None:
        albedo = UNMEASURED_SHARE * material.albedo
        return InputUncertainty(alpha_share=UNMEASURED_SHARE, albedo=albedo, tail=None)
    return InputUncertainty(tail=tail or 0.0)
