"""Deviation map: where a part differs from its own ridges, in all poses together.

Every point of the ridges is compared with the mean profile over their phase (`phase_map`), pose by pose, so that the
pattern of the flanks, the lamp, and the level of the part are no deviation. The deviations of ln L of the P poses have
a covariance, from most of the cells themselves; D² of the mean of a cell in it has P degrees of freedom whatever the
texture and the number of poses. Its limit is from most cells of the part, or from golden parts. The mean of a cell,
over which the texture evens out and a mark does not, shows more than the mean of the D² of its points. These show what
leaves the mean as it is: a patch of another texture, against the calmest quarter of the part.

Marks at the crests of half of the ridges are most of the cells there. What a good part may scatter by is therefore
bounded by the calmest quarter of the pitch, as the facets are, and so is the limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.mark_classes import MarkSigns
from anisoscope.imaging.phase_map import phase_map, phases_of
from anisoscope.imaging.pose_radiance import CELLS_PER_PITCH, Image, Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Pose
from anisoscope.recipe.surface import MOST_DEVIATION, AreaPart, SurfaceRecipe
from anisoscope.record.schema import AreaRecord
from anisoscope.record.verdict import Verdict
from anisoscope.sim.light.contrasts import consecutive_pairs

MAX_CELL_NOISE = 0.25
LEAST_POINTS = 3.0
"""Points a pitch from which on the phase of the ridges is found; below, places are those of the raster."""
BINS = 24
"""Parts of a pitch, each with its own expected radiances and covariance."""
FINE = 32
"""Steps a bin between which an expected radiance is not interpolated."""
BIN_POINTS = 20
"""Points that a bin needs for every pose."""
U_PLACE = 0.02
"""Standard uncertainty of the place of a ridge in pitches, of which walls are brighter or darker as a whole."""
CALM_UM = 3.0
"""Standard deviation of the average over points."""
MOST_LOG = 1.5
"""Deviation of ln L as which a greater one counts: one grain does not decide its cell alone."""
SCATTERS = 3.8
"""By how many (median − 16 % quantile) of the cells the cube root of D² may be above their median."""
FEW = 4.0
"""Points that cells have at the least: of fewer points the noise is not known."""
TAIL = 1.6
"""The means of cells of n points keep the tails of noisy points: `SCATTERS` is more by this share over n."""
LEAST_SPREAD = 0.1  # of these roots
PATCH = 5
"""Side in cells of the square of which the median shows a patch of another texture, and no mark that is narrower."""
PATCH_SCATTERS = 14.0
"""By how many (25 % − 8 % quantile) of the cells this median, of the mean ln(1 + D²) of the points, may be above the
25 % quantile."""
LEAST_PATCH_SPREAD = 0.02
GLOW = 0.05
"""Standard deviation of ln L of a cell in every pose by light of other cells that deviate."""
LEAST_DEVIATION = 1.4 * GLOW
"""Ln ratio of a pair of poses below which no cell deviates in this pair alone, however smooth the part."""
LEAST_SCATTER = 0.005
"""Standard deviation of ln L that registration leaves at the least."""
KEPT_CHANCE = 0.1
"""Chance of the points of a good part that the covariance leaves out as marks."""
CALM_SHARE = 0.25
"""Share of the pitch that scatters least: it shows the texture of the part, whatever the rest hides."""
WALLS = 0.035
"""Standard deviation of ln L that walls of good parts have at most besides the texture of the facets."""
CROWDED = 1.1
"""Limit by all cells over that by the calm ones, for cells of many points, from which on marks have raised it."""
SHIFT_ROWS, FEWEST_RIDGES = 4, 4
"""Step of the rows by which ridges are shifted, and ridges from which on they have a pitch."""
LEAST_SHIFT, SURE = 0.012, 5.0
"""Shift in pitches of the outermost ridges, also in its standard uncertainties, from which on the pitch is mended."""
GLINT = 0.11
"""Standard deviation of ln L of a cell of which all light is the glint of a crest."""
PHASES, LEAST_CELLS = 8, 40
"""Parts of a pitch whose cells scatter alike, and cells of which the scatter of one is known."""
ALIKE = 1.15
"""Ratio of limits of cells that scatter alike."""
LEAST_BLUR = 0.3
"""Standard deviation in points below which an average is of one point."""
CLEAR = 1.15
"""Score over the limit of cells whose groups are measured: by chance a good part has groups of a few cells of less."""
_SAMPLE = 2000
"""Points of a bin that determine its medians and covariance."""
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class CellScatter:
    """How the cells of good parts scatter, by which cells deviate.

    Attributes:
        covariance: (P, P) of the deviations of ln L.
        most: D² in it beyond which a cell deviates.
    """

    covariance: FloatArray
    most: float

    @staticmethod
    def of_texture(off: FloatArray) -> "CellScatter":
        """Scatter of most of the cells of a surface that is seen or predicted without noise: (P, …) deviations."""
        flat = off.reshape(len(off), -1)
        covariance = _most_covariance(flat) + GLOW**2 * np.eye(len(off))
        limit, _ = _limit(np.log1p(squares_in(covariance, flat)), len(off))
        return CellScatter(covariance, max(float(np.expm1(limit)), _usual_limit(len(off))))

    @staticmethod
    def of(area: AreaRecord) -> "CellScatter | None":
        """Scatter by which a part was judged; None where its cells were not, or by an earlier rule."""
        if area.cell_covariance is None or area.limit is None:
            return None
        return CellScatter(np.array(area.cell_covariance), float(np.expm1(area.limit)))

    @staticmethod
    def even(threshold: float, poses: int) -> "CellScatter":
        """Scatter that is the same in all poses, by which a ln ratio of a pair of them deviates from a threshold on."""
        most = _usual_limit(poses)
        return CellScatter(threshold**2 / (2.0 * (most - poses)) * np.eye(poses), most)

    def deviating(self, off: FloatArray) -> npt.NDArray[np.bool_]:
        """(…) True where (P, …) deviations of ln L are those of a cell that deviates."""
        return squares_in(self.covariance, off) > self.most

    def thresholds(self, pairs: Sequence[tuple[int, int]]) -> FloatArray:
        """(pairs,) ln ratios of about which a cell deviates that deviates in one pair of poses alone."""
        own, beyond = self.covariance, max(self.most - len(self.covariance), 1.0)
        return np.array([np.sqrt(beyond * (own[i, i] + own[j, j] - 2.0 * own[i, j])) for i, j in pairs])


def squares_in(covariance: FloatArray, off: FloatArray) -> FloatArray:
    """(…) D² of (P, …) deviations in a (P, P) covariance."""
    flat = off.reshape(len(off), -1)
    return np.asarray(np.sum(flat * np.linalg.solve(covariance, flat), axis=0).reshape(off.shape[1:]))


@dataclass(frozen=True, eq=False)
class CellMap:
    """How the cells of a part deviate.

    Attributes:
        score: (cell rows, cell cols) ln(1 + D²).
        limit: score beyond which a cell deviates, by the cells of the part.
        off: (pairs, cell rows, cell cols) deviation of the ln ratio of a pair of poses.
        thresholds: (pairs,) ln ratios of about which a cell deviates that deviates in one pair alone.
        u_score: standard uncertainty of a score against its limit.
        over: limit by all cells over that by the calmest part of the pitch; from `CROWDED` on marks hide each other.
        covariance: (P, P) of the deviations of ln L of good cells; None in a map that was stored without it.
        signs: deviation in the poses, by which marks are named; None in a stored map.
    """

    score: FloatArray
    limit: float
    off: FloatArray
    thresholds: FloatArray
    u_score: float
    over: float = 1.0
    covariance: FloatArray | None = None
    signs: MarkSigns | None = None

    def arrays(self) -> dict[str, FloatArray | float]:
        """What is stored of a map: all that is known but the signs."""
        return {name: value for name, value in vars(self).items() if name != "signs" and value is not None}

    def deviating(self) -> npt.NDArray[np.bool_]:
        """(cell rows, cell cols) True where a cell deviates."""
        return np.asarray(self.score > self.limit)

    def by(self, limits: Sequence[float]) -> "CellMap":
        """The same with the limit of golden parts, the mean of theirs; of a map of an earlier version, the same.

        A part that is spoiled all over has a higher one of its own, so that it hides its marks.
        """
        known = limits and self.covariance is not None
        return replace(self, limit=min(self.limit, float(np.mean(limits)))) if known else self

    @property
    def u_share(self) -> float:
        """Standard uncertainty of the share of deviating cells, from that of the scores and from their number."""
        from scipy.special import ndtr  # noqa: PLC0415 - start-up time

        chance = ndtr((self.score - self.limit) / self.u_score)
        variance = np.sum(chance * (1.0 - chance)) / chance.size**2
        return float(np.sqrt(variance + (0.5 / chance.size) ** 2))


def cell_log_ratios(measured: Measured, poses: tuple[Pose, ...]) -> FloatArray:
    """(pairs, cell rows, cell cols) ln ratio of every cell for consecutive stage angles."""
    safe = np.maximum(measured.cells, 1e-6)
    return np.stack([np.log(safe[i] / safe[j]) for i, j in consecutive_pairs(poses)])


_MADE: WeakKeyDictionary[Measured, CellMap] = WeakKeyDictionary()


def remember(measured: Measured, found: CellMap) -> None:
    """Use a stored map for a measurement without pictures."""
    _MADE[measured] = found


def cell_map(measured: Measured, recipe: SurfaceRecipe) -> CellMap:
    """How the cells of a part deviate from its own ridges; made once a measurement.

    Args:
        measured: the part; where its pictures are not kept, its cells stand for them.
        recipe: pitch and poses.
    """
    if measured not in _MADE:
        _MADE[measured] = _cell_map(measured, recipe)
    return _MADE[measured]


def _cell_map(measured: Measured, recipe: SurfaceRecipe) -> CellMap:
    pictures, pitch_um = measured.aligned, recipe.surface.pitch_um
    pixel_um = 1000.0 * measured.grid.pixel_mm
    if not pictures:
        pictures, pixel_um = tuple(measured.cells.astype(np.float32)), pitch_um / CELLS_PER_PITCH
    try:
        if measured.aligned:
            place = phases_of(measured, pitch_um, None, LEAST_POINTS).place
        else:
            place = phase_map(pictures, pixel_um, pitch_um, None, LEAST_POINTS).place
    except MeasurementError:  # no pattern to be compared with, or too few ridges
        rows, cols = pictures[0].shape
        place = np.broadcast_to((np.arange(cols) + 0.5) * pixel_um / pitch_um, (rows, cols))
    logs = np.stack([np.log(np.maximum(one, 1e-9)) for one in pictures]).astype(np.float32)
    place = _of_exact_pitch(logs, place)
    points = _Points.of(logs, place)
    off = points.off(CALM_UM / pixel_um)
    covariance, calm = points.covariance(off)
    size = measured.cells.shape[:0:-1]

    def of_cells(values: Image) -> FloatArray:
        return cv2.resize(values, size, interpolation=cv2.INTER_AREA).astype(np.float64)

    cells = np.stack([of_cells(one) for one in off])
    share = of_cells(calm)
    known = share >= max(float(np.quantile(share, 1.0 - CALM_SHARE)), 0.5 * float(share.max()))
    phase = of_cells(place.astype(np.float32))
    level = _Points.of(cells, phase).off(0.0).astype(np.float64)
    texture = _most_covariance(level[:, known])
    own = _cell_covariance(level, texture)
    squares = squares_in(own, level)
    score = np.log1p(squares / _glint_scales(squares, phase, points.glints(), texture, own, known))
    limit, spread, over = _limits(score, known, len(cells), max(pictures[0].size / score.size, FEW))
    of_points = points.distance(off, covariance)
    score = np.maximum(score, limit * _texture_share(of_cells(np.log1p(of_points))))
    beyond = (of_points > np.expm1(limit)).astype(np.float32)
    poses = recipe.poses.poses()
    pairs = consecutive_pairs(poses)
    scatter = np.maximum(1.4826 * np.median(np.abs(cells), axis=(1, 2)), LEAST_SCATTER)
    noisy = float(np.mean(np.minimum(measured.cell_noise / scatter, 1.0)))
    return CellMap(
        score,
        limit,
        np.stack([cells[i] - cells[j] for i, j in pairs]).astype(np.float32).astype(np.float64),
        CellScatter(own, float(np.expm1(limit))).thresholds(pairs),
        spread * float(np.hypot(noisy, 20.0 / np.sqrt(score.size))),
        over,
        own,
        MarkSigns.of(cells, of_cells(beyond), of_cells(beyond * calm), poses),
    )


def _of_exact_pitch(logs: Image, place: FloatArray) -> FloatArray:
    """(rows, cols) places in pitches of (P, rows, cols) ln L, by the shifts of the ridges against the usual profile.

    The glint of a rounded crest is as narrow as a point: where the pitch of few ridges is wrong by half a percent,
    those at the border of a region seem to deviate from end to end.
    """
    for _ in range(_ROUNDS):
        some = place[::SHIFT_ROWS]
        points = _Points.of(logs[:, ::SHIFT_ROWS], some)
        slopes = points.slopes()
        ridge = np.round(some).astype(int)
        first, count = int(ridge.min()), int(np.ptp(ridge)) + 1
        number = (ridge - first + np.arange(len(ridge))[:, None] * count).ravel()
        along, steep = (
            np.bincount(number, np.einsum("pij,pij->ij", one, slopes).ravel(), len(ridge) * count).reshape(
                -1, count
            )
            for one in (points.off(0.0), slopes)
        )
        least = 0.1 * float(np.median(steep))
        known = np.flatnonzero(np.any(steep > least, axis=0))
        if len(known) < FEWEST_RIDGES:
            break
        shift = np.array(
            [
                np.median(a[s > least] / s[s > least])
                for a, s in zip(along.T[known], steep.T[known], strict=True)
            ]
        )
        one, other = np.triu_indices(len(known), 1)
        rise = float(np.median((shift[other] - shift[one]) / (known[other] - known[one])))  # Theil and Sen
        left = shift - rise * known
        middle, most = float(np.median(left)), 0.5 * abs(rise) * count
        u = 1.4826 * float(np.median(np.abs(left - middle))) / np.sqrt(len(known))
        if most < max(LEAST_SHIFT, SURE * u):
            break
        place = place + np.clip(middle + rise * (place - first), -2.0 * U_PLACE, 2.0 * U_PLACE)
    return place


def _glint_scales(
    squares: FloatArray,
    phase: FloatArray,
    glint: FloatArray,
    texture: FloatArray,
    own: FloatArray,
    calm: npt.NDArray[np.bool_],
) -> FloatArray:
    """(cell rows, cell cols) by how much D² of good cells is greater than that of the calm ones.

    Args:
        squares: (cell rows, cell cols) D².
        phase: likewise, in pitches.
        glint: (P, `PHASES`) share of the light that is glint.
        texture: (P, P) covariance of the calm cells.
        own: (P, P) covariance by which D² is.
        calm: cells of the calmest part of the pitch.

    The glint of a rounded crest is the light of few facets of the texture, so that it scatters. Cells of a phase of
    the ridges have their own scale, from those that deviate least, and at most the one that their glint explains: marks
    of the crests, which most cells of a phase may have, do not raise it further.
    """

    def limit(some: FloatArray) -> float:
        """Of the cube roots, were they normal: from a quarter of the cells, which marks leave as they are."""
        quarter, low = np.quantile(np.cbrt(some), [0.25, 0.08])
        return float(quarter + (SCATTERS + 0.674) / (1.405 - 0.674) * (quarter - low))

    kind = np.floor(np.mod(phase, 1.0) * PHASES)
    usual = float(np.trace(np.linalg.solve(own, texture)))
    found, least = np.ones(squares.shape), ALIKE * max(limit(squares[calm]), LEAST_SPREAD)
    for number in range(PHASES):
        chosen = kind == number
        if chosen.sum() >= LEAST_CELLS:
            explained = 1.0 + float((GLINT * glint[:, number]) ** 2 @ np.diag(np.linalg.inv(own))) / usual
            found[chosen] = np.clip((limit(squares[chosen]) / least) ** 3, 1.0, explained)
    return found


def _texture_share(logs: FloatArray) -> FloatArray:
    """(cell rows, cell cols) texture around every cell, as a share of its limit: mean ln(1 + D²) of the points."""
    seen = cv2.medianBlur(logs.astype(np.float32), PATCH).astype(np.float64)
    usual, low = np.quantile(seen, [0.25, 0.08])
    return np.asarray(seen / (usual + PATCH_SCATTERS * max(float(usual - low), LEAST_PATCH_SPREAD)))


def _cell_covariance(cells: FloatArray, texture: FloatArray) -> FloatArray:
    """(P, P) covariance of the cells of a good part, of most of them and at most as the texture and walls scatter.

    Every pose has `GLOW` besides: light that marks throw onto cells around them deviates, but is no mark there.
    """
    poses = len(cells)
    every = _most_covariance(cells.reshape(poses, -1))
    bounded = _at_most(every[None], texture + WALLS**2 * np.eye(poses))[0]
    return np.asarray(bounded + GLOW**2 * np.eye(poses))


def _limits(
    score: FloatArray, calm: npt.NDArray[np.bool_], poses: int, points: float
) -> tuple[float, float, float]:
    """Limit of the cells, their spread, and limit by all of them over that by the calm ones, as of many points.

    The limit by all cells is that of the texture, unless marks have raised it far beyond that of the calm ones.

    Args:
        score: (cell rows, cell cols) ln(1 + D²).
        calm: cells of the calmest part of the pitch.
        poses: degrees of freedom of D².
        points: of a cell; noise of few of them differs over the pitch more.
    """
    own, spread = _limit(score, poses, points)
    least, calm_spread = _limit(score[calm], poses, points)
    over = own / (least * (1.0 + 1.0 / points))
    least = own / over
    most = max(1.0, 2.0 * CROWDED - over)
    return least * min(over, most), min(spread, calm_spread), over


def _usual_limit(poses: int) -> float:
    """D² beyond which a cell deviates where cells scatter normally (Wilson and Hilferty, 1931)."""
    variance = 2.0 / (9.0 * poses)
    return poses * float(1.0 - variance + SCATTERS * np.sqrt(variance)) ** 3


def _limit(scores: FloatArray, poses: int, points: float = np.inf) -> tuple[float, float]:
    """Limit of cells and their spread; the cube root of D² is nearly normal (Wilson and Hilferty, 1931)."""
    roots = np.cbrt(np.expm1(scores) / poses)
    middle, low = np.quantile(roots, [0.5, 0.16])
    spread = max(float(middle - low), LEAST_SPREAD)
    limit = float(middle) + SCATTERS * (1.0 + TAIL / points) * spread
    steep = 3.0 * poses * limit**2 / (1.0 + poses * limit**3)
    return float(np.log1p(poses * limit**3)), steep * spread


def _most_covariance(values: FloatArray) -> FloatArray:
    """(P, P) covariance of most of (P, N) deviations from 0; those of marks are left out."""
    from scipy.special import chdtri  # noqa: PLC0415 - start-up time

    poses = len(values)
    middle, most = chdtri(poses, 0.5), chdtri(poses, KEPT_CHANCE)
    scale = np.maximum(1.4826 * np.median(np.abs(values), axis=1), LEAST_SCATTER)
    scaled = values / scale[:, None]
    kept = np.all(np.abs(scaled) < 4.0, axis=0)
    matrix = np.eye(poses)
    for _ in range(_ROUNDS):
        if kept.sum() <= poses:
            break
        matrix = scaled[:, kept] @ scaled[:, kept].T / kept.sum() + 1e-6 * np.eye(poses)
        squares = np.sum(scaled * np.linalg.solve(matrix, scaled), axis=0)
        usual = max(float(np.median(squares)) / middle, 1e-3)
        matrix *= usual
        kept = squares < usual * most
    return np.asarray(matrix * np.outer(scale, scale))


def _at_most(matrices: FloatArray, most: FloatArray) -> FloatArray:
    """(B, P, P) covariances of which no direction has a greater variance than in ``most``."""
    half = np.linalg.cholesky(most)
    inverse = np.linalg.inv(half)
    values, vectors = np.linalg.eigh(inverse @ matrices @ np.swapaxes(inverse, -2, -1))
    axes = half @ vectors * np.sqrt(np.clip(values, 0.0, 1.0))[:, None, :]
    return np.asarray(axes @ np.swapaxes(axes, 1, 2))


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the pictures in the order of their phase.

    Attributes:
        logs: (P, rows, cols) ln L; NaN where unknown.
        fine: (rows, cols) phase in `FINE` steps a bin.
        order: (N,) points by bin.
        ends: (B + 1,) where the bins begin and end in it.
    """

    logs: Image
    fine: npt.NDArray[np.intp]
    order: npt.NDArray[np.intp]
    ends: npt.NDArray[np.intp]

    @staticmethod
    def of(logs: FloatArray | Image, place: FloatArray) -> "_Points":
        """Points of (P, rows, cols) ln L at (rows, cols) places in pitches."""
        logs = logs.astype(np.float32)
        count = int(np.clip(place.size / (BIN_POINTS * len(logs)), 1, BINS))
        fine = (np.mod(place, 1.0) * (count * FINE)).astype(np.intp) % (count * FINE)
        number = (fine // FINE).ravel()
        order = np.argsort(number.astype(np.uint8), kind="stable")
        return _Points(logs, fine, order, np.searchsorted(number[order], np.arange(count + 1)))

    @property
    def bins(self) -> int:
        return len(self.ends) - 1

    def _bin(self, number: int) -> npt.NDArray[np.intp]:
        return self.order[self.ends[number] : self.ends[number + 1]]

    def _medians(self, values: Image) -> FloatArray:
        """(P, B) medians over the phase; a bin without points lies between its neighbours."""
        poses = len(values)
        flat = values.reshape(poses, -1)
        found = np.full((poses, self.bins), np.nan)
        for number in range(self.bins):
            chosen = self._bin(number)
            if len(chosen):
                some = flat[:, chosen[:: max(1, len(chosen) // _SAMPLE)]]
                known = np.isfinite(some).any(axis=1)
                found[known, number] = np.nanmedian(some[known], axis=1)
        for row in found:
            filled = np.flatnonzero(np.isfinite(row))
            row[:] = np.interp(np.arange(self.bins), filled, row[filled], period=self.bins)
        return found

    @cached_property
    def _usual(self) -> FloatArray:
        """(P, B) usual ln L over the phase."""
        return self._medians(self.logs)

    def _rising(self, medians: FloatArray) -> Image:
        """(P, B · `FINE`) profiles that rise evenly from the middle of a bin to that of the next."""
        steps = (np.arange(self.bins * FINE) + 0.5) / FINE - 0.5
        rows = [np.interp(steps, np.arange(self.bins), row, period=self.bins) for row in medians]
        return np.stack(rows).astype(np.float32)

    def off(self, sigma: float) -> Image:
        """(P, rows, cols) deviation of ln L from the profile, averaged over ``sigma`` points; 0 where unknown.

        The profile rises evenly from bin to bin, and by what that leaves in the middle of one.
        """
        rising = self._rising(self._usual)
        found = np.stack([logs - table[self.fine] for logs, table in zip(self.logs, rising, strict=True)])
        for off, row in zip(found, self._medians(found).astype(np.float32), strict=True):
            np.subtract(off, np.repeat(row, FINE)[self.fine], out=off)
            np.clip(np.nan_to_num(off), -MOST_LOG, MOST_LOG, out=off)
            if sigma > LEAST_BLUR:
                cv2.GaussianBlur(off, (0, 0), sigma, dst=off, borderType=cv2.BORDER_REFLECT)
        return found

    def slopes(self) -> Image:
        """(P, rows, cols) by how much the usual ln L of a point rises with its place, per pitch."""
        table = np.gradient(self._rising(self._usual), axis=1) * (self.bins * FINE)
        return np.asarray(table.astype(np.float32)[:, self.fine])

    def covariance(self, off: Image) -> tuple[FloatArray, Image]:
        """Covariance of the deviations in every bin, of most of its points and at most as of a good part.

        Returns:
            (B, P, P) covariances, and (rows, cols) 1 at the points of the bins that scatter least, which show the
            texture.
        """
        poses = len(off)
        flat = off.reshape(poses, -1)
        found = np.zeros((self.bins, poses, poses))
        for number in range(self.bins):
            chosen = self._bin(number)
            values = flat[:, chosen[:: max(1, len(chosen) // _SAMPLE)]].astype(np.float64)
            if not values.size:
                continue
            found[number] = _most_covariance(values)
        empty = np.diff(self.ends) == 0
        if empty.any():
            found[empty] = np.median(found[~empty], axis=0)
        size = np.where(empty, np.inf, np.trace(found, axis1=1, axis2=2))
        calm = size <= np.quantile(size[~empty], CALM_SHARE)
        texture, steep = found[calm].mean(axis=0), U_PLACE**2 * self._steepness()
        walls = WALLS**2 + LEAST_SCATTER**2
        bounded = _at_most(found + steep, texture + steep + walls * np.eye(poses))
        return bounded, np.repeat(calm, FINE)[self.fine].astype(np.float32)

    def glints(self) -> FloatArray:
        """(P, `PHASES`) mean share of the light of cells that is glint: more than the facets send at the median."""
        light = np.exp(self._usual)
        share = np.maximum(1.0 - np.median(light, axis=1, keepdims=True) / light, 0.0)
        inside = (np.arange(PHASES) + 0.5)[:, None] / PHASES + (np.arange(8) - 3.5) / 8.0 / CELLS_PER_PITCH
        return np.asarray(share[:, np.floor(np.mod(inside, 1.0) * self.bins).astype(int)].mean(axis=2))

    def _steepness(self) -> FloatArray:
        """(B, P, P) mean products of the slopes of the profiles per pitch, over every bin and its neighbours."""
        slopes = np.gradient(self._rising(self._usual), axis=1) * (self.bins * FINE)
        each = slopes.reshape(len(slopes), self.bins, FINE)
        products = np.einsum("pbf,qbf->bpq", each, each) / FINE
        return np.asarray(np.mean([np.roll(products, step, axis=0) for step in (-1, 0, 1)], axis=0))

    def distance(self, off: Image, covariance: FloatArray) -> Image:
        """(rows, cols) D² of the deviations of every point."""
        poses, rows, cols = off.shape
        flat = off.reshape(poses, -1)
        least = LEAST_SCATTER**2 * np.eye(poses)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance + least)).astype(np.float32)
        found = np.empty(rows * cols, dtype=np.float32)
        for number in range(self.bins):
            chosen = self._bin(number)
            white = whiten[number] @ flat[:, chosen]
            found[chosen] = np.einsum("pn,pn->n", white, white)
        return found.reshape(rows, cols)


def judge_area(
    measured: Measured, cells: CellMap | None, rule: AreaPart | None, coverage: float
) -> tuple[AreaRecord | None, npt.NDArray[np.bool_] | None]:
    """Decide on the deviating area of a part.

    Args:
        measured: the part.
        cells: how its cells deviate.
        rule: limit of the area.
        coverage: guard band by the standard uncertainty of the share.

    Returns:
        The result and (cell rows, cell cols) where cells deviate; None and None without a rule.

    Raises:
        MeasurementError: noise hides all but gross deviations of the cells.
    """
    if rule is None or cells is None:
        return None, None
    noise = float(np.sqrt(2.0) * measured.cell_noise.max())
    if noise > (1.0 + 1e-9) * MAX_CELL_NOISE * MOST_DEVIATION:
        raise MeasurementError(
            f"the ln ratio of a cell is uncertain by {noise:.3f}, too much to tell deviations of {MOST_DEVIATION:g} "
            f"(limit {MAX_CELL_NOISE * MOST_DEVIATION:.3f}): "
            "take more frames_per_pose, a longer exposure_s, or brackets (acquisition.brackets)"
        )
    over = cells.deviating()
    if measured.mirroring is not None:  # saturated by a defect
        over = over | measured.mirroring
    share, u = float(np.mean(over)), cells.u_share
    limit, guard = rule.max_share, coverage * u
    verdict = Verdict.INCONCLUSIVE
    if share <= limit - guard:
        verdict = Verdict.PASS
    elif share >= limit + guard:
        verdict = Verdict.FAIL
    area = AreaRecord(
        share=share,
        u=u,
        max_share=limit,
        cells=over.size,
        verdict=verdict,
        cell_deviations=tuple(map(float, cells.thresholds)),
        cell_covariance=None if cells.covariance is None else tuple(map(tuple, cells.covariance.tolist())),
        limit=cells.limit,
    )
    if rule.max_length_um is not None:
        longest_um, place = _longest(cells.score > CLEAR * cells.limit, measured.grid)
        area = area.model_copy(
            update={"longest_um": longest_um, "longest_at": place, "max_length_um": rule.max_length_um}
        )
    return area, over


def _longest(clear: npt.NDArray[np.bool_], grid: Grid) -> tuple[float, tuple[float, float] | None]:
    """Length in µm of the longest group of touching cells, in any direction, and its middle in mm."""
    count, labels = cv2.connectedComponents(clear.astype(np.uint8), connectivity=8)
    along, across = (size / cells for size, cells in zip(grid.size_mm, clear.shape, strict=True))
    longest, middle = 0.0, None
    for label in range(1, count):
        rows, cols = np.nonzero(labels == label)
        length = float(np.ptp(np.stack([cols * across, rows * along], axis=1) @ _WAYS, axis=0).max())
        if length + min(along, across) > longest:
            longest = length + min(along, across)
            middle = grid.of_cell(rows.mean(), cols.mean(), clear.shape)
    return 1000.0 * longest, middle


_WAYS = np.stack([function(np.linspace(0.0, np.pi, 12, endpoint=False)) for function in (np.cos, np.sin)])
