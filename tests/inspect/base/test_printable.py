"""Names that cannot be seen are refused at every door alike, before anything is written."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

import anisoscope.api as an
from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.printable import LONGEST, check_printable
from anisoscope.console.station import Start
from anisoscope.history.aqdef import AqdefFile, description_lines, value_lines
from anisoscope.history.signs import Beacon
from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.batch.watch import whose
from anisoscope.inspection.check_standard import teach_check
from anisoscope.inspection.job import check_serial
from anisoscope.line.jobs import order_of
from anisoscope.operations.project import read_project
from anisoscope.parameters.taking import Taking
from anisoscope.record.schema import Particulars

BAD = ("L\n7", "L\x1b[31m7", "L\u202e7", "L\x007", "L\u2028" + "7")
FRAMES = "file,kind,stage_deg,exposure_s\n"


def put(path, text):
    path.write_text(text, encoding="utf-8", newline="")
    return path


def command(*words):
    return lambda anisoscope, _, text: refused(anisoscope(*(text if one is None else one for one in words)))


def refused(done):
    assert done.code == 64, done.err
    assert "Traceback" not in done.err
    raise AnisoscopeError(done.err)


def job(folder, **particulars):
    """An inspection that would fail for its recipe, were its particulars not looked at first."""
    an.inspect(folder / "none.toml", folder / "none.toml", serial="A1", out=folder / "out", **particulars)


def aqdef(folder, text):
    path = folder / "tray.dfq"
    file = AqdefFile("plate", {"serial": ("A1",), "lot": ("LOT",)}, {"h": np.array([1.0])}, {}, {})
    put(path, "".join([*description_lines(file), *value_lines(file)]).replace("LOT", text))
    read_tray(path)


def ordered(**entries):
    order_of(json.loads(json.dumps({"job": "1", "recipe": "plate", "serial": "A1"} | entries)))


DOORS = {
    "inspect --lot": command("inspect", "-r", "none", "-g", "none", "--serial", "A1", "--lot", None),
    "inspect --serial": command("inspect", "-r", "none", "-g", "none", "--serial", None),
    "inspect --frames": command(
        "inspect", "--frames", ".", "-r", "none", "--serial", "A1", "--station", None
    ),
    "init --operator": command("init", "job", "--operator", None),
    "key trust --station": command(
        "key", "trust", "keys.toml", "--public", 43 * "A" + "=", "--station", None
    ),
    "api operator": lambda _, folder, text: job(folder, operator=text),
    "api cavity": lambda _, folder, text: job(folder, cavity=text),
    "tray list": lambda _, folder, text: read_tray(
        put(folder / "tray.csv", f'slot,serial,lot\n1,A1,"{text}"\n')
    ),
    "serial of a tray list": lambda _, folder, text: read_tray(
        put(folder / "tray.csv", f'slot,serial\n1,"{text}"\n')
    ),
    "part.toml": lambda _, folder, text: (
        put(folder / "frames.csv", FRAMES),
        put(folder / "part.toml", f"lot = {json.dumps(text)}\n"),
        whose(folder),
    ),
    "frames.csv": lambda _, folder, text: (
        put(folder / "frames.csv", f'lot,{FRAMES}"{text}",a.tif,sample,0,0.1\n'),
        whose(folder),
    ),
    "anisoscope.toml": lambda _, folder, text: read_project(
        put(folder / "anisoscope.toml", f"station = {json.dumps(text)}\n")
    ),
    "page of the station": lambda _, __, text: Start(recipe="plate", serial="A1", lot=text),
    "serial of all pages and servers": lambda _, __, text: check_serial(text),
    "lot over OPC UA, MQTT and Sparkplug": lambda _, __, text: ordered(lot=text),
    "operator over OPC UA, MQTT and Sparkplug": lambda _, __, text: ordered(operator=text),
    "id of a job": lambda _, __, text: ordered(job=text),
    "station of serve and line": lambda _, __, text: Beacon(None, text),
    "operator of a calibration": lambda _, __, text: Taking(0.1, operator=text),
    "operator of a check": lambda _, folder, text: teach_check(folder, folder, folder, operator=text),
}


@pytest.mark.parametrize("text", BAD, ids=ascii)
@pytest.mark.parametrize("door", DOORS)
def test_a_sign_that_cannot_be_seen_is_refused_at_every_door(door, text, anisoscope, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if "\x00" in text and door in {"frames.csv", "tray list", "serial of a tray list"}:
        text = text.replace("\x00", "\x01")  # no text file holds it
    with pytest.raises((AnisoscopeError, ValidationError)) as caught:
        DOORS[door](anisoscope, tmp_path, text)
    assert "cannot be seen" in str(caught.value) or "cannot be used" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_aqdef_holds_no_line_breaks_but_other_signs(tmp_path):
    with pytest.raises(AnisoscopeError, match="cannot be seen"):
        aqdef(tmp_path, "L\x1b7")


def test_names_of_any_script_pass_and_long_ones_do_not():
    Particulars(operator="Ana Łęcka", lot="ロット 7", station="Prüfplatz 2", cavity="a;b, [red]<b>").checked()
    check_printable({"lot": LONGEST * "x", "cavity": None, "operator": ""})
    with pytest.raises(AnisoscopeError, match=r"lot: longer than 200 signs"):
        check_printable({"lot": (LONGEST + 1) * "x"})


def test_a_record_of_the_past_is_read_as_it_is():
    assert Particulars.model_validate({"lot": "L\n7"}).lot == "L\n7"
