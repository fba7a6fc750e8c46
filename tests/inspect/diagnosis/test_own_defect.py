"""A new defect is one object in one file: of a package (the example of docs/own-defect.md), or of a notebook."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.base.plugins import Registry
from anisoscope.diagnosis.cause_words import plastic_words
from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.signatures import signatures
from anisoscope.kinds.registry import kind_named
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defect_injection import DEFECTS, Defect, Setting, inject_defect
from anisoscope.profiles.files.load import read_height_map
from anisoscope.profiles.ideal import ridges

DOCS = Path(__file__).resolve().parents[3] / "docs"
EXAMPLE = DOCS / "examples" / "sink"
OURS = (
    *("burrs", "wear", "incomplete-filling", "ridge-angle", "pitch", "rough-facets"),
    *("scratches", "dust", "missing-ridges", "chatter"),
)


def lowered(surface, values, _rng):
    return surface.with_height(surface.height_um * (1.0 - values["loss"]))


SHRUNK = Defect("shrunk", "moulding: shrinkage", Setting("loss", "", "share of the height", 0.4), (), lowered)


def installed(folder, name, points, text):
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[anisoscope.defects]\n{points}\n")
    (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def sink(tmp_path_factory):
    """A folder in which the example is installed."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))
    (point,) = project["project"]["entry-points"]["anisoscope.defects"].items()
    text = (EXAMPLE / "sink.py").read_text(encoding="utf-8")
    return installed(tmp_path_factory.mktemp("sink"), "sink", " = ".join(point), text)


def test_the_defects_are_listed_in_their_places():
    assert tuple(DEFECTS) == OURS
    assert all(one.title and one.plain for one in DEFECTS.values())


def test_an_object_is_all_that_a_new_defect_takes(monkeypatch):
    monkeypatch.setitem(DEFECTS, "shrunk", SHRUNK)
    cause = next(one for one in all_causes(10.0) if one.name == "shrunk")
    assert (cause.title, cause.group, cause.doubt) == ("shrunk, share of the height", "shape", 0.3)
    assert cause.extents == pytest.approx((0.0, 0.02, 0.048, 0.1, 0.2, 0.4))
    part = ridges(RidgeDesign(60.0, 10.0), (40, 240), 1.0)
    spoiled = inject_defect(part, "shrunk", np.random.default_rng(0), severity=0.5)
    assert np.ptp(spoiled.height_um) == pytest.approx(0.8 * np.ptp(part.height_um))
    assert plastic_words()["shrunk"].finding(0.2) == "Shrunk: share of the height of about {size}"
    for name in ("ridges", "plates"):
        assert "shrunk" in kind_named(name).cause_words


def test_the_signature_of_a_new_defect_is_computed(monkeypatch, make_recipe):
    """Ridges that are lower with the same pitch are flatter: they shine as those of a smaller ridge angle."""
    monkeypatch.setitem(DEFECTS, "shrunk", SHRUNK)
    found = signatures(make_recipe(), 10.0, names=("shrunk", "ridge-angle"))
    change = {one.cause.name: one for one in found.found}
    flatter = np.degrees(np.arctan(0.9 * np.tan(np.radians(10.0)))) - 10.0
    np.testing.assert_allclose(
        change["shrunk"].at(0.1)[0], change["ridge-angle"].at(float(flatter))[0], atol=0.03
    )


def test_a_package_brings_a_defect(anisoscope, sink, tmp_path):
    listed = anisoscope("profile", "spoil", "--list", "--json", path=[sink]).json
    assert list(listed) == [*OURS, "sink"]
    part, out = tmp_path / "part.npz", tmp_path / "sunk.npz"
    made = anisoscope("profile", "make", "ridges", "--size", "100,200", "--out", part)
    assert made.code == 0, made.err
    done = anisoscope("profile", "spoil", part, "sink", "--depth-um", "4", "--out", out, path=[sink])
    assert done.code == 0, done.err
    change = read_height_map(out).height_um - read_height_map(part).height_um
    assert change.min() == pytest.approx(-4.0, abs=0.01)


def test_an_action_for_it_may_stand_in_a_recipe(anisoscope, sink, virtual_rig):
    """The arm is looked at after the actions, and signatures of all causes, which take long, after the arm."""
    part = virtual_rig(recipe={"actions": {"sink": "Set it aside"}, "poses": {"tilts_deg": [85.0]}})
    command = ("recipe", "check", part.recipe, "--rig", part.rig)
    assert "actions.sink: no cause" in anisoscope(*command).err
    known = anisoscope(*command, path=[sink]).err
    assert "actions.sink" not in known
    assert "a tilt of 85° was asked for" in known


@pytest.mark.parametrize(
    ("points", "text", "says"),
    [
        ("dent = dent:MISSING", "", "the defect 'dent' does not load: "),
        ("dent = dent:DENT", "DENT = 3", "the defect 'dent' does not load: 3 is no object of Defect"),
        (
            "dent = dent:SINK",
            (EXAMPLE / "sink.py").read_text(encoding="utf-8"),
            "the defect 'dent' does not load: it calls itself 'sink'",
        ),
        ("wear = dent:DENT", "DENT = 3", "several packages install a defect 'wear': anisoscope, dent"),
    ],
)
def test_one_that_does_not_load_is_one_line(tmp_path, monkeypatch, points, text, says):
    monkeypatch.syspath_prepend(installed(tmp_path, "dent", points, text))
    monkeypatch.delitem(sys.modules, "dent", raising=False)
    with pytest.raises(HeightMapError) as caught:
        dict(Registry("anisoscope.defects", "defect", Defect, HeightMapError))
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)
