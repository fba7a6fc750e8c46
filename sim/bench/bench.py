"""The virtual rig as a whole: one stage, one light, one sample, one sensor, that all act on each other.

A new kind of sample is a class with the two members of `Sample` in a module of its own, a table of its own in the bench
file (`SamplePart`), a word for it in ``SamplePart.kind``, and a line in `build_sample`. Poses, seating, lens, lamp
level and noise belong to the bench; a sample does not know them.
"""

import copy
import hashlib
import importlib
import io
import threading
from collections.abc import Callable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.clock import clock_of
from anisoscope.base.errors import HeightMapError, RigFileError, UsageError
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.bench.benchfile import (
    BenchFile,
    CodePart,
    FilterPart,
    MaterialPart,
    OpticsPart,
    SamplePart,
    SensorPart,
    read_bench,
)
from anisoscope.sim.bench.faults import Faults
from anisoscope.sim.bench.firmware.axis import LinearAxis, RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import COOLLED, LIGHT, WHEEL, Mount, build
from anisoscope.sim.bench.firmware.coolled import CoolLedFirmware
from anisoscope.sim.bench.firmware.device import Firmware
from anisoscope.sim.bench.firmware.fw102c import PLACES, WheelFirmware
from anisoscope.sim.bench.firmware.light import LightFirmware
from anisoscope.sim.bench.optics import (
    PLATE,
    Lamp,
    defocused,
    image_of_fixture,
    image_of_surface,
    pixel_from_mm,
    vignette,
)
from anisoscope.sim.bench.plate import PlateSample
from anisoscope.sim.bench.printpart import PrintPart
from anisoscope.sim.bench.sensor import Mosaic, Sensor
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.pathtracer.plastic import Plastic

Image = npt.NDArray[np.float32]

PIXEL_X_UM = 1.0
PIXEL_Y_UM = 2.0
MOST_REFLECTIONS = 6
MOST_MISSING = 0.25
POSES_REMEMBERED = 4
SAME_DIRECTION = 9  # decimals of the directions of one pose


class Sample(Protocol):
    """A sample on the stage, centred on its axis.

    A perfect white diffuser that faces the lamp has the radiance 1/π, in every channel alike. So a grey sample is
    equally bright in all channels; how much less light one colour filter passes than another is not the sample's
    affair (`anisoscope.sim.bench.sensor`).
    """

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of the pixels of `radiance`."""
        ...

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(channels, rows, cols) radiance in the sample's own frame; row index rises with +y, NaN is not known.

        One channel for a sample that is grey, or a camera without colour filters; otherwise three: red, green, blue,
        each the mean over wavelengths under the bench's lamp as the filter of that colour weighs them
        (`anisoscope.sim.light.colour.vision.Vision.weights`).

        Args:
            to_light: (3,) unit vector in the frame of the sample as it is seated.
            to_camera: (3,) likewise.
        """
        ...


class RidgedSurface(NamedTuple):
    """A height map, and the pitch after which it repeats across, if it does."""

    surface: HeightMap
    pitch_um: float | None


class ReliefSample:
    """A height map of plastic: grey. Pictures of the last poses are remembered.

    It is rendered by the path tracer, which shares nothing with the prediction (`anisoscope.sim.pathtracer.tracer`).
    """

    def __init__(self, made: RidgedSurface, file: BenchFile) -> None:
        self.surface = made.surface
        self._pitch_um, self._file = made.pitch_um, file

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of a facet."""
        return self.surface.pixel_y_um, self.surface.pixel_x_um

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(1, rows, cols) radiance of every facet."""
        seen = tuple(float(one) for side in (to_light, to_camera) for one in np.round(side, SAME_DIRECTION))
        return self._shown(seen)

    @cached_property
    def _shown(self) -> Callable[[tuple[float, ...]], Image]:
        from anisoscope.sim.pathtracer.tracer import PathTracer

        part, distance = self._file.sample, self._file.optics.lamp_distance_mm
        tracer = PathTracer(
            self.surface,
            plastic(part.material),
            pitch_um=self._pitch_um,
            reflections=MOST_REFLECTIONS if part.reflections else 1,
            lamp_distance_um=None if distance is None else 1000.0 * distance,
            seed=self._file.seed,
        )

        @lru_cache(maxsize=POSES_REMEMBERED)
        def shown(seen: tuple[float, ...]) -> Image:
            found = tracer.radiance(np.array(seen[:3]), np.array(seen[3:]))[None]
            found.flags.writeable = False
            return found

        return shown


