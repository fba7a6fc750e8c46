"""The audit trail: what was changed in it is found, whoever writes at the same time and whenever a process ends."""

import json
import subprocess
import sys

import pytest

from anisoscope.base.errors import RecordError
from anisoscope.console.trail import A_PIECE, Trail, trail_of

ADDS = """
import sys
from pathlib import Path
from anisoscope.console.trail import Trail
for number in range(int(sys.argv[3])):
    Trail(Path(sys.argv[1])).add(sys.argv[2], "step", "x" * (number % 7 * 1000), number=number)
    print(number, flush=True)
"""


def test_a_changed_or_removed_line_of_the_trail_is_found(tmp_path):
    trail = trail_of(tmp_path / "users.json")
    for what in ("start", "stop", "account set"):
        trail.add("anna", what, "why not", serial="A-1")
    assert trail.damaged() == []
    lines = trail.path.read_text().splitlines()
    changed = json.loads(lines[1]) | {"who": "bo"}
    trail.path.write_text("\n".join([lines[0], json.dumps(changed), lines[2]]) + "\n")
    assert trail.damaged() == [2]
    trail.path.write_text("\n".join([lines[0], lines[2]]) + "\n")
    assert trail.damaged() == [2]


def test_a_process_may_end_at_any_byte_of_a_line(tmp_path):
    path = tmp_path / "trail"
    Trail(path).add("anna", "first")
    first = path.read_bytes()
    Trail(path).add("anna", "seconds", "ä")
    whole = path.read_bytes()
    cut_letter = whole.index("ä".encode()) + 1
    for size in (*range(len(first), len(whole), 9), cut_letter, len(whole) - 1, len(whole)):
        path.write_bytes(whole[:size])
        trail = Trail(path)
        assert trail.damaged() == [], size
        trail.add("bo", "third")
        kept = ["first", "seconds", "third"] if size >= len(whole) - 1 else ["first", "third"]
        assert [line["what"] for line in trail.lines()] == kept, size
        assert trail.damaged() == [], size
        path.write_bytes(path.read_bytes()[:-20])  # and once more
        trail.add("bo", "fourth")
        assert trail.damaged() == [], size


def test_a_piece_that_was_changed_or_added_is_found(tmp_path):
    trail = Trail(tmp_path / "trail")
    trail.add("anna", "first")
    trail.path.write_bytes(trail.path.read_bytes() + b'{"at": "20')
    trail.add("anna", "second")
    lines = trail.path.read_bytes().splitlines(keepends=True)
    for changed in (
        [lines[0], b"other\n", lines[2]],
        [lines[0], lines[2]],
        [*lines[:2], b"more\n", lines[2]],
        [*lines, b"more\n"],
    ):
        trail.path.write_bytes(b"".join(changed))
        assert trail.damaged() != []


def test_several_processes_add_lines_though_one_is_killed(tmp_path):
    path = tmp_path / "trail"

    def adding(name, count):
        arguments = [sys.executable, "-c", ADDS, str(path), name, str(count)]
        return subprocess.Popen(arguments, stdout=subprocess.PIPE)

    with adding("a", 15) as one, adding("b", 15) as two, adding("endless", 1_000_000) as other:
        for _ in range(5):
            other.stdout.readline()
        Trail(path).add("here", "between")
        other.kill()
        for running in (one, two):
            running.communicate()
    trail = Trail(path)
    assert trail.damaged() == []
    lines = trail.lines()
    for name in ("a", "b"):
        assert [line["more"]["number"] for line in lines if line["who"] == name] == list(range(15))
    assert len(path.read_bytes()) > 2 * A_PIECE


def test_a_trail_that_cannot_be_written_says_so(tmp_path):
    with pytest.raises(RecordError, match="cannot be written"):
        Trail(tmp_path).add("anna", "first")
    with pytest.raises(RecordError, match="cannot be read"):
        Trail(tmp_path).lines()
