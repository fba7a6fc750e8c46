"""The poses of a recipe: stage angles and tilts, with light and camera above the horizon in all of them."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from anisoscope.base.errors import ModelError, RecipeError
from anisoscope.base.toml_file import Part
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.light.geometry import directions, pose_grid


class PosesPart(Part):
    """Stage angles in the order in which they are photographed, and tilts, in degrees.

    ``stage_and_tilt_deg`` lists single poses instead; ``angles_deg`` and ``tilts_deg`` are then those that occur in it.
    """

    angles_deg: Annotated[tuple[float, ...], Field(min_length=2)] = (0.0, 90.0, 180.0)
    tilts_deg: Annotated[tuple[float, ...], Field(min_length=1)] = (0.0,)
    stage_and_tilt_deg: Annotated[
        tuple[tuple[float, float], ...] | None, Field(min_length=2, exclude_if=lambda value: value is None)
    ] = None
    facet_azimuth_deg: float = 0.0

    @model_validator(mode="after")
    def _single_poses(self) -> Self:
        single = self.stage_and_tilt_deg
        if single is None:
            return self
        if len(set(single)) != len(single):
            raise ValueError("stage_and_tilt_deg names a pose twice")
        for k, name in enumerate(("angles_deg", "tilts_deg")):
            values = tuple(dict.fromkeys(pose[k] for pose in single))
            if name in self.model_fields_set and getattr(self, name) != values:
                raise ValueError(f"give stage_and_tilt_deg or {name}, not both")
            self.__dict__[name] = values
        if not any(a[1] == b[1] for a, b in pairwise(single)):
            raise ValueError(
                "stage_and_tilt_deg needs two poses of one tilt one after the other, whose contrast is measured"
            )
        return self

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for name, values in (("angles_deg", self.angles_deg), ("tilts_deg", self.tilts_deg)):
            if len(set(values)) != len(values):
                raise ValueError(f"{name} names an angle twice")
        return self

    def poses(self) -> tuple[Pose, ...]:
        """All poses, stage angles fastest, or the single ones."""
        if self.stage_and_tilt_deg is not None:
            return tuple(Pose(stage, tilt) for stage, tilt in self.stage_and_tilt_deg)
        return pose_grid(self.angles_deg, self.tilts_deg)


def check_poses(poses: PosesPart, light_angle_deg: float, path: Path | None = None) -> None:
    """Check that light and camera are above the horizon of the part in every pose.

    Args:
        poses: of the recipe.
        light_angle_deg: of the rig, between light and camera.
        path: of the recipe's file, for the message.

    Raises:
        RecipeError: in some pose one of them is not.
    """
    try:
        directions(poses.poses(), Convention(light_angle_deg))
    except ModelError as problem:
        file = "" if path is None else f"{path}: "
        raise RecipeError(
            f"{file}poses.tilts_deg: {problem}, with the light {light_angle_deg:g}° from the camera: tilt less"
        ) from None
