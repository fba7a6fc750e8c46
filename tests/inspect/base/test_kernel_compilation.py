import os

from anisoscope.base.kernel_compilation import remove_stale


def test_kernels_older_than_any_source_are_forgotten(tmp_path):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    for name, age in (("inner.py", 100), ("outer.py", 300)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    for name, age in (("outer.f-1.py311.nbi", 200), ("inner.g-1.py311.nbi", 50)):
        (cache / name).touch()
        os.utime(cache / name, (1e9 - age, 1e9 - age))
    remove_stale(tmp_path)
    assert [path.name for path in cache.iterdir()] == ["inner.g-1.py311.nbi"]


def test_a_folder_without_cache_is_no_trouble(tmp_path):
    remove_stale(tmp_path / "nowhere")
    (tmp_path / "a.py").touch()
    remove_stale(tmp_path)
