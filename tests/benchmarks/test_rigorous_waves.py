"""Scalar waves against rigorous coupled waves: lamellar gratings of aluminium, solved by fmmax (MIT).

More orders come first: of both polarisations, at the narrowest and at the widest steps. Then every cell of the
table is solved, and with ANISOSCOPE_WRITE_DOCS=1 written to tests/sim/light/wave/rigorous.csv, with which
`test_rigorous.py` there compares the engine. So are gratings and a random tile that no bound was fitted to
(unseen.csv, `test_edges.py`).
"""

import csv
import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "tests" / "sim" / "light" / "wave" / "rigorous.csv"
UNSEEN = REFERENCE.with_name("unseen.csv")
UM = 0.55
ALUMINIUM = (0.96 + 6.69j) ** 2
WIDTHS_UM = (2.0, 4.0, 8.0, 16.0)
FACTORS = {2.0: 3.0, 4.0: 2.0, 8.0: 1.5, 16.0: 1.15}
"""Orders of the expansion over those that can propagate."""

DEPTHS_UM = (0.06, 0.1375, 0.25, 0.4)
ANGLES_DEG = (0.0, 15.0, 30.0, 45.0)
KEPT = 1e-3
UNSEEN_GRATINGS = ("6/12", "11/22", "5/14")
UNSEEN_DEPTHS_UM, UNSEEN_ANGLES_DEG = (0.08, 0.1375, 0.2), (0.0, 6.0)
SEED = 20261127

pytestmark = pytest.mark.filterwarnings(  # fmmax 1.7 with jax 0.10
    "ignore:Implicit conversion of an array to a dtype:DeprecationWarning"
)


def propagating(width_um):
    """Orders that can propagate at any angle, on one side."""
    return int(np.ceil(2.0 * 2.0 * width_um / UM))


def terms(width_um, factor):
    """Largest order of the expansion: the propagating ones, and evanescent ones that the walls need."""
    return int(propagating(width_um) * factor) + 20


def solved(width_um, depths_um, angle_deg, half):
    """As `solved_ridges`, for ridges as wide as the grooves between them."""
    return solved_ridges(2.0 * width_um, [(0.0, width_um)], depths_um, angle_deg, half)


def solved_ridges(pitch_um, ridges, depths_um, angle_deg, half):
    """{depth: (2, 2·half + 1)} power of every order over that of the flat metal; first TE, field along the grooves."""
    import fmmax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    number = np.zeros((2 * half + 1, 2), dtype=int)
    number[1::2, 0], number[2::2, 0] = np.arange(1, half + 1), -np.arange(1, half + 1)
    expansion = fmmax.Expansion(number)
    lattice = fmmax.LatticeVectors(u=jnp.array([pitch_um, 0.0]), v=jnp.array([0.0, 1.0]))
    points = round(pitch_um / 0.05) * max(1, round(16 * half * 0.05 / pitch_um))  # whole points a ridge
    place = (np.arange(points) + 0.5) / points * pitch_um
    on_ridge = np.any([(start < place) & (place < end) for start, end in ridges], axis=0)
    pattern = np.where(on_ridge, ALUMINIUM, 1.0 + 0.0j)[:, None]

    def walls(permittivity, _expansion, _lattice):  # tangent to the walls: along y
        return jnp.zeros_like(permittivity), jnp.ones_like(permittivity)

    def layer(permittivity):
        return fmmax.eigensolve_isotropic_media(
            wavelength=jnp.array(UM),
            in_plane_wavevector=jnp.array([2.0 * np.pi / UM * np.sin(np.radians(angle_deg)), 0.0]),
            primitive_lattice_vectors=lattice,
            permittivity=jnp.asarray(permittivity),
            expansion=expansion,
            formulation=walls,
        )

    air, metal = layer(np.ones((1, 1), dtype=complex)), layer(np.full((1, 1), ALUMINIUM))
    grooves, count = layer(pattern), expansion.num_terms

    def power(layers, depths):
        scattering = fmmax.stack_s_matrix(layers, [jnp.array(depth) for depth in depths])
        found = []
        for polarisation in range(2):
            into = np.zeros((2 * count, 1), dtype=complex)
            into[polarisation * count] = 1.0
            down, up = fmmax.amplitude_poynting_flux(jnp.asarray(into), scattering.s21 @ into, air)
            up = np.asarray(up)[:, 0]
            found.append(-(up[:count] + up[count:]) / float(np.asarray(down).sum()))
        return np.array(found)[:, np.argsort(number[:, 0])]

    flat = power([air, metal], [0.0, 0.0]).sum(axis=1, keepdims=True)
    return {depth: power([air, grooves, metal], [0.0, depth, 0.0]) / flat for depth in depths_um}


