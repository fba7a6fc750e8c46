"""``anisoscope recipe yield`` as a user calls it."""

import pytest

FEW = ("--parts", 4, "--rigs", 2, "--jobs", 1)


@pytest.fixture(scope="module")
def recipe(anisoscope, tmp_path_factory):
    path = tmp_path_factory.mktemp("yield") / "plate.toml"
    made = anisoscope("recipe", "new", "--ridge-angle", 10, "--out", path)
    assert made.code == 0, made.err
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("# tolerance = 0.25", "tolerance = 1.5"), encoding="utf-8")
    return path


def test_verdicts_risks_and_contrasts_are_printed(anisoscope, recipe):
    done = anisoscope("recipe", "yield", recipe, *FEW, "--scatter", "ridge_angle=0.3")
    assert done.code == 0, done.err
    assert "no rig file: light at 10° is assumed" in done.err
    for words in ("PASS", "consumer's risk", "0°/90° @ 0°", "±1.5", "reference: the prediction"):
        assert words in done.out


def test_json_holds_the_lot_and_its_yield(anisoscope, recipe):
    done = anisoscope("recipe", "yield", recipe, *FEW, "--shift", "alpha=0.1", "--json", "--light-angle", 12)
    assert (done.code, done.err) == (0, "")
    assert done.json["shift"]["alpha"] == 0.1
    assert done.json["scatter"]["alpha"] == 0.05
    assert sum(one["count"] for one in done.json["yield"]["verdicts"].values()) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scatter", "stage=1"], "--scatter does not know 'stage'; it knows ridge_angle, alpha"),
        (["--shift", "alpha"], "--shift takes NAME=VALUE"),
        (["--parts", "1"], "not 1 parts on 25"),
        (["--jobs", "0"], "--jobs takes 1 or more"),
    ],
)
def test_wrong_options_are_one_line(anisoscope, recipe, arguments, message):
    done = anisoscope("recipe", "yield", recipe, *arguments)
    assert done.code == 64
    assert message in done.err
    assert done.err.strip().count("\n") == 0


def test_a_print_has_no_lot(anisoscope, tmp_path):
    path = tmp_path / "print.toml"
    assert anisoscope("recipe", "new", "--ink", "synthetic-red", "--out", path).code == 0
    done = anisoscope("recipe", "yield", path)
    assert done.code == 64
    assert "a lot is drawn where a recipe states how good parts differ" in done.err
