"""A file of limits of control charts, so that later data are charted within limits of earlier ones (phase II)."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import tomli_w
from pydantic import Field

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import ConfigError, UsageError
from anisoscope.base.toml_file import Part, Positive, read_toml_model
from anisoscope.quality.control import ControlStudy
from anisoscope.quality.limits import Limits, given_limits


class KnownChart(Part):
    """Limits of a chart, and in words what they rest on; without ``freedom`` sigma is exact."""

    chart: str
    center: float
    sigma: Positive
    freedom: Positive | None = None
    source: str


class KnownCharts(Part):
    """The file: limits by the name of the chart."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    charts: dict[str, KnownChart]


def write_chart_limits(path: Path, studies: Iterable[ControlStudy], source: str) -> None:
    """Write the limits of charts as TOML.

    Args:
        path: the file, which must not be there.
        studies: the charts.
        source: of their data, in words.

    Raises:
        RecordError: it cannot be written.
        UsageError: it is there.
    """
    if path.exists():
        raise UsageError(f"{path} is there: limits are not replaced; name another file, or remove this one")
    charts = {}
    for one in studies:
        basis = one.basis
        ends = f"{one.labels[basis.first]} to {one.labels[basis.last]}" if basis.baseline else "given"
        charts[one.name] = {
            "chart": one.points.chart,
            "center": basis.center,
            "sigma": basis.sigma,
            **({"freedom": basis.freedom} if math.isfinite(basis.freedom) else {}),
            "source": f"{source}: {basis.baseline or 'no'} {one.unit}, {ends}",
        }
    write_text(path, tomli_w.dumps({"schema": 1, "charts": charts}))


def read_chart_limits(path: Path) -> dict[str, tuple[str, Limits]]:
    """Chart and limits by the name of the number.

    Raises:
        ConfigError: it cannot be read, or is no such file.
    """
    found = read_toml_model(path, KnownCharts, error=ConfigError)
    return {
        name: (
            one.chart,
            given_limits(one.center, one.sigma, one.freedom or math.inf, f"{path.name} ({one.source})"),
        )
        for name, one in found.charts.items()
    }
