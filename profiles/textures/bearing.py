"""Bearing (Abbott–Firestone) curve of a surface and the functional parameters of ISO 25178-2.

The material ratio of a height c is the share of the measured points that stand at c or above. Heights count
from the mean height of the map.
"""

from dataclasses import dataclass

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.profiles.files.checks import check_heights
from anisoscope.profiles.heightmap import HeightMap

CURVE_POINTS = 10_000
SECANT = 0.4
PEAK_RATIO, VALLEY_RATIO = 0.1, 0.8


@dataclass(frozen=True, eq=False)
class Bearing:
    """The bearing curve: ``height_um`` (n,), falling, at the material ratios ``ratio`` (n,), rising, 0 to 1."""

    ratio: FloatArray
    height_um: FloatArray

    def smr(self, height_um: float) -> float:
        """Areal material ratio Smr(c): share of the surface at or above c µm, 0 to 1."""
        if height_um > self.height_um[0]:
            return 0.0
        if height_um <= self.height_um[-1]:
            return 1.0
        return float(np.interp(-height_um, -self.height_um, self.ratio))

    def smc(self, ratio: float) -> float:
        """Inverse areal material ratio Smc(p): the height in µm above which the share p (0 to 1) stands."""
        return float(np.interp(ratio, self.ratio, self.height_um))

    def above(self, ratio: float) -> float:
        """Volume of material per area (µm³/µm²) above the height of a ratio."""
        return self._area(0.0, ratio) - ratio * self.smc(ratio)

    def below(self, ratio: float) -> float:
        """Volume of void per area (µm³/µm²) below the height of a ratio."""
        return (1.0 - ratio) * self.smc(ratio) - self._area(ratio, 1.0)

    def _area(self, start: float, stop: float) -> float:
        """Integral of the height over the ratio."""
        inner = (self.ratio > start) & (self.ratio < stop)
        ratio = np.concatenate([[start], self.ratio[inner], [stop]])
        height = np.concatenate([[self.smc(start)], self.height_um[inner], [self.smc(stop)]])
        return float(np.trapezoid(height, ratio))


@dataclass(frozen=True)
class Core:
    """Core parameters (ISO 25178-2, 4.4; ISO 13565-2): heights in µm, ratios 0 to 1.

    Attributes:
        sk_um: core height Sk.
        spk_um: reduced peak height Spk.
        svk_um: reduced dale depth Svk.
        top_um: height of the core line at the ratio 0, from the mean.
        smr1: ratio Smrk1 where the core meets the peaks.
        smr2: ratio Smrk2 where the core meets the dales.
    """

    sk_um: float
    spk_um: float
    svk_um: float
    top_um: float
    smr1: float
    smr2: float


@dataclass(frozen=True)
class Volumes:
    """Volume parameters of ISO 25178-2, 4.4, at the ratios 10 % and 80 %, in µm³/µm².

    Attributes:
        vmp_um: material volume of the peaks.
        vmc_um: material volume of the core.
        vvc_um: void volume of the core.
        vvv_um: void volume of the dales.
    """

    vmp_um: float
    vmc_um: float
    vvc_um: float
    vvv_um: float


def bearing(surface: HeightMap) -> Bearing:
    """The bearing curve of the measured points of a map, heights about their mean.

    Maps of more than 10 000 points give 10 001 ratios, ends included.

    Raises:
        HeightMapError: nothing was measured.
    """
    check_heights("height map", surface.height_um)
    height = surface.height_um[np.isfinite(surface.height_um)]
    height -= float(np.mean(height))
    height.sort()
    ratio = np.linspace(0.0, 1.0, min(height.size, CURVE_POINTS) + 1)
    # each point is a plateau of 1/n: the curve passes through its middle
    place = np.clip(ratio * height.size - 0.5, 0.0, height.size - 1.0)
    before = np.minimum(place.astype(np.intp), max(height.size - 2, 0))
    after = np.minimum(before + 1, height.size - 1)
    upper, lower = height[height.size - 1 - before], height[height.size - 1 - after]
    return Bearing(ratio, upper + (place - before) * (lower - upper))


def core(curve: Bearing) -> Core:
    """Sk, Spk, Svk and the ratios that bound the core.

    The core line is the least-squares line through the 40 % of the curve with the least slope; peaks and dales
    beyond it become triangles of equal area. Source: ISO 13565-2, 4.
    """
    ratio, height = curve.ratio, curve.height_um
    span = max(1, round(SECANT * (ratio.size - 1)))
    drop = height[:-span] - height[span:]
    first = int(np.argmin(drop))
    middle = slice(first, first + span + 1)
    x, z = ratio[middle], height[middle]
    slope = float(np.sum((x - x.mean()) * (z - z.mean())) / np.sum((x - x.mean()) ** 2))
    top = float(z.mean() - slope * x.mean())
    bottom = top + slope
    smr1, smr2 = curve.smr(top), curve.smr(bottom)
    # a height that many points share belongs to the core as a whole
    peaks = curve._area(0.0, smr1) - smr1 * top  # noqa: SLF001 - the same module
    dales = (1.0 - smr2) * bottom - curve._area(smr2, 1.0)  # noqa: SLF001
    spk = 2.0 * peaks / smr1 if smr1 > 0.0 else 0.0
    svk = 2.0 * dales / (1.0 - smr2) if smr2 < 1.0 else 0.0
    return Core(top - bottom, max(spk, 0.0), max(svk, 0.0), top, smr1, smr2)


def volumes(curve: Bearing) -> Volumes:
    """Material and void volumes at the ratios 10 % and 80 % that ISO 25178-3 names as default."""
    peaks, dales = curve.above(PEAK_RATIO), curve.below(VALLEY_RATIO)
    return Volumes(
        vmp_um=peaks,
        vmc_um=curve.above(VALLEY_RATIO) - peaks,
        vvc_um=curve.below(PEAK_RATIO) - dales,
        vvv_um=dales,
    )
