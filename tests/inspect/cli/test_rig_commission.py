"""``rig commission`` and ``rig check`` as a user calls them."""

import io
import re
import sys

import pytest
import tomli_w

from anisoscope.calibration.record import read_calibration
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.rig.rigfile import read_rig

BENCH = {
    "schema": 1,
    "seed": 3,
    "sample": {"kind": "ridges", "size_mm": 1.2, "resolved_alpha": 0.0, "reflections": False},
    "sensor": {"rows": 512, "cols": 512},
    "optics": {"pixel_um": 8.0, "blur_um": 5.0, "electrons": 2.4e7},
    "stage": {"time_scale": 0.0, "turns": "cw", "zero_deg": 350.0},
    "geometry": {"light_angle_deg": 9.0},
    "fixture": FIXTURE,
}
RIG = f"""# the rig of the test
schema = 1
name = "small rig"

[stage]
driver = "elliptec"
port = "sim://elliptec?bench=${{here}}/bench.toml"
zero_deg = 10.0  # by eye
options = {{ move_gap_s = 0.0, timeout_s = 0.2 }}

[camera]
driver = "simulated"
pixel_um = 8.0
options = {{ bench = "${{here}}/bench.toml" }}

[light]
driver = "simulated"
angle_deg = 10.0
options = {{ bench = "${{here}}/bench.toml" }}

[fixture]
{tomli_w.dumps(FIXTURE)}"""
COMMON = (
    "--exposure",
    "0.0015",
    "--ridge-angle",
    "10",
    "--pitch",
    "100",
    "--spot-mm",
    "1",
    "--settle",
    "0",
    "--yes",
)


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "bench.toml").write_text(tomli_w.dumps(BENCH), encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return path


def laid(rig, **sample):
    """Lay another sample on the stage."""
    bench = {**BENCH, "sample": BENCH["sample"] | sample}
    (rig.parent / "bench.toml").write_text(tomli_w.dumps(bench), encoding="utf-8")


class Operator(io.StringIO):
    """A terminal at which somebody takes the tile away, and answers."""

    def __init__(self, rig, answer):
        super().__init__(answer)
        self.rig = rig

    def isatty(self):
        return True

    def readline(self):
        laid(self.rig, kind="none")
        return super().readline()


@pytest.mark.parametrize("answer", ["\n", "n\n"])
def test_flat_asks_for_the_fixture_after_the_tile_and_teaches_it(rig, monkeypatch, capsys, answer):
    from anisoscope.cli.rig.calibrate import app

    laid(rig, kind="white-tile")
    monkeypatch.setattr(sys, "stdin", Operator(rig, answer))
    flat = [
        "flat",
        "--rig",
        str(rig),
        "--exposure",
        "0.0015",
        "--out",
        str(rig.parent / "flat.tif"),
        "--write",
    ]
    assert app(flat, result_action="return_value", exit_on_error=False) == 0
    told = capsys.readouterr()
    assert "Take the tile away and seat the fixture" in told.err
    now = read_rig(rig).calibration
    assert now.flat == rig.parent / "flat.tif"
    if answer.startswith("n"):
        assert now.fixture is None
        assert "anisoscope calibrate fixture --rig" in " ".join(told.out.split())
    else:
        assert now.fixture == rig.parent / "fixture.json"
        assert read_calibration(now.fixture, "fixture", None).in_limits


def test_a_new_rig_with_a_flat_ends_commissioned_with_a_reference(anisoscope, rig):
    laid(rig, kind="white-tile")
    flat = ("--rig", rig, "--exposure", "0.0015", "--out", rig.parent / "flat.tif", "--write")
    done = anisoscope("calibrate", "flat", *flat)
    assert done.code == 0, done.err
    assert "the tile hid the markers" in " ".join(done.out.split())  # nobody sits at a terminal
    laid(rig)
    done = anisoscope("rig", "commission", "--rig", rig, *COMMON, "--step", "45", "--write")
    assert done.code == 0, done.err
    assert "the markers are taught" in " ".join(done.out.split())
    now = read_rig(rig)
    assert (now.stage.turns, now.calibration.fixture) == ("cw", rig.parent / "fixture.json")

    checked = anisoscope("rig", "check", "--rig", rig, "--exposure", "0.0015", "--count", "8", "--json")
    assert checked.code == 0, checked.out
    outcomes = {one["key"]: one["outcome"] for one in checked.json["checks"]}
    assert {outcomes[f"fixture.{what}"] for what in ("level", "stray", "edge", "gradient")} == {"PASS"}

    rig.write_text(rig.read_text(encoding="utf-8").replace('fixture = "fixture.json"', ""), encoding="utf-8")
    check = ("rig", "check", "--rig", rig, "--exposure", "0.0015", "--count", "8", "--teach")
    assert anisoscope(*check, "--tile").code == 64
    checked = anisoscope(*check)
    assert checked.code == 0, checked.out
    assert "anisoscope rig check --teach" in " ".join(checked.out.split())
    assert read_rig(rig).calibration.fixture == rig.parent / "fixture.json"


def test_commission_finds_and_writes_and_check_agrees(anisoscope, rig, tmp_path):
    before = anisoscope("rig", "check", "--rig", rig, "--exposure", "0.0015", "--count", "8", "--yes")
    assert before.code == 3, before.err
    assert "NOT fit" in before.out
    assert "turns the other way" in " ".join(before.out.split())

    page = tmp_path / "page.html"
    done = anisoscope("rig", "commission", "--rig", rig, *COMMON, "--step", "45", "--write", "--html", page)
    assert done.code == 0, done.err
    assert "rotation sense" in done.out or "growing reading" in " ".join(done.out.split())
    assert page.stat().st_size > 50_000
    now = read_rig(rig)
    assert now.stage.turns == "cw"
    assert now.stage.zero_deg == pytest.approx(350.0, abs=0.05)
    stated = rig.read_text(encoding="utf-8")
    assert re.search(r"zero_deg = 3\d\d\.\d+  # commissioned \d{4}-\d\d-\d\d, u = 0\.\d+ °\n", stated), stated
    assert "# the rig of the test" in stated
    assert (tmp_path / "rig.commissioning.json").is_file()

    after = anisoscope(
        "rig",
        "check",
        "--rig",
        rig,
        "--exposure",
        "0.0015",
        "--count",
        "8",
        "--json",
        "--out",
        tmp_path / "tests",
    )
    assert after.code == 0, after.out
    assert after.json["fit"] is True
    assert next((tmp_path / "tests").iterdir()).name.startswith("selftest-")
    assert "anisoscope calibrate flat --write" in done.out.replace(
        "\n", " "
    )  # without a flat nothing is taught


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--exposure", "0.001"), "name the part on the stage"),
        ((*COMMON[:-1],), "never commissioned"),
        (("--ridge-angle", "10", "--pitch", "100", "--spot-mm", "1"), "give --exposure"),
        ((*COMMON, "--alpha", "0.1,0.2,0.3"), "--alpha takes"),
        ((*COMMON, "--step", "90"), "step must lie"),
        ((*COMMON, "--bounces", "0"), "--bounces must be 1 or more"),
        ((*COMMON, "--bounces", "1", "--all-reflections"), "is --bounces all"),
    ],
)
def test_what_is_missing_is_named(rig, options, message):
    from anisoscope.base.errors import UsageError
    from anisoscope.cli.rig.rig import app

    with pytest.raises(UsageError, match=message):
        app(["commission", "--rig", str(rig), *options], result_action="return_value", exit_on_error=False)
