"""Pages of statistics: what they say, that they ask for nothing outside, and that a browser and a printer take them."""

import re

import numpy as np
import pytest

from anisoscope.base.errors import RecordError
from anisoscope.calibration.linearity import TransferCurve
from anisoscope.calibration.record import dated, write_calibration
from anisoscope.quality.attribute import AttributeData, attribute_study
from anisoscope.quality.bias import bias_study
from anisoscope.quality.camera import read_camera
from anisoscope.quality.capability import Specification
from anisoscope.quality.control import Settings, control_study
from anisoscope.quality.gauge import GaugeData, gauge_study
from anisoscope.quality.limits import counted_points, individuals
from anisoscope.quality.linearity import gauge_linearity
from anisoscope.quality.measurement_process import measurement_process, standards_study, type_one
from anisoscope.quality.stability import stability_study
from anisoscope.report.camera_page import write_camera_page
from anisoscope.report.msa_page import (
    write_attribute_page,
    write_bias_page,
    write_gauge_page,
    write_linearity_page,
    write_process_page,
    write_stability_page,
    write_type_one_page,
)
from anisoscope.report.spc_page import write_spc_page

NAMES = (
    *("spc", "many", "gauge", "bias", "linearity", "stability", "camera", "old-camera"),
    *("attribute", "type-one", "process"),
)
PICTURES = {
    "spc": 5,
    "many": 2,
    "gauge": 2,
    "bias": 1,
    "linearity": 1,
    "stability": 2,
    "camera": 3,
    "old-camera": 0,
    "attribute": 2,
    "type-one": 1,
    "process": 1,
}
NASTY = "<script>alert('x')</script>"


