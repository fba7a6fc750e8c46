"""What ``anisoscope predict --json`` prints."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.prediction.predicting import Predicted
    from anisoscope.prediction.sensitivity import Budget

    FloatArray = npt.NDArray[np.float64]

KINDS = ("difference", "michelson", "log_ratio")
_DISAGREES = 0.2
_SURE = 4.0  # standard uncertainties of a u from draws


def _finite(value: float) -> float | None:
    return float(value) if abs(value) < float("inf") else None


def pose_names(result: "Predicted") -> list[str]:
    """Short names of the poses."""
    return [f"{pose.stage_deg:g}°, tilt {pose.tilt_deg:g}°" for pose in result.poses]


def contrast_names(result: "Predicted") -> list[str]:
    """Short names of the contrasts."""
    return [f"{c.from_deg:g}°/{c.to_deg:g}°, tilt {c.tilt_deg:g}°" for c in result.contrasts]


def radiance_u(result: "Predicted") -> list[float] | None:
    """Standard uncertainty of every pose radiance in 1/sr, or None where it was not asked for."""
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
    """Where first-order propagation fails, or may fail; None where it serves."""
    if result.budget is None:
        return None
    from anisoscope.prediction.montecarlo import disagreement

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
            "u": [float(value) for value in part.absolute],
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
        labels = pose_names(result) if name == "radiance" else contrast_names(result)
        found[name] = {"labels": labels, "matrix": [[_finite(v) for v in row] for row in matrix.tolist()]}
    return found


def _monte_carlo_as_json(result: "Predicted") -> dict[str, Any]:
    assert result.budget is not None
    assert result.drawn is not None
    return {
        "draws": len(result.drawn.radiance),
        "u_error_share": result.drawn.u_error_share,
        "mean": result.drawn.radiance.mean(axis=0).tolist(),
        "u": result.drawn.u().tolist(),
        "u_first_order": result.budget.u().tolist(),
    }


def as_json(result: "Predicted", *, covariance: bool = False) -> dict[str, Any]:
    """One prediction as plain data; null stands for what a dark pose leaves undefined."""
    u = radiance_u(result)
    poses: list[dict[str, Any]] = [
        {"stage_deg": pose.stage_deg, "tilt_deg": pose.tilt_deg, "radiance": float(value)}
        for pose, value in zip(result.poses, result.radiance, strict=True)
    ]
    pairs: list[dict[str, Any]] = [
        {key: _finite(value) for key, value in asdict(contrast).items()} for contrast in result.contrasts
    ]
    found: dict[str, Any] = {
        "model": result.model,
        "convention": asdict(result.convention),
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
        pair["u"] = {kind: _finite(values[number]) for kind, values in by_kind.items()}
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
