"""Lamp and lens of the bench: how bright it is, and the image of sample and fixture for any angle of the stage."""

import math
from collections.abc import Callable, Sequence
from itertools import cycle

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import RigFileError
from anisoscope.rig.fixture import Fixture
from anisoscope.sim.bench.benchfile import OpticsPart, SensorPart

Image = npt.NDArray[np.float32]
Place = tuple[float, float]
MIDDLE: Place = (0.0, 0.0)

_PAPER_WHITE = 0.75
_PAPER_BLACK = 0.03
_PAPER_GREYS = (0.4, 0.2, 0.58)
PLATE = 0.04
"""Reflectance of the holder's bare plate."""
_DOTS_PER_MODULE = 48


def pixel_from_mm(
    part: OpticsPart,
    sensor: SensorPart,
    angle_deg: float,
    tilt_deg: float = 0.0,
    shift_mm: Place = MIDDLE,
    centre_mm: Place = MIDDLE,
) -> FloatArray:
    """(2, 3) affine map from sample millimetres (x right, y up) to pixels (column, row), pixel centres integer.

    A camera tilted about the picture's horizontal axis sees the plate foreshortened by cos(tilt).

    Args:
        part: the optics.
        sensor: the sensor.
        angle_deg: true angle of the sample.
        tilt_deg: tilt of the camera.
        shift_mm: how far the stage, its axis included, is shifted to the right and up.
        centre_mm: place on the plate of the sample's own origin.
    """
    turn = np.radians(angle_deg)
    scale = 1000.0 / part.pixel_um
    column = (sensor.cols - 1) / 2 + part.axis_px[0]
    row = (sensor.rows - 1) / 2 + part.axis_px[1]
    cos, sin = scale * np.cos(turn), scale * np.sin(turn)
    squeeze = np.cos(np.radians(tilt_deg))
    turn_and_scale = np.array([[cos, -sin], [-squeeze * sin, -squeeze * cos]])
    moved = np.array([scale * shift_mm[0], -squeeze * scale * shift_mm[1]])
    origin = np.array([column, row]) + moved + turn_and_scale @ np.asarray(centre_mm)
    return np.column_stack([turn_and_scale, origin])


def vignette(part: OpticsPart, sensor: SensorPart) -> Image:
    """Relative illumination, 1 at the centre and 1 − vignetting at the corners."""
    y, x = np.meshgrid(np.linspace(-1, 1, sensor.rows), np.linspace(-1, 1, sensor.cols), indexing="ij")
    return (1.0 - part.vignetting * (x**2 + y**2) / 2.0).astype(np.float32)


def _blurred(image: Image, sigma_px: tuple[float, float]) -> Image:
    import cv2

    if max(sigma_px) < 1e-3:
        return image
    sigma_x, sigma_y = (max(s, 1e-3) for s in sigma_px)
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigmaX=sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REPLICATE)
    )


def image_of_surface(
    radiance: Image,
    pixel_um: tuple[float, float],
    part: OpticsPart,
    sensor: SensorPart,
    angle_deg: float,
    tilt_deg: float = 0.0,
    shift_mm: Place = MIDDLE,
    centre_mm: Place = MIDDLE,
) -> tuple[Image, Image]:
    """Image of the sample on the sensor.

    Args:
        radiance: (rows, cols) per facet, centred on the rotation axis; row index rises with +y.
        pixel_um: facet size (y, x).
        part: the optics.
        sensor: the sensor.
        angle_deg: true angle of the sample.
        tilt_deg: tilt of the camera.
        shift_mm: as for `pixel_from_mm`.
        centre_mm: likewise.

    Returns:
        The image, and the share of each pixel that the sample covers.
    """
    # lens blur, and the pixel's own width as a blur of equal variance
    import cv2

    sigma_um = np.sqrt(part.blur_um**2 + part.pixel_um**2 / 12.0)
    sigma_px = sigma_um / pixel_um[1], sigma_um / pixel_um[0]
    shown = _blurred(np.nan_to_num(radiance), sigma_px)
    known = np.isfinite(radiance)
    if not known.all():  # a facet that was not measured shines like its neighbours, or like the whole
        seen = _blurred(known.astype(np.float32), sigma_px)
        shown = np.where(seen > 1e-3, shown / np.maximum(seen, 1e-3), np.nanmean(radiance))
    rows, cols = radiance.shape
    index_to_mm = np.array(
        [
            [pixel_um[1] / 1000, 0, -(cols - 1) / 2 * pixel_um[1] / 1000],
            [0, pixel_um[0] / 1000, -(rows - 1) / 2 * pixel_um[0] / 1000],
            [0, 0, 1],
        ]
    )
    matrix = pixel_from_mm(part, sensor, angle_deg, tilt_deg, shift_mm, centre_mm) @ index_to_mm
    size = (sensor.cols, sensor.rows)
    image = cv2.warpAffine(shown, matrix, size, flags=cv2.INTER_LINEAR)
    cover = cv2.warpAffine(np.ones_like(shown), matrix, size, flags=cv2.INTER_LINEAR)
    return np.asarray(image, dtype=np.float32), np.asarray(cover, dtype=np.float32)


