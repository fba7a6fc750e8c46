"""``anisoscope profile compare``: maps of one part, or a tool and its parts."""

import sys
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.json_output import fields_of, print_json
from anisoscope.cli.options import Flag, Json, check_map, check_new
from anisoscope.cli.profile.many import (
    NO_TABLE,
    OutOptions,
    Values,
    check_table,
    measure_each,
    write_each,
)
from anisoscope.cli.profile.profile import AS_STATED, Scales, reader
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import print_lines, print_table
from anisoscope.views.options import parse_numbers

if TYPE_CHECKING:
    from anisoscope.prediction.contrast_change import ContrastCauses
    from anisoscope.profiles.comparison import Comparison
    from anisoscope.recipe.surface import SurfaceRecipe


def compare(
    first: Path,
    /,
    *others: Path,
    mirrored: Flag = False,
    out: Annotated[Path | None, Parameter(help="HTML page to write, of one second map.")] = None,
    difference: Path | None = None,
    plot: Path | None = None,
    line: str | None = None,
    recipe: Path | None = None,
    several: Annotated[OutOptions, Parameter(name="*", group="Several files")] = NO_TABLE,
    json_: Json = False,
    scales: Scales = AS_STATED,
) -> int:
    """Register other maps on the first: difference, wear volume, ridges, degree of replication.

    Args:
        first: Map A: before wear, or the tool.
        others: Map B: after wear, or the part. Several maps or patterns make a table, with --out-dir a page each.
        difference: File for the difference map B − A, such as *.x3p.
        plot: Picture of difference, outlines and line: *.png or *.svg.
        line: Line of the page: X0,Y0,X1,Y1 in µm from the first point of the first map.
        recipe: Recipe whose plastic and poses say what the changes do to the predicted contrasts.
        mirrored: A tool and its part: negate the first map and mirror it along x first.

    Examples:
        anisoscope profile compare new.x3p worn.x3p --out wear.html
        anisoscope profile compare tool.x3p part.x3p --mirrored --recipe recipe.toml --out replication.html
    """
    from anisoscope.profiles.comparison import compare_maps
    from anisoscope.profiles.files.load import write_height_map
    from anisoscope.report.comparison_page import (
        comparison_notes,
        write_comparison_page,
        write_comparison_picture,
    )
    from anisoscope.report.study_page import check_picture

    check_picture(plot)
    shown = _line(line)
    seconds = _seconds(first, others)
    light = None if recipe is None else _light(recipe)
    if len(seconds) > 1 or several.table is not None or several.out_dir is not None:
        if not out is difference is plot is None:
            raise UsageError("--out, --plot and --difference are of one second map; several take --out-dir")
        reference = reader(scales)(first)

        def work(path: Path, target: Path | None = None) -> Values:
            found = compare_maps(reference, reader(scales)(path), mirrored=mirrored)
            if target is not None:
                write_comparison_page(found, (first.name, path.name), target, shown, _contrasts(found, light))
            return _values(found)

        if several.out_dir is not None:
            return write_each(seconds, work, several, ".html", to_json=json_)
        return measure_each(seconds, work, several, to_json=json_)
    second = seconds[0]
    check_table(several)
    _check_targets(out, difference, plot, overwrite=several.overwrite)
    with progress(f"{first.name}, {second.name}") as advance:
        advance("reading", 0, 3)
        maps = reader(scales)(first), reader(scales)(second)
        advance("registering", 1, 3)
        found = compare_maps(*maps, mirrored=mirrored)
        contrasts = _contrasts(found, light)
        advance("writing", 2, 3)
        if difference is not None:
            write_height_map(found.difference, difference)
        if out is not None:
            write_comparison_page(found, (first.name, second.name), out, shown, contrasts)
        if plot is not None:
            write_comparison_picture(found, plot, shown)
    if json_:
        content = {"first": first, "second": second, **fields_of(found), "notes": comparison_notes(found)}
        print_json(content | ({"contrasts": contrasts} if contrasts else {}))
    else:
        _print(found, first, second, contrasts, out)
    return 0


