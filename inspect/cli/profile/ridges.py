"""``anisoscope profile ridges``: pitch, angles, heights, roughness and burrs of a ridged height map."""

from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import HeightMaps, Json
from anisoscope.cli.profile.many import (
    NONE,
    ManyOptions,
    Values,
    check_table,
    measure_each,
    print_sheet,
)
from anisoscope.cli.profile.profile import AS_STATED, PeriodLimit, Scales, TipRadius, reader
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.profiles.metrology.burrlist import Outlier
    from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement

LISTED_BURRS = 12
NAMES = (
    ("pitch_um", "pitch", "µm"),
    ("surface_pitch_um", "pitch on the tilted surface", "µm"),
    ("direction_deg", "direction from +y", "°"),
    ("ridge_angle_deg", "ridge angle", "°"),
    ("wall_angle_deg", "wall angle", "°"),
    ("height_um", "ridge height", "µm"),
    ("height_loss", "height loss at the crest", "1"),
    ("edge_radius_um", "edge radius of the crest", "µm"),
    ("foot_loss", "height loss at the foot", "1"),
    ("foot_radius_um", "radius of the foot", "µm"),
    ("alpha_along", "alpha along the ridges", "1"),
    ("alpha_across", "alpha across the ridges", "1"),
    ("noise_um", "noise of the heights", "µm"),
    ("angle_variation_deg", "ridge angle, ridge to ridge", "°"),
    ("height_variation_um", "ridge height, ridge to ridge", "µm"),
    ("shift_variation_um", "position, ridge to ridge", "µm"),
    ("along_variation_deg", "ridge angle, along the ridges", "°"),
)


def measurement_as_json(found: "RidgeMeasurement") -> dict[str, Any]:
    """The measurement as plain data; a number is {value, u}, with at_least or at_most where only a bound is known.

    Numbers of straight facets are null where there are none.
    """
    found = found.stated()
    return {**_plain(found), "remarks": found.remarks()}


def _plain(value: object) -> Any:  # noqa: ANN401 - of any field
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if not is_dataclass(value) or isinstance(value, type):
        return value
    shown = fields_of(value).items()
    return {
        name: _plain(one) for name, one in shown if one is not None or name not in {"at_least", "at_most"}
    }


