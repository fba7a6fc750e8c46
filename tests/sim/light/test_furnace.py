"""Energy balance of the base under a rough interface, by walks that follow light through every reflection.

Light walks on Smith's surface (Heitz et al. 2016, "Multiple-scattering microfacet BSDFs with the Smith model"): heights
even in −1 to 1, visible microfacets, Fresnel's choice at each; nothing is lost. Only Λ and Fresnel's terms are shared.
"""

import numpy as np
import pytest

from anisoscope.parameters.material import Material
from anisoscope.sim.light.material import (
    diffuse_scale,
    fresnel,
    interface_bound,
    smith_lambda,
    transmittance,
)
from anisoscope.sim.pathtracer.plastic import Plastic

INDEX, CANDIDATES, MEETINGS = 1.5, 48, 12


def entered(mu, alpha, tail, rng, outside=True):
    """Share of light with these cosines that crosses the interface, from outside or from inside."""
    count, side = len(mu), 1.0 if outside else -1.0
    way = side * np.stack([np.sqrt(1.0 - mu**2), np.zeros(count), -mu], axis=1)
    side, height, walking = np.full(count, side), np.full(count, 0.999999 * side), np.ones(count, bool)
    for _ in range(MEETINGS):
        at = np.flatnonzero(walking)
        flip = side[at][:, None]
        to, h = way[at] * flip, height[at] * flip[:, 0]
        z = to[:, 2]
        above = smith_lambda(alpha * np.sqrt(np.maximum(1 - z * z, 1e-12)) / np.maximum(abs(z), 1e-6), tail)
        shadow = np.where(z >= 0.0, above, -1.0 - above)
        below, drawn = np.clip(0.5 * (h + 1.0), 1e-12, 1.0), rng.random(len(at))
        leaves = (z > 0.0) & (drawn > 1.0 - below ** np.maximum(shadow, 0.0))
        walking[at[leaves]] = False
        exponent = np.where(np.abs(shadow) < 1e-9, 1e-9, shadow)
        with np.errstate(all="ignore"):
            risen = 2.0 * np.clip(below / (1.0 - drawn) ** (1.0 / exponent), 0.0, 1.0) - 1.0
        at, flip, to = at[~leaves], flip[~leaves], -to[~leaves]
        height[at] = risen[~leaves] * flip[:, 0]
        if not at.size:
            break
        share = rng.random((len(at), CANDIDATES))
        radius = alpha * np.sqrt((share**-tail - 1.0) / tail if tail else -np.log(share))
        turn = 2.0 * np.pi * rng.random(share.shape)
        x, y = -radius * np.cos(turn), -radius * np.sin(turn)
        seen = np.cumsum(np.maximum(to[:, :1] * x + to[:, 1:2] * y + to[:, 2:], 0.0), axis=1)
        pick = np.sum(seen < rng.random(len(at))[:, None] * seen[:, -1:], axis=1).clip(0, CANDIDATES - 1)
        rows = np.arange(len(at))
        facet = np.stack([x[rows, pick], y[rows, pick], np.ones(len(at))], axis=1)
        facet /= np.linalg.norm(facet, axis=1, keepdims=True)
        cosine = np.clip(np.sum(to * facet, axis=1), 0.0, 1.0)
        out = side[at] > 0.0
        eta = np.where(out, INDEX, 1.0 / INDEX)
        mirrored = np.where(out, fresnel(cosine, INDEX), fresnel(cosine, 1.0 / INDEX))
        back = rng.random(len(at)) < mirrored
        bent = np.sqrt(np.maximum(1.0 - (1.0 - cosine**2) / eta**2, 0.0))
        through = -to / eta[:, None] + (cosine / eta - bent)[:, None] * facet
        onward = np.where(back[:, None], 2.0 * cosine[:, None] * facet - to, through)
        way[at] = onward / np.linalg.norm(onward, axis=1, keepdims=True) * flip
        side[at] = np.where(back, side[at], -side[at])
    return float(np.mean(side < 0.0 if outside else side > 0.0))


@pytest.mark.parametrize(("alpha", "tail"), [(0.15, 1.0), (0.3, 0.0)])
def test_the_base_of_energy_balance_lies_within_the_bound_and_nearer_to_ours(judged_figure, alpha, tail):
    rng, count = np.random.default_rng(6), 30000
    inside = 1.0 - entered(np.sqrt(rng.random(count)), alpha, tail, rng, outside=False)
    crossed = entered(np.full(count, 0.98), alpha, tail, rng)
    other = Plastic(alpha, alpha, 0.5, INDEX, "ggx" if tail else "beckmann")
    for albedo in (0.2, 0.6, 0.9):
        material = Material(alpha, alpha, albedo, INDEX, tail=tail)
        balanced = albedo / (1.0 - albedo * inside) / (np.pi * INDEX**2) * crossed**2
        ours = diffuse_scale(material) * float(transmittance(np.array([0.98]), material)[0]) ** 2
        bound = interface_bound(material) / (1.0 - albedo * inside)
        noise = 3.0 * (0.0028 * albedo / (1.0 - albedo * inside) + 0.0022)
        assert -noise < balanced / ours - 1.0 < bound + noise
        shown = f"{balanced / ours - 1.0:+.1%}, bound in the budget {bound:.1%}"
        if tail:
            there = np.interp(0.98, np.linspace(0.0, 1.0, len(other.transmission)), other.transmission)
            theirs = albedo / (1.0 - albedo * other.internal_reflectance) / (np.pi * INDEX**2) * there**2
            assert abs(ours / balanced - 1.0) < abs(theirs / balanced - 1.0)
            shown += f"; single reflections under the tail {balanced / theirs - 1.0:+.1%}"
        what = f"base of α {alpha:g}, albedo {albedo:g}, tail {tail:g}: balance over ours"
        judged_figure("Base under a tail", what, "walks through all reflections", shown, "within the bound")
