"""The colours of a print's poses: measured beside wanted, and by how much they differ."""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.kinds.prints.colour import worst_direction
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, PrintFit
from anisoscope.kinds.prints.measurement import MeasuredPrint
from anisoscope.kinds.prints.model import State


@dataclass(frozen=True, eq=False)
class PoseColour:
    """The colour of one pose.

    Attributes:
        measured, predicted: (3,) channels in 1/sr.
        wanted: (3,) channels predicted for a print that lies and leans as this one does.
        u: (3,) relative standard uncertainty of the measured over the wanted channels.
        xyz, xyz_predicted: (3,) of measured and wanted, Y = 1 for the perfect diffuser.
        delta_e: CIEDE2000 between them.
        u_delta_e: its standard uncertainty.
    """

    measured: FloatArray
    predicted: FloatArray
    wanted: FloatArray
    u: FloatArray
    xyz: FloatArray
    xyz_predicted: FloatArray
    delta_e: float
    u_delta_e: float


def without_lean(fit: PrintFit, covariance: FloatArray) -> FloatArray:
    """(N, N) covariance of ln of the channels: what the two fitted tilts follow is no deviation."""
    places = [PARAMETERS.index(name) for name in ("tilt_x_deg", "tilt_y_deg")]
    kept = np.eye(len(covariance)) - fit.slopes[:, places] @ fit.gain[places]
    return np.asarray(kept @ covariance @ kept.T)


def colours_of(
    expected: PrintExpectation, measured: MeasuredPrint, fit: PrintFit | None, covariance: FloatArray
) -> tuple[PoseColour, ...]:
    """Colours against those of a print that leans alike: the lean, maybe that of its seat, is judged by itself.

    Without a fit nothing is known of a lean, and the colours are compared with those of a print that lies flat.
    """
    eye, metric = expected.eye, expected.eye.metric(measured.channels)
    channels = expected.channels
    if fit is not None:
        leans = State(tilt_x_deg=fit.state.tilt_x_deg, tilt_y_deg=fit.state.tilt_y_deg)
        channels, covariance = expected.scene.channels(leans), without_lean(fit, covariance)
    delta = eye.difference(measured.channels, channels)
    xyz, wanted = eye.xyz(measured.channels), eye.xyz(channels)
    found = []
    for k in range(len(delta)):
        block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        worst = worst_direction(block, metric[k])
        u = float(np.sqrt(worst @ metric[k] @ worst))
        found.append(
            PoseColour(
                measured.channels[k],
                expected.channels[k],
                channels[k],
                np.sqrt(np.diag(block)),
                xyz[k],
                wanted[k],
                float(delta[k]),
                u,
            )
        )
    return tuple(found)
