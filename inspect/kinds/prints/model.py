"""What a print shows in every pose: the ink model as a function of all that may differ from one print to the next.

Pranovich 2024, Eq. 5, with a lobe of any orientation: the roughness is a symmetric 2 × 2 matrix A of slopes, and for
the slopes s = (hx, hy)/hz of the half vector GGX is D = 1/(π √|A| hz⁴ (1 + sᵀA⁻¹s)²), and Beckmann's has exp(−sᵀA⁻¹s)
in place of the last bracket (Heitz 2014, Eqs. 71 and 85).
"""

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import SHORTEST_TAIL
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.ink.angles import half_vector, shift
from anisoscope.sim.light.ink.distributions import tail_of
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import brdf

_STEP = 1e-4
_FAINTEST = 600.0
"""Largest exponent of a lobe: where a wild state of a fit leads beyond it, its logarithm stays finite."""


@dataclass(frozen=True)
class State:
    """Deviation of a print from its recipe and of the rig from its file; zero where there is none.

    Attributes:
        alpha: change of ln α, alike in all directions.
        ratio: change of ln(αy/αx).
        skew: change of ln(α at 135°/α at 45°).
        tilt_x_deg, tilt_y_deg: by how much the flakes lean toward +x and +y.
        red, green, blue: change of ln of the ink's level in each colour channel.
        lobe: 0 the ink's distribution of normals, 1 the farther of GGX and Beckmann, between them the geometric mean.
        c: added to c at all wavelengths.
        shift_nm: by how much the ink's spectra lie at longer wavelengths.
        missing: share of the ink that is missing; the substrate shows instead.
        other: share of the ink that is another one (`Scene.other`).
        substrate: added to the substrate's reflectance.
        light_angle_deg: added to the angle between light and camera.
        stage_deg, arm_deg: added to every stage angle and every tilt.
        seat_x_deg, seat_y_deg: turn of the whole sheet about x and about y.
    """

    alpha: float = 0.0
    ratio: float = 0.0
    skew: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    red: float = 0.0
    green: float = 0.0
    blue: float = 0.0
    lobe: float = 0.0
    c: float = 0.0
    shift_nm: float = 0.0
    missing: float = 0.0
    other: float = 0.0
    substrate: float = 0.0
    light_angle_deg: float = 0.0
    stage_deg: float = 0.0
    arm_deg: float = 0.0
    seat_x_deg: float = 0.0
    seat_y_deg: float = 0.0


NAMES = tuple(field.name for field in fields(State))


