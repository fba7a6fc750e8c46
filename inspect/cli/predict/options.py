"""Options of ``anisoscope predict`` that say how uncertain its inputs are."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.prediction.monte_carlo import MonteCarlo
    from anisoscope.prediction.sensitivity import InputUncertainty

GROUP = Group(
    "Uncertainty",
    help="Standard uncertainties (k = 1) of the inputs; 0 takes an input as exact. The defaults are those of a recipe.",
    sort_key=10,
)


@dataclass(frozen=True)
class UncertaintyOptions:
    """The options; names and meaning of the inputs as in `anisoscope.prediction.sensitivity.InputUncertainty`."""

    u_alpha: Annotated[float, Parameter("--u-alpha", help="Of both roughnesses, relative.")] = 0.05
    u_albedo: Annotated[float, Parameter("--u-albedo", help="Of the albedo.")] = 0.01
    u_index: Annotated[float, Parameter("--u-index", help="Of the refractive index.")] = 0.01
    u_light_angle: Annotated[float, Parameter("--u-light-angle", help="Of the light angle, degrees.")] = 0.1
    u_stage: Annotated[
        float, Parameter("--u-stage", help="Of the stage angle, another error in each pose, degrees.")
    ] = 0.05
    u_stage_zero: Annotated[
        float, Parameter("--u-stage-zero", help="Of the stage's zero against the ridges, degrees.")
    ] = 0.05
    u_tilt: Annotated[
        float, Parameter("--u-tilt", help="Of the tilt, another error in each pose, degrees.")
    ] = 0.05
    u_tilt_zero: Annotated[float, Parameter("--u-tilt-zero", help="Of the zero of the tilt, degrees.")] = 0.05
    u_seating_tilt: Annotated[
        float, Parameter("--u-seating-tilt", help="Of the seating about x and about y, each, degrees.")
    ] = 0.1
    u_ridge_angle: Annotated[
        float, Parameter("--u-ridge-angle", help="Design: of the ridge angle, degrees.")
    ] = 0.0
    u_height_loss: Annotated[
        float, Parameter("--u-height-loss", help="Design: of the height loss, a share.")
    ] = 0.0
    u_height_map: Annotated[
        float, Parameter("--u-height-map", help="Map: whatever else is wrong with it, relative, each pose.")
    ] = 0.01
    u_height_noise: Annotated[
        float, Parameter("--u-height-noise", help="Map: noise of a height, standard deviation in µm.")
    ] = 0.0
    u_height_scale: Annotated[
        float, Parameter("--u-height-scale", help="Map: of the scale of the heights, relative.")
    ] = 0.0
    u_pixel_size: Annotated[
        float, Parameter("--u-pixel-size", help="Map: of the pixel size, relative, both axes together.")
    ] = 0.0
    ridges_seen: Annotated[
        int | None,
        Parameter("--ridges-seen", help="Map: ridges in the camera's field, whose scatter then counts too."),
    ] = None
    light_field: Annotated[
        float,
        Parameter(
            "--light-field", help="Half-width by which the light angle varies over the field, degrees."
        ),
    ] = 0.0
    uncertainty: Annotated[
        bool,
        Parameter("--uncertainty", negative="--no-uncertainty", help="State uncertainties; costs some time."),
    ] = True
    monte_carlo: Annotated[
        int | None,
        Parameter(
            "--monte-carlo", help="Draw all inputs this often; their scatter is then the u that is stated."
        ),
    ] = None
    seed: Annotated[int, Parameter("--seed", help="Of the Monte Carlo.")] = 0
    covariance: Annotated[
        bool, Parameter("--covariance", negative="", help="JSON: covariances of radiances and contrasts too.")
    ] = False


DEFAULTS = UncertaintyOptions()
_OF_A_DESIGN = ("u_ridge_angle", "u_height_loss")
_OF_A_MAP = (
    "u_height_map",
    "u_height_noise",
    "u_height_scale",
    "u_pixel_size",
    "ridges_seen",
)


def check_options(options: UncertaintyOptions, *, height_map: bool, as_json: bool, spectrum: bool) -> None:
    """Refuse combinations that make no sense.

    Raises:
        UsageError: one line that says which.
    """
    _check_surface(options, height_map=height_map)
    _check_values(options)
    if not options.uncertainty and (options.monte_carlo is not None or options.covariance):
        which = "--covariance" if options.monte_carlo is None else "--monte-carlo"
        raise UsageError(f"{which} and --no-uncertainty exclude each other")
    if options.covariance and not as_json:
        raise UsageError("--covariance is written as JSON only: add --json")
    if options.monte_carlo is not None and spectrum:
        raise UsageError(
            "--monte-carlo takes one wavelength: give --index and --albedo instead of --spectrum"
        )


def _check_surface(options: UncertaintyOptions, *, height_map: bool) -> None:
    for name in _OF_A_DESIGN if height_map else _OF_A_MAP:
        if getattr(options, name) != getattr(DEFAULTS, name):
            what = "a design (--ridge-angle)" if height_map else "a height map"
            raise UsageError(f"--{name.replace('_', '-')} belongs to {what}")


def _check_values(options: UncertaintyOptions) -> None:
    if options.seed < 0:
        raise UsageError(f"--seed must be 0 or a positive whole number, not {options.seed}")
    if options.monte_carlo is not None and options.monte_carlo < 10:
        raise UsageError(f"--monte-carlo needs at least 10 draws, not {options.monte_carlo}")
    for name, value in vars(options).items():
        if isinstance(value, float) and not 0.0 <= value < float("inf"):
            option = "--" + name.replace("_", "-")
            raise UsageError(f"{option} must be a finite number, 0 or more, not {value:g}")
    if options.ridges_seen is not None and options.ridges_seen < 1:
        raise UsageError(f"--ridges-seen must be 1 or more, not {options.ridges_seen}")


def input_uncertainty(options: UncertaintyOptions) -> "InputUncertainty | None":
    """The uncertainties of the options; None with --no-uncertainty."""
    from anisoscope.prediction.sensitivity import InputUncertainty

    if not options.uncertainty:
        return None
    return InputUncertainty(
        alpha_share=options.u_alpha,
        albedo=options.u_albedo,
        index=options.u_index,
        light_angle_deg=options.u_light_angle,
        light_field_deg=options.light_field,
        stage_deg=options.u_stage,
        stage_zero_deg=options.u_stage_zero,
        tilt_deg=options.u_tilt,
        tilt_zero_deg=options.u_tilt_zero,
        seating_tilt_deg=options.u_seating_tilt,
        ridge_angle_deg=options.u_ridge_angle,
        height_loss=options.u_height_loss,
        height_noise_um=options.u_height_noise,
        height_scale_share=options.u_height_scale,
        pixel_size_share=options.u_pixel_size,
        height_map_share=options.u_height_map,
        ridges_seen=options.ridges_seen,
    )


def monte_carlo(options: UncertaintyOptions) -> "MonteCarlo | None":
    """The Monte Carlo of the options, or None."""
    from anisoscope.prediction.monte_carlo import MonteCarlo

    return None if options.monte_carlo is None else MonteCarlo(options.monte_carlo, options.seed)
