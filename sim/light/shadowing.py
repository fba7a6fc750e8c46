"""Smith's Λ of Beckmann's lobe from tables: no library with an error function, which would be slow to import."""

from math import erfc

import numpy as np

from anisoscope.base.arrays import FloatArray

UNSHADOWED = 6.0
"""1/(α·tan θ) from which on Smith's Λ is below 1e-18, less than 1 + Λ can hold."""
PER_UNIT = 256
LAMBDA_NODES = np.arange(int(UNSHADOWED * PER_UNIT) + 2) / PER_UNIT
LAMBDA_BELLS = np.exp(-(LAMBDA_NODES**2)) / np.sqrt(np.pi)
LAMBDA_TAILS = 0.5 * np.array([erfc(node) for node in LAMBDA_NODES])


def beckmann_lambda(a: FloatArray) -> FloatArray:
    """Smith's Λ of Beckmann's lobe (Heitz 2014, Eq. 66) from a = 1/(α·tan θ), 0 < a ≤ UNSHADOWED.

    g = a·Λ = ½(exp(−a²)/√π − a·erfc a) has the derivatives −½·erfc a, exp(−a²)/√π and multiples of the latter: its
    Taylor series from the nearest of 256 nodes a unit, up to the fourth power, is exact to 2e-15.
    """
    place = (a * PER_UNIT + 0.5).astype(np.intp)
    node, bell, tail = LAMBDA_NODES[place], LAMBDA_BELLS[place], LAMBDA_TAILS[place]
    d = a - node
    bent = 0.5 - d * (node / 3.0 - d * (4.0 * node * node - 2.0) / 24.0)
    return np.asarray(np.maximum(0.5 * bell - node * tail + d * (d * bell * bent - tail), 0.0) / a)
