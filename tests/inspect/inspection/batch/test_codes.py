"""Codes in pictures: turned, pale, small, several of them."""

import cv2
import numpy as np
import pytest
import zxingcpp

from anisoscope.base.errors import MeasurementError, RecordError
from anisoscope.inspection.batch.codes import one_code, read_codes, read_picture

FORMATS = {
    "datamatrix": zxingcpp.BarcodeFormat.DataMatrix,
    "code128": zxingcpp.BarcodeFormat.Code128,
    "qr": zxingcpp.BarcodeFormat.QRCode,
}


def draw(text, kind, *, module_px=4, angle_deg=0.0, side=620, at=None, options=""):
    """(side, side) share of white: a code on white paper, turned about its middle."""
    made = zxingcpp.create_barcode(text, FORMATS[kind], options=options)
    label = np.array(made.to_image(scale=1)).astype(np.float32) / 255.0
    rows, cols = label.shape
    middle = at or (side / 2, side / 2)
    turn = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle_deg, module_px)
    turn[:, 2] += middle[0] - (cols - 1) / 2, middle[1] - (rows - 1) / 2
    return cv2.warpAffine(label, turn, (side, side), flags=cv2.INTER_NEAREST, borderValue=1.0)


def as_counts(share, *, contrast, rng, noise=10.0):
    blurred = cv2.GaussianBlur(share, (0, 0), 0.7)
    counts = 600.0 + 2400.0 * contrast * blurred + noise * rng.standard_normal(share.shape)
    return np.clip(counts, 0, 4095).astype(np.uint16)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(
    ("module_px", "contrast"), [pytest.param(4, 1.0, marks=pytest.mark.soak), (4, 0.12), (2.5, 0.5)]
)
def test_turned_pale_and_small_codes_are_read(kind, module_px, contrast, rng):
    for angle_deg in (0, 301):
        share = draw("A17-0042", kind, module_px=module_px, angle_deg=angle_deg)
        found = read_codes(as_counts(share, contrast=contrast, rng=rng))
        assert [(code.kind, code.scan.serial) for code in found] == [(kind, "A17-0042")], angle_deg


@pytest.mark.parametrize("kind", FORMATS)
def test_gs1_gives_lot_and_serial_number(kind, rng):
    share = draw("(10)LOT7(21)A17", kind, options="gs1", module_px=2.5)
    (code,) = read_codes(as_counts(share, contrast=0.6, rng=rng))
    assert (code.scan.lot, code.scan.serial, code.scan.gs1) == ("LOT7", "A17", True)


@pytest.mark.parametrize(("module_px", "angle_deg"), [(4, 0), (4, 45), (3, 0)])
def test_corners_lie_where_the_code_is(module_px, angle_deg, rng):
    share = draw("A17", "code128", module_px=module_px, angle_deg=angle_deg, at=(300, 200))
    (code,) = read_codes(as_counts(share, contrast=0.8, rng=rng))
    assert np.mean(code.corners, axis=0) == pytest.approx((300, 200), abs=12)


def test_several_codes_are_told_apart_or_said(rng):
    share = np.minimum(
        draw("A17", "datamatrix", at=(120, 120)), draw("B-99", "qr", module_px=3, at=(310, 310))
    )
    counts = as_counts(share, contrast=0.8, rng=rng)
    found = read_codes(counts)
    assert [code.scan.text for code in found] == ["A17", "B-99"]
    with pytest.raises(
        MeasurementError, match=r"2 codes are in x\.png: 'A17' \(Data Matrix\), 'B-99' \(QR code\)"
    ):
        one_code(found, "any", "x.png")
    with pytest.raises(MeasurementError, match="pick one with --code-kind"):
        one_code(found, "any", "x.png")
    assert one_code(read_codes(counts, "qr"), "qr", "x.png").scan.text == "B-99"


def test_two_of_a_kind_cannot_be_picked(rng):
    share = np.minimum(draw("A17", "qr", at=(120, 120)), draw("A18", "qr", at=(310, 310)))
    found = read_codes(as_counts(share, contrast=0.8, rng=rng))
    with pytest.raises(MeasurementError, match="cover those that are not meant"):
        one_code(found, "qr", "x.png")


def test_no_code_in_noise(rng):
    assert read_codes(rng.integers(0, 4096, (200, 300)).astype(np.uint16)) == ()
    assert read_codes(np.zeros((64, 64), np.uint16)) == ()
    with pytest.raises(MeasurementError, match="no QR code can be read in the picture"):
        one_code((), "qr", "the picture")


def test_pictures_of_other_programs(tmp_path, rng):
    counts = as_counts(draw("A17", "datamatrix"), contrast=0.8, rng=rng)
    for name, image in (("16.png", counts), ("16.tif", counts), ("8.jpg", (counts // 16).astype(np.uint8))):
        cv2.imwrite(str(tmp_path / name), image)
        assert [code.scan.text for code in read_codes(read_picture(tmp_path / name))] == ["A17"], name
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "empty.png").touch()
    for name, said in (
        ("text.png", "is no picture"),
        ("empty.png", "is no picture"),
        ("none.png", "No such file"),
    ):
        with pytest.raises(RecordError, match=said):
            read_picture(tmp_path / name)
