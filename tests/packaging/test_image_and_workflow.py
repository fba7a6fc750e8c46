"""Dockerfile and workflow, which run elsewhere: their files, users, extras, commands and packages exist."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from anisoscope.cli import app

ROOT = Path(__file__).resolve().parents[2]
IMAGE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
WORKFLOW = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
CI = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
GROUPS_OF_DEBIAN = {
    *("adm", "audio", "backup", "bin", "cdrom", "daemon", "dialout", "dip", "disk", "fax", "floppy", "games"),
    *("kmem", "list", "lp", "mail", "man", "news", "nogroup", "operator", "plugdev", "proxy", "root", "sasl"),
    *("shadow", "src", "staff", "sudo", "sys", "tape", "tty", "users", "utmp", "uucp", "video", "voice"),
    "www-data",
}
"""Groups of every Debian 12 (base-passwd): useradd makes no user of such a name."""


def copied():
    """Files and folders that the image takes from here."""
    return {name for line in re.findall(r"^COPY (.*)$", IMAGE, re.MULTILINE) for name in line.split()[:-1]}


def test_the_image_is_made_of_all_packages_and_of_nothing_else():
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    let_through = {line[1:] for line in ignored if line.startswith("!")}
    assert "*" in ignored
    assert copied() == let_through
    assert set(PROJECT["tool"]["setuptools"]["package-dir"].values()) <= copied()
    assert all((ROOT / name).exists() for name in copied())


def test_the_user_of_the_image_can_be_made_and_opens_devices():
    made = re.search(r"useradd .*--groups (\S+) (\S+)", IMAGE)
    assert made[2] not in GROUPS_OF_DEBIAN
    assert set(made[1].split(",")) == {"dialout", "video", "plugdev"} <= GROUPS_OF_DEBIAN
    assert f"USER {made[2]}\n" in IMAGE


@pytest.mark.parametrize("text", [IMAGE, WORKFLOW], ids=["image", "workflow"])
def test_extras_exist(text):
    named = re.findall(r"EXTRAS=([\w,]+)|\.\[([\w,$]+)\]", text)
    assert named
    assert {one for pair in named for one in "".join(pair).split(",") if one != "$EXTRAS"} <= EXTRAS.keys()


def test_commands_of_the_image_can_be_parsed():
    found = re.findall(r"^#   run .*?anisoscope (.*)$", IMAGE, re.MULTILINE)
    assert {line.split()[0] for line in found} == {"demo", "inspect", "serve", "line"}
    for line in found:
        app.parse_args(shlex.split(line), exit_on_error=False, print_error=False)


def test_versions_of_extras_are_those_that_are_tested():
    pattern = (
        re.search(r"sed -n 's/(.*)/\\1/p' requirements-dev", IMAGE)[1].replace(r"\(", "(").replace(r"\)", ")")
    )
    lock = (ROOT / "requirements-dev.lock").read_text(encoding="utf-8")
    tested = {found[1].partition("==")[0] for found in re.finditer(pattern, lock, re.MULTILINE)}
    assert {"fastapi", "asyncua", "authlib"} <= tested
    assert len(tested) == sum("==" in line for line in lock.splitlines())


def test_the_image_has_the_libraries_that_continuous_integration_installs():
    libraries = set(re.findall(r"\blib[\w.-]+:(lib[\w-]+)", CI))
    assert len(libraries) == 3
    assert libraries <= set(IMAGE.split())


def test_tests_of_the_workflow_exist():
    found = set(re.findall(r"tests/[\w/]+(?:\.py)?", WORKFLOW))
    assert len(found) == 9
    assert [name for name in found if not (ROOT / name).exists()] == []
