"""The virtual rig as a whole: one stage, one light, one sample, one sensor, that all see each other."""

import importlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RigFileError, UsageError
from anisoscope.sim.bench.benchfile import BenchFile, CodePart, OpticsPart, SensorPart, read_bench
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import LIGHT, Mount, build
from anisoscope.sim.bench.firmware.device import Firmware
from anisoscope.sim.bench.firmware.light import LightFirmware
from anisoscope.sim.bench.lamp import Lamp
from anisoscope.sim.bench.optics import PLATE, image_of_fixture, image_of_surface, pixel_from_mm, vignette
from anisoscope.sim.bench.samples import Sample, build_sample
from anisoscope.sim.bench.sensor import Mosaic, Sensor
from anisoscope.sim.light.geometry import Convention, Pose, directions, seating_rotation

Image = npt.NDArray[np.float32]

_FORMATS = {"datamatrix": "DataMatrix", "code128": "Code128", "qr": "QRCode"}
_DOTS_PER_MODULE = 16


def image_of_code(
    code: CodePart, part: OpticsPart, sensor: SensorPart, angle_deg: float, tilt_deg: float, plate: float
) -> Image:
    """What the label with the code adds to the reflectance of the plate, (rows, cols).

    Args:
        code: what is printed where.
        part: the optics.
        sensor: the sensor.
        angle_deg: true angle of the sample.
        tilt_deg: tilt of the camera.
        plate: reflectance of the plate under the label.

    Raises:
        RigFileError: the text cannot be written in such a code.
    """
    dots = np.kron(printed(code), np.ones((_DOTS_PER_MODULE, _DOTS_PER_MODULE), dtype=np.float32))
    dot_mm = code.width_mm / dots.shape[1]
    sigma = float(np.sqrt(part.blur_um**2 + part.pixel_um**2 / 12.0) / (1000.0 * dot_mm))
    margin = int(4 * sigma) + 1
    label = cv2.GaussianBlur(np.pad(dots - plate, margin), (0, 0), max(sigma, 1e-3))
    rows, cols = label.shape
    turn = np.radians(code.turned_deg)
    cos, sin = dot_mm * np.cos(turn), dot_mm * np.sin(turn)
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    linear = np.array([[cos, sin], [sin, -cos]])  # rows count downwards, y upwards
    dot_to_mm = np.eye(3)
    dot_to_mm[:2, :2] = linear
    dot_to_mm[:2, 2] = np.array([code.x_mm, code.y_mm]) - linear @ middle
    matrix = pixel_from_mm(part, sensor, angle_deg, tilt_deg) @ dot_to_mm
    return np.asarray(cv2.warpAffine(label, matrix, (sensor.cols, sensor.rows), flags=cv2.INTER_LINEAR))


def printed(code: CodePart) -> Image:
    """Reflectance of the label, one element a module, its quiet zone included.

    Raises:
        RigFileError: the text cannot be written in such a code.
    """
    library: Any = importlib.import_module("zxingcpp")  # compiled, without types
    kind = getattr(library.BarcodeFormat, _FORMATS[code.kind])
    try:
        barcode = library.create_barcode(code.text, kind, options="gs1" if code.gs1 else "")
        black = np.asarray(barcode.to_image(scale=1)) < 128
    except (ValueError, RuntimeError) as problem:
        raise RigFileError(
            f"sample.code: {code.text!r} cannot be written as {code.kind}: {problem}"
        ) from problem
    return np.where(black, code.black, code.white).astype(np.float32)


Counts = npt.NDArray[np.uint16]


class Scenes:
    """Pictures without noise that benches of one process share: equal parts in equal poses look alike.

    Attributes:
        most: how many are kept; none by default, and every bench keeps the last one of its own.
    """

    def __init__(self, most: int = 0) -> None:
        self.most = most
        self._kept: OrderedDict[Hashable, FloatArray] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, render: Callable[[], FloatArray]) -> FloatArray:
        """The picture of a key, rendered where it is not kept; not to be written to."""
        with self._lock:
            found = self._kept.get(key)
        if found is None:
            found = render()
            found.flags.writeable = False
        with self._lock:
            self._kept[key] = found
            self._kept.move_to_end(key)
            while len(self._kept) > self.most:
                self._kept.popitem(last=False)
        return found


SCENES = Scenes()


