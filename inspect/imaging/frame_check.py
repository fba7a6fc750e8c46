"""Check of single frames before those of a pose are averaged: stale, torn, black, repeated and clipped ones.

All frames of one pose and exposure show the same picture, so that each is compared with the pixel-wise median of them
in blocks of rows. Their noise is known from the frames themselves: its variance is that of the dark frames plus a part
in proportion to the signal (photon transfer; EMVA 1288).
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError
from anisoscope.base.parallel import for_each
from anisoscope.imaging.frames import AcquiredFrames, Shot
from anisoscope.recipe.base import LimitsPart
from anisoscope.rig.frame import SATURATION

MIN_FRAMES = 2
COLUMN_STEP, BLOCK_ROWS = 4, 4
MOST_NOISE = 6.0  # mean square of a block over what noise explains
FAINT_COUNTS = 1.0  # light of a pose below which frames are not compared by their light
UNLIT = 0.05  # share of the pose's level below which a frame is black
NEARLY_ALL = 0.5  # of the blocks of both halves, that another picture changes; fewer are torn
PILE = 4.0  # pixels on a clipped count over those on each of the counts below it
BELOW = 4
ALIKE = 0.9  # correlation of frames of one picture
COMMON = 0.5  # share of counts that two frames have in common, less where noise shows
_KINDS = ("sample", "dark", "stray")

_Counts = npt.NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class _Group:
    """Frames of one pose and exposure.

    Attributes:
        shots: the frames.
        counts: (n, rows, some columns) their counts, in every fourth column or fewer.
        level: (n,) ratio of each frame's signal to that of the median frame.
        signal: (blocks,) mean signal of the median frame in counts, and `power` its mean square.
        off: (n, blocks) mean square of the deviations from the median frame, scaled to its level.
    """

    shots: tuple[Shot, ...]
    counts: _Counts
    level: FloatArray
    signal: FloatArray
    power: FloatArray
    off: FloatArray

    @property
    def is_dark(self) -> bool:
        """Whether the light was off."""
        return self.shots[0].frame.kind == "dark"

    @property
    def place(self) -> str:
        """The pose in words, or the kind of frames."""
        first = self.shots[0]
        if first.frame.kind != "sample":
            return f"of the {first.frame.kind} frames"
        tilt = f", tilt {first.pose.tilt_deg:g}°" if first.pose.tilt_deg else ""
        again = ", again" if first.again else ""
        return f"at {first.pose.stage_deg:g}°{tilt}{again}"


@dataclass(frozen=True)
class _Fault:
    """Fault of a frame that cannot be used, in words, and what to do."""

    says: str
    do: str
    same: str = ""
    """Hash of the pixels that another frame has as well."""


_DRIVER = "check the camera's cable and driver, and that it delivers a new picture for every trigger"
_BUFFER = "the camera or its driver delivers one buffer again"
_EXPOSURE = "switch automatic exposure and gain off, and look whether the lamp flickers"


def usable_frames(acquired: AcquiredFrames, limits: LimitsPart) -> tuple[AcquiredFrames, tuple[str, ...]]:
    """Frames without those that are stale, torn, black, repeated or clipped below full scale.

    Args:
        acquired: all frames of an inspection.
        limits: how much the frames of a pose may differ.

    Returns:
        The frames that can be averaged, and a note on each that was left out: at least two and at least half of a pose
        have to remain.

    Raises:
        MeasurementError: too few remain; the line names the frame, its fault and what to do.
    """
    grouped: dict[object, list[Shot]] = defaultdict(list)
    for shot in acquired.shots:
        frame = shot.frame
        if frame.kind in _KINDS and frame.counts.ndim == 2:
            key = () if frame.kind == "dark" else (shot.pose, shot.again, shot.check, shot.run)
            grouped[frame.kind, key, frame.exposure_s, frame.gain, frame.counts.shape].append(shot)
    blacks = _blacks(grouped.values())
    groups = for_each(lambda shots: _group(shots, _black_of(shots[0], blacks)), grouped.values())
    read, gain = _noise(groups)

    def different(group: _Group) -> dict[int, _Fault]:
        return _compared(group, read, gain, limits, groups) | _of_themselves(group, limits)

    found = for_each(different, groups)
    sound = [
        (group, number)
        for group, faults in zip(groups, found, strict=True)
        for number in range(len(group.shots))
        if number not in faults
    ]
    same = _identical([group.shots[number] for group, number in sound])
    bad, notes = set(), []
    for group, faults in zip(groups, found, strict=True):
        faults |= {number: same[id(shot)] for number, shot in enumerate(group.shots) if id(shot) in same}
        left = len(group.shots) - len(faults)
        if faults and (left < MIN_FRAMES or 2 * left < len(group.shots)):
            raise MeasurementError(_refusal(group, faults))
        bad |= {id(group.shots[number]) for number in faults}
        notes += [
            f"{_named(group, number)} was left out: it {fault.says}"
            for number, fault in sorted(faults.items())
        ]
    if not bad:
        return acquired, ()
    kept = tuple(shot for shot in acquired.shots if id(shot) not in bad)
    return replace(acquired, shots=kept), tuple(notes)


def _named(group: _Group, number: int) -> str:
    return f"frame {number + 1} {group.place} ({group.shots[number].name})"


def _refusal(group: _Group, faults: Mapping[int, _Fault]) -> str:
    """Line on frames of which too few are left."""
    number, all_bad = min(faults), len(faults) == len(group.shots)
    first = faults[number]
    twins = [
        place + 1 for place, shot in enumerate(group.shots) if first.same and shot.frame.pixels == first.same
    ]
    if len(twins) > len(faults):
        return f"frames {twins[0]} to {twins[-1]} {group.place} are the same picture bit for bit: {_BUFFER}: {first.do}"
    others = f" (and {len(faults) - 1} more of {len(group.shots)} cannot be used)" if len(faults) > 1 else ""
    if all_bad and len(faults) == MIN_FRAMES:
        others = ", or the other one is"
    return f"{_named(group, number)} {first.says}{others}: {first.do}"


def _blacks(groups: Iterable[Sequence[Shot]]) -> dict[tuple[float, float], float]:
    """Counts without light by exposure and gain."""
    return {
        (shots[0].frame.exposure_s, shots[0].frame.gain): float(
            np.median([one.frame.counts[::BLOCK_ROWS, ::COLUMN_STEP].mean() for one in shots])
        )
        for shots in groups
        if shots[0].frame.kind == "dark"
    }


def _black_of(shot: Shot, blacks: dict[tuple[float, float], float]) -> float:
    return blacks.get((shot.frame.exposure_s, shot.frame.gain), shot.frame.black_level)


def _group(shots: Sequence[Shot], black: float) -> _Group:
    step = COLUMN_STEP if len(shots) <= COLUMN_STEP else COLUMN_STEP**2  # the median of many takes longer
    counts = np.stack([shot.frame.counts[:, ::step] for shot in shots])
    signals = counts.astype(np.float32)
    signals -= np.float32(black)
    means = _blocks(signals)
    level = np.ones(len(shots))
    if shots[0].frame.kind != "dark":
        usual = np.median(means, axis=0)
        lit = usual >= np.median(usual)
        if np.median(usual[lit]) > FAINT_COUNTS:
            level = np.median(means[:, lit] / np.maximum(usual[lit], FAINT_COUNTS), axis=1)
            signals /= np.where(level > UNLIT, level, 1.0)[:, None, None].astype(np.float32)
    middle = _median(signals)
    signals -= middle
    np.square(signals, out=signals)
    return _Group(tuple(shots), counts, level, _blocks(middle), _blocks(np.square(middle)), _blocks(signals))


def _median(signals: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Pixel-wise median of the frames; of up to four, by their extremes, which is four times as fast."""
    if len(signals) > 4:
        return np.asarray(np.median(signals, axis=0))
    total = signals.sum(axis=0)
    if len(signals) < 3:
        return np.asarray(total / np.float32(len(signals)))
    total -= signals.min(axis=0)
    total -= signals.max(axis=0)
    return np.asarray(total / np.float32(len(signals) - 2))


