"""Lamps of the live picture: level of the light, stray light, focus and angle, read from the markers of the fixture.

Level and stray light are those of the monitor of inspections (`anisoscope.imaging.rig_monitor`), against the reference
of the fixture, with the black level of the camera in place of dark frames. Focus is compared with the reference too,
else with the sharpest edges seen so far. The angle is that of the fixture; its lamp says how well the markers agree.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import AnisoscopeError, RegistrationError
from anisoscope.base.language import decimal, message, translated
from anisoscope.base.notation import true_minus
from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.calibration.white_reference import read_reference
from anisoscope.imaging.linearisation import Stack, WhiteReference, linearise, stack
from anisoscope.imaging.registration.placement import Placement, View, angle_between, check_fixture, locate
from anisoscope.imaging.rig_monitor import FixtureReference, PoseState, TiltReference, watch
from anisoscope.imaging.views import luminance
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.camera import CameraInfo
from anisoscope.rig.frame import Frame
from anisoscope.rig.rigfile import RigFile, read_rig

GAP_S = 0.5
"""Time between two readings at least, in seconds; pictures between them show the one before."""
SHARP, BLURRED = 1.1, 1.3
"""Edge width over the reference's, from which on the lamp of the focus is yellow, and red."""
NOTED = 0.25
"""Share of a limit from which on a reading is noted, as in the monitor of inspections."""
TILTED = 0.01
LIMITS = LimitsPart()

Colour = Literal["green", "yellow", "red", "grey"]


@dataclass(frozen=True)
class Lamp:
    """One lamp.

    Attributes:
        name: what it shows, in English.
        colour: grey where nothing can be said.
        value: the reading in `unit`, or None.
        unit: of the value; level and stray light are in percent of the reference and of white.
        why: why it is grey or red, in English, or "".
    """

    name: Literal["lamp level", "stray light", "focus", "angle"]
    colour: Colour
    value: float | None = None
    unit: str = ""
    why: str = ""


@dataclass(frozen=True, eq=False)
class _Rig:
    """Rig file in a channel; `reference` is None, with the reason, where the fixture cannot be compared."""

    file: RigFile
    known: Calibrations
    white: WhiteReference | None = None
    reference: FixtureReference | None = None
    why: str = "not taught (anisoscope calibrate fixture)"


class RigLamps:
    """Reads the lamps of a rig from pictures, at most a few times a second.

    Args:
        rig: the rig file; read at the first picture, and again after `forget`.
        gap_s: time between two readings at least, in seconds.
    """

    def __init__(self, rig: Path, gap_s: float = GAP_S) -> None:
        self._path, self._gap_s = rig, gap_s
        self.forget()

    def forget(self) -> None:
        """Read the rig file anew, and forget the sharpest edges."""
        self._rig: _Rig | None = None
        self._newest: tuple[float, tuple[Lamp, ...]] | None = None
        self._best_um = np.inf

    def read(
        self,
        counts: npt.NDArray[np.uint16],
        info: CameraInfo,
        taken: tuple[float, float],
        now_s: float,
        channel: str | None = None,
    ) -> tuple[Lamp, ...]:
        """The four lamps for a picture; none for a rig without a fixture.

        Args:
            counts: (rows, cols) raw counts.
            info: the camera.
            taken: exposure in seconds, and gain.
            now_s: a monotonic time in seconds.
            channel: of the light; None for that of the rig file.

        Raises:
            RigFileError: the rig file.
        """
        if self._newest is not None and now_s - self._newest[0] < self._gap_s:
            return self._newest[1]
        if self._rig is None:
            self._rig = _read(self._path, info, channel)
        frame = Frame(
            counts, "sample", info.bit_depth, info.black_level, *taken, 0.0, 0.0, 0.0, "", info.serial, info.filters
        )  # fmt: skip
        found = self._look(self._rig, frame)
        self._newest = now_s, found
        return found

    def _look(self, rig: _Rig, frame: Frame) -> tuple[Lamp, ...]:
        fixture = rig.file.fixture
        if fixture is None:
            return ()
        tilt_deg = 0.0 if rig.file.tilt is not None else rig.file.geometry.tilt_deg
        signal = frame.counts.astype(np.float32) - np.float32(frame.black_level)
        seen = signal if frame.filters == "mono" else luminance(signal)
        try:
            place = locate(seen, fixture, tilt_deg, lens=rig.known.lens, marker_off_um=LIMITS.marker_off_um)
        except RegistrationError as error:
            none = "the markers are not seen"
            return (
                Lamp("lamp level", "grey", why=none),
                Lamp("stray light", "grey", why=none),
                Lamp("focus", "grey", why=none),
                Lamp("angle", "red", why=str(error)),
            )
        focus = self._focus(place, None if rig.reference is None else rig.reference.like(tilt_deg))
        if focus.colour == "red" and rig.reference is not None:
            rig = replace(rig, reference=None, why="focus first: blur looks like stray light")
        return *_light(rig, frame, place, tilt_deg), focus, _angle(place)

    def _focus(self, place: Placement, taught: TiltReference | None) -> Lamp:
        assert place.blur_px is not None
        edge_um = place.blur_px * place.pixel_um
        self._best_um = min(self._best_um, edge_um)
        share = edge_um / (taught.edge_um if taught is not None and taught.edge_um > 0.0 else self._best_um)
        return Lamp("focus", _colour(share, SHARP, BLURRED), edge_um, "µm")


