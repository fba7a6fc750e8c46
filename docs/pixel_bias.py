"""Draw docs/pictures/pixel-bias.png: bias of coarsely sampled ridges over pixel size, with the stated uncertainty.

python docs/pixel_bias.py docs/pictures/pixel-bias.png
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anisoscope.prediction.pixel_bias import PixelBias, find_pixel_bias
from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.geometry import Convention, pose_grid
from anisoscope.sim.light.material import Material

PITCHES_UM, ANGLES_DEG = (100.0, 50.0), (5.0, 10.0, 20.0)
PIXELS_UM = np.geomspace(0.1, 5.0, 18)
POSES = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0, 10.0))
COLOURS = ("#1f6fb2", "#e07b00", "#2b8a4b")


def find() -> dict[tuple[float, float], PixelBias]:
    """The bias of every pitch and ridge angle of the figure."""
    return {
        (pitch, angle): find_pixel_bias(RidgeDesign(pitch, angle), PIXELS_UM, Material(), POSES, Convention())
        for pitch in PITCHES_UM
        for angle in ANGLES_DEG
    }


def draw(found: dict[tuple[float, float], PixelBias], path: Path) -> None:
    """Draw rms and largest bias beside u and 2 u, one panel a pitch."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, pitch in zip(figure.subplots(1, 2, sharey=True), PITCHES_UM, strict=True):
        u = 100.0 * found[pitch, ANGLES_DEG[0]].u
        axes.fill_between(PIXELS_UM, 1e-4, u, color="#d7dee5", label="stated u")
        axes.plot(PIXELS_UM, 2.0 * u, color="#5b6b7b", linewidth=0.8, label="2 u")
        for angle, colour in zip(ANGLES_DEG, COLOURS, strict=True):
            one = found[pitch, angle]
            axes.plot(PIXELS_UM, 100.0 * one.rms, color=colour, label=f"ridge angle {angle:g}°, rms")
            largest = np.abs(one.bias).max(axis=(1, 2))
            axes.plot(PIXELS_UM, 100.0 * largest, ".", color=colour, markersize=3)
        axes.set(xscale="log", yscale="log", ylim=(1e-3, 40.0), title=f"pitch {pitch:g} µm")
        axes.set(xlabel="pixel size [µm]", xlim=(PIXELS_UM[0], PIXELS_UM[-1]))
        axes.set_xticks([0.1, 0.2, 0.5, 1.0, 2.0, 5.0], labels=["0.1", "0.2", "0.5", "1", "2", "5"])
        axes.set_xticks([], minor=True)
        axes.grid(visible=True, linewidth=0.4)
    figure.axes[0].set_ylabel("|relief / corrected − 1| [%]")
    figure.axes[0].legend(fontsize=7, loc="upper left")
    figure.savefig(path, dpi=130, metadata={"Software": None})


def main() -> None:
    """Draw, and print how well u covers the bias with 12 pixels a pitch and more."""
    found = find()
    draw(found, Path(sys.argv[1]))
    print("pitch  angle  largest rms/u  least share within 2 u  (12 pixels a pitch and more)")  # noqa: T201
    for (pitch, angle), one in found.items():
        fine = one.pixel_um <= pitch / 12.0
        ratio, share = np.max((one.rms / one.u)[fine]), one.within[fine].min()
        print(f"{pitch:5g}  {angle:5g}  {ratio:13.2f}  {share:22.3f}")  # noqa: T201


if __name__ == "__main__":
    main()
