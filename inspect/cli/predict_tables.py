"""The tables of ``anisoscope predict``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from anisoscope.cli.console import print_table
from anisoscope.cli.predict_output import KINDS, contrast_u, pose_names, radiance_u, uncertainty_warning

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.prediction.predicting import Predicted
    from anisoscope.prediction.sensitivity import Budget

    FloatArray = npt.NDArray[np.float64]

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


def _caption(result: "Predicted") -> str:
    convention = result.convention
    caption = (
        f"model {result.model}; light {convention.light_angle_deg:g}° from the camera, tilt plane "
        f"{convention.tilt_plane}, facets toward {convention.facet_azimuth_deg:g}°, stage turns "
        f"{convention.rotation_sense}; k = {result.k:g}"
    )
    for name, value in result.notes.items():
        if name == "optics":
            caption += f"; optics: {value['reason']}"
            if value["stated_error_per_sr"] is not None:
                caption += f" (of the middle of a lobe: {value['stated_error_per_sr']:.2g} 1/sr)"
            continue
        if name in _IN_WORDS:
            caption += "; " + _IN_WORDS[name].format(100.0 * value)
            continue
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        caption += f"; {name.replace('_', ' ')}: {shown}"
    if result.budget is not None:
        source = "first order" if result.drawn is None else f"{len(result.drawn.radiance)} draws"
        caption += f"; ± is the standard uncertainty (coverage factor 1), from {source}"
    warning = uncertainty_warning(result)
    return caption if warning is None else f"{caption}; warning: {warning}"


def radiance_rows(result: "Predicted") -> list[list[str]]:
    """Rows of the table of radiances."""
    u: Sequence[float | None] = radiance_u(result) or [None] * len(result.poses)
    rows = []
    for number, pose in enumerate(result.poses):
        value = float(result.radiance[number])
        row = [f"{pose.stage_deg:g}", f"{pose.tilt_deg:g}", _with_u(value, u[number], 5)]
        if result.drawn is not None and result.budget is not None:
            mean = float(result.drawn.radiance[:, number].mean())
            row += [f"{result.budget.u()[number]:.5f}", f"{result.drawn.u()[number]:.5f}", f"{mean:.5f}"]
        rows.append(row)
    return rows


def contrast_rows(result: "Predicted") -> list[list[str]]:
    """Rows of the table of contrasts."""
    unknown: list[float | None] = [None] * len(result.contrasts)
    u: dict[str, Sequence[float | None]] = {kind: contrast_u(result, kind) or unknown for kind in KINDS}
    digits = {"difference": 5, "michelson": 4, "log_ratio": 4}
    return [
        [
            f"{c.from_deg:g}",
            f"{c.to_deg:g}",
            f"{c.tilt_deg:g}",
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
    contrast = [f"difference{pm} [1/sr]", f"Michelson{pm}", f"ln ratio{pm}"]
    return radiance, ["from [°]", "to [°]", "tilt [°]", *contrast]


def print_prediction(result: "Predicted") -> None:
    """Print radiances, contrasts and the budget."""
    radiance, contrast = columns_of(result)
    print_table("Radiance per unit irradiance", radiance, radiance_rows(result))
    print_table("Contrasts", contrast, contrast_rows(result), caption=_caption(result))
    if result.budget is not None:
        _print_budget(result, result.budget)


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
    rows.append(["all, first order", "", *cells(budget.u())])
    exact = [part.source for part in parts if not np.any(part.absolute != 0.0)]
    head = [f"u at {name} [%]" for name in names] if few else ["largest u [%]", "at"]
    caption = f"nothing comes from: {', '.join(exact)}" if exact else None
    print_table("Uncertainty budget, relative", ["source", "between poses", *head], rows, caption=caption)


def print_spectrum(results: "list[Predicted]", wavelengths_nm: tuple[float, ...]) -> None:
    """Print radiances and contrasts of every wavelength."""
    radiance, contrast = columns_of(results[0])
    wavelength_head = "wavelength [nm]"
    shown = [f"{wavelength:g}" for wavelength in wavelengths_nm]
    for title, head, rows_of, caption in (
        ("Radiance per unit irradiance", radiance, radiance_rows, None),
        ("Contrasts", contrast, contrast_rows, _caption(results[0])),
    ):
        rows = [[name, *row] for name, one in zip(shown, results, strict=True) for row in rows_of(one)]
        print_table(title, [wavelength_head, *head], rows, caption=caption)
