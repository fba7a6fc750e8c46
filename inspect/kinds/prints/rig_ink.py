"""Ink of a good print that a rig photographed: roughness and form of its lobe, and the spectrum between its channels.

A rig sees three colours and hardly any change with the angle of the light. Between the channels an ink of coated flakes
reflects as one film does, A + B sin²δ/(1 + F sin²δ) with δ = 2π n d/λ (Airy; Born and Wolf, Principles of Optics, 7.6),
which three channels determine; a smooth factor takes what is left. The same film says how the colour changes: where
light and eye move from the normal, n d becomes n d cos θ of the refracted light, so that c = −∂ln ρ/∂ln(n d)/n².

Bright poses decide, because the mirror direction is the brightest: where the lobe has another form, its flank would
else be described at the cost of its middle. What is left of the channels is the misfit of the ink, by half angle.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import MeasurementError, UsageError
from anisoscope.ink.fitting import SCATTER, RigInk, left_by_angle
from anisoscope.kinds.prints.lighting import lamp_and_sensitivities
from anisoscope.kinds.prints.model import Scene, State, roughness_matrix
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.reference_prints import GoldenPrints
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import LONGEST_TAIL
from anisoscope.record.schema import Record
from anisoscope.rig.rigfile import RigFile
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.light.ink.ink import Ink, InkUncertainty

LEAST_POSES = 21
NM = np.arange(380.0, 781.0, 10.0)
COAT_INDEX, BINDER_INDEX = 2.4, 1.5
"""Refractive indices of titania on mica, at 550 nm, and of what lies about the flakes."""
PATHS_NM = np.arange(100.0, 501.0, 1.0)
"""n·d of the films that are tried: the first two orders and a half."""
_PER_CENT, _THIN_NM = 0.01, 400.0
"""Misfit of a film that counts as much as an n·d of 400 nm: of two films that fit, the thinner is likelier."""
_READING, _DIM = 0.003, 0.03
"""Relative u of the brightest channel, and what grows with the square of how much darker another pose is."""
_ROUNDS = 3
_STARTS = (0.1, 0.3)
_SHORTEST = 0.01
_UNSEEN_C = 0.5
"""Relative u of c, which follows from the film and is not seen."""
_BRUSHED = 0.02
_NAMES = ("ratio", "skew", "tilt_x_deg", "tilt_y_deg", "red", "green", "blue")
_LEVELS = slice(6, 9)


def ink_of_inspections(inspections: Sequence[tuple[str, Record, PrintRecipe, RigFile]], name: str) -> RigInk:
    """Fit an ink to inspections of good prints; arguments and errors as of `kinds.parts.Inked`."""
    rows, first = [], None
    for folder, record, recipe, rig in inspections:
        rows.append(GoldenPrints.row_of(record, recipe).log_channels)
        part, seen = recipe.print, Vision(*lamp_and_sensitivities(rig))
        alike = (recipe.poses.poses(), part.coverage, part.substrate, rig.light.angle_deg, seen)
        first = first or alike
        if alike != first:
            raise UsageError(
                f"{folder}: poses, coverage, lamp or camera differ from those of {inspections[0][0]}: give prints "
                "photographed alike"
            )
    assert first is not None
    poses, coverage, substrate, light_angle_deg, vision = first
    scene = Scene(
        inspections[0][2].print.read_ink(), coverage, substrate, poses, light_angle_deg, vision.weights(NM)
    )
    source = f"{len(poses)} poses of {len(rows)} good prints on a rig"
    return ink_of_channels(scene, vision, np.mean(rows, axis=0), name, source)


def ink_of_channels(
    scene: Scene, vision: Vision, log_channels: FloatArray, name: str, source: str = ""
) -> RigInk:
    """Fit an ink to the channels of a good print.

    Args:
        scene: poses, coverage and substrate; its ink does not count.
        vision: camera under the lamp.
        log_channels: (P, 3) ln of red, green and blue in 1/sr.
        name: of the ink.
        source: of the ink.

    Raises:
        UsageError: fewer than `LEAST_POSES` poses.
        MeasurementError: the width of the lobe is not determined.
    """
    if len(scene.poses) < LEAST_POSES:
        raise UsageError(
            f"{len(scene.poses)} poses do not tell the form of a lobe: inspect the print at {LEAST_POSES} or more, "
            "such as those of `anisoscope recipe new --ink`"
        )
    from scipy.optimize import least_squares  # noqa: PLC0415 - start-up time

    logs, weights = np.asarray(log_channels, dtype=np.float64), vision.weights(NM)
    share = np.exp(logs.max(axis=0) - logs)
    u = np.hypot(_READING, _DIM * (share**2 - 1.0)).ravel()
    film_nm, ink = _film_ink(weights, np.exp(logs.max(axis=0)), name, source)

    def made(values: FloatArray) -> tuple[Scene, State]:
        alpha, tail = float(np.exp(values[0])), float(np.exp(values[1]))
        shown = replace(scene, ink=replace(ink, alpha=alpha, distribution=tail), weights=weights, lobe=0.0)
        return shown, State(**dict(zip(_NAMES, values[2:].tolist(), strict=True)))

    def off(values: FloatArray) -> FloatArray:
        shown, state = made(values)
        return np.asarray((logs.ravel() - shown.log_channels(state)) / u)

    ends = np.array([[0.01, _SHORTEST], [1.0, LONGEST_TAIL]])
    bounds = np.array([np.full(9, -np.inf), np.full(9, np.inf)])
    bounds[:, :2] = np.log(ends)
    found = None
    for turn in range(_ROUNDS):
        starts = (
            [found.x]
            if found is not None
            else [np.r_[np.log([alpha, 0.5]), np.zeros(7)] for alpha in _STARTS]
        )
        tries = [
            least_squares(off, one, bounds=tuple(bounds), x_scale=0.1, xtol=1e-6, ftol=1e-6) for one in starts
        ]
        found = min(tries, key=lambda one: one.cost)
        if turn + 1 < _ROUNDS:
            level = (ink.rho_brdf @ weights) * np.exp(found.x[_LEVELS])
            film_nm, ink = _film_ink(weights, level, name, source)
            found.x[_LEVELS] = 0.0
    assert found is not None
    shown, state = made(found.x)
    # what the last round found of the levels is below a thousandth: the spectrum follows it
    level = (ink.rho_brdf @ weights) * np.exp(found.x[_LEVELS])
    film_nm, ink = _film_ink(weights, level, name, source)
    residual = (u * found.fun).reshape(-1, 3)
    slopes = np.asarray(found.jac, dtype=np.float64)
    inverse = np.linalg.inv(slopes.T @ slopes) * max(1.0, 2.0 * found.cost / (logs.size - 9))
    u_found = np.sqrt(np.diag(inverse))
    if not u_found[0] < 0.5:
        raise MeasurementError(
            "the channels do not tell how wide the lobe is: is the print a good one, does it lie flat, and do the "
            "tilts reach down its flank?"
        )
    half = half_vector(*directions(scene.poses, Convention(scene.light_angle_deg)))
    flakes = half @ seating_rotation(-state.tilt_y_deg, state.tilt_x_deg)
    half_deg = np.degrees(np.arccos(np.clip(flakes[:, 2], -1.0, 1.0)))
    known = _uncertainty(u_found, ink, half_deg, residual[:, ::-1])
    lobe = _brushed(shown.ink, state)
    return RigInk(
        replace(
            ink,
            alpha=lobe[0],
            alpha_y=lobe[1],
            brush_deg=lobe[2],
            distribution=float(f"{shown.ink.distribution:.3g}"),
            uncertainty=known,
        ),
        film_nm,
        (state.tilt_x_deg, state.tilt_y_deg),
        len(scene.poses),
        float(np.sqrt(np.mean(residual**2))),
        float(np.sqrt(np.mean(residual[half_deg < half_deg.min() + 1.0] ** 2))),
    )


def _film_ink(weights: FloatArray, level: FloatArray, name: str, source: str) -> tuple[float, Ink]:
    """n·d in nm and the ink of the film whose spectrum the channels, (3,), are those of."""
    phase = 2.0 * np.pi * PATHS_NM[:, None] / NM
    face = ((COAT_INDEX - BINDER_INDEX) / (COAT_INDEX + BINDER_INDEX)) ** 2
    finesse, wave = 4.0 * face / (1.0 - face) ** 2, np.sin(phase) ** 2
    beams = np.stack([np.ones_like(wave), wave / (1.0 + finesse * wave)], axis=-1)  # (K, W, 2)
    seen = np.einsum("kwb,wc->kcb", beams, weights) / level[:, None]
    inverse = np.linalg.pinv(seen)
    shares = np.maximum(inverse.sum(axis=-1), 1e-4 * level.max())
    left = np.sum((np.einsum("kcb,kb->kc", seen, shares) - 1.0) ** 2, axis=1)
    best = int(np.argmin(left / _PER_CENT**2 + (PATHS_NM / _THIN_NM) ** 2))
    rho, turn = beams[best] @ shares[best], phase[best] * np.sin(2.0 * phase[best])
    c = -shares[best, 1] * turn / (1.0 + finesse * wave[best]) ** 2 / rho / COAT_INDEX**2
    # the channels exactly, by a factor that is smooth
    base, factor = np.vander((NM - 560.0) / 180.0, 3), np.zeros(3)
    for _ in range(20):
        shown = rho * np.exp(base @ factor)
        factor += np.linalg.solve((weights.T * shown) @ base, level - shown @ weights)
    rho = rho * np.exp(base @ factor)
    return float(PATHS_NM[best]), Ink(
        name, 0.2, tuple(NM.tolist()), tuple(rho.tolist()), tuple(c.tolist()), "brdf", source
    )


def _uncertainty(u: FloatArray, ink: Ink, half_deg: FloatArray, residual: FloatArray) -> InkUncertainty:
    level = float(np.sqrt(np.mean(u[_LEVELS] ** 2)))
    own = (u[0], level, level, _UNSEEN_C * float(np.sqrt(np.mean(ink.c_values**2))), u[1])
    alpha, rho, colour, c, lobe = (float(f"{min(one, 1.0):.2g}") for one in np.hypot(own, SCATTER))
    return InkUncertainty(alpha, rho, colour, c, lobe, *left_by_angle(half_deg, residual))


def _brushed(ink: Ink, state: State) -> tuple[float, float | None, float]:
    """α, α across and the direction of the brushing; the last two only where the lobe is clearly anisotropic."""
    squares, axes = np.linalg.eigh(roughness_matrix(ink, state))
    along, across = np.sqrt(squares)
    if np.log(across / along) < _BRUSHED:
        return float(f"{ink.alpha:.5g}"), None, 0.0
    turn = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))) % 180.0
    return float(f"{along:.5g}"), float(f"{across:.5g}"), round(turn, 1)
