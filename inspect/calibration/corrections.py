"""Calibrations of a rig file: corrections and uncertainties for an inspection, validity, and their list.

A file that is missing, damaged or of another camera is an error before anything moves (exit code 3). A calibration that
has expired, or was out of its limits, gives an INVALID record with the reason.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CalibrationError, RegistrationError, RigFileError
from anisoscope.calibration.record import (
    KINDS,
    CalibrationRecord,
    Kind,
    advice,
    picture_path,
    read_calibration,
    record_path,
)
from anisoscope.calibration.white_reference import read_reference
from anisoscope.imaging.linearisation import Image, Mask, RadianceImage, Stack, WhiteReference
from anisoscope.imaging.registration.lens import Lens
from anisoscope.imaging.registration.placement import Placement, angle_between
from anisoscope.imaging.rig_monitor import FixtureReference
from anisoscope.recipe.base import RecipeBase
from anisoscope.rig.acquisition.plan import Seat
from anisoscope.rig.rigfile import CalibrationPart, LightPart, read_rig

RecipeT = TypeVar("RecipeT", bound=RecipeBase)
TURN_DEG = 0.2
DARK_LEVEL_SHARE = 0.005
BEYOND_MAP = 1.25
LIGHT_DEG = 0.5
"""Distance of the rig's light angle from that of the fixture's reference from which on it is another lamp."""


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Calibrations of a rig with records, as used by an inspection.

    Attributes:
        records: by kind; a flat of an earlier version has none.
        stray: (rows, cols) stray light in counts per second at gain 1.
        hot: (rows, cols) pixels that the dark calibration found hot.
        files: every file that was read, with its role.
        followed: whether x and y keep the part in the middle of the picture while the stage turns.
    """

    records: Mapping[Kind, CalibrationRecord] = field(default_factory=dict)
    stray: Image | None = None
    hot: Mask | None = None
    files: Mapping[str, Path] = field(default_factory=dict)
    followed: bool = False

    def check_valid(self, at: datetime) -> None:
        """Check that all calibrations are valid at a time.

        Raises:
            CalibrationError: one has expired, or was out of its limits.
        """
        for kind in KINDS:
            invalid_reason = self.records[kind].invalid_reason(at) if kind in self.records else None
            if invalid_reason is not None:
                raise CalibrationError(invalid_reason)

    def check_camera(self, serial: str, shape: tuple[int, int]) -> None:
        """Check that all calibrations belong to this camera.

        Raises:
            CalibrationError: one was not.
        """
        for kind, record in self.records.items():
            if record.camera.serial != serial:
                raise CalibrationError(
                    f"the {kind} calibration {record.id} was taken with camera {record.camera.serial}, this is "
                    f"{serial}: {advice(kind)}"
                )
            if kind in {"dark", "stray", "rotation"} and (record.camera.rows, record.camera.cols) != shape:
                raise CalibrationError(
                    f"the {kind} calibration {record.id} has {record.camera.cols} × {record.camera.rows} pixels, the "
                    f"camera {shape[1]} × {shape[0]}: {advice(kind)}"
                )

    def check_light(self, light: LightPart) -> None:
        """Check that the reference of the fixture was taken under this light.

        Args:
            light: of the rig, in the channel that is used.

        Raises:
            CalibrationError: it was taken in another channel, or at another light angle.
        """
        record = self.records.get("fixture")
        if record is None:
            return
        channel, angle_deg = record.details.get("channel"), record.details.get("light_angle_deg")
        if channel != light.channel:
            raise CalibrationError(
                f"the fixture calibration {record.id} was taken in {_channel_words(channel)}, this is "
                f"{_channel_words(light.channel)}: {advice('fixture')} in it, and name it as fixture of that channel"
            )
        if angle_deg is not None and abs(angle_deg - light.angle_deg) > LIGHT_DEG:
            raise CalibrationError(
                f"the fixture calibration {record.id} was taken at a light angle of {angle_deg:g}°, the rig file "
                f"states {light.angle_deg:g}° (limit ±{LIGHT_DEG:g}°): {advice('fixture')}"
            )

    @property
    def axis_px(self) -> tuple[float, float] | None:
        """(column, row) of the point about which the part turns in the picture, where it was calibrated."""
        record = self.records.get("rotation")
        if record is None:
            return None
        if self.followed:
            return 0.5 * (record.camera.cols - 1), 0.5 * (record.camera.rows - 1)
        return record.number("centre_column"), record.number("centre_row")

    @property
    def lens(self) -> Lens | None:
        """Distortion of the pictures, where the rotation calibration found a significant one."""
        record = self.records.get("rotation")
        if record is None or "distortion_k1" not in record.values:
            return None
        k2 = record.values.get("distortion_k2")
        shape = (record.camera.rows, record.camera.cols)
        return Lens(shape, record.number("distortion_k1"), 0.0 if k2 is None else k2.value)

    @property
    def fixture_reference(self) -> FixtureReference | None:
        """White, black and greys of the fixture on the sound rig, where they were taught."""
        record = self.records.get("fixture")
        if record is None:
            return None
        return FixtureReference.from_details(record.id, record.details)

    def seat(self, place_mm: tuple[float, float] | None) -> Seat:
        """How the axes x, y and z bring a part below the camera.

        Args:
            place_mm: (x, y) of the part on the plate from the axis of the stage, at sample angle 0; None for there.

        Raises:
            CalibrationError: the place is beyond the focus map.
        """
        found = Seat(place_mm or (0.0, 0.0))
        rotation, focus = self.records.get("rotation"), self.records.get("focus")
        if rotation is not None and "x" in rotation.values:
            found = replace(
                found,
                centre_mm=(rotation.number("x"), rotation.number("y")),
                directions_deg=(rotation.number("x_direction"), rotation.number("y_direction")),
            )
        if focus is None:
            return found
        x, y = found.place_mm
        away_mm = float(np.hypot(x - focus.number("middle_x"), y - focus.number("middle_y")))
        if away_mm > BEYOND_MAP * focus.number("reach"):
            raise CalibrationError(
                f"the part lies {away_mm:.3g} mm from the middle of the focus map {focus.id}, which reaches "
                f"{focus.number('reach'):.3g} mm: {advice('focus')} over all seats"
            )
        height = focus.number("z") + focus.number("slope_x") * x + focus.number("slope_y") * y
        return replace(found, focus_mm=height + focus.number("bow") * (x**2 + y**2))

    def applied_to(self, recipe: RecipeT) -> RecipeT:
        """The recipe with the uncertainties that were calibrated in place of those it states."""
        found = {}
        if "stray" in self.records:
            found["stray_radiance"] = self.records["stray"].uncertainty("stray_radiance")
        if "linearity" in self.records:
            found["linearity_share"] = self.records["linearity"].number("linearity_error")
        if not found:
            return recipe
        return recipe.model_copy(update={"uncertainty": recipe.uncertainty.model_copy(update=found)})

    def corrected(self, sample: Stack, dark: Stack) -> Stack:
        """Counts of a sample corrected for linearity and stray light.

        Raises:
            CalibrationError: the dark frames differ from the calibrated dark picture of this camera.
        """
        self._check_dark(dark)
        if self.stray is None and self._response(sample.gain) == 0.0:
            return sample
        signal = self._linear(sample.mean - dark.mean, sample.gain)
        if self.stray is not None:
            signal = signal - self.stray * np.float32(sample.exposure_s * sample.gain)
        return replace(sample, mean=dark.mean + signal)

    def white(self, white: WhiteReference) -> WhiteReference:
        """White reference in linear counts; needs the record of the flat."""
        flat = self.records.get("flat")
        if flat is None or self._response(flat.gain) == 0.0:
            return white
        counts = np.float32(flat.exposure_s * flat.gain)
        return replace(white, signal=self._linear(white.signal * counts, flat.gain) / counts)

    def masked(self, image: RadianceImage) -> RadianceImage:
        """A picture without the pixels that the dark calibration found hot."""
        if self.hot is None or not self.hot.any():
            return image
        return replace(image, value=np.where(self.hot, np.float32(np.nan), image.value))

    def check_place(self, stage_deg: float, place: Placement, limit_um: float) -> None:
        """Check the position of the fixture against the calibrated rotation.

        Args:
            stage_deg: angle of the stage, degrees.
            place: of the fixture in the picture.
            limit_um: largest distance of the axis from the calibrated one, µm on the sample; of the angle it is 0.2°.

        Raises:
            RegistrationError: it is not.
        """
        record = self.records.get("rotation")
        if record is None or place.markers == 0:
            return
        if self.followed:
            self._check_followed(record, stage_deg, place, limit_um)
            return
        eccentricity = np.array([record.number("eccentricity_x"), record.number("eccentricity_y")])
        axis = place.homography @ np.append(-eccentricity, 1.0)
        centre = record.number("centre_column"), record.number("centre_row")
        off_px = float(np.hypot(*(axis[:2] / axis[2] - centre)))
        if off_px * place.pixel_um > limit_um:
            raise RegistrationError(
                f"at {stage_deg:g}° the fixture turns about a point {off_px * place.pixel_um:.0f} µm ({off_px:.1f} px) "
                f"from the calibrated rotation centre (limit {limit_um:g} µm, limits.fixture_um): seat the fixture as "
                "it was, check that the camera was not moved, or " + advice("rotation")
            )
        turned = angle_between(stage_deg + record.number("fixture_angle"), place.angle_deg)
        if abs(turned) > TURN_DEG:
            raise RegistrationError(
                f"at {stage_deg:g}° the fixture stands {turned:+.2f}° from where it stood at the rotation calibration "
                f"(limit ±{TURN_DEG:g}°): seat the fixture again, or {advice('rotation')}"
            )

    def _check_followed(
        self, record: CalibrationRecord, stage_deg: float, place: Placement, limit_um: float
    ) -> None:
        middle = 0.5 * (record.camera.cols - 1), 0.5 * (record.camera.rows - 1)
        off_um = float(np.hypot(*np.subtract(place.axis_px, middle))) * place.pixel_um
        if off_um > limit_um:
            raise RegistrationError(
                f"at {stage_deg:g}° the markers of the part stand {off_um:.0f} µm from where x and y bring them (limit "
                f"{limit_um:g} µm, limits.fixture_um): seat the part as it was, correct its place on the tray, or "
                + advice("rotation")
            )

    def _response(self, gain: float) -> float:
        """Second-order term of the camera's response, per count; 0 where it is linear."""
        record = self.records.get("linearity")
        if record is None or record.gain != gain:
            return 0.0
        return float(record.details.get("response_per_count", 0.0))

    def _linear(self, signal: Image, gain: float) -> Image:
        bend = np.float32(self._response(gain))
        return np.asarray(signal * (1.0 + bend * signal), dtype=np.float32) if bend else signal

    def _check_dark(self, dark: Stack) -> None:
        record = self.records.get("dark")
        if record is None or (record.exposure_s, record.gain) != (dark.exposure_s, dark.gain):
            return
        off = float(np.median(dark.mean)) - record.number("level")
        limit = max(DARK_LEVEL_SHARE * 2**record.camera.bit_depth, 5.0 * record.uncertainty("level"))
        if abs(off) > limit:
            raise CalibrationError(
                f"the dark frames lie {off:+.1f} counts from the dark calibration {record.id} (limit ±{limit:.1f}): "
                f"keep other light off the camera, let it warm up, or {advice('dark')}"
            )


