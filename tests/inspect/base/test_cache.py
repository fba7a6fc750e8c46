"""The cache: what is computed once, what is computed again, and what the folder holds."""

import json
import os
import shutil
import subprocess
import sys
import time
from importlib.metadata import distribution
from pathlib import Path

import pytest

from anisoscope.base import cache as cache_module
from anisoscope.base.cache import Cache, SourceDigests, cache_folder, limit_bytes, source_digest
from anisoscope.base.errors import RecordError, UsageError

ROOT = Path(__file__).parents[3]
HERE = "anisoscope.prediction.cache"


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("ANISOSCOPE_CACHE_LIMIT_MB", raising=False)
    return tmp_path / "cache"


def entry(number=1, kind="numbers", cache=None):
    return (cache or Cache()).entry(kind, {"number": number}, HERE)


# the sources that a key holds ------------------------------------------------------------------------------------


@pytest.fixture
def copied(tmp_path):
    """A copy of the package, and the digest that a process of its own computes from it."""
    package = tmp_path / "anisoscope"
    shutil.copytree(ROOT / "inspect", package)
    for name in ("rig", "profiles", "sim"):
        shutil.copytree(ROOT / name, package / name)
    about = tmp_path / "anisoscope-0.1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: anisoscope\nVersion: 0.1.0\n")
    (about / "entry_points.txt").write_text(distribution("anisoscope").read_text("entry_points.txt"))
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from anisoscope.base.cache import SourceDigests\n"
        "from pathlib import Path\n"
        "print(SourceDigests(Path(sys.argv[1], 'memo.json')).of(sys.argv[2]))"
    )

    def digest(module="anisoscope.diagnosis.signature_cache"):
        command = [sys.executable, "-IS", "-c", code, str(tmp_path), module]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    return package, digest


def edit(file):
    with file.open("a") as stream:
        stream.write("\nEDITED = 1\n")


def test_an_edit_of_anything_that_signatures_import_is_another_key(copied):
    package, digest = copied
    found = [digest()]
    for file in (
        "sim/light/wave/fused_kernels.py",  # seven imports deep
        "imaging/pose_radiance.py",
        "prediction/expectation.py",
        "profiles/__init__.py",  # a package around what is imported
        "profiles/ridge_defects.py",  # plug-ins, which nothing imports
    ):
        edit(package / file)
        found.append(digest())
    assert len(set(found)) == len(found)


def test_an_edit_of_what_signatures_do_not_import_changes_nothing(copied):
    package, digest = copied
    before = digest()
    for file in ("cli/predict/predict.py", "report/inspection_page.py", "study/sweep.py"):
        assert (package / file).is_file()
        edit(package / file)
    assert digest() == before


def test_the_place_of_the_package_is_no_part_of_the_key(copied):
    assert copied[1]() == source_digest("anisoscope.diagnosis.signature_cache")


def lay(folder, files):
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_every_form_of_import_is_followed(monkeypatch, tmp_path):
    files = {
        "laid/__init__.py": "",
        "laid/top.py": "from laid import one\nimport laid.two as two\nfrom .three import nothing\n"
        "def late():\n    from laid.deep import four\n",
        "laid/one.py": "import json\nimport numpy\n",
        "laid/two.py": "from anisoscope.base import arrays\n",
        "laid/three.py": "",
        "laid/deep/__init__.py": "from . import five\n",
        "laid/deep/four.py": "from ..six import nothing\n",
        "laid/deep/five.py": "this is not python",
        "laid/deep/data/table.csv": "1,2\n",
        "laid/six.py": "from laid import top\n",
        "laid/seven.py": "",
    }
    lay(tmp_path, files)
    monkeypatch.syspath_prepend(tmp_path)
    found = SourceDigests().modules("laid.top")
    own = {name for name in found if name.startswith("laid")}
    modules = {"laid", "laid.deep", *(f"laid.{name}" for name in ("top", "one", "two", "three", "six"))}
    assert own == modules | {"laid.deep.four", "laid.deep.five", "laid.deep/data/table.csv"}
    assert {"anisoscope.base", "anisoscope.base.arrays"} <= set(found)
    assert not any(name.startswith(("numpy", "json")) for name in found)
    before = SourceDigests().of("laid.top")
    (tmp_path / "laid/deep/data/table.csv").write_text("1,3\n")
    assert SourceDigests().of("laid.top") != before
    with pytest.raises(LookupError, match=r"laid\.none"):
        SourceDigests().of("laid.none")


