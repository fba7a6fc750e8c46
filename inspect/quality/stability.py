"""Stability: a check standard measured repeatedly over time, on a control chart, with its bias."""

from dataclasses import dataclass

from anisoscope.base.arrays import FloatArray
from anisoscope.base.json_fields import in_json
from anisoscope.quality.bias import ALPHA, Bias, bias_study
from anisoscope.quality.control import ControlStudy, Settings, control_study
from anisoscope.quality.limits import individuals


@dataclass(frozen=True, eq=False)
class Stability:
    """The chart, and the bias where the value of the standard is known."""

    chart: ControlStudy
    bias: Bias | None

    @property
    def acceptable(self) -> bool:
        """The chart is stable, and no bias is significant."""
        return self.chart.stable and (self.bias is None or not self.bias.significant)

    @property
    @in_json()
    def verdict(self) -> str:
        """The outcome in plain words."""
        if self.bias is None:
            return self.chart.verdict
        if not self.chart.stable:
            return f"{self.chart.verdict}; a bias of what is not stable says little"
        return f"{self.chart.verdict}; {self.bias.verdict}"


def stability_study(
    values: FloatArray,
    labels: tuple[str, ...],
    settings: Settings,
    reference: float | None = None,
    alpha: float = ALPHA,
    name: str = "check standard",
) -> Stability:
    """Chart a check standard.

    Args:
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N times or names.
        settings: of the chart.
        reference: the value that the standard has, if known.
        alpha: significance of the bias.
        name: of the number.

    Raises:
        UsageError: too few values, or settings that make no sense.
    """
    chart = control_study(name, individuals(values, labels), settings)
    return Stability(chart, None if reference is None else bias_study(values, reference, alpha))
