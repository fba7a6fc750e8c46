"""``anisoscope cache info`` and ``cache clear``."""

import json
import os
import time

import pytest

from anisoscope.base.cache import Cache


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ANISOSCOPE_CACHE_LIMIT_MB", raising=False)
    return tmp_path / "cache"


def fill():
    for kind, count in (("predictions", 2), ("signatures", 1)):
        for number in range(count):
            entry = Cache().entry(kind, number, "anisoscope.base.cache")
            entry.write(bytes(500_000))
            old = time.time() - 7200.0 * (number + 1)
            os.utime(entry.path, (old, old))


def test_info_tells_folder_size_limit_kinds_and_ages(anisoscope, folder):
    fill()
    done = anisoscope("cache", "info")
    assert done.code == 0, done.err
    assert f"{folder}: 3 entries, 1.5 MB of 512.0 MB" in done.out
    for row in (("predictions", "2", "1.0 MB", "2 h", "4 h"), ("signatures", "1", "0.5 MB", "2 h", "2 h")):
        assert any(all(cell in line for cell in row) for line in done.out.splitlines()), done.out
    told = json.loads(anisoscope("cache", "info", "--json").out)
    assert (told["folder"], told["limit_bytes"], told["entries"]) == (str(folder), 512_000_000, 3)
    assert [one["kind"] for one in told["kinds"]] == ["predictions", "signatures"]
    assert told["kinds"][0]["longest_unused_s"] == pytest.approx(14400.0, abs=600.0)
    assert sum(one["bytes"] for one in told["kinds"]) == told["bytes"] > 1_500_000


def test_clear_says_what_it_removed_and_a_second_time_there_is_nothing(anisoscope, folder):
    fill()
    done = anisoscope("cache", "clear")
    assert done.code == 0, done.err
    assert done.out.splitlines() == [
        "removed 2 predictions, 1.0 MB",
        "removed 1 signatures, 0.5 MB",
        f"{folder}: 3 entries removed, 1.5 MB",
    ]
    assert Cache().stored() == []
    told = json.loads(anisoscope("cache", "clear", "--json").out)
    assert (told["removed"]["entries"], told["kinds"], told["left"]) == (0, [], 0)
    empty = anisoscope("cache", "info")
    assert (empty.code, empty.out.splitlines()[0]) == (0, f"{folder}: 0 entries, 0.0 MB of 512.0 MB")


def test_a_limit_that_is_no_number_is_told(anisoscope, folder, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE_LIMIT_MB", "plenty")
    done = anisoscope("cache", "info")
    assert (done.code, done.out) == (64, "")
    assert "ANISOSCOPE_CACHE_LIMIT_MB" in done.err
    assert "'plenty'" in done.err


def test_a_file_in_place_of_the_folder_is_said(anisoscope, folder):
    folder.write_text("")
    assert f"{folder} is not a folder: nothing is cached" in anisoscope("cache", "info").out.splitlines()
