"""Monitor of the rig: level, stray light and linearity of every picture, read from the printed markers of the fixture.

The markers are a grey card in every picture. Their white label gives the level of lamp and exposure, their black border
the stray light, and printed grey patches the linearity of the camera. A reference of the fixture
(`anisoscope.calibration.fixture`) makes these readings absolute: with W and B the radiances of white and black of a
marker in a picture, and w and b·w those of the reference, W = a·w + s and B = a·b·w + s, so that the stray radiance is
s = (B − b·W)/(1 − b) and the level a = (W − s)/w.

Without a reference the readings of the poses are compared with each other only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import View, dictionary_of
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.fixture import Fixture

RING = (0.35, 0.85)
"""Distances from the edge of a marker, in modules, between which its label is white."""
BORDER = (-0.7, -0.3)
SEEN_BLACK = 0.6  # a marker that is covered shows no contrast
HARMONICS = 2
DIRTY_SIGMA = 4.0
BLURRED = 1.3
SHARE_OF_STRAY = 0.1
"""Relative standard uncertainty of the stray light at the part, whose place is not that of the markers."""
EVEN_GREY = 0.01  # a patch that varies more over the stage angles, relative to white, is no grey


@dataclass(frozen=True, eq=False)
class MarkerReading:
    """Radiances of the greys of a fixture in one picture, in 1/sr; NaN where a marker is not seen.

    Attributes:
        stage_deg, tilt_deg: commanded angles.
        again: a repetition of the first pose.
        white, black: (M,) label and border of every marker of the fixture, in its order.
        noise: (M,) standard uncertainty of `white` from the noise of its pixels.
        greys: (G,) printed grey patches.
        edge_um: standard deviation of the edge spread, µm; None where it was not measured.
        scene: mean radiance of the picture, in 1/sr, of which a lens spreads a share over all of it (veiling glare).
    """

    stage_deg: float
    tilt_deg: float
    again: bool
    white: FloatArray
    black: FloatArray
    noise: FloatArray
    greys: FloatArray
    edge_um: float | None
    scene: float = 0.0

    @property
    def black_share(self) -> float:
        """Black relative to white, median of the markers."""
        return float(np.nanmedian(self.black / self.white))


@dataclass(frozen=True, eq=False)
class TiltReference:
    """Greys of a fixture at a tilt on a sound rig.

    Attributes:
        tilt_deg: tilt of the arm.
        white: (M,) radiance of the label of every marker in 1/sr, mean over the stage angles.
        shape: (1 + 2 H,) factor of it over the stage angle θ: 1, cos θ, sin θ, cos 2θ, …
        black: (M,) black relative to white.
        greys: (G,) greys relative to white; NaN where a patch is not even over the stage angles.
        edge_um: edge spread.
    """

    tilt_deg: float
    white: FloatArray
    shape: FloatArray
    black: FloatArray
    greys: FloatArray
    edge_um: float

    def at(self, stage_deg: float) -> FloatArray:
        """(M,) radiance of the labels at a stage angle."""
        return np.asarray(self.white * (harmonics([stage_deg], len(self.shape) // 2) @ self.shape))


@dataclass(frozen=True)
class FixtureReference:
    """Reference of a fixture, as `calibrate fixture` wrote it.

    Attributes:
        id: of the calibration.
        tilts: one a tilt.
        u_black: standard uncertainty of the black shares.
    """

    id: str
    tilts: tuple[TiltReference, ...]
    u_black: float

    @classmethod
    def from_details(cls, name: str, details: Mapping[str, Any]) -> "FixtureReference":
        """The reference from the details of its calibration record, as `as_details` gave them."""
        tilts = tuple(
            TiltReference(
                tilt_deg=float(one["tilt_deg"]),
                edge_um=float(one["edge_um"]),
                **{key: np.array(one[key], dtype=float) for key in ("white", "shape", "black", "greys")},
            )
            for one in details["tilts"]
        )
        return cls(name, tilts, float(details["u_black"]))

    def as_details(self) -> dict[str, Any]:
        """The reference as JSON: plain numbers, null for a grey without a value."""
        return {
            "u_black": self.u_black,
            "tilts": [
                {
                    "tilt_deg": one.tilt_deg,
                    "white": one.white.tolist(),
                    "shape": one.shape.tolist(),
                    "black": one.black.tolist(),
                    "greys": [None if np.isnan(grey) else grey for grey in one.greys.tolist()],
                    "edge_um": one.edge_um,
                }
                for one in self.tilts
            ],
        }

    def like(self, tilt_deg: float) -> TiltReference | None:
        """The reference of a tilt, or None where it was not taught."""
        near = [one for one in self.tilts if abs(one.tilt_deg - tilt_deg) < 0.5]
        return near[0] if near else None


def harmonics(stage_deg: Sequence[float], orders: int) -> FloatArray:
    """(N, 1 + 2 orders) one, cosines and sines of the multiples of angles."""
    angle = np.radians(np.asarray(stage_deg, dtype=float))
    columns = [np.ones_like(angle)]
    for order in range(1, orders + 1):
        columns += [np.cos(order * angle), np.sin(order * angle)]
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class PoseState:
    """State of the rig in one picture.

    Attributes:
        stage_deg, tilt_deg, again: as of `MarkerReading`.
        white: radiance of the labels in 1/sr, median of the markers.
        level: relative to the reference, or to the mean of the poses of this tilt without one.
        u_level: standard uncertainty of it from noise.
        black_share: black of the markers relative to their white.
        stray: radiance of stray light in 1/sr, beyond that at the reference; None without one.
        u_stray: standard uncertainty of it at the part.
        gradient: largest relative deviation of a marker from the level of all.
        nonlinear: largest deviation of a grey from a straight line through black and white, relative to white.
        edge_um: edge spread at the markers.
        scene: mean radiance of the picture, 1/sr.
    """

    stage_deg: float
    tilt_deg: float
    again: bool
    white: float
    level: float
    u_level: float
    black_share: float
    stray: float | None = None
    u_stray: float = 0.0
    gradient: float | None = None
    nonlinear: float | None = None
    edge_um: float | None = None
    scene: float = 0.0

    @property
    def stray_share(self) -> float:
        """Stray light relative to the labels, or to the picture where a mirror's spike makes that brighter."""
        return (self.stray or 0.0) / max(self.white, self.scene)


