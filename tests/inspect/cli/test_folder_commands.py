"""resume, recompute, verify and replay on the command line."""

import shutil
from dataclasses import replace

import pytest

from anisoscope.history.rows import row_of
from anisoscope.history.store import open_history
from anisoscope.record.schema import read_record
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder


@pytest.fixture
def inspected(inspected_part):
    """The folder of a finished inspection."""
    return inspected_part[1].folder


def test_an_untouched_folder(anisoscope, inspected):
    done = anisoscope("verify", inspected)
    assert (done.code, done.err) == (0, "")
    assert "files are as they were" in done.out
    found = anisoscope("recompute", inspected, "--json")
    assert found.code == 0, found.err
    assert (found.json["same"], found.json["recorded"], found.json["differences"]) == (True, "PASS", [])
    done = anisoscope("resume", inspected)
    assert (done.code, done.err.count("\n")) == (74, 1)
    assert "there is nothing to resume" in done.err


def test_a_folder_that_was_tampered_with(anisoscope, inspected, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(inspected, folder)
    (folder / "report.html").write_text("all is well")
    (folder / "notes.txt").write_text("mine")
    (folder / "frames" / "000_dark.tif").unlink()
    done = anisoscope("verify", folder, "--json")
    assert done.code == 1
    names = {"changed": ["report.html"], "missing": ["frames/000_dark.tif"], "additional": ["notes.txt"]}
    assert {what: done.json[what] for what in names} == names
    done = anisoscope("verify", folder)
    assert done.code == 1
    for line in ("changed: report.html", "missing: frames/000_dark.tif", "additional: notes.txt"):
        assert line in done.out.splitlines()
    done = anisoscope("recompute", folder)
    assert (done.code, done.err.count("\n")) == (74, 1)
    assert "000_dark.tif" in done.err


def test_folders_are_shown_and_compared_without_a_history(anisoscope, inspected, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(inspected, folder)
    done = anisoscope("show", folder)
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("PASS\n")
    assert "inspection: in no history" in done.out
    done = anisoscope("compare", inspected, folder, "--json")
    assert (done.code, done.err) == (0, "")
    assert [one["difference"] for one in done.json["contrasts"]] == [0.0] * len(done.json["contrasts"])
    with open_history(tmp_path / "history.sqlite", create=True) as history:
        history.append(row_of(read_record(folder), folder))
    assert "inspection: 1" in anisoscope("show", folder).out
    assert anisoscope("show", folder, "--history", tmp_path / "no.sqlite").code == 74
    for wrong in (tmp_path, folder / "record.json"):
        done = anisoscope("show", wrong, cwd=tmp_path)
        assert (done.code, done.err.count("\n")) == (64, 1)
        assert f"{wrong} is no folder of a finished inspection" in done.err


def test_an_unfinished_folder_is_resumed(anisoscope, inspected, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(inspected, folder)
    for name in ("record.json", "report.html", "report.sha256"):
        (folder / name).unlink()
    done = anisoscope("verify", folder)
    assert done.code == 0
    assert "the inspection is not finished" in done.out
    done = anisoscope("resume", folder, "--json")
    assert (folder / "report.html").stat().st_size > 10_000
    assert (done.code, done.json["verdict"]) == (0, "PASS")
    assert anisoscope("verify", folder).code == 0


def test_frames_instead_of_a_rig(anisoscope, inspected, tmp_path):
    part = inspected.parent.parent
    record = read_record(inspected)
    frames = [replace(read_frame(inspected / entry.name), serial=None) for entry in record.frames]
    write_frame_folder(tmp_path / "frames", frames)
    job = ("inspect", "-r", part / "recipe.toml", "-s", "R1", "--out", tmp_path / "out")
    done = anisoscope(*job)
    assert (done.code, "--rig" in done.err, "--frames" in done.err) == (64, True, True)
    done = anisoscope(*job, "--frames", tmp_path / "frames")
    assert (done.code, "rig.toml" in done.err) == (64, True)
    done = anisoscope(
        *job, "--frames", tmp_path / "frames", "--rig", part / "rig.toml", "--json", "--operator", "M. M."
    )
    assert done.code == 0, done.err
    live = {(c.from_deg, c.to_deg): c.measured for c in record.details.contrasts}
    for contrast in done.json["contrasts"]:
        assert contrast["measured"] == pytest.approx(live[contrast["from_deg"], contrast["to_deg"]], abs=1e-9)
    assert '"operator": "M. M."' in next((tmp_path / "out").glob("*/record.json")).read_text()


def test_folders_that_are_none(anisoscope, tmp_path):
    for command in ("resume", "recompute", "verify"):
        done = anisoscope(command, tmp_path / "none")
        assert done.code == 74
        assert done.err.count("\n") == 1
        assert "none" in done.err


def test_a_folder_of_pictures_gets_its_first_table(anisoscope, inspected, tmp_path):
    folder = tmp_path / "photographed"
    shutil.copytree(inspected / "frames", folder)
    done = anisoscope("inspect", "--frames", folder, "--init")
    assert done.code == 0, done.err
    assert "black_level: counts of a pixel without light" in done.out
    assert "fill in" not in done.out, "frames of ours tell everything"
    assert len((folder / "frames.csv").read_text().splitlines()) == 1 + len(list(folder.glob("*.tif")))
    again = anisoscope("inspect", "--frames", folder, "--init", "--json")
    assert (again.code, "exists already" in again.err) == (64, True)
    assert anisoscope("inspect", "--init").code == 64
