"""The page of a batch: the tray as it lies, links that stay inside, texts that stay texts, silent in a browser."""

import numpy as np
import pytest

from anisoscope.report.batch_page import SlotView, thumbnail, tray_places, write_batch_page

NASTY = "<script>alert(1)</script>\"'&\u202e[b]"
WORDS = ("PASS", "FAIL", "INCONCLUSIVE", "INVALID", "fault", "skipped", "waiting", "at work")


def test_wells_lie_as_their_names_say_and_others_in_order():
    assert tray_places(["A1", "B3", "a2"]) == (3, [(1, 1), (2, 3), (1, 2)])
    columns, places = tray_places([str(number) for number in range(1, 13)])
    assert (columns, places[0], places[-1]) == (5, (1, 1), (3, 2))
    assert len(set(places)) == 12
    assert tray_places(["A1", "a1", "x"])[1] == [(1, 1), (1, 2), (2, 1)]
    assert tray_places(["A0"]) == (1, [(1, 1)])


def test_a_link_cannot_leave_the_folder():
    assert SlotView("1", "PASS", report="1/A 1#+-X/report.html").link == "./1/A%201%23%2B-X/report.html"
    assert SlotView("1", "PASS", report="javascript:alert(1)").link == "./javascript%3Aalert%281%29"
    assert SlotView("1", "PASS").link is None


@pytest.fixture
def written(tmp_path):
    rng = np.random.default_rng(1)
    counts = rng.integers(100, 4000, (300, 400)).astype(np.uint16)
    slots = [
        SlotView(
            slot=f"S{number}",
            word=word,
            serial=NASTY,
            lot=NASTY,
            cavity="2",
            code=NASTY,
            reason=NASTY * 3,
            seconds=75.0,
            report="javascript:alert(1)/report.html",
            thumbnail=thumbnail(counts),
        )
        for number, word in enumerate(WORDS * 3)
    ]
    path = tmp_path / "batch.html"
    write_batch_page(path, NASTY, [(NASTY, NASTY)], [(word, 3) for word in WORDS], slots)
    return path


def test_texts_stay_texts_and_pictures_are_small(written):
    text = written.read_text(encoding="utf-8")
    assert "<script" not in text
    assert text.count("&lt;script&gt;alert(1)") > 24
    assert written.stat().st_size < 24 * 20_000
    assert "1.2 min" in text


@pytest.mark.browser
def test_the_page_is_silent_and_whole(page, written):
    page.open(written.as_uri())
    assert page.complaints() == []
    assert page.requests() == [written.as_uri()]
    pictures = page.evaluate("[...document.images].map(i => [i.naturalWidth, i.alt])")
    assert len(pictures) == 24
    assert all(width == 160 and alt.startswith("The part in slot S") for width, alt in pictures)
    assert page.evaluate("[...document.links].every(a => a.protocol == 'file:')")
    assert page.evaluate("document.querySelectorAll('.tray li').length") == 24
    assert page.evaluate("document.querySelector('h1').textContent") == NASTY


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1100])
def test_nothing_overflows_sideways(page, written, width):
    page.open(written.as_uri(), width=width)
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


@pytest.mark.browser
def test_nothing_is_cut_off_on_a_printed_a4_page(page, written):
    try:
        page.call("Emulation.setEmulatedMedia", media="print")
        page.open(written.as_uri(), width=688)  # 182 mm of text at 96 dpi
        wide = "[...document.querySelectorAll('main, .wide, table')].filter(e => e.scrollWidth > e.clientWidth + 1)"
        assert page.evaluate(f"{wide}.length") == 0
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_on_colours_can_be_read(page, written, scheme):
    """WCAG 2.1, 1.4.3: 4.5 to 1."""
    try:
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        page.call("Emulation.setEmulatedMedia", media="screen", features=features)
        page.open(written.as_uri())
        pairs = page.evaluate(
            "[...document.querySelectorAll('.counts li, .cell:not(.open), td .word')].map(e => "
            "[getComputedStyle(e).color, getComputedStyle(e).backgroundColor])"
        )
        assert len(pairs) > 40
        for pair in {tuple(pair) for pair in pairs}:
            light, dark = sorted(map(luminance, pair), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, pair
    finally:
        page.call("Emulation.setEmulatedMedia", media="", features=[])


def luminance(colour):
    """Relative luminance of rgb(r, g, b), after WCAG 2.1."""
    share = np.array([float(part) for part in colour[4:-1].split(",")[:3]]) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])
