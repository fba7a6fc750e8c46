"""What the bench file says of light and colour, as spectra."""

from anisoscope.base.errors import ModelError, RigFileError, UsageError
from anisoscope.sim.bench.benchfile import BenchFile
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities


def vision_of(file: BenchFile) -> Vision:
    """The sensor's channels under the bench's lamp.

    Raises:
        RigFileError: a spectrum that the bench file names cannot be used.
    """
    try:
        illuminant = find_illuminant(file.optics.spectrum)
    except UsageError as problem:
        raise RigFileError(f"optics.spectrum: {problem}") from None
    try:
        sensitivities = find_sensitivities(file.sensor.sensitivities, file.sensor.filters)
    except UsageError as problem:
        raise RigFileError(f"sensor.sensitivities: {problem}") from None
    try:
        return Vision(illuminant, sensitivities)
    except ModelError as problem:
        raise RigFileError(f"sensor.sensitivities, optics.spectrum: {problem}") from None
