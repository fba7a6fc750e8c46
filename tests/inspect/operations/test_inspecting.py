"""One part inspected from Python: what needs a folder of frames says so."""

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.operations.inspecting import inspect


def test_a_reason_for_frames_of_another_part_needs_frames(virtual_rig):
    rig = virtual_rig()
    with pytest.raises(UsageError, match=r"--reuse .* needs a folder of --frames"):
        inspect(rig.recipe, rig.rig, serial="R-1", out=rig.out, reuse="a second look")
    assert not rig.folders
