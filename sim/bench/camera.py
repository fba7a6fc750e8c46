"""The simulated camera and light: drivers like any other, found through the registry."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, RigFileError
from anisoscope.rig.camera import Camera, CameraInfo, CameraSettings
from anisoscope.rig.cameras.linearised import linearised
from anisoscope.sim.bench.bench import Bench, shared_bench
from anisoscope.sim.bench.camera_client import RemoteCamera


class SimulatedCamera:
    """A camera that photographs a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._settings: CameraSettings | None = None
        part = bench.file.sensor
        self.info = CameraInfo(
            model="virtual camera (EMVA 1288 linear model)",
            serial=f"SIM-{bench.file.optics.pixel_um:g}UM",
            rows=part.rows,
            cols=part.cols,
            bit_depth=part.bit_depth,
            black_level=part.black_level,
            linear=part.gamma == 1.0,
            auto_exposure=part.auto_exposure != "none",
            filters=part.filters,
        )

    def configure(self, exposure_s: float, gain: float) -> CameraSettings:
        """Set exposure in seconds and gain; returns what the camera really uses.

        Raises:
            CameraError: outside the range of the camera.
        """
        if not 1e-6 <= exposure_s <= 60.0:
            raise CameraError(f"the exposure must lie between 1 µs and 60 s, not {exposure_s} s")
        if not 0.1 <= gain <= 24.0:
            raise CameraError(f"the gain must lie between 0.1 and 24, not {gain}")
        self._settings = CameraSettings(exposure_s=exposure_s, gain=gain)
        return self._settings

    def grab(self) -> npt.NDArray[np.uint16]:
        """One frame, (rows, cols) counts.

        Raises:
            CameraError: ``configure`` was not called.
        """
        if self._settings is None:
            raise CameraError("the camera was asked for a frame before exposure and gain were set")
        return self._bench.photograph(self._settings.exposure_s, self._settings.gain)

    def close(self) -> None:
        """Nothing is held."""


class SimulatedLight:
    """The light of a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def on(self) -> None:
        """Switch on."""
        self._bench.light_on = True

    def off(self) -> None:
        """Switch off."""
        self._bench.light_on = False

    def close(self) -> None:
        """Switch off and let go."""
        self.off()


def open_camera(
    *,
    bench: str | Path | None = None,
    port: str | None = None,
    timeout_s: float = 180.0,
    response: str | Path = "",
) -> Camera:
    """Open the camera of a bench.

    Args:
        bench: file of a bench in this process.
        port: ``host:port`` where ``rig sim bench`` serves the bench of another process.
        timeout_s: with `port`: longest wait for an answer, in seconds, on top of the exposure.
        response: file of a response curve of this camera, which makes counts linear.

    Raises:
        RigFileError: neither a bench nor a port, or both; or the bench file is wrong.
        NotConnected: nobody serves on the port.
    """
    if (bench is None) == (port is None):
        raise RigFileError("camera.options: a simulated camera needs bench = FILE or port = HOST:PORT")
    camera: Camera
    if port is not None:
        camera = RemoteCamera(port, timeout_s=timeout_s)
    else:
        assert bench is not None
        camera = SimulatedCamera(shared_bench(bench))
    return linearised(camera, response) if response else camera


def open_light(*, bench: str | Path) -> SimulatedLight:
    """Open the light of a bench file."""
    return SimulatedLight(shared_bench(bench))
