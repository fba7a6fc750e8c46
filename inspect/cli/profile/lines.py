"""``anisoscope profile lines``: profile parameters of ISO 21920 on lines of a height map."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from anisoscope.cli.options import HeightMaps, Json
from anisoscope.cli.profile.many import NONE, ManyOptions, Values, measure_maps
from anisoscope.cli.profile.profile import AS_STATED, OF_FILTERING, Scales, reader
from anisoscope.cli.tables import print_table
from anisoscope.parameters.texture import Filtering
from anisoscope.views.options import Given, with_options

if TYPE_CHECKING:
    from anisoscope.profiles.lines import LineParameters

MEANINGS = {
    "Ra": ("µm", "arithmetic mean height"),
    "Rq": ("µm", "root mean square height"),
    "Rz": ("µm", "maximum height, mean over sections (points, ISO 4287)"),
    "Rz_hills": ("µm", "the same of hills and dales (ISO 21920-2)"),
    "Rp": ("µm", "maximum peak height, mean over sections"),
    "Rv": ("µm", "maximum pit depth, mean over sections"),
    "Rt": ("µm", "total height of a line"),
    "Rsk": ("", "skewness"),
    "Rku": ("", "kurtosis"),
    "Rdq": ("", "root mean square gradient"),
    "Rsm": ("µm", "mean profile element spacing, 10 % of Rz"),
}


@with_options(filtering=OF_FILTERING)
def lines(
    *files: HeightMaps,
    direction: Literal["across", "along", "x", "y"] = "across",
    filtering: Given[Filtering],
    json_: Json = False,
    many: Annotated[ManyOptions, Parameter(name="*", group="Several files")] = NONE,
    scales: Scales = AS_STATED,
) -> int:
    """Profile parameters (ISO 21920-2) on parallel lines of height maps: Ra, Rq, Rz, Rp, Rv, Rt, Rsm, Rsk, Rku, Rdq.

    Rz takes the points of each section (ISO 4287), Rz_hills its hills and dales (ISO 21920-2).

    Args:
        direction: Direction of the profiles: across or along the ridges, or x or y.

    Examples:
        anisoscope profile lines part.x3p --direction across --l-filter 250
    """
    from anisoscope.profiles.lines import line_parameters

    read, filters = reader(scales), filtering.made()

    def measure(path: Path) -> "LineParameters":
        return line_parameters(read(path), direction, filtering=filters)

    return measure_maps(files, many, measure, _values, _print, to_json=json_)


def _print(name: str, found: "LineParameters") -> None:
    print_table(
        name,
        ["parameter", "mean", "between lines (s)", "unit", "meaning"],
        [
            [name, _cell(found.values[name]), _cell(found.spread[name]), unit, meaning]
            for name, (unit, meaning) in MEANINGS.items()
        ],
        caption=_caption(found),
    )


def _values(found: "LineParameters") -> Values:
    return {name: (found.values[name], unit) for name, (unit, _) in MEANINGS.items()}


def _cell(value: float) -> str:
    return f"{value:.5g}" if abs(value) < float("inf") else "–"


def _caption(found: "LineParameters") -> str:
    filters = [
        f"{name} {'none' if cutoff is None else f'{cutoff:g} µm ({kind})'}"
        for name, cutoff, kind in (
            ("λs", found.s_filter_um, found.s_filter),
            ("λc", found.l_filter_um, found.l_filter),
        )
    ]
    return (
        f"{found.lines} lines {found.direction}, {found.angle_deg:.2f}° counter-clockwise from +x, "
        f"{found.length_um:.5g} µm long, {found.sections} sections; {', '.join(filters)}"
    )
