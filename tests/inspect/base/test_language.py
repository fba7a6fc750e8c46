"""Messages of the operator's path in German and Danish: catalogues are complete, and sentences are found in them."""

import gettext
import importlib.util
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from anisoscope.base.language import (
    answering,
    decimal,
    language,
    message,
    of_browser,
    of_locale,
    shown,
    speaking,
    translated,
    use,
)
from anisoscope.prediction.part_scatter import named_defects

ROOT = Path(__file__).resolve().parents[3]
PLACE = re.compile(r"\{(\w+)\}")


@pytest.fixture(scope="module")
def messages():
    """The script that brings the catalogues up to date."""
    pytest.importorskip("babel")
    spec = importlib.util.spec_from_file_location("messages", ROOT / "tools" / "messages.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["messages"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def found(messages):
    return messages.found_messages()


@pytest.mark.parametrize("language", ["de", "da"])
def test_every_message_is_translated_with_its_places(messages, found, language):
    known = {one.id: one.string for one in messages.catalogue(language) if one.id}
    assert set(found) == set(known), "run python tools/messages.py"
    assert [text for text, new in known.items() if not new.strip()] == []
    assert [
        text for text, new in known.items() if not set(PLACE.findall(new)) <= set(PLACE.findall(text))
    ] == []
    with (messages.LOCALE / language / "LC_MESSAGES" / "anisoscope.mo").open("rb") as file:
        shipped = gettext.GNUTranslations(file)
    assert [text for text, new in known.items() if shipped.gettext(text) != new] == []


def test_messages_are_found_in_templates_calls_and_sentences(found):
    assert found["What to do next"].endswith("inspection.html")
    assert found["over 99 %"].endswith("wording.py")
    assert found["{where} deviates by {deviation} (tolerance ±{tolerance}, guard band {guard})"].endswith(
        "decision.py"
    )


SIGNIFICANT = (
    "all contrasts together: p < 1e-9 for a part as predicted (level 0.01), a significant deviation of "
    "0° / 90°, tilt 0°; 0° / 180°, tilt 0°"
)
LIKE_A_DEFECT = (
    "all contrasts together: p = 0.00028 for a part like the golden part (level 0.001), a significant deviation like "
    "that of ridge angle −0.5° (score 4.4)"
)
DARK = (
    "The part was not judged: the part is darker than the dark frames: check light, exposure and dark frames."
)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("Ridges are about 1.8° flatter than designed (8.2° ± 0.5°).", ("1,8°", "(8,2° ± 0,5°).", "Rippen")),
        (
            "ln ratio 0° / 90°, tilt -10° deviates by +0.412 (tolerance ±0.25, guard band 0.051)",
            ("ln-Verhältnis 0° / 90°, Neigung -10°", "+0,412", "±0,25", "0,051"),
        ),
        (SIGNIFICANT, ("p < 1e-9", "wie vorhergesagt", "0,01", "0° / 180°, Neigung 0°")),
        (DARK, ("nicht beurteilt", "Dunkelbilder prüfen.")),
        (
            LIKE_A_DEFECT,
            ("0,00028", "wie das Gutteil", "wie bei „Rippenwinkel −0,5°“ (Score 4,4)"),
        ),
        (
            "ridge angle, off; cannot be distinguished from: pitch, off and 2 more",
            ("Rippenwinkel", "Teilung und 2 weitere"),
        ),
        (
            "ridge angle, off; cannot be distinguished from: the part lies tilted about y",
            ("Rippenwinkel; nicht zu unterscheiden von: das Teil liegt um y geneigt",),
        ),
        (
            "ΔE2000 at 90°, tilt -10° is 2.31 (limit 2, guard band 0.96)",
            ("ΔE2000 bei 90°, Neigung -10° ist 2,31 (Grenzwert 2, Schutzband 0,96)",),
        ),
    ],
)
def test_a_recorded_sentence_is_translated_with_its_numbers(text, wanted):
    with speaking("de"):
        said = translated(text)
    assert [part for part in wanted if part not in said] == []
    assert translated(text) == text


@pytest.mark.parametrize("name", ["de", "da"])
def test_every_named_defect_has_its_translation(name, make_recipe):
    defects = named_defects(make_recipe(defects={"wear_um": 5.0}))
    with speaking(name):
        assert [one.name for one in defects if translated(one.name) == decimal(one.name)] == []


def test_what_the_catalogue_does_not_know_stays_as_it_is():
    with speaking("da"):
        assert translated("Ask Maria and call the toolmaker") == "Ask Maria and call the toolmaker"
        assert message("Camera picture {name}, not judged", name="frame.0.5.tif").endswith(
            "frame.0.5.tif, ikke bedømt"
        )


def test_pages_have_a_blank_before_a_percent_sign_and_addresses_none():
    for text, wanted in (
        (
            "28.3% of the study (95% interval)",
            "28.3\N{NO-BREAK SPACE}% of the study (95\N{NO-BREAK SPACE}% interval)",
        ),
        ("15.5 %, ±1%, 100%", "15.5 %, ±1\N{NO-BREAK SPACE}%, 100\N{NO-BREAK SPACE}%"),
        ("parts/A1%20B/report.html?a=5%C3%A4", "parts/A1%20B/report.html?a=5%C3%A4"),
        ("write roughness=20% or wear=5%", "write roughness=20% or wear=5%"),
        ("%", "%"),
    ):
        assert shown(text) == wanted
    assert shown(0.5) == 0.5


def test_decimal_marks_of_numbers_only():
    with speaking("de"):
        assert decimal("0.25 mm at 1.5e-3, v1.2.3, map.0.5.toml, ISO 14253-1") == (
            "0,25 mm at 1,5e-3, v1.2.3, map.0.5.toml, ISO 14253-1"
        )


@pytest.mark.parametrize(
    ("variables", "wanted"),
    [
        ({"LANG": "de_DE.UTF-8"}, "de"),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "da_DK.UTF-8"}, "da"),
        ({"LC_ALL": "C.UTF-8", "LANG": "da_DK"}, "en"),
        ({"LANG": "fr_FR.UTF-8"}, "en"),
        ({}, "en"),
    ],
)
def test_the_locale_names_the_language(variables, wanted):
    assert of_locale(variables) == wanted


def test_another_language_is_refused():
    with pytest.raises(ValueError, match="no language 'fr'"):
        use("fr")


@pytest.mark.parametrize(
    ("header", "wanted"),
    [
        ("de-AT,de;q=0.9,en;q=0.8", "de"),
        ("fr, da;q=0.4, en-GB;q=0.7", "en"),
        ("da;q=0, en;q=0.1", "en"),
        ("fr-FR, *;q=0.5", None),
        ("de;q=high", None),
        ("", None),
    ],
)
def test_a_browser_prefers_a_language(header, wanted):
    assert of_browser(header) == wanted


def test_each_reader_of_a_server_has_its_language_and_the_process_keeps_its_own():
    with speaking("da"):
        with ThreadPoolExecutor(1) as pool, answering("de"):
            here, elsewhere = message("good"), pool.submit(message, "good").result()
        assert (here, elsewhere, language()) == ("gut", "god", "da")
