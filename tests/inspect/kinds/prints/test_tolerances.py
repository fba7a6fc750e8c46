"""A good print teaches exposure, region and tolerances."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.inspection.teach import teach
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import rig_sources
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import PrintDetails
from anisoscope.kinds.prints.sources import total
from anisoscope.kinds.prints.tolerances import (
    KEYS,
    _measured,
    _reached,
    _Spread,
    golden_tolerances,
    taught_tolerances,
)
from anisoscope.record.schema import read_record
from anisoscope.record.verdict import Verdict
from anisoscope.sim.materials.inks import synthetic_ink


def test_a_good_print_teaches_its_recipe(print_rig, plain):
    untaught = {"acquisition": {"exposure_s": 0.0004}, "region": {"size_mm": [0.4, 0.4]}}
    recipe_path, rig_path = print_rig.lay_out({}, recipe=untaught)
    before = recipe_path.read_text()
    found = teach(recipe_path, rig_path, "GOOD-1", print_rig.folder / "inspections", methods=plain)
    recipe, record = PrintRecipe.read(recipe_path), read_record(found.folder)
    assert (recipe.version, found.version, found.kept.read_text()) == (2, 2, before)
    # the sheet is 2.4 mm wide; a cell of 0.2 mm stays away from its edge
    assert recipe.region.size_mm[0] == recipe.region.size_mm[1]
    assert 1.6 <= recipe.region.size_mm[0] <= 2.2
    assert 0.002 < recipe.acquisition.exposure_s < 0.008
    frame_level = max(pose.measured for pose in record.poses)
    assert frame_level > 0.0
    limits = recipe.tolerances.model_dump()
    for one in record.details.quantities:
        limit = limits[KEYS[one.name]]
        assert limit >= 8.0 * one.u
        assert abs(one.deviation) + 1.645 * one.u < limit
    assert {change.key for change in found.changes} == {
        "acquisition.exposure_s",
        "region.size_mm",
        *(f"tolerances.{name}" for name in limits),
    }
    assert not list(recipe_path.parent.glob(".*.toml"))


def test_tolerances_are_rounded_up_and_cover_the_print(make_recipe):
    quantities = [
        SimpleNamespace(name="delta_e", u=0.11, deviation=0.9),
        SimpleNamespace(name="alpha x", u=0.0101, deviation=0.002),
        SimpleNamespace(name="alpha y", u=0.005, deviation=-0.1),
    ]
    record = SimpleNamespace(details=PrintDetails.model_construct(quantities=quantities))
    found = taught_tolerances(record, make_recipe(tolerances={"alpha_share": 0.06}))
    assert {key: one.value for key, one in found.items()} == {"delta_e": 1.3, "alpha_share": 0.12}
    assert found["alpha_share"].why.endswith("; WIDER than the stated 0.06")
    assert found["delta_e"].why.startswith("4 times the expanded uncertainty")
    assert "WIDER" not in found["delta_e"].why


@pytest.mark.parametrize(("count", "mean", "u"), [(10, 0.0, 0.0), (27, 0.0, 0.4), (10, 3.0, 0.0)])
def test_one_more_good_print_exceeds_what_golden_prints_reach_as_rarely_as_said(count, mean, u):
    """Normal deviations, and lengths of vectors in a plane; u is an error that all prints of a set share."""
    rng, alpha, trials = np.random.default_rng(7), 0.05, 3000
    off = mean + rng.standard_normal((trials, count + 1)) + u * rng.standard_normal((trials, 1))
    later = off[:, -1] + u * rng.standard_normal(trials)  # after the next calibration
    over = [
        abs(own - known.mean()) > _reached("gain", _Spread(known, 0.0, 2.0**0.5 * u), alpha)
        for known, own in zip(off[:, :-1], later, strict=True)
    ]
    assert 0.2 * alpha < np.mean(over) < 1.25 * alpha
    lengths = np.hypot(*rng.standard_normal((2, trials, count + 1)))
    over = [row[-1] > _reached("tilt", _Spread(row[:-1], 0.0, 0.0), alpha) for row in lengths]
    assert 0.5 * alpha < np.mean(over) < 1.5 * alpha


SPREAD = {"alpha": 0.01, "ratio": 0.005, "skew": 0.005, "tilt_x_deg": 0.05, "tilt_y_deg": 0.05, "lobe": 0.02,
          "shift_nm": 0.3}  # fmt: skip
LISTED = (
    {"alpha": np.log(1.10)},
    {"missing": 0.10},
    {"ratio": np.log(1.15)},
    {"tilt_x_deg": 0.6, "tilt_y_deg": -0.8},
    {"shift_nm": 10.0},
    {"other": 0.05},
)


def test_good_prints_pass_limits_that_golden_prints_teach_and_defects_fail(make_recipe, predict, golden_of):
    """A house whose level varies by 1 %, measured by a rig that is off by what its uncertainties say."""
    recipe = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area=None)
    expected, rng = predict(recipe), np.random.default_rng(12)
    covariance = total(rig_sources(recipe, expected), expected.channels.size)
    of_rig = np.linalg.cholesky(covariance) @ rng.standard_normal(len(covariance))
    scene = replace(expected.scene, other=synthetic_ink("synthetic-red"))

    def drawn(more=None):
        changes = {name: s * rng.standard_normal() for name, s in SPREAD.items()}
        changes |= dict.fromkeys(("red", "green", "blue"), 0.01 * rng.standard_normal())
        for name, value in (more or {}).items():
            changes[name] = changes.get(name, 0.0) + value
        return scene.log_channels(State(**changes)) + of_rig + 0.001 * rng.standard_normal(of_rig.size)

    golden = golden_of(recipe, expected, [drawn() for _ in range(15)])
    limits = golden_tolerances(golden, recipe, expected)
    assert set(limits) == {"alpha_share", "ln_ratio", "gain_share", "chromaticity", "tilt_deg", "delta_e"}
    for key, one in limits.items():
        assert one.why.startswith("15 golden prints: at least 95% of good prints pass")
        # nothing is stated in this recipe
        assert ("WIDER than the usual" in one.why) is (one.value > getattr(recipe.tolerances, key))
    new = {key: one.value for key, one in limits.items()}
    taught = recipe.model_copy(update={"tolerances": recipe.tolerances.model_copy(update=new)})

    def judged(logs):
        return decide_print(expected, _measured(logs, taught), taught, golden).verdict

    assert [judged(drawn()) for _ in range(16)].count(Verdict.PASS) >= 14  # 99 % pass
    assert {str(more): judged(drawn(more)) for more in LISTED} == {str(more): Verdict.FAIL for more in LISTED}
