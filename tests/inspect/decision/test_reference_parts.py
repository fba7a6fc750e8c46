"""Sets of reference parts: their files, which rows count, and when they serve as the reference."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError
from anisoscope.base.significance import like_sample
from anisoscope.decision.reference_parts import GoldenPart, GoldenSet, RadianceSet, counted, write_golden

POSES = ((0.0, 0.0), (90.0, 0.0), (180.0, 0.0))


def part(number, log_radiance, share=None, limit=None, cells=None):
    return GoldenPart(
        serial=f"G{number}",
        inspected_at="2026-01-02T03:04:05+00:00",
        log_radiance=tuple(log_radiance),
        area_share=share,
        cell_limit=limit,
        cells=cells,
        verdict="PASS",
    )


def golden(parts, recipe=None):
    key = "0" * 64 if recipe is None else GoldenSet.key_of(recipe)
    return GoldenSet(product="plate", recipe_key=key, poses=POSES, parts=tuple(parts))


def by_their_own(parts):
    """A set of a kind that states no scatter between its parts."""
    return RadianceSet(product="card", recipe_key="0" * 64, poses=POSES, parts=tuple(parts))


def test_the_order_of_the_entries_in_a_file_is_that_of_earlier_versions(tmp_path):
    path = tmp_path / "plate.golden.json"
    write_golden(path, golden([part(1, (-1.0, -2.0, -3.0), 0.01, 0.3, 100)]))
    found = json.loads(path.read_text())
    assert list(found) == ["schema", "product", "recipe_key", "poses", "parts"]
    assert list(found["parts"][0]) == [
        "serial",
        "inspected_at",
        "log_radiance",
        "area_share",
        "cell_limit",
        "cells",
        "verdict",
    ]


def test_the_set_of_a_kind_that_states_viewing_conditions_is_refused(make_recipe, tmp_path):
    path, recipe = tmp_path / "plate.golden.json", make_recipe()
    for more in ({"kind": "print"}, {"seen": {"lamp": "D65"}}):
        content = golden([], recipe).model_dump(mode="json", by_alias=True) | more
        path.write_text(json.dumps(content))
        with pytest.raises(CalibrationError, match=r"the golden parts in .* cannot be read"):
            GoldenSet.read(path, recipe)


def test_a_part_that_was_inspected_in_more_poses_serves_a_recipe_with_fewer(make_recipe):
    tilted = make_recipe(poses={"tilts_deg": [0.0, 10.0]})
    upright = make_recipe(poses={"angles_deg": [0.0, 180.0]})
    seen = [
        SimpleNamespace(stage_deg=a, tilt_deg=t, measured=a + t)
        for t in (0.0, 10.0)
        for a in (0.0, 90.0, 180.0)
    ]
    record = SimpleNamespace(poses=seen, model_copy=lambda update: SimpleNamespace(**update))
    part, rules = GoldenSet.restricted(record, tilted, upright)
    assert [pose.measured for pose in part.poses] == [0.0, 180.0]
    assert GoldenSet.key_of(rules) == GoldenSet.key_of(upright)
    assert rules.area is None  # fewer pairs deviate in fewer cells
    for other in (tilted, make_recipe(poses={"angles_deg": [0.0, 45.0]})):
        assert GoldenSet.restricted(record, tilted, other) == (record, tilted)
    turned = make_recipe(poses={"angles_deg": [0.0, 180.0], "facet_azimuth_deg": 5.0})
    assert GoldenSet.restricted(record, tilted, turned) == (record, tilted)


def test_limits_of_cells_are_those_of_the_rows_that_have_one(make_recipe):
    rows = [part(k, (0.0, 0.0, 0.0), 0.01, limit, 400) for k, limit in enumerate((3.0, None, 3.2))]
    found = golden(rows)
    assert found.cell_limits == (3.0, 3.2)
    earlier = rows[0].model_copy(update={"cell_limit": None, "limit": 1.4})  # of the scores of points
    assert golden([earlier, *rows]).cell_limits == (3.0, 3.2)
    assert golden([earlier, *rows]).area_shares(make_recipe().area) == (0.01, 0.01, 0.01)
    assert found.area_shares(make_recipe().area) == (0.01, 0.01)


def test_three_parts_serve_where_no_scatter_is_stated(rng):
    logs = rng.normal(size=(3, 3))
    few, enough = (by_their_own([part(k, row) for k, row in enumerate(logs[:n])]) for n in (2, 3))
    assert few.needed == 3
    assert few.lacking.startswith(counted(2, "golden part"))
    assert enough.lacking is None


def test_where_the_recipe_states_the_scatter_one_part_serves():
    one = golden([part(1, (-1.0, -2.0, -3.0))])
    assert (one.needed, one.lacking, golden([]).lacking is None) == (1, None, False)


def test_t_squared_is_of_the_ratios(rng):
    logs, own = rng.normal(size=(9, 3)), rng.normal(size=3)
    known = RadianceSet(
        product="card", recipe_key="0", poses=POSES, parts=tuple(part(k, row) for k, row in enumerate(logs))
    )
    t2, dof, p_value = known.t_squared(np.exp(own), np.ones(3))
    ratios = logs[:, 1:] - logs[:, :1]
    form = np.array([[2.0, 1.0], [1.0, 2.0]])  # of ratios to one pose
    assert (t2, p_value) == pytest.approx(like_sample(own[1:] - own[0], ratios, form))
    assert dof == 2
    brighter, _, _ = known.t_squared(2.0 * np.exp(own), np.ones(3))
    assert brighter == pytest.approx(t2)
