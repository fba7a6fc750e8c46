"""Local defects where the scatter of the cells is that of every part."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.decision.decision import decide
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES
from anisoscope.diagnosis.cell_levels import SMEARS, STEP, CellLevels, Deviating, SmearedLevels
from anisoscope.diagnosis.part_diagnosis import explain
from anisoscope.diagnosis.signature_cache import _packed, _unpacked, cached_signatures
from anisoscope.diagnosis.signatures import signatures
from anisoscope.imaging.deviation_map import CALM_UM, CellScatter, cell_map
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.relief import Relief, radiance_maps
from detection_study.product import LIGHT_DEG, Size, recipe_of

ALPHA, TEXTURE, ANGLE_DEG, PITCH_UM, PIXEL_UM = 0.095, 0.03, 15.0, 100.0, 2.5
CELL_ROWS, CELL_COLS, CELL_POINTS = 32, 80, 10
COVERAGE = 0.05


@pytest.fixture(scope="module")
def recipe():
    """A pale plastic with steep ridges: ln ratios of 0.4 at most."""
    found = recipe_of("standard", Size())
    design = found.surface.design.model_copy(update={"ridge_angle_deg": ANGLE_DEG})
    pale = {"albedo": 0.25, "alpha_along": ALPHA, "alpha_across": ALPHA, "u_tail": 0.0}
    return found.model_copy(
        update={
            "surface": found.surface.model_copy(update={"design": design, "reflections": "direct"}),
            "material": found.material.model_copy(update=pale),
        }
    )


@pytest.fixture(scope="module")
def few(recipe):
    """The causes of the plastic, of which burrs are looked for, from the cache."""
    known = signatures(recipe, LIGHT_DEG, names=("burrs",))
    causes = replace(PLASTIC_CAUSES, signatures=lambda *_: known)
    cached_signatures(recipe, LIGHT_DEG, causes=causes)
    return replace(PLASTIC_CAUSES, signatures=lambda *_: pytest.fail("stored before"))


@pytest.fixture(scope="module")
def marks(recipe):
    """Signatures of burrs and dust."""
    return signatures(recipe, LIGHT_DEG, names=("burrs", "dust"))


def pictures_of_part(recipe, coverage):
    """(P, rows, cols) radiances of a rough part; the texture is no part of its lobe."""
    rng = np.random.default_rng(1)
    shape = CELL_ROWS * CELL_POINTS + 1, CELL_COLS * CELL_POINTS + 1
    surface = ridges(recipe.surface.ridge_design(), shape, (PIXEL_UM, PIXEL_UM))
    surface = add_facet_roughness(surface, TEXTURE, TEXTURE, 8.0, rng)
    if coverage:
        surface = inject_defect(surface, "burrs", rng, values={"coverage": coverage})
    whole = recipe.material.material()
    along, across = (float(np.sqrt(one**2 - TEXTURE**2)) for one in (whole.alpha_along, whole.alpha_across))
    lobe = replace(whole, alpha_along=along, alpha_across=across)
    sides = directions(recipe.poses.poses(), Convention(LIGHT_DEG))
    return np.array(list(radiance_maps(Relief(surface, PITCH_UM, max_missing_share=1.0), *sides, lobe)))


def cells_of(maps):
    """(P, rows, cols) cells of such pictures."""
    blocks = maps.reshape(len(maps), CELL_ROWS, CELL_POINTS, CELL_COLS, CELL_POINTS)
    return blocks.mean(axis=(2, 4), dtype=np.float64)


def cells_of_part(recipe, coverage):
    return cells_of(pictures_of_part(recipe, coverage))


def measured(cells, radiance):
    """Such a part; the means are those of a part whose texture is in its lobe, and of its burrs."""
    component = Component("flat field", "measurement", np.full(len(radiance), 0.004), shared=False)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    return Measured(radiance, (component,), (), cells, np.full(len(radiance), 0.005), grid, 0.0)


def test_burrs_are_named_by_the_scatter_of_the_cells(recipe, few):
    expected = expectation(recipe, LIGHT_DEG)
    good, burred = (cells_of_part(recipe, coverage) for coverage in (0.0, COVERAGE))
    means = [cells.mean(axis=(1, 2)) for cells in (good, burred)]
    told = []
    for cells, mean in zip((good, burred), means, strict=True):
        seen = measured(cells, expected.radiance * mean / means[0])
        decided = decide(expected, seen, recipe, exclude=False)
        found, note = explain(recipe, expected, seen, decided, causes=few)
        assert note is None
        told.append((decided.verdict, found))
    (of_good, nothing), (of_burred, found) = told
    assert (of_good, of_burred) == ("PASS", "FAIL")
    assert nothing.causes == ()
    first = found.causes[0]
    assert first.cause == "burrs"
    assert abs(first.severity - COVERAGE) < 2.0 * first.u


@pytest.mark.parametrize("coverage", [0.02, 0.1, 0.2])
def test_pictures_and_prediction_count_the_same_cells(recipe, marks, coverage):
    """The share by D² is that of the predicted map by the scatter of the part, so that it states severities."""
    maps = pictures_of_part(recipe, coverage).astype(np.float32)
    cells = cells_of(maps)
    seen = measured(cells, cells.mean(axis=(1, 2)))
    grid = Grid((0.0, 0.0), PIXEL_UM / 1000.0, maps.shape[1:])
    found = cell_map(replace(seen, aligned=tuple(maps), grid=grid), recipe)
    scatter = CellScatter(found.covariance, np.expm1(found.limit))
    known = marks.by_scatter(scatter, CALM_UM / PITCH_UM, found.score.size)
    predicted = known.found[0].at(coverage)[1]
    scatter = known.found[0].share_scatter(coverage)
    assert abs(found.deviating().mean() - predicted) < 2.0 * np.hypot(0.15 * predicted, np.sqrt(scatter))


def test_texture_seen_off_the_mirror_direction_is_no_defect():
    """At tilts good cells scatter by more than any fixed threshold that marks exceed."""
    tilted = recipe_of("tilted", Size())
    shares = {}
    for coverage in (0.0, 0.02):
        cells = cells_of_part(tilted, coverage)
        seen = measured(cells, cells.mean(axis=(1, 2)))
        shares[coverage] = cell_map(seen, tilted).deviating().mean()
    assert shares[0.0] < 0.015
    assert shares[0.02] > 0.02


def test_cells_deviate_by_d_squared_and_whole_lines_only_where_they_do(rng):
    """A line off its neighbours counts with what its cells deviate by where it deviates itself, and not else."""
    logs = rng.normal(0.0, 0.06, (3, 8, 40))
    logs[1, :, 17] += 0.4
    logs[1, :, 24] += 0.1
    covariance = np.diag([0.07, 0.06, 0.05]) ** 2 + 0.001
    levels = CellLevels.of(logs, 1)
    for most in (6.0, 20.0):
        alone = logs - np.median(logs, axis=1, keepdims=True)
        alone[1, :, 17] += STEP * levels.lines[1, 17]
        squares = np.einsum("pij,pq,qij->ij", alone, np.linalg.inv(covariance), alone)
        over = levels.deviating(CellScatter(covariance, most))
        clear = np.abs(np.sqrt(squares) - np.sqrt(most)) > 0.5 * STEP * np.sqrt(3.0) / 0.05
        np.testing.assert_array_equal(over[clear], (squares > most)[clear])
        assert over[:, 17].all()
        assert over[:, 24].mean() < 0.5
    assert STEP * levels.lines[1, 17] == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize("poses", [2, 3, 9])
def test_even_scatter_has_the_threshold_that_is_asked_for(rng, poses):
    pairs = [(k, k + 1) for k in range(poses - 1)]
    np.testing.assert_allclose(CellScatter.even(0.3, poses).thresholds(pairs), 0.3)
    normal = 0.02 * rng.normal(size=(poses, 60, 80))
    texture = CellScatter.of_texture(normal)
    assert texture.deviating(normal).mean() < 1e-3
    assert texture.deviating(normal + 0.5).all()


def test_a_grain_much_smaller_than_a_cell_is_hidden_by_a_smeared_picture():
    """The light of a pixel-sized spot is spread as by a Gaussian; what a large mark changes is not."""
    fine = np.ones((2, 64, 64))
    fine[0, 17:19, 17:19] = 0.0  # a quarter of a cell, as dark as one grain counts
    fine[0, 40:56, 40:56] = 0.5  # 4 by 4 cells
    levels, scatter = SmearedLevels.of(fine, 4), CellScatter(0.01 * np.eye(2), 0.3**2 / 0.01)
    sharp, between, smeared = (levels.deviating(scatter, one) for one in (0.0, SMEARS[1] / 2.0, SMEARS[1]))
    assert levels.cells == 256
    assert sharp.share == 17 / 256
    assert sharp.variance == (16**2 + 1) / 256**2
    assert smeared.share == 16 / 256
    assert between.share == pytest.approx((0.75 * 17 + 0.25 * 16) / 256)  # by the square of the smear
    assert between.form.groups == 2
    assert levels.deviating(CellScatter(0.01 * np.eye(2), 300.0), 0.05).form is None


def test_marks_scatter_by_their_number(rng):
    """The variance of the share is that of maps with as many marks, each of two cells, at random."""
    shares, stated = [], []
    for _ in range(400):
        over = np.zeros((40, 61), dtype=bool)
        for _ in range(rng.poisson(12)):
            row, col = rng.integers(40), 3 * rng.integers(20)
            over[row, col : col + 2] = True
        found = Deviating.of(over)
        shares.append(found.share)
        stated.append(found.variance)
    assert np.mean(stated) == pytest.approx(np.var(shares), rel=0.25)


EVEN = CellScatter.even(0.3, 3)


def test_the_uncertainty_of_a_share_is_that_of_both_maps_that_are_counted(marks):
    known = replace(marks, found=marks.found[1:])
    (alone,), (small,) = (known.by_scatter(EVEN, cells=one).found for one in (None, known.levels.cells))
    (sharp,) = known.by_scatter(EVEN, 0.0).found
    assert sharp.at(150.0)[1] > 1.2 * alone.at(150.0)[1] > 0.0
    more = small.share_scatter(150.0) - alone.share_scatter(150.0)
    counted = known.found[0].levels[2].deviating(EVEN, 0.08).variance
    assert known.found[0].extents[2] < 150.0
    assert more > counted > 0.0


def test_signatures_state_the_form_of_their_marks_by_the_scatter_of_a_part(recipe, marks):
    """Burrs are at the crests and extend along them; dust is anywhere. Stored signatures say the same."""
    again = _unpacked(_packed(marks), recipe, PLASTIC_CAUSES)
    for found in (marks, again):
        burrs, dust = found.by_scatter(EVEN).found
        at_crests, along, _ = burrs.form_at(0.05)
        anywhere, alone, _ = dust.form_at(200.0)
        assert at_crests > 0.9
        assert anywhere < 0.7
        assert along > 0.6
        assert alone < 0.3
    assert np.isnan(
        marks.by_scatter(CellScatter.even(2.0, 3)).found[1].form_at(20.0)
    ).all()  # nothing deviates so much
