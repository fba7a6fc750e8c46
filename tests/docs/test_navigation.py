"""Pages for users stay short."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SPEC = importlib.util.spec_from_file_location("count_words", ROOT / "tools" / "count_words.py")
COUNT = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(COUNT)
WORDS_FOR_USERS = 57_800


def test_pages_for_users_have_no_more_words_than_they_had():
    assert COUNT.for_users() <= WORDS_FOR_USERS, "python tools/count_words.py"


def test_every_page_is_listed_once():
    listed = [page for pages in COUNT.words().values() for page in pages]
    assert len(listed) == len(set(listed)) > 80
