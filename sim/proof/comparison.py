"""Comparison of models with pictures from readings, as in Table 1 of Pranovich 2024.

A sphere under two lights is shown by each model and from the readings. Colour space: sRGB, encoded and clipped, all
pictures with one exposure, at which 99.5 % of the sphere made from readings stay below full scale. Mask: the pixels of
the sphere that a light reaches at directions that were read (`measured_picture`). RMSE is over the three channels
there; SSIM (Wang et al. 2004) has its Gaussian window of 11 × 11 pixels, σ = 1.5 pixels, data range 1, and is averaged
over channels and mask.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.sim.light.colour.illuminant import Illuminant, standard
from anisoscope.sim.light.colour.spaces import encode
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import MODELS, Model
from anisoscope.sim.light.ink.shading import Light, picture
from anisoscope.sim.proof.measured import Measured, measured_picture
from anisoscope.sim.proof.render import direction
from anisoscope.sim.proof.scene import Scene, surface

BoolArray = npt.NDArray[np.bool_]

SIZE = 512
STAYS_BELOW = 0.995
CONVENTION = (
    "encoded and clipped sRGB, one exposure for all pictures (99.5 % of the measured sphere below full scale); "
    "mask: lit pixels of the sphere within a step of the readings; SSIM: Gaussian window 11 × 11, σ 1.5 px, data range "
    "1, mean over channels and mask"
)


@dataclass(frozen=True, eq=False)
class Row:
    """One model against the readings.

    Attributes:
        model: of the BRDF.
        rmse: root mean square difference, 0 to 1.
        ssim: structural similarity, at most 1.
        frame_s: time of a frame on this machine's processor, the fastest of several; NaN where it was not taken.
        srgb: (rows, cols, 3) the picture, encoded.
    """

    model: Model = field(metadata=LEFT_OUT)
    rmse: float
    ssim: float
    frame_s: float = field(metadata=json_field("frame_ms", by=lambda seconds: 1e3 * seconds))
    srgb: FloatArray = field(metadata=LEFT_OUT)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Models against one measured ink.

    Attributes:
        ink: the parameters that the models were given.
        rows: a row a model.
        reference: (rows, cols, 3) the picture from readings, encoded.
        mask: (rows, cols) what was compared.
        measured_share: of the lit sphere that was compared; the rest lies beyond the readings.
        exposure: factor on linear light before encoding.
    """

    ink: Ink = field(metadata=json_field(by=lambda ink: {"ink": ink.name, "alpha": ink.alpha}, merged=True))
    rows: tuple[Row, ...] = field(
        metadata=json_field("models", by=lambda rows: {row.model: row for row in rows})
    )
    reference: FloatArray = field(metadata=LEFT_OUT)
    mask: BoolArray = field(metadata=LEFT_OUT)
    measured_share: float
    exposure: float


def two_lights(illuminant: Illuminant) -> tuple[Light, Light]:
    """Two directional lights, as in Fig. 5 of the paper: from the upper left, and from the right, half as bright.

    The paper does not give their directions; these are ours.
    """
    first, second = direction(135.0, 45.0), direction(-15.0, 35.0)
    return Light(first, np.pi, illuminant), Light(second, 0.5 * np.pi, illuminant)


