"""A reflectance as a function of the directions to light and camera, and what physics demands of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError

Evaluate = Callable[[FloatArray, FloatArray], FloatArray]

MOST_BYTES = 2 * 2**30
"""Largest file or table that is made."""
WATCHED_DEG = (0.0, 30.0, 60.0)
_PAIRS = 4096
_HIGHEST_DEG = 75.0
_ANISOTROPIC = 0.01


@dataclass(frozen=True, eq=False)
class Reflectance:
    """A BRDF.

    Attributes:
        name: of the surface.
        evaluate: (N, 3) unit vectors to the light and (N, 3) to the camera, z along the normal, to (N, W) values in
            1/sr; 0 where one of them is below the horizon.
        wavelengths_nm: W rising wavelengths; () where one value (W = 1) holds for all light.
        isotropic: turning the surface about its normal changes nothing.
        notes: what is neglected, one sentence each.
        costly: a pair of directions takes 0.1 ms or more: writers of fine grids sample it on a coarser one first.
        ridged: it is of ridges, whose lobes are narrower than the patches of coarse files.
    """

    name: str
    evaluate: Evaluate
    wavelengths_nm: tuple[float, ...] = ()
    isotropic: bool = False
    notes: tuple[str, ...] = ()
    costly: bool = False
    ridged: bool = False

    @property
    def channels(self) -> int:
        """W."""
        return max(1, len(self.wavelengths_nm))

    def at(self, wavelength_nm: float) -> "Reflectance":
        """One wavelength of several, interpolated linearly.

        Raises:
            UsageError: the reflectance is not known there.
        """
        known = self.wavelengths_nm
        if not known:
            return self
        if not known[0] <= wavelength_nm <= known[-1]:
            raise UsageError(
                f"{self.name}: known from {known[0]:g} to {known[-1]:g} nm, not at {wavelength_nm:g} nm"
            )
        right = min(int(np.searchsorted(known, wavelength_nm)), len(known) - 1)
        left = max(right - 1, 0)
        share = 0.0 if left == right else (wavelength_nm - known[left]) / (known[right] - known[left])

        def evaluate(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
            found = self.evaluate(to_light, to_camera)
            return (1.0 - share) * found[:, left : left + 1] + share * found[:, right : right + 1]

        return replace(self, evaluate=evaluate, wavelengths_nm=(wavelength_nm,))

    def turned(self, angle_deg: float) -> "Reflectance":
        """The surface turned counter-clockwise about its normal."""
        cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        back = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return replace(self, evaluate=lambda light, camera: self.evaluate(light @ back, camera @ back))


def above_horizon(
    to_light: FloatArray, to_camera: FloatArray, value: Callable[..., FloatArray]
) -> FloatArray:
    """(N, W) values of a function where both directions are above the horizon, 0 elsewhere.

    Args:
        to_light: (N, 3).
        to_camera: (N, 3).
        value: (M, 3), (M, 3) to (M,) or (M, W).
    """
    up = (to_light[:, 2] > 1e-6) & (to_camera[:, 2] > 1e-6)
    if not up.any():
        up[:1] = True
        some = np.asarray(value(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])))
        return np.zeros((len(to_light), 1 if some.ndim == 1 else some.shape[1]))
    some = np.asarray(value(to_light[up], to_camera[up]))
    some = some[:, None] if some.ndim == 1 else some
    found = np.zeros((len(to_light), some.shape[1]))
    found[up] = some
    return found


@dataclass(frozen=True)
class Physics:
    """How far a reflectance is from what physics demands.

    Attributes:
        albedo: directional albedos at WATCHED_DEG, the largest over the wavelengths and over light from +x and +y.
        reciprocity_rms: rms of f(i, o) − f(o, i) over the rms of f, over pairs up to 75° from the normal.
        negative_share: share of negative values.
        anisotropy: rms change of f when the surface is turned by 90°, over the rms of f.
    """

    albedo: tuple[float, ...]
    reciprocity_rms: float
    negative_share: float
    anisotropy: float

    def warnings(self) -> tuple[str, ...]:
        """Sentences about what is not physical."""
        found = []
        if max(self.albedo) > 1.0:
            at = WATCHED_DEG[int(np.argmax(self.albedo))]
            found.append(
                f"the albedo is {max(self.albedo):.3g} for light at {at:g}°: more light than fell in"
            )
        if self.reciprocity_rms > 0.01:
            found.append(
                f"not reciprocal: exchanging light and camera changes the values by {self.reciprocity_rms:.1%} rms"
            )
        if self.negative_share > 0.0:
            found.append(f"{self.negative_share:.2%} of the values are negative")
        return tuple(found)


def physics_of(reflectance: Reflectance) -> Physics:
    """Albedo, reciprocity, sign and anisotropy of a reflectance, by quadrature and on fixed pairs of directions."""
    one, other = hemisphere(_PAIRS, _HIGHEST_DEG), shuffled(hemisphere(_PAIRS, _HIGHEST_DEG, 0.5))
    forward, backward = reflectance.evaluate(one, other), reflectance.evaluate(other, one)
    scale = float(np.sqrt(np.mean(forward**2))) or 1.0
    return Physics(
        tuple(
            max(float(np.max(albedo(reflectance, deg, turn))) for turn in (0.0, 90.0)) for deg in WATCHED_DEG
        ),
        float(np.sqrt(np.mean((forward - backward) ** 2))) / scale,
        float(np.mean(forward < 0.0)),
        _anisotropy(reflectance, one, other, forward),
    )


def _anisotropy(
    reflectance: Reflectance, one: FloatArray, other: FloatArray, straight: FloatArray | None = None
) -> float:
    """Rms change by a quarter turn over the rms; ``straight`` are the values of the pairs, if they are known."""
    straight = reflectance.evaluate(one, other) if straight is None else straight
    turned = reflectance.evaluate(_quarter_turn(one), _quarter_turn(other))
    return float(np.sqrt(np.mean((straight - turned) ** 2) / (np.mean(straight**2) or 1.0)))


def must_be_isotropic(reflectance: Reflectance, what: str) -> None:
    """Refuse an anisotropic reflectance for a format that has none.

    Raises:
        UsageError: turning it changes it by more than 1 % rms.
    """
    if reflectance.isotropic:
        return
    one = hemisphere(_PAIRS, _HIGHEST_DEG)
    change = _anisotropy(reflectance, one, shuffled(hemisphere(_PAIRS, _HIGHEST_DEG, 0.5)))
    if change > _ANISOTROPIC:
        raise UsageError(
            f"{reflectance.name}: {what} holds isotropic surfaces only, and a quarter turn changes this one by "
            f"{change:.0%} rms: write an RGL .bsdf, Zemax or Klems file"
        )


def albedo(
    reflectance: Reflectance, theta_deg: float, phi_deg: float = 0.0, count: int = 16384
) -> FloatArray:
    """(W,) share of light from one direction that is sent back, by quadrature with ``count`` nodes."""
    out = hemisphere(count, 90.0)
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    light = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    value = reflectance.evaluate(np.broadcast_to(light, out.shape).copy(), out)
    return np.asarray(2.0 * np.pi * np.mean(value * out[:, 2:], axis=0))


def hemisphere(count: int, highest_deg: float, shift: float = 0.0) -> FloatArray:
    """(count, 3) unit vectors, uniform in solid angle to an angle from the normal, on a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    z = 1.0 - index / count * (1.0 - np.cos(np.radians(highest_deg)))
    turn = np.pi * (1.0 + np.sqrt(5.0)) * (index + shift)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=-1)


def shuffled(vectors: FloatArray) -> FloatArray:
    """The same (N, 3) vectors in another order, N a power of 2: together with the old order all over the hemisphere."""
    return vectors[np.arange(len(vectors)) * 1531 % len(vectors)]


def _quarter_turn(vectors: FloatArray) -> FloatArray:
    return np.stack([-vectors[:, 1], vectors[:, 0], vectors[:, 2]], axis=-1)


def refuse_huge(size: int, what: str) -> None:
    """Refuse a file that would not fit into memory.

    Raises:
        UsageError: more than MOST_BYTES.
    """
    if size > MOST_BYTES:
        raise UsageError(
            f"{what} would take {size / 2**30:.1f} GiB, at most {MOST_BYTES / 2**30:g} are written: take fewer "
            "directions or wavelengths"
        )
