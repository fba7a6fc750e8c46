"""Pages of history, show and compare, from the archived inspections."""

import shutil
import tarfile
from pathlib import Path

import pytest

from anisoscope import cli
from anisoscope.inspection import past_pages
from anisoscope.record.schema import read_record

DATA = Path(__file__).parents[2] / "data" / "inspections"


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Two archived inspections and one whose folder is gone, in a history."""
    folder = tmp_path_factory.mktemp("archive")
    for kind in ("ridges", "wafer"):
        with tarfile.open(DATA / f"{kind}.tar.xz") as packed:
            packed.extractall(folder, filter="data")
    history = f"sqlite:///{folder / 'history.sqlite'}"
    assert (
        cli.run(["history", "add", str(folder / "ridges"), str(folder / "wafer"), "--history", history]) == 0
    )
    return folder, history


def attributes(page, tag, name):
    return [found[name] for one, found in page.found if one == tag and name in found]


def test_the_history_has_thumbnails_findings_and_links(archive, tmp_path, parsed, capsys):
    folder, history = archive
    html = folder / "pages.html"
    assert cli.run(["history", "--history", history, "--html", str(html)]) == 0
    page, records = parsed(html), [read_record(folder / kind) for kind in ("ridges", "wafer")]
    assert {*attributes(page, "tr", "data-verdict")} == {one.verdict for one in records}
    assert [(html.parent / link).is_file() for link in attributes(page, "a", "href")] == [True, True]
    assert len(attributes(page, "img", "src")) == 2
    assert all(source.startswith("data:image/") for source in attributes(page, "img", "src"))
    assert all(one.serial in page.text for one in records)
    assert [scope for scope in attributes(page, "th", "scope") if scope not in ("col", "row")] == []


def test_two_inspections_stand_side_by_side(archive, tmp_path, parsed, capsys):
    folder, history = archive
    html = tmp_path / "compared.html"
    assert cli.run(["compare", str(folder / "ridges"), str(folder / "wafer"), "--history", history,
                    "--html", str(html)]) == 0  # fmt: skip
    page = parsed(html)
    poses = {
        (pose.stage_deg, pose.tilt_deg)
        for kind in ("ridges", "wafer")
        for pose in read_record(folder / kind).poses
    }
    assert [found.get("class") for tag, found in page.found if tag == "div"].count("pair") == len(poses)
    assert "ln ratio 0° / 90°, tilt 10°" in page.text
    assert "tile.npz" in page.text
    assert "/tile.npz" not in page.text  # no folders of the computer on a page that is passed on
    assert " (1)" not in page.text
    twice = [str(folder / "ridges")] * 2
    assert cli.run(["compare", *twice, "--history", history, "--html", str(html)]) == 0
    assert (
        f"{read_record(folder / 'ridges').serial} (1)" in parsed(html).text
    )  # one serial number: told apart by id


def test_a_missing_report_is_made_again(archive, tmp_path, monkeypatch, capsys):
    folder, history = archive
    again = []
    monkeypatch.setattr(past_pages, "report_again", lambda *given: again.append(given[:2]) or "again")
    report, html = folder / "ridges" / "report.html", tmp_path / "shown.html"
    show = ["show", str(folder / "ridges"), "--history", history, "--html", str(html)]
    assert cli.run(show) == 0
    assert (html.read_bytes(), again) == (report.read_bytes(), [])
    shutil.move(report, tmp_path / "report.html")
    try:
        assert cli.run(show) == 0
    finally:
        shutil.move(tmp_path / "report.html", report)
    assert ([one[0] for one in again], html.read_text(encoding="utf-8")) == ([folder / "ridges"], "again")
    assert again[0][1].conclusion is not None
    assert cli.run(["show", str(folder / "ridges"), "--history", history, "--refresh"]) == 64


def test_filters_work_without_a_server_and_no_verdict_is_hidden(archive, page, capsys):
    folder, history = archive
    html = folder / "filtered.html"
    assert cli.run(["history", "--history", history, "--html", str(html)]) == 0
    page.open(html.as_uri(), width=390)
    seen = "[...document.querySelectorAll('#inspections tbody tr')].filter(r => r.offsetHeight > 0)"
    verdicts = page.evaluate(f"{seen}.map(r => r.dataset.verdict)")
    assert len(verdicts) == 2
    assert page.evaluate(f"{seen}.every(r => r.querySelector('.word').getBoundingClientRect().right < 390)")
    for field, value, left in (("verdict", verdicts[0], verdicts.count(verdicts[0])), ("text", "no such", 0)):
        page.evaluate(
            f"(f => {{ f.elements['{field}'].value = '{value}'; f.dispatchEvent(new Event('input')); }})"
            "(document.querySelector('#filters'))"
        )
        assert page.evaluate(f"{seen}.length") == left
    assert page.complaints() == []
    assert page.requests() == [html.as_uri()]
