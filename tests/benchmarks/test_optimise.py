"""Designs under tolerances: a sample in arrays against one part after the other, and the search against scipy's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.study.objective import Part, Scoring, Tolerances, errors_sample, score
from anisoscope.study.optimum import optimum

pytestmark = pytest.mark.benchmark
TOLERANCES = Tolerances(ridge_angle=0.3, alpha=0.1, height_loss=0.03, seating=0.3)
SCORING = Scoring(tolerances=TOLERANCES)
ANGLES = (3.0, 20.0)
BOUNDS = {
    "ridge_angle": ANGLES,
    "pitch": (50.0, 150.0),
    "alpha_along": (0.03, 0.2),
    "alpha_across": (0.05, 0.2),
}


def one_by_one(angle):
    """The robust score of a ridge angle from predictions of single parts."""
    errors, found = errors_sample(TOLERANCES, 2, SCORING.samples, SCORING.seed), []
    to_light, to_camera = directions(SCORING.poses, Convention())
    for number in range(SCORING.samples):
        seat = seating_rotation(*errors["seating"][number])
        alphas = np.array([0.06, 0.10]) * np.exp(errors["alpha"][number])
        design = RidgeDesign(
            100.0, angle + errors["ridge_angle"][number, 0], height_loss=abs(errors["height_loss"][number, 0])
        )
        first, second = corrected.radiance(to_light @ seat, to_camera @ seat, design, Material(*alphas))
        found.append(abs(first - second))
    return np.mean(found) - SCORING.z * np.std(found, ddof=1)


def test_a_sample_together_against_one_part_after_the_other(bench):
    found = bench.compare(
        f"robust score of one design, {SCORING.samples} parts, 2 poses",
        {"together": lambda: score(Part(), SCORING).score, "one after the other": lambda: one_by_one(10.0)},
    )
    together, alone = (one.result for one in found.timings.values())
    bench.note(f"scores differ by {abs(together / alone - 1.0):.1e}")
    assert together == pytest.approx(alone, rel=1e-3)
    assert found.ratio("one after the other", "together") > 5.0


def test_the_search_against_scipy(bench):
    """Scipy only climbs; the search also covers the whole range and states how well the optimum is known."""
    found = bench.compare(
        "robust ridge angle",
        {
            "search": lambda: optimum(Part(), {"ridge_angle": ANGLES}, SCORING, Workers()).part.ridge_angle,
            "scipy, one part after the other": lambda: (
                minimize_scalar(lambda angle: -one_by_one(angle), bounds=ANGLES, method="bounded").x
            ),
        },
        rounds=2,
    )
    ours, theirs = (float(one.result) for one in found.timings.values())
    bench.note(f"ridge angle {ours:.3f}° and {theirs:.3f}°")
    assert ours == pytest.approx(theirs, abs=0.05)


def test_the_search_by_the_number_of_variables(bench):
    works = {}
    for count in (1, 2, 4):
        varied = dict(list(BOUNDS.items())[:count])
        works[f"{count} varied"] = lambda v=varied: optimum(Part(edge_radius=3.0), v, SCORING, Workers())
    bench.compare("robust designs with rounded crests", works, rounds=2, warm=False)


def test_the_search_with_reflections(bench):
    """All reflections while four parameters are varied; the search has those after the second from a table."""
    part, all_ = Part(edge_radius=3.0), replace(SCORING, bounces="all")
    found = bench.compare(
        "robust designs with rounded crests, 4 varied",
        {
            "all reflections": lambda: optimum(part, BOUNDS, all_, Workers()),
            "two reflections": lambda: optimum(part, BOUNDS, replace(all_, bounces=2), Workers()),
            "direct light": lambda: optimum(part, BOUNDS, SCORING, Workers()),
        },
        rounds=1,
        warm=False,
    )
    best = found["all reflections"].result
    bench.note(
        f"{best.evaluations} designs; score of the optimum {best.scored.score:.5f}, from the table {best.hills[0]:.5f}"
    )
    assert best.hills[0] == pytest.approx(best.scored.score, rel=2e-3)
