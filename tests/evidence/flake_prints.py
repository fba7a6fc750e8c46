"""Prints of another world than the product's: coated flakes in a glossy binder on a dark sheet, before a colour camera.

Nothing here is the product's. A flake reflects by the transfer matrices of its coat (Abelès; Born and Wolf, Principles
of Optics, 1.6) from within the binder, at the angle of its own incidence; flakes lie in two lobes side by side; the
binder's surface adds its own narrow reflection, and the sheet below what it scatters. Spectra are sums at every 2 nm.
The product sees the numbers alone: radiances of a goniometer and of a rig.
"""

from dataclasses import dataclass, replace

import numpy as np

NM = np.arange(380.0, 781.0, 2.0)
LAMP = np.exp(-0.5 * ((NM - 452.0) / 11.0) ** 2) + 0.62 * np.exp(-0.5 * ((NM - 562.0) / 58.0) ** 2) + 1e-4
CAMERA = np.stack(
    [
        0.9 * np.exp(-0.5 * ((NM - 605.0) / 33.0) ** 2) + 0.03,
        np.exp(-0.5 * ((NM - 535.0) / 38.0) ** 2) + 0.04,
        0.8 * np.exp(-0.5 * ((NM - 462.0) / 27.0) ** 2) + 0.02,
    ]
)
LIGHT_ANGLE_DEG = 10.0


@dataclass(frozen=True)
class Print:
    """A print of this world.

    ``peaked`` lobes have a cusp, exponential in the slope.

    ``film_nm`` is the thickness of the coat (index 2.4), ``spread`` its relative scatter from flake to flake, ``wide``
    the share of flakes in the second lobe, ``rough`` the factor on both lobes; ``across`` widens them along y by as
    much as it narrows them along x. ``lean_deg`` is the mean tilt toward +x and +y. ``gloss`` is the slope of the
    binder's surface, ``sheet`` the reflectance below, ``cover`` the share under flakes, of which ``other`` have the
    coat ``other_nm``.
    """

    film_nm: float = 105.0
    spread: float = 0.05
    narrow_slope: float = 0.11
    wide_slope: float = 0.22
    wide: float = 0.25
    rough: float = 1.0
    across: float = 1.0
    lean_deg: tuple[float, float] = (0.0, 0.0)
    peaked: bool = False
    gloss: float = 0.25
    sheet: float = 0.015
    cover: float = 1.0
    other: float = 0.0
    other_nm: float = 150.0

    def brdf(self, to_light, to_camera):
        """(P, W) in 1/sr at (P, 3) unit vectors in the frame of the print."""
        inner_light, inner_camera = _into_binder(to_light), _into_binder(to_camera)
        half = _unit(inner_light + inner_camera)
        incidence = np.clip(np.sum(half * inner_light, axis=1), 0.0, 1.0)
        flakes = (1.0 - self.other) * _flake(self.film_nm, self.spread, incidence)
        flakes = flakes + (self.other * _flake(self.other_nm, self.spread, incidence) if self.other else 0.0)
        lobe = self._slopes(_slopes_seen(half, self.lean_deg), self.rough)
        cos = to_light[:, 2] * to_camera[:, 2]
        through = (1.0 - _fresnel(to_light[:, 2])) * (1.0 - _fresnel(to_camera[:, 2])) / BINDER**2
        inside = lobe / (4.0 * half[:, 2] ** 4 * inner_light[:, 2] * inner_camera[:, 2])
        outer = _unit(to_light + to_camera)
        surface = _gauss(_slopes_seen(outer, (0.0, 0.0)), self.gloss, 1.0) / (4.0 * outer[:, 2] ** 4 * cos)
        gloss = _fresnel(np.sum(outer * to_light, axis=1)) * surface
        below = (through * BINDER**2 * self.sheet / np.pi)[:, None]
        mix = self.cover * (through * inside)[:, None] * flakes + (1.0 - self.cover) * below
        return mix + gloss[:, None]

    def _slopes(self, slopes, rough):
        lobe = _peak if self.peaked else _gauss
        narrow = lobe(slopes, rough * self.narrow_slope, self.across)
        return (1.0 - self.wide) * narrow + self.wide * lobe(slopes, rough * self.wide_slope, self.across)

    def channels(self, poses):
        """(P, 3) radiance per unit of normal irradiance [1/sr] of a perfect white, at (stage, tilt) in degrees."""
        return self.seen(*rig(poses))

    def seen(self, to_light, to_camera):
        """The same at (P, 3) unit vectors in the frame of the print."""
        seen = CAMERA * LAMP
        return (to_light[:, 2:] * self.brdf(to_light, to_camera)) @ (seen / seen.sum(axis=1, keepdims=True)).T


BINDER, COAT, CORE = 1.5, 2.4, 1.58


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _into_binder(outside):
    """(P, 3) refracted directions, by Snell."""
    lateral = outside[:, :2] / BINDER
    return np.column_stack([lateral, np.sqrt(1.0 - np.sum(lateral**2, axis=1))])


