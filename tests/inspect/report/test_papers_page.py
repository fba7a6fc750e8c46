"""The page of the papers on a telephone."""

import pytest

from anisoscope.cli.study.papers import FOOT
from anisoscope.report.page import write_page
from anisoscope.study.papers.rows import Paper, Row

ROWS = [
    Row(
        "Claims 1 and 2, appendix C",
        "the spectrum of random steps approaches the closed form",
        "-",
        "-",
        "number",
        True,
    ),
    Row(
        "Fig. 12",
        "drawing: phases of a distant source and viewer (Eq. 19 to 28)",
        "-",
        "-",
        "none",
        None,
        note="none",
    ),
]


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1100])
def test_no_result_is_cut_off(page, tmp_path, width):
    path = tmp_path / "papers.html"
    papers = [(Paper("one", "A paper", "nowhere", ()), ROWS)]
    write_page(path, "papers.html", {"title": "Papers", "subtitle": "1 of 1", "papers": papers, "foot": FOOT})
    page.open(path.as_uri(), width=width)
    assert page.evaluate(
        "[...document.querySelectorAll('td')].some(e => e.innerText.includes('not reproduced'))"
    )
    ends = page.evaluate("[...document.querySelectorAll('td,th')].map(e => e.getBoundingClientRect().right)")
    assert max(ends) <= page.evaluate("document.querySelector('.wide').getBoundingClientRect().right") + 0.5
    assert page.evaluate(
        "document.querySelector('.wide').scrollWidth <= document.querySelector('.wide').clientWidth"
    )
