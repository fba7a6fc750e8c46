"""Help of every command: a sentence, examples that work, few options first; and what usage errors say."""

import shlex
from collections import defaultdict
from pathlib import Path
from typing import get_args

import pytest
from cyclopts import Parameter

from anisoscope.cli import COMMANDS, app, run
from anisoscope.cli.help_page import examples, of_today


def commands(parent=app, words=()):
    """All commands of the program as words -> app, groups included."""
    flags = (*parent.help_flags, *parent.version_flags)
    found = {} if parent is app else {words: parent}
    for name in parent:
        if name not in flags:
            found |= commands(parent[name], (*words, name))
    return found


ALL = commands()


def test_every_command_has_a_sentence():
    lines = {" ".join(words): one.help.strip().split("\n")[0] for words, one in ALL.items()}
    assert {name: line for name, line in lines.items() if not line.endswith(".") or len(line) > 120} == {}
    assert {words[0] for words in ALL} == {name for group in COMMANDS.values() for name in group}


def test_examples_of_every_command_are_understood():
    for words, one in ALL.items():
        shown = examples(one)
        assert 1 <= len(shown) <= 3, words
        if one.default_command is None:
            continue  # a group shows those of its commands
        for line in shown:
            program, *arguments = shlex.split(line)
            assert program == "anisoscope"
            chain, _, _ = app.parse_commands(arguments)
            assert chain[: len(words)] == words, line
            app.parse_args(arguments, exit_on_error=False, print_error=False)


@pytest.mark.parametrize(
    "words",
    [("cache", "info"), ("recipe", "new"), ("profile", "make"), ("rig", "ports"), ("design", "depths")],
)
def test_cheap_examples_run(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    line = examples(ALL[words])[0]
    assert run(shlex.split(line)[1:]) == 0, capsys.readouterr().err


def test_the_page_of_a_command_ends_with_its_examples(capsys):
    assert run(["cache", "--help"]) == 0
    assert capsys.readouterr().out.endswith("Examples:\n  anisoscope cache info\n  anisoscope cache clear\n")


def test_the_first_page_names_every_command_and_the_options_of_all(capsys):
    assert run([]) == 0
    page = capsys.readouterr().out
    for name in [*COMMANDS, *(name for group in COMMANDS.values() for name in group)]:
        assert f" {name} " in page
    assert "--log-file FILE" in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["predict", "--ridge-angle", "10", "--tilts", "-10,0,10"],
            "write --tilts=-10,0,10 (see anisoscope predict --help)",
        ),
        (["inspect", "--rig", "rig.toml"], "--recipe is missing (see anisoscope inspect --help)"),
        (["inspect", "--recip", "r.toml"], "--recipe is missing. Did you mean --recipe instead of --recip?"),
        (["predict", "--ridge-angle", "--json"], "--ridge-angle needs a value, and --json is an option"),
        (["verify"], "FOLDER is missing (see anisoscope verify --help)"),
        (["cache", "info", "all"], "too many arguments: all (see anisoscope cache info --help)"),
        (["rig", "hum"], 'Unknown command of rig: "hum"'),
        (["predict"], "(see anisoscope predict --help)"),
        (["cache", "info", "--log-file"], "--log-file needs the name of a file"),
    ],
)
def test_usage_errors_say_the_remedy_and_where_to_read_on(arguments, words, capsys):
    assert run(arguments) == 64
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1


def test_words_of_the_version_before_are_understood():
    assert of_today(["experiment", "ridges", "--json"])[0] == ["research", "experiment", "--json"]
    assert of_today(["study", "detection"])[0] == ["research", "detection"]
    assert of_today(["code", "picture.png"]) == (["read-code", "picture.png"], ["`code` is `read-code` now"])
    assert of_today(["inspect", "code"]) == (["inspect", "code"], [])
    assert of_today(["rig", "live", "--frames=3", "--rig", "r"])[0] == [
        "rig",
        "live",
        "--count=3",
        "--rig",
        "r",
    ]


def test_a_log_file_gets_command_error_and_end(tmp_path, capsys):
    file = tmp_path / "run.log"
    assert run(["cache", "info", "all", "--log-file", str(file)]) == 64
    lines = file.read_text().splitlines()
    assert lines[0].endswith(f"anisoscope cache info all --log-file {file}")
    assert "too many arguments: all" in lines[1]
    assert "ended after" in lines[2]
    assert run(["cache", "info", f"--log-file={tmp_path / 'no' / 'run.log'}"]) == 64
    assert "cannot be written" in capsys.readouterr().err


def sort_of(hint):
    """Flag, file, or another value."""
    inner = [
        sort_of(one)
        for one in get_args(hint)
        if one is not type(None) and not isinstance(one, str | Parameter)
    ]
    return {bool: "flag", Path: "file"}.get(hint) or next((one for one in inner if one != "value"), "value")


def test_an_option_is_a_flag_in_all_commands_or_in_none_and_so_is_a_file():
    found = defaultdict(set)
    for one in ALL.values():
        for argument in one.assemble_argument_collection() if one.default_command else ():
            for name in argument.names:
                found[name].add(sort_of(argument.hint))
    # --recipe of the commands that filter inspections names one as the history shows it
    assert {name for name, sorts in found.items() if name.startswith("-") and len(sorts) > 1} <= {"--recipe"}


def test_pages_begin_with_at_most_twelve_options():
    for words, one in ALL.items():
        if one.default_command is None:
            continue
        first = [
            argument.name
            for argument in one.assemble_argument_collection()
            if argument.show
            and argument.index is None
            and argument.names != ("*",)
            and any(getattr(group, "name", group) == "Parameters" for group in argument.parameter.group or ())
        ]
        assert len(first) <= 12, (words, first)