def test_the_memo_saves_parsing_and_never_hides_an_edit(monkeypatch, tmp_path):
    lay(
        tmp_path,
        {"laid2/__init__.py": "", "laid2/top.py": "from laid2 import low\n", "laid2/low.py": "A = 1\n"},
    )
    monkeypatch.syspath_prepend(tmp_path)
    parsed = []
    parse = "anisoscope.base.cache._parse"
    original = sys.modules["anisoscope.base.cache"]._parse
    monkeypatch.setattr(parse, lambda file: parsed.append(file.name) or original(file))

    def digest():
        parsed.clear()
        digests = SourceDigests(tmp_path / "memo.json")
        found = digests.of("laid2.top")
        digests.save()
        return found

    first = digest()
    assert sorted(parsed) == ["__init__.py", "low.py", "top.py"]
    assert digest() == first
    assert parsed == []
    low, state = tmp_path / "laid2/low.py", (tmp_path / "laid2/low.py").stat()
    low.write_text("A = 2\n")  # as long as before
    os.utime(low, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert digest() != first
    assert parsed == ["low.py"]
    for damaged in ("{", "[]", '{"format": 1, "files": {"a": 1}}', '{"format": 0}'):
        (tmp_path / "memo.json").write_text(damaged)
        assert len({digest(), digest()}) == 1


def test_a_digest_costs_an_inspection_next_to_nothing(folder):
    """With the memo of an earlier process, a file costs a look at its state."""
    memo = folder / "memo.json"
    first = SourceDigests(memo)
    first.of("anisoscope.diagnosis.signature_cache")
    first.save()
    took = []
    for _ in range(5):
        began = time.process_time()
        SourceDigests(memo).of("anisoscope.diagnosis.signature_cache")
        took.append(time.process_time() - began)
    assert min(took) < 0.1


# entries ---------------------------------------------------------------------------------------------------------


def test_a_result_is_computed_once(folder):
    computed = []

    def compute():
        computed.append(1)
        return 42

    found = [entry().result(compute, lambda value: json.dumps(value).encode(), json.loads) for _ in range(3)]
    assert found == [42, 42, 42]
    assert len(computed) == 1


def test_what_the_caller_gives_kind_code_and_libraries_make_the_key(folder, monkeypatch):
    paths = {entry().path, entry(2).path, entry(kind="others").path}
    paths.add(Cache().entry("numbers", {"number": 1}, "anisoscope.base.cache").path)
    paths.add(Cache().entry("numbers", {"number": 1}, HERE, libraries=("pytest",)).path)
    assert entry().path in paths
    monkeypatch.setattr(cache_module, "source_digest", lambda *_: "other code")
    paths.add(entry().path)
    assert len(paths) == 6


def test_damaged_and_foreign_files_are_no_entries(folder):
    one, other = entry(1), entry(2)
    one.write(b"content")
    whole = one.path.read_bytes()
    assert one.read() == b"content"
    for damaged in (b"", whole[:-1], whole[:20], whole[:-1] + b"x", b"content"):
        one.path.write_bytes(damaged)
        assert one.read() is None
    other.path.write_bytes(whole)  # under another's name
    assert other.read() is None
    one.path.unlink()
    one.path.mkdir()
    assert one.read() is None
    one.write(b"content")


def test_where_nothing_can_be_written_nothing_is_cached(monkeypatch, tmp_path):
    monkeypatch.setenv("ANISOSCOPE_CACHE", "/dev/null")
    entry().write(b"content")
    assert entry().read() is None
    assert Cache().stored() == []
    assert Cache().clear() == []
    (tmp_path / "file").touch()
    with pytest.raises(RecordError, match="cannot write"):  # a folder of somebody's choice must hold
        entry(cache=Cache(tmp_path / "file")).write(b"content")


def test_what_was_not_used_for_longest_goes_first(folder, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE_LIMIT_MB", "0.01")
    content = bytes(3000)
    for number in range(3):
        entry(number).write(content)
        os.utime(entry(number).path, (1000 + number, 1000 + number))
    assert entry(0).read() == content  # used just now
    entry(3).write(content)
    assert [entry(number).read() is not None for number in range(4)] == [True, False, True, True]
    entry(4).write(bytes(20000))  # never fits
    assert entry(4).read() is None
    assert entry(3).read() == content
    monkeypatch.setenv("ANISOSCOPE_CACHE_LIMIT_MB", "0")
    entry(5).write(b"")
    assert entry(5).read() is None


def test_a_folder_of_somebodys_choice_has_no_limit(tmp_path, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE_LIMIT_MB", "0")
    entry(cache=Cache(tmp_path)).write(b"content")
    assert entry(cache=Cache(tmp_path)).read() == b"content"


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf"])
def test_a_limit_that_is_no_size_is_refused_and_stops_no_inspection(folder, monkeypatch, text):
    monkeypatch.setenv("ANISOSCOPE_CACHE_LIMIT_MB", text)
    with pytest.raises(UsageError, match="ANISOSCOPE_CACHE_LIMIT_MB takes a number of megabytes"):
        limit_bytes()
    entry().write(b"content")
    assert entry().read() == b"content"


def test_clearing_removes_entries_and_nothing_else(folder):
    for number in range(3):
        entry(number).write(b"content")
    strange = folder / "numbers" / "notes.txt"
    strange.write_text("mine")
    half = folder / "numbers" / f".{'0' * 32}.entry.1_2.partial"
    half.touch()
    at_work = folder / "numbers" / f".{'1' * 32}.entry.1_2.partial"
    at_work.touch()
    os.utime(half, (1000, 1000))
    assert len(Cache().clear()) == 3
    assert Cache().stored() == []
    assert sorted(path.name for path in folder.rglob("*") if path.is_file()) == sorted(
        [at_work.name, strange.name]
    )


def test_processes_that_write_and_remove_at_the_same_time_read_whole_entries(folder):
    program = (
        "import sys\n"
        "from anisoscope.base.cache import Cache\n"
        "for turn in range(12):\n"
        "    for number in range(6):\n"
        f"        entry = Cache().entry('numbers', number, {HERE!r})\n"
        "        found = entry.read()\n"
        "        assert found in (None, bytes([number]) * 50_000), number\n"
        "        entry.write(bytes([number]) * 50_000)\n"
        "    if turn % 4 == 0:\n"
        "        Cache().clear()\n"
    )
    environment = os.environ | {"ANISOSCOPE_CACHE_LIMIT_MB": "0.2"}
    running = [
        subprocess.Popen([sys.executable, "-c", program], env=environment, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for one in running:
        assert one.communicate(timeout=120)[1] == ""
        assert one.returncode == 0
    assert sum(one.size for one in Cache().stored()) <= 0.2e6
    assert not list(cache_folder().rglob("*.partial"))


def test_code_that_was_edited_after_it_was_loaded_is_neither_served_nor_stored(folder, monkeypatch, tmp_path):
    package = tmp_path / "edited_kind"
    package.mkdir()
    source = package / "__init__.py"
    source.write_text("A = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(cache_module, "_LOADED_AT", time.time() + 60.0)
    place = Cache().entry("numbers", 1, "edited_kind")
    place.write(b"of the loaded code")
    assert place.read() == b"of the loaded code"
    edited = time.time() + 120.0
    os.utime(source, (edited, edited))
    assert place.read() is None
    other = Cache().entry("numbers", 2, "edited_kind")
    other.write(b"of which code?")
    assert not other.path.exists()
    source.unlink()
    assert place.read() is None


def test_the_sources_of_this_process_are_loaded():
    assert SourceDigests().loaded(HERE)
