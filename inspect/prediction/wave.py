"""Predictor by wave optics, with the interface of the geometric ones.

Light reflected at the surface is propagated as a wave, the Lambertian base (light scattered inside the plastic) as
rays. Radiances have the meaning and the unit of the geometric models.

Roughness below the pixels is given in the frame of a facet (`material`), the blur is one of slopes of the whole
surface. Between the slope of the facets that shine into a direction and the slope that would mirror, the two are
related by a matrix that is exact at this pair; so is the height of the lobe. On large flat facets the wave model then
gives what the geometric one gives, lobe, Fresnel and Smith's shadowing by the roughness included.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, ModelError
from anisoscope.parameters.light import LightSpectrum
from anisoscope.parameters.material import Material
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.sensitivity import Model
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.material import fresnel, smith
from anisoscope.sim.light.wave.correlation import Correlation, correlation_of, reach_um
from anisoscope.sim.light.wave.halfvectors import HalfVector, across_beam, half_vector
from anisoscope.sim.light.wave.reflectance import radiance_scale
from anisoscope.sim.light.wave.surface import WaveSurface, sampling_of
from anisoscope.sim.light.wave.windows import Extent, Window

SAME_H_Z = 1e-3
"""Relative difference of h_z up to which one correlation serves; directions are matched by their slopes."""

CELL = 0.01
"""Parts that a pixel of one height is taken in, times the width of the window in cycles: the window is off by 3e-4."""

CUT = 0.01
"""Coherence that may be left at the largest distance that a map has."""

_DESIGN_PITCHES = 8
_DESIGN_POINTS = 2**20
MOST_FACETS = 40_000
_FAINT = 30.0


@dataclass(frozen=True, eq=False)
class Lobe:
    """What unresolved roughness does in one direction.

    Attributes:
        slope_variance: (2, 2) covariance of its slopes along x and y.
        factor: what the blurred spectrum of a perfect mirror is multiplied with.
    """

    slope_variance: FloatArray
    factor: float


def facet_slopes(surface: WaveSurface, limit_um: float, *, along_y: bool = True) -> FloatArray:
    """(F, 2) slopes along x and y of a sample of the facets; jumps of more than ``limit_um`` are none."""
    rows, cols = surface.shape
    step = max(1, int(np.sqrt(rows * cols / MOST_FACETS))) if rows > 1 else max(1, cols // MOST_FACETS)
    z = surface.height_um
    low = z[: max(rows - 1, 1) : step, :-1:step].astype(np.float64)
    rise_x = z[: max(rows - 1, 1) : step, 1::step][:, : low.shape[1]] - low
    rise_y = np.zeros_like(rise_x)
    if along_y and rows > 1:
        rise_y = z[1::step, :-1:step][: low.shape[0]] - low
    smooth = (np.abs(rise_x) <= limit_um) & (np.abs(rise_y) <= limit_um)
    if not smooth.any():
        return np.zeros((1, 2))
    found = np.stack([rise_x[smooth] / surface.pixel_x_um, rise_y[smooth] / surface.pixel_y_um], axis=-1)
    return np.asarray(found, dtype=np.float64)


def lobe_of(
    half: HalfVector, to_light: FloatArray, to_camera: FloatArray, slopes: FloatArray, material: Material
) -> Lobe:
    """The lobe about the facets (F, 2) that shine most into a direction.

    Raises:
        ModelError: the roughness is not Gaussian, so that waves do not know its spectrum.
    """
    if not material.is_beckmann:
        raise ModelError(
            "the wave model knows Gaussian roughness only: take the tail and the second lobe of the material away, "
            "or predict by rays (geometric)"
        )
    target = np.array(half.slopes)
    apart = (target - slopes) / (material.alpha_across, material.alpha_along)
    spread = np.sum((apart / (1.0 + slopes @ target)[:, None]) ** 2, axis=1)
    weight = np.exp(-np.minimum(spread - spread.min(), _FAINT))
    facet = weight @ slopes / weight.sum()
    long = np.sqrt(1.0 + facet @ facet)
    normal = np.array([-facet[0], -facet[1], 1.0]) / long
    along = np.array([0.0, 1.0, facet[1]]) / np.sqrt(1.0 + facet[1] ** 2)
    across = np.cross(along, normal)
    reach = (1.0 + facet @ target) / long
    to_facet = (
        np.stack([across[:2], along[:2]]) / reach
    )  # slopes of the surface to those in the frame of the facet
    inverse = to_facet.T @ np.diag([material.alpha_across**-2.0, material.alpha_along**-2.0]) @ to_facet
    mirrored = float(fresnel(np.sqrt(np.asarray(half.square)), material.index))  # l·ĥ = |h|
    shadow = float(smith(to_light, to_camera, along, across, normal, material))
    height = (1.0 + facet @ facet) / reach**2
    return Lobe(0.5 * np.linalg.inv(inverse), mirrored * shadow * float(height))


def wave_surface(surface: HeightMap) -> WaveSurface:
    """The heights for wave optics; a map of identical rows counts as an infinitely extended profile.

    Raises:
        HeightMapError: a pixel without a height.
    """
    found = WaveSurface.of(surface)
    if np.ptp(found.height_um, axis=0).max() < 1e-6 * max(1.0, float(np.ptp(found.height_um))):
        return replace(found, height_um=found.height_um[:1], is_profile=True)
    return found


def design_surface(design: RidgeDesign, light: LightSpectrum) -> WaveSurface:
    """Profile of ideal ridges, sampled finely enough for the phase on the walls; vertical walls are jumps.

    Raises:
        ModelError: too many points would be needed.
    """
    steepest = np.tan(np.radians(design.ridge_angle_deg))
    if design.draft_rad > 0.0:
        steepest = max(steepest, 1.0 / np.tan(design.draft_rad))
    limit = 0.25 * light.shortest_um / max(float(steepest), 1e-9)
    a_pitch = int(np.ceil(design.pitch_um / min(0.8 * limit, 0.1 * light.shortest_um)))
    if a_pitch * _DESIGN_PITCHES > _DESIGN_POINTS:
        raise ModelError(
            f"waves on walls of ridges of {design.ridge_angle_deg:g}° need {a_pitch} points a pitch: take a vertical "
            "wall, a larger angle, or the geometric model"
        )
    x = np.asarray(
        (np.arange(a_pitch * _DESIGN_PITCHES) + 0.5) * (design.pitch_um / a_pitch), dtype=np.float64
    )
    return WaveSurface.of(design.profile(x), design.pitch_um / a_pitch)


def discs_of(optics: Optics) -> tuple[float, float]:
    """Diameters of lamp and lens in direction cosines.

    Raises:
        ModelError: a lamp at a finite distance, whose angle varies over the field.
    """
    if optics.lamp_distance_mm is not None and max(optics.field_mm) > 0.0:
        raise ModelError(
            "wave optics takes a lamp far away: leave the distance of the lamp out, or go geometric"
        )
    source = 2.0 * np.sin(np.radians(optics.lamp_half_angle_deg))
    aperture = 2.0 * np.sin(np.radians(optics.aperture_half_angle_deg))
    return float(source), float(aperture)


def window_of(
    to_light: FloatArray, to_camera: FloatArray, optics: Optics, slope_variance: FloatArray | None
) -> Window:
    """Lamp and lens as discs about (3,) directions, with the roughness below the pixels; errors as of `discs_of`."""
    source, aperture = discs_of(optics)
    return Window(
        Extent("disc", source, across_beam(to_light)),
        Extent("disc", aperture, across_beam(to_camera)),
        slope_variance,
    )


@dataclass(eq=False)
class WavePredictor:
    """Predictor of radiances by wave optics; caches its height correlations.

    Attributes:
        surface: the heights, at the sampling used.
        base: the geometric model; its difference with and without albedo is the Lambertian base.
        optics: lamp and lens.
        light: the wavelengths.
    """

    surface: WaveSurface
    base: Model
    optics: Optics
    light: LightSpectrum
    _slopes: FloatArray = field(init=False)
    _stored: list["_Stored"] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        limit = 0.25 * self.light.shortest_um
        self._slopes = facet_slopes(self.surface, limit, along_y=not self.surface.is_profile)

    def __call__(self, to_light: FloatArray, to_camera: FloatArray, material: Material) -> FloatArray:
        """(P,) radiances in 1/sr for (P, 3) unit vectors; the signature of every predictor.

        Raises:
            HeightMapError: the pixels are too coarse, or the map is smaller than the coherence length.
            ModelError: a direction below the horizon, or a lamp close by.
        """
        halves = [half_vector(i, o) for i, o in zip(to_light, to_camera, strict=True)]
        sampling_of(self.surface, self.light.shortest_um, max(half.z for half in halves)).check()
        mirrored = np.array(
            [self._mirrored(*one, material) for one in zip(halves, to_light, to_camera, strict=True)]
        )
        if material.albedo == 0.0:
            return mirrored
        inside = self.base(to_light, to_camera, material)
        return np.asarray(mirrored + inside - self.base(to_light, to_camera, replace(material, albedo=0.0)))

    def _mirrored(
        self, half: HalfVector, to_light: FloatArray, to_camera: FloatArray, material: Material
    ) -> float:
        lobe = lobe_of(half, to_light, to_camera, self._slopes, material)
        window = window_of(to_light, to_camera, self.optics, lobe.slope_variance)
        total = 0.0
        for wavelength, share in zip(self.light.wavelengths_um, self.light.weights, strict=True):
            stored = self._correlation(wavelength, half.z, window)
            found = stored.correlation
            # another h_z is equivalent to another wavelength at the same slopes
            matched = replace(half, x=half.x * found.h_z / half.z, y=half.y * found.h_z / half.z, z=found.h_z)
            dense = (found.extruded_density if self.surface.is_profile else found.density)(matched, window)
            dense *= (found.h_z / half.z) ** 2
            total += (
                share * radiance_scale(half, wavelength) * dense * self._cell(half, wavelength, stored.times)
            )
        return max(total * lobe.factor, 0.0)  # rounding may leave negative values where it is dark

    def _cell(self, half: HalfVector, wavelength_um: float, times: int) -> float:
        from anisoscope.sim.light.wave.fused import cell_response  # noqa: PLC0415 - numba when first needed

        return cell_response(self.surface, half, wavelength_um, times)

    def _correlation(self, wavelength_um: float, h_z: float, window: Window) -> "_Stored":
        reach = reach_um(window, wavelength_um, h_z)
        times = self._times(wavelength_um, h_z, window)
        for stored in self._stored:
            one = stored.correlation
            near = one.wavelength_um == wavelength_um and abs(one.h_z / h_z - 1.0) < SAME_H_Z
            if (
                near
                and stored.reach[0] >= reach[0]
                and stored.reach[1] >= reach[1]
                and 2 * stored.times >= times
            ):
                return stored
        self._check_size(wavelength_um, h_z, window)
        roomy = 1.3 * reach[0], 1.3 * reach[1]  # margin for other roughnesses and tilts
        found = correlation_of(self.surface, wavelength_um, h_z, roomy, endless=True)
        self._stored.append(_Stored(found.of_cells(times), roomy, times))
        return self._stored[-1]

    def _times(self, wavelength_um: float, h_z: float, window: Window) -> int:
        """Number of parts into which pixels of constant height are divided."""
        if not self.surface.cells or window.slope_variance is None:
            return 1
        rough = 2.0 * h_z / wavelength_um * np.sqrt(np.diag(window.slope_variance))
        edges = 0.5 / wavelength_um * np.hypot(window.source.reach, window.aperture.reach)
        pixels = np.array(
            [self.surface.pixel_x_um, 0.0 if self.surface.is_profile else self.surface.pixel_y_um]
        )
        return max(1, int(np.ceil(float((np.hypot(rough, edges) * pixels).max()) / CELL)))

    def _check_size(self, wavelength_um: float, h_z: float, window: Window) -> None:
        rows, cols = self.surface.shape
        high, wide = (rows - 1) * self.surface.pixel_y_um, (cols - 1) * self.surface.pixel_x_um
        part, none = np.linspace(0.8, 1.0, 17), np.zeros(1)  # sinc and Airy pass through 0
        left = [window.coherence(wide * part, none, wavelength_um, h_z)]
        if not self.surface.is_profile:
            left.append(window.coherence(none, high * part, wavelength_um, h_z))
        worst = max(float(np.abs(one).max()) for one in left)
        if worst > CUT:
            size = f"{wide:.3g}" if self.surface.is_profile else f"{wide:.3g} × {high:.3g}"
            raise HeightMapError(
                f"the heights span {size} µm, and light is still coherent over that ({worst:.0%}): waves need a larger "
                "map, a rougher plastic (--alpha-along, --alpha-across), or a lamp and a lens of some size"
            )


@dataclass(frozen=True, eq=False)
class _Stored:
    """A cached correlation, its reach along x and y, and the subdivision of pixels of constant height."""

    correlation: Correlation
    reach: tuple[float, float]
    times: int
