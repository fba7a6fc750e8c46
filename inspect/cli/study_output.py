"""What ``anisoscope study`` prints and draws."""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from anisoscope.report.study_page import Chart, Table
    from anisoscope.study.best_angle import AngleStudy
    from anisoscope.study.convergence import ConvergenceStudy


def _finite(values: Any) -> list[float | None]:  # noqa: ANN401 - an array of any numbers
    return [float(value) if math.isfinite(value) else None for value in values]


def _share(value: float) -> str:
    return f"{value:.3%}" if math.isfinite(value) else "–"


def convergence_json(found: "ConvergenceStudy") -> dict[str, Any]:
    """The study as a table for JSON."""
    from dataclasses import asdict

    from anisoscope.study.convergence import LARGEST

    return {
        "design": asdict(found.design),
        "material": asdict(found.material),
        "sampling": asdict(found.sampling),
        "defects": [
            {
                "defect": curve.defect,
                "unit": LARGEST[curve.defect][1],
                "severity": _finite(curve.severity),
                "total": _finite(curve.total),
                "bias": _finite(curve.bias),
                "scatter": _finite(curve.scatter),
                "mean_contrast": _finite(curve.mean_contrast),
                "sampling_bias": curve.sampling_bias,
                "orders": {name: asdict(order) for name, order in curve.orders.items()},
            }
            for curve in found.curves
        ],
    }


def convergence_tables(found: "ConvergenceStudy") -> "list[Table]":
    """Its tables."""
    from anisoscope.report.study_page import Table
    from anisoscope.study.convergence import LARGEST

    rows: list[tuple[str, ...]] = []
    orders: list[tuple[str, ...]] = []
    for curve in found.curves:
        unit = LARGEST[curve.defect][1]
        rows += [
            (
                curve.defect,
                f"{curve.severity[number]:.4g} {unit}",
                _share(curve.total[number]),
                _share(curve.bias[number]),
                _share(curve.scatter[number]),
                f"{curve.mean_contrast[number]:.4f}",
            )
            for number in reversed(range(len(curve.severity)))
        ]
        orders += [
            (curve.defect, name, f"{order.slope:.2f}", f"{order.low:.2f} … {order.high:.2f}")
            for name, order in curve.orders.items()
        ]
    return [
        Table(
            "Order of convergence", ("defect", "deviation", "order [1]", "95 % interval [1]"), tuple(orders)
        ),
        Table(
            "Deviation by severity",
            ("defect", "severity", "total [%]", "bias [%]", "scatter [%]", "mean |C| / ideal [1]"),
            tuple(rows),
        ),
    ]


def convergence_charts(found: "ConvergenceStudy") -> "list[Chart]":
    """Its pictures."""
    import numpy as np

    from anisoscope.report.study_page import Chart, Curve
    from anisoscope.study.convergence import LARGEST

    charts = []
    for curve in found.curves:
        lines = [Curve("total", curve.severity, curve.total)]
        if "scatter" in curve.orders:
            lines += [
                Curve("bias", curve.severity, curve.bias),
                Curve("scatter", curve.severity, curve.scatter),
            ]
        for order in (1, 2):
            guide = curve.total[-1] * (curve.severity / curve.severity[-1]) ** order
            lines.append(Curve(f"order {order}", curve.severity, np.asarray(guide), dashed=True))
        unit = LARGEST[curve.defect][1]
        charts.append(
            Chart(curve.defect, f"severity [{unit}]", "deviation / ideal [1]", tuple(lines), log=True)
        )
    return charts


def angle_json(found: "tuple[AngleStudy, ...]") -> dict[str, Any]:
    """The study as a table for JSON."""
    return {
        "imperfections": [
            {
                "imperfection": study.imperfection.name,
                "severity_is": study.imperfection.what,
                "ten_overtakes_five_at": study.turns_at,
                "curves": [
                    {
                        "severity": curve.severity,
                        "best_deg": curve.best_deg,
                        "best_sd_deg": curve.best_sd_deg,
                        "best_published_deg": curve.best_published_deg,
                        "at_edge": curve.at_edge,
                        "ten_over_five": curve.ten_over_five,
                        "max_at_zero_tilt": curve.findings.max_at_zero_tilt,
                        "first_pair_larger": curve.findings.first_pair_larger,
                        "angles_deg": _finite(curve.angles_deg),
                        "contrast": _finite(curve.contrast),
                        "contrast_sd": _finite(curve.sd),
                    }
                    for curve in study.curves
                ],
            }
            for study in found
        ]
    }


def angle_tables(found: "tuple[AngleStudy, ...]") -> "list[Table]":
    """Its tables."""
    from anisoscope.report.study_page import Table

    tables = []
    for study in found:
        turns = study.turns_at
        always = study.curves[0].ten_over_five > 1.0
        note = (
            f"10° overtakes 5° at {turns:.3g}"
            if turns is not None and not always
            else f"5° overtakes 10° at {turns:.3g}"
            if turns is not None
            else "10° exceeds 5° throughout"
            if always
            else "5° exceeds 10° throughout"
        )
        rows = []
        for curve in study.curves:
            best = f"{curve.best_deg:.2f}" + (f" ± {curve.best_sd_deg:.2f}" if curve.best_sd_deg else "")
            rows.append(
                (
                    f"{curve.severity:g}",
                    best + (" (edge)" if curve.at_edge else ""),
                    f"{curve.best_published_deg:g}",
                    *(f"{value:.5f}" for value in curve.published),
                    f"{curve.ten_over_five:.3f}",
                    "yes" if curve.findings.max_at_zero_tilt else "no",
                )
            )
        columns = (
            study.imperfection.what, "best [°]", "best of the four [°]",
            "5° [1/sr]", "10° [1/sr]", "15° [1/sr]", "20° [1/sr]", "10° / 5° [1]", "most at zero tilt",
        )  # fmt: skip
        tables.append(Table(study.imperfection.name, columns, tuple(rows), note))
    return tables


def angle_charts(found: "tuple[AngleStudy, ...]") -> "list[Chart]":
    """Its pictures."""
    from anisoscope.report.study_page import Chart, Curve

    charts = []
    for study in found:
        lines = tuple(
            Curve(
                f"{curve.severity:g}",
                curve.angles_deg,
                curve.contrast / curve.contrast.max(),
                *(
                    ()
                    if not curve.sd.any()
                    else (
                        (curve.contrast - curve.sd) / curve.contrast.max(),
                        (curve.contrast + curve.sd) / curve.contrast.max(),
                    )
                ),
            )
            for curve in study.curves
        )
        charts.append(
            Chart(
                study.imperfection.what, "ridge angle [°]", "mean |C| / its maximum [1]", lines, points=False
            )
        )
    return charts
