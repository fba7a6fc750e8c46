"""Texts of a fit, common to console and page."""

from dataclasses import asdict
from typing import Any

import numpy as np

from anisoscope.base.json_fields import as_json
from anisoscope.base.rejection import rejection_words
from anisoscope.fit.fitting import Estimate, Fit
from anisoscope.fit.identifiability import MODEL_SHARE
from anisoscope.fit.parameters import PARAMETERS


def number(value: float) -> str:
    """A number to five digits."""
    return f"{value:.5g}"


def value_texts(estimate: Estimate) -> tuple[str, str, str]:
    """Value, standard uncertainty and 95 % interval, rounded to two digits of the uncertainty."""
    if estimate.value is None or estimate.u is None:
        return "not determined", "–", "–"
    low, high = estimate.low95, estimate.high95
    if not estimate.u > 0.0:
        ends = "–" if low is None or high is None else f"{number(low)} … {number(high)}"
        return number(estimate.value), "0", ends
    places = 1 - int(np.floor(np.log10(estimate.u)))

    def rounded(value: float) -> str:
        text = f"{value:.{places}f}" if places >= 0 else f"{round(value, places):.0f}"
        return text if float(text) else text.lstrip("-")

    ends = "–" if low is None or high is None else f"{rounded(low)} … {rounded(high)}"
    return rounded(estimate.value), rounded(estimate.u), ends


def unit_text(fit: Fit) -> str:
    """Unit of the measured values."""
    return {"brdf": "1/sr", "michelson": "1", "log_ratio": "1"}.get(fit.problem.readings.kind, "as measured")


def quality(fit: Fit) -> str:
    """Chi-square, or the scatter where the noise was not known, in one sentence."""
    if not fit.problem.readings.noise_known:
        relative = fit.rms / max(float(np.sqrt(np.mean(fit.problem.readings.value**2))), 1e-300)
        return (
            f"rms residual {fit.rms:.3g} ({100.0 * relative:.2g} % of the rms value), {fit.dof} degrees of freedom; "
            "no chi-square: the noise was not given"
        )
    text = f"chi² {fit.chi2:.4g} for {fit.dof} degrees of freedom"
    if fit.dof > 0:
        text += f", chi²/dof {fit.chi2 / fit.dof:.3g}"
    if fit.p_value is not None:
        text += f", p = {fit.p_value:.2g}"
    return f"{text}; rms residual {fit.rms:.3g}"


def notes(fit: Fit) -> list[str]:
    """Notes needed to read the numbers, one sentence each."""
    found = [f"Noise: {fit.problem.readings.assumption}."]
    found += rejection_words(fit.misfit, fit.tests or (fit.misfit,)) if fit.estimates else []
    if not fit.estimates and not fit.fits:
        found.append(
            f"p = {fit.p_value:.2g}: this model does not describe the data within their uncertainties."
        )
    found += [f"Not determined: {one.words}." for one in fit.lacking]
    if any(one.value is None for one in fit.estimates):
        found.append(_advice(fit))
    found += [
        f"At a bound: {PARAMETERS[one.name].words}; its uncertainty only holds inward."
        for one in fit.estimates
        if one.at_bound
    ]
    for rival in fit.rivals:
        text = ", ".join(f"{PARAMETERS[name].words} {number(value)}" for name, value in rival.items())
        found.append(f"Another minimum fits about as well: {text}.")
    if fit.problem.free:
        found.append("Fixed parameters count as exact.")
    return found


def _advice(fit: Fit) -> str:
    if fit.advice is not None and "noise" in fit.advice:
        return f"What would determine it: {fit.advice}."
    if fit.advice is not None:
        return f"What would determine it, added at the same noise a pose: {fit.advice}."
    if fit.problem.scene.poses and fit.problem.scene.ridge_angles_deg is None:
        return (
            "Neither more stage angles and tilts within ±20° nor a tenth of the noise would determine it: fix one of "
            "its parameters."
        )
    return "Fix one of its parameters, or measure more directions with less noise."


