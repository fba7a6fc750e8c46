"""Defects of a plate that its poses exclude: of its worst field, by the scatter of its class, and of all fields.

A field is compared with the middle of its class, or with the pattern of golden plates. A plate with one field that has
a defect of exactly the size of interest excludes it as seldom as that field does, however many fields there are; of a
good plate the limit is that of its most deviating field, and so larger the more fields it has.

What all fields share shows in the classes alone, against the prediction and with the absolute scale: of an unmeasured
lobe, too, because it moves classes and poses otherwise than a defect does.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.decision.exclusion import (
    FINE,
    ONE_SIDED,
    Change,
    Exclusion,
    PlannedLimit,
    excluded_by_changes,
    planned,
)
from anisoscope.kinds.plates.expectation import FLAT_DEG, ExpectedPlate, quick_light
from anisoscope.kinds.plates.field_outliers import FieldScatter
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.recipe.named_defect import NamedDefect

DOUBT = 0.1
"""Relative standard uncertainty of the change of ln L by a defect."""
PLANNED = 0.2
"""Scatter of the fields over their tolerance, where no plate has shown it."""
OF_ALL = "every "
"""Before the words of a defect that all fields share."""
_MANY = 1e6
_Light = Callable[[RidgeDesign, float], FloatArray]


def excluded_fields(
    expected: ExpectedPlate,
    recipe: PlateRecipe,
    tested: FloatArray,
    scatters: tuple[FieldScatter | None, ...],
    shared: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[Exclusion, ...]:
    """Limits of the named defects of the worst field; of any size where a class has too few fields to compare.

    With ``shared``, those of all fields at once follow.

    Args:
        expected: the prediction.
        recipe: with the smallest interesting sizes.
        tested: (P, rows, cols) ln L of the fields less that of good ones.
        scatters: of every class.
        shared: (C·P,) ln L of the classes less the predicted one, and its (C·P, C·P) covariance with that of the scale.
    """
    light = quick_light(recipe, expected.poses, expected.convention)
    design, plan, classes = recipe.surface.ridge_design(), expected.plan, expected.plan.classes()
    worst: dict[str, Exclusion] = {}
    together: dict[NamedDefect, list[FloatArray]] = {}
    for number, (letter, scatter) in enumerate(zip(plan.letters, scatters, strict=True)):
        places = np.argwhere((classes == number) & np.isfinite(tested).all(axis=0))
        own = plan.design_of(letter, design)
        for defect, shown in _shown(recipe, own, plan.azimuths_deg[letter], light):
            together.setdefault(defect, []).append(shown)
            for one in _of_class(defect, shown, scatter, tested, places):
                if defect.name not in worst or one.limit > worst[defect.name].limit:
                    worst[defect.name] = one
    if shared is None:
        return tuple(worst.values())
    off, covariance = shared
    changes = []
    for defect, each in together.items():
        shown = np.concatenate(each, axis=1)
        of_all = replace(defect, words=f"{OF_ALL}{defect.words}")
        changes.append(Change(of_all, shown, covariance + _doubted(shown)))
    return (*worst.values(), *excluded_by_changes(changes, off))


def _doubted(shown: FloatArray) -> FloatArray:
    """(E, n, n) covariance of changes (E, n)."""
    return np.asarray(DOUBT**2 * np.einsum("ep,eq->epq", shown, shown))


def planned_fields(
    expected: ExpectedPlate, recipe: PlateRecipe, covariance: FloatArray | None
) -> tuple[PlannedLimit, ...]:
    """Limits of a plate as designed, whose fields scatter by `PLANNED` of their tolerance.

    Args:
        expected: the prediction.
        recipe: with the smallest interesting sizes.
        covariance: (C·P, C·P) of ln L of the classes with that of the scale; None where a tolerance judges them.
    """
    size = len(expected.poses)
    own = (PLANNED * recipe.fields.tolerance) ** 2 * np.eye(size)
    scatter = FieldScatter(np.zeros(size), own, _MANY)
    tested = np.zeros((size, *expected.plan.classes().shape))
    shared = None if covariance is None else (np.zeros(len(covariance)), covariance)
    return planned(
        [excluded_fields(expected, recipe, tested, (scatter,) * len(expected.plan.letters), shared)]
    )


def _of_class(
    defect: NamedDefect,
    shown: FloatArray,
    scatter: FieldScatter | None,
    tested: FloatArray,
    places: np.ndarray,
) -> Iterator[Exclusion]:
    """Limits of the fields of a class that look most like the defect."""
    from scipy.special import stdtrit  # noqa: PLC0415 - start-up time

    if scatter is None:
        if len(places):
            yield Exclusion(defect, 0.0, float("inf"), place_text(*places[0]))
        return
    # what few fields leave unknown of their scatter, as for golden parts
    known = scatter.covariance * (float(stdtrit(scatter.freedom, 0.95)) / ONE_SIDED) ** 2
    covariance = known + _doubted(shown)
    away = tested[:, places[:, 0], places[:, 1]].T - scatter.middle
    (at_size,) = np.flatnonzero(FINE == 1.0)
    score = away @ np.linalg.solve(covariance[at_size], shown[at_size])
    for k in np.argsort(-score)[:_LIKEST]:
        (found,) = excluded_by_changes([Change(defect, shown, covariance)], away[k])
        yield replace(found, where=place_text(*places[k]))


_LIKEST = 5


def place_text(row: int, col: int) -> str:
    """Place of a field, counted from 1."""
    return f"row {row + 1} column {col + 1}"


def _shown(
    recipe: PlateRecipe, design: RidgeDesign, azimuth_deg: float, light: _Light
) -> Iterator[tuple[NamedDefect, FloatArray]]:
    """Every named defect with the (E, P) change of ln L of a field at `FINE`; none that ridges cannot have."""
    sizes, good = recipe.defects, light(design, azimuth_deg)
    flat = light(replace(design, ridge_angle_deg=FLAT_DEG, edge_radius_um=0.0), 0.0)

    def bare(share: float) -> FloatArray:
        part = min(share, 1.0)
        return np.asarray(np.log((1.0 - part) * np.exp(good) + part * np.exp(flat)))

    def turned(by_deg: float) -> FloatArray:
        return light(
            replace(design, ridge_angle_deg=max(design.ridge_angle_deg + by_deg, FLAT_DEG)), azimuth_deg
        )

    def lower(loss: float) -> FloatArray:
        return light(replace(design, height_loss=min(loss, _MOST), edge_radius_um=0.0), azimuth_deg)

    def worn(radius_um: float) -> FloatArray:
        return light(replace(design, edge_radius_um=max(radius_um, design.edge_radius_um)), azimuth_deg)

    ways: tuple[tuple[str, float | None, str, float, Callable[[float], FloatArray]], ...] = (
        ("field ridge angle +", sizes.ridge_angle_deg, "°", 1.0, turned),
        ("field ridge angle −", sizes.ridge_angle_deg, "°", 1.0, lambda e: turned(-e)),
        ("field height loss ", sizes.height_loss, "%", 100.0, lower),
        ("field worn to ", sizes.wear_um, " µm", 1.0, worn),
        ("field bare on ", sizes.bare_share, "%", 100.0, bare),
    )
    for words, size, unit, scale, way in ways:
        if size is None:
            continue
        found: list[FloatArray] = []
        for extent in FINE:
            try:
                found.append(way(float(extent) * size) - good)
            except HeightMapError:  # no facet is left: more of it is no other
                found.append(found[-1])
        yield NamedDefect(words, scale * size, unit), np.array(found)


_MOST = 0.95