def _channel_words(name: str | None) -> str:
    return "no light channel" if name is None else f"light channel {name}"


def read_calibrations(part: CalibrationPart, without: Kind | None = None) -> Calibrations:
    """Read the calibrations of the rig file, except one kind; an old flat needs no record.

    Raises:
        CalibrationError: a file is missing, damaged, or of another kind.
    """
    files: dict[str, Path] = {}
    for kind in KINDS:
        path: Path | None = getattr(part, kind)
        if path is None or kind == without or (kind == "flat" and not record_path(path).is_file()):
            continue
        files[f"{kind} record"] = record_path(path)
        if kind in {"dark", "stray"}:
            files[f"{kind} picture"] = picture_path(path)
        if kind == "flat":
            files["white reference"] = path
    return calibrations_of(files)


def calibrations_of(files: Mapping[str, Path]) -> Calibrations:
    """Calibrations from their files by role, such as ``stray record`` and ``stray picture``.

    Raises:
        CalibrationError: as for `read_calibrations`.
    """
    records: dict[Kind, CalibrationRecord] = {}
    pictures: dict[Kind, Image] = {}
    for kind in KINDS:
        if f"{kind} record" not in files:
            continue
        picture = files.get("white reference" if kind == "flat" else f"{kind} picture")
        records[kind] = read_calibration(files[f"{kind} record"], kind, picture)
        if picture is not None and kind != "flat":
            pictures[kind] = read_picture(picture, kind)
    hot = pictures["dark"][1] > 0.5 if "dark" in pictures else None
    own = {role: path for role, path in files.items() if role != "white reference"}
    return Calibrations(records, pictures.get("stray"), hot, own)


