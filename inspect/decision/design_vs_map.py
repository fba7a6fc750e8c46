"""Comparison of the measurement with both surfaces of a recipe: the design and the height map.

A recipe with both surfaces states which one decides; the other one is compared as well, and both results together
locate the problem: the shape, the height map, or dirt, plastic and rig.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError, HeightMapError
from anisoscope.base.significance import chi2_tail, log_basis, mahalanobis
from anisoscope.decision.consistency import from_prediction
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.prediction.expectation import Component, Expectation, expectation
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
from anisoscope.recipe.surface import Surface, SurfaceRecipe
from anisoscope.record.schema import ComparisonRecord, ReadingNumberRecord, ReadingRecord
from anisoscope.sim.light.contrasts import consecutive_pairs
from anisoscope.sim.light.relief import Relief
from anisoscope.sim.light.unresolved import resolve

Predict = Callable[[SurfaceRecipe, float], Expectation]
"""Function that predicts a recipe at the rig's light angle, computed or from the cache."""

TEXTURE = 0.01
"""Roughness that a map resolves beyond which the light of a smooth design differs."""
HEIGHT_SCALE_SHARE, PIXEL_SIZE_SHARE = 0.005, 0.002
"""Relative standard uncertainties of the height and length scales of a calibrated profilometer."""
NAMES: dict[Surface, str] = {"design": "design", "height_map": "height map"}
READINGS = {
    (True, True): "as designed, and the light agrees with the height map",
    (True, False): (
        "as designed, but not as the height map says: is it of another part or place, or was it measured wrongly?"
    ),
    (False, True): "a shape defect: the part is not as designed, and the light agrees with its height map",
    (
        False,
        False,
    ): "neither as designed nor as the height map says: dirt or film, another plastic, or the rig",
}
"""What it means, by (agrees with the design, agrees with the height map)."""


@dataclass(frozen=True)
class Compared:
    """Comparisons of a measurement with the surfaces of a recipe.

    Attributes:
        comparisons: with one surface, or with both.
        reading: what both together mean; None of a recipe with one surface.
        readings: the four readings of a recipe with both surfaces.
        note: why the surface that does not decide could not be compared, or None.
    """

    comparisons: tuple[ComparisonRecord, ...]
    reading: str | None = None
    readings: tuple[ReadingRecord, ...] = ()
    note: str | None = None


def compare(
    recipe: SurfaceRecipe,
    expected: Expectation,
    measured: Measured,
    predict: Predict = expectation,
    known: tuple[float, int, float] | None = None,
) -> Compared:
    """Compare with both surfaces of a recipe.

    Args:
        recipe: the recipe.
        expected: the prediction from the surface that decides.
        measured: the measurement.
        predict: predicts the surface that does not decide.
        known: what `from_prediction` gives for the surface that decides, where the decision found it already.
    """
    decides = recipe.surface.decides
    mine = _one(decides, expected, measured, recipe, decides=True, known=known)
    if not recipe.surface.both:
        return Compared((mine,))
    other: Surface = "design" if decides == "height_map" else "height_map"
    try:
        second = predict(recipe.against(other), expected.convention.light_angle_deg)
        found = (mine, _one(other, second, measured, recipe, decides=False))
    except AnisoscopeError as problem:
        return Compared((mine,), note=f"no comparison with the {other.replace('_', ' ')}: {problem}")
    agrees = {one.surface: one.agrees for one in found}
    records = {one.surface: one for one in found}
    design, mapped = (expected, second) if decides == "design" else (second, expected)
    readings = (
        _measured("design", records["design"], design, measured),
        _measured("height_map", records["height_map"], mapped, measured),
        _predictions(recipe, design, mapped),
        _geometry(recipe, mapped.surface),
    )
    return Compared(found, READINGS[agrees["design"], agrees["height_map"]], readings)


