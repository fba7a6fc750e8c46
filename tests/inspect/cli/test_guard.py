"""Options of all commands, and keys of their JSON, are those of the files beside this test."""

import os


def test_every_option_is_known(guard):
    found = guard.lines_of_options()
    if "ANISOSCOPE_WRITE_DOCS" in os.environ:
        guard.OPTIONS.write_text("\n".join(found) + "\n", encoding="utf-8")
    known = guard.OPTIONS.read_text(encoding="utf-8").splitlines()
    assert not set(known) - set(found), "options that were taken away or changed: say so in CHANGELOG.md"
    assert not set(found) - set(known), "new options: ANISOSCOPE_WRITE_DOCS=1 notes them"


def test_names_that_are_data_are_no_keys(guard):
    assert guard.keys({"parts": {"A 1": 1, "B 2": {"u": 2}}, "list": [{"a": 1}, {"b": 2}]}) == {
        *("parts", "parts.*", "parts.*.u"),
        *("list", "list.a", "list.b"),
    }
