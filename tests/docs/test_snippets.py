"""What the docs show works as it stands."""

import re
from pathlib import Path

import numpy as np
import pytest

from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.run import Methods, inspect_part
from anisoscope.kinds.kind import Explanation
from anisoscope.kinds.registry import read_recipe
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.report.inspection_page import Sections
from anisoscope.rig.acquisition.opening import open_rig
from anisoscope.rig.bayer import channel_of_pixels
from anisoscope.rig.rigfile import read_rig
from anisoscope.sim.light.colour.vision import Vision
from anisoscope.sim.light.geometry import directions
from anisoscope.sim.light.ink.model import brdf
from anisoscope.sim.materials.inks import synthetic_ink
from anisoscope.sim.materials.spectra import find_illuminant, find_sensitivities

DOCS = Path(__file__).resolve().parents[2] / "docs"


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def copied(tmp_path, rng):
    """Recipe, rig and bench as the docs show them, with the virtual rig's drivers in place of the hardware's."""
    recipe, rig = blocks("recipe-and-rig.md", "toml")
    bench, _ = blocks("virtual-rig.md", "toml")  # the second one breaks it
    rig = rig.replace('"/dev/ttyUSB0"', '"sim://elliptec?bench=${here}/bench.toml"')
    rig = rig.replace('driver = "manual"', 'driver = "simulated"')
    rig = rig.replace("[geometry]", '[light.options]\nbench = "${here}/bench.toml"\n[geometry]', 1)
    (tmp_path / "recipe.toml").write_text(recipe)
    (tmp_path / "rig.toml").write_text(rig)
    (tmp_path / "bench.toml").write_text(bench)
    surface = ridges(RidgeDesign(100.0, 10.0), (501, 1001), 1.0)
    write_height_map(add_facet_roughness(surface, 0.03, 0.03, 8.0, rng), tmp_path / "reference.x3p")
    return tmp_path


def test_recipe_rig_and_bench_of_the_docs_inspect_a_part(copied):
    # diagnosis and report have tests of their own, and take longer than this one
    methods = Methods(
        diagnose=lambda *_: Explanation(),
        start_renderer=lambda _: None,
        sections=lambda *_: Sections(),
        page=lambda record, *_: record.verdict,
    )

    def inspect(serial):
        files = copied / "recipe.toml", copied / "rig.toml"
        return inspect_part(*files, serial, copied / "out", methods=methods).record

    for name, shown, quick in (
        ("bench.toml", "time_scale = 0.1", "time_scale = 0.0"),
        ("bench.toml", "read_noise_e = 6.0", "rows = 512\ncols = 512\nread_noise_e = 6.0"),
        ("bench.toml", "size_mm = 2.4", "size_mm = 1.4"),
        ("recipe.toml", "size_mm = [2.0, 2.0]", "size_mm = [1.0, 1.0]"),
        ("bench.toml", "[optics]  ", "[optics]\npixel_um = 8.0\n#"),
        ("rig.toml", "pixel_um = 4.0", "pixel_um = 8.0"),
        ("recipe.toml", "frames_per_pose = 4\ndark_frames = 8", "frames_per_pose = 2\ndark_frames = 2"),
    ):
        text = (copied / name).read_text()
        assert shown in text
        (copied / name).write_text(text.replace(shown, quick))
    bench = (copied / "bench.toml").read_text()
    (copied / "bench.toml").write_text(bench.replace('kind = "ridges"', 'kind = "white-tile"'))
    take_flat(copied / "rig.toml", copied / "flat.tif", exposure_s=0.006, frames=4)
    (copied / "bench.toml").write_text(bench)
    record = inspect("DOC-1")
    assert record.verdict == "FAIL"  # the bench of the docs has burrs on a tenth of its area
    assert "area" in record.reasons[0]
    (copied / "bench.toml").write_text(bench.replace("burr_coverage = 0.1", "burr_coverage = 0.0"))
    record = inspect("DOC-2")
    assert record.verdict == "PASS", record.reasons


def test_bench_and_rig_for_colour_photograph_a_print(tmp_path):
    """The radiance of the ink comes out of the docs' own rig, white balanced by the docs' own lamp and camera."""
    bench, rig_file = blocks("virtual-prints.md", "toml")
    (tmp_path / "bench.toml").write_text(bench.replace("time_scale = 0.1", "time_scale = 0.0"))
    (tmp_path / "rig.toml").write_text(rig_file)
    file = read_rig(tmp_path / "rig.toml")
    middle = slice(472, 552)
    with open_rig(file) as rig:
        for axis in rig.axes:
            axis.home()
        rig.stage.move_to(file.stage.reading(20.0))
        rig.tilt.move_to(file.tilt.reading(10.0))
        rig.light.on()
        rig.camera.configure(0.006, 1.0)
        counts = rig.camera.grab()[middle, middle].astype(float) - rig.camera.info.black_level
        filters = rig.camera.info.filters
    vision = Vision(
        find_illuminant(file.light.spectrum), find_sensitivities(file.camera.sensitivities, filters)
    )
    seen = channel_of_pixels(filters, counts.shape)
    found = (
        np.array([counts[seen == k].mean() for k in range(3)]) * 7.5 / (6.0e6 * 0.006) / vision.strengths()
    )
    ink = synthetic_ink("synthetic-red")
    to_light, to_camera = directions((Pose(20.0, 10.0),), Convention())
    expected = to_light[0, 2] * brdf(ink, to_light[0], to_camera[0]) @ vision.weights(ink.nm)
    np.testing.assert_allclose(found - 0.0002, expected, rtol=0.01)  # less the stray light


def test_defaults_that_the_docs_show_are_the_defaults(copied):
    shown = read_recipe(copied / "recipe.toml")
    text = (copied / "recipe.toml").read_text()
    for table in ("limits", "uncertainty"):
        text = re.sub(rf"^\[{table}\].*?(?=^\[|\Z)", "", text, flags=re.DOTALL | re.MULTILINE)
    (copied / "recipe.toml").write_text(text)
    silent = read_recipe(copied / "recipe.toml")
    assert (silent.limits, silent.uncertainty) == (shown.limits, shown.uncertainty)


def test_links_of_all_pages_lead_to_checked_in_files():
    for page in [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *DOCS.rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), (page, target)
