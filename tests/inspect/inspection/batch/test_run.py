"""A tray on the virtual rig: verdicts, faults, skipped slots, codes that are not those of the list, going on."""

import shutil
from dataclasses import replace

import pytest

from anisoscope.base.errors import CameraError, UsageError
from anisoscope.inspection.batch.first_pose import Look
from anisoscope.inspection.batch.journal import read_batch
from anisoscope.inspection.batch.operator import Answer, Unattended, seconds_left
from anisoscope.inspection.batch.run import run_batch
from anisoscope.inspection.batch.scan import read_scan
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.reports import Reports
from anisoscope.operations.remembering import lot_mates, remember
from anisoscope.record.schema import read_record
from anisoscope.sim.bench.camera import SimulatedCamera

THREE = "slot,serial,lot,cavity\n1,A17,7,a\n2,A18,7,b\n3,A19,,\n"
CODE = {"x_mm": 1.3, "y_mm": 1.3, "width_mm": 0.8}


def words(batch):
    return [slot.word for slot in batch.slots]


def coded(text, **changes):
    return {"sample": {"code": {**CODE, "text": text, **changes}}}


@pytest.fixture
def failing(monkeypatch):
    """``failing(2, 3)``: the camera fails for the second and third inspection (counted by the first frame)."""

    def plan(*parts, after=3):
        grab, configure, state = SimulatedCamera.grab, SimulatedCamera.configure, {"part": 0, "frames": 0}

        def begin(camera, exposure_s, gain):
            state.update(part=state["part"] + 1, frames=0)
            return configure(camera, exposure_s, gain)

        def fail(camera):
            state["frames"] += 1
            if state["part"] in parts and state["frames"] > after:
                raise CameraError("the cable came off")
            return grab(camera)

        monkeypatch.setattr(SimulatedCamera, "configure", begin)
        monkeypatch.setattr(SimulatedCamera, "grab", fail)

    return plan


def test_a_tray_is_inspected_and_every_part_recorded(tray_of, run, remembered, scripted):
    order, who = tray_of(THREE), scripted()
    found = run(order, who)
    assert words(found) == who.done == ["INVALID"] * 3
    assert found.exit_code == 3
    assert "marker" in found.slots[0].reason
    assert remembered == ["A17", "A18", "A19"]
    assert who.asked == [("1", False), ("2", False), ("3", False)]
    assert read_batch(order.out) == found
    assert (order.out / "tray.csv").read_text() == THREE
    record = read_record(order.out / found.slots[0].folder)
    assert (record.serial, record.particulars.lot, record.particulars.cavity) == ("A17", "7", "a")
    assert (record.particulars.operator, record.particulars.station) == ("M. M.", "line 2")
    assert seconds_left(found) == 0.0
    with pytest.raises(UsageError, match="a batch began there; --resume goes on with it"):
        run(order)


def test_a_bad_part_and_a_fault_stop_nothing(tray_of, virtual_rig, run, failing, tmp_path):
    bad = virtual_rig("bad", bench={"sample": {"ridge_angle_deg": 16.0}})
    tile = virtual_rig("tile", bench={"sample": {"kind": "white-tile"}})
    failing(3)
    rows = f"slot,serial,rig\n1,A1,{bad.rig}\n2,A2,{tile.rig}\n3,A3,\n4,A4,\n"
    found = run(tray_of(rows, bench={}))
    assert words(found) == ["FAIL", "INVALID", "fault", "PASS"]
    assert found.slots[2].reason == "the cable came off"
    assert found.exit_code == CameraError.exit_code
    assert found.counts == {"INVALID": 1, "FAIL": 1, "INCONCLUSIVE": 0, "PASS": 1, "fault": 1}
    assert found.with_slot(2, state="done", verdict="PASS").exit_code == 3
    assert found.with_slot(2, state="skipped").with_slot(1, verdict="PASS").exit_code == 1


def test_two_faults_in_a_row_stop_and_ask(tray_of, run, failing, scripted):
    failing(1, 2, 3, 5)
    who = scripted(troubles=["again", "go on"])
    rows = THREE + "4,A20,,\n5,A21,,\n"
    found = run(tray_of(rows), who)
    # 1 and 2 fail, 2 is tried again and fails, then it goes on; a fault after a good part asks nobody
    assert words(found) == ["fault", "fault", "INVALID", "fault", "INVALID"]
    assert [asked for asked in who.asked if asked[1] not in {True, False} or asked[1] == 2] == [
        ("2", 2),
        ("2", 3),
    ]


