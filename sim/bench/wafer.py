"""An etched wafer as the bench photographs it: every source point throws its own diffraction image through the lens.

Abbe's way: a point of the lamp lights the wafer with a plane wave, the aperture of the lens lets some of the orders
pass, and what they make together in the picture is an intensity; the pictures of all points of the lamp, and of all its
wavelengths, add up. So the grain of a window as small as the lens resolves is in the picture, as in a real one. Its
mean is the blurred power spectrum (Levin et al. 2013, Eq. 6–9; the sum over the source instead of an integral).
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import AnisoscopeError, HeightMapError, RigFileError
from anisoscope.parameters.etching import PatternOptions
from anisoscope.parameters.light import LightSpectrum
from anisoscope.profiles.etching import Etched
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.bench.waferpart import WaferPart
from anisoscope.sim.light.wave.halfvectors import across_beam, half_vector
from anisoscope.sim.light.wave.orders import Orders, level_phases
from anisoscope.sim.light.wave.reflectance import radiance_scale

Image = npt.NDArray[np.float32]

LINES = 5
RINGS, SPOKES = 4, 12
"""Points of the lamp: rings of equal area, and points in each."""

POINTS_A_RESOLUTION = 2.5
"""Points of the picture in the finest period that the intensity has."""

MOST_POINTS = 2**26
"""Grid points of a tile: 2 mm at 0.25 µm."""


def etched_tile(part: WaferPart, rng: np.random.Generator) -> Etched:
    """The tile of a wafer with its errors.

    Raises:
        RigFileError: the file cannot be read, or is no surface of etched steps.
    """
    try:
        surface = _surface(part, rng)
        tile = Etched.of(surface).over_etched(1e-3 * part.over_etch_nm, part.over_etch_share)
    except AnisoscopeError as problem:
        raise RigFileError(f"sample.wafer.file: {problem}") from None
    return tile.widened(1e-3 * part.width_bias_nm)


def _surface(part: WaferPart, rng: np.random.Generator) -> HeightMap:
    """The heights of one tile of whatever file it is."""
    from anisoscope.sim.design.designfile import read_design, read_layout  # noqa: PLC0415 - of wafers only
    from anisoscope.sim.design.maskreading import read_gds  # noqa: PLC0415 - of wafers only
    from anisoscope.sim.design.pattern import make_layout  # noqa: PLC0415 - of wafers only

    kind = part.file.suffix.lower()
    if kind == ".toml":
        classes = np.zeros((part.dots, part.dots), dtype=np.int64)
        options = PatternOptions(part.dot_um, part.dots**2)
        found = make_layout(classes, (read_design(part.file),), rng, options).window()
    elif kind in (".gds", ".gdsii", ".gds2"):
        found = read_gds(part.file, grid_um=part.grid_um, passes_nm=part.passes_nm)
    elif kind == ".npz" and _is_layout(part.file):
        found = read_layout(part.file)[0].window()
    else:
        found = read_height_map(part.file)
    if found.height_um.size > MOST_POINTS:
        raise HeightMapError(
            f"a tile of {found.shape[0]} × {found.shape[1]} points is too large for the bench (at most {MOST_POINTS}): "
            "give it a window of the design (anisoscope design height --size)"
        )
    return found


def _is_layout(path: Path) -> bool:
    try:
        with np.load(path, allow_pickle=False) as file:
            return "tile_class" in file
    except (OSError, ValueError, EOFError):
        return True  # the reader of the layout reports what is wrong


class WaferSample:
    """A wafer whose pattern repeats all over it: grey, under the lamp that its table describes."""

    def __init__(self, part: WaferPart, size_mm: float, tile: Etched) -> None:
        self._part = part
        self._size_um = 1e3 * size_mm
        self._levels_um = np.array(tile.levels_um)
        self._light = LightSpectrum.led(part.wavelength_nm, part.bandwidth_nm, LINES)
        if part.bandwidth_nm == 0.0:
            self._light = LightSpectrum((1e-3 * part.wavelength_nm,))
        self._orders = Orders.of(tile)
        self._shape = tuple(self._points(length) for length in self._orders.size_um)

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Size (y, x) of a point of the picture."""
        y, x = (length / count for length, count in zip(self._orders.size_um, self._shape, strict=True))
        return y, x

    def radiance(self, to_light: FloatArray, to_camera: FloatArray) -> Image:
        """(1, rows, cols) radiance per unit irradiance perpendicular to the beam, the tile repeated."""
        part = self._part
        half = half_vector(to_light, to_camera)
        tile = np.zeros(self._shape)
        for wavelength, share in zip(self._light.wavelengths_um, self._light.weights, strict=True):
            tile += (
                share * radiance_scale(half, wavelength) * self._intensity(to_light, to_camera, wavelength)
            )
        diffuse = part.scatter / np.pi * float(to_light[2])
        tile = part.reflectance * ((1.0 - part.scatter) * tile + diffuse)
        counts = [round(self._size_um / pixel) for pixel in self.pixel_um]
        repeats = [-(-count // n) for count, n in zip(counts, self._shape, strict=True)]
        shown = np.tile(tile.astype(np.float32), repeats)[: counts[0], : counts[1]]
        return np.asarray(shown[None], dtype=np.float32)

    def _intensity(self, to_light: FloatArray, to_camera: FloatArray, wavelength_um: float) -> FloatArray:
        """(rows, cols) spectral density of every point of the tile in µm²."""
        from scipy import fft  # noqa: PLC0415 - slow to import

        half = half_vector(to_light, to_camera)
        lens = np.sin(np.radians(self._part.aperture_half_angle_deg)) / wavelength_um
        lamp = np.sin(np.radians(self._part.lamp_half_angle_deg)) / wavelength_um
        phases = level_phases(self._levels_um, wavelength_um, half.z)
        middle, wide = half.frequency(wavelength_um), 1.01 * (lens + lamp)
        waves, fx, fy = self._orders.around(middle, (wide, wide), phases)
        into_lens = np.linalg.inv(lens * across_beam(to_camera).T)
        x, y = fx[None, :] - middle[0], fy[:, None] - middle[1]
        total = np.zeros(self._shape)
        rows, cols = (np.arange(n) % m for n, m in zip(waves.shape, self._shape, strict=True))
        for at in _lamp_points() @ (lamp * across_beam(to_light)):
            u, v = (into_lens[k, 0] * (x - at[0]) + into_lens[k, 1] * (y - at[1]) for k in (0, 1))
            seen = np.zeros(self._shape, dtype=np.complex64)
            seen[np.ix_(rows, cols)] = np.where(u**2 + v**2 <= 1.0, waves, 0.0)
            total += np.abs(fft.ifft2(seen, norm="forward")) ** 2
        area = np.pi * abs(1.0 / float(np.linalg.det(into_lens)))
        return total / (RINGS * SPOKES * area)

    def _points(self, length_um: float) -> int:
        """Points along a side of the tile: enough for the intensity, and for all orders that any lamp point shows."""
        finest = (
            4.0 * np.sin(np.radians(self._part.aperture_half_angle_deg)) / (1e-3 * self._part.wavelength_nm)
        )
        lens = np.radians(self._part.aperture_half_angle_deg + self._part.lamp_half_angle_deg)
        reach = 2.2 * float(lens) / (1e-3 * (self._part.wavelength_nm - self._part.bandwidth_nm))
        return max(16, int(np.ceil(length_um * max(0.5 * POINTS_A_RESOLUTION * finest, reach))))


def _lamp_points() -> FloatArray:
    """(N, 2) points that represent equal shares of a unit disc."""
    radius = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
    turn = 2.0 * np.pi * (np.arange(SPOKES) + np.arange(RINGS)[:, None] / RINGS) / SPOKES
    points = radius[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.asarray(points.reshape(-1, 2))


def build_wafer(part: WaferPart, size_mm: float, rng: np.random.Generator) -> WaferSample:
    """The wafer of a bench.

    Raises:
        RigFileError: its file cannot be read, or is no surface of etched steps.
    """
    return WaferSample(part, size_mm, etched_tile(part, rng))
