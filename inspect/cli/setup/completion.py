"""``anisoscope completion``: names of commands, options and choices at the Tab key."""

import sys
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli import app
from anisoscope.cli.options import Flag

Shell = Literal["bash", "zsh", "fish", "powershell"]


def completion(
    shell: Shell | None = None,
    /,
    *,
    install: Flag = False,
    out: Path | None = None,
) -> int:
    """Print or install the script by which bash, zsh, fish or PowerShell complete commands and options.

    Args:
        shell: Which shell; by default the one that runs this command.
        install: Write the script where the shell finds it, and load it at its start.
        out: With --install: write the script to this file instead.

    Examples:
        anisoscope completion bash --install
        anisoscope completion powershell
    """
    from cyclopts.completion.detect import ShellDetectionError

    if out is not None and not install:
        raise UsageError("--out belongs to --install; without it the script is printed")
    try:
        if install:
            print(f"{_installed(shell, out)}: written; open a new shell")  # noqa: T201
        else:
            sys.stdout.write(app.generate_completion(shell=shell))
    except ShellDetectionError:
        raise UsageError("the shell is not known: name bash, zsh, fish or powershell") from None
    except OSError as error:
        raise RecordError(f"the script cannot be written: {error}") from error
    return 0


def _installed(shell: Shell | None, out: Path | None) -> Path:
    return app.install_completion(shell=shell, output=out, add_to_startup=out is None)
