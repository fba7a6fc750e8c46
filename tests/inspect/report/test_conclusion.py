"""Finding and action of a verdict in plain words, for every verdict, cause and kind."""

import numpy as np
import pytest

from anisoscope.diagnosis.cause_words import plastic_words, words_of
from anisoscope.diagnosis.causes import all_causes
from anisoscope.kinds.registry import kind_named, kind_names
from anisoscope.kinds.wafers.causes import WAFER_WORDS, wafer_causes
from anisoscope.profiles.etching import Etched
from anisoscope.record.surface_details import surface_of
from anisoscope.report.conclusion import OUTCOMES, concluded

PLASTIC_WORDS = plastic_words()
DESIGN = {"ridge-angle": 10.0}


def row(name, severity, half, unit="°", **changes):
    interval = None if half is None else (severity - half, severity + half)
    base = {"cause": name, "title": name, "unit": unit, "severity": severity, "u": None, "interval": interval}
    return base | {"weight": 0.5, "chi2": 1.0, "at_bound": False, "tie": True} | changes


@pytest.fixture
def conclude(make_report_record):
    """``conclude(causes, verdict=…)``: finding and action of a part with these causes."""

    def made(
        *causes,
        verdict="FAIL",
        words=PLASTIC_WORDS,
        nominal=DESIGN,
        actions=None,
        p=0.5,
        details=None,
        **changes,
    ):
        record = make_report_record(
            verdict=verdict, diagnosis={"says": "", "causes": causes, "unexplained_p": p}, **changes
        )
        recipe = record.recipe | ({} if actions is None else {"actions": actions})
        changed = {"recipe": recipe, "details": details or record.details}
        return concluded(record.model_copy(update=changed), words, "Contrast is off", nominal)

    return made


def test_the_finding_names_its_size_and_how_well_it_is_known(conclude):
    found = conclude(row("ridge-angle", -1.83, 0.47), row("seating-y", -1.8, 0.4, weight=0.01))
    assert found.finding == "Ridges are about 1.8° flatter than designed (8.2° ± 0.5°)."
    assert found.follows_from == "ridge-angle"
    assert found.action == f"{PLASTIC_WORDS['ridge-angle'].action}."
    shares = conclude(row("burrs", 0.069, 0.02, ""))
    assert "7 % of the area (± 2 %)" in shares.finding


@pytest.mark.parametrize(
    ("severity", "interval", "words"),
    [
        (0.19, (0.12, None), "19 % of the area (at least 12 %)."),
        (0.02, (None, 0.05), "2 % of the area (at most 5 %)."),
        (0.02, (-0.01, None), "2 % of the area."),
        (0.02, (None, None), "2 % of the area."),
    ],
)
def test_an_interval_with_one_end_says_it(conclude, severity, interval, words):
    assert words in conclude(row("burrs", severity, None, "", interval=interval)).finding


def test_causes_that_tie_are_named_together_and_none_of_them_acted_on(conclude):
    tied = (
        row("ridge-angle", -1.83, 0.47),
        row("wear", 5.0, 2.0, "µm", title="worn edges, radius", weight=0.2),
    )
    found = conclude(*tied)
    assert found.finding == (
        "Ridges are about 1.8° flatter than designed (8.2° ± 0.5°); cannot be distinguished from: worn edges, radius."
    )
    assert (found.follows_from, found.action) == ("tied", f"{OUTCOMES['tied']}.")
    assert conclude(*tied, actions={"wear": "Hone it", "tied": "Ask Maria"}).action == "Ask Maria."
    for other in ({"weight": 0.04}, {"tie": False}, {"cause": "nothing"}):
        assert conclude(tied[0], tied[1] | other).follows_from == "ridge-angle"


def test_an_unknown_sign_is_one_finding_and_not_two_causes(conclude):
    causes = [row(name, 22.0, 1.4, "nm") for name in ("over-etch", "under-etch")]
    both = conclude(*causes, words=WAFER_WORDS)
    assert (
        both.finding == "Etch depth is off by about 22 nm (± 1 nm); the sign cannot be told from these poses."
    )
    assert "too deep" in conclude(causes[0], words=WAFER_WORDS).finding
    of_pass = [row(f"{name}-pass-2", 22.0, 1.4, "nm") for name in ("deep", "shallow")]
    assert conclude(*of_pass, words=WAFER_WORDS).finding == (
        "Depth of pass 2 is off by about 22 nm (± 1 nm); the sign cannot be told from these poses."
    )


@pytest.mark.parametrize("severity", [-1.8, 0.04, 1.2])
@pytest.mark.parametrize("half", [0.05, 1.5, 3.0, None])
@pytest.mark.parametrize("verdict", ["PASS", "FAIL"])
@pytest.mark.parametrize("warned", [False, True])
def test_a_cause_that_may_be_nothing_is_no_headline(conclude, severity, half, verdict, warned):
    """Its interval holds zero: neither its size nor its direction may be said, whatever the verdict."""
    reasons = ["warning: it deviates"] if warned else ["all contrasts"]
    found = conclude(row("light-angle", severity, half), verdict=verdict, reasons=reasons)
    named = "The lamp stands about" in found.finding
    may_be_zero = half is not None and half >= abs(severity)
    assert named == (not may_be_zero and (verdict == "FAIL" or warned))
    assert " 0.0°" not in found.finding
    if may_be_zero:
        assert "Contrast is off" in found.finding


