"""Angle map: how far the facets of a part lean across and along the ridges, cell by cell, from its photographs.

Every cell of a facet is brighter or darker in each pose as its lean moves the mirror direction. The radiance of a
plane facet with the lobe of the recipe is the model; what reaches the camera by more than one reflection is added as
its mean, with an uncertainty that leaves the verdict to the poses near the mirror direction. First one lean and one
roughness are fitted to the medians of the part, then the lean of every cell. Where no pose tells the lean along the
ridges it is held. A cell that no lean explains is left out: there is no facet, or something on it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.imaging.facet_fit import U_ALONG_DEG, U_LEAN_DEG, FacetScene, PartLean, part_lean
from anisoscope.imaging.phase_map import PhaseMap, phases_of
from anisoscope.imaging.pose_radiance import Image, Measured
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Expectation
from anisoscope.prediction.part_scatter import with_design
from anisoscope.recipe.surface import SurfaceRecipe
from anisoscope.record.schema import AngleRecord, RidgeLeanRecord

CELL_UM = 48.0
MARGIN_SHARE, MARGIN_POINTS = 0.12, 2.5
"""Distance of the cells from crest and wall: share of the pitch, and points of the pictures; the larger counts."""
LEAST_FACET = 0.25  # of a pitch, between the margins
HALF_FULL = 0.5  # share of its points that a cell needs
FOOT_HEIGHTS = (
    0.75  # distance from the wall within which light from the wall brightens the facet, in heights of it
)
SHOWN_SHARE = 0.66
"""Share of the variance of a fine texture's slopes that the points of a picture show: lens and pixels average."""
BORDER_POINTS = 0.15
"""Width of the border of a cell, in points of the picture, in which the light is that of its neighbours."""
CELL_ERROR = 0.004
"""Relative standard uncertainty of the radiance of one cell against that of the part, without texture."""
UNSEEN_CHANCE = 1e-5  # that a facet has a misfit as large
STEP_DEG = 0.1
COARSE = 5  # steps of the table of leans between which what roughness changes hardly differs
BELOW_DEG, ABOVE_DEG, ASIDE_DEG = 14.0, 8.0, 1.5
"""How far from the part's lean that of a cell is searched."""
_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class AngleMap:
    """Lean of the facets of a part.

    Attributes:
        angle_deg: (A, C) lean across the ridges, the first row farthest along them, C cells from ridge to ridge; NaN
            where no facet is seen.
        u_deg: the same shape, standard uncertainty against the mean of the part.
        along_deg: the same shape, lean along the ridges; None where no pose tells it.
        u_along_deg: its standard uncertainty, or None.
        x_mm: (A, C) places on the sample from the rotation axis.
        y_mm: likewise.
        across_mm: (C,) places across the ridges from the middle of the region.
        along_mm: (A,) places along them, falling.
        ridge: (C,) number of the ridge of a column, 0 in the middle of the region.
        cell_um: sides of a cell across and along the ridges.
        mean_deg: mean lean across the ridges.
        u_mean_deg: its standard uncertainty, with those of lamp, lens, seat and material that all cells share.
        alpha: roughness of the part in units of that of the recipe.
        u_alpha: its standard uncertainty.
        pitch_um: mean pitch of the pictures.
        turn_deg: how far the ridges run counter-clockwise from where the recipe says.
        unseen: (A, C) True where light is, but no facet explains it.
        stretch_deg: (A, C) signed part of ``u_deg`` by the roughness of the part, which moves all cells at once.
    """

    angle_deg: FloatArray
    u_deg: FloatArray
    along_deg: FloatArray | None
    u_along_deg: FloatArray | None
    x_mm: FloatArray
    y_mm: FloatArray
    across_mm: FloatArray
    along_mm: FloatArray
    ridge: npt.NDArray[np.intp]
    cell_um: tuple[float, float]
    mean_deg: float
    u_mean_deg: float
    alpha: float
    u_alpha: float
    pitch_um: float
    turn_deg: float
    unseen: npt.NDArray[np.bool_]
    stretch_deg: FloatArray | float = 0.0

    def under_lamp(self, distance_mm: float | None) -> "AngleMap":
        """The same in the light of a lamp so near that the half vector turns over the part, by place/2D."""
        if distance_mm is None:
            return self
        across, along = (np.degrees(0.5 * one / distance_mm) for one in (self.across_mm, self.along_mm))
        leant = None if self.along_deg is None else self.along_deg + along[:, None]
        return replace(self, angle_deg=self.angle_deg - across, along_deg=leant)

    @cached_property
    def _own_variance(self) -> FloatArray:
        """(A, C) of a cell against all others."""
        return np.maximum(self.u_deg**2 - np.square(self.stretch_deg), 0.0)

    @cached_property
    def spread_deg(self) -> float:
        """Standard deviation of the lean between cells, less what their uncertainty makes."""
        known = np.isfinite(self.angle_deg)
        total = float(np.var(self.angle_deg[known], ddof=1))
        return float(np.sqrt(max(total - float(np.mean(self._own_variance[known])), 0.0)))

    @cached_property
    def by_ridge(self) -> tuple["RidgeLean", ...]:
        """The lean of every ridge of which a tenth of the cells or more is known."""
        found = []
        for number in np.unique(self.ridge):
            columns = self.angle_deg[:, self.ridge == number]
            known = np.isfinite(columns)
            if known.mean() < LEAST_KNOWN or known.sum() < 2:
                continue
            values, own, stretch = (
                np.broadcast_to(one, self.angle_deg.shape)[:, self.ridge == number][known]
                for one in (self.angle_deg, self._own_variance, self.stretch_deg)
            )
            found.append(
                RidgeLean(
                    int(number),
                    float(np.nanmean(self.x_mm[:, self.ridge == number])),
                    float(np.nanmean(self.y_mm[:, self.ridge == number])),
                    float(values.mean()),
                    float(np.hypot(np.sqrt(np.sum(own)) / len(values), np.mean(stretch))),
                    float(values.std(ddof=1)),
                    float(known.mean()),
                )
            )
        return tuple(found)

    def record(self) -> AngleRecord:
        """What a record of the inspection holds of it."""
        worst, known = self.worst, np.isfinite(self.angle_deg)
        return AngleRecord(
            mean_deg=self.mean_deg,
            u_mean_deg=self.u_mean_deg,
            spread_deg=self.spread_deg,
            u_cell_deg=float(np.median(self.u_deg[known])),
            along_deg=None if self.along_deg is None else float(self.along_deg[known].mean()),
            alpha=self.alpha,
            u_alpha=self.u_alpha,
            cell_um=self.cell_um,
            cells=int(known.sum()),
            unseen_share=float(self.unseen.sum() / max(self.unseen.sum() + known.sum(), 1)),
            worst=None
            if worst is None
            else RidgeLeanRecord(
                ridge=worst.ridge, x=worst.x_mm, y=worst.y_mm, angle_deg=worst.angle_deg, u_deg=worst.u_deg
            ),
        )

    @property
    def farthest(self) -> tuple["RidgeLean", ...]:
        """The ridges, the one whose lean is farthest from the median of all first."""
        middle = float(np.median([one.angle_deg for one in self.by_ridge])) if self.by_ridge else 0.0
        return tuple(sorted(self.by_ridge, key=lambda one: -abs(one.angle_deg - middle)))

    @property
    def worst(self) -> "RidgeLean | None":
        """The ridge whose lean is farthest from the median of all."""
        return next(iter(self.farthest), None)


