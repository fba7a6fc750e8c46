"""Draw docs/pictures/plate-pictures.png: two pictures, and what a plate of ridges shows of them.

python docs/plate_pictures.py docs/pictures
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import skimage.data
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.design.plates import design_pictures

FIELDS = 96


def main() -> None:
    """Draw the picture into a folder."""
    astronaut = cv2.cvtColor(skimage.data.astronaut(), cv2.COLOR_RGB2GRAY)
    pictures = [
        cv2.resize(one, (FIELDS, FIELDS), interpolation=cv2.INTER_AREA) / 255.0
        for one in (skimage.data.camera(), astronaut)
    ]
    ridges = RidgeDesign(50.0, 8.0, 10.0, edge_radius_um=1.0)
    found = design_pictures(np.array(pictures), (0.0, 90.0), ridges, 100.0, Material(), 10.0)
    similar, talk = found.likeness()
    figure = Figure(figsize=(9.0, 2.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 4)
    for number in range(2):
        panels[number].imshow(pictures[number], cmap="gray", vmin=0.0, vmax=1.0)
        panels[number].set_title(f"picture for {found.stages_deg[number]:g}°", fontsize=8)
        # what the camera sees: the plate has turned counter-clockwise by the stage angle
        panels[2 + number].imshow(
            np.rot90(found.shown[number], number), cmap="gray", vmin=found.black, vmax=found.white
        )
        panels[2 + number].set_title(
            f"plate at {found.stages_deg[number]:g}°: SSIM {similar[number]:.2f}, cross-talk {talk[number]:.1%}",
            fontsize=8,
        )
    for axes in panels:
        axes.set_axis_off()
    figure.savefig(Path(sys.argv[1]) / "plate-pictures.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
