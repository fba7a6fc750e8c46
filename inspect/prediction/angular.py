"""Angular reflectance of a height map by wave optics: the BRDF over all directions of the camera, one light.

The surface reflects all light (metal, or a metallised copy). Scalar waves, no shadows; Levin et al. 2013, Eq. 2, 5, 8.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT, in_json
from anisoscope.base.progress import Advance, silent
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import xyz_weights
from anisoscope.sim.light.colour.spaces import encode, linear_srgb
from anisoscope.sim.light.wave.correlation import DensityLadder
from anisoscope.sim.light.wave.surface import WaveSurface, on_plateaus, sampling_of
from anisoscope.sim.light.wave.windows import Extent, Window

POINTS = 161
REACH = 0.4
MOST_POINTS = 1001
COLOUR_NM = tuple(float(nm) for nm in range(400, 701, 20))


@dataclass(frozen=True)
class AngularTask:
    """Directions and light of a map.

    Attributes:
        wavelengths_nm: one value of the BRDF for each.
        light_deg: inclination and azimuth (from +x toward +y) of the light.
        reach: largest |v_x| and |v_y|, direction cosines of the camera.
        points: directions along each axis.
        lamp_half_angle_deg: half of the angle that the lamp subtends.
        aperture_half_angle_deg: half of the angle of the lens; 0: every point is the mean over its own square.
        slope_rms: (x, y) rms slopes that the map does not show.
        lamp_sigma_deg: standard deviation of a Gaussian lamp, in place of the disc; its direction cosine counts.

    Raises:
        ModelError: directions or a light that are none.
    """

    wavelengths_nm: tuple[float, ...] = (550.0,)
    light_deg: tuple[float, float] = (0.0, 0.0)
    reach: float = REACH
    points: int = POINTS
    lamp_half_angle_deg: float = 0.0
    aperture_half_angle_deg: float = 0.0
    slope_rms: tuple[float, float] = (0.0, 0.0)
    lamp_sigma_deg: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.light_deg[0] < 80.0:
            raise ModelError(f"the light of an angular map stands at 0 to 80°, not at {self.light_deg[0]:g}°")
        if self.lamp_sigma_deg > 0.0 and self.lamp_half_angle_deg > 0.0:
            raise ModelError(
                "a lamp is a Gaussian or a disc: leave the half angle or the standard deviation out"
            )
        if not 0.0 <= self.lamp_sigma_deg <= 10.0:
            raise ModelError(
                f"a Gaussian lamp has a standard deviation of 0 to 10°, not {self.lamp_sigma_deg:g}°"
            )
        if not 0.0 < self.reach <= 0.95:
            raise ModelError(
                f"the directions of an angular map reach above 0 and up to 0.95, not {self.reach:g}"
            )
        if not 11 <= self.points <= MOST_POINTS:
            raise ModelError(
                f"an angular map has 11 to {MOST_POINTS} directions along an axis, not {self.points}"
            )
        if not self.wavelengths_nm or not all(100.0 <= one <= 20000.0 for one in self.wavelengths_nm):
            raise ModelError("an angular map needs wavelengths of 100 to 20000 nm")

    @property
    def to_light(self) -> FloatArray:
        """(3,) unit vector."""
        theta, phi = np.radians(self.light_deg)
        return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])

    def window(self) -> Window:
        """Source, lens or the square of a direction, and slopes below the pixels."""
        lamp = 2.0 * float(np.sin(np.radians(self.lamp_half_angle_deg)))
        lens = 2.0 * float(np.sin(np.radians(self.aperture_half_angle_deg)))
        square = Extent("rect", 2.0 * self.reach / (self.points - 1))
        slopes = None if not any(self.slope_rms) else np.diag(np.square(self.slope_rms))
        source = Extent("disc", lamp)
        if self.lamp_sigma_deg > 0.0:
            source = Extent("gauss", float(np.sin(np.radians(self.lamp_sigma_deg))))
        return Window(source, Extent("disc", lens) if lens > 0.0 else square, slopes)


@dataclass(frozen=True, eq=False)
class AngularReflectance:
    """The BRDF of a height map over directions of the camera.

    Attributes:
        task: what was asked for.
        stepped: whether the map is one of plateaus.
        v: (V,) direction cosines of the camera along x, and along y.
        brdf: (W, V, V) in 1/sr, rows along rising v_y; NaN below the horizon.
    """

    task: AngularTask
    stepped: bool
    v: FloatArray = field(metadata=LEFT_OUT)
    brdf: npt.NDArray[np.float64] = field(metadata=LEFT_OUT)

    @property
    @in_json()
    def light_in_map(self) -> list[float]:
        """Share of the light that goes into the directions of the map, for each wavelength."""
        cell = float(self.v[1] - self.v[0]) ** 2  # ∫ f cosθ dω = ∫ f dv_x dv_y
        return [float(np.nansum(one) * cell) for one in self.brdf]

    @property
    @in_json()
    def peak_per_sr(self) -> list[float]:
        """Largest BRDF, for each wavelength."""
        return [float(np.nanmax(one)) for one in self.brdf]

    @property
    @in_json()
    def peak_at(self) -> list[list[float]]:
        """(v_x, v_y) of the largest BRDF, for each wavelength."""
        found = []
        for one in self.brdf:
            row, col = np.unravel_index(int(np.nanargmax(one)), one.shape)
            found.append([float(self.v[col]), float(self.v[row])])
        return found

    def srgb(self, illuminant: Illuminant | None, quantile: float = 0.997) -> FloatArray:
        """(V, V, 3) encoded sRGB, first row at the top, the quantile of the luminance as white; grey without a lamp."""
        known = np.isfinite(self.brdf[0])
        values = np.nan_to_num(self.brdf)
        if illuminant is None:
            grey = values.mean(axis=0)
            linear = np.repeat((grey / _white(grey[known], quantile))[..., None], 3, axis=-1)
        else:
            xyz = np.moveaxis(values, 0, -1) @ xyz_weights(illuminant, np.array(self.task.wavelengths_nm))
            linear = linear_srgb(xyz / _white(xyz[known][:, 1], quantile))
        return encode(np.clip(linear[::-1], 0.0, None)).srgb

    def rows(self) -> Sequence[tuple[float, ...]]:
        """Rows (v_x, v_y, inclination and azimuth in degrees, wavelength in nm, BRDF in 1/sr) above the horizon."""
        y, x = np.meshgrid(self.v, self.v, indexing="ij")
        known = np.isfinite(self.brdf[0])
        theta = np.degrees(np.arcsin(np.hypot(x, y)[known]))
        phi = np.degrees(np.arctan2(y[known], x[known]))
        return [
            row
            for nm, one in zip(self.task.wavelengths_nm, self.brdf, strict=True)
            for row in zip(
                x[known].tolist(), y[known].tolist(), theta.tolist(), phi.tolist(), [nm] * theta.size,
                one[known].tolist(), strict=True,
            )
        ]  # fmt: skip


def _white(values: FloatArray, quantile: float) -> float:
    return max(float(np.quantile(values, quantile)), 1e-12)


def angular_reflectance(
    surface: HeightMap,
    task: AngularTask,
    *,
    steps: int | None = None,
    interpolate: int = 1,
    periodic: bool = False,
    advance: Advance = silent,
) -> AngularReflectance:
    """BRDF of a height map over the directions of the camera, for one direction of the light.

    Args:
        surface: the heights.
        task: directions, light and wavelengths.
        steps: number of plateaus, whose heights hold for whole pixels; they are found where it is not given.
        interpolate: points per original point along each axis, by cubic splines of smooth heights.
        periodic: the map is one unit of a surface that repeats.
        advance: receives the progress.

    Raises:
        HeightMapError: a pixel without a height, or pixels too coarse for the phase.
        ModelError: more memory or more maps than are taken; the message says how much.
    """
    shortest = 1e-3 * min(task.wavelengths_nm)
    heights = on_plateaus(WaveSurface.of(surface), shortest, steps).interpolated(interpolate)
    v = np.linspace(-task.reach, task.reach, task.points)
    y, x = np.meshgrid(v, v, indexing="ij")
    inside = np.hypot(x, y) < 0.999
    v_z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 1e-6))
    light = task.to_light
    h_x, h_y, h_z = 0.5 * (x + light[0]), 0.5 * (y + light[1]), 0.5 * (v_z + light[2])
    # γ of Eq. 23: (1 + ⟨l, v⟩)/(v_z + l_z)/λ, with 1 + ⟨l, v⟩ = 2·|h|²
    square = h_x**2 + h_y**2 + h_z**2
    found = np.full((len(task.wavelengths_nm), *x.shape), np.nan)
    for number, nm in enumerate(task.wavelengths_nm):
        advance(f"{nm:g} nm", number, len(task.wavelengths_nm))
        um = 1e-3 * nm
        sampling_of(heights, um, float(h_z[inside].max())).check()
        ladder = DensityLadder(
            heights,
            um,
            task.window(),
            (float(h_z[inside].min()), float(h_z[inside].max())),
            periodic=periodic,
        )
        density = ladder.at(h_x[inside], h_y[inside], h_z[inside])
        gamma = square[inside] / h_z[inside] / um
        found[number][inside] = np.maximum(density, 0.0) * gamma**2 / (v_z[inside] * light[2])
    return AngularReflectance(task, heights.cells, v, found)