def _blocks(values: npt.NDArray[np.float32]) -> FloatArray:
    """(…, blocks) means over blocks of rows."""
    rows = values.mean(axis=-1, dtype=np.float32)
    starts = np.arange(0, rows.shape[-1], BLOCK_ROWS)
    sizes = np.diff(np.append(starts, rows.shape[-1]))
    return np.asarray(np.add.reduceat(rows, starts, axis=-1) / sizes, dtype=np.float64)


def _noise(groups: Sequence[_Group]) -> tuple[float, float]:
    """Variance of a count in the dark, and its growth with the signal, from what most blocks show."""
    dark = [group.off.ravel() for group in groups if group.is_dark]
    read = (float(np.median(np.concatenate(dark))) if dark else 0.0) + 1.0 / 12.0
    growth = [
        ((group.off - read) / np.maximum(group.signal, 1.0)).ravel() for group in groups if not group.is_dark
    ]
    return read, max(float(np.median(np.concatenate(growth))), 0.0) if growth else 0.0


def _of_themselves(group: _Group, limits: LimitsPart) -> dict[int, _Fault]:
    """Faults that a frame shows alone: rows without content, and a plateau."""
    if group.is_dark:
        return {}
    found = {}
    for number, (shot, counts) in enumerate(zip(group.shots, group.counts, strict=True)):
        other = group.counts[(number + 1) % len(group.counts)]
        if (blank := _constant(counts, other)).size:
            black = blank.size == len(counts) and not counts.any()
            says = "is black" if black else f"is torn: all counts are equal in {_rows(blank)}"
        elif (again := _repeated(counts, other)).size:
            says = f"is torn: it repeats the row before bit for bit in {_rows(again)}"
        elif (plateau := _plateau(shot, counts, other, limits)) is not None:
            found[number] = plateau
            continue
        else:
            continue
        found[number] = _Fault(says, _DRIVER)
    return found


