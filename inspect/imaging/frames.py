"""The frames that an inspection rests on, with the poses at which they were taken."""

from dataclasses import dataclass

from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import Frame


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame of an inspection.

    Attributes:
        name: its file, relative to the folder.
        sha256: of the file.
        frame: what is in it.
        pose: the pose that was asked for.
        again: whether it only shows drift.
        run: number of the run that took it.
        check: whether it was taken on resuming.
    """

    name: str
    sha256: str
    frame: Frame
    pose: Pose
    again: bool
    run: int
    check: bool


@dataclass(frozen=True, eq=False)
class AcquiredFrames:
    """The frames that count, and the devices that took them; `linear` if all cameras count in proportion to light."""

    shots: tuple[Shot, ...]
    camera: str
    stage: str
    linear: bool = True

    @property
    def filters(self) -> str:
        """The colour filters on the camera's pixels; see `anisoscope.rig.bayer`."""
        return self.shots[0].frame.filters

    @property
    def full_scale(self) -> int:
        """Largest count that the camera can give."""
        return self.shots[0].frame.full_scale
