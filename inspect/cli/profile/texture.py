"""``anisoscope profile texture``: surface texture parameters of ISO 25178-2."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError
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
from anisoscope.cli.profile.profile import AS_STATED, OF_FILTERING, Scales, reader
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.parameters.texture import Extent, Filtering, MapUncertainty
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.profiles.textures.texture import Spread, Texture


@with_options(
    filtering=OF_FILTERING,
    extent=Options(
        Extent,
        names={"pruning_percent": "--pruning", "ratios_percent": "--ratios"},
        flags=("features",),
        whole=True,
    ),
    doubt=Options(
        MapUncertainty,
        Group("Uncertainty"),
        names={"draws": "--draws", "seed": "--seed"},
        prefix="u-",
        whole=True,
    ),
)
def texture(
    *files: HeightMaps,
    filtering: Given[Filtering],
    plot: Path | None = None,
    extent: Given[Extent],
    json_: Json = False,
    doubt: Given[MapUncertainty],
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Height, spatial, hybrid, functional and feature parameters (ISO 25178-2) of height maps.

    Args:
        plot: Picture of spectra, autocorrelation and bearing curve: *.png or *.svg.

    Examples:
        anisoscope profile texture part.x3p --s-filter 3 --l-filter 250
        anisoscope profile texture 'lot/*.x3p' --limits limits.toml --table lot.html
    """
    from anisoscope.operations.map_series import expanded
    from anisoscope.profiles.limits import sheet_of
    from anisoscope.profiles.textures.texture import texture as measure
    from anisoscope.profiles.textures.texture import texture_uncertainty
    from anisoscope.report.study_page import check_picture

    check_picture(plot)
    inputs = doubt.made()
    measured = partial(measure, filtering=filtering.made(), extent=extent.made())

    def valued(surface: "HeightMap") -> Values:
        return measured(surface).values

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        if plot is not None:
            raise UsageError("--plot draws one map; give one file and no --table")

        def with_uncertainty(path: Path) -> Values:
            surface = reader(scales)(path)
            values = valued(surface)
            spreads = texture_uncertainty(surface, valued, inputs)
            return {**values, **{f"u({name})": (one.u, values[name][1]) for name, one in spreads.items()}}

        return measure_each(chosen, with_uncertainty, many, to_json=json_)
    check_table(many)
    surface = reader(scales)(chosen[0])
    found = measured(surface)
    with progress(chosen[0].name, quiet=inputs.draws is None) as advance:
        spreads = texture_uncertainty(surface, valued, inputs, on_progress=advance)
    if plot is not None:
        from anisoscope.report.texture_picture import write_texture_picture

        write_texture_picture(found, plot)
    sheet = sheet_of(many.limits, found.values)
    if json_:
        print_json(fields_of(found) | _spreads_as_json(inputs, spreads) | ({"sheet": sheet} if sheet else {}))
    else:
        _print(chosen[0].name, found, spreads)
    return print_sheet(sheet, silent=json_)


def _spreads_as_json(inputs: MapUncertainty, spreads: "Mapping[str, Spread]") -> dict[str, Any]:
    if not spreads:
        return {}
    return {
        "u": {name: one.u for name, one in spreads.items()},
        "shift": {name: one.shift for name, one in spreads.items()},
        "uncertainty": fields_of(inputs),
    }


def _print(name: str, found: "Texture", spreads: "Mapping[str, Spread]") -> None:
    def of(parameter: str) -> list[str]:
        if not spreads:
            return []
        one = spreads[parameter]
        return [
            f"{one.u:.2g}" if math.isfinite(one.u) else "–",
            f"{one.shift:+.1g}" if math.isfinite(one.shift) else "–",
        ]

    rows = [
        [
            parameter,
            (_bound(found) if parameter == "Str" else "") + _number(value),
            *of(parameter),
            unit,
            meaning,
        ]
        for parameter, value, unit, meaning in found.rows()
    ]
    caption = "\n".join(found.notes())
    if spreads:
        caption += (
            "\nu: standard uncertainty (k = 1) from noise, height scale and pixel size; "
            "shift: what as much noise again adds"
        )
    columns = ["parameter", "value", *(["u", "shift"] if spreads else []), "unit", "meaning"]
    print_table(name, columns, rows, caption=caption)


def _bound(found: "Texture") -> str:
    return "≤ " if found.spatial.str_is_bound else ""


def _number(value: float) -> str:
    return f"{value:.5g}" if math.isfinite(value) else "–"
