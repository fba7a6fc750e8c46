"""Reports as a browser sees them: nothing asked from outside, nothing complained about, every picture decoded."""

import json
from pathlib import Path

import pytest

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def parts(demo):
    return demo[1]["parts"]


def test_the_watch_itself_notices_outside_requests_and_errors(page, tmp_path):
    """A page with all the sins, so that silence below means something."""
    sinner = tmp_path / "sinner.html"
    sinner.write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('sin')</script>")
    page.open(sinner.as_uri())
    assert len(page.complaints()) >= 2
    assert "http://127.0.0.1:9/x.png" in page.requests()


@pytest.mark.parametrize("part", [0, 1, 2])
def test_report_is_silent_self_contained_and_whole(page, parts, part):
    report = parts[part]["report"]
    page.open(f"file://{report}")
    assert page.complaints() == []
    assert page.requests() == [f"file://{report}"]
    pictures = page.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth, i.alt])")
    assert len(pictures) >= 9
    assert all(complete and width > 100 and alt for complete, width, alt in pictures)
    assert page.evaluate("document.getElementById('verdict').textContent") == parts[part]["verdict"]


def test_tables_say_what_the_record_says(page, parts):
    report = parts[1]["report"]
    page.open(f"file://{report}")
    rows = page.evaluate(
        "[...document.querySelectorAll('#contrasts tbody tr')].map(r => [...r.cells].map(c => c.innerText))"
    )
    record = json.loads(Path(report).with_name("record.json").read_text(encoding="utf-8"))
    for row, contrast in zip(rows, record["details"]["contrasts"], strict=False):
        shown = [float(cell.replace("−", "-")) for cell in row[1:5]]
        expected = [
            contrast["measured"],
            contrast["predicted"],
            contrast["measured"] - contrast["predicted"],
            contrast["u"],
        ]
        assert shown == pytest.approx(expected, abs=6e-4)
    assert rows[-1][1] == f"{100 * record['details']['area']['share']:.1f} %"


def test_nothing_is_cut_off_on_a_printed_a4_page(page, parts):
    try:
        page.call("Emulation.setEmulatedMedia", media="print")
        page.open(f"file://{parts[2]['report']}", width=688)  # 182 mm of text at 96 dpi
        wide = "[...document.querySelectorAll('main, .wide, table')].filter(e => e.scrollWidth > e.clientWidth + 1)"
        assert page.evaluate(f"{wide}.length") == 0
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize("width", [390, 800, 1600])
def test_nothing_overflows_sideways(page, parts, width):
    page.open(f"file://{parts[1]['report']}", width=width)
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
