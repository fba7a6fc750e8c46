"""What inspections have in common is stored once, and every inspection can still be proven and judged again."""

import errno
import os
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.inspection import objects
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.manifest import read_job_file
from anisoscope.inspection.objects import ARCHIVE, OBJECTS, SeriesFile, clear_unused, shared_darks
from anisoscope.inspection.recompute import recompute
from anisoscope.record.schema import read_record
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.sim.bench.camera import SimulatedCamera


def darks_of(folder):
    return [line for line in read_journal(folder).frames if line.kind == "dark"]


def one_file(*paths):
    """Whether paths are names of one file on the disk."""
    return all(path.samefile(paths[0]) for path in paths)


def copy_with_links(source, target):
    """Copy a folder; what are names of one file there are names of one file here."""
    here = {}

    def copy(one, other):
        first = here.setdefault(Path(one).stat().st_ino, other)
        return shutil.copy2(one, other) if first == other else os.link(first, other)

    shutil.copytree(source, target, copy_function=copy)


@pytest.fixture
def three(virtual_rig, plain, made_once, tmp_path):
    """A rig and the folders of three parts: a copy of what is made once for a run."""
    rig = virtual_rig(recipe={"acquisition": {"dark_frames": 3}})

    def make(folder):
        made = replace(rig, out=folder / "inspections")
        for number in range(3):
            made.inspect(f"T-{number}", plain)

    copy_with_links(made_once("three of one rig", make) / "inspections", rig.out)
    return rig, rig.folders


def test_parts_of_one_rig_have_inputs_and_dark_frames_in_common_and_each_folder_all_its_files(
    three, tmp_path
):
    rig, folders = three
    inputs = {copy.name: copy for copy in read_job_file(folders[0]).inputs}
    white = inputs["inputs/flat.tif"]
    place = rig.out / OBJECTS / white.sha256[:2] / f"{white.sha256[2:]}.tif"
    assert one_file(place, *(folder / "inputs" / "flat.tif" for folder in folders))
    assert not one_file(*(folder / "inputs" / "recipe.toml" for folder in folders))  # small
    names = [f"{number:03d}_dark.tif" for number in range(3)]
    shared = [one_file(*(folder / "frames" / name for folder in folders)) for name in names]
    assert shared == [False, True, True]
    for folder in folders:
        assert [line.name for line in darks_of(folder)] == [f"frames/{name}" for name in names]
        assert verify(folder).intact
        assert recompute(folder).differences == ()
        assert [frame.kind for frame in read_record(folder).frames].count("dark") == 3
    alone = tmp_path / "sent"
    shutil.copytree(folders[2], alone)
    shutil.rmtree(rig.out.parent)
    assert verify(alone).intact
    assert recompute(alone).differences == ()


def test_a_shared_file_that_was_changed_is_found_in_every_part_and_not_passed_on(three, plain):
    rig, folders = three
    path, name = folders[0] / "frames" / "001_dark.tif", "frames/001_dark.tif"
    white = folders[0] / "inputs" / "flat.tif"
    assert path.stat().st_mode & 0o222 == white.stat().st_mode & 0o222 == 0
    path.chmod(0o644)
    white.chmod(0o644)
    content = path.read_bytes()
    path.write_bytes(content[:-1] + b"!")
    white.write_bytes(white.read_bytes()[:-1] + b"!")
    for folder in folders:
        assert verify(folder).changed == (name, "inputs/flat.tif")
        with pytest.raises(RecordError, match="was changed since the inspection"):
            recompute(folder)
    for number in range(2):
        after = rig.inspect(f"T-1{number}", plain).folder
        assert verify(after).intact
        assert recompute(after).differences == ()
        assert not one_file(after / name, path)
    assert one_file(*(folder / "inputs" / "flat.tif" for folder in rig.folders if folder not in folders))
    path.unlink()
    assert verify(folders[0]).missing == (name,)
    assert verify(folders[1]).missing == ()


@pytest.mark.parametrize("code", [errno.EPERM, pytest.param(errno.ENOTSUP, marks=pytest.mark.soak)])
def test_without_hard_links_every_folder_has_copies(virtual_rig, plain, monkeypatch, caplog, code):
    def refuse(source, target, **_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "link", refuse)
    objects._say_once.cache_clear()
    rig = virtual_rig(recipe={"acquisition": {"dark_frames": 3}})
    folders = [rig.inspect(f"T-{number}", plain).folder for number in range(2)]
    assert not one_file(*(folder / "inputs" / "flat.tif" for folder in folders))
    assert not {line.sha256 for line in darks_of(folders[0])} & {line.sha256 for line in darks_of(folders[1])}
    assert all(verify(folder).intact and recompute(folder).differences == () for folder in folders)
    assert [one.getMessage() for one in caplog.records if one.name == "anisoscope.objects"] == [
        f"{rig.out / OBJECTS}: no hard links ({os.strerror(code)}): every inspection keeps copies of its own"
    ]


