"""Parts rendered by Mitsuba 3 as a world of the detection study."""

import pytest

from anisoscope.base.errors import UsageError
from detection_study.mitsuba import ARCHIVE, CAUSES, GOLDEN, GOOD, QUIET, UPRIGHT, Inspector, Parts


@pytest.fixture(scope="module")
def parts(tmp_path_factory, request):
    return Parts.unpacked(request.config.rootpath / ARCHIVE, tmp_path_factory.mktemp("mitsuba"))


def test_true_severities_are_those_that_were_rendered(parts):
    assert parts.severity("angle-1") == pytest.approx(-1.0, abs=0.3)
    assert parts.severity("wear-5") == parts.truth["wear-5"]["edge_um"]
    assert {*CAUSES, *GOOD, *GOLDEN} == set(parts.truth)


def test_one_golden_part_tells_a_good_part_from_lost_height(parts, tmp_path, undiagnosed):
    inspector = Inspector(parts, tmp_path, UPRIGHT, methods=undiagnosed).learn(GOLDEN[:1])
    assert [inspector.record(name).verdict for name in (GOOD[0], "height-loss")] == ["PASS", "FAIL"]
    assert (tmp_path / "recipe.toml").exists()
    assert QUIET.diagnose is not undiagnosed.diagnose  # the study looks for causes


def test_an_archive_that_is_none_is_refused_in_one_line(tmp_path):
    with pytest.raises(UsageError, match="no archive of rendered parts"):
        Parts.unpacked(tmp_path / "none.tar.xz", tmp_path)
