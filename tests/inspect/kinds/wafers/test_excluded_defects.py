"""Limits of depth and width of wafers: parts drawn by the model itself, with every input as uncertain as stated."""

import json
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.significance import log_basis
from anisoscope.decision.consistency import contrast_covariance
from anisoscope.decision.decision import decide
from anisoscope.decision.exclusion import ONE_SIDED
from anisoscope.decision.reference_parts import GoldenPart
from anisoscope.decision.surface_exclusion import excluded_by_states, planned_limits
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds.surface_reference import golden_record
from anisoscope.kinds.wafers.kind import OPTICS, WAFERS, WaferSet
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.kinds.wafers.states import DEPTH, WIDTH
from anisoscope.operations.demo import wafers as demo
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.prediction.profile_likelihood import Combined, nearest_costly
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.verdict import Verdict
from anisoscope.rig.rigfile import RigFile

SIDE_UM, NOISE = 64.0, 0.003


def wafer_recipe(folder, **changes):
    cells = np.random.default_rng(2).integers(0, 2, (32, 32))
    height = np.kron(cells, np.ones((8, 8))) * -0.13
    write_height_map(HeightMap(height, SIDE_UM / 256, SIDE_UM / 256), folder / "tile.npz")
    table = {
        "schema": 1,
        "product": "wafer",
        "surface": {"height_map": str(folder / "tile.npz"), "pitch_um": SIDE_UM},
        "material": {"reflectance": 0.9, "albedo": 0.002, "u_albedo": 0.0006},
        "light": {
            "wavelength_nm": 520.0,
            "bandwidth_nm": 10.0,
            "lamp_half_angle_deg": 0.6,
            "aperture_half_angle_deg": 1.4,
        },
        "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, 3.0]},
        "acquisition": {"exposure_s": 4e-5},
        "region": {"size_mm": [0.5, 0.5]},
        "decision": {"unexcluded": "inconclusive"},
        "defects": {"etch_depth_nm": 5.0, "etch_width_nm": 100.0},
        "uncertainty": {
            "seating_tilt_deg": 0.05,
            "light_angle_deg": 0.05,
            "tilt_deg": 0.02,
            "step_edges_nm": 20.0,
        },
    }
    return WaferRecipe.model_validate(table | changes)


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    return wafer_recipe(tmp_path_factory.mktemp("wafer"))


@pytest.fixture(scope="module")
def expected(recipe):
    return expectation(recipe, 0.0, OPTICS)


def seen(radiance):
    count = len(radiance)
    errors = (Component("noise", "measurement", np.full(count, NOISE), shared=False),)
    grid = Grid((0.0, 0.0), 0.025, (4, 4))
    return Measured(radiance, errors, (), np.ones((count, 1, 1)), np.zeros(count), grid, None)


class OneDefect:
    """States of which one defect is tried, which takes a quarter of the time."""

    def __init__(self, states, defect):
        self._states, self.defects = states, (defect,)

    def __getattr__(self, name):
        return getattr(self._states, name)


def drawn(expected, defect, rng):
    """A wafer with exactly the size of interest, and all else as uncertain as the recipe states."""
    states = expected.states.with_defect(defect, 1.0)
    off = states.change(rng.normal(size=len(states.sources)))
    return expected.radiance * np.exp(off + NOISE * rng.normal(size=len(off)))


def wrongly_excluded(expected, defect, count, rng):
    one = replace(expected, states=OneDefect(expected.states, defect))
    errors = seen(expected.radiance).components
    return sum(
        excluded_by_states(one, drawn(expected, defect, rng), errors)[0].excluded for _ in range(count)
    )


@pytest.mark.statistics
def test_wafers_with_exactly_the_size_of_interest_seldom_exclude_it(expected):
    rng = np.random.default_rng(4)
    wrong = sum(wrongly_excluded(expected, one, 2, rng) for one in expected.states.defects)
    assert wrong <= 2  # 0.4 are due at most


