"""`anisoscope key`, and the key that `init` makes."""

import json
import tomllib

import pytest

from anisoscope import cli
from anisoscope.base import signature
from anisoscope.operations import project_place


@pytest.fixture(autouse=True)
def settings(tmp_path, monkeypatch):
    """Settings of a user of their own, and no key in use before."""
    monkeypatch.setattr(project_place, "user_path", lambda: tmp_path / "settings" / "config.toml")
    monkeypatch.setattr(signature, "_chosen", None)
    monkeypatch.delenv(signature.VARIABLE, raising=False)


@pytest.fixture
def said(capsys):
    def run(*arguments):
        code = cli.run(list(map(str, arguments)))
        found = capsys.readouterr()
        return code, found.out, found.err

    return run


def test_init_makes_one_key_for_a_station_and_names_it(said, tmp_path, monkeypatch):
    for name in ("a", "b"):
        assert said("init", tmp_path / name, "--station", "rig 1")[0] == 0
    (path,) = (tmp_path / "settings" / "keys").iterdir()
    assert path.stat().st_mode & 0o777 == 0o600
    monkeypatch.chdir(tmp_path / "b")
    assert tomllib.loads((tmp_path / "b" / "anisoscope.toml").read_text())["signing_key"] == str(path)
    code, out, _ = said("key", "show", "--json")
    assert (code, json.loads(out)) == (0, json.loads(said("key", "show", path, "--json")[1]))


def test_rotation_and_revocation(said, tmp_path, monkeypatch):
    file, first, second = tmp_path / "keys.toml", tmp_path / "1.pem", tmp_path / "2.pem"
    ids = []
    for path in (first, second):
        assert said("key", "new", path)[0] == 0
        public = json.loads(said("key", "show", path, "--json")[1])
        ids.append(public["key"])
        code, out, _ = said("key", "trust", file, "--station", "rig 1", "--public", public["public"])
        assert code == 0
    assert "its earlier key counts until" in out
    earlier, present = signature.read_trust(file).keys
    assert earlier.until is not None
    assert (present.since, present.until) == (None, None)  # what it signed before it was trusted counts
    assert said("key", "revoke", file, ids[0], "--reason", "laptop stolen")[0] == 0
    assert said("key", "retire", file, ids[1])[0] == 0
    earlier, present = signature.read_trust(file).keys
    assert (earlier.revoked, present.until is not None) == ("laptop stolen", True)
    old = signature.read_signed("record", signature.signed("record", {}, signature.KeyFile(first)))
    assert "is revoked" in signature.read_trust(file).distrust(old)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("key", "show"), 64, "no key signs here"),
        (("key", "show", "none.pem"), 78, "anisoscope key new"),
        (("key", "trust", "keys.toml", "--station", "a", "--public", "abc"), 64, "44 letters"),
        (("key", "revoke", "keys.toml", "ed25519:1", "--reason", "x"), 78, "no such file"),
        (("history", "sign"), 64, "no key signs here"),
        (("history", "stamp"), 64, "name one of --url"),
        (("verify", ".", "--trust", "none.toml"), 78, "no such file"),
    ],
)
def test_what_cannot_be_is_one_line(said, tmp_path, monkeypatch, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    found, _, err = said(*arguments)
    assert (found, err.count("\n")) == (code, 1)
    assert says in err
