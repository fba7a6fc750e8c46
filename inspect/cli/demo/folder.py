"""Common files of the demos of all kinds: the folder, and one bench and one rig file a part."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from anisoscope.base.errors import RecordError, UsageError

FIXTURE = {
    "marker_mm": 0.52,
    "markers": [
        {"id": 0, "x_mm": 1.56, "y_mm": 0.0},
        {"id": 1, "x_mm": 0.0, "y_mm": 1.56},
        {"id": 2, "x_mm": -1.56, "y_mm": 0.0},
        {"id": 3, "x_mm": 0.0, "y_mm": -1.56},
    ],
}
"""Four markers round the part."""


def begin(out: Path, seed: int) -> tuple[Path, np.random.Generator]:
    """Absolute folder of a demo, created if missing, and its random generator.

    Raises:
        UsageError: a negative seed.
        RecordError: the folder cannot be made.
    """
    if seed < 0:
        raise UsageError(f"--seed must be 0 or a positive whole number, not {seed}")
    folder = out.resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"cannot make the folder {out}: {error.strerror}") from error
    return folder, np.random.default_rng(seed)


def write_bench(folder: Path, name: str, bench: dict[str, Any], rig: dict[str, Any]) -> None:
    """Write ``bench/NAME/bench.toml`` and ``rig.toml`` of a part below the folder of a demo."""
    place = folder / "bench" / name
    place.mkdir(parents=True, exist_ok=True)
    (place / "bench.toml").write_text(tomli_w.dumps(bench), encoding="utf-8")
    (place / "rig.toml").write_text(tomli_w.dumps(rig), encoding="utf-8")
