"""``anisoscope``, and ``python -m anisoscope``.

A stop of a held rig is sent before the command line is even imported, which takes longer than the stop.
"""

import atexit
import contextlib
import gc
import itertools
import os
import sys
from pathlib import Path
from typing import NoReturn

COLLECTED_AFTER = 50_000
"""New objects after which Python looks for cycles; its own 700 let it look a hundred times while a command imports."""
SPINNING_CYCLES = "4"
"""Binary logarithm of the clock cycles that idle threads of OpenBLAS spin; its own 26 cost a tenth of a second each."""


def main() -> NoReturn:
    """Entry point of the ``anisoscope`` command."""
    gc.set_threshold(COLLECTED_AFTER, 10, 10)
    atexit.register(gc.freeze)  # nothing is looked through for cycles when all of it goes
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", SPINNING_CYCLES)
    # pydantic would read the metadata of every installed package to look for plug-ins of its own
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if sys.argv[1:3] == ["rig", "stop"] and not {"--help", "-h", "--driver"} & set(sys.argv):
        _stop_at_once(sys.argv[3:])
    from anisoscope.cli import main as command_line  # noqa: PLC0415 - start-up time

    command_line()


def _stop_at_once(options: list[str]) -> None:
    """Stop held rigs, else interrupt who moves; what came of it is for the command itself, which stops again."""
    from anisoscope.base.errors import AnisoscopeError  # noqa: PLC0415
    from anisoscope.rig.holdline import stop_held  # noqa: PLC0415
    from anisoscope.rig.portholder import interrupt_movers  # noqa: PLC0415

    named = [word.partition("=")[2] for word in options if word.startswith(("--rig=", "-g="))]
    named += [value for word, value in itertools.pairwise(options) if word in {"--rig", "-g"}]
    with contextlib.suppress(AnisoscopeError, OSError):
        if not stop_held(Path(named[0]) if named else None) and named:
            interrupt_movers(Path(named[0]))


if __name__ == "__main__":
    main()