def fixed(fit: Fit) -> dict[str, float]:
    """The parameters that were not fitted and enter the prediction."""
    scene, readings = fit.problem.scene, fit.problem.readings
    left_out = set(fit.problem.free)
    if not readings.scaled:
        left_out.add("k")
    if scene.ridge_angles_deg is not None:
        left_out.add("ridge_angle_deg")
    if scene.model == "printed":
        left_out.add("height_loss")
    return {name: value for name, value in fit.values.items() if name not in left_out}


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """Fit as plain data without its rows; null for an undetermined number."""
    scene, readings = fit.problem.scene, fit.problem.readings
    found: dict[str, Any] = {"model": scene.model, "kind": readings.kind, "wall": scene.design.wall}
    if scene.model == "corrected":
        found |= {
            "bounces": "all" if scene.bounces is None else scene.bounces,
            "internal_reflection": scene.material.internal_reflection,
            "second_lobe": scene.material.second_lobe,
            "edge_radius_um": scene.design.edge_radius_um,
            "foot_radius_um": scene.design.foot_radius_um,
        }
    if scene.convention is not None:
        found["convention"] = asdict(scene.convention)
    return found | {
        "parameters": [
            asdict(one) | {"determined": one.value is not None, "limit_of_u": PARAMETERS[one.name].limit}
            for one in fit.estimates
        ],
        "fixed": fixed(fit),
        "correlation": _matrix(fit.correlation),
        "covariance": _matrix(fit.covariance),
        "noise": "given" if readings.noise_known else "estimated from the residuals",
        "assumption": readings.assumption,
        "chi2": fit.chi2 if readings.noise_known else None,
        "dof": fit.dof,
        "p_value": fit.p_value,
        "tests": as_json(fit.tests or (fit.misfit,)),
        "fitted_model": fit.misfit.model,
        "rejected": fit.misfit.rejected,
        "birge_ratio": fit.misfit.birge_ratio,
        "rms_residual": fit.rms,
        "model_error_share": MODEL_SHARE,
        "not_determined": [{"parts": dict(one.parts), "spread_in_limits": one.spread} for one in fit.lacking],
        "advice": fit.advice,
        "rivals": [dict(rival) for rival in fit.rivals],
        "notes": notes(fit),
    }


def _matrix(matrix: "np.ndarray[Any, np.dtype[np.float64]]") -> list[list[float | None]]:
    return [[float(x) if np.isfinite(x) else None for x in row] for row in matrix]


def rows_as_json(fit: Fit) -> list[dict[str, float | None]]:
    """Measured, fitted and residual of every row, with its pose where it has one."""
    scene, readings = fit.problem.scene, fit.problem.readings
    rows: list[dict[str, float | None]] = []
    for n in range(len(readings.value)):
        row: dict[str, float | None] = {}
        if scene.poses:
            first, second = scene.poses[readings.first[n]], scene.poses[readings.second[n]]
            if scene.ridge_angles_deg is not None:
                row["ridge_angle_deg"] = float(scene.ridge_angles_deg[readings.first[n]])
            if readings.kind == "exposure":
                row["stage_deg"] = first.stage_deg
            else:
                row |= {"from_deg": first.stage_deg, "to_deg": second.stage_deg}
            row["tilt_deg"] = first.tilt_deg
        row |= {
            "measured": float(readings.value[n]),
            "u": float(fit.u_value[n]),
            "fitted": float(fit.fitted[n]),
            "residual": float(fit.residual[n]),
            "z": float(fit.z[n]),
        }
        rows.append(row)
    return rows


def setup_text(fit: Fit) -> str:
    """Model and convention in one line."""
    scene = fit.problem.scene
    text = f"model {scene.model}"
    if scene.model == "corrected":
        text += f", {'all' if scene.bounces is None else scene.bounces} bounce(s), wall {scene.design.wall}"
    if scene.convention is not None:
        one = scene.convention
        text += (
            f"; light {one.light_angle_deg:g}° from the camera, tilt plane {one.tilt_plane}, facets toward "
            f"{one.facet_azimuth_deg:g}°, stage turns {one.rotation_sense}"
        )
    return text
