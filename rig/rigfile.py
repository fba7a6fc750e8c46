"""The rig file: which devices stand on the rig, where, and how they are oriented. TOML, schema 1."""

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import BeforeValidator, Field, model_validator

from anisoscope.base.errors import RigError, RigFileError
from anisoscope.base.toml_file import LocalPath, NameOrFile, Part, Positive, read_toml_model
from anisoscope.rig.camera import CameraInfo, Compression
from anisoscope.rig.collisions import AxisTable, Collision
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.stage import Unit, apart_deg, approach_from, within_a_turn

Option = str | int | float | bool
BY_HAND = "manual"
AXES = ("stage", "tilt", "x", "y", "z")


class MotorPart(Part):
    """Axis of the rig: driver, port, zero, sense and limits; a place is of the part, a reading of the scale.

    Attributes:
        unit: in which it counts: degrees, or millimetres of a linear axis.
        driver: name of the driver; ``manual`` asks the operator.
        port: COM port, device path, ``usb:SERIAL``, ``socket://host:port`` or ``sim://…``; none where the driver needs
            none.
        options: further options of the driver.
    """

    unit: ClassVar[Unit] = "deg"

    driver: str
    port: Annotated[str, Field(min_length=1)] | None = None
    options: dict[str, Option] = Field(default_factory=dict)

    @property
    def zero(self) -> float:
        """Reading at which the place is 0, in the unit."""
        raise NotImplementedError

    @property
    def approach(self) -> float:
        """Every reading is approached from this far below, in the unit."""
        raise NotImplementedError

    @property
    def direction(self) -> int:
        """1 if the place grows with the reading, else −1."""
        return 1

    @property
    def driver_options(self) -> dict[str, Option]:
        """The options as the driver takes them."""
        return dict(self.options)

    def reading(self, place: float) -> float:
        """Reading at a place (an angle of sample or arm, or a length), in the unit."""
        return self.zero + self.direction * place

    def place(self, reading: float) -> float:
        """Place at a reading, in the unit."""
        return self.direction * (reading - self.zero)

    def way(self, place: float, limits: tuple[float, float]) -> tuple[float, float]:
        """Reading below, from which a place is approached, and reading at the place; limits are those of the axis.

        Whether the axis reaches both is not asked here.
        """
        del limits
        reading = self.reading(place)
        return reading - self.approach, reading


class AxisPart(MotorPart):
    """An axis that turns.

    Attributes:
        zero_deg: reading at which sample or arm stands at 0°.
        approach_deg: every reading is approached from this far below, because of backlash.
    """

    zero_deg: float = 0.0
    approach_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 2.0

    @model_validator(mode="before")
    @classmethod
    def _a_hand_has_no_backlash(cls, table: Any) -> Any:  # noqa: ANN401
        if isinstance(table, dict) and table.get("driver") == BY_HAND:
            return {"approach_deg": 0.0, **table}
        return table

    @property
    def zero(self) -> float:
        """`zero_deg`."""
        return self.zero_deg

    @property
    def approach(self) -> float:
        """`approach_deg`."""
        return self.approach_deg


class LinearPart(MotorPart):
    """A linear axis: ``z`` changes the distance of camera and sample, ``x`` and ``y`` shift the stage below the camera.

    Lengths among the options of its driver end in ``mm``, such as ``min_mm``, ``tolerance_mm``, ``velocity_mm_s``.

    Attributes:
        zero_mm: reading at which x, y or z is 0.
        sign: −1 where a growing reading lowers x, y or z.
        approach_mm: every reading is approached from this far below, because of backlash.
    """

    unit: ClassVar[Unit] = "mm"

    zero_mm: float = 0.0
    sign: Literal[-1, 1] = 1
    approach_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.1

    @property
    def zero(self) -> float:
        """`zero_mm`."""
        return self.zero_mm

    @property
    def approach(self) -> float:
        """`approach_mm`."""
        return self.approach_mm

    @property
    def direction(self) -> int:
        """`sign`."""
        return self.sign

    @property
    def driver_options(self) -> dict[str, Option]:
        """The options as a driver takes them: it counts in its unit, and its names say degrees."""
        named = {re.sub(r"_mm(?=_|$)", "_deg", key): value for key, value in self.options.items()}
        return {"unit": self.unit, **named}

    @model_validator(mode="after")
    def _lengths_in_mm(self) -> Self:
        for key in self.options:
            if re.search(r"_deg(_|$)", key):
                raise ValueError(
                    f"options.{key}: this axis is linear; write {re.sub('_deg', '_mm', key)}, in millimetres"
                )
        return self


