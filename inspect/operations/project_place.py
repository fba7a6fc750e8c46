"""Where the project file and the user's file of settings are; found without the libraries that read them."""

from pathlib import Path

PROJECT_NAME = "anisoscope.toml"
USER_NAME = "config.toml"


def project_path(folder: Path | None = None) -> Path | None:
    """The project file of a folder or of the nearest folder above it; None without one.

    Args:
        folder: where the search begins; by default the working folder.
    """
    start = (folder or Path.cwd()).resolve()
    return next(
        (one / PROJECT_NAME for one in (start, *start.parents) if (one / PROJECT_NAME).is_file()), None
    )


def user_path() -> Path:
    """The user's file of settings; it need not exist."""
    from platformdirs import user_config_path

    return user_config_path("anisoscope", appauthor=False) / USER_NAME


def project_files() -> list[Path]:
    """The files that exist, the user's first."""
    return [path for path in (user_path(), project_path()) if path is not None and path.is_file()]
