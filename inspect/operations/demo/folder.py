"""Common files of the demos of all kinds: the folder, one bench and one rig file a part, and the flat of a tile."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.calibration.pictures import take_flat
from anisoscope.parameters.taking import Taking

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
TILE, TILE_REFLECTANCE = "white-tile", 0.99
FLAT, FLAT_FRAMES = "flat.tif", 16
MARKERS, MARKER_FRAMES, EMPTY = "fixture.json", 2, "empty-fixture"
PORT, BENCH = "sim://elliptec?bench=${here}/bench.toml", {"bench": "${here}/bench.toml"}


Files = tuple[dict[str, Any], dict[str, Any]]
"""Tables of a bench file and of a rig file."""


@dataclass(frozen=True)
class Scene:
    """Parts of a demo and their files.

    Attributes:
        parts: name -> verdict that it should get.
        megabytes: size of the folder of one demo.
        recipe: writes what the recipe names into a folder, and returns the recipe.
        files: tables of bench and rig by the name of a part, or of `TILE`; called for the parts in turn.
        flat_exposure_s: of the white tile.
    """

    parts: Mapping[str, str]
    megabytes: int
    recipe: Callable[[Path, np.random.Generator, Advance], dict[str, Any]]
    files: Callable[[str, np.random.Generator], Files]
    flat_exposure_s: float

    def lay_out(self, out: Path, seed: int, advance: Advance = silent) -> Path:
        """Write all files of the demo below ``out`` and take the flat on the virtual rig.

        Args:
            out: folder, made if it is missing; the parts are in ``bench/NAME`` below it.
            seed: seed of everything random.
            advance: progress.

        Returns:
            The folder, absolute.

        Raises:
            UsageError: a negative seed.
            RecordError: the folder cannot be made.
        """
        if seed < 0:
            raise UsageError(f"--seed must be 0 or a positive whole number, not {seed}")
        folder, rng = out.resolve(), np.random.default_rng(seed)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(f"cannot make the folder {out}: {error.strerror}") from error
        recipe = self.recipe(folder, rng, advance)
        (folder / "recipe.toml").write_text(tomli_w.dumps(recipe), encoding="utf-8")
        tilts = recipe["poses"].get("tilts_deg", (0.0,))
        write_benches(
            folder, self.parts, lambda name: self.files(name, rng), self.flat_exposure_s, advance, tilts
        )
        return folder


def write_bench(folder: Path, name: str, bench: dict[str, Any], rig: dict[str, Any]) -> None:
    """Write ``bench/NAME/bench.toml`` and ``rig.toml`` of a part below the folder of a demo."""
    place = folder / "bench" / name
    place.mkdir(parents=True, exist_ok=True)
    (place / "bench.toml").write_text(tomli_w.dumps(bench), encoding="utf-8")
    (place / "rig.toml").write_text(tomli_w.dumps(rig), encoding="utf-8")


def tile_sample() -> dict[str, Any]:
    """The sample table of the white tile."""
    return {"kind": TILE, "reflectance": TILE_REFLECTANCE}


def write_benches(
    folder: Path,
    parts: Iterable[str],
    files: Callable[[str], Files],
    exposure_s: float,
    advance: Advance,
    tilts: Sequence[float] = (0.0,),
) -> None:
    """Write the files of all parts and of a white tile; take the flat of the tile and the reference of the fixture.

    Args:
        folder: of the demo.
        parts: their names.
        files: tables of bench and rig by the name of a part, called for the parts in turn and for `TILE`.
        exposure_s: of the tile, and of the markers.
        advance: progress.
        tilts: of the arm, in degrees, at which the fixture is photographed.
    """
    for name in parts:
        bench, rig = files(name)
        taught = rig["calibration"] | {"fixture": f"../../{MARKERS}"}
        write_bench(folder, name, bench, rig | {"calibration": taught})
    bench, rig = files(TILE)
    write_bench(folder, TILE, bench, rig)
    write_bench(
        folder, EMPTY, bench | {"sample": {"kind": "none"}}, rig | {"calibration": {"flat": flat_of(EMPTY)}}
    )
    advance("flat of the white tile", 0, 1)
    take_flat(
        folder / "bench" / TILE / "rig.toml",
        folder / FLAT,
        exposure_s=exposure_s,
        frames=FLAT_FRAMES,
        reflectance=TILE_REFLECTANCE,
    )
    taking = Taking(exposure_s, frames=MARKER_FRAMES)
    calibrate_fixture(
        folder / "bench" / EMPTY / "rig.toml",
        folder / MARKERS,
        taking,
        tilts=tuple(tilts),
        on_progress=advance,
    )


def flat_of(name: str) -> str | None:
    """Path of the flat from the folder of a part; None for the white tile, which has none yet."""
    return None if name == TILE else f"../../{FLAT}"


def rig_table(
    title: str,
    camera: dict[str, Any],
    light: dict[str, Any],
    *,
    flat: str | None,
    tilts: bool = False,
) -> dict[str, Any]:
    """The rig file of a bench: stage, camera and light, and an axis that tilts the arm.

    Args:
        title: name of the rig.
        camera: keys beside driver and bench.
        light: the same of the light.
        flat: path of the flat; None for the rig that takes it.
        tilts: whether there is an axis for tilts.
    """
    axis = {"driver": "elliptec", "port": PORT}
    found: dict[str, Any] = {
        "schema": 1,
        "name": title,
        "stage": {**axis, "zero_deg": 10.0, "options": {"address": "0"}},
        "camera": {"driver": "simulated", **camera, "options": BENCH},
        "light": {"driver": "simulated", **light, "options": BENCH},
        "fixture": FIXTURE,
    }
    if tilts:
        found["tilt"] = {**axis, "zero_deg": 30.0, "options": {"address": "1"}}
    if flat is not None:
        found["calibration"] = {"flat": flat}
    return found
