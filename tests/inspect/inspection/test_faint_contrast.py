"""Local defects of a part whose own contrast is small: a pale plastic with steep ridges, ln ratios of 0.4 at most."""

import numpy as np
import pytest

from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defect_injection import inject_defect
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.record.surface_details import surface_of

ALPHA, TEXTURE, ALBEDO, ANGLE_DEG, PITCH_UM = 0.095, 0.03, 0.25, 15.0, 100.0
DEFECTS = {
    "good": None,
    "burrs": ("burrs", {"coverage": 0.05}),
    "scratches": ("scratches", {"density_per_mm2": 40.0}),  # 1.5 % of the area
}


def surface_of_part(defect, rng):
    pitches, step = 26, 2.0
    points = round(pitches * PITCH_UM / step) + 1
    good = ridges(RidgeDesign(PITCH_UM, ANGLE_DEG), (points, points), (step, step))
    good = add_facet_roughness(good, TEXTURE, TEXTURE, 8.0, rng)
    if DEFECTS[defect] is None:
        return good
    name, values = DEFECTS[defect]
    return inject_defect(good, name, rng, values=values)


@pytest.mark.soak
@pytest.mark.parametrize("defect", DEFECTS)
def test_local_defects_are_found_where_the_contrast_is_small(virtual_rig, undiagnosed, tmp_path, rng, defect):
    path = tmp_path / "part.npz"
    write_height_map(surface_of_part(defect, rng), path)
    whole = float(np.hypot(ALPHA, TEXTURE))
    plastic = {"albedo": ALBEDO, "u_tail": 0.0}
    rig = virtual_rig(
        recipe={
            "surface": {"pitch_um": PITCH_UM, "design": {"ridge_angle_deg": ANGLE_DEG, "u_ridge_angle_deg": 0.1}},
            "material": {"alpha_along": whole, "alpha_across": whole, **plastic},
            "decision": {"tolerance": 3.0},
        },
        bench={
            "sample": {
                "kind": "height-map", "file": str(path),
                "material": {"alpha_along": ALPHA, "alpha_across": ALPHA, "albedo": ALBEDO, "index": 1.5},
            }
        },
    )  # fmt: skip
    record = rig.inspect(methods=undiagnosed).record
    contrasts = [abs(one.measured) for one in surface_of(record).contrasts]
    assert max(contrasts) < 0.4
    share = surface_of(record).area.share
    assert record.verdict == {"good": "PASS", "burrs": "FAIL", "scratches": "FAIL"}[defect]
    assert share < 0.005 if defect == "good" else share > 0.02
