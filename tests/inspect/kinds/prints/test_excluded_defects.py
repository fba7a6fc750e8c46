"""Limits of the defects of prints: prints drawn by the ink model, with every input as uncertain as stated."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.excluded_defects import excluded_of
from anisoscope.kinds.prints.expectation import rig_sources
from anisoscope.kinds.prints.kind import PRINTS
from anisoscope.kinds.prints.lobe_fit import fit_print
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.recipe_check import check_print_recipe
from anisoscope.kinds.prints.sources import of_each, total
from anisoscope.record.verdict import Verdict

BY_MODEL = {"c of the ink", "substrate", "light angle", "zero of the tilt"}


def states(sizes, turn):
    """State of a print with exactly the size of interest, by the beginning of the defect's name."""
    brush, lean = np.log1p(sizes.brushed_share), sizes.lean_deg
    return {
        "flakes less flat": State(alpha=np.log1p(sizes.roughness_share)),
        "flakes flatter": State(alpha=-np.log1p(sizes.roughness_share)),
        "brushed": State(ratio=brush * np.cos(turn), skew=brush * np.sin(turn)),
        "flakes lean": State(tilt_x_deg=lean * np.cos(turn), tilt_y_deg=lean * np.sin(turn)),
        "ink missing": State(missing=sizes.missing_share),
        "film thicker": State(shift_nm=sizes.film_nm),
        "film thinner": State(shift_nm=-sizes.film_nm),
        "synthetic red": State(other=sizes.wrong_ink_share),
        "synthetic blue": State(other=sizes.wrong_ink_share),
    }


def drawn(recipe, expected, rng, name=""):
    """(N,) ln of the channels of a print: uncertain inputs by the model, errors of the rig by their factors."""
    part, rig, z = recipe.print, recipe.uncertainty, rng.normal
    found = states(recipe.defects, rng.uniform(0.0, 2.0 * np.pi))
    key = next((one for one in found if name.startswith(one)), None)
    state = State() if key is None else found[key]
    ink = next((one for one in part.read_wrong_inks() if name.startswith(one.name)), None)
    known = part.of_ink(expected.scene.ink)
    level = known.rho_share * z()
    more = {
        "alpha": 0.0 if name.startswith(("flakes less", "flakes fl")) else known.alpha_share * z(),
        "c": known.c * z(),
        "lobe": known.lobe * z(),
        "substrate": part.u_substrate * z(),
        "light_angle_deg": rig.light_angle_deg * z(),
        "arm_deg": rig.tilt_zero_deg * z(),
        "seat_x_deg": rig.seating_tilt_deg * z(),
        "seat_y_deg": rig.seating_tilt_deg * z(),
        **{colour: level + known.colour_share * z() for colour in ("red", "green", "blue")},
    }
    made = replace(state, **{key: getattr(state, key) + value for key, value in more.items()})
    logs = replace(expected.scene, other=ink).log_channels(made)
    for source in (*expected.common, *rig_sources(recipe, expected)):
        if source.name not in BY_MODEL:
            logs = logs + source.factor @ z(size=source.factor.shape[1])
    return logs


def limits(recipe, expected, logs):
    sources = (*expected.sources, *rig_sources(recipe, expected))
    fit = fit_print(expected.scene, logs, (*expected.common, *rig_sources(recipe, expected)))
    off = logs - np.log(expected.channels).ravel()
    return {
        one.defect.name: one
        for one in excluded_of(recipe, expected, fit, off, total(sources, logs.size), golden=False)
    }


def wrongly_excluded(recipe, expected, name, count, rng):
    found = [limits(recipe, expected, drawn(recipe, expected, rng, name))[name] for _ in range(count)]
    return sum(one.excluded for one in found)


def seen(recipe, expected, logs):
    channels = np.exp(logs).reshape(-1, 3)
    noise = of_each("noise", "measurement", np.full(channels.size, 1e-4))
    return MeasuredPrint(
        channels, channels[:, :, None, None], np.zeros_like(channels), (noise,), cell_grid(recipe), None
    )


