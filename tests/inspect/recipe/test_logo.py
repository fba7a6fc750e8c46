"""The logo that a recipe names for its reports: what is embedded, what is refused, and what a folder keeps."""

import base64
import struct
import zlib

import pytest

from anisoscope.base.errors import RecipeError
from anisoscope.inspection.job import sources_of
from anisoscope.kinds.registry import kind_of
from anisoscope.recipe.logo import LARGEST_KB, LOGO, logo_uri, with_logo
from anisoscope.rig.rigfile import read_rig

SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="40" height="20"><rect width="40" height="20"/></svg>'


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


PNG = (
    b"\x89PNG\r\n\x1a\n"
    + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 1, 8, 0, 0, 0, 0))
    + chunk(b"IDAT", zlib.compress(b"\0\x10\xf0"))
    + chunk(b"IEND", b"")
)


@pytest.fixture
def written(tmp_path):
    """A recipe of a print that names a logo of this content."""

    def write(content, name="logo.svg"):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "recipe.toml"
        path.write_text(
            'schema = 1\nproduct = "card"\n[print]\nink = "synthetic-red"\n'
            f'[report]\nlogo = "{name}"\n[acquisition]\nexposure_s = 0.01\n[region]\nsize_mm = [2.0, 2.0]\n'
        )
        return path, kind_of(path).read_recipe(path)

    return write


@pytest.mark.parametrize(("content", "kind"), [(SVG, "svg+xml"), (PNG, "png")])
def test_a_picture_is_embedded_whole(written, content, kind):
    head, _, data = logo_uri(written(content)[1]).partition(",")
    assert (head, base64.b64decode(data)) == (f"data:image/{kind};base64", content)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "cannot be read: No such file"),
        (b"", "is neither a PNG nor an SVG picture"),
        (b"\x89PNG\r\n\x1a\n" + b"damaged", "is neither a PNG nor an SVG picture"),
        (b"<html></html>", "is neither a PNG nor an SVG picture"),
        (SVG + b" " * 1000 * LARGEST_KB, "at most 200 kB"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_the_first_picture(written, tmp_path, content, says):
    path, _ = written(content)
    with pytest.raises(RecipeError, match=rf"recipe\.toml: report\.logo: .*logo\.svg.*{says}"):
        kind_of(path).check_recipe(path, None, 10.0)


def test_it_is_one_of_the_files_of_an_inspection(written, tmp_path):
    path, recipe = written(SVG)
    rig_path = tmp_path / "rig.toml"
    rig_path.write_text(
        'schema = 1\nname = "rig"\n[stage]\ndriver = "manual"\n[camera]\ndriver = "folder"\npixel_um = 5.0\n'
        'sensitivities = "synthetic"\n[light]\ndriver = "manual"\nangle_deg = 10.0\nspectrum = "led-white"\n'
    )
    kind, rig = kind_of(path), read_rig(rig_path)
    files = {one.role: one.path for one in sources_of(path, rig_path, kind, recipe, rig)}
    assert files[LOGO] == tmp_path / "logo.svg"
    (tmp_path / "inputs").mkdir()
    copy = tmp_path / "inputs" / "logo.svg"
    files[LOGO].rename(copy)
    assert logo_uri(with_logo(recipe, copy)).startswith("data:image/svg+xml")


def test_recipes_without_a_logo_have_none(written, tmp_path):
    _, recipe = written(SVG)
    bare = recipe.model_copy(update={"report": recipe.report.model_copy(update={"logo": None})})
    assert logo_uri(bare) is None
    assert with_logo(bare, None) is bare
