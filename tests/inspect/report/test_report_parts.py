"""What the report of an inspection says: rules, peers, provenance, words."""

import os
import pickle
import re
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from jinja2.bccache import bc_magic

from anisoscope.base.cache import Cache, Entry
from anisoscope.base.language import speaking
from anisoscope.record.schema import sha256_of
from anisoscope.report import figures, surface_sections
from anisoscope.report.inspection_page import Pictures, report_page
from anisoscope.report.page import css_string, template_environment
from anisoscope.report.peers import LotMate, among, lot_of
from anisoscope.report.provenance import calibrations_of, files_of, groups_of, when
from anisoscope.report.rule import rule_of
from anisoscope.report.tilt_sections import MOST, listed_tilt_contrasts, tilt_parts, tilt_row
from anisoscope.report.wording import cause_range, cause_text, filters

LOGO = "data:image/png;base64,AAAA"


def judged(*verdicts):
    base = {"tolerance": 0.25, "guard": 0.08, "u": 0.05, "kind": "log_ratio", "tilt_deg": 0.0}
    base |= {
        "from_deg": 0.0,
        "to_deg": 90.0,
        "measured": 0.1,
        "predicted": 0.0,
        "conformance_probability": 0.5,
    }
    return [base | {"verdict": verdict} for verdict in verdicts]


def area(verdict):
    return {"share": 0.03, "u": 0.01, "max_share": 0.03, "cells": 99, "verdict": verdict}


@pytest.mark.parametrize(
    ("changes", "words", "not_words"),
    [
        ({"verdict": "INVALID"}, ["never fails a part"], ["tolerance"]),
        ({"contrasts": judged("FAIL", "PASS")}, ["1 contrast lies outside", "FAIL goes before"], ["together", "area"]),
        ({"contrasts": judged("FAIL", "FAIL")}, ["2 contrasts lie outside"], []),
        ({"contrasts": judged("PASS"), "area": area("FAIL")}, ["the deviating area lies outside"], ["contrast lies"]),
        (
            {"verdict": "INCONCLUSIVE", "contrasts": judged("INCONCLUSIVE", "PASS"), "area": area("INCONCLUSIVE")},
            ["no limit is broken for certain", "1 contrast lies on one side", "area lies on one side"],
            ["outside"],
        ),
        ({"verdict": "PASS", "contrasts": judged("PASS")}, ["within its limit by more than its guard band"], []),
    ],
)  # fmt: skip
def test_the_rule_that_decided_is_said(make_report_record, changes, words, not_words):
    said = rule_of(make_report_record(**changes))
    assert all(word in said for word in words), said
    assert not any(word in said for word in not_words), said


@pytest.mark.parametrize(("language", "verdict"), [("de", "nicht bestanden"), ("da", "afvist")])
def test_page_1_is_in_the_language_of_the_operator(make_report_record, tmp_path, parsed, language, verdict):
    record = make_report_record(verdict="FAIL", contrasts=judged("FAIL", "PASS"))
    with speaking(language):
        text = report_page(record, Pictures(logo=LOGO), tmp_path)
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    page = parsed(tmp_path / "report.html")
    number = {"de": '"Seite " counter(page) " von "', "da": '"side " counter(page) " af "'}
    assert number[language] in text
    marks = {attributes.get("id"): attributes for _, attributes in page.found}
    assert [attributes["lang"] for tag, attributes in page.found if tag == "html"] == [language]
    assert marks["verdict"]["data-verdict"] == "FAIL"
    assert (marks["logo"]["src"], marks["logo"]["alt"]) == (LOGO, "logo")
    assert verdict in page.text
    assert re.findall(r"\d%", page.words) == []
    assert "What to do next" not in page.text
    assert [
        attributes["lang"] for tag, attributes in page.found if tag == "div" and "lang" in attributes
    ] == ["en"]