def image_of_fixture(
    fixture: Fixture,
    part: OpticsPart,
    sensor: SensorPart,
    angle_deg: float,
    tilt_deg: float = 0.0,
    shift_mm: Place = MIDDLE,
    centres_mm: Sequence[Place] = (MIDDLE,),
) -> Image:
    """Reflectance of the holder: a dark plate with white labels that carry the markers, about every one of some places.

    Raises:
        RigFileError: OpenCV has no such dictionary, or the dictionary no such marker.
    """
    import cv2

    if not hasattr(cv2.aruco, fixture.dictionary):
        raise RigFileError(f"fixture.dictionary: OpenCV has no dictionary '{fixture.dictionary}'")
    plate = np.full((sensor.rows, sensor.cols), PLATE, dtype=np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, fixture.dictionary))
    modules = dictionary.markerSize + 2
    dot_mm = fixture.marker_mm / modules / _DOTS_PER_MODULE
    sigma = np.sqrt(part.blur_um**2 + part.pixel_um**2 / 12.0) / (1000.0 * dot_mm)
    margin = int(4 * sigma) + 1
    views = [pixel_from_mm(part, sensor, angle_deg, tilt_deg, shift_mm, centre) for centre in centres_mm]

    def pasted(reflectance: npt.NDArray[np.float32], x_mm: float, y_mm: float) -> None:
        """Add a square print to the plate; its elements are dots."""
        import cv2

        square = _blurred(np.pad(reflectance - PLATE, margin), (sigma, sigma))
        half = (square.shape[0] - 1) / 2 * dot_mm
        dot_to_mm = np.array([[dot_mm, 0, x_mm - half], [0, -dot_mm, y_mm + half], [0, 0, 1]])
        for to_pixel in views:
            size = sensor.cols, sensor.rows
            np.add(
                plate, cv2.warpAffine(square, to_pixel @ dot_to_mm, size, flags=cv2.INTER_LINEAR), out=plate
            )

    for marker in fixture.markers:
        if marker.id >= len(dictionary.bytesList):
            raise RigFileError(f"fixture.markers: {fixture.dictionary} holds no marker {marker.id}")
        code = np.asarray(cv2.aruco.generateImageMarker(dictionary, marker.id, modules, borderBits=1))
        paper = np.pad(np.where(code > 0, _PAPER_WHITE, _PAPER_BLACK), 1, constant_values=_PAPER_WHITE)
        dots = np.kron(paper, np.ones((_DOTS_PER_MODULE, _DOTS_PER_MODULE)))
        pasted(dots.astype(np.float32), marker.x_mm, marker.y_mm)
    for patch, grey in zip(fixture.greys, cycle(_PAPER_GREYS), strict=False):
        count = round(float(patch.size_mm / dot_mm))
        pasted(np.full((count, count), grey, np.float32), patch.x_mm, patch.y_mm)
    return plate