LEAST_KNOWN = 0.1


@dataclass(frozen=True)
class RidgeLean:
    """Lean of one ridge.

    Attributes:
        ridge: its number, 0 in the middle of the region.
        x_mm: middle of its cells on the sample.
        y_mm: likewise.
        angle_deg: mean lean across the ridges.
        u_deg: standard uncertainty of the mean against that of the part.
        spread_deg: standard deviation of its cells.
        known: share of its cells where a facet is seen.
    """

    ridge: int
    x_mm: float
    y_mm: float
    angle_deg: float
    u_deg: float
    spread_deg: float
    known: float


def angle_map(
    recipe: SurfaceRecipe, expected: Expectation, measured: Measured, cell_um: float = CELL_UM
) -> AngleMap:
    """Lean of the facets, cell by cell.

    Args:
        recipe: pitch, material, poses.
        expected: the prediction, whose uncertainties of lamp, lens and seat all cells share.
        measured: with the aligned pictures.
        cell_um: side of the cells; across the ridges the facet is divided evenly.

    Raises:
        MeasurementError: the pictures are missing, or do not resolve the ridges; or no pose has light of the lobe.
        HeightMapError: the recipe's height map has no ridges.
        UsageError: a cell smaller than a point of the pictures, or larger than the region.
    """
    if not measured.aligned:
        raise MeasurementError("the pictures of the part are not kept: the angle map is made from its frames")
    recipe = with_design(recipe.deciding())
    scene = FacetScene(recipe, expected.poses, expected.convention, expected.components)
    pixel_um = measured.grid.pixel_mm * 1000.0
    phases = phases_of(measured, scene.design.pitch_um, scene.wall)
    cells = _Cells.of(phases, scene.design, pixel_um, cell_um)
    light = np.stack([cells.means(picture) for picture in measured.aligned])
    full = np.all(np.isfinite(light) & (light > 0.0), axis=0)
    if full.sum() < 2:
        raise MeasurementError("no cell of a facet has light in every pose: see the frames of the inspection")
    logs = np.log(light[:, full])
    part = part_lean(scene, np.median(logs, axis=1))
    border = BORDER_POINTS * pixel_um * sum(1.0 / side for side in cells.side_um)
    texture = _texture(scene, part, np.array([cells.scatter(one) for one in measured.aligned]), border)
    found = _leans(scene, part, logs - part.left[:, None], texture)
    kept = full.any(axis=0)

    def spread(values: FloatArray, fill: float = np.nan) -> FloatArray:
        out = np.full(full.shape, fill)
        out[full] = values
        return out[:, kept]

    unseen = found.misfit > _limit(len(logs))
    angle = np.where(unseen, np.nan, found.lean[:, 0])
    known = np.isfinite(angle)
    if not known.any():
        raise MeasurementError(
            "no lean of a facet explains any cell: are lamp, material and poses the recipe's?"
        )
    row, col = (place[:, kept] for place in cells.middles())
    x_mm, y_mm, scale = measured.grid.to_mm() @ np.stack([col.ravel(), row.ravel(), np.ones(col.size)])
    rows, cols = measured.grid.shape
    along = part.sees_along
    return AngleMap(
        angle_deg=spread(angle),
        u_deg=spread(found.u[:, 0]),
        along_deg=spread(np.where(unseen, np.nan, found.lean[:, 1])) if along else None,
        u_along_deg=spread(found.u[:, 1]) if along else None,
        x_mm=(x_mm / scale).reshape(row.shape),
        y_mm=(y_mm / scale).reshape(row.shape),
        across_mm=(np.nanmean(col, axis=0) - 0.5 * (cols - 1)) * measured.grid.pixel_mm,
        along_mm=(0.5 * (rows - 1) - np.nanmean(row, axis=1)) * measured.grid.pixel_mm,
        ridge=cells.ridge[kept],
        cell_um=cells.side_um,
        mean_deg=part.lean[0],
        u_mean_deg=part.u_lean_deg,
        alpha=part.alpha,
        u_alpha=part.u_alpha,
        pitch_um=phases.pitch_um,
        turn_deg=phases.turn_deg,
        unseen=spread(unseen.astype(np.float64), 0.0) > 0.0,
        stretch_deg=spread(found.stretch_deg),
    )


