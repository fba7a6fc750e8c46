"""A recipe that was taught by good parts: what changed, and where the version before lies."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from anisoscope.base.errors import RecordError


@dataclass(frozen=True)
class Change:
    """A value of the recipe, as it was and is."""

    key: str
    old: Any
    new: Any
    why: str


@dataclass(frozen=True)
class Taught:
    """A recipe that was taught.

    Attributes:
        version: the new one.
        kept: where the old version lies.
        folder: the inspection of the good part with the new exposure and region; None where none was inspected.
        changes: what was changed.
        notes: what the user should know besides.
    """

    version: int
    kept: Path
    folder: Path | None
    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """For `json.dump`."""
        folder = None if self.folder is None else str(self.folder)
        return asdict(self) | {"kept": str(self.kept), "folder": folder}


def previous_version_path(recipe_path: Path, version: int) -> Path:
    """Where the old version goes.

    Raises:
        RecordError: something else lies there.
    """
    path = recipe_path.with_name(f"{recipe_path.stem}.v{version}{recipe_path.suffix}")
    if path.exists():
        raise RecordError(f"{path} exists already: move it away, or correct `version` in {recipe_path}")
    return path
