"""One ink: roughness, and spectra of reflectance and of goniochromatism."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError
from anisoscope.parameters.material import LONGEST_TAIL
from anisoscope.sim.light.ink.distributions import Distribution, tail_of

Scale = Literal["brdf", "factor"]

SPECTRALON = 0.99
"""Reflectance of the white reference of the paper, a 99 % Spectralon."""

MOST_C = 50.0
_MICROMETRES = 20.0
_GAP = 4.0


_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_NotNegative = Annotated[float, Field(ge=0.0)]


@dataclass(frozen=True)
class InkUncertainty:
    """Standard uncertainties of an ink: how well its file describes the light of its prints.

    Relative of roughness, of level (``rho_share``, all wavelengths alike) and of colour (``colour_share``, between red,
    green and blue); absolute of c and of the form of the lobe. The misfit is what the model left of the readings, in
    ln, as a systematic error that neighbouring half angles share: rms of all wavelengths together and, besides, of each
    third of the spectrum, at half angles ``misfit_at_deg``.
    """

    alpha_share: _Share
    rho_share: _Share
    colour_share: _Share
    c: _NotNegative
    lobe: _NotNegative
    misfit_at_deg: tuple[_NotNegative, ...] = ()
    misfit_share: tuple[_NotNegative, ...] = ()
    misfit_colour_share: tuple[_NotNegative, ...] = ()

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        if not len(self.misfit_at_deg) == len(self.misfit_share) == len(self.misfit_colour_share):
            raise ValueError("misfit_at_deg, misfit_share and misfit_colour_share need as many values")
        if np.any(np.diff(self.misfit_at_deg) <= 0.0):
            raise ValueError("misfit_at_deg must rise")


UNKNOWN = InkUncertainty(alpha_share=0.1, rho_share=0.1, colour_share=0.03, c=0.3, lobe=0.5)
"""Of an ink whose file states none."""


@dataclass(frozen=True)
class Ink:
    """Parameters of the model of Pranovich 2024 (Eq. 5) at W wavelengths.

    Attributes:
        name: for people.
        alpha: roughness α, above 0 and at most 1; along the brushing where ``alpha_y`` is given.
        wavelengths_nm: (W,) rising.
        rho: (W,) ρ(λ), 0 or more, in the scale that ``convention`` says.
        c: (W,) c(λ), of either sign.
        convention: "brdf": Eq. 5 gives the BRDF in 1/sr; "factor": it gives the value over that of a white reference,
            and the BRDF is white/π times as much. Taken for a BRDF, a factor makes everything 3.17 times too bright.
        source: where the numbers come from.
        white: reflectance of the white reference, for "factor".
        alpha_y: roughness across the brushing; None for an isotropic print.
        brush_deg: direction along which ``alpha`` holds, counter-clockwise from +x of the surface.
        distribution: of the flakes' normals, "ggx" (the paper's, Eq. 3), "beckmann", or a tail (0 Beckmann's, 1 GGX).
        uncertainty: how well all this is known; None where nobody says.
        base: inks at the same wavelengths whose light adds, such as paper (α = 1: 4 times its reflectance is ρ, in
            1/sr) and gloss of the binder.

    Raises:
        ModelError: numbers that no ink can have; the message names the wavelength.
    """

    name: str
    alpha: float
    wavelengths_nm: tuple[float, ...]
    rho: tuple[float, ...]
    c: tuple[float, ...]
    convention: Scale = "brdf"
    source: str = ""
    white: float = SPECTRALON
    alpha_y: float | None = None
    brush_deg: float = 0.0
    distribution: Distribution = "ggx"
    uncertainty: InkUncertainty | None = None
    base: tuple["Ink", ...] = ()

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("alpha_y", self.across)):
            if not 0.0 < value <= 1.0:
                raise ModelError(f"{name} must lie above 0 and at most at 1, not {value:g}")
        if not 0.0 < self.white <= 1.1:
            raise ModelError(
                f"the reflectance of the white reference must lie in 0 to 1.1, not {self.white:g}"
            )
        if isinstance(self.distribution, str) and self.distribution not in ("ggx", "beckmann"):
            raise ModelError(
                f"no distribution is named {self.distribution!r}; known: ggx, beckmann, or a tail"
            )
        if not 0.0 <= tail_of(self.distribution) <= LONGEST_TAIL:
            raise ModelError(
                f"the tail of the lobe must lie between 0 and {LONGEST_TAIL:g}, not {self.distribution}"
            )
        if self.convention not in ("brdf", "factor"):
            raise ModelError(f"the scale of rho is 'brdf' or 'factor', not {self.convention!r}")
        if not np.isfinite(self.brush_deg):
            raise ModelError("the direction of the brushing must be a finite angle")
        self._check_wavelengths()
        self._check_spectra()
        for one in self.base:
            if one.base or not one.isotropic or one.wavelengths_nm != self.wavelengths_nm:
                raise ModelError(
                    "a base is isotropic, has the wavelengths of its ink, and no base of its own"
                )

    def _check_wavelengths(self) -> None:
        nm = np.array(self.wavelengths_nm, dtype=np.float64)
        if nm.size < 2 or not nm.size == len(self.rho) == len(self.c):
            raise ModelError(
                f"an ink needs as many rho and c as wavelengths, two or more: "
                f"found {nm.size} wavelengths, {len(self.rho)} rho, {len(self.c)} c"
            )
        if not np.all(np.isfinite(nm)) or nm.min() <= 0.0:
            raise ModelError("wavelengths must be finite numbers above 0")
        if nm.max() < _MICROMETRES:
            raise ModelError(
                f"wavelengths up to {nm.max():g} look like µm: write them in nm, 1000 times larger"
            )
        steps = np.diff(nm)
        if np.any(steps <= 0.0):
            at = int(np.argmax(steps <= 0.0))
            raise ModelError(f"wavelengths must rise: {nm[at + 1]:g} nm follows {nm[at]:g} nm")
        if np.any(steps > _GAP * np.median(steps)):
            at = int(np.argmax(steps))
            raise ModelError(
                f"the wavelengths have a gap between {nm[at]:g} and {nm[at + 1]:g} nm, where others are "
                f"{np.median(steps):g} nm apart: fill it"
            )

    def _check_spectra(self) -> None:
        for name, values in (("rho", self.rho), ("c", self.c)):
            for nm, value in zip(self.wavelengths_nm, values, strict=True):
                if not np.isfinite(value):
                    raise ModelError(
                        f"{name} at {nm:g} nm is {value:g}: every wavelength needs a finite number"
                    )
                if name == "rho" and value < 0.0:
                    raise ModelError(f"rho at {nm:g} nm is {value:g}: a reflectance is 0 or more")
                if name == "c" and abs(value) > MOST_C:
                    raise ModelError(f"c at {nm:g} nm is {value:g}: beyond ±{MOST_C:g} it is no ink")

    @property
    def across(self) -> float:
        """Roughness across the brushing, α itself where the print is isotropic."""
        return self.alpha if self.alpha_y is None else self.alpha_y

    @property
    def isotropic(self) -> bool:
        """The print looks alike however it is turned in its plane."""
        return self.across == self.alpha

    @property
    def parts(self) -> tuple["Ink", ...]:
        """The flakes alone, and the base: Eq. 5 holds for each, and their light adds."""
        return (replace(self, base=()), *self.base) if self.base else (self,)

    @property
    def rho_brdf(self) -> FloatArray:
        """(W,) ρ with which Eq. 5 gives the BRDF in 1/sr."""
        factor = 1.0 if self.convention == "brdf" else self.white / np.pi
        return factor * np.array(self.rho, dtype=np.float64)

    @property
    def c_values(self) -> FloatArray:
        """(W,) c."""
        return np.array(self.c, dtype=np.float64)

    @property
    def nm(self) -> FloatArray:
        """(W,) wavelengths in nm."""
        return np.array(self.wavelengths_nm, dtype=np.float64)

    def in_brush_frame(self, vectors: FloatArray) -> FloatArray:
        """(…, 3) vectors of the surface's frame, x turned into the direction of the brushing."""
        if self.brush_deg == 0.0:
            return np.asarray(vectors, dtype=np.float64)
        x, y, z = np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)
        cosine, sine = np.cos(np.radians(self.brush_deg)), np.sin(np.radians(self.brush_deg))
        return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=-1)
