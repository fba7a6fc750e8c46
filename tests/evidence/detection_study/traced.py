"""Ridged parts rendered by the path tracer, which shares nothing with the prediction, as a camera sees them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.imaging.angle_map import AngleMap, angle_map
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import expectation
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

POINT_UM, PICTURE_UM, BLUR_UM = 2.0, 4.0, 3.0
UPRIGHT = tuple(Pose(angle, 0.0) for angle in (0.0, 90.0, 180.0))
TEXTURE = 0.03
PHASE = 0.37


def recipe_of(
    angle_deg: float = 10.0, pitch_um: float = 100.0, alpha: float = 0.08, tail: float = 0.0
) -> RidgeRecipe:
    whole = float(np.hypot(alpha, TEXTURE))
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "traced ridges",
            "surface": {"pitch_um": pitch_um, "design": {"ridge_angle_deg": angle_deg}},
            "material": {
                "alpha_along": whole, "alpha_across": whole, "albedo": 0.1, "u_albedo": 0.003,
                "tail": tail, "u_tail": 0.0,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0]},
            "acquisition": {"exposure_s": 0.001},
            "region": {"size_mm": [1.2, 0.8]},
            "uncertainty": {"seating_tilt_deg": 0.1},
        }
    )  # fmt: skip


class Part:
    """A part of ridges that lean differently, with waves of its form and marks, and what the camera sees of it.

    ``formed`` adds the heights over (x, y) in µm; ``spoiled`` is a defect with its values, or changes a height map
    with a generator. ``crest_um`` is the radius of the crests. ``changed`` (rows, cols) of the pictures is the largest
    change of a height by the defect in µm.
    """

    def __init__(
        self,
        seed: int,
        poses: Sequence[Pose],
        *,
        angle: float = 10.0,
        pitch: float = 100.0,
        alpha: float = 0.08,
        lobe: Any = "beckmann",
        size: tuple[float, float] = (1200, 800),
        spread: float = 0.15,
        flat_ridge: int | None = None,
        formed: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
        spoiled: Any = None,
        phase: float = PHASE,
        albedo: float = 0.1,
        crest_um: float = 0.0,
        lamp_um: float | None = None,
    ) -> None:
        rng = np.random.default_rng(seed)
        cols, rows = (int(one / POINT_UM) + 1 for one in size)
        x = np.arange(cols, dtype=np.float64) * POINT_UM - phase * pitch
        design = RidgeDesign(pitch, angle, edge_radius_um=crest_um)
        # a crest is one chord of the mesh: ridges are stretched from foot to foot, so that its slope stays
        height, ridge = design.profile(x), np.floor((x + design.wall_width_um) / pitch).astype(int)
        for number in np.unique(ridge):
            lean = 0.0 if number == flat_ridge else angle + spread * rng.standard_normal()
            height[ridge == number] *= np.tan(np.radians(lean)) / np.tan(np.radians(angle))
        surface = HeightMap(np.tile(height, (rows, 1)), POINT_UM, POINT_UM, {})
        if formed is not None:
            at_x, at_y = np.meshgrid(np.arange(cols) * POINT_UM, np.arange(rows) * POINT_UM)
            surface = surface.with_height(surface.height_um + formed(at_x, at_y))
        good = self.surface = add_facet_roughness(surface, TEXTURE, TEXTURE, 8.0, rng)
        if callable(spoiled):
            self.surface = spoiled(good, rng)
        elif spoiled is not None:
            self.surface = inject_defect(good, spoiled[0], rng, values=spoiled[1])
        change = np.abs(self.surface.height_um - good.height_um)[::-1]
        rows, cols = (size // 2 for size in change.shape)
        self.changed = change[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).max(axis=(1, 3))
        self.poses = tuple(poses)
        tracer = PathTracer(
            self.surface, Plastic(alpha, alpha, albedo, 1.5, lobe), reflections=3, paths=65536, seed=seed,
            lamp_distance_um=lamp_um,
        )  # fmt: skip
        self.pictures: list[Any] = []
        for light, camera in zip(*directions(self.poses, Convention(10.0)), strict=True):
            seen = cv2.GaussianBlur(tracer.radiance(light, camera), (0, 0), BLUR_UM / POINT_UM)[::-1]
            small = cv2.resize(seen, (seen.shape[1] // 2, seen.shape[0] // 2), interpolation=cv2.INTER_AREA)
            noise = 1.0 + 0.005 * rng.standard_normal(small.shape)
            self.pictures.append((small * noise).astype(np.float32))

    def measured(
        self, poses: Sequence[int] | None = None, pitch_um: float = 100.0, margin: int | None = None
    ) -> Measured:
        """Measurement in some of the poses, without ``margin`` pitches at every side; None: of the whole picture."""
        per_cell = round(pitch_um / CELLS_PER_PITCH / PICTURE_UM)
        rows, cols = (self._inner(size, per_cell, margin) for size in self.pictures[0].shape)
        pictures = tuple(
            np.ascontiguousarray(one[rows, cols])
            for one in (self.pictures if poses is None else [self.pictures[k] for k in poses])
        )
        shape = pictures[0].shape
        size = shape[1] // per_cell, shape[0] // per_cell
        cells = np.stack([cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pictures])
        return Measured(
            np.array([one.mean() for one in pictures]), (), pictures, cells.astype(np.float64),
            np.full(len(pictures), 0.001), Grid((0.0, 0.0), PICTURE_UM / 1000.0, shape, 0.0), None,
        )  # fmt: skip

    def spoiled_share(self, least_um: float, pitch_um: float = 100.0, margin: int = 0) -> FloatArray:
        """(cell rows, cell cols) share of every cell of `measured` whose height was changed by more than so much."""
        per_cell = round(pitch_um / CELLS_PER_PITCH / PICTURE_UM)
        rows, cols = (self._inner(size, per_cell, margin) for size in self.changed.shape)
        over = (self.changed[rows, cols] > least_um).astype(np.float64)
        high, wide = (size // per_cell for size in over.shape)
        return np.asarray(over.reshape(high, per_cell, wide, per_cell).mean(axis=(1, 3)))

    @staticmethod
    def _inner(size: int, per_cell: int, margin: int | None) -> slice:
        if margin is None:
            return slice(0, size)
        pitch = CELLS_PER_PITCH * per_cell
        return slice(margin * pitch, (size // pitch - margin) * pitch)

    def map_by(self, recipe: RidgeRecipe, cell_um: float = 48.0, parts: Sequence[Any] = ()) -> AngleMap:
        known = expectation(recipe, 10.0)
        expected = replace(
            known, poses=self.poses, components=tuple(parts), radiance=np.ones(len(self.poses))
        )
        return angle_map(recipe, expected, self.measured(pitch_um=recipe.surface.pitch_um), cell_um)

    def leans(self, found: AngleMap) -> list[FloatArray]:
        """(A, C) true leans across and along of the cells of a map, averaged over them."""
        rows, cols = self.pictures[0].shape
        z = self.surface.height_um[: 2 * rows + 1, : 2 * cols + 1]
        slopes = np.diff(z, axis=1)[:-1] / POINT_UM, np.diff(z, axis=0)[:, :-1] / POINT_UM
        x = (np.arange(2 * cols) + 0.5 - cols) * POINT_UM
        y = (np.arange(2 * rows) + 0.5 - rows) * POINT_UM
        leans = []
        for slope, sign in zip(slopes, (-1.0, 1.0), strict=True):
            whole = np.zeros((2 * rows + 1, 2 * cols + 1))
            whole[1:, 1:] = np.cumsum(np.cumsum(slope, axis=0), axis=1)
            half_x, half_y = (0.5 * one for one in found.cell_um)
            left, right = (np.searchsorted(x, 1000.0 * found.across_mm + s) for s in (-half_x, half_x))
            low, high = (np.searchsorted(y, 1000.0 * found.along_mm + s) for s in (-half_y, half_y))
            total = (
                whole[np.ix_(high, right)] - whole[np.ix_(low, right)] - whole[np.ix_(high, left)]
                + whole[np.ix_(low, left)]
            )  # fmt: skip
            leans.append(sign * np.degrees(np.arctan(total / np.outer(high - low, right - left))))
        return leans