@pytest.mark.parametrize("how", ["no tolerance", "recipe"])
def test_a_significant_deviation_is_the_rule_only_where_it_decides(make_report_record, how):
    recipe = dict(make_report_record().recipe)
    contrasts = judged("PASS")
    assert "significantly" not in rule_of(make_report_record(contrasts=contrasts, area=area("FAIL")))
    if how == "recipe":
        recipe["decision"] = recipe["decision"] | {"deviation": "fail"}
    else:
        contrasts = [one | {"tolerance": None} for one in contrasts]
    said = rule_of(make_report_record(recipe=recipe, contrasts=contrasts))
    assert "all contrasts together deviate significantly (p below 0.001)" in said


def test_places_among_peers_are_mean_deviation_and_rank():
    peers = np.array([[1.0, 5.0], [2.0, 5.0], [3.0, 5.0], [6.0, 5.0]])
    first, second = among(("a", "b"), peers, (4.0, 5.0), "peers", "ln ratio [1]").places
    assert (first.mean, first.below) == (3.0, 3)
    assert first.s == pytest.approx(np.sqrt(14.0 / 3.0))
    assert first.off == pytest.approx(1.0 / first.s)
    assert (second.s, second.off, second.below) == (0.0, None, 0)
    (single,) = among(("a",), peers[:1, :1], (4.0,), "peers", "ln ratio [1]").places
    assert (single.s, single.off, single.below) == (None, None, 1)


def test_a_lot_is_the_last_of_every_other_part(make_report_record):
    record = make_report_record()

    def mate(serial, verdict="PASS", product="ridged plate", **numbers):
        return LotMate(serial, product, verdict, {"ln 0-90": 2.0, "ln 90-180": 0.1} | numbers)

    mates = (
        mate("B", "FAIL"),
        mate("B", "PASS", **{"ln 0-90": 2.5}),
        mate("A-17"),
        mate("C", product="something else"),
        LotMate("D", "ridged plate", "INVALID", {}),
    )
    lot = lot_of(record, mates)
    assert [(part.serial, part.verdict, part.contrasts) for part in lot.parts] == [
        ("B", "PASS", (2.5, 0.1)),
        ("D", "INVALID", ()),
    ]
    assert lot.verdicts == "1 PASS, 1 INVALID"
    assert lot_of(record, ()) is None
    assert lot_of(make_report_record(particulars={}), mates) is None


def test_provenance_says_who_what_with_what(make_report_record):
    told = {name: value for group in groups_of(make_report_record()) for name, value in group.rows}
    assert told["lot"] == "L7"
    assert told["inspected"] == when("2026-03-04T05:06:07+00:00")
    assert told["frames"] == "1 in 2 rounds"
    assert "f5" * 32 in told["recipe"]
    assert "21" * 32 in told["rig"]
    assert told["drift"].startswith("−0.21 %")
    assert "turned +0.01° to +0.01° from the stage's reading" in told["alignment"]
    silent = {n: v for g in groups_of(make_report_record(particulars={}, poses=[])) for n, v in g.rows}
    assert not {"lot", "cavity", "operator", "station"} & silent.keys()
    assert silent["alignment"] == "–"


def test_times_are_local_and_name_their_zone():
    winter, summer = "2026-01-04T23:30:00+00:00", "2026-07-04T23:30:00.123456"
    copenhagen = ZoneInfo("Europe/Copenhagen")
    assert when(winter, copenhagen) == "2026-01-05 00:30:00 CET (2026-01-04 23:30 UTC)"
    assert when(summer, copenhagen) == "2026-07-05 01:30:00 CEST (2026-07-04 23:30 UTC)"


def test_a_serial_cannot_leave_its_string_in_a_style_sheet():
    assert css_string("A-1 ü") == '"A-1 ü"'
    assert css_string('a";}</style>') == '"a\\000022\\00003b\\00007d\\00003c\\00002fstyle\\00003e"'


def test_calibrations_and_files(make_report_record, tmp_path):
    record = make_report_record()
    (white,) = calibrations_of(record, {})
    assert (white.taken, white.valid_until, white.sha256) == (when("2026-03-01"), "–", "b6" * 32)
    assert files_of(record, tmp_path) == record.inputs
    (tmp_path / "frames.jsonl").write_text("{}\n")
    assert files_of(record, tmp_path)[-1].sha256 == sha256_of(tmp_path / "frames.jsonl")


