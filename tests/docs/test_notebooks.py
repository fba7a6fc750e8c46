"""The notebooks run from top to bottom: the quick one in this process, all of them in a kernel (soak)."""

import importlib.util
import warnings
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def test_the_quick_one(monkeypatch):
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    monkeypatch.chdir(ROOT / "docs" / "notebooks")
    notebook = nbformat.read(ROOT / "docs" / "notebooks" / "predict-and-plot.ipynb", as_version=4)
    names = {}
    try:
        for cell in notebook.cells:
            if cell.cell_type == "code":
                exec(compile(cell.source, cell.id, "exec"), names)
    finally:
        plt.close("all")
    assert names["found"].contrasts[0].log_ratio > 1.0
    assert (names["rougher"].radiance > names["round_about"].radiance).any()


def test_what_they_show_is_stored():
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert any(cell.get("outputs") for cell in notebook.cells), path
        assert not any(
            one.output_type == "error" for cell in notebook.cells for one in cell.get("outputs", ())
        )


@pytest.mark.soak
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_all_of_them_in_a_kernel(path):
    """A cell that fails raises; it runs as the stored outputs were made."""
    spec = importlib.util.spec_from_file_location("run_notebooks", ROOT / "tools" / "run_notebooks.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # of the kernel's sockets
        tool.run(path)
