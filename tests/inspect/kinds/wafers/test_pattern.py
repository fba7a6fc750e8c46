"""A wafer whose pattern does not repeat: a window of it is inspected, where it lies on the part."""

import numpy as np
import pytest
import tomli_w

from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.run import inspect_part
from anisoscope.operations.demo import wafers as demo_wafer
from anisoscope.profiles.files.load import write_height_map
from anisoscope.sim.design.designfile import write_layout
from anisoscope.sim.design.pattern import PatternOptions, make_layout

DOT_UM, DOTS, AREA, INSIDE = 128.0, 6, 4, 2
"""Dots along a side of the part, of the area at its lower right that is wide along x, of the window in its middle."""
SIDE_MM = 1e-3 * DOT_UM * DOTS
CORNER_UM = (DOT_UM * (AREA - INSIDE) / 2.0, DOT_UM * (DOTS - (AREA + INSIDE) / 2.0))
"""(y, x) of the window's lower left."""
MIDDLE_MM = 1e-3 * DOT_UM * (DOTS - AREA) / 2.0
"""Of the window from the middle of the part, towards +x and −y."""


@pytest.fixture(scope="module")
def wafer(tmp_path_factory, small_wafer_rig):
    """Layout of dots that are wide along y but for an area, a window in its middle, rig and flat."""
    folder, rng = tmp_path_factory.mktemp("pattern"), np.random.default_rng(8)
    wide_x = demo_wafer.design()
    turned = wide_x.model.model_copy(
        update={
            "widths_x_um": wide_x.model.widths_y_um,
            "p_a_x": wide_x.model.p_a_y,
            "widths_y_um": wide_x.model.widths_x_um,
            "p_a_y": wide_x.model.p_a_x,
        }
    )
    wide_y = wide_x.model_copy(update={"name": "wide along y", "model": turned})
    classes = np.ones((DOTS, DOTS), dtype=np.int64)
    classes[-AREA:, -AREA:] = 0  # row 0 is at the top of the picture
    layout = make_layout(classes, (wide_x, wide_y), rng, PatternOptions(DOT_UM, 4))
    write_layout(layout, folder / "wafer.npz", (wide_x, wide_y))
    side = INSIDE * DOT_UM
    write_height_map(layout.window(CORNER_UM, (side, side)), folder / "window.npz")
    sample = {"kind": "wafer", "size_mm": SIDE_MM, "wafer": {"file": "../../wafer.npz", **demo_wafer.LIGHT}}
    for name, table in (("part", sample), ("white-tile", {"kind": "white-tile"})):
        place = folder / "bench" / name
        place.mkdir(parents=True)
        (place / "bench.toml").write_text(tomli_w.dumps(small_wafer_rig(demo_wafer.bench(table, 7))))
        (place / "rig.toml").write_text(tomli_w.dumps(small_wafer_rig(demo_wafer.rig(name))))
    rig = folder / "bench" / "white-tile" / "rig.toml"
    take_flat(rig, folder / "flat.tif", exposure_s=0.03, frames=4, reflectance=0.99)
    return folder


def recipe(center_mm):
    side = INSIDE * DOT_UM
    found = demo_wafer.recipe()
    found["surface"] = {"height_map": "window.npz", "pitch_um": side}
    found["region"] = {"center_mm": center_mm, "size_mm": [1e-3 * side, 1e-3 * side]}
    found["poses"]["angles_deg"] = [0.0, 90.0]
    found["acquisition"] |= {"frames_per_pose": 2, "dark_frames": 2, "exposure_s": 2.4e-5}
    return found


@pytest.mark.parametrize(
    ("name", "center_mm", "verdict"),
    [
        ("there", [MIDDLE_MM, -MIDDLE_MM], "PASS"),
        pytest.param("elsewhere", [MIDDLE_MM, MIDDLE_MM], "FAIL", marks=pytest.mark.soak),
    ],
)
def test_a_window_of_a_pattern_is_inspected_where_it_lies(wafer, undiagnosed, name, center_mm, verdict):
    path = wafer / f"{name}.toml"
    path.write_text(tomli_w.dumps(recipe(center_mm)))
    record = inspect_part(
        path, wafer / "bench" / "part" / "rig.toml", name, wafer / "inspections", methods=undiagnosed
    ).record
    assert record.verdict == verdict, record.reasons
    if verdict == "PASS":
        assert record.p_value > 0.01
        dark, bright = (pose.predicted for pose in record.poses if pose.tilt_deg == demo_wafer.TILT_DEG)
        assert np.log(bright / dark) > 1.5
