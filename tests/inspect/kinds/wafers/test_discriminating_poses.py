"""What would tell causes of a wafer apart: against closed forms, and against the recipe's own separability."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from anisoscope.base.cache import VARIABLE
from anisoscope.base.progress import silent
from anisoscope.diagnosis import discriminating_poses as advice
from anisoscope.diagnosis.cause_model import Option
from anisoscope.diagnosis.discriminating_poses import advice_for, cached_options
from anisoscope.diagnosis.ranking import Diagnosis
from anisoscope.diagnosis.separability import planned_covariance, separability
from anisoscope.kinds.wafers import causes
from anisoscope.kinds.wafers.causes import (
    WAFER_CAUSES,
    second_lamps,
    wafer_options,
    wafer_signatures,
)
from anisoscope.kinds.wafers.kind import OPTICS
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.prediction.expectation import expectation
from anisoscope.record.schema import CauseRecord

DEPTHS = ("over-etch", "under-etch")


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """The demo's recipe with a tile of 64 µm."""
    folder = tmp_path_factory.mktemp("wafer")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("DOT_UM", 32.0), ("DOTS", 2), ("TILE_UM", 64.0)):
            patch.setattr(demo_wafer, name, value)
        demo_wafer.write_tile(folder, np.random.default_rng(2))
        table = demo_wafer.recipe()
        table["uncertainty"]["step_edges_nm"] = 0.0  # which hide small widths
        (folder / "recipe.toml").write_text(tomli_w.dumps(table))
    return WaferRecipe.read(folder / "recipe.toml")


@pytest.fixture(scope="module")
def options(recipe):
    """What would tell too deep from too shallow."""
    return wafer_options(recipe, 0.0, DEPTHS)


def of_kind(options, kind):
    return [option for option in options if option.kind == kind]


def test_the_square_of_the_depth_is_told_by_no_angle_but_by_another_wavelength(options):
    """|τ|² = sin²(2π·e/λ) is even in e at the wavelength of the design, cos²(2π·(λ/4 + e)/λ') at another is not."""
    (angles,) = of_kind(options, "angles")
    assert angles.separation_extents == {"over-etch": {"under-etch": None}, "under-etch": {"over-etch": None}}
    lamps = of_kind(options, "lamp")
    assert [option.says.split()[4] for option in lamps] == ["470", "450", "590", "625"]
    for option in lamps:
        for cause, other in (DEPTHS, DEPTHS[::-1]):
            assert option.separation_extents[cause][other] < 10.0


def test_a_tilt_tells_as_the_recipe_with_that_tilt_does(recipe, options):
    """The half vector of a tilted part stands askew, which is another wavelength; here by the whole prediction."""
    tilted = recipe.model_copy(
        update={"poses": recipe.poses.model_copy(update={"tilts_deg": (0.0, 3.0, 20.0)})}
    )
    known = wafer_signatures(tilted, 0.0, names=DEPTHS)
    covariance = planned_covariance(tilted, expectation(tilted, 0.0, OPTICS))
    rows = {row.cause: row for row in separability(known, covariance, with_map=False)}
    (option,) = (one for one in of_kind(options, "tilt") if "20°" in one.says)
    for cause, other in (DEPTHS, DEPTHS[::-1]):
        assert option.separation_extents[cause][other] == pytest.approx(
            rows[cause].separation_extents[other], rel=0.15
        )


def test_lamps_that_are_tried_stand_on_both_sides_and_are_no_neighbours():
    assert second_lamps(520.0) == (470.0, 450.0, 590.0, 625.0)
    assert second_lamps(900.0) == (660.0, 625.0)
    assert second_lamps(400.0) == (450.0, 470.0)


def tie(*causes, unexplained_p=0.5):
    """A diagnosis of tied causes, (name, severity) each, of which the first is the best."""
    found = tuple(
        CauseRecord(
            cause=name,
            title=f"{name}, by",
            unit="nm",
            severity=severity,
            u=0.1,
            weight=0.5,
            chi2=1.0,
            at_bound=False,
            tie=True,
        )
        for name, severity in causes
    )
    return Diagnosis(found, unexplained_p)


