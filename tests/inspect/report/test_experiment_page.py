import base64
import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from anisoscope.base.errors import RecordError
from anisoscope.experiment.experiment import SHAPE, Setup, run_experiment
from anisoscope.experiment.findings_map import findings_share
from anisoscope.parameters.geometry import Convention
from anisoscope.report.experiment_page import (
    bar_chart,
    findings_svg,
    level_text,
    write_experiment_page,
    write_findings_page,
)


@pytest.fixture(scope="module")
def experiments():
    """Predicted only, with a complete table, and with a partial one in which one tilt was not measured."""
    rng = np.random.default_rng(4)
    plain = run_experiment(Setup())
    measured = 2.5 * plain.predicted + 0.02 * rng.random(SHAPE)
    partial = measured.copy()
    partial[:, 3] = np.nan
    return {
        "plain": plain,
        "complete": run_experiment(Setup("corrected"), measured),
        "partial": run_experiment(Setup(), partial),
    }


@pytest.fixture(scope="module")
def maps():
    grid = np.geomspace(0.03, 0.3, 6)
    planes = ("perpendicular", "in-plane")
    return [findings_share(Setup(convention=Convention(tilt_plane=p)), grid, grid) for p in planes]


@pytest.fixture(scope="module")
def pages(experiments, maps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    for name, result in experiments.items():
        write_experiment_page(result, folder / f"{name}.html")
    write_findings_page(maps, folder / "findings.html")
    return folder


NAMES = ["plain", "complete", "partial", "findings"]


@pytest.mark.parametrize("name", NAMES)
def test_a_page_refers_to_nothing_outside_and_runs_nothing(pages, name, parsed):
    source = (pages / f"{name}.html").read_text(encoding="utf-8")
    elements = parsed(pages / f"{name}.html").found
    assert not {"script", "link", "iframe", "object", "base", "form"} & {tag for tag, _ in elements}
    for _, attributes in elements:
        assert not [key for key in attributes if key.startswith("on")]
        assert "href" not in attributes
        assert attributes.get("src", "data:").startswith("data:")
    assert "url(" not in source
    assert "@import" not in source
    policy = [a["content"] for _, a in elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy == ["default-src 'none'; img-src data:; style-src 'unsafe-inline'"]
    for _, attributes in elements:
        if "src" in attributes:
            svg = base64.b64decode(attributes["src"].partition("base64,")[2]).decode("utf-8")
            outside = [
                value
                for e in ET.fromstring(svg).iter()
                for key, value in e.attrib.items()
                if key.endswith("href")
            ]
            assert all(value.startswith("#") for value in outside)


def test_alt_texts_carry_the_means(pages, experiments, parsed):
    elements = parsed(pages / "partial.html").found
    alts = [a["alt"] for tag, a in elements if tag == "img"]
    assert len(alts) == 3
    for alt, name in zip(alts, ("tilt", "ridge_angle", "pair"), strict=True):
        for mean in experiments["partial"].means[name]:
            assert f"{level_text(mean.level_deg)} predicted {mean.predicted:.4g}" in alt
            if mean.measured is not None:
                assert f"measured {mean.measured:.4g}" in alt
    assert "0 measured" not in alts[0].partition(" 10°")[2].partition(",")[0]


def test_the_page_says_convention_model_and_scale(pages, experiments, parsed):
    plain = parsed(pages / "plain.html").text
    assert "perpendicular to the light's plane" in plain
    assert "1 (nothing measured)" in plain
    assert "measured [" not in plain
    complete = parsed(pages / "complete.html").text
    assert f"{experiments['complete'].k:.6g}, fitted" in complete
    assert "corrected" in complete
    assert "Not every row was measured" not in complete
    assert "Not every row was measured" in (pages / "partial.html").read_text(encoding="utf-8")


def rows_of(source, table):
    body = re.search(rf'<table id="{table}">.*?<tbody>(.*?)</tbody>', source, re.DOTALL)[1]
    return [
        re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row)
        for row in re.findall(r"<tr>(.*?)</tr>", body, re.DOTALL)
    ]


def test_the_table_says_what_the_experiment_says(pages, experiments):
    result = experiments["partial"]
    rows = rows_of((pages / "partial.html").read_text(encoding="utf-8"), "contrasts")
    assert len(rows) == result.predicted.size
    assert [float(row[3]) for row in rows] == pytest.approx(result.predicted.ravel().tolist(), rel=1e-4)
    for row, measured in zip(rows, result.measured.ravel(), strict=True):
        assert row[4] == "–" if np.isnan(measured) else float(row[4]) == pytest.approx(measured, rel=1e-4)
    answers = rows_of((pages / "plain.html").read_text(encoding="utf-8"), "findings")
    assert [row[1] for row in answers] == ["yes", "yes", "yes", "5°"]


def test_the_map_says_its_shares(pages, maps):
    rows = rows_of((pages / "findings.html").read_text(encoding="utf-8"), "shares")
    assert rows[3][1:] == [f"<strong>{100 * m.share:.1f} %</strong>" for m in maps]


def test_pictures_are_the_same_every_time(maps):
    assert findings_svg(maps) == findings_svg(maps)
    ET.fromstring(findings_svg(maps[:1]))


def test_bars_stand_where_their_values_are():
    """A missing bar leaves a gap; the heights of the others keep their ratio."""

    def heights(values):
        svg = base64.b64decode(bar_chart(["a", "b"], [("s", "#123456", values)], "x", "1").partition(",")[2])
        paths = [e.get("d") for e in ET.fromstring(svg).iter() if "#123456" in (e.get("style") or "")]
        corners = [[float(y) for _, y in re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", d)] for d in paths]
        return [max(c) - min(c) for c in corners]

    first, second = heights([1.0, 3.0])
    assert second / first == pytest.approx(3.0, rel=1e-3)
    gap, there = heights([None, 3.0])
    assert gap == 0.0 < there


def test_a_folder_that_is_not_there_is_one_error(experiments, tmp_path):
    with pytest.raises(RecordError, match="cannot write"):
        write_experiment_page(experiments["plain"], tmp_path / "nowhere" / "page.html")


@pytest.mark.browser
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", [390, 1100])
def test_a_browser_finds_the_page_silent_and_whole(page, pages, name, width):
    address = (pages / f"{name}.html").as_uri()
    page.open(address, width=width)
    assert page.complaints() == []
    assert page.requests() == [address]
    pictures = page.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth, i.alt])")
    assert len(pictures) == (1 if name == "findings" else 3)
    assert all(complete and width > 100 and alt for complete, width, alt in pictures)
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
