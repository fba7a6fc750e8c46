"""Uncertainty of a measuring process (`anisoscope.quality.measurement_process`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ProcessInputs:
    """Tolerance, further uncertainties and limits of a measuring process.

    Attributes:
        tolerance: tolerance: width between the limits of good parts.
        resolution: resolution of the gauge.
        corrected: readings are corrected by the line of the standards.
        u_calibration: standard uncertainty by the calibration.
        u_linearity: standard uncertainty by the linearity.
        u_object: standard uncertainty by the part itself, such as its form.
        u_temperature: standard uncertainty by the temperature.
        u_stability: standard uncertainty by the stability over time.
        u_gauges: standard uncertainty by differences between gauges.
        u_other: standard uncertainty by other influences.
        largest_error: maximum permissible error, in place of calibration, bias and linearity.
        system_limit: largest Q of the measuring system, as a share.
        process_limit: largest Q of the process, as a share.
    """

    tolerance: float
    resolution: float | None = None
    corrected: bool = False
    u_calibration: float | None = None
    u_linearity: float | None = None
    u_object: float | None = None
    u_temperature: float | None = None
    u_stability: float | None = None
    u_gauges: float | None = None
    u_other: float | None = None
    largest_error: float | None = None
    system_limit: float = 0.15
    process_limit: float = 0.30

    @property
    def stated(self) -> dict[str, float]:
        """Stated uncertainties by the names of ISO 22514-7."""
        each = {
            "CAL": self.u_calibration,
            "LIN": self.u_linearity,
            "OBJ": self.u_object,
            "T": self.u_temperature,
            "STAB": self.u_stability,
            "GV": self.u_gauges,
            "rest": self.u_other,
        }
        return {name: u for name, u in each.items() if u is not None}