def test_words(make_report_record):
    ridge, seating = make_report_record().diagnosis.causes
    assert cause_text(ridge) == "ridge angle, off by −2.05° (95 %: −2.44° to −1.65°)"
    assert cause_text(seating) == "the part lies tilted about y −2.08° (not determined)"
    open_ends = [ridge.model_copy(update={"interval": ends}) for ends in ((-2.44, None), (None, -1.65))]
    assert [cause_range(one) for one in open_ends] == ["95 %: −2.44° or more", "95 %: −1.65° or less"]
    earlier = [one.model_copy(update={"interval": None}) for one in (ridge, seating)]
    assert [cause_range(one) for one in earlier] == ["± 0.2°", "not determined"]
    share = {"unit": "", "severity": 0.0612, "interval": (0.0342, None), "title": "burrs, share of the area"}
    assert (
        cause_text(ridge.model_copy(update=share)) == "burrs, share of the area 6.12 % (95 %: 3.42 % or more)"
    )
    change = {
        "unit": "",
        "severity": -0.2,
        "u": 0.05,
        "interval": None,
        "title": "roughness, relative change",
    }
    assert cause_text(ridge.model_copy(update=change)) == "roughness, relative change −20 % (± 5 %)"
    plain = change | {"title": "rough facets, added roughness across the ridges", "severity": 0.03}
    assert cause_text(ridge.model_copy(update=plain)).endswith("across the ridges 0.03 (± 0.05)")
    told = filters()
    assert (told["short"](4e-5), told["short"](0.00123)) == ("< 0.0001", "0.0012")
    assert (told["signed"](-0.0004, 2), told["signed"](0.004, 2), told["signed"](0.005)) == (
        "0.00",
        "0.00",
        "+0.005",
    )
    assert (told["signed"](-0.5), told["chance"](3e-5), told["number"](-1234.5)) == (
        "−0.500",
        "< 0.0001",
        "−1.23e+03",
    )


def between(count):
    """Contrasts between tilts, ever likelier ones, the least likely ones last."""
    base = {"stage_deg": -90.0, "from_tilt_deg": 0.0, "kind": "log_ratio", "measured": 0.31, "predicted": 0.3}
    base |= {"u_measured": 0.003, "u_predicted": 0.004, "u": 0.005}
    return [base | {"to_tilt_deg": float(k), "p_value": 1.0 - k / 100.0} for k in range(1, count + 1)]


@pytest.mark.parametrize("count", [0, 3, MOST, MOST + 4])
def test_of_many_contrasts_between_tilts_the_least_likely_are_shown(make_report_record, count):
    record = make_report_record(between_tilts=between(count))
    shown, folded = listed_tilt_contrasts(record)
    assert (len(shown), len(folded)) == (min(count, MOST), max(count - MOST, 0))
    assert [one.to_tilt_deg for one in (*folded, *shown)] == [float(k) for k in range(1, count + 1)]
    parts = tilt_parts(record)
    assert [len(parts["tilt_rows"]), len(parts["tilt_folded"])] == [len(shown), len(folded)]
    assert (parts["tilt_chart"] is None) == (count == 0)


def test_a_contrast_between_tilts_says_every_value_with_its_expanded_uncertainty(make_report_record):
    (one,) = make_report_record(between_tilts=between(1)).details.between_tilts
    row = tilt_row(one)
    assert row.label == "−90°, tilt 0° / 1°"
    assert row.numbers == ("+0.310", "0.006", "+0.300", "0.008", "+0.010", "0.010")
    assert row.chance == "0.99"


