"""The rig file examples of docs/cameras.md name options that the drivers have, and values that they take."""

import re
import tomllib
from inspect import signature
from pathlib import Path

import pytest

from anisoscope.base.plugins import installed
from anisoscope.rig.drivers import CAMERAS
from anisoscope.rig.framefolderline import COLUMNS, OPTIONAL
from anisoscope.rig.rigfile import CameraPart

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "cameras.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_of_rig_files(example):
    data = tomllib.loads(re.sub(r"^# (?=\w+ = )", "", example, flags=re.MULTILINE))
    part = CameraPart.model_validate(data["camera"])
    opener = installed(CAMERAS)[part.driver].load().open
    bound = signature(opener).bind(**part.options)
    for name, value in bound.arguments.items():
        default = opener.__kwdefaults__[name] if name in (opener.__kwdefaults__ or {}) else None
        if default not in {None, ""} and name != "device":
            assert type(value) is type(default) or (type(value), type(default)) == (int, float), name


def test_there_are_examples_of_every_driver():
    assert {tomllib.loads(example)["camera"]["driver"] for example in EXAMPLES} == {
        "aravis",
        "basler",
        "folder",
        "gentl",
        "uvc",
    }


def test_the_table_of_columns_is_whole():
    for name in (*COLUMNS, *OPTIONAL):
        assert re.search(rf"^\|.*`{name}`.*\|", PAGE, re.MULTILINE), name
