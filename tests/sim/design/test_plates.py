"""Pictures of ridges: what the fields show is what was asked for, at each stage angle."""

import arbez_dmtx
import cv2
import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.sim.design.plates import design_pictures, modules_of_code
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

PLASTIC = Material(0.06, 0.10, 0.2)
RIDGES = RidgeDesign(50.0, 8.0, 10.0, edge_radius_um=1.0)
ACROSS, DOWN = np.meshgrid(np.linspace(0.0, 1.0, 24), np.linspace(0.0, 1.0, 24))
RINGS = 0.5 + 0.5 * np.cos(12.0 * np.hypot(ACROSS - 0.5, DOWN - 0.5))
BOTH = np.stack([ACROSS, RINGS])


def designed(pictures, stages, design=RIDGES, field_um=100.0, material=PLASTIC, **options):
    return design_pictures(pictures, stages, design, field_um, material, 10.0, **options)


@pytest.mark.parametrize("text", ["RIDGE", "LOT 7 of 2026, insert 12", "x" * 120])
def test_qr_codes_are_read_by_another_reader_than_the_one_that_encodes_them(text):
    drawn = np.where(modules_of_code(text, "qr"), 0, 255).astype(np.uint8)
    found, _, _ = cv2.QRCodeDetector().detectAndDecode(np.kron(drawn, np.ones((8, 8), np.uint8)))
    assert found == text


@pytest.mark.parametrize("text", ["A17", "RIDGE", "LOT 7 of 2026, insert 12", "x" * 120])
def test_data_matrices_are_square_and_read_by_another_reader(text):
    """The smallest symbol of 120 letters would be of 20 × 64 modules, which libdmtx does not know."""
    modules = modules_of_code(text, "datamatrix")
    assert modules.shape[0] == modules.shape[1]
    drawn = np.kron(np.where(modules, 0, 255).astype(np.uint8), np.ones((8, 8), np.uint8))
    (found,) = arbez_dmtx.decode(np.stack([drawn] * 3, axis=-1), max_count=1)
    assert found.data.decode() == text


def test_one_picture_is_shown_nearly_exactly():
    found = designed(RINGS[None], (0.0,))
    (similar,), talk = found.likeness()
    assert similar > 0.99
    assert talk == (0.0,)
    np.testing.assert_allclose(found.shown, found.wanted, atol=0.02 * (found.white - found.black))


@pytest.mark.parametrize("stages", [(0.0, 90.0), (0.0, 180.0), (20.0, 65.0)])
def test_two_pictures_are_shown_with_little_of_each_other(stages):
    found = designed(BOTH, stages)
    similar, talk = found.likeness()
    assert min(similar) > 0.9
    assert max(talk) < 0.02
    assert found.missed < 0.06
    assert found.white > 2.0 * found.black
    row, col = 5, 17
    letter = found.plan.rows[row][col]
    ridges = found.plan.design_of(letter, RIDGES)
    border = 0.5 * ridges.height_um * np.tan(np.radians(10.0)) / 100.0
    for stage, shown in zip(stages, found.shown, strict=True):
        sides = directions((Pose(stage),), Convention(facet_azimuth_deg=found.plan.azimuths_deg[letter]))
        light = float(corrected.radiance(*sides, ridges, PLASTIC)[0]) * (1.0 - 2.0 * border) ** 2
        assert shown[row, col] == pytest.approx(light, rel=1e-9)


def test_classes_are_few_and_of_common_greys():
    found = designed(BOTH, (0.0, 90.0), classes=12)
    assert len(found.plan.letters) == 12
    assert min(found.likeness()[0]) > 0.6
    three = designed(np.round(2.0 * ACROSS)[None] / 2.0, (0.0,))
    assert len(three.plan.letters) == 3
    assert three.likeness()[0][0] > 0.99
    # the first class is the darkest
    dark = three.shown[0][np.array([list(row) for row in three.plan.rows]) == "A"]
    assert dark.max() == three.shown.min()


def test_likeness_of_other_radiances():
    found = designed(BOTH, (0.0, 90.0))
    exchanged, talk = found.likeness(found.shown[::-1])
    assert max(exchanged) < 0.5
    assert min(talk) > 10.0
    halved = found.wanted + 0.1 * (found.wanted[::-1] - found.wanted)
    assert found.likeness(halved)[1] == pytest.approx((1.0 / 9.0, 1.0 / 9.0), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"stages": (0.0, 4.0)}, "take stage angles farther apart"),
        ({"stages": (0.0, 1.0)}, "a plate looks the same"),
        ({"pictures": np.stack([ACROSS] * 3), "stages": (0.0, 90.0, 180.0)}, "one picture or two"),
        ({"pictures": np.zeros((1, 600, 4)), "stages": (0.0,)}, "at most 512 × 512"),
        ({"classes": 1}, "--class-count must be 2 to 256"),
        ({"design": RidgeDesign(40.0, 8.0, 10.0)}, "--pitch must be 50 µm or more, not 40"),
        ({"field_um": 130.0}, "hold 2.60 ridges of 50 µm: make them 100 or 150 µm wide"),
        ({"design": RidgeDesign(50.0, 8.0, 0.5)}, "a draft of 0.5° hold the part in its mould"),
        ({"design": RidgeDesign(50.0, 8.0, "vertical")}, "a draft of 0° hold the part in its mould"),
        ({"material": Material(0.8, 0.8, 0.9)}, "no field is 1.5 times as bright at one stage angle"),
    ],
)
def test_what_no_plate_can_show_is_refused(change, match):
    with pytest.raises(UsageError, match=match):
        designed(**{"pictures": BOTH, "stages": (0.0, 90.0)} | change)
