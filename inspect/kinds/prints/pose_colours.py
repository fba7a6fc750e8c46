"""Colour differences of a print's poses between measurement and prediction (CIEDE2000)."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.prints.colour import worst_direction
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, PrintFit
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.record import ColourRecord, triple


def without_lean(fit: PrintFit, covariance: FloatArray) -> FloatArray:
    """(N, N) covariance of ln of the channels: without what the two fitted tilts explain."""
    places = [PARAMETERS.index(name) for name in ("tilt_x_deg", "tilt_y_deg")]
    projection = np.eye(len(covariance)) - fit.slopes[:, places] @ fit.gain[places]
    return np.asarray(projection @ covariance @ projection.T)


def colours_of(
    expected: PrintExpectation, measured: MeasuredPrint, fit: PrintFit | None, covariance: FloatArray
) -> tuple[ColourRecord, ...]:
    """Colours compared with those of a print with the same lean, which is judged by itself.

    The lean may be that of the seat. Without a fit it is unknown, and the colours are compared with
    those of a flat print.
    """
    eye, metric = expected.eye, expected.eye.metric(measured.channels)
    channels = expected.channels
    if fit is not None:
        leans = State(tilt_x_deg=fit.state.tilt_x_deg, tilt_y_deg=fit.state.tilt_y_deg)
        channels, covariance = expected.scene.channels(leans), without_lean(fit, covariance)
    delta = eye.difference(measured.channels, channels)
    xyz, xyz_reference = eye.xyz(measured.channels), eye.xyz(channels)
    found = []
    for k, pose in enumerate(expected.poses):
        block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        worst = worst_direction(block, metric[k])
        u = float(np.sqrt(worst @ metric[k] @ worst))
        found.append(
            ColourRecord(
                stage_deg=pose.stage_deg,
                tilt_deg=pose.tilt_deg,
                measured=triple(measured.channels[k]),
                predicted=triple(expected.channels[k]),
                wanted=triple(channels[k]),
                u=triple(np.sqrt(np.diag(block))),
                xyz=triple(xyz[k]),
                xyz_predicted=triple(xyz_reference[k]),
                delta_e=float(delta[k]),
                u_delta_e=u,
            )
        )
    return tuple(found)