class StagePart(AxisPart):
    """The rotation stage; ``turns`` is the sense in which a growing reading turns the sample, seen from the camera."""

    turns: Literal["ccw", "cw"] = "ccw"

    @property
    def direction(self) -> int:
        """1 if the angle of the sample grows with the reading, else −1."""
        return 1 if self.turns == "ccw" else -1

    def place_near(self, reading: float, place: float) -> float:
        """The angle of the sample at a reading, among those a turn apart the nearest to another, in degrees."""
        return place + apart_deg(self.place(reading), place)

    def way(self, place: float, limits: tuple[float, float]) -> tuple[float, float]:
        """As of every axis; where the limits span a turn, readings a turn apart are the same."""
        reading = within_a_turn(limits, self.reading(place), self.approach)
        return approach_from(limits, reading, self.approach), reading


class TiltPart(AxisPart):
    """The axis that tilts the camera arm; ``sign`` is −1 where a growing reading lowers the tilt."""

    sign: Literal[-1, 1] = 1

    @property
    def direction(self) -> int:
        """1 if the tilt grows with the reading, else −1."""
        return self.sign


class CameraPart(Part):
    """The camera.

    Attributes:
        driver: name of the driver.
        pixel_um: size of one of its pixels on the sample.
        sensitivities: file ``wavelength_nm,red,green,blue`` (or ``wavelength_nm,mono``) with the relative quantum
            efficiency of its channels, or ``synthetic``, as on the virtual rig; needed where colours are predicted.
        half_angle_deg: of the cone of light that its lens collects; compared with recipes that predict with it.
        compression: how its frames are packed on disk, without loss: ``zlib``, ``jpeg-xl`` (needs imagecodecs) or
            ``none``.
        share_darks_s: seconds during which inspections share dark frames, as long as one of their own agrees; 0: each
            takes all of its own.
        options: further options of the driver.
    """

    driver: str
    pixel_um: Positive
    sensitivities: NameOrFile | None = None
    half_angle_deg: Annotated[float, Field(ge=0.0, le=90.0)] | None = None
    compression: Compression = "zlib"
    share_darks_s: Annotated[float, Field(ge=0.0)] = 3600.0
    options: dict[str, Option] = Field(default_factory=dict)


class WheelPart(Part):
    """A filter wheel in the beam of the light: its driver, port (as for an axis) and options."""

    driver: str
    port: Annotated[str, Field(min_length=1)] | None = None
    options: dict[str, Option] = Field(default_factory=dict)


def _as_tuple(value: Any) -> Any:  # noqa: ANN401
    """Tables that were looked at before hold lists."""
    return tuple(value) if isinstance(value, list) else value


class ChannelPart(Part):
    """A light channel: what shines, and what of the light is then different from its table.

    Attributes:
        lamps: those of the controller that shine together; without any, its only lamp, or all.
        level_percent: level of these lamps.
        filter: place of the filter wheel, from 1.
        angle_deg: as in `LightPart`, as are spectrum, wavelength, bandwidth and half angle.
        flat, fixture: white reference and reference of the fixture that were taken under it; those of
            ``[calibration]`` by default.
    """

    lamps: Annotated[tuple[str, ...], BeforeValidator(_as_tuple)] = ()
    level_percent: Annotated[int, Field(ge=1, le=100)] = 100
    filter: Annotated[int, Field(ge=1)] | None = None
    angle_deg: float | None = None
    spectrum: NameOrFile | None = None
    wavelength_nm: Positive | None = None
    bandwidth_nm: Annotated[float, Field(ge=0.0)] | None = None
    half_angle_deg: Annotated[float, Field(ge=0.0, le=90.0)] | None = None
    flat: LocalPath | None = None
    fixture: LocalPath | None = None


