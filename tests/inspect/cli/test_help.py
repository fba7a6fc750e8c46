"""Help of every command: a sentence, examples that work, few options first; and what usage errors say."""

import re
import shlex
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import get_args

import pytest
from cyclopts import Parameter

from anisoscope.cli import COMMANDS, EVERYDAY, app, run
from anisoscope.cli.help_page import FIRST_EXAMPLES, FIRST_OPTIONS, examples
from anisoscope.cli.mistakes import FORMER_OPTIONS, of_today


def commands(parent=app, words=()):
    """All commands of the program as words -> app, groups included."""
    flags = (*parent.help_flags, *parent.version_flags)
    found = {} if parent is app else {words: parent}
    for name in parent:
        if name not in flags:
            found |= commands(parent[name], (*words, name))
    return found


ALL = commands()
ROOT = Path(__file__).resolve().parents[3]


def test_every_command_has_a_sentence():
    lines = {" ".join(words): one.help.strip().split("\n")[0] for words, one in ALL.items()}
    assert {name: line for name, line in lines.items() if not line.endswith(".") or len(line) > 120} == {}


def test_the_page_of_a_group_has_the_sentences_of_commands_that_nothing_imported_before():
    page = subprocess.run(
        [sys.executable, "-m", "anisoscope", "ink", "--help"], capture_output=True, text=True, check=True
    ).stdout
    names = [name for name in app["ink"] if not name.startswith("-")]
    assert [name for name in names if not re.search(rf"{name} +[A-Z]", page)] == []


def test_commands_that_the_sources_name_exist():
    groups, named = {words[0] for words in ALL if len(words) > 1}, defaultdict(set)
    for path in (
        one for name in ("inspect", "rig", "profiles", "sim") for one in (ROOT / name).rglob("*.py")
    ):
        text = path.read_text(encoding="utf-8")
        for first, second in re.findall(
            r"`(?:python -m )?anisoscope ([a-z][a-z-]*)(?: ([a-z][a-z-]*))?", text
        ):
            words = (first, second) if second and first in groups else (first,)
            named[words].add(path.name)
    assert len(named) > 50
    assert {words: files for words, files in named.items() if words not in ALL} == {}


def test_the_first_page_has_the_sentences_and_examples_of_the_commands():
    shown = {name: sentence for group in COMMANDS.values() for name, (_, sentence) in group.items()}
    assert shown == {name: app[name].help.strip().split("\n")[0].replace("`", "") for name in shown}
    assert {words[0] for words in ALL} == set(shown)
    assert list(FIRST_EXAMPLES) == examples(app)


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


def test_the_first_page_shows_twenty_commands_in_the_order_of_work_and_names_all(capsys):
    assert run([]) == 0
    page, _, more = capsys.readouterr().out.partition("More commands")
    everyday = [name for names in EVERYDAY.values() for name in names]
    assert len(everyday) == 20
    assert re.findall(r"^│ ([a-z][a-z-]*)  ", page, re.MULTILINE) == everyday
    rest = {name for group in COMMANDS.values() for name in group} - set(everyday)
    assert set(re.findall(r"(?:  |· )([a-z-]+)(?= ·|\n|$)", more.partition("\n\n")[0])) == rest
    assert "--log-file FILE" in more
    assert run(["--help-all"]) == 0
    page = capsys.readouterr().out
    for name in [*COMMANDS, *(name for group in COMMANDS.values() for name in group)]:
        assert f" {name} " in page