def _read(path: Path, info: CameraInfo, channel: str | None) -> _Rig:
    """The rig file with what its fixture is compared by."""
    file = read_rig(path, channel=channel)
    if file.fixture is not None:
        check_fixture(file.fixture)
    known = Calibrations()
    if file.fixture is None or file.calibration is None:
        return _Rig(file, known)
    try:
        known = read_calibrations(file.calibration)
        record = known.records.get("fixture")
        if record is None:
            return _Rig(file, known)
        known.check_camera(info.serial, (info.rows, info.cols))
        known.check_light(file.light)
        if (reason := record.invalid_reason(datetime.now(UTC))) is not None:
            return _Rig(file, known, why=reason)
        white = known.white(read_reference(file.calibration.flat))
    except AnisoscopeError as error:
        return _Rig(file, known, why=str(error))
    return _Rig(file, known, white, known.fixture_reference)


def _light(rig: _Rig, frame: Frame, place: Placement, tilt_deg: float) -> tuple[Lamp, Lamp]:
    """Level of the light and stray light."""
    state: PoseState | None = None
    why = rig.why
    if rig.white is not None and rig.reference is not None:
        if abs(place.squeeze - 1.0) > TILTED:
            why = "the arm is tilted"
        else:
            try:
                state, why = _state(rig, rig.white, frame, place, tilt_deg)
            except AnisoscopeError as error:
                why = str(error)
    if state is None or state.stray is None:
        return Lamp("lamp level", "grey", why=why), Lamp("stray light", "grey", why=why)
    off, stray = abs(state.level - 1.0), state.stray / state.white
    return (
        Lamp(
            "lamp level",
            _colour(off, LIMITS.level_note_share, LIMITS.level_share),
            100.0 * state.level,
            "%",
        ),
        Lamp(
            "stray light",
            _colour(abs(stray), NOTED * LIMITS.stray_share, LIMITS.stray_share),
            100.0 * stray,
            "%",
        ),
    )


def _state(
    rig: _Rig, white: WhiteReference, frame: Frame, place: Placement, tilt_deg: float
) -> tuple[PoseState | None, str]:
    """Readings of the markers against the reference, or why there are none."""
    dark, black = rig.known.records.get("dark"), frame.black_level
    if dark is not None and (dark.exposure_s, dark.gain) == (frame.exposure_s, frame.gain):
        black = dark.number("level")
    even = np.full(frame.counts.shape, black, dtype=np.float32)
    none = np.zeros_like(even)
    unlit = Stack(even, 1, none, none > 0.0, frame.exposure_s, frame.gain)
    image = linearise(rig.known.corrected(stack([frame]), unlit), unlit, white, frame.full_scale)
    view = View(place.angle_deg, tilt_deg, rig.known.masked(image), place)
    found = watch([view], [], rig.file.fixture, LIMITS, rig.reference)
    return (found.poses[0], "") if not found.not_watched else (None, found.not_watched[0])


def _angle(place: Placement) -> Lamp:
    colour = _colour(place.residual_px, 0.5 * LIMITS.registration_px, LIMITS.registration_px)
    if colour == "green" and place.dropped:
        colour = "yellow"
    why = ""
    if colour != "green":
        why = f"the markers disagree by {place.residual_px:.2f} px"
        if place.dropped:
            why = f"marker {', '.join(map(str, place.dropped))} is left out"
    return Lamp("angle", colour, angle_between(0.0, place.angle_deg), "°", why)


def in_words(lamp: Lamp) -> str:
    """Judgement, value and reason of a lamp, in the language of the page."""
    judged = {"green": message("good"), "yellow": message("look at it"), "red": message("not good")}
    unit = lamp.unit if lamp.unit == "°" else f" {lamp.unit}"
    value = "" if lamp.value is None else decimal(true_minus(f"{lamp.value:z.1f}{unit}"))
    return ", ".join(filter(None, (judged.get(lamp.colour), value, translated(lamp.why))))


def _colour(value: float, noted: float, limit: float) -> Colour:
    return "green" if value <= noted else "yellow" if value <= limit else "red"
