"""Golden prints teach how much of the area may deviate: level, what counts, and what the recipe says goes before."""

import numpy as np
import pytest

from anisoscope.cli.recipe import golden as command
from anisoscope.decision.reference_parts import golden_path, write_golden
from anisoscope.imaging.area_limit import KnownShares
from anisoscope.kinds.prints.decision import decide_print
from anisoscope.kinds.prints.expectation import rig_sources, scatter_of_prints
from anisoscope.kinds.prints.lobe_fit import PARAMETERS
from anisoscope.kinds.prints.model import State
from anisoscope.kinds.prints.reference_comparison import compare_with_golden, linear_fit
from anisoscope.kinds.prints.reference_prints import (
    GoldenPrint,
    GoldenPrints,
    ViewingConditions,
)
from anisoscope.record.verdict import Verdict

SPREAD = {"alpha": 0.01, "ratio": 0.01, "skew": 0.01, "tilt_x_deg": 0.1, "tilt_y_deg": 0.1, "red": 0.02,
          "green": 0.02, "blue": 0.02, "lobe": 0.05}  # fmt: skip


@pytest.fixture(scope="module")
def few(make_recipe, predict):
    """A recipe with nine poses and 100 cells, and what it predicts."""
    recipe = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area={"cell_mm": 0.2})
    return recipe, predict(recipe)


def golden_of(few, shares, cell_mm=0.2):
    """A set of prints with these shares of the area."""
    recipe, expected = few
    rng = np.random.default_rng(4)
    slopes = np.stack([SPREAD[name] * expected.scene.slope(name, State()) for name in PARAMETERS], axis=-1)
    good, parts = expected.scene.log_channels(), []
    for number, share in enumerate(shares):
        logs = good + slopes @ rng.standard_normal(9) + 0.003 * rng.standard_normal(good.size)
        rows = tuple(map(tuple, logs.reshape(-1, 3).tolist()))
        parts.append(
            GoldenPrint(
                serial=f"G-{number}",
                inspected_at="2026-01-01T00:00:00Z",
                log_channels=rows,
                area_share=share,
                cell_delta_e=3.0,
                cell_mm=cell_mm,
                cells=100,
                verdict="PASS",
            )
        )
    seen = ViewingConditions(
        ink="synthetic green", lamp="led-white", sensitivities="synthetic", filters="rggb"
    )
    poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in expected.poses)
    return GoldenPrints(
        product="test print",
        recipe_key=GoldenPrints.key_of(recipe),
        seen=seen,
        poses=poses,
        parts=tuple(parts),
    )


def test_the_limit_is_kept_by_the_share_of_good_prints_that_it_says():
    """Marks of random size and number: over many sets of 15, one more good print exceeds the limit once in 1/α."""
    rng, alpha = np.random.default_rng(11), 0.05
    marks = rng.poisson(3.0, (1200, 16))
    shares = np.array([[rng.gamma(2.0, 0.002, n).sum() for n in row] for row in marks])
    over = [
        own > (known := KnownShares(tuple(others), 2500)).limit(alpha) for *others, own in shares.tolist()
    ]
    agreed = [
        (own > (known := KnownShares(tuple(others), 2500)).limit(alpha)) == (known.chance(own) < alpha)
        for *others, own in shares[:300].tolist()
    ]
    assert 0.007 < np.mean(over) < 0.065  # .0197 ± .004: the limit is on the safe side
    assert all(agreed)


def test_clean_prints_leave_one_cell(few):
    """Where nothing deviates on golden prints, more than one cell of 100 is more than a good print shows."""
    recipe, _ = few
    known = golden_of(few, [0.0] * 15).known_shares(recipe)
    assert golden_of(few, [0.0] * 15).area_limit(recipe) == pytest.approx(0.01)
    assert known.chance(0.01) > recipe.decision.alpha / GoldenPrints.tests > known.chance(0.0105)


def test_what_the_recipe_says_goes_before_and_too_few_tell_nothing(few, make_recipe):
    recipe, _ = few
    stated = make_recipe(poses={"tilts_deg": [0.0, 10.0, 20.0]}, area={"cell_mm": 0.2, "max_share": 0.02})
    shares = [0.001 * k for k in range(12)]
    assert golden_of(few, shares).known_shares(stated) is None
    assert golden_of(few, shares).known_shares(recipe).shares == tuple(shares)
    assert golden_of(few, shares[:9]).known_shares(recipe) is None
    assert golden_of(few, shares, cell_mm=0.1).known_shares(recipe) is None


def test_lobe_colours_and_area_share_one_level(few):
    """P values of three tests by Holm: the smallest is held against a third of the level."""
    recipe, expected = few
    golden = golden_of(few, np.random.default_rng(2).gamma(4.0, 0.001, 30).tolist())
    fit = linear_fit(expected, (*expected.common, *rig_sources(recipe, expected)))
    stated = scatter_of_prints(recipe, expected)
    known, good = golden.known_shares(recipe), golden.logs().mean(axis=0)
    far = good + 0.3 * expected.scene.slope("alpha")
    for logs, parts in ((good, 3.0), (far, 2.0)):
        limit = compare_with_golden(golden, expected, logs, fit, stated, (known, 0.02), 0.01).area.limit
        assert limit == pytest.approx(known.limit(0.01 / parts))
        for share, fails in ((0.99 * limit, False), (1.01 * limit, True)):
            found = compare_with_golden(golden, expected, logs, fit, stated, (known, share), 0.01)
            assert (found.area.p_value < 0.01) is fails
    alone = compare_with_golden(golden, expected, good + 0.02, fit, stated)
    shared = compare_with_golden(golden, expected, good + 0.02, fit, stated, (known, 0.0), 0.01)
    assert shared.p_value >= alone.p_value


def test_a_spot_fails_by_what_golden_prints_have_shown(few, sheet):
    recipe, expected = few
    spotted = type(sheet)(recipe, expected, np.random.default_rng(5)).spotted(slice(3, 4), slice(4, 6), 0.5)
    measured = spotted.measured()
    clean, marked = (golden_of(few, shares) for shares in ([0.0] * 15, [0.002 * k for k in range(15)]))
    found = decide_print(expected, measured, recipe, clean)
    area = found.map.record
    assert (found.verdict, area.learnt, area.max_share) == (Verdict.FAIL, True, pytest.approx(0.01))
    assert any("(limit 1.00%, learnt from 15 golden prints)" in line for line in found.reasons)
    found = decide_print(expected, measured, recipe, marked)
    assert found.map.record.verdict is Verdict.PASS
    assert found.map.record.max_share > 0.028
    assert "shared with the area" in " ".join(found.reasons)


def test_show_says_where_the_limit_comes_from(few, tmp_path, capsys):
    text = (
        'schema = 1\nproduct = "test print"\n[print]\nink = "synthetic-green"\n[poses]\n'
        "tilts_deg = [0.0, 10.0, 20.0]\n[acquisition]\nexposure_s = 0.005\n[region]\nsize_mm = [2.0, 2.0]\n"
        "[area]\ncell_mm = 0.2\n"
    )
    path = tmp_path / "print.toml"
    path.write_text(text)
    for count, says in ((15, "limit of the area: 1.00 %, learnt from 15"), (4, "now there are 4")):
        write_golden(golden_path(path), golden_of(few, [0.0] * count))
        assert command.show(recipe=path) == 0
        assert says in capsys.readouterr().out
    path.write_text(f"{text}max_share = 0.02\n")
    assert command.show(recipe=path) == 0
    assert "2.00 %, as the recipe says" in capsys.readouterr().out
