"""Decoders that hang, die, print, or take memory cannot do so to us."""

import sys
import textwrap
import time

import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files import decoder_process

MISBEHAVING = """
    import os, sys, time
    import numpy as np
    from anisoscope.profiles.files import decoder_worker

    def hang(request):
        while True:
            pass

    def sleep(request):
        time.sleep(600)

    def die(request):
        os.abort()

    def swell(request):
        return {}, np.ones(2**30)

    def shout(request):
        os.write(1, b"x" * 10**6)
        os.write(2, b"y" * 10**6)
        print("z" * 10**6, file=sys.stderr)
        return {}, np.eye(3)

    def leave(request):
        sys.exit("no")

    decoder_worker.DECODERS.update(hang=hang, sleep=sleep, die=die, swell=swell, shout=shout, leave=leave)
    decoder_worker._prepare = lambda kind: "misbehaving 1"
    decoder_worker.main()
"""


@pytest.fixture
def decode(tmp_path, monkeypatch):
    """``decoder_process.decode`` with a process of its own whose decoders misbehave."""
    script = tmp_path / "misbehaving.py"
    script.write_text(textwrap.dedent(MISBEHAVING))
    keeper = decoder_process._Keeper()
    monkeypatch.setattr(decoder_process, "COMMAND", [sys.executable, str(script)])
    monkeypatch.setattr(decoder_process, "_keeper", keeper)
    (tmp_path / "a.sur").write_bytes(b"DIGITAL SURF")
    yield lambda kind: decoder_process.decode(kind, tmp_path / "a.sur")
    keeper.drop()


def test_a_decoder_that_hangs_is_stopped_and_the_next_file_is_read(decode, monkeypatch):
    start = time.monotonic()
    with monkeypatch.context() as patch, pytest.raises(HeightMapError, match="reading: the decoder stopped"):
        patch.setattr(decoder_process, "SECONDS", 0.3)
        decode("hang")
    assert time.monotonic() - start < 60.0  # the decoder would hang for ever
    _, raw = decode("shout")
    assert raw.trace() == 3.0


def test_a_decoder_that_waits_for_ever_is_not_waited_for(decode, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(HeightMapError, match="the decoder stopped"):
        patch.setattr(decoder_process, "SECONDS", 0.02)
        decode("sleep")
    assert decode("shout")[1].shape == (3, 3)


def test_a_decoder_that_dies_is_replaced(decode):
    for _ in range(2):
        with pytest.raises(HeightMapError, match="the decoder stopped"):
            decode("die")
    assert decode("shout")[1].shape == (3, 3)


def test_a_decoder_that_takes_memory_is_refused_it(decode):
    with pytest.raises(HeightMapError, match="more memory than a file of its size"):
        decode("swell")


def test_a_decoder_that_exits_is_an_error_of_the_file(decode):
    with pytest.raises(HeightMapError, match="SystemExit: no"):
        decode("leave")


def test_nothing_that_a_decoder_prints_is_seen(decode, capfd):
    answer, _ = decode("shout")
    assert answer["reader"] == "misbehaving 1"
    assert capfd.readouterr() == ("", "")


def test_the_process_is_kept_and_its_folder_removed(decode, monkeypatch):
    decode("shout")
    process = decoder_process._keeper.process
    decode("shout")
    assert decoder_process._keeper.process is process
    assert not list(process.folder.iterdir())
    decoder_process._keeper.drop()
    assert not process.folder.exists()
    assert process.process.returncode is not None


@pytest.mark.parametrize(
    ("kind", "name", "remedy"),
    [
        ("mesh", "a.stl", "pyvista is not installed; pip install 'anisoscope[view]'"),
        ("library", "a.plux", "SurfaceTopography is not installed; pip install 'anisoscope[formats]'"),
        ("exr", "a.exr", "OpenEXR is not installed; pip install 'anisoscope[exr]'"),
    ],
)
def test_a_decoder_that_is_not_installed_is_named_with_its_extra(kind, name, remedy, tmp_path, monkeypatch):
    (tmp_path / name).write_bytes(b"something")
    monkeypatch.setattr(decoder_process.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(HeightMapError) as problem:
        decoder_process.decode(kind, tmp_path / name)
    assert remedy in str(problem.value)