def test_where_nobody_is_asked_two_faults_stop_and_resume_goes_on(tray_of, run, failing, remembered):
    failing(1, 2)
    order = tray_of(THREE)
    found = run(order)
    assert words(found) == ["fault", "fault", "waiting"]
    before = {slot.folder for slot in found.slots[:2]}
    assert all((order.out / name / "job.json").exists() for name in before)
    found = run(order, resume=True)
    assert words(found) == ["INVALID"] * 3
    assert {slot.folder for slot in found.slots[:2]} == before  # taken up, not begun anew
    assert remembered == ["A17", "A18", "A19"]
    assert all(verify(order.out / slot.folder).intact for slot in found.slots)


def test_skipping_stopping_and_going_on(tray_of, run, scripted, remembered):
    order = tray_of(THREE)
    found = run(order, scripted([Answer("skip"), Answer(), Answer("stop")]))
    assert words(found) == ["skipped", "INVALID", "waiting"]
    assert (found.exit_code, found.with_slot(1, verdict="PASS").exit_code) == (3, 75)
    who = scripted()
    found = run(order, who, resume=True)
    assert words(found) == ["INVALID"] * 3
    assert [slot for slot, _ in who.asked] == ["1", "3"]
    assert remembered == ["A18", "A18", "A17", "A19"]  # the history takes a seal once
    with pytest.raises(UsageError, match="no batch began there"):
        run(tray_of(THREE).__class__(order.tray, order.recipe, order.rig, order.out / "other"), resume=True)


def test_an_interruption_says_how_to_go_on(tray_of, run, scripted):
    order = tray_of(THREE)
    with pytest.raises(KeyboardInterrupt) as caught:
        run(order, scripted([Answer(), KeyboardInterrupt()]))
    assert "--resume goes on" in caught.value.__notes__[-1]
    assert words(read_batch(order.out)) == ["INVALID", "waiting", "waiting"]


def test_a_finished_part_that_was_not_noted_is_not_inspected_again(tray_of, run, scripted, remembered):
    order = tray_of(THREE)
    run(order, scripted([Answer(), Answer("stop")]))
    path = order.out / "batch.json"
    path.write_text(path.read_text().replace('"state": "done"', '"state": "at work"', 1))
    (order.out / "2" / "A18-20260101T000000Z" / "inputs").mkdir(parents=True)  # died before it began
    who = scripted()
    found = run(order, who, resume=True)
    assert words(found) == ["INVALID"] * 3
    assert [slot for slot, _ in who.asked] == ["2", "3"]
    assert remembered == ["A17", "A17", "A18", "A19"]
    assert len(list((order.out / "2").iterdir())) == 1


def test_another_list_or_recipe_is_not_taken_for_the_same_batch(tray_of, run, scripted):
    run(tray_of(THREE), scripted([Answer("stop")]))
    with pytest.raises(UsageError, match="the tray list is not the one with which the batch began"):
        run(tray_of(THREE + "4,A20,,\n"), resume=True)
    order = tray_of(THREE)
    order.recipe.write_text(order.recipe.read_text() + "\n# changed\n")
    with pytest.raises(UsageError, match="the recipe is not the one"):
        run(order, resume=True)


def test_files_are_checked_before_anything_moves(tray_of, run, tmp_path):
    with pytest.raises(UsageError, match="line 3, column serial: slot 2 has none"):
        run(tray_of("slot,serial\n1,A\n2,\n"))
    assert not (tmp_path / "batch").exists()


def test_a_scanned_code_is_compared_with_the_list(tray_of, run, scripted):
    scans = ["]d210L1\x1d21A17", "A99", "]d210L8\x1d21A19"]
    order = tray_of("slot,serial,lot\n1,A17,\n2,A18,\n3,A19,L7\n", bench={})
    found = run(order, scripted([Answer("go on", read_scan(scan)) for scan in scans]))
    assert words(found) == ["PASS", "INVALID", "INVALID"]
    assert (found.slots[0].lot, found.slots[0].code) == ("L1", "(10)L1(21)A17")
    assert found.slots[1].reason == "slot 2 should hold A18, its code reads A99"
    assert found.slots[2].reason == "slot 3 should hold lot L7, its code reads lot L8"
    folder = order.out / found.slots[1].folder
    record = read_record(folder)
    assert (record.serial, record.verdict, record.frames) == ("A18", "INVALID", ())
    assert record.reasons == ("slot 2 should hold A18, its code reads A99",)
    assert verify(folder).intact
    assert recompute(folder).differences == ()