@dataclass(frozen=True)
class RigMonitor:
    """State of the rig during an inspection.

    Attributes:
        reference: id of the fixture's reference, or None.
        poses: one a picture, repetitions last.
        dirty: ids of markers that differ from the others in every pose and are left out.
        notes: for the operator.
        not_watched: what could not be seen.
        fault: reason why the measurement is INVALID, or None.
    """

    reference: str | None
    poses: tuple[PoseState, ...]
    dirty: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    not_watched: tuple[str, ...] = ()
    fault: str | None = None

    @property
    def u_stray(self) -> float:
        """Standard uncertainty of the stray light that was subtracted, 1/sr."""
        return max((pose.u_stray for pose in self.poses), default=0.0)

    @property
    def light_watched(self) -> bool:
        """Whether lamp, exposure and stray light were measured in every pose."""
        return bool(self.poses) and all(pose.stray is not None for pose in self.poses)


@dataclass(frozen=True, eq=False)
class _Places:
    """Points of the greys in sample millimetres, (N, 2) each: white and black of the markers, and further patches."""

    white: Sequence[FloatArray]
    black: Sequence[FloatArray]
    greys: Sequence[FloatArray]


def _places(fixture: Fixture, pixel_um: float) -> _Places:
    """Points at the distance of a pixel."""
    half = fixture.marker_mm / 2.0
    module = fixture.marker_mm / (dictionary_of(fixture).markerSize + 2)
    step = pixel_um / 1000.0

    def frame(inner: float, outer: float) -> FloatArray:
        """Points of a square ring."""
        at = np.arange(-outer, outer + 0.5 * step, step)
        x, y = np.meshgrid(at, at)
        far = np.maximum(np.abs(x), np.abs(y))
        return np.asarray(np.stack([x, y], axis=-1)[(far >= inner) & (far <= outer)])

    middles = [np.array([one.x_mm, one.y_mm]) for one in fixture.markers]
    white = frame(half + RING[0] * module, half + RING[1] * module)
    black = frame(half + BORDER[0] * module, half + BORDER[1] * module)
    return _Places(
        tuple(middle + white for middle in middles),
        tuple(middle + black for middle in middles),
        tuple(np.array([one.x_mm, one.y_mm]) + frame(0.0, 0.3 * one.size_mm) for one in fixture.greys),
    )