def build_sample(file: BenchFile, rng: np.random.Generator) -> Sample:
    """The sample of a bench, but for a white tile, which has no edges and fills the picture.

    Raises:
        HeightMapError: the file of a height map cannot be read.
        RigFileError: what the bench file names cannot be used.
    """
    part = file.sample
    if part.kind == "print":
        from anisoscope.sim.bench.prints import PrintSample

        lamp_mm, raster_um = file.optics.lamp_distance_mm, file.optics.pixel_um
        return PrintSample(part.print or PrintPart(), part.size_mm, raster_um, file.vision(), rng, lamp_mm)
    if part.kind == "wafer":
        from anisoscope.sim.bench.wafer import build_wafer

        assert part.wafer is not None  # the bench file's own check
        return build_wafer(part.wafer, part.size_mm, rng)
    if part.kind == "plate":
        assert part.plate is not None  # the bench file's own check
        return PlateSample(part.plate, plastic(part.material), rng, reflections=part.reflections)
    made = build_surface(part, rng)
    if file.faults.upside_down:
        made = made._replace(surface=made.surface.with_height(made.surface.height_um[:, ::-1]))
    return ReliefSample(made, file)


def plastic(part: MaterialPart) -> Plastic:
    """The material that a bench file describes."""
    return Plastic(part.alpha_along, part.alpha_across, part.albedo, part.index, part.lobe)


