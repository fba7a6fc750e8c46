"""``anisoscope predict``: radiance and contrasts of a design or of a height map."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.cli.console import parse_numbers, print_table
from anisoscope.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.predicting import Predicted

Model = Literal["printed", "corrected", "relief"]


def predict(
    height_map: Path | None = None,
    /,
    *,
    ridge_angle: Annotated[float | None, Parameter(help="Ridge angle of an ideal design in degrees.")] = None,
    pitch: Annotated[
        float | None, Parameter(help="Pitch in µm; of a height map it is found where four ridges lie in it.")
    ] = None,
    alpha_along: Annotated[float, Parameter(help="Beckmann roughness along the ridges.")] = 0.06,
    alpha_across: Annotated[float, Parameter(help="Beckmann roughness across the ridges.")] = 0.10,
    albedo: Annotated[float, Parameter(help="Diffuse albedo of the plastic, 0 to 1.")] = 0.2,
    index: Annotated[float, Parameter(help="Refractive index of the plastic.")] = 1.5,
    wall: Annotated[
        Literal["perpendicular", "vertical"], Parameter(help="Wall of an ideal ridge.")
    ] = "perpendicular",
    internal_reflection: Annotated[
        Literal["nonlinear", "linear"], Parameter(help="Colour of light sent back inside the plastic.")
    ] = "nonlinear",
    bounces: Annotated[
        int | Literal["all"],
        Parameter(
            help="Reflections followed: 1 is direct light; more or 'all' for a design under corrected."
        ),
    ] = 1,
    light_angle: Annotated[float, Parameter(help="Angle between light and camera in degrees.")] = 10.0,
    tilt_plane: Annotated[
        Literal["perpendicular", "in-plane"], Parameter(help="Plane in which camera and light tilt.")
    ] = "perpendicular",
    facet_azimuth: Annotated[float, Parameter(help="Azimuth toward which the facets lean at 0°.")] = 0.0,
    angles: Annotated[str, Parameter(help="Stage angles in degrees, comma-separated.")] = "0,90,180",
    tilts: Annotated[str, Parameter(help="Tilts in degrees, comma-separated (--tilts=-10,0,10).")] = "0",
    model: Annotated[
        Model | None, Parameter(help="Default: corrected for a design, relief for a height map.")
    ] = None,
    pixel: Annotated[
        str | None, Parameter(help="Pixel size in µm of a map without one: SIZE or Y,X.")
    ] = None,
    level: Annotated[
        Literal["auto", "plane", "none"],
        Parameter(help="How a height map is levelled; auto: by whole pitches if ridges are known, else not."),
    ] = "auto",
    json_: Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")] = False,
) -> int:
    """Predict radiances and contrasts of a height map or of an ideal ridge design.

    Args:
        height_map: File with a measured height map; leave it out and give --ridge-angle for an ideal design.
    """
    from anisoscope.predicting import predict_design, predict_height_map
    from anisoscope.profiles.ideal import RidgeDesign
    from anisoscope.sim.light.geometry import Convention, pose_grid
    from anisoscope.sim.light.material import Material

    _check_choice(height_map, ridge_angle, model)
    _check_bounces(bounces, height_map, model)
    poses = pose_grid(parse_numbers(angles, "--angles"), parse_numbers(tilts, "--tilts"))
    convention = Convention(light_angle, tilt_plane, facet_azimuth)
    material = Material(alpha_along, alpha_across, albedo, index, internal_reflection)
    if height_map is not None:
        from anisoscope.cli.profile import parse_pixel
        from anisoscope.profiles.load import read_height_map

        surface = read_height_map(height_map, pixel_um=parse_pixel(pixel))
        result = predict_height_map(surface, material, poses, convention, pitch, level)
    else:
        assert ridge_angle is not None
        design = RidgeDesign(
            pitch_um=100.0 if pitch is None else pitch, ridge_angle_deg=ridge_angle, wall=wall
        )
        result = predict_design(
            design,
            material,
            poses,
            convention,
            "printed" if model == "printed" else "corrected",
            None if bounces == "all" else bounces,
        )
    if json_:
        json.dump(_as_json(result), sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
    else:
        _print(result)
    return 0


def _check_choice(height_map: Path | None, ridge_angle: float | None, model: Model | None) -> None:
    if (height_map is None) == (ridge_angle is None):
        raise UsageError("give either a height map file or --ridge-angle of an ideal design")
    if height_map is not None and model not in (None, "relief"):
        raise UsageError(
            f"--model {model} needs a design (--ridge-angle); a height map is predicted by --model relief"
        )
    if height_map is None and model == "relief":
        raise UsageError(
            "--model relief needs a height map file; a design is predicted by corrected or printed"
        )


def _check_bounces(bounces: int | Literal["all"], height_map: Path | None, model: Model | None) -> None:
    if bounces == 1:
        return
    if bounces != "all" and bounces < 1:
        raise UsageError(f"--bounces must be 1 or more, or all, not {bounces}")
    if height_map is not None or model == "printed":
        what = "a height map" if height_map is not None else "--model printed"
        raise UsageError(
            f"--bounces {bounces} needs a design under --model corrected; {what} knows direct light only"
        )


def _finite(value: float) -> float | None:
    return value if abs(value) < float("inf") else None


def _as_json(result: "Predicted") -> dict[str, Any]:
    return {
        "model": result.model,
        "convention": asdict(result.convention),
        "k": result.k,
        "poses": [
            {"stage_deg": pose.stage_deg, "tilt_deg": pose.tilt_deg, "radiance": float(value)}
            for pose, value in zip(result.poses, result.radiance, strict=True)
        ],
        "contrasts": [
            {key: _finite(value) for key, value in asdict(contrast).items()} for contrast in result.contrasts
        ],
        **result.notes,
    }


def _print(result: "Predicted") -> None:
    convention = result.convention
    caption = (
        f"model {result.model}; light {convention.light_angle_deg:g}° from the camera, tilt plane "
        f"{convention.tilt_plane}, facets toward {convention.facet_azimuth_deg:g}°, stage turns "
        f"{convention.rotation_sense}; k = {result.k:g}"
    )
    for name, value in result.notes.items():
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        caption += f"; {name.replace('_', ' ')}: {shown}"
    print_table(
        "Radiance per unit irradiance",
        ["stage [°]", "tilt [°]", "radiance [1/sr]"],
        [
            [f"{pose.stage_deg:g}", f"{pose.tilt_deg:g}", f"{value:.5f}"]
            for pose, value in zip(result.poses, result.radiance, strict=True)
        ],
    )
    print_table(
        "Contrasts",
        ["from [°]", "to [°]", "tilt [°]", "difference [1/sr]", "Michelson", "ln ratio"],
        [
            [
                f"{c.from_deg:g}",
                f"{c.to_deg:g}",
                f"{c.tilt_deg:g}",
                f"{c.difference:+.5f}",
                f"{c.michelson:+.4f}",
                f"{c.log_ratio:+.4f}",
            ]
            for c in result.contrasts
        ],
        caption=caption,
    )