@pytest.mark.parametrize("p_value", [9e-5, 0.5, None])
def test_a_part_with_a_significant_contrast_is_not_as_it_should_be(conclude, make_report_record, p_value):
    details = surface_of(make_report_record())
    contrasts = [one.model_copy(update={"p_value": p_value}) for one in details.contrasts]
    found = conclude(verdict="PASS", details=details.model_copy(update={"contrasts": tuple(contrasts)}))
    wrong = p_value is not None and p_value < 0.01
    assert found.follows_from == ("warning" if wrong else "pass")
    assert ("as it should be" in found.finding) == (not wrong)


@pytest.mark.parametrize(("u", "guard", "key"), [(0.288, 0.474, "uncertain"), (0.06, 0.1, "inconclusive")])
def test_a_tolerance_that_no_part_passes_is_not_a_part_close_to_it(
    conclude, make_report_record, u, guard, key
):
    details = surface_of(make_report_record())
    first, *others = details.contrasts
    wide = first.model_copy(update={"u": u, "guard": guard, "tolerance": 0.4})
    kept = [one.model_copy(update={"guard": None, "tolerance": None}) for one in others]
    found = conclude(verdict="INCONCLUSIVE", details=details.model_copy(update={"contrasts": (wide, *kept)}))
    assert (found.follows_from, found.action) == (key, f"{OUTCOMES[key]}.")
    assert ("± 0.58 only" in found.finding and "±0.4" in found.finding) == (key == "uncertain")


def test_what_does_not_describe_a_part_is_the_finding(conclude, make_report_record):
    details = surface_of(make_report_record()).model_copy(update={"not_described": "the ink file does not"})
    found = conclude(verdict="INCONCLUSIVE", details=details)
    assert (found.follows_from, found.finding) == ("misfit", "The ink file does not.")
    assert found.action == f"{OUTCOMES['misfit']}."


@pytest.mark.parametrize("verdict", ["PASS", "INCONCLUSIVE", "INVALID"])
def test_every_verdict_has_its_action(conclude, verdict):
    found = conclude(row("ridge-angle", -1.8, 0.5), verdict=verdict)
    assert found.action == f"{OUTCOMES[found.follows_from]}."
    assert found.follows_from == verdict.lower()
    warned = conclude(row("ridge-angle", -1.8, 0.5), verdict="PASS", reasons=["warning: it deviates"])
    assert (warned.follows_from, "flatter" in warned.finding) == ("warning", True)


@pytest.mark.parametrize("causes", [(), (row("something-else", 0.0, None),), (row("unheard-of", 1.0, None),)])
def test_without_a_known_cause_the_numbers_are_the_finding(conclude, causes):
    assert conclude(*causes).finding == "Contrast is off."
    assert conclude(*causes).follows_from == "unexplained"
    assert conclude(row("ridge-angle", 1.0, 0.1), p=1e-5).follows_from == "unexplained"


def test_a_kind_that_looks_for_no_causes_does_not_say_that_none_explains_it(make_report_record):
    record = make_report_record(verdict="FAIL", diagnosis=None)
    assert concluded(record, {}, "Field (3, 4) is missing", {}).follows_from == "undiagnosed"


def test_a_recipe_has_the_last_word_on_what_to_do(conclude):
    actions = {"ridge-angle": "Call the tool shop, extension -17", "pass": "Box 4"}
    assert (
        conclude(row("ridge-angle", 1.0, 0.1), actions=actions).action == "Call the tool shop, extension -17."
    )
    assert conclude(verdict="PASS", actions=actions).action == "Box 4."


def test_two_causes_and_wrong_inks_have_words(conclude):
    parts = [{k: v for k, v in row(n, 1.0, 0.1).items() if k in PART} for n in ("ridge-angle", "seating-x")]
    both = conclude(row("ridge-angle+seating-x", 0.0, None, components=parts))
    assert both.finding.startswith("Two findings together. Ridges are about 1.0° steeper")
    ink = conclude(row("wrong-ink-synthetic-red", 0.05, 0.01, ""), words=kind_named("prints").cause_words)
    assert "synthetic-red" in ink.finding
    assert ink.follows_from == "wrong-ink"


PART = {"cause", "title", "unit", "severity", "u", "interval"}


def test_every_cause_of_every_kind_has_words():
    assert {one.name for one in all_causes()} <= PLASTIC_WORDS.keys()
    wafer = Etched(np.zeros((4, 4), np.uint8), (0.06, 0.13), 0.5)
    assert all(words_of(one.name, WAFER_WORDS) for one in wafer_causes(wafer))
    for words in (kind_named(name).cause_words for name in kind_names()):
        for one in words.values():
            assert one.action
            assert not one.opposite or (one.opposite in words and "{size}" in one.either)
