"""Nothing but the server on a pseudo terminal needs POSIX: Windows and macOS can import and run everything else."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
POSIX_ONLY = {
    "fcntl",
    "termios",
    "pty",
    "tty",
    "pwd",
    "grp",
    "resource",
    "posix",
    "syslog",
    "crypt",
    "readline",
}
# Attributes that exist on POSIX only; `os` and `signal` themselves are everywhere.
MISSING_ON_WINDOWS = {
    "os": {
        "fork",
        "forkpty",
        "openpty",
        "mkfifo",
        "killpg",
        "setsid",
        "geteuid",
        "getuid",
        "getgid",
        "ttyname",
        "uname",
    },
    "signal": {
        "SIGKILL",
        "SIGHUP",
        "SIGUSR1",
        "SIGUSR2",
        "SIGALRM",
        "alarm",
        "setitimer",
        "pthread_kill",
        "pause",
    },
    "socket": {"AF_UNIX"},  # socketpair exists on Windows since Python 3.5
}
# Where it is allowed, and what guards it.
GUARDED = {
    ("sim/bench/serve.py", "pty"): "imported when a pseudo terminal is asked for; its absence is a RigError",
    ("sim/bench/serve.py", "tty"): "likewise",
    ("sim/bench/serve.py", "os.ttyname"): "likewise",
    ("inspect/base/user_name.py", "os.getuid"): "where it is missing, a user without a name is called user",
    ("inspect/base/lock.py", "fcntl"): "where it is missing, Windows' msvcrt locks",
    (
        "inspect/cli/rig/live.py",
        "termios",
    ): "keys of a terminal; where it is missing, those of the page remain",
    ("inspect/cli/rig/live.py", "tty"): "likewise",
    ("rig/jogging.py", "fcntl"): "asks a Linux input device for its range",
    ("inspect/report/page.py", "os.getuid"): "behind hasattr(os, 'getuid')",
    ("rig/portholder.py", "os.getuid"): "behind hasattr(os, 'getuid')",
    ("profiles/files/decoder_worker.py", "resource"): "on Linux only; elsewhere the parent limits time",
    ("profiles/files/decoder_worker.py", "signal.setitimer"): "likewise",
}
_FOLDERS = ("inspect", "rig", "profiles", "sim")
MODULES = sorted(path for folder in _FOLDERS for path in (ROOT / folder).rglob("*.py"))


WORDS = re.compile("|".join(sorted(POSIX_ONLY.union(*MISSING_ON_WINDOWS.values()))))


def posix_uses(text):
    """(name, whether at import time) of everything that only POSIX has."""
    if not WORDS.search(text):
        return
    tree = ast.parse(text)
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for node in ast.walk(function)
    }
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".")[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            module = (node.module or "").split(".")[0]
            missing = MISSING_ON_WINDOWS.get(module, set())
            names = [module, *(f"{module}.{alias.name}" for alias in node.names if alias.name in missing)]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            owner = node.value.id
            names = [f"{owner}.{node.attr}"] if node.attr in MISSING_ON_WINDOWS.get(owner, set()) else []
        for name in names:
            if name in POSIX_ONLY or "." in name:
                yield name, id(node) not in inside


def test_the_search_finds_what_it_looks_for():
    text = (
        "import fcntl, os, signal\nfrom termios import tcgetattr\nfrom os import getuid\n"
        "def f():\n    import pty\n    os.kill(1, signal.SIGKILL)\n    getattr(signal, 'SIGHUP', None)\n"
    )
    assert sorted(posix_uses(text)) == [
        ("fcntl", True),
        ("os.getuid", True),
        ("pty", False),
        ("signal.SIGKILL", False),
        ("termios", True),
    ]


@pytest.mark.parametrize("folder", _FOLDERS)
def test_nothing_needs_posix(folder):
    found = set()
    for path in MODULES:
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(f"{folder}/"):
            continue
        for use, at_import in posix_uses(path.read_text(encoding="utf-8")):
            assert (name, use) in GUARDED, f"{name}: {use} exists on POSIX only"
            assert not at_import, f"{name}: {use} is needed as soon as it is imported"
            found.add((name, use))
    assert found == {key for key in GUARDED if key[0].startswith(f"{folder}/")}, "a guard that guards nothing"


def test_processes_are_spawned_or_of_loky():
    """A fork copies threads and locks, and Windows has none: nobody relies on one."""
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        assert not re.search(
            r"get_context\((?!\"spawn\"\))|set_start_method|multiprocessing import .*Pool", text
        ), path
