"""Plates rendered by Mitsuba 3 (tools/render_mitsuba_plates.py), judged as `inspect --frames` judges them.

The renderer shares nothing with the prediction, and light goes from field to field.
"""

import re
import tarfile

import pytest

from anisoscope.inspection.replay import inspect_frames

FIELDS = {
    "good-1": {},
    "good-2": {},
    "dead": {(3, 4): {"missing"}, (6, 8): {"missing"}, (9, 2): {"missing", "filled"}},
    "one-worn": {(4, 5): {"worn"}},
    "turned-field": {(7, 3): {"wrong direction"}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, request):
    found = tmp_path_factory.mktemp("mitsuba-plates")
    archive = request.config.rootpath / "tests" / "data" / "mitsuba" / "plates.tar.xz"
    with tarfile.open(archive) as packed:
        packed.extractall(found, filter="data")
    return found


@pytest.mark.parametrize("name", FIELDS)
def test_rendered_plates_get_their_verdicts(folder, name, undiagnosed, judged_figure):
    record = inspect_frames(
        folder / name,
        folder / "recipe.toml",
        name,
        folder / "out",
        rig_path=folder / "rig.toml",
        methods=undiagnosed,
    ).record
    details = record.details
    found = {(one.row, one.col): one for one in details.fields}
    assert set(found) == set(FIELDS[name])
    assert all(found[place].looks_like in words for place, words in FIELDS[name].items())
    assert details.code.unread == ()
    deviations = [abs(one.measured - one.predicted) / one.u for one in details.contrasts]
    assert max(deviations) < 2.5
    fields = f"{len(FIELDS[name])} with defects" if FIELDS[name] else "all good"
    shown = f"{record.verdict}, {len(found)} deviate"
    judged_figure("Plates", f"144 fields, {fields}", f"Mitsuba, frames of {name}", shown, "as many deviate")
    if name.startswith("good"):
        assert record.verdict == "PASS"
        grades = {one.parameter: one.measured_grade for one in details.code.grades}
        assert grades["overall grade"] == 4
    elif name == "one-worn":  # 13 % of brightness, within the tolerance of a field
        assert found[4, 5].significant
        assert record.verdict != "FAIL"
    else:
        assert record.verdict == "FAIL"


@pytest.mark.parametrize(
    ("name", "verdict", "radius"),
    [("good-1", "PASS", 0), ("all-worn-10", "PASS", 10), ("all-worn-15", "FAIL", 15)],
)
def test_what_all_fields_share_is_excluded_with_an_unmeasured_lobe(
    folder, name, verdict, radius, undiagnosed, judged_figure
):
    """By the recipe as `design code` writes it: no tolerance, no golden plates; the limit covers what is there."""
    text = (folder / "recipe.toml").read_text()
    text = re.sub(r"^(tolerance|alpha|u_tail|u_alpha_share|u_albedo) .*\n", "", text, flags=re.MULTILINE)
    recipe = folder / "unmeasured.toml"
    recipe.write_text(text.replace("[decision]", '[decision]\nunexcluded = "inconclusive"'))
    record = inspect_frames(
        folder / name, recipe, f"{name}-u", folder / "out", rig_path=folder / "rig.toml", methods=undiagnosed
    ).record
    assert record.verdict == verdict
    shown = verdict
    if verdict == "PASS":
        (worn,) = [one for one in record.details.exclusions if one.words == "every field worn to "]
        assert radius <= worn.size * worn.limit < 15.0
        shown = f"PASS, excluded beyond {worn.size * worn.limit:.0f} µm"
        assert f"every field worn to {worn.size * worn.limit:.2g} µm" in record.reasons[0]
    judged_figure(
        "Plates",
        f"144 fields, all crests of {radius} µm, lobe unmeasured",
        f"Mitsuba, frames of {name}",
        shown,
        "no PASS from 15 µm",
    )
