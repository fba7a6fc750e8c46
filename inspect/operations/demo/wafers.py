"""The files of the demo with wafers: design, layout, the tile as a height map, recipe, benches, rig files, and a flat.

The lamp shines along the camera's axis, as through a beam splitter: at tilt 0 the camera stands in the mirror
direction, where a spike shows wrong etching, and at a small tilt it sees the foot of the lobe, bright at 90° and dark
at 0° and 180°.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anisoscope.base.progress import Advance
from anisoscope.operations.demo.folder import FIXTURE, TILE, Files, Scene, flat_of, rig_table, tile_sample
from anisoscope.profiles.files.load import write_height_map

if TYPE_CHECKING:
    from anisoscope.sim.design.designfile import DesignFile

PARTS = {"good": "PASS", "over-etched": "FAIL", "wide": "FAIL"}
WAVELENGTH_NM = 520.0
COHERENCE_UM = 40.0
SIGMA = (0.04, 0.02)
"""Half widths of the lobe along x and y, in units of h."""

DOT_UM, DOTS = 128.0, 4
TILE_UM = DOT_UM * DOTS
DRAWS = 12
TILT_DEG = 3.0
OVER_ETCH_NM = 20.0
WIDTH_BIAS_NM = 640.0  # far more than the waves of the edges, which act like 210 nm at most
LIGHT = {
    "wavelength_nm": WAVELENGTH_NM,
    "bandwidth_nm": 10.0,
    "lamp_half_angle_deg": 0.3,
    "aperture_half_angle_deg": 0.7,
}
FLAT_EXPOSURE_S = 0.03
EXPOSURE_S = 2.5e-5  # grains in the spike of wrong etching shine five to ten times as bright as their mean
REFLECTANCE, SCATTER = 0.9, 0.001
SEATING_DEG, TILT_ZERO_DEG = 0.05, 0.02
ETCH_DEPTH_NM, ETCH_WIDTH_NM = 1.0, 20.0


def design() -> "DesignFile":
    """A glossy lobe, wide along x and narrow along y, of quarter-wave steps: it has no spike."""
    from anisoscope.sim.design.depths import design_depths
    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.lobe import LobeTask, design_lobe
    from anisoscope.sim.design.models import LobeModel

    tasks = [
        LobeTask(sigma, wavelength_um=1e-3 * WAVELENGTH_NM, coherence_um=COHERENCE_UM) for sigma in SIGMA
    ]
    found = design_lobe(*tasks)
    found.check()
    x, y = found.x.widths, found.y.widths
    model = LobeModel(
        widths_x_um=x.widths_um, p_a_x=x.probabilities, widths_y_um=y.widths_um, p_a_y=y.probabilities
    )
    depths = design_depths(2, (WAVELENGTH_NM, WAVELENGTH_NM))
    return DesignFile(
        name="wide along x",
        model=model,
        passes_nm=depths.passes_nm,
        wavelength_nm=WAVELENGTH_NM,
        band_nm=depths.band_nm,
        coherence_um=COHERENCE_UM,
        figures={"rel_l2": found.rel_l2},
    )


def write_tile(folder: Path, rng: np.random.Generator) -> None:
    """Write ``design.toml``, the layout ``wafer.npz``, and ``tile.npz``: the height map that the recipe names.

    Of several random tiles the one is taken of which just half is etched: else a width bias could balance it first.
    """
    from anisoscope.parameters.etching import PatternOptions
    from anisoscope.sim.design.designfile import write_design, write_layout
    from anisoscope.sim.design.pattern import make_layout

    pattern = design()
    classes = np.zeros((DOTS, DOTS), dtype=np.int64)
    drawn = [make_layout(classes, (pattern,), rng, PatternOptions(DOT_UM, DOTS**2)) for _ in range(DRAWS)]
    layout = min(drawn, key=lambda one: abs(float(one.tiles[one.index].mean()) - 0.5))
    write_design(pattern, folder / "design.toml")
    write_layout(layout, folder / "wafer.npz", (pattern,))
    write_height_map(layout.window(), folder / "tile.npz")


def recipe() -> dict[str, Any]:
    """The recipe of the wafer."""
    return {
        "schema": 1,
        "product": "etched demo wafer, lobe wide along x",
        "surface": {"height_map": "tile.npz", "pitch_um": TILE_UM},
        "material": {"reflectance": REFLECTANCE, "albedo": SCATTER, "u_albedo": 0.3 * SCATTER},
        "light": LIGHT,
        "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, TILT_DEG]},
        "acquisition": {
            "exposure_s": EXPOSURE_S,
            "brackets": [12.0, 160.0],
            "frames_per_pose": 3,
            "dark_frames": 4,
            "settle_s": 0.0,
        },
        "region": {"size_mm": [3.0 * TILE_UM / 1000.0, 3.0 * TILE_UM / 1000.0]},
        "decision": {
            "contrast": "log_ratio",
            "alpha": 0.001,
            "deviation": "fail",
            "unexcluded": "inconclusive",
        },
        "uncertainty": {
            "seating_tilt_deg": SEATING_DEG,
            "light_angle_deg": 0.05,
            "tilt_deg": TILT_ZERO_DEG,
            "etch_depth_nm": ETCH_DEPTH_NM,
            "etch_width_nm": ETCH_WIDTH_NM,
        },
    }


def sample(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """The sample table of a part: etching, lamp, lens and seating with the recipe's uncertainties, and its defect."""
    if name == TILE:
        return tile_sample()

    def about(value: float, u: float) -> float:
        return float(value + u * rng.standard_normal())

    return {
        "kind": "wafer",
        "size_mm": 1.9,
        "seating_tilt_deg": [about(0.0, SEATING_DEG), about(0.0, SEATING_DEG)],
        "wafer": {
            "file": "../../wafer.npz",
            "over_etch_nm": about(OVER_ETCH_NM if name == "over-etched" else 0.0, ETCH_DEPTH_NM),
            "width_bias_nm": about(WIDTH_BIAS_NM if name == "wide" else 0.0, ETCH_WIDTH_NM),
            "reflectance": about(REFLECTANCE, 0.01),
            "scatter": abs(about(SCATTER, 0.3 * SCATTER)),
            "wavelength_nm": about(LIGHT["wavelength_nm"], 0.5),
            "bandwidth_nm": about(LIGHT["bandwidth_nm"], 0.5),
            "lamp_half_angle_deg": about(LIGHT["lamp_half_angle_deg"], 0.01),
            "aperture_half_angle_deg": about(LIGHT["aperture_half_angle_deg"], 0.01),
        },
    }


