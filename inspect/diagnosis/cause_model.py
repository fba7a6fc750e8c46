"""Cause model of one kind of part: causes, their signatures, and measurements that separate them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from anisoscope.base.arrays import FloatArray
from anisoscope.base.progress import Advance
from anisoscope.diagnosis.causes import Cause
from anisoscope.diagnosis.signatures import Signatures, causes_of, changes_at, signatures
from anisoscope.recipe.surface import SurfaceRecipe


@dataclass(frozen=True)
class Option:
    """A further measurement that may separate causes.

    Attributes:
        kind: "angles", "tilt" or "lamp".
        says: the measurement in words.
        separation_extents: by cause and other cause, the least extent at which the measurement separates the one from
            all extents of the other, or None.
    """

    kind: str
    says: str
    separation_extents: dict[str, dict[str, float | None]]

    def separates(self, one: tuple[str, float], other: tuple[str, float]) -> bool:
        """Whether the measurement separates two causes of these names and extents, whichever is true."""
        return self._separates(one, other[0]) and self._separates(other, one[0])

    def _separates(self, cause: tuple[str, float], other: str) -> bool:
        least = self.separation_extents.get(cause[0], {}).get(other)
        return least is not None and abs(least) <= abs(cause[1])


@dataclass(frozen=True)
class CauseModel:
    """The causes of one kind of part, as its model predicts them.

    Attributes:
        causes: all causes considered for the part of a recipe.
        signatures: their signatures, by recipe, the rig's light angle, progress, and names of causes (None: all).
        options: measurements that separate causes of these names, by recipe, light angle, names, and progress; None if
            not computed.
        changes: change of ln L of every pose by causes of given extents, by recipe and light angle; None where
            `options` say what separates causes, or nothing does.
    """

    causes: Callable[[SurfaceRecipe], tuple[Cause, ...]]
    signatures: Callable[[SurfaceRecipe, float, Advance, Sequence[str] | None], Signatures]
    options: Callable[[SurfaceRecipe, float, Sequence[str], Advance], tuple[Option, ...]] | None = None
    changes: Callable[[SurfaceRecipe, float, Mapping[str, float]], dict[str, FloatArray]] | None = None


PLASTIC_CAUSES = CauseModel(causes_of, signatures, changes=changes_at)
