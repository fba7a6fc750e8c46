"""Colour of inks against angle under one illuminant, for the standard observer."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, json_field
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.colour.observer import white_point, xyz_weights
from anisoscope.sim.light.colour.spaces import (
    SRGB_WHITE,
    bradford,
    ciede2000,
    encode,
    hexadecimal,
    lab,
    linear_srgb,
)
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import Model, brdf_at_angles

ANGLES_DEG = tuple(float(angle) for angle in range(0, 81, 10))


def _identity(ink: Ink) -> dict[str, Any]:
    return {"name": ink.name, "alpha": [ink.alpha, ink.across], "source": ink.source}


@dataclass(frozen=True, eq=False)
class Appearance:
    """Colours of one ink in the mirror direction, N angles.

    Attributes:
        ink: the ink.
        theta_deg: (N,) inclination of light and eye, on opposite sides.
        off_mirror_deg: angle of the eye from the mirror direction.
        xyz: (N, 3), Y = 1 for the perfect diffuser.
        srgb: (N, 3) encoded and clipped, at the exposure.
        hexes: (N,) the same as ``#rrggbb``.
        clipped: how many of the N colours are out of gamut.
        difference: (N,) CIEDE2000 from the first angle, at the exposure.
    """

    ink: Ink = field(metadata=json_field(by=_identity, merged=True))
    theta_deg: FloatArray
    off_mirror_deg: float
    xyz: FloatArray
    srgb: FloatArray = field(metadata=LEFT_OUT)
    hexes: tuple[str, ...] = field(metadata=json_field("srgb"))
    clipped: int
    difference: FloatArray = field(metadata=json_field("delta_e2000"))


@dataclass(frozen=True, eq=False)
class Show:
    """Several inks under one light, with one exposure.

    Attributes:
        illuminant: the light.
        model: of the BRDF.
        exposure: factor on XYZ for display.
        adapted: the light's white was turned into that of sRGB (Bradford).
        inks: their colours.
    """

    illuminant: Illuminant = field(metadata=json_field(by=attrgetter("name")))
    model: Model
    exposure: float
    adapted: bool
    inks: tuple[Appearance, ...]


def show_inks(
    inks: Sequence[Ink],
    illuminant: Illuminant,
    *,
    theta_deg: Sequence[float] = ANGLES_DEG,
    off_mirror_deg: float = 0.0,
    model: Model = "goniochromatic",
    exposure: float | None = None,
    adapt: bool = False,
) -> Show:
    """Colours of inks against the angle of incidence.

    Args:
        inks: one or more.
        illuminant: the light.
        theta_deg: inclinations of the light, 0 to below 90.
        off_mirror_deg: the eye stands at θo = θi + this.
        model: of the BRDF.
        exposure: factor on XYZ before it is shown. None: the brightest channel of all colours becomes 1.
        adapt: turn the light's white into that of sRGB, as an eye does that has got used to it.

    Raises:
        UsageError: no ink, or angles beyond the horizon.
        ModelError: an ink whose wavelengths give no colour.
    """
    theta = np.array(theta_deg, dtype=np.float64)
    theta_o_deg = theta + off_mirror_deg
    if not inks or theta.size == 0:
        raise UsageError("colours need an ink and an angle")
    if not (theta.min() >= 0.0 and theta.max() < 90.0 and np.abs(theta_o_deg).max() < 90.0):
        raise UsageError("angles of light and eye lie between 0 and 90°")
    if exposure is not None and not 0.0 < exposure < np.inf:
        raise UsageError(f"the exposure must be a number above 0, not {exposure:g}")
    white = white_point(illuminant)
    turn = bradford(white, SRGB_WHITE) if adapt else np.eye(3)
    colours = [
        np.pi * brdf_at_angles(ink, theta, theta_o_deg, model) @ xyz_weights(illuminant, ink.nm) @ turn.T
        for ink in inks
    ]
    brightest = max(float(linear_srgb(xyz).max()) for xyz in colours)
    # One factor for all inks keeps their brightness comparable; the brightest colour just avoids clipping.
    factor = exposure if exposure is not None else 1.0 / brightest if brightest > 0.0 else 1.0
    reference = SRGB_WHITE if adapt else white
    found = []
    for ink, xyz in zip(inks, colours, strict=True):
        encoded, eye = encode(linear_srgb(factor * xyz)), lab(factor * xyz, reference)
        hexes = tuple(hexadecimal(one) for one in encoded.srgb)
        found.append(
            Appearance(
                ink, theta, off_mirror_deg, xyz, encoded.srgb, hexes, encoded.clipped, ciede2000(eye[:1], eye)
            )
        )
    return Show(illuminant, model, factor, adapt, tuple(found))