def read_markers(
    view: View, fixture: Fixture, places: _Places | None = None, *, again: bool = False
) -> MarkerReading:
    """Radiances of the greys of a fixture in a picture.

    Args:
        view: the picture with the placement of the fixture.
        fixture: its markers.
        places: points to sample; computed if not given.
        again: whether it is a repetition.
    """
    found = places or _places(fixture, view.placement.pixel_um)
    (white, spread), (black, _), (greys, _) = (
        _means(view, points) for points in (found.white, found.black, found.greys)
    )
    unseen = ~(black < SEEN_BLACK * white) | np.isin(
        [one.id for one in fixture.markers], view.placement.dropped
    )
    white, black = (np.where(unseen, np.nan, values) for values in (white, black))
    blur = view.placement.blur_px
    return MarkerReading(
        view.stage_deg,
        view.tilt_deg,
        again,
        white,
        black,
        spread,
        greys,
        None if blur is None else blur * view.placement.pixel_um,
        float(np.nanmean(view.image.value)),
    )


def _means(view: View, areas: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(K,) trimmed mean radiance of areas of points, and its standard uncertainty; NaN outside the picture."""
    rows, cols = view.image.value.shape
    means, spreads = np.full(len(areas), np.nan), np.full(len(areas), np.nan)
    for k, points in enumerate(areas):
        at = _pixels_of(view, points)
        if not np.all((at >= 0.0) & (at <= (cols - 1.0, rows - 1.0))):
            continue
        column, row = np.rint(at).astype(int).T
        values = np.sort(view.image.value[row, column].astype(np.float64))
        values = values[np.isfinite(values)]
        kept = values[len(values) // 10 : len(values) - len(values) // 10]
        if len(kept) > 10:
            means[k], spreads[k] = kept.mean(), values.std() / np.sqrt(len(values))
    return means, spreads


def _pixels_of(view: View, points: FloatArray) -> FloatArray:
    """(..., 2) column and row of points (..., 2) in sample millimetres, as the lens shows them."""
    found = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ view.placement.homography.T
    return view.placement.seen(found[..., :2] / found[..., 2:])


def watch(
    views: Sequence[View],
    again: Sequence[View],
    fixture: Fixture | None,
    limits: LimitsPart,
    reference: FixtureReference | None,
) -> RigMonitor:
    """Read the rig's state from the markers in every picture.

    Args:
        views: the poses.
        again: repetitions of the first pose.
        fixture: the markers; None where pictures are registered by edges.
        limits: of the recipe.
        reference: of the fixture, or None.

    Returns:
        The monitor; a fault is in it, and not raised.
    """
    if fixture is None or any(view.placement.markers == 0 for view in views):
        return RigMonitor(
            None, (), not_watched=("lamp, exposure, stray light and linearity: no markers are seen",)
        )
    places = _places(fixture, views[0].placement.pixel_um)
    readings = [read_markers(view, fixture, places) for view in views]
    readings += [read_markers(view, fixture, places, again=True) for view in again]
    ids = [one.id for one in fixture.markers]
    blind = [one for one in readings if not np.isfinite(one.white).any()]
    if blind:
        lacking = "lamp, exposure, stray light and linearity: no white of a marker can be read"
        return RigMonitor(
            None, (), not_watched=(f"{lacking} at {blind[0].stage_deg:g}° (saturated, or covered)",)
        )
    if reference is None:
        return _compared(readings, limits)
    return _against(readings, reference, ids, limits)


def _without_veil(readings: Sequence[MarkerReading], most: float) -> list[MarkerReading]:
    """Readings without the glare of pictures that are brighter than the labels; as clean as the cleanest one.

    Args:
        readings: of all poses.
        most: share of a picture's mean radiance that is taken for glare of the lens.
    """
    usual, found = min(one.black_share for one in readings), []
    for one in readings:
        white = float(np.nanmedian(one.white))
        veil = (float(np.nanmedian(one.black)) - usual * white) / (1.0 - usual)
        veil = min(veil, most * one.scene) if one.scene > white else 0.0
        found.append(replace(one, white=one.white - veil, black=one.black - veil))
    return found


def _compared(readings: Sequence[MarkerReading], limits: LimitsPart) -> RigMonitor:
    """Readings of the poses against each other, tilt by tilt."""
    readings = _without_veil(readings, limits.stray_share)
    usual = {
        tilt: _mean_seen(np.stack([one.white for one in readings if one.tilt_deg == tilt]))
        for tilt in {one.tilt_deg for one in readings}
    }
    poses = tuple(
        PoseState(
            one.stage_deg,
            one.tilt_deg,
            one.again,
            float(np.nanmedian(one.white)),
            # markers differ from each other; each is compared with itself
            float(np.nanmedian(one.white / usual[one.tilt_deg])),
            _noise_of(one),
            one.black_share,
            edge_um=one.edge_um,
            scene=one.scene,
        )
        for one in readings
    )
    fault = _uneven(poses, limits.white_untaught_share, "limits.white_untaught_share")
    worst = max(poses, key=lambda pose: pose.black_share)
    if fault is None and worst.black_share > limits.black_share:
        fault = (
            f"at {worst.stage_deg:g}° the black of the markers is {worst.black_share:.1%} as bright as their white "
            f"(limit {limits.black_share:.1%}, limits.black_share): keep other light off the rig, look for glare on "
            "lens and fixture; a print whose black is brighter is taught by `anisoscope calibrate fixture`"
        )
    lacking = (
        f"lamp level, stray light below {limits.black_share:.0%} of white and linearity of the camera: the rig has no "
        "reference of its fixture (anisoscope calibrate fixture)"
    )
    return RigMonitor(None, poses, not_watched=(lacking,), fault=fault)


def _against(
    readings: Sequence[MarkerReading], reference: FixtureReference, ids: Sequence[int], limits: LimitsPart
) -> RigMonitor:
    """Readings of the poses against the reference of the fixture."""
    untaught = sorted({one.tilt_deg for one in readings if reference.like(one.tilt_deg) is None})
    if untaught:
        known = _compared(readings, limits)
        tilts = ", ".join(f"{tilt:g}°" for tilt in untaught)
        lacking = (
            f"lamp level, stray light and linearity: the reference of the fixture does not hold tilt {tilts}"
        )
        return replace(known, not_watched=(f"{lacking} (anisoscope calibrate fixture --tilts)",))
    dirty = _dirty(readings, reference)
    poses = tuple(_state(one, reference, dirty) for one in readings)
    names = tuple(number for number, bad in zip(ids, dirty, strict=True) if bad)
    notes = [f"marker {number} is dirty or in shadow: its neighbours serve" for number in names]
    level = float(np.mean([pose.level for pose in poses]))
    fault = _fault(poses, level, reference, limits)
    fault = fault and (_blur_instead(poses, reference) or fault)
    if fault is None and abs(level - 1.0) > limits.level_note_share:
        notes.append(
            f"the markers are {abs(level - 1.0):.1%} {'brighter' if level > 1.0 else 'darker'} than at the reference "
            f"{reference.id}: has the lamp aged, or its level changed?"
        )
    stray = max(pose.stray_share for pose in poses)
    if fault is None and stray > 0.25 * limits.stray_share:
        notes.append(f"stray light of {stray:.1%} of white was measured at the markers and subtracted")
    return RigMonitor(reference.id, poses, names, tuple(notes), (), fault)


def _mean_seen(values: FloatArray) -> FloatArray:
    """(M,) means of the known values of (N, M); NaN for a marker that is never seen."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


def _dirty(readings: Sequence[MarkerReading], reference: FixtureReference) -> FloatArray:
    """(M,) True for markers that differ from the others in every pose, by more than their own scatter; not for most."""
    rows = []
    for one in readings:
        tilt = reference.like(one.tilt_deg)
        assert tilt is not None
        ratio = np.log(one.white / tilt.at(one.stage_deg))
        rows.append(ratio - np.nanmedian(ratio))
    off = np.stack(rows)
    mean = _mean_seen(off)
    spread = np.sqrt(_mean_seen((off - mean) ** 2))
    usual = 1.4826 * float(np.nanmedian(np.abs(mean - np.nanmedian(mean))))
    found = np.abs(mean) > np.maximum(DIRTY_SIGMA * np.maximum(spread, usual), 0.02)
    found |= np.isnan(mean)
    enough = (~found).sum() >= 2
    return np.asarray(found if enough else np.isnan(mean))


def _state(one: MarkerReading, reference: FixtureReference, dirty: FloatArray) -> PoseState:
    tilt = reference.like(one.tilt_deg)
    assert tilt is not None
    usual = np.where(dirty, np.nan, tilt.at(one.stage_deg))
    strays = (one.black - tilt.black * one.white) / (1.0 - tilt.black)
    strays = np.where(dirty, np.nan, strays)
    stray = float(np.nanmedian(strays))
    white = float(np.nanmedian(np.where(dirty, np.nan, one.white)))
    levels = (one.white - stray) / usual
    level = float(np.nanmedian(levels))
    scatter = float(np.nanstd(strays)) / np.sqrt(max(int(np.isfinite(strays).sum()), 1))
    middle = float(np.nanmean(usual))
    greys = (one.greys - stray) / (level * middle) - tilt.greys
    return PoseState(
        one.stage_deg,
        one.tilt_deg,
        one.again,
        white,
        level,
        _noise_of(one),
        one.black_share,
        stray,
        float(np.hypot(np.hypot(scatter, reference.u_black * white), SHARE_OF_STRAY * stray)),
        float(np.nanmax(np.abs(levels / level - 1.0))),
        float(greys[np.nanargmax(np.abs(greys))]) if np.isfinite(greys).any() else None,
        one.edge_um,
        one.scene,
    )


def _noise_of(one: MarkerReading) -> float:
    """Relative standard uncertainty of the median white, from noise."""
    seen = np.isfinite(one.white)
    return (
        float(np.sqrt(np.mean((one.noise[seen] / one.white[seen]) ** 2) / seen.sum())) if seen.any() else 0.0
    )


def _uneven(poses: Sequence[PoseState], limit: float, key: str) -> str | None:
    """Fault where the level differs between the poses, or None; that nearest to the reference is the right one."""
    usual = min((pose.level for pose in poses), key=lambda level: abs(level - 1.0))
    worst = max(poses, key=lambda pose: abs(pose.level / usual - 1.0))
    off = worst.level / usual - 1.0
    if abs(off) <= limit + 3.0 * worst.u_level:
        return None
    where = f"{worst.stage_deg:g}°" + (" at the end" if worst.again else "")
    return (
        f"at {where} the white of the markers is {abs(off):.1%} {'brighter' if off > 0 else 'darker'} than in the "
        f"other poses (limit {limit:.1%}, {key}): lamp, exposure or gain changed; switch automatic exposure and gain "
        "off, and let the lamp warm up"
    )


def _stray_fault(poses: Sequence[PoseState], reference: FixtureReference, limits: LimitsPart) -> str | None:
    """Fault of more stray light than is corrected for, or None."""
    worst = max(poses, key=lambda pose: abs(pose.stray_share))
    stray = worst.stray_share
    if abs(stray) <= limits.stray_share:
        return None
    limit = f"(limit {limits.stray_share:.1%}, limits.stray_share)"
    if stray < 0.0:
        return (
            f"at {worst.stage_deg:g}° the black of the markers lies {-stray:.1%} of white below that at the reference "
            f"{reference.id} {limit}: the dark frames hold light; keep other light off the rig while they are taken, "
            "and check the camera's black level"
        )
    return (
        f"at {worst.stage_deg:g}° stray light is {stray:.1%} of the white of the markers {limit}: keep other light off "
        "the rig, look for glare of the lamp on lens and fixture, and check the camera's black level"
    )


def _blur_instead(poses: Sequence[PoseState], reference: FixtureReference) -> str | None:
    """Fault of the focus, where blur, which mixes white and black, explains readings of the light; or None."""
    worst = max(poses, key=lambda pose: pose.edge_um or 0.0)
    taught = reference.like(worst.tilt_deg)
    if taught is None or worst.edge_um is None or not worst.edge_um > BLURRED * taught.edge_um > 0.0:
        return None
    return (
        f"at {worst.stage_deg:g}° the edges of the markers are {worst.edge_um:.1f} µm wide, {taught.edge_um:.1f} µm at "
        f"the reference {reference.id}: the picture is out of focus, so that white and black of the markers "
        "mix; focus again, and clean the lens"
    )


def _fault(
    poses: Sequence[PoseState], level: float, reference: FixtureReference, limits: LimitsPart
) -> str | None:
    """First fault of the rig against the reference, or None."""
    found = _stray_fault(poses, reference, limits) or _uneven(poses, limits.white_share, "limits.white_share")
    tilted = max(poses, key=lambda pose: pose.gradient or 0.0)
    bent = max(poses, key=lambda pose: abs(pose.nonlinear or 0.0))
    if found is not None:
        return found
    if abs(level - 1.0) > limits.level_share:
        return (
            f"the white of the markers is at {level:.0%} of the reference {reference.id} (limit ±"
            f"{limits.level_share:.0%}, limits.level_share): are exposure and gain those that the frames state? else "
            "the lamp changed: take a new flat"
        )
    if (tilted.gradient or 0.0) > limits.gradient_share:
        return (
            f"at {tilted.stage_deg:g}° a marker is {tilted.gradient:.1%} off the level of the others (limit "
            f"{limits.gradient_share:.1%}, limits.gradient_share): the light is uneven; clean the fixture, put the "
            "lamp as it was, or take a new flat"
        )
    if bent.nonlinear is not None and abs(bent.nonlinear) > limits.grey_share:
        return (
            f"at {bent.stage_deg:g}° a grey of the fixture is {bent.nonlinear:+.1%} of white off a straight line "
            f"through black and white (limit {limits.grey_share:.1%}, limits.grey_share): the camera is not linear "
            "(gamma, saturation, tone curve), or the patch is dirty; switch gamma off, or `anisoscope calibrate "
            "response`"
        )
    return None


def corrected(view: View, state: PoseState) -> View:
    """The view without the stray light that was measured, at the level of the reference."""
    if state.stray is None:
        return view
    image = view.image
    value = cv2.addWeighted(image.value, 1.0 / state.level, image.value, 0.0, -state.stray / state.level)
    changed: RadianceImage = replace(image, value=np.asarray(value, dtype=np.float32))
    return replace(view, image=changed, u_level=state.u_level)


def teach(readings: Sequence[MarkerReading], name: str) -> tuple[FixtureReference, float]:
    """Reference of a fixture from readings on a sound rig.

    Args:
        readings: every tilt at several stage angles; repetitions belong to their tilt.
        name: id of the reference.

    Returns:
        The reference, and the largest relative deviation of a reading's level from it.

    Raises:
        MeasurementError: a marker is never seen.
    """
    tilts, worst, blacks = [], 0.0, []
    for tilt_deg in dict.fromkeys(one.tilt_deg for one in readings):
        own = [one for one in readings if one.tilt_deg == tilt_deg]
        seen = np.stack([one.white for one in own])
        if np.isnan(seen).all(axis=0).any():
            raise MeasurementError(
                f"at tilt {tilt_deg:g}° a marker of the fixture is in no picture: clean it, and centre the fixture"
            )
        white = np.nanmean(seen, axis=0)
        level = np.nanmedian(seen / white, axis=1)
        orders = min(HARMONICS, (len({one.stage_deg for one in own}) - 1) // 2)
        design = harmonics([one.stage_deg for one in own], orders)
        shape = np.linalg.lstsq(design, level, rcond=None)[0]
        worst = max(worst, float(np.abs(level - design @ shape).max()))
        shares = np.stack([one.black / one.white for one in own])
        blacks.append(np.nanstd(shares, axis=0))
        greys = np.stack([one.greys / np.nanmean(one.white) for one in own])
        even = np.ptp(greys, axis=0) < EVEN_GREY
        edges = [one.edge_um for one in own if one.edge_um is not None]
        tilts.append(
            TiltReference(
                tilt_deg,
                white,
                shape,
                np.asarray(np.nanmean(shares, axis=0)),
                np.where(even, greys.mean(axis=0), np.nan),
                float(np.median(edges)) if edges else 0.0,
            )
        )
    u_black = float(np.mean(blacks) / np.sqrt(max(len(readings) - 1, 1)))
    return FixtureReference(name, tuple(tilts), u_black), worst