def test_a_file_that_can_have_no_further_name_is_stored_once_more(three, plain, monkeypatch):
    rig, folders = three
    link, white = os.link, folders[0] / "inputs" / "flat.tif"

    def refuse(source, target, **how):
        if Path(source).samefile(white):
            raise OSError(errno.EMLINK, os.strerror(errno.EMLINK))
        link(source, target, **how)

    monkeypatch.setattr(os, "link", refuse)
    more = [rig.inspect(f"T-1{number}", plain).folder for number in range(2)]
    assert not one_file(white, more[0] / "inputs" / "flat.tif")
    assert one_file(*(folder / "inputs" / "flat.tif" for folder in more))


def test_objects_that_no_folder_has_any_more_are_cleared_away_after_a_day(three):
    rig, folders = three
    place, now = rig.out / OBJECTS, datetime.now(UTC)
    there = sorted(place.glob("??/*"))
    assert len(there) >= 3
    for folder in folders[1:]:
        shutil.rmtree(folder)
    later = now + timedelta(days=2)
    assert clear_unused(place, later) == 0  # one inspection has them
    shutil.rmtree(folders[0])
    assert clear_unused(place, now) == 0
    (rig.out / ARCHIVE).write_text("{}")
    assert clear_unused(place, later) == 0  # an archive has no other names
    (rig.out / ARCHIVE).unlink()
    assert clear_unused(place, later) == len(there)
    assert list(place.glob("??/*")) == []


def test_other_light_in_the_room_begins_a_new_series(virtual_rig, plain, monkeypatch):
    rig = virtual_rig(recipe={"acquisition": {"dark_frames": 3}})
    rig.inspect("T-1", plain)
    grab = SimulatedCamera.grab
    monkeypatch.setattr(SimulatedCamera, "grab", lambda camera: grab(camera) + 3)
    brighter = rig.inspect("T-2", plain).folder
    after = rig.inspect("T-3", plain).folder
    first = rig.folders[0]
    hashes = [{line.sha256 for line in darks_of(folder)} for folder in (first, brighter, after)]
    assert not hashes[0] & hashes[1]
    assert len(hashes[1] & hashes[2]) == 2
    assert recompute(brighter).differences == ()


@pytest.mark.parametrize(("off_s", "shared"), [(10.0, True), (3590.0, True), (3601.0, False), (-5.0, False)])
def test_a_series_ends_after_an_hour_and_when_the_clock_is_set_back(three, off_s, shared):
    from anisoscope.inspection.job import prepare
    from anisoscope.rig.acquisition.opening import open_rig

    rig, folders = three
    job = prepare(rig.recipe, rig.rig, "T-9")
    with open_rig(job.rig) as opened:
        (series,) = (rig.out / OBJECTS / "darks").iterdir()
        began = SeriesFile.model_validate_json(series.read_bytes()).taken_at
        found = shared_darks(folders[0], job.plan(), opened, began + timedelta(seconds=off_s))
        assert (found is not None) == shared
        assert (
            shared_darks(rig.out / "x" / "y", job.plan(), opened, datetime.now(UTC)) is None
        )  # its own objects


def test_a_rig_may_refuse_to_share_dark_frames(virtual_rig, plain):
    rig = virtual_rig(rig={"camera": {"share_darks_s": 0.0}})
    folders = [rig.inspect(f"T-{number}", plain).folder for number in range(2)]
    assert not {line.sha256 for line in darks_of(folders[0])} & {line.sha256 for line in darks_of(folders[1])}


def test_an_inspection_with_shared_dark_frames_is_resumed(virtual_rig, plain, monkeypatch):
    from anisoscope.base.errors import CameraError
    from anisoscope.inspection.run import resume_part

    rig = virtual_rig(recipe={"acquisition": {"dark_frames": 3}})
    rig.inspect("T-1", plain)
    grab, count = SimulatedCamera.grab, []

    def fail(camera):
        count.append(1)
        if len(count) > 4:
            raise CameraError("the cable came off")
        return grab(camera)

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "grab", fail)
        with pytest.raises(CameraError):
            rig.inspect("T-2", plain)
    broken = next(folder for folder in rig.folders if folder.name.startswith("T-2"))
    assert verify(broken).intact
    done = resume_part(broken, methods=plain)
    assert done.record.verdict == "PASS"
    assert one_file(*(folder / "frames" / "001_dark.tif" for folder in rig.folders))
    assert verify(broken).intact
    assert recompute(broken).differences == ()
