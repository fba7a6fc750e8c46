"""TOML into models, strictly, with mistakes in one line."""

from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict

from anisoscope.base.errors import ConfigError, RecipeError, RigFileError
from anisoscope.base.toml_file import NameOrFile, read_toml_model
from anisoscope.base.toml_table import MOST_BYTES, read_toml


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")

    height_um: float = 1.0
    flag: bool = False


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")

    text: str = ""
    path: Path | None = None
    known: NameOrFile = "d65"
    count: int = 0
    pair: tuple[float, float] = (0.0, 0.0)
    inner: Inner = Inner()
    parts: dict[str, Inner] = {}


def read(tmp_path, text, **options):
    path = tmp_path / "file.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_toml_model(path, Outer, **options)


def test_a_good_file(tmp_path):
    text = '\ufefftext = "ä"\npath = "x/y"\ncount = 3\npair = [1, 2.5]\n'
    text += "[inner]\nheight_um = 2\n[parts.a]\nflag = true"
    outer = read(tmp_path, text)
    assert (outer.text, outer.path, outer.pair) == ("ä", Path("x/y"), (1.0, 2.5))
    assert outer.inner.height_um == 2.0
    assert outer.parts["a"].flag


def test_substitutions_are_encoded_in_urls_only(tmp_path):
    options = {"substitutions": {"here": "/a&b"}}
    assert read(tmp_path, 'text = "${here}/c"', **options).text == "/a&b/c"
    assert read(tmp_path, 'text = "sim://x?bench=${here}/c"', **options).text == "sim://x?bench=/a%26b/c"


def test_a_name_is_a_name_and_a_file_lies_beside(tmp_path):
    assert read(tmp_path, "").known == "d65"
    assert read(tmp_path, 'known = "led-b3"').known == "led-b3"
    assert read(tmp_path, 'known = "lamps/mine.CSV"').known == str(tmp_path / "lamps" / "mine.CSV")
    assert read(tmp_path, 'known = "/else/ink.toml"').known == "/else/ink.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("count = 1.5", "count: input should be a valid integer"),
        ("count = true", "count: input should be a valid integer"),
        ("count = '1'", "count: input should be a valid integer"),
        ("pair = [1]", "pair[1]: missing"),
        ("[inner]\nheight_nm = 2.0", "inner.height_nm: unknown key; did you mean 'height_um'?"),
        ("[parts.a]\nheigth_um = 2.0", "parts.a.heigth_um: unknown key"),
        ("inner = 3", "inner: input should be an object, not 3"),
        ("zzz = 3", "zzz: unknown key; known here: count, inner, known, pair, parts, path, text"),
        ("a = ", "not valid TOML"),
        (b"\xff\xfe", "not a text file in UTF-8"),
    ],
)
def test_mistakes(tmp_path, text, message):
    with pytest.raises(RigFileError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_caller_chooses_the_error(tmp_path):
    with pytest.raises(RecipeError, match="no such file"):
        read_toml_model(tmp_path / "none.toml", Outer, error=RecipeError)
    with pytest.raises(RecipeError, match="cannot be read"):
        read_toml_model(tmp_path, Outer, error=RecipeError)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 100_000, "nested more than 32 deep"),
        ("a = " + "[" * 33 + "]" * 33, "nested more than 32 deep"),
        ("[" + ".".join("a" * 40) + "]", "nested more than 32 deep"),
        ("a = " + "{a = " * 5000 + "1" + "}" * 5000, "nested more than 32 deep"),
        ("# " + "x" * MOST_BYTES, "more than 4 MiB"),
    ],
    ids=["open", "lists", "tables", "inline tables", "size"],
)
def test_a_file_that_would_exhaust_the_program_is_one_line(tmp_path, text, message):
    with pytest.raises(RecipeError, match=rf"file\.toml: .*{message}"):
        read(tmp_path, text, error=RecipeError)


def test_depth_within_the_limit_is_read(tmp_path):
    (tmp_path / "file.toml").write_text("a = " + "[" * 31 + "]" * 31)
    assert list(read_toml(tmp_path / "file.toml")) == ["a"]


def test_a_number_with_thousands_of_digits_is_one_line(tmp_path):
    (tmp_path / "recipe.toml").write_text("a = " + 5000 * "9" + "\n")
    with pytest.raises(ConfigError, match=r"recipe\.toml: not valid TOML: a number has too many digits"):
        read_toml(tmp_path / "recipe.toml")