@pytest.mark.parametrize("azimuth", [0.0, 90.0])
def test_map_and_table_count_from_the_rotation_axis(
    make_report_record, report_pictures, monkeypatch, azimuth
):
    region = {"x": 5.1, "y": 1.9, "width": 0.1, "length": 0.2, "area_share": 0.01, "cells": 4, "kind": "spot"}
    base = make_report_record()
    recipe = base.recipe | {"region": {"center_mm": [5.0, 2.0]}, "poses": {"facet_azimuth_deg": azimuth}}
    record = make_report_record(recipe=recipe, regions=[region | {"deviation": 0.4, "p_value": 0.001}])
    drawn = {}

    def keep(_deviation, _mask, places, size_mm, frame):
        with figures.new_map_figure(size_mm) as (_, axes, _bar):
            drawn.update(ends=frame.label(axes, size_mm), names=(axes.get_xlabel(), axes.get_ylabel()))
        drawn["places"] = places
        return ""

    monkeypatch.setattr(figures, "deviation_map", keep)
    surface_sections._maps(record, record.details, report_pictures, record.details.regions)
    (place,), (left, right, low, high) = drawn["places"], drawn["ends"]
    height, width = report_pictures.size_mm
    assert (right - left, high - low) == pytest.approx((width, height))
    turned = {0.0: (lambda x, y: (x, y)), 90.0: (lambda x, y: (y, -x))}[azimuth]
    assert place == pytest.approx(turned(5.1, 1.9))
    assert (0.5 * (left + right), 0.5 * (low + high)) == pytest.approx(turned(5.0, 2.0))
    assert "from the rotation axis [mm]" in drawn["names"][0]
    assert drawn["names"][0].startswith("x " if azimuth == 0.0 else "across the ridges ")


def test_labels_of_regions_are_apart_and_inside():
    rng = np.random.default_rng(1)
    points = [(float(x), float(y)) for x, y in rng.uniform(80.0, 130.0, (12, 2))]
    points += [(1.0, 1.0), (199.0, 199.0)]
    offsets = figures.label_offsets(points, (200.0, 200.0))
    places = np.add(points, offsets)
    assert np.all((places > 5.0) & (places < 195.0))
    apart = np.abs(places[:, None] - places[None]) > (15.0, 11.0)
    assert np.all(apart.any(axis=2) | np.eye(len(places), dtype=bool))


def test_single_cells_are_not_outlined():
    mask = np.zeros((4, 5), dtype=bool)
    mask[0, 0] = mask[2, 2] = mask[3, 3] = True
    assert figures.outline_path(mask).count("M") == 8  # two cells that touch at a corner


def test_a_template_is_translated_once_for_all_processes(tmp_path, monkeypatch):
    """What is kept serves as long as the template is the same, and in each language by itself."""
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))

    def shown():
        found = template_environment("anisoscope.report")
        found.loader.loaders[1].mapping["part"] = source
        return found.get_template("part").render(value=1.5)

    source = "{{ 2.5 }} and {{ value }}"
    assert (shown(), shown()) == ("2.5 and 1.5", "2.5 and 1.5")
    (kept,) = Cache().stored()
    assert kept.kind == "templates"
    with speaking("de"):
        assert shown() == shown()
    assert len(Cache().stored()) == 2
    source = "only {{ value }}"
    assert shown() == "only 1.5"
    kept.path.write_bytes(b"no translation")
    source = "{{ 2.5 }} and {{ value }}"
    assert shown() == "2.5 and 1.5"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="other systems have no such modes")
@pytest.mark.parametrize(("mode", "open_to_others"), [(0o644, False), (0o664, True), (0o646, True)])
def test_no_translation_is_run_that_others_may_have_written(tmp_path, monkeypatch, mode, open_to_others):
    """Nobody can tell the translation of "one" in the place of that of "two" but by who may have put it there."""
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))

    def shown(text):
        found = template_environment("anisoscope.report")
        found.loader.loaders[1].mapping["part"] = text
        return found.get_template("part").render()

    def entries():
        return {Entry(Cache(), kept.path) for kept in Cache().stored()}

    shown("one")
    (one,) = entries()
    shown("two")
    (two,) = entries() - {one}
    head = len(bc_magic) + len(pickle.dumps("0" * 40, 2))
    two.write(two.read()[:head] + one.read()[head:])
    two.path.chmod(mode)
    assert shown("two") == ("two" if open_to_others else "one")
