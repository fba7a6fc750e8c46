"""Standard uncertainties of the inputs of a prediction (`anisoscope.prediction.sensitivity`)."""

from dataclasses import dataclass, fields

from anisoscope.base.errors import ModelError


@dataclass(frozen=True)
class InputUncertainty:
    """Standard uncertainties of all inputs of a prediction; the defaults are the recipe's.

    Attributes:
        alpha_share: relative, of roughness along and across, independently.
        albedo: of the diffuse albedo.
        index: of the refractive index.
        tail: of the tail of the lobe.
        light_angle_deg: of the angle between light and camera, degrees.
        light_field_deg: half-width by which the light angle varies over the field of view, degrees.
        stage_deg: of the stage angle, another error in each pose, degrees.
        stage_zero_deg: of the stage's zero against the ridges, the same in all poses, degrees.
        tilt_deg: of the tilt, another error in each pose, degrees.
        tilt_zero_deg: of the zero of the tilt, the same in all poses, degrees.
        seating_tilt_deg: of the seating about x and about y of the part, each, degrees.
        ridge_angle_deg: of the ridge angle of a design, degrees.
        height_loss: of the height loss of a design, a share.
        height_noise_um: standard deviation of the noise of a height map in µm, independent in every point.
        height_scale_share: relative, of the amplification of the heights of a map.
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
    tail: float = 0.0
    light_angle_deg: float = 0.1
    light_field_deg: float = 0.0
    stage_deg: float = 0.05
    stage_zero_deg: float = 0.05
    tilt_deg: float = 0.05
    tilt_zero_deg: float = 0.05
    seating_tilt_deg: float = 0.1
    ridge_angle_deg: float = 0.0
    height_loss: float = 0.0
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
