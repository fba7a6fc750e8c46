"""Where the part stands in every picture: by the fixture's markers, or by edges where there are none."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import RegistrationError
from anisoscope.base.parallel import for_each
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.edges import TurnedPicture, place_by_edges
from anisoscope.imaging.registration.placement import Placement, View, locate
from anisoscope.rig.fixture import Fixture


@dataclass(frozen=True, eq=False)
class Photograph:
    """One pose as photographed.

    Attributes:
        stage_deg, tilt_deg: commanded angles.
        arm_deg: the tilt at which the arm stood.
        image: the picture.
        guide: what makes of it the picture in which markers and edges are searched, where it is another one.
    """

    stage_deg: float
    tilt_deg: float
    arm_deg: float
    image: RadianceImage
    guide: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]] | None = None


def place(
    photographs: Sequence[Photograph],
    fixture: Fixture | None,
    pixel_um: float,
    axis_px: tuple[float, float] | None = None,
) -> list[View]:
    """Find the part in every picture.

    Without a fixture, or where it allows this and too few of its markers are seen, all pictures are aligned with the
    first one by their edges; the sample's origin is then the rotation axis.

    Args:
        photographs: the first is the reference for edges.
        fixture: the markers.
        pixel_um: size of a pixel on the sample.
        axis_px: (column, row) of the rotation axis, where it was calibrated.

    Raises:
        RegistrationError: neither works.
    """
    if fixture is not None:
        marked = fixture

        def located(one: Photograph) -> Placement:
            return locate(_searched(one), marked, one.arm_deg)

        try:
            return _views(photographs, for_each(located, photographs))
        except RegistrationError as by_markers:
            if fixture.without_markers == "refuse":
                raise
            try:
                return _views(photographs, _by_edges(photographs, pixel_um, axis_px))
            except RegistrationError as by_edges:
                raise RegistrationError(f"{by_markers}; without them: {by_edges}") from by_edges
    return _views(photographs, _by_edges(photographs, pixel_um, axis_px))


def _by_edges(
    photographs: Sequence[Photograph], pixel_um: float, axis_px: tuple[float, float] | None
) -> list[Placement]:
    pictures = [TurnedPicture(_searched(one), one.stage_deg, one.arm_deg) for one in photographs]
    return place_by_edges(pictures, pixel_um, axis_px)


def _views(photographs: Sequence[Photograph], places: Sequence[Placement]) -> list[View]:
    return [
        View(one.stage_deg, one.tilt_deg, one.image, where)
        for one, where in zip(photographs, places, strict=True)
    ]


def _searched(one: Photograph) -> npt.NDArray[np.float32]:
    found = _bright(one.image)
    return found if one.guide is None else one.guide(found)


def _bright(image: RadianceImage) -> npt.NDArray[np.float32]:
    """What is searched; a saturated pixel has no value, but it is surely bright."""
    if not image.saturated.any():
        return image.value
    brightest = image.value.max(initial=0.0, where=image.usable)
    return np.where(image.saturated, brightest, image.value)
