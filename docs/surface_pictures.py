"""Draw docs/pictures/surface-ideal.png and surface-defects.png: made surfaces in slanting light.

python docs/surface_pictures.py docs/pictures
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles import patterns
from anisoscope.profiles.defect_injection import DEFECTS, inject_defect
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges

SEVERITY = 0.5
TO_LIGHT = np.array([0.55, 0.35, 0.76])  # x, y, z; the facets lean toward +x


def ideal() -> dict[str, HeightMap]:
    """The ideal surfaces of the first picture."""
    design, shape = RidgeDesign(60.0, 15.0), (300, 300)
    rough = add_facet_roughness(ridges(design, shape, 1.0), 0.1, 0.15, 6.0, np.random.default_rng(0))
    levels = patterns.etched_levels([0.1073, 0.1575])
    steps = patterns.random_steps(levels, shape, 0.1, (2.0, 2.0), np.random.default_rng(0), spread=1.0)
    return {
        "ridges": ridges(design, shape, 1.0),
        "ridges, direction 30°, vertical wall": patterns.turned_ridges(
            RidgeDesign(60.0, 15.0, "vertical"), shape, 1.0, direction_deg=30.0
        ),
        "ridges, rough facets": rough,
        "V-grooves with land": patterns.v_grooves(patterns.GrooveDesign(60.0, 30.0, 20.0), shape, 1.0),
        "checkerboard": patterns.checkerboard(design, shape, 1.0, 100.0),
        "staircase of 4 levels, random": steps,
    }


def spoiled() -> dict[str, HeightMap]:
    """One part without and with each defect at half severity."""
    smooth = ridges(RidgeDesign(60.0, 15.0), (360, 360), 1.0, phase=0.3)
    part = add_facet_roughness(smooth, 0.02, 0.03, 6.0, np.random.default_rng(0))
    found = {"good part": part}
    for name in DEFECTS:
        found[name] = inject_defect(part, name, np.random.default_rng(1), severity=SEVERITY)
    return found


def draw(surfaces: dict[str, HeightMap], path: Path, columns: int) -> None:
    """Draw every surface in slanting light, with its field and its height."""
    rows = -(-len(surfaces) // columns)
    figure = Figure(figsize=(2.3 * columns, 2.6 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, (name, surface) in zip(panels, surfaces.items(), strict=False):
        height, span = surface.height_um, float(np.ptp(surface.height_um))
        steepen = 1.0 if span > 1.0 else 8.0
        slope_y, slope_x = np.gradient(steepen * height, surface.pixel_y_um, surface.pixel_x_um)
        normal = np.stack([-slope_x, -slope_y, np.ones_like(height)]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
        shade = np.maximum(np.tensordot(TO_LIGHT, normal, 1), 0.0) ** 2
        axes.imshow(shade, cmap="gray", origin="lower", vmin=0.0, vmax=1.0, interpolation="antialiased")
        field = surface.extent_um
        axes.set_title(f"{name}\n{field[1]:g} × {field[0]:g} µm, Sz {span:.3g} µm", fontsize=7.5)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    """Draw both pictures into a folder."""
    folder = Path(sys.argv[1])
    draw(ideal(), folder / "surface-ideal.png", 3)
    draw(spoiled(), folder / "surface-defects.png", 4)


if __name__ == "__main__":
    main()