@pytest.mark.benchmark
@pytest.mark.parametrize(("width_um", "factor"), [(2.0, 6.0), (16.0, 1.25)])
def test_orders_of_the_expansion_suffice(bench, width_um, factor):
    """The table's orders against more: TM of shallow grooves converges slowly, even and odd numbers apart."""
    kept, found = propagating(width_um), []
    for one in (FACTORS[width_um], factor):
        half = terms(width_um, one)
        powers = solved(width_um, (0.06, 0.4), 30.0, half)
        found.append({depth: both[:, half - kept : half + kept + 1] for depth, both in powers.items()})
    for depth in found[0]:
        te, tm = np.abs(found[1][depth] - found[0][depth]).max(axis=1)
        bench.note(
            f"{width_um:g} µm wide, {1e3 * depth:g} nm deep: ±{half} instead of ±{terms(width_um, FACTORS[width_um])} "
            f"orders change TE by {te:.1e}, TM by {tm:.1e}"
        )
        assert max(te, tm) < 5e-3


@pytest.mark.benchmark
def test_every_cell_is_solved(bench):
    rows = []
    for width in WIDTHS_UM:
        half, kept = terms(width, FACTORS[width]), propagating(width)
        for angle in ANGLES_DEG:
            for depth, both in solved(width, DEPTHS_UM, angle, half).items():
                for name, powers in zip(("TE", "TM"), both, strict=True):
                    for order in range(-kept, kept + 1):
                        value = float(powers[half + order])
                        if value > KEPT * float(powers.max()):
                            rows.append((width, 1e3 * depth, angle, name, order, f"{value:.5f}"))
    bench.note(f"{len(rows)} orders of {len(WIDTHS_UM) * len(DEPTHS_UM) * len(ANGLES_DEG) * 2} cells")
    totals = {}
    for row in rows:
        totals[row[:4]] = totals.get(row[:4], 0.0) + float(row[5])
    assert min(totals.values()) > 0.5
    assert max(totals.values()) < 1.02
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        with REFERENCE.open("w", newline="", encoding="utf-8") as stream:
            stream.write(
                "# fmmax 1.7.1, lamellar grating of aluminium (n = 0.96 + 6.69i), half of it grooves, 550 nm\n"
            )
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(("width_um", "depth_nm", "angle_deg", "polarisation", "order", "power"))
            writer.writerows(rows)


def random_tile():
    """Pitch and ridges (from, to) in µm of a tile with ridges and grooves of random width."""
    widths = np.random.default_rng(SEED).integers(30, 101, 14) * 0.05
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    return float(edges[-1]), [(float(a), float(b)) for a, b in zip(edges[:-1:2], edges[1::2], strict=True)]


@pytest.mark.benchmark
def test_patterns_that_no_bound_was_fitted_to_are_solved(bench):
    """Gratings of other widths, and a random tile: each order above a thousandth of the brightest one."""
    pitch, ridges = random_tile()
    patterns = {"tile1": (pitch, ridges)}
    for name in UNSEEN_GRATINGS:
        width, period = (float(one) for one in name.split("/"))
        patterns[name] = (period, [(0.0, width)])
    rows = []
    for name, (period, of_pattern) in patterns.items():
        kept = propagating(0.5 * period)
        half = int(kept * (1.15 if period > 16.0 else 1.5)) + 20
        for angle in UNSEEN_ANGLES_DEG:
            found = solved_ridges(period, of_pattern, UNSEEN_DEPTHS_UM, angle, half)
            for depth, both in found.items():
                for polarisation, powers in zip(("TE", "TM"), both, strict=True):
                    assert 0.5 < powers.sum() < 1.02
                    for order in range(-kept, kept + 1):
                        value = float(powers[half + order])
                        if value > KEPT * float(powers.max()):
                            rows.append(
                                (
                                    name,
                                    550,
                                    f"{1e3 * depth:g}",
                                    f"{angle:g}",
                                    polarisation,
                                    order,
                                    f"{value:.5f}",
                                )
                            )
        bench.note(f"{name}: {period:g} µm, ±{half} orders, {sum(row[0] == name for row in rows)} rows")
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        with UNSEEN.open("w", newline="", encoding="utf-8") as stream:
            stream.write(
                "# fmmax 1.7.1, aluminium (n = 0.96 + 6.69i), TE: field along the grooves; w/p: ridge and pitch in µm\n"
            )
            stream.write(f"# tile1 {pitch:g}: {' '.join(f'{a:g}-{b:g}' for a, b in ridges)}\n")
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(
                ("pattern", "wavelength_nm", "depth_nm", "angle_deg", "polarisation", "order", "power")
            )
            writer.writerows(rows)
