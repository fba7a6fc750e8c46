"""A code on the plate of the virtual rig: where it should be, and only there."""

import numpy as np
import pytest

from anisoscope.base.errors import RigFileError
from anisoscope.inspection.batch.codes import read_codes, read_picture
from anisoscope.operations.demo.folder import FIXTURE
from anisoscope.rig.frame import Frame, write_frame
from anisoscope.sim.bench.bench import Bench, printed
from anisoscope.sim.bench.benchfile import BenchFile, CodePart
from anisoscope.sim.bench.optics import pixel_from_mm

PLACE = {"x_mm": 1.2, "y_mm": 1.25, "width_mm": 0.8}


def bench(code, filters="mono"):
    sample = {"kind": "ridges", "size_mm": 0.3} | ({} if code is None else {"code": PLACE | code})
    table = {
        "schema": 1,
        "sample": sample,
        "sensor": {"rows": 512, "cols": 512, "hot_pixel_share": 0.0, "filters": filters},
        "optics": {"pixel_um": 8.0, "electrons": 2.4e7},
        "stage": {"time_scale": 0.0, "zero_deg": 0.0},
        "fixture": FIXTURE,
    }
    made = Bench(BenchFile.model_validate(table))
    made.light_on = True
    return made


@pytest.mark.parametrize(
    "code",
    [
        {"text": "A17"},
        {"text": "A17", "kind": "qr", "turned_deg": 40.0},
        {"text": "A17", "kind": "code128", "turned_deg": 90.0, "width_mm": 1.2},
        {"text": "(10)L7(21)A17", "gs1": True, "white": 0.2, "black": 0.08, "turned_deg": 200.0},
    ],
)
def test_the_camera_sees_it_where_it_was_put(code):
    made = bench(code)
    (found,) = read_codes(made.photograph(0.0015, 1.0))
    assert (found.kind, found.scan.serial) == (code.get("kind", "datamatrix"), "A17")
    wanted = pixel_from_mm(made.file.optics, made.file.sensor, made.sample_angle_deg) @ [1.2, 1.25, 1.0]
    assert np.mean(found.corners, axis=0) == pytest.approx(wanted, abs=6.0)


def test_a_colour_camera_reads_it_as_well(tmp_path):
    """Small modules and little contrast, behind filters that pass 2.5 times as much as others."""
    made = bench({"text": "A17", "white": 0.2, "black": 0.08, "turned_deg": 200.0}, "gbrg")
    counts = made.photograph(0.003, 1.0)
    frame = Frame(counts, "sample", 12, 64.0, 0.003, 1.0, 0.0, 0.0, 0.0, "", "virtual", "gbrg")
    write_frame(frame, tmp_path / "a.tif")
    wanted = pixel_from_mm(made.file.optics, made.file.sensor, 0.0) @ [1.2, 1.25, 1.0]
    for picture in (frame.grey, read_picture(tmp_path / "a.tif")):
        (found,) = read_codes(picture)
        assert found.scan.serial == "A17"
        assert np.mean(found.corners, axis=0) == pytest.approx(wanted, abs=6.0)


def test_the_rest_of_the_picture_is_as_without_it():
    with_code, without = (
        made._radiance_on_sensor(made._shining()[0][0]) for made in (bench({"text": "A17"}), bench(None))
    )
    changed = np.argwhere(np.abs(with_code - without) > 1e-6)
    middle = changed.mean(axis=0)
    assert np.abs(changed - middle).max() < 0.8 * 1000 / 8.0
    assert len(changed) > 2000


def test_it_turns_with_the_stage():
    made = bench({"text": "A17"})
    made.axis.start_move(90.0)
    (found,) = read_codes(made.photograph(0.0015, 1.0))
    wanted = pixel_from_mm(made.file.optics, made.file.sensor, 90.0) @ [1.2, 1.25, 1.0]
    assert made.sample_angle_deg == pytest.approx(90.0)
    assert np.mean(found.corners, axis=0) == pytest.approx(wanted, abs=6.0)


def test_what_no_code_can_hold_is_said():
    with pytest.raises(RigFileError, match="cannot be written as code128"):
        printed(CodePart(text="€" * 200, kind="code128", **PLACE))
