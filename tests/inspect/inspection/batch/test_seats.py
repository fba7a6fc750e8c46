"""A tray of several parts on the virtual rig: x and y follow every part around the axis, z goes to its focus."""

import threading

import numpy as np
import pytest

from anisoscope.base.errors import CameraError, RigError, UsageError
from anisoscope.calibration.rotation import calibrate_rotation
from anisoscope.cli import run as command
from anisoscope.inspection.batch.start import Order
from anisoscope.inspection.batch.tray import read_tray
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.run import inspect_part, resume_part
from anisoscope.live_view.autofocus import Sweep, fit_plane, map_focus
from anisoscope.parameters.taking import Taking
from anisoscope.record.schema import Particulars, read_record
from anisoscope.rig.acquisition.journal import read_journal
from anisoscope.sim.bench.camera import SimulatedCamera

SEATS = ((0.0, 0.0), (6.0, 1.5), (-2.5, 5.5))
SLOPE = (0.012, -0.02)  # mm per mm: at the outer seats several depths of field
ZERO_MM = {"x": 12.37, "y": 11.81, "z": 10.0}
AXIS_PX = (9.0, -6.0)
PIXEL_UM = 8.0
EXPOSURE_S = 0.0015
LIST = "slot,serial,x_mm,y_mm\n" + "".join(f"{n},P{n},{x},{y}\n" for n, (x, y) in enumerate(SEATS, start=1))


def axes_of_bench(**changes):
    found = {
        name: {"protocol": "zaber", "address": str(number), "zero_mm": ZERO_MM[name]}
        for number, name in enumerate("xyz", start=1)
    }
    return {**found, "tray": {"parts": [list(seat) for seat in SEATS], "slope": list(SLOPE)}, **changes}


def axes_of_rig():
    scale = {"counts_per_mm": 1000.0 / 0.047625}
    return {
        name: {
            "driver": "zaber",
            "port": "sim://zaber?bench=${here}/bench.toml",
            "options": {"address": number, **scale},
            "zero_mm": ZERO_MM[name] + off,
        }
        for number, (name, off) in enumerate((("x", 0.11), ("y", -0.07), ("z", 0.0)), start=1)
    }


@pytest.fixture(scope="module")
def tray(virtual_rigs, tmp_path_factory):
    """A rig with x, y and z, its rotation and its focus map calibrated; and its tray list."""
    optics = {"axis_px": list(AXIS_PX), "numerical_aperture": 0.05}
    rig = virtual_rigs(
        "tray",
        bench={"optics": optics, **axes_of_bench()},
        rig=axes_of_rig(),
        recipe={"poses": {"angles_deg": [0.0, 90.0, 180.0]}},
    )
    here = rig.rig.parent
    rotation = calibrate_rotation(
        rig.rig, here / "rotation.json", Taking(0.004, frames=2), angles=6, at_mm=SEATS[1]
    )
    text = rig.rig.read_text()
    rig.rig.write_text(text.replace("[calibration]\n", '[calibration]\nrotation = "rotation.json"\n'))
    focus = map_focus(
        rig.rig, SEATS, here / "focus.json", Taking(0.003), Sweep(9.55, 10.45, steps=7, repeats=2)
    )
    text = rig.rig.read_text()
    rig.rig.write_text(text.replace("[calibration]\n", '[calibration]\nfocus = "focus.json"\n'))
    (here / "tray.csv").write_text(LIST)
    return rig, rotation, focus


def test_the_rotation_centre_is_found_in_x_and_y(tray):
    _, rotation, _ = tray
    for name, off_px, sign in (("x", AXIS_PX[0], -1), ("y", AXIS_PX[1], 1)):
        expected = ZERO_MM[name] + sign * off_px * PIXEL_UM / 1000.0
        assert rotation.number(name) == pytest.approx(expected, abs=max(4 * rotation.uncertainty(name), 5e-4))
        assert 0.0 < rotation.uncertainty(name) < 0.002
        assert abs(rotation.number(f"{name}_direction")) < 0.1
        assert rotation.number(f"{name}_scale") == pytest.approx(1.0, abs=2e-3)
    assert rotation.number("eccentricity_x") == pytest.approx(SEATS[1][0], abs=0.01)
    assert rotation.in_limits


def test_the_focus_map_is_the_plane_of_the_plate(tray):
    _, _, focus = tray
    found = focus.number("z"), focus.number("slope_x"), focus.number("slope_y")
    # a plate that rises lies nearer: z goes down by as much
    assert found == pytest.approx((ZERO_MM["z"], -SLOPE[0], -SLOPE[1]), abs=1e-3)
    assert focus.number("repeatability") < 0.002
    assert focus.number("bow") == 0.0
    assert focus.in_limits
    assert focus.remarks == ("three seats fix the plane, so that nothing tests it: map four or more",)


def test_a_bowed_plate_and_its_uncertainty_come_back_from_seats_that_scatter(rng):
    places = rng.uniform(-10.0, 10.0, (9, 2))
    true = np.array([10.0, -0.012, 0.02, 4e-4])
    design = np.column_stack([np.ones(9), places, np.sum(places**2, axis=1)])
    off = []
    for _ in range(200):
        found = fit_plane(places, design @ true + 0.001 * rng.standard_normal(9), 0.0)
        off.append((np.array([found.z, *found.slope, found.bow]) - true) / found.u)
    assert np.std(off, axis=0) == pytest.approx(
        np.sqrt(5.0 / 3.0), rel=0.25
    )  # of Student's t, five degrees of freedom
    with pytest.raises(UsageError, match="do not lie on one line"):
        fit_plane(np.array([[0.0, 0.0], [5.0, 0.0], [-4.0, 0.0]]), np.zeros(3), 0.0)