@pytest.mark.statistics
@pytest.mark.parametrize("place", range(4))
def test_rate_of_wrong_exclusions(expected, place):
    """5 % are due at most: the least value tried lies above the minimum, so that fewer parts exclude it."""
    wrong = wrongly_excluded(expected, expected.states.defects[place], 60, np.random.default_rng(place))
    assert wrong <= 7  # of 60; 3 are due, 7 are 2.4 standard deviations more


def test_limits_of_a_good_wafer_are_below_the_sizes_of_interest_and_those_are_found(recipe, expected):
    good = decide(expected, seen(expected.radiance), recipe)
    assert good.verdict is Verdict.PASS, good.reasons
    assert good.reasons[-1].startswith("excluded with 95% confidence: etched too deep by ")
    assert len(good.exclusions) == 4
    planned = planned_limits(expected, None, recipe, NOISE)
    assert [one.worst for one in planned] == [one.limit_text for one in good.exclusions]
    assert all(one.excluded for one in planned)


def test_poses_that_do_not_show_the_depth_leave_a_wafer_undecided(tmp_path):
    """Both poses see the mirror direction: depth and width change them alike."""
    blind = wafer_recipe(tmp_path, poses={"angles_deg": [0.0, 180.0], "tilts_deg": [0.0]})
    expected = expectation(blind, 0.0, OPTICS)
    found = decide(expected, seen(expected.radiance), blind)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.reasons[0].startswith("not excluded: etched too deep by 5 nm (any size), ")
    assert "further tilts" in found.reasons[0]
    assert all(np.isinf(one.limit) for one in found.exclusions)
    noted = blind.model_copy(update={"decision": blind.decision.model_copy(update={"unexcluded": "note"})})
    assert decide(expected, seen(expected.radiance), noted).verdict is Verdict.PASS


def test_no_start_finds_a_nearer_wafer_than_the_limit_rests_on(expected):
    """A wafer that excludes its defect: from no state of the inputs is the defect near it."""
    rng, basis = np.random.default_rng(7), log_basis(6)
    own = contrast_covariance(expected.outside_states + seen(expected.radiance).components, basis)
    for defect in expected.states.defects[::2]:
        curve = Combined(expected.states.with_defect(defect, 1.0), basis)
        good = Combined(expected.states.with_defect(defect, 0.0), basis)
        y = good.change(rng.normal(size=len(good.sources)))
        errors = seen(expected.radiance).components
        one = replace(expected, states=OneDefect(expected.states, defect))
        radiance = expected.radiance * np.exp(basis.T @ y)
        assert excluded_by_states(one, radiance, errors)[0].excluded
        nil = nearest_costly(good, y, own, np.zeros(len(good.sources)), settled=3e-3, farthest=good.farthest)
        for _ in range(4):
            start = 1.5 * rng.normal(size=len(curve.sources))
            left, _ = nearest_costly(curve, y, own, start, settled=3e-3, farthest=curve.farthest)
            assert left > nil[0] + ONE_SIDED**2


def test_a_state_with_a_defect_is_that_wafer(recipe, expected):
    deep, shallow, wide, narrow = expected.states.defects
    states = expected.states
    for defect, source, sign in (
        (deep, DEPTH, 1.0),
        (shallow, DEPTH, -1.0),
        (wide, WIDTH, 1.0),
        (narrow, WIDTH, -1.0),
    ):
        pinned = states.with_defect(defect, 0.5)
        assert source not in pinned.sources
        u = {DEPTH: recipe.uncertainty.etch_depth_nm, WIDTH: recipe.uncertainty.etch_width_nm}[source]
        z = (np.array(states.sources) == source) * sign * 0.5 * defect.size / u
        np.testing.assert_allclose(
            pinned.change(np.zeros(len(pinned.sources))), states.change(z.astype(float)), atol=2e-3
        )