def _constant(counts: _Counts, other: _Counts) -> npt.NDArray[np.intp]:
    """Rows of one count, although noise shows there."""
    return _noisy(np.flatnonzero((counts == counts[:, :1]).all(axis=1)), counts, other)


def _repeated(counts: _Counts, other: _Counts) -> npt.NDArray[np.intp]:
    """Rows that repeat the one before, although noise shows there."""
    return _noisy(np.flatnonzero((counts[1:] == counts[:-1]).all(axis=1)) + 1, counts, other)


def _noisy(rows: npt.NDArray[np.intp], counts: _Counts, other: _Counts) -> npt.NDArray[np.intp]:
    """Those of the rows in which most counts differ from those of another frame."""
    return np.asarray(rows[np.mean(counts[rows] == other[rows], axis=1) < COMMON])


def _rows(places: npt.NDArray[np.intp]) -> str:
    """Rows in words, counted from 1."""
    first, last = int(places[0]) + 1, int(places[-1]) + 1
    if first == last:
        return f"row {first}"
    return f"{places.size} rows from {first} to {last}"


def _plateau(shot: Shot, some: _Counts, other: _Counts, limits: LimitsPart) -> _Fault | None:
    """Fault of a frame whose brightest pixels all have one count below full scale, although noise shows below it."""
    counts, full = shot.frame.counts, shot.frame.full_scale
    top = int(counts.max(initial=0))
    if top >= SATURATION * full:
        return None
    piled = np.count_nonzero(counts == top)
    if piled <= limits.plateau_share * counts.size:
        return None
    below = np.bincount(top - counts[counts >= top - min(BELOW, top)].astype(np.int64), minlength=BELOW + 1)[
        1:
    ]
    noisy = (some < top) & (some > 0.5 * top)
    if piled <= PILE * below.max() or not noisy.any() or np.mean(some[noisy] == other[noisy]) > COMMON:
        return None
    return _Fault(
        f"has {piled / counts.size:.1%} of its pixels on {top} counts, its largest, below the full scale of {full} "
        f"(limit {limits.plateau_share:.1%}, limits.plateau_share): it is clipped there",
        "correct the bit depth, switch the camera's gamma and look-up tables off, or shorten the exposure",
    )