def compare(
    measured: Measured,
    ink: Ink,
    *,
    illuminant: Illuminant | None = None,
    models: Sequence[Model] = MODELS,
    size: int = SIZE,
    repeats: int = 5,
) -> Comparison:
    """Show a sphere by models and from readings, and measure how far they are apart.

    Args:
        measured: the readings.
        ink: fitted to them.
        illuminant: of both lights; D65 where none is given.
        models: to compare.
        size: side of the pictures in pixels, 32 or more.
        repeats: frames to take the time of; 0 takes none.

    Raises:
        ModelError: a size below 32, readings that show nothing, or as `picture`.
    """
    if size < 32:
        raise ModelError(f"pictures to compare need 32 pixels a side, not {size}")
    lights = two_lights(illuminant or standard("d65"))
    where = surface(Scene("sphere"), size, size)
    linear, known = measured_picture(where, measured, lights)
    facing = np.stack([where.normal @ np.array(light.to_light, dtype=np.float32) for light in lights])
    lit = np.any(facing > 0.0, axis=0) & (where.normal[..., 2] > 0.0)
    mask = lit & known
    if not mask.any():
        raise ModelError(
            "no pixel of the sphere lies within the readings: read at more angles of light and detector"
        )
    brightest = float(np.quantile(linear[mask].max(axis=-1), STAYS_BELOW))
    if brightest <= 0.0:
        raise ModelError("the readings show no light: is their scale right?")
    exposure = 1.0 / brightest
    reference = encode(exposure * linear).srgb
    rows = []
    for model in models:
        rendered = encode(exposure * picture(where, [ink], lights, model=model).astype(np.float64)).srgb
        timings = [
            _timed(lambda model=model: picture(where, [ink], lights, model=model)) for _ in range(repeats)
        ]
        rows.append(
            Row(
                model,
                rmse(rendered, reference, mask),
                ssim(rendered, reference, mask),
                min(timings, default=np.nan),
                rendered,
            )
        )
    return Comparison(ink, tuple(rows), reference, mask, float(mask.sum() / lit.sum()), exposure)


def _timed(function: Any) -> float:  # noqa: ANN401 - anything that can be called
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def rmse(one: FloatArray, other: FloatArray, mask: BoolArray) -> float:
    """Root mean square difference of two pictures (rows, cols, 3) over a mask."""
    return float(np.sqrt(np.mean((one[mask] - other[mask]) ** 2)))


def ssim(one: FloatArray, other: FloatArray, mask: BoolArray) -> float:
    """Structural similarity of two pictures (rows, cols, 3) over a mask."""
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - slow to load

    _, found = structural_similarity(  # type: ignore[no-untyped-call]
        one,
        other,
        channel_axis=-1,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return float(np.mean(found[mask]))


def synthetic_readings(
    ink: Ink,
    rng: np.random.Generator,
    *,
    noise: float = 0.03,
    angle_error_deg: float = 0.3,
    retro: float = 0.002,
) -> Measured:
    """Synthetic readings of an ink at the paper's angles: the goniochromatic model, perturbed, with noise.

    The perturbation is what no model here knows: a grey lobe back toward the light, errors of the goniometer's angles,
    and multiplicative noise.

    Args:
        ink: the truth.
        rng: of the noise.
        noise: relative, one standard deviation.
        angle_error_deg: of both angles, one standard deviation.
        retro: height of the lobe toward the light, as a share of the ink's mean ρ over 4πα².
    """
    from anisoscope.sim.light.ink.model import brdf_at_angles  # noqa: PLC0415 - only who makes readings up

    light = np.array([20.0, 30.0, 40.0, 50.0, 60.0, 65.0, 70.0])
    camera = np.arange(-80.0, 80.1, 2.5)
    theta_i, theta_o = (part.ravel() for part in np.meshgrid(light, camera, indexing="ij"))
    measurable = (np.abs(theta_i + theta_o) > 10.0) & (
        (theta_i > 30.0) | (theta_o > 0.0)
    )  # light and detector collide
    theta_i, theta_o = theta_i[measurable], theta_o[measurable]
    off_i, off_o = rng.normal(0.0, angle_error_deg, (2, theta_i.size))
    value = brdf_at_angles(ink, np.clip(theta_i + off_i, 0.0, 89.0), np.clip(theta_o + off_o, -89.0, 89.0))
    peak = float(ink.rho_brdf.mean()) / (4.0 * np.pi * ink.alpha**2)
    value = value + retro * peak * np.exp(-0.5 * ((theta_i + theta_o) / 20.0) ** 2)[:, None]
    return Measured(theta_i, theta_o, ink.nm, value * np.exp(rng.normal(0.0, noise, value.shape)))
