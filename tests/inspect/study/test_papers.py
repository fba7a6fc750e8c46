"""Rows of the papers: they agree, their commands exist, and a row that differs ends the command with 1."""

import re
import shlex

import pytest

from anisoscope.cli import app
from anisoscope.cli.study import papers as command
from anisoscope.study.papers import levin, luongo, pranovich
from anisoscope.study.papers.rows import Paper, Row

PAPERS = (levin.PAPER, luongo.PAPER, pranovich.PAPER)
LONG = {
    levin.fig_2, levin.fig_5, levin.fig_6, levin.fig_8, levin.fig_9, levin.fig_10, levin.fig_11, levin.appendix_b,
    levin.eq_15, levin.section_5,
    luongo.fig_8, pranovich.fig_4, pranovich.table_1, pranovich.fig_5,
}  # fmt: skip
"""Rows of more than a fifth of a second; `make docs` makes them all."""


@pytest.fixture(scope="module")
def made():
    return {paper.key: [make() for make in paper.makers if make not in LONG] for paper in PAPERS}


@pytest.fixture(scope="module")
def rows(made):
    return [row for found in made.values() for row in found]


def test_no_row_differs_from_its_paper(rows):
    assert [row.label for row in rows if row.holds is False] == []
    assert sum(row.holds is True for row in rows) >= 10


def test_what_cannot_be_compared_says_why(rows):
    assert all((row.compared == "none") == (row.holds is None) for row in rows)
    assert all(row.note for row in rows if row.holds is None)


def test_commands_of_the_rows_can_be_parsed(rows):
    lines = [row.command for row in rows if row.command.startswith("anisoscope ")]
    assert len(lines) >= 9
    for line in lines:
        app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def test_every_figure_of_the_papers_has_its_row(made):
    """Levin 1 to 12, Luongo 1 to 10, Pranovich 1 to 9; a row may serve several figures."""
    for paper, last in zip(PAPERS, (12, 10, 9), strict=True):
        labels = [row.label.partition("Eq.")[0] for row in made[paper.key] if row.label.startswith("Fig.")]
        labels += [
            make.__name__ for make in paper.makers if make in LONG and make.__name__.startswith("fig_")
        ]
        numbers = {int(one) for label in labels for one in re.findall(r"\d+", label)}
        assert set(range(1, last + 1)) <= numbers, paper.key


def test_rays_and_the_closed_form_of_shadowing_meet():
    """Eq. 9 with a perpendicular wall, by hand: θ_r = 20°, from 50°: 1 − tan 20°·tan 30°."""
    assert luongo.lit_share(20.0, 50.0, "perpendicular") == pytest.approx(1.0 - 0.36397 * 0.57735, abs=1e-4)


def test_a_row_that_differs_ends_with_1(monkeypatch, capsys, tmp_path):
    def wrong():
        return Row("Fig. 1", "x", "1", "2", "number", False, "anisoscope demo")

    for module in (levin, luongo, pranovich):
        monkeypatch.setattr(module, "PAPER", Paper(module.PAPER.key, "title", "source", (wrong,)))
    assert command.papers(only="luongo", html=tmp_path / "p.html") == 1
    assert "0 of 1 rows" in capsys.readouterr().out
    assert re.search(r'class="differs">differs<', (tmp_path / "p.html").read_text(encoding="utf-8"))
