"""Result of teaching a recipe from good parts: the changes, and the path of the previous version."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anisoscope.base.errors import RecordError


@dataclass(frozen=True)
class Change:
    """Old and new value of a recipe entry."""

    key: str
    old: Any
    new: Any
    why: str


@dataclass(frozen=True)
class Taught:
    """A taught recipe.

    Attributes:
        version: the new one.
        kept: path of the previous version.
        folder: the inspection of the good part with the new exposure and region; None where none was inspected.
        changes: what was changed.
        notes: further remarks for the user.
    """

    version: int
    kept: Path
    folder: Path | None
    changes: tuple[Change, ...]
    notes: tuple[str, ...]


def previous_version_path(recipe_path: Path, version: int) -> Path:
    """Path for the previous version.

    Raises:
        RecordError: another file has this name.
    """
    path = recipe_path.with_name(f"{recipe_path.stem}.v{version}{recipe_path.suffix}")
    if path.exists():
        raise RecordError(f"{path} exists already: move it away, or correct `version` in {recipe_path}")
    return path