def test_a_record_without_sizes_is_judged_as_it_was(recipe):
    table = recipe.model_dump(mode="json", by_alias=True)
    assert WAFERS.as_recorded(recipe, table).defects.of_wafers == recipe.defects.of_wafers
    del table["defects"]["etch_depth_nm"], table["defects"]["etch_width_nm"]
    assert WAFERS.as_recorded(recipe, table).defects.of_wafers == ()


def test_wafers_of_a_lot_show_which_one_is_bad(recipe, expected):
    """Four of unknown quality: the one that is 20 nm too deep fails, and is no reference for the others."""
    rng, states = np.random.default_rng(4), expected.states
    varies = np.array([one.startswith(WaferSet.varies) for one in states.sources])
    shared = rng.normal(size=len(varies))
    deep = states.with_defect(states.defects[0], 20.0 / recipe.defects.etch_depth_nm)
    off = [states.change(np.where(varies, rng.normal(size=len(varies)), shared)) for _ in range(4)]
    off.insert(0, deep.change(np.zeros(len(deep.sources))))
    made = [expected.radiance * np.exp(one + NOISE * rng.normal(size=len(one))) for one in off]
    rows = [
        GoldenPart(
            serial=str(k),
            inspected_at="",
            log_radiance=tuple(np.log(one)),
            area_share=None,
            verdict="PASS",
            unlabelled=True,
        )
        for k, one in enumerate(made)
    ]
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)

    def judged(number, parts):
        others = tuple(row for row in rows[:parts] if row.serial != str(number))
        lot = WaferSet(product="wafers", recipe_key="", poses=poses, lot="W-1", parts=others)
        return WAFERS.decide(None, recipe, expected, seen(made[number]), lot)

    assert judged(1, 3).golden == 0  # two others are too few
    assert judged(0, 5).verdict is Verdict.FAIL
    good = judged(1, 5)
    assert good.p_value > 1e-3
    assert "compared with 3 other parts of lot W-1 (without 0, unlike the others)" in good.reasons[-1]
    whole = WaferSet(product="wafers", recipe_key="", poses=poses, parts=tuple(rows))
    rig = RigFile.model_validate(demo.rig("good"))
    kept, left_out = WAFERS.without_odd_parts(whole, recipe, {(str(k), "") for k in range(5)}, rig)
    assert ([row.serial for row in kept.parts], left_out, kept.unjudged) == (list("1234"), ["0"], 4)


@pytest.mark.parametrize("count", [3, 5, 6, 7, 25])
def test_golden_wafers_serve_from_three_on_in_any_number(recipe, expected, count):
    """Good ones vary in etching and seat; one more is like them, and one that is 20 nm too deep is not."""
    rng, states = np.random.default_rng(count), expected.states
    varies = np.array([one.startswith(WaferSet.varies) for one in states.sources])
    shared = rng.normal(size=len(varies))

    def good():
        off = states.change(np.where(varies, rng.normal(size=len(varies)), shared))
        return expected.radiance * np.exp(off + NOISE * rng.normal(size=len(off)))

    rows = tuple(
        GoldenPart(
            serial=str(k),
            inspected_at="",
            log_radiance=tuple(np.log(good())),
            area_share=None,
            verdict="PASS",
        )
        for k in range(count)
    )
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)
    golden = WaferSet(product="wafers", recipe_key="", poses=poses, parts=rows)
    assert golden.lacking is None
    one = seen(good())
    found = decide(expected, one, recipe, golden, exclude=False)
    assert found.p_value > 1e-3
    assert np.isfinite(json.loads(golden_record(golden, one, found).model_dump_json())["measured"]).all()
    deep = states.with_defect(expected.states.defects[0], 20.0 / recipe.defects.etch_depth_nm)
    wrong = seen(expected.radiance * np.exp(deep.change(np.zeros(len(deep.sources)))))
    assert decide(expected, wrong, recipe, golden, exclude=False).p_value < 1e-3