@pytest.mark.parametrize(
    "kind", ["datamatrix", *(pytest.param(kind, marks=pytest.mark.soak) for kind in ("code128", "qr"))]
)
def test_the_camera_reads_the_code_on_the_part(tray_of, run, kind):
    code = coded("A17", kind=kind, turned_deg=25.0, white=0.4, black=0.15, width_mm=1.1)
    found = run(tray_of("slot,serial\n1,\n", Look(), bench=code))
    assert words(found) == ["PASS"]
    assert (found.slots[0].serial, found.slots[0].code) == ("A17", "A17")


def test_the_wrong_part_in_a_slot_is_invalid_and_its_picture_kept(tray_of, run):
    order = tray_of("slot,serial\n3,A17\n4,\n5,\n", Look("datamatrix"), bench=coded("A71"))
    found = run(order)
    assert words(found) == ["INVALID", "PASS", "INVALID"]
    assert found.slots[0].reason == "slot 3 should hold A17, its code reads A71"
    assert found.slots[2].reason == "slot 5: its code reads A71, which slot 4 holds"
    folder = order.out / found.slots[0].folder
    assert (folder / "code.tif").stat().st_size > 10_000
    assert verify(folder).intact
    shutil.copyfile(folder / "record.json", folder / "code.tif")
    assert verify(folder).changed == ("code.tif",)


def test_a_code_that_cannot_be_read_is_asked_for_or_makes_the_part_invalid(tray_of, run, scripted):
    who = scripted(serials=[read_scan("A17"), None])
    found = run(tray_of("slot,serial\n1,A17\n3,\n", Look("datamatrix")), who)
    assert words(found) == ["INVALID"] * 2
    assert "marker" in found.slots[0].reason
    assert "slot 3: no Data Matrix can be read in the picture at the first pose" in found.slots[1].reason
    assert found.slots[1].serial == "unread-3"
    assert [slot for slot, why in who.asked if why is not False] == ["1", "3"]


def test_every_part_is_shown_beside_those_of_its_lot(tray_of, undiagnosed, tmp_path):
    lots, write = [], undiagnosed.page

    def look(record, pictures, *others):
        lots.append((record.serial, pictures.lot and [part.serial for part in pictures.lot.parts]))
        return write(record, pictures, *others)

    methods = replace(undiagnosed, page=look)
    place = tmp_path / "history.sqlite"
    order = tray_of("slot,serial,lot\n1,A17,L7\n2,A18,L8\n3,A19,L7\n")
    order = replace(order, lot_mates=lambda lot: lot_mates(place, lot))
    run_batch(order, Unattended(), lambda inspected: remember(inspected, place), methods=methods)
    assert lots == [("A17", None), ("A18", None), ("A19", ["A17"])]


def test_a_part_that_is_taken_up_is_shown_beside_its_lot_as_well(tray_of, failing, undiagnosed, tmp_path):
    lots, write = [], undiagnosed.page

    def look(record, pictures, *others):
        lots.append((record.serial, pictures.lot and [part.serial for part in pictures.lot.parts]))
        return write(record, pictures, *others)

    methods = replace(undiagnosed, page=look)
    failing(2)
    place = tmp_path / "history.sqlite"
    order = replace(
        tray_of("slot,serial,lot\n1,A17,L7\n2,A18,L7\n"), lot_mates=lambda lot: lot_mates(place, lot)
    )
    for resume in (False, True):
        run_batch(
            order, Unattended(), lambda inspected: remember(inspected, place), resume=resume, methods=methods
        )
    assert lots == [("A17", None), ("A18", ["A17"])]


def test_reports_follow_in_the_background_and_a_resumed_batch_writes_those_that_are_missing(tray_of, run):
    order = tray_of("slot,serial\n1,A17\n2,A18\n")
    with Reports() as reports:
        found = run(order, reports=reports)
    folders = [order.out / slot.folder for slot in found.slots]
    assert all(verify(folder).report_written for folder in folders)
    for name in ("report.html", "report.sha256"):
        (folders[0] / name).unlink()
    run(order, resume=True)
    assert verify(folders[0]).report_written
    assert verify(folders[0]).intact
