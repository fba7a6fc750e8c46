"""Defects of the shape of ridges: incomplete filling, wrong pitch, missing ridges, chatter of the cutter."""

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.defects_layout import RidgeLayout, positions, ridge_layout, ridge_numbers
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.fold import Folded, fold
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.period import find_period


def incomplete_filling(surface: HeightMap, loss: float, *, gradient: float = 0.0) -> HeightMap:
    """Crests that end in a plateau because the melt froze before it reached the tip of the groove.

    In moulding: melt or mould too cold, packing pressure too low or too late, trapped air, a wall too thin far from
    the gate. Everything above the foot plus (1 − loss) of the height of the median ridge is cut off.

    Args:
        surface: the map, with ridges.
        loss: share of the ridge height that is missing, 0 to 1.
        gradient: the loss grows along +y from (1 − gradient)·loss to (1 + gradient)·loss, as it does away from the
            gate; −1 to 1.

    Raises:
        HeightMapError: a parameter outside its range, or no ridges.
    """
    if not 0.0 <= loss <= 1.0:
        raise HeightMapError(f"the loss must be a share of 0 to 1, not {loss}")
    if not -1.0 <= gradient <= 1.0:
        raise HeightMapError(f"the gradient must be within −1 and 1, not {gradient}")
    layout = ridge_layout(surface)
    place = np.linspace(-1.0, 1.0, surface.shape[0])[:, None]
    local = np.clip(loss * (1.0 + gradient * place), 0.0, 1.0)
    limit = layout.foot_um + (1.0 - local) * (layout.crest_um - layout.foot_um)
    # without loss nothing is cut, although peaks stand above the median crest
    cut = np.where(local > 0.0, np.maximum(layout.levelled_um - limit, 0.0), 0.0)
    return surface.with_height(surface.height_um - cut)


def pitch_error(surface: HeightMap, error_percent: float) -> HeightMap:
    """Ridges cut with a wrong feed: another pitch, the same angles, and so heights in proportion.

    In tooling: wrong feed per groove, a worn or hot lead screw; in moulding: wrong allowance for shrinkage. The median
    ridge is exchanged for one that is larger by the error in width and height; roughness, residue and form, which are
    the difference from it, stay where they are.

    Args:
        surface: the map, with ridges.
        error_percent: change of the pitch in percent, above −90.

    Raises:
        HeightMapError: a parameter outside its range, or no ridges.
    """
    if not error_percent > -90.0:
        raise HeightMapError(f"the pitch cannot change by {error_percent}%; −90% is the limit")
    layout = ridge_layout(surface)
    factor = 1.0 + 0.01 * error_percent
    across, _ = positions(surface, layout.period.direction_deg)
    now, mean = layout.folded, float(np.mean(layout.folded.height_um))
    wanted = factor * (now.at(np.mod(across / (factor * layout.period.pitch_um), 1.0)) - mean)
    return surface.with_height(surface.height_um + wanted - (now.at(now.phase) - mean))


def missing_ridges(surface: HeightMap, share: float, *, rng: np.random.Generator) -> HeightMap:
    """Ridges that are not there: their place lies at the level of the foot.

    In moulding: grooves of the tool clogged with residue or plastic; in tooling: passes skipped, a broken cutter. The
    median ridge is taken off from foot to foot; roughness stays.

    Args:
        surface: the map, with ridges.
        share: share of the ridges that are missing, 0 to 1, rounded to whole ridges.
        rng: draws which ones; more of them include fewer.

    Raises:
        HeightMapError: a share outside its range, or no ridges.
    """
    if not 0.0 <= share <= 1.0:
        raise HeightMapError(f"the share of missing ridges must be 0 to 1, not {share}")
    layout = ridge_layout(surface)
    number = ridge_numbers(surface, layout)
    order = rng.permutation(int(number.max()) + 1)
    gone = np.zeros(order.size, dtype=np.bool_)
    gone[order[: round(share * order.size)]] = True
    return surface.with_height(surface.height_um - np.where(gone[number], _ridge(layout), 0.0))


def _ridge(layout: RidgeLayout) -> FloatArray:
    """(rows, cols) height of the median ridge above its foot in µm."""
    folded: Folded = layout.folded
    return folded.at(folded.phase) - layout.foot_um


def chatter(
    surface: HeightMap,
    amplitude_um: float,
    *,
    wavelength_um: float = 80.0,
    phase_step: float = 0.25,
    jitter: float = 0.1,
    rng: np.random.Generator,
) -> HeightMap:
    """Waves along the ridges, left by a cutter that vibrated while it cut the tool.

    In tooling: resonance of cutter, holder or spindle; wavelength = cutting speed / frequency. Each ridge is one pass:
    the whole ridge goes up and down with amplitude·cos(2π·(v/wavelength + phase)); from pass to pass the phase moves
    on by a step, with some jitter. A map without ridges counts as one pass along +y.

    Args:
        surface: the map.
        amplitude_um: amplitude in µm.
        wavelength_um: wavelength along the ridges in µm, at least two pixels.
        phase_step: shift from ridge to ridge as a share of the wavelength.
        jitter: standard deviation of that shift, as a share of the wavelength.
        rng: source of randomness.

    Raises:
        HeightMapError: a parameter outside its range.
    """
    check_heights("height map", surface.height_um)
    if not amplitude_um >= 0.0 or not jitter >= 0.0:
        raise HeightMapError(
            f"amplitude and jitter of chatter must not be negative, not {amplitude_um} µm and {jitter}"
        )
    if not wavelength_um >= 2.0 * max(surface.pixel_x_um, surface.pixel_y_um):
        raise HeightMapError(
            f"chatter of {wavelength_um:g} µm is shorter than two pixels; take a longer wave"
        )
    period = find_period(surface)
    direction = period.direction_deg if period.is_periodic else 0.0
    _, along = positions(surface, direction)
    if period.is_periodic:
        folded = fold(surface, period.pitch_um, direction)
        number = ridge_numbers(surface, RidgeLayout(period, surface.height_um, folded))
    else:
        number = np.zeros(surface.shape, dtype=np.int64)
    steps = phase_step + jitter * rng.standard_normal(int(number.max()) + 1)
    phase = rng.random() + np.cumsum(steps)
    wave = np.cos(2.0 * np.pi * (along / wavelength_um + phase[number]))
    return surface.with_height(surface.height_um + amplitude_um * wave)
