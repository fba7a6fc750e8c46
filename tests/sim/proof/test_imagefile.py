import io
import struct

import numpy as np
import PIL.Image
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.proof.imagefile import dots_png, film_png, photo_uri, read_image, to_dots
from anisoscope.sim.proof.separation import decode_srgb


def saved(path, array, **options):
    PIL.Image.fromarray(array).save(path, **options)
    return path


def test_pictures_come_as_srgb(tmp_path, rng):
    colour = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    found = read_image(saved(tmp_path / "a.png", colour))
    np.testing.assert_array_equal(found.srgb, colour)
    assert found.notes == ()
    grey = read_image(saved(tmp_path / "g.png", colour[..., 0]))
    np.testing.assert_array_equal(grey.srgb, np.repeat(colour[..., :1], 3, axis=2))


def test_deep_grey_and_transparent_pictures(tmp_path):
    ramp = np.linspace(0, 65535, 256).astype(np.uint16).reshape(16, 16)
    found = read_image(saved(tmp_path / "deep.png", ramp))
    np.testing.assert_array_equal(found.srgb[..., 0].ravel(), np.arange(256))
    assert "8 bits" in found.notes[0]
    dark = read_image(saved(tmp_path / "dark.png", (ramp // 257).astype(np.uint16)))
    assert dark.srgb.max() == 1  # 255 of 65535
    clear = np.full((4, 4, 4), 255, dtype=np.uint8)
    clear[:, 2:, 3] = 0
    found = read_image(saved(tmp_path / "clear.png", clear))
    assert found.srgb[0, :, 0].tolist() == [255, 255, 0, 0]
    assert "no ink" in found.notes[0]


def linear_profile():
    """An ICC profile (version 2, ICC.1:2001-04) with the primaries of sRGB, adapted to D50, and no gamma."""

    def number(value):
        return struct.pack(">i", round(value * 65536))

    columns = {
        b"wtpt": (0.9642, 1.0, 0.8249),
        b"rXYZ": (0.43607, 0.22249, 0.01392),
        b"gXYZ": (0.38515, 0.71687, 0.09708),
        b"bXYZ": (0.14307, 0.06061, 0.71410),
    }
    tags = {name: b"XYZ " + bytes(4) + b"".join(map(number, xyz)) for name, xyz in columns.items()}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), b"curv" + bytes(8))
    tags[b"desc"] = b"desc" + bytes(4) + struct.pack(">I", 7) + b"linear\0" + bytes(8 + 3 + 67)
    tags[b"cprt"] = b"text" + bytes(4) + b"none\0"
    place, table, body = 128 + 4 + 12 * len(tags), b"", b""
    for name, content in tags.items():
        table += name + struct.pack(">II", place + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    d50 = b"".join(map(number, (0.9642, 1.0, 0.8249)))
    head = struct.pack(">I", place + len(body)) + bytes(4) + b"\x02\x10\0\0mntrRGB XYZ " + bytes(12) + b"acsp"
    head += bytes(28) + d50
    return head + bytes(128 - len(head)) + struct.pack(">I", len(tags)) + table + body


def test_an_embedded_profile_is_applied(tmp_path):
    """Codes that are linear in light come as the sRGB codes of the same light (0.5 is 187.5)."""
    codes = np.array([[[0, 0, 0], [128, 128, 128], [51, 51, 51], [255, 255, 255]]], dtype=np.uint8)
    found = read_image(saved(tmp_path / "linear.png", codes, icc_profile=linear_profile()))
    expected = np.array([0, 188, 124, 255])
    assert np.abs(found.srgb[0].astype(int) - expected[:, None]).max() <= 1
    assert found.notes == ("converted from its colour profile (linear) to sRGB",)


def test_the_profile_of_a_deep_picture_is_not_lost(tmp_path):
    ramp = np.linspace(0, 65535, 16).astype(np.uint16).reshape(4, 4)
    with pytest.raises(
        UsageError, match="colour profile cannot be used"
    ):  # one of three colours fits no grey
        read_image(saved(tmp_path / "deep.png", ramp, icc_profile=linear_profile()))


def test_too_many_pixels_are_told_as_such(tmp_path, monkeypatch):
    path = saved(tmp_path / "a.png", np.zeros((30, 50), dtype=np.uint8))
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", 1000)  # from here to twice as many Pillow only warns
    assert read_image(path).srgb.shape == (30, 50, 3)
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", 700)
    with pytest.raises(UsageError, match="too many pixels"):
        read_image(path)


def test_pictures_that_cannot_be_read(tmp_path):
    saved(tmp_path / "float.tif", np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4))
    (tmp_path / "text.png").write_text("no picture")
    PIL.Image.new("CMYK", (2, 2)).save(tmp_path / "cmyk.tif")
    PIL.Image.new("RGB", (2, 2)).save(tmp_path / "odd.png", icc_profile=b"nonsense")
    for name, message in (
        ("none.png", "no such file"),
        ("text.png", "not a picture"),
        ("cmyk.tif", "CMYK"),
        ("odd.png", "colour profile cannot be used"),
        ("float.tif", "floating-point"),
    ):
        with pytest.raises(UsageError, match=message):
            read_image(tmp_path / name)


def test_resampling_keeps_light(tmp_path, rng):
    image = read_image(saved(tmp_path / "a.png", rng.integers(0, 256, (40, 60, 3), dtype=np.uint8)))
    assert to_dots(image, 60) is image.srgb
    small = to_dots(image, 15)
    assert small.shape == (10, 15, 3)
    linear = decode_srgb()[image.srgb]
    np.testing.assert_allclose(small.mean(axis=(0, 1)), linear.mean(axis=(0, 1)), rtol=1e-5)
    assert to_dots(image, 90).shape == (60, 90, 3)
    with pytest.raises(UsageError, match="cannot be made"):
        to_dots(image, 0)


@pytest.mark.parametrize("positive", [True, False])
def test_films_hold_one_bit_a_dot_and_their_resolution(rng, positive):
    mask = rng.random((30, 41)) < 0.3
    with PIL.Image.open(io.BytesIO(film_png(mask, 1270.0, positive=positive))) as film:
        assert film.mode == "1"
        assert film.info["dpi"] == pytest.approx((1270.0, 1270.0), abs=0.02)
        np.testing.assert_array_equal(np.array(film), ~mask if positive else mask)


def test_the_sheet_of_all_dots_has_four_colours(rng):
    dots = rng.integers(0, 4, (20, 30), dtype=np.uint8)
    colours = np.array([[0, 0, 0], [250, 10, 10], [10, 240, 20], [20, 30, 230]], dtype=np.uint8)
    with PIL.Image.open(io.BytesIO(dots_png(dots, colours, 600.0))) as sheet:
        assert sheet.info["dpi"] == pytest.approx((600.0, 600.0), abs=0.02)
        np.testing.assert_array_equal(np.array(sheet.convert("RGB")), colours[dots])


def test_photographs_are_made_smaller(tmp_path):
    image = read_image(saved(tmp_path / "a.png", np.zeros((30, 2000, 3), dtype=np.uint8)))
    assert photo_uri(image, 100).startswith("data:image/jpeg;base64,")
    assert len(photo_uri(image, 100)) < len(photo_uri(image, 2000))