@pytest.fixture(scope="module")
def strict(make_recipe, predict):
    """A recipe that lets no print pass with a defect of interest; without the map."""
    recipe = make_recipe(decision={"unexcluded": "inconclusive"})
    recipe = recipe.model_copy(update={"area": None})
    return recipe, predict(recipe)


def test_a_good_print_excludes_every_defect(strict):
    recipe, expected = strict
    rng = np.random.default_rng(2)
    for _ in range(5):
        found = limits(recipe, expected, drawn(recipe, expected, rng))
        assert len(found) == 9
        assert all(one.excluded for one in found.values()), found
    decided = decide_print(expected, seen(recipe, expected, np.log(expected.channels).ravel()), recipe)
    assert decided.verdict is Verdict.PASS
    assert decided.reasons[-1].startswith("excluded with 95% confidence: flakes less flat by ")


@pytest.mark.statistics
def test_a_print_with_exactly_the_size_of_interest_seldom_excludes_it(strict):
    recipe, expected = strict
    rng, wrong = np.random.default_rng(3), 0
    for name in limits(recipe, expected, np.log(expected.channels).ravel()):
        wrong += wrongly_excluded(recipe, expected, name, 2, rng)
    assert wrong <= 4  # of 18; 0.9 are due


@pytest.mark.statistics
def test_rate_of_wrong_exclusions(strict):
    """5 % are due where all that is uncertain is linear about the defect."""
    recipe, expected = strict
    names = limits(recipe, expected, np.log(expected.channels).ravel())
    rng = np.random.default_rng(5)
    wrong = {name: wrongly_excluded(recipe, expected, name, 60, rng) for name in names}
    assert all(count <= MOST_WRONG for count in wrong.values()), wrong


MOST_WRONG = 8  # of 60; 3 are due, and 8 are 3 standard deviations more


def test_a_size_smaller_than_the_poses_show_leaves_a_print_undecided(strict):
    recipe, expected = strict
    small = recipe.defects.model_copy(update={"missing_share": 0.01, "lean_deg": 0.1})
    asked = recipe.model_copy(update={"defects": small})
    print_ = seen(asked, expected, np.log(expected.channels).ravel())
    decided = decide_print(expected, print_, asked)
    assert decided.verdict is Verdict.INCONCLUSIVE
    assert decided.reasons[0].startswith("not excluded: ink missing 1% (up to ")
    noted = asked.model_copy(update={"decision": asked.decision.model_copy(update={"unexcluded": "note"})})
    assert decide_print(expected, print_, noted).verdict is Verdict.PASS
    planned = check_print_recipe(asked, expected)
    assert {one.defect for one in planned.excludes if not one.excluded} == {
        "ink missing 1%",
        "flakes lean by 0.1°",
    }
    assert any(
        "not excluded" in one.text and "ink missing 1% (up to " in one.text for one in planned.findings
    )


def test_a_print_that_deviates_within_its_limits_has_no_limits_of_defects(strict):
    recipe, expected = strict
    off = expected.scene.log_channels(State(ratio=0.1))
    wide = dict.fromkeys(type(recipe.tolerances).model_fields, 1000.0)
    asked = recipe.model_copy(update={"tolerances": recipe.tolerances.model_copy(update=wide)})
    decided = decide_print(expected, seen(asked, expected, off), asked)
    assert (decided.verdict, decided.exclusions) == (Verdict.INCONCLUSIVE, ())
    assert decided.reasons[0].startswith("no defect is excluded, because the print deviates")


def test_a_record_without_sizes_is_judged_as_it_was(good):
    recipe, _ = good
    table = recipe.model_dump(mode="json", by_alias=True)
    assert PRINTS.as_recorded(recipe, table).defects == recipe.defects
    del table["defects"]
    unsized = PRINTS.as_recorded(recipe, table).defects
    assert set(unsized.model_dump().values()) == {None}
