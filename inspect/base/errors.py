"""Every error that anisoscope raises on purpose.

The tree, with the exit code of the command line in brackets::

    AnisoscopeError [70]
    ├── UsageError [64]            an option or a combination of options that makes no sense
    ├── HeightMapError [65]        a height map that cannot be read, or that cannot be true
    ├── ModelError [64]            a reflectance model asked for something outside its validity
    ├── ConfigError [78]           a file of ours (recipe, rig, bench, calibration) that is wrong
    │   ├── RecipeError
    │   ├── RigFileError
    │   ├── LimitsError             (in `profiles.limits`)
    │   └── InkFileError            (in `sim.materials.inks`)
    ├── SweepError [69]            a sweep that cannot be run to its end (in `study.sweep`)
    ├── RecordError [74]           an inspection folder that cannot be written or read
    ├── HistoryError [74]          a history that cannot be reached, read or written (in `history.problems`)
    ├── RigError [69]              hardware
    │   ├── NotConnected           no such port, unplugged, silent, or in use
    │   ├── ProtocolError          the device answers, but not what its protocol says
    │   ├── MotionTimeout          the stage did not arrive in the time the move needs
    │   ├── Stalled                the stage reports a mechanical fault
    │   ├── LimitExceeded          a target outside the limits; refused before the move
    │   ├── NotHomed               an absolute move before the reference search
    │   └── CameraError
    │       └── Saturated          too many pixels at full scale to measure anything
    └── MeasurementError [3]       the frames cannot carry a verdict: the inspection is INVALID
        ├── CalibrationError       missing, expired, or belonging to another rig
        └── RegistrationError      the turned frames cannot be aligned

Messages are one line: what is wrong, where, and what to do.
"""

from typing import ClassVar


class AnisoscopeError(Exception):
    """Base of all errors raised on purpose; its message is meant for the user."""

    exit_code: ClassVar[int] = 70


class UsageError(AnisoscopeError):
    """An option, or a combination of options, that makes no sense."""

    exit_code = 64


class HeightMapError(AnisoscopeError):
    """A height map that cannot be read, or whose content cannot be true."""

    exit_code = 65


class ModelError(AnisoscopeError):
    """A reflectance model is used outside its range of validity."""

    exit_code = 64


class ConfigError(AnisoscopeError):
    """A file of ours (recipe, rig, bench, calibration) is wrong."""

    exit_code = 78


class RecipeError(ConfigError):
    """A recipe that cannot be used."""


class RigFileError(ConfigError):
    """A rig file that cannot be used."""


class RecordError(AnisoscopeError):
    """An inspection folder that cannot be written or read."""

    exit_code = 74


class RigError(AnisoscopeError):
    """Hardware is missing, wrong, or does not carry out a command."""

    exit_code = 69


class NotConnected(RigError):
    """No such port, port in use, unplugged, or silent."""


class ProtocolError(RigError):
    """The device answers outside its protocol."""


class MotionTimeout(RigError):
    """The stage did not arrive in the time that the move needs."""


class Stalled(RigError):
    """The stage reports a mechanical fault."""


class LimitExceeded(RigError):
    """A target outside the limits of travel; refused before the move."""


class NotHomed(RigError):
    """An absolute move before the reference search."""


class CameraError(RigError):
    """The camera is missing, or did not deliver a usable frame."""


class Saturated(CameraError):
    """Too many pixels at full scale to measure anything."""


class MeasurementError(AnisoscopeError):
    """The frames cannot carry a verdict; the inspection is INVALID."""

    exit_code = 3


class CalibrationError(MeasurementError):
    """A calibration is missing, expired, or belongs to another rig."""


class RegistrationError(MeasurementError):
    """The turned frames cannot be aligned."""