def _measured(
    surface: Surface, compared: ComparisonRecord, expected: Expectation, measured: Measured
) -> ReadingRecord:
    """The measurement against one surface."""
    name = NAMES[surface]
    own = sum(
        (c.covariance() for c in (*expected.components, *measured.components)),
        np.zeros((len(expected.poses),) * 2),
    )
    numbers = _contrasts(expected, measured.radiance, expected.radiance, own)
    says = (
        f"the light {'agrees' if compared.agrees else 'does not agree'} with the {name}: {_largest(numbers)}"
    )
    return ReadingRecord(
        reading="measured-design" if surface == "design" else "measured-map",
        title=f"measured against the {name}",
        says=says,
        agrees=compared.agrees,
        d2=compared.d2,
        dof=compared.dof,
        p_value=compared.p_value,
        numbers=numbers,
    )


def _predictions(recipe: SurfaceRecipe, design: Expectation, mapped: Expectation) -> ReadingRecord:
    """The light that the map predicts against that of the design: what both share cancels in their difference."""
    covariance = difference_covariance(mapped.components, design.components)
    basis = log_basis(len(design.poses))
    off = basis @ np.log(mapped.radiance / design.radiance)
    d2, dof = mahalanobis(off, basis @ covariance @ basis.T)
    p_value = _chance(d2, dof)
    numbers = _contrasts(design, mapped.radiance, design.radiance, covariance)
    agrees = p_value >= recipe.decision.alpha
    does = "predicts" if agrees else "does not predict"
    says = f"the height map {does} the light of the design: {_largest(numbers)}"
    if not agrees and recipe.surface.roughness == "lobe":
        says += _texture_text(mapped)
    return ReadingRecord(
        reading="map-design",
        title="light of the height map against that of the design",
        says=says,
        agrees=agrees,
        d2=d2,
        dof=dof,
        p_value=p_value,
        numbers=numbers,
    )


def _texture_text(mapped: Expectation) -> str:
    """Note that the roughness of the map's texture is missing in the design, where it exceeds `TEXTURE`; else empty."""
    if mapped.surface is None:
        return ""
    shown = resolve(Relief(mapped.surface, direction_deg=mapped.turn_deg, turn_deg=mapped.turn_deg))
    if max(shown.along, shown.across) < TEXTURE:
        return ""
    return (
        f"; the map resolves a roughness of {shown.along:.3f} along and {shown.across:.3f} across the ridges that the "
        'design lacks: with surface.roughness = "plastic", [material] is the whole plastic of both'
    )


def difference_covariance(first: Sequence[Component], second: Sequence[Component]) -> FloatArray:
    """(P, P) covariance of the difference of two predictions' ln L: shared sources of one name act on both."""
    poses = len(first[0].relative)
    others = {one.source: one for one in second if one.shared}
    total = np.zeros((poses, poses))
    for one in first:
        twin = others.pop(one.source, None) if one.shared else None
        total += one.covariance() if twin is None else np.outer(*(2 * (one.relative - twin.relative,)))
    alone = [one for one in second if not one.shared] + list(others.values())
    return np.asarray(total + sum((one.covariance() for one in alone), np.zeros_like(total)))


