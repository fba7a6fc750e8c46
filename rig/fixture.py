"""The sample holder: printed ArUco markers around the sample, to find position and angle by."""

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Marker(BaseModel):
    """One marker: its number in the dictionary, and its centre in mm in the sample frame."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    id: Annotated[int, Field(ge=0)]
    x_mm: float
    y_mm: float


class Grey(BaseModel):
    """A printed square of one grey: its centre in mm in the sample frame, and its side."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    x_mm: float
    y_mm: float
    size_mm: Annotated[float, Field(gt=0.0)]


class Fixture(BaseModel):
    """The markers of a sample holder.

    The sample frame has x to the right and y up as the camera sees it at sample angle 0, its origin on the
    nominal axis.

    Attributes:
        dictionary: name of a predefined ArUco dictionary of OpenCV.
        marker_mm: side of the black square of a marker.
        markers: the markers.
        greys: grey patches printed beside the markers, by which the linearity of the camera is watched.
        without_markers: what happens where fewer than three of them are seen: "refuse" the pictures, or align them by
            the "edges" of what lies under the camera.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    dictionary: Annotated[str, Field(pattern=r"^DICT_[A-Z0-9_h]+$")] = "DICT_4X4_50"
    marker_mm: Annotated[float, Field(gt=0.0)]
    markers: Annotated[tuple[Marker, ...], Field(min_length=1)]
    greys: tuple[Grey, ...] = ()
    without_markers: Literal["refuse", "edges"] = "refuse"

    @model_validator(mode="after")
    def _check_ids(self) -> "Fixture":
        ids = [marker.id for marker in self.markers]
        twice = sorted({number for number in ids if ids.count(number) > 1})
        if twice:
            raise ValueError(f"marker {twice[0]} is listed twice; every marker needs its own id")
        return self

    @property
    def free_mm(self) -> float:
        """Side in mm of the upright square about the origin that markers and greys leave free; 0 without any.

        Each marker has a module of white round it; rounded down to 0.1 mm.
        """
        quiet = QUIET * self.marker_mm
        ends = [max(abs(one.x_mm), abs(one.y_mm)) - self.marker_mm / 2.0 - quiet for one in self.markers]
        ends += [max(abs(one.x_mm), abs(one.y_mm)) - one.size_mm / 2.0 for one in self.greys]
        return max(0.0, math.floor(20.0 * min(ends)) / 10.0)


QUIET = 1.0 / 6.0
"""White round a marker as a share of its side: a module of the 6 of a 4 × 4 marker."""
