"""The numbers of docs/uncertainty.md, and of its evidence, are those of the commands that they name."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from anisoscope.cli.options import OF_UNCERTAINTY
from anisoscope.cli.predict.output import contrast_u, radiance_u
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty, default_uncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.monte_carlo import MonteCarlo
from anisoscope.prediction.predict import predict_design
from anisoscope.sim.light.geometry import pose_grid

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = "".join(
    (DOCS / name).read_text(encoding="utf-8") for name in ("uncertainty.md", "evidence/uncertainty.md")
)
POSES = pose_grid((0.0, 90.0, 180.0))


@pytest.fixture(scope="module")
def example():
    return predict_design(
        RidgeDesign(100.0, 10.0), Material(), POSES, Convention(), inputs=default_uncertainty(Material())
    )


def assert_quoted(pattern, *values):
    """The page has the text, with the numbers in place of `#`, each within one unit of its last digit."""
    number = r"([+-]?\d+(?:\.\d+)?)"
    quoted = [found.groups() for found in re.finditer(re.escape(pattern).replace(r"\#", number), PAGE)]
    assert len(quoted) == 1, pattern
    for text, value in zip(quoted[0], values, strict=True):
        decimals = len(text.partition(".")[2])
        assert float(text) == pytest.approx(value, abs=10.0**-decimals), (pattern, text, value)


def test_the_example_is_what_the_command_prints(example):
    for pose, value, u in zip(POSES, example.radiance, radiance_u(example), strict=True):
        assert_quoted(f"| {pose.stage_deg:g}° | # ± # | # % |", value, u, 100.0 * u / value)
    for number, pair in enumerate(example.contrasts):
        values = []
        for kind in ("difference", "michelson", "log_ratio"):
            values += [getattr(pair, kind), contrast_u(example, kind)[number]]
        assert_quoted(f"| {pair.from_deg:g}° / {pair.to_deg:g}° | # ± # | # ± # | # ± # |", *values)


def test_the_sources_that_lead_are_those_of_the_budget(example):
    share = {c.source: abs(example.budget.relative(c.absolute)) * 100.0 for c in example.budget.contributions}
    leading = [
        "tail of the lobe",
        "roughness along the ridges",
        "roughness across the ridges",
        "refractive index",
    ]
    assert_quoted(
        "the unmeasured tail (# %), roughness along the ridges (# %) and across (# %) and the index (# %) lead",
        *(share[source][0] for source in leading),
    )
    assert set(sorted(share, key=lambda source: -share[source][0])[:4]) == set(leading)
    assert_quoted(
        "the tail (# %, # %) and the albedo (# %, # %) do",
        *share["tail of the lobe"][1:],
        *share["albedo of the plastic"][1:],
    )
    for pose in (1, 2):
        assert sorted(share, key=lambda source: -share[source][pose])[:2] == [
            "tail of the lobe",
            "albedo of the plastic",
        ]
    _, ratio = contrast_u(example, "log_ratio")
    apart = 100.0 * np.hypot(*(example.budget.u() / example.radiance)[1:])
    assert_quoted("is known to # %, each of them only to # %", 100.0 * ratio, 0.5 * apart * np.sqrt(2.0))
    assert_quoted("uncertainties alone would say # %", apart)


@pytest.mark.soak  # 2,000 draws; each of the other numbers of the page is read in every run
def test_the_broken_case_is_what_the_command_prints():
    inputs = InputUncertainty(alpha_share=0.0, index=0.0, seating_tilt_deg=1.5, tail=0.0)
    found = predict_design(
        RidgeDesign(100.0, 5.0),
        Material(0.03, 0.03),
        pose_grid((0.0, 180.0)),
        Convention(),
        inputs=inputs,
        monte_carlo=MonteCarlo(2000),
    )
    assert_quoted(
        "At 0° L = # 1/sr; first order says u = #, the budget with its second order #, the draws say #, "
        "about a mean of #. Without",
        found.radiance[0],
        found.budget.first_order().u()[0],
        found.budget.u()[0],
        found.drawn.u()[0],
        found.drawn.radiance[:, 0].mean(),
    )


def test_coarse_pixels_are_what_the_figure_shows(pixel_bias_script):
    poses = pose_grid((0.0, 90.0, 180.0), (-10.0, 0.0, 10.0))

    def bias(pitch, angle, *pixels):
        return pixel_bias_script.find_pixel_bias(
            RidgeDesign(pitch, angle), np.array(pixels), Material(), poses, Convention()
        )

    shown = bias(100.0, 5.0, *np.geomspace(0.1, 5.0, 18)[-4:])
    assert_quoted("stays below u (# u at worst)", (shown.rms / shown.u).max())
    assert_quoted("and at least # % lie within 2 u", 100.0 * shown.within.min())
    coarse = bias(50.0, 10.0, 5.0)
    assert_quoted("pixels of 5 µm the rms is # u", coarse.rms[0] / coarse.u[0])
    one = bias(100.0, 5.0, 1.0)
    text = "(wall # µm at pitch 100 µm)\n  u is # %, the rms bias # %"
    assert_quoted(text, one.design.wall_width_um, 100.0 * one.u[0], 100.0 * one.rms[0])


def test_the_defaults_of_the_table_are_the_defaults():
    names = {OF_UNCERTAINTY.option(field.name): field.name for field in fields(InputUncertainty)}
    shares = {"--u-albedo": 0.2}  # a share of the albedo
    for option, text in re.findall(r"`(--(?:u-|light-field)[a-z-]*)`(?:, `[^`]*`)? \(([\d.]+)", PAGE):
        usual = getattr(OF_UNCERTAINTY.default, names[option])
        assert float(text) * shares.get(option, 1.0) == pytest.approx(usual), option
