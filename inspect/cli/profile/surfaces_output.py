"""Output of ``profile make`` and ``profile spoil``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.cli.json_output import print_json
from anisoscope.cli.tables import print_lines, print_table

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap


def list_defects(*, as_json: bool) -> int:
    """Print all defects with their dimensions and causes."""
    from anisoscope.profiles.defect_injection import DEFECTS

    if as_json:
        found = {
            defect.name: {
                "cause": defect.cause,
                "parameters": {
                    one.name: {"unit": one.unit, "meaning": one.meaning, "default": one.default}
                    for one in (defect.extent, *defect.settings)
                },
                "scaled_by_severity": defect.extent.name,
            }
            for defect in DEFECTS.values()
        }
        return print_json(found)
    rows = []
    for defect in DEFECTS.values():
        rows.append(
            [defect.name, _option(defect.extent.name), f"{defect.extent.default:g}", defect.extent.unit]
        )
        rows[-1] += ["severity 1", defect.extent.meaning]
        rows += [
            ["", _option(one.name), f"{one.default:g}", one.unit, "default", one.meaning]
            for one in defect.settings
        ]
    print_table("defects", ["defect", "option", "value", "unit", "at", "meaning"], rows)
    print_table("what causes them", ["defect", "cause"], [[one.name, one.cause] for one in DEFECTS.values()])
    return 0


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def deliver(
    surface: "HeightMap", out: Path, *, as_json: bool, deviation: dict[str, float] | None = None
) -> int:
    """Write the map and print its size and origin."""
    from anisoscope.profiles.files.checks import check_map
    from anisoscope.profiles.files.load import write_height_map
    from anisoscope.profiles.provenance import keeps_provenance
    from anisoscope.profiles.textures.amplitude import amplitude

    write_height_map(check_map(surface, out.name), out)
    written = keeps_provenance(out)
    found = amplitude(surface)
    rows, cols = surface.shape
    result = {
        "file": str(out),
        "rows": rows,
        "cols": cols,
        "pixel_um": [surface.pixel_y_um, surface.pixel_x_um],
        "sq_um": found.sq_um,
        "sz_um": found.sz_um,
        "made": surface.origin.get("made"),
        "defects": surface.origin.get("defects", []),
        "origin_kept_in_file": written,
    } | ({"deviation": deviation} if deviation else {})
    if as_json:
        return print_json(result)
    table = [
        ["rows, columns", f"{rows}, {cols}", ""],
        ["pixel along y, x", f"{surface.pixel_y_um:.6g}, {surface.pixel_x_um:.6g}", "µm"],
        ["Sq", f"{found.sq_um:.6g}", "µm"],
        ["Sz", f"{found.sz_um:.6g}", "µm"],
    ]
    if deviation:
        table += [
            ["deviation, rms", f"{deviation['rms_um']:.6g}", "µm"],
            ["highest added", f"{max(deviation['highest_um'], 0.0):.6g}", "µm"],
            ["deepest removed", f"{abs(min(deviation['lowest_um'], 0.0)):.6g}", "µm"],
            ["points changed", f"{100.0 * deviation['share_changed']:.3g}", "%"],
        ]
    lines = [f"made: {_words(surface.origin['made'])}"] if "made" in surface.origin else []
    lines += [f"defect: {_words(entry)}" for entry in surface.origin.get("defects", [])]
    lines += [] if written else [f"{out.suffix} has no place for this history; x3p, npz and gsf keep it"]
    print_table(out.name, ["quantity", "value", "unit"], table)
    print_lines(*lines)
    return 0


def _words(entry: dict[str, Any]) -> str:
    """An entry of the provenance on one line."""
    flat: dict[str, Any] = {}
    for key, value in entry.items():
        flat |= value if isinstance(value, dict) else {key: value}
    first = flat.pop("ideal", None) or flat.pop("defect", "")
    parts = [
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in flat.items()
    ]
    return ", ".join([str(first), *(part for part in parts if not part.endswith(" None"))])
