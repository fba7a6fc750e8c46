"""What the docs show works as it stands."""

import re
from functools import partial
from pathlib import Path

import pytest

from anisoscope import explaining
from anisoscope.calibration.pictures import take_flat
from anisoscope.diagnosis.signatures import signatures
from anisoscope.inspection import inspect_part
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import RidgeDesign, add_facet_roughness, ridges
from anisoscope.recipe import read_recipe

DOCS = Path(__file__).resolve().parents[2] / "docs"


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def copied(tmp_path, rng):
    """Recipe, rig and bench as the docs show them, with the virtual rig's drivers in place of the hardware's."""
    recipe, rig = blocks("recipe-and-rig.md", "toml")
    (bench,) = blocks("virtual-rig.md", "toml")
    rig = rig.replace('"/dev/ttyUSB0"', '"sim://elliptec?bench=${here}/bench.toml"')
    rig = rig.replace('driver = "manual"', 'driver = "simulated"')
    rig = rig.replace("[geometry]", '[light.options]\nbench = "${here}/bench.toml"\n[geometry]', 1)
    (tmp_path / "recipe.toml").write_text(recipe)
    (tmp_path / "rig.toml").write_text(rig)
    (tmp_path / "bench.toml").write_text(bench)
    surface = ridges(RidgeDesign(100.0, 10.0), (501, 1001), 1.0)
    write_height_map(add_facet_roughness(surface, 0.03, 0.03, 8.0, rng), tmp_path / "reference.x3p")
    return tmp_path


def test_recipe_rig_and_bench_of_the_docs_inspect_a_part(copied, monkeypatch):
    # the diagnosis has tests of its own, and takes longer than this one
    monkeypatch.setattr(explaining, "remembered_signatures", partial(signatures, names=("colour",)))
    bench = (copied / "bench.toml").read_text()
    (copied / "bench.toml").write_text(bench.replace('kind = "ridges"', 'kind = "white-tile"'))
    take_flat(copied / "rig.toml", copied / "flat.tif", exposure_s=0.006, frames=4)
    (copied / "bench.toml").write_text(bench)
    record = inspect_part(copied / "recipe.toml", copied / "rig.toml", "DOC-1", copied / "out").record
    assert record.verdict == "FAIL"  # the bench of the docs has burrs on a tenth of its area
    assert "area" in record.reasons[0]
    (copied / "bench.toml").write_text(bench.replace("burr_coverage = 0.1", "burr_coverage = 0.0"))
    record = inspect_part(copied / "recipe.toml", copied / "rig.toml", "DOC-2", copied / "out").record
    assert record.verdict == "PASS", record.reasons


def test_defaults_that_the_docs_show_are_the_defaults(copied):
    shown = read_recipe(copied / "recipe.toml")
    text = (copied / "recipe.toml").read_text()
    for table in ("limits", "uncertainty"):
        text = re.sub(rf"^\[{table}\].*?(?=^\[|\Z)", "", text, flags=re.DOTALL | re.MULTILINE)
    (copied / "recipe.toml").write_text(text)
    silent = read_recipe(copied / "recipe.toml")
    assert (silent.limits, silent.uncertainty) == (shown.limits, shown.uncertainty)


def test_links_of_all_pages_lead_somewhere():
    for page in [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *DOCS.rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), (page, target)