def series(rng, count, name):
    values = rng.normal(size=count)
    values[count // 2] = 6.0
    values[3] = np.nan
    labels = tuple(f"{NASTY if k == count // 2 else 'SN'}-{k}" for k in range(count))
    return control_study(name, individuals(values, labels), Settings(), Specification(-4.0, 4.0))


def lots(rng):
    """Shares of lots of different size."""
    sizes = rng.integers(20, 90, size=30)
    return counted_points(rng.binomial(sizes, 0.2), sizes, tuple(f"{NASTY}{k}" for k in range(30)), "p-laney")


def camera_record(folder, *, curve):
    exposure = np.linspace(0.02, 1.3, 20)
    electrons = np.minimum(20_000.0 * exposure, 20_000.0)
    signal, shot = 0.2 * electrons, np.where(electrons < 20_000.0, 0.04 * electrons, 0.0)
    level = np.full(20, 64.0)
    found = TransferCurve(exposure, exposure, level + signal, level, shot + 4.0, np.full(20, 4.0), 4096)
    values = {
        "gain": 0.2,
        "read_noise": 10.0,
        "saturation": 19_000.0,
        "prnu": 0.01,
        "dsnu": 5.0,
        "raw_error": 0.001,
    }
    values |= {"linearity_error": 0.001, "snr_max": 138.0, "dynamic_range": 1800.0}
    content = {
        "rig": NASTY,
        "camera": {"model": "SIM", "serial": "1", "rows": 64, "cols": 64, "bit_depth": 12},
        "exposure_s": 1.3,
        "gain": 1.0,
        "frames": 40,
        "values": {name: {"value": value} for name, value in values.items()},
        "details": {"curve": found.content()} if curve else {},
    }
    return read_camera(
        write_calibration(dated("linearity", content, valid_days=1.0), folder / f"{curve}.json")
    )


@pytest.fixture(scope="module")
def studies():
    rng = np.random.default_rng(4)
    values = (
        rng.normal(size=(10, 1, 1)) + 0.2 * rng.normal(size=(1, 3, 1)) + 0.3 * rng.normal(size=(10, 3, 3))
    )
    references = np.repeat([2.0, 4.0, 6.0], 6)
    readings = 6.0 + 0.1 * rng.normal(size=30)
    return {
        "spc": [
            series(rng, 80, "ln 0-90"),
            series(rng, 60, "ln 0-90, lot 2"),
            control_study(NASTY, lots(rng), Settings(chart="p-laney")),
        ],
        "many": [series(rng, 30_000, "drift")],
        "gauge": gauge_study(GaugeData(tuple("abcdefghij"), ("Ada", NASTY, "Eve"), values), 8.0),
        "bias": (bias_study(readings, 6.0), readings),
        "linearity": gauge_linearity(references, references + 0.1 * rng.normal(size=18)),
        "attribute": attribute_study(
            AttributeData(
                tuple(map(str, range(9))),
                ("Ada", NASTY),
                np.repeat(np.array([0, 0, 1, 1, 1, 1, 1, 0, 0])[:, None, None], 2, axis=1),
                np.array([0, 0, 1, 1, 1, 1, 1, 0, 0]),
                np.arange(9.0),
            ),
            4.0,
        ),
        "type-one": type_one(readings, 6.0, 8.0),
        "process": measurement_process(
            8.0,
            standards_study(np.full(30, 6.0), readings),
            gauge_study(GaugeData(tuple("abcdefghij"), ("Ada", NASTY, "Eve"), values)),
        ),
        "readings": readings,
        "stability": stability_study(readings, tuple(map(str, range(30))), Settings(), 6.0),
    }


@pytest.fixture(scope="module")
def pages(studies, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    for name in ("spc", "many"):
        write_spc_page(
            folder / f"{name}.html",
            "Control charts",
            "history",
            studies[name],
            [(one, None, None) for one in studies[name]],
            [NASTY],
        )
    write_gauge_page(folder / "gauge.html", "Gauge R&R", NASTY, studies["gauge"])
    write_bias_page(folder / "bias.html", "Bias", "file", *studies["bias"])
    write_linearity_page(folder / "linearity.html", "Linearity", "file", studies["linearity"])
    write_stability_page(folder / "stability.html", "Stability", "file", studies["stability"])
    write_attribute_page(folder / "attribute.html", "Attributes", NASTY, studies["attribute"])
    write_type_one_page(folder / "type-one.html", "Type 1", NASTY, studies["type-one"], studies["readings"])
    write_process_page(folder / "process.html", "Process", NASTY, studies["process"])
    write_camera_page(folder / "camera.html", camera_record(folder, curve=True))
    write_camera_page(folder / "old-camera.html", camera_record(folder, curve=False))
    return folder


@pytest.fixture(scope="module")
def page_of(pages, parsed):
    return lambda name: parsed(pages / f"{name}.html")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_runs_nothing_and_refers_to_nothing_outside(page_of, name):
    elements = page_of(name)
    assert not {"script", "link", "iframe", "object", "base", "form"} & {tag for tag, _ in elements.found}
    images = [attributes for tag, attributes in elements.found if tag == "img"]
    assert len(images) == PICTURES[name]
    assert all(one["src"].startswith("data:image/svg+xml;base64,") and len(one["alt"]) > 30 for one in images)
    assert sum(tag == "h1" for tag, _ in elements.found) == 1
    assert re.findall(r"\d%", elements.words) == []
    for tag, attributes in elements.found:
        if tag == "div" and attributes.get("class") == "wide":
            assert (attributes["tabindex"], attributes["role"]) == ("0", "region")
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in {"col", "row"}


def test_the_control_page_says_what_the_study_says(pages, studies, page_of):
    source = (pages / "spc.html").read_text(encoding="utf-8")
    text = page_of("spc").text
    for study in studies["spc"]:
        assert study.verdict.partition(",")[0].removeprefix("not stable: ").lower() in text.lower()
    assert NASTY not in source
    assert "ln 0-90, lot 2" in text
    rules = re.search(r'<table id="flags">.*?<tbody>(.*?)</tbody>', source, re.DOTALL)[1]
    assert len(re.findall("<tr>", rules)) == len(studies["spc"][0].flags)
    assert "Cpk (short term)" in text
    assert "Anderson-Darling" in text


def test_the_gauge_page_says_the_shares(page_of, studies):
    study = studies["gauge"]
    text = page_of("gauge").text
    assert f"{100 * study.share_of_study(study.gauge):.1f} %" in text
    assert f"{100 * study.share_of_tolerance(study.gauge):.1f} %" in text
    assert f"(ndc): {study.categories}" in text


def test_the_camera_page_says_values_in_words_of_the_standard(page_of):
    text = page_of("camera").text
    for words in ("system gain K", "DSNU1288", "PRNU1288", "5 e for one count", "65.1 dB, 10.8 bit"):
        assert words in text
    assert "no transfer curve" in page_of("old-camera").text


def test_a_folder_that_is_not_there_is_one_error(studies, tmp_path):
    with pytest.raises(RecordError, match="cannot write"):
        write_linearity_page(tmp_path / "none" / "x.html", "x", "y", studies["linearity"])


@pytest.mark.browser
@pytest.mark.parametrize("name", NAMES)
def test_a_browser_finds_the_page_silent_and_whole(page, pages, name):
    address = (pages / f"{name}.html").as_uri()
    for width in (390, 1100):
        page.open(address, width=width)
        assert page.complaints() == []
        assert page.requests() == [address]
        images = page.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth])")
        assert all(complete and wide > 100 for complete, wide in images)
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


