"""Truncated files and files with flipped header bytes: HeightMapError or a plausible map, and nothing else."""

import time
from pathlib import Path

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.profiles.files import decoder_process
from anisoscope.profiles.files.load import read_height_map

LIMIT_S = 5.0  # of this process's own time; the guarded one has a limit of its own
SPENT = []
MEMORY_BYTES = 2**30
REAL_HEADERS = {
    "opengps_rubber.x3p": 400,
    "sensofar_ground.plu": 508,
    "wyko.opd": 24_030,
    "iso25178-71_ascii.sdf": 300,
    "zygo_metropro.dat": 834,
    "digitalsurf.sur": 512,
    "alicona.al3d": 800,
}


@pytest.fixture
def little_memory():
    """No more than 1 GiB above what is in use; the guarded process has limits of its own."""
    resource = pytest.importorskip("resource", reason="Windows has no limits of memory")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY_BYTES, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.fixture(autouse=True)
def _starting(monkeypatch):
    """Seconds in which the guarded process was started anew do not count as reading."""
    prepare = decoder_process.GuardedProcess.prepare

    def timed(self, kind):
        start = time.process_time()
        found = prepare(self, kind)
        SPENT.append(time.process_time() - start)
        return found

    monkeypatch.setattr(decoder_process.GuardedProcess, "prepare", timed)


def read_or_refuse(path, options):
    """The map, or None where it was refused in one line; within the time."""
    SPENT.clear()
    start = time.process_time()
    try:
        surface = read_height_map(path, **options)
    except HeightMapError as error:
        assert "\n" not in str(error)  # noqa: PT017 - both outcomes are right
        assert path.name in str(error)  # noqa: PT017
        surface = None
    assert time.process_time() - start - sum(SPENT) < LIMIT_S
    if surface is not None:
        assert np.nanmax(np.abs(surface.height_um)) <= 10_000.0
        assert min(surface.pixel_x_um, surface.pixel_y_um) >= 0.01
        assert max(surface.pixel_x_um, surface.pixel_y_um) <= 1000.0
    return surface


def truncate(path, whole, places, options):
    for size in np.linspace(0, len(whole) - 1, places).astype(int):
        path.write_bytes(whole[:size])
        yield size, read_or_refuse(path, options)


def flip(path, whole, header, times, options, seed):
    rng = np.random.default_rng(seed)
    for _ in range(times):
        data = bytearray(whole)
        data[int(rng.integers(min(header, len(data))))] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(data))
        yield read_or_refuse(path, options)


def damage(made, tmp_path, heights, places, flips, seed=1):
    path = tmp_path / f"a{made.suffix}"
    made.write(path, heights)
    whole = path.read_bytes()
    assert read_or_refuse(path, made.options) is not None
    for size, surface in truncate(path, whole, places, made.options):
        if surface is not None and made.suffix != ".xyz":
            assert size > 0.9 * len(whole), "a truncated file was read as if it were whole"
            assert surface.shape == heights.shape
    list(flip(path, whole, made.header, flips, made.options, seed))


@pytest.mark.usefixtures("little_memory")
def test_own_readers_survive(made_own, tmp_path, heights, capfd):
    damage(made_own, tmp_path, heights, places=20, flips=40)
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("little_memory")
def test_library_formats_survive(made_library, tmp_path, heights, capfd):
    damage(made_library, tmp_path, heights, places=20, flips=40)
    assert capfd.readouterr() == ("", "")


@pytest.mark.realdata
@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("name", REAL_HEADERS)
def test_real_files_survive(name, real_file, tmp_path, capfd):
    whole = real_file(name).read_bytes()
    path = tmp_path / name
    for _ in truncate(path, whole, 5, {}):
        pass
    list(flip(path, whole, REAL_HEADERS[name], 20, {}, seed=2))
    assert capfd.readouterr() == ("", "")


@pytest.mark.soak
@pytest.mark.usefixtures("little_memory")
def test_long_campaign(made, tmp_path, heights, capfd):
    damage(made, tmp_path, heights, places=1000, flips=5000, seed=7)
    assert capfd.readouterr() == ("", "")


def what_changed(true, surface):
    """The worst of what a damaged header has done; heights are compared without their mean."""
    if surface is None:
        return "refused"
    ratios = [now / then for now, then in zip(surface.extent_um, true.extent_um, strict=True)]
    if surface.shape == true.shape and np.array_equal(np.isnan(surface.height_um), np.isnan(true.height_um)):
        now, then = (map_.height_um - np.nanmean(map_.height_um) for map_ in (surface, true))
        if np.allclose(now, then, rtol=0, atol=1e-6 * np.nanstd(then), equal_nan=True):
            return "nothing" if np.allclose(ratios, 1.0, rtol=1e-6, atol=0) else "pixel"
    return "heights"


@pytest.mark.soak
@pytest.mark.usefixtures("little_memory")
def test_what_a_flipped_bit_changes_silently(made, request, tmp_path, heights, capsys):
    """Every bit of the header, one at a time: what is refused, and what goes through with another scale."""
    path = tmp_path / f"a{made.suffix}"
    made.write(path, heights)
    whole = path.read_bytes()
    true = read_or_refuse(path, made.options)
    found = dict.fromkeys(("refused", "nothing", "pixel", "heights"), 0)
    for place in range(8 * min(made.header, len(whole))):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(bytes(data))
        found[what_changed(true, read_or_refuse(path, made.options))] += 1
    total = sum(found.values())
    shares = ", ".join(f"{key} {100 * count / total:.1f} %" for key, count in found.items())
    with capsys.disabled():
        print(f"\n{request.node.callspec.id}: {total} bits: {shares}")  # noqa: T201
