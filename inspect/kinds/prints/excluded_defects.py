"""Defects of a print that its poses exclude: flakes, ink and film, each as the ink model shows it at several sizes.

What is compared is ln of all channels with that of the prediction, or of the golden prints. A defect changes them as
the ink model says with it; everything else that is uncertain is linear. An input that is the same state as a defect
(the roughness of the ink) is no uncertainty of its limit: the limit is of that state.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.decision.exclusion import FINE, Change, Exclusion, excluded_by_changes
from anisoscope.kinds.prints.expectation import ROUGHNESS, PrintExpectation, sources_at
from anisoscope.kinds.prints.lobe_fit import PrintFit
from anisoscope.kinds.prints.model import Scene, State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_comparison import GoldenComparison
from anisoscope.kinds.prints.sources import Source, total
from anisoscope.recipe.named_defect import NamedDefect

MOST = 0.95
"""Share of an ink beyond which no more of it is missing, or another one."""
DOUBT = 0.03
"""Relative standard uncertainty of a change: inputs act on it to second order, and spectra have steps of 10 nm."""
_Way = tuple[NamedDefect, Callable[[float], State], Scene]


def deviation_of(
    expected: PrintExpectation,
    logs: FloatArray,
    sources: tuple[Source, ...],
    golden: GoldenComparison | None,
) -> tuple[FloatArray, FloatArray, tuple[Source, ...]]:
    """Ln of the channels over the golden prints, or else over the prediction, its covariance, and the sources in it.

    Args:
        expected: the prediction.
        logs: (3P,) ln of the print's channels.
        sources: all of its uncertainty.
        golden: comparison with the golden prints, or None.
    """
    if golden is None:
        return logs - np.log(expected.channels).ravel(), total(sources, logs.size), sources
    # how good inks and seats vary shows in the golden prints' scatter
    own = tuple(source for source in sources if source not in (*expected.fitted, *expected.misfit))
    return logs - golden.logs, total(own, logs.size) + golden.covariance, own


def excluded_of(
    recipe: PrintRecipe,
    expected: PrintExpectation,
    fit: PrintFit,
    deviation: FloatArray,
    covariance: FloatArray,
    *,
    golden: bool,
) -> tuple[Exclusion, ...]:
    """Limits of the named defects of a print.

    Args:
        recipe: with the smallest interesting sizes.
        expected: the prediction.
        fit: gives the directions of brushing and lean, which are those of the least distance.
        deviation: (N,) ln of the channels of all poses over those of a good print.
        covariance: (N, N) of it.
        golden: whether the good print is the mean of golden prints, with which errors common to all prints cancel.
    """
    nominal, changes = sources_at(recipe, expected, State()), []
    for defect, state, scene in _ways(recipe, expected.scene, fit.state):
        pinned = (ROUGHNESS,) if defect.words in _OF_ROUGHNESS and not golden else ()
        size = defect.size * (0.01 if defect.unit == "%" else 1.0)
        try:
            good = scene.log_channels()
            shown = np.array([scene.log_channels(state(float(one) * size)) - good for one in FINE])
            acting = sources_at(recipe, replace(expected, scene=scene), state(size))
        except ModelError:  # the model does not reach that far
            continue
        more = np.array([_added(nominal, acting, float(one), pinned, golden=golden) for one in FINE])
        more += DOUBT**2 * np.einsum("em,en->emn", shown, shown)
        changes.append(Change(defect, shown, covariance + more))
    return excluded_by_changes(changes, deviation)


def _added(
    nominal: tuple[Source, ...],
    acting: tuple[Source, ...],
    extent: float,
    pinned: tuple[str, ...],
    *,
    golden: bool,
) -> FloatArray:
    """(N, N) covariance that uncertain inputs add where a defect makes them act otherwise, in proportion."""
    found = np.zeros((len(nominal[0].factor),) * 2)
    for before, at_size in zip(nominal, acting, strict=True):
        apart = extent * (at_size.factor - before.factor)
        if golden:
            found += apart @ apart.T
            continue
        now = before.factor + apart
        found += (0.0 if before.name in pinned else 1.0) * (now @ now.T) - before.covariance()
    return found


_ROUGHER, _FLATTER = "flakes less flat by ", "flakes flatter by "
_OF_ROUGHNESS = {_ROUGHER, _FLATTER}


def _ways(recipe: PrintRecipe, scene: Scene, fitted: State) -> Iterator[_Way]:
    """Every named defect of the recipe, the state of the print of a size, and the scene that shows it."""
    sizes = recipe.defects
    brush = direction(fitted.ratio, fitted.skew)
    lean = direction(fitted.tilt_x_deg, fitted.tilt_y_deg)

    def brushed(e: float) -> State:
        return State(ratio=float(brush[0] * np.log1p(e)), skew=float(brush[1] * np.log1p(e)))

    def leaning(e: float) -> State:
        return State(tilt_x_deg=float(lean[0] * e), tilt_y_deg=float(lean[1] * e))

    ways: list[tuple[str, float | None, str, Callable[[float], State], Scene]] = [
        (_ROUGHER, sizes.roughness_share, "%", lambda e: State(alpha=float(np.log1p(e))), scene),
        (_FLATTER, sizes.roughness_share, "%", lambda e: State(alpha=-float(np.log1p(e))), scene),
        ("brushed by ", sizes.brushed_share, "%", brushed, scene),
        ("flakes lean by ", sizes.lean_deg, "°", leaning, scene),
        ("ink missing ", sizes.missing_share, "%", lambda e: State(missing=min(e, MOST)), scene),
        ("film thicker by ", sizes.film_nm, " nm", lambda e: State(shift_nm=e), scene),
        ("film thinner by ", sizes.film_nm, " nm", lambda e: State(shift_nm=-e), scene),
    ]
    for ink in recipe.print.read_wrong_inks():
        words, mixed = f"{ink.name} in the ink ", replace(scene, other=ink)
        ways.append((words, sizes.wrong_ink_share, "%", lambda e: State(other=min(e, MOST)), mixed))
    for words, size, unit, state, shown_by in ways:
        if size is not None:
            yield NamedDefect(words, 100.0 * size if unit == "%" else size, unit), state, shown_by


def direction(first: float, second: float) -> FloatArray:
    """Unit vector of a fitted direction; the first axis where there is none."""
    found = np.array([first, second])
    length = float(np.linalg.norm(found))
    return found / length if length > 0.0 else np.array([1.0, 0.0])
