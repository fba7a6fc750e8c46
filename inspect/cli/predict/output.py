"""Output of ``anisoscope predict --json``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from anisoscope.base.notation import contrast_name
from anisoscope.cli.json_output import fields_of
from anisoscope.cli.log import verbose
from anisoscope.cli.tables import console, print_table

if TYPE_CHECKING:
    from anisoscope.base.arrays import FloatArray
    from anisoscope.prediction.predicted import Predicted
    from anisoscope.prediction.sensitivity import Budget

KINDS = ("difference", "michelson", "log_ratio")
_DISAGREES = 0.2
_SURE = 4.0  # standard uncertainties of a u from draws


def pose_names(result: "Predicted") -> list[str]:
    """Short names of the poses."""
    return [f"{pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°" for pose in result.poses]


def contrast_keys(result: "Predicted") -> list[str]:
    """Labels of the contrasts in JSON, which stay as they were."""
    return [f"{c.from_deg:g}°/{c.to_deg:g}°, tilt {c.tilt_deg:g}°" for c in result.contrasts]


def radiance_u(result: "Predicted") -> list[float] | None:
    """Standard uncertainty of every pose radiance in 1/sr, or None without uncertainties."""
    if result.budget is None:
        return None
    u: list[float] = (result.budget if result.drawn is None else result.drawn).u().tolist()
    return u


def contrast_u(result: "Predicted", kind: str) -> list[float] | None:
    """Standard uncertainty of every contrast; infinite where a dark pose leaves it undefined."""
    import numpy as np

    covariance = result.contrast_covariance(kind)
    return None if covariance is None else [float(np.sqrt(value)) for value in np.diag(covariance)]


def uncertainty_warning(result: "Predicted") -> str | None:
    """Warning where first-order propagation fails, or may fail; None elsewhere."""
    if result.budget is None:
        return None
    from anisoscope.prediction.monte_carlo import disagreement

    names = pose_names(result)
    if result.drawn is None:
        doubtful = [name for name, bent in zip(names, result.budget.not_linear(), strict=True) if bent]
        if not doubtful:
            return None
        return f"first-order uncertainty is in doubt at {'; '.join(doubtful)}: check with --monte-carlo 500"
    limit = max(_DISAGREES, _SURE * result.drawn.u_error_share)
    off = [
        f"{name} (×{1.0 + share:.3g})"
        for name, share in zip(names, disagreement(result.budget, result.drawn), strict=True)
        if abs(share) > limit
    ]
    if not off:
        return None
    return f"first-order uncertainty fails, u of the Monte Carlo differs from it at {'; '.join(off)}"


def _budget_as_json(budget: "Budget") -> list[dict[str, Any]]:
    return [
        {
            "source": part.source,
            "kind": part.kind,
            "correlation": part.correlation,
            "u": part.absolute,
            "relative": [
                None if dark else float(value)
                for value, dark in zip(budget.relative(part.absolute), budget.dark, strict=True)
            ],
        }
        for part in budget.contributions
    ]


def _covariances(result: "Predicted") -> dict[str, Any]:
    found: dict[str, Any] = {}
    matrices = {"radiance": result.covariance} | {kind: result.contrast_covariance(kind) for kind in KINDS}
    for name, matrix in matrices.items():
        assert matrix is not None
        labels = pose_names(result) if name == "radiance" else contrast_keys(result)
        found[name] = {"labels": labels, "matrix": matrix}
    return found


def _monte_carlo_as_json(result: "Predicted") -> dict[str, Any]:
    assert result.budget is not None
    assert result.drawn is not None
    return {
        "draws": len(result.drawn.radiance),
        "u_error_share": result.drawn.u_error_share,
        "mean": result.drawn.radiance.mean(axis=0),
        "u": result.drawn.u(),
        "u_first_order": result.budget.first_order().u(),
    }


def as_json(result: "Predicted", *, covariance: bool = False) -> dict[str, Any]:
    """Prediction as plain data; null for values that a dark pose leaves undefined."""
    u = radiance_u(result)
    poses: list[dict[str, Any]] = [
        {"stage_deg": pose.stage_deg, "tilt_deg": pose.tilt_deg, "radiance": float(value)}
        for pose, value in zip(result.poses, result.radiance, strict=True)
    ]
    pairs = [fields_of(contrast) for contrast in result.contrasts]
    found: dict[str, Any] = {
        "model": result.model,
        "convention": result.convention,
        "k": result.k,
        "poses": poses,
        "contrasts": pairs,
        **result.notes,
    }
    if u is None or result.budget is None:
        return found
    for pose, value in zip(poses, u, strict=True):
        pose["u"] = value
    by_kind = {kind: contrast_u(result, kind) or [] for kind in KINDS}
    for number, pair in enumerate(pairs):
        pair["u"] = {kind: values[number] for kind, values in by_kind.items()}
    found["budget"] = _budget_as_json(result.budget)
    if result.drawn is not None:
        found["monte_carlo"] = _monte_carlo_as_json(result)
    warning = uncertainty_warning(result)
    if warning is not None:
        found["uncertainty_warning"] = warning
    if covariance:
        found["covariance"] = _covariances(result)
    return found


def spectrum_as_json(
    results: "list[Predicted]", wavelengths_nm: tuple[float, ...], *, covariance: bool
) -> dict[str, Any]:
    """Predictions at several wavelengths: numbers become lists with one entry a wavelength."""
    each = [as_json(result, covariance=covariance) for result in results]
    found = {key: value for key, value in each[0].items() if key not in {"poses", "contrasts"}}
    found["wavelengths_nm"] = list(wavelengths_nm)
    for part, fixed in (
        ("poses", {"stage_deg", "tilt_deg"}),
        ("contrasts", {"from_deg", "to_deg", "tilt_deg"}),
    ):
        rows = zip(*(one[part] for one in each), strict=True)
        found[part] = [_stacked(row, fixed) for row in rows]
    for key in ("budget", "covariance", "uncertainty_warning", "optics"):
        if any(key in one for one in each):
            found[key] = [one.get(key) for one in each]
    return found


def _stacked(rows: tuple[dict[str, Any], ...], fixed: set[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in rows[0].items():
        if key in fixed:
            found[key] = value
        elif isinstance(value, dict):
            found[key] = _stacked(tuple(row[key] for row in rows), set())
        else:
            found[key] = [row[key] for row in rows]
    return found


_MAX_POSE_COLUMNS = 6


def _with_u(value: float, u: float | None, digits: int, sign: str = "") -> str:
    if not abs(value) < float("inf"):
        return "–"
    text = f"{value:{sign}.{digits}f}"
    if u is None:
        return text
    return f"{text} ± {u:.{digits}f}" if u < float("inf") else f"{text} ± –"


_IN_WORDS = {
    "second_reflection_would_add": "direct light only: a second reflection would add up to {:.2g} % (--bounces all)",
    "lost_in_roughness": "single scattering loses up to {:.2g} % of the lobe",
}
_NOT_DETAILED = {*_IN_WORDS, "neglected_waves_per_sr", "regions"}


def _convention_text(result: "Predicted") -> str:
    convention = result.convention
    return (
        f"model {result.model}; light {convention.light_angle_deg:g}° from the camera, tilt plane "
        f"{convention.tilt_plane}, facets toward {convention.facet_azimuth_deg:g}°, stage turns "
        f"{convention.rotation_sense}; k = {result.k:g}"
    )


def _source_of_u(result: "Predicted") -> str:
    if result.budget is None:
        return ""
    source = "second order" if result.drawn is None else f"{len(result.drawn.radiance)} draws"
    return f"; ± is the standard uncertainty (coverage factor 1), from {source}"


def _details(result: "Predicted") -> str:
    """Notes on model and surface that are no warnings."""
    texts = []
    for name, value in result.notes.items():
        if name == "optics":
            text = f"optics: {value['reason']}"
            if value["stated_error_per_sr"] is not None:
                text += f" (of the middle of a lobe: {value['stated_error_per_sr']:.2g} 1/sr)"
            texts.append(text)
        elif name not in _NOT_DETAILED and not name.endswith("warning"):
            shown = f"{value:.4g}" if isinstance(value, float) else str(value)
            texts.append(f"{name.replace('_', ' ')}: {shown}")
    return "; ".join(texts)


GRAZING_DEG = 75.0
"""Angle between a beam and the normal of the sample beyond which a prediction is warned of."""


def warnings_of(result: "Predicted") -> list[str]:
    """What limits the use of a prediction, a line each."""
    found = [str(value) for name, value in result.notes.items() if name.endswith("warning")]
    found += [
        text.format(100.0 * result.notes[name]) for name, text in _IN_WORDS.items() if name in result.notes
    ]
    found += [
        text
        for text in (_neglected_waves(result), _grazing(result), uncertainty_warning(result))
        if text is not None
    ]
    return found


def _neglected_waves(result: "Predicted") -> str | None:
    error = result.notes.get("neglected_waves_per_sr")
    if error is None:
        return None
    counted = "" if result.budget is None else ", which are in u"
    return (
        f"waves matter here and are neglected: rays are off by up to {error:.2g} 1/sr in every pose{counted}"
    )


def _grazing(result: "Predicted") -> str | None:
    import numpy as np

    from anisoscope.sim.light.geometry import directions

    steepest = np.min([beam[:, 2] for beam in directions(result.poses, result.convention)], axis=0)
    angles = np.degrees(np.arccos(np.clip(steepest, -1.0, 1.0)))
    if not np.any(angles > GRAZING_DEG):
        return None
    worst = int(angles.argmax())
    return (
        f"at {pose_names(result)[worst]} light or camera is {angles[worst]:.0f}° from the normal of the sample: beyond "
        f"{GRAZING_DEG:g}° a small error of an angle changes everything, and neither plastic nor model is tested there"
    )


def radiance_rows(result: "Predicted") -> list[list[str]]:
    """Rows of the table of radiances."""
    u: Sequence[float | None] = radiance_u(result) or [None] * len(result.poses)
    rows = []
    for number, pose in enumerate(result.poses):
        value = float(result.radiance[number])
        row = [f"{pose.stage_deg:g}", f"{pose.tilt_deg:g}", _with_u(value, u[number], 5)]
        if result.drawn is not None and result.budget is not None:
            mean = float(result.drawn.radiance[:, number].mean())
            row += [
                f"{result.budget.first_order().u()[number]:.5f}",
                f"{result.drawn.u()[number]:.5f}",
                f"{mean:.5f}",
            ]
        rows.append(row)
    return rows


def contrast_rows(result: "Predicted") -> list[list[str]]:
    """Rows of the table of contrasts."""
    unknown: list[float | None] = [None] * len(result.contrasts)
    u: dict[str, Sequence[float | None]] = {kind: contrast_u(result, kind) or unknown for kind in KINDS}
    digits = {"difference": 5, "michelson": 4, "log_ratio": 4}
    return [
        [
            contrast_name(c.from_deg, c.to_deg, c.tilt_deg),
            *(_with_u(getattr(c, kind), u[kind][n], digits[kind], "+") for kind in KINDS),
        ]
        for n, c in enumerate(result.contrasts)
    ]


def columns_of(result: "Predicted") -> tuple[list[str], list[str]]:
    """Headers of the tables of radiances and of contrasts."""
    pm = "" if result.budget is None else " ± u"
    radiance = ["stage [°]", "tilt [°]", f"radiance{pm} [1/sr]"]
    if result.drawn is not None:
        radiance += ["u first order [1/sr]", "u Monte Carlo [1/sr]", "mean of draws [1/sr]"]
    return radiance, ["contrast", f"difference{pm} [1/sr]", f"Michelson{pm} [1]", f"ln ratio{pm} [1]"]


def print_prediction(result: "Predicted") -> None:
    """Print contrasts and warnings; with --verbose radiances, details of the model and the budget as well."""
    radiance, contrast = columns_of(result)
    details = _details(result)
    if verbose():
        print_table("Radiance per unit irradiance", radiance, radiance_rows(result), caption=details or None)
    caption = _convention_text(result) + _source_of_u(result)
    print_table("Contrasts", contrast, contrast_rows(result), caption=caption)
    if "regions" in result.notes:
        _print_regions(result)
    _print_warnings(result)
    if verbose() and result.budget is not None:
        _print_budget(result, result.budget)
    elif not verbose():
        _print_line("radiances, model and uncertainty budget: --verbose")


def _print_regions(result: "Predicted") -> None:
    """Radiances of the regions of a map with ridges of several directions."""
    rows = [
        [
            f"{one['direction_deg']:.1f}",
            f"{one['facet_azimuth_on_map_deg']:.1f}",
            f"{one['regions']}",
            f"{one['share']:.1%}",
            *(
                _with_u(value, None if one["u"] is None else one["u"][number], 5)
                for number, value in enumerate(one["radiance"])
            ),
        ]
        for one in result.notes["regions"]
    ]
    columns = ["ridges at [°]", "facets toward [°]", "regions", "share"]
    print_table(
        "Regions of one direction",
        [*columns, *(f"radiance at {name} [1/sr]" for name in pose_names(result))],
        rows,
        caption="each in the frame of its own ridges; the contrasts above are of the mean over the area",
    )


def _print_warnings(result: "Predicted") -> None:
    for text in warnings_of(result):
        _print_line(f"warning: {text}")


def _print_line(text: str) -> None:
    console().print(text, markup=False, highlight=False, soft_wrap=True)


def _print_budget(result: "Predicted", budget: "Budget") -> None:
    import numpy as np

    names = pose_names(result)
    few = len(names) <= _MAX_POSE_COLUMNS

    def cells(absolute: "FloatArray") -> list[str]:
        shares = np.abs(budget.relative(absolute))
        if not few:
            return [f"{100.0 * shares.max():.3g}", names[int(shares.argmax())]]
        return ["–" if dark else f"{100.0 * v:.3g}" for v, dark in zip(shares, budget.dark, strict=True)]

    parts = sorted(
        budget.contributions, key=lambda part: -float(np.abs(budget.relative(part.absolute)).max())
    )
    rows = [[p.source, p.correlation, *cells(p.absolute)] for p in parts if np.any(p.absolute != 0.0)]
    rows.append(["all", "", *cells(budget.u())])
    exact = [part.source for part in parts if not np.any(part.absolute != 0.0)]
    head = [f"u at {name} [%]" for name in names] if few else ["largest u [%]", "at"]
    caption = f"nothing comes from: {', '.join(exact)}" if exact else None
    print_table("Uncertainty budget, relative", ["source", "between poses", *head], rows, caption=caption)


def print_spectrum(results: "list[Predicted]", wavelengths_nm: tuple[float, ...]) -> None:
    """Print radiances and contrasts of every wavelength."""
    radiance, contrast = columns_of(results[0])
    wavelength_head = "wavelength [nm]"
    text = [f"{wavelength:g}" for wavelength in wavelengths_nm]
    for title, head, rows_of, caption in (
        ("Radiance per unit irradiance", radiance, radiance_rows, None),
        ("Contrasts", contrast, contrast_rows, _convention_text(results[0]) + _source_of_u(results[0])),
    ):
        rows = [[name, *row] for name, one in zip(text, results, strict=True) for row in rows_of(one)]
        print_table(title, [wavelength_head, *head], rows, caption=caption)
    _print_warnings(results[0])
