"""Every command is given pipes, devices, links that lead to themselves and files without end, where it wants a file."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest

from anisoscope.cli import run

pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes"),
]
LONGEST_S = 2
MOST_MIB = 64
MAKES = {"init", "key new"}
"""Commands whose path is that of a new file or folder."""
STARTS = {"recompute"}
"""Commands that start processes first, whose time varies by more than the limit."""
ROW = re.compile(r"([a-z0-9 -]+): ([A-Z_]+) \((.*)\) = (.*)")


def commands():
    """Words of each command with a path in front, ``{}`` where a path stands."""
    wanted = {}
    rows = Path(__file__).with_name("options.txt").read_text(encoding="utf-8").splitlines()
    for command, name, kind, default in (found.groups() for found in map(ROW.fullmatch, rows) if found):
        wanted.setdefault(command, []).append((name, kind, default))
    for command, names in wanted.items():
        paths = [one for one in names if "Path" in one[1]]
        needed = [one for one in names if one[2] == "required" or one in paths[:1]]
        if paths and command not in MAKES:
            yield (
                command,
                ["{}" if "Path" in kind else "P-1" if "str" in kind else "1" for _, kind, _ in needed],
            )


def done(words):
    """Exit code, seconds, MiB and what was said by a command in a process of its own."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(10 * LONGEST_S)
        for stream in (1, 2):
            os.dup2(writing, stream)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        code = 99
        try:
            code = run(words)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        said = stream.read().decode()
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, said


@pytest.mark.parametrize("suffix", [".toml", ".csv", ".x3p", ".png", ".npz"])
@pytest.mark.parametrize(
    ("command", "words"), list(commands()), ids=lambda one: one if isinstance(one, str) else ""
)
def test_what_is_no_file_is_refused_in_a_line_at_once(command, words, suffix, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo(f"pipe{suffix}")
    Path(f"zeros{suffix}").symlink_to("/dev/zero")
    Path(f"loop{suffix}").symlink_to(f"loop{suffix}")
    with Path(f"huge{suffix}").open("wb") as stream:
        stream.truncate(1 << 40)  # takes no room

    def of(name):
        return done([*command.split(), *(word.format(f"{name}{suffix}") for word in words)])

    _, seconds, size, _ = of("missing")
    for name in ("pipe", "zeros", "loop", "huge"):
        code, took, held, said = of(name)
        assert code not in (0, 70, 99), said
        assert code > 0, f"{name}: it waits for ever"
        assert len(said.splitlines()) == 1 or command in STARTS, said
        assert took < seconds + LONGEST_S or command in STARTS
        assert held < size + MOST_MIB