def defocus_transfer(share: FloatArray, waves: float) -> FloatArray:
    """Optical transfer function of a perfect lens with a round pupil that is out of focus, in incoherent light.

    The overlap of two pupils, shifted by the share, weighted by the phase difference of the wavefronts in them.
    Source: Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231 (1955).

    Args:
        share: frequencies as multiples of NA/λ; the transfer ends at 2.
        waves: defocus at the edge of the pupil in wavelengths, z NA²/(2 λ).

    Returns:
        As many values, 1 at frequency 0.
    """
    share = np.asarray(share, dtype=float)
    half = 1.0 - np.minimum(share, 2.0) / 2.0
    panels = 2 + int(np.ceil(abs(waves) / 2.0))
    own, weights = np.polynomial.legendre.leggauss(16)
    nodes = ((own + 1.0) / panels + 2.0 / panels * np.arange(panels)[:, None]).ravel() - 1.0
    # x = half sin(t) takes the root at the end of the overlap out of the integrand
    turn = np.pi / 4.0 * (nodes + 1.0)
    x = half[:, None] * np.sin(turn)
    high = np.sqrt(np.maximum(1.0 - (x + share[:, None] / 2.0) ** 2, 0.0))
    phase = np.cos(4.0 * np.pi * waves * share[:, None] * x)
    overlap = phase * high * half[:, None] * np.cos(turn)
    return np.asarray(overlap @ np.tile(weights / panels, panels), dtype=float)


_TRANSFER_STEPS = 256


def defocused(image: FloatArray, part: OpticsPart, defocus_mm: float) -> Image:
    """Picture of a telecentric lens with the object out of focus; diffraction included.

    Args:
        image: (rows, cols) picture in perfect focus.
        part: aperture, wavelength, size of the pixels on the object.
        defocus_mm: distance from the plane of sharpest focus.
    """
    cutoff = 1000.0 * part.numerical_aperture / part.wavelength_nm  # of share 1, per µm
    waves = 1e6 * defocus_mm * part.numerical_aperture**2 / (2.0 * part.wavelength_nm)
    radius = 1000.0 * abs(defocus_mm) * part.numerical_aperture / part.pixel_um + 2.0 / (
        cutoff * part.pixel_um
    )
    edge = [min(int(np.ceil(radius)) + 2, size - 1) for size in image.shape]
    wide = np.pad(image, [(one, one) for one in edge], mode="reflect")
    down = np.fft.fftfreq(wide.shape[0], part.pixel_um)[:, None]
    across = np.fft.rfftfreq(wide.shape[1], part.pixel_um)[None, :]
    share = np.hypot(down, across) / cutoff
    highest = min(2.0, float(share.max()))
    known = np.linspace(0.0, highest, _TRANSFER_STEPS + int(32 * highest * abs(waves)))
    transfer = np.interp(share, known, defocus_transfer(known, waves), right=0.0)
    blurred = np.fft.irfft2(np.fft.rfft2(wide) * transfer, s=wide.shape)
    rows, cols = (slice(one, one + size) for one, size in zip(edge, image.shape, strict=True))
    return np.asarray(blurred[rows, cols], dtype=np.float32)


class Lamp:
    """A lamp that one light switches and a camera sees: it warms up, drifts and flickers from frame to frame.

    Args:
        part: drift, noise and warm-up.
        rng: noise.

    Attributes:
        attend: called before the level is read; a light that may switch itself off does it here.
    """

    def __init__(self, part: OpticsPart, rng: np.random.Generator) -> None:
        self.attend: Callable[[], None] = lambda: None
        self._part = part
        self._rng = rng
        self._level = 0.0
        self._frames_lit = 0
        self._warmth = 0.0

    @property
    def level(self) -> float:
        """Share of full brightness to which it is set, 0 … 1; 0 is off."""
        self.attend()
        return self._level

    @level.setter
    def level(self, share: float) -> None:
        self._level = min(max(share, 0.0), 1.0)

    def brightness(self) -> float:
        """Brightness during the next frame; 1 is that of a warm lamp at full level, at the begin of its drift."""
        level, part = self.level, self._part
        keeps_cold = math.exp(-1.0 / part.lamp_warmup_frames)
        if level == 0.0:
            self._warmth *= keeps_cold
            return 0.0
        lamp = 1.0 + part.lamp_noise * self._rng.standard_normal()
        lamp *= 1.0 + part.lamp_drift_per_frame * self._frames_lit
        lamp *= 1.0 + part.lamp_warmup_share * (1.0 - self._warmth)
        self._frames_lit += 1
        self._warmth = 1.0 - (1.0 - self._warmth) * keeps_cold
        return lamp * level