def ridges(
    *files: HeightMaps,
    picture: Path | None = None,
    period_limit: PeriodLimit = None,
    tip_radius: TipRadius = None,
    json_: Json = False,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Measure pitch, direction, angles, heights, roughness and burrs of ridged height maps, with uncertainties.

    A map has at least four ridges, in any direction. One with ridges of several directions is divided into regions of
    one direction each, and these are listed.

    Args:
        picture: PNG of a map of several directions, its regions outlined and numbered.

    Examples:
        anisoscope profile ridges part.x3p --period-limit 4
        anisoscope profile ridges 'lot/*.x3p' --table lot.csv
        anisoscope profile ridges checkerboard.npz --picture regions.png
    """
    from anisoscope.operations.map_series import expanded
    from anisoscope.profiles.limits import sheet_of
    from anisoscope.profiles.metrology.ridges import measure_ridges as measured

    def measure(surface: "HeightMap") -> "RidgeMeasurement":
        return measured(surface, period_limit, tip_radius_um=tip_radius)

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        return measure_each(chosen, lambda path: _values(measure(reader(scales)(path))), many, to_json=json_)
    check_table(many)
    surface = reader(scales)(chosen[0])
    try:
        found = measure(surface)
    except HeightMapError:
        if not many.limits and _regions(chosen[0].name, surface, picture, as_json=json_):
            return 0
        raise
    if picture is not None:
        raise UsageError(
            "--picture shows the regions of a map with several directions; for this one take profile view"
        )
    sheet = sheet_of(many.limits, _values(found))
    if json_:
        print_json(measurement_as_json(found) | ({"sheet": sheet} if sheet else {}))
    else:
        _print(chosen[0].name, found)
    return print_sheet(sheet, silent=json_)


def _regions(name: str, surface: "HeightMap", picture: Path | None, *, as_json: bool) -> bool:
    """List the regions of a map of several directions; False for other maps."""
    from anisoscope.profiles.metrology.quantity import as_text
    from anisoscope.profiles.metrology.regions import direction_regions

    regions = direction_regions(surface)
    if len(regions.azimuths_deg) < 2:
        return False
    ridges_of = [regions.ridges(one) for one in regions.regions]
    if picture is not None:
        from anisoscope.report.profile_page import write_region_picture

        write_region_picture(picture, regions)
    if as_json:
        rows = [
            {
                "number": one.number,
                "direction_deg": one.direction_deg,
                "facet_azimuth_deg": one.azimuth_deg,
                "ridge_angle_deg": _plain(ridges.ridge_angle_deg),
                "pitch_um": ridges.pitch_um,
                "share": one.share,
                "centre_um": one.centre_um,
            }
            for one, ridges in zip(regions.regions, ridges_of, strict=True)
        ]
        azimuths = regions.azimuths_deg
        print_json({"facet_azimuths_deg": azimuths, "class_shares": regions.areas, "regions": rows})
        return True
    columns = ["region", "direction from +y [°]", "facets fall toward [°]", "ridge angle [°]", "u [°]"]
    columns += ["pitch [µm]", "share", "centre x, y [µm]"]
    print_table(
        f"{name}: regions of one direction",
        columns,
        [
            [
                str(one.number),
                f"{one.direction_deg:.1f}",
                f"{one.azimuth_deg:.1f}",
                *as_text(ridges.ridge_angle_deg),
                "–" if ridges.pitch_um is None else f"{ridges.pitch_um:.2f}",
                f"{one.share:.2%}",
                f"{one.centre_um[0]:.0f}, {one.centre_um[1]:.0f}",
            ]
            for one, ridges in zip(regions.regions, ridges_of, strict=True)
        ],
        caption="; ".join(
            f"facets toward {azimuth:.1f}°: {area:.1%} of the map"
            for azimuth, area in zip(regions.azimuths_deg, regions.areas, strict=True)
        )
        + "; the pitch needs four ridges in a region",
    )
    return True


def _values(found: "RidgeMeasurement") -> Values:
    """Values by the names of the JSON, u(...) their standard uncertainties; NaN where only a bound is known."""
    values: dict[str, tuple[float, str]] = {}
    found = found.stated()
    for key, _, unit in NAMES:
        one = getattr(found, key)
        values[key] = (float("nan") if one.value is None else one.value, unit)
        values[f"u({key})"] = (float("nan") if one.u is None else one.u, unit)
    return values


def _print(name: str, found: "RidgeMeasurement") -> None:
    from anisoscope.profiles.metrology.quantity import as_text

    found = found.stated()
    low, high = found.bandwidth_um
    print_table(
        name,
        ["quantity", "value", "u (k = 1)", "unit"],
        [[text, *as_text(getattr(found, key)), unit] for key, text, unit in NAMES],
        caption=f"facets fall toward {found.lean_deg:.1f}° from +x and take {found.facet_share:.0%} of the pitch; "
        f"roughness from {low:.3g} to {high:.3g} µm; {found.missing_share:.2%} missing; periodicity {found.score:.2f}"
        + (f"; lateral period limit {limit:.4g} µm" if (limit := found.period_limit_um) is not None else "")
        + (f"; tip radius {tip:.4g} µm" if (tip := found.tip_radius_um) is not None else "")
        + "".join(f"\n{remark}" for remark in found.remarks()),
    )
    ridge_rows = []
    for one in found.ridges:
        cells = (cell for each in (one.angle_deg, one.height_um, one.shift_um) for cell in as_text(each))
        ridge_rows.append([str(one.number), f"{one.position_um:.2f}", *cells])
    columns = [
        "ridge",
        "position [µm]",
        "angle [°]",
        "u [°]",
        "height [µm]",
        "u [µm]",
        "out of row [µm]",
        "u [µm]",
    ]
    print_table("ridges", columns, ridge_rows)
    if found.burrs:
        _print_burrs(found.burrs)


def _print_burrs(burrs: "tuple[Outlier, ...]") -> None:
    rows = []
    for one in burrs[:LISTED_BURRS]:
        size = f"{one.height_um:.2f}", f"{one.area_um2:.4g}", f"{one.volume_um3:.4g}"
        rows.append([one.kind, f"{one.x_um:.1f}", f"{one.y_um:.1f}", *size])
    count = {kind: sum(one.kind == kind for one in burrs) for kind in ("burr", "spike", "pit")}
    more = f"; {LISTED_BURRS} shown, all with --json" if len(burrs) > LISTED_BURRS else ""
    print_table(
        "what stands out, largest volume first",
        ["kind", "x [µm]", "y [µm]", "height [µm]", "area [µm²]", "volume [µm³]"],
        rows,
        caption=f"{count['burr']} burrs, {count['spike']} spikes, {count['pit']} pits{more}",
    )
