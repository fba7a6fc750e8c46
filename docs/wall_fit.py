"""Print how well walls and crests are known from height maps: error of predictions, and uncertainty stated for it.

python docs/wall_fit.py [MAPS]

Ridges of 10°, pitch 100 µm, walls 70° to 90°, edge radius 0.5 to 2 µm, are sampled with pixels of 0.5 to 4 µm at any
phase, half of them whole pixels a pitch, a third in an oblique direction, and predicted as a measured map.
"""

import sys
from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.height_map_uncertainty import edge_contributions, pixel_bias, relief_model
from anisoscope.prediction.relief_preparation import prepare_relief
from anisoscope.prediction.ridge_edges import ridge_edges
from anisoscope.profiles.patterns import turned_ridges
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

POSES = (Pose(0.0), Pose(90.0), Pose(180.0))
PLASTIC = Material(0.08, 0.08, 0.1)
PIXELS_UM = (0.5, 1.0, 2.0, 4.0)
FIELD_UM, HEIGHT_UM = 620.0, 130.0
OBLIQUE_DEG = (0.0, 90.0, 37.0)
NOISE = 0.005  # of a pixel
BOUNCES = 2


@dataclass(frozen=True, eq=False)
class Drawn:
    """One map.

    Attributes:
        pixel_um: its pixel.
        before: (P,) ln of the prediction without the fit over the truth, with a perpendicular wall.
        after: (P,) the same with the fit.
        u_before: (P,) relative standard uncertainty stated without the fit.
        u_after: (P,) the same with it.
    """

    pixel_um: float
    before: FloatArray
    after: FloatArray
    u_before: FloatArray
    u_after: FloatArray


def draw(rng: np.random.Generator, pixel_um: float) -> Drawn | None:
    """Sample and predict one surface; None where no profile can be fitted."""
    pitch = 100.0 if rng.random() < 0.5 else float(100.0 + rng.uniform(-1.0, 1.0))
    design = RidgeDesign(pitch, 10.0, float(rng.uniform(0.0, 20.0)), 0.0, float(rng.uniform(0.5, 2.0)))
    direction = float(rng.choice(OBLIQUE_DEG))
    long, short = int(FIELD_UM / pixel_um), max(int(HEIGHT_UM / pixel_um), 60)
    shape = {0.0: (short, long), 90.0: (long, short)}.get(direction, (long, long))
    surface = turned_ridges(design, shape, pixel_um, direction_deg=direction, phase=float(rng.random()))
    noise = NOISE * pixel_um * rng.standard_normal(shape)
    relief, _ = prepare_relief(surface.with_height(surface.height_um + noise), 100.0)
    sides = directions(POSES, Convention())
    truth = corrected.radiance(*sides, design, PLASTIC, BOUNCES)
    edges = ridge_edges(relief)
    if edges is None:
        return None
    sharp = corrected.indirect_radiance(*sides, RidgeDesign(pitch, 10.0), PLASTIC, BOUNCES)
    before = relief_model(relief)(*sides, PLASTIC) + sharp
    indirect = edges.indirect(*sides, PLASTIC, BOUNCES)
    after = relief_model(relief, edges=edges)(*sides, PLASTIC) + indirect
    stated = edge_contributions(edges, sides, PLASTIC, after, indirect)
    u = np.sqrt(sum(one.absolute**2 for one in stated)) / after
    old = pixel_bias(relief.surface.pixel_x_um, pitch, before, sharp).absolute / before
    return Drawn(pixel_um, np.log(before / truth), np.log(after / truth), old, np.asarray(u))


def campaign(maps: int, seed: int = 0) -> list[Drawn]:
    """Maps of every pixel size in turn."""
    rng = np.random.default_rng(seed)
    found = [draw(rng, PIXELS_UM[number % len(PIXELS_UM)]) for number in range(maps)]
    return [one for one in found if one is not None]


def main() -> None:
    """Print the table of the page on uncertainty."""
    found = campaign(int(sys.argv[1]) if len(sys.argv) > 1 else 80)
    print("pixel  maps  rms of ln L at 0/90/180 before [%]  after [%]  stated u, rms [%]  within 2 u")  # noqa: T201
    for pixel in PIXELS_UM:
        some = [one for one in found if one.pixel_um == pixel]
        before, after, u = (
            np.array([getattr(one, name) for one in some]) for name in ("before", "after", "u_after")
        )
        rms = [
            " ".join(f"{100.0 * v:.1f}" for v in np.sqrt(np.mean(one**2, axis=0)))
            for one in (before, after, u)
        ]
        within = np.mean(np.abs(after) <= 2.0 * u)
        print(f"{pixel:5g}  {len(some):4d}  {rms[0]:>14}  {rms[1]:>14}  {rms[2]:>14}  {within:.2f}")  # noqa: T201


if __name__ == "__main__":
    main()
