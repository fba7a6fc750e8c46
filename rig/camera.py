"""What a camera is: linear raw counts, with the settings that were really used."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

from anisoscope.base.errors import CameraError

if TYPE_CHECKING:  # who only moves a stage does without
    import numpy as np
    import numpy.typing as npt

Compression = Literal["none", "zlib", "jpeg-xl"]
"""How the counts of a frame are packed on disk; all are lossless, and ``jpeg-xl`` needs the package imagecodecs."""
UNCALIBRATED = (
    "uncalibrated: the camera does not count in proportion to light, and no response curve is given; such contrasts "
    "serve to compare parts on this rig, not with a prediction (see `anisoscope calibrate response`)"
)


@dataclass(frozen=True)
class CameraInfo:
    """Fixed properties of a camera.

    Attributes:
        model: maker's name of the camera.
        serial: serial number.
        rows, cols: shape of its frames.
        bit_depth: bits per pixel; full scale is 2**bit_depth − 1 counts.
        black_level: counts of a pixel without light.
        pixel_pitch_um: distance of pixels on the sensor, if known.
        linear: whether counts grow in proportion to light; if not, contrasts are uncalibrated.
        auto_exposure: whether it has automatic exposure or gain, so that one has to prove that they are off.
        filters: the colour filters on its pixels, named by the first two rows of the mosaic, such as "rggb"; "mono" has
            none. See `anisoscope.rig.bayer`.
        repeats: whether its pictures are those of its last start again, noise included, as a simulation's may be.

    Raises:
        CameraError: no such mosaic is known.
    """

    model: str
    serial: str
    rows: int
    cols: int
    bit_depth: int
    black_level: float
    pixel_pitch_um: float | None = None
    linear: bool = True
    auto_exposure: bool = False
    filters: str = "mono"
    repeats: bool = False

    def __post_init__(self) -> None:
        from anisoscope.rig.bayer import FILTERS  # noqa: PLC0415 - loads numpy

        if self.filters not in FILTERS:
            raise CameraError(
                f"{self.model}: no colour filters are named {self.filters!r}; known: {', '.join(FILTERS)}"
            )


@dataclass(frozen=True)
class CameraSettings:
    """Settings as the camera reports them after they were set: exposure in seconds, gain as a factor."""

    exposure_s: float
    gain: float


@runtime_checkable
class Camera(Protocol):
    """A camera that delivers single frames. Every method may raise `CameraError` or `NotConnected`."""

    @property
    def info(self) -> CameraInfo:
        """Fixed properties of the camera."""
        ...

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain as a factor; return what the camera really uses."""
        ...

    def grab(self) -> "npt.NDArray[np.uint16]":
        """Return the next frame that was exposed wholly under the present settings.

        Linear raw counts, right-justified, (rows, cols).
        """
        ...

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        ...
