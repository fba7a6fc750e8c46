"""Is a fitted model rejected by its data, which rival describes them, and by how much are its uncertainties too small?

A model is rejected where χ² is less probable than `REJECTED`. Its rivals are then fitted as well; the one that is not
rejected and has the smallest Bayesian information criterion (Schwarz 1978) takes its place. Where every one is
rejected, no interval of a parameter means anything; uncertainties are enlarged by the Birge ratio (Birge 1932), which
cannot tell how wrong the model is.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from anisoscope.base.json_fields import in_json
from anisoscope.base.notation import p_value_text
from anisoscope.base.significance import chi2_tail

REJECTED = 1e-3
"""Probability of χ² below which a model is rejected."""

Found = TypeVar("Found")


@dataclass(frozen=True)
class Misfit:
    """Test of a fitted model by its residuals.

    Attributes:
        model: what was fitted, in words.
        chi2: weighted sum of squares of the residuals.
        dof: degrees of freedom.
        bic: Bayesian information criterion, less what is the same for all models of the data.
        p_value: of χ²; None where the noise is unknown or no freedom is left.
    """

    model: str
    chi2: float
    dof: float
    bic: float
    p_value: float | None

    @property
    @in_json()
    def rejected(self) -> bool:
        """Whether the model does not describe the data within their uncertainties."""
        return self.p_value is not None and self.p_value < REJECTED

    @property
    @in_json()
    def birge_ratio(self) -> float:
        """Factor on the uncertainties of a rejected model, √(χ²/degrees of freedom); else 1."""
        return float(np.sqrt(self.chi2 / self.dof)) if self.rejected else 1.0

    @property
    def words(self) -> str:
        """The test in words."""
        p_value = "" if self.p_value is None else f", p {p_value_text(self.p_value)}"
        return f"{self.model}: chi² {self.chi2:.4g} for {self.dof:.4g} degrees of freedom{p_value}"


def misfit(
    model: str, chi2: float, count: int, parameters: float, *, known: bool = True, dof: float | None = None
) -> Misfit:
    """Test of a model.

    Args:
        model: in words.
        chi2: weighted sum of squares.
        count: number of values.
        parameters: number of fitted ones.
        known: the noise of the values is known; else χ² is in any unit, and only compares models.
        dof: degrees of freedom where they are not count − parameters.
    """
    left = count - parameters if dof is None else dof
    scale = chi2 if known else count * float(np.log(max(chi2, 1e-300)))
    p_value = float(chi2_tail(chi2, left)) if known and left > 0 else None
    return Misfit(model, chi2, left, scale + parameters * float(np.log(max(count, 1))), p_value)


def best_model(
    own: Found,
    stages: Iterable[Iterable[Callable[[], Found | None]]],
    test: Callable[[Found], Misfit],
    limits: Iterable[Callable[[], Found | None]] = (),
) -> tuple[Found, tuple[Misfit, ...]]:
    """The model where it holds, else the rival that describes the data best, else the model again.

    Args:
        own: the fitted model.
        stages: rivals; each fits another model, or says None where it cannot be fitted. A stage is only tried where
            the model and all earlier ones are rejected.
        test: of a fitted model.
        limits: simpler models, fitted likewise where the noise is unknown, so that only rivals can say that a model is
            wrong.

    Returns:
        The chosen one, and the tests of all that were fitted, the model's own first.
    """
    found, tests = [own], [test(own)]
    for stage in (limits,) if tests[0].p_value is None else stages:
        if tests[0].p_value is not None and not all(one.rejected for one in tests):
            break
        for fit in stage:
            rival = fit()
            if rival is not None:
                found.append(rival)
                tests.append(test(rival))
    holding = [n for n, one in enumerate(tests) if not one.rejected]
    return found[min(holding, key=lambda n: tests[n].bic, default=0)], tuple(tests)


def rejection_words(chosen: Misfit, tests: tuple[Misfit, ...]) -> list[str]:
    """Lines on a rejected model and its rivals; none where the model holds."""
    if not tests[0].rejected and chosen is tests[0]:
        return []
    lines = [f"{'Rejected' if one.rejected else 'Not rejected'}: {one.words}." for one in tests]
    if chosen.rejected:
        lines.append(
            "No model that was tried describes these values: no interval is given, and u, enlarged by the Birge ratio "
            f"{chosen.birge_ratio:.3g}, does not say how far the parameters are off."
        )
    else:
        lines.append(f"The parameters are those of: {chosen.model}.")
    return lines
