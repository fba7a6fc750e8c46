"""Closed forms of the spectra that sampling processes 1 and 2 give on average (Levin et al. 2013, claims 1 and 2).

All densities are per area and integrate to 1 over ω: mixtures of surfaces then simply add by their shares of area. They
are blurred by the source throughout, a rect of width 1/Δc; the paper blurs its second terms only. Claim 2 has a
Dirichlet kernel where the paper prints a sinc.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import ModelError

Density = Callable[[FloatArray], FloatArray]

_NODES = 96


def mean_phase(levels_um: Sequence[float], wavelength_um: float, h_z: float = 1.0) -> complex:
    """τ, the mean of exp(−ik·2h_z·z) over equally likely levels; 0 leaves no specular spike.

    |τ| over a band of wavelengths is what Eq. 18 bounds; printed, it lacks the modulus and a factor of 2.
    """
    turns = 2.0 * h_z / wavelength_um * np.asarray(levels_um, dtype=np.float64)
    return complex(np.mean(np.exp(-2j * np.pi * turns)))


def blurred_sinc2(frequency: FloatArray, width_um: float, coherence_um: float = np.inf) -> FloatArray:
    """a·sinc²(a·ω), blurred by a rect of width 1/Δc: exact, by the sine integral; in µm."""
    if np.isinf(coherence_um):
        return np.asarray(width_um * np.sinc(width_um * frequency) ** 2)
    upper, lower = (_integral(width_um * (frequency + 0.5 * sign / coherence_um)) for sign in (1.0, -1.0))
    return np.asarray(coherence_um * (upper - lower))


def _integral(t: FloatArray) -> FloatArray:
    """∫₀ᵗ sinc²."""
    from scipy.special import sici  # noqa: PLC0415 - slow to import

    safe = np.where(np.abs(t) > 1e-9, t, 1.0)
    found = sici(2.0 * np.pi * t)[0] / np.pi - np.sin(np.pi * t) ** 2 / (np.pi**2 * safe)
    return np.where(np.abs(t) > 1e-9, found, t)


def area_shares(widths_um: FloatArray, probabilities: FloatArray) -> FloatArray:
    """Shares a·p_a/E[a] of the area that steps of each width cover, from how often they are drawn."""
    widths, drawn = np.asarray(widths_um, dtype=np.float64), np.asarray(probabilities, dtype=np.float64)
    if widths.shape != drawn.shape or not (widths > 0.0).all() or drawn.min() < 0.0 or drawn.sum() <= 0.0:
        raise ModelError("every width must be positive and have a probability, 0 or more, not all of them 0")
    return widths * drawn / float(np.sum(widths * drawn))


def lobe(
    frequency: FloatArray, widths_um: FloatArray, probabilities: FloatArray, coherence_um: float = np.inf
) -> FloatArray:
    """Glossy lobe of sampling process 1 along one axis without its spike, in µm; integral 1.

    Source: Levin et al. 2013, Eq. 13 and 14, per area instead of per step, with the source's blur on the lobe too.

    Raises:
        ModelError: widths or probabilities that are none.
    """
    shares = area_shares(widths_um, probabilities)
    parts = [
        share * blurred_sinc2(frequency, float(width), coherence_um)
        for width, share in zip(widths_um, shares, strict=True)
    ]
    return np.asarray(np.sum(parts, axis=0))


def spike(frequency: FloatArray, coherence_um: float) -> FloatArray:
    """Specular spike along one axis: a rect of width 1/Δc, in µm; integral 1."""
    inside = np.abs(frequency) * coherence_um
    return np.where(inside < 0.5, coherence_um, np.where(inside == 0.5, 0.5 * coherence_um, 0.0))


def with_spike(tau: complex, lobe_density: FloatArray, spike_density: FloatArray) -> FloatArray:
    """(1 − |τ|²)·lobe + |τ|²·spike: claim 1, and claim 2 where the mean is not zero; of one axis or of both."""
    share = abs(tau) ** 2
    return (1.0 - share) * lobe_density + share * spike_density


def spike_over_lobe(tau: complex, coherence_um: float, width_um: float) -> float:
    """Height of the spike over that of the lobe of square steps in 2-D: |τ|²·(Δc/a)² for small τ."""
    share = abs(tau) ** 2
    return float(share / (1.0 - share) * (coherence_um / width_um) ** 2)


def dirichlet2(frequency: FloatArray, count: int, width_um: float) -> FloatArray:
    """[sin(πmωa)/(m·sin(πωa))]²: 1 wherever ω·a is a whole number. Eq. 17 prints sinc² of the remainder."""
    turns = np.asarray(frequency, dtype=np.float64) * width_um
    centred = turns - np.rint(turns)
    return np.asarray((np.sinc(count * centred) / np.sinc(centred)) ** 2)


def anti_mirror(
    frequency: FloatArray, count: int, width_um: float, coherence_um: float = np.inf
) -> FloatArray:
    """Sampling process 2 along one axis, m steps of width a in random order with zero mean, in µm; integral 1.

    Source: Levin et al. 2013, Eq. 17 with its sinc mended to a Dirichlet kernel, normalised by m/(m − 1).

    Raises:
        ModelError: fewer than two steps.
    """
    if count < 2:
        raise ModelError(f"two steps or more can have a zero mean, not {count}")

    def sharp(f: FloatArray) -> FloatArray:
        envelope = width_um * np.sinc(width_um * f) ** 2
        return np.asarray(count / (count - 1) * (1.0 - dirichlet2(f, count, width_um)) * envelope)

    return blurred(sharp, np.asarray(frequency, dtype=np.float64), coherence_um, count * width_um)


def anti_mirror_2d(
    frequency_x: FloatArray,
    frequency_y: FloatArray,
    counts: tuple[int, int],
    widths_um: tuple[float, float],
    coherence_um: float = np.inf,
) -> FloatArray:
    """(Y, X) density in µm² of blocks of m_x × m_y rectangles a0x × a0y in random order with zero mean.

    Arguments are (x, y). The hole is 1/(m_x·a0x) by 1/(m_y·a0y). Source: Levin et al. 2013, section 3.2.

    Raises:
        ModelError: fewer than two rectangles.
    """
    total = counts[0] * counts[1]
    if total < 2 or min(counts) < 1:
        raise ModelError(f"two rectangles or more can have a zero mean, not {counts[0]} × {counts[1]}")
    parts = []
    for f, count, width in zip((frequency_x, frequency_y), counts, widths_um, strict=True):

        def hole(g: FloatArray, count: int = count, width: float = width) -> FloatArray:
            return dirichlet2(g, count, width) * width * np.sinc(width * g) ** 2

        parts.append((blurred_sinc2(f, width, coherence_um), blurred(hole, f, coherence_um, count * width)))
    (ring_x, hole_x), (ring_y, hole_y) = parts
    return np.asarray(
        total / (total - 1) * (np.outer(ring_y, ring_x) - np.outer(hole_y, hole_x)), dtype=np.float64
    )


def crossed(density_x: FloatArray, density_y: FloatArray) -> FloatArray:
    """(Y, X) density of a surface whose wave is the product of two profiles: the hole becomes a cross."""
    return np.outer(density_y, density_x)


def blurred(density: Density, frequency: FloatArray, coherence_um: float, period_um: float) -> FloatArray:
    """A density blurred by a rect of width 1/Δc, by Gauss and Legendre, in as many parts as it has ripples."""
    if np.isinf(coherence_um):
        return density(frequency)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    parts = max(1, int(np.ceil(period_um / coherence_um / 8.0)))
    edges = np.linspace(-0.5, 0.5, parts + 1) / coherence_um
    total = np.zeros_like(frequency)
    for low, high in pairwise(edges):
        offset = 0.5 * (high + low) + 0.5 * (high - low) * node
        total += 0.5 * (high - low) * (density(frequency[..., None] + offset) @ weight)
    return np.asarray(coherence_um * total)


def mixture(shares: Sequence[float], densities: Sequence[FloatArray]) -> FloatArray:
    """Density of a surface tiled with several models, by shares of the area.

    Raises:
        ModelError: shares that do not add up to 1, or are negative.
    """
    if len(shares) != len(densities) or min(shares) < 0.0 or abs(sum(shares) - 1.0) > 1e-9:
        raise ModelError("every model needs a share of the area, 0 or more, 1 all together")
    return np.asarray(sum(share * density for share, density in zip(shares, densities, strict=True)))
