"""Rough plastic: parameters of its reflectance (`anisoscope.sim.light.material`)."""

import math
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import ModelError

InternalReflection = Literal["nonlinear", "linear"]
LONGEST_TAIL = 1.6  # the shadowing of a tail of 2 and more is infinite
SHORTEST_TAIL = 1e-4  # a tail below it is none: the lobe is Beckmann's


@dataclass(frozen=True)
class Material:
    """Optical properties of the plastic.

    Attributes:
        alpha_along: Beckmann roughness along the ridges α_u, √2 · rms slope, 0.001 to 1.
        alpha_across: Beckmann roughness across the ridges α_v, 0.001 to 1.
        albedo: diffuse albedo ρ_d of the plastic's interior, 0 to 1.
        index: refractive index η of the plastic, above 1 to 4.
        internal_reflection: colour of light sent back inside the plastic: coloured again (nonlinear: x = ρ·F_dr,
            physical), or not (linear: x = F_dr).
        tail: tail τ of the lobe, 0 (Beckmann) to 1.6; 1 is GGX. Roughness is then no rms slope, but the width of the
            lobe's core.
        second_lobe: weight w and width factor s of a Beckmann lobe that is mixed in: slopes of
            (1 − w)·P(r²) + w/s²·exp(−r²/s²)/π.

    Raises:
        ModelError: a value outside the range in which the model means anything.
    """

    alpha_along: float = 0.06
    alpha_across: float = 0.10
    albedo: float = 0.2
    index: float = 1.5
    internal_reflection: InternalReflection = "nonlinear"
    tail: float = 0.0
    second_lobe: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, alpha in (("along", self.alpha_along), ("across", self.alpha_across)):
            if not 0.001 <= alpha <= 1.0:
                raise ModelError(
                    f"roughness alpha {name} the ridges must lie between 0.001 and 1, not {alpha}"
                )
        if not 0.0 <= self.albedo <= 1.0:
            raise ModelError(f"the albedo must lie between 0 and 1, not {self.albedo}")
        if not 1.0 < self.index <= 4.0:
            raise ModelError(f"the refractive index must lie above 1 and up to 4, not {self.index}")
        if self.internal_reflection not in ("nonlinear", "linear"):
            raise ModelError(
                f"internal reflection is 'nonlinear' or 'linear', not {self.internal_reflection!r}"
            )
        if not 0.0 <= self.tail <= LONGEST_TAIL:
            raise ModelError(f"the tail of the lobe must lie between 0 and {LONGEST_TAIL:g}, not {self.tail}")
        if self.second_lobe is not None:
            weight, width = self.second_lobe
            if not (0.0 < weight < 1.0 and 0.1 <= width <= 10.0):
                raise ModelError(
                    "a second lobe has a weight between 0 and 1 and a width of .1 to 10 times the first, not "
                    f"{weight:g} and {width:g}"
                )

    @property
    def is_beckmann(self) -> bool:
        """Whether the lobe has neither a tail nor a second lobe."""
        return self.tail < SHORTEST_TAIL and self.second_lobe is None

    @property
    def narrowest_alpha(self) -> float:
        """The smallest width of the lobe or of a second one."""
        _, width = self.second_lobe or (0.0, 1.0)
        return min(self.alpha_along, self.alpha_across) * min(1.0, width)

    @property
    def alpha_mean(self) -> float:
        """√(α_u·α_v), the isotropic roughness used for the transmittance of the interface.

        Rounded to 12 digits, so that a table is computed once for all pairs with the same product.
        """
        return float(f"{math.sqrt(self.alpha_along * self.alpha_across):.12g}")