def test_every_part_of_a_tray_is_brought_below_the_camera_and_into_focus(tray, tmp_path, run, scripted):
    rig, _, _ = tray
    order, who = Order(read_tray(rig.rig.with_name("tray.csv")), rig.recipe, rig.rig, tmp_path), scripted()
    slots = run(order, who).slots
    assert who.asked == ["3 at once"]  # nobody is asked part by part
    assert [slot.verdict for slot in slots] == ["PASS"] * 3
    for slot, seat in zip(slots, SEATS, strict=True):
        folder = tmp_path / slot.folder
        record = read_record(folder)
        assert record.particulars.place_mm == seat
        for frame in (one for one in record.frames if one.kind == "sample"):
            turn = np.exp(1j * np.radians(frame.commanded_deg))
            went = -turn * complex(*seat)
            at = frame.linear_mm
            assert at["x"] - ZERO_MM["x"] + AXIS_PX[0] * PIXEL_UM / 1000.0 == pytest.approx(
                went.real, abs=3e-3
            )
            assert at["y"] - ZERO_MM["y"] - AXIS_PX[1] * PIXEL_UM / 1000.0 == pytest.approx(
                went.imag, abs=3e-3
            )
            assert at["z"] - ZERO_MM["z"] == pytest.approx(-SLOPE[0] * seat[0] - SLOPE[1] * seat[1], abs=2e-3)
        assert verify(folder).intact


def place(seat):
    return Particulars(place_mm=seat)


def test_an_interrupted_part_goes_on_at_its_own_seat(tray, tmp_path, monkeypatch, undiagnosed):
    rig, _, _ = tray
    grab, count = SimulatedCamera.grab, []

    def fail(camera):
        count.append(1)
        if len(count) > 5:
            raise CameraError("the cable came off")
        return grab(camera)

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "grab", fail)
        with pytest.raises(CameraError, match="the cable came off"):
            inspect_part(
                rig.recipe, rig.rig, "P2", tmp_path, particulars=place(SEATS[1]), methods=undiagnosed
            )
    folder = next(tmp_path.glob("*/job.json")).parent
    for axis in rig.bench.linear.values():  # somebody moved them meanwhile
        axis.start_move(axis.position() + 1.0)
    found = resume_part(folder, methods=undiagnosed)
    assert found.record.verdict == "PASS"
    assert found.record.particulars.place_mm == SEATS[1]


def test_a_stop_ends_the_way_to_a_seat_at_once(tray, tmp_path, undiagnosed):
    rig, _, _ = tray
    cancel = threading.Event()

    def halt(text, _done, _total):
        if text.startswith("moving x"):
            cancel.set()

    with pytest.raises(RigError, match="cancelled after"):
        inspect_part(
            rig.recipe,
            rig.rig,
            "P3",
            tmp_path,
            halt,
            particulars=place(SEATS[2]),
            methods=undiagnosed,
            cancel=cancel,
        )
    frames = [read_journal(folder).frames for folder in tmp_path.iterdir()]
    assert all(line.kind == "dark" for lines in frames for line in lines)
    assert not rig.bench.light_on


def test_a_part_that_is_not_where_the_list_says_is_refused(tray, tmp_path, undiagnosed):
    rig, _, _ = tray
    off = (SEATS[1][0] + 0.4, SEATS[1][1])
    found = inspect_part(rig.recipe, rig.rig, "P2", tmp_path, particulars=place(off), methods=undiagnosed)
    assert found.record.verdict == "INVALID"
    assert "from where x and y bring them" in found.record.reasons[0]


def test_seats_beyond_map_or_travel_are_refused_before_anything_moves(tray, tmp_path, capsys):
    rig, _, _ = tray
    before = [axis.position() for axis in rig.bench.linear.values()]
    unmapped = rig.rig.with_name("unmapped.toml")
    unmapped.write_text(rig.rig.read_text().replace('focus = "focus.json"\n', ""))
    for file, code, said in (
        (rig.rig, 3, "mm from the middle of the focus map"),
        (unmapped, 78, "the part at a sample angle of 90° needs the y at"),
    ):
        files = ["--recipe", str(rig.recipe), "--rig", str(file), "--out", str(tmp_path), "--serial", "P9"]
        assert command(["inspect", *files, "--at", "12", "6"]) == code
        assert said in capsys.readouterr().err
    assert [axis.position() for axis in rig.bench.linear.values()] == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("slot,serial,x_mm\n1,A,3\n", "line 2, column y_mm: missing; a place on the plate has x_mm and y_mm"),
        ("slot,serial,x_mm,y_mm\n1,A,3,wide\n", "line 2, column y_mm: 'wide' is no length in mm"),
    ],
)
def test_half_a_place_in_a_list_is_named(tray, tmp_path, capsys, text, said):
    rig, _, _ = tray
    path = tmp_path / "half.csv"
    path.write_text(text)
    assert command(["batch", str(path), "--recipe", str(rig.recipe), "--rig", str(rig.rig), "--yes"]) == 64
    assert said in capsys.readouterr().err


def test_a_rig_without_x_and_y_does_not_go_to_a_seat(virtual_rig, tmp_path, capsys):
    rig = virtual_rig()
    files = ["--recipe", str(rig.recipe), "--rig", str(rig.rig), "--out", str(tmp_path), "--serial", "P9"]
    assert command(["inspect", *files, "--at", "3", "2"]) == 69
    assert "describe [x] and [y] in the rig file" in capsys.readouterr().err
