"""Ridged surfaces in any direction with a known truth, made here and not by the package."""

from dataclasses import dataclass, field

import numpy as np

from anisoscope.profiles.heightmap import HeightMap


@dataclass
class Truth:
    """A ridged surface, written down in coordinates across and along its ridges."""

    pitch: float = 100.0
    angle: float = 10.0
    direction: float = 0.0
    wall: float | None = None  # wall angle in degrees; None: perpendicular to the facet
    loss: float = 0.0
    radius: float = 0.0
    slope_across: float = 0.07
    slope_along: float = 0.05
    length: float = 6.0  # geometric mean of the correlation lengths in µm
    noise: float = 0.05
    missing: float = 0.02
    burrs: int = 40
    spikes: int = 60
    tilt: tuple = (0.3, -0.2)  # degrees, along x and y
    lean: int = 1
    shape: tuple = (1000, 1000)
    pixel: tuple = (1.0, 1.0)  # y, x
    jitter_deg: float = 0.0
    made: list = field(default_factory=list)

    @property
    def wall_deg(self):
        return 90.0 - self.angle if self.wall is None else self.wall

    @property
    def full_height(self):
        theta, psi = np.radians([self.angle, self.wall_deg])
        return self.pitch / (1 / np.tan(theta) + 1 / np.tan(psi))

    @property
    def whole_loss(self):
        """What is missing at the crest, cut level or rounded, as a share of the full height."""
        if not self.radius:
            return self.loss
        theta, psi = np.radians([self.angle, self.wall_deg])
        half = 0.5 * (np.pi - theta - psi)
        # crest to vertex of an arc that touches both flanks: its centre is r/sin(half) below, on the bisector
        return self.radius * (np.cos(0.5 * (theta - psi)) / np.sin(half) - 1.0) / self.full_height

    def profile(self, r):
        """Height at r µm across, the crest (uncut) at 0, the facet falling toward +r."""
        theta, psi = np.radians([self.angle, self.wall_deg])
        p, full = self.pitch, self.full_height
        r = np.mod(r, p)
        facet = full / np.tan(theta)
        up = p - facet
        z = np.where(r < facet, full - r * np.tan(theta), full * (r - facet) / max(up, 1e-12))
        z = np.minimum(z, (1 - self.loss) * full)
        if self.radius:
            reach = self.radius / np.tan(0.5 * (np.pi - theta - psi))
            x = np.where(r > 0.5 * p, r - p, r)
            x0 = reach * np.cos(theta) - self.radius * np.sin(theta)
            z0 = full - reach * np.sin(theta) - self.radius * np.cos(theta)
            on = (x > -reach * np.cos(psi)) & (x < reach * np.cos(theta))
            z = np.where(on, z0 + np.sqrt(np.maximum(self.radius**2 - (x - x0) ** 2, 0)), z)
        return z

    def roughness(self, rng):
        """Gaussian heights with Gaussian correlation whose axes lie along and across the ridges."""
        rows, cols = self.shape
        if self.slope_across == 0.0:
            return np.zeros(self.shape)
        py, px = self.pixel
        lu = self.length * np.sqrt(self.slope_across / self.slope_along)
        lv = self.length * np.sqrt(self.slope_along / self.slope_across)
        sigma = self.slope_across * lv / np.sqrt(2)
        pad = [int(2 ** np.ceil(np.log2(n + 4 * max(lu, lv)))) if n < 400 else n + 120 for n in (rows, cols)]
        fy, fx = np.fft.fftfreq(pad[0], py)[:, None], np.fft.rfftfreq(pad[1], px)[None, :]
        a = np.radians(self.direction)
        fv, fu = fx * np.cos(a) + fy * np.sin(a), -fx * np.sin(a) + fy * np.cos(a)
        gain = np.exp(-0.5 * np.pi**2 * ((lu * fu) ** 2 + (lv * fv) ** 2))
        gain *= np.sqrt(np.pi * lu * lv / (px * py))  # of a spectral density σ²π·lu·lv·exp(−π²(l f)²)
        noise = np.fft.rfft2(rng.standard_normal(pad))
        return sigma * np.fft.irfft2(noise * gain, s=pad)[:rows, :cols]

    def surface(self, seed):
        """The surface as an instrument sees it; ``made`` lists the burrs: x, y, height, half length, half width."""
        rng = np.random.default_rng(seed)
        rows, cols = self.shape
        py, px = self.pixel
        x, y = np.arange(cols)[None, :] * px, np.arange(rows)[:, None] * py
        a = np.radians(self.direction)
        start = rng.random() * self.pitch
        r = self.lean * (x * np.cos(a) + y * np.sin(a)) - start
        v = self.lean * (-x * np.sin(a) + y * np.cos(a))
        if self.jitter_deg:
            each = rng.standard_normal(4000) * np.radians(self.jitter_deg)
            k = np.floor(r / self.pitch).astype(int)
            z = self.profile(r) - (np.mod(r, self.pitch) - 0.5 * self.pitch) * each[k + 2000] * (
                1 + np.tan(np.radians(self.angle)) ** 2
            )
        else:
            z = self.profile(r)
        z = z + self.roughness(rng)
        self.made.clear()
        for _ in range(self.burrs):
            bx, by = rng.uniform(0, cols * px), rng.uniform(0, rows * py)
            across = self.lean * (bx * np.cos(a) + by * np.sin(a)) - start
            aside = np.round(across / self.pitch) * self.pitch - across + 2.0 * rng.standard_normal()
            bx, by = bx + self.lean * aside * np.cos(a), by + self.lean * aside * np.sin(a)
            height, half = rng.uniform(3, 9), rng.uniform(5, 20)
            br, bv = (
                self.lean * (bx * np.cos(a) + by * np.sin(a)) - start,
                self.lean * (by * np.cos(a) - bx * np.sin(a)),
            )
            near = tuple(
                slice(max(0, int((at - half) / step)), max(0, int((at + half) / step) + 2))
                for at, step in ((by, py), (bx, px))
            )
            inside = 1 - ((r[near] - br) / (0.5 * half)) ** 2 - ((v[near] - bv) / half) ** 2
            z[near] += height * np.maximum(inside, 0) ** 1.5
            self.made.append((bx, by, height, half, 0.5 * half))
        z = z + self.noise * rng.standard_normal(self.shape)
        at = rng.integers(0, z.size, self.spikes)
        z.ravel()[at] += rng.choice([-1, 1], self.spikes) * rng.uniform(10, 40, self.spikes)
        z = z + np.tan(np.radians(self.tilt[0])) * x + np.tan(np.radians(self.tilt[1])) * y
        z[rng.random(self.shape) < 0.5 * self.missing] = np.nan
        hole = max(1, int(np.sqrt(0.5 * self.missing * z.size)))
        if self.missing:
            i, j = rng.integers(0, rows - hole), rng.integers(0, cols - hole)
            z[i : i + hole, j : j + hole] = np.nan
        return HeightMap(z, px, py)

    def tilt_across(self):
        """Slope of the surface across the ridges; the tilt was added by shearing."""
        a = np.radians(self.direction)
        return self.lean * (
            np.tan(np.radians(self.tilt[0])) * np.cos(a) + np.tan(np.radians(self.tilt[1])) * np.sin(a)
        )

    def wall_angle(self):
        """The angle of the wall against the tilted plane of the surface."""
        across = self.tilt_across()
        return np.degrees(np.arctan(across + np.tan(np.radians(self.wall_deg))) - np.arctan(across))

    def ridge_angle(self):
        """The angle against the tilted plane of the surface."""
        across = self.tilt_across()
        return np.degrees(np.arctan(across) - np.arctan(across - np.tan(np.radians(self.angle))))

    def _alpha(self, slope, length, direction_deg):
        """√2 times the rms difference quotient over one pixel, of a Gaussian correlation of this length."""
        a = np.radians(direction_deg)
        lag = 1 / np.hypot(np.cos(a) / self.pixel[1], np.sin(a) / self.pixel[0])
        return np.sqrt(2) * slope * length / lag * np.sqrt(-np.expm1(-((lag / length) ** 2)))

    @property
    def alpha_across(self):
        length = self.length * np.sqrt(self.slope_along / self.slope_across)
        return self._alpha(self.slope_across, length, self.direction)

    @property
    def alpha_along(self):
        length = self.length * np.sqrt(self.slope_across / self.slope_along)
        return self._alpha(self.slope_along, length, self.direction + 90)