def test_the_page_of_a_command_shows_ten_options_and_names_the_panels_of_the_others(capsys):
    for words, one in ALL.items():
        assert run([*words, "--help"]) == 0
        page = capsys.readouterr().out
        _, bar, options = page.partition("─ Parameters ─")
        shown = len(re.findall(r"^│ (?:\*  )?--", options or page, re.MULTILINE)) if bar else 0
        assert shown <= FIRST_OPTIONS, words
        known = {a.names for a in one.assemble_argument_collection() if a.show} if one.default_command else ()
        if len(known) > 24:
            assert f"anisoscope {' '.join(words)} --help-all" in page
    assert run(["predict", "--help"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert re.match(
        r"\d\d more options \(Ridges, Plastic, .*Angular map\): anisoscope predict --help-all$", line
    )
    assert run(["help", "predict", "--help-all"]) == 0
    page = capsys.readouterr().out
    assert "more options" not in page
    assert "--tail" in page


def test_help_is_a_word_too(capsys):
    pages = []
    for arguments in (["help", "rig", "sim"], ["rig", "sim", "--help"]):
        assert run(arguments) == 0
        pages.append(capsys.readouterr().out)
    assert pages[0] == pages[1]
    assert run(["help"]) == 0
    assert "Usage: anisoscope COMMAND" in capsys.readouterr().out


GROUPS_OF_A_VERB = {"calibrate", "design", "fit", "render", "research"}
VERBS = """
    add align-lines certify check clear commission compare compare-lobe convert crop dispose edit export fill
    filter fit focus hold home import jog level list lock make mask move new pull push refine relight remove
    resample retain retire revoke rotate scan show sign snap spoil stamp stitch stop subtract suggest teach
    trust unlock verify view
"""
NOUNS = """
    antimirror attribute best-angle bias brdf certificate checkerboard code comparison convergence covariates
    dark depths experiment findings fixture flat form frame gauge halftone height hologram info ink light
    linearity lines live lobe markers material mixture modbus mqtt opcua outliers papers pattern picture plate
    pod ports process proof report resolution response ridges rotation scars sim stability status step stray
    textures texture type1 yield
"""
ACTS_ON_A_VERB = {"check", "list", "refine", "relight", "compare-lobe", "mask"}  # `design mask` is the noun


def test_commands_are_named_by_one_rule():
    """After a noun comes a verb, or the noun of what is measured or shown; after a verb comes a noun."""
    verbs, nouns = set(VERBS.split()), set(NOUNS.split())
    pairs = {words for words in ALL if len(words) == 2}
    assert {second for _, second in pairs} == verbs | nouns
    assert not verbs & nouns
    assert not {(a, b) for a, b in pairs if a in GROUPS_OF_A_VERB and b in verbs - ACTS_ON_A_VERB}


def test_no_two_commands_do_the_same():
    sentences = [one.help.strip().split("\n")[0] for one in ALL.values()]
    assert len(sentences) == len(set(sentences))
    assert not {words for words in ALL if len(words) == 2 and words[::-1] in ALL}


def test_words_of_the_version_before_are_understood():
    assert of_today(["experiment", "ridges", "--json"])[0] == ["research", "experiment", "--json"]
    assert of_today(["study", "pod"])[0] == ["research", "pod"]
    assert of_today(["code", "picture.png"]) == (["read-code", "picture.png"], ["`code` is `read-code` now"])
    assert of_today(["inspect", "code"]) == (["inspect", "code"], [])
    assert of_today(["rig", "live", "--frames=3", "--rig", "r"])[0] == [
        "rig",
        "live",
        "--count=3",
        "--rig",
        "r",
    ]
    ink = ["ink", "proof", "a.png", "--size", "64", "--gain=2"]
    assert of_today(ink)[0] == ["ink", "proof", "a.png", "--picture-size", "64", "--image-gain=2"]


def test_former_options_are_gone_and_those_of_today_exist():
    for words, options in FORMER_OPTIONS.items():
        names = {name for one in ALL[words].assemble_argument_collection() for name in one.names}
        assert set(options.values()) <= names, words
        assert not names & set(options), words


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


SAME_QUANTITY = {
    "--align": "register",
    "--alpha": "roughness",
    "--alpha-across": "roughness across",
    "--alpha-along": "roughness along",
    "--angles": "stage angles",
    "--band": "wavelengths",
    "--bounces": "reflections",
    "--count": "frames",
    "--csv": "csv file",  # readings to study
    "--depths": "depth of every",
    "--direction": "direction of the profiles",
    "--dot": "side of a dot",
    "--dots": "dots a",  # along or across
    "--dpi": "dots.* per inch",
    "--dry-run": "only print",
    "--format": "format of the new files",
    "--html": "page",
    "--jobs": "processes",
    "--kind": "kind",
    "--lamp-half-angle": "half of the angle .*lamp",
    "--layer": "layer of the map",
    "--level": "height map is levelled",
    "--levels": "levels",
    "--light-angle": "angle (of the light|between light)",
    "--model": "model",  # of the reflected light
    "--open": "encryption",  # of orders from other computers
    "--out": "file|folder|page|record|write|png",  # the command's own product
    "--picture-size": "side of the picture",
    "--pixel": "pixel size",
    "--plot": "picture",
    "--png": "picture|spheres",
    "--port": "port",
    "--pty": "pseudo terminals",
    "--read-code": "code on every part",
    "--reach": r"largest \|h_x\| and \|h_y\|",
    "--recipe": "recipe",
    "--reuse": "judging frames",
    "--rig": "rig file",
    "--role": "map of the part",
    "--scatter": "standard deviations",
    "--step": "step of the",  # angle, in degrees
    "--steps": "number of",
    "--teach": "reference|markers",
    "--tilts": "tilts",
    "--tone": "greys of the",
    "--trust": "must not refuse|keys has to have signed",  # a file in spite of a check; the keys that count
    "--u-alpha": "roughness",
    "--u-height-noise": "noise of a height",
    "--u-height-scale": "scale of the heights",
    "--u-pixel-size": "pixel size",
    "--u-ridge-angle": "of the ridge angle",
    "--width": "width of (a|the) step",
    "--yes": "without asking",
}
"""Option of several commands -> the quantity that all its help texts name, where it is not the option's own name."""


def test_an_option_names_one_quantity_in_all_commands():
    found = defaultdict(lambda: defaultdict(set))
    for words, one in ALL.items():
        for argument in one.assemble_argument_collection(parse_docstring=True) if one.default_command else ():
            for name in argument.names:
                if name.startswith("--"):
                    found[name][sort_of(argument.hint), argument.parameter.help or ""].add(" ".join(words))
    several = {name: texts for name, texts in found.items() if len(texts) > 1}
    wrong = [
        (name, text, sorted(where))
        for name, texts in several.items()
        for (_, text), where in texts.items()
        if not re.search(SAME_QUANTITY.get(name, name.strip("-").replace("-", ".")), text, re.IGNORECASE)
    ]
    assert not wrong, "\n".join(map(str, wrong))
    assert set(SAME_QUANTITY) <= set(several)  # no entry outlives its option
    # --recipe of the commands that filter inspections names one as the history shows it, --trust of `profile` is a word
    assert {name for name, texts in several.items() if len({sort for sort, _ in texts}) > 1} <= {
        "--recipe",
        "--trust",
    }


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
