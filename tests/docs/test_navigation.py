"""Pages for users stay short, and readers find in two clicks what they look for."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SPEC = importlib.util.spec_from_file_location("count_words", ROOT / "tools" / "count_words.py")
COUNT = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(COUNT)
WORDS_FOR_USERS = 45_000
LINK = re.compile(r"\]\(([^)#]+\.md)")
QUESTIONS = {
    "I have a rig and a recipe: how do I inspect a part?": ("start/operator", "Every day"),
    "The report says FAIL: what do I do?": ("start/operator", "What to do with a verdict"),
    "By which rule did this part fail?": ("verdict", "Rule"),
    "The power failed in the middle of a part": ("inspection-folder", "When an inspection is interrupted"),
    "What does exit code 69 mean?": ("troubleshooting", "Exit codes"),
    "Why is every part INCONCLUSIVE?": ("troubleshooting", "The part and the recipe"),
    "How do I inspect a tray of parts?": ("batch", "A tray"),
    "Another program takes the photographs": ("inspection-folder", "Frames that exist already"),
    "How many good parts do I need, and how do I name them?": ("recipes", "Golden parts"),
    "Which key of the recipe sets the tolerance?": (
        "recipe-and-rig",
        "Recipe: what the part should look like and how it is judged",
    ),
    "Is my gauge capable?": ("statistics", "Measurement systems analysis"),
    "How do I prove that no record was changed?": ("history", "Nothing is changed, and it can be checked"),
    "My camera adjusts its exposure by itself": ("cameras", "Prove that auto exposure is off"),
    "A GigE camera is found and sends no picture": ("cameras", "GigE Vision, USB3 Vision, GenTL"),
    "How do I measure roughness and lobe of my plastic?": ("calibration", "The plastic"),
    "What is in the ± of a contrast?": ("uncertainty", "What is in the budget"),
    "Can it read the files of my instrument?": ("height-maps", "Formats"),
    "How do I connect a controller by OPC UA?": ("line", "OPC UA"),
    "Which topics and bytes does my program have to send?": ("interfaces", "MQTT and Sparkplug B"),
    "How often does a good part fail, and a bad one pass?": ("detection", "Results"),
    "When are rays wrong, and waves needed?": ("wave", "Rays or waves"),
    "How do I stop a stage that must not move?": ("rig-commands", "Motion"),
}
"""Page and heading where a reader finds the answer."""


def headings(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"^#+ (.*)$", text, re.MULTILINE)


def reached():
    """Pages of the index, and those that a start page or the page of the evidence links."""
    first = [page for pages in COUNT.groups(DOCS / "index.md").values() for page in pages]
    openings = [
        page for page in first if page.parent.name == "start" or page.parts[-2:] == ("evidence", "index.md")
    ]
    second = [page.parent / target for page in openings for target in LINK.findall(page.read_text("utf-8"))]
    return {page.resolve() for page in [*first, *second]}


def test_pages_for_users_have_no_more_words_than_they_had():
    assert COUNT.for_users() <= WORDS_FOR_USERS, "python tools/count_words.py"


def test_every_page_is_listed_once():
    listed = [page for pages in COUNT.words().values() for page in pages]
    assert len(listed) == len(set(listed)) > 80


def test_every_page_of_the_evidence_is_in_its_table():
    text = (DOCS / "evidence" / "index.md").read_text(encoding="utf-8")
    linked = {(DOCS / "evidence" / target).resolve() for target in LINK.findall(text)}
    assert linked == set(COUNT.groups(DOCS / "evidence" / "index.md")[COUNT.EVIDENCE])


@pytest.mark.parametrize("question", QUESTIONS)
def test_the_answer_to_a_question_is_two_clicks_away(question):
    name, heading = QUESTIONS[question]
    page = DOCS / f"{name}.md"
    assert heading in headings(page)
    assert page in reached()