class Bench:
    """A virtual rig built from a bench file.

    The stage's firmware turns ``axis``; the light's firmware, or the setter of ``light_on``, switches ``lamp``; the
    camera sees the sample at the angle where the axis *really* is, as bright as the lamp really is. Everything random
    comes from the file's seed.

    Raises:
        RigFileError: a spectrum that the file names cannot be used.
    """

    def __init__(self, file: BenchFile) -> None:
        self.file = file
        sample_rng, sensor_rng, light_rng = np.random.default_rng(file.seed).spawn(3)
        self.axis = RotaryAxis(time_scale=file.stage.time_scale, backlash_deg=file.stage.backlash_deg)
        mounts = [Mount(self.axis, file.stage.address)]
        self.tilt_axis: RotaryAxis | None = None
        if file.tilt is not None:
            self.tilt_axis = RotaryAxis(time_scale=file.stage.time_scale, backlash_deg=file.tilt.backlash_deg)
            mounts.append(Mount(self.tilt_axis, file.tilt.address))
        self.stage_firmware = build(
            file.stage.protocol, mounts, model=file.stage.model, faults=file.stage.faults
        )
        self.sensor = Sensor(file.sensor, sensor_rng)
        self.lamp = Lamp(file.optics, light_rng)
        self.light_firmware = LightFirmware(self.lamp)
        self._sample_rng = sample_rng
        self._sample: Sample | None = None
        self._mosaic = Mosaic(file.sensor, file.vision().strengths())
        self._scene: tuple[tuple[float, float], FloatArray] | None = None
        self._lock = threading.Lock()

    @property
    def light_on(self) -> bool:
        """Whether the lamp shines; setting it switches the lamp to full level, or off."""
        return self.lamp.level > 0.0

    @light_on.setter
    def light_on(self, on: bool) -> None:
        self.lamp.level = 1.0 if on else 0.0

    @property
    def sample_angle_deg(self) -> float:
        """The angle at which the sample truly stands now."""
        sense = 1.0 if self.file.stage.turns == "ccw" else -1.0
        return sense * (self.axis.load_deg() - self.file.stage.zero_deg)

    @property
    def tilt_deg(self) -> float:
        """The angle by which the camera arm truly leans now."""
        fixed, part = self.file.geometry.tilt_deg, self.file.tilt
        if self.tilt_axis is None or part is None:
            return fixed
        return fixed + part.sign * (self.tilt_axis.load_deg() - part.zero_deg)

    def device(self, name: str) -> Firmware:
        """The device that answers on a line of this rig: the stage by its protocol, or the ``light``.

        Raises:
            UsageError: this rig has no such device.
        """
        if name == LIGHT:
            return self.light_firmware
        if name != self.file.stage.protocol:
            raise UsageError(f"the stage of this bench speaks {self.file.stage.protocol}, not {name}")
        return self.stage_firmware

    def photograph(self, exposure_s: float, gain: float) -> Counts:
        """One frame of the sensor, (rows, cols) counts."""
        with self._lock:
            optics = self.file.optics
            signal = np.zeros((self.file.sensor.rows, self.file.sensor.cols))
            lamp = 0.0 if optics.lens_cap else self.lamp.brightness()
            if lamp > 0.0:
                per_second = self._radiance_on_sensor() * (lamp * optics.electrons)
                if self.file.sensor.auto_exposure == "on":
                    exposure_s = self.sensor.automatic_exposure_s(per_second)
                signal = per_second * exposure_s
            return self.sensor.expose(signal, exposure_s, gain)

    def _radiance_on_sensor(self) -> FloatArray:
        pose = self.sample_angle_deg, self.tilt_deg
        if self._scene is None or self._scene[0] != pose:
            found = (
                SCENES.get((self._scene_key(), pose), lambda: self._render(*pose)) if SCENES.most else None
            )
            self._scene = (pose, self._render(*pose) if found is None else found)
        return self._scene[1]

    def _scene_key(self) -> Hashable:
        """All but the pose that a picture without noise depends on."""
        sample = self.file.sample.file
        changed = None if sample is None else Path(sample).stat().st_mtime_ns
        return self.file.model_dump_json(exclude={"stage", "tilt"}), changed

    def _render(self, angle_deg: float, tilt_deg: float) -> FloatArray:
        file = self.file
        convention = Convention(light_angle_deg=file.geometry.light_angle_deg)
        to_light, to_camera = directions((Pose(angle_deg, tilt_deg),), convention)
        cos_light = to_light[0, 2]
        shade = vignette(file.optics, file.sensor)
        if file.sample.kind == "white-tile":
            image = np.full(shade.shape, file.sample.reflectance / np.pi * cos_light)
        else:
            picture, cover = self._image_of_sample(angle_deg, tilt_deg, to_light, to_camera)
            image = self._mosaic.pick(picture).astype(np.float64)
            if file.fixture is not None:
                around = image_of_fixture(file.fixture, file.optics, file.sensor, angle_deg, tilt_deg)
                if (code := file.sample.code) is not None:
                    around += image_of_code(code, file.optics, file.sensor, angle_deg, tilt_deg, PLATE)
                image = image + (1.0 - cover) * around / np.pi * cos_light
        return np.asarray((image + file.optics.stray_radiance) * shade * self._mosaic.passed)

    def _image_of_sample(
        self, angle_deg: float, tilt_deg: float, to_light: FloatArray, to_camera: FloatArray
    ) -> tuple[Image, Image]:
        """(channels, rows, cols) image of the sample on the sensor, and the share of each pixel that it covers.

        The directions are (1, 3), in the frame of the stage's plate.
        """
        if self._sample is None:
            self._sample = build_sample(self.file, self._sample_rng)
        sample, file = self._sample, self.file
        seat = seating_rotation(*file.sample.seating_tilt_deg)
        shown = [
            image_of_surface(channel, sample.pixel_um, file.optics, file.sensor, angle_deg, tilt_deg)
            for channel in sample.radiance((to_light @ seat)[0], (to_camera @ seat)[0])
        ]
        return np.stack([image for image, _ in shown]), shown[0][1]


@lru_cache(maxsize=4)
def _bench_of(path: Path, _modified_ns: int) -> Bench:
    return Bench(read_bench(path))


def shared_bench(path: Path | str) -> Bench:
    """The bench of a file: stage, light and camera of one process get the same one.

    A file that changed on disk makes a new bench.

    Raises:
        RigFileError: the file is missing or wrong.
    """
    resolved = Path(path).resolve()
    if not resolved.is_file():
        return Bench(read_bench(resolved))  # raises the error that names the file
    return _bench_of(resolved, resolved.stat().st_mtime_ns)