# relative luminance and contrast after WCAG 2
CONTRAST = """(() => {
  const channel = c => (c /= 255) <= .03928 ? c / 12.92 : ((c + .055) / 1.055) ** 2.4;
  const light = t => { const [r, g, b] = t.match(/[\\d.]+/g).map(Number).map(channel);
    return .2126 * r + .7152 * g + .0722 * b; };
  const ground = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor;
    if (!/, 0\\)$/.test(c)) return c; } return 'rgb(255, 255, 255)'; };
  return Math.min(...[...document.querySelectorAll('h1,h2,h3,p,th,td,caption,figcaption,dt,dd')].map(e => {
    const a = light(getComputedStyle(e).color), b = light(ground(e));
    return (Math.max(a, b) + .05) / (Math.min(a, b) + .05); }));
})()"""


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["spc", "gauge", "camera"])
def test_texts_stand_out_in_the_light_and_in_the_dark(page, pages, name, scheme):
    try:
        page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        page.open((pages / f"{name}.html").as_uri())
        assert page.evaluate(CONTRAST) >= 4.5
        shade = page.evaluate("getComputedStyle(document.querySelector('main')).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", shade))) < 200) == (scheme == "dark")
    finally:
        page.call("Emulation.setEmulatedMedia", features=[])


@pytest.mark.browser
@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_cut_off_on_a_printed_a4_page(page, pages, name):
    try:
        page.call("Emulation.setEmulatedMedia", media="print")
        page.open((pages / f"{name}.html").as_uri(), width=688)  # 182 mm of text at 96 dpi
        wide = "[...document.querySelectorAll('main, .wide, table')].filter(e => e.scrollWidth > e.clientWidth + 1)"
        assert page.evaluate(f"{wide}.length") == 0
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize(("noise", "shade"), [(0.02, "good"), (0.2, "fair"), (0.6, "bad")])
def test_a_gauge_page_is_green_amber_or_red_by_its_share(tmp_path, noise, shade):
    rng = np.random.default_rng(8)
    values = rng.normal(size=(10, 1, 1)) + noise * rng.normal(size=(10, 3, 3))
    write_gauge_page(
        tmp_path / "g.html",
        "Gauge",
        "file",
        gauge_study(GaugeData(tuple("abcdefghij"), ("A", "B", "C"), values)),
    )
    assert f'class="verdict {shade}"' in (tmp_path / "g.html").read_text("utf-8")
