"""Options of all commands, and keys of their JSON, are those of the files beside this test."""

import json
import os
from pathlib import Path

import pytest


def test_every_option_is_known(guard):
    found = guard.lines_of_options()
    if "ANISOSCOPE_WRITE_DOCS" in os.environ:
        guard.OPTIONS.write_text("\n".join(found) + "\n", encoding="utf-8")
    known = guard.OPTIONS.read_text(encoding="utf-8").splitlines()
    gone, new = sorted(set(known) - set(found)), sorted(set(found) - set(known))
    assert not gone, "options that were taken away or changed: say so in CHANGELOG.md"
    assert not new, "new options: ANISOSCOPE_WRITE_DOCS=1 notes them"


def test_a_new_key_is_noticed(guard, tmp_path, monkeypatch):
    eyes = guard.Watch()
    command = next(iter(eyes.known))
    path = next(iter(eyes.known[command]))
    value = 1
    for name in reversed(path.split(".")):
        value = {"some other name" if name == "*" else name: value}
    eyes.printed([*command.split(), "--json"], json.dumps(value))
    eyes.check()
    eyes.printed([*command.split(), "--json"], json.dumps({"no_key_of_today": 1}))
    with pytest.raises(AssertionError, match="no_key_of_today"):
        eyes.check()
    monkeypatch.setenv(guard.WRITE, str(tmp_path))
    eyes.printed([*command.split(), "--json"], json.dumps({"no_key_of_today": 1}))
    eyes.check()
    assert json.loads(next(Path(tmp_path).iterdir()).read_text()) == {command: ["no_key_of_today"]}


def test_names_that_are_data_are_no_keys(guard):
    assert guard.keys({"parts": {"A 1": 1, "B 2": {"u": 2}}, "list": [{"a": 1}, {"b": 2}]}) == {
        *("parts", "parts.*", "parts.*.u"),
        *("list", "list.a", "list.b"),
    }
