"""From the camera's channels to colours: a 3 × 3 matrix fitted on the ink's own spectra, and differences with their u.

The matrix takes what the camera sees to XYZ (Y = 1 for a perfect white). It is fitted by least squares on the spectra
that the recipe predicts for its poses and for small changes of the ink, so that it is good where it is used; broad
bells over all wavelengths, with little weight, hold it where the ink shows nothing. What is left is stated as
CIEDE2000.
"""

from dataclasses import dataclass, replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import principal, root, signed
from anisoscope.kinds.prints.model import Scene, State
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import white_point, xyz_weights
from anisoscope.sim.light.colour.spaces import ciede2000, encode, lab, linear_srgb

_CHANGES = (
    State(),
    State(shift_nm=10.0),
    State(shift_nm=-10.0),
    State(c=0.3),
    State(c=-0.3),
    State(alpha=0.1),
    State(missing=0.1),
)
_BELLS_NM = np.arange(400.0, 701.0, 25.0)
_BELL_WIDTH_NM = 40.0
_BELL_WEIGHT = 0.03
_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Eye:
    """Conversion of the camera's channels to colours as the eye sees them.

    Attributes:
        lamp: the light.
        to_xyz: (3, 3) matrix from π times the channels' radiance to XYZ.
        white: (3,) XYZ of the perfect diffuser, Y = 1.
        exposure: factor on XYZ before Lab: the brightest pose of a good print has Y = 1.
        residual: largest CIEDE2000 between the matrix and the spectra, over the poses of a good print.
        residual_changed: the same over the changed prints on which it was fitted.
    """

    lamp: str
    to_xyz: FloatArray
    white: FloatArray
    exposure: float
    residual: float
    residual_changed: float

    def xyz(self, channels: FloatArray) -> FloatArray:
        """(…, 3) XYZ of (…, 3) channels in 1/sr."""
        return np.asarray(np.pi * np.asarray(channels) @ self.to_xyz.T)

    def lab(self, channels: FloatArray) -> FloatArray:
        """(…, 3) CIELAB of (…, 3) channels in 1/sr at the exposure."""
        return lab(self.exposure * self.xyz(channels), self.white)

    def srgb(self, channels: FloatArray) -> FloatArray:
        """(…, 3) encoded sRGB of (…, 3) channels at the exposure, clipped to the gamut."""
        return encode(linear_srgb(self.exposure * self.xyz(channels))).srgb

    def uv(self, channels: FloatArray) -> FloatArray:
        """(…, 2) u′v′ (CIE 1976) of (…, 3) channels."""
        x, y, z = np.moveaxis(self.xyz(channels), -1, 0)
        total = x + 15.0 * y + 3.0 * z
        return np.stack([4.0 * x / total, 9.0 * y / total], axis=-1)

    def difference(self, measured: FloatArray, reference: FloatArray) -> FloatArray:
        """(…) CIEDE2000 between (…, 3) channels."""
        return ciede2000(self.lab(reference), self.lab(measured))

    def metric(self, channels: FloatArray) -> FloatArray:
        """(P, 3, 3) G with ΔE² = dᵀ G d for small changes d of ln of (P, 3) channels.

        CIEDE2000 is a distance for small differences: G comes from ΔE of single and paired steps.
        """
        count = len(channels)
        units = np.eye(3)
        steps = np.stack([*units, units[0] + units[1], units[0] + units[2], units[1] + units[2]])
        changed = channels[:, None, :] * np.exp(_STEP * steps)
        base = np.broadcast_to(channels[:, None, :], changed.shape)
        squares = (self.difference(changed, base) / _STEP) ** 2
        found = np.zeros((count, 3, 3))
        for k in range(3):
            found[:, k, k] = squares[:, k]
        for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)), start=3):
            cross = 0.5 * (squares[:, row] - squares[:, i] - squares[:, j])
            found[:, i, j] = found[:, j, i] = cross
        return found


def eye_of(scene: Scene, lamp: Illuminant) -> Eye:
    """Fit the matrix for a print.

    Args:
        scene: the good print.
        lamp: its light.

    Raises:
        ModelError: the ink's wavelengths give no colour.
    """
    weights = xyz_weights(lamp, scene.ink.nm)
    spectra = [np.pi * scene.spectra(state) for state in _CHANGES]
    bells = np.exp(-0.5 * ((scene.ink.nm - _BELLS_NM[:, None]) / _BELL_WIDTH_NM) ** 2)
    measured = np.concatenate([*spectra, bells, np.ones((1, len(scene.ink.nm)))])
    scale = np.concatenate([np.full(sum(map(len, spectra)), 1.0), np.full(len(bells) + 1, _BELL_WEIGHT)])
    rgb, xyz = measured @ scene.weights, measured @ weights
    scale = scale / xyz[:, 1]
    fitted = np.linalg.lstsq(rgb * scale[:, None], xyz * scale[:, None], rcond=None)[0]
    matrix = np.asarray(fitted.T, dtype=np.float64)
    white = white_point(lamp)
    exposure = 1.0 / float((spectra[0] @ weights)[:, 1].max())
    eye = Eye(lamp.name, matrix, white, exposure, 0.0, 0.0)
    left = [
        float(ciede2000(lab(exposure * one @ weights, white), eye.lab(one @ scene.weights / np.pi)).max())
        for one in spectra
    ]
    return replace(eye, residual=left[0], residual_changed=max(left))


def worst_direction(covariance: FloatArray, metric: FloatArray) -> FloatArray:
    """(3,) standard uncertainty of ln of three channels along the direction in which ΔE is least certain.

    Args:
        covariance: (3, 3) of ln of the channels.
        metric: (3, 3) G of `Eye.metric`.
    """
    half = root(covariance)
    return signed(half @ principal(half @ metric @ half)[1][-1])