@dataclass(frozen=True, eq=False)
class Scene:
    """One print before one rig; the state acts on the flakes, not on the base of an ink.

    Attributes:
        ink: its ink.
        coverage: share of the area that carries ink.
        substrate: diffuse reflectance below and between.
        poses: P poses.
        light_angle_deg: angle between light and camera.
        weights: (W, 3) what the colour channels see of a spectrum at the ink's wavelengths; every column adds up to 1.
        lobe: as in `State`, of the good print.
        other: another ink, that may be mixed in.
    """

    ink: Ink
    coverage: float
    substrate: float
    poses: tuple[Pose, ...]
    light_angle_deg: float
    weights: FloatArray
    lobe: float = 0.0
    other: Ink | None = None

    def channels(self, state: State | None = None) -> FloatArray:
        """(P, 3) radiance per unit of normal irradiance [1/sr] that the colour channels see.

        Raises:
            ModelError: light or camera stands below the horizon in some pose.
        """
        state = state or State()
        ink, cos_i = self._parts(state)
        balance = np.exp([state.red, state.green, state.blue])
        coverage = self.coverage * (1.0 - state.missing)
        paper = max(self.substrate + state.substrate, 0.0) / np.pi
        mixed = coverage * (ink @ self.weights) * balance + (1.0 - coverage) * paper
        return np.asarray(cos_i[:, None] * mixed)

    def spectra(self, state: State | None = None) -> FloatArray:
        """(P, W) radiance per unit of normal irradiance [1/sr] at the ink's wavelengths; colour channels unchanged."""
        state = state or State()
        ink, cos_i = self._parts(state)
        coverage = self.coverage * (1.0 - state.missing)
        paper = max(self.substrate + state.substrate, 0.0) / np.pi
        return np.asarray(cos_i[:, None] * (coverage * ink + (1.0 - coverage) * paper))

    def leaning(self, tilts_deg: FloatArray) -> FloatArray:
        """(K, P, 3) `channels` of good prints whose flakes lean by (K, 2) tilts toward +x and +y.

        Raises:
            ModelError: as for `channels`.
        """
        to_light, to_camera = directions(self.poses, Convention(self.light_angle_deg))
        half, good = half_vector(to_light, to_camera), State()
        x_deg, y_deg = np.asarray(tilts_deg).T
        leans = seating_rotation(-y_deg, x_deg)
        shares = _density(self.ink, half @ leans, good, self.lobe) / _density(self.ink, half, good, self.lobe)
        still = self._still(to_light, to_camera)
        return np.asarray(still + shares[..., None] * (self.channels() - still))

    def _still(self, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        """(P, 3) of `channels` that no flake sends: what lies below and between, and the base of the ink."""
        base = _base(self.ink, to_light, to_camera) @ self.weights
        return np.asarray(
            to_light[:, 2:] * ((1.0 - self.coverage) * self.substrate / np.pi + self.coverage * base)
        )

    def density(self, half: FloatArray) -> FloatArray:
        """D [1/sr] of the good print's flakes at (P, 3) half vectors."""
        return 4.0 * _density(self.ink, half, State(), self.lobe)

    def of_flakes(self) -> FloatArray:
        """(P,) share of the light of every pose that flakes send."""
        still = self._still(*directions(self.poses, Convention(self.light_angle_deg)))
        return np.asarray(1.0 - still.sum(axis=1) / self.channels().sum(axis=1))

    def log_channels(self, state: State | None = None) -> FloatArray:
        """(3 P,) ln of `channels`, channels fastest.

        Raises:
            ModelError: as for `channels`, or a state leaves no light in some channel.
        """
        channels = self.channels(state)
        if channels.min() <= 0.0:
            raise ModelError("more ink is missing than there is: no light is left in some channel")
        return np.asarray(np.log(channels).ravel())

    def slope(self, name: str, at: State | None = None) -> FloatArray:
        """(3 P,) derivative of ln of the channels with respect to a field of `State`, by central differences."""
        here = at or State()
        value = getattr(here, name)
        after, before = (replace(here, **{name: value + step}) for step in (_STEP, -_STEP))
        return (self.log_channels(after) - self.log_channels(before)) / (2.0 * _STEP)

    def _parts(self, state: State) -> tuple[FloatArray, FloatArray]:
        """(P, W) BRDF of the ink in 1/sr, and (P,) cosines of the light's inclination."""
        turned = state.light_angle_deg, state.stage_deg, state.arm_deg, state.seat_x_deg, state.seat_y_deg
        seen = _seen(self, *turned)
        flakes = state.alpha, state.ratio, state.skew, state.tilt_x_deg, state.tilt_y_deg
        found = np.zeros((len(self.poses), len(self.ink.wavelengths_nm)))
        for part, ink in ((1.0 - state.other, self.ink), (state.other, self.other)):
            if ink is not None and part != 0.0:
                lobe = _lobe(seen, ink, self.lobe + state.lobe, *flakes)
                found += part * lobe[:, None] * _colour(seen, ink, state.c, state.shift_nm)
                found += part * _base_of(seen, ink)
        return found, seen.to_light[:, 2]


@dataclass(frozen=True, eq=False)
class _Seen:
    """The poses of a scene, as a print that is turned sees them.

    Attributes:
        to_light, to_camera: (P, 3) unit vectors.
        half: (P, 3) half vectors.
        argument: (P,) x, which the colour of an ink depends on.
        nm: (W,) wavelengths.
    """

    to_light: FloatArray
    to_camera: FloatArray
    half: FloatArray
    argument: FloatArray
    nm: FloatArray


# Derivatives move one input at a time, and most inputs leave directions, colours or the lobe as they are: all are kept.
@lru_cache(maxsize=64)
def _seen(
    scene: Scene, light_angle_deg: float, stage_deg: float, arm_deg: float, x_deg: float, y_deg: float
) -> _Seen:
    convention = Convention(scene.light_angle_deg + light_angle_deg)
    poses = tuple(Pose(pose.stage_deg + stage_deg, pose.tilt_deg + arm_deg) for pose in scene.poses)
    to_light, to_camera = directions(poses, convention)
    if x_deg or y_deg:
        seat = seating_rotation(x_deg, y_deg)
        to_light, to_camera = to_light @ seat, to_camera @ seat
    argument = shift(to_light[:, 2], to_camera[:, 2])
    return _Seen(to_light, to_camera, half_vector(to_light, to_camera), argument, scene.ink.nm)


@lru_cache(maxsize=64)
def _base_of(seen: _Seen, ink: Ink) -> FloatArray:
    """(P, W) `_base` at the wavelengths of a scene."""
    base = _base(ink, seen.to_light, seen.to_camera)
    return np.stack([np.interp(seen.nm, ink.nm, one) for one in base])


def _base(ink: Ink, to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
    """(P, W) BRDF in 1/sr of what adds to the flakes, which do not move it."""
    dark = np.zeros((len(to_light), len(ink.wavelengths_nm)))
    return np.asarray(sum((brdf(one, to_light, to_camera) for one in ink.base), dark))


@lru_cache(maxsize=64)
def _colour(seen: _Seen, ink: Ink, more_c: float, shift_nm: float) -> FloatArray:
    """(P, W) ρ·exp(c·x), a quarter of D times this is the BRDF; c larger, and the spectra at longer wavelengths."""
    at = seen.nm - shift_nm
    rho, c = (np.interp(at, ink.nm, values) for values in (ink.rho_brdf, ink.c_values))
    return np.asarray(rho * np.exp((c + more_c) * seen.argument[:, None]))


@lru_cache(maxsize=64)
def _lobe(
    seen: _Seen, ink: Ink, lobe: float, alpha: float, ratio: float, skew: float, x_deg: float, y_deg: float
) -> FloatArray:
    """(P,) D/4 at half vectors, of the ink's lobe turned, widened and leaned."""
    leaning = seen.half @ seating_rotation(-y_deg, x_deg)
    return _density(ink, leaning, State(alpha=alpha, ratio=ratio, skew=skew), lobe)


def _density(ink: Ink, half: FloatArray, state: State, lobe: float) -> FloatArray:
    """(…) D/4 at (…, 3) half vectors as flakes that do not lean see them."""
    z, matrix = half[..., 2], roughness_matrix(ink, state)
    q = squared_slopes(half, matrix)
    tail = tail_of(ink.distribution)
    own = -(1.0 + 1.0 / tail) * np.log1p(tail * q) if tail >= SHORTEST_TAIL else -q
    other = -q if tail > 0.5 else -2.0 * np.log1p(q)
    shape = np.exp(np.clip((1.0 - lobe) * own + lobe * other, -_FAINTEST, _FAINTEST))
    return np.asarray(shape / (4.0 * np.pi * np.sqrt(np.linalg.det(matrix)) * z**4))


def squared_slopes(half: FloatArray, matrix: FloatArray) -> FloatArray:
    """(…) sᵀA⁻¹s of the slopes of (…, 3) half vectors, tan²θh/α² of an isotropic ink.

    Raises:
        ModelError: a half vector lies below the print.
    """
    if np.any(half[..., 2] <= 0.0):
        raise ModelError("a half vector lies below the print: no flake reflects there")
    slopes = half[..., :2] / half[..., 2:]
    return np.asarray(np.einsum("...i,ij,...j->...", slopes, np.linalg.inv(matrix), slopes))


def roughness_matrix(ink: Ink, state: State) -> FloatArray:
    """(2, 2) A, whose quadratic form along a direction is α² in that direction; not to be written to."""
    return _roughness((ink.alpha, ink.across, ink.brush_deg), state.alpha, state.ratio, state.skew)


@lru_cache(maxsize=64)
def _roughness(ink: tuple[float, float, float], alpha: float, ratio: float, skew: float) -> FloatArray:
    along, across, turn = *ink[:2], np.radians(ink[2])
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    nominal = axes @ np.diag([along**2, across**2]) @ axes.T
    half = 0.5 * ratio
    stretch = np.array([[alpha - half, -0.5 * skew], [-0.5 * skew, alpha + half]])
    values, vectors = np.linalg.eigh(stretch)
    factor = vectors @ np.diag(np.exp(values)) @ vectors.T
    return np.asarray(factor @ nominal @ factor)


def roughness_along(ink: Ink, state: State, azimuth_deg: float) -> float:
    """α along a direction of the print, counter-clockwise from +x."""
    turn = np.radians(azimuth_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    return float(np.sqrt(along @ roughness_matrix(ink, state) @ along))
