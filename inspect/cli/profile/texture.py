"""``anisoscope profile texture``: surface texture parameters of ISO 25178-2."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import LENGTH, Flag, Json
from anisoscope.cli.profile.many import (
    NONE,
    ManyOptions,
    Values,
    check_table,
    measure_each,
    print_sheet,
)
from anisoscope.cli.profile.profile import AS_STATED, FilterType, Scales, reader
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_table
from anisoscope.views.options import parse_numbers

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.profiles.textures.texture import MapUncertainty, Spread, Texture


@dataclass(frozen=True)
class UncertaintyOptions:
    """Uncertainty of the values, by Monte Carlo.

    Attributes:
        uncertainty: Number of draws of noise, height scale and pixel size, such as 100: standard uncertainties of all
            values; each draw takes as long as the measurement.
        u_height_noise: Noise of a height, standard deviation in µm.
    """

    uncertainty: Annotated[int | None, Parameter(name="--draws")] = None
    u_height_noise: Annotated[float, LENGTH] = 0.0
    u_height_scale: Annotated[float, Parameter(help="Of the scale of the heights, relative.")] = 0.0
    u_pixel_size: Annotated[float, Parameter(help="Of the pixel size, relative, both axes together.")] = 0.0
    seed: Annotated[int, Parameter(help="Seed of the draws.")] = 0

    def check(self) -> None:
        """Refuse what makes no sense before a map is read.

        Raises:
            UsageError: draws without an uncertainty of the map, or the other way round; a value out of range.
        """
        given = any((self.u_height_noise, self.u_height_scale, self.u_pixel_size))
        if self.uncertainty is None:
            if given:
                raise UsageError("--u-height-noise, --u-height-scale and --u-pixel-size take --draws NUMBER")
            return
        if not given:
            raise UsageError("--draws takes --u-height-noise, --u-height-scale or --u-pixel-size")
        if self.uncertainty < 2:
            raise UsageError(f"--draws takes two draws or more, not {self.uncertainty}")
        if self.seed < 0:
            raise UsageError(f"--seed takes a whole number from 0, not {self.seed}")
        self.of_map()

    def of_map(self) -> "MapUncertainty":
        """Uncertainties of the map."""
        from anisoscope.profiles.textures.texture import MapUncertainty

        return MapUncertainty(self.u_height_noise, self.u_height_scale, self.u_pixel_size)

    def spreads(
        self, surface: "HeightMap", evaluate: "Callable[[HeightMap], Values]", on_progress: Advance = silent
    ) -> "Mapping[str, Spread]":
        """Uncertainty of every value by name; empty where none was chosen."""
        from anisoscope.profiles.textures.texture import texture_uncertainty

        if self.uncertainty is None:
            return {}
        return texture_uncertainty(
            surface, evaluate, self.of_map(), self.uncertainty, seed=self.seed, on_progress=on_progress
        )


CERTAIN = UncertaintyOptions()


def texture(
    *files: Path,
    s_filter: Annotated[float | None, LENGTH] = None,
    l_filter: Annotated[float | None, LENGTH] = None,
    s_filter_type: FilterType = "gaussian",
    l_filter_type: Annotated[FilterType, Parameter(help="The same for the L-filter.")] = "gaussian",
    form: str = "plane",
    plot: Path | None = None,
    features: Flag = False,
    pruning: Annotated[float, Parameter(help="Wolf pruning of hills and dales in % of Sz.")] = 5.0,
    border_features: bool = True,
    ratios: str | None = None,
    heights: str | None = None,
    json_: Json = False,
    doubt: Annotated[UncertaintyOptions, Parameter(name="*", group="Uncertainty")] = CERTAIN,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Height, spatial, hybrid, functional and feature parameters (ISO 25178-2) of height maps.

    Args:
        files: Height maps in a format of docs/height-maps.md, or patterns.
        s_filter_type: S-filter of ISO 16610: gaussian (-61), robust (-71) or spline (separable, -22 along x and y).
        form: Form that is removed: none, plane, poly1 … poly10, sphere or cylinder.
        plot: Picture of spectra, autocorrelation and bearing curve: *.png or *.svg.
        border_features: Count peaks and pits of hills and dales at the border or a gap; others leave them out.
        ratios: Material ratios in %, such as 2,50: Smc, Vm and Vv there, and Sxp of the first two.
        heights: Heights in µm from the mean, such as -0.5,0.5: Smr there.
        features: Also hills and dales: Spd, Spc, S5p, S5v, S10z, Sha, Sda, Shv, Sdv.
        s_filter: Nesting index of the S-filter in µm; removes shorter waves.
        l_filter: Nesting index of the L-filter in µm; removes longer waves.

    Examples:
        anisoscope profile texture part.x3p --s-filter 3 --l-filter 250
        anisoscope profile texture 'lot/*.x3p' --limits limits.toml --table lot.html
    """
    from anisoscope.operations.map_series import expanded
    from anisoscope.profiles.limits import sheet_of
    from anisoscope.profiles.textures.texture import texture as measure
    from anisoscope.report.study_page import check_picture

    check_picture(plot)
    shares, at_heights = _free(ratios, heights)
    doubt.check()
    if not (features or border_features):
        raise UsageError("--no-border-features leaves out hills and dales: ask for them with --features")

    def measured(surface: "HeightMap") -> "Texture":
        return measure(
            surface,
            form=form,
            s_filter_um=s_filter,
            l_filter_um=l_filter,
            s_filter=s_filter_type,
            l_filter=l_filter_type,
            pruning=0.01 * pruning if features else None,
            border_features=border_features,
            ratios_percent=shares,
            at_heights_um=at_heights,
        )

    def valued(surface: "HeightMap") -> Values:
        return measured(surface).values

    chosen = expanded(files)
    if len(chosen) > 1 or many.table is not None:
        if plot is not None:
            raise UsageError("--plot draws one map; give one file and no --table")

        def with_uncertainty(path: Path) -> Values:
            surface = reader(scales)(path)
            values = valued(surface)
            spreads = doubt.spreads(surface, valued)
            return {**values, **{f"u({name})": (one.u, values[name][1]) for name, one in spreads.items()}}

        return measure_each(chosen, with_uncertainty, many, to_json=json_)
    check_table(many)
    surface = reader(scales)(chosen[0])
    found = measured(surface)
    with progress(chosen[0].name, quiet=doubt.uncertainty is None) as advance:
        spreads = doubt.spreads(surface, valued, advance)
    if plot is not None:
        from anisoscope.report.texture_picture import write_texture_picture

        write_texture_picture(found, plot)
    sheet = sheet_of(many.limits, found.values)
    if json_:
        print_json(fields_of(found) | _spreads_as_json(doubt, spreads) | ({"sheet": sheet} if sheet else {}))
    else:
        _print(chosen[0].name, found, spreads)
    return print_sheet(sheet, silent=json_)


def _spreads_as_json(doubt: UncertaintyOptions, spreads: "Mapping[str, Spread]") -> dict[str, Any]:
    if not spreads:
        return {}
    return {
        "u": {name: one.u for name, one in spreads.items()},
        "shift": {name: one.shift for name, one in spreads.items()},
        "uncertainty": fields_of(doubt.of_map()) | {"draws": doubt.uncertainty, "seed": doubt.seed},
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


def _free(ratios: str | None, heights: str | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    shares = () if ratios is None else parse_numbers(ratios, "--ratios", "2,50")
    if any(not 0.0 <= share <= 100.0 for share in shares):
        raise UsageError(f"--ratios takes material ratios from 0 to 100 %, not {ratios!r}")
    return shares, () if heights is None else parse_numbers(heights, "--heights", "-0.5,0.5", "um")


def _bound(found: "Texture") -> str:
    return "≤ " if found.spatial.str_is_bound else ""


def _number(value: float) -> str:
    return f"{value:.5g}" if math.isfinite(value) else "–"
