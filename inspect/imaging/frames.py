"""The acquired frames of an inspection, with their poses."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from anisoscope.rig.acquisition.plan import Pose
from anisoscope.rig.frame import Frame


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame of an inspection.

    Attributes:
        name: its file, relative to the folder.
        sha256: of the file.
        frame: what is in it.
        pose: the commanded pose.
        again: a repetition, used for drift only.
        run: number of the acquisition run.
        check: acquired on resuming, to compare with the frames before the interruption.
        linear_mm: readings of x, y and z, of a rig that has them.
    """

    name: str
    sha256: str
    frame: Frame
    pose: Pose
    again: bool
    run: int
    check: bool
    linear_mm: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class AcquiredFrames:
    """The frames used, and the devices that acquired them; `linear` if all cameras respond linearly."""

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
        """Full-scale count of the camera."""
        return self.shots[0].frame.full_scale