def _identical(shots: Sequence[Shot]) -> dict[int, _Fault]:
    """Faults of frames that equal an earlier one bit for bit, by the id of the shot."""
    alike: dict[str, list[Shot]] = defaultdict(list)
    for shot, pixels in zip(shots, for_each(lambda one: one.frame.pixels, shots), strict=True):
        if shot.frame.kind in _KINDS and (shot.frame.kind != "dark" or is_noisy(shot.frame.counts)):
            alike[pixels].append(shot)
    return {
        id(shot): _Fault(f"is the same picture bit for bit as {same[0].name}: {_BUFFER}", _DRIVER, pixels)
        for pixels, same in alike.items()
        for shot in same[1:]
    }


def is_noisy(counts: _Counts) -> bool:
    """Whether noise shows in counts (rows, cols): not where the camera clips most pixels at one count."""
    some = counts[::8, ::8].ravel()
    return bool(np.bincount(some).max() < 0.5 * some.size)


def _compared(
    group: _Group, read: float, gain: float, limits: LimitsPart, groups: Sequence[_Group]
) -> dict[int, _Fault]:
    """Faults of frames that differ from the others of their pose."""
    if len(group.shots) < MIN_FRAMES:
        return {}
    expected = read + gain * np.maximum(group.signal, 0.0)
    power = np.maximum(group.power, group.power.mean())
    if group.is_dark:  # a difference matters by the light of the pictures from which it is subtracted
        power = np.full_like(
            expected, min((one.power.mean() for one in groups if not one.is_dark), default=np.inf)
        )
    differs = (group.off > MOST_NOISE * expected) & (group.off > limits.frame_difference**2 * power)
    found = {}
    for number, level in enumerate(group.level):
        share = float(differs[number].mean())
        if level < UNLIT:
            says, do = f"is black: it has {max(float(level), 0.0):.0%} of the others' light", _DRIVER
        elif abs(level - 1.0) > limits.frame_level and (
            share < NEARLY_ALL or _likeness(group, number, group) > ALIKE
        ):
            says = (
                f"has {level:.0%} of the others' light (limit ±{limits.frame_level:.0%}, limits.frame_level): its "
                "exposure is stale or was cut short"
            )
            do = _EXPOSURE
        elif all(half.mean() >= NEARLY_ALL for half in np.array_split(differs[number], 2)):
            says, do = f"is stale: it shows {_shown(group, number, groups)}", _DRIVER
        elif share > 0.0:
            rows = np.flatnonzero(np.repeat(differs[number], BLOCK_ROWS))
            says, do = f"is torn: it differs from the others of its pose in {_rows(rows)}", _DRIVER
        else:
            continue
        found[number] = _Fault(says, do)
    return found


def _likeness(group: _Group, number: int, other: _Group) -> float:
    """Correlation of a frame with the median of the other frames of a pose."""
    rest = [one for place, one in enumerate(other.counts) if other is not group or place != number]
    return float(np.corrcoef(group.counts[number].ravel(), np.median(rest, axis=0).ravel())[0, 1])


def _shown(group: _Group, number: int, groups: Sequence[_Group]) -> str:
    """What a stale frame shows, in words."""
    others = [one for one in groups if one is not group and one.counts.shape[1:] == group.counts.shape[1:]]
    likeness = [-1.0 if one.is_dark else _likeness(group, number, one) for one in others]
    if not others or max(likeness) < ALIKE:
        return "another picture than the others of its pose"
    return f"the picture {others[int(np.argmax(likeness))].place}"
