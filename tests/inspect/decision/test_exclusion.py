"""Limits of named defects by any model: closed forms, a model with two minima, verdicts, and sentences."""

import numpy as np
import pytest

from anisoscope.decision.exclusion import (
    ONE_SIDED,
    Exclusion,
    excluded_by_model,
    excluded_text,
    of_curve,
    of_normal,
    open_text,
    planned,
    planned_text,
    with_exclusions,
)
from anisoscope.recipe.named_defect import NamedDefect
from anisoscope.record.verdict import Verdict

LOSS = NamedDefect("height loss ", 10.0, "%")
ANGLE = NamedDefect("ridge angle +", 0.5, "°")
SHIFT, SLOPE = np.array([0.05, -0.03, 0.01]), np.array([[0.02, 0.0], [0.01, 0.02], [0.0, 0.01]])
OWN = 0.01**2 * np.eye(3)


class Line:
    """Two inputs that act linearly besides a defect."""

    sources, farthest = ("a", "b"), np.full(2, 8.0)

    def __init__(self, offset):
        self.offset = offset

    def change(self, z):
        return self.offset + z @ SLOPE.T

    def tangent(self, z):
        return np.broadcast_to(SLOPE, (*np.shape(z)[:-1], *SLOPE.shape))


class Linear:
    defects = (LOSS,)

    def with_defect(self, defect, extent):
        assert defect is LOSS
        return Line(extent * SHIFT)


class Well:
    """One input; what it shows has a second minimum of the misfit far from the nominal state."""

    sources, farthest = ("a",), np.array([8.0])

    def __init__(self, extent):
        self.extent = extent

    def change(self, z):
        a = np.asarray(z)
        return 0.3 * self.extent * np.exp(-((a - 1.2) ** 2) * 4.0) - 0.3 * self.extent * np.ones_like(a)

    def tangent(self, z):
        a = np.asarray(z)
        return (-8.0 * (a - 1.2) * 0.3 * self.extent * np.exp(-((a - 1.2) ** 2) * 4.0))[..., None]


@pytest.mark.parametrize("extent", [-0.5, 0.0, 0.7])
def test_the_limit_of_a_linear_model_is_that_of_its_normal_likelihood(extent):
    deviation = extent * SHIFT + [0.004, -0.002, 0.003]
    (found,) = excluded_by_model(Linear(), deviation, OWN)
    weight = np.linalg.inv(OWN + SLOPE @ SLOPE.T)
    u = 1.0 / np.sqrt(SHIFT @ weight @ SHIFT)
    best = SHIFT @ weight @ deviation * u**2
    tried = np.linspace(0.0, 4.0, 4001)
    within = (tried - best) ** 2 <= (max(best, 0.0) - best) ** 2 + (ONE_SIDED * u) ** 2
    # the least value tried is above the minimum, so that the limit is too large rather than too small
    assert found.limit == pytest.approx(tried[within].max() + 0.02, abs=0.04)
    assert found.excluded == (found.limit <= 1.0)
    assert found.best == pytest.approx(max(best, 0.0), abs=0.05)


def test_a_blind_model_excludes_no_size():
    class Blind(Linear):
        def with_defect(self, defect, extent):
            del defect
            return Line(1e-6 * extent * SHIFT)

    (found,) = excluded_by_model(Blind(), np.zeros(3), OWN)
    assert found.limit == np.inf
    assert found.limit_text == "any size"


def test_a_size_of_interest_is_tried_from_more_than_one_state():
    """A state with the defect that no step from the state before reaches is the nearer one."""

    class TwoMinima:
        defects = (ANGLE,)

        def with_defect(self, defect, extent):
            del defect
            return Well(extent)

    (found,) = excluded_by_model(TwoMinima(), np.zeros(1), np.array([[0.02**2]]))
    direct = [
        min(a**2 + (Well(1.0).change(np.array([a]))[0] / 0.02) ** 2 for a in np.linspace(-3.0, 3.0, 6001))
    ]
    assert direct[0] < ONE_SIDED**2  # the model cannot exclude it
    assert not found.excluded


def test_limits_of_a_curve_are_read_between_its_values():
    extents = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0])
    found = of_curve(LOSS, ((extents - 0.2) / 0.3) ** 2, extents)
    assert found.best == pytest.approx(0.2, abs=0.01)
    assert found.limit == pytest.approx(0.2 + ONE_SIDED * 0.3, abs=0.01)


def test_an_open_defect_undoes_a_pass_only_where_the_recipe_says_so():
    closed, left = of_normal(LOSS, 0.1, 0.2), of_normal(ANGLE, 0.4, 0.6)
    why = ("nothing deviates",)
    asked = with_exclusions(Verdict.PASS, why, (closed, left), "inconclusive", "more poses")
    assert asked == (
        Verdict.INCONCLUSIVE,
        (
            "not excluded: ridge angle +0.5° (up to 0.69°): more poses, or state larger sizes in [defects]",
            *why,
        ),
    )
    assert with_exclusions(Verdict.PASS, why, (closed, left), "note", "") == (Verdict.PASS, why)
    passed = with_exclusions(Verdict.PASS, why, (closed,), "inconclusive", "")
    assert passed == (Verdict.PASS, (*why, "excluded with 95% confidence: height loss 4.3%"))
    assert with_exclusions(Verdict.FAIL, why, (left,), "inconclusive", "") == (Verdict.FAIL, why)
    unknown = with_exclusions(Verdict.PASS, why, (), "inconclusive", "", "no defect is excluded")
    assert unknown == (Verdict.INCONCLUSIVE, ("no defect is excluded", *why))
    assert with_exclusions(Verdict.PASS, why, (), "note", "", "unknown") == (Verdict.PASS, why)


def test_sentences_name_sizes_in_the_unit_of_the_defect():
    found = (Exclusion(ANGLE, 0.1, 0.86), Exclusion(LOSS, 0.0, np.inf))
    assert excluded_text(found) == "excluded with 95% confidence: ridge angle +0.43°"
    assert open_text(found, "add parts").startswith("not excluded: height loss 10% (any size): add parts, or")
    assert "height loss 10% (up to 18%)" in open_text((Exclusion(LOSS, 0.2, 1.8),), "")
    at = Exclusion(LOSS, 0.2, 1.8, "row 3 column 1")
    assert "height loss 10% (up to 18% at row 3 column 1)" in open_text((at,), "")
    assert at.record().place == " at row 3 column 1"
    assert excluded_text((Exclusion(LOSS, 0.2, 1.8),)) == ""


def test_a_planned_limit_is_that_of_the_worst_case():
    cases = [(Exclusion(LOSS, 0.0, 0.4), Exclusion(ANGLE, 0.0, np.inf)), (Exclusion(LOSS, 0.0, 0.9),) * 2]
    loss, angle = planned(cases)
    assert (loss.best, loss.worst, loss.excluded) == ("4%", "9%", True)
    assert (angle.worst, angle.excluded) == ("any size", False)
    (line,) = planned_text((loss, angle), "add parts")
    assert line.startswith("a part as designed excludes height loss 10%; not excluded")
    assert planned_text((), "") == ()
    assert planned_text((loss,), "")[0].endswith("good parts can PASS by the prediction alone")
