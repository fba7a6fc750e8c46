"""Injection of defects into height maps, by name, with dimensions, severity from 0 (none) to 1 (gross) and cause."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.defects import (
    burrs,
    chatter,
    incomplete_filling,
    missing_ridges,
    pitch_error,
    ridge_angle_error,
)
from anisoscope.profiles.defects_contact import dust, edge_wear, scratches
from anisoscope.profiles.defects_layout import ridge_layout
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness

Values = Mapping[str, float]
ALONG_Y_DEG = 1.0


@dataclass(frozen=True)
class Setting:
    """One dimension of a defect: its name with the unit, its meaning, and its default."""

    name: str
    unit: str
    meaning: str
    default: float


@dataclass(frozen=True)
class Defect:
    """A defect.

    Attributes:
        name: what it is called.
        cause: what goes wrong in moulding, tooling or handling.
        extent: the dimension that the severity scales; its default is the value at severity 1.
        settings: its other dimensions.
        apply: makes the spoiled map from a map, all values by name, and a source of randomness.
    """

    name: str
    cause: str
    extent: Setting
    settings: tuple[Setting, ...]
    apply: Callable[[HeightMap, Values, np.random.Generator], HeightMap]


def _burrs(surface: HeightMap, values: Values, rng: np.random.Generator) -> HeightMap:
    period = ridge_layout(surface).period
    if abs(period.direction_deg) > ALONG_Y_DEG:
        raise HeightMapError(
            f"burrs are made on ridges along y; these run at {period.direction_deg:.3g}°. Turn the map first"
        )
    return burrs(
        surface,
        values["coverage"],
        pitch_um=period.pitch_um,
        height_um=(values["least_height_um"], values["greatest_height_um"]),
        size_um=(values["least_length_um"], values["greatest_length_um"]),
        rng=rng,
    ).map


def _ridge_angle(surface: HeightMap, values: Values, _rng: np.random.Generator) -> HeightMap:
    layout = ridge_layout(surface)
    return ridge_angle_error(
        surface, values["delta_deg"], ridge_angle_deg=layout.ridge_angle_deg, period=layout.period
    )


def _roughness(surface: HeightMap, values: Values, rng: np.random.Generator) -> HeightMap:
    alpha = values["alpha"]
    return add_facet_roughness(surface, alpha * values["along_share"], alpha, values["correlation_um"], rng)


DEFECTS = {
    defect.name: defect
    for defect in (
        Defect(
            "burrs",
            "moulding: plastic in cracks of the tool, or torn on demoulding; tooling: chips left at edges",
            Setting("coverage", "", "share of the area that is covered", 0.2),
            (
                Setting("least_height_um", "µm", "least height of a burr", 2.0),
                Setting("greatest_height_um", "µm", "greatest height of a burr", 8.0),
                Setting("least_length_um", "µm", "least length along the ridge", 10.0),
                Setting("greatest_length_um", "µm", "greatest length along the ridge", 60.0),
            ),
            _burrs,
        ),
        Defect(
            "wear",
            "use: crests rubbed off; moulding: crests that stuck to the tool. On a map of the tool: worn tool",
            Setting("radius_um", "µm", "radius of convex edges", 20.0),
            (),
            lambda surface, values, _: edge_wear(surface, values["radius_um"]),
        ),
        Defect(
            "incomplete-filling",
            "moulding: melt or tool too cold, packing pressure too low, trapped air, far from the gate",
            Setting("loss", "", "share of the ridge height that is missing", 0.6),
            (Setting("gradient", "", "growth of the loss along +y, −1 to 1", 0.0),),
            lambda surface, values, _: incomplete_filling(
                surface, values["loss"], gradient=values["gradient"]
            ),
        ),
        Defect(
            "ridge-angle",
            "tooling: cutter ground or set at a wrong angle; moulding: sagging, uneven shrinkage",
            Setting("delta_deg", "°", "change of the slope of the facets", 4.0),
            (),
            _ridge_angle,
        ),
        Defect(
            "pitch",
            "tooling: wrong feed, lead screw worn or warm; moulding: wrong allowance for shrinkage",
            Setting("error_percent", "%", "change of pitch and height, angles kept", 10.0),
            (),
            lambda surface, values, _: pitch_error(surface, values["error_percent"]),
        ),
        Defect(
            "rough-facets",
            "tooling: worn or chipped cutter, built-up edge, corroded or badly polished tool; moulding: cold tool",
            Setting("alpha", "", "Beckmann roughness across the ridges", 0.2),
            (
                Setting("along_share", "", "roughness along the ridges, as a share of that across", 0.6),
                Setting("correlation_um", "µm", "geometric mean of the correlation lengths", 8.0),
            ),
            _roughness,
        ),
        Defect(
            "scratches",
            "handling: parts rubbing, grippers, grit in cloth; moulding: drag marks of ejection",
            Setting("density_per_mm2", "1/mm²", "number of scratches", 60.0),
            (
                Setting("depth_um", "µm", "greatest depth below the crests", 4.0),
                Setting("width_um", "µm", "width at the crests", 12.0),
                Setting("length_um", "µm", "mean length", 400.0),
            ),
            lambda surface, values, rng: scratches(
                surface,
                values["density_per_mm2"],
                depth_um=values["depth_um"],
                width_um=values["width_um"],
                length_um=values["length_um"],
                rng=rng,
            ),
        ),
        Defect(
            "dust",
            "handling: dust, abrasion; moulding: residue of release agent, deposits from the tool",
            Setting("density_per_mm2", "1/mm²", "number of grains", 400.0),
            (Setting("diameter_um", "µm", "median diameter", 10.0),),
            lambda surface, values, rng: dust(
                surface, values["density_per_mm2"], diameter_um=values["diameter_um"], rng=rng
            ),
        ),
        Defect(
            "missing-ridges",
            "moulding: clogged grooves of the tool; tooling: passes skipped, broken cutter",
            Setting("share", "", "share of the ridges that are missing", 0.4),
            (),
            lambda surface, values, rng: missing_ridges(surface, values["share"], rng=rng),
        ),
        Defect(
            "chatter",
            "tooling: cutter, holder or spindle in resonance while the tool was cut",
            Setting("amplitude_um", "µm", "amplitude of the waves along the ridges", 2.0),
            (
                Setting("wavelength_um", "µm", "wavelength along the ridges", 80.0),
                Setting("phase_step", "", "shift from ridge to ridge, in wavelengths", 0.25),
                Setting("jitter", "", "standard deviation of that shift, in wavelengths", 0.1),
            ),
            lambda surface, values, rng: chatter(
                surface,
                values["amplitude_um"],
                wavelength_um=values["wavelength_um"],
                phase_step=values["phase_step"],
                jitter=values["jitter"],
                rng=rng,
            ),
        ),
    )
}


def values_of(defect: Defect, severity: float | None, given: Values) -> dict[str, float]:
    """All values of a defect: those given, the extent by severity, defaults for the rest.

    Raises:
        HeightMapError: an unknown or infinite value, a severity outside 0–1, both or neither of severity and extent.
    """
    known = [defect.extent.name, *(setting.name for setting in defect.settings)]
    for name, value in given.items():
        if name not in known:
            raise HeightMapError(f"{defect.name} has no parameter {name!r}; it has {', '.join(known)}")
        if not np.isfinite(value):
            raise HeightMapError(f"{name} of {defect.name} must be a finite number, not {value}")
    if (severity is None) == (defect.extent.name not in given):
        raise HeightMapError(
            f"{defect.name} takes either a severity of 0 to 1 or {defect.extent.name} ({defect.extent.meaning})"
        )
    values = {setting.name: setting.default for setting in defect.settings}
    if severity is not None:
        if not 0.0 <= severity <= 1.0:
            raise HeightMapError(f"a severity lies between 0 (none) and 1 (gross), not {severity}")
        values[defect.extent.name] = severity * defect.extent.default
    return {**values, **given}


def inject_defect(
    surface: HeightMap,
    name: str,
    rng: np.random.Generator,
    *,
    severity: float | None = None,
    values: Values | None = None,
    **note: object,
) -> HeightMap:
    """Add a defect to a map.

    Args:
        surface: the map; missing points stay missing.
        name: one of :data:`DEFECTS`.
        rng: source of randomness.
        severity: 0 (none) to 1 (gross); scales the extent of the defect. Leave it out where the extent is
            in ``values``.
        values: dimensions of the defect by name, with the unit in the name; defaults for those not given.
        note: further entries of the provenance, such as the seed.

    Returns:
        The spoiled map; ``origin["defects"]`` lists all defects added so far with their values.

    Raises:
        HeightMapError: unknown defect or parameter, a value outside its range, or a map that cannot have this defect.
    """
    defect = DEFECTS.get(name)
    if defect is None:
        raise HeightMapError(f"unknown defect {name!r}; there are {', '.join(DEFECTS)}")
    found = values_of(defect, severity, values or {})
    result = surface if found[defect.extent.name] == 0.0 else defect.apply(surface, found, rng)
    entry = {"defect": name, "severity": severity, "parameters": found, **note}
    return surface.with_height(result.height_um, defects=[*surface.origin.get("defects", []), entry])
