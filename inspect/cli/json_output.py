"""JSON of the commands: results as they are, on standard output; what is not finite becomes null."""

import json
import sys
from typing import Any

from anisoscope.base.json_fields import as_json, fields_of

__all__ = ["as_json", "fields_of", "print_json", "print_json_line"]


def print_json(value: Any) -> int:  # noqa: ANN401 - results of all commands
    """Print a result as JSON; escaped, so that it reaches every terminal and pipe. Returns the exit code 0."""
    sys.stdout.write(json.dumps(as_json(value), indent=2, allow_nan=False) + "\n")
    sys.stdout.flush()
    return 0


def print_json_line(value: Any) -> None:  # noqa: ANN401
    """Print a result as one line of JSON, as soon as it is known."""
    sys.stdout.write(json.dumps(as_json(value), allow_nan=False) + "\n")
    sys.stdout.flush()
