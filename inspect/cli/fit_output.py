"""What ``anisoscope fit`` prints: tables, JSON, and its page."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anisoscope.cli.console import console, print_table

if TYPE_CHECKING:
    from anisoscope.fit.brdf import BrdfTable, Reciprocity
    from anisoscope.fit.fitting import Fit


def show(
    fitted: "Fit",
    title: str,
    json_: bool,
    html: Path | None,
    brdf: "tuple[BrdfTable, Reciprocity] | None" = None,
) -> int:
    """Print a fit, or write its page."""
    from anisoscope.fit.text import fit_as_json, quality

    if json_:
        found = fit_as_json(fitted)
        rows = _rows(fitted, brdf)
        found |= {} if brdf is None else _brdf_as_json(*brdf)
        json.dump(found | {"rows": rows}, sys.stdout, indent=2, allow_nan=False)
        sys.stdout.write("\n")
    elif html is not None:
        from anisoscope.report.fit_page import write_fit_page

        write_fit_page(fitted, title, html, () if brdf is None else (_reciprocity_words(brdf[1]),))
        console().print(f"{html}: {quality(fitted)}", markup=False, highlight=False, soft_wrap=True)
    else:
        _print(fitted, title, brdf)
    return 0


def _rows(fitted: "Fit", brdf: "tuple[BrdfTable, Reciprocity] | None") -> list[dict[str, float | None]]:
    from anisoscope.fit.brdf import COLUMNS
    from anisoscope.fit.text import rows_as_json

    rows = rows_as_json(fitted)
    if brdf is None:
        return rows
    angles = [dict(zip(COLUMNS[:4], map(float, row), strict=True)) for row in brdf[0].angles_deg]
    return [
        {"line": line, **place, **row} for line, place, row in zip(brdf[0].lines, angles, rows, strict=True)
    ]


def _brdf_as_json(table: "BrdfTable", pairs: "Reciprocity") -> dict[str, Any]:
    from dataclasses import asdict

    return {"wavelength_nm": table.wavelength_nm, "unit": "1/sr", "reciprocity": asdict(pairs)}


def _reciprocity_words(pairs: "Reciprocity") -> str:
    if not pairs.pairs or pairs.rms_share is None or pairs.worst_share is None or pairs.worst_lines is None:
        return "Reciprocity: no row is measured in both directions."
    one, other = pairs.worst_lines
    return (
        f"Reciprocity: {pairs.pairs} rows measured in both directions differ by {100 * pairs.rms_share:.2g} % rms, at "
        f"most {100 * pairs.worst_share:.2g} % (lines {one} and {other})."
    )


WORST = 10


def _print(fitted: "Fit", title: str, brdf: "tuple[BrdfTable, Reciprocity] | None") -> None:
    import numpy as np

    from anisoscope.fit.text import notes, number, quality, unit_text

    unit, result = unit_text(fitted), "fitted" if fitted.estimates else "predicted"
    order = list(range(len(fitted.fitted)))
    if brdf is not None:
        order = [int(n) for n in np.argsort(-np.abs(fitted.z), kind="stable")[:WORST]]
    print_table(
        title if brdf is None else f"{title}: the {len(order)} worst of {len(fitted.fitted)} rows",
        [
            "row" if brdf is None else "θi, φi → θo, φo",
            *(f"{w} [{unit}]" for w in ("measured", "u", result)),
            "z [1]",
        ],
        [
            [
                fitted.problem.readings.labels[n],
                number(fitted.problem.readings.value[n]),
                f"{fitted.u_value[n]:.2g}",
                number(fitted.fitted[n]),
                f"{fitted.z[n]:+.2f}".replace("-", "−"),
            ]
            for n in order
        ],
        caption=quality(fitted),
    )
    if fitted.estimates:
        _print_parameters(fitted)
    lines = [*notes(fitted), *([] if brdf is None else [_reciprocity_words(brdf[1])])]
    for line in lines:
        console().print(line, markup=False, highlight=False)


def _print_parameters(fitted: "Fit") -> None:
    import numpy as np

    from anisoscope.fit.parameters import PARAMETERS
    from anisoscope.fit.text import fixed, number, setup_text, value_texts

    names = [PARAMETERS[one.name].words for one in fitted.estimates]
    print_table(
        "Parameters",
        ["parameter", "unit", "value", "u", "95 % interval"],
        [
            [name, PARAMETERS[one.name].unit or "1", *value_texts(one)]
            for name, one in zip(names, fitted.estimates, strict=True)
        ],
        caption=setup_text(fitted)
        + "; fixed: "
        + ", ".join(f"{PARAMETERS[n].words} {number(v)}" for n, v in fixed(fitted).items()),
    )
    if len(names) > 1:
        print_table(
            "Correlation [1]",
            ["", *(str(n + 1) for n in range(len(names)))],
            [
                [f"{n + 1} {name}", *("–" if np.isnan(x) else f"{x:+.3f}" for x in row)]
                for n, (name, row) in enumerate(zip(names, fitted.correlation, strict=True))
            ],
        )