def _fresnel(cosine):
    """Reflectance of the binder's surface for unpolarised light."""
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / BINDER**2)
    s = (cosine - BINDER * inner) / (cosine + BINDER * inner)
    p = (BINDER * cosine - inner) / (BINDER * cosine + inner)
    return 0.5 * (s**2 + p**2)


def _slopes_seen(half, lean_deg):
    slopes = half[:, :2] / half[:, 2:]
    return slopes - np.tan(np.radians(lean_deg))


def _gauss(slopes, width, across):
    stretch = np.array([1.0 / np.sqrt(across), np.sqrt(across)])
    return np.exp(-np.sum((slopes / stretch) ** 2, axis=1) / width**2) / (np.pi * width**2)


def _peak(slopes, width, across):
    stretch = width * np.array([1.0 / np.sqrt(across), np.sqrt(across)])
    return np.exp(-np.linalg.norm(slopes / stretch, axis=1)) / (2.0 * np.pi * width**2)


def _flake(film_nm, spread, incidence):
    """(P, W) reflectance of coat–core–coat from within the binder; the core is thick, so that intensities add."""
    thicknesses = film_nm * (1.0 + spread * np.array([-1.5, -0.75, 0.0, 0.75, 1.5]))
    weights = np.exp(-0.5 * np.array([-1.5, -0.75, 0.0, 0.75, 1.5]) ** 2)
    found = 0.0
    for thickness, weight in zip(thicknesses, weights / weights.sum(), strict=True):
        one = 0.5 * sum(_film(thickness, incidence, p) for p in (False, True))
        found = found + weight * 2.0 * one / (1.0 + one)  # two faces that do not interfere
    return found


def _film(thickness, incidence, p_polarised):
    """(P, W) reflectance of one coat between binder and core."""
    sine = BINDER * np.sqrt(1.0 - incidence**2)
    cos = {n: np.sqrt(1.0 - (sine / n) ** 2) for n in (BINDER, COAT, CORE)}
    admittance = {n: (n / c if p_polarised else n * c) for n, c in cos.items()}
    phase = 2.0 * np.pi * COAT * thickness * cos[COAT][:, None] / NM
    first, film, last = (admittance[n][:, None] for n in (BINDER, COAT, CORE))
    b = np.cos(phase) + 1j * np.sin(phase) * last / film
    c = 1j * film * np.sin(phase) + last * np.cos(phase)
    return np.abs((first * b - c) / (first * b + c)) ** 2


def rig(poses):
    """(P, 3) directions to light and camera in the frame of a print on a stage, the light aside by 10°."""
    to_light, to_camera = [], []
    for stage_deg, tilt_deg in poses:
        turn, tilt, aside = np.radians([stage_deg, tilt_deg, LIGHT_ANGLE_DEG])
        camera = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
        light = np.cos(aside) * camera + np.sin(aside) * np.array([1.0, 0.0, 0.0])
        back = np.array(
            [[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
        )
        to_light.append(back @ light)
        to_camera.append(back @ camera)
    return np.array(to_light), np.array(to_camera)


def goniometer(one, rng, noise=0.01):
    """Angles of light and detector, wavelengths and BRDF of an in-plane goniometer with errors of every place."""
    places = [(i, o) for i in range(0, 61, 10) for o in range(-30, 71, 5) if i > 0 or o >= 0]
    theta = np.array(places, dtype=float)
    light, detector = np.radians(theta).T
    zero = np.zeros_like(light)
    to_light = np.column_stack([-np.sin(light), zero, np.cos(light)])
    to_camera = np.column_stack([np.sin(detector), zero, np.cos(detector)])
    value = one.brdf(to_light, to_camera)[:, ::5]
    value = value * np.exp(noise * (rng.standard_normal((len(theta), 1)) + rng.standard_normal(value.shape)))
    return theta[:, 0], theta[:, 1], NM[::5], value


def good(rng, house=None):
    """A good print as they vary from one to the next."""
    z = rng.standard_normal(6)
    house = house or Print()
    return replace(
        house,
        rough=house.rough * np.exp(0.006 * z[0]),
        film_nm=house.film_nm * np.exp(0.001 * z[1]),
        across=house.across * np.exp(0.004 * z[2]),
        lean_deg=(house.lean_deg[0] + 0.05 * z[3], house.lean_deg[1] + 0.05 * z[4]),
        cover=min(1.0, house.cover * (1.0 - abs(0.004 * z[5]))),
    )


def photographed(one, poses, rng):
    """(3P,) ln of the channels, with the scatter that a rig leaves."""
    logs = np.log(one.channels(poses))
    each = 0.001 * rng.standard_normal(logs.shape)
    return (
        logs + each + 0.001 * rng.standard_normal((len(logs), 1)) + 0.003 * rng.standard_normal(3)
    ).ravel()
