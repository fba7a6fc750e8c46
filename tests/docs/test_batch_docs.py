"""The page about batches: its list and its tables are understood."""

import re
import tomllib
from pathlib import Path

from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.batch.watch import PartFile
from anisoscope.sim.bench.bench import printed
from anisoscope.sim.bench.benchfile import SamplePart

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "batch.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_tray_list_is_one(tmp_path):
    (tmp_path / "tray.csv").write_text(blocks("csv")[0])
    slots = read_tray(tmp_path / "tray.csv").slots
    assert [(slot.label, slot.serial, slot.lot, slot.cavity) for slot in slots] == [
        ("A1", "P-1042", "L7", "1"),
        ("A2", "P-1043", "L7", "2"),
        ("A3", None, "L7", "3"),
    ]


def test_the_tables_are_understood():
    code, part = map(tomllib.loads, blocks("toml"))
    sample = SamplePart.model_validate(code["sample"])
    assert printed(sample.code).shape[0] >= 10
    assert PartFile.model_validate(part).serial == "A17"