def _light(path: Path) -> "SurfaceRecipe":
    """The recipe whose plastic and poses count.

    Raises:
        UsageError: one of prints, plates or wafers.
        RecipeError: it cannot be read.
    """
    from anisoscope.kinds.registry import kind_of
    from anisoscope.kinds.surface import SurfaceKind

    kind = kind_of(path)
    if not isinstance(kind, SurfaceKind):
        raise UsageError(f"{path}: the recipe of {kind.one}; --recipe takes those of surfaces")
    read: SurfaceRecipe = kind.read_recipe(path)
    return read


def _contrasts(found: "Comparison", light: "SurfaceRecipe | None") -> "tuple[ContrastCauses, ...]":
    from anisoscope.prediction.contrast_change import contrast_change

    return () if light is None else contrast_change(found, light)


def _seconds(first: Path, others: Sequence[Path]) -> list[Path]:
    """The second maps; patterns are replaced by what they match.

    Raises:
        UsageError: none is given, or a pattern that matches none.
    """
    from anisoscope.operations.map_series import expanded

    if not others:
        raise UsageError(f"compare {first} with which map? name the second one after it")
    return expanded(others)


def _line(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    ends = parse_numbers(text, "--line", "0,50,400,50", "um")
    if len(ends) != 4:
        raise UsageError(f"--line takes X0,Y0,X1,Y1 in µm, not {text!r}")
    return ends[0], ends[1], ends[2], ends[3]


def _check_targets(out: Path | None, difference: Path | None, plot: Path | None, *, overwrite: bool) -> None:
    if out is not None and out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: a page is named *.html")
    check_map(difference, "--difference")
    check_new((out, difference, plot), overwrite=overwrite)


def _values(found: "Comparison") -> Values:
    """Values by name, u(...) their standard uncertainties; NaN where there is none."""
    from anisoscope.profiles.metrology.quantity import Quantity

    placed, lost, gained = found.placed, found.lost, found.gained
    quantities = {
        "volume lost": (lost.volume_um3, "µm³"),
        "volume gained": (gained.volume_um3, "µm³"),
        "sum of all differences": (found.net_um3, "µm³"),
        "relief B/A": (found.replication.relief, ""),
        "ridge height B/A": (found.replication.height, ""),
        "shrinkage of B": (found.replication.shrinkage, ""),
        "shift along x": (Quantity(placed.x_um, placed.u_x_um), "µm"),
        "shift along y": (Quantity(placed.y_um, placed.u_y_um), "µm"),
        "turned": (Quantity(placed.angle_deg, placed.u_angle_deg), "°"),
        "scale B/A": (Quantity(placed.scale, placed.u_scale), ""),
    }
    values: dict[str, tuple[float, str]] = {}
    for name, (one, unit) in quantities.items():
        values[name] = (nan if one.value is None else one.value, unit)
        values[f"u({name})"] = (nan if one.u is None else one.u, unit)
    return values | {
        "greatest loss": (lost.depth_um, "µm"),
        "overlap": (100.0 * placed.overlap, "%"),
        "ambiguity": (placed.ambiguity, ""),
    }


def _print(
    found: "Comparison", first: Path, second: Path, contrasts: "tuple[ContrastCauses, ...]", out: Path | None
) -> None:
    from anisoscope.report.comparison_page import (
        comparison_answer,
        comparison_notes,
        comparison_numbers,
        contrast_table,
        ridge_table,
    )

    print_lines(comparison_answer(found))
    print_table(
        f"{second.name} against {first.name}",
        ["quantity", "value", "u (k = 1)", "unit"],
        comparison_numbers(found),
        caption="\n".join(comparison_notes(found)) or None,
    )
    if found.ridges:
        print_table("ridges", *ridge_table(found, contrasts))
    if contrasts:
        print_table("predicted contrasts, ln of the ratio of radiances", *contrast_table(contrasts))
    if out is not None:
        sys.stdout.write(f"{out}\n")
