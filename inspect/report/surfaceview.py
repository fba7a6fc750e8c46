"""All drawings of a height map, begun while the part is still being photographed."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from anisoscope.profiles.heightmap import HeightMap
from anisoscope.report import figures
from anisoscope.report.relief3d import Picture3D, Renderer

PROFILE_UM = 600.0


@dataclass(frozen=True)
class SurfacePictures(Picture3D):
    """The 3-D picture, and as data URIs the map seen from above and a profile across the ridges."""

    above: str = ""
    profile: str = ""


def flat_drawings(surface: HeightMap) -> tuple[str, str]:
    """The map seen from above, and its middle row, as data URIs."""
    line = surface.height_um[surface.shape[0] // 2]
    shown = min(line.size, round(PROFILE_UM / surface.pixel_x_um))
    return (
        figures.height_picture(surface.height_um, (surface.pixel_y_um, surface.pixel_x_um)),
        figures.profile_chart(np.arange(shown) * surface.pixel_x_um, line[:shown]),
    )


class SurfaceView:
    """Draws a height map in the background: in 3-D in a process of its own, flat in a thread.

    Args:
        surface: the height map, levelled.
        meanwhile: what else can be made ready before the verdict; runs in the thread.
    """

    def __init__(self, surface: HeightMap, meanwhile: Callable[[], object]) -> None:
        self._surface = surface
        self._flat: tuple[str, str] | None = None
        self._meanwhile = meanwhile
        self._relief = Renderer(surface.height_um, (surface.pixel_y_um, surface.pixel_x_um), interactive=True)
        # no daemon: Python's end would cut it off within native code, and that aborts the program
        self._thread = threading.Thread(target=self._draw, name="height map drawings")
        self._thread.start()

    def _draw(self) -> None:
        self._flat = flat_drawings(self._surface)
        self._meanwhile()

    def result(self) -> Picture3D:
        """Wait for all drawings."""
        view = self._relief.result()
        self._thread.join()
        above, profile = self._flat or ("", "")
        return SurfacePictures(view.png, view.note, view.scene, above, profile)

    def discard(self) -> None:
        """End the process if it still runs and forget its files; the thread ends by itself, before the program."""
        self._relief.discard()