def build_surface(part: SamplePart, rng: np.random.Generator) -> RidgedSurface:
    """The surface of a sample, as large as the sample, in whole pitches.

    Raises:
        HeightMapError: the file cannot be read, or too much of the map is missing.
    """
    if part.kind == "height-map":
        from anisoscope.profiles.files.load import read_height_map

        assert part.file is not None  # the bench file's own check
        found = read_height_map(part.file)
        if found.missing_share > MOST_MISSING:
            raise HeightMapError(
                f"{part.file}: {found.missing_share:.1%} of the heights are missing (limit {MOST_MISSING:.0%}): "
                "fill the gaps in the instrument's software"
            )
        return RidgedSurface(_repeat(found, part), None)
    pitches = max(1, int(part.size_mm * 1000.0 // part.pitch_um))
    cols = round(pitches * part.pitch_um / PIXEL_X_UM) + 1
    rows = round(part.size_mm * 1000.0 / PIXEL_Y_UM) + 1
    design = RidgeDesign(pitch_um=part.pitch_um, ridge_angle_deg=part.ridge_angle_deg)
    surface = ridges(design, (rows, cols), (PIXEL_Y_UM, PIXEL_X_UM))
    if part.resolved_alpha > 0:
        alpha = part.resolved_alpha
        surface = add_facet_roughness(
            surface, alpha_along=alpha, alpha_across=alpha, correlation_um=part.correlation_um, rng=rng
        )
    if part.burr_coverage > 0:
        from anisoscope.profiles.defects import burrs

        surface = burrs(surface, part.burr_coverage, pitch_um=part.pitch_um, rng=rng).map
    return RidgedSurface(surface, part.pitch_um)


def _repeat(surface: HeightMap, part: SamplePart) -> HeightMap:
    """Lay copies of a map side by side, every other one mirrored so that heights meet, up to the sample's size."""
    tile = surface.height_um
    tall = np.concatenate([tile, tile[::-1]])
    size_um = part.size_mm * 1000.0
    rows, cols = (round(size_um / pixel) + 1 for pixel in (surface.pixel_y_um, surface.pixel_x_um))
    repeats = -(-rows // tall.shape[0]), -(-cols // tall.shape[1])
    return surface.with_height(np.tile(tall, repeats)[:rows, :cols])


_FORMATS = {"datamatrix": "DataMatrix", "code128": "Code128", "qr": "QRCode"}
_DOTS_PER_MODULE = 16


def image_of_code(
    code: CodePart,
    part: OpticsPart,
    sensor: SensorPart,
    angle_deg: float,
    tilt_deg: float,
    shift_mm: tuple[float, float],
    plate: float,
) -> Image:
    """(rows, cols) reflectance that the label with the code adds to the plate.

    Args:
        code: what is printed where.
        part: the optics.
        sensor: the sensor.
        angle_deg: true angle of the sample.
        tilt_deg: tilt of the camera.
        shift_mm: how far the stage is shifted, to the right and up.
        plate: reflectance of the plate under the label.

    Raises:
        RigFileError: the text cannot be written in such a code.
    """
    import cv2

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
    matrix = pixel_from_mm(part, sensor, angle_deg, tilt_deg, shift_mm) @ dot_to_mm
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


class Bench:
    """A virtual rig built from a bench file.

    The stage's firmware turns ``axis``; the light's firmware, or the setter of ``light_on``, switches ``lamp``; of
    several ``lamps``, of which it is the first, a CoolLED controller. The camera sees the sample at the angle where the
    axis *really* is, as bright as the lamps really are. Everything random comes from the file's seed.

    Raises:
        RigFileError: a spectrum that the file names cannot be used.
    """

    def __init__(self, file: BenchFile) -> None:
        self.file = file
        sample_rng, sensor_rng, light_rng = np.random.default_rng(file.seed).spawn(3)
        scale = file.stage.time_scale
        clock = clock_of(scale)
        self.axis = RotaryAxis(time_scale=scale, backlash_deg=file.stage.backlash_deg, clock=clock)
        lines = {file.stage.protocol: [Mount(self.axis, file.stage.address)]}
        self.tilt_axis: RotaryAxis | None = None
        if file.tilt is not None:
            self.tilt_axis = RotaryAxis(time_scale=scale, backlash_deg=file.tilt.backlash_deg, clock=clock)
            lines[file.stage.protocol].append(Mount(self.tilt_axis, file.tilt.address))
        self.linear: dict[str, LinearAxis] = {}
        for name, part in file.linear.items():
            axis = LinearAxis(time_scale=scale, backlash_deg=part.backlash_mm, clock=clock)
            self.linear[name] = axis
            lines.setdefault(part.protocol, []).append(Mount(axis, part.address, part.model))
        self.lines = {
            protocol: build(
                protocol,
                mounts,
                model=file.stage.model if protocol == file.stage.protocol else "",
                faults=file.stage.faults if protocol == file.stage.protocol else (),
            )
            for protocol, mounts in lines.items()
        }
        self.sensor = Sensor(file.sensor, sensor_rng)
        self.lamp = Lamp(file.optics, light_rng)
        others = [(letter, light_rng.spawn(1)[0]) for letter in list(file.lamps)[1:]]
        self.lamps = {next(iter(file.lamps), ""): self.lamp}
        self.lamps |= {letter: Lamp(file.optics, rng) for letter, rng in others}
        self.light_firmware: LightFirmware | CoolLedFirmware
        if file.lamps:
            model = "pE-4000" if "D" in file.lamps else "pE-300"
            self.light_firmware = CoolLedFirmware(dict(sorted(self.lamps.items())), model)
        else:
            self.light_firmware = LightFirmware(self.lamp)
        wheel = next(name for name, places in PLACES.items() if places >= len(file.filters))
        self.wheel = WheelFirmware(wheel, clock=clock, time_scale=scale)
        self._sample_rng = sample_rng
        self._faults = Faults(file)
        self._samples: dict[float | None, Sample] = {}
        self._mosaic = Mosaic(file.sensor, file.vision().strengths())
        self._scenes: dict[_Shine, tuple[_Pose, Image]] = {}
        self._sharp: dict[_Shine, tuple[_InFocus, FloatArray]] = {}
        self._lock = threading.Lock()

    def lay(self, sample: SamplePart) -> None:
        """Lay another sample on the stage; everything else stays as it is, axes and lamps too."""
        with self._lock:
            self.file = self.file.model_copy(update={"sample": sample})
            for known in (self._samples, self._scenes, self._sharp):
                known.clear()

    @property
    def light_on(self) -> bool:
        """Whether the lamp shines; set, it switches the lamp to full level, or off."""
        return self.lamp.level > 0.0

    @light_on.setter
    def light_on(self, on: bool) -> None:
        self.lamp.level = 1.0 if on else 0.0

    @property
    def sample_angle_deg(self) -> float:
        """True angle of the sample now."""
        sense = 1.0 if self.file.stage.turns == "ccw" else -1.0
        return sense * (self.axis.load_deg() - self.file.stage.zero_deg)

    @property
    def tilt_deg(self) -> float:
        """The angle by which the camera arm truly leans now."""
        fixed, part = self.file.geometry.tilt_deg, self.file.tilt
        if self.tilt_axis is None or part is None:
            return fixed
        return fixed + part.sign * (self.tilt_axis.load_deg() - part.zero_deg)

    def _moved_mm(self, name: str) -> float:
        """True travel of a linear axis; 0 without it."""
        part = self.file.linear.get(name)
        return 0.0 if part is None else part.sign * (self.linear[name].load_deg() - part.zero_mm)

    @property
    def shift_mm(self) -> tuple[float, float]:
        """True shift of the stage, to the right and up."""
        return self._moved_mm("x"), self._moved_mm("y")

    @property
    def defocus_mm(self) -> float:
        """True height of the plate below the middle of the picture above the plane of focus."""
        turn = np.radians(self.sample_angle_deg)
        x, y = self.shift_mm
        seen = -x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) - y * np.cos(turn)
        return self._moved_mm("z") + self.file.tray.height_mm(*(float(one) for one in seen))

    def device(self, name: str) -> Firmware:
        """Device on a line of this rig: the axes of a protocol, ``light`` or ``coolled``, or ``fw102c``.

        Raises:
            UsageError: this rig has no such device.
        """
        if name == (COOLLED if self.file.lamps else LIGHT):
            return self.light_firmware
        if name == WHEEL and self.file.filters:
            return self.wheel
        if name in {LIGHT, COOLLED, WHEEL}:
            raise UsageError(
                "this bench has one lamp (light) and no wheel, unless its file has tables [lamps.A] and [[filters]]"
            )
        if name not in self.lines:
            raise UsageError(f"the axes of this bench speak {' and '.join(self.lines)}, not {name}")
        return self.lines[name]

    def photograph(self, exposure_s: float, gain: float) -> Counts:
        """One frame of the sensor, (rows, cols) counts."""
        with self._lock:
            optics, faults = self.file.optics, self._faults
            shines = [] if optics.lens_cap else self._shining()
            lit = bool(shines)
            faults.attend(self._place, lit)
            per_second = np.zeros((self.file.sensor.rows, self.file.sensor.cols))
            for shine, lamp in shines:
                per_second += self._radiance_on_sensor(shine) * np.float64(lamp * optics.electrons)
            per_second = faults.signal(per_second, lit)
            if lit and self.file.sensor.auto_exposure == "on":
                exposure_s = self.sensor.automatic_exposure_s(per_second)
            exposure_s, gain = faults.settings(per_second, exposure_s, gain, lit)
            return faults.delivered(self.sensor.expose(per_second * exposure_s, exposure_s, gain), lit)

    @property
    def _place(self) -> tuple[float, float]:
        return round(self.sample_angle_deg, 3), round(self.tilt_deg, 3)

    def _shining(self) -> list[tuple["_Shine", float]]:
        """The lamps that shine during the next frame, behind the filter, and their brightness."""
        found = []
        place = self.wheel.place - 1
        beam = self.file.filters[place] if place < len(self.file.filters) else FilterPart()
        for letter, lamp in self.lamps.items():
            part = self.file.lamps[letter] if letter else None  # type: ignore[index]
            level = lamp.brightness() * beam.passes
            angle = self.file.geometry.light_angle_deg if part is None else part.light_angle_deg
            own = None if part is None else part.wavelength_nm
            if level > 0.0:
                share = 1.0 if part is None else part.brightness
                found.append((_Shine(angle, beam.wavelength_nm or own), share * level))
        return found

    def _radiance_on_sensor(self, shine: "_Shine") -> Image:
        turned = self._faults.part_deg(self._place)
        pose = _Pose(self.sample_angle_deg, self.tilt_deg, self.shift_mm, self.defocus_mm, turned)
        if shine not in self._scenes or self._scenes[shine][0] != pose:
            axes = (self.axis, self.tilt_axis, *self.linear.values())
            moving = any(axis is not None and axis.busy() for axis in axes)
            # what a live view shows on the way is of no use to another process, nor is one of many planes of focus
            passing = moving or bool(self.linear)
            self._scenes[shine] = (
                pose,
                self._render(pose, shine) if passing else self._cached_scene(pose, shine),
            )
        return self._scenes[shine][1]

    def _cached_scene(self, pose: "_Pose", shine: "_Shine") -> Image:
        """The scene of a pose, from the cache of all processes."""
        exclude = {"stage", "tilt", "x", "y", "z", "lamps", "filters", "faults"}
        key = {"bench": _with_content(self.file.model_dump(mode="json", exclude=exclude)), "pose": pose[:2]}
        if self.file.lamps or self.file.filters:
            key["light"] = shine
        seen = self.file.faults.model_dump(include=self.file.faults.seen, exclude_defaults=True)
        if seen or pose.part_deg:
            key["faults"] = (seen, pose.part_deg)
        entry = Cache().entry("scenes", key, __name__)
        return entry.result(lambda: self._render(pose, shine), _packed, _unpacked)

    def _render(self, pose: "_Pose", shine: "_Shine") -> Image:
        if shine not in self._sharp or self._sharp[shine][0] != pose.in_focus:
            self._sharp[shine] = pose.in_focus, self._in_focus(pose, shine)
        file, picture = self.file, self._sharp[shine][1]
        picture = self._faults.through_lens(picture, pose.angle_deg, pose.tilt_deg)
        if "z" in self.linear:
            picture = np.stack([defocused(channel, file.optics, pose.defocus_mm) for channel in picture])
        shade = vignette(file.optics, file.sensor)
        scene = (self._mosaic.pick(picture) + file.optics.stray_radiance) * shade * self._mosaic.passed
        return np.asarray(scene, dtype=np.float32)

    def _in_focus(self, pose: "_Pose", shine: "_Shine") -> FloatArray:
        """(channels, rows, cols) radiance on the sensor, but for vignette and stray light."""
        file = self.file
        convention = Convention(light_angle_deg=shine.angle_deg)
        to_light, _ = directions((Pose(pose.angle_deg, pose.tilt_deg),), convention)
        cos_light = to_light[0, 2]
        if file.sample.kind == "white-tile":
            shape = (1, file.sensor.rows, file.sensor.cols)
            return np.full(shape, file.sample.reflectance / np.pi * cos_light)
        on_part = pose._replace(angle_deg=pose.angle_deg + pose.part_deg)
        seen_from = directions((Pose(on_part.angle_deg, pose.tilt_deg),), convention)
        size = file.sensor.rows, file.sensor.cols
        picture, cover = np.zeros((1, *size), np.float32), np.zeros(size, np.float32)
        if file.sample.kind != "none":
            picture, cover = self._image_of_samples(on_part, shine, *seen_from)
        image = picture.astype(np.float64)
        if file.fixture is not None:
            view = (file.optics, file.sensor, pose.angle_deg, pose.tilt_deg)
            around = image_of_fixture(file.fixture, *view, pose.shift_mm, file.tray.parts)
            if (code := file.sample.code) is not None:
                around += image_of_code(code, *view, pose.shift_mm, PLATE)
            image = image + (1.0 - cover) * around / np.pi * cos_light
        return image

    def _image_of_samples(
        self, pose: "_Pose", shine: "_Shine", to_light: FloatArray, to_camera: FloatArray
    ) -> tuple[Image, Image]:
        """(channels, rows, cols) image of the samples on the sensor, and the share of each pixel that they cover.

        The directions are (1, 3), in the frame of the stage's plate.
        """
        sample, file = self._sample_under(shine), self.file
        seat = seating_rotation(*file.sample.seating_tilt_deg)
        radiance = sample.radiance((to_light @ seat)[0], (to_camera @ seat)[0])
        view = (sample.pixel_um, file.optics, file.sensor, pose.angle_deg, pose.tilt_deg, pose.shift_mm)
        shown = [
            [image_of_surface(channel, *view, centre_mm) for channel in radiance]
            for centre_mm in file.tray.parts
        ]
        images = [np.stack([image for image, _ in channels]) for channels in shown]
        return sum(images[1:], images[0]), sum((one[0][1] for one in shown[1:]), shown[0][0][1])

    def _sample_under(self, shine: "_Shine") -> Sample:
        """The sample; a wafer shows something else under a lamp of another wavelength."""
        wafer = self.file.sample.wafer
        nm = shine.wavelength_nm if wafer is not None else None
        if nm not in self._samples:
            file = self.file
            if nm is not None and wafer is not None:
                part = file.sample.model_copy(
                    update={"wafer": wafer.model_copy(update={"wavelength_nm": nm})}
                )
                file = file.model_copy(update={"sample": part})
            self._samples[nm] = build_sample(file, copy.deepcopy(self._sample_rng))
        return self._samples[nm]


class _Shine(NamedTuple):
    """Direction of a lamp, and its wavelength where it is not that of the sample's table."""

    angle_deg: float
    wavelength_nm: float | None


_InFocus = tuple[float, float, tuple[float, float], float]


class _Pose(NamedTuple):
    """True pose of everything when a picture is taken."""

    angle_deg: float
    tilt_deg: float
    shift_mm: tuple[float, float]
    defocus_mm: float
    part_deg: float = 0.0

    @property
    def in_focus(self) -> _InFocus:
        """All but the distance."""
        return self.angle_deg, self.tilt_deg, self.shift_mm, self.part_deg


def _with_content(value: object) -> object:
    """A table with the hash of the content of a file in place of its path."""
    if isinstance(value, dict):
        return {name: _with_content(one) for name, one in value.items()}
    if isinstance(value, str) and Path(value).is_file():
        return hashlib.sha256(bounded_bytes(Path(value), MOST_PICTURE_BYTES)).hexdigest()
    return value


def _packed(scene: Image) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, scene)
    return buffer.getvalue()


def _unpacked(content: bytes) -> Image:
    return np.asarray(np.load(io.BytesIO(content)))


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
