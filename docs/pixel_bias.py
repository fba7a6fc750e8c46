"""Draw docs/pictures/pixel-bias.png: bias of coarsely sampled ridges over pixel size, with the stated uncertainty.

python docs/pixel_bias.py docs/pictures/pixel-bias.png
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import pixel_bias
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.relief import radiance as relief_radiance

PITCHES_UM, ANGLES_DEG = (100.0, 50.0), (5.0, 10.0, 20.0)
PIXELS_UM = np.geomspace(0.1, 5.0, 18)
POSES = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0, 10.0))
COLOURS = ("#1f6fb2", "#e07b00", "#2b8a4b")
_RIDGES, _ROWS = 20, 3
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class PixelBias:
    """Bias of the relief predictor over pixel size.

    Attributes:
        design: the ridges.
        pixel_um: (N,) pixel sizes.
        bias: (N, F, P) ln of relief over corrected radiance, for F places of the pixels against the crests and
            P poses.
        u: (N,) relative standard uncertainty that is stated for it.
    """

    design: RidgeDesign
    pixel_um: FloatArray
    bias: FloatArray
    u: FloatArray

    @property
    def rms(self) -> FloatArray:
        """(N,) root mean square of the bias over places and poses."""
        return np.asarray(np.sqrt(np.mean(self.bias**2, axis=(1, 2))))

    @property
    def within(self) -> FloatArray:
        """(N,) share of places and poses whose bias lies within 2 u."""
        return np.asarray(np.mean(np.abs(self.bias) <= 2.0 * self.u[:, None, None], axis=(1, 2)))


def find_pixel_bias(
    design: RidgeDesign,
    pixel_um: FloatArray,
    material: Material,
    poses: tuple[Pose, ...],
    convention: Convention,
    places: int = 21,
) -> PixelBias:
    """Sample ideal ridges at many pixel sizes, and compare their prediction with that of the design.

    Args:
        design: the ridges; twenty of them are sampled.
        pixel_um: (N,) pixel sizes.
        material: the plastic.
        poses: P poses, all of them lit.
        convention: how the angles are counted.
        places: F, places of the first crest within a pitch, evenly spread by the golden ratio.
    """
    seen = directions(poses, convention)
    ideal = corrected.radiance(*seen, design, material)
    bias = np.empty((len(pixel_um), places, len(poses)))
    u = np.empty(len(pixel_um))
    for number, pixel in enumerate(pixel_um):
        cols = int(np.ceil(_RIDGES * design.pitch_um / pixel - 1e-9)) + 1
        for place in range(places):
            surface = ridges(design, (_ROWS, cols), (1.0, float(pixel)), (place * _GOLDEN) % 1.0)
            found = relief_radiance(Relief(surface, design.pitch_um), *seen, material)
            bias[number, place] = np.log(found / ideal)
        u[number] = pixel_bias(float(pixel), design.pitch_um, np.ones(1)).absolute[0]
    return PixelBias(design, np.asarray(pixel_um, dtype=np.float64), bias, u)


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
