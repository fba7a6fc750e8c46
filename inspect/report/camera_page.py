"""Page of a camera after EMVA 1288: photon transfer, linearity, signal-to-noise ratio, and values."""

import math
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.calibration.linearity import GAIN_RANGE
from anisoscope.calibration.record import Value
from anisoscope.quality.camera import NAMES, CameraSheet
from anisoscope.report.figures import BLUE, GREEN, INK, MUTED, ORANGE, new_figure, svg_uri
from anisoscope.report.page import write_page
from anisoscope.report.statistics_sections import Grid, Picture, number

PERCENT = {NAMES[name] for name in ("prnu", "raw_error", "linearity_error")}
RATIOS = {NAMES[name] for name in ("snr_max", "dynamic_range")}


def write_camera_page(path: Path, sheet: CameraSheet) -> None:
    """Write the page, atomically.

    Raises:
        RecordError: the file cannot be written.
    """
    record, camera = sheet.record, sheet.record.camera
    provenance = (
        ("calibration", record.id),
        ("taken", f"{record.taken_at:%Y-%m-%d %H:%M} UTC, valid until {record.valid_until:%Y-%m-%d}"),
        (
            "frames",
            f"{record.frames}, exposures up to {number(record.exposure_s)} s, gain {number(record.gain)}",
        ),
        (
            "camera",
            f"{camera.cols} x {camera.rows} pixels, {camera.bit_depth} bit, serial number {camera.serial}",
        ),
        ("rig", record.rig),
        *([("operator", record.operator)] if record.operator else []),
        *([] if record.temperature_c is None else [("temperature", f"{number(record.temperature_c)} °C")]),
        ("software", record.software),
        (
            "method",
            "EMVA 1288, release 4, linear model; the middle of the picture, photographed with a white tile",
        ),
    )
    content = {
        "title": f"Camera {camera.model}",
        "source": f"EMVA 1288 data from {sheet.path.name}",
        "verdict": sheet.verdict,
        "good": record.in_limits,
        "values": values_table(sheet),
        "pictures": pictures(sheet),
        "provenance": provenance,
        "notes": sheet.notes,
    }
    write_page(path, "camera.html", content)


def values_table(sheet: CameraSheet) -> Grid:
    """Values with uncertainties and symbols of the standard."""
    rows = tuple((name, *value_texts(name, one)) for name, one in sheet.rows)
    return Grid("Values", "What was found", ("what", "value", "u", "unit", "that is"), rows, "values")


def value_texts(name: str, one: Value) -> tuple[str, str, str, str]:
    """Value, uncertainty, unit, and the value in other words."""
    factor, unit, more = 1.0, one.unit, ""
    if name in PERCENT:
        factor, unit = 100.0, "%"
    elif name in RATIOS and one.value > 0.0:
        more = f"{20.0 * math.log10(one.value):.1f} dB, {math.log2(one.value):.1f} bit"
        unit = ": 1"
    elif name == NAMES["gain"] and one.value > 0.0:
        more = f"{number(1.0 / one.value)} e for one count"
    doubt = "–" if one.u is None else number(factor * one.u, 2)
    return number(factor * one.value), doubt, unit, more


def pictures(sheet: CameraSheet) -> tuple[Picture, ...]:
    """The three pictures, or fewer where the record holds no curve."""
    if sheet.curve is None:
        return ()
    gain = sheet.record.number("gain")
    signal, deviation = _known(sheet.deviations())
    electrons, ratio = _known(sheet.snr())
    return (
        Picture(
            _transfer(sheet),
            f"Photon transfer of {len(sheet.curve.signal)} exposures: variance over signal, slope {number(gain)} "
            f"counts per electron, saturation at {number(sheet.saturation_dn)} counts",
            "Photon transfer: temporal variance over signal. The slope of the line is the system gain K.",
        ),
        Picture(
            _deviation(signal, deviation),
            "Deviation from a straight line between 5 and 95 % of saturation: at most "
            f"{100 * np.max(np.abs(deviation)):.2f} %",
            "Linearity: deviation of the signal from a straight line over exposure.",
        ),
        Picture(
            _snr(sheet, electrons, ratio),
            f"Signal-to-noise ratio over signal, up to {number(float(ratio.max()), 3)} at "
            f"{number(float(electrons.max()), 3)} e",
            "Signal-to-noise ratio of single pixels over time, and the limit by shot noise.",
        ),
    )


def _known(found: tuple[FloatArray, FloatArray] | None) -> tuple[FloatArray, FloatArray]:
    assert found is not None
    return found


def _transfer(sheet: CameraSheet) -> str:
    curve = sheet.curve
    assert curve is not None
    gain, end = sheet.record.number("gain"), sheet.saturation_dn
    with new_figure(4.7, 3.4) as (figure, axes):
        axes.plot(
            curve.signal,
            curve.light_variance - curve.dark_variance,
            "o",
            color=BLUE,
            markersize=4,
            label="measured",
        )
        axes.plot([0.0, GAIN_RANGE * end], [0.0, gain * GAIN_RANGE * end], color=ORANGE, label="slope K")
        axes.plot([GAIN_RANGE * end, end], [gain * GAIN_RANGE * end, gain * end], "--", color=ORANGE)
        axes.axvline(end, color=GREEN, linewidth=1.0, linestyle=":", label="saturation")
        axes.set_xlabel("signal [counts]")
        axes.set_ylabel("variance [counts²]")
        axes.grid()
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)


def _deviation(signal: FloatArray, deviation: FloatArray) -> str:
    with new_figure(4.7, 3.4) as (figure, axes):
        axes.plot(signal, 100.0 * deviation, "o-", color=BLUE, markersize=4, linewidth=0.9)
        axes.axhline(0.0, color=MUTED, linewidth=0.9)
        axes.set_xlabel("signal [counts]")
        axes.set_ylabel("deviation from a line [%]")
        reach = 1.2 * max(0.01, 100.0 * float(np.max(np.abs(deviation))))  # a perfect line must look like one
        axes.set_ylim(-reach, reach)
        axes.grid()
        return svg_uri(figure)


def _snr(sheet: CameraSheet, electrons: FloatArray, ratio: FloatArray) -> str:
    with new_figure(4.7, 3.4) as (figure, axes):
        axes.loglog(electrons, ratio, "o", color=BLUE, markersize=4, label="measured")
        noise = sheet.record.number("read_noise")
        x = np.geomspace(max(electrons.min() / 30.0, 0.5), electrons.max(), 100)
        axes.loglog(x, np.sqrt(x), "--", color=GREEN, label="shot noise alone")
        axes.loglog(x, x / np.sqrt(x + noise**2), color=ORANGE, label="with read noise")
        axes.set_xlabel("signal [e]")
        axes.set_ylabel("signal / noise [1]")
        axes.grid()
        axes.tick_params(colors=INK)
        axes.legend(frameon=False, fontsize=8)
        return svg_uri(figure)
