"""The viewer's document: its scripts are named by their hashes, whatever the map; the map is never run."""

import base64
import gzip
import hashlib
import html
import importlib.util
from html.parser import HTMLParser

import pytest

from anisoscope.report import surface_view
from anisoscope.report.surface_view import viewer_of


class Scripts(HTMLParser):
    def __init__(self, document):
        super().__init__(convert_charrefs=False)
        self.found, self._open = [], False
        self.feed(document)

    def handle_starttag(self, tag, attrs):
        if tag == "script":
            self.found.append([dict(attrs), ""])
            self._open = True

    def handle_endtag(self, tag):
        self._open = self._open and tag != "script"

    def handle_data(self, data):
        if self._open:
            self.found[-1][1] += data


def test_every_script_that_runs_is_named_and_none_else():
    viewer = viewer_of(b"state")
    scripts = []
    for attributes, text in Scripts(viewer.document).found:
        if attributes.get("id") == "viewer-script":
            scripts.append(gzip.decompress(base64.b64decode(text)).decode())
            assert attributes["data-type"] == "module"
        elif attributes.get("type") != "text/plain":
            scripts.append(text)
    assert len(viewer.document) < 500_000
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts]
    assert viewer.script_sources == tuple(f"'sha256-{digest}'" for digest in digests)
    assert len(scripts) == 3


def test_the_map_is_text_and_changes_no_script():
    one, other = viewer_of(b"one"), viewer_of(bytes(range(256)) * 9)
    assert one.script_sources == other.script_sources
    (data,) = [text for attributes, text in Scripts(other.document).found if attributes.get("id") == "state"]
    assert base64.b64decode(data) == bytes(range(256)) * 9


def test_it_names_no_outside_resource():
    for attributes, _ in Scripts(viewer_of(b"").document).found:
        assert "src" not in attributes


def test_the_attribute_says_the_document():
    viewer = viewer_of(b"state")
    assert '"' not in viewer.srcdoc
    assert html.unescape(viewer.srcdoc) == html.unescape(viewer.document.replace("&", "&amp;"))


def test_without_trame_there_is_none(monkeypatch):
    surface_view._page.cache_clear()
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    try:
        assert viewer_of(b"state") is None
    finally:
        surface_view._page.cache_clear()


@pytest.fixture(autouse=True)
def has_trame():
    if importlib.util.find_spec("trame_vtk") is None:
        pytest.skip("trame-vtk is not installed")