class LightPart(Part):
    """The light.

    Attributes:
        driver: name of the driver; ``manual`` asks the operator.
        port: as for an axis; none where the driver needs none. Older files have it among the options.
        angle_deg: angle between light and camera, seen from the sample.
        spectrum: its spectrum, needed where colours are predicted: ``led-white`` (made up), a CIE illuminant such as
            ``d65`` or ``a``, or a file ``wavelength_nm,power``.
        wavelength_nm: middle of the spectrum of a narrow lamp; like the next two compared with recipes that predict
            with it.
        bandwidth_nm: full width of its spectrum at half of its height.
        half_angle_deg: of the cone of light that falls on a point of the sample.
        distance_mm: from the middle of the field to the lamp; far away where it is left out. The light of a near lamp
            turns over the region: predicted for ridges and prints, refused for plates and wafers beyond what they are
            predicted for.
        options: further options of the driver.
        wheel: filter wheel in its beam.
        channels: light channels by their names.
        channel: the channel that is used where a recipe or a command names none.
    """

    driver: str = BY_HAND
    port: Annotated[str, Field(min_length=1)] | None = None
    angle_deg: float = 10.0
    spectrum: NameOrFile | None = None
    wavelength_nm: Positive | None = None
    bandwidth_nm: Annotated[float, Field(ge=0.0)] | None = None
    half_angle_deg: Annotated[float, Field(ge=0.0, le=90.0)] | None = None
    distance_mm: Positive | None = None
    options: dict[str, Option] = Field(default_factory=dict)
    wheel: WheelPart | None = None
    channels: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")], ChannelPart] = Field(
        default_factory=dict
    )
    channel: str | None = None

    @model_validator(mode="after")
    def _channels_are_there(self) -> Self:
        for name, one in self.channels.items():
            if one.filter is not None and self.wheel is None:
                raise ValueError(f"channels.{name}.filter: there is no table [light.wheel]")
        if self.channel is not None and self.channel not in self.channels:
            there = ", ".join(self.channels) or "none"
            raise ValueError(f"channel: there is no channel '{self.channel}'; there are: {there}")
        return self

    def check_distance(self, size_mm: tuple[float, float], most_deg: float = math.inf) -> None:
        """Check the distance of the lamp, where it is stated, against the size of a region.

        Args:
            size_mm: width and height of the region.
            most_deg: turn of the light from the middle of the region to its rim for which it is predicted.

        Raises:
            RigFileError: the lamp stands nearer than the region is wide, or its light turns by more.
        """
        size, far = max(size_mm), self.distance_mm
        if far is None:
            return
        if not far > size:
            raise RigFileError(
                f"light.distance_mm: the lamp stands at {far:g} mm, nearer than the region is wide ({size:g} mm): "
                "give the distance from the part to the lamp"
            )
        turn_deg = math.degrees(0.5 * size / far)
        if turn_deg > most_deg:
            raise RigFileError(
                f"light.distance_mm: over a region of {size:g} mm the light of a lamp at {far:g} mm turns by ± "
                f"{turn_deg:.2g}°, and this surface is predicted for light of one direction within {most_deg:.2g}°: "
                "move the lamp away, or take a smaller region"
            )

    def in_channel(self, name: str) -> Self:
        """The same light in one of its channels."""
        own = self.channels[name].model_dump(exclude_none=True, include=set(type(self).model_fields))
        return self.model_copy(update={**own, "channel": name})

    @model_validator(mode="before")
    @classmethod
    def _port_among_options(cls, table: Any) -> Any:  # noqa: ANN401
        options = table.get("options") if isinstance(table, dict) else None
        if not (isinstance(options, dict) and "port" in options):
            return table
        if table.get("port") is not None:
            raise ValueError("port stands here and among the options: keep the one here")
        rest = {key: value for key, value in options.items() if key != "port"}
        return {**table, "port": options["port"], "options": rest}