def _limit(poses: int) -> float:
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    return float(chdtri(poses, UNSEEN_CHANCE))


def _median_chi2(freedom: int) -> float:
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    return float(chdtri(freedom, 0.5))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Which cell a point of the raster belongs to, −1 for none.

    Attributes:
        number: (rows, cols) cell of a point.
        shape: cells along and across.
        ridge: (C,) ridge of a column of cells.
        side_um: sides across and along.
    """

    number: npt.NDArray[np.intp]
    shape: tuple[int, int]
    ridge: npt.NDArray[np.intp]
    side_um: tuple[float, float]

    @staticmethod
    def of(phases: PhaseMap, design: RidgeDesign, pixel_um: float, cell_um: float) -> "_Cells":
        """Divide the facets of a part.

        Raises:
            MeasurementError: too little of a facet is left between wall and crest.
            UsageError: a cell smaller than a point, or larger than the region.
        """
        pitch = phases.pitch_um
        margin = max(MARGIN_SHARE, MARGIN_POINTS * pixel_um / pitch)
        first = margin + design.edge_reach_um / pitch
        last = (design.facet_width_um - FOOT_HEIGHTS * design.full_height_um) / design.pitch_um - margin
        if last - first < LEAST_FACET:
            raise MeasurementError(
                f"between crest and wall {max(last - first, 0.0):.0%} of the pitch are facet, an angle map needs "
                f"{LEAST_FACET:.0%}: take a lens of greater magnification"
            )
        if cell_um < pixel_um:
            raise UsageError(
                f"cells of {cell_um:g} µm are smaller than a point of the pictures ({pixel_um:.3g} µm)"
            )
        if cell_um > pixel_um * len(phases.place):
            raise UsageError(
                f"cells of {cell_um:g} µm are larger than the region ({pixel_um * len(phases.place):.4g} µm along)"
            )
        parts = max(1, round((last - first) * pitch / cell_um))
        rows, _ = phases.place.shape
        high = max(1, round(cell_um / pixel_um))
        along = rows // high
        ridge = np.floor(phases.place)
        part = np.floor((phases.place - ridge - first) / (last - first) * parts)
        inside = (part >= 0) & (part < parts)
        low, top = int(ridge[inside].min()), int(ridge[inside].max())
        column = (ridge - low) * parts + part
        line = np.minimum(np.arange(rows) // high, along)[:, None]
        inside &= line < along
        count = (top - low + 1) * parts
        number = np.where(inside, line * count + column, -1).astype(np.intp)
        middle = int(np.floor(np.median(phases.place)))
        return _Cells(
            number,
            (along, count),
            np.repeat(np.arange(low, top + 1) - middle, parts).astype(np.intp),
            ((last - first) * pitch / parts, high * pixel_um),
        )

    @cached_property
    def _inside(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        chosen = np.flatnonzero(self.number.ravel() >= 0)
        return chosen, self.number.ravel()[chosen]

    def _sums(self, values: FloatArray) -> FloatArray:
        total = np.bincount(self._inside[1], values, minlength=self.shape[0] * self.shape[1])
        return np.asarray(total, dtype=np.float64)

    @cached_property
    def _count(self) -> FloatArray:
        return self._sums(np.ones(len(self._inside[0])))

    def means(self, picture: FloatArray | Image) -> FloatArray:
        """(A, C) mean of the points of every cell; NaN of cells that are not half full."""
        values = picture.ravel()[self._inside[0]].astype(np.float64)
        known = np.isfinite(values)
        count = self._sums(known.astype(np.float64))
        total = self._sums(np.where(known, values, 0.0))
        enough = count >= max(1.0, HALF_FULL * float(np.max(self._count)))
        return np.where(enough, total / np.maximum(count, 1.0), np.nan).reshape(self.shape)

    def scatter(self, picture: FloatArray | Image) -> tuple[float, float, float]:
        """Variance of ln L of the points of a cell, how much it differs between cells, and what the means scatter by.

        The second is the variance of the variances of the cells over the square of the first. The second and third
        are half the variance of the differences of cells along a ridge.
        """
        logs = np.log(np.maximum(np.nan_to_num(picture, nan=1e-12), 1e-12))
        means = self.means(logs)
        own = np.full(self.number.shape, np.nan)
        own.ravel()[self._inside[0]] = (logs.ravel()[self._inside[0]] - means.ravel()[self._inside[1]]) ** 2
        each = self.means(own)
        known = each[np.isfinite(each)]
        usual = float(np.median(known)) if known.size else 0.0
        unlike, near = (np.diff(one, axis=0) / np.sqrt(2.0) for one in (each / max(usual, 1e-300), means))
        return usual, *(_calm_variance(one[np.isfinite(one)]) for one in (unlike, near))  # type: ignore[return-value]

    def middles(self) -> tuple[FloatArray, FloatArray]:
        """(A, C) row and column of the middles of the cells; NaN of empty ones."""
        row, col = np.divmod(self._inside[0], self.number.shape[1])
        count = np.where(self._count > 0, self._count, np.nan)
        return (self._sums(row) / count).reshape(self.shape), (self._sums(col) / count).reshape(self.shape)


def _calm_variance(values: FloatArray) -> float:
    """Variance from the median of the absolute values, which marks do not raise; 0 of none."""
    return float((1.4826 * np.median(np.abs(values))) ** 2) if values.size else 0.0


@dataclass(frozen=True, eq=False)
class _Texture:
    """Doubt of a cell by the texture within it: (P, 3) of ln L, each of one sign over the poses, and of the lean."""

    of_light: FloatArray
    of_lean_deg: float


def _texture(scene: FacetScene, part: PartLean, seen: FloatArray, border: float) -> _Texture:
    """Standard uncertainties of a cell by the texture within it.

    The mean of L over a cell is not L of the mean lean: with slopes of covariance σᵢⱼ about it, it is greater by
    ½·Σ σᵢⱼ·L,ᵢⱼ/L, and that of one cell scatters about that of all as σᵢⱼ does, of which a cell has n independent
    values: the variances across and along by 2σ⁴/n, their covariance by σ⁴/n. All poses see the same slopes. Lens and
    points of the picture blur the border of a cell besides, so that its mean lean is in part that of its neighbours.

    Args:
        scene: of the part.
        part: its lean.
        seen: (P, 3) variance of ln L of the points of a cell, that of the cells' variances over its square, and
            variance of the means of cells (`_Cells.scatter`).
        border: share of a cell whose light is that of its neighbours.
    """
    h = 0.5  # degrees
    steps = [(0.0, 0.0), (h, 0.0), (-h, 0.0), (0.0, h), (0.0, -h), (h, h), (-h, -h), (h, -h), (-h, h)]
    leans = np.array(steps) + part.lean
    logs = scene.log_radiance(leans[:, 0], leans[:, 1], scene.rougher(part.alpha, interface=part.alpha))
    slopes = np.stack([logs[:, 1] - logs[:, 2], logs[:, 3] - logs[:, 4]], axis=-1) / (2.0 * h)
    bend = np.stack([logs[:, 1] + logs[:, 2], logs[:, 3] + logs[:, 4]], axis=-1) - 2.0 * logs[:, :1]
    bend = bend / h**2 + slopes**2  # L''/L
    twist = (logs[:, 5] + logs[:, 6] - logs[:, 7] - logs[:, 8]) / (4.0 * h**2) + slopes[:, 0] * slopes[:, 1]
    points, unlike, means = seen.T
    steep = np.sum(slopes**2, axis=1)
    variance, between = (float(np.sum(one * steep) / np.sum(steep**2)) for one in (points, means))
    unlike_all = float(np.sum(unlike * points * steep) / max(float(np.sum(points * steep)), 1e-300))
    share = min(0.5 * unlike_all, 1.0)  # 1/n
    each = np.column_stack([np.sqrt(0.5) * bend, twist]) * (variance / SHOWN_SHARE * np.sqrt(share))
    if not part.sees_along:  # a cell leans along by what no pose tells: U_ALONG_DEG bends its light, too
        each = np.column_stack([each, np.sqrt(0.5) * bend[:, 1] * U_ALONG_DEG**2])
    return _Texture(np.asarray(each), float(np.sqrt(border * between)))


@dataclass(frozen=True, eq=False)
class _Leans:
    """(N, 2) leans of cells and their standard uncertainties, across and along, and (N,) misfits.

    ``stretch_deg`` (N,) is the part of the first by the roughness of the part.
    """

    lean: FloatArray
    u: FloatArray
    misfit: FloatArray
    stretch_deg: FloatArray


def _leans(scene: FacetScene, part: PartLean, logs: FloatArray, texture: _Texture) -> _Leans:
    """Lean of every cell: the best of a table, then one step of Gauss and Newton from it."""
    centre = part.lean
    across = np.arange(max(centre[0] - BELOW_DEG, -10.0), centre[0] + ABOVE_DEG, STEP_DEG)
    along = centre[1] + np.arange(-ASIDE_DEG, ASIDE_DEG + 0.5 * STEP_DEG, STEP_DEG)
    grid = np.stack(np.meshgrid(across, along, indexing="ij"), axis=-1)
    table = scene.log_radiance(
        grid[..., 0].ravel(), grid[..., 1].ravel(), scene.rougher(part.alpha, interface=part.alpha)
    )
    table = table.reshape(len(logs), len(across), len(along))
    slope = np.stack([np.gradient(table, STEP_DEG, axis=axis) for axis in (1, 2)], axis=-1)
    # another roughness of the part stretches the leans about their mean, which it leaves
    coarse = grid[::COARSE, ::COARSE]
    rougher = scene.log_radiance(
        coarse[..., 0].ravel(),
        coarse[..., 1].ravel(),
        scene.rougher(part.alpha + part.u_alpha, interface=part.alpha),
    )
    moved = rougher.reshape(len(logs), *coarse.shape[:2]) - table[:, ::COARSE, ::COARSE]
    near = np.argmin(np.sum((coarse - centre) ** 2, axis=-1))
    moved -= moved.reshape(len(logs), -1)[:, near, None, None]
    own_error = CELL_ERROR**2 * np.eye(len(logs)) + texture.of_light @ texture.of_light.T
    white = np.linalg.inv(np.linalg.cholesky(own_error))
    before = np.array([U_LEAN_DEG, U_ALONG_DEG]) ** -2.0
    prior = np.sum((grid - centre) ** 2 * before, axis=-1).ravel()
    flat = white @ table.reshape(len(logs), -1)
    square = np.sum(flat**2, axis=0) + prior
    lean, u, stretch = (np.empty((logs.shape[1], 2)) for _ in range(3))
    misfit = np.empty(logs.shape[1])
    for first in range(0, logs.shape[1], _AT_ONCE):
        block = slice(first, first + _AT_ONCE)
        own = white @ logs[:, block]
        best = np.argmin(square[:, None] - 2.0 * (flat.T @ own), axis=0)
        i, j = np.unravel_index(best, grid.shape[:2])
        jacobian = np.einsum("pq,qna->npa", white, slope[:, i, j])  # (N, P, 2)
        left = (own - flat[:, best]).T
        information = np.einsum("npa,npb->nab", jacobian, jacobian) + np.diag(before)
        gain = np.linalg.inv(information)
        pull = np.einsum("npa,np->na", jacobian, left) - (grid[i, j] - centre) * before
        step = np.clip(np.einsum("nab,nb->na", gain, pull), -STEP_DEG, STEP_DEG)
        lean[block] = grid[i, j] + step
        u[block] = np.sqrt(np.diagonal(gain, axis1=1, axis2=2))
        other = white @ moved[:, i // COARSE, j // COARSE]
        stretch[block] = np.einsum("nab,npb,pn->na", gain, jacobian, other)
        misfit[block] = np.sum((left - np.einsum("npa,na->np", jacobian, step)) ** 2, axis=1)
    # where the poses contradict each other by more than that in most cells, all of it is larger
    usual = float(np.median(misfit)) / _median_chi2(max(len(logs) - 2, 1))
    u = np.sqrt(u**2 * max(usual, 1.0) + texture.of_lean_deg**2 + stretch**2)
    return _Leans(lean, u, misfit / max(usual, 1.0), stretch[:, 0])