def bench(sample: dict[str, Any], seed: int) -> dict[str, Any]:
    """The bench file about a sample."""
    return {
        "schema": 1,
        "seed": seed,
        "sample": sample,
        "geometry": {"light_angle_deg": 0.0},
        "sensor": {"rows": 672, "cols": 672},
        "optics": {"pixel_um": 6.0, "blur_um": 5.0, "electrons": 2.0e6},
        "tilt": {"address": "1", "zero_deg": 30.0},
        "fixture": FIXTURE,
    }


def rig(name: str) -> dict[str, Any]:
    """The rig file of a part; the white tile's has no flat yet."""
    camera = {"pixel_um": 6.0, "half_angle_deg": LIGHT["aperture_half_angle_deg"]}
    light = {
        "angle_deg": 0.0,
        "wavelength_nm": LIGHT["wavelength_nm"],
        "bandwidth_nm": LIGHT["bandwidth_nm"],
        "half_angle_deg": LIGHT["lamp_half_angle_deg"],
    }
    return rig_table(
        "virtual rig, lamp along the camera's axis", camera, light, tilts=True, flat=flat_of(name)
    )


def _recipe(folder: Path, rng: np.random.Generator, advance: Advance) -> dict[str, Any]:
    advance("wafer design", 0, 1)
    write_tile(folder, rng)
    return recipe()


def _files(name: str, rng: np.random.Generator) -> Files:
    return bench(sample(name, rng), int(rng.integers(2**31))), rig(name)


SCENE = Scene(PARTS, 350, _recipe, _files, FLAT_EXPOSURE_S)
