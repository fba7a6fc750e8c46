"""``anisoscope predict``: radiance and contrasts of a design or of a height map."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.predict.angular_map import MAP_DEFAULTS, MAP_GROUP, MapOptions
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from anisoscope.base.progress import Advance
    from anisoscope.parameters.inputs import InputUncertainty
    from anisoscope.parameters.material import Material
    from anisoscope.parameters.optics import Optics
    from anisoscope.prediction.monte_carlo import MonteCarlo
    from anisoscope.prediction.optics_selection import OpticsModel, OpticsRequest
    from anisoscope.prediction.predicted import Predicted

    PredictOne = Callable[[Material, Advance, float | None], tuple[Predicted, ...]]


GROUP = Group(
    "Uncertainty",
    help="Standard uncertainties (k = 1) of the inputs; 0 takes an input as exact. The defaults are those of a recipe.",
    sort_key=10,
)


@dataclass(frozen=True)
class UncertaintyOptions:
    """The options; names and meaning of the inputs as in `anisoscope.parameters.inputs.InputUncertainty`."""

    u_alpha: Annotated[float, Parameter("--u-alpha", help="Of the roughness along and across, relative.")] = (
        0.05
    )
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
        float, Parameter("--u-height-map", help="Map: all other errors, relative, in each pose.")
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
    u_reflections: Annotated[
        float, Parameter("--u-reflections", help="Of the amplitude of all further reflections, relative.")
    ] = 0.1
    ridges_seen: Annotated[
        int | None,
        Parameter("--ridges-seen", help="Map: number of ridges in the camera's field; adds their scatter."),
    ] = None
    light_field: Annotated[
        float,
        Parameter(
            "--light-field", help="Half-width by which the light angle varies over the field, degrees."
        ),
    ] = 0.0
    uncertainty: Annotated[
        bool,
        Parameter(
            "--uncertainty", negative="--no-uncertainty", help="Compute uncertainties; takes some time."
        ),
    ] = True
    monte_carlo: Annotated[
        int | None,
        Parameter("--monte-carlo", help="Number of draws of all inputs; u is then their standard deviation."),
    ] = None
    seed: Annotated[int, Parameter("--seed", help="Seed of the Monte Carlo.")] = 0
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
    _check_inputs(options, height_map=height_map)
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


def _check_inputs(options: UncertaintyOptions, *, height_map: bool) -> None:
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
    from anisoscope.parameters.inputs import InputUncertainty

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
        reflections_share=options.u_reflections,
        ridges_seen=options.ridges_seen,
    )


def monte_carlo(options: UncertaintyOptions) -> "MonteCarlo | None":
    """The Monte Carlo of the options, or None."""
    from anisoscope.prediction.monte_carlo import MonteCarlo

    return None if options.monte_carlo is None else MonteCarlo(options.monte_carlo, options.seed)


WAVE_GROUP = Group(
    "Waves",
    help="Which optics: --model auto takes waves where rays fail, geometric or wave insists, both compares.",
    sort_key=8,
)

Model = Literal["auto", "geometric", "wave", "both", "printed", "corrected", "relief"]
GEOMETRIC_MODELS = ("printed", "corrected", "relief")


@dataclass(frozen=True)
class WaveOptions:
    """The options."""

    wavelengths: Annotated[
        str | None,
        Parameter("--wavelengths", help="Of the light in nm, comma-separated: NM or NM:WEIGHT. Default 550."),
    ] = None
    interpolate: Annotated[
        int,
        Parameter(
            "--interpolate", help="Points per original point along each axis, for waves on smooth maps."
        ),
    ] = 1


WAVE_DEFAULTS = WaveOptions()


def optics_request(
    options: WaveOptions, model: Model | None, bounces: int | Literal["all"], roughness: str
) -> "OpticsRequest | None":
    """Requested wave optics; None where --model names one of the geometric models.

    Raises:
        UsageError: wavelengths that are none, or options that waves do not know.
    """
    if options.interpolate < 1:
        raise UsageError(f"--interpolate must be 1 or more, not {options.interpolate}")
    if model in GEOMETRIC_MODELS:
        if options != WAVE_DEFAULTS:
            raise UsageError(
                f"--wavelengths and --interpolate are for waves; --model {model} knows rays only"
            )
        return None
    optics: OpticsModel = "auto"
    if model == "geometric" or model == "wave" or model == "both":  # noqa: PLR1714 - narrows the type
        optics = model
    if optics in ("wave", "both") and roughness != "lobe":
        raise UsageError(
            f"--roughness plastic belongs to rays: --model {optics} takes the roughness of a lobe"
        )
    from anisoscope.prediction.optics_selection import OpticsRequest

    if optics == "auto" and roughness != "lobe":
        optics = "geometric"
    count = None if bounces == "all" else bounces
    return OpticsRequest(optics, light_of(options.wavelengths), options.interpolate, count)


def light_of(text: str | None) -> Any:  # noqa: ANN401 - a LightSpectrum, imported when it runs
    """Wavelengths and weights of the option.

    Raises:
        UsageError: something that is no wavelength or no weight.
    """
    from anisoscope.parameters.light import LightSpectrum

    if text is None:
        return LightSpectrum()
    parts = [part.partition(":") for part in text.split(",")]
    nm = [parse_numbers(part[0], "--wavelengths", "530:1,550:2")[0] for part in parts]
    weights = [
        parse_numbers(part[2], "--wavelengths", "530:1,550:2")[0] if part[1] else 1.0 for part in parts
    ]
    return LightSpectrum(tuple(1e-3 * value for value in nm), tuple(weights))


def differences(geometric: "Predicted", wave: "Predicted") -> list[dict[str, float | None]]:
    """Difference of wave to geometric optics in every pose, relative to the brightest radiance and to the pose.

    Null where that is dark.
    """
    brightest = float(geometric.radiance.max())
    return [
        {
            "stage_deg": pose.stage_deg,
            "tilt_deg": pose.tilt_deg,
            "difference": float(w - g),
            "relative": float(w / g - 1.0) if g > 0.0 else None,
            "of_brightest": float((w - g) / brightest) if brightest > 0.0 else None,
        }
        for pose, g, w in zip(geometric.poses, geometric.radiance, wave.radiance, strict=True)
    ]


def print_differences(geometric: "Predicted", wave: "Predicted") -> None:
    """Print the table of differences between the optics."""
    rows = [
        [
            f"{one['stage_deg']:g}",
            f"{one['tilt_deg']:g}",
            f"{one['difference']:+.5f}",
            *(
                "–" if share is None else f"{100.0 * share:+.2f}"
                for share in (one["relative"], one["of_brightest"])
            ),
        ]
        for one in differences(geometric, wave)
    ]
    head = ["stage [°]", "tilt [°]", "wave − geometric [1/sr]", "relative [%]", "of the brightest pose [%]"]
    print_table("What waves change", head, rows)


OPTICS_GROUP = Group(
    "Lamp and lens", help="Sizes as the sample sees them; without them both are points far away.", sort_key=9
)


@dataclass(frozen=True)
class OpticsOptions:
    """The options; meaning as in `anisoscope.sim.light.optics.Optics`."""

    lamp_half_angle: Annotated[
        float, Parameter("--lamp-half-angle", help="Half of the angle subtended by the lamp, degrees.")
    ] = 0.0
    aperture: Annotated[float, Parameter("--aperture", help="Numerical aperture of the lens.")] = 0.0
    lamp_distance: Annotated[
        float | None, Parameter("--lamp-distance", help="From the middle of the field to the lamp, mm.")
    ] = None
    field: Annotated[
        str | None,
        Parameter(
            "--field",
            help="Size of the field on the sample in mm: SIZE or WIDTH,HEIGHT; with --lamp-distance.",
        ),
    ] = None
    disc_rings: Annotated[
        int,
        Parameter("--disc-rings", help="Rings of directions for lamp and lens; more where lobes are narrow."),
    ] = 1


OPTICS_DEFAULTS = OpticsOptions()


def optics_of(options: OpticsOptions) -> "Optics":
    """The optics of the options.

    Raises:
        UsageError: a field without a lamp distance or the other way round, or a numerical aperture beyond 0 to 0.86.
    """
    import numpy as np

    from anisoscope.parameters.optics import Optics

    if (options.field is None) != (options.lamp_distance is None):
        raise UsageError("--lamp-distance and --field belong together: the light angle varies over the field")
    if not 0.0 <= options.aperture < 0.86:
        raise UsageError(f"--aperture must be a numerical aperture of 0 to 0.86, not {options.aperture:g}")
    size = (0.0,) if options.field is None else parse_numbers(options.field, "--field")
    if len(size) not in (1, 2) or (options.field is not None and min(size) <= 0.0):
        raise UsageError(f"--field takes one or two positive numbers of mm, not {options.field!r}")
    half_angle = float(np.degrees(np.arcsin(options.aperture)))
    field = size[0], size[-1]
    return Optics(options.lamp_half_angle, half_angle, options.lamp_distance, field, options.disc_rings)


DEFAULT_ALBEDO, DEFAULT_INDEX = 0.2, 1.5


@everyday(
    *("recipe", "ridge_angle", "pitch", "alpha_along", "alpha_across", "albedo", "index", "light_angle"),
    *("angles", "tilts", "pixel", "json_", "waves", "sizes", "over_directions", "uncertainties"),
)
def predict(  # noqa: PLR0915
    height_map: Path | None = None,
    /,
    *,
    recipe: Annotated[
        Path | None,
        Parameter(help="Recipe file with surface, plastic and poses: predict what an inspection expects."),
    ] = None,
    ridge_angle: Annotated[float | None, Parameter(help="Ridge angle of an ideal design in degrees.")] = None,
    pitch: Annotated[
        float | None,
        Parameter(help="Pitch in µm; found automatically in height maps with at least four ridges."),
    ] = None,
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10,
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = DEFAULT_ALBEDO,
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = DEFAULT_INDEX,
    spectrum: Annotated[
        Path | None,
        Parameter(help="CSV file with wavelength_nm,index,albedo: predict at each wavelength."),
    ] = None,
    wall: Annotated[
        Literal["perpendicular", "vertical"], Parameter(help="Wall of an ideal ridge.")
    ] = "perpendicular",
    height_loss: Annotated[
        float, Parameter(help="Share of the height that is missing at the crest of an ideal ridge.")
    ] = 0.0,
    internal_reflection: Annotated[
        Literal["nonlinear", "linear"], Parameter(help="Colour of light sent back inside the plastic.")
    ] = "nonlinear",
    bounces: Annotated[
        int | Literal["all"],
        Parameter(help="Reflections followed, by rays: 1 is direct light; a larger number, or 'all'."),
    ] = "all",
    reflect: Annotated[
        Literal["groove", "paths"],
        Parameter(
            help="Reflections of a map: of the groove fitted to its ridges, or of paths followed on the map."
        ),
    ] = "groove",
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0,
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular",
    facet_azimuth: Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°.")] = 0.0,
    angles: Annotated[str, Parameter(help="Stage angles in degrees, comma-separated.")] = "0,90,180",
    tilts: Annotated[str, Parameter(help="Tilts in degrees, comma-separated (--tilts=-10,0,10).")] = "0",
    model: Annotated[
        Model | None,
        Parameter(
            help="Model; auto: rays or waves, as the surface needs. Rays are corrected for a design, relief for a map."
        ),
    ] = None,
    pixel: Annotated[
        str | None, Parameter(help="Pixel size in µm of a map without one: SIZE or Y,X.")
    ] = None,
    level: Annotated[
        Literal["auto", "plane", "none"],
        Parameter(help="How a height map is levelled; auto: by whole pitches if ridges are known, else not."),
    ] = "auto",
    role: Annotated[
        Literal["part", "tool"], Parameter(help="Map of the part, or of the tool (mould).")
    ] = "part",
    max_missing: Annotated[
        float, Parameter(help="Share of missing facets above which a height map is refused.")
    ] = 0.25,
    facets: Annotated[
        Literal["symmetric", "diagonal", "antidiagonal"],
        Parameter(help="Four points of a map as one facet, or as two triangles along a diagonal."),
    ] = "symmetric",
    roughness: Annotated[
        Literal["lobe", "plastic"],
        Parameter(help="Alpha is what a map does not resolve (lobe), or that of the plastic at all scales."),
    ] = "lobe",
    waves: Annotated[WaveOptions, Parameter(name="*", group=WAVE_GROUP)] = WAVE_DEFAULTS,
    sizes: Annotated[OpticsOptions, Parameter(name="*", group=OPTICS_GROUP)] = OPTICS_DEFAULTS,
    over_directions: Annotated[MapOptions, Parameter(name="*", group=MAP_GROUP)] = MAP_DEFAULTS,
    uncertainties: Annotated[UncertaintyOptions, Parameter(name="*", group=GROUP)] = DEFAULTS,
    json_: Json = False,
) -> int:
    """Predict contrasts and radiances, with uncertainty, of a design, a height map or a recipe's part.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for an ideal design.

    Examples:
        anisoscope predict --ridge-angle 10 --tilts=-10,0,10
        anisoscope predict --recipe recipe.toml
        anisoscope predict wafer.x3p --map lobe.png --map-colour d65
    """
    given = locals()
    given = {name: given[name] for name in _defaults()}
    if over_directions != MAP_DEFAULTS:
        from anisoscope.cli.predict.angular_map import Blur, write_angular_map

        _check_map_alone(given)
        nm = None if waves.wavelengths is None else light_of(waves.wavelengths).wavelengths_um
        blur = Blur(optics_of(sizes), alpha_across, alpha_along)
        return write_angular_map(
            height_map, over_directions, nm, blur, waves.interpolate, pixel, role, as_json=json_
        )
    if recipe is not None:
        _check_recipe_alone(given)
        return _predict_recipe(recipe, light_angle, as_json=json_, covariance=uncertainties.covariance)
    _check_choice(height_map, ridge_angle, model)
    _check_bounces(bounces, model)
    _check_surface(height_map, model, height_loss, role, max_missing)
    _check_map_options(height_map, facets, roughness, reflect)
    _check_spectrum(spectrum, waves, model, albedo, index)
    check_options(
        uncertainties, height_map=height_map is not None, as_json=json_, spectrum=spectrum is not None
    )

    def prepared() -> "tuple[PredictOne, Material]":
        from anisoscope.parameters.geometry import Convention
        from anisoscope.parameters.light import LightSpectrum
        from anisoscope.parameters.material import Material
        from anisoscope.parameters.ridges import RidgeDesign
        from anisoscope.prediction.optics_selection import Rig, predict_with_optics
        from anisoscope.prediction.predict import predict_design
        from anisoscope.profiles.heightmap import HeightMap
        from anisoscope.sim.light.geometry import pose_grid

        poses = pose_grid(parse_numbers(angles, "--angles"), parse_numbers(tilts, "--tilts"))
        convention = Convention(light_angle, tilt_plane, facet_azimuth)
        material = Material(alpha_along, alpha_across, albedo, index, internal_reflection)
        optics, count = optics_of(sizes), None if bounces == "all" else bounces
        request = optics_request(waves, model, bounces, roughness)
        inputs, draws = input_uncertainty(uncertainties), monte_carlo(uncertainties)
        subject: HeightMap | RidgeDesign
        if height_map is not None:
            from anisoscope.cli.profile.profile import parse_pixel
            from anisoscope.prediction.region_prediction import predict_map
            from anisoscope.profiles.files.load import read_height_map

            surface = subject = read_height_map(height_map, pixel_um=parse_pixel(pixel), role=role)

            def of(plastic: Material, advance: "Advance") -> "Predicted":
                return predict_map(
                    surface,
                    plastic,
                    poses,
                    convention,
                    pitch,
                    levelling=level,
                    max_missing_share=max_missing,
                    inputs=inputs,
                    monte_carlo=draws,
                    on_progress=advance,
                    bounces=count,
                    optics=optics,
                    facets=facets,
                    roughness=roughness,
                    reflect=reflect,
                )
        else:
            assert ridge_angle is not None
            design = subject = RidgeDesign(100.0 if pitch is None else pitch, ridge_angle, wall, height_loss)
            of_design: Literal["printed", "corrected"] = "printed" if model == "printed" else "corrected"

            def of(plastic: Material, advance: "Advance") -> "Predicted":
                return predict_design(
                    design, plastic, poses, convention, of_design, count, inputs, draws, advance, optics
                )

        def under(
            plastic: Material, advance: "Advance", wavelength_nm: float | None
        ) -> "tuple[Predicted, ...]":
            if request is None:
                return (of(plastic, advance),)
            requested = (
                request
                if wavelength_nm is None
                else replace(request, light=LightSpectrum((1e-3 * wavelength_nm,)))
            )
            rig = Rig(plastic, poses, convention, optics, inputs, draws)
            return predict_with_optics(subject, partial(of, plastic), rig, requested, pitch, level, advance)

        return under, material

    if spectrum is None:
        _print_cached(given, prepared, as_json=json_, covariance=uncertainties.covariance)
    else:
        _print_spectrum(*prepared(), spectrum, as_json=json_, covariance=uncertainties.covariance)
    return 0


_WITH_A_MAP = (
    *("height_map", "alpha_along", "alpha_across", "pixel", "role"),
    *("waves", "sizes", "over_directions", "json_"),
)


def _check_map_alone(given: "Mapping[str, object]") -> None:
    """Refuse options that a map over all directions does not have.

    Raises:
        UsageError: one of them is given.
    """
    defaults = _defaults()
    for name, value in given.items():
        if name not in _WITH_A_MAP and value != defaults[name]:
            raise UsageError(
                "--map takes a height map, wavelengths, lamp and lens, and roughness: "
                f"leave --{name.replace('_', '-')} out"
            )


_WITH_A_RECIPE = ("recipe", "light_angle", "json_")


def _defaults() -> dict[str, object]:
    return {"height_map": None, **(predict.__kwdefaults__ or {})}


def _check_recipe_alone(given: "Mapping[str, object]") -> None:
    """Refuse options besides --recipe that the recipe itself decides.

    Raises:
        UsageError: one of them is given.
    """
    defaults = _defaults()
    for name, value in given.items():
        default = defaults[name]
        if name == "uncertainties" and isinstance(value, UncertaintyOptions):
            value = replace(value, covariance=False)  # noqa: PLW2901
        if name not in _WITH_A_RECIPE and value != default:
            what = "a height map" if name == "height_map" else f"--{name.replace('_', '-')}"
            raise UsageError(
                f"--recipe decides surface, plastic, poses, optics and uncertainties: leave {what} out, or the recipe"
            )


def _predict_recipe(path: Path, light_angle: float, *, as_json: bool, covariance: bool) -> int:
    from anisoscope.cli.predict import output
    from anisoscope.kinds.registry import kind_of
    from anisoscope.kinds.surface import SurfaceKind
    from anisoscope.prediction.cache import cached_expectation
    from anisoscope.prediction.expectation import predicted

    if covariance and not as_json:
        raise UsageError("--covariance is written as JSON only: add --json")
    kind = kind_of(path)
    if not isinstance(kind, SurfaceKind):
        raise UsageError(f"{path}: the recipe of {kind.one}; --recipe takes those of surfaces")
    result = predicted(cached_expectation(kind.read_recipe(path), light_angle, kind.optics))
    if as_json:
        print_json(output.as_json(result, covariance=covariance))
    else:
        output.print_prediction(result)
    return 0


def _key(given: "Mapping[str, object]") -> dict[str, object]:
    """All that a prediction is computed from, as JSON; a height map by its content and its name.

    Raises:
        HeightMapError: it cannot be read.
    """
    import hashlib

    from anisoscope.base.errors import HeightMapError

    path = given["height_map"]
    content = None
    if isinstance(path, Path):
        try:
            content = [path.name, hashlib.sha256(path.read_bytes()).hexdigest()]
        except OSError as problem:
            raise HeightMapError(f"{path}: cannot be read: {problem.strerror or problem}") from problem
    grouped = {name: vars(value) for name, value in given.items() if hasattr(value, "__dict__")}
    key = {name: value for name, value in (dict(given) | grouped).items() if name not in _NOT_PREDICTED}
    uncertainties = {name: value for name, value in grouped["uncertainties"].items() if name != "covariance"}
    return key | {"height_map": content, "uncertainties": uncertainties}


CACHED = "printed-predictions"
"""Kind of entry in the cache."""
READERS = ("SurfaceTopography",)
"""What reads height maps besides the readers of this package."""
_NOT_PREDICTED = ("recipe", "spectrum", "over_directions", "json_")
"""Options that change nothing in the numbers of a prediction from the cache."""


def _print_cached(
    given: "Mapping[str, object]",
    prepared: "Callable[[], tuple[PredictOne, Material]]",
    *,
    as_json: bool,
    covariance: bool,
) -> None:
    """Print a prediction; one that was made before comes from the cache."""
    from anisoscope.base.cache import LIBRARIES, Cache
    from anisoscope.cli.predict import output
    from anisoscope.prediction.predicted import packed, unpacked

    def compute() -> "tuple[Predicted, ...]":
        predict_one, material = prepared()
        with progress("predict") as advance:
            return predict_one(material, advance, None)

    entry = Cache().entry(CACHED, _key(given), __name__, libraries=(*LIBRARIES, *READERS))
    results = entry.result(compute, packed, unpacked)
    if not as_json:
        for result in results:
            output.print_prediction(result)
        if len(results) > 1:
            print_differences(*results)
        return
    found: dict[str, object] = output.as_json(results[0], covariance=covariance)
    if len(results) > 1:
        geometric, wave = (output.as_json(result, covariance=covariance) for result in results)
        found = {"geometric": geometric, "wave": wave, "difference": differences(*results)}
        found["optics"] = geometric["optics"]
    print_json(found)


def _print_spectrum(
    predict_one: "PredictOne", material: "Material", spectrum: Path, *, as_json: bool, covariance: bool
) -> None:
    """Print the predictions at the wavelengths of a spectrum."""
    from anisoscope.cli.predict import output
    from anisoscope.sim.materials.spectra import read_plastic_spectrum

    colours = read_plastic_spectrum(spectrum)
    lines: list[Predicted] = []
    for wavelength, plastic in zip(colours.wavelengths_nm, colours.materials(material), strict=True):
        with progress(f"{wavelength:g} nm") as advance:
            lines += predict_one(plastic, advance, wavelength)
    if not as_json:
        output.print_spectrum(lines, colours.wavelengths_nm)
        return
    print_json(output.spectrum_as_json(lines, colours.wavelengths_nm, covariance=covariance))


def _check_surface(
    height_map: Path | None, model: Model | None, height_loss: float, role: str, max_missing: float
) -> None:
    if height_loss != 0.0 and (height_map is not None or model == "printed"):
        what = "a height map has the heights it has" if height_map is not None else "printed knows none"
        raise UsageError(f"--height-loss needs a design under --model corrected; {what}")
    if height_map is None and role != "part":
        raise UsageError("--role tool belongs to a height map; a design is that of the part")
    if not 0.0 <= max_missing <= 1.0:
        raise UsageError(f"--max-missing must be a share of 0 to 1, not {max_missing:g}")


def _check_spectrum(
    spectrum: Path | None, waves: WaveOptions, model: Model | None, albedo: float, index: float
) -> None:
    if spectrum is None:
        return
    if waves.wavelengths is not None:
        raise UsageError("--spectrum names the wavelengths itself: leave --wavelengths out")
    if model == "both":
        raise UsageError(
            "--spectrum takes one model: --model wave and --model geometric, one after the other"
        )
    if model == "printed":
        raise UsageError(
            "--spectrum needs --model corrected or relief: in the printed model index and albedo only scale"
        )
    if (albedo, index) != (DEFAULT_ALBEDO, DEFAULT_INDEX):
        raise UsageError(
            "--spectrum states index and albedo of each wavelength: leave --index and --albedo out"
        )


def _check_choice(height_map: Path | None, ridge_angle: float | None, model: Model | None) -> None:
    if (height_map is None) == (ridge_angle is None):
        raise UsageError("give either a height map file or --ridge-angle of an ideal design")
    if height_map is not None and model in ("printed", "corrected"):
        raise UsageError(
            f"--model {model} needs a design (--ridge-angle); a height map is predicted by --model relief"
        )
    if height_map is None and model == "relief":
        raise UsageError(
            "--model relief needs a height map file; a design is predicted by corrected or printed"
        )


def _check_bounces(bounces: int | Literal["all"], model: Model | None) -> None:
    if bounces in (1, "all"):
        return
    if bounces != "all" and bounces < 1:
        raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
    if model == "printed":
        raise UsageError(
            f"--bounces {bounces} needs --model corrected; --model printed knows direct light only"
        )


def _check_map_options(height_map: Path | None, facets: str, roughness: str, reflect: str) -> None:
    if height_map is None and (facets != "symmetric" or roughness != "lobe" or reflect != "groove"):
        which = "--facets" if facets != "symmetric" else "--roughness" if roughness != "lobe" else "--reflect"
        raise UsageError(f"{which} belongs to a height map; a design has no facets of its own")
