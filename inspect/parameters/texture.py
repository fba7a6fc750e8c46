"""Filters, parameters and uncertainty of a surface texture (`anisoscope.profiles.textures`)."""

import math
from dataclasses import dataclass
from typing import Literal

from anisoscope.base.errors import UsageError

Smoothing = Literal["gaussian", "robust", "spline"]
MOST_SHARE = 0.2


@dataclass(frozen=True)
class Filtering:
    """Form and filters of a surface or of its lines.

    Attributes:
        form: form that is removed: none, plane, poly1 … poly10, sphere or cylinder.
        s_filter_um: nesting index (of lines λs) of the S-filter in µm; removes shorter waves.
        l_filter_um: nesting index (of lines λc) of the L-filter in µm; removes longer waves.
        s_filter: S-filter of ISO 16610: gaussian (-61, of lines -21), robust (-71, of lines -31) or spline (-22;
            separable, along x and y).
        l_filter: the same for the L-filter.
    """

    form: str = "plane"
    s_filter_um: float | None = None
    l_filter_um: float | None = None
    s_filter: Smoothing = "gaussian"
    l_filter: Smoothing = "gaussian"


@dataclass(frozen=True)
class Extent:
    """Texture parameters besides those that every map has.

    Attributes:
        features: also hills and dales: Spd, Spc, S5p, S5v, S10z, Sha, Sda, Shv, Sdv.
        pruning_percent: Wolf pruning of hills and dales in % of Sz.
        border_features: count peaks and pits of hills and dales at the border or a gap; others leave them out.
        ratios_percent: material ratios in %, such as 2,50: Smc, Vm and Vv there, and Sxp of the first two.
        heights_um: heights in µm from the mean, such as -0.5,0.5: Smr there.

    Raises:
        UsageError: a material ratio outside 0 to 100 %, or borders of features that are not wanted.
    """

    features: bool = False
    pruning_percent: float = 5.0
    border_features: bool = True
    ratios_percent: tuple[float, ...] = ()
    heights_um: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if any(not 0.0 <= share <= 100.0 for share in self.ratios_percent):
            shown = ",".join(f"{share:g}" for share in self.ratios_percent)
            raise UsageError(f"--ratios takes material ratios from 0 to 100 %, not {shown!r}")
        if not (self.features or self.border_features):
            raise UsageError("--no-border-features leaves out hills and dales: ask for them with --features")


@dataclass(frozen=True)
class MapUncertainty:
    """Standard uncertainties of a height map, and the draws that carry them to its parameters.

    Attributes:
        height_noise_um: noise of a height, standard deviation in µm, independent from point to point.
        height_scale: of the scale of the heights, relative.
        pixel_size: of the pixel size, relative, both axes together.
        draws: number of draws of noise, height scale and pixel size, such as 100: standard uncertainties of all
            values; each draw takes as long as the measurement.
        seed: seed of the draws.

    Raises:
        UsageError: one is negative or not finite, a relative one is beyond 0.2; draws without an uncertainty, or the
            other way round; fewer than two draws.
    """

    height_noise_um: float = 0.0
    height_scale: float = 0.0
    pixel_size: float = 0.0
    draws: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        limits = {"height_noise_um": math.inf, "height_scale": MOST_SHARE, "pixel_size": MOST_SHARE}
        for name, most in limits.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= value <= most):
                raise UsageError(f"the uncertainty {name} is a number from 0 to {most:g}, not {value:g}")
        if self.draws is None:
            if any(getattr(self, name) for name in limits):
                raise UsageError("--u-height-noise, --u-height-scale and --u-pixel-size take --draws NUMBER")
            return
        if not any(getattr(self, name) for name in limits):
            raise UsageError("--draws takes --u-height-noise, --u-height-scale or --u-pixel-size")
        if self.draws < 2:
            raise UsageError(f"--draws takes two draws or more, not {self.draws}")
        if self.seed < 0:
            raise UsageError(f"--seed takes a whole number from 0, not {self.seed}")
