"""The files of the demo with prints: recipe, one bench and rig file a part, and a flat of a colour camera."""

from typing import Any

import numpy as np

from anisoscope.operations.demo.folder import FIXTURE, TILE, Files, Scene, flat_of, rig_table, tile_sample

PARTS = {"good": "PASS", "brushed": "FAIL", "wrong-ink": "FAIL", "spot": "FAIL"}
INK = "synthetic-green"
LAMP = "led-white"
EXPOSURE_S, FLAT_EXPOSURE_S = 0.008, 0.012
PIXEL_UM, PIXELS = 6.3, 640
TILTS_DEG = [0.0, 10.0, 20.0, -20.0, -10.0]
DELTA_E = 2.4
"""Limit that 90 % of prints pass whose ink and rig are off as their files allow (`recipe check`)."""
DEFECTS: dict[str, dict[str, Any]] = {
    "good": {},
    "brushed": {"anisotropy": 1.15, "brush_deg": 20.0},
    "wrong-ink": {"wrong_ink": "synthetic-red", "wrong_share": 0.05},
    "spot": {"spots": [{"x_mm": 0.3, "y_mm": -0.4, "diameter_mm": 0.4, "missing_share": 0.6}]},
}


def recipe_of(ink: str) -> dict[str, Any]:
    """The recipe of a print with one of the synthetic inks."""
    return {
        "schema": 1,
        "product": f"demo print, {ink}",
        "print": {"ink": ink, "wrong_inks": [name for name in _INKS if name != ink]},
        "poses": {"tilts_deg": TILTS_DEG},
        "acquisition": {
            "exposure_s": EXPOSURE_S,
            "brackets": [8.0],
            "frames_per_pose": 2,
            "dark_frames": 4,
            "settle_s": 0.0,
        },
        "region": {"size_mm": [2.0, 2.0]},
        "decision": {"unexcluded": "inconclusive"},
    }


_INKS = ("synthetic-red", "synthetic-green", "synthetic-blue")


def sample_of(defects: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A sheet of a good print, as prints vary, with defects."""
    varied = {"alpha_share": float(0.005 * rng.standard_normal()), "substrate": 0.04, "ink": INK}
    return {
        "kind": "print",
        "size_mm": 2.4,
        "seating_tilt_deg": [float(tilt) for tilt in 0.05 * rng.standard_normal(2)],
        "print": varied | defects,
    }


def bench_of(sample: dict[str, Any], seed: int) -> dict[str, Any]:
    """A bench with a colour camera, a white lamp and an axis that tilts the arm."""
    return {
        "schema": 1,
        "seed": seed,
        "sample": sample,
        "sensor": {"rows": PIXELS, "cols": PIXELS, "filters": "rggb"},
        "optics": {"pixel_um": PIXEL_UM, "spectrum": LAMP},
        "tilt": {"zero_deg": 30.0},
        "fixture": FIXTURE,
    }


def rig_of(flat: str | None) -> dict[str, Any]:
    """The rig file of such a bench."""
    camera = {"pixel_um": PIXEL_UM, "sensitivities": "synthetic"}
    return rig_table(
        "virtual colour rig", camera, {"angle_deg": 10.0, "spectrum": LAMP}, tilts=True, flat=flat
    )


def _files(name: str, rng: np.random.Generator) -> Files:
    sample = tile_sample() if name == TILE else sample_of(DEFECTS[name], rng)
    return bench_of(sample, int(rng.integers(2**31))), rig_of(flat_of(name))


def _recipe(*_: object) -> dict[str, Any]:
    return recipe_of(INK) | {"tolerances": {"delta_e": DELTA_E}}


SCENE = Scene(PARTS, 300, _recipe, _files, FLAT_EXPOSURE_S)
