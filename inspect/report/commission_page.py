"""Page of a commissioning: findings, pictures, curves and tables."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.notation import true_minus
from anisoscope.commissioning.commissioning import Commissioned
from anisoscope.commissioning.model import RigModel
from anisoscope.commissioning.observation import Picture
from anisoscope.commissioning.record import Finding, FitRecord
from anisoscope.report.figures import BLUE, GREEN, MUTED, ORANGE, RED, new_figure, svg_uri
from anisoscope.report.page import write_page
from anisoscope.report.provenance import when

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_COLOURS = (BLUE, ORANGE, GREEN, RED, MUTED, "#7a4fa3", "#b58900")


def text_of(value: float | str | None, u: float | None = None) -> str:
    """A value with the digits that its uncertainty deserves, two of them uncertain."""
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    if u is None or not np.isfinite(u) or u <= 0.0:
        return f"{value:.6g}".replace("-", "−")
    decimals = min(max(1 - int(np.floor(np.log10(u))), 0), 6)
    return f"{value:.{decimals}f}".replace("-", "−")


def u_text(u: float | None) -> str:
    """A standard uncertainty with two digits."""
    return "–" if u is None else f"{u:.2g}"


def finding_row(finding: Finding) -> tuple[str, str, str, str, str, str, str]:
    """Quantity, key, unit, old value, new value, u, and remark."""
    known = finding.status == "found"
    value = text_of(finding.value, finding.u) if known else finding.status
    note = (
        finding.remark
        if known or finding.value is None
        else f"{text_of(finding.value, finding.u)}{finding.unit} ± {u_text(finding.u)}{finding.unit}: {finding.remark}"
    )
    return (
        finding.words,
        finding.key,
        finding.unit or "1",
        text_of(finding.old),
        value,
        u_text(finding.u),
        true_minus(note),
    )


def _answer(findings: Sequence[Finding]) -> str:
    """How much was found, and what the pictures do not show, in a sentence."""
    found = sum(one.status == "found" for one in findings)
    unclear = "; ".join(one.words for one in findings if one.status == "not identifiable")
    return f"Found: {found} of {len(findings)} quantities." + (
        f" Not identifiable: {unclear}." if unclear else ""
    )


def picture_chart(picture: Picture) -> str:
    """A picture with markers, spot and ridges drawn in, as a data URI."""
    rows, cols = picture.image.shape
    with new_figure(4.2, 4.2 * rows / cols + 0.1) as (figure, axes):
        bright = max(float(np.percentile(picture.image, 99.5)), 1e-12)
        axes.imshow(np.sqrt(np.clip(picture.image / bright, 0.0, 1.0)), cmap="gray", vmin=0.0, vmax=1.0)
        for corners in picture.corners_px.reshape(-1, 4, 2):
            closed = np.concatenate([corners, corners[:1]]) * picture.scale
            axes.plot(*closed.T, color=ORANGE, linewidth=1.2)
        _draw_spot(axes, picture)
        axes.set_axis_off()
        axes.set_xlim(-0.5, cols - 0.5)
        axes.set_ylim(rows - 0.5, -0.5)
        return svg_uri(figure)


def _draw_spot(axes: "Axes", picture: Picture) -> None:
    middle = np.array(picture.center_px) * picture.scale
    radius = picture.radius_px * picture.scale
    turn = np.linspace(0.0, 2.0 * np.pi, 90)
    axes.plot(middle[0] + radius * np.cos(turn), middle[1] + radius * np.sin(turn), color=BLUE, linewidth=1.0)
    if picture.ridge_deg is None:
        return
    across = np.radians(picture.ridge_deg)
    along = across + 0.5 * np.pi
    for angle, style in ((along, "-"), (across, ":")):
        step = radius * np.array([np.cos(angle), -np.sin(angle)])
        line = np.stack([middle - step, middle + step])
        axes.plot(*line.T, linestyle=style, color=RED, linewidth=1.2)


def _curve(done: Commissioned, pose: int, lean_deg: FloatArray) -> FloatArray:
    """The fitted radiance at the tilt of a pose."""
    light, known = done.angles.light, {one.name: one.value for one in done.angles.light.parameters}
    tilt = np.full_like(lean_deg, (light.sign or 1) * done.angles.tilts_deg[pose])
    model = RigModel(done.part, lean_deg, tilt, done.record.series["bounces"])
    return np.asarray(np.exp(model.anchored(known, every=6)(known)), dtype=np.float64)


def radiance_chart(done: Commissioned) -> str:
    """Radiances over the angle of the sample, one colour a tilt, with the fit, as a data URI."""
    record, dense = done.record, np.linspace(0.0, 360.0, 181)
    turns, zero = record["stage.turns"].value, record["ridges.zero_deg"].value
    sense = 1.0 if turns == "ccw" else -1.0
    assert isinstance(zero, float)
    tilts = sorted({round(pose.tilt_reading_deg, 1) for pose in record.poses})
    with new_figure(8.6, 3.8) as (figure, axes):
        for tilt, colour in zip(tilts, _COLOURS * len(tilts), strict=False):
            poses = [
                (number, pose)
                for number, pose in enumerate(record.poses)
                if round(pose.tilt_reading_deg, 1) == tilt
            ]
            angle = np.array([sense * (pose.reading_deg - zero) % 360.0 for _, pose in poses])
            measured = np.array([pose.radiance or np.nan for _, pose in poses])
            axes.plot(angle, measured, "o", color=colour, markersize=4, label=f"tilt axis at {tilt:g}°")
            axes.plot(dense, _curve(done, poses[0][0], dense), "-", color=colour, linewidth=0.9)
        axes.set_yscale("log")
        axes.set_xticks(range(0, 361, 45))
        axes.set_xlabel("azimuth toward which the facets lean, from the light's side [°]")
        axes.set_ylabel("radiance [1/sr]" if record.series["white_reference"] else "brightness [counts/s]")
        axes.grid(visible=True)
        figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize=8)
        return svg_uri(figure)


def residual_chart(done: Commissioned) -> str:
    """Residual angles of markers and ridges over the reading, as a data URI."""
    with new_figure(8.6, 2.6) as (figure, axes):
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        for turning, name, colour in (
            (done.angles.markers, "markers", ORANGE),
            (done.angles.ridges, "ridges", RED),
        ):
            if turning is None:
                continue
            axes.plot(turning.residuals_deg, "o", color=colour, markersize=4, label=name)
        axes.set_xlabel("picture")
        axes.set_ylabel("angle off [°]")
        figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=8)
        return svg_uri(figure)


def write_commission_page(done: Commissioned, path: Path) -> None:
    """Write the page of a commissioning, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    record = done.record
    assert record.fit is not None
    content = {
        "title": f"Commissioning of {record.rig}",
        "answer": _answer(record.findings),
        "record": record,
        "findings": [finding_row(finding) for finding in record.findings],
        "pictures": [
            (picture_chart(one), f"Stage at {one.reading_deg:.1f}°, tilt at {one.tilt_reading_deg:.1f}°.")
            for one in done.pictures
        ],
        "radiances": radiance_chart(done),
        "residuals": residual_chart(done),
        "quality": _quality(record.fit),
        "parameters": [
            (
                one.words,
                "–" if one.u_prior is None else f"{text_of(one.prior, one.u_prior)} ± {u_text(one.u_prior)}",
                text_of(one.value, one.u),
                u_text(one.u),
                "not determined" if one.u_alone is None else u_text(one.u_alone),
            )
            for one in record.fit.parameters
        ],
        "correlation": [[f"{x:+z.2f}".replace("-", "−") for x in row] for row in record.fit.correlation],
    }
    write_page(path, "commission.html", content, {"when": when})


def _quality(fit: FitRecord) -> str:
    text = f"χ² = {fit.chi2:.1f} at {fit.dof} degrees of freedom"
    return text if fit.widened <= 1.0 else f"{text}; uncertainties were widened by {fit.widened:.2f}"
