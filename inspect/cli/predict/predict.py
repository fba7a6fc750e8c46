"""``anisoscope predict``: radiance and contrasts of a design or of a height map."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import everyday
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import (
    OF_LIGHT,
    OF_OPTICS,
    OF_PLASTIC,
    OF_RIDGES,
    OF_UNCERTAINTY,
    UNCERTAINTY,
    Json,
    MaterialOption,
    parse_pixel,
)
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.operations.plastic import plastic_of
from anisoscope.operations.predict import BY_RAYS, Method, Model, Task, predict_recipe
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty, default_uncertainty
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.views.options import Given, parse_numbers, with_options

if TYPE_CHECKING:
    from collections.abc import Mapping

    from anisoscope.prediction.angular import AngularReflectance
    from anisoscope.prediction.predicted import Predicted


@dataclass(frozen=True)
class UseOptions:
    """What is computed of the uncertainties.

    Attributes:
        uncertainty: Compute uncertainties; takes some time.
        monte_carlo: Number of draws of all inputs; u is then their standard deviation.
        covariance: JSON: covariances of radiances and contrasts too.
    """

    uncertainty: Annotated[bool, Parameter(negative="--no-uncertainty")] = True
    monte_carlo: int | None = None
    seed: Annotated[int, Parameter(help="Seed of the Monte Carlo.")] = 0
    covariance: Annotated[bool, Parameter(negative="")] = False


USE_DEFAULTS = UseOptions()
WAVE_GROUP = Group(
    "Waves",
    help="Which optics: --model auto takes waves where rays fail, geometric or wave insists, both compares.",
    sort_key=40,
)


@dataclass(frozen=True)
class WaveOptions:
    """The options.

    Attributes:
        wavelengths: Of the light in nm, comma-separated: NM or NM:WEIGHT. Default 550.
        interpolate: Points per original point along each axis, for waves on smooth maps.
    """

    wavelengths: str | None = None
    interpolate: int = 1
    steps: Annotated[
        int | None,
        Parameter(
            "--steps", help="Number of plateaus of a stepped height map, for waves; found if not given."
        ),
    ] = None


WAVE_DEFAULTS = WaveOptions()


MAP_GROUP = Group(
    "Angular map",
    help="BRDF of a height map over all directions of the camera, by waves. The surface reflects all light, as metal.",
    sort_key=41,
)


@dataclass(frozen=True)
class MapOptions:
    """The options; meaning as in `anisoscope.prediction.angular.AngularTask`."""

    picture: Annotated[
        Path | None, Parameter("--map", help="Write the map as a picture *.png, in place of contrasts.")
    ] = None
    table: Annotated[Path | None, Parameter("--map-csv", help="Write the map as a table *.csv.")] = None
    light: Annotated[str, Parameter("--map-light", help="Inclination and azimuth of the light, degrees.")] = (
        "0,0"
    )
    reach: Annotated[
        float, Parameter("--map-reach", help="Largest direction cosine of the camera along x and y.")
    ] = 0.4
    points: Annotated[int, Parameter("--map-points", help="Directions along each axis.")] = 161
    lamp_sigma: Annotated[
        float,
        Parameter(
            "--map-lamp-sigma", help="Gaussian lamp: its standard deviation in degrees, in place of a disc."
        ),
    ] = 0.0
    periodic: Annotated[
        bool, Parameter("--map-periodic", negative="", help="The map is one unit of a surface that repeats.")
    ] = False
    colour: Annotated[
        str | None,
        Parameter(
            "--map-colour", help="Illuminant of a map in colour: d65, a, led-b3 …, or CSV; 400 to 700 nm."
        ),
    ] = None


MAP_DEFAULTS = MapOptions()


@dataclass(frozen=True)
class Blur:
    """Lamp and lens, and the plastic where its roughness is stated: a map then has slopes below the pixels."""

    optics: Optics
    plastic: Material | None

    @property
    def slope_rms(self) -> tuple[float, float]:
        """Slopes along x and y below the pixels."""
        if self.plastic is None:
            return 0.0, 0.0
        return self.plastic.alpha_across / 2.0**0.5, self.plastic.alpha_along / 2.0**0.5


@dataclass(frozen=True)
class Waves:
    """Wavelengths, and how waves take the map."""

    wavelengths_um: tuple[float, ...] | None
    interpolate: int
    steps: int | None


def light_of(text: str | None) -> LightSpectrum:
    """Wavelengths and weights of the option.

    Raises:
        UsageError: something that is no wavelength or no weight.
    """
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


@with_options(
    ridges=replace(
        OF_RIDGES,
        default=None,
        help={
            "ridge_angle_deg": "Ridge angle of an ideal design in degrees.",
            "pitch_um": "Pitch in µm; found automatically in height maps with at least four ridges.",
        },
    ),
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
    sizes=OF_OPTICS,
    uncertainties=OF_UNCERTAINTY,
)
@everyday(
    *(
        "recipe",
        "ridges",
        "plastic",
        "material",
        "rig",
        "angles",
        "tilts",
        "pixel",
        "json_",
        "waves",
        "sizes",
    ),
    *("over_directions", "uncertainties", "use"),
)
def predict(
    height_map: Path | None = None,
    /,
    *,
    recipe: Path | None = None,
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    material: MaterialOption = None,
    spectrum: Path | None = None,
    bounces: int | Literal["all"] = "all",
    reflect: Literal["groove", "paths"] = "groove",
    rig: Given[Convention],
    angles: Annotated[str, Parameter(help="Stage angles in degrees, comma-separated.")] = "0,90,180",
    tilts: Annotated[str, Parameter(help="Tilts in degrees, comma-separated (--tilts=-10,0,10).")] = "0",
    model: Model | None = None,
    pixel: str | None = None,
    level: Literal["auto", "plane", "none"] = "auto",
    role: Literal["part", "tool"] = "part",
    max_missing: float = 0.25,
    facets: Literal["symmetric", "diagonal", "antidiagonal"] = "symmetric",
    roughness: Literal["lobe", "plastic"] = "lobe",
    waves: Annotated[WaveOptions, Parameter(name="*", group=WAVE_GROUP)] = WAVE_DEFAULTS,
    sizes: Given[Optics],
    over_directions: Annotated[MapOptions, Parameter(name="*", group=MAP_GROUP)] = MAP_DEFAULTS,
    uncertainties: Given[InputUncertainty],
    use: Annotated[UseOptions, Parameter(name="*", group=UNCERTAINTY)] = USE_DEFAULTS,
    json_: Json = False,
) -> int:
    """Predict contrasts and radiances, with uncertainty, of a design, a height map or a recipe's part.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for an ideal design.
        recipe: Recipe file with surface, plastic and poses: predict what an inspection expects.
        spectrum: CSV file with wavelength_nm,index,albedo: predict at each wavelength.
        bounces: Reflections followed, by rays: 1 is direct light; a larger number, or 'all'.
        reflect: Reflections of a map: of the groove fitted to its ridges, or of paths followed on the map.
        model: Model; auto: rays or waves, as the surface needs. Rays are corrected for a design, relief for a map.
        pixel: Pixel size in µm of a map without one: SIZE or Y,X.
        level: How a height map is levelled; auto: by whole pitches if ridges are known, else not.
        role: Map of the part, or of the tool (mould).
        max_missing: Share of missing facets above which a height map is refused.
        facets: Four points of a map as one facet, or as two triangles along a diagonal.
        roughness: Alpha is what a map does not resolve (lobe), or that of the plastic at all scales.

    Examples:
        anisoscope predict --ridge-angle 10 --tilts=-10,0,10
        anisoscope predict --recipe recipe.toml
        anisoscope predict wafer.x3p --map lobe.png --map-colour d65
    """
    given = locals()
    given = {name: given[name] for name in _defaults()}
    if over_directions != MAP_DEFAULTS:
        _check_map_alone(given)
        nm = None if waves.wavelengths is None else light_of(waves.wavelengths).wavelengths_um
        blur = Blur(_optics(sizes), plastic.over(Material()) if plastic.values else None)
        return write_angular_map(
            *(height_map, over_directions, Waves(nm, waves.interpolate, waves.steps), blur),
            *(pixel, role),
            as_json=json_,
        )
    if recipe is not None:
        _check_recipe_alone(given)
        return _predict_recipe(recipe, rig.over(Convention()), as_json=json_, covariance=use.covariance)
    _check_choice(height_map, ridges, model)
    _check_bounces(bounces, model)
    _check_surface(height_map, model, ridges, role, max_missing)
    _check_map_options(height_map, facets, roughness, reflect)
    _check_plastic(spectrum, waves, model, plastic, material)
    _check_use(use, as_json=json_, spectrum=spectrum is not None)
    map_alone, design_alone = (
        ("height_map_share", "height_noise_um", "height_scale_share", "pixel_size_share", "ridges_seen"),
        ("ridge_angle_deg", "height_loss", "edge_radius_share"),
    )
    if height_map is None:
        uncertainties.refuse(map_alone, "belongs to a height map")
    else:
        uncertainties.refuse(design_alone, "belongs to a design (--ridge-angle)")
    _check_waves(waves, model, roughness, height_map)
    pixel_um = None
    if pixel is not None:
        from anisoscope.cli.options import parse_pixel

        pixel_um = parse_pixel(pixel)
    method = Method(
        model or "auto", bounces, light_of(waves.wavelengths), waves.interpolate, waves.steps, use.monte_carlo,
        use.seed, reflect, level, max_missing, facets, roughness, pixel_um, role,
    )  # fmt: skip
    base, file = plastic_of(material)
    design = ridges.over(RidgeDesign(100.0, 10.0)) if height_map is None else None

    def task(resin: Material, method: Method) -> Task:
        tail = uncertainties.values.get("tail")
        usual = default_uncertainty(resin, tail, calibrated=file is not None)
        if design is not None and ridges.values.get("edge_radius_um") == 0.0:
            usual = replace(usual, edge_radius_share=0.0)  # stated as sharp
        return Task(
            height_map or design or RidgeDesign(100.0, 10.0),
            resin,
            file,
            parse_numbers(angles, "--angles"),
            parse_numbers(tilts, "--tilts"),
            rig.over(Convention()),
            _optics(sizes),
            uncertainties.over(usual) if use.uncertainty else None,
            None if height_map is None else ridges.values.get("pitch_um"),
            method,
        )

    resin = plastic.over(base)
    if spectrum is None:
        with progress("predict") as advance:
            results = task(resin, method).cached(advance)
        _print(results, as_json=json_, covariance=use.covariance)
        return 0
    from anisoscope.cli.predict import output
    from anisoscope.sim.materials.spectra import read_plastic_spectrum

    colours = read_plastic_spectrum(spectrum)
    lines: list[Predicted] = []
    for line_nm, coloured in zip(colours.wavelengths_nm, colours.materials(resin), strict=True):
        with progress(f"{line_nm:g} nm") as advance:
            at = replace(method, light=LightSpectrum((1e-3 * line_nm,)))
            lines += task(coloured, at).predictions(advance)
    if json_:
        print_json(output.spectrum_as_json(lines, colours.wavelengths_nm, covariance=use.covariance))
    else:
        output.print_spectrum(lines, colours.wavelengths_nm)
    return 0


def _optics(sizes: Given[Optics]) -> Optics:
    if ("field_mm" in sizes) != ("lamp_distance_mm" in sizes):
        raise UsageError("--lamp-distance and --field belong together: the light angle varies over the field")
    return sizes.over(Optics())


def _defaults() -> dict[str, Any]:
    return {"height_map": None, **(predict.__kwdefaults__ or {})}


def _stated(given: "Mapping[str, Any]") -> Iterator[tuple[str, str]]:
    """(parameter or field, option) of all that the command line states."""
    for name, default in _defaults().items():
        value = given[name]
        if isinstance(value, Given):
            yield from ((field, value.option[field]) for field in value.values)
        elif value != default and hasattr(value, "__dict__") and not isinstance(value, Path):
            changed = (one for one in vars(value) if getattr(value, one) != getattr(default, one))
            yield from ((one, f"--{one.replace('_', '-')}") for one in changed)
        elif value != default:
            yield name, "a height map" if name == "height_map" else f"--{name.rstrip('_').replace('_', '-')}"


_WITH_A_MAP = {
    *("height_map", "alpha_along", "alpha_across", "pixel", "role", "json_"),
    *(*vars(WAVE_DEFAULTS), *vars(MAP_DEFAULTS), *Optics.__dataclass_fields__),
}
_WITH_A_RECIPE = {"recipe", "light_angle_deg", "json_", "covariance"}


def _check_map_alone(given: "Mapping[str, Any]") -> None:
    """Refuse options that a map over all directions does not have.

    Raises:
        UsageError: one of them is given.
    """
    for name, option in _stated(given):
        if name not in _WITH_A_MAP:
            raise UsageError(
                f"--map takes a height map, wavelengths, lamp and lens, and roughness: leave {option} out"
            )


def _check_recipe_alone(given: "Mapping[str, Any]") -> None:
    """Refuse options besides --recipe that the recipe itself decides.

    Raises:
        UsageError: one of them is given.
    """
    for name, option in _stated(given):
        if name not in _WITH_A_RECIPE:
            raise UsageError(
                f"--recipe decides surface, plastic, poses, optics and uncertainties: leave {option} out, or the recipe"
            )


def _predict_recipe(path: Path, convention: Convention, *, as_json: bool, covariance: bool) -> int:
    if covariance and not as_json:
        raise UsageError("--covariance is written as JSON only: add --json")
    _print((predict_recipe(path, convention.light_angle_deg),), as_json=as_json, covariance=covariance)
    return 0


def _print(results: "tuple[Predicted, ...]", *, as_json: bool, covariance: bool) -> None:
    """Print a prediction, or those by rays and by waves with their difference."""
    from anisoscope.cli.predict import output

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


def _check_use(use: UseOptions, *, as_json: bool, spectrum: bool) -> None:
    if use.seed < 0:
        raise UsageError(f"--seed must be 0 or a positive whole number, not {use.seed}")
    if use.monte_carlo is not None and use.monte_carlo < 10:
        raise UsageError(f"--monte-carlo needs at least 10 draws, not {use.monte_carlo}")
    if not use.uncertainty and (use.monte_carlo is not None or use.covariance):
        which = "--covariance" if use.monte_carlo is None else "--monte-carlo"
        raise UsageError(f"{which} and --no-uncertainty exclude each other")
    if use.covariance and not as_json:
        raise UsageError("--covariance is written as JSON only: add --json")
    if use.monte_carlo is not None and spectrum:
        raise UsageError(
            "--monte-carlo takes one wavelength: give --index and --albedo instead of --spectrum"
        )


def _check_waves(waves: WaveOptions, model: Model | None, roughness: str, height_map: Path | None) -> None:
    if waves.interpolate < 1:
        raise UsageError(f"--interpolate must be 1 or more, not {waves.interpolate}")
    if model in BY_RAYS and waves != WAVE_DEFAULTS:
        raise UsageError(
            f"--wavelengths, --interpolate and --steps are for waves; --model {model} knows rays only"
        )
    if waves.steps is not None and (height_map is None or model == "geometric"):
        raise UsageError(
            "--steps is for waves on a height map: leave it out of designs and of --model geometric"
        )
    if model in ("wave", "both") and roughness != "lobe":
        raise UsageError(
            f"--roughness plastic belongs to rays: --model {model} takes the roughness of a lobe"
        )


def _check_surface(
    height_map: Path | None,
    model: Model | None,
    ridges: Given[RidgeDesign],
    role: str,
    max_missing: float,
) -> None:
    if ridges.values.get("height_loss", 0.0) != 0.0 and (height_map is not None or model == "printed"):
        what = "a height map has the heights it has" if height_map is not None else "printed knows none"
        raise UsageError(f"--height-loss needs a design under --model corrected; {what}")
    if height_map is not None:
        ridges.refuse(("wall", "edge_radius_um", "foot_radius_um"), "belongs to a design (--ridge-angle)")
    if model == "printed":
        ridges.refuse(
            ("edge_radius_um", "foot_radius_um"),
            "needs --model corrected; --model printed knows the ridge angle only",
        )
    if height_map is None and role != "part":
        raise UsageError("--role tool belongs to a height map; a design is that of the part")
    if not 0.0 <= max_missing <= 1.0:
        raise UsageError(f"--max-missing must be a share of 0 to 1, not {max_missing:g}")


def _check_plastic(
    spectrum: Path | None,
    waves: WaveOptions,
    model: Model | None,
    plastic: Given[Material],
    material: Path | None,
) -> None:
    if material is not None:
        plastic.refuse(tuple(plastic.option), "is in the material file: leave it or --material out")
    if spectrum is None:
        return
    if material is not None:
        raise UsageError("--spectrum states index and albedo of each wavelength: leave --material out")
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
    if plastic.values.keys() & {"albedo", "index"}:
        raise UsageError(
            "--spectrum states index and albedo of each wavelength: leave --index and --albedo out"
        )


def _check_choice(height_map: Path | None, ridges: Given[RidgeDesign], model: Model | None) -> None:
    if (height_map is None) == ("ridge_angle_deg" not in ridges):
        raise UsageError(
            "give one of a height map file, --ridge-angle of an ideal design, and --recipe; for example: anisoscope "
            "predict --ridge-angle 10"
        )
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


def write_angular_map(
    path: Path | None,
    options: MapOptions,
    waves: Waves,
    blur: Blur,
    pixel: str | None,
    role: Literal["part", "tool"],
    *,
    as_json: bool,
) -> int:
    """Compute and write the map.

    Raises:
        UsageError: options that do not go together.
        HeightMapError: a map that waves cannot take.
        ModelError: more memory or more maps than are taken.
    """
    from anisoscope.operations.predict import write_angular_picture, write_angular_table
    from anisoscope.prediction.angular import COLOUR_NM, AngularTask, angular_reflectance
    from anisoscope.profiles.files.load import read_height_map
    from anisoscope.sim.materials.spectra import find_illuminant

    height_map, light = _checked_map(path, options, blur, waves.wavelengths_um)
    lamp = None if options.colour is None else find_illuminant(options.colour)
    nm = COLOUR_NM if lamp is not None else tuple(1e3 * um for um in waves.wavelengths_um or (0.55,))
    task = AngularTask(
        nm, light, options.reach, options.points, blur.optics.lamp_half_angle_deg,
        blur.optics.aperture_half_angle_deg, blur.slope_rms, options.lamp_sigma,
    )  # fmt: skip
    surface = read_height_map(height_map, pixel_um=parse_pixel(pixel), role=role)
    with progress("map", quiet=as_json) as advance:
        found = angular_reflectance(
            *(surface, task),
            steps=waves.steps,
            interpolate=waves.interpolate,
            periodic=options.periodic,
            advance=advance,
        )
    if options.table is not None:
        write_angular_table(found, options.table)
    if options.picture is not None:
        write_angular_picture(found, lamp, options.picture)
    if as_json:
        return print_json({"map": height_map, **fields_of(found)})
    _print_map(found, height_map)
    for target in (options.picture, options.table):
        if target is not None:
            sys.stdout.write(f"written: {target}\n")
    return 0


def _checked_map(
    path: Path | None, options: MapOptions, blur: Blur, wavelengths_um: tuple[float, ...] | None
) -> tuple[Path, tuple[float, float]]:
    """The height map, and inclination and azimuth of the light."""
    if path is None:
        raise UsageError("--map needs a height map file: name it before the options")
    if options.picture is None and options.table is None:
        raise UsageError("name what to write: --map PICTURE.png, --map-csv TABLE.csv, or both")
    for target, option, ending in ((options.picture, "--map", ".png"), (options.table, "--map-csv", ".csv")):
        if target is not None and target.suffix.lower() == ".bsdf":
            raise UsageError(
                f"all directions of light and camera are written by `anisoscope bsdf export {target} --height-map "
                f"{path} --optics waves`"
            )
        if target is not None and target.suffix.lower() != ending:
            raise UsageError(f"{option} writes *{ending}, not {target.name}")
    if options.colour is not None and wavelengths_um is not None:
        raise UsageError("--map-colour takes wavelengths from 400 to 700 nm itself: leave --wavelengths out")
    light = parse_numbers(options.light, "--map-light", "10,0")
    if len(light) != 2:
        raise UsageError(
            f"--map-light takes inclination and azimuth in degrees, such as 10,0, not {options.light!r}"
        )
    if blur.optics.lamp_distance_mm is not None:
        raise UsageError("--map takes a lamp far away: leave --lamp-distance and --field out")
    return path, (light[0], light[1])


def _print_map(found: "AngularReflectance", path: Path) -> None:
    task = found.task
    rows = [
        [f"{nm:g}", f"{100.0 * share:.1f}", f"{peak:.4g}", f"({x:.3f}, {y:.3f})".replace("-", "−")]
        for nm, share, peak, (x, y) in zip(
            task.wavelengths_nm, found.light_in_map, found.peak_per_sr, found.peak_at, strict=True
        )
    ]
    print_table(
        f"{path.name}: BRDF by waves, {'steps' if found.stepped else 'smooth'}, all light reflected",
        ["wavelength [nm]", "light within the map [%]", "largest [1/sr]", "at (v_x, v_y)"],
        rows,
        caption=f"light at {task.light_deg[0]:g}°, azimuth {task.light_deg[1]:g}°; |v_x|, |v_y| ≤ {task.reach:g}",
    )