def told(**least):
    return {"a": least, "b": {"a": 4.0}, "c": {"a": 4.0}}


def test_the_advice_names_the_first_of_every_kind_that_tells_both_ways(recipe, monkeypatch):
    known = (
        Option("angles", "more angles", told(b=None, c=None)),
        Option("tilt", "a small tilt", told(b=8.0, c=None)),
        Option("tilt", "a large tilt", told(b=2.0, c=None)),
        Option("lamp", "a near lamp", told(b=3.0, c=None)),
        Option("lamp", "a far lamp", told(b=2.0, c=None)),
    )
    monkeypatch.setattr(advice, "cached_options", lambda *_: known)
    words = advice_for(recipe, 0.0, tie(("a", 5.0), ("b", 5.0)), causes=WAFER_CAUSES)
    assert words == "a large tilt, or a near lamp"
    assert (
        advice_for(recipe, 0.0, tie(("a", 9.0), ("b", -9.0)), causes=WAFER_CAUSES)
        == "a small tilt, or a near lamp"
    )
    both = advice_for(recipe, 0.0, tie(("a", 5.0), ("b", 5.0), ("c", 5.0)), causes=WAFER_CAUSES)
    assert both.startswith(
        "b: a large tilt, or a near lamp; c: nothing that was tried (more angles, a small tilt, "
    )
    for small in (("a", 1.0), ("b", 5.0)), (("a", 5.0), ("b", 1.0)):
        assert advice_for(recipe, 0.0, tie(*small), causes=WAFER_CAUSES).endswith(
            "at this size optics cannot"
        )


def test_there_is_nothing_to_advise_without_a_tie_or_an_explanation(recipe, monkeypatch):
    monkeypatch.setattr(advice, "cached_options", lambda *_: pytest.fail("was computed"))
    assert advice_for(recipe, 0.0, tie(("a", 5.0)), causes=WAFER_CAUSES) is None
    assert advice_for(recipe, 0.0, tie(("a", 5.0), ("nothing", 0.0)), causes=WAFER_CAUSES) is None
    assert (
        advice_for(recipe, 0.0, tie(("a", 5.0), ("b", 5.0), unexplained_p=1e-5), causes=WAFER_CAUSES) is None
    )


def test_options_are_kept_and_belong_to_their_recipe(recipe, options, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    asked = []

    def computed(*arguments):
        asked.append(arguments)
        return options

    causes = replace(WAFER_CAUSES, options=computed)
    assert cached_options(recipe, 0.0, DEPTHS, silent, causes) == options
    assert cached_options(recipe, 0.0, DEPTHS[::-1], silent, causes) == options
    assert len(asked) == 1
    other = recipe.uncertainty.model_copy(update={"etch_depth_nm": 2.0})
    cached_options(recipe.model_copy(update={"uncertainty": other}), 0.0, DEPTHS, silent, causes)
    cached_options(recipe, 0.0, ("over-etch", "scatter"), silent, causes)
    assert len(asked) == 3
    (kept, *_) = (tmp_path / "advice").iterdir()
    kept.write_text("[")
    for names in (DEPTHS, ("over-etch", "scatter")):
        assert cached_options(recipe, 0.0, names, silent, causes) == options


def test_every_cause_of_a_wafer_can_be_asked_for(recipe, monkeypatch):
    monkeypatch.setattr(causes, "FURTHER_TILTS_DEG", ())
    monkeypatch.setattr(causes, "LAMPS_NM", ())
    (angles,) = wafer_options(recipe, 0.0, ("width-bias", "scatter", "seating-x"))
    assert set(angles.separation_extents) == {"width-bias", "scatter", "seating-x"}
    assert angles.separation_extents["width-bias"]["scatter"] is not None