class GeometryPart(Part):
    """Fixed tilt of the camera arm from the normal of the stage, where no axis tilts it."""

    tilt_deg: Annotated[float, Field(gt=-90.0, lt=90.0)] = 0.0


class CalibrationPart(Part):
    """The files that ``calibrate`` wrote, of which either of a pair may be named; all may be missing but the flat."""

    flat: LocalPath
    dark: LocalPath | None = None
    stray: LocalPath | None = None
    linearity: LocalPath | None = None
    rotation: LocalPath | None = None
    focus: LocalPath | None = None
    check: LocalPath | None = None
    fixture: LocalPath | None = None


class RigAxes(Part):
    """A rig of which the axes matter; camera and light may be missing. Without `tilt` the camera arm is fixed.

    The linear axes `x`, `y` and `z` may be missing, each. Rows of `collisions` forbid readings of several axes
    together; `home_order` names axes in an order in which their reference searches are safe, wherever those that follow
    stand.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str = "rig"
    stage: StagePart
    tilt: TiltPart | None = None
    x: LinearPart | None = None
    y: LinearPart | None = None
    z: LinearPart | None = None
    camera: CameraPart | None = None
    light: LightPart | None = None
    geometry: GeometryPart = GeometryPart()
    fixture: Fixture | None = None
    calibration: CalibrationPart | None = None
    collisions: tuple[Collision, ...] = ()
    home_order: tuple[AxisTable, ...] = ()

    @property
    def linear(self) -> dict[str, LinearPart]:
        """The linear axes by their tables."""
        found = {"x": self.x, "y": self.y, "z": self.z}
        return {name: part for name, part in found.items() if part is not None}

    def moved_with(self, *tables: str) -> dict[str, MotorPart]:
        """These axes and the axes that share a row of `collisions` with one of them, by their tables."""
        found = set(tables)
        while more := {
            name for row in self.collisions if found & row.ranges.keys() for name in row.ranges.keys() - found
        }:
            found |= more
        return {name: part for name, part in self.axes.items() if name in found}

    @property
    def axes(self) -> dict[str, MotorPart]:
        """All axes by their tables, the stage first."""
        found = {name: getattr(self, name) for name in AXES}
        return {name: part for name, part in found.items() if part is not None}

    def uncalibrated(self, info: CameraInfo) -> bool:
        """Whether contrasts are uncalibrated: the camera is not linear, and no response is known."""
        return not info.linear and (self.calibration is None or self.calibration.linearity is None)

    @model_validator(mode="after")
    def _axes_are_there(self) -> Self:
        named = [
            *(
                (f"collisions[{number}]", name)
                for number, row in enumerate(self.collisions)
                for name in row.ranges
            ),
            *(("home_order", name) for name in self.home_order),
        ]
        for where, name in named:
            if name not in self.axes:
                raise ValueError(f"{where} names {name}, but there is no table [{name}]")
        if len(set(self.home_order)) < len(self.home_order):
            raise ValueError("home_order names an axis twice")
        return self

    @model_validator(mode="after")
    def _one_tilt(self) -> Self:
        if self.tilt is not None and self.geometry.tilt_deg != 0.0:
            raise ValueError(
                "geometry.tilt_deg is for an arm that stands fixed; with [tilt], set tilt.zero_deg"
            )
        return self


class RigFile(RigAxes):
    """A rig that takes pictures, as its file describes it."""

    name: str
    camera: CameraPart
    light: LightPart

    def in_channel(self, name: str | None) -> Self:
        """The rig in a light channel: its lamp, and flat and reference of the fixture that were taken under it.

        Args:
            name: of the channel; None for the one that the rig file uses by default.

        Raises:
            RigFileError: there is no such channel, or there are channels and none is chosen.
        """
        names, name = ", ".join(self.light.channels), name or self.light.channel
        if name is None and not names:
            return self
        if name is None:
            raise RigFileError(
                f"light.channels: the rig '{self.name}' has {names}: choose one, by acquisition.light_channel of the "
                "recipe, by --channel, or by light.channel of the rig file"
            )
        if name not in self.light.channels:
            there = f"it has {names}" if names else "it has none"
            raise RigFileError(f"light.channels: the rig '{self.name}' has no channel '{name}'; {there}")
        found: dict[str, object] = {"light": self.light.in_channel(name)}
        channel = self.light.channels[name]
        own = {"flat": channel.flat, "fixture": channel.fixture}
        own = {kind: path for kind, path in own.items() if path is not None}
        known = self.calibration or (None if channel.flat is None else CalibrationPart(flat=channel.flat))
        if known is not None:
            found["calibration"] = known.model_copy(update=own)
        return self.model_copy(update=found)

    @property
    def without_devices(self) -> bool:
        """Whether it has geometry and calibrations only, so that nothing can be photographed."""
        return NO_DEVICE in {self.stage.driver, self.camera.driver}


TILT_TOLERANCE_DEG = 0.01


def check_arm(rig: RigFile, tilts_deg: Iterable[float]) -> None:
    """Check that a camera arm without an axis is at all of these tilts, in degrees.

    Raises:
        RigError: it does not.
    """
    arm_deg = rig.geometry.tilt_deg
    for tilt_deg in tilts_deg:
        if rig.tilt is None and abs(tilt_deg - arm_deg) > TILT_TOLERANCE_DEG:
            raise RigError(
                f"a tilt of {tilt_deg:g}° was asked for, but the camera arm of '{rig.name}' "
                f"is fixed at {arm_deg:g}°; ask for that, correct geometry.tilt_deg in the rig file, or "
                "describe the axis that tilts it under [tilt]"
            )


NO_DEVICE = "replay"


class ReplayCameraPart(CameraPart):
    """A camera of which only the size of its pixels matters."""

    driver: str = NO_DEVICE


class ReplayRigFile(RigFile):
    """A rig file read for pictures that exist already: geometry is needed, devices are not."""

    name: str = "frames from a folder"
    stage: StagePart = StagePart(driver=NO_DEVICE)
    camera: ReplayCameraPart


def read_rig(path: Path | str, *, here: Path | None = None, channel: str | None = None) -> RigFile:
    """Read a rig file; ``${here}`` in it is the folder of the file.

    Args:
        path: the file.
        here: the folder that ``${here}`` stands for, if it is another one: that of the original of a copy.
        channel: the light channel; None for the one that the file uses by default, if it has channels.

    Raises:
        RigFileError: the file is missing or wrong; the message names the key.
    """
    return _in_channel(_read(Path(path), RigFile, here), channel)


def read_axes(path: Path) -> RigAxes:
    """Read a rig file for its axes; camera and light may be missing. Errors as for `read_rig`."""
    return _read(path, RigAxes, None)


def read_replay_rig(path: Path, channel: str | None = None) -> RigFile:
    """Read a rig file for its geometry; the tables of the devices may be missing. Errors as for `read_rig`."""
    return _in_channel(_read(path, ReplayRigFile, None), channel)


def _in_channel(file: "RigFileT", name: str | None) -> "RigFileT":
    """The rig in a channel; a rig with several of which none is chosen stays as it is."""
    return file.in_channel(name) if name or file.light.channel else file


AxesT = TypeVar("AxesT", bound=RigAxes)
RigFileT = TypeVar("RigFileT", bound=RigFile)


def _read(path: Path, model: type[AxesT], here: Path | None) -> AxesT:
    folder = str(here or path.resolve().parent)
    return read_toml_model(path, model, error=RigFileError, substitutions={"here": folder})