def _geometry(recipe: SurfaceRecipe, surface: HeightMap | None) -> ReadingRecord:
    """The ridges of the map against the design: angle and pitch decide, height is for information."""
    title = "ridges of the height map against the design"
    part = recipe.surface.design
    assert part is not None
    design = recipe.surface.ridge_design()
    try:
        if surface is None:
            raise HeightMapError("the map was not read")
        ridges = measured_ridges(surface)
    except HeightMapError as problem:
        return ReadingRecord(
            reading="geometry",
            title=title,
            says=f"the ridges of the height map cannot be measured: {problem}",
            agrees=None,
            d2=None,
            dof=None,
            p_value=None,
        )
    leaning = 0.5 * np.degrees(np.sin(2.0 * np.radians(part.ridge_angle_deg)))
    more = {
        "ridge angle": np.hypot(leaning * HEIGHT_SCALE_SHARE, part.u_ridge_angle_deg),
        "pitch": recipe.surface.pitch_um * PIXEL_SIZE_SHARE,
        "height": design.height_um * HEIGHT_SCALE_SHARE,
    }
    rows = (
        ("ridge angle", "°", ridges.ridge_angle_deg, part.ridge_angle_deg),
        ("pitch", "µm", ridges.pitch_um, recipe.surface.pitch_um),
        ("height", "µm", ridges.height_um, design.height_um),
    )
    numbers = tuple(
        ReadingNumberRecord(
            name=name,
            unit=unit,
            value=found.value,
            u=float(np.hypot(found.u or 0.0, more[name])),
            expected=expected,
        )
        for name, unit, found, expected in rows
        if found.value is not None
    )
    judged = [one for one in numbers if one.name != "height"]
    d2 = float(sum(((one.value - one.expected) / one.u) ** 2 for one in judged if one.u > 0.0))
    p_value = _chance(d2, len(judged))
    agrees = p_value >= recipe.decision.alpha
    said = ", ".join(f"{one.name} {_with_u(one)} (design {one.expected:.4g}{_unit(one)})" for one in numbers)
    return ReadingRecord(
        reading="geometry",
        title=title,
        says=f"the ridges of the height map are {'' if agrees else 'not '}those of the design: {said}",
        agrees=agrees,
        d2=d2,
        dof=len(judged),
        p_value=p_value,
        numbers=numbers,
    )


@lru_cache(maxsize=4)
def measured_ridges(surface: HeightMap) -> RidgeMeasurement:
    """The ridges of a map, measured once for all parts of a recipe.

    Raises:
        HeightMapError: there are none.
    """
    from anisoscope.profiles.metrology.ridges import measure_ridges  # noqa: PLC0415 - numba when first needed

    return measure_ridges(surface)


def _contrasts(
    expected: Expectation, radiance: FloatArray, reference: FloatArray, covariance: FloatArray
) -> tuple[ReadingNumberRecord, ...]:
    """The ln ratios of consecutive poses of one tilt against those of a reference."""
    found = []
    for i, j in consecutive_pairs(expected.poses):
        one, other = expected.poses[i], expected.poses[j]
        tilt = f", tilt {one.tilt_deg:g}°" if one.tilt_deg else ""
        variance = covariance[i, i] + covariance[j, j] - 2.0 * covariance[i, j]
        found.append(
            ReadingNumberRecord(
                name=f"ln {one.stage_deg:g}° / {other.stage_deg:g}°{tilt}",
                unit="",
                value=float(np.log(radiance[i] / radiance[j])),
                u=float(np.sqrt(max(variance, 0.0))),
                expected=float(np.log(reference[i] / reference[j])),
            )
        )
    return tuple(found)


def _largest(numbers: Sequence[ReadingNumberRecord]) -> str:
    """The number that is farthest off, in words."""
    most = max(numbers, key=lambda one: abs(one.value - one.expected) / max(one.u, 1e-12))
    off = most.value - most.expected
    return f"{most.name} is {off:+.3f} off (u {most.u:.2g})".replace("-", "−")


def _unit(number: ReadingNumberRecord) -> str:
    return number.unit if number.unit in {"", "°"} else f" {number.unit}"


def _with_u(number: ReadingNumberRecord) -> str:
    return f"{number.value:.4g} ± {number.u:.2g}{_unit(number)}"


def _chance(d2: float, dof: int) -> float:
    return float(chi2_tail(d2, dof))


def _one(
    surface: Surface,
    expected: Expectation,
    measured: Measured,
    recipe: SurfaceRecipe,
    *,
    decides: bool,
    known: tuple[float, int, float] | None = None,
) -> ComparisonRecord:
    d2, dof, p_value = known or from_prediction(expected, measured)
    return ComparisonRecord(
        surface=surface,
        decides=decides,
        model=expected.model,
        predicted=tuple(float(value) for value in expected.radiance),
        d2=d2,
        dof=dof,
        p_value=p_value,
        agrees=p_value >= recipe.decision.alpha,
    )
