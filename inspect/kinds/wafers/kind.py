"""Etched wafers as a kind of part."""

from collections.abc import Mapping
from typing import Any

from anisoscope.imaging.views import clipped_at_white
from anisoscope.kinds.surface import SurfaceKind
from anisoscope.kinds.wafers.discriminating_poses import WAFER_CAUSES
from anisoscope.kinds.wafers.optics import WAFERS as OPTICS
from anisoscope.kinds.wafers.recipe import WaferRecipe, recognises


class Wafers(SurfaceKind[WaferRecipe]):
    """Mirrors with steps: their contrasts under rotation and tilt, predicted by waves.

    A tile that repeats is at no one place, and its grain is alike everywhere: nothing is matched, fitted or gated.
    """

    name = "wafers"
    one = "a wafer"
    guides = (clipped_at_white,)
    optics = OPTICS
    causes = WAFER_CAUSES

    @property
    def recipe(self) -> type[WaferRecipe]:
        """The model of its recipe."""
        return WaferRecipe

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """What is reflected, whatever the angle, only a mirror states."""
        return recognises(table)


WAFERS = Wafers()
