"""Slips of users: each is answered in one line with the line that works, without a traceback or words of the parser."""

import json
import shlex

import numpy as np
import pytest
import tifffile

from anisoscope.cli import run
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap

# ruff: noqa: E501 - a slip and its answer are one line
RIG = """schema = 1
name = "rig"
[stage]
driver = "elliptec"
port = "sim://elliptec"
[camera]
driver = "simulated"
pixel_um = 4.0
[light]
driver = "simulated"
angle_deg = 10.0
"""
BENCH = 'schema = 1\n[sample]\nkind = "ridges"\n'

SLIPS = """
# words of commands and options
inspekt --recipe recipe.toml --rig rig.toml --serial A1 | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A1
optimize | anisoscope optimise
status | anisoscope rig status
version | anisoscope --version
--versoin | anisoscope --version
--zzz | Unknown option: --zzz (see anisoscope --help)
-help | anisoscope --help
rig state --rig rig.toml | anisoscope rig status --rig rig.toml
rig --rig rig.toml status | anisoscope rig status --rig rig.toml
rig hum | Unknown command of rig: "hum"; for example: anisoscope rig
rig sim eliptec | did you mean elliptec?
rig sim | anisoscope rig sim elliptec --tcp 4001
rig sim zaber | anisoscope rig sim zaber --tcp 4001
calibrate --rig rig.toml | anisoscope calibrate flat --rig rig.toml
calibrate flatfield --rig rig.toml --exposure 0.006 | anisoscope calibrate flat --rig rig.toml --exposure 0.006 --out flat.tif
line opc-ua --rig rig.toml | anisoscope line opcua --rig rig.toml
msa gaugerr --csv gauge.csv | anisoscope msa gauge --csv gauge.csv
history list | anisoscope history (see
inspect --recipe recipe.toml --rig rig.toml --sn A1 | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A1
inspect -recipe recipe.toml -rig rig.toml --serial A1 | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A1
inspect --recip recipe.toml | anisoscope inspect --recipe recipe.toml
predict --angle 10 | anisoscope predict --ridge-angle 10
optimise --angle 10 | anisoscope optimise --ridge-angle 10
doctor --fix | Unknown option: --fix (see anisoscope doctor --help)
demo wafer | anisoscope demo --kind wafer
demo --sed 3 | anisoscope demo --seed 3
demo --kind paper | Choose from: "ridges", "wafers"
init job --kind wafer | did you mean wafers?
# files without their options, and files of other sorts
inspect recipe.toml rig.toml | files are named by options; write: anisoscope inspect --recipe recipe.toml --rig rig.toml
inspect recipe.toml rig.toml A-7 | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A-7
inspect --recipe rig.toml --rig recipe.toml --serial A1 | anisoscope inspect --rig rig.toml --recipe recipe.toml --serial A1
inspect --recipe recipe.toml --rig bench.toml --serial A1 | anisoscope rig sim bench bench.toml --pty --write-rig rig.toml
inspect --recipe recipe --rig rig.toml --serial A1 | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A1
inspect --recipe=recipes.toml --rig rig.toml --serial A1 | anisoscope inspect --recipe=recipe.toml --rig rig.toml --serial A1
inspect --recipe recipe.toml --rig rig.toml --serial A1 --frames frame.tif | --serial A1 --frames .
inspect --recipe recipe.toml --rig rig.toml --serial A1 --frames shots | anisoscope inspect --frames shots --init
inspect --recipe recipe.toml --rig rig.toml --serial A1 --frames nowhere | nowhere: there is no such folder of frames
recipe check rig.toml | anisoscope recipe check recipe.toml
recipe check . | anisoscope recipe check recipe.toml
recipe check done/A-1 | done/A-1: cannot be read: Is a directory; a recipe is a file *.toml
rig home --rig bench.toml | anisoscope rig sim bench bench.toml --pty --write-rig rig.toml
msa gauge gauge.csv | anisoscope msa gauge --csv gauge.csv
msa gauge done | anisoscope msa gauge --history done
msa gauge --csv gage.csv | anisoscope msa gauge --csv gauge.csv
spc done/history.sqlite | anisoscope spc --history done/history.sqlite
export week.csv | anisoscope export --csv-file week.csv
predict recipe.toml | anisoscope predict --recipe recipe.toml
predict rig.toml | for example: anisoscope predict --ridge-angle 10
predict part.X3P | anisoscope predict part.x3p
predict frame.tif | anisoscope inspect --frames FOLDER --recipe recipe.toml
profile info frame.tif --pixel 4 | anisoscope inspect --frames FOLDER --recipe recipe.toml
profile part.x3p | anisoscope profile info part.x3p
profile info part | anisoscope profile info part.x3p
profile info nothing.x3p | there are part.x3p
profile info maps | anisoscope profile info maps/one.x3p
profile info mm.csv | give it in µm with --pixel SIZE
profile info mm.csv --pixel 1 | say the unit of the heights with --z-unit, such as --z-unit mm or um
profile compare part.x3p | name the second one after it
profile convert part.x3p part.xyzq | written are .x3p
profile view part.x3p --out view.pdf | a page is named *.html
compare part.x3p part.x3p | anisoscope profile compare FIRST SECOND
# folders of inspections
show done | anisoscope show done/A-1
show done/A-1/report.html | anisoscope show done/A-1
verify done | anisoscope verify done/A-1
verify done/A-1/report.html | anisoscope verify done/A-1
resume . | anisoscope resume done/A-1
resume done | anisoscope resume done/A-1
resume | for example: anisoscope resume inspections/
compare done/A-1 | SECOND is missing; for example: anisoscope compare A-0001 A-0002
verify | FOLDER is missing; for example: anisoscope verify
# what another command makes first
show A-0001 | anisoscope history add FOLDER
history --since 28.11.2026 | anisoscope history add FOLDER
spc | anisoscope history add FOLDER
# values
predict --ridge-angle ten | --ridge-angle takes a number of °
predict --ridge-angle 10 --pitch 0.1 | ridges of 0.1 mm are --pitch 100
predict --ridge-angle 10 --tilts -10,0,10 | anisoscope predict --ridge-angle 10 --tilts=-10,0,10
predict --ridge-angle 10 --tilts 0 10 20 | anisoscope predict --ridge-angle 10 --tilts=0,10,20
predict --ridge-angle --json | --ridge-angle needs a value, and --json is an option
predict 10 | anisoscope predict --ridge-angle 10
demo --seed many | --seed takes a whole number, not 'many'
rig move ninety --rig rig.toml | anisoscope rig move 90
history --since 03/04/2026 | write 2026-03-04 or 2026-04-03
history --since someday | --since takes 2026-11-01, 01.11.2026, 1 Nov 2026
history --verdict failed | did you mean --verdict FAIL?
inspect --at wide | --at needs 2 values, not 1
inspect --recipe recipe.toml --rig rig.toml --serial | anisoscope inspect --recipe recipe.toml --rig rig.toml --serial A-0001
# what is missing
inspect | anisoscope inspect --recipe recipe.toml
inspect --recipe recipe.toml | anisoscope inspect --recipe recipe.toml --rig rig.toml
calibrate flat --rig rig.toml --exposure 0.006 | anisoscope calibrate flat --rig rig.toml --exposure 0.006 --out flat.tif
recipe new --ridge-angle 10 | anisoscope recipe new --ridge-angle 10 --out plate.toml
recipe new --ridge-angle 10 --out recipe.toml | recipe.toml exists already: name another file
golden add done/A-1 | anisoscope golden add done/A-1 --recipe recipe.toml
whatif recipe.toml | anisoscope whatif --recipe recipe.toml
batch recipe.toml | anisoscope batch tray.csv --recipe recipe.toml --rig rig.toml
batch parts.csv | anisoscope batch parts.csv --recipe recipe.toml
watch frames | anisoscope watch frames --recipe recipe.toml
serve | anisoscope serve --rig rig.toml --recipes recipes
rig home | anisoscope rig home --rig rig.toml
export | anisoscope export --csv-file
ink proof picture.png | --out proof.html, --png picture.png, or both
cache info all | anisoscope cache info (see
cache info --log-file | --log-file needs the name of a file
"""
"""Line as typed | what the answer holds."""
WALK = [tuple(line.split(" | ")) for line in SLIPS.splitlines() if line and not line.startswith("#")]
WORDS_OF_THE_PARSER = (
    "Traceback",
    "unable to convert",
    "specified multiple times",
    "Errno",
    "internal error",
)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder as users have it: recipe, rig and bench file, maps, frames, readings, an inspection."""
    desk = tmp_path_factory.mktemp("desk")
    assert run(["recipe", "new", "--ridge-angle", "10", "--out", str(desk / "recipe.toml")]) == 0
    for name, text in {"rig.toml": RIG, "bench.toml": BENCH, "gauge.csv": "part,appraiser,x\n"}.items():
        (desk / name).write_text(text, encoding="utf-8")
    (desk / "mm.csv").write_text("0.001,0.002\n0.002,0.003\n", encoding="utf-8")
    for folder in ("maps", "shots", "done/A-1"):
        (desk / folder).mkdir(parents=True)
    for name in ("record.json", "job.json"):
        (desk / "done" / "A-1" / name).write_text(json.dumps({}))
    (desk / "done" / "A-1" / "report.html").write_text("")
    for name in ("part.x3p", "maps/one.x3p"):
        write_height_map(HeightMap(np.arange(12.0).reshape(3, 4), 1.0, 1.0), desk / name)
    tifffile.imwrite(desk / "frame.tif", np.zeros((8, 8), dtype=np.uint16))
    return desk


def test_slips_are_answered_with_the_line_that_works(desk, monkeypatch, capsys):
    monkeypatch.chdir(desk)
    wrong = []
    capsys.readouterr()
    for typed, answer in WALK:
        code, said = run(shlex.split(typed)), capsys.readouterr().err
        if (
            answer not in said
            or said.count("\n") != 1
            or not 64 <= code < 128
            or any(word in said for word in WORDS_OF_THE_PARSER)
        ):
            wrong.append(f"{typed}  [{code}]\n    {said}")
    assert len(WALK) > 90
    assert not wrong, "\n".join(wrong)
    assert {one.name for one in desk.iterdir()} == {
        *("recipe.toml", "rig.toml", "bench.toml", "gauge.csv", "mm.csv", "part.x3p", "frame.tif"),
        *("maps", "shots", "done"),
    }
