"""Readings as a crossed gauge study: every part measured by every appraiser equally often."""

import numpy as np

from anisoscope.errors import UsageError
from anisoscope.quality.gaugestudy import GaugeData
from anisoscope.quality.readings import Readings

ALONE = "(one)"


def gauge_data(readings: Readings, number: str | None = None) -> GaugeData:
    """Sort readings by part and appraiser.

    Args:
        readings: the part stands in the column ``part`` or ``serial``, the appraiser in ``appraiser`` or ``operator``;
            where there is neither, one appraiser did all.
        number: which number; the first one for None.

    Raises:
        UsageError: no column of parts, a missing value, or a part that was not measured as often as the others.
    """
    _, values = readings.number(number)
    part = readings.column("part" if "part" in readings.texts else "serial")
    whom = next((readings.texts[name] for name in ("appraiser", "operator") if name in readings.texts), ())
    whom = tuple(name or ALONE for name in whom) or (ALONE,) * len(part)
    cells: dict[tuple[str, str], list[float]] = {}
    for key, value in zip(zip(part, whom, strict=True), values.tolist(), strict=True):
        if np.isnan(value):
            raise UsageError(
                f"{readings.source}: part {key[0]} by {key[1]} has a missing value: measure it again"
            )
        cells.setdefault(key, []).append(value)
    parts, appraisers = tuple(dict.fromkeys(part)), tuple(dict.fromkeys(whom))
    trials = max(len(cell) for cell in cells.values())
    for one in parts:
        for by in appraisers:
            found = len(cells.get((one, by), ()))
            if found != trials:
                raise UsageError(
                    f"{readings.source}: part {one} was measured {found} times by {by}, others {trials} times: a gauge "
                    "study needs every part equally often"
                )
    table = [[cells[one, by] for by in appraisers] for one in parts]
    return GaugeData(parts, appraisers, np.array(table, dtype=np.float64))
