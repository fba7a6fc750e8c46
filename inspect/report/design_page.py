"""Page of a designed surface: target and achieved lobe, unreachable part, appearance, tolerances."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.report.figures import BLUE, GRID, MUTED, ORANGE, RED, new_figure, png_uri, svg_uri
from anisoscope.report.page import write_page


@dataclass(frozen=True, eq=False)
class LobeCurves:
    """A lobe along one axis.

    Attributes:
        axis: "x" or "y".
        h: (H,) half vectors.
        target: (H,) wanted, or None where nothing was asked for but what is there.
        achieved: (H,) density in µm.
    """

    axis: str
    h: FloatArray
    target: FloatArray | None
    achieved: FloatArray


@dataclass(frozen=True, eq=False)
class PhaseCurve:
    """|τ| over wavelength.

    Attributes:
        wavelength_nm: (W,).
        tau: (W,).
        band_nm: that it was made small for.
    """

    wavelength_nm: FloatArray
    tau: FloatArray
    band_nm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class CaptionedPicture:
    """A picture.

    Attributes:
        pixels: (rows, cols, 3) encoded sRGB from 0 to 1, first row at the top.
        caption: what it shows.
    """

    pixels: FloatArray
    caption: str


@dataclass(frozen=True, eq=False)
class DesignPage:
    """Content of the page; empty parts are left out.

    Attributes:
        title: heading.
        subtitle: one line below it.
        answer: what the design does, in a sentence.
        warnings: what to mind.
        figures: (name, value, unit) of the design.
        lobes: along the axes.
        phase: of the etch passes.
        progress: (seconds, relative error) of a refinement.
        pictures: the lobe on a screen, dots under white and green light.
        looks: the pattern under two lights.
        tolerances: rows of text.
        notes: where things come from.
    """

    title: str
    subtitle: str
    answer: str
    warnings: Sequence[str] = ()
    figures: Sequence[tuple[str, str, str]] = ()
    lobes: Sequence[LobeCurves] = ()
    phase: PhaseCurve | None = None
    progress: Sequence[tuple[float, float]] = ()
    pictures: Sequence[CaptionedPicture] = ()
    looks: Sequence[CaptionedPicture] = ()
    tolerances: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()


TOLERANCE_COLUMNS = (
    "error of depth [nm]", "error of width [nm]", "|τ| [1]", "largest |τ| over the band [1]", "spike over lobe [1]",
    "light in the lobe [%]", "change of the lobe [%]",
)  # fmt: skip


def write_design_page(page: DesignPage, path: Path) -> None:
    """Write the page, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    charts = [(_lobe_chart(one), _lobe_text(one)) for one in page.lobes]
    if page.phase is not None:
        low, high = page.phase.band_nm
        where = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
        text = f"Mean phase |τ| of all levels over wavelength; it was made small {where}"
        charts.append((_phase_chart(page.phase), text))
    if len(page.progress) > 1:
        text = f"Relative error over time, from {page.progress[0][1]:.3f} to {page.progress[-1][1]:.4f}"
        charts.append((_progress_chart(page.progress), text))
    content = {
        "title": page.title,
        "subtitle": page.subtitle,
        "answer": page.answer,
        "warnings": page.warnings,
        "figures": page.figures,
        "charts": charts,
        "pictures": [(_picture_uri(one.pixels), one.caption) for one in page.pictures],
        "looks": [(_picture_uri(one.pixels), one.caption) for one in page.looks],
        "columns": TOLERANCE_COLUMNS,
        "tolerances": page.tolerances,
        "notes": page.notes,
    }
    write_page(path, "design.html", content)


def _picture_uri(pixels: FloatArray) -> str:
    values = np.asarray(np.rint(255.0 * np.clip(pixels, 0.0, 1.0)), dtype=np.uint8)
    done, data = cv2.imencode(".png", values[..., ::-1])
    assert done
    return png_uri(data.tobytes())


def _lobe_text(one: LobeCurves) -> str:
    if one.target is None:
        return f"Reflected density along h_{one.axis}"
    missed = float(np.linalg.norm(one.target - one.achieved) / np.linalg.norm(one.target))
    return f"Target and achieved lobe along h_{one.axis}; {100.0 * missed:.1f} % (L2) of the target stays out of reach"


def _lobe_chart(one: LobeCurves) -> str:
    with new_figure(4.6, 3.0) as (figure, axes):
        axes.axhline(0.0, color=GRID, linewidth=0.8)
        if one.target is not None:
            axes.fill_between(
                one.h, one.target - one.achieved, color=ORANGE, alpha=0.6, linewidth=0, label="unreachable"
            )
            axes.plot(one.h, one.target, color=MUTED, linewidth=1.2, linestyle="--", label="target")
        axes.plot(one.h, one.achieved, color=BLUE, linewidth=1.4, label="achieved")
        axes.set_xlabel(f"h_{one.axis} [1]")
        axes.set_ylabel("density [µm]")
        axes.set_xlim(float(one.h[0]), float(one.h[-1]))
        axes.grid()
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def _phase_chart(one: PhaseCurve) -> str:
    with new_figure(4.6, 3.0) as (figure, axes):
        low, high = one.band_nm
        if low < high:
            axes.axvspan(low, high, color=GRID, alpha=0.5, linewidth=0)
        else:
            axes.axvline(low, color=RED, linewidth=0.8)
        axes.plot(one.wavelength_nm, one.tau, color=BLUE, linewidth=1.4)
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("|τ| [1]")
        axes.set_ylim(bottom=0.0)
        axes.grid()
        return svg_uri(figure)


def _progress_chart(progress: Sequence[tuple[float, float]]) -> str:
    with new_figure(4.6, 3.0) as (figure, axes):
        seconds, error = np.array(progress).T
        axes.step(seconds, error, where="post", color=BLUE, linewidth=1.4)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("relative error [1]")
        axes.set_ylim(bottom=0.0)
        axes.grid()
        return svg_uri(figure)
