"""Display of a record in a notebook: one line, HTML tables, a plot, a data frame; the same for every kind of part."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from anisoscope.base.notebook import axes_or_new, data_frame, html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class DisplayedPose(Protocol):
    """The fields of a pose that are displayed; radiances in 1/sr."""

    @property
    def stage_deg(self) -> float: ...  # noqa: D102
    @property
    def tilt_deg(self) -> float: ...  # noqa: D102
    @property
    def measured(self) -> float: ...  # noqa: D102
    @property
    def predicted(self) -> float: ...  # noqa: D102


class DisplayedRecord(Protocol):
    """The fields of a record that are displayed."""

    @property
    def serial(self) -> str: ...  # noqa: D102
    @property
    def product(self) -> str: ...  # noqa: D102
    @property
    def verdict(self) -> str: ...  # noqa: D102
    @property
    def reasons(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def poses(self) -> Sequence[DisplayedPose]: ...  # noqa: D102


def record_line(record: DisplayedRecord) -> str:
    """Serial number, product, verdict and the first reason."""
    reason = f", {record.reasons[0]}" if record.reasons else ""
    return f"{record.serial}, {record.product}: {record.verdict}{reason}"


def record_html(record: DisplayedRecord) -> str:
    """Verdict and reasons, and the radiances of the poses."""
    reasons = html_table(
        f"{record.serial}, {record.product}: {record.verdict}", ("reasons",), zip(record.reasons)
    )
    rows = [
        (f"{pose.stage_deg:g}°", f"{pose.tilt_deg:g}°", f"{pose.measured:.4g}", f"{pose.predicted:.4g}")
        for pose in record.poses
    ]
    return reasons + html_table("radiance in 1/sr", ("stage", "tilt", "measured", "predicted"), rows)


def record_plot(record: DisplayedRecord, axes: "Axes | None" = None) -> "Axes":
    """Draw measured and predicted radiances of the poses against the stage angle, a colour for every tilt."""
    axes = axes_or_new(axes)
    for number, tilt in enumerate(sorted({pose.tilt_deg for pose in record.poses})):
        poses = [pose for pose in record.poses if pose.tilt_deg == tilt]
        angles, colour = [pose.stage_deg for pose in poses], f"C{number}"
        axes.plot(
            angles, [pose.predicted for pose in poses], "--", color=colour, label=f"predicted, tilt {tilt:g}°"
        )
        axes.plot(
            angles, [pose.measured for pose in poses], "o", color=colour, label=f"measured, tilt {tilt:g}°"
        )
    axes.set(xlabel="stage angle [°]", ylabel="radiance [1/sr]", title=f"{record.serial}: {record.verdict}")
    axes.legend()
    return axes


def record_frame(record: DisplayedRecord) -> Any:  # noqa: ANN401 - pandas need not be installed
    """The poses as a pandas data frame: stage angle, tilt, measured and predicted radiance in 1/sr.

    Raises:
        UsageError: pandas is not installed.
    """
    names = ("stage_deg", "tilt_deg", "measured", "predicted")
    return data_frame({name: [getattr(pose, name) for pose in record.poses] for name in names})