def read_picture(path: Path, kind: Kind) -> npt.NDArray[np.float32]:
    """The picture of a calibration: (rows, cols), or (2, rows, cols) with the hot pixels of a dark one.

    Raises:
        CalibrationError: it cannot be read.
    """
    import tifffile  # noqa: PLC0415 - start-up time

    try:
        return np.asarray(tifffile.imread(path), dtype=np.float32)
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CalibrationError(f"{path} cannot be read ({reason}): {advice(kind)}") from error


State = Literal["valid", "expired", "out of limits", "no record", "damaged", "missing"]
NEEDED: tuple[Kind, ...] = ("flat",)


@dataclass(frozen=True)
class Listed:
    """One kind of calibration of a rig.

    Attributes:
        kind: the kind.
        state: whether an inspection can use it; a flat of an earlier version has no record, and no end.
        file: what the rig file names, or None.
        id: of its record.
        taken_at, valid_until: UTC times.
        needed: whether inspections require one.
        advice: what to do, or "".
    """

    kind: Kind
    state: State
    file: str | None
    id: str | None
    taken_at: str | None
    valid_until: str | None
    needed: bool
    advice: str


def list_calibrations(rig_path: Path, at: datetime | None = None) -> tuple[Listed, ...]:
    """All kinds of calibrations of a rig, with their states.

    Args:
        rig_path: rig file.
        at: time of use; now by default.

    Raises:
        RigFileError: the rig file.
    """
    part = read_rig(rig_path).calibration
    return tuple(_listed(kind, part, at or datetime.now(UTC)) for kind in KINDS)


def _listed(kind: Kind, part: CalibrationPart | None, at: datetime) -> Listed:
    path: Path | None = None if part is None else getattr(part, kind)
    needed = kind in NEEDED
    if path is None:
        return Listed(kind, "missing", None, None, None, None, needed, advice(kind))
    try:
        if kind == "flat":
            white = read_reference(path)
            if not record_path(path).is_file():
                return Listed(kind, "no record", str(path), None, white.taken_at, None, needed, advice(kind))
        record = read_calibration(path, kind, path if kind == "flat" else picture_path(path))
    except (CalibrationError, RigFileError) as error:
        state: State = "damaged" if path.exists() or record_path(path).exists() else "missing"
        return Listed(kind, state, str(path), None, None, None, needed, str(error))
    return Listed(
        kind,
        _state(record, at),
        str(path),
        record.id,
        record.taken_at.isoformat(timespec="seconds"),
        record.valid_until.isoformat(timespec="seconds"),
        needed,
        record.invalid_reason(at) or "",
    )


def _state(record: CalibrationRecord, at: datetime) -> State:
    if at >= record.valid_until:
        return "expired"
    return "valid" if record.in_limits else "out of limits"
