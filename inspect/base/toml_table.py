"""Tables of a TOML file, with limits of size and depth: a hostile or damaged file is one line, never a crash."""

import tomllib
from pathlib import Path
from typing import Any

from anisoscope.base.errors import ConfigError
from anisoscope.base.json_file import is_deeper
from anisoscope.base.regular_file import regular_file

MOST_BYTES = 4 << 20
"""Size in bytes; the largest recipes of inspections take some thousand."""
MOST_LEVELS = 32
"""Tables and lists within each other; recipes have five."""


def read_toml(path: Path, error: type[ConfigError] = ConfigError) -> dict[str, Any]:
    """The table of a file in UTF-8, with or without byte order mark.

    Args:
        path: the file, at most 4 MiB.
        error: raised for every mistake.

    Raises:
        ConfigError: as ``error``; the file is missing, too large, not UTF-8, no TOML, or nested too deeply.
    """
    try:
        with regular_file(path) as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise error(f"{path}: more than {MOST_BYTES >> 20} MiB: this is not a file of settings")
        table = tomllib.loads(content.decode("utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise error(f"{path}: not a text file in UTF-8") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from problem
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: not valid TOML: {problem}") from None
    except ValueError:  # of a whole number with thousands of digits
        raise error(f"{path}: not valid TOML: a number has too many digits") from None
    except RecursionError:
        raise _too_deep(path, error) from None
    if is_deeper(table, MOST_LEVELS):
        raise _too_deep(path, error)
    return table


def _too_deep(path: Path, error: type[ConfigError]) -> ConfigError:
    return error(
        f"{path}: tables or lists nested more than {MOST_LEVELS} deep: this is not a file of settings"
    )
