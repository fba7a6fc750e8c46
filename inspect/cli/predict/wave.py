"""Options of ``anisoscope predict`` about waves, and how predictions under both optics are shown."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.console import parse_numbers, print_table

if TYPE_CHECKING:
    from anisoscope.prediction.optics_selection import OpticsModel, Wanted
    from anisoscope.prediction.predict import Predicted

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
            "--interpolate", help="Points put in the place of one along each axis, for waves on smooth maps."
        ),
    ] = 1


WAVE_DEFAULTS = WaveOptions()


def wanted_optics(
    options: WaveOptions, model: Model | None, bounces: int | Literal["all"], roughness: str
) -> "Wanted | None":
    """What is asked for; None where --model names one of the geometric models.

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
    if optics in ("wave", "both") and (bounces != 1 or roughness != "lobe"):
        which = "--bounces" if bounces != 1 else "--roughness plastic"
        raise UsageError(f"{which} belongs to rays: --model {optics} follows waves, which reflect once")
    from anisoscope.prediction.optics_selection import Wanted

    if optics == "auto" and (bounces != 1 or roughness != "lobe"):
        optics = "geometric"
    return Wanted(optics, light_of(options.wavelengths), options.interpolate)


def light_of(text: str | None) -> Any:  # noqa: ANN401 - a LightSpectrum, imported when it runs
    """Wavelengths and weights of the option.

    Raises:
        UsageError: something that is no wavelength or no weight.
    """
    from anisoscope.sim.light.wave.reflectance import LightSpectrum

    if text is None:
        return LightSpectrum()
    parts = [part.partition(":") for part in text.split(",")]
    nm = [parse_numbers(part[0], "--wavelengths", "530:1,550:2")[0] for part in parts]
    weights = [
        parse_numbers(part[2], "--wavelengths", "530:1,550:2")[0] if part[1] else 1.0 for part in parts
    ]
    return LightSpectrum(tuple(1e-3 * value for value in nm), tuple(weights))


def differences(geometric: "Predicted", wave: "Predicted") -> list[dict[str, float | None]]:
    """What waves change in every pose, relative to the brightest geometric radiance and to that of the pose.

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
    """Table of what waves change."""
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
