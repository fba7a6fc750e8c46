"""Project file ``anisoscope.toml``: values that commands take where their command line leaves them out.

The file is searched in the working folder and all folders above it; what it does not state is taken from the file
``config.toml`` in the user's folder of settings.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from anisoscope.base.errors import ConfigError
from anisoscope.base.printable import Printable
from anisoscope.base.toml_file import LocalPath, Part, read_toml_model
from anisoscope.operations.project_place import project_files


class ProjectFile(Part):
    """Keys of the project file; paths count from its folder."""

    recipe: LocalPath | None = None
    rig: LocalPath | None = None
    out: LocalPath | None = None
    history: str | None = Field(default=None, min_length=1)
    store: str | None = Field(default=None, min_length=1)
    operator: Printable | None = Field(default=None, min_length=1)
    station: Printable | None = Field(default=None, min_length=1)
    lang: Literal["en", "de", "da"] | None = None
    csv_style: Literal["comma", "semicolon"] | None = None
    signing_key: str | None = Field(default=None, min_length=1)


@dataclass(frozen=True)
class Default:
    """A value and the file that states it."""

    value: str
    source: Path


def read_project(path: Path) -> dict[str, Default]:
    """Values of one file.

    Raises:
        ConfigError: the file cannot be read, or has an unknown key.
    """
    found = read_toml_model(path, ProjectFile, error=ConfigError)
    values = {name: value for name, value in found.model_dump().items() if value is not None}
    if found.history is not None and found.history != "none" and "://" not in found.history:
        values["history"] = path.resolve().parent / found.history
    if found.signing_key is not None and ":" not in found.signing_key and found.signing_key != "none":
        values["signing_key"] = path.resolve().parent / found.signing_key
    if found.store is not None and "://" not in found.store:
        values["store"] = path.resolve().parent / found.store
    return {name: Default(str(value), path) for name, value in values.items()}


def project_defaults() -> dict[str, Default]:
    """Values of the project file, and of the user's file what that leaves out.

    Raises:
        ConfigError: one of the files cannot be read.
    """
    found: dict[str, Default] = {}
    for path in project_files():
        found |= read_project(path)
    return found
